"""The page of `study serve` in a real browser: quiet, alive, and deaf to hostile names."""

import contextlib
import json
import time

import pytest

from study import api
from study.record.store import Store
from tests.cli.small import DESIGN, write_files
from tests.reporting.browser.devtools import IN_A_BROWSER, OVERFLOW
from tests.waiting import CAP_S

pytestmark = IN_A_BROWSER
HOSTILE = "<script>document.title='run'</script><img src=x onerror=document.title='run'>"


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    folder = tmp_path_factory.mktemp("served")
    write_files(folder)
    hostile = DESIGN.replace('"small"', '"hostile"', 1).replace("Does the energy", HOSTILE)
    (folder / "hostile.toml").write_text(hostile)
    with contextlib.chdir(folder):
        for name in ("small", "hostile"):
            api.run(f"{name}.toml", data="data", jobs=1, formats=("html",))
    return folder


def until(tab, expression):
    """Wait until an expression is true in the page."""
    end = time.monotonic() + CAP_S
    while not tab.ask(expression):
        assert time.monotonic() < end, f"{expression} did not become true"
        time.sleep(0.1)


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1400, 390])
def test_the_page_is_quiet_and_within_the_screen(tab, server, width, scheme):
    tab.open(server.address, width, scheme)
    assert tab.complaints() == []
    assert [url for url in tab.requests() if not url.startswith(server.address)] == []
    assert tab.ask(OVERFLOW) <= 0
    assert tab.ask("document.title") == "Studies"
    assert tab.ask(f"document.body.textContent.includes({json.dumps(HOSTILE)})")
    # its own style is allowed, so a bar has the width that it gives
    assert tab.ask("getComputedStyle(document.querySelector('.kicker')).textTransform") == (
        "uppercase"
    )


def test_a_report_opens_from_the_page(tab, server):
    tab.open(server.address, 1400, "light")
    tab.ask("document.querySelector('a[href=\"/reports/small/small.html\"]').click();0")
    until(tab, "location.pathname === '/reports/small/small.html'")
    until(tab, "document.readyState === 'complete'")
    assert tab.ask("document.querySelector('h1').textContent") == "small"
    tab.ask("document.querySelector('a[href$=\"small-details.html\"]').click();0")
    until(tab, "location.pathname === '/reports/small/small-details.html'")
    until(tab, "document.readyState === 'complete'")
    # its own script runs under the policy of the server: heads of tables became buttons
    assert tab.ask("document.querySelectorAll('thead button').length") > 0
    assert tab.complaints() == []


def test_progress_moves_without_loading_anew(tab, server, home):
    store = Store(home / "results" / "small")
    with store.lock():
        store.note({"done": 5, "total": 24, "counted": "2/12 cases, 3/12 calibrations"})
        tab.open(server.address, 1400, "light")
        assert tab.ask("document.querySelector('progress').value") == 5
        tab.ask("window.marked = true;0")
        store.note({"done": 20, "total": 24, "counted": "8/12 cases, 12/12 calibrations"})
        until(tab, "document.querySelector('progress')?.value === 20")
        assert "8/12 cases" in str(tab.ask("document.querySelector('.run .note').textContent"))
        assert tab.ask("window.marked") is True
    # the study ends: the page is loaded anew and has no bar
    until(tab, "document.readyState === 'complete' && !document.querySelector('progress')")
    assert tab.ask("window.marked") is None
    assert tab.complaints() == []
