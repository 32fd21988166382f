"""A study whose test goes as far as its rows: no displacement, no range, finite elements."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from study.api.opened_study import load as open_study
from tests.cli.small import study, success

DESIGN = """schema = 1
[study]
question = "Do bonded plates matter?"
assumed = ["test.interface"]
[specimen]
shape = "cylinder"
radius = "10 mm"
height = "10 mm"
[test]
kind = "compression"
steps = 3
[material]
model = "neo-hookean"
poisson_ratio = 0.49
[model]
mesh_size = "5 mm"
[measurements]
file = "m.csv"
columns = { displacement = "d", force = "f" }
units = { displacement = "mm", force = "N" }
block = "specimen"
points = "raw"
[factors]
"test.interface" = ["frictionless", "bonded"]
[[response]]
name = "mu0"
practical = "1 kPa"
"""
#: moduli of the three specimens, MPa
MODULI = {"a": 0.010, "b": 0.011, "c": 0.0095}


@pytest.mark.usefixtures("inside")
def test_the_rows_say_how_far_the_test_goes() -> None:
    """The modulus comes back between frictionless plates, and is less if they are bonded."""
    Path("raw.toml").write_text(DESIGN)
    rows = ["specimen,d,f"]
    for name, modulus in MODULI.items():
        d = np.linspace(0.1, 2.0, 12)
        stretch = 1 - d / 10.0
        # nearly incompressible: 2 C10 A (1 / l^2 - l) to the order of 1 - 2 nu
        force = modulus * np.pi * 100 * (stretch**-2 - stretch)
        rows += [f"{name},{x:.6f},{f:.9f}" for x, f in zip(d, force, strict=True)]
    Path("m.csv").write_text("\n".join(rows) + "\n")
    assert study("plan", "raw.toml", "--data", ".").code == 0
    answer = success("run", "raw.toml", "--data", ".", "--jobs", "1", "--json")
    assert answer.json["cases"] == {"total": 6, "done": 6, "failed": 0, "missing": 0}
    found = {
        (one.levels["test.interface"], one.block): one.responses["mu0"]["value"]
        for one in open_study("results/raw", Path("results")).records
    }
    for name, modulus in MODULI.items():
        assert found["frictionless", name] == pytest.approx(1e3 * modulus, rel=0.02)
        assert found["bonded", name] < 0.95 * found["frictionless", name]
    verdict = next(row for row in answer.json["verdicts"] if row["factor"] == "test.interface")
    assert verdict["u_num"] > 0  # finer meshes were solved, which ended in an error
    assert study("verify", "raw").code == 0
