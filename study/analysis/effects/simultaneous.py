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

from study.analysis.effects.simple_effects import Differences
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
#: From this number of blocks on, contrasts share nothing of their variances that would show.
ASYMPTOTIC_BLOCKS = 50
#: Values held at once by a simulation: 4 MB, which stay in the cache of one core.
_AT_ONCE = 500_000


@overload
def bonferroni(contrasts: int, df: float, alpha: float) -> float: ...
@overload
def bonferroni(contrasts: int, df: Array, alpha: float) -> Array: ...
def bonferroni(contrasts: int, df: float | Array, alpha: float) -> float | Array:
    """Multiplier that holds whatever the dependence.

    Parameters
    ----------
    contrasts : int
        Number of contrasts, at least 1.
    df : float or ndarray, shape (m,)
        Degrees of freedom of the standard errors; the result has its shape.
    alpha : float
        Error probability of all two-sided intervals together.
    """
    from scipy.special import stdtrit

    found = stdtrit(df, 1 - alpha / (2 * contrasts))
    return np.asarray(found) if np.ndim(found) else float(found)


@overload
def block_multiplier(contrasts: Array, alpha: float, seed: int | None) -> float: ...
@overload
def block_multiplier(
    contrasts: Array, alpha: float, seed: int | None, groups: Sequence[Ints], df: Array
) -> Array: ...
def block_multiplier(
    contrasts: Array,
    alpha: float,
    seed: int | None,
    groups: Sequence[Ints] = (),
    df: Array | None = None,
) -> float | Array:
    """Multiplier of the standard errors for simultaneous intervals of all contrasts.

    Parameters
    ----------
    contrasts : ndarray, shape (m, b)
        Value of every contrast in every block; in groups, what each block adds to it.
    alpha : float
        1 - level of the intervals together.
    seed : int or None
        Of the simulation; None for Bonferroni's multiplier at once.
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
    if seed is None or m <= 1 or min(len(part) for part in parts) < FEWEST_BLOCKS:
        return safe
    roots = [_centred(contrasts[:, part]) for part in parts]
    z = np.concatenate(roots, axis=1)
    spread = np.sqrt(np.sum(z**2, axis=1))
    z = z[spread > 1e-12 * spread.max(initial=0.0)]
    if not len(z):
        return safe
    z = np.unique((z / np.sqrt(np.sum(z**2, axis=1))[:, None]).round(9), axis=0)
    ends = np.cumsum([len(part) for part in parts])[:-1]
    if len(parts) == 1 and b >= ASYMPTOTIC_BLOCKS:
        largest = _largest_of_many(z, b, seed)
    else:
        largest = _largest_t(np.split(z, ends, axis=1), [len(part) for part in parts], seed)
    found = float(np.quantile(largest, 1 - SHARPER * alpha))
    return np.minimum(safe, found) if isinstance(safe, np.ndarray) else min(safe, found)


def _centred(values: Array) -> Array:
    """Root of the covariance of some blocks: z z' is their covariance, shape (m, b)."""
    centre = values.mean(axis=1, keepdims=True)
    return np.asarray((values - centre) / math.sqrt(values.shape[1] - 1))


