"""What is known of combinations of coefficients: over blocks, with a pooled error, or exactly."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from study.analysis.effects.estimates import t_quantile
from study.analysis.effects.scale import Scale
from study.analysis.effects.simple_effects import (
    Differences,
    Estimates,
    Sample,
    SimpleEffects,
    simple_effects,
)
from study.analysis.effects.simultaneous import block_multiplier, pooled_multiplier
from study.analysis.linear_model.design_matrix import Layout, Term
from study.analysis.linear_model.sums_of_squares import Factored
from study.arrays import Array, Ints


def over_blocks(fit: Factored, coefficients: Array, alpha: float, seed: int | None) -> Sample:
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
    """

    def estimate(asked: Differences) -> Estimates:
        rows = asked.rows
        value = np.where(fit.estimable(rows)[:, None], rows @ coefficients, np.nan)
        known = value[np.isfinite(value).all(axis=1)]
        b = value.shape[1]
        return Estimates(
            value.mean(axis=1),
            value.std(axis=1, ddof=1) / np.sqrt(b),
            t_quantile(alpha / 2, b - 1),
            block_multiplier(known, alpha, seed) if len(known) else 0.0,
        )

    return estimate


def over_groups(
    fit: Factored, added: Array, groups: Sequence[Ints], alpha: float, seed: int | None
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
    """

    def estimate(asked: Differences) -> Estimates:
        rows = asked.rows
        value = np.where(fit.estimable(rows)[:, None], rows @ added, np.nan)
        error, df = group_errors(value, groups)
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


def every_simple_effect(
    terms: Sequence[Term], layout: Layout, fit: Factored, sample: Sample, scale: Scale
) -> dict[str, SimpleEffects]:
    """Judge every factor of a model by its simple effects.

    Parameters
    ----------
    terms : sequence of Term
        Terms of the model; only its main effects are judged.
    layout : Layout
        Levels of all factors.
    fit : Factored
        Fit whose columns ``sample`` combines.
    sample : Sample
        Estimates of differences, with their standard errors.
    scale : Scale
        Practical difference and numerical bound on the working scale.

    Returns
    -------
    dict of str to SimpleEffects
        By factor; without factors that have too many simple effects, or none that is estimable.
    """
    found = {}
    for term in terms:
        if len(term) == 1:
            judged = simple_effects(
                term[0], layout, fit.matrix, sample, scale.practical, scale.bound, scale.only
            )
            if judged is not None:
                found[term[0]] = judged
    return found
