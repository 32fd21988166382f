"""Intervals from recorded rows: coverage by simulation, and answers known otherwise."""

import math

import numpy as np
import pytest

from study.ground.curve import Curve
from study.mechanics.calibration.fit import fit
from study.mechanics.calibration.fit_influence import with_serial_correlation
from study.mechanics.calibration.residual_function import MeasuredCurve
from study.mechanics.calibration.serial_correlation import Series, intervals
from tests.calibration.cylinder import AREA, autoregression, predictor
from tests.cli.small import success
from tests.fem.problems import LONG
from tests.runner.test_calibrate import case

pytestmark = pytest.mark.usefixtures("undrawn")

ENERGIES = {"neo-hookean": {"C10": 7e-3}, "reduced-polynomial": {"C10": 7e-3, "C20": 1.5e-3}}
ROWS, DEPTH = 60, 9.0


MANY = [
    pytest.param(model, points, rho, 1500, 0.92, 0.98, marks=LONG)
    for model in ENERGIES
    for points in (0, 60, 200, 1000)
    for rho in (0.0, 0.9)
]
# 60 tests of 95 %: fewer than 52 or so in one of 200 simulations; 35 % would hit 21
FEW = [
    ("neo-hookean", points, rho, 60, 52 / 60, 1.0)
    for points, rho in ((0, 0.0), (1000, 0.0), (200, 0.9))
]


# one binomial standard deviation of 1500 tests is 0.6 points
@pytest.mark.parametrize(("model", "points", "rho", "tests", "least", "most"), [*FEW, *MANY])
def test_intervals_cover_the_constants(model, points, rho, tests, least, most):
    """Share of 95 % intervals that hold the truth; ``points`` 0 fits the rows."""
    names, truth = tuple(ENERGIES[model]), np.array(list(ENERGIES[model].values()))
    at_rows, d = predictor(model, names, DEPTH, points=ROWS)
    exact = at_rows(truth)[0].force_N
    places = np.linspace(0.3, DEPTH, points) if points else d  # 60 of them are not the rows
    predict = predictor(model, names, DEPTH, places=places)[0]
    rng, hits = np.random.default_rng(2011), np.zeros(truth.size)
    for _ in range(tests):
        rows = Curve(d, exact + 0.1 * autoregression(rho, rng, ROWS))
        curve = Curve(places, np.interp(places, d, rows.force_N), recorded=(rows,))
        measured = [MeasuredCurve("virtual", curve)]
        found = with_serial_correlation(fit(predict, measured, names, truth), measured)
        hits += (found.ci95[:, 0] <= truth) & (truth <= found.ci95[:, 1])
    assert np.all((hits / tests >= least) & (hits / tests <= most)), hits / tests


def test_long_recording_gives_the_error_that_its_correlation_is_known_to_give():
    """20,000 rows determine rho, and the error is that of an autoregression with it known."""
    rho, rows = 0.8, 20_000
    rng = np.random.default_rng(2011)
    design = 1 + np.linspace(0, 1, rows)[:, None]
    influence = design.T / (design.T @ design)
    error = autoregression(rho, rng, rows)
    residual = error - design @ (influence @ error)
    found = intervals([Series(residual, design, influence)])
    assert found.correlation == pytest.approx(rho, abs=0.015)  # 3 sqrt((1 - rho^2) / n)
    # a slowly varying influence sees the spectrum at frequency 0: (1 + rho) / (1 - rho) = 9
    exact = 3 / np.linalg.norm(design)
    assert np.sqrt(found.covariance[0, 0]) == pytest.approx(exact, rel=0.05)
    assert found.half_width[0] == pytest.approx(1.96 * exact, rel=0.06)


def test_two_recordings_are_no_neighbors():
    """The last row of one recording does not foretell the first of the next."""
    rng = np.random.default_rng(2011)
    one, two = rng.normal(size=(2, 2000))
    design = np.ones((2000, 1))
    apart = intervals([Series(e, design, design.T / 4000) for e in (one + 3, two - 3)])
    # each stands off by 3: 18 times the noise is common to neighbors, 9 / 10 of the variance
    assert apart.correlation == pytest.approx(0.9, abs=0.02)


