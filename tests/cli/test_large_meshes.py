"""What a plan says of hopeless meshes, and of a specimen that is pressed beside itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from study.harness.runner.cost import _PATIENCE_S
from study.mechanics.mesh.mesher import build_mesh
from study.mechanics.solver import solution_cost
from study.mechanics.solver.solution_cost import expected_unknowns
from tests.cli.small import study
from tests.fem.surfaces import box, write

DESIGN = """
schema = 1
[specimen]
shape = "surface"
file = "box.stl"
unit = "mm"
clamp_below = "1 mm"
{more}
[test]
kind = "compression"
[material]
model = "neo-hookean"
bulk_modulus = "10 MPa"
[model]
mesh_size = "3 mm"
[factors]
"test.interface" = ["frictionless", "bonded"]
[measurements]
file = "tests.csv"
columns = {{ displacement = "d", force = "f" }}
units = {{ displacement = "mm", force = "N" }}
block = "specimen"
range = ["0.1 mm", "0.6 mm"]
points = 5
[[response]]
name = "mu0"
"""
NEEDLE = Path(__file__).parents[2] / "designs" / "needle-geometry.toml"


def design(folder: Path, more: str = "", size: tuple[float, float, float] = (24, 24, 34)) -> Path:
    write(folder / "box.stl", box(*size))
    rows = [f"{s},{d:.3f},{0.45 * d:.5f}" for s in "ab" for d in np.linspace(0, 0.7, 15)]
    (folder / "tests.csv").write_text("\n".join(["specimen,d,f", *rows, ""]))
    path = folder / "design.toml"
    path.write_text(DESIGN.format(more=more))
    return path


@pytest.mark.parametrize("verb", ["plan", "run"])
def test_a_place_beside_the_specimen_is_refused(tmp_path: Path, verb: str) -> None:
    """Gmsh ended with the process: the body lay 1e9 mm beside the axis."""
    path = design(tmp_path, 'press_x = "1e9 mm"\npress_y = "-12.5 mm"')
    answer = study(verb, path, "--data", tmp_path)
    assert answer.code == 2
    for k, place in (("x", "1e+09"), ("y", "-12.5")):
        said = f"specimen.press_{k}: {place} mm is beside the specimen, which reaches from -12 to"
        assert f"{said} 12 mm" in answer.err
    assert "choose press_x and press_y inside its outline" in answer.err


def test_a_place_inside_is_planned(tmp_path: Path) -> None:
    path = design(tmp_path, 'press_x = "11 mm"')
    assert study("plan", path, "--data", tmp_path).code == 0


def test_a_plan_of_a_surface_makes_no_mesh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(_: object) -> None:
        raise AssertionError("a mesh was made")

    monkeypatch.setattr(solution_cost, "build_mesh", never)
    answer = study("plan", design(tmp_path), "--data", tmp_path)
    assert answer.code == 0
    assert "predicted: " in answer.out


def test_a_plate_of_twenty_million_elements_is_refused(tmp_path: Path) -> None:
    path = design(tmp_path, size=(5000, 5000, 1.0))
    answer = study("plan", path, "--data", tmp_path, "-s", "model.mesh_size=1 mm")
    assert answer.code == 2
    assert "model.mesh_size: 1 mm gives about" in answer.err
    assert 'mm" or more' in answer.err


def test_a_plan_of_many_meshes_counts_but_a_few(monkeypatch: pytest.MonkeyPatch) -> None:
    """120 needles with 0.05 mm took more than 10 s to be meshed: 40,000 unknowns each."""
    meshed = []
    monkeypatch.setattr(
        solution_cost, "build_mesh", lambda one: meshed.append(one) or build_mesh(one)
    )
    solution_cost._count.cache_clear()
    answer = study("plan", NEEDLE, "-s", "model.mesh_size=0.05 mm")
    assert answer.code == 0
    assert "predicted: " in answer.out
    # 4 us for each unknown, in the costs of the cells and in those of their refinement
    assert 0 < sum(map(expected_unknowns, meshed)) < 4 * _PATIENCE_S / 4e-6
    assert max(map(expected_unknowns, meshed)) < 0.5 / 4e-6
