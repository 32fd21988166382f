"""P03, P06 and P07: relations that hold for any deformation gradient."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from study.mechanics.material.homogeneous import first_piola
from study.mechanics.material.material import Material
from tests.material.modes import FOAM

#: positive constants: polyconvex, so that the energy has its only minimum at rest
STABLE = [
    ("neo-hookean", {"C10": 0.5}),
    ("mooney-rivlin", {"C10": 0.4, "C01": 0.1}),
    ("reduced-polynomial", {"C10": 0.5, "C20": 0.1, "C30": 0.02}),
    ("polynomial", {"C10": 0.3, "C01": 0.1, "C11": 0.05, "C02": 0.02}),
    ("yeoh", {"C10": 0.5, "C20": 0.1, "C30": 0.02}),
    ("arruda-boyce", {"mu": 0.8, "lambda_m": 3.0}),
    ("gent", {"mu": 0.8, "Jm": 40.0}),
    ("extended-tube", {"Gc": 0.4, "Ge": 0.5, "beta": 0.6, "delta": 0.1}),
    ("van-der-waals", {"mu": 0.7, "lambda_m": 7.0, "a": 0.1, "beta": 0.2}),
    ("fung", {"mu": 0.6, "b": 0.2}),
    ("ogden", {"mu1": 0.6, "alpha1": 1.3, "mu2": 0.3, "alpha2": 5.0, "mu3": 0.1, "alpha3": -2.0}),
]
materials = st.one_of(
    st.builds(
        lambda pair, bulk: Material(*pair, bulk_modulus=bulk),
        st.sampled_from(STABLE),
        st.floats(20, 1e4),
    ),
    st.just(FOAM),
)
stretches = st.tuples(*[st.floats(0.6, 2.0)] * 3)
angles = st.tuples(*[st.floats(-3, 3)] * 3)


def _rotation(angle):
    return Rotation.from_rotvec(angle).as_matrix()


def _gradient(stretch, angle, other):
    """Deformation gradient with given principal stretches and J between 0.8 and 1.2."""
    s = np.array(stretch)
    s *= (np.clip(s.prod(), 0.8, 1.2) / s.prod()) ** (1 / 3)
    return _rotation(angle) @ np.diag(s) @ _rotation(other).T


@given(materials, stretches, angles, angles, angles)
def test_objectivity_and_isotropy(material, stretch, angle, other, third):
    F, Q = _gradient(stretch, angle, other), _rotation(third)
    stress, scale = first_piola(material, F), material.bulk
    # stresses go with powers of the stretch up to l^5 / 0.6: a hundred times the rounding
    assert first_piola(material, Q @ F) == pytest.approx(Q @ stress, abs=1e-11 * scale)
    assert first_piola(material, F @ Q) == pytest.approx(stress @ Q, abs=1e-11 * scale)


@settings(max_examples=20)
@given(materials, stretches, angles, angles)
def test_the_stress_derives_from_an_energy(material, stretch, angle, other):
    """Its tangent has major symmetry, which no stress without a potential has."""
    F, h = _gradient(stretch, angle, other), 1e-6
    steps = h * np.eye(9).reshape(9, 3, 3)
    rows = [
        (first_piola(material, F + d) - first_piola(material, F - d)).ravel() / (2 * h)
        for d in steps
    ]
    tangent = np.array(rows)
    assert tangent == pytest.approx(tangent.T, abs=1e-7 * material.bulk)


@pytest.mark.parametrize("pair", STABLE, ids=lambda p: p[0])
def test_rest_and_rigid_motion_are_free_of_stress(pair):
    material = Material(*pair, bulk_modulus=1000)
    Q = _rotation((0.3, -1.0, 2.0))
    for F in (np.eye(3), Q):
        # V08: 1e-12 mu at rest; a rotation matrix has J = 1 to 4e-16, times K = 1000
        assert first_piola(material, F) == pytest.approx(np.zeros((3, 3)), abs=2e-12)


@given(stretches, angles, angles, st.floats(0.05, 1), st.floats(0.05, 1))
def test_energies_collapse_into_each_other(stretch, angle, other, c10, c01):
    F = _gradient(stretch, angle, other)
    given_bulk = {"bulk_modulus": 100.0}
    nh = Material("neo-hookean", {"C10": c10}, **given_bulk)
    mr = Material("mooney-rivlin", {"C10": c10, "C01": c01}, **given_bulk)
    pairs = [
        (nh, Material("ogden", {"mu1": 2 * c10, "alpha1": 2.0}, **given_bulk)),
        (nh, Material("reduced-polynomial", {"C10": c10}, **given_bulk)),
        (nh, Material("polynomial", {"C10": c10, "C01": 0.0}, **given_bulk)),
        (mr, Material("polynomial", {"C10": c10, "C01": c01}, **given_bulk)),
        (
            mr,
            Material(
                "ogden",
                {"mu1": 2 * c10, "alpha1": 2.0, "mu2": 2 * c01, "alpha2": -2.0},
                **given_bulk,
            ),
        ),
    ]
    for one, same in pairs:
        # P06: 1e-12 of the largest modulus, K
        assert first_piola(same, F) == pytest.approx(first_piola(one, F), abs=1e-10)
