"""Rigid registration of paired points, and what it says of targets."""

from __future__ import annotations

import numpy as np
import pytest

from study.ground.errors import InputError
from study.laboratory.registration.rigid import (
    BIWEIGHT,
    fit_pairs,
    inlier_scale,
    scale_of,
    target_registration_error,
    turned_about,
)


def motion(rng: np.random.Generator) -> tuple[np.ndarray, object]:
    points = rng.uniform(-100, 100, (8, 3))
    return points, turned_about(np.zeros(3), rng.standard_normal(3), rng.uniform(-900, 900, 3))


def test_a_known_motion_is_found_to_the_rounding() -> None:
    points, truth = motion(np.random.default_rng(1))
    found = fit_pairs(points, truth(points))
    assert np.abs(found.motion.rotation - truth.rotation).max() < 1e-13
    assert np.abs(found.motion.translation - truth.translation).max() < 1e-10
    assert found.scale == pytest.approx(1, abs=1e-13)
    back = found.motion.after(truth.inverse)
    assert np.abs(back(truth(points)) - truth(points)).max() < 1e-9


def test_scale_and_mirror_are_seen() -> None:
    points, truth = motion(np.random.default_rng(2))
    assert fit_pairs(points / 1000, truth(points)).scale == pytest.approx(1000)
    assert fit_pairs(points * [1, -1, 1], truth(points)).is_mirrored
    assert not fit_pairs(points, truth(points) + 0.1).is_mirrored


def test_simulated_targets_err_as_fitzpatrick_says() -> None:
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
def test_points_that_fix_no_motion_are_refused(moving: np.ndarray, count: int, rule: str) -> None:
    with pytest.raises(InputError, match=rule):
        fit_pairs(moving, moving[:count] + 1)


def test_the_scale_of_inliers_has_settled() -> None:
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
