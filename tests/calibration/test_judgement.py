"""Lack of fit, pattern, choice, agreement between fits, and a search along an edge."""

import numpy as np
import pytest

from study.ground.errors import InputError, RefusedError
from study.mechanics.calibration.fit import fit
from study.mechanics.calibration.lack_of_fit import agreement, lack_of_fit, pattern, same_constants
from study.mechanics.calibration.levenberg_marquardt import Status, levenberg_marquardt
from study.mechanics.calibration.residual_function import EvaluationFailed
from tests.calibration.cylinder import predictor, virtual

RP2 = "reduced-polynomial", ("C10", "C20")


def test_lack_of_fit_is_the_textbook_f_test():
    """A straight line through three points of two repeats each, by hand.

    Means 1, 2, 4 at x = 0, 1, 2; the line 5/6 + 1.5 x misses them by -1/6, 1/3, -1/6, so
    that 2 (1/36 + 1/9 + 1/36) = 1/3 has 1 degree of freedom; each pair scatters by
    +-0.1: 2 x 0.01 x 3 = 0.06 with 3 degrees of freedom; F = (1/3) / 0.02 = 50/3.
    """
    residual = np.array([-1 / 6, 1 / 3, -1 / 6])
    found = lack_of_fit([(residual, np.full(3, np.sqrt(0.02)), 2)], 2)
    assert (found.df, found.df_error) == (1, 3)
    assert found.statistic == pytest.approx(50 / 3, rel=1e-12)
    # F(1, 3) is the square of t(3), and F(1, 1) that of a Cauchy variable: both by arctan
    t = np.sqrt(50 / 9)
    by_hand = 1 - 2 / np.pi * (np.arctan(t) + t / (1 + t**2))
    assert found.p_independent == pytest.approx(by_hand, rel=1e-10)
    assert found.p_dependent == pytest.approx(1 - 2 / np.pi * np.arctan(np.sqrt(50 / 3)))
    assert found.verdict == "undecided"


def test_nothing_repeated_and_no_degrees_of_freedom():
    assert lack_of_fit([], 2) is None
    assert lack_of_fit([(np.ones(2), np.ones(2), 3)], 2) is None
    assert lack_of_fit([(np.ones(5), np.zeros(5), 3)], 2) is None


def test_pattern_tells_misfit_from_noise():
    rng = np.random.default_rng(2011)
    noise = pattern([rng.normal(size=100), rng.normal(size=100)])
    assert abs(noise.lag1) < 0.15  # two standard deviations of 1/sqrt(200)
    assert noise.p > 0.05
    wave = pattern([np.sin(np.linspace(0, 7, 100))])
    assert wave.lag1 > 0.95
    assert wave.p < 1e-10
    assert pattern([np.ones(4)]) is None
    assert pattern([np.zeros(20)]) is None


def test_runs_of_a_published_sequence():
    """Wald and Wolfowitz: 11 plus and 9 minus signs in 12 runs: expected 10.9, variance 4.6."""
    signs = np.array([1, 1, -1, -1, 1, -1, 1, 1, 1, -1, 1, -1, -1, 1, 1, -1, -1, -1, 1, 1])
    found = pattern([signs.astype(float)])
    plus, minus = int((signs > 0).sum()), int((signs < 0).sum())
    assert found.runs == 1 + int(np.count_nonzero(np.diff(signs)))
    assert found.expected_runs == pytest.approx(1 + 2 * plus * minus / 20)


def test_same_constants_keeps_its_level():
    rng, rejected = np.random.default_rng(7), 0
    x = np.linspace(1, 2, 15)
    for _ in range(1000):
        y = 3 * x + rng.normal(size=(3, 15))
        own = sum(float(np.sum((row - x * (row @ x) / (x @ x)) ** 2)) for row in y)
        slope = float((y @ x).sum() / (3 * x @ x))
        p = same_constants(float(np.sum((y - slope * x) ** 2)), own, 45, 1, 3)
        rejected += p is not None and p < 0.05
    assert rejected / 1000 == pytest.approx(0.05, abs=0.014)
    assert same_constants(1.0, 0.0, 45, 1, 3) is None


