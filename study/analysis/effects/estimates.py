"""Sizes of effects: level means, simultaneous interval of the largest difference, verdict.

The verdict rests on the interval against the practical band and on the numerical uncertainty;
p never decides alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from study.analysis.anova_table import Effect, PairDifference
from study.analysis.effects.comparisons import letters, studentized_range_quantile
from study.analysis.linear_model.design_matrix import Layout, Term, grid, model_matrix, term_name
from study.analysis.linear_model.sums_of_squares import Factored
from study.arrays import Array

MATTERS = "matters"
NO_DIFFERENCE = "no practical difference"
CANNOT_TELL = "cannot tell"

# beyond this nobody reads all pairs
_MOST_LEVELS = 20


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
    critical : float or None
        Simultaneous multiplier of the standard error of a difference.
    mean_half : ndarray, shape (k,), or None
        Half-width of the interval of each mean.
    p : float or None
        The deciding p.
    """

    term: Term
    levels: tuple[str, ...]
    component: Array
    mean: Array
    covariance: Array | None
    critical: float | None
    mean_half: Array | None
    p: float | None


@dataclass(frozen=True)
class Scale:
    """What turns an estimate into a verdict, on the working scale.

    Parameters
    ----------
    u_num, u_num_raw : float or None
        Numerical uncertainty on the working scale and in the unit of the response.
    by_term : mapping of str to float, optional
        Uncertainty of each term in the unit of the response, in place of one for all; a term
        that is absent has none.
    unit : float
        Unit of the response on the working scale.
    """

    transform: str
    practical: float | None
    u_num: float | None
    u_num_raw: float | None
    deterministic: bool
    by_term: Mapping[str, float] | None = None
    unit: float = 1.0

    def of(self, term: Term) -> Scale:
        """Scale of one term, with its own numerical uncertainty."""
        if self.by_term is None:
            return self
        raw = self.by_term.get(term_name(term))
        u = None if raw is None else raw * self.unit
        return replace(self, u_num=u, u_num_raw=raw, by_term=None)


def term_rows(layout: Layout, fit: Factored, term: Term) -> tuple[tuple[str, ...], Array, Array]:
    """Linear combinations of the coefficients that give a term's components and means.

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
    """Estimate of a term with the error variance ``rss / df`` (none where df is 0)."""
    levels, component_rows, mean_rows = term_rows(layout, fit, term)
    beta = fit.coefficients()
    mean = fit.shift + mean_rows @ beta
    mean[np.logical_not(fit.estimable(mean_rows))] = np.nan
    component = component_rows @ beta
    if not fit.estimable(component_rows).all():
        component = np.full_like(component, np.nan)
    if df <= 0 or rss <= 0:
        return TermEstimate(term, levels, component, mean, None, None, None, p)
    covariance = fit.unscaled_covariance() * rss / df
    spread = np.einsum("ij,jk,ik->i", mean_rows, covariance, mean_rows)
    return TermEstimate(
        term,
        levels,
        component,
        mean,
        component_rows @ covariance @ component_rows.T,
        pooled_critical(len(levels), _df_of(layout, term), df, len(term) == 1, alpha),
        t_quantile(alpha / 2, df) * np.sqrt(np.maximum(spread, 0)),
        p,
    )


def _df_of(layout: Layout, term: Term) -> int:
    return int(np.prod([len(layout.levels[name]) - 1 for name in term]))


def t_quantile(upper: float, df: float) -> float:
    """Upper quantile of Student's t."""
    from scipy.special import stdtrit

    return float(stdtrit(df, 1 - upper))


def pooled_critical(k: int, df_term: int, df: float, main: bool, alpha: float) -> float:
    """Smallest valid simultaneous multiplier: Tukey-Kramer, Bonferroni or Scheffe."""
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


