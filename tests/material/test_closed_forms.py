"""V01-V07 at the material point: every energy in every homogeneous test."""

import csv
from pathlib import Path

import numpy as np
import pytest

from study.ground.errors import InputError
from study.mechanics.material.homogeneous import LOADINGS, MODES, first_piola, response
from study.mechanics.material.material import Material
from study.mechanics.material.stability import stability
from tests.material.modes import FOAM, confined, equibiaxial, planar, solid, uniaxial

ROOT = Path(__file__).resolve().parents[2]
with open(ROOT / "validation" / "material_points.csv", newline="", encoding="utf-8") as _file:
    POINTS = list(csv.DictReader(_file))


def _material(row):
    constants = dict(pair.split("=") for pair in row["constants"].split())
    values = {name: float(value) for name, value in constants.items()}
    if row["bulk_modulus"] == "inf":
        return Material(row["model"], values, incompressible=True)
    return Material(row["model"], values, bulk_modulus=float(row["bulk_modulus"]))


@pytest.mark.parametrize(
    "row", POINTS, ids=lambda r: "-".join([r["constants"], r["test"], r["stretch"], r["quantity"]])
)
def test_published_material_points(row):
    state = response(_material(row), row["test"], float(row["stretch"]))
    expected = float(row["expected"])
    # the tables print 10 decimals, or 9 for free stretches and J and 9 digits for P at finite K
    half_unit = 0.6 * 10.0 ** -len(row["expected"].split(".")[1])
    assert getattr(state, row["quantity"])[0] == pytest.approx(expected, rel=1e-10, abs=half_unit)


def test_zero_exponent_is_the_logarithmic_limit():
    x = np.array([0.4, 0.999, 1.0, 1.7])
    zero = Material("ogden", {"mu1": 1.0, "alpha1": 0.0}, incompressible=True)
    # P = sigma/x with sigma = 2 mu ln(x / x^(-1/2)) = 3 mu ln x
    assert uniaxial(zero, x) == pytest.approx(3 * np.log(x) / x, rel=1e-13, abs=1e-15)
    tiny = Material("ogden", {"mu1": 1.0, "alpha1": 1e-9}, incompressible=True)
    assert uniaxial(tiny, x) == pytest.approx(uniaxial(zero, x), rel=1e-8)


MATERIALS = [
    Material("neo-hookean", {"C10": 0.5}, poisson_ratio=0.49),
    Material("mooney-rivlin", {"C10": 0.4, "C01": 0.1}, poisson_ratio=0.4995),
    Material("mooney-rivlin", {"C10": 0.4, "C01": 0.1}, incompressible=True),
    Material("reduced-polynomial", {"C10": 0.5, "C20": -0.05, "C30": 0.02}, bulk_modulus=20),
    Material("polynomial", {"C10": 0.3, "C01": 0.1, "C11": 0.05, "C02": 0.02}, poisson_ratio=0.45),
    Material("ogden", {"mu1": 1, "alpha1": 4}, incompressible=True),
    Material("ogden", {"mu1": 0.6, "alpha1": 1.3, "mu2": 0.3, "alpha2": 0.0}, poisson_ratio=0.49),
    Material("yeoh", {"C10": 0.5, "C20": -0.05, "C30": 0.02}, poisson_ratio=0.49),
    Material("arruda-boyce", {"mu": 0.8, "lambda_m": 2.5}, poisson_ratio=0.49),
    Material("gent", {"mu": 0.8, "Jm": 12.0}, poisson_ratio=0.49),
    solid("extended-tube", 0.4, 0.5, 0.6, 0.2, poisson_ratio=0.49),
    solid("van-der-waals", 0.7, 5.0, 0.3, 0.2, poisson_ratio=0.49),
    Material("veronda-westmann", {"C1": 0.4, "C2": 1.7}, poisson_ratio=0.49),
    Material("fung", {"mu": 0.6, "b": 0.4}, incompressible=True),
    Material("linear-elastic", {"youngs_modulus": 3.0}, poisson_ratio=0.4),
    Material("linear-elastic", {"youngs_modulus": 3.0}, bulk_modulus=7.0),
    FOAM,
]


