"""A study is expanded without side effects; constants from everything but what is scored."""

from __future__ import annotations

import numpy as np
import pytest

from study.ground.curve import Curve
from study.ground.errors import InputError
from study.harness.design import load
from study.harness.design.load import loads
from study.harness.runner.batch import expand
from study.simulation import case, response
from study.simulation.cell import Case, Cell, CellProblem
from study.simulation.fit_task import fitted
from study.simulation.job import CaseJob, FitJob, FitResult, ScorePair, fit_problem, together
from study.simulation.tasks import Costs
from tests.cli.small import measured, pressed, responses
from tests.runner.test_calibrate import write as write_tests

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


D = np.linspace(0.0, 2.0, 201)
MEASURED = Curve(D, 10 * D)


@pytest.mark.parametrize("factor", [1.1, 0.9])
def test_a_curve_ten_percent_off_is_ten_percent_off_in_every_measure(factor):
    predicted = Curve(D, factor * MEASURED.force_N)
    found = response.score(predicted, MEASURED)
    assert found["relative_rms_force_error"] == {"value": pytest.approx(10.0), "unit": "%"}
    assert found["work_error"] == {"value": pytest.approx(10.0), "unit": "%"}
    assert found["peak_force_error"] == {"value": pytest.approx(2.0), "unit": "N"}
    # RMS of d on [0, 2] is 2/sqrt(3), up to the grid's 1e-4
    assert found["rms_force_error"]["value"] == pytest.approx(2 / np.sqrt(3), rel=5e-3)


BLOCK = 'block = "s"\n'
SPECIMEN = 'leave_out = "specimen"'
TEST = 'leave_out = "test"'
HEIGHTS = """height = ["low", "high", "higher"]
[presets.height.low]
"specimen.height" = "30 mm"
[presets.height.high]
"specimen.height" = "40 mm"
[presets.height.higher]
"specimen.height" = "50 mm"
"""


def write(path, stiffness):
    constants = {"C10": 7e-3, "C20": 1e-3}
    write_tests(path, "reduced-polynomial", constants, depth=12.0, specimens=stiffness)


def expanded(folder, leave_out, *, block=BLOCK, heights="", asked="mu0"):
    """Expand the study of two energies; ``asked`` are its responses."""
    text = pressed(
        '[material]\npoisson_ratio = 0.4995\n[model]\nmesh = "coarse"\n'
        + measured("a.csv")
        + f'{block}points = 30\nrange = ["1 %", "20 %"]\n[calibration]\n{leave_out}\n'
        '[presets.material.rp2]\nmodel = "reduced-polynomial"\norder = 2\n'
        '[presets.material.nh]\nmodel = "neo-hookean"\n'
        '[analysis]\nmodel = 1\n[factors]\nmaterial = ["rp2", "nh"]\n'
        + heights
        + responses(**dict.fromkeys(asked.split(), "")),
        radius=25,
        height=30,
    )
    return expand(load.loads(text), folder)


def constants(work, key):
    job = work.fits[key]
    start = None if job.start is None else constants(work, job.start.key)
    return fitted(FitJob(job.problem, job.measured, start))


def test_a_specimen_is_scored_with_the_constants_of_the_others(tmp_path):
    write(tmp_path / "a.csv", {"A": 1.0, "B": 1.2, "C": 0.9})
    work = expanded(tmp_path, SPECIMEN)
    job = next(j for j in work.jobs if j.case.block == "B" and j.case.levels["material"] == "rp2")
    direction, own = job.directions
    assert direction.fit_label == "all but B"
    assert direction.role == "score"
    # a constant is asked for, and B's comes from B's own curve
    assert (own.fit_label, own.role) == ("B alone", "constants")
    (curve,) = work.fits[own.fit_key or ""].measured
    assert curve.force_N.tolist() == direction.measured.force_N.tolist()
    # the scored curve is B's own, the fitted ones are A's and C's
    fitted = work.fits[direction.fit_key or ""].measured
    ratios = [float(c.force_N[-1] / direction.measured.force_N[-1]) for c in fitted]
    assert ratios == pytest.approx([1 / 1.2, 0.9 / 1.2])
    found = constants(work, direction.fit_key or "")
    assert found.converged
    assert found.fit["n"] == 60
    assert found.constants == pytest.approx(
        {"C10": 0.95 * 7e-3, "C20": 0.95e-3},
        abs=3e-6,  # the curve is resampled linearly
    )
    # three blocks and two energies: a score and a constant each, none of their fits shared
    assert len({d.fit_key for j in work.jobs for d in j.directions}) == 12


