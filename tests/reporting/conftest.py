"""One report for all tests of the room: building it takes seconds."""

from __future__ import annotations

import pytest

from study.reporting.output.page import Contents, prepare, render
from study.reporting.results.study_result import ReportData
from tests.reporting.example import example


@pytest.fixture(scope="session")
def data() -> ReportData:
    return example()


@pytest.fixture(scope="session")
def contents(data: ReportData) -> Contents:
    return prepare(data)


@pytest.fixture(scope="session")
def html(contents: Contents) -> str:
    return render(contents)
