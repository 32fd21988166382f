"""Gradients of the force (their Taylor tests: test_energy_gradients) and tangent stiffness."""

from dataclasses import replace

import numpy as np
import pytest

from study.mechanics.material.material import Material
from study.mechanics.mesh.mesher import build_mesh
from study.mechanics.setup.geometry import Block, Cone, Cylinder, Flat, Sphere
from study.mechanics.solver import sensitivity
from study.mechanics.solver.finite_element_solution import solve
from study.mechanics.solver.load_path import LoadPath
from study.mechanics.solver.newton import Options
from tests.fem.problems import LONG, compression, indentation

MATERIALS = [
    Material("mooney-rivlin", {"C10": 3e-3, "C01": 2e-3}, poisson_ratio=0.4995),
    Material("reduced-polynomial", {"C10": 5e-3, "C20": 1e-3}, bulk_modulus=10.0),
]


def test_warm_start_changes_nothing():
    problem = compression(Cylinder(25, 30), 3, material=MATERIALS[0], steps=3, mesh="coarse")
    base = solve(problem)
    other = replace(problem, material=MATERIALS[0].with_constants([3.6e-3, 1.5e-3]))
    cold, warm = solve(other), solve(other, warm=base)
    np.testing.assert_allclose(warm.curve.force_N, cold.curve.force_N, rtol=1e-9)
    assert sum(warm.newton_iterations) < sum(cold.newton_iterations)


def test_a_warm_start_holds_the_points_that_the_earlier_solve_held():
    """The folded side of a bonded solid has a point that never settles and is held though it pulls.

    Released in the later solve, it changed sides for 20 iterations.
    """
    material = Material("mooney-rivlin", {"C10": 3.24e-3, "C01": 2.91e-3}, poisson_ratio=0.4995)
    problem = compression(
        Cylinder(25, 30), 12.0, material=material, steps=2,
        space="3d", element_order="quadratic", mesh_size_mm=5.5,
    )  # fmt: skip
    base = solve(problem)
    system, state = base.warm.system, base.warm.steps[-1].state
    assert any(held.any() for held in system.held_against_wish(state))
    moved = replace(problem, material=material.with_constants(np.array([3.228e-3, 2.92e-3])))
    cold, warm = (solve(moved, gradients=False, warm=start) for start in (None, base))
    assert max(warm.newton_iterations) <= 2
    np.testing.assert_allclose(warm.curve.force_N, cold.curve.force_N, rtol=1e-9)
    # so is a step that is added between two such states
    between = LoadPath(system, problem, Options(), False, None, None)._halfway(
        state, state, state.displacement_mm
    )
    assert between.iterations <= 2


CONFIGURATIONS = {
    "needle": (Cone(30.0, 1.0, 3.0), 3.0, "axisymmetric", "simplex"),
    "rounded punch": (Flat(3.0, 0.3), 2.0, "axisymmetric", "simplex"),
    "sphere": (Sphere(5.0), 3.0, "axisymmetric", "tensor"),
    "needle in 3D": (Cone(30.0, 1.0), 1.5, "3d", "simplex"),
}


@pytest.mark.parametrize(
    "name", [*list(CONFIGURATIONS)[:3], pytest.param("needle in 3D", marks=LONG)]
)
def test_a_curve_has_one_slope_whatever_is_asked_for(name):
    """dF/dd of a second specimen, warm and without gradients, is that of forces on one mesh.

    The tangent is exact, so that what differs is the curvature over 2e-5 of the depth (some
    1e-6), and where a point of the contact opens or closes between the three forces.
    """
    indenter, depth, space, shape = CONFIGURATIONS[name]
    order = "linear" if space == "3d" else "quadratic"
    first = Material("neo-hookean", {"C10": 6e-3}, poisson_ratio=0.4995)
    problem = indentation(
        indenter, depth, material=first, specimen=Block(60.0, 60.0, 40.0), steps=4, space=space,
        element_order=order, element_shape=shape, mesh="coarse",
    )  # fmt: skip
    mesh = build_mesh(problem.setup)
    base = solve(problem, mesh=mesh)
    second = replace(problem, material=first.with_constants([5.4e-3]))
    later = solve(second, gradients=False, warm=base, mesh=mesh).curve.stiffness_N_per_mm
    alone = solve(second, gradients=False, mesh=mesh).curve.stiffness_N_per_mm
    asked = solve(second, mesh=mesh).curve.stiffness_N_per_mm
    # two states within Newton's tolerance of 1e-8 have slopes that differ by up to 1e-5
    np.testing.assert_allclose(alone, asked, rtol=5e-5)
    np.testing.assert_allclose(later, asked, rtol=5e-5)
    nearby = [
        replace(second, test=replace(second.test, displacement_mm=depth * (1 + h)))
        for h in (-1e-5, 1e-5)
    ]
    low, high = (solve(p, gradients=False, mesh=mesh).curve.force_N[-1] for p in nearby)
    assert asked.size >= 4
    np.testing.assert_allclose(asked[-1], (high - low) / (2e-5 * depth), rtol=1e-4)


def test_derivatives_that_do_not_converge_are_said(monkeypatch):
    """Without corrections the springs of the contact keep a part of every derivative."""
    problem = indentation(
        Sphere(5.0), 1.0, material=MATERIALS[0], specimen=Cylinder(12, 10), steps=2, mesh="coarse"
    )
    right = solve(problem)
    assert right.message == "every step converged"
    # fewer than are needed: the tangent is factorized once more and serves for the rest
    monkeypatch.setattr(sensitivity, "_CORRECTIONS", 3)
    again = solve(problem)
    assert again.message == "every step converged"
    np.testing.assert_allclose(
        again.curve.stiffness_N_per_mm, right.curve.stiffness_N_per_mm, rtol=1e-6
    )
    monkeypatch.setattr(sensitivity, "_CORRECTIONS", 0)
    assert "steps did not converge: at" in solve(problem).message


@pytest.mark.parametrize(
    ("specimen", "share", "mesh", "rtol"),
    [
        # steps of 0.2 % strain
        (Cylinder(25, 30), 0.02, {"mesh": "coarse"}, 1e-6),
        # 1200 elements along the axis: a small residual allowed an error of 3e-5, of 3000 elements
        # slopes twice as steep
        (Cylinder(0.05, 30.0), 0.2, {"mesh_size_mm": 0.025}, 1e-5),
    ],
)
def test_stiffness_is_the_slope_of_the_curve(specimen, share, mesh, rtol):
    problem = compression(specimen, share * 30, material=MATERIALS[1], steps=12, **mesh)
    curve = solve(problem).curve
    d, f, k = curve.displacement_mm, curve.force_N, curve.stiffness_N_per_mm
    assert len(d) == 12
    # differences of fourth order
    central = (f[:-4] - 8 * f[1:-3] + 8 * f[3:-1] - f[4:]) / (12 * (d[1] - d[0]))
    np.testing.assert_allclose(k[2:-2], central, rtol=rtol)
