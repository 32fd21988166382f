"""One tab of one browser, and one server of the file's studies, for all tests of a file."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from study.api.serving import Folders, StudyServer
from tests.reporting.browser.devtools import Browser, running


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with running(tmp_path_factory.mktemp("profile")) as browser:
        yield browser


@pytest.fixture(scope="module")
def server(home: Path) -> Iterator[StudyServer]:
    made = StudyServer(Folders(home / "results", home / "reports"), 0)
    thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    yield made
    made.shutdown()
    thread.join()
    made.server_close()
