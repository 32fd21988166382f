"""Slopes are limited where the cubic would overshoot, and nowhere else."""

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from study.laboratory.haptics.haptic_export import is_monotone, monotone_slopes


def falls(knots, values, slopes):
    """Whether the interpolant falls inside each interval: the minimum of its derivative."""
    derivative = CubicHermiteSpline(knots, values, slopes).derivative()
    # 400 places an interval; a parabola between two of them is lower by 1e-6 of its height
    inside = np.linspace(knots[:-1], knots[1:], 400)
    return np.asarray(derivative(inside).min(axis=0) < -1e-5 * np.abs(slopes).max())


@pytest.mark.parametrize("seed", range(20))
def test_rising_data_make_a_rising_interpolant(seed):
    random = np.random.default_rng(seed)
    knots = np.cumsum(random.uniform(0.1, 2.0, 30))
    values = np.cumsum(random.exponential(1.0, 30) ** 2)
    slopes = random.exponential(4.0, 30)
    assert falls(knots, values, slopes).any()
    limited = monotone_slopes(knots, values, slopes)
    assert not falls(knots, values, limited).any()
    assert np.all((limited >= 0) & (limited <= slopes))


@pytest.mark.parametrize("seed", range(5))
def test_the_condition_is_exact(seed):
    """It agrees with the derivative's own minimum, which it does not use."""
    random = np.random.default_rng(100 + seed)
    knots, values = np.arange(200.0), np.cumsum(random.uniform(0.5, 1.5, 200))
    slopes = random.uniform(0.0, 4.5, 200)
    found = is_monotone(np.diff(values), slopes)
    assert 20 < found.sum() < 180
    assert np.array_equal(found, ~falls(knots, values, slopes))


def test_a_slope_that_does_no_harm_stays():
    # with chord slopes of 1: (1, 4) is on the ellipse of Fritsch and Carlson, (0.9, 4) outside
    knots = np.array([0.0, 1.0])
    for slopes in ([1.0, 4.0], [0.0, 3.0], [3.0, 3.0]):
        assert monotone_slopes(knots, knots, np.array(slopes)).tolist() == slopes
    assert monotone_slopes(knots, knots, np.array([0.9, 4.0])).tolist() == [0.9, 3.0]


def test_where_the_data_turn_nothing_is_changed():
    """A limit point lies between the second and the third knot: the slopes know it."""
    knots = np.array([0.0, 1.0, 2.0, 3.0])
    values, slopes = np.array([0.0, 1.0, 1.1, 0.8]), np.array([1.2, 0.6, -0.3, -0.4])
    assert monotone_slopes(knots, values, slopes).tolist() == slopes.tolist()
    assert not is_monotone(np.diff(values), slopes)[1]


def test_falling_data_make_a_falling_interpolant():
    knots, values = np.arange(3.0), np.array([0.0, -1.0, -1.1])
    assert monotone_slopes(knots, values, np.array([-1.0, -4.0, -0.1])).tolist() == pytest.approx(
        [-1.0, -0.3, -0.1]
    )
