"""What crosses to a worker comes back as it went, and a study is expanded without side effects."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from study.curve import Curve
from study.design.load import loads
from study.design.spec import Design
from study.forward.finite_element import Anchor
from study.runner.batch import _case_frame
from study.runner.case_task import CaseTask, Origin, ScoreTask
from study.runner.expansion import expand
from study.runner.fitting.fit_problem import fit_problem
from study.runner.fitting.fit_summary import FitResult
from study.runner.fitting.fit_task import FitTask, fitted
from study.runner.fitting.solution import Predicted
from study.runner.job import fits_of
from study.runner.numerical.solve_task import SolveResult, SolveTask, solutions
from study.runner.tables import PROBLEM, on_mesh

from .conftest import DESIGN

CURVE = Curve(np.array([1.0, 2.0]), np.array([3.0, 7.0]), np.array([3.5, 4.5]))


def through_json(document: object) -> dict[str, object]:
    found = json.loads(json.dumps(document, allow_nan=False))
    assert isinstance(found, dict)
    return found


def result() -> FitResult:
    predicted = Predicted(CURVE, {"dofs": 9}, {"name": "pardiso", "snaps_mm": [0.5]})
    fit = {"message": "", "names": ["C10"], "values": {"C10": 1 / 3}, "seconds": 2.5}
    return FitResult.from_json({"status": "converged", **fit, **predicted.to_json()})


def test_a_case_task_comes_back_as_it_went(design: Design, one_mix: Path) -> None:
    work = expand(design, one_mix)
    job = work.jobs[0]
    (pair, _) = job.directions
    direction = ScoreTask(
        pair.label,
        pair.measured,
        pair.role,
        pair.fit_label,
        (0.1, 0.2),
        pair.depth_mm,
        pair.fit_key,
        result(),
    )
    tables = {name: job.case.config[name] for name in PROBLEM if name in job.case.config}
    task = CaseTask(
        _case_frame(work, job), tables, job.forward, (direction,), Anchor("cell", {"C10": 0.1})
    )
    back = CaseTask.from_json(through_json(task.to_json()))
    assert back.to_json() == task.to_json()
    assert back.frame == task.frame
    assert back.anchor == task.anchor
    assert back.directions[0].scatter_N == (0.1, 0.2)
    found = back.directions[0].fit
    assert found is not None
    assert found.constants == {"C10": 1 / 3}
    assert found.prediction is not None
    assert found.prediction.solver["snaps_mm"] == [0.5]


def test_a_fit_that_a_worker_lost_has_a_status_and_no_constants() -> None:
    lost = FitResult.from_json({"status": "timeout", "message": "stopped", "traceback": "..."})
    assert (lost.status, lost.message, lost.constants) == ("timeout", "stopped", {})
    assert not lost.usable
    assert FitResult.from_json(through_json(lost.to_json())) == lost


def test_unstable_constants_are_not_usable() -> None:
    assert result().usable
    bad = FitResult.from_json(result().to_json() | {"usable": False})
    assert bad.converged
    assert not bad.usable


def test_a_solution_comes_back_as_it_went() -> None:
    done = SolveResult("converged", curve=CURVE, elements=4, dofs=9, seconds=0.5, memory_MB=80.0)
    back = SolveResult.from_json(through_json(done.to_json()))
    assert back.to_json() == done.to_json()
    assert back.curve.force_N.tolist() == [3.0, 7.0]
    lost = SolveResult.from_json({"status": "crashed", "message": "twice"})
    assert (lost.converged, lost.dofs, lost.curve.force_N.size) == (False, 0, 0)


def test_equal_solutions_are_made_once() -> None:
    cylinder = {"shape": "cylinder", "radius_mm": 5.0, "height_mm": 5.0}
    test = {"kind": "compression", "steps": 2}
    tables = {"specimen": cylinder, "test": test, "material": {}, "model": {}}
    tasks = [SolveTask.of(tables, size) for size in (1.0, 2.0, 1.0)]
    asked: list[str] = []

    def solve(some: list[SolveTask]) -> list[tuple[str, SolveResult]]:
        asked.extend(task.key for task in some)
        # the last one first, as workers may give them
        return [(t.key, SolveResult(f"{t.tables['model']['mesh_size_mm']:g}")) for t in some[::-1]]

    assert [one.status for one in solutions(solve, tasks)] == ["1", "2", "1"]
    assert len(asked) == 2


def test_an_origin_names_only_what_applies() -> None:
    origin = Origin(purpose="refinement", of="a1", level=2)
    assert origin.to_json() == {"purpose": "refinement", "of": "a1", "level": 2}
    assert Origin(**through_json(origin.to_json())) == origin
    assert not Origin(noise_seed=3).predicts


def test_a_mesh_is_changed_in_the_problem_of_the_calibration_too() -> None:
    tables = {
        "model": {"mesh": "fine"},
        "calibration": {"method": "auto", "problem": {"model": {"mesh": "fine"}, "test": {}}},
    }
    found = on_mesh(tables, mesh=None, mesh_size_mm=2.0)
    both = found["model"], found["calibration"]["problem"]["model"]
    assert both == ({"mesh": None, "mesh_size_mm": 2.0},) * 2
    assert found["calibration"]["problem"]["test"] == {}
    assert tables["model"] == {"mesh": "fine"}


def test_fits_that_start_others_come_first_and_shared_ones_once(one_mix: Path) -> None:
    work = expand(loads(DESIGN), one_mix)
    jobs = [job for job in work.jobs if job.case.levels["plates"] == "bonded"]
    found = list(fits_of(jobs).values())
    starts = [fit.start for fit in found if fit.start is not None]
    assert starts
    place = {fit.key: k for k, fit in enumerate(found)}
    assert all(place[fit.start.key] < place[fit.key] for fit in found if fit.start is not None)
    # mooney-rivlin starts from neo-hookean, which its own cells fit as well
    assert {start.key for start in starts} <= {fit.key for job in jobs for fit in job.fits}
    assert {fit.key: fit.label for fit in found} == {k: v.label for k, v in fits_of(jobs).items()}


def test_where_a_prediction_comes_from_is_said_once(one_mix: Path) -> None:
    for method, expected in (
        ("auto", {"frictionless": "simulation", "bonded": "fit"}),
        ("inverse-fem", {"frictionless": "fit", "bonded": "fit"}),
    ):
        text = f'{DESIGN}\n[calibration]\nmethod = "{method}"\n'
        jobs = expand(loads(text, "small.toml"), one_mix).jobs
        assert {j.case.levels["plates"]: j.forward for j in jobs} == expected


def test_a_fit_task_comes_back_and_fits_alike() -> None:
    d = np.linspace(0.01, 0.3, 30)
    tables = {
        "specimen": {"shape": "cylinder", "radius_mm": 25.0, "height_mm": 30.0},
        "test": {"kind": "compression", "interface": "frictionless", "displacement_mm": 0.3},
        "material": {"model": "neo-hookean", "poisson_ratio": 0.4995},
        "model": {},
    }
    task = FitTask(fit_problem(tables), (Curve(d, 2.0 * d),), noise=(7, 3))
    back = FitTask.from_json(through_json(task.to_json()))
    assert back.to_json() == task.to_json()
    assert back.noise == (7, 3)
    first, second = fitted(task), fitted(back)
    assert first.constants == second.constants
    # E A / h = 2 N/mm with E = 6 C10; 1 % of compression stiffens by as much
    C10 = 2.0 * 30.0 / (6 * np.pi * 25.0**2)  # noqa: N806
    assert first.constants["C10"] == pytest.approx(C10, rel=0.02)
