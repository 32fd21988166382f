"""Nominal stress of every loading of a homogeneous specimen, against formulas written anew."""

import numpy as np
import pytest

from study.ground.errors import InputError
from study.mechanics.material.homogeneous import (
    LOADINGS,
    first_piola,
    loading_in,
    sheared_stretches,
)
from study.mechanics.material.material import Material

MR = Material("mooney-rivlin", {"C10": 0.4, "C01": 0.1}, poisson_ratio=0.49)
SOLIDS = [
    MR,
    Material("gent", {"mu": 0.8, "Jm": 12.0}, poisson_ratio=0.49),
    Material("ogden", {"mu1": 0.7, "alpha1": -4.0}, poisson_ratio=0.49),
    Material("veronda-westmann", {"C1": 0.4, "C2": 1.7}, poisson_ratio=0.49),
]


@pytest.mark.parametrize("material", SOLIDS, ids=lambda m: m.model)
def test_simple_shear_is_that_of_the_full_stress_tensor(material):
    for shear in (-0.6, 0.3, 1.1):
        F = np.eye(3)
        F[0, 1] = shear
        found = LOADINGS["simple-shear"].nominal(material, np.array([shear]))
        assert found.stress[0] == pytest.approx(first_piola(material, F)[0, 1], rel=1e-12)


def test_volumetric_stress_is_the_pressure_on_its_face():
    """Equal stretches: P = K (J - 1) l^2, and d/dC10 comes by K alone."""
    stretch = np.array([0.95, 1.0, 1.02])
    found = LOADINGS["volumetric"].nominal(MR, stretch)
    expected = MR.bulk * (stretch**3 - 1) * stretch**2
    assert found.stress == pytest.approx(expected, rel=1e-14, abs=1e-14)
    assert found.gradient["C10"] == pytest.approx(2 * expected / MR.mu0, rel=1e-12, abs=1e-12)
    for one in stretch:
        tensor = first_piola(MR, one * np.eye(3))
        assert LOADINGS["volumetric"].nominal(MR, np.array([one])).stress[0] == pytest.approx(
            tensor[0, 0], rel=1e-12, abs=1e-13
        )


def test_an_incompressible_solid_has_no_volumetric_test():
    fixed = Material("neo-hookean", {"C10": 0.5}, incompressible=True)
    with pytest.raises(InputError, match="poisson_ratio"):
        LOADINGS["volumetric"].nominal(fixed, np.array([0.9]))


@pytest.mark.parametrize("prestretch", [0.75, 1.0, 1.25])
def test_a_stretched_specimen_is_sheared(prestretch):
    """Mooney-Rivlin: I1 = 2/l + l^2 + g^2 and I2 = 2 l + 1/l^2 + g^2/l, P_12 = dW/dg."""
    shear = np.array([-0.9, -0.3, 0.0, 0.1, 1.3])
    found = loading_in("simple-shear", prestretch).nominal(MR, shear)
    by = {"C10": 2 * shear, "C01": 2 * shear / prestretch}
    exact = sum(MR.constants[name] * by[name] for name in by)
    assert found.stress == pytest.approx(exact, rel=1e-12, abs=1e-18)
    for name in by:
        assert found.gradient[name] == pytest.approx(by[name], rel=1e-12, abs=1e-18)


@pytest.mark.parametrize("prestretch", [0.8, 1.2])
def test_a_stretched_ogden_solid_is_sheared_as_its_full_stress_tensor_says(prestretch):
    solid = Material("ogden", {"mu1": 6e-4, "alpha1": -24.0}, poisson_ratio=0.4995)
    F = np.diag([prestretch**-0.5, prestretch, prestretch**-0.5])[:, :, None].copy()
    F[0, 1] = 0.2
    found = loading_in("simple-shear", prestretch).nominal(solid, np.array([0.2]))
    assert found.stress == pytest.approx(first_piola(solid, F)[0, 1], rel=1e-10)
    longest, across, shortest = sheared_stretches(np.array([0.2]), prestretch)
    assert longest * across * shortest == pytest.approx(1.0)
    assert longest == pytest.approx(np.linalg.svd(F[:, :, 0])[1][0], rel=1e-12)
