"""What the tests know, in the units of their curves: combinations known another way."""

import json

import numpy as np
import pytest

from study import api
from study.ground.curve import Curve
from study.mechanics.calibration.fit import fit
from study.mechanics.calibration.identifiability import identify
from study.mechanics.calibration.residual_function import MeasuredCurve
from tests.calibration.cylinder import predictor, virtual
from tests.cli.small import case_file, recorded, success

pytestmark = pytest.mark.usefixtures("undrawn")

MOONEY = ("C10", "C01")
TRUTH = np.array([7e-3, 1e-3])


def identified(mode, depth, noise=0.02, sign=1.0, names=MOONEY, truth=TRUTH, model="mooney-rivlin",
               points=60):  # fmt: skip
    predict, d = predictor(model, names, depth, mode=mode, sign=sign, points=points)
    data = virtual(predict, truth, d, noise, np.random.default_rng(2011))
    found = fit(predict, data, names, truth)
    known = identify(found, data)
    return found, known


def test_tension_to_small_strain_knows_only_the_sum():
    """Small-strain elasticity has one shear modulus, 2 (C10 + C01), whatever the test."""
    for mode in ("uniaxial", "equibiaxial"):
        found, known = identified(mode, 0.3)
        stiff = known.directions[0]
        assert list(stiff.combination) == ["C10", "C01"]
        # at 1 % the coefficients of the sum differ by the strain itself
        assert stiff.combination["C01"] == pytest.approx(1.0, abs=0.03)
        assert stiff.value == pytest.approx(8e-3, rel=0.03)
        assert stiff.is_known
        assert not known.directions[1].is_known
        assert not any(one.is_known for one in known.constants)
        assert "C01 alone is not" in known.sentence


def test_equibiaxial_stretch_of_half_tells_the_constants_apart():
    """Treloar: the stress over its neo-Hookean part is C10 + l^2 C01, from 1 to 2.25 times."""
    _, known = identified("equibiaxial", 15.0)
    assert all(one.is_known for one in known.constants)
    assert all(one.is_known for one in known.directions)
    assert known.directions[0].combination["C01"] > 1.5
    assert known.directions[0].combination["C01"] < 2.25


def test_combination_does_not_depend_on_the_unit_of_a_constant():
    """Two columns, the second 0.005 of the first but for a bend: in lengths of themselves."""
    d = np.linspace(0.1, 1.0, 50)
    rng = np.random.default_rng(1)
    for factor in (1.0, 1e6):
        columns = np.stack([d, 0.005 * factor * (d + 1e-3 * d**2)], axis=1)
        truth = np.array([7.0, 1.5 / factor])

        def predict(x, columns=columns):
            slopes = {"C10": columns[:, 0], "C20": columns[:, 1]}
            return [Curve(d, columns @ x, force_gradient=slopes)]

        noise = 0.005 * rng.normal(size=d.size)
        data = [MeasuredCurve("sphere", Curve(d, columns @ truth + noise))]
        known = identify(fit(predict, data, ("C10", "C20"), truth), data)
        stiff = known.directions[0]
        assert stiff.combination["C20"] == pytest.approx(0.005 * factor, rel=2e-3)
        assert stiff.relative < 1e-3
        ten, twenty = known.constants
        assert not twenty.is_known
        assert twenty.refitted_N < 0.1 * known.noise_N
        assert known.noise_N == pytest.approx(0.005, rel=0.3)


def test_a_constant_that_is_zero_is_known_where_its_interval_moves_no_force():
    names, truth = ("C10", "C20"), np.array([7e-3, 0.0])
    asked = (-1.0, names, truth, "reduced-polynomial", 1000)
    found, known = identified("uniaxial", 15.0, 0.05, *asked)
    assert abs(found.values[1]) < 3 * found.standard_error[1]
    assert known.constants[1].is_known
    assert found.identifiable
    # at a tenth of the strain, and noise of 7 % of the force, C20 may be anything
    found, known = identified("uniaxial", 1.5, 0.3, *asked)
    assert not known.constants[1].is_known
    assert not found.identifiable


SPHERE = """
schema = 1
[specimen]
shape = "cylinder"
radius = "25 mm"
height = "30 mm"
[model]
mesh = "coarse"
[material]
model = "reduced-polynomial"
{material}
poisson_ratio = 0.495
"""
LOADED = 'kind = "indentation", interface = "frictionless", displacement = "2 mm"'
LOADED += ', indenter = { shape = "sphere", radius = "10 mm" }'


def test_a_sphere_knows_a_combination_that_the_verb_says(tmp_path):
    """The weight of C20 from two simulations that differ in C20, without any gradient."""
    forces = []
    for twenty in (1.0, 1.2):
        text = SPHERE.format(material=f'C10 = "7 kPa"\nC20 = "{twenty} kPa"')
        curve = api.solve(case_file(tmp_path, f"test = {{ {LOADED}, steps = 20 }}\n", text)).curve
        forces.append(curve.force_N)
    force, by_twenty = forces[0], (forces[1] - forces[0]) / 0.2
    by_ten = (force - by_twenty) / 7.0  # the force is of first degree in all moduli
    weight = np.linalg.norm(by_twenty) / np.linalg.norm(by_ten)
    noise = 0.002 * force[-1] * np.random.default_rng(7).normal(size=force.size)
    columns = {"displacement": ("mm", curve.displacement_mm), "force": ("N", force + noise)}
    test = recorded(tmp_path, "a", LOADED, columns, ', points = "raw"')
    path = case_file(tmp_path, SPHERE.format(material="order = 2"), test)
    said = success("calibrate", path, "--data", tmp_path, "--results", tmp_path / "r").out
    document = json.loads((tmp_path / "r/case/calibration.json").read_text())
    found = document["identifiability"]
    stiff = found["directions"][0]
    # it moves with C20 itself
    assert stiff["coefficients"]["C20"] == pytest.approx(weight, rel=0.1)
    assert weight < 0.05
    assert stiff["value"] == pytest.approx(7.0 + weight, rel=0.01)
    assert stiff["known"]
    assert not found["constants"]["C20"]["known"]
    assert "C20 alone is not" in said
    assert f"{stiff['combination']} is known to" in said
