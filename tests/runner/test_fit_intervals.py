"""A fit of a study has the intervals of ``study calibrate``: both follow the recorded rows."""

import json

import pytest

from study.cli.app import run
from study.harness.calibration.measured_tests import in_order, read_tests
from study.harness.design.load import load_calibration
from study.harness.runner.fit_problem import FitProblem, fitted_test
from study.harness.runner.fit_task import FitTask, fitted
from tests.runner.test_calibrate import RP2, case, write


@pytest.mark.parametrize("points", [60, 1000])
def test_a_fit_of_a_study_and_the_verb_give_one_interval(tmp_path, capsys, points):
    """Through a worker's plain data, at any grid: two ways to one number."""
    write(tmp_path / "a.csv", "reduced-polynomial", RP2, noise=0.1)
    path = case(tmp_path, [{"points": points, "more": ""}])
    arguments = ["calibrate", str(path), "--data", str(tmp_path), "--json"]
    assert run([*arguments, "--results", str(tmp_path / "r")]) == 0
    document = json.loads(capsys.readouterr().out)
    tests = load_calibration(path).tests
    (curve,) = in_order(read_tests(tests, tmp_path)[0])
    way = fitted_test("auto", tests[0].problem)
    task = FitTask(FitProblem(way.method, (way,)), (curve.measured.curve,))
    found = fitted(task)
    for name, one in document["parameters"].items():
        wanted = [1e-3 * value for value in one["ci95"]]
        assert found.fit["ci95"][name] == pytest.approx(wanted, rel=1e-6)
    assert found.fit["aicc"] == pytest.approx(document["aicc"], rel=1e-9)
