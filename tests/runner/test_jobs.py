"""A study is expanded without side effects, and what is equal is computed once."""

import pytest

from study.harness.design.load import loads
from study.harness.runner.batch import expand
from study.simulation import case
from study.simulation.cell import Case, Cell, CellProblem
from study.simulation.job import CaseJob, FitJob, FitResult, ScorePair, fit_problem

from .conftest import DESIGN

PROBLEM = CellProblem.of({
    "specimen": {"shape": "cylinder", "radius_mm": 5.0, "height_mm": 5.0},
    "test": {"kind": "compression", "steps": 2},
    "material": {"model": "neo-hookean", "poisson_ratio": 0.49},
})  # fmt: skip


def test_a_mesh_is_changed_in_the_problem_of_the_calibration_too():
    cell = Cell(PROBLEM, "auto", fitted_elsewhere=PROBLEM.loaded(steps=7))
    found = cell.on_mesh(mesh_size_mm=2.0)
    both = found.problem.model, found.fitted_elsewhere.model
    assert [model.mesh_size_mm for model in both] == [2.0, 2.0]
    assert found.fitted_elsewhere.test.steps == 7
    assert cell.problem.model.mesh_size_mm is None


def test_where_a_prediction_comes_from_is_said_once(one_mix):
    for method, expected in (
        ("auto", {"frictionless": "simulation", "bonded": "fit"}),
        ("inverse-fem", {"frictionless": "fit", "bonded": "fit"}),
    ):
        text = f'{DESIGN}\n[calibration]\nmethod = "{method}"\n'
        jobs = expand(loads(text, "small.toml"), one_mix).jobs
        assert {j.case.levels["plates"]: j.forward for j in jobs} == expected


@pytest.mark.parametrize(("depth", "stable"), [(3.0, True), (7.0, False)])
def test_a_record_judges_its_fit_over_the_simulated_test(depth, stable):
    gauge = CellProblem.of({
        "specimen": {"shape": "homogeneous", "area_mm2": 20.0, "height_mm": 10.0},
        "test": {"kind": "compression"},
        "material": {"model": "reduced-polynomial", "order": 2, "incompressible": True},
    })  # fmt: skip
    cell = Cell(gauge, "auto")
    # its data end at a third of the height
    pair = ScorePair("all", None, FitJob(fit_problem(cell), (), key="fit"), pressed_mm=depth)
    fit = {"values": {"C10": 1.0, "C20": -0.05}, "stable": True, "stability": "stable to 0.7"}
    job = CaseJob(Case({}, cell, None, "case"), (pair,), "hash")
    task = job.sent({pair.fit_key: FitResult("converged", fit)})
    judged = case._fits(task)["all"]
    assert judged["stable"] is stable
    sentence = "over its data: stable to 0.7; in the simulated test: unstable (Drucker)"
    assert judged["stability"].startswith("stable to 0.7" if stable else sentence)
