"""The fuzz campaign draws every verb, repeats its examples, and sees what it looks for."""

import numpy as np
import pytest

from study.cli.app import VERBS
from validation import fuzz, fuzz_verbs
from validation.fuzz_inputs import Place


@pytest.fixture
def place(tmp_path):
    """A campaign whose project has its inputs, and stored files in place of runs."""
    folder = tmp_path / "verbs"
    fuzz_verbs.write_project(folder)
    case = "cases/0123456789ab/record.json"
    for name in (f"results/small/{case}", f"results/demo/{case}", "reports/small/small.html"):
        (folder / name).parent.mkdir(parents=True)
        (folder / name).write_text('{"schema": 1, "checksum": "0", "content": {}}')
    return Place(str(tmp_path), str(tmp_path))


def words_of(place, number, folder):
    folder.mkdir()
    (words,), _ = fuzz_verbs.every_verb(np.random.default_rng(number), folder, place)
    return words


def test_every_verb_of_the_program_is_drawn(place, tmp_path):
    names = {verb.__name__ for verb in VERBS}
    assert set(fuzz_verbs.MAKERS) == names
    rng = np.random.default_rng(1)
    for verb, make in fuzz_verbs.MAKERS.items():
        folder = tmp_path / f"of-{verb}"
        fuzz_verbs.write_project(folder)
        for study in ("small", "demo"):
            (folder / f"results/{study}/cases/0123456789ab").mkdir(parents=True)
        assert make(rng, folder)[0] == verb
        assert all(option.startswith("--") for option in fuzz_verbs.options_of(verb))


def test_an_example_is_the_same_when_it_is_repeated(place, tmp_path):
    for number in range(12):
        first = words_of(place, number, tmp_path / f"a{number}")
        assert first == words_of(place, number, tmp_path / f"b{number}")
        contents = [
            {p.relative_to(f): p.read_bytes() for p in f.rglob("*") if p.is_file()}
            for f in (tmp_path / f"a{number}", tmp_path / f"b{number}")
        ]
        assert contents[0] == contents[1]


def test_kinds_are_drawn_in_their_shares():
    drawn = [fuzz.drawn("all", 7, number) for number in range(1000)]
    assert set(drawn) == set(fuzz.KINDS)
    assert drawn.count("verbs") == pytest.approx(700, abs=60)
    assert fuzz.drawn("tables", 7, 3) == "tables"


def test_what_is_wrong_with_an_answer():
    assert list(fuzz.wrong(0, "done", "")) == []
    assert list(fuzz.wrong(2, "", "error:\n  the design has no factors\n")) == []
    assert list(fuzz.wrong(130, "", "interrupted: nothing was written", True)) == []
    assert any("documented nowhere" in fault for fault in fuzz.wrong(-11, "", "Segmentation fault"))
    assert any("without a sentence" in fault for fault in fuzz.wrong(2, "", ""))
    assert any("Traceback" in fault for fault in fuzz.wrong(1, "", "Traceback (most recent call"))


def test_the_table_counts_by_verb():
    outcomes = [
        fuzz.Outcome(0, ["solve problem.toml"], [0], seconds=1.5, megabytes=40.0),
        fuzz.Outcome(1, ["solve no.toml"], [2], seconds=0.5),
        fuzz.Outcome(2, ["serve --port 0"], [130], ["a page answers 500"]),
    ]
    lines = {line.split()[0]: line.split() for line in fuzz.shown("all", outcomes)}
    assert lines["solve"] == ["solve", "2", "50%", "1", "0", "1.00", "1.5", "40", "0"]
    assert lines["serve"][1:5] == ["1", "100%", "0", "1"]
    assert lines["tracking"] == ["tracking", "0"]
    assert lines["all"][1:3] == ["3", "67%"]
