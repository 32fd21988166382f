"""Patch tests: homogeneous fields are exact on distorted meshes (V04, V08, V11, V12)."""

from __future__ import annotations

import numpy as np
import pytest

from study.mechanics.material.material import Material
from study.mechanics.setup.geometry import Cylinder
from study.mechanics.solver.finite_element_solution import solve
from study.mechanics.solver.newton import Options
from tests.fem.problems import (
    MOONEY,
    NEO_HOOKEAN,
    RP2,
    YEOH,
    compression,
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


def test_superlu_gives_the_same_answer() -> None:
    problem = compression(Cylinder(25, 50), 2.5, material=RP2, mesh="coarse")
    fallback = solve(problem, options=Options(linear_solver="superlu"))
    usual = solve(problem)
    assert fallback.solver == "superlu"
    np.testing.assert_allclose(fallback.curve.force_N, usual.curve.force_N, rtol=1e-9)
