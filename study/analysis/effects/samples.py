"""What is known of combinations of coefficients: over blocks, with a pooled error, or exactly."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from study.analysis.effects.comparisons import studentized_range_quantile
from study.analysis.effects.estimates import t_quantile
from study.analysis.effects.simple_effects import Differences, Estimates, Sample
from study.analysis.effects.simultaneous import block_multiplier, bonferroni, pooled_multiplier
from study.analysis.linear_model.sums_of_squares import Factored
from study.analysis.unreplicated import pseudo_standard_error
from study.arrays import Array, Ints


def over_blocks(
    fit: Factored, coefficients: Array, alpha: float, seed: int | None, reading: float = 0.0
) -> Sample:
    """Estimate combinations by their own variance over the blocks.

    Parameters
    ----------
    fit : Factored
        Fit of p columns to the means of the cells; it says what can be estimated.
    coefficients : ndarray, shape (p, b)
        Of every block.
    alpha : float
        Error probability of each interval, and of all simultaneous ones together.
    seed : int or None
        Seed of the simulated simultaneous multiplier; None for Bonferroni's.
    reading : float
        Standard deviation of a reading below which no scatter is believed.
    """

    def estimate(asked: Differences) -> Estimates:
        rows = asked.rows
        value = np.where(fit.estimable(rows)[:, None], rows @ coefficients, np.nan)
        known = value[np.isfinite(value).all(axis=1)]
        b = value.shape[1]
        spread = value.std(axis=1, ddof=1)
        if reading:
            spread = np.maximum(spread, reading * np.linalg.norm(rows @ fit.model.inverse, axis=1))
        return Estimates(
            value.mean(axis=1),
            spread / np.sqrt(b),
            t_quantile(alpha / 2, b - 1),
            block_multiplier(known, alpha, seed) if len(known) else 0.0,
        )

    return estimate


def over_groups(
    fit: Factored,
    added: Array,
    groups: Sequence[Ints],
    alpha: float,
    seed: int | None,
    reading: float = 0.0,
) -> Sample:
    """Estimate combinations by their own variance in each group of blocks (Welch 1938).

    Parameters
    ----------
    fit : Factored
        Fit of p columns to the rows; it says what can be estimated.
    added : ndarray, shape (p, b)
        What each block adds to the coefficients, which are its sum.
    groups : sequence of ndarray of int
        Blocks of each group.
    alpha : float
        Error probability of each interval, and of all simultaneous ones together.
    seed : int or None
        Seed of the simulated simultaneous multiplier; None for Bonferroni's.
    reading : float
        Standard deviation of a reading below which no scatter is believed.
    """

    def estimate(asked: Differences) -> Estimates:
        rows = asked.rows
        value = np.where(fit.estimable(rows)[:, None], rows @ added, np.nan)
        error, df = group_errors(value, groups)
        if reading:
            error = np.maximum(error, reading * np.linalg.norm(rows @ fit.model.inverse, axis=1))
        known = np.isfinite(value).all(axis=1)
        wide = np.zeros(len(value))
        if known.any():
            wide[known] = block_multiplier(value[known], alpha, seed, groups, df[known])
        return Estimates(value.sum(axis=1), error, t_quantile(alpha / 2, df), wide)

    return estimate


def group_errors(value: Array, groups: Sequence[Ints]) -> tuple[Array, Array]:
    """Find the standard errors of sums over blocks and their degrees of freedom, shape (m,).

    Parameters
    ----------
    value : ndarray, shape (m, b)
        What each block adds.
    groups : sequence of ndarray of int
        Blocks of each group, three of them at least.
    """
    n = np.array([len(group) for group in groups])
    parts = n[:, None] * np.array([value[:, group].var(axis=1, ddof=1) for group in groups])
    total = parts.sum(axis=0)
    below = np.sum(parts**2 / (n - 1)[:, None], axis=0)
    all_of_them = np.full(len(value), float((n - 1).sum()))
    df = np.divide(total**2, below, out=all_of_them, where=below > 0)
    return np.sqrt(total), df


def with_pooled_error(
    fit: Factored, rss: float, df: float, alpha: float, seed: int | None
) -> Sample:
    """Estimate combinations with one error variance, ``rss / df``; none where ``df`` is 0.

    Parameters
    ----------
    fit : Factored
        Fit of the rows.
    rss, df : float
        Sum of squares of the error on the working scale, and its degrees of freedom.
    alpha : float
        Error probability of each interval, and of all simultaneous ones together.
    seed : int or None
        Seed of the simulated simultaneous multiplier; None for Bonferroni's.
    """
    coefficients = fit.coefficients()
    inverse = fit.model.inverse

    def estimate(asked: Differences) -> Estimates:
        rows = asked.rows
        value = np.where(fit.estimable(rows), rows @ coefficients, np.nan)
        if df <= 0 or rss <= 0:
            return Estimates(value, None)
        known = np.isfinite(value)
        roots = asked.settings @ inverse
        square = asked.of(roots)
        length = np.sqrt(np.einsum("ij,ij->i", square, square))
        kept = Differences(roots, asked.first[known], asked.second[known])
        wide = pooled_multiplier(kept, length[known], df, alpha, seed) if known.any() else 0.0
        error = length * math.sqrt(rss / df)
        return Estimates(value, error, t_quantile(alpha / 2, df), wide)

    return estimate


def cell_welch(fit: Factored, y: Array, cell: Ints, alpha: float, reading: float) -> Sample:
    """Estimate combinations with a variance of its own in each cell (Welch, Satterthwaite).

    Of one factor the simultaneous intervals are those of Games and Howell (1976); a contrast that
    needs a cell with one row has no interval.

    Parameters
    ----------
    fit : Factored
        Fit of the rows, without blocks.
    y : ndarray, shape (n,)
        Response on the working scale.
    cell : ndarray of int, shape (n,)
        Number of the cell of each row, from 0.
    alpha : float
        Error probability of each interval, and of all simultaneous ones together.
    reading : float
        Standard deviation of a reading below which no scatter is believed.
    """
    count = np.bincount(cell)
    first = np.unique(cell, return_index=True)[1]
    mean = np.bincount(cell, y - y[0]) / count
    ss = np.bincount(cell, (y - y[0] - mean[cell]) ** 2)
    variance = np.maximum(ss / np.maximum(count - 1, 1), reading**2)
    variance[count < 2] = np.inf
    coefficients = fit.coefficients()

    def estimate(asked: Differences) -> Estimates:
        rows = asked.rows
        value = np.where(fit.estimable(rows), rows @ coefficients, np.nan)
        weight = (rows @ fit.model.inverse) @ fit.q[first].T
        weight[np.abs(weight) < 1e-12 * np.abs(weight).max(initial=0.0)] = 0.0
        with np.errstate(invalid="ignore"):
            part = np.where(weight == 0, 0.0, weight**2 * count * variance)
            square = part.sum(axis=1)
            df = square**2 / np.sum(part**2 / np.maximum(count - 1, 1), axis=1)
        known = np.isfinite(square) & np.isfinite(df)
        error = np.where(known, np.sqrt(square), np.inf)
        df = np.where(known, df, 1.0)
        every = games_howell_multiplier(asked, df, alpha)
        return Estimates(value, error, t_quantile(alpha / 2, df), every)

    return estimate


def games_howell_multiplier(asked: Differences, df: Array, alpha: float) -> Array:
    """Multiplier of each standard error: Games and Howell's at each setting, or Bonferroni's.

    Parameters
    ----------
    asked : Differences
        All pairs of k levels at one or more settings.
    df : ndarray, shape (m,)
        Degrees of freedom of each difference.
    alpha : float
        Error probability of all intervals together.
    """
    m = len(df)
    safe = np.asarray(bonferroni(max(m, 1), df, alpha))
    levels = len(asked.settings)
    if m > MOST_RANGES or m != levels * (levels - 1) // 2:
        return safe
    ranges = [studentized_range_quantile(1 - alpha, levels, d) / math.sqrt(2) for d in df.tolist()]
    return np.minimum(safe, ranges)


#: Differences whose studentized ranges are integrated one by one, at 2 ms each.
MOST_RANGES = 66
#: Draws of null contrasts behind the limits of a pseudo standard error.
PSEUDO_DRAWS = 4000


def with_pseudo_error(
    fit: Factored, contrasts: Array, alpha: float, seed: int | None, y: Array
) -> Sample:
    """Estimate combinations of an unreplicated design with Lenth's pseudo standard error.

    Limits are quantiles of the same combinations of simulated null contrasts over their own
    pseudo standard error, as those of :func:`study.analysis.unreplicated.lenth`.

    Parameters
    ----------
    fit : Factored
        Saturated fit of the rows.
    contrasts : ndarray, shape (n, m)
        Orthonormal one-df contrasts of all effects.
    alpha : float
        Error probability of each interval, and of all simultaneous ones together.
    seed : int or None
        Seed of the simulation.
    y : ndarray, shape (n,)
        Response on the working scale.
    """
    values = contrasts.T @ (y - y[0])
    pse = float(pseudo_standard_error(values))

    def estimate(asked: Differences) -> Estimates:
        weight = (asked.rows @ fit.model.inverse) @ (fit.q.T @ contrasts)
        length = np.linalg.norm(weight, axis=1)
        known = fit.estimable(asked.rows) & (length > 0)
        single, largest = np.full(len(weight), np.inf), np.zeros(PSEUDO_DRAWS)
        z = np.random.default_rng(seed or 0).standard_normal((PSEUDO_DRAWS, len(values)))
        null = pseudo_standard_error(z)
        for i in np.flatnonzero(known):
            t = np.abs(z @ weight[i]) / length[i] / null
            largest = np.maximum(largest, t)
            single[i] = np.quantile(t, 1 - alpha)
        value = np.where(known, weight @ values, np.nan)
        every = float(np.quantile(largest, 1 - alpha))
        return Estimates(value, pse * length, single, every)

    return estimate


#: p of a preliminary test below which the assumption that it tests is not relied on. The usual
#: .05 leaves errors that it has little power to see (Bancroft 1964, Biometrics 20, 427-442).
DOUBT = 0.25
#: the same for cells of two rows, whose variances of one degree of freedom vary so much that Welch
#: would leave a third of the right claims of normal rows
DOUBT_OF_PAIRS = 0.10
#: rows of a cell from which its own variance is known well enough to be asked always
ENOUGH_ROWS = 5
UNEQUAL = (
    "cells scatter unequally or too few rows tell their scatter: with variances of their own "
    "(Welch) the interval does not allow the claim"
)


def needs_welch(y: Array, cell: Ints) -> bool:
    """Whether a claim from a pooled variance must be made with a variance for each cell as well.

    Parameters
    ----------
    y : ndarray, shape (n,)
        Response on the working scale.
    cell : ndarray of int, shape (n,)
        Number of the cell of each row, from 0.
    """
    counts = np.bincount(cell)
    limit = DOUBT if counts.max() > 2 else DOUBT_OF_PAIRS
    return bool(counts.max() >= ENOUGH_ROWS) or _bartlett_p(y, cell, counts) < limit


def _bartlett_p(y: Array, index: Ints, counts: Ints) -> float:
    """P of Bartlett's test of the cells that hold several rows; 1 where fewer than two do."""
    from scipy.special import chdtrc

    mean = np.bincount(index, y - y[0]) / counts
    ss = np.bincount(index, (y - y[0] - mean[index]) ** 2)
    many = counts > 1
    df, s2 = counts[many] - 1.0, ss[many] / np.maximum(counts[many] - 1, 1)
    if df.size < 2:
        return 1.0
    if s2.min() <= 0:
        return 0.0
    total = df.sum()
    pooled = float(df @ s2) / total
    ratio = total * math.log(pooled) - float(df @ np.log(s2))
    ratio /= 1 + (float((1 / df).sum()) - 1 / total) / (3 * (df.size - 1))
    return float(chdtrc(df.size - 1, max(ratio, 0.0)))
