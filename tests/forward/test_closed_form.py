"""Curves in closed form between their rows, and of indentations, where a fit starts."""

from __future__ import annotations

import numpy as np
import pytest

from study.ground.curve import Curve
from study.ground.errors import InputError
from study.mechanics.forward import finite_element
from study.mechanics.forward.closed_form import at_rows, between_rows, indentation, solution
from study.mechanics.material.material import Material
from study.mechanics.material.relaxation import RelaxationTerm
from study.mechanics.setup.geometry import Cone, Cylinder, Homogeneous
from study.mechanics.setup.setup import Model, Problem, Setup
from study.mechanics.setup.test_kind import Test
from study.simulation import fit_task
from study.simulation.cell import Cell, CellProblem
from study.simulation.job import fit_problem
from tests.fem.problems import LONG

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


HIGH = 1e9
NEO_HOOKEAN = 6e-3
INDENTERS = {
    "flat": {"shape": "flat", "radius_mm": 8.0, "edge_radius_mm": 1.0},
    "cone": {"shape": "cone", "half_angle_deg": 45.0, "tip_radius_mm": 2.0},
    "needle": {"shape": "cone", "half_angle_deg": 30.0, "tip_radius_mm": 1.0,
               "shaft_radius_mm": 3.0},
    "sphere": {"shape": "sphere", "radius_mm": 8.0},
}  # fmt: skip
SPECIMENS = {
    "thick cylinder": {"shape": "cylinder", "radius_mm": 25.0, "height_mm": 30.0},
    "thin cylinder": {"shape": "cylinder", "radius_mm": 25.0, "height_mm": 8.0},
    "thick block": {"shape": "block", "width_mm": 60.0, "depth_mm": 60.0, "height_mm": 40.0},
    "thin block": {"shape": "block", "width_mm": 60.0, "depth_mm": 60.0, "height_mm": 8.0},
}


def test_a_rounded_tip_and_a_shaft():
    """A rounded tip lies its own rounding deeper than a sharp one; a shaft goes on as a punch."""
    depth = np.array([20.0, 30.0])
    sharp = indentation(Cone(45.0), depth + (np.sqrt(2) - 1) * 0.2, height_mm=HIGH)
    rounded = indentation(Cone(45.0, tip_radius_mm=0.2), depth, height_mm=HIGH)
    assert rounded == pytest.approx(sharp, rel=1e-4)
    shaft = indentation(Cone(45.0, shaft_radius_mm=3.0), depth, height_mm=HIGH)
    assert np.diff(shaft) == pytest.approx(2 * 3.0 * 10.0 / 0.75)


def setting(indenter, specimen, nu=0.4995):
    own = SPECIMENS[specimen]
    return {
        "specimen": own,
        "test": {"kind": "indentation", "interface": "frictionless", "base": "bonded",
                 "displacement_mm": min(5.0, 0.3 * own["height_mm"]), "steps": 10,
                 "indenter": INDENTERS[indenter]},
        "material": {"model": "neo-hookean", "constants": {}, "poisson_ratio": nu},
        "model": {"space": "axisymmetric", "element_order": "quadratic", "mesh": "coarse"},
    }  # fmt: skip


def calibrated(document, measured):
    problem = fit_problem(Cell(CellProblem.of(document), "auto"))
    return fit_task.fitted(fit_task.FitJob(problem, (measured,)))


def virtual(config):
    solution = finite_element.solve(
        CellProblem.of(config).at({"C10": NEO_HOOKEAN}), gradients=False
    )
    assert solution.status == "converged", solution.message
    return Curve(solution.curve.displacement_mm, solution.curve.force_N)


FITS = [  # each indenter and each specimen once in the suite, all pairs in the long verification
    pytest.param(indenter, specimen, marks=() if i == k else LONG)
    for i, indenter in enumerate(INDENTERS)
    for k, specimen in enumerate(SPECIMENS)
]


@pytest.mark.parametrize(("indenter", "specimen"), FITS)
def test_an_indentation_fit_starts_near_its_end(indenter, specimen):
    """Large strains, a layer and a finite width are in the data: a factor of 1.25 at most."""
    config = setting(indenter, specimen)
    measured = virtual(config)
    _, start = fit_task.start_values(CellProblem.of(config), [measured], None)
    assert 1 / 1.25 < start[0] / NEO_HOOKEAN < 1.25
    found = calibrated(config, measured)
    assert found.status == "converged"
    assert found.constants["C10"] == pytest.approx(NEO_HOOKEAN, rel=1e-6)
    # the force is proportional to C10
    assert found.fit["solves"] == 1
