"""Estimates of the terms of a model: components, level means and their standard errors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import overload

import numpy as np

from study.analysis.effects.comparisons import studentized_range_quantile
from study.analysis.effects.simple_effects import columns_at, partners
from study.analysis.linear_model.design_matrix import Layout, Term, grid, model_matrix
from study.analysis.linear_model.sums_of_squares import Factored
from study.arrays import Array


@dataclass(frozen=True)
class TermEstimate:
    """Estimates of one term on the working scale.

    Parameters
    ----------
    component : ndarray, shape (k,)
        Pure effect of each level (or combination); differences of level means for a factor.
    mean : ndarray, shape (k,)
        Marginal means, NaN where not estimable.
    covariance : ndarray, shape (k, k), or None
        Covariance of ``component``; None where there is no error.
    critical : float or ndarray, shape (k, k), or None
        Simultaneous multiplier of the standard error of a difference.
    mean_half : ndarray, shape (k,), or None
        Half-width of the interval of each mean.
    p : float or None
        The deciding p.
    settings : tuple of tuple of str
        Level of each factor of the term in every combination.
    """

    term: Term
    levels: tuple[str, ...]
    component: Array
    mean: Array
    covariance: Array | None
    critical: float | Array | None
    mean_half: Array | None
    p: float | None
    settings: tuple[tuple[str, ...], ...] = ()


def term_rows(layout: Layout, fit: Factored, term: Term) -> tuple[tuple[str, ...], Array, Array]:
    """Linear combinations of the coefficients that give a term's components and means.

    Parameters
    ----------
    layout : Layout
        Levels of all factors of the model; its rows do not count.
    fit : Factored
        Fit of p columns.
    term : Term
        One of its terms, with k combinations of levels.

    Returns
    -------
    levels : tuple of str
        Labels of the level combinations.
    component, mean : ndarray, shape (k, p)
        Rows of the combinations.
    """
    matrix = fit.matrix
    cells = grid(layout, term)
    inner = [t for t in matrix.terms[1:] if set(t) <= set(term)]
    # the full list of terms decides how each factor is coded, so it is coded as in the fit
    local = model_matrix(_padded(cells, layout), matrix.terms[1:])
    component = np.zeros((cells.n, matrix.columns.shape[1]))
    mean = np.zeros_like(component)
    mean[:, 0] = 1.0
    for t in inner:
        at = matrix.of(t)
        mean[:, at] = local.columns[:, local.of(t)]
    component[:, matrix.of(term)] = local.columns[:, local.of(term)]
    labels = tuple(
        " ".join(layout.levels[name][cells.codes[name][i]] for name in term) for i in range(cells.n)
    )
    return labels, component, mean


def over_complete_settings(layout: Layout, fit: Factored, term: Term, rows: Array) -> Array:
    """Rows of a main effect; where cells are empty, over the settings that have all its levels.

    Parameters
    ----------
    layout : Layout
        Levels of all factors of the model.
    fit : Factored
        Fit of p columns.
    term : Term
        One of its terms, with k combinations of levels.
    rows : ndarray, shape (k, p)
        Rows over all settings.

    Returns
    -------
    ndarray, shape (k, p)
        The same rows where they can be estimated, for interactions, and where no setting is
        complete.
    """
    if len(term) != 1 or fit.estimable(rows).all():
        return rows
    k, names = len(layout.levels[term[0]]), partners(term[0], fit.matrix.terms)
    settings = list(product(*(range(len(layout.levels[name])) for name in names)))
    cells = columns_at(term[0], layout, fit.matrix, names, settings).reshape(len(settings), k, -1)
    centred = cells - cells.mean(axis=1, keepdims=True)
    complete = fit.estimable(centred.reshape(-1, rows.shape[1])).reshape(-1, k).all(axis=1)
    return np.asarray(centred[complete].mean(axis=0)) if complete.any() else rows


def _padded(cells: Layout, layout: Layout) -> Layout:
    """Cells of some factors with the other factors held at their first level."""
    codes = {
        name: cells.codes.get(name, np.zeros(cells.n, dtype=np.int64)) for name in layout.levels
    }
    return Layout(layout.levels, codes)


def pooled_estimate(
    layout: Layout,
    fit: Factored,
    term: Term,
    df: float,
    p: float | None,
    alpha: float,
    rss: float,
) -> TermEstimate:
    """Estimate of a term with the error variance ``rss / df`` (none where df is 0).

    Parameters
    ----------
    layout : Layout
        Levels of all factors of the model.
    fit : Factored
        Fit of the rows on the working scale.
    term : Term
        One of its terms.
    df, rss : float
        Degrees of freedom of the error, and its sum of squares on the working scale.
    p : float or None
        Deciding p of the term, which the estimate carries on.
    alpha : float
        Error probability; simultaneous intervals have the level 1 - alpha together, and those of
        means 1 - alpha each.
    """
    levels, component_rows, mean_rows = term_rows(layout, fit, term)
    component_rows = over_complete_settings(layout, fit, term, component_rows)
    settings = settings_of(layout, term)
    beta = fit.coefficients()
    mean = fit.shift + mean_rows @ beta
    mean[np.logical_not(fit.estimable(mean_rows))] = np.nan
    component = component_rows @ beta
    if not fit.estimable(component_rows).all():
        component = np.full_like(component, np.nan)
    if df <= 0 or rss <= 0:
        return TermEstimate(term, levels, component, mean, None, None, None, p, settings)
    covariance = fit.unscaled_covariance() * rss / df
    spread = np.einsum("ij,ij->i", mean_rows @ covariance, mean_rows)
    return TermEstimate(
        term,
        levels,
        component,
        mean,
        component_rows @ covariance @ component_rows.T,
        pooled_critical(len(levels), _df_of(layout, term), df, len(term) == 1, alpha),
        t_quantile(alpha / 2, df) * np.sqrt(np.maximum(spread, 0)),
        p,
        settings,
    )


def settings_of(layout: Layout, term: Term) -> tuple[tuple[str, ...], ...]:
    """Levels of the factors of a term in every combination, in the order of its components.

    Parameters
    ----------
    layout : Layout
        Levels of all factors.
    term : Term
        Its last factor changes fastest.
    """
    return tuple(product(*(layout.levels[name] for name in term)))


def _df_of(layout: Layout, term: Term) -> int:
    return int(np.prod([len(layout.levels[name]) - 1 for name in term]))


@overload
def t_quantile(upper: float, df: float) -> float: ...
@overload
def t_quantile(upper: float, df: Array) -> Array: ...
def t_quantile(upper: float, df: float | Array) -> float | Array:
    """Upper quantile of Student's t.

    Parameters
    ----------
    upper : float
        Probability above the quantile: 0.025 for a two-sided interval of 95 %.
    df : float or ndarray
        Degrees of freedom; the result has its shape.
    """
    from scipy.special import stdtrit

    found = stdtrit(df, 1 - upper)
    return np.asarray(found) if np.ndim(found) else float(found)


def pooled_critical(k: int, df_term: int, df: float, main: bool, alpha: float) -> float:
    """Smallest valid simultaneous multiplier: Tukey-Kramer, Bonferroni or Scheffe.

    Parameters
    ----------
    k : int
        Number of level combinations; all their pairs are compared.
    df_term, df : float
        Degrees of freedom of the term, and of the error.
    main : bool
        Whether the term is one factor, for which Tukey and Kramer's multiplier holds.
    alpha : float
        Error probability of all intervals together.

    Returns
    -------
    float
        Multiplier of the standard error of a difference.
    """
    from scipy.special import fdtri

    if k == 2:
        return t_quantile(alpha / 2, df)
    options = [
        t_quantile(alpha / (k * (k - 1)), df),
        math.sqrt(df_term * float(fdtri(df_term, df, 1 - alpha))),
    ]
    if main:
        options.append(studentized_range_quantile(1 - alpha, k, df) / math.sqrt(2))
    return min(options)


def own_critical(k: int, df_term: int, blocks: int, alpha: float) -> float:
    """Multiplier where each difference has its own variance over blocks.

    Bonferroni, or Hotelling's T^2 (all contrasts of the term at once) where that is smaller:
    neither needs sphericity.

    Parameters
    ----------
    k : int
        Number of level combinations; all their pairs are compared.
    df_term : int
        Degrees of freedom of the term.
    blocks : int
        Number of blocks b, two at least; a variance has b - 1 degrees of freedom.
    alpha : float
        Error probability of all intervals together.

    Returns
    -------
    float
        Multiplier of the standard error of a difference.
    """
    from scipy.special import fdtri

    if k == 2 or df_term == 1:
        return t_quantile(alpha / 2, blocks - 1)
    options = [t_quantile(alpha / (k * (k - 1)), blocks - 1)]
    rest = blocks - df_term
    if rest > 0:
        f = float(fdtri(df_term, rest, 1 - alpha))
        options.append(math.sqrt(df_term * (blocks - 1) / rest * f))
    return min(options)
