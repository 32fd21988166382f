"""The emulator against other codes, closed forms and functions with known indices."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
import threadpoolctl
from scipy import optimize
from scipy.stats import qmc
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern, WhiteKernel

from study.ground.errors import RefusedError
from study.statistics.surfaces import gaussian_process
from study.statistics.surfaces.emulator import (
    fit_emulator,
    fit_own,
    fit_together,
    jansen,
    verdict_of,
)
from study.statistics.surfaces.gaussian_process import (
    FAMILIES,
    CategoryCorrelation,
    condition,
    draw_paths,
    fit_process,
    fitted,
    hyperparameters,
    log_likelihood,
)
from study.statistics.surfaces.surface_factors import Runs
from study.statistics.surfaces.surface_optimum import extremes
from tests.response_surface import functions

THETA = np.log([0.4, 0.7, 1.3, 1.7, 1e-4])


def standardized(n=40):
    x = functions.hypercube(3, n, 4)
    y = functions.ishigami(x)
    return x, (y - y.mean()) / y.std()


def two_categories(n=30, seed=4):
    """A product: the second category answers three times as much, plus a constant."""
    x = functions.hypercube(5, 2 * n, seed)
    y = functions.friedman(x)
    first, second = functions.unit_runs(x[:n], y[:n]), functions.unit_runs(x[n:], 3 * y[n:] + 20)
    return first, second


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("sizes", [(), (3, 2), (6,), (2,)])
def test_gradient_is_that_of_finite_differences(family, sizes):
    rng = np.random.default_rng(1)
    number = np.arange(50) % max(1, int(np.prod(sizes)))
    x = np.column_stack([rng.random((50, 2)), *([number] if sizes else [])])
    y = np.sin(4 * x[:, 0]) + x[:, 1] ** 2 * (1 + number % 2) + 0.3 * (number // 2)
    apart = np.log([0.2, 0.1, 0.3, 0.05, 0.4, 0.15][: fitted(sizes)])
    theta = np.array([*np.log([0.4, 0.7]), *apart, *np.log([1.7, 1e-4])])
    noise = np.full(y.size, 1e-3)
    _, slope = log_likelihood(theta, x, y, noise, family, sizes)
    numeric = optimize.approx_fprime(
        theta, lambda t: log_likelihood(t, x, y, noise, family, sizes)[0], 1e-6
    )
    assert slope == pytest.approx(numeric, rel=1e-4, abs=1e-4)


def test_categories_correlate_by_their_distances_from_the_shared_part():
    both = CategoryCorrelation.of(np.array([0.1, 0.2, 0.4, 0.05]), (3, 2))
    three = np.exp(-np.array([[0.0, 0.3, 0.5], [0.3, 0.0, 0.6], [0.5, 0.6, 0.0]]))
    two = np.exp(-np.array([[0.0, 0.1], [0.1, 0.0]]))
    assert both.matrix == pytest.approx(np.kron(three, two))
    assert both.parts @ both.parts.T == pytest.approx(both.matrix, abs=1e-9)


def test_categories_that_are_alike_learn_from_each_other():
    runs = two_categories()
    together = fit_together(runs, (2,))
    apart = [fit_emulator(one) for one in runs]
    matrix = together[0].process.hyperparameters.kernel.categories
    assert matrix is not None
    assert matrix.matrix[0, 1] > 0.95
    points = 2.0 * np.random.default_rng(5).random((500, 5)) - 1.0
    truth = functions.friedman(0.5 * (points + 1.0))
    for one, alone, exact in zip(together, apart, (truth, 3 * truth + 20), strict=True):
        error = [np.sqrt(np.mean((m.value(points) - exact) ** 2)) for m in (one, alone)]
        assert error[0] < 0.8 * error[1]


def test_left_out_runs_of_a_category_are_those_of_conditioning_without_them():
    runs = two_categories(15)
    for number, one in enumerate(fit_together(runs, (2,))):
        i = 15 * number + 3
        told = one.centre + one.scale * without(one.process, i).mean(one.process.x[i : i + 1])[0]
        assert one.loo_errors[3] == pytest.approx(runs[number].response[3] - told, rel=1e-6)


def without(process, i):
    """Condition on all runs but one."""
    rest = np.delete(np.arange(process.y.size), i)
    return condition(process.x[rest], process.y[rest], process.noise[rest], process.hyperparameters)


def test_leave_one_out_is_what_conditioning_without_the_run_says():
    x, y = standardized(30)
    found = hyperparameters(THETA, "Matern 5/2")
    process = condition(x, y, np.full(y.size, 1e-3), found)
    for i in (0, 7, 29):
        rest = without(process, i)
        deviation = np.sqrt(
            rest.deviation(x[i : i + 1])[0] ** 2 + 1e-3 + found.variance * found.nugget
        )
        error = y[i] - rest.mean(x[i : i + 1])[0]
        assert process.loo_errors[i] == pytest.approx(error, rel=1e-7)
        assert process.loo_deviations[i] == pytest.approx(deviation, rel=1e-7)


def test_a_category_with_hardly_any_runs_is_refused():
    first, second = two_categories(20)
    few = Runs(second.name, second.factors, second.coded[:4], second.response[:4])
    with pytest.raises(RefusedError, match="4 different runs at one combination"):
        fit_together([first, few], (2,))


@pytest.mark.parametrize("family", FAMILIES)
def test_likelihood_and_prediction_are_those_of_scikit_learn(family):
    """A constant with a wide prior is the mean by least squares, up to a constant likelihood."""
    x, y = standardized()
    wide, steps = 1e5, []
    points = np.random.default_rng(1).random((20, 3))
    well = THETA + [0.0, 0.0, 0.0, 0.0, 5.0]  # a nugget that rounding cannot touch
    for theta in (well, well + [0.1, -0.2, 0.3, 0.2, 1.0]):
        found = hyperparameters(theta, family)
        lengths = found.kernel.lengths
        shape = RBF(lengths) if family == "Gaussian" else Matern(lengths, nu=2.5)
        kernel = ConstantKernel(wide) + ConstantKernel(found.variance) * shape
        both = kernel + WhiteKernel(found.variance * found.nugget)
        other = GaussianProcessRegressor(both, alpha=1e-14, optimizer=None).fit(x, y)
        ours, _ = log_likelihood(theta, x, y, np.zeros(y.size), family)
        steps.append(ours - other.log_marginal_likelihood_value_)
        process = condition(x, y, np.zeros(y.size), found)
        mean, deviation = other.predict(points, return_std=True)
        assert process.mean(points) == pytest.approx(mean, abs=1e-5)
        latent = np.sqrt(deviation**2 - found.variance * found.nugget)
        assert process.deviation(points) == pytest.approx(latent, rel=1e-4, abs=1e-4)
    assert steps[0] == pytest.approx(steps[1], abs=1e-4)


@pytest.mark.parametrize("sizes", [(), (2,)])
def test_paths_scatter_as_the_posterior_says(sizes):
    x, y = standardized(30)
    theta = np.log([0.4, 0.7, 1.3, *([0.3] if sizes else []), 1.7, 1e-4])
    points = np.random.default_rng(2).random((25, 3))
    if sizes:
        x = np.column_stack([x, np.arange(30) % 2])
        points = np.column_stack([points, np.ones(25)])
    process = condition(x, y, np.zeros(y.size), hyperparameters(theta, "Gaussian", sizes))
    values = draw_paths(process, 3, paths=4000)(points)
    assert values[:, 0] == pytest.approx(process.mean(points), abs=1e-10)
    deviation = process.deviation(points)
    assert np.abs(values[:, 1:].mean(axis=1) - values[:, 0]).max() < 0.08 * deviation.max()
    assert values[:, 1:].std(axis=1) == pytest.approx(deviation, rel=0.15)


def test_jansen_on_sobols_function():
    s, t = functions.sobol_g_indices()
    first, total = jansen(lambda x: functions.sobol_g(x)[:, None], 4, seed=1)
    assert first[:, 0] == pytest.approx(s, abs=0.005)
    assert total[:, 0] == pytest.approx(t, abs=0.005)


def emulated(function, k, n, seed):
    x = functions.hypercube(k, n, seed)
    return fit_emulator(functions.unit_runs(x, function(x)), seed)


def on_other_points(function, found):
    """Q2 and share of 2,000 other points within their intervals."""
    x = np.random.default_rng(99).random((2000, len(found.runs.factors)))
    y = function(x)
    values, half = found.predict(2.0 * x - 1.0)
    q2 = 1.0 - ((values - y) ** 2).sum() / ((y - y.mean()) ** 2).sum()
    return float(q2), float(np.mean(np.abs(values - y) <= half))


def errors_of_indices(found, s, t):
    """Largest errors of S and T, and the share of intervals that hold the truth."""
    indices = found.indices()
    first = np.array([i.first for i in indices])
    total = np.array([i.total for i in indices])
    ends = np.array([(*i.first_interval, *i.total_interval) for i in indices])
    held = [(ends[:, 0] <= s) & (s <= ends[:, 1]), (ends[:, 2] <= t) & (t <= ends[:, 3])]
    return float(np.abs(first - s).max()), float(np.abs(total - t).max()), float(np.mean(held))


def test_borehole_of_50_runs():
    found = emulated(functions.borehole, 8, 50, 1)
    q2, cover = on_other_points(functions.borehole, found)
    s, t, held = errors_of_indices(found, functions.BOREHOLE_S, functions.BOREHOLE_T)
    assert q2 >= 0.995
    assert cover >= 0.9
    assert max(s, t) <= 0.01
    assert held == 1.0


def test_friedman_gives_the_range_of_its_additive_inputs():
    found = emulated(functions.friedman, 5, 100, 1)
    assert found.gate == "given"
    ranges = found.ranges(practical=3.0)
    for j, truth in ((2, 5.0), (3, 10.0), (4, 5.0)):
        assert abs(ranges[j].value - truth) <= ranges[j].bound
        low, high = functions.friedman(0.5 * (ranges[j].confirm + 1.0))
        assert high - low == pytest.approx(truth, abs=ranges[j].bound)


@pytest.mark.parametrize(
    ("value", "bound", "practical", "verdict"),
    [
        (1.5, 0.4, 1.0, "matters"),
        (1.3, 0.4, 1.0, "cannot tell"),
        (0.5, 0.2, 1.0, "no practical difference"),
        (0.7, 0.2, 1.0, "cannot tell"),  # 2 % of 10 is added
        (5.0, 0.1, None, "cannot tell"),
    ],
)
def test_verdict_of_a_range(value, bound, practical, verdict):
    assert verdict_of(value, bound, practical, 10.0) == verdict


def test_copies_are_no_test_of_themselves():
    x = functions.hypercube(3, 40, 2)
    y = functions.ishigami(x)
    once = fit_emulator(functions.unit_runs(x, y))
    twice = fit_emulator(functions.unit_runs(np.vstack([x, x]), np.append(y, y)))
    assert twice.q2 == pytest.approx(once.q2, abs=1e-9)


def test_known_numerical_uncertainty_widens_deviations():
    x, y = standardized()
    exact = fit_process(x, y, np.zeros(y.size), "Gaussian")
    noisy = condition(x, y, np.full(y.size, 0.05), exact.hyperparameters)
    assert (noisy.deviation(x) > exact.deviation(x)).all()


def test_emulators_of_blocks_know_the_numerical_uncertainty_of_their_runs():
    x = functions.hypercube(2, 16, 4)
    blocks = tuple(f"s{i}" for i in range(3))
    runs = functions.unit_runs(np.tile(x, (3, 1)), np.tile(np.sin(3 * x[:, 0]) + x[:, 1], 3))
    runs = replace(runs, blocks=tuple(np.repeat(blocks, 16)), u_num=np.full(48, 0.1))
    at = functions.hypercube(2, 20, 5)
    _, half = fit_own(runs).predict(at)
    _, alone = fit_emulator(
        replace(functions.unit_runs(x, runs.response[:16]), u_num=np.full(16, 0.1))
    ).predict(at)
    np.testing.assert_allclose(half, alone, rtol=1e-9)
    _, exact = fit_own(replace(runs, u_num=None)).predict(at)
    assert (half > exact).all()


def test_what_no_emulator_can_be_made_of_is_refused():
    x = functions.hypercube(2, 30, 1)
    eight, many = functions.hypercube(3, 8, 1), np.random.default_rng(1).random((10_000, 2))
    for points, response, match in [
        (x, np.ones(30), "same in every run"),
        (x[:5], x[:5, 0], "at least 20"),
        (eight, eight[:, 0], "at least 9"),
        (many, many[:, 0], "every 5th row"),
    ]:
        with pytest.raises(RefusedError, match=match):
            fit_emulator(functions.unit_runs(points, response))


BOREHOLE = functions.BOREHOLE_S, functions.BOREHOLE_T
ISHIGAMI = functions.ISHIGAMI_S, functions.ISHIGAMI_T


@pytest.mark.slow
@pytest.mark.parametrize(
    ("function", "k", "n", "indices", "limits"),
    [
        (functions.borehole, 8, 50, BOREHOLE, (0.995, 0.01, 0.01)),
        (functions.ishigami, 3, 100, ISHIGAMI, (0.85, np.inf, 0.12)),
        (functions.ishigami, 3, 200, ISHIGAMI, (0.98, 0.02, 0.02)),
        (functions.sobol_g, 4, 100, functions.sobol_g_indices(), None),
        (functions.friedman, 5, 100, functions.friedman_indices(), None),
        (functions.harmonic, 3, 60, functions.harmonic_indices(), None),
    ],
)
def test_published_indices_lie_in_their_intervals(function, k, n, indices, limits):
    """Bar 11; stated intervals are of about 95 %, over all indices of all seeds."""
    found = [emulated(function, k, n, seed) for seed in range(8)]
    q2, cover = np.median([on_other_points(function, f) for f in found[:5]], axis=0)
    told = [errors_of_indices(f, *indices) for f in found if f.gate != "refused"]
    first, total, _ = np.median(told[:5], axis=0)
    held = np.mean([h for _, _, h in told])
    print(f"{function.__name__} {n}: Q2 {q2:.4f}, S {first:.4f}, T {total:.4f}")
    print(f"intervals {held:.3f}, points {cover:.3f}, {len(told)} of 8 gave indices")
    assert len(told) >= 4
    assert held >= 0.95
    if limits is not None:
        assert q2 >= limits[0]
        assert first <= limits[1]
        assert total <= limits[2]
        assert cover >= 0.9


@pytest.mark.slow
def test_few_runs_are_refused():
    few = [emulated(functions.ishigami, 3, 50, seed) for seed in range(5)]
    assert sum(f.gate == "refused" for f in few) >= 4


@pytest.mark.slow
def test_a_thousand_runs():
    tracemalloc.start()
    found = emulated(functions.borehole, 8, 1000, 1)
    found.indices()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    print(f"1,000 runs: {peak / 1e9:.2f} GB")
    assert peak < 2e9


def flat_specimen(x):
    """Force of a neo-Hookean cylinder between frictionless plates, 4 mm of 15 to 30 mm, N."""
    radius, height, c10 = 15 + 10 * x[:, 0], 15 + 15 * x[:, 1], 5e-3 + 10e-3 * x[:, 2]
    stretch = 1 - 4 / height
    return np.asarray(np.pi * radius**2 * 2 * c10 * (stretch**-2 - stretch))


@pytest.mark.parametrize(("last", "fewest"), [(3, 6), pytest.param(6, 11, marks=pytest.mark.slow)])
def test_extremes_lie_in_corners_and_inside_their_intervals(last, fewest):
    ends = {True: np.array([[1.0, -1.0, 1.0]]), False: np.array([[-1.0, 1.0, -1.0]])}
    inside = []
    for seed in range(1, last + 1):
        x = functions.hypercube(3, 60, seed)
        found = fit_emulator(functions.unit_runs(x, flat_specimen(x)))
        for coded in ends.values():
            value, half = found.predict(coded)
            inside.append(abs(value - flat_specimen(0.5 * (coded + 1)))[0] <= half[0])
        # and the interval is still one that says something
        assert half[0] < 0.02 * np.ptp(found.runs.response)
    assert sum(inside) >= fewest  # of two a seed; half where the other kernel did not count


def test_nothing_near_the_least_prediction_is_less():
    x = functions.hypercube(2, 40, 1)
    bowl = (x[:, 0] - 0.3) ** 2 + (x[:, 1] - 0.6) ** 2 + 0.2 * x[:, 0] * x[:, 1]
    model = fit_emulator(functions.unit_runs(x, bowl))
    smallest, _ = extremes(model)
    side = np.linspace(-0.01, 0.01, 101)
    near = smallest.at + np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    # predictions repeat to some 1e-9 of their range, from which the search takes its slopes
    assert model.value(near).min() > smallest.value - 2e-7 * np.ptp(bowl)


def test_a_search_of_length_scales_goes_on_or_is_refused(monkeypatch):
    x = qmc.Sobol(2, seed=3).random(16)
    y = np.sin(5 * x[:, 0]) + x[:, 1] ** 2
    y, noise = (y - y.mean()) / y.std(), np.zeros(16)
    usual = fit_process(x, y, noise, FAMILIES[0])
    monkeypatch.setattr(gaussian_process, "STEPS", 1)
    longer = fit_process(x, y, noise, FAMILIES[0])
    assert longer.hyperparameters.variance == pytest.approx(
        usual.hyperparameters.variance, rel=1e-3
    )
    monkeypatch.setattr(gaussian_process, "MOST_STEPS", 1)
    with pytest.raises(RefusedError, match="length scales of the emulator: the search has not"):
        fit_process(x, y, noise, FAMILIES[0])


def test_an_emulator_is_fitted_on_one_thread(monkeypatch):
    threads = []

    def watched(*arguments):
        pools = threadpoolctl.threadpool_info()
        threads.extend(pool["num_threads"] for pool in pools if pool["user_api"] == "blas")
        return likelihood(*arguments)

    likelihood = gaussian_process.log_likelihood
    monkeypatch.setattr(gaussian_process, "log_likelihood", watched)
    x = np.linspace(-1, 1, 12)[:, None]
    with threadpoolctl.threadpool_limits(2):
        gaussian_process.fit_process(x, np.sin(3 * x[:, 0]), np.zeros(12), "Matern 5/2")
    assert set(threads) == {1}
