"""Loss of ellipticity: closed forms, and energies that never get there."""

import numpy as np
import pytest
from scipy.optimize import brentq

from study.mechanics.material.homogeneous import EQUIBIAXIAL, PLANAR, UNIAXIAL
from study.mechanics.material.material import Material
from study.mechanics.material.stability import always_elliptic, ellipticity, tangent

ANYWHERE = np.random.default_rng(5).lognormal(0.0, 0.7, (3, 2000))


def ogden(alpha):
    return Material("ogden", {"mu1": 1.0, "alpha1": alpha}, incompressible=True)


def test_a_neo_hookean_solid_has_the_squares_of_its_stretches():
    """W = C (l1^2 + l2^2 + l3^2 - 3): alpha = 2 C l^2, beta + sqrt(alpha gamma) = C (l1 + l2)^2."""
    rubber = Material("neo-hookean", {"C10": 1.5}, incompressible=True)
    bar = ANYWHERE / np.cbrt(ANYWHERE.prod(axis=0))
    smallest, middle, _ = np.sort(bar, axis=0)
    wanted = np.minimum(2 * smallest**2, (smallest + middle) ** 2) * 1.5
    np.testing.assert_allclose(ellipticity(rubber, ANYWHERE), wanted, rtol=1e-9)


def test_the_undeformed_state_has_the_shear_modulus():
    """alpha = mu and beta + sqrt(alpha gamma) = 2 mu there, for every energy."""
    for material in (ogden(-0.02), ogden(9.0), ogden(1.5)):
        found = ellipticity(material, np.ones((3, 1)))
        assert found == pytest.approx(material.mu0, rel=1e-3)


@pytest.mark.parametrize("alpha", [1e-3, -1e-3])
def test_hencky_gives_way_at_a_ratio_of_stretches(alpha):
    """W = mu sum (ln l)^2: d tanh d = 1 with d half the logarithm of the ratio."""
    d = brentq(lambda d: d * np.tanh(d) - 1, 0.5, 2.0)
    for share, lost in ((0.999, False), (1.001, True)):
        ratio = np.exp(2 * d * share)
        stretch = ratio ** (1 / 3)  # equibiaxial: l, l, l^-2
        found = ellipticity(ogden(alpha), np.array([[stretch], [stretch], [stretch**-2]]))
        assert (found[0] <= 0) == lost


@pytest.mark.parametrize(
    ("model", "constants", "elliptic", "stable"),
    [
        ("neo-hookean", {"C10": 1.0}, True, True),
        ("mooney-rivlin", {"C10": 0.2, "C01": 0.9}, True, True),
        ("mooney-rivlin", {"C10": 1.0, "C01": -0.2}, False, False),
        ("reduced-polynomial", {"C10": 0.2, "C20": 0.3, "C30": 0.1}, True, True),
        ("reduced-polynomial", {"C10": 0.2, "C20": -0.01}, False, False),
        ("polynomial", {"C10": 1, "C01": 1, "C20": 0, "C11": 0.1, "C02": 0}, False, False),
        ("ogden", {"mu1": 1.0, "alpha1": 2.0, "mu2": 0.5, "alpha2": -4.0}, True, True),
        ("ogden", {"mu1": 1.0, "alpha1": 2.0, "mu2": -0.1, "alpha2": 4.0}, False, False),
        ("ogden", {"mu1": 1.0, "alpha1": 0.5, "mu2": 0.1, "alpha2": -4.0}, False, True),
    ],
)
def test_what_is_known_without_looking(model, constants, elliptic, stable):
    """Where ellipticity or Drucker's criterion is said to be known, a scan finds the same."""
    material = Material(model, constants, incompressible=True)
    assert always_elliptic(material) is elliptic
    assert material.isochoric.always_stable(constants) is stable
    if elliptic:
        assert (ellipticity(material, ANYWHERE) > 0).all()
    for mode in (UNIAXIAL, EQUIBIAXIAL, PLANAR) if stable else ():
        d = tangent(material, mode, np.geomspace(0.1, 10.0, 300))
        assert (np.linalg.eigvalsh(np.moveaxis(d, -1, 0)) > 0).all()


def test_a_change_of_volume_does_not_count():
    material = ogden(0.5)
    np.testing.assert_allclose(
        ellipticity(material, 1.3 * ANYWHERE), ellipticity(material, ANYWHERE), rtol=1e-9
    )
