"""Drucker's criterion, Biot's limits and what a user may not give."""

import numpy as np
import pytest
from scipy.optimize import brentq

from study.ground.errors import InputError
from study.mechanics.material.homogeneous import UNIAXIAL, response
from study.mechanics.material.material import Material, is_constant
from study.mechanics.material.polynomial import index_pair
from study.mechanics.material.stability import (
    BIOT_LIMITS,
    BIOT_ROOT,
    check,
    stability,
    surface_warning,
    tangent,
)
from study.simulation.cell import CellProblem
from study.simulation.job import stability_over

RP2 = {"C10": 9.1e-3, "C20": -2.5e-3}  # the closed-form fit of a silicone mix at 20 %


def _rp2(**constants):
    return Material("reduced-polynomial", {**RP2, **constants}, incompressible=True)


def test_softening_constants_name_the_stretch():
    verdict = stability(_rp2(), [0.3, 1.0])
    assert not verdict.stable
    limit = verdict.limits["uniaxial"]
    assert f"in uniaxial loading below stretch {limit:.4f}" in verdict.sentence
    # at the limit the determinant of the tangent vanishes, on one side only
    inside, outside = (
        np.linalg.det(tangent(_rp2(), UNIAXIAL, s)[:, :, 0]) for s in (limit + 1e-6, limit - 1e-6)
    )
    assert inside > 0 > outside
    assert stability(_rp2(), [0.9, 1.0]).stable


def test_uniaxial_limit_is_no_later_than_the_peak_of_true_stress():
    verdict = stability(_rp2(), [0.3, 1.0])
    stretch = np.linspace(1.0, 0.3, 7001)
    true = stretch * response(_rp2(), "uniaxial", stretch).stress
    turning = stretch[np.argmin(true)]
    # along the path d tau / d eps = det D / (a sum of its entries): both vanish together or
    # the determinant does first
    assert verdict.limits["uniaxial"] >= turning - 1e-3


def test_negative_shear_modulus_is_unstable_from_the_start():
    material = Material("mooney-rivlin", {"C10": 0.1, "C01": -0.2}, incompressible=True)
    assert "from the start" in stability(material).sentence


def test_biot_limits():
    assert pytest.approx(1, abs=1e-15) == BIOT_ROOT**3 + BIOT_ROOT**2 + 3 * BIOT_ROOT
    # V45 prints six digits
    assert BIOT_LIMITS["planar"] == pytest.approx(0.543689, abs=5e-7)
    assert BIOT_LIMITS["equibiaxial"] == pytest.approx(0.666142, abs=5e-7)
    assert BIOT_LIMITS["uniaxial"] == pytest.approx(0.443746, abs=5e-7)
    material = Material("neo-hookean", {"C10": 0.5}, incompressible=True)
    assert surface_warning(material.energy, "uniaxial", 0.5) == ""
    assert "Biot" in surface_warning(material.energy, "uniaxial", 0.4)


@pytest.mark.parametrize("name", ["C00", "C000", "C010", "D10"])
def test_no_constant_has_two_names(name):
    with pytest.raises(InputError, match="is not a polynomial constant"):
        index_pair(name)
    assert not is_constant(name)
    assert index_pair("C100") == (10, 0)


def test_implausible_modulus_warns_about_units():
    assert check(_rp2(), [0.9, 1]) == ()
    (warning,) = check(Material("neo-hookean", {"C10": 5000.0}, incompressible=True))
    assert "check the units" in warning


def test_every_loading_is_judged_over_the_stretches_of_its_tests():
    """Yeoh with a negative second term: lost beyond a stretch that no single test must hide."""
    material = Material("reduced-polynomial", {"C10": 1.0, "C20": -0.01}, incompressible=True)
    lost = stability(material, [1.0, 6.0]).limits
    assert 1 < lost["equibiaxial"] < lost["uniaxial"] < 6
    end = lost["uniaxial"]
    tension = (homogeneous("tension"), np.linspace(0, 10 * (end - 1) * 1.05, 20))
    pressed = (homogeneous("compression"), np.linspace(0, 3.0, 20))
    for tests in ([tension], [pressed, tension], [tension, pressed]):
        judged = stability_over(material, tests)
        assert not judged.stable
        assert judged.limits["uniaxial"] == pytest.approx(end)
    short = (homogeneous("tension"), np.linspace(0, 10 * (lost["equibiaxial"] - 1) * 0.9, 20))
    biaxial = (homogeneous("equibiaxial"), np.linspace(0, 2.0, 20))
    judged = stability_over(material, [short, pressed, biaxial])
    assert judged.stable
    assert "equibiaxial loading from stretch 1 to 1.2" in judged.sentence
    assert "uniaxial loading from stretch 0.7 to" in judged.sentence


def test_a_loss_of_ellipticity_is_said_too():
    """Hencky's quadratic logarithm: Drucker holds, ellipticity ends at a ratio of stretches."""
    hencky = Material("ogden", {"mu1": 1.0, "alpha1": 1e-3}, incompressible=True)
    half = brentq(lambda d: d * np.tanh(d) - 1, 0.5, 2.0)
    lost = np.exp(2 * half) ** (2 / 3)  # of stretches l and l^-1/2
    for share, stable in ((0.98, True), (1.02, False)):
        tension = (homogeneous("tension"), np.linspace(0, 10 * (share * lost - 1), 9))
        judged = stability_over(hencky, [tension])
        assert judged.stable == stable
    end = float(judged.sentence.partition("not elliptic in uniaxial loading at stretch ")[2])
    assert end == pytest.approx(lost, rel=0.01)


def homogeneous(kind):
    specimen = {"shape": "homogeneous", "area_mm2": 20.0, "height_mm": 10.0}
    return CellProblem.of({"specimen": specimen, "test": {"kind": kind}}).setup