def test_a_test_is_scored_with_the_constants_of_the_other_tests(tmp_path):
    write(tmp_path / "a.csv", {"A": 1.0, "B": 1.2})
    work = expanded(tmp_path, TEST, heights=HEIGHTS)
    levels = {"material": "rp2", "height": "high"}
    job = next(j for j in work.jobs if j.case.block == "A" and j.case.levels == levels)
    (direction,) = job.directions
    assert direction.fit_label == "all other tests"
    problem = work.fits[direction.fit_key or ""].problem
    assert problem.method == "together"
    assert [t.problem.height_mm for t in problem.tests] == [30.0, 50.0]
    assert [t.method for t in problem.tests] == ["closed-form", "closed-form"]
    found = constants(work, direction.fit_key or "")
    assert found.converged
    # one force for two heights: 20 % of each, so that the constants lie between both
    assert 7e-3 < found.constants["C10"] < 7e-3 * 5 / 3


def test_a_fit_to_several_tests_costs_what_its_tests_do():
    """It was expected to take no time and no memory, so that as many ran at once as would fit."""
    cylinder = {"shape": "cylinder", "radius_mm": 10.0, "height_mm": 10.0}
    test = {"kind": "compression", "interface": "bonded", "displacement_mm": 2.0, "steps": 5}
    shared = {
        "material": {"model": "neo-hookean", "poisson_ratio": 0.49},
        "model": {"space": "axisymmetric", "mesh_size_mm": 0.5},
    }
    tests = [
        {"specimen": cylinder, "test": {**test, "displacement_mm": depth}} for depth in (1.0, 2.0)
    ]
    problems = [CellProblem.of({**shared, **one}) for one in tests]
    cells = [Cell(problem, "auto") for problem in problems]
    slipping = problems[0].loaded(interface="frictionless", base="frictionless")
    both = together(cells[0], [*problems, slipping])
    assert [one.method for one in both.tests] == ["inverse-fem", "inverse-fem", "closed-form"]
    whole, *alone = (FitJob(one, ()) for one in (both, *map(fit_problem, cells)))
    costs = Costs()
    apart = [costs.seconds(one) for one in alone]
    assert costs.seconds(whole) == pytest.approx(sum(apart), rel=0.1)
    assert costs.seconds(whole) > 1.5 * max(apart)
    assert costs.MB(whole) == max(costs.MB(one) for one in alone) > 0


@pytest.mark.parametrize(("leave_out", "block"), [(SPECIMEN, ""), (SPECIMEN, BLOCK), (TEST, "")])
def test_nothing_else_to_fit_is_told(tmp_path, leave_out, block):
    write(tmp_path / "a.csv", {"A": 1.0})
    with pytest.raises(InputError, match="calibration.leave_out"):
        expanded(tmp_path, leave_out, block=block)


#: factors of the force of four specimens about the same material
SCALES = {"A": 1.0, "B": 1.2, "C": 0.9, "D": 1.1}


def roles(work):
    return {tuple(pair.role for pair in job.directions) for job in work.jobs}


@pytest.mark.parametrize(
    ("scales", "asked", "leave_out", "expected"),
    [
        (SCALES, "work_error", "", ("score",)),
        (SCALES, "work_error mu0", "", ("score", "constants")),
        # constants alone: each specimen by itself
        (SCALES, "mu0", "", ("fit",)),
        (SCALES, "work_error", 'leave_out = "nothing"', ("fit",)),
        # with two specimens one alone would stand for all others
        ({"A": 1.0, "B": 1.2}, "work_error", "", ("fit",)),
    ],
)
def test_scores_are_held_out_by_default(tmp_path, scales, asked, leave_out, expected):
    write(tmp_path / "a.csv", scales)
    work = expanded(tmp_path, leave_out, asked=asked)
    assert roles(work) == {expected}
    held_out = {
        pair.fit_label for job in work.jobs for pair in job.directions if "but" in pair.fit_label
    }
    assert bool(held_out) == (expected[0] == "score")
