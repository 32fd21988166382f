"""Scores on specimens that the fit never saw, through `study run`: the answer is known by hand.

The force of an incompressible neo-Hookean cylinder between frictionless plates is proportional
to its one constant. Specimens whose forces are s_k times one curve have constants s_k C; the fit
to all others has the mean of their s, so that the relative error on specimen k is
|mean(s, all but k) / s_k - 1|.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.small import incompressible_force, success
from tests.pages import both_pages

SCALES = {"A": 1.0, "B": 1.2, "C": 0.9, "D": 1.1, "E": 0.95}
C10_KPA = 5.0

DESIGN = """
schema = 1
[study]
name = "cross"
question = "Does the method predict another specimen?"
[specimen]
shape = "cylinder"
radius = "25 mm"
height = "30 mm"
[test]
kind = "compression"
interface = "frictionless"
[material]
incompressible = true
[presets.material.neo-hookean]
model = "neo-hookean"
[presets.material.mooney-rivlin]
model = "mooney-rivlin"
[measurements]
file = "tests.csv"
columns = { displacement = "d_mm", force = "f_N" }
units = { displacement = "mm", force = "N" }
block = "gel"
points = "raw"
[calibration]
method = "analytic"
LEAVE_OUT
[factors]
material = ["neo-hookean", "mooney-rivlin"]
[[response]]
name = "relative_rms_force_error"
practical = "2 pp"
[[response]]
name = "mu0"
"""


def written(folder: Path, leave_out: str = "") -> Path:
    d = np.linspace(0.0, 6.0, 61)
    force = incompressible_force(C10_KPA, 0.0, d)
    rows = ["gel,d_mm,f_N"]
    rows += [f"{k},{x:.6f},{s * f:.12f}" for k, s in SCALES.items() for x, f in zip(d, force)]  # noqa: B905
    (folder / "measurements").mkdir()
    (folder / "measurements" / "tests.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    path = folder / "cross.toml"
    path.write_text(DESIGN.replace("LEAVE_OUT", leave_out), encoding="utf-8")
    return path


def run(
    folder: Path, leave_out: str = "", kind: str = "html"
) -> tuple[dict[tuple[str, str], Any], dict[str, Any]]:
    """Responses by energy and specimen, and what the run says of the study."""
    path = written(folder, leave_out)
    found = success(
        "run", path, "--data", folder / "measurements", "--results", folder / "results",
        "--reports", folder / "reports", "--jobs", 1, "--json", "-s", f'report.format=["{kind}"]',
    )  # fmt: skip
    records = (
        json.loads(one.read_text())["content"] for one in (folder / "results").rglob("record.json")
    )
    return {(r["levels"]["material"], r["block"]): r["responses"] for r in records}, found.json


def test_a_score_is_that_of_the_other_specimens_and_a_constant_its_own(tmp_path: Path) -> None:
    records, said = run(tmp_path)
    assert len(records) == 2 * len(SCALES)
    for (_, gel), responses in records.items():
        others = float(np.mean([s for name, s in SCALES.items() if name != gel]))
        expected = 100 * abs(others / SCALES[gel] - 1)
        assert responses["relative_rms_force_error"]["value"] == pytest.approx(expected, rel=1e-6)
        assert responses["mu0"]["value"] == pytest.approx(2 * C10_KPA * SCALES[gel], rel=1e-6)
    scored = {one["response"]: one["scored_on"] for one in said["verdicts"]}
    assert scored["relative_rms_force_error"] == "other specimen"
    page = both_pages(min((tmp_path / "reports").rglob("*.html"), key=lambda path: len(path.name)))
    assert "predicted by constants fitted to the other specimens" in page


def test_nothing_left_out_scores_the_curve_fitted(tmp_path: Path) -> None:
    records, said = run(tmp_path, 'leave_out = "nothing"', "csv")
    for responses in records.values():
        assert responses["relative_rms_force_error"]["value"] == pytest.approx(0.0, abs=1e-6)
    scored = {one["response"]: one["scored_on"] for one in said["verdicts"]}
    assert scored["relative_rms_force_error"] == "the curve fitted"
