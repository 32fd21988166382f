"""Hexahedra in rings around the edge of a flat punch: sound, alike in a series, convergent.

The reference is a bonded punch of radius 3 mm, pressed 0.3 mm into a bonded block of 40 x 40
x 20 mm. On a cylinder of the same cross-section quadratic triangles and quadrilaterals give
0.08293 and 0.08295 N (elements of 0.0125 mm; from below and from above); a block has 0.9971
of that (quadratic hexahedra, the same on two meshes).
"""

import numpy as np
import pytest

from study.mechanics.contact.contact import constraints
from study.mechanics.element.function_space import discretize
from study.mechanics.material.material import Material
from study.mechanics.mesh.mesher import _volumes, build_mesh
from study.mechanics.setup.geometry import Block, Cylinder, Flat
from tests.fem.problems import GEL, LONG, forces, indentation, reached

LEVELS = ("coarse", "medium", "fine")
BLOCK, FORCE = Block(40, 40, 20), 0.0827
ROUND = Cylinder(float(np.sqrt(1600 / np.pi)), 20)


def punch(specimen=BLOCK, interface="bonded", pressed=None, depth=0.3, **model):
    return indentation(
        pressed or Flat(3.0), depth, material=GEL, specimen=specimen, steps=1, interface=interface,
        **{"space": "3d", "element_order": "linear", "element_shape": "tensor", **model},
    )  # fmt: skip


def force(problem):
    return float(forces(problem)[-1])


def on_circle(mesh, radius):
    """Angles of the nodes on a circle on the loaded face."""
    rho = np.hypot(*mesh.points[:, :2].T)
    top = mesh.points[:, 2] == mesh.height_mm
    x, y, _ = mesh.points[top & (np.abs(rho - radius) < 1e-12 * radius)].T
    return np.sort(np.arctan2(y, x))


SHAPES = {
    "block": punch(),
    "cylinder": punch(ROUND),
    "long": punch(Block(90, 20, 30)),
    "deep": punch(Block(20, 90, 80)),
    "shallow": punch(Block(40, 40, 2)),
    "narrow": punch(Block(6.4, 40, 20)),
    "full": punch(Cylinder(3.1, 20)),
    "round edge": punch(pressed=Flat(3, 0.3)),
    "very round": punch(ROUND, pressed=Flat(3, 2.5)),
    "pressed far": punch(depth=3.0),
    "huge": punch(mesh_size_mm=3.0),
    "tiny": punch(mesh_size_mm=0.06),
}


@pytest.mark.parametrize("problem", SHAPES.values(), ids=SHAPES)
def test_elements_are_sound_and_fill_the_specimen(problem):
    mesh, specimen = build_mesh(problem.setup), problem.specimen
    corners = _volumes(mesh, mesh.points)
    assert corners.min() > 0
    space = discretize(mesh, problem.model)
    if isinstance(specimen, Cylinder):
        quarter = np.pi / 4 * specimen.radius_mm**2 * specimen.height_mm
    else:
        quarter = specimen.width_mm * specimen.depth_mm * specimen.height_mm / 4
    assert space.weights.sum() == pytest.approx(quarter, rel=1e-9)
    assert space.weights.min() > 0
    edge = problem.test.indenter.radius_mm - problem.test.indenter.edge_radius_mm
    found = on_circle(mesh, edge)
    assert found.size >= 5
    np.testing.assert_allclose(found, np.linspace(0, np.pi / 2, found.size), atol=1e-12)


