"""Gravity as a level of a factor, through `study solve` and `study run`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.cli.small import study

PROBLEM = """
schema = 1
[specimen]
shape = "cylinder"
radius = "10 mm"
height = "40 mm"
[test]
kind = "compression"
interface = "bonded"
displacement = "4 mm"
steps = 4
gravity = { density = "0.98 g/cm^3", direction = "down" }
[material]
model = "neo-hookean"
C10 = "2.5 kPa"
poisson_ratio = 0.499
[model]
mesh_size = "6 mm"
"""
FACTOR = """
[study]
name = "gravity"
[factors]
"test.gravity.direction" = ["none", "down", "up"]
[converge]
levels = 2
[[response]]
name = "peak_force"
practical = "0.01 N"
[report]
format = ["csv"]
"""
WEIGHT = 980e-9 * 9.80665 * np.pi * 10**2 * 40


def test_the_base_carries_the_weight(tmp_path: Path) -> None:
    (tmp_path / "p.toml").write_text(PROBLEM, encoding="utf-8")
    found = study("solve", tmp_path / "p.toml", "--json")
    assert found.code == 0, found.err
    force, base = (np.array(found.json[key]) for key in ("force_N", "base_reaction_N"))
    np.testing.assert_allclose(base - force, WEIGHT, rtol=1e-8)


@pytest.mark.parametrize("size", [6.0, 7.5, 10.0, 20.0])
def test_hexahedra_however_large_have_the_weight_of_the_cylinder(
    tmp_path: Path, size: float
) -> None:
    # one or two elements in the radius of 10 mm: the cross-section keeps its area, and none folds
    (tmp_path / "p.toml").write_text(
        PROBLEM + 'space = "3d"\nelement_shape = "hexahedron"\n', encoding="utf-8"
    )
    found = study("solve", tmp_path / "p.toml", "--json", "-s", f"model.mesh_size={size} mm")
    assert found.code == 0, found.err
    force, base = (np.array(found.json[key]) for key in ("force_N", "base_reaction_N"))
    np.testing.assert_allclose(base - force, WEIGHT, rtol=1e-7)


def test_gravity_is_a_factor(tmp_path: Path) -> None:
    (tmp_path / "d.toml").write_text(PROBLEM + FACTOR, encoding="utf-8")
    found = study("run", tmp_path / "d.toml", "--jobs", 1, "--results", tmp_path / "results",
                  "--reports", tmp_path / "reports")  # fmt: skip
    assert found.code == 0, found.err
    rows = next((tmp_path / "reports").rglob("cases.csv")).read_text().splitlines()
    names = rows[0].split(",")
    peak = {
        row.split(",")[names.index("test.gravity.direction")]:
            float(row.split(",")[names.index("peak_force")])
        for row in rows[1:]
    }  # fmt: skip
    # between like plates the plate above carries about half of the weight, one way or the other
    assert peak["up"] - peak["down"] == pytest.approx(WEIGHT, rel=0.1)
    assert (peak["up"] + peak["down"]) / 2 == pytest.approx(peak["none"], rel=0.01)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("test.gravity.density=980 g", "density"),
        ("test.gravity.direction=sideways", "down"),
        ("test.gravity.density=0 kg/m^3", "above 0"),
    ],
)
def test_faulty_weights_are_refused(tmp_path: Path, change: str, said: str) -> None:
    (tmp_path / "p.toml").write_text(PROBLEM, encoding="utf-8")
    found = study("solve", tmp_path / "p.toml", "-s", change)
    assert found.code == 2
    assert said in found.err
