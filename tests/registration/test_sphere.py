"""Fitted spheres: the truth lies in the stated interval as often as it promises."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, t

from study.ground.errors import InputError, RefusedError
from study.laboratory.registration import rigid
from study.laboratory.registration.rigid import fit_sphere
from tests.registration.bodies import cap

SCANS = 200


@pytest.mark.parametrize(
    ("share", "outliers", "n"),
    [(1.0, 0.0, 200), (0.25, 0.0, 200), (0.1, 0.0, 400), (0.25, 0.3, 300)],
    ids=["whole", "quarter", "tenth", "quarter with outliers"],
)
def test_the_truth_is_in_the_interval_in_95_of_100_scans(
    share: float, outliers: float, n: int
) -> None:
    rng = np.random.default_rng(11)
    foreign = int(outliers * n)
    inside = np.zeros(4)
    for _ in range(SCANS):
        center = 50 * rng.standard_normal(3)
        points = cap(center, 9.5, share, n, 0.02, rng)
        points[:foreign] = center + rng.uniform(-15, 15, (foreign, 3))
        found = fit_sphere(points)
        error = np.append(found.center - center, found.radius_mm - 9.5)
        half = t.ppf(0.975, n - foreign - 4) * np.sqrt(np.diag(found.covariance))
        inside += np.abs(error) < half
    # one figure of four leaves these bounds by chance in 1 of 500 such tests
    low, high = binom.ppf([2.5e-4, 1 - 2.5e-4], SCANS, 0.95)
    assert (inside >= low).all(), inside
    assert (inside <= high).all(), inside


def test_exact_points_give_the_sphere_to_the_rounding() -> None:
    rng = np.random.default_rng(3)
    center = np.array([120.0, -40.0, 900.0])
    found = fit_sphere(cap(center, 19.05, 0.2, 50, 0.0, rng))
    assert np.abs(found.center - center).max() < 1e-9
    assert found.radius_mm == pytest.approx(19.05, abs=1e-9)


def test_outliers_are_counted_and_the_coverage_is_said() -> None:
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
def test_points_that_fix_no_sphere_are_refused(points: np.ndarray, rule: str) -> None:
    with pytest.raises(InputError, match=rule):
        fit_sphere(points)


def test_a_cap_too_flat_for_a_radius_is_refused() -> None:
    rng = np.random.default_rng(5)
    with pytest.raises(InputError, match=r"radius is open|plane"):
        fit_sphere(cap(np.zeros(3), 10.0, 0.0005, 60, 0.05, rng))


def test_a_search_that_has_not_settled_gives_no_sphere(monkeypatch: pytest.MonkeyPatch) -> None:
    points = cap(np.zeros(3), 10.0, 0.3, 200, 0.05, np.random.default_rng(2011))
    fit_sphere(points)
    monkeypatch.setattr(rigid, "MAX_STEPS", 1)
    with pytest.raises(RefusedError, match="not settled in 1 steps"):
        fit_sphere(points)


def test_copies_of_half_the_points_are_no_singular_matrix() -> None:
    rng = np.random.default_rng(8)
    points = cap(np.zeros(3), 10.0, 0.5, 40, 0.0, rng)
    points[::2] = points[0]
    found = fit_sphere(points)
    assert np.abs(found.center).max() < 1e-6
    assert found.radius_mm == pytest.approx(10.0, abs=1e-6)
