"""Thick spheres (V18) and cylinders in plane strain (V19), inner radius 1, driven by it."""

import numpy as np
import pytest

from study.mechanics.material.material import Material
from study.mechanics.setup.setup import Model
from study.statistics.convergence.grid_convergence import grid_convergence
from tests.fem.known import body, rectangle, solve
from tests.fem.problems import LONG

NEO = Material("neo-hookean", {"C10": 0.5}, incompressible=True)
MR = Material("mooney-rivlin", {"C10": 0.4, "C01": 0.1}, incompressible=True)


def sphere_truth(la, material, outer=2.0):
    lb = (1 + (la**3 - 1) / outer**3) ** (1 / 3)
    c10, c01 = material.constants["C10"], material.constants.get("C01", 0.0)
    p = c10 * (4 / lb + lb**-4 - 4 / la - la**-4)
    return float(p + 4 * c01 * ((la - lb) - (la**-2 - lb**-2) / 2))


def cylinder_truth(la, outer):
    lb = (1 + (la**2 - 1) / outer**2) ** 0.5
    return float(np.log(la / lb) + (lb**-2 - la**-2) / 2)


def sphere_pressure(la, material, model, n):
    """Work conjugate of the inner volume: forces times rate of the prescribed motion."""
    radius, angle = np.linspace(1, 2, n + 1), np.linspace(0, np.pi / 2, 2 * n + 1)
    points, cells = rectangle(radius, angle, model)
    points = points[:, :1] * np.column_stack([np.cos(points[:, 1]), np.sin(points[:, 1])])
    points[np.abs(points) < 1e-12] = 0.0
    made = body(points, cells, model, material)
    inner = (np.linalg.norm(made.nodes, axis=1) < 1 + 1e-9) | _on_chords(made.nodes, angle)
    held, values = [], []
    for axis in (0, 1):
        dofs = made.dofs_where(lambda X: inner, axis)
        held.append(dofs)
        values.append((la - 1) * made.nodes[dofs // 2, axis])
    for axis in (0, 1):
        dofs = made.dofs_where(lambda X, axis=axis: X[:, axis] < 1e-12, axis)
        held.append(dofs)
        values.append((la - 1) * made.nodes[dofs // 2, axis] * inner[dofs // 2])
    answer = solve(made, np.concatenate(held), np.concatenate(values), steps=max(2, round(4 * la)))
    work = sum(float(answer.forces[d] @ made.nodes[d // 2, k]) for k, d in enumerate(held[:2]))
    return work / (2 * np.pi * la**2)


def _on_chords(nodes, angle):
    """Midpoints of the straight inner edges, which lie a little inside the circle."""
    middle = (angle[1:] + angle[:-1]) / 2
    chord = np.cos((angle[1] - angle[0]) / 2) * np.column_stack([np.cos(middle), np.sin(middle)])
    gap = np.linalg.norm(nodes[:, None] - chord[None], axis=2).min(axis=1)
    return np.asarray(gap < 1e-9)


def cylinder_pressure(la, outer, model, n):
    """One slice of a long tube: ends stay in their planes."""
    points, cells = rectangle(np.linspace(1, outer, n + 1), np.linspace(0, 0.5, 3), model)
    made = body(points, cells, model, NEO)
    inner = made.dofs_where(lambda X: X[:, 0] < 1 + 1e-12, 0)
    ends = made.dofs_where(lambda X: (X[:, 1] < 1e-12) | (X[:, 1] > 0.5 - 1e-12), 1)
    held = np.r_[inner, ends]
    values = np.r_[np.full(inner.size, la - 1), np.zeros(ends.size)]
    answer = solve(made, held, values, steps=max(2, round(4 * la)))
    return float(answer.forces[inner].sum() / (2 * np.pi * la * 0.5))


@pytest.mark.parametrize("order", ["quadratic", "linear"])
@pytest.mark.parametrize("la", [1.1, *(pytest.param(la, marks=LONG) for la in (1.5, 2.0))])
@pytest.mark.parametrize("wall", [NEO, MR, 1.5, 2.0], ids=["NH", "MR", "B=1.5", "B=2"])
def test_the_bound_of_a_thick_wall_holds_its_closed_form(wall, la, order):
    model = Model("axisymmetric", order, "simplex")
    # straight sides of a curved wall are of second order whatever the element
    formal = 4.0 if isinstance(wall, float) and order == "quadratic" else 2.0
    if isinstance(wall, float):
        meshes, truth = (3, 5, 8), cylinder_truth(la, wall)
        values = [cylinder_pressure(la, wall, model, n) for n in meshes]
    else:
        meshes, truth = (4, 6, 9), sphere_truth(la, wall)
        values = [sphere_pressure(la, wall, model, n) for n in meshes]
    found = grid_convergence([1 / n for n in meshes], values, formal_order=formal)
    assert abs(values[-1] - truth) <= (found.u_num or 0.0)
    if la == 1.1:  # V18, V19: a mesh of 9 by 18, of 8 by 2
        assert values[-1] == pytest.approx(truth, rel=5e-3)