def _fits(shift, rng):
    predict, d = predictor(*RP2, depth=9.0, points=30)
    found = []
    for true in ([7e-3, 1e-3], [(1 + shift) * 7e-3, 1e-3], [7e-3, 1e-3]):
        data = virtual(predict, true, d, 0.02, rng)
        found.append(fit(predict, data, RP2[1], [5e-3, 0.0]))
    return found


def test_agreement_keeps_its_level_and_sees_a_difference():
    rng = np.random.default_rng(2011)
    p = [agreement(_fits(0.0, rng)).p for _ in range(100)]
    # chi-square of t-distributed distances rejects a little more often than 5 %
    assert 0.01 <= np.mean(np.array(p) < 0.05) <= 0.12
    different = agreement(_fits(0.05, rng))
    assert different.p < 1e-6
    assert different.df == 4
    # a common uncertainty of that size, added to each, makes them agree
    extra = [np.diag([(0.05 * 7e-3) ** 2, (1e-3) ** 2])] * 3
    assert agreement(_fits(0.05, rng), extra).p > 0.05


def test_agreement_of_what_cannot_be_compared():
    one, two, _ = _fits(0.0, np.random.default_rng(1))
    with pytest.raises(InputError, match="two or more"):
        agreement([one])
    predict, d = predictor(*RP2, depth=9.0, points=2)
    exact = fit(predict, virtual(predict, [7e-3, 1e-3], d), RP2[1], [5e-3, 0.0])
    with pytest.raises(RefusedError, match="without a covariance"):
        agreement([two, exact])


def test_a_search_along_an_edge_ends_there():
    """A valley that leads along constants without an answer: told, and not crept along for ever."""

    def walled(x):
        if x[1] > 1 + 0.3 * np.sin(40 * x[0]):
            raise EvaluationFailed("no equilibrium")
        return np.array([x[0] - 3, 10 * (x[1] - 2)]), np.diag([1.0, 10.0])

    patient = levenberg_marquardt(walled, [0.0, 0.0], max_evaluations=400)
    hasty = levenberg_marquardt(walled, [0.0, 0.0], max_evaluations=400, edge=1e-2)
    assert hasty.status is Status.at_edge
    assert not hasty.converged
    assert hasty.status.usable
    assert hasty.evaluations < patient.evaluations
    assert hasty.cost <= 1.3 * patient.cost


def kinked(x):
    """Least squares of (x - 2) on the left of 1 and of 3 (x - 1) + 0.5 on its right."""
    a, b = x
    left = np.array([a - 2, b]), np.eye(2)
    right = np.array([-1 + 3 * (1 - a), b]), np.array([[-3.0, 0.0], [0.0, 1.0]])
    return left if a < 1 else right


def test_a_kink_is_a_minimum_without_standard_errors():
    for edge in (0.0, 1e-3):
        found = levenberg_marquardt(kinked, [0.3, 1.0], edge=edge)
        assert found.status is Status.at_kink
        assert found.x == pytest.approx([1, 0], abs=1e-3)
        assert found.status.usable
        assert not found.converged


def test_a_wrong_gradient_is_no_kink():
    def wrong(x):
        return np.array([x[0] - 1, x[1]]), np.array([[-1.0, 0.0], [0.0, 1.0]])

    for edge in (0.0, 1e-3):
        assert levenberg_marquardt(wrong, [3.0, 0.0], edge=edge).status is Status.no_decrease


@pytest.mark.parametrize(("jump", "alike"), [(3e-4, True), (3e-2, False)])
def test_a_kink_of_no_consequence_is_a_minimum(jump, alike):
    """The gradient jumps from -jump to +jump of the residual, whose minimum is at the jump.

    Bates and Watts's criterion calls a thousandth near enough where evaluations are dear.
    """

    def bent(x):
        side = 1.0 if x[0] > 1 else -1.0
        residual = np.array([x[0] - 1, 10 * (x[1] - 2), 1 + jump * abs(x[0] - 1)])
        return residual, np.array([[1.0, 0.0], [0.0, 10.0], [side * jump, 0.0]])

    dear = levenberg_marquardt(bent, [0.3, 1.0], edge=1e-3)
    assert dear.x == pytest.approx([1, 2], abs=2 * jump)
    assert dear.status is (Status.converged_cost if alike else Status.at_kink)
    assert not levenberg_marquardt(bent, [0.3, 1.0]).converged
