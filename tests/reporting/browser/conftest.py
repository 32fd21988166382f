"""One tab of one browser, and one server of the file's studies, for all tests of a file."""

import pytest

from tests.reporting.browser.devtools import running, server

__all__ = ["server"]


@pytest.fixture(scope="module")
def tab(tmp_path_factory):
    with running(tmp_path_factory.mktemp("profile")) as browser:
        yield browser
