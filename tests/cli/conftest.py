"""Folders with the small study: untouched, finished, and a copy to change."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.cli import test_numeric_factors
from tests.cli.small import Edit, Finished, success, write_files


@pytest.fixture
def inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Empty working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def home(inside: Path) -> Path:
    """Working folder with the files, and nothing computed."""
    write_files(inside)
    return inside


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    """One run for all tests that only read."""
    folder = tmp_path_factory.mktemp("finished")
    write_files(folder)
    answer = success("run", "small.toml", "--data", "data", "--jobs", 1, "--json", folder=folder)
    return Finished(folder, answer)


@pytest.fixture(scope="session")
def ranges(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    """One run of a study over ranges, for all tests that only read, or copy it."""
    folder = tmp_path_factory.mktemp("ranges")
    text = test_numeric_factors.DESIGN.replace('["csv"]', '["html"]')
    (folder / "ranges.toml").write_text(text + test_numeric_factors.UNCERTAIN)
    return Finished(folder, success("run", "ranges.toml", "--jobs", 1, "--json", folder=folder))


@pytest.fixture
def done(finished: Finished, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Copy of the finished study, for tests that change something."""
    folder = tmp_path / "copy"
    shutil.copytree(finished.folder, folder)
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def edit(home: Path) -> Edit:
    """Replace a piece of the design."""

    def change(old: str, new: str) -> None:
        text = (home / "small.toml").read_text()
        assert old in text
        (home / "small.toml").write_text(text.replace(old, new, 1))

    return change
