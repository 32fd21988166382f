"""Every energy at a material point: the compiled law against independent formulas (V06-V09)."""

import numpy as np
import pytest

from study.mechanics.element.point_law import WORK_ROWS, full_tangent, isochoric
from study.mechanics.material.homogeneous import first_piola
from study.mechanics.material.material import Material
from tests.fem import reference_law
from tests.fem.problems import YEOH
from tests.fem.test_energies import GENT, OGDEN1, OGDEN3, OTHERS, TUBE, WAALS
from tests.material.modes import solid

ALMOST_ZERO = Material("ogden", {"mu1": 1.0, "alpha1": 1e-7}, bulk_modulus=100.0)
STEEP = solid("ogden", 0.5, 24.0, 0.5, -9.0, bulk_modulus=1e3)
POLY3 = solid(
    "polynomial", 0.4, 0.1, 0.03, 0.05, 0.02, 0.01, 0.004, 0.003, 0.002, bulk_modulus=100.0
)
LINEAR = Material("linear-elastic", {"youngs_modulus": 3.0}, incompressible=True)
HYPERELASTIC = [OGDEN1, OGDEN3, ALMOST_ZERO, STEEP, POLY3, YEOH, *OTHERS]
ALL = [*HYPERELASTIC, LINEAR]


def name(material):
    return f"{material.model}-{len(material.names)}-{material.values[-1]:g}"


def evaluate(law, F, *, tangent=True):
    """Isochoric nominal stress, tangent and J of the compiled law."""
    P, A, work = np.zeros(9), np.zeros((9, 9)), np.zeros((WORK_ROWS, 9))
    f = np.ascontiguousarray(F, dtype=float).ravel()
    J = isochoric(int(law.kind), f, law.constants, work, P)
    if tangent and J > 0:
        full_tangent(int(law.kind), f, law.constants, False, 0.0, 0.0, work, A)
    return P.reshape(3, 3), A, J


def random_gradient(seed):
    """Deformation gradient with J between 0.8 and 1.2."""
    rng = np.random.default_rng(seed)
    while True:
        F = np.eye(3) + 0.25 * rng.standard_normal((3, 3))
        J = np.linalg.det(F)
        if J > 0.3:
            return F * (rng.uniform(0.8, 1.2) / J) ** (1 / 3)


def rotation(seed):
    q, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    return q * np.sign(np.linalg.det(q))


def close(got, expected, tolerance):
    """Every entry agrees to a fraction of the largest."""
    np.testing.assert_allclose(got, expected, rtol=0, atol=tolerance * np.abs(expected).max())


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("material", ALL, ids=name)
def test_stress_and_tangent_against_complex_steps(material, seed):
    """V09: no differences, so only rounding is left (and the conditioning of exponent 24)."""
    F = random_gradient(seed)
    P, A, _ = evaluate(material.law(), F)
    close(P, reference_law.stress(material, F).real, 2e-12)
    close(P, first_piola(Material(material.model, material.constants, incompressible=True), F),
          2e-12)  # fmt: skip
    close(A, reference_law.tangent(material, F), 1e-11)
    close(A, A.T, 1e-15)


@pytest.mark.parametrize("material", ALL, ids=name)
def test_constant_derivatives_against_complex_steps(material):
    F = random_gradient(7)
    for constant in material.names:
        got, _, _ = evaluate(material.law_rate(constant), F, tangent=False)
        close(got, reference_law.constant_derivative(material, F, constant), 2e-12)


@pytest.mark.parametrize("gap", [0.0, 1e-15, 1e-12, 1e-9, 1e-7, 1e-5, 1e-3, 0.1])
@pytest.mark.parametrize("stretches", [(1.0, 1.0, 1.0), (0.7, 0.7, 2.0), (1.4, 0.6, 1.4)])
def test_nearly_equal_stretches(stretches, gap):
    """No threshold: the tangent is exact whatever the distance of two or three stretches."""
    apart = np.array(stretches) * (1 + gap * np.array([1.0, -0.5, -0.3]))
    F = rotation(3) @ np.diag(apart) @ rotation(4)
    for material in (OGDEN3, ALMOST_ZERO):
        P, A, _ = evaluate(material.law(), F)
        expected = reference_law.tangent(material, F)
        close(A, expected, 1e-12)
        np.testing.assert_allclose(
            P, reference_law.stress(material, F).real, rtol=0, atol=1e-13 * np.abs(expected).max()
        )


def test_at_rest():
    """F = I: no stress, the isotropic tangent 2 mu0 dev(sym), and no derivative by a constant.

    V07: no isochoric stress under pressure, F = s I.
    """
    assert np.abs(evaluate(LINEAR.law(), 0.99 * np.eye(3))[0]).max() < 1e-13
    for material in HYPERELASTIC:
        assert np.abs(evaluate(material.law(), 0.99 * np.eye(3))[0]).max() < 1e-13
        P, A, J = evaluate(material.law(), np.eye(3))
        assert J == 1.0
        assert np.abs(P).max() < 1e-15
        linear = solid("linear-elastic", 3 * material.mu0, incompressible=True)
        close(A, evaluate(linear.law(), np.eye(3))[1], 1e-14)
        for constant in material.names:
            rate, _, _ = evaluate(material.law_rate(constant), np.eye(3), tangent=False)
            assert np.abs(rate).max() < 1e-15


def test_exponent_through_zero():
    """Stress and d/dalpha are smooth at alpha = 0; uniaxial P is 3 mu ln(l) / l there."""
    F, mu = np.diag([1.3**-0.5, 1.3**-0.5, 1.3]), 0.7
    results = []
    for alpha in (-1e-3, -1e-9, 0.0, 1e-9, 1e-3):
        material = Material("ogden", {"mu1": mu, "alpha1": alpha}, incompressible=True)
        P, _, _ = evaluate(material.law(), F)
        rate, _, _ = evaluate(material.law_rate("alpha1"), F, tangent=False)
        # the pressure that frees the sides removes their Kirchhoff stress from the axial one
        axial = [p[2, 2] - p[0, 0] * F[0, 0] / F[2, 2] for p in (P, rate)]
        results.append(axial)
    stress, slope = np.array(results).T
    np.testing.assert_allclose(stress[1:4], 3 * mu * np.log(1.3) / 1.3, rtol=2e-9)
    # the derivative is continuous, and it is that of the stress
    np.testing.assert_allclose(slope[1:4], slope[2], rtol=2e-9)
    assert (stress[4] - stress[0]) / 2e-3 == pytest.approx(slope[2], rel=1e-6)


def test_inverted_is_told():
    assert evaluate(OGDEN3.law(), np.diag([1.0, 1.0, -0.1]))[2] < 0


@pytest.mark.parametrize("material", [GENT, TUBE, WAALS], ids=name)
def test_a_state_beyond_the_end_of_chains_is_told(material):
    """As an inverted one, so that a load step is halved; just before it there is a stress."""
    below, beyond = (np.diag([s, s**-0.5, s**-0.5]) for s in (2.2, 12.0))
    assert np.isfinite(evaluate(material.law(), below)[0]).all()
    assert evaluate(material.law(), beyond)[2] == -1.0