def test_seven_rows_count_as_independent():
    d = np.arange(1.0, 8.0)
    rng = np.random.default_rng(2011)
    force = 2 * d + rng.normal(size=7)

    def predict(values):
        return [Curve(d, values[0] * d, force_gradient={"k": d})]

    measured = [MeasuredCurve("line", Curve(d, force))]
    plain = fit(predict, measured, ("k",), [1.0])
    found = with_serial_correlation(plain, measured)
    assert np.isnan(found.serial.correlation)
    assert found.serial.effective_rows == 7
    assert found.ci95 == pytest.approx(plain.ci95, rel=1e-8)
    assert found.aicc == pytest.approx(plain.aicc, rel=1e-10)


def test_a_certain_covariance_leaves_the_quantile_of_students_t_up_to_the_normal():
    """Two rows, one constant: 1 degree of freedom, and as many more as is certain of the whole."""
    rows = [Series(np.array([1.0, -1.0]), np.ones((2, 1)), np.full((1, 2), 0.5))]
    alone = intervals(rows)
    variance = alone.covariance[0, 0]
    # quantiles at 97.5 %: of a Cauchy distribution, of the next from tables, then of the normal
    tables = {1: math.tan(0.475 * math.pi), 2: 4.302652729911275, 5: 2.570581835636314,
              30: 2.042272456301238, 120: 1.979930405052777, 1000: 1.962339080826408}  # fmt: skip
    for nu in [1, 2, 5, 30, 120, 1000, *np.logspace(4, 300, 75)]:
        found = intervals(rows, other_covariance=np.array([[variance * (math.sqrt(nu) - 1)]]))
        # Cornish and Fisher's expansion about the normal (Abramowitz and Stegun 1964, 26.7.5)
        z = 1.959963984540054
        second = (5 * z**5 + 16 * z**3 + 3 * z) / 96
        expected = tables.get(nu, z + (z**3 + z) / (4 * nu) + second / nu / nu)
        error = math.sqrt(found.covariance[0, 0])
        assert found.half_width[0] / error == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("certain", [1e6, 1e9, 1e10, 1e12, 1e20, 1e100, 1e153, 1e200])
def test_the_interval_of_a_mixture_holds_95_percent_of_normal_errors(certain):
    """So much more is certain than the rows tell that the errors are normal at each rho."""
    rng = np.random.default_rng(2011)
    for rows in (8, 60, 400):
        design = np.ones((rows, 1))
        series = [Series(rng.normal(size=rows), design, design.T / rows)]
        alone = intervals(series)
        found = intervals(series, other_covariance=certain * alone.covariance)
        z = found.half_width[0] / np.sqrt(found.mixture.covariance[:, 0, 0])
        inside = found.mixture.weight @ [math.erf(t / math.sqrt(2)) for t in z]
        assert inside == pytest.approx(0.95, rel=1e-11)


def test_the_interval_of_a_mixture_of_cauchy_errors_holds_95_percent():
    rng = np.random.default_rng(2011)
    design = rng.normal(size=(8, 7))  # one degree of freedom is left
    influence = np.linalg.pinv(design)
    error = rng.normal(size=8)
    found = intervals([Series(error - design @ (influence @ error), design, influence)])
    for i in range(7):
        t = found.half_width[i] / np.sqrt(found.mixture.covariance[:, i, i])
        assert found.mixture.weight @ np.arctan(t) * 2 / np.pi == pytest.approx(0.95, rel=1e-12)


