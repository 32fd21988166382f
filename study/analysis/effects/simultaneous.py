"""Simultaneous intervals of many contrasts, each with its own variance over blocks.

The multiplier is the quantile of the largest |t| of all contrasts, simulated from normal blocks
that have the covariance of the observed ones (parametric bootstrap; Westfall and Young 1993,
Resampling-Based Multiple Testing, chapter 2). Neither sphericity nor equal variances is needed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import overload

import numpy as np

from study.arrays import Array, Ints

#: Draws of the largest |t|; 2,000 give its .96 quantile to about 3 %.
DRAWS = 4000
#: Quantile taken for an error of .05: the plug-in covariance makes the .95 quantile slightly
#: liberal (coverage .914 to .970 simulated at .95, .949 to .960 at .96).
SHARPER = 0.8
#: With fewer blocks their covariance is too unsure to be simulated from: Bonferroni instead.
FEWEST_BLOCKS = 5
#: Blocks beyond which their covariance is factored first; below, that saves nothing.
MANY_BLOCKS = 9
#: Values held at once by a simulation: 4 MB, which stay in the cache of one core.
_AT_ONCE = 500_000


@overload
def bonferroni(contrasts: int, df: float, alpha: float) -> float: ...
@overload
def bonferroni(contrasts: int, df: Array, alpha: float) -> Array: ...
def bonferroni(contrasts: int, df: float | Array, alpha: float) -> float | Array:
    """Multiplier that holds whatever the dependence."""
    from scipy.special import stdtrit

    found = stdtrit(df, 1 - alpha / (2 * contrasts))
    return np.asarray(found) if np.ndim(found) else float(found)


@overload
def block_multiplier(contrasts: Array, alpha: float, seed: int) -> float: ...
@overload
def block_multiplier(
    contrasts: Array, alpha: float, seed: int, groups: Sequence[Ints], df: Array
) -> Array: ...
def block_multiplier(
    contrasts: Array, alpha: float, seed: int, groups: Sequence[Ints] = (), df: Array | None = None
) -> float | Array:
    """Multiplier of the standard errors for simultaneous intervals of all contrasts.

    Parameters
    ----------
    contrasts : ndarray, shape (m, b)
        Value of every contrast in every block; in groups, what each block adds to it.
    alpha : float
        1 - level of the intervals together.
    seed : int
        Of the simulation.
    groups : sequence of ndarray of int, optional
        Blocks of each group, which have a covariance of their own; one group by default.
    df : ndarray, shape (m,), optional
        Degrees of freedom of each contrast, b - 1 by default.

    Returns
    -------
    float or ndarray, shape (m,)
        Bonferroni's with fewer than five blocks in a group or where that is smaller.
    """
    m, b = contrasts.shape
    parts = list(groups) or [np.arange(b)]
    safe = bonferroni(max(m, 1), b - 1 if df is None else df, alpha)
    if m <= 1 or min(len(part) for part in parts) < FEWEST_BLOCKS:
        return safe
    roots = [_centred(contrasts[:, part]) for part in parts]
    z = np.concatenate(roots, axis=1)
    spread = np.sqrt(np.sum(z**2, axis=1))
    z = z[spread > 1e-12 * spread.max(initial=0.0)]
    if not len(z):
        return safe
    z = np.unique((z / np.sqrt(np.sum(z**2, axis=1))[:, None]).round(9), axis=0)
    ends = np.cumsum([len(part) for part in parts])[:-1]
    largest = _largest_t(np.split(z, ends, axis=1), [len(part) for part in parts], seed)
    found = float(np.quantile(largest, 1 - SHARPER * alpha))
    return np.minimum(safe, found) if isinstance(safe, np.ndarray) else min(safe, found)


def _centred(values: Array) -> Array:
    """Root of the covariance of some blocks: z z' is their covariance, shape (m, b)."""
    centre = values.mean(axis=1, keepdims=True)
    return np.asarray((values - centre) / math.sqrt(values.shape[1] - 1))


def _largest_t(roots: Sequence[Array], blocks: Sequence[int], seed: int) -> Array:
    """Largest |t| of all contrasts in each draw of blocks from N(0, z z') of each group.

    Of x columns drawn, the contrasts z x have the sum of squares z (x x') z': one product with
    all z z' serves every draw, and no draw of every contrast in every block has to be held.
    """
    random = np.random.default_rng(seed)
    found = np.empty(DRAWS)
    short = [_short(z) for z in roots]
    pairs = [np.triu_indices(z.shape[1]) for z in short]
    # what is off the diagonal counts twice
    twice = [np.where(i == j, 1.0, 2.0) for i, j in pairs]
    outer = [(z[:, i] * z[:, j] * w).T for z, (i, j), w in zip(short, pairs, twice, strict=True)]
    most = max(len(z) * b for z, b in zip(short, blocks, strict=True))
    step = max(1, min(DRAWS, _AT_ONCE // most))
    for start in range(0, DRAWS, step):
        n = min(step, DRAWS - start)
        total, variance = np.zeros((n, len(roots[0]))), np.zeros((n, len(roots[0])))
        for z, b, (i, j), products in zip(short, blocks, pairs, outer, strict=True):
            x = random.standard_normal((n, z.shape[1], b))
            added = x.sum(axis=2) @ z.T
            squares = (x @ x.transpose(0, 2, 1))[:, i, j] @ products
            total += added
            variance += (squares - added**2 / b) * (b / (b - 1))
        found[start : start + n] = np.abs(total / np.sqrt(np.maximum(variance, 1e-300))).max(axis=1)
    return found


def _short(z: Array) -> Array:
    """Root of z z' with no more columns than rows where blocks are many (400 resamples)."""
    if z.shape[1] <= MANY_BLOCKS or z.shape[1] <= z.shape[0]:
        return z
    upper = np.asarray(np.linalg.qr(z.T, mode="r"))
    return np.asarray(upper.T)


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
