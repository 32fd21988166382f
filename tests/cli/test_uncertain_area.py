"""Uncertain inputs of measured strips: u_input of E = S - D against the formula of the strip."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.small import study

DESIGN = """schema = 1
[study]
question = "Which modulus?"
[specimen]
shape = "homogeneous"
area = "100 mm^2"
length = "20 mm"
[test]
kind = "tension"
[material]
incompressible = true
[measurements]
file = "m.csv"
columns = { displacement = "d", force = "f" }
units = { displacement = "mm", force = "N" }
block = "specimen"
range = ["1 %", "10 %"]
points = 10
[presets.energy.soft]
material = { model = "neo-hookean", C10 = "9.5 kPa" }
[presets.energy.stiff]
material = { model = "neo-hookean", C10 = "10.5 kPa" }
[factors]
energy = ["soft", "stiff"]
[uncertainty]
"specimen.area" = "2 mm^2"
"specimen.length" = "0.1 mm"
[[response]]
name = "work_error"
practical = "1 pp"
[report]
format = ["csv"]
"""


def strip(d: np.ndarray, length: float = 20.0) -> np.ndarray:
    """Force over C10, mm^2, of 100 mm^2."""
    stretch = 1 + d / length
    return 2 * 100 * (stretch - stretch**-2)


def test_area_and_length_of_a_strip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("u.toml").write_text(DESIGN)
    rows = [
        f"{name},{d:.4f},{scale * 0.01 * force:.6f}"
        for name, scale in (("a", 1.0), ("b", 1.02), ("c", 0.97))
        for d in np.linspace(0.1, 2.0, 21)
        for force in strip(np.array([d]))
    ]
    Path("m.csv").write_text("\n".join(["specimen,d,f", *rows, ""]))
    answer = study("run", "u.toml", "--data", ".", "--jobs", "1", "--json")
    assert answer.code == 0, answer.err
    found = json.loads(Path("results/u/validation.json").read_text())["content"]
    assert len(found) == 6
    for row in found:
        d, simulated = np.array(row["displacement_mm"]), np.array(row["simulated_N"])
        by_area = 0.02 * simulated
        modulus = {"soft": 0.0095, "stiff": 0.0105}[row["levels"]["energy"]]
        by_length = modulus * (strip(d, 20.1) - strip(d))
        expected = np.hypot(by_area, by_length)
        # known at some places of the curve, and carried to the others as a share of the force
        assert np.array(row["u_input_N"]) == pytest.approx(expected, rel=0.02)
