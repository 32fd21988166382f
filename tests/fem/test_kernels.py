"""The compiled constitutive law at a material point (V06-V09, P03, P07)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from study.mechanics.element.point_law import (
    POLYNOMIAL,
    cofactor,
    invariant_derivatives,
    invariant_stress,
    invariant_tangent,
)
from tests.fem.problems import MOONEY, NEO_HOOKEAN, RP2, YEOH

MATERIALS = [NEO_HOOKEAN, MOONEY, RP2, YEOH]
FULL_TABLE = np.array([[0.0, 0.1, 0.02], [0.4, 0.05, 0.0], [0.03, 0.0, 0.0]])


def stress(F: np.ndarray, table: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    P, A, work = np.zeros(9), np.zeros((9, 9)), np.zeros((7, 9))
    J = invariant_stress(POLYNOMIAL, F.ravel(), table, work, P)
    if J > 0:
        invariant_tangent(F.ravel(), False, 0.0, 0.0, work, A)
    return P.reshape(3, 3), A, J


def energy(F: np.ndarray, table: np.ndarray) -> float:
    J = np.linalg.det(F)
    C = F.T @ F
    I1 = np.trace(C)
    I2 = (I1**2 - np.trace(C @ C)) / 2
    a, b = J ** (-2 / 3) * I1 - 3, J ** (-4 / 3) * I2 - 3
    return sum(
        table[i, j] * a**i * b**j for i in range(table.shape[0]) for j in range(table.shape[1])
    )


def random_gradient(seed: int) -> np.ndarray:
    """A deformation gradient with J between 0.8 and 1.2."""
    rng = np.random.default_rng(seed)
    F = np.eye(3) + 0.3 * rng.standard_normal((3, 3))
    J = np.linalg.det(F)
    if J <= 0.1:
        return random_gradient(seed + 1000)
    return F * (rng.uniform(0.8, 1.2) / J) ** (1 / 3)


def rotation(seed: int) -> np.ndarray:
    q, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    return q * np.sign(np.linalg.det(q))


@pytest.mark.parametrize("seed", range(5))
def test_stress_is_the_derivative_of_the_energy(seed: int) -> None:
    F, h = random_gradient(seed), 1e-6
    P, _, _ = stress(F, FULL_TABLE)
    for i in range(3):
        for j in range(3):
            step = np.zeros((3, 3))
            step[i, j] = h
            slope = (energy(F + step, FULL_TABLE) - energy(F - step, FULL_TABLE)) / (2 * h)
            # central difference: truncation h^2 and rounding eps/h, both near 1e-10
            assert P[i, j] == pytest.approx(slope, abs=2e-8)


@pytest.mark.parametrize("seed", range(5))
def test_tangent_is_the_derivative_of_the_stress(seed: int) -> None:
    F, h = random_gradient(seed), 1e-6
    _, A, _ = stress(F, FULL_TABLE)
    for n in range(9):
        step = np.zeros(9)
        step[n] = h
        plus, _, _ = stress(F + step.reshape(3, 3), FULL_TABLE)
        minus, _, _ = stress(F - step.reshape(3, 3), FULL_TABLE)
        np.testing.assert_allclose(A[:, n], (plus - minus).ravel() / (2 * h), atol=1e-7)
    np.testing.assert_allclose(A, A.T, atol=1e-14)  # major symmetry


@given(st.integers(0, 10_000))
def test_objective_and_isotropic(seed: int) -> None:
    F, Q = random_gradient(seed), rotation(seed + 1)
    P, _, _ = stress(F, FULL_TABLE)
    # V08 and P03: F -> QF rotates P, F -> FQ rotates it from the right
    np.testing.assert_allclose(stress(Q @ F, FULL_TABLE)[0], Q @ P, atol=1e-12)
    np.testing.assert_allclose(stress(F @ Q, FULL_TABLE)[0], P @ Q, atol=1e-12)


def test_rigid_rotation_has_no_stress() -> None:
    for seed in range(4):
        P, _, J = stress(rotation(seed), FULL_TABLE)
        assert np.abs(P).max() < 1e-13
        assert pytest.approx(1.0, abs=1e-14) == J


@pytest.mark.parametrize(
    ("table", "stretch", "expected"),
    [
        # V06, analytic: 4/3 C10 (l^1/3 - l^-5/3) + 4/3 C01 (l^-1/3 - l^-7/3) + K (l - 1)
        ([[0.0], [0.5]], 0.9, -10.1509818791),
        ([[0.0], [0.5]], 0.95, -5.0708012102),
        ([[0.0, 0.1], [0.4, 0.0]], 0.9, -10.1531791480),
    ],
)
def test_confined_compression(table: list[list[float]], stretch: float, expected: float) -> None:
    P, _, J = stress(np.diag([1.0, 1.0, stretch]), np.array(table))
    total = P[2, 2] + 100.0 * (J - 1)  # cofactor of F_33 is one
    assert total == pytest.approx(expected, abs=1e-10)


def test_isochoric_part_carries_no_pressure() -> None:
    """V07: F = s I gives no isochoric stress whatever the constants."""
    P, _, _ = stress(0.99 * np.eye(3), FULL_TABLE)
    assert np.abs(P).max() < 1e-14


def test_cofactor_is_the_derivative_of_the_volume() -> None:
    F, g = random_gradient(3), np.zeros(9)
    J = cofactor(F.ravel(), g)
    np.testing.assert_allclose(g.reshape(3, 3), J * np.linalg.inv(F).T, atol=1e-14)


def test_inverted_element_is_told() -> None:
    _, _, J = stress(np.diag([1.0, 1.0, -0.1]), FULL_TABLE)
    assert J < 0


def test_polynomial_derivatives_at_the_origin() -> None:
    out = np.zeros(5)
    invariant_derivatives(POLYNOMIAL, FULL_TABLE, 0.0, 0.0, out)
    np.testing.assert_allclose(out, [0.4, 0.1, 0.06, 0.05, 0.04])
