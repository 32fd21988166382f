"""One tab of one browser, and one server of the file's studies, for all tests of a file."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.reporting.browser.devtools import Browser, running, server

__all__ = ["server"]


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with running(tmp_path_factory.mktemp("profile")) as browser:
        yield browser