@pytest.mark.parametrize("material", MATERIALS, ids=lambda m: m.model)
@pytest.mark.parametrize("name", LOADINGS)
def test_gradients_pass_the_taylor_test(material, name):
    """V41: without the gradient the remainder is first order in the step, with it second."""
    if material.incompressible and LOADINGS[name].is_volumetric:
        pytest.skip("no such test")
    if name == "biaxial" and (material.small_strain or material.compressible is not None):
        pytest.skip("no such closed form")
    x = LOADINGS[name].measure(np.array([-0.4, -0.1, 0.3]))
    if name == "biaxial":  # two directions of three rows, each with a stretch of its own
        x = np.concatenate([x, 1 + np.array([0.2, 0.05, -0.1])])
    state = LOADINGS[name].nominal(material, x)
    # relative steps, small enough that the third order is a twentieth of the second
    size = np.where(material.values == 0, 1, np.abs(material.values))
    direction = 0.02 * size * np.random.default_rng(2011).uniform(0.5, 1, size.size)
    change = sum(d * state.gradient[n] for d, n in zip(direction, material.names, strict=True))
    steps = 0.5 ** np.arange(4)

    def remainder(h):
        changed = material.with_constants(material.values + h * direction)
        moved = LOADINGS[name].nominal(changed, x)
        return np.linalg.norm(moved.stress - state.stress - h * change)

    remainders = np.array([remainder(h) for h in steps])
    if remainders.max() < 1e-11 * np.linalg.norm(state.stress):
        return  # linear in the constants: no remainder at all
    slopes = np.log2(remainders[:-1] / remainders[1:])
    assert np.all((slopes > 1.9) & (slopes < 2.1)), slopes


@pytest.mark.parametrize("material", MATERIALS, ids=lambda m: m.model)
@pytest.mark.parametrize("mode", MODES)
def test_slope_is_the_derivative(material, mode):
    if mode == "confined" and material.incompressible:
        pytest.skip("no such test")
    x, h = np.array([0.6, 0.9, 1.3]), 1e-5
    ahead, behind = (response(material, mode, x + s * h).stress for s in (1, -1))
    # central differences of step 1e-5: truncation 1e-10 of the third derivative, rounding 1e-11
    slope = response(material, mode, x).slope
    assert slope == pytest.approx((ahead - behind) / (2 * h), rel=2e-7)


def test_linear_elastic_moduli():
    material = Material("linear-elastic", {"youngs_modulus": 3.0}, poisson_ratio=0.3)
    assert uniaxial(material, 1.01) == pytest.approx(0.03, rel=1e-12)
    assert equibiaxial(material, 1.01) == pytest.approx(0.03 / 0.7, rel=1e-12)
    assert planar(material, 1.01) == pytest.approx(0.03 / 0.91, rel=1e-12)
    assert confined(material, 1.01) == pytest.approx(0.03 * 0.7 / (1.3 * 0.4), rel=1e-12)


def test_unstable_constants_give_nan_not_an_exception():
    # a negative modulus with K following it has no equilibrium; a fit must survive meeting it
    material = Material("neo-hookean", {"C10": -5.0}, poisson_ratio=0.49)
    assert np.all(np.isnan(uniaxial(material, [0.2, 0.3])))


def test_bad_stretches_and_tests_are_refused():
    material = Material("neo-hookean", {"C10": 0.5}, incompressible=True)
    with pytest.raises(InputError, match="positive"):
        uniaxial(material, [0.5, 0.0])
    with pytest.raises(InputError, match="did you mean 'uniaxial'"):
        response(material, "uniaxail", 1.1)
    with pytest.raises(InputError, match="rigid box"):
        confined(material, 0.9)


@pytest.mark.parametrize(
    ("model", "constants"),
    [
        ("gent", {"mu": 0.8, "Jm": 2.0}),
        ("extended-tube", {"Gc": 0.4, "Ge": 0.5, "beta": 0.6, "delta": 0.7}),
        ("van-der-waals", {"mu": 0.7, "lambda_m": 2.2, "a": 0.3, "beta": 0.0}),
    ],
)
def test_a_state_beyond_the_end_of_chains_is_refused(model, constants):
    """I1 - 3 is at most 2.05 at the limits chosen, and 17.2 at a stretch of 4.5."""
    material = Material(model, constants, bulk_modulus=1e3)
    F = np.diag([4.5, 4.5**-0.5, 4.5**-0.5])
    with pytest.raises(InputError, match="no stress"):
        first_piola(material, F)
    assert np.isnan(uniaxial(material, 4.5))
    stable = stability(material, [1.0, 4.5])
    # uniaxial: l^2 + 2/l - 3 = 2 at l = 2.0; the limit is told where it is
    assert not stable.stable
    assert 1.9 < stable.limits["uniaxial"] < 2.2
