"""One report for all tests of the room: building it takes seconds."""

import pytest

from study.reporting.output.page import printed
from study.reporting.output.study_page import prepare
from tests.reporting.example import example


@pytest.fixture(scope="session")
def data():
    return example()


@pytest.fixture(scope="session")
def contents(data):
    return prepare(data)


@pytest.fixture(scope="session")
def both(contents):
    """The first page and the second."""
    return contents.html()


@pytest.fixture(scope="session")
def first(both):
    return both[0]


@pytest.fixture(scope="session")
def second(both):
    return both[1]


@pytest.fixture(scope="session")
def html(both):
    """Both pages in one document."""
    return printed(*both)
