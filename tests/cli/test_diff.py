"""The verb diff, and the report of a study beside another one."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.cli.small import DESIGN, Finished, study, write_files

#: the same study of a specimen that is 1 mm taller and over a shorter range
SECOND = (
    DESIGN.replace('"small"', '"other"', 1)
    .replace('"30 mm"', '"31 mm"')
    .replace('["1 %", "20 %"]', '["1 %", "12 %"]')
)


@pytest.fixture(scope="module")
def pair(finished: Finished, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with two finished studies and one that shares nothing with them."""
    folder = tmp_path_factory.mktemp("pair")
    write_files(folder)
    shutil.copytree(finished.folder / "results", folder / "results")
    (folder / "other.toml").write_text(SECOND)
    alone = SECOND.replace('"other"', '"alone"', 1).replace("relative_rms", "rms")
    (folder / "alone.toml").write_text(alone.replace('"0.5 pp"', '"0.1 N"'))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for name in ("other", "alone"):
            answer = study("run", f"{name}.toml", "--data", "data", "--jobs", 1, "--json")
            assert answer.code == 0, answer.err
    return folder


@pytest.fixture
def here(pair: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(pair)
    return pair


@pytest.mark.usefixtures("here")
def test_diff_as_json() -> None:
    answer = study("diff", "small", "results/other", "--json")
    assert answer.code == 0, answer.err
    found = answer.json
    assert [s["name"] for s in found["studies"]] == ["small", "other"]
    assert found["studies"][0]["cases"] == {"total": 12, "done": 12, "failed": 0, "missing": 0}
    assert {c["key"]: c["values"] for c in found["changes"]} == {
        "specimen.height": ["30 mm", "31 mm"],
        "presets.range.large.measurements.range": ["1 %, 20 %", "1 %, 12 %"],
    }
    verdicts = {
        name: {
            # an interaction has no verdict: studies are compared by what its components allow
            (row["response"], row["factor"]): row["of_components"] or row["verdict"]
            for row in study("report", name, "--json").json["verdicts"]
        }
        for name in ("small", "other")
    }
    assert len(found["conclusions"]) == 3  # two factors and their interaction
    for row in found["conclusions"]:
        key = row["response"], row["factor"]
        assert [one["verdict"] for one in row["found"]] == [
            verdicts["small"][key], verdicts["other"][key],
        ]  # fmt: skip


@pytest.mark.usefixtures("here")
def test_diff_in_words_names_the_changes_first() -> None:
    words = study("diff", "small.toml", "other.toml").out
    assert words.index("specimen.height") < words.index("conclusions about single factors")
    assert words.index("conclusions about single factors") < words.index("95 % interval")
    assert "31 mm" in words


@pytest.mark.parametrize(
    ("first", "second", "said"),
    [
        ("small", "alone", "no analyzed response with a factor in common"),
        ("small", "results/small", "is the same study as the other one"),
        ("small", "nowhere", "no results of a study there"),
    ],
)
@pytest.mark.usefixtures("here")
def test_what_cannot_be_compared_is_bad_input(first: str, second: str, said: str) -> None:
    answer = study("diff", first, second, "--json")
    assert answer.code == 2
    assert said in answer.err
    assert answer.out == ""


def test_report_beside_another_study(here: Path) -> None:
    answer = study(
        "report", "small", "--beside", "other", "--format", "html", "--reports", "two", "--json"
    )
    assert answer.code == 0, answer.err
    assert set(answer.json["beside"]) >= {"summary", "conclusions"}
    first = here / answer.json["report"]
    page = first.with_name(f"{first.stem}-details.html").read_text()
    assert '<section id="beside">' in page
    assert "Compared with other" in page
    table = (here / "two" / "small" / "small-data" / "table-beside.csv").read_text()
    assert table.count("\n") == 1 + 2 * 3


def test_report_beside_a_study_with_nothing_in_common_writes_nothing(here: Path) -> None:
    answer = study("report", "small", "--beside", "alone", "--reports", "none")
    assert answer.code == 2
    assert "share a [[response]] and a factor by name" in answer.err
    assert not (here / "none").exists()
