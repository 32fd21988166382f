"""Robust scale and weights: Tukey's biweight about a scale from the median (Huber 1981)."""

from __future__ import annotations

import numpy as np

from study.arrays import Array, Flags, Ints

#: Median absolute deviation of a normal distribution over its standard deviation.
NORMAL_MAD = 0.6744897501960817

#: Tukey's tuning constant: 95 % efficiency where errors are normal (Holland and Welsch 1977).
BIWEIGHT = 4.685

#: Rounds in which the scale of the inliers settles: each round removes most of what is left.
SCALE_STEPS = 10

#: Neighbors whose mean distance tells how isolated a point of a cloud is.
NEIGHBORS = 8

#: Robust standard deviations of log distance beyond which a point is isolated.
ISOLATED = 3.0


def scale_of(residuals: Array, center: float = 0.0) -> float:
    """Estimate the standard deviation of normal residuals by their median size.

    Parameters
    ----------
    residuals : ndarray
        In any unit, which the result has too.
    center : float
        Their center, in the same unit.
    """
    return float(np.median(np.abs(residuals - center)) / NORMAL_MAD)


def biweight(standardized: Array) -> Array:
    """Weights of residuals over their scale: 1 at zero, 0 from 4.685 on.

    Parameters
    ----------
    standardized : ndarray
        Residuals over their scale, of either sign.

    Returns
    -------
    ndarray
        Of the same shape, from 0 to 1.
    """
    inside = np.clip(1 - (standardized / BIWEIGHT) ** 2, 0, None)
    return np.asarray(inside**2)


def inlier_scale(residuals: Array, start: float | None = None) -> float:
    """Estimate the standard deviation of those residuals that the biweight gives weight.

    The median of all would grow by half where three in ten points are outliers.

    Parameters
    ----------
    residuals : ndarray
        About zero, in any unit, which the result has too.
    start : float, optional
        Scale to begin from; by default that of all residuals.
    """
    scale = scale_of(residuals) if start is None else start
    for _ in range(SCALE_STEPS):
        inside = residuals[np.abs(residuals) < BIWEIGHT * scale]
        if not inside.size or scale == 0:
            return scale
        scale = scale_of(inside)
    return scale


def sandwich(slope: Array, residuals: Array, scale: float, groups: Ints | None = None) -> Array:
    """Covariance of a biweight regression, shape (p, p).

    Huber 1981, section 7.6: A^-1 B A^-1 with A = sum psi' x x' and B = sum psi^2 x x'. Where
    residuals of a group go together, B is the sum over groups of what they add up to (Liang
    and Zeger 1986), enlarged by G/(G - p) for G groups.

    Parameters
    ----------
    slope : ndarray, shape (n, p)
        Derivatives of the residuals by the parameters.
    residuals : ndarray, shape (n,)
        Residuals.
    scale : float
        Their standard deviation.
    groups : ndarray of int, shape (n,), optional
        Number of the group of every residual; without, all are independent.
    """
    u = residuals / scale
    inside = np.clip(1 - (u / BIWEIGHT) ** 2, 0, None)
    psi = scale * u * inside**2
    bread = (slope * (inside**2 - 4 * (u / BIWEIGHT) ** 2 * inside)[:, None]).T @ slope
    scores = slope * psi[:, None]
    size, count = slope.shape[1], int((inside > 0).sum())
    if groups is not None:
        sums = np.zeros((int(groups.max()) + 1, size))
        np.add.at(sums, groups, scores)
        scores = sums[np.bincount(groups, minlength=len(sums)) > 0]
        count = len(scores)
    meat = scores.T @ scores * count / max(count - size, 1)
    inverse = np.linalg.pinv(bread)
    return np.asarray(inverse @ meat @ inverse.T)


def isolated(points: Array) -> Flags:
    """Which points of a cloud have no company: outliers by the cloud alone.

    The mean distance to the nearest neighbors of every point is compared with the others' in
    logarithms (Rusu et al. 2008 do so without). No surface is asked, so a region in which a
    model is wrong is never taken for an outlier.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        In any unit; of :data:`NEIGHBORS` or fewer none is isolated.

    Returns
    -------
    ndarray of bool, shape (n,)
        True for an outlier.
    """
    from scipy.spatial import cKDTree

    if len(points) <= NEIGHBORS:
        return np.zeros(len(points), dtype=bool)
    distances = cKDTree(points).query(points, k=NEIGHBORS + 1)[0][:, 1:].mean(axis=1)
    positive = distances[distances > 0]
    if not positive.size:
        return np.zeros(len(points), dtype=bool)
    logs = np.log(np.maximum(distances, positive.min()))
    middle = float(np.median(logs))
    # the lower half has the cloud alone; outliers would widen the upper one
    spread = scale_of(logs[logs <= middle], middle)
    # a scan on a regular grid has no spread: a factor 3 is far from all of them
    return np.asarray(logs > middle + np.maximum(ISOLATED * spread, np.log(3.0)))
