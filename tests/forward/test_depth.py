"""How deep a needle gets: every energy, every element, coarse to fine, in both spaces."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from study.forward.boundary import contact_points
from study.forward.contact import ContactPoints, Plate
from study.forward.elements import discretize
from study.forward.mesh import build_mesh
from study.forward.problem import Block, Cone, Cylinder, Model, Problem, Sphere, Test
from study.forward.solve import Options, solve
from study.material import Material

NEO_HOOKEAN = Material("neo-hookean", {"C10": 5e-3}, bulk_modulus=10.0)
ENERGIES = {
    "neo-hookean": NEO_HOOKEAN,
    "mooney-rivlin": Material("mooney-rivlin", {"C10": 5e-3, "C01": 1e-3}, bulk_modulus=10.0),
    "yeoh-2": Material("reduced-polynomial", {"C10": 5e-3, "C20": 3e-4}, bulk_modulus=10.0),
    "ogden": Material("ogden", {"mu1": 0.012, "alpha1": 2.8}, bulk_modulus=10.0),
}
MESHES = [
    (shape, order, mesh)
    for shape in ("simplex", "tensor")
    for order in ("linear", "quadratic")
    for mesh in ("coarse", "medium", "fine")
]


def deep(material: Material, shape: str, order: str, mesh: str) -> Problem:
    test = Test("indentation", 5.0, "frictionless", "bonded", 10, Cone(30, 1))
    model = Model("axisymmetric", order, shape, mesh=mesh)  # type: ignore[arg-type]
    return Problem(Cylinder(25, 50), test, material, model)


def in_block(material: Material, depth: float, order: str, mesh: str) -> Problem:
    steps = round(depth / 0.4)
    test = Test("indentation", depth, "frictionless", "bonded", steps, Cone(30, 1, 3))
    model = Model("3d", order, mesh=mesh, mesh_ratio=1.3)  # type: ignore[arg-type]
    return Problem(Block(60, 60, 40), test, material, model)


@pytest.mark.parametrize(
    ("shape", "order", "mesh"),
    [
        ("simplex", "quadratic", "coarse"),
        ("tensor", "linear", "fine"),
        ("tensor", "linear", "medium"),
    ],
)
def test_the_softest_energy_reaches_five_millimetres(shape: str, order: str, mesh: str) -> None:
    solution = solve(deep(NEO_HOOKEAN, shape, order, mesh), gradients=False)
    assert solution.converged, solution.message
    assert "snapped" not in solution.message


@pytest.mark.slow
@pytest.mark.verify
@pytest.mark.parametrize("energy", ENERGIES)
@pytest.mark.parametrize(("shape", "order", "mesh"), MESHES)
def test_every_energy_reaches_five_millimetres(
    energy: str, shape: str, order: str, mesh: str
) -> None:
    solution = solve(deep(ENERGIES[energy], shape, order, mesh), gradients=False)
    assert solution.converged, solution.message


def test_a_solid_needs_no_snap_under_the_needle() -> None:
    options = Options(snaps=False)
    problem = in_block(ENERGIES["ogden"], 1.6, "quadratic", "coarse")
    solution = solve(problem, gradients=False, options=options)
    assert solution.converged, solution.message


@pytest.mark.slow
@pytest.mark.verify
@pytest.mark.parametrize("energy", ENERGIES)
@pytest.mark.parametrize("order", ["linear", "quadratic"])
@pytest.mark.parametrize("mesh", ["coarse", "medium"])
def test_every_energy_reaches_four_millimetres_in_a_block(
    energy: str, order: str, mesh: str
) -> None:
    solution = solve(in_block(ENERGIES[energy], 4.0, order, mesh), gradients=False)
    assert solution.converged, solution.message


def points_of_three(middles: sp.csr_matrix) -> ContactPoints:
    nodes, ones = np.arange(3)[:, None], np.ones((3, 1))
    return ContactPoints(Plate(1.0, -1, 1.0), nodes, ones, np.ones(3), 1e3, 1.0, middles=middles)


@pytest.mark.parametrize(
    ("own", "closed", "led"),
    [
        ([False, True, True], True, True),  # pulled, amid closed mid-sides: held
        ([True, False, False], False, True),  # pressed, amid open ones: free
        ([False, True, False], False, False),  # at the edge it decides for itself
        ([True, True, False], True, False),
    ],
)
def test_a_corner_goes_with_its_mid_sides(own: list[bool], closed: bool, led: bool) -> None:
    rows = sp.csr_matrix(([True, True], ([0, 0], [1, 2])), (3, 3))
    multipliers = np.where(own, 1.0, -1.0)
    touch = points_of_three(rows).evaluate(
        np.array([[0.0, 0.0, 1.0]] * 3), np.zeros((3, 3)), 0.0, multipliers
    )
    assert touch.wanted.tolist() == [closed, *own[1:]]
    assert touch.led.tolist() == [led, False, False]
    kept = points_of_three(rows).admissible(multipliers)
    assert kept[0] == multipliers[0]
    assert (kept[1:] >= 0).all()


def test_every_corner_has_the_mid_sides_of_its_edges() -> None:
    test = Test("indentation", 0.5, "frictionless", "bonded", 2, Sphere(3.0))
    problem = Problem(Block(20, 20, 10), test, NEO_HOOKEAN, Model("3d", mesh="coarse"))
    mesh = build_mesh(problem)
    space = discretize(mesh, problem.model)
    (points,) = contact_points(problem, space, mesh)
    assert points.middles is not None
    places = space.nodes[points.nodes[:, 0]]
    around = np.diff(points.middles.indptr)
    assert set(around[around > 0]) <= set(range(2, 12))
    corner = int(np.flatnonzero(around)[0])
    for middle in points.middles[corner].indices:
        other = 2 * places[middle] - places[corner]  # the far end of that edge is a corner too
        far = int(np.linalg.norm(places - other, axis=1).argmin())
        assert np.linalg.norm(places[far] - other) < 1e-9
        assert around[far] > 0
