"""Registration of paired points, fitted spheres, lines with errors in both quantities."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import binom, t

from study.ground.errors import InputError, RefusedError
from study.laboratory.registration import rigid
from study.laboratory.registration.rigid import (
    BIWEIGHT,
    deming_line,
    fit_pairs,
    fit_sphere,
    inlier_scale,
    limits_of_agreement,
    scale_of,
    target_registration_error,
    turned_about,
)
from tests.registration.bodies import cap


def motion(rng):
    points = rng.uniform(-100, 100, (8, 3))
    return points, turned_about(np.zeros(3), rng.standard_normal(3), rng.uniform(-900, 900, 3))


def test_a_known_motion_is_found_to_the_rounding():
    points, truth = motion(np.random.default_rng(1))
    found = fit_pairs(points, truth(points))
    assert np.abs(found.motion.rotation - truth.rotation).max() < 1e-13
    assert np.abs(found.motion.translation - truth.translation).max() < 1e-10
    assert found.scale == pytest.approx(1, abs=1e-13)
    back = found.motion.after(truth.inverse)
    assert np.abs(back(truth(points)) - truth(points)).max() < 1e-9


def test_scale_and_mirror_are_seen():
    points, truth = motion(np.random.default_rng(2))
    assert fit_pairs(points / 1000, truth(points)).scale == pytest.approx(1000)
    assert fit_pairs(points * [1, -1, 1], truth(points)).is_mirrored
    assert not fit_pairs(points, truth(points) + 0.1).is_mirrored


def test_simulated_targets_err_as_fitzpatrick_says():
    """RMS over 4000 simulated registrations; the formula is of first order in FLE."""
    rng = np.random.default_rng(3)
    fiducials, truth = motion(rng)
    targets = np.array([[0.0, 0.0, 0.0], [300.0, 0.0, 50.0]])
    squared, left = np.zeros(2), []
    for _ in range(4000):
        noisy = truth(fiducials) + rng.standard_normal((8, 3)) * 0.5 / np.sqrt(3)
        found = fit_pairs(fiducials, noisy)
        squared += ((found.motion(targets) - truth(targets)) ** 2).sum(axis=1)
        left.append(found.localization_error**2)
    expected = target_registration_error(fiducials, targets, 0.5)
    # an RMS of 4000 three-component errors is known to 1 %
    assert np.sqrt(squared / 4000) == pytest.approx(expected, rel=0.03)
    assert np.sqrt(np.mean(left)) == pytest.approx(0.5, rel=0.03)


@pytest.mark.parametrize(
    ("moving", "count", "rule"),
    [
        (np.eye(3)[:2], 2, "2 pairs"),
        (np.outer(np.arange(5.0), [1.0, 2.0, 3.0]), 5, "on a line"),
        (np.eye(3), 2, "3 points do not pair with 2"),
    ],
)
def test_points_that_fix_no_motion_are_refused(moving, count, rule):
    with pytest.raises(InputError, match=rule):
        fit_pairs(moving, moving[:count] + 1)


def test_the_scale_of_inliers_has_settled():
    """Residuals each a little larger than the last are let out one by one, in many rounds."""
    most = 0
    for power in (2.82, 2.85, 2.9):  # near log2(4.685 / 0.6745): each round lets out a few of 500
        residuals = np.arange(1.0, 501.0) ** power
        scale = inlier_scale(residuals)
        assert scale_of(residuals[residuals < BIWEIGHT * scale]) == scale
        rounds, before, now = 0, np.inf, scale_of(residuals)
        while now != before:
            before, now = now, scale_of(residuals[residuals < BIWEIGHT * now])
            rounds += 1
        most = max(most, rounds)
    assert most > 12


# Fitted spheres: the truth lies in the stated interval as often as it promises.


@pytest.mark.parametrize("scans", [40, pytest.param(100, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("share", "outliers", "n"),
    [(1.0, 0.0, 200), (0.25, 0.0, 200), (0.1, 0.0, 400), (0.25, 0.3, 300)],
    ids=["whole", "quarter", "tenth", "quarter with outliers"],
)
def test_the_truth_is_in_the_interval_in_95_of_100_scans(share, outliers, n, scans):
    rng = np.random.default_rng(11)
    foreign = int(outliers * n)
    inside = np.zeros(4)
    for _ in range(scans):
        center = 50 * rng.standard_normal(3)
        points = cap(center, 9.5, share, n, 0.02, rng)
        points[:foreign] = center + rng.uniform(-15, 15, (foreign, 3))
        found = fit_sphere(points)
        error = np.append(found.center - center, found.radius_mm - 9.5)
        half = t.ppf(0.975, n - foreign - 4) * np.sqrt(np.diag(found.covariance))
        inside += np.abs(error) < half
    # one figure of four leaves these bounds by chance in 1 of 500 such tests
    low, high = binom.ppf([2.5e-4, 1 - 2.5e-4], scans, 0.95)
    assert (inside >= low).all(), inside
    assert (inside <= high).all(), inside


def test_exact_points_give_the_sphere_to_the_rounding():
    rng = np.random.default_rng(3)
    center = np.array([120.0, -40.0, 900.0])
    found = fit_sphere(cap(center, 19.05, 0.2, 50, 0.0, rng))
    assert np.abs(found.center - center).max() < 1e-9
    assert found.radius_mm == pytest.approx(19.05, abs=1e-9)


def test_outliers_are_counted_and_the_coverage_is_said():
    rng = np.random.default_rng(4)
    points = cap(np.zeros(3), 10.0, 0.25, 400, 0.01, rng)
    points[:100] = rng.uniform(20, 30, (100, 3))
    found = fit_sphere(points)
    assert found.outliers == 100
    # the smallest cap about the mean direction of a quarter of a sphere is that quarter
    assert found.coverage == pytest.approx(0.25, abs=0.03)
    assert found.scatter_mm == pytest.approx(0.01, rel=0.15)


@pytest.mark.parametrize(
    ("points", "rule"),
    [
        (np.eye(3), "needs 5"),
        (np.column_stack([np.random.default_rng(1).random((20, 2)), np.zeros(20)]), "plane"),
        (np.outer(np.linspace(0, 3, 12), [1.0, 2.0, 3.0]), "on a line"),
        (np.full((9, 3), 3.7), "at one place"),
        (np.vstack([np.full((7, 3), 3.7), [[1.0, 0.0, 0.0]]]), "on a line"),
        (
            np.vstack([np.eye(3), np.eye(3), [[np.nan, 0.0, 1.0]]]),
            "1 of 7 points have .* no number",
        ),
        (1e160 * np.random.default_rng(1).random((8, 3)), "8 of 8 points .* and more"),
        (1e-300 * np.random.default_rng(1).random((8, 3)), "at one place"),
    ],
)
def test_points_that_fix_no_sphere_are_refused(points, rule):
    with pytest.raises(InputError, match=rule):
        fit_sphere(points)


def test_a_cap_too_flat_for_a_radius_is_refused():
    rng = np.random.default_rng(5)
    with pytest.raises(InputError, match=r"radius is open|plane"):
        fit_sphere(cap(np.zeros(3), 10.0, 0.0005, 60, 0.05, rng))


def test_a_search_that_has_not_settled_gives_no_sphere(monkeypatch):
    points = cap(np.zeros(3), 10.0, 0.3, 200, 0.05, np.random.default_rng(2011))
    fit_sphere(points)
    monkeypatch.setattr(rigid, "MAX_STEPS", 1)
    with pytest.raises(RefusedError, match="not settled in 1 steps"):
        fit_sphere(points)


def test_copies_of_half_the_points_are_no_singular_matrix():
    rng = np.random.default_rng(8)
    points = cap(np.zeros(3), 10.0, 0.5, 40, 0.0, rng)
    points[::2] = points[0]
    found = fit_sphere(points)
    assert np.abs(found.center).max() < 1e-6
    assert found.radius_mm == pytest.approx(10.0, abs=1e-6)


# Lines with errors in both quantities, limits of agreement: known answers and coverage.


LINES = 600


def test_the_line_is_that_of_orthogonal_distance_regression():
    """The true places are unknowns too (Boggs, Byrd and Schnabel 1987), found by iteration."""
    rng = np.random.default_rng(1)
    x = np.linspace(0, 50, 15)
    y = 1.02 * x - 0.4 + 0.8 * rng.standard_normal(15)
    x = x + 0.4 * rng.standard_normal(15)

    def distances(unknown):
        places = unknown[2:]
        return np.append((x - places) / 0.4, (y - unknown[1] - unknown[0] * places) / 0.8)

    known = least_squares(distances, np.append([1.0, 0.0], x), xtol=1e-14, ftol=1e-14).x[:2]
    found = deming_line(x, y, variance_ratio=4.0)
    assert [found.scale, found.offset] == pytest.approx(known, rel=1e-6)


def test_an_exact_abscissa_gives_least_squares():
    rng = np.random.default_rng(2)
    x = np.arange(10.0)
    y = 3 - 2 * x + rng.standard_normal(10)
    known = np.polyfit(x, y, 1)
    for ratio in (np.inf, 1e12):
        found = deming_line(x, y, ratio)
        assert [found.scale, found.offset] == pytest.approx(known, rel=1e-9)


def test_intervals_hold_the_truth_in_95_of_100():
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


def test_a_bias_that_grows_is_seen():
    x = np.linspace(1, 20, 20)
    noise = 0.01 * np.random.default_rng(4).standard_normal(20)
    found = limits_of_agreement(1.05 * x + noise, x)
    assert found.trend == pytest.approx(0.05 / 1.025, rel=0.02)
    assert found.trend_p < 1e-6


@pytest.mark.parametrize("n", [1, 2])
def test_too_few_items_are_refused(n):
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
def test_pairs_that_fix_no_line_are_refused(x, y, ratio, rule):
    with pytest.raises(InputError, match=rule):
        deming_line(np.array(x), np.array(y), ratio)
