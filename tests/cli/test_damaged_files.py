"""Sealed files of a finished study with wrong content get an answer or a refusal in words.

Every key is damaged once (:mod:`validation.damage`): some damages in each run of the tests, all of
them with ``-m verify``.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from study import api
from study.ground.errors import StoreError
from study.harness.record.record import Record, seal
from tests.cli.small import Answer, study
from validation.damage import Damage, damages, sealed
from validation.fuzz import BUG, obey

#: one damage of so many is looked at where it need not be all
FEW = 150

READERS = (
    ("status", "small"),
    ("plan", "small.toml", "--data", "data"),
    ("analyze", "results/small"),
    ("report", "small", "--format", "csv"),
)
RUN = ("run", "small.toml", "--data", "data", "--jobs", "1")
SMALL = Path("results/small")


def records() -> list[Path]:
    """Records of the study, by name."""
    return sorted(SMALL.glob("cases/*/record.json"))


def fault(words: Sequence[str]) -> str:
    """Say what is wrong with the answer to a verb; empty if nothing is."""
    answer = study(*words)
    said = answer.out + answer.err
    found = BUG.search(said)
    if found is not None:
        return f"{words[0]}: {said[max(found.start() - 100, 0) : found.end() + 100]}"
    if answer.code not in (0, 1, 2, 3) or (answer.code and len(said.split()) < 3):
        return f"{words[0]}: exit code {answer.code}, {said!r}"
    return ""


def accepted(content: object) -> Iterator[Damage]:
    """Damages that make no record invalid; the others are one and the same to every verb."""
    for damage in damages(content):
        try:
            Record.from_json(sealed(damage.content).encode())
        except StoreError:
            continue
        yield damage


def look(path: Path, found: Sequence[Damage], verbs: Sequence[Sequence[str]]) -> list[str]:
    """Damage a file in some ways, and list what is wrong with the answers."""
    whole = {one: one.read_bytes() for one in SMALL.rglob("*") if one.is_file()}
    wrong = []
    for damage in found:
        path.write_text(sealed(damage.content))
        wrong += [f"{path.name}: {damage}: {said}" for verb in verbs if (said := fault(verb))]
        for one in [one for one in SMALL.rglob("*") if one.is_file() and one not in whole]:
            one.unlink()
        for one, data in whole.items():
            one.write_bytes(data)
    return wrong


def content_of(path: Path) -> object:
    """Content of a sealed file."""
    return json.loads(path.read_bytes())["content"]


def test_some_damages_of_a_record(done: Path) -> None:
    path = records()[0]
    found = list(accepted(content_of(path)))
    why = ("why", path.parent.name[:8])
    assert not look(path, found[::FEW], [*READERS, why])


@pytest.mark.slow
@pytest.mark.verify
def test_all_damages_of_a_record(done: Path) -> None:
    path = records()[0]
    why = ("why", path.parent.name[:8])
    assert not look(path, list(accepted(content_of(path))), [*READERS, why])


@pytest.mark.parametrize("name", ["study", "numerical", "index", "runs/run-1", "fits/*"])
def test_some_damages_of_other_files(done: Path, name: str) -> None:
    path = sorted(SMALL.glob(f"{name}.json"))[0]
    found = list(damages(content_of(path)))
    verbs = READERS[:2] if name in ("study", "index") else ()
    assert not look(path, found[1 :: len(found) // 3], verbs)
    records()[0].unlink()  # a case that is missing has its fit read
    assert not look(path, found[2 :: len(found) // 2], [RUN])


@pytest.mark.slow
@pytest.mark.verify
@pytest.mark.parametrize("name", ["study", "numerical", "index", "runs/run-1", "fits/*"])
def test_all_damages_of_other_files(done: Path, name: str) -> None:
    path = sorted(SMALL.glob(f"{name}.json"))[0]
    for record in records():
        record.unlink()
    assert not look(path, list(damages(content_of(path))), [*READERS, RUN])


ROWS = (None, 1, [1], [{}], {"a": 1}, [[]], ["x"])


@pytest.mark.parametrize("name", ["numerical", "spaces", "validation", "adaptive", "confirmed"])
def test_rows_that_are_none_are_set_aside_and_named(done: Path, name: str) -> None:
    for content in ROWS:
        (SMALL / f"{name}.json").write_text(seal(content))
        (said,) = [one for one in api.load(SMALL).warnings if f"{name}.json: " in one]
        assert said.endswith("it is not used, and the next run replaces it"), content
    assert study("report", "small", "--format", "csv").code == 0


@pytest.mark.parametrize("content", [{"a": 1}, [1], {}, "x"])
def test_an_unfinished_manifest_that_is_none_is_as_none(done: Path, content: object) -> None:
    (SMALL / "unfinished.json").write_text(seal(content))
    for verb in (*READERS, ("why", records()[0].parent.name)):
        assert not fault(verb)
    assert study("status", "small", "--json").json["unfinished"] is None


def mended(path: Path, answer: Answer) -> None:
    """Check that a damaged file was named, kept beside, and written once more."""
    assert answer.code == 0, answer.err
    assert re.search(rf"{path.name}: .*renamed to {path.name}\.corrupt-1", answer.err)
    assert path.with_name(f"{path.name}.corrupt-1").is_file()
    assert path.is_file()


@pytest.mark.parametrize("key", ["key", "correlation", "n"])
def test_a_record_of_a_wrong_fit_is_named_kept_and_computed_again(done: Path, key: str) -> None:
    path = records()[0]
    before, content = path.read_bytes(), json.loads(path.read_bytes())["content"]
    content["fit"]["A"][key] = -1
    path.write_text(seal(content))
    assert study("status", "small", "--json").json["cases"]["missing"] == 1
    mended(path, study(*RUN))
    again, first = (json.loads(data)["content"] for data in (path.read_bytes(), before))
    assert again["fit"]["A"]["values"] == first["fit"]["A"]["values"]


def test_a_fit_of_wrong_content_is_named_kept_and_computed_again(done: Path) -> None:
    content = json.loads(records()[0].read_bytes())["content"]
    path = SMALL / "fits" / f"{content['fit']['A']['key']}.json"
    records()[0].unlink()
    path.write_text(seal({}))
    mended(path, study(*RUN))


def test_a_manifest_of_wrong_content_is_named_kept_and_written_again(done: Path) -> None:
    path = SMALL / "study.json"
    content = json.loads(path.read_bytes())["content"]
    del content["blocks"]
    path.write_text(seal(content))
    for words in (("status", "small"), ("report", "small"), ("analyze", "results/small")):
        answer = study(*words)
        assert answer.code == 2
        assert "its manifest is damaged; run the design again" in answer.err
    mended(path, study(*RUN))


def test_a_pipe_in_the_place_of_the_lock_is_refused(done: Path) -> None:
    (SMALL / ".lock").unlink()
    os.mkfifo(SMALL / ".lock")
    assert study("status", "small").code == 0
    answer = study(*RUN)
    assert answer.code == 2
    assert ".lock: cannot be written (it is no file; remove it)" in answer.err


@pytest.mark.parametrize(
    ("place", "mode"),
    [
        ("reports/small", 0o444),
        ("reports/small/small-data", 0o000),
        ("reports", 0o000),
        ("results/small/fits", 0o444),
        ("results/small/cases", 0o444),
    ],
)
def test_what_may_not_be_read_is_told(done: Path, place: str, mode: int) -> None:
    """Rights are obeyed by root, too, for as long as it asks."""
    verbs = [READERS[0], RUN]
    if place not in ("reports", "results/small/fits"):
        # a page draws its figures whenever it is made or verified
        assert study("report", "small", "--format", "csv,html").code == 0
        report = "reports/small/small.html" if place == "reports/small" else "small"
        verbs = [("verify", report), *verbs]
    os.chmod(place, mode)
    obey(True)
    try:
        wrong = [said for verb in verbs if (said := fault(verb))]
    finally:
        obey(False)
        os.chmod(place, 0o755)
    assert not wrong