def _largest_t(roots: Sequence[Array], blocks: Sequence[int], seed: int) -> Array:
    """Largest |t| of all contrasts in each draw of blocks from N(0, z z') of each group.

    Of draws N of the blocks a contrast has the mean z'N and the variance z'NN'z, so that sums
    over the blocks need not be made contrast by contrast.
    """
    random = np.random.default_rng(seed)
    found = np.empty(DRAWS)
    short = [_short(z) for z in roots]
    squares = [_squares(z) for z in short]
    # what is drawn at once is part of the stream of numbers where there are several groups
    most = max(len(z) * (b if len(short) > 1 else 1) for z, b in zip(short, blocks, strict=True))
    step = max(1, min(DRAWS, _AT_ONCE // most))
    for start in range(0, DRAWS, step):
        n = min(step, DRAWS - start)
        total, variance = np.zeros((len(roots[0]), n)), np.zeros((len(roots[0]), n))
        for z, pairs, b in zip(short, squares, blocks, strict=True):
            normal = random.standard_normal((n, z.shape[1], b))
            total += z @ normal.sum(axis=2).T
            normal -= normal.mean(axis=2, keepdims=True)
            upper = np.triu_indices(z.shape[1])
            scatter = (normal @ normal.transpose(0, 2, 1))[:, upper[0], upper[1]]
            variance += pairs @ scatter.T * (b / (b - 1))
        np.multiply(total, total, out=total)
        total /= np.maximum(variance, 1e-300, out=variance)
        found[start : start + n] = np.sqrt(total.max(axis=0))
    return found


def _squares(z: Array) -> Array:
    """Products of all pairs of columns, each once: z'Sz of a symmetric S is linear in them."""
    i, j = np.triu_indices(z.shape[1])
    return np.asarray(z[:, i] * z[:, j] * np.where(i == j, 1.0, 2.0))


def _largest_of_many(z: Array, blocks: int, seed: int) -> Array:
    """Largest |t| with so many blocks that only the margins differ from those of normals.

    Of 200 contrasts in 50 blocks the .96 quantile then covers .956 to .960 (20,000 draws of the
    blocks themselves, contrasts alike or apart), in 100 blocks .958 to .960.
    """
    from scipy.special import ndtr, stdtrit

    random = np.random.default_rng(seed)
    short = _short(z)
    found = np.empty(DRAWS)
    step = max(1, min(DRAWS, _AT_ONCE // len(short)))
    for start in range(0, DRAWS, step):
        n = min(step, DRAWS - start)
        normal = short @ random.standard_normal((n, short.shape[1])).T
        found[start : start + n] = np.abs(normal).max(axis=0)
    return np.asarray(-stdtrit(blocks - 1, ndtr(-found)))


def _short(z: Array) -> Array:
    """Root of z z' with no more columns than rows where blocks are many (400 resamples)."""
    if z.shape[1] <= MANY_BLOCKS or z.shape[1] <= z.shape[0]:
        return z
    upper = np.asarray(np.linalg.qr(z.T, mode="r"))
    return np.asarray(upper.T)


def pooled_multiplier(
    asked: Differences, length: Array, df: float, alpha: float, seed: int | None
) -> float:
    """Multiplier where one error variance with ``df`` degrees of freedom serves all contrasts.

    Parameters
    ----------
    asked : Differences
        Of settings that are combinations of independent normals of one variance.
    length : ndarray, shape (m,)
        Standard error of each difference, for a variance of one.
    df : float
        Degrees of freedom of the error variance.
    alpha : float
        Error probability of all intervals together.
    seed : int or None
        Seed of the simulation; None for Bonferroni's multiplier.

    Returns
    -------
    float
        Quantile of the largest |t| of a multivariate t (Hothorn, Bretz and Westfall 2008),
        simulated; never above Bonferroni's.
    """
    kept = np.flatnonzero(length > 1e-12 * length.max(initial=0.0))
    safe = bonferroni(max(len(kept), 1), df, alpha)
    if len(kept) <= 1 or seed is None:
        return safe
    kept = kept[_once(asked, length, kept)]
    few = Differences(asked.settings, asked.first[kept], asked.second[kept])
    random = np.random.default_rng(seed)
    found = np.empty(DRAWS)
    step = max(1, min(DRAWS, _AT_ONCE // len(kept)))
    for start in range(0, DRAWS, step):
        n = min(step, DRAWS - start)
        values = asked.settings @ random.standard_normal((asked.settings.shape[1], n))
        normal = (np.abs(few.of(values)) / length[kept, None]).max(axis=0)
        found[start : start + n] = normal / np.sqrt(random.chisquare(df, n) / df)
    return min(safe, float(np.quantile(found, 1 - alpha)))


def _once(asked: Differences, length: Array, kept: Ints) -> Ints:
    """First of every set of contrasts that are one but for their unit."""
    # what is equal has the same product with any numbers; two of nine digits tell others apart
    drawn = np.random.default_rng(0).standard_normal((asked.settings.shape[1], 2))
    product = asked.of(asked.settings @ drawn)[kept] / length[kept, None]
    return np.asarray(np.unique(product.round(9), axis=0, return_index=True)[1])
