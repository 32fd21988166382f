"""Lines with errors in both quantities, limits of agreement: known answers and coverage."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import binom

from study.ground.errors import InputError
from study.laboratory.registration.rigid import deming_line, limits_of_agreement

LINES = 600


def test_the_line_is_that_of_orthogonal_distance_regression() -> None:
    """The true places are unknowns too (Boggs, Byrd and Schnabel 1987), found by iteration."""
    rng = np.random.default_rng(1)
    x = np.linspace(0, 50, 15)
    y = 1.02 * x - 0.4 + 0.8 * rng.standard_normal(15)
    x = x + 0.4 * rng.standard_normal(15)

    def distances(unknown: np.ndarray) -> np.ndarray:
        places = unknown[2:]
        return np.append((x - places) / 0.4, (y - unknown[1] - unknown[0] * places) / 0.8)

    known = least_squares(distances, np.append([1.0, 0.0], x), xtol=1e-14, ftol=1e-14).x[:2]
    found = deming_line(x, y, variance_ratio=4.0)
    assert [found.scale, found.offset] == pytest.approx(known, rel=1e-6)


def test_an_exact_abscissa_gives_least_squares() -> None:
    rng = np.random.default_rng(2)
    x = np.arange(10.0)
    y = 3 - 2 * x + rng.standard_normal(10)
    known = np.polyfit(x, y, 1)
    for ratio in (np.inf, 1e12):
        found = deming_line(x, y, ratio)
        assert [found.scale, found.offset] == pytest.approx(known, rel=1e-9)


def test_intervals_hold_the_truth_in_95_of_100() -> None:
    rng = np.random.default_rng(3)
    held = np.zeros(5)
    truth = np.linspace(0, 50, 11)
    for _ in range(LINES):
        x = truth + 0.1 * rng.standard_normal(11)
        y = 1.01 * truth + 0.3 + 0.2 * rng.standard_normal(11)
        line = deming_line(x, y, 4.0)
        pair = limits_of_agreement(rng.standard_normal(11) + 0.5, np.zeros(11))
        intervals = (
            (line.scale_interval, 1.01), (line.offset_interval, 0.3),
            (pair.bias_interval, 0.5), (pair.lower_interval, 0.5 - 1.959964),
            (pair.upper_interval, 0.5 + 1.959964),
        )  # fmt: skip
        held += [low < value < high for (low, high), value in intervals]
    low, high = binom.ppf([2e-4, 1 - 2e-4], LINES, 0.95)
    assert (held >= low).all(), held
    assert (held <= high).all(), held


def test_a_bias_that_grows_is_seen() -> None:
    x = np.linspace(1, 20, 20)
    noise = 0.01 * np.random.default_rng(4).standard_normal(20)
    found = limits_of_agreement(1.05 * x + noise, x)
    assert found.trend == pytest.approx(0.05 / 1.025, rel=0.02)
    assert found.trend_p < 1e-6


@pytest.mark.parametrize("n", [1, 2])
def test_too_few_items_are_refused(n: int) -> None:
    x = np.arange(float(n))
    with pytest.raises(InputError, match="need 3 items"):
        limits_of_agreement(x, x)
    with pytest.raises(InputError, match="needs 4 pairs"):
        deming_line(x, x, 1.0)


@pytest.mark.parametrize(
    ("x", "y", "ratio", "rule"),
    [
        ([5.0, 5.0, 5.0, 10.0], [5.0, 5.1, 4.9, 10.0], np.inf, "3 of 4 pairs are at one place"),
        ([1.0, 1.0, 2.0, 2.0], [0.0, 9.0, 0.0, 9.0], 1.0, "y does not go with x"),
        ([1e-300, 2e-300, 3e-300, 4e-300], [1.0, 2.0, 3.0, 4.0], np.inf, "y does not go with x"),
    ],
)
def test_pairs_that_fix_no_line_are_refused(
    x: list[float], y: list[float], ratio: float, rule: str
) -> None:
    with pytest.raises(InputError, match=rule):
        deming_line(np.array(x), np.array(y), ratio)
