"""Patch tests: homogeneous fields are exact on distorted meshes (V04, V08, V11, V12)."""

from __future__ import annotations

import numpy as np
import pytest

from study.mechanics.material.material import Material
from study.mechanics.setup.geometry import Cylinder
from study.mechanics.solver.finite_element_solution import solve
from study.mechanics.solver.newton import NewtonSettings, Options, solve_step
from study.mechanics.solver.system import State, System
from tests.fem.homogeneous import held
from tests.fem.problems import (
    MOONEY,
    NEO_HOOKEAN,
    RP2,
    YEOH,
    compression,
    cube,
    grid,
    irregular,
)

#: Table B at l = 0.7, K/mu0 = 1000: lateral stretch and nominal stress over mu0 (analytic)
TABLE_B = [
    (NEO_HOOKEAN, 1.195041618, -1.34045742),
    (MOONEY, 1.195025594, -1.45527701),
    (RP2, 1.195015666, -1.52641324),
    (YEOH, 1.195051894, -1.26682329),
]


@pytest.mark.parametrize(("material", "lateral", "stress"), TABLE_B)
@pytest.mark.parametrize("order", ["linear", "quadratic"])
def test_axisymmetric_patch(material: Material, lateral: float, stress: float, order: str) -> None:
    problem = compression(
        Cylinder(1, 1), 0.3, "frictionless", material=material, element_order=order
    )
    solution = solve(problem, mesh=irregular(grid(1, 1, 4, 4)))
    assert solution.converged
    # the affine field is in the space: what is left is the table's last digit
    assert solution.curve.force_N[-1] == pytest.approx(-stress * np.pi, rel=1e-8)
    side = solution.points[:, 0] > 1 - 1e-9
    np.testing.assert_allclose(1 + solution.displacement[side, 0], lateral, atol=1e-9)


@pytest.mark.parametrize(("material", "lateral", "stress"), TABLE_B[:2])
@pytest.mark.parametrize("order", ["linear", "quadratic"])
def test_cylinder_in_3d_keeps_its_area(
    material: Material, lateral: float, stress: float, order: str
) -> None:
    problem = compression(
        Cylinder(1, 1), 0.3, "frictionless", material=material, element_order=order, space="3d"
    )
    solution = solve(problem, gradients=False)
    # a polygon of straight sides would lose 0.4 %; the adjusted radius loses nothing
    assert solution.curve.force_N[-1] == pytest.approx(-stress * np.pi, rel=1e-8)


@pytest.mark.parametrize("order", ["linear", "quadratic"])
@pytest.mark.parametrize("material", [NEO_HOOKEAN, MOONEY])
def test_3d_patch_with_a_full_gradient(material: Material, order: str) -> None:
    """V12: boundary u = (F - I) X for a random F; inside exact, p = K (J - 1) uniform."""
    rng = np.random.default_rng(11)
    F = np.eye(3) + 0.1 * rng.standard_normal((3, 3))
    F *= (1.0005 / np.linalg.det(F)) ** (1 / 3)
    problem = compression(Cylinder(1, 1), 0.1, material=material, space="3d", element_order=order)
    system = System.build(problem, cube(3), folding=False)
    nodes = system.space.nodes
    rim = np.flatnonzero((np.abs(nodes * (1 - nodes)) < 1e-9).any(axis=1))
    field = (nodes @ (F - np.eye(3)).T).ravel()
    if order == "linear":  # a bubble is no nodal value: exact means that it vanishes
        field.reshape(-1, 3)[len(system.mesh.points) :] = 0.0
    dofs = np.array([3 * n + i for n in rim for i in range(3)])
    system = held(system, dofs, field[dofs])
    start = system.start()
    target = State(1.0, start.x, start.multipliers)
    result = solve_step(system, target, NewtonSettings(tolerance=1e-12), lifted_from=start)
    assert result.converged
    u, p = np.split(result.state.x, [system.space.n_displacement])
    np.testing.assert_allclose(u, field, atol=1e-10)
    np.testing.assert_allclose(p, 1000 * 0.0005, rtol=1e-8)


@pytest.mark.parametrize("space", ["axisymmetric", "3d"])
def test_rigid_motion_has_no_force(space: str) -> None:
    """V08: an axial shift (and in 3D a rotation) leaves the residual zero."""
    problem = compression(Cylinder(1, 1), 0.1, space=space)
    mesh = grid(1, 1, 3, 3) if space == "axisymmetric" else cube(2)
    system = System.build(problem, mesh, folding=False)
    x = np.zeros(system.space.n)
    u = x[: system.space.n_displacement].reshape(-1, system.space.dim)
    u[:, -1] = 0.37
    if space == "3d":
        turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        u += system.space.nodes @ (turn - np.eye(3)).T
    assembly = system.assemble(State(0.0, x))
    assert np.abs(assembly.residual).max() < 1e-12


def test_newton_converges_quadratically() -> None:
    """V09: the tangent is consistent, so the residual squares in the last iterations."""
    problem = compression(Cylinder(25, 50), 2.5, material=NEO_HOOKEAN)
    system = System.build(problem, grid(25, 50, 8, 16), folding=False)
    start = system.start()
    target = State(2.5, start.x, start.multipliers)
    result = solve_step(system, target, NewtonSettings(tolerance=1e-13), lifted_from=start)
    history = [r for r in result.residuals if r > 1e-13]
    orders = [
        np.log(history[k + 1]) / np.log(history[k])
        for k in range(len(history) - 3, len(history) - 1)
    ]
    assert min(orders) > 1.7


def test_superlu_gives_the_same_answer() -> None:
    problem = compression(Cylinder(25, 50), 2.5, material=RP2, mesh="coarse")
    fallback = solve(problem, options=Options(linear_solver="superlu"))
    usual = solve(problem)
    assert fallback.solver == "superlu"
    np.testing.assert_allclose(fallback.curve.force_N, usual.curve.force_N, rtol=1e-9)
