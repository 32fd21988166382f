"""How deep a needle gets: every energy, every element, coarse to fine, in both spaces."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from study.mechanics.contact.collocation import contact_points
from study.mechanics.contact.contact import ContactPoints, Plane
from study.mechanics.element.function_space import discretize
from study.mechanics.material.material import Material
from study.mechanics.mesh.mesher import build_mesh
from study.mechanics.setup.geometry import Block, Cone, Sphere
from study.mechanics.solver.finite_element_solution import solve
from study.mechanics.solver.newton import Options
from tests.fem.problems import GEL, LONG, NEEDLE, indentation, long_verification, reached

ENERGIES = {
    "neo-hookean": GEL,
    "mooney-rivlin": Material("mooney-rivlin", {"C10": 5e-3, "C01": 1e-3}, bulk_modulus=10.0),
    "yeoh-2": Material("reduced-polynomial", {"C10": 5e-3, "C20": 3e-4}, bulk_modulus=10.0),
    "ogden": Material("ogden", {"mu1": 0.012, "alpha1": 2.8}, bulk_modulus=10.0),
}
#: as lubricated compression of a measured silicone gives it: it softens in tension
SOFTENING = Material("ogden", {"mu1": 0.015422, "alpha1": 1.52394}, poisson_ratio=0.4995)
MESHES = [
    (shape, order, mesh)
    for shape in ("simplex", "tensor")
    for order in ("linear", "quadratic")
    for mesh in ("coarse", "medium", "fine")
]
IN_BLOCK = [
    ("block", order, mesh) for order in ("linear", "quadratic") for mesh in ("coarse", "medium")
]


def deep(material, shape, order, mesh):
    return indentation(
        NEEDLE, 5.0, material=material, element_order=order, element_shape=shape, mesh=mesh
    )


def in_block(material, depth, order, mesh, space="3d"):
    return indentation(
        Cone(30, 1, 3), depth, material=material, specimen=Block(60, 60, 40),
        steps=max(1, round(depth / 0.4)), space=space, element_order=order, mesh=mesh,
        mesh_ratio=1.3,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("shape", "order", "mesh"), [("simplex", "quadratic", "coarse"), ("tensor", "linear", "fine")]
)
def test_the_softest_energy_reaches_five_millimetres(shape, order, mesh):
    solution = reached(deep(GEL, shape, order, mesh))
    assert "snapped" not in solution.message


@pytest.mark.parametrize("steps", [10, 30])
def test_a_jump_between_two_load_steps_is_told_with_its_place(steps):
    """Plain Newton crosses a limit point at 2.8 mm; the force falls and 1 % of the work is lost.

    All Newton sees is that every step converged. The place does not depend on the load steps.
    """
    problem = deep(GEL, "tensor", "linear", "medium")
    problem = replace(problem, test=replace(problem.test, steps=steps))
    solution = reached(problem)
    assert "snapped to another equilibrium" in solution.message
    (place,) = solution.energy.jumps_mm
    assert place == pytest.approx(2.8, abs=0.1)
    assert solution.energy.largest_mismatch > 0.005


@pytest.mark.parametrize(
    ("space", "order", "mesh", "apart"),
    [
        # bubbles that swell unevenly at no cost had limit points at 2.5 and 2.0 mm
        ("axisymmetric", "linear", "medium", 0.03),
        ("axisymmetric", "linear", "fine", 0.03),
        # facets a twentieth of the tip wide stopped at 3.86 mm
        ("axisymmetric", "quadratic", "coarse", 0.003),
        # integrated at four points they collapse between them, at 3.18 and 3.43 mm
        pytest.param("3d", "quadratic", "coarse", 0.02, marks=LONG),
        pytest.param("3d", "quadratic", "medium", 0.02, marks=LONG),
    ],
)
def test_a_softening_energy_reaches_its_depth(space, order, mesh, apart):
    solution = reached(in_block(SOFTENING, 4.0, order, mesh, space))
    assert "snapped" not in solution.message
    # 0.511 N on six meshes of quadratic triangles, coarse to fine, within 0.1 %
    assert solution.curve.force_N[-1] == pytest.approx(0.511, rel=apart)


@pytest.mark.parametrize("order", ["linear", "quadratic"])
def test_a_shallow_needle_needs_no_larger_mesh(order):
    """Elements of the size of the contact all over the tip took 6 GB at a fiftieth of 2 mm."""
    deep, shallow = (
        build_mesh(in_block(GEL, depth, order, "coarse").setup).cells.shape[0]
        for depth in (4.0, 0.04)
    )
    assert shallow < 2 * deep


def test_quadratic_tetrahedra_are_looked_at_in_more_points_under_an_indenter():
    problem = in_block(SOFTENING, 4.0, "quadratic", "coarse")
    mesh = build_mesh(problem.setup)
    usual, stretched = (
        discretize(mesh, problem.model, stretched=much).weights for much in (False, True)
    )
    assert stretched.shape[1] > 3 * usual.shape[1]
    assert (stretched > 0).all(), "a point with a negative weight would reward its collapse"
    assert stretched.sum() == pytest.approx(usual.sum(), rel=1e-12)


@long_verification
@pytest.mark.parametrize("alpha", [1.3, 1.8])
@pytest.mark.parametrize("size", [0.25, 0.3, 0.35, 0.4, 0.5])
def test_linear_triangles_of_any_size_reach_their_depth(alpha, size):
    material = Material("ogden", {"mu1": 0.0154, "alpha1": alpha}, poisson_ratio=0.4995)
    problem = in_block(material, 4.0, "linear", "fine", "axisymmetric")
    problem = replace(problem, model=replace(problem.model, mesh_size_mm=size))
    reached(problem)


@long_verification
@pytest.mark.parametrize("energy", ENERGIES)
@pytest.mark.parametrize(("shape", "order", "mesh"), [*MESHES, *IN_BLOCK])
def test_every_energy_reaches_its_depth(energy, shape, order, mesh):
    if shape == "block":
        reached(in_block(ENERGIES[energy], 4.0, order, mesh))
    else:
        reached(deep(ENERGIES[energy], shape, order, mesh))


@long_verification
def test_a_solid_needs_no_snap_under_the_needle():
    problem = in_block(ENERGIES["ogden"], 1.6, "quadratic", "coarse")
    reached(problem, options=Options(snaps=False))


def points_of_three(middles):
    nodes, ones = np.arange(3)[:, None], np.ones((3, 1))
    stiff = np.full(3, 1e3)
    return ContactPoints(
        Plane(1.0, -1, 1.0, 2), nodes, ones, np.ones(3), stiff, 1.0, middles=middles
    )


@pytest.mark.parametrize(
    ("own", "closed", "led"),
    [
        ([False, True, True], True, True),  # pulled, amid closed mid-sides: held
        ([True, False, False], False, True),  # pressed, amid open ones: free
        ([False, True, False], False, False),  # at the edge it decides for itself
        ([True, True, False], True, False),
    ],
)
def test_a_corner_goes_with_its_mid_sides(own, closed, led):
    rows = sp.csr_matrix(([True, True], ([0, 0], [1, 2])), (3, 3))
    multipliers = np.where(own, 1.0, -1.0)
    points = points_of_three(rows)
    met = points.meet(np.array([[0.0, 0.0, 1.0]] * 3), np.zeros((3, 3)), 0.0)
    touch = points.evaluate(met, multipliers)
    assert touch.closing.tolist() == [closed, *own[1:]]
    assert touch.led.tolist() == [led, False, False]
    kept = points_of_three(rows).admissible(multipliers)
    assert kept[0] == multipliers[0]
    assert (kept[1:] >= 0).all()


def test_every_corner_has_the_mid_sides_of_its_edges():
    problem = indentation(Sphere(3.0), 0.5, specimen=Block(20, 20, 10), space="3d", mesh="coarse")
    mesh = build_mesh(problem.setup)
    space = discretize(mesh, problem.model)
    (points,) = contact_points(problem, space, mesh)
    places = space.nodes[points.nodes[:, 0]]
    around = np.diff(points.middles.indptr)
    assert set(around[around > 0]) <= set(range(2, 12))
    corner = int(np.flatnonzero(around)[0])
    for middle in points.middles[corner].indices:
        other = 2 * places[middle] - places[corner]  # the far end of that edge is a corner too
        far = int(np.linalg.norm(places - other, axis=1).argmin())
        assert np.linalg.norm(places[far] - other) < 1e-9
        assert around[far] > 0


def test_an_energy_that_is_no_longer_elliptic_says_so():
    """An exponent of nearly zero is Hencky's energy: no mesh carries it under a needle."""
    hencky = Material("ogden", {"mu1": 0.01228, "alpha1": -0.019}, poisson_ratio=0.4995)
    found = solve(in_block(hencky, 4.0, "quadratic", "coarse", "axisymmetric"), gradients=False)
    assert found.status == "unstable"
    assert "no longer elliptic where it is stretched" in found.message
    assert "use another energy" in found.message
    assert 1.5 < found.reached_mm < 3.0
    assert 0 < len(found.curve) < 10
