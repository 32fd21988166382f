"""The optimizer against NIST's certified fits and the problems of More, Garbow, Hillstrom."""

import numpy as np
import pytest

from study.mechanics.calibration.covariance import uncertainty
from study.mechanics.calibration.levenberg_marquardt import Status, levenberg_marquardt
from tests.calibration import more_garbow_hillstrom as mgh
from tests.calibration.nist import digits, never_rises, read, residual_function


@pytest.fixture(scope="module")
def nist_runs(data_dir):
    """Every set from both starts: certified entry, result, digits of x, of errors and of rss."""
    runs = []
    for entry in read(data_dir / "nist_nls"):
        function = residual_function(entry["dataset"], entry["x"], entry["y"])
        for start in ("start1", "start2"):
            first = [float(v) for v in entry[start]]
            # as far as doubles go: Lanczos1 has no residual left to judge convergence by
            result = levenberg_marquardt(function, first, xtol=1e-14, max_evaluations=5000)
            known = uncertainty(result.jacobian, result.residual, result.x)
            runs.append(
                {
                    "entry": entry,
                    "result": result,
                    "x": digits(result.x, entry["parameters"]),
                    "error": digits(known.standard_error, entry["standard_deviations"]),
                    "rss": digits([2 * result.cost], [entry["rss"]]),
                }
            )
    return runs


def test_nist_parameters(nist_runs):
    assert len(nist_runs) == 54
    assert sum(run["x"] >= 4 for run in nist_runs) == 54
    lower = [run["x"] for run in nist_runs if run["entry"]["difficulty"] == "Lower"]
    assert len(lower) == 16
    assert min(lower) >= 6


def test_nist_standard_errors(nist_runs):
    # at a residual of 1e-13 (Lanczos1) rounding of the parameters alone leaves three digits
    for run in nist_runs:
        lanczos1 = run["entry"]["dataset"] == "Lanczos1"
        assert run["error"] >= (3 if lanczos1 else 4), run["entry"]["dataset"]
        assert lanczos1 or run["rss"] >= 6, run["entry"]["dataset"]


def test_nist_never_claims_a_false_success(nist_runs):
    for run in nist_runs:
        assert run["result"].converged == (run["x"] >= 4), run["entry"]["dataset"]
        assert never_rises(run["result"].history)


def test_dead_end_is_no_success(data_dir):
    # BoxBOD from far out: the exponential vanishes and its rate with it; MINPACK stops there
    (entry,) = [e for e in read(data_dir / "nist_nls") if e["dataset"] == "BoxBOD"]
    function = residual_function("BoxBOD", entry["x"], entry["y"])
    result = levenberg_marquardt(function, [100.0, 40.0])
    assert not result.converged
    assert result.status is Status.no_influence


MGH_RUNS = mgh.runs()


@pytest.mark.parametrize("run", MGH_RUNS, ids=lambda run: run[0])
def test_more_garbow_hillstrom(run):
    name, function, start, minima = run
    result = levenberg_marquardt(function, start, max_evaluations=3000)
    # MINPACK solves 51 of the 53; ours reaches a known lowest value in all of them
    assert mgh.minimum_reached(2 * result.cost, minima)
    # Bard's 17.4287 is approached only as two parameters go to infinity: no success to claim
    far = name in ("Bard [8] x10", "Bard [8] x100")
    assert result.status is Status.running_away if far else result.converged
    assert never_rises(result.history)
    assert np.all(np.isfinite(result.x))