@pytest.mark.parametrize("specimen", [BLOCK, ROUND], ids=["block", "cylinder"])
@pytest.mark.parametrize("order", ["linear", "quadratic"])
def test_what_is_held_is_the_disc(specimen, order):
    problem = punch(specimen, element_order=order)
    mesh = build_mesh(problem.setup)
    space = discretize(mesh, problem.model)
    prescribed = constraints(problem.setup, space, mesh)
    driven = prescribed.dofs[prescribed.rate == -1.0] // 3
    under = np.isin(space.facets, driven).all(axis=1)
    segments = on_circle(mesh, 3.0).size - 1
    step = np.pi / 2 / segments
    polygon = np.pi / 4 * 9 * np.sin(step) / step
    assert space.facet_weights[under].sum() == pytest.approx(polygon, rel=1e-12)
    # no single node outside of these facets is held
    assert np.isin(driven, space.facets[under]).all()


def test_a_series_is_refined_everywhere_alike():
    meshes = [build_mesh(punch(mesh=level).setup) for level in LEVELS]
    assert [mesh.size_mm for mesh in meshes] == pytest.approx([0.225, 0.15, 0.1])
    counts = [len(mesh.cells) for mesh in meshes]
    assert counts[1] / counts[0] == pytest.approx(1.5**3, rel=0.1)
    assert counts[2] / counts[1] == pytest.approx(1.5**3, rel=0.1)
    assert [on_circle(mesh, 3.0).size - 1 for mesh in meshes] == [6, 8, 12]
    for mesh in meshes:  # across the edge, on the x axis: finer than what is asked for
        x = np.sort(mesh.points[(mesh.points[:, 1] == 0) & (mesh.points[:, 2] == 20), 0])
        beside = np.diff(x)[np.searchsorted(x, 3.0 - 1e-9) - 1 :][:2]
        assert (beside < mesh.size_mm).all()
        assert (beside > 0.2 * mesh.size_mm).all()


def test_linear_hexahedra_converge_from_above():
    """Measured: 3.8, 1.7 and 0.9 %; a staircase of nodes gave -3.9, -6.8 and -0.8 %."""
    coarse, medium, fine = (force(punch(mesh=level)) / FORCE - 1 for level in LEVELS)
    assert 0.05 > coarse > 1.5 * medium > 2 * fine > 0
    assert fine < 0.01


@pytest.mark.parametrize(
    "mesh", ["coarse", pytest.param("medium", marks=LONG), pytest.param("fine", marks=LONG)]
)
def test_quadratic_hexahedra_are_right_on_every_mesh(mesh):
    """Measured: -0.10 and -0.08 % on coarse and medium; the reference is known to 0.1 %."""
    assert force(punch(mesh=mesh, element_order="quadratic")) == pytest.approx(FORCE, rel=0.003)


def test_a_frictionless_punch_meets_the_same_disc():
    """An incompressible half-space does not move sideways under it (Spence 1968)."""
    held, free = (force(punch(interface=how, mesh="coarse")) for how in ("bonded", "frictionless"))
    assert 0.995 < free / held <= 1.0


def test_a_seed_leaves_the_circle_where_it_is():
    regular, moved = (build_mesh(punch(mesh="medium", mesh_seed=seed).setup) for seed in (None, 3))
    assert moved.digest() != regular.digest()
    np.testing.assert_array_equal(on_circle(moved, 3.0), on_circle(regular, 3.0))
    assert force(punch(mesh="medium", mesh_seed=3)) == pytest.approx(
        force(punch(mesh="medium")), rel=0.01
    )


def test_a_fine_mesh_of_quadratic_elements_meets_a_flat_punch_at_a_tiny_depth():
    """Points that were held closed pulled, and were chosen for ever: the test stopped at 0 mm."""
    forces, soft = [], Material("neo-hookean", {"C10": 5e-3}, poisson_ratio=0.49)
    for order in ("linear", "quadratic"):
        problem = indentation(
            Flat(3.0, 0.3), 0.006, Cylinder(20.0, 20.0), steps=2, element_order=order,
            mesh_size_mm=0.1 / 3, material=soft,
        )  # fmt: skip
        forces.append(reached(problem).curve.force_N[-1])
    np.testing.assert_allclose(forces[1], forces[0], rtol=0.01)
