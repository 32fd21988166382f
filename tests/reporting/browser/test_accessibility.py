"""No violation that axe-core knows, in reports and in the page that watches studies.

axe-core is a package of npm, not of Python: it is used where `npm install --global axe-core` put
it, or where AXE_CORE names its `axe.min.js`.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import threading
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pandas as pd
import pytest

from study import api
from study.api.analyzing import AnalysisSource as Source
from study.api.fitting_surfaces import table_data
from study.api.serving import Folders, StudyServer
from study.harness.record.store import Store
from study.reporting.output import write
from tests.cli.small import PROBLEM
from tests.cli.test_labels_and_numbers import table as mixed_table
from tests.cli.test_require import PLATES
from tests.reporting.browser.devtools import Browser, running
from tests.tracker_accuracy.test_tracking import distance_study


@cache
def axe() -> Path | None:
    """Return the file of axe-core on this machine."""
    named = os.environ.get("AXE_CORE", "")
    npm = shutil.which("npm")
    if not named and npm:
        asked = subprocess.run([npm, "root", "-g"], capture_output=True, text=True, check=False)
        named = f"{asked.stdout.strip()}/axe-core/axe.min.js"
    return Path(named) if named and Path(named).is_file() else None


pytestmark = [
    pytest.mark.slow,
    pytest.mark.verify,
    pytest.mark.skipif(
        not any(map(shutil.which, write.BROWSERS)), reason="no Chromium or Chrome is installed"
    ),
    pytest.mark.skipif(
        axe() is None,
        reason="axe-core is not installed: npm install --global axe-core, or AXE_CORE names it",
    ),
]
VIEWS = [(width, scheme) for width in (1400, 390) for scheme in ("light", "dark")]
RUN = """
axe.run(document, {resultTypes: ["violations"]}).then((found) => found.violations.map(
  (one) => [one.id, one.impact, one.help, one.nodes.slice(0, 5).map((node) =>
    [node.target.join(" "), node.any.concat(node.all).map((check) => check.message).join("; ")])]))
"""
OVERFLOW = "document.documentElement.scrollWidth - document.documentElement.clientWidth"


def violations(tab: Browser) -> object:
    """What axe-core finds in the page, run beside its policy as a developer's tools are."""
    path = axe()
    assert path is not None
    tab.ask(path.read_text(encoding="utf-8") + ";0")
    tab.ask("document.querySelectorAll('details').forEach((one) => { one.open = true; });0")
    return tab.ask(RUN)


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with running(tmp_path_factory.mktemp("profile")) as found:
        yield found


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder in which the demo ran."""
    folder = tmp_path_factory.mktemp("demo")
    made = api.demo(results=folder / "results", reports=folder / "reports")
    assert made.report is not None
    return folder


@pytest.fixture(scope="module")
def server(demo: Path) -> Iterator[StudyServer]:
    made = StudyServer(Folders(demo / "results", demo / "reports"), 0)
    thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    yield made
    made.shutdown()
    thread.join()
    made.server_close()


@pytest.mark.parametrize(("width", "scheme"), VIEWS)
def test_the_report_of_the_demo(tab: Browser, demo: Path, width: int, scheme: str) -> None:
    pages = sorted(demo.glob("reports/*/*.html"))
    assert len(pages) == 2
    for page in pages:
        tab.open(page, width, scheme)
        assert violations(tab) == []
        assert tab.ask(OVERFLOW) <= 0


@pytest.mark.parametrize(("width", "scheme"), VIEWS)
def test_a_report_with_every_part(
    tab: Browser, tmp_path: Path, html: str, width: int, scheme: str
) -> None:
    page = tmp_path / "report.html"
    page.write_text(html, "utf-8")
    tab.open(page, width, scheme)
    assert violations(tab) == []


@pytest.mark.parametrize(("width", "scheme"), VIEWS)
def test_the_pages_of_a_table_and_of_a_series(
    tab: Browser, tmp_path: Path, width: int, scheme: str
) -> None:
    rows = [(b, m, 1 + 0.1 * b + (m == "stiff") + 0.01 * k) for b in (1, 2, 3)
            for k, m in enumerate(("soft", "stiff"))]  # fmt: skip
    table = pd.DataFrame(rows, columns=["specimen", "material", "force"])
    found = api.analyze(table, "force", ["material"], block="specimen", practical=0.5)
    (tmp_path / "problem.toml").write_text(PROBLEM)
    api.converge(tmp_path / "problem.toml", results=tmp_path, reports=tmp_path / "series")
    first = found.report(tmp_path / "table")
    series = next(tmp_path.glob("series/**/*.html"))
    for page in (first, first.with_stem(f"{first.stem}-details"), series):
        tab.open(page, width, scheme)
        assert violations(tab) == []


@pytest.mark.parametrize(("width", "scheme"), VIEWS)
def test_the_pages_of_surfaces_and_of_a_tracker(
    tab: Browser, tmp_path: Path, width: int, scheme: str
) -> None:
    runs, _ = mixed_table(tmp_path)
    found = api.fit_surfaces(runs, "force", ["tip", "depth"], ["material"], practical=1.0)
    surface = write.write(table_data(found, Source(runs, {})), tmp_path / "surface", ["html"])
    tracked = api.tracking(distance_study(tmp_path, 1), reports=tmp_path / "tracker").report
    assert tracked is not None
    for page in (surface, Path(tracked)):
        tab.open(page, width, scheme)
        assert violations(tab) == []
        assert tab.ask(OVERFLOW) <= 0


@pytest.fixture(scope="module")
def pages_of_instruments(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Pages of a force law and of what sensors must be."""
    folder = tmp_path_factory.mktemp("instruments")
    (folder / "problem.toml").write_text(PROBLEM)
    (folder / "plates.toml").write_text(PLATES)
    api.export(folder / "problem.toml", out=folder / "law")
    api.require(folder / "plates.toml", jobs=1, out=folder / "sensors")
    found = sorted(folder.rglob("*.html"))
    assert len(found) == 2
    return found


@pytest.mark.parametrize(("width", "scheme"), VIEWS)
def test_the_pages_of_a_force_law_and_of_sensors(
    tab: Browser, pages_of_instruments: list[Path], width: int, scheme: str
) -> None:
    for page in pages_of_instruments:
        tab.open(page, width, scheme)
        assert violations(tab) == []
        assert tab.ask(OVERFLOW) <= 0


@pytest.mark.parametrize(("width", "scheme"), VIEWS)
def test_the_page_that_watches(
    tab: Browser, demo: Path, server: StudyServer, width: int, scheme: str
) -> None:
    tab.open(server.address, width, scheme)
    assert violations(tab) == []
    (results,) = (demo / "results").iterdir()
    store = Store(results)
    with store.lock():
        store.note({"done": 5, "total": 24, "counted": "2/12 cases, 3/12 calibrations"})
        tab.open(server.address, width, scheme)
        assert violations(tab) == []


def test_violations_are_found(tab: Browser, tmp_path: Path) -> None:
    page = tmp_path / "bad.html"
    page.write_text("<title>x</title><p style='color:#ccc'>pale</p><img src='data:,'>")
    tab.open(page, 1400, "light")
    found = {one[0] for one in json.loads(json.dumps(violations(tab)))}
    assert {"color-contrast", "image-alt", "html-has-lang"} <= found