def test_verb_gives_the_same_interval_however_the_rows_are_resampled(tmp_path):
    """``study calibrate --json`` of 60 rows: half width of a straight regression at any points."""
    _, d = predictor("neo-hookean", ("C10",), DEPTH, points=ROWS)
    rng = np.random.default_rng(2011)
    stretch = 1 - d / 30
    slope = 2 * AREA * (stretch**-2 - stretch)  # F / C10, Treloar's uniaxial closed form
    force = 7e-3 * slope + 0.1 * rng.normal(size=ROWS)
    text = "".join(f"{x:.9f},{y:.9f}\n" for x, y in zip(d, force, strict=True))
    (tmp_path / "a.csv").write_text("d,f\n" + text, encoding="utf-8")
    c10 = slope @ force / (slope @ slope)
    residual = force - c10 * slope
    scatter = np.sqrt(residual @ residual / (ROWS - 1))
    lag1 = (residual[1:] @ residual[:-1]) / (residual @ residual)
    # t of 59 degrees of freedom, kPa, as many rows as Bayley and Hammersley 1946 leave
    by_hand = 2.001 * scatter / np.sqrt(slope @ slope) * np.sqrt((1 + lag1) / (1 - lag1))
    half = {}
    for points in ('"raw"', 60, 200, 1000):
        test = {"points": points, "more": "", "range": '["1 %", "30 %"]'}
        path = case(tmp_path, [test], "neo-hookean", "")
        document = success(
            "calibrate", path, "--data", tmp_path, "--json", "--results", tmp_path / "results"
        ).json
        low, high = document["parameters"]["C10"]["ci95"]
        half[points] = 1e-3 * (high - low) / 2
        assert document["serial_correlation"]["rows"] == 59  # the first lies at 0.5 %
        assert document["serial_correlation"]["correlation"] == pytest.approx(lag1, abs=0.05)
    # that rho is not known widens the interval: by 3 to 15 % over many tests of 60 rows
    assert min(half.values()) > by_hand
    assert max(half.values()) < 1.15 * by_hand
    assert min(half.values()) > 0.93 * max(half.values())


def test_choice_between_energies_does_not_depend_on_the_grid():
    """AICc of one term less that of two: with every point a row it would grow with points."""
    names, truth = ("C10", "C20"), np.array([7e-3, 3e-4])
    at_rows, d = predictor("reduced-polynomial", names, DEPTH, points=ROWS)
    noise = 0.1 * np.random.default_rng(2011).normal(size=ROWS)
    rows = Curve(d, at_rows(truth)[0].force_N + noise)
    found, independent = [], []
    for points in (60, 200, 1000):
        places = np.linspace(0.3, DEPTH, points)
        curve = Curve(places, np.interp(places, d, rows.force_N), recorded=(rows,))
        measured = [MeasuredCurve("virtual", curve)]
        two = predictor("reduced-polynomial", names, DEPTH, places=places)[0]
        one = predictor("neo-hookean", names[:1], DEPTH, places=places)[0]
        fits = fit(one, measured, names[:1], truth[:1]), fit(two, measured, names, truth)
        independent.append(fits[0].aicc - fits[1].aicc)
        fits = tuple(with_serial_correlation(each, measured) for each in fits)
        found.append(fits[0].aicc - fits[1].aicc)
    assert independent[2] > 10 * independent[0]
    # the same from the rows alone: likelihood with the covariance written out
    inside = d >= 0.3
    gradient = at_rows(truth)[0].force_gradient
    design = np.stack([gradient[n][inside] for n in names], axis=1)
    by_hand = [aicc_by_hand(x, rows.force_N[inside]) for x in (design[:, :1], design)]
    assert found == pytest.approx([by_hand[0] - by_hand[1]] * 3, abs=0.05)


def aicc_by_hand(design, force):
    """AICc of a linear model with errors of an autoregression, rho by a search."""
    n, p = design.shape
    apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))

    def deviance(rho):
        covariance = rho**apart / (1 - rho**2)
        inverse = np.linalg.inv(covariance)
        normal, right = design.T @ inverse @ design, design.T @ inverse @ force
        left = force - design @ np.linalg.solve(normal, right)
        return n * np.log(left @ inverse @ left / n) + np.linalg.slogdet(covariance)[1]

    k = p + 2
    least = min(deviance(rho) for rho in np.linspace(-0.9, 0.99, 379))
    return least + 2 * k + 2 * k * (k + 1) / (n - k - 1)
