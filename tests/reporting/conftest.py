"""One report for all tests of the room: building it takes seconds."""

from __future__ import annotations

import pytest

from study.reporting.output.page import Contents, pages, prepare, printed
from study.reporting.results.study_result import ReportData
from tests.reporting.example import example


@pytest.fixture(scope="session")
def data() -> ReportData:
    return example()


@pytest.fixture(scope="session")
def contents(data: ReportData) -> Contents:
    return prepare(data)


@pytest.fixture(scope="session")
def both(contents: Contents) -> tuple[str, str]:
    """The first page and the second."""
    return pages(contents)


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
