"""``study calibrate --bootstrap``: standard errors known in closed form, and coverage."""

import numpy as np
import pytest
from scipy.signal import lfilter

from study.ground.curve import Curve
from study.simulation.fit_task import resampled, residuals_of
from tests.cli.small import case_file, gauge, recorded, refusal, success

pytestmark = pytest.mark.usefixtures("undrawn")

C10_KPA = 10.0
HEAD = gauge('model = "neo-hookean"\nincompressible = true') + "[calibration]\nseed = 2011\n"


def errors(rows, phi, rng):
    """Stationary autoregression of unit variance."""
    long = lfilter([1.0], [1.0, *(-np.array(phi))], rng.normal(size=rows + 500))[500:]
    rho = phi[0] if len(phi) == 1 else phi[0] / (1 - phi[1])
    explained = phi[0] * rho + (phi[1] * (phi[0] * rho + phi[1]) if len(phi) > 1 else 0.0)
    return np.asarray(long * np.sqrt(1 - explained))


def written(folder, specimens, shear):
    """Simple shear of a neo-Hookean solid, stress 2 C10 g; one column numbers the specimens."""
    count = len(specimens)
    columns = {
        "strain": ("1", np.tile(shear, count)),
        "stress": ("kPa", np.concatenate(specimens)),
        "who": ("", np.repeat(range(count), shear.size)),
    }
    block = ', block = "who"' if count > 1 else ""
    return case_file(
        folder, HEAD, recorded(folder, "shear", 'kind = "simple-shear"', columns, block)
    )


def drawn(path, count=250):
    more = ("--results", path.parent / "r", "--bootstrap", str(count), "--json")
    found = success("calibrate", path, "--data", path.parent, *more)
    return found.json["bootstrap"]


@pytest.mark.parametrize(("rho", "rows", "off"), [(0.0, 100, 0.12), (0.8, 600, 0.3)])
def test_the_standard_error_is_that_of_least_squares(tmp_path, rho, rows, off):
    shear = np.linspace(0.01, 0.5, rows)
    noise = 0.3 * errors(rows, [rho], np.random.default_rng(2011))
    path = written(tmp_path, [2 * C10_KPA * shear + noise], shear)
    found = drawn(path)
    x = 2 * shear
    lags = np.abs(np.subtract.outer(np.arange(rows), np.arange(rows)))
    exact = 0.3 * np.sqrt(x @ rho**lags @ x) / (x @ x)
    # 250 resamples know it to 4.5 %, the scatter of the noise and the blocks to the rest
    assert found["standard_error"]["C10"] == pytest.approx(exact, rel=off)
    assert found["specimens"] == 0
    assert (found["blocks"][0] == 1) == (rho == 0)
    low, high = found["interval"]["C10"]
    assert high - low == pytest.approx(2 * 1.96 * found["standard_error"]["C10"], rel=0.2)
    if not rho:
        assert drawn(path) == found  # a seed draws the same again


def test_specimens_are_drawn_whole(tmp_path):
    """Of eight specimens: the scatter of means of draws, sqrt(sum of squares) / 8."""
    shear, rng = np.linspace(0.05, 0.5, 12), np.random.default_rng(7)
    own = C10_KPA * (1 + 0.15 * rng.normal(size=8))
    found = drawn(written(tmp_path, [2 * c * shear for c in own], shear))
    assert found["specimens"] == 8
    exact = np.sqrt(np.sum((own - own.mean()) ** 2)) / 8
    # three standard errors of a standard deviation over 250 resamples
    assert found["standard_error"]["C10"] == pytest.approx(exact, rel=3 / np.sqrt(2 * 250))


def test_too_few_resamples_are_refused(tmp_path):
    shear = np.linspace(0.05, 0.5, 12)
    path = written(tmp_path, [2 * C10_KPA * shear + 0.1 * np.sin(shear * 90)], shear)
    refused = refusal("calibrate", path, "--data", tmp_path, "--bootstrap", "50")
    assert "at least 200 resamples" in refused.err


def coverage(phi, rows, tests, seed=3):
    """Share of percentile intervals of 400 resamples that hold the slope of a straight line."""
    rng, hits = np.random.default_rng(seed), 0
    d = np.linspace(1.0, 9.0, rows)
    for _ in range(tests):
        force = d + errors(rows, phi, rng)
        slope = float(d @ force / (d @ d))
        left = residuals_of(Curve(d, force), slope * d, rows / (rows - 1))
        again = np.array([d @ resampled(left, rng) for _ in range(400)]) / (d @ d)
        low, high = np.percentile(again, [2.5, 97.5])
        hits += int(low <= 1.0 <= high)
    return hits / tests


@pytest.mark.slow
@pytest.mark.parametrize("phi", [[0.9], [1.2, -0.4]])
def test_blocks_cover_where_the_recording_is_long(phi):
    # one binomial standard deviation of 800 tests is 0.8 points
    assert 0.92 <= coverage(phi, 4000, 800) <= 0.98
