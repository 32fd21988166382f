"""One report for all tests of the room: building it takes seconds."""

from __future__ import annotations

import pytest

from study.reporting.output.page import Pages, printed
from study.reporting.output.study_page import prepare
from study.reporting.results.study_result import ReportData
from tests.reporting.example import example


@pytest.fixture(scope="session")
def data() -> ReportData:
    return example()


@pytest.fixture(scope="session")
def contents(data: ReportData) -> Pages:
    return prepare(data)


@pytest.fixture(scope="session")
def both(contents: Pages) -> tuple[str, str]:
    """The first page and the second."""
    return contents.html()


@pytest.fixture(scope="session")
def first(both: tuple[str, str]) -> str:
    return both[0]


@pytest.fixture(scope="session")
def second(both: tuple[str, str]) -> str:
    return both[1]


@pytest.fixture(scope="session")
def html(both: tuple[str, str]) -> str:
    """Both pages in one document."""
    return printed(*both)