def size(estimate: TermEstimate, scale: Scale) -> Effect:
    """Turn an estimate into the reported effect with its verdict."""
    scale = scale.of(estimate.term)
    back: Callable[[float], float] = math.exp if scale.transform == "log" else float
    mean = tuple(None if math.isnan(m) else back(float(m)) for m in estimate.mean)
    kind = "ratio" if scale.transform == "log" else "difference"
    practical = None if scale.practical is None else back(scale.practical)
    if np.isnan(estimate.component).any():
        return Effect(
            term_name(estimate.term),
            estimate.levels,
            mean,
            None,
            None,
            CANNOT_TELL,
            kind,
            practical=practical,
            u_num=scale.u_num_raw,
            p=estimate.p,
            why="not estimable",
        )
    top, bottom = int(np.argmax(estimate.component)), int(np.argmin(estimate.component))
    largest = float(estimate.component[top] - estimate.component[bottom])
    half = _half_widths(estimate)
    interval = None
    if half is not None:
        interval = (largest - half[top, bottom], largest + half[top, bottom])
    verdict, why = decide(estimate, largest, interval, half, scale)
    pairs, tags = _pairs(estimate, half, back)
    resolved = None if not scale.u_num else _resolved(largest / scale.u_num)
    return Effect(
        term_name(estimate.term),
        estimate.levels,
        mean,
        None if interval is None else (back(interval[0]), back(interval[1])),
        back(largest),
        verdict,
        kind,
        (estimate.levels[top], estimate.levels[bottom]),
        _mean_intervals(estimate, back),
        practical,
        scale.u_num_raw,
        largest / scale.u_num if scale.u_num else None,
        resolved,
        estimate.p,
        why,
        pairs,
        tags,
    )


def _mean_intervals(
    estimate: TermEstimate, back: Callable[[float], float]
) -> tuple[tuple[float, float], ...] | None:
    if estimate.mean_half is None or np.isnan(estimate.mean).any():
        return None
    pairs = zip(estimate.mean, estimate.mean_half, strict=True)
    return tuple((back(float(m - h)), back(float(m + h))) for m, h in pairs)


def _half_widths(estimate: TermEstimate) -> Array | None:
    if estimate.covariance is None or estimate.critical is None:
        return None
    v = estimate.covariance
    d = np.diag(v)
    return np.asarray(estimate.critical * np.sqrt(np.maximum(d[:, None] + d - 2 * v, 0.0)))


def _resolved(ratio: float) -> str:
    if ratio >= 3:
        return "resolved"
    return "marginal" if ratio >= 1 else "not resolved"


def decide(
    estimate: TermEstimate,
    largest: float,
    interval: tuple[float, float] | None,
    half: Array | None,
    scale: Scale,
) -> tuple[str, str]:
    """Verdict of one effect, and why."""
    if scale.practical is None:
        return CANNOT_TELL, "no practical threshold was given"
    unresolved = scale.u_num is not None and largest <= 3 * scale.u_num
    if interval is None or half is None:
        return _decide_without_error(largest, unresolved, scale)
    if interval[0] > scale.practical:
        if unresolved:
            return CANNOT_TELL, "not resolved by the mesh: the difference is within 3 u_num"
        return MATTERS, "the interval of the largest difference lies beyond the practical band"
    differences = np.abs(estimate.component[:, None] - estimate.component)
    if float((differences + half).max()) < scale.practical:
        return NO_DIFFERENCE, "every interval lies inside the practical band"
    return CANNOT_TELL, "the interval of the largest difference crosses the practical threshold"


def _decide_without_error(largest: float, unresolved: bool, scale: Scale) -> tuple[str, str]:
    if not scale.deterministic or scale.practical is None:
        return CANNOT_TELL, "there is no error to judge the effect against"
    u = scale.u_num or 0.0
    if largest - u > scale.practical:
        if unresolved:
            return CANNOT_TELL, "not resolved by the mesh: the difference is within 3 u_num"
        return MATTERS, "the computed difference exceeds the practical threshold (no p)"
    if largest + u < scale.practical:
        return NO_DIFFERENCE, "the computed difference is below the practical threshold (no p)"
    return CANNOT_TELL, "the difference and the threshold are within the numerical uncertainty"


def _pairs(
    estimate: TermEstimate, half: Array | None, back: Callable[[float], float]
) -> tuple[tuple[PairDifference, ...], tuple[str, ...]]:
    """Differences of all pairs of levels of a factor, and the letters of the levels."""
    k = len(estimate.levels)
    if half is None or len(estimate.term) != 1 or k > _MOST_LEVELS:
        return (), ()
    found = []
    for i, j in combinations(range(k), 2):
        d, h = float(estimate.component[i] - estimate.component[j]), float(half[i, j])
        names = estimate.levels[i], estimate.levels[j]
        found.append(PairDifference(*names, back(d), back(d - h), back(d + h), abs(d) > h))
    apart = {frozenset((pair.first, pair.second)) for pair in found if pair.different}
    order = np.argsort(-estimate.component, kind="stable")
    by_level = letters([estimate.levels[i] for i in order], apart)
    return tuple(found), tuple(by_level[level] for level in estimate.levels)
