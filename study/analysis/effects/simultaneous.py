"""Simultaneous intervals of many contrasts, each with its own variance over blocks.

The multiplier is the quantile of the largest |t| of all contrasts, simulated from normal blocks
that have the covariance of the observed ones (parametric bootstrap; Westfall and Young 1993,
Resampling-Based Multiple Testing, chapter 2). Neither sphericity nor equal variances is needed.
"""

from __future__ import annotations

import math

import numpy as np

from study.arrays import Array

#: Draws of the largest |t|; 2,000 give its .96 quantile to about 3 %.
DRAWS = 4000
#: Quantile taken for an error of .05: the plug-in covariance makes the .95 quantile slightly
#: liberal (coverage .914 to .970 simulated at .95, .949 to .960 at .96).
SHARPER = 0.8
#: With fewer blocks their covariance is too unsure to be simulated from: Bonferroni instead.
FEWEST_BLOCKS = 5
#: Values held at once by a simulation: 64 MB.
_AT_ONCE = 8_000_000


def bonferroni(contrasts: int, df: float, alpha: float) -> float:
    """Multiplier that holds whatever the dependence."""
    from scipy.special import stdtrit

    return float(stdtrit(df, 1 - alpha / (2 * contrasts)))


def block_multiplier(contrasts: Array, alpha: float, seed: int) -> float:
    """Multiplier of the standard errors for simultaneous intervals of all contrasts.

    Parameters
    ----------
    contrasts : ndarray, shape (m, b)
        Value of every contrast in every block.
    alpha : float
        1 - level of the intervals together.
    seed : int
        Of the simulation.

    Returns
    -------
    float
        Bonferroni's with fewer than five blocks or where that is smaller.
    """
    m, b = contrasts.shape
    safe = bonferroni(max(m, 1), b - 1, alpha)
    if m <= 1 or b < FEWEST_BLOCKS:
        return safe
    z = (contrasts - contrasts.mean(axis=1, keepdims=True)) / math.sqrt(b - 1)
    spread = np.sqrt(np.sum(z**2, axis=1))
    z = z[spread > 1e-12 * spread.max(initial=0.0)]
    if not len(z):
        return safe
    z = np.unique((z / np.sqrt(np.sum(z**2, axis=1))[:, None]).round(9), axis=0)
    largest = _largest_t(z, b, seed)
    return min(safe, float(np.quantile(largest, 1 - SHARPER * alpha)))


def _largest_t(z: Array, b: int, seed: int) -> Array:
    """Largest |t| of all contrasts in each draw of b blocks from N(0, z z')."""
    random = np.random.default_rng(seed)
    found = np.empty(DRAWS)
    step = max(1, min(DRAWS, _AT_ONCE // (len(z) * b)))
    for start in range(0, DRAWS, step):
        n = min(step, DRAWS - start)
        draws = z @ random.standard_normal((n, b, b))
        mean = draws.mean(axis=2)
        error = np.sqrt(np.maximum(draws.var(axis=2, ddof=1), 1e-300) / b)
        found[start : start + n] = np.abs(mean / error).max(axis=1)
    return found


def pooled_multiplier(root: Array, df: float, alpha: float, seed: int) -> float:
    """Multiplier where one error variance with ``df`` degrees of freedom serves all contrasts.

    Parameters
    ----------
    root : ndarray, shape (m, p)
        The contrasts are ``root`` times independent normals of one variance.

    Returns
    -------
    float
        Quantile of the largest |t| of a multivariate t (Hothorn, Bretz and Westfall 2008),
        simulated; never above Bonferroni's.
    """
    length = np.sqrt(np.sum(root**2, axis=1))
    root = root[length > 1e-12 * length.max(initial=0.0)]
    safe = bonferroni(max(len(root), 1), df, alpha)
    if len(root) <= 1:
        return safe
    unit = root / np.sqrt(np.sum(root**2, axis=1))[:, None]
    unit = np.unique(unit.round(9), axis=0)
    random = np.random.default_rng(seed)
    found = np.empty(DRAWS)
    step = max(1, min(DRAWS, _AT_ONCE // len(unit)))
    for start in range(0, DRAWS, step):
        n = min(step, DRAWS - start)
        normal = np.abs(unit @ random.standard_normal((unit.shape[1], n))).max(axis=0)
        found[start : start + n] = normal / np.sqrt(random.chisquare(df, n) / df)
    return min(safe, float(np.quantile(found, 1 - alpha)))
