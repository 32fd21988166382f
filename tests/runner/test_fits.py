"""Calibration of one material: recovery, start values, sharing, and what may not enter."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from study.ground.curve import Curve
from study.mechanics.forward import closed_form, finite_element
from study.mechanics.material.material import Material
from study.mechanics.mesh.mesher import mesh_size
from study.mechanics.setup.geometry import Cylinder
from study.simulation import fit_task
from study.simulation.cell import Cell, CellProblem
from study.simulation.fit_task import fitted
from study.simulation.job import FitJob, FitResult, fit_key, fit_problem

from .conftest import compressed
from .fake_worker import BONDED, solve

SPECIMEN = Cylinder(25.0, 30.0)
DEPTHS = np.linspace(0.3, 6.0, 60)


config = partial(compressed, space="3d", element_order="linear", mesh="coarse")


def calibration_of(document):
    return fit_problem(Cell(CellProblem.of(document), "auto"))


def curve(model, constants):
    return closed_form.homogeneous(
        SPECIMEN,
        Material(model, constants, poisson_ratio=0.4995),
        DEPTHS,
    )


def bonded(free, share=1.0):
    """Force that the fake solver gives between bonded plates."""
    size = mesh_size(CellProblem.of(config("neo-hookean", "bonded")).at({"C10": 1.0}).setup)
    return Curve(free.displacement_mm, share * BONDED * (1 + 1e-3 * size) * free.force_N)


@pytest.mark.parametrize(
    ("model", "order", "truth"),
    [
        ("neo-hookean", None, {"C10": 8e-3}),
        ("mooney-rivlin", None, {"C10": 7e-3, "C01": 1e-3}),
        ("reduced-polynomial", 2, {"C10": 9e-3, "C20": -2e-3}),
        ("reduced-polynomial", 3, {"C10": 8e-3, "C20": -2e-3, "C30": 3e-3}),
        ("ogden", 1, {"mu1": 16e-3, "alpha1": 3.0}),
        ("linear-elastic", None, {"youngs_modulus": 40e-3}),
    ],
)
def test_closed_form_recovers_the_constants_of_exact_data(model, order, truth):
    problem = calibration_of(config(model, "frictionless", order=order))
    assert problem.method == "closed-form"
    found = fitted(FitJob(problem, (curve(model, truth),)))
    assert found.status == "converged", found.message
    # V40: noise-free recovery to 1e-10 of an analytic model; RP3 is the worst conditioned
    assert found.constants == pytest.approx(truth, rel=1e-7, abs=1e-12)
    assert found.fit["rss"] == pytest.approx(0.0, abs=1e-12)


def of_two_constants():
    """A second-order solid on a mesh that no cheaper problem goes before."""
    coarse = {"space": "axisymmetric", "element_order": "linear", "mesh": "coarse"}
    return {**config("reduced-polynomial", "bonded", order=2), "model": coarse}


def test_equal_problems_of_one_constant_are_solved_once(monkeypatch):
    problems = []

    def counted(problem, **options):
        problems.append(problem)
        return solve(problem, **options)

    monkeypatch.setattr(finite_element, "solve", counted)
    problem = calibration_of(config("neo-hookean", "bonded"))
    base = curve("neo-hookean", {"C10": 8e-3})
    for share in (1.0, 2.5):
        found = fitted(FitJob(problem, (bonded(base, share),)))
        assert found.constants == pytest.approx({"C10": share * 8e-3}, rel=2e-3)
        assert found.fit["solves"] == 1
    assert len(problems) == 1
    shallower = replace(base, displacement_mm=0.9 * base.displacement_mm)
    fitted(FitJob(problem, (shallower,)))
    assert len(problems) == 2


def test_a_solver_that_stops_is_a_rejected_step_and_a_status(monkeypatch):
    calls = []

    def stops(problem, **options):
        calls.append(1.0)
        found = solve(problem)
        if len(calls) > 1:
            return replace(found, status="not-converged", message="stopped")
        return found

    monkeypatch.setattr(finite_element, "solve", stops)
    problem = calibration_of(of_two_constants())
    found = fitted(FitJob(problem, (curve("neo-hookean", {"C10": 8e-3}),)))
    assert found.status == "at-edge"  # its stiffness alone needs no other solution
    assert len(calls) > 2  # it tried shorter steps before it gave up


def test_a_solver_that_stops_from_a_warm_start_is_asked_again(monkeypatch):
    warm = []

    def lost(problem, **options):
        found = solve(problem)
        warm.append(options["warm"] is not None)
        if warm[-1]:
            return replace(found, status="not-converged", message="stopped")
        return found

    truth = {"C10": 7e-3, "C20": -1e-3}
    measured = bonded(curve("reduced-polynomial", truth))
    monkeypatch.setattr(finite_element, "solve", lost)
    problem = calibration_of(of_two_constants())
    found = fitted(FitJob(problem, (measured,)))
    assert found.status == "converged", found.message
    assert found.constants == pytest.approx(truth, rel=2e-3)
    # every simulation after the first is done twice
    assert warm == [False, *[True, False] * (len(warm) // 2)]
    assert len(warm) == found.fit["solves"] > 2


def test_a_failed_start_is_told_and_not_replaced_by_another():
    problem = calibration_of(config("mooney-rivlin", "bonded"))
    start = FitResult.from_json({"status": "crashed", "message": "crashed (signal 9), twice"})
    task = FitJob(problem, (curve("neo-hookean", {"C10": 8e-3}),), start)
    found = fitted(task)
    assert found.status == "crashed"
    assert "the fit that starts it" in found.message


def test_space_and_elements_do_not_enter_a_closed_form():
    one, other = config("neo-hookean", "frictionless"), config("neo-hookean", "frictionless")
    other["model"] = {"space": "axisymmetric", "element_order": "quadratic", "mesh": "fine"}
    other["test"]["steps"] = 20
    data = [curve("neo-hookean", {"C10": 8e-3})]
    assert fit_key(calibration_of(one), data) == fit_key(calibration_of(other), data)
    for document in (one, other):
        document["test"]["interface"] = "bonded"
    assert fit_key(calibration_of(one), data) != fit_key(calibration_of(other), data)


@pytest.mark.parametrize(
    ("model", "order", "given", "expected"),
    [
        ("reduced-polynomial", 3, {"C10": 6e-3}, {"C10": 6e-3, "C20": 0.0, "C30": 0.0}),
        ("reduced-polynomial", 3, {"C10": 6, "C20": -0.4}, {"C10": 6, "C20": -0.4, "C30": 0.0}),
        ("ogden", 2, {"C10": 6e-3}, {"mu1": 6e-3}),  # mu0 = 12 kPa in two terms
    ],
)
def test_higher_constants_start_at_zero(model, order, given, expected):
    problem = CellProblem.of(config(model, "bonded", order=order))
    names, start = fit_task.start_values(problem, [], given)
    values = dict(zip(names, start, strict=True))
    assert {name: values[name] for name in expected} == pytest.approx(expected)
