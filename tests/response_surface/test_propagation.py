"""Uncertain inputs through a surface: distributions whose answers are known in closed form."""

import math

import numpy as np
import pytest
from scipy import stats

from study.ground.errors import RefusedError
from study.statistics.surfaces.emulator import fit_emulator
from study.statistics.surfaces.quadratic import fit_quadratic
from study.statistics.surfaces.surface_factors import InputDistribution
from study.statistics.surfaces.surface_result import analysis_of, propagate
from tests.response_surface import functions


def of(kind, *numbers):
    return InputDistribution(kind, numbers, 0.0, 1.0)


def emulated(function, k, n, seed=1):
    x = functions.hypercube(k, n, seed)
    return analysis_of(fit_emulator(functions.unit_runs(x, function(x))))


@pytest.mark.parametrize(
    ("found", "known"),
    [
        (of("normal", 0.5, 0.1), stats.truncnorm(-5, 5, 0.5, 0.1)),
        (of("normal", 0.3, 0.2), stats.truncnorm(-1.5, 3.5, 0.3, 0.2)),
        (of("uniform", 0.2, 0.7), stats.uniform(0.2, 0.5)),
        (of("triangular", 0.1, 0.3, 0.9), stats.triang(0.25, 0.1, 0.8)),
        (of("lognormal", 0.3, 1.2), stats.lognorm(math.log(1.2), scale=0.3)),
    ],
)
def test_quantiles_are_those_of_scipy(found, known):
    p = np.linspace(0.001, 0.999, 57)
    assert found.quantile(p) == pytest.approx(known.ppf(p), rel=1e-6)


def test_half_the_spread_is_half_the_deviation():
    p = (np.arange(20000) + 0.5) / 20000
    for whole in (
        of("normal", 0.5, 0.05),
        of("uniform", 0.2, 0.8),
        of("triangular", 0.2, 0.3, 0.9),
    ):
        half = whole.halved()
        assert half.quantile(p).std() == pytest.approx(0.5 * whole.quantile(p).std(), rel=1e-3)
        assert half.quantile(p).mean() == pytest.approx(whole.quantile(p).mean(), rel=1e-6)
    logs = np.log(of("lognormal", 0.4, 1.2).halved().quantile(p))
    assert logs.std() == pytest.approx(0.5 * math.log(1.2), rel=1e-3)


def linear(x):
    return 1.0 + 3.0 * x[:, 0] - 2.0 * x[:, 1] + 0.5 * x[:, 2]


def test_a_linear_function_of_normal_inputs_is_normal():
    inputs = {"x1": of("normal", 0.5, 0.05), "x2": of("normal", 0.4, 0.06)}
    told = propagate(emulated(linear, 3, 30), inputs, {"x3": 0.2})
    variance = (3 * 0.05) ** 2 + (2 * 0.06) ** 2
    known = stats.norm(1 + 1.5 - 0.8 + 0.1, math.sqrt(variance))
    assert told.mean.value == pytest.approx(known.mean(), abs=1e-3)
    assert told.sd.value == pytest.approx(known.std(), rel=1e-3)
    for percent, one in told.percentiles.items():
        # a percentile of 8,192 points, the outermost known to 2 % of the deviation
        assert one.value == pytest.approx(known.ppf(percent / 100), abs=0.02 * known.std())
    first, second = told.inputs
    assert (first.name, second.name) == ("x1", "x2")
    assert first.index is not None
    assert first.index.first == pytest.approx((3 * 0.05) ** 2 / variance, abs=0.01)
    assert first.halved == pytest.approx(math.sqrt(variance - 0.75 * (3 * 0.05) ** 2), rel=2e-3)
    assert told.fixed == {"x3": 0.2}


def square(x):
    return 4.0 * (x[:, 0] - 0.2) ** 2 + x[:, 1]


@pytest.mark.parametrize("kind", ["emulator", "quadratic"])
def test_a_square_of_a_normal_input_is_a_shifted_chi_square(kind):
    if kind == "emulator":
        found = emulated(square, 2, 30)
    else:
        grid = np.array([[a, b] for a in (0.0, 0.5, 1.0) for b in (0.0, 0.5, 1.0)])
        found = analysis_of(fit_quadratic(functions.unit_runs(grid, square(grid))))
    told = propagate(found, {"x1": of("normal", 0.5, 0.08)}, {"x2": 0.25})
    s, m = 0.08, 0.3  # of x1 - .2: mean and variance of its square by hand
    assert told.mean.value == pytest.approx(4 * (m**2 + s**2) + 0.25, rel=1e-3)
    deviation = 4 * math.sqrt(2 * s**4 + 4 * m**2 * s**2)
    assert told.sd.value == pytest.approx(deviation, rel=3e-3)
    (only,) = told.inputs
    assert only.index is not None
    assert only.index.total == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("last", [1, pytest.param(8, marks=[pytest.mark.slow, pytest.mark.verify])])
def test_ishigamis_mean_and_variance_are_inside_what_the_emulator_may_err(last):
    uniform = {f"x{j}": of("uniform", 0.0, 1.0) for j in (1, 2, 3)}
    mean, variance = 3.5, 7**2 / 8 + 0.1 * math.pi**4 / 5 + 0.01 * math.pi**8 / 18 + 0.5
    held = []
    for seed in range(1, last + 1):
        told = propagate(emulated(functions.ishigami, 3, 120, seed), uniform, {})
        held.append(abs(told.mean.value - mean) <= told.mean.own)
        held.append(abs(told.sd.value - math.sqrt(variance)) <= told.sd.own)
        assert told.mean.own < 0.5
    assert np.mean(held) >= 0.9
    # the published indices, and the third input does nothing alone
    told = propagate(emulated(functions.ishigami, 3, 200, 1), uniform, {})
    index = {one.name: one.index for one in told.inputs if one.index is not None}
    for name, known in {"x1": 0.3139, "x2": 0.4424, "x3": 0.0}.items():
        low, high = index[name].first_interval
        assert low <= known <= high


def test_a_poor_surface_says_nothing():
    rng = np.random.default_rng(1)
    found = emulated(lambda x: rng.standard_normal(len(x)), 2, 24)
    with pytest.raises(RefusedError, match="nothing is said of uncertain inputs"):
        propagate(found, {"x1": of("uniform", 0.0, 1.0)}, {"x2": 0.5})
