"""No violation that axe-core knows, in reports and in the page that watches studies.

axe-core is a package of npm, not of Python: it is used where `npm install --global axe-core` put
it, or where AXE_CORE names its `axe.min.js`.
"""

import json
import os
import shutil
import subprocess
from functools import cache
from pathlib import Path

import pandas as pd
import pytest

from study import api
from study.record.store import Store
from study.reporting.output import write
from study.reporting.output.analysis_page import AnalysisSource as Source
from study.reporting.output.analysis_page import surface_data
from tests.cli.small import PROBLEM
from tests.cli.test_labels_and_numbers import table as mixed_table
from tests.cli.test_require import PLATES
from tests.reporting.browser.devtools import IN_A_BROWSER, OVERFLOW
from tests.tracker_accuracy.test_tracking import distance_study


@cache
def axe():
    """Return the file of axe-core on this machine."""
    named = os.environ.get("AXE_CORE", "")
    npm = shutil.which("npm")
    if not named and npm:
        asked = subprocess.run([npm, "root", "-g"], capture_output=True, text=True, check=False)
        named = f"{asked.stdout.strip()}/axe-core/axe.min.js"
    return Path(named) if named and Path(named).is_file() else None


pytestmark = [
    *IN_A_BROWSER,
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


def violations(tab):
    """What axe-core finds in the page, run beside its policy as a developer's tools are."""
    path = axe()
    assert path is not None
    tab.ask(path.read_text(encoding="utf-8") + ";0")
    tab.ask("document.querySelectorAll('details').forEach((one) => { one.open = true; });0")
    return tab.ask(RUN)


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """Folder in which the demo ran."""
    folder = tmp_path_factory.mktemp("demo")
    made = api.demo(results=folder / "results", reports=folder / "reports")
    assert made.report is not None
    return folder


@pytest.fixture(scope="module")
def pages(home, both, tmp_path_factory):
    """Every kind of page: studies, a table, a series, surfaces and instruments."""
    folder = tmp_path_factory.mktemp("pages")
    for name, text in zip(("report", "report-details"), both, strict=True):
        (folder / f"{name}.html").write_text(text, "utf-8")
    rows = [(b, m, 1 + 0.1 * b + (m == "stiff") + 0.01 * k) for b in (1, 2, 3)
            for k, m in enumerate(("soft", "stiff"))]  # fmt: skip
    table = pd.DataFrame(rows, columns=["specimen", "material", "force"])
    found = api.analyze(table, "force", ["material"], block="specimen", practical=0.5)
    found.report(folder / "table")
    (folder / "problem.toml").write_text(PROBLEM)
    (folder / "plates.toml").write_text(PLATES)
    api.converge(folder / "problem.toml", results=folder, reports=folder / "series")
    runs, _ = mixed_table(folder)
    surfaces = api.fit_surfaces(runs, "force", ["tip", "depth"], ["material"], practical=1.0)
    write.write(surface_data(surfaces, Source(runs, {})), folder / "surface", ["html"])
    api.tracking(distance_study(folder, 1), reports=folder / "tracker")
    api.export(folder / "problem.toml", out=folder / "law")
    api.require(folder / "plates.toml", jobs=1, out=folder / "sensors")
    made = [*home.glob("reports/*/*.html"), *sorted(folder.rglob("*.html"))]
    assert len(made) == 12
    return made


@pytest.mark.parametrize(("width", "scheme"), VIEWS)
def test_every_kind_of_page(tab, pages, width, scheme):
    for page in pages:
        tab.open(page, width, scheme)
        assert violations(tab) == [], page
        assert tab.ask(OVERFLOW) <= 0, page


@pytest.mark.parametrize(("width", "scheme"), VIEWS)
def test_the_page_that_watches(tab, home, server, width, scheme):
    tab.open(server.address, width, scheme)
    assert violations(tab) == []
    (results,) = (home / "results").iterdir()
    store = Store(results)
    with store.lock():
        store.note({"done": 5, "total": 24, "counted": "2/12 cases, 3/12 calibrations"})
        tab.open(server.address, width, scheme)
        assert violations(tab) == []


def test_violations_are_found(tab, tmp_path):
    page = tmp_path / "bad.html"
    page.write_text("<title>x</title><p style='color:#ccc'>pale</p><img src='data:,'>")
    tab.open(page, 1400, "light")
    found = {one[0] for one in json.loads(json.dumps(violations(tab)))}
    assert {"color-contrast", "image-alt", "html-has-lang"} <= found
