"""Curves in closed form between their rows: the same as if every place had been a row."""

import numpy as np
import pytest

from study.ground.curve import Curve
from study.ground.errors import InputError
from study.mechanics.forward.closed_form import at_rows, between_rows, solution
from study.mechanics.material.material import Material
from study.mechanics.material.relaxation import RelaxationTerm
from study.mechanics.setup.geometry import Cylinder, Homogeneous
from study.mechanics.setup.setup import Model, Problem, Setup
from study.mechanics.setup.test_kind import Test

STRIP = Homogeneous(100.0, 20.0)
SOLID = Material("mooney-rivlin", {"C10": 0.1, "C01": 0.05}, incompressible=True)
GEL = Material("neo-hookean", {"C10": 0.1}, poisson_ratio=0.4)
SLOW = Material(
    "neo-hookean", {"C10": 0.1}, incompressible=True, relaxation=(RelaxationTerm(0.4, 3.0),)
)
CASES = [
    ("tension", STRIP, SOLID, 30.0, {}),
    ("tension", STRIP, GEL, 30.0, {}),
    ("equibiaxial", STRIP, SOLID, 20.0, {}),
    ("planar", STRIP, SOLID, 20.0, {}),
    ("simple-shear", STRIP, SOLID, 20.0, {"prestretch": 1.2}),
    ("volumetric", STRIP, GEL, 5.0, {}),
    ("confined-compression", STRIP, GEL, 8.0, {}),
    ("compression", Cylinder(10.0, 20.0), GEL, 12.0, {"interface": "frictionless"}),
    ("tension", STRIP, SLOW, 30.0, {"speed_mm_per_s": 4.0}),
]


def made(kind, specimen, depth, more):
    return Setup(specimen, Test(kind, displacement_mm=depth, **more), Model())


def dense(setup, material, d):
    """Force where every place is a row of its own."""
    return at_rows(setup, material, Curve(d, np.empty(0))).force_N


@pytest.mark.parametrize(("kind", "specimen", "material", "depth", "more"), CASES)
def test_curve_between_its_rows(kind, specimen, material, depth, more):
    setup = made(kind, specimen, depth, more)
    rows = np.linspace(0, depth, 41)
    curve = between_rows(setup, material, rows)
    np.testing.assert_allclose(curve.force_N, dense(setup, material, rows), rtol=1e-9, atol=1e-12)

    places = 0.5 * (rows[1:] + rows[:-1])
    largest = np.abs(curve.force_N).max()
    apart = curve.force_at(places) - dense(setup, material, places)
    assert np.abs(apart).max() < 2e-6 * largest

    h = 1e-3
    low, high = dense(setup, material, rows[1:] - h), dense(setup, material, rows[1:] + h)
    slope = (high - low) / (2 * h)
    stiffness = curve.stiffness_at(rows[1:])
    np.testing.assert_allclose(stiffness, slope, atol=1e-6 * np.abs(slope).max())
    ahead = dense(setup, material, np.array([0.0, h, 2 * h]))
    begun = (4 * ahead[1] - 3 * ahead[0] - ahead[2]) / (2 * h)
    assert curve.stiffness_at(0.0) == pytest.approx(begun, rel=1e-5)

    fine = np.linspace(0, depth, 20_001)
    work = np.trapezoid(dense(setup, material, fine), fine)
    assert curve.work_Nmm is not None
    assert curve.work_Nmm[-1] == pytest.approx(work, rel=1e-7)


def test_material_without_a_state_ends_its_curve_there():
    weak = Material("ogden", {"mu1": 0.1, "alpha1": -1.0}, incompressible=True)
    limited = Material("gent", {"mu": 0.1, "Jm": 3.0}, incompressible=True)
    for material, depth in ((weak, 30.0), (limited, 40.0)):
        setup = made("tension", STRIP, depth, {})
        found = solution(Problem(setup.specimen, setup.test, material, setup.model))
        stiffness = found.curve.stiffness_N_per_mm
        assert stiffness is not None
        assert np.isfinite(stiffness).all()
        assert np.isfinite(found.curve.force_N).all()
        assert (found.status == "converged") == (found.reached_mm == depth)


def test_a_plate_that_would_pass_the_base_is_refused():
    setup = made("compression", Cylinder(10.0, 20.0), 20.0, {"interface": "frictionless"})
    with pytest.raises(InputError):
        between_rows(setup, GEL, np.array([10.0, 20.0]))
