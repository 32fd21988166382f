"""A report that would be the same again is not made again; whatever decides it makes it again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from study import api
from study.reporting.output import write
from tests.cli.small import write_files


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a study that was run and reported."""
    write_files(tmp_path)
    monkeypatch.chdir(tmp_path)
    again()
    return tmp_path


def again() -> Path:
    """Run the study; everything is there but the first time."""
    found = api.run("small.toml", data="data", jobs=1)
    assert found.report is not None
    assert not [said for said in found.warnings if "could not be written" in said]
    return Path(found.report)


def state(home: Path) -> dict[str, tuple[int, bytes]]:
    """Inode and bytes of every file of the report; files are replaced whole."""
    files = [path for path in (home / "reports").rglob("*") if path.is_file()]
    return {path.name: (path.stat().st_ino, path.read_bytes()) for path in files}


def content(home: Path) -> dict[str, bytes]:
    """Bytes of the files that a reader opens."""
    return {name: kept for name, (_, kept) in state(home).items() if name != write.NAME}


def test_a_run_with_nothing_to_do_leaves_the_report_as_it_is(home: Path) -> None:
    before = state(home)
    main = again()
    assert main == Path("reports/small/small-data/cases.csv")
    assert state(home) == before
    assert api.report("small").report == main
    assert state(home) == before


def _deleted(home: Path) -> None:
    (home / "reports/small/small-data/numbers.json").unlink()


def _altered(home: Path) -> None:
    path = home / "reports/small/small-data/cases.csv"
    path.write_text(path.read_text().replace("neo-hookean", "neo-Hookean", 1))


def _note_lost(home: Path) -> None:
    (home / "reports/small/small-data" / write.NAME).write_text("[")


@pytest.mark.parametrize("spoil", [_deleted, _altered, _note_lost])
def test_a_report_that_was_touched_is_made_again(home: Path, spoil: Callable[[Path], None]) -> None:
    before = content(home)
    spoil(home)
    again()
    assert content(home) == before


def test_a_changed_record_makes_it_again(home: Path) -> None:
    """One record is lost and solved again: its seconds differ, so the table does."""
    before = state(home)
    case = next((home / "results/small/cases").iterdir())
    (case / "record.json").write_text("{}")
    again()
    after = state(home)
    assert after["cases.csv"][0] != before["cases.csv"][0]


def test_changed_code_and_another_format_make_it_again(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = state(home)
    with monkeypatch.context() as other:
        other.setattr("study.api.study.versions", lambda: {"study": "another"})
        again()
    after = state(home)
    assert after["cases.csv"][0] != before["cases.csv"][0]
    assert content(home).keys() == {name for name in before if name != write.NAME}
    page = api.report("small", formats=["html"]).report
    assert page == Path("reports/small/small.html")
    assert page.is_file()
    written = page.stat().st_ino
    assert api.report("small", formats=["html"]).report == page
    assert page.stat().st_ino == written


def test_every_source_and_every_stored_byte_is_looked_at(home: Path) -> None:
    results = home / "results/small"
    name = write.made_of(results, ["html"], {"study": "1"})
    assert name == write.made_of(results, ["html"], {"study": "1"})
    others = {write.made_of(results, ["csv"], {"study": "1"})}
    others.add(write.made_of(results, ["html"], {"study": "2"}))
    record = next(results.glob("cases/*/record.json"))
    record.write_bytes(record.read_bytes() + b" ")
    others.add(write.made_of(results, ["html"], {"study": "1"}))
    assert len(others | {name}) == 4
