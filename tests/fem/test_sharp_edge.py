"""A flat punch with a sharp edge: meshes alike around it, contact on the closed disc."""

import numpy as np
import pytest

from study.mechanics.contact.collocation import contact_points
from study.mechanics.contact.contact import Plane
from study.mechanics.element.function_space import discretize
from study.mechanics.material.material import Material
from study.mechanics.mesh.mesher import build_mesh
from study.mechanics.mesh.structured import half_hexagon
from study.mechanics.setup.geometry import Cylinder, Flat
from study.mechanics.solver.finite_element_solution import solve
from tests.fem.problems import indentation

SHAPES = ("simplex", "tensor")


def punch(size, shape, order="quadratic", edge=0.0):
    """Punch of radius 1 on a bonded layer of height 1, small strain, mu = 1."""
    material = Material("linear-elastic", {"youngs_modulus": 2.998}, poisson_ratio=0.499)
    return indentation(
        Flat(1.0, edge), 1e-3, material=material, specimen=Cylinder(10, 1), steps=1,
        element_shape=shape, element_order=order, mesh_size_mm=size,
    )  # fmt: skip


def around_edge(problem):
    """Mesh points around the edge, in elements."""
    mesh = build_mesh(problem.setup)
    return np.asarray((mesh.points - [1.0, 1.0]) / mesh.size_mm)


@pytest.mark.parametrize("shape", SHAPES)
def test_meshes_of_a_series_are_alike_around_the_edge(shape):
    """One pattern, in elements, on every mesh; a whole number of cells may move lines by 1 %."""
    half = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    grid = np.array([(x, z) for x in half for z in half[:3]])
    pattern, allowed = (half_hexagon(1.0, 1)[0], 1e-6) if shape == "simplex" else (grid, 0.01)
    for level in range(4):
        found = around_edge(punch(0.05 / 1.5**level, shape))
        assert (found == 0).all(axis=1).sum() == 1  # a node exactly at the edge
        gap = np.linalg.norm(found[None] - pattern[:, None], axis=2).min(axis=1)
        assert gap.max() < allowed
        inside = (np.abs(found) < 0.99).all(axis=1)
        assert inside.sum() == (np.abs(pattern) < 0.99).all(axis=1).sum()


@pytest.mark.parametrize("halvings", [0, 1, 3])
def test_half_hexagon_fills_its_area_with_even_triangles(halvings):
    points, cells, rim = half_hexagon(0.5, halvings)
    corners = points[cells]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2
    assert len(cells) == 12 + 12 * halvings
    assert areas.sum() == pytest.approx(1.5 * np.sqrt(3) / 2, rel=1e-12)  # of radius 1
    assert areas.min() == pytest.approx(np.sqrt(3) / 4 * 0.25 / 4**halvings, rel=1e-12)
    np.testing.assert_allclose(
        np.linalg.norm(np.diff(points[rim], axis=0), axis=1), 0.5, rtol=1e-12
    )
    used, counts = np.unique(np.sort(np.vstack([cells[:, [0, 1]], cells[:, [1, 2]],
                                                cells[:, [2, 0]]]), axis=1), axis=0,
                             return_counts=True)  # fmt: skip
    assert counts.max() == 2
    assert np.unique(used).size == len(points)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("order", ["linear", "quadratic"])
def test_the_closed_disc_touches_and_no_point_of_it_is_left_out(order, shape):
    problem = punch(0.05, shape, order)
    mesh = build_mesh(problem.setup)
    space = discretize(mesh, problem.model)
    face, beside = contact_points(problem, space, mesh)
    on_top = np.flatnonzero(np.abs(space.nodes[:, 1] - 1.0) < 1e-12)
    under = on_top[space.nodes[on_top, 0] <= 1.0]
    if order == "quadratic":  # a uniform pressure does not load the node on the axis
        under = under[space.nodes[under, 0] > 0]
    assert isinstance(face.surface, Plane)
    assert sorted(face.nodes[:, 0]) == sorted(under)
    assert space.nodes[face.nodes].max() == 1.0
    assert (space.nodes[beside.nodes][:, :, 0].max(axis=1) > 1.0).all()


@pytest.mark.parametrize("shape", SHAPES)
def test_the_force_comes_from_above_with_every_node_in_contact(shape):
    """V29, Table D: a/h = 1, nu = 0.499."""
    solution = solve(punch(0.05, shape), gradients=False)
    found = solution.curve.force_N[-1] / (4e-3 / 0.501)
    assert 3.60438 < found < 3.60438 * 1.002
    assert solution.newton_iterations[0] <= 5  # nothing opens and closes again
    system, state = solution.warm.system, solution.warm.steps[-1].state
    assert system.assemble(state).contact[0].active.all()
