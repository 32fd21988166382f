"""Folders with the small study: untouched, finished, and a copy to change."""

import shutil

import pytest

from tests.cli import test_numeric_factors
from tests.cli.small import Finished, success, write_files


@pytest.fixture
def inside(tmp_path, monkeypatch):
    """Empty working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def home(inside):
    """Working folder with the files, and nothing computed."""
    write_files(inside)
    return inside


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    """One run for all tests that only read."""
    folder = tmp_path_factory.mktemp("finished")
    write_files(folder)
    answer = success("run", "small.toml", "--data", "data", "--jobs", 1, "--json", folder=folder)
    return Finished(folder, answer)


@pytest.fixture(scope="session")
def ranges(tmp_path_factory):
    """One run of a study over ranges, for all tests that only read, or copy it."""
    folder = tmp_path_factory.mktemp("ranges")
    text = test_numeric_factors.DESIGN.replace('["csv"]', '["html"]')
    (folder / "ranges.toml").write_text(text + test_numeric_factors.UNCERTAIN)
    return Finished(folder, success("run", "ranges.toml", "--jobs", 1, "--json", folder=folder))


@pytest.fixture
def done(finished, tmp_path, monkeypatch):
    """Copy of the finished study, for tests that change something."""
    folder = tmp_path / "copy"
    shutil.copytree(finished.folder, folder)
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def edit(home):
    """Replace a piece of the design."""

    def change(old, new):
        text = (home / "small.toml").read_text()
        assert old in text
        (home / "small.toml").write_text(text.replace(old, new, 1))

    return change
