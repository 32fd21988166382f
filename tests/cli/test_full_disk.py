"""A disk that fills up: the exit code of the README, whole files, and nothing half written."""

from __future__ import annotations

import errno
from collections.abc import Callable
from pathlib import Path

import pytest

from study.ground.errors import DiskFullError
from study.harness.record.atomic_files import FileSystem, replaced, write_new
from tests.cli.small import study

RUN = ("run", "small.toml", "--data", "data", "--jobs", "1")
Fill = Callable[[Callable[[Path, int], bool]], None]


@pytest.fixture
def fill(monkeypatch: pytest.MonkeyPatch) -> Fill:
    """Let writes fail in the middle that a condition of path and number picks."""
    whole, written = FileSystem.write, [0]

    def fill_up(is_full: Callable[[Path, int], bool]) -> None:
        def write(system: FileSystem, path: Path, data: bytes) -> None:
            written[0] += 1
            if not is_full(path, written[0]):
                return whole(system, path, data)
            path.write_bytes(data[: len(data) // 2])
            raise OSError(errno.ENOSPC, "No space left on device")

        monkeypatch.setattr(FileSystem, "write", write)

    return fill_up


def halves(folder: Path) -> list[Path]:
    """Files that an unfinished write would leave."""
    return sorted(folder.rglob("*.part"))


def test_a_run_on_a_full_disk_is_stopped_and_resumes(home: Path, fill: Fill) -> None:
    records: list[Path] = []

    def after_three_records(path: Path, number: int) -> bool:
        records.extend([path] * ("record.json" in path.name))
        return len(records) > 3

    fill(after_three_records)
    answer = study(*RUN)
    assert answer.code == 130
    assert "No space left on device" in answer.err
    assert f"To resume:\n  study {' '.join(RUN)}\n" in answer.err
    assert "Traceback" not in answer.err
    assert not halves(home)
    kept = len(list((home / "results/small/cases").glob("*/record.json")))
    assert kept == 3
    fill(lambda path, number: False)
    answer = study(*RUN)
    assert answer.code == 0
    assert not halves(home)


def test_a_run_that_may_write_no_longer_is_stopped_and_resumes(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exit 2 says that nothing was written, which is true of the first file alone."""
    whole, records = FileSystem.write, list[Path]()

    def write(system: FileSystem, path: Path, data: bytes) -> None:
        records.extend([path] * ("record.json" in path.name))
        if len(records) > lost:
            raise PermissionError(errno.EACCES, "Permission denied")
        whole(system, path, data)

    lost = 3
    with monkeypatch.context() as patch:
        patch.setattr(FileSystem, "write", write)
        answer = study(*RUN)
    assert answer.code == 130
    assert "Permission denied" in answer.err
    assert f"To resume:\n  study {' '.join(RUN)}\n" in answer.err
    assert not halves(home)
    lost = -1
    with monkeypatch.context() as patch:
        patch.setattr(FileSystem, "write", write)
        answer = study("run", "small.toml", "--data", "data", "--results", "other")
    assert (answer.code, answer.out) == (2, "")
    assert study(*RUN).code == 0


@pytest.mark.parametrize(
    "words",
    [
        ("demo", "--results", "file"),
        ("virtual", "file", "--from", "small.toml"),
        ("virtual", "file"),
    ],
)
def test_a_file_in_the_place_of_a_folder_is_refused(home: Path, words: tuple[str, ...]) -> None:
    (home / "file").write_text("mine")
    answer = study(*words)
    assert answer.code == 2
    assert "could not be written (Not a directory)" in answer.err
    assert (home / "file").read_text() == "mine"


@pytest.mark.parametrize("name", ["numbers.json", "small.html", "made-from.json"])
def test_a_report_on_a_full_disk_leaves_no_part_of_a_file(
    done: Path, fill: Fill, name: str
) -> None:
    fill(lambda path, number: name in path.name)
    written = "html" if name.endswith("html") else "csv"  # a page takes its time to be drawn
    answer = study("report", "small", "--format", written, "--reports", "pages")
    assert answer.code == 1
    assert "could not be written" in answer.err
    assert not halves(done)


def test_a_page_of_a_table_on_a_full_disk_is_no_traceback(home: Path, fill: Fill) -> None:
    rows = "".join(f"{a},{b},{k}\n" for k, (a, b) in enumerate(("xu", "xv", "yu", "yv") * 3))
    (home / "t.csv").write_text("a,b,y\n" + rows)
    fill(lambda path, number: number > 1)
    page = ("--report", "page", "--format", "csv")
    answer = study("analyze", "t.csv", "--response", "y", "--factors", "a,b", *page)
    assert answer.code == 1
    assert "could not be written (No space left on device)" in answer.err
    assert not halves(home)


def half_written(path: Path) -> None:
    with replaced(path) as part:
        part.write_text("half")
        raise OSError(errno.EDQUOT, "Disk quota exceeded")


def test_a_new_file_is_there_whole_or_not_at_all(tmp_path: Path, fill: Fill) -> None:
    fill(lambda path, number: True)
    with pytest.raises(DiskFullError):
        write_new(tmp_path / "new.toml", "schema = 1\n")
    with pytest.raises(DiskFullError):
        half_written(tmp_path / "out.vtu")
    assert not list(tmp_path.iterdir())
