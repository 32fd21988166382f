"""All pairs of levels of every factor: difference, simultaneous interval, adjusted p."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from study.analysis.anova_table import Effect, PairDifference, Row
from study.analysis.effects.comparisons import studentized_range_cdf
from study.analysis.effects.estimates import own_critical, pooled_critical, t_quantile

if TYPE_CHECKING:
    from study.analysis.result import AnalysisResult

TUKEY = "Tukey"
BONFERRONI = "Bonferroni"
HOTELLING = "Hotelling"
TWO_LEVELS = "t"


@dataclass(frozen=True)
class PairwiseDifference:
    """Difference (or ratio) of two levels of one factor.

    Parameters
    ----------
    factor, first, second : str
        The difference is first - second (first / second for a log response).
    difference, lower, upper : float
        With the simultaneous interval of all pairs of the factor.
    p : float or None
        Adjusted for all pairs of the factor; below alpha exactly where the interval excludes no
        difference. None where the error is made of several strata.
    method : str
        What makes interval and p hold for all pairs together.
    """

    factor: str
    first: str
    second: str
    difference: float
    lower: float
    upper: float
    p: float | None
    method: str


def pairwise(found: AnalysisResult) -> tuple[PairwiseDifference, ...]:
    """Give all pairwise comparisons of an analysis, factor after factor.

    With one pooled error they are Tukey's (Kramer's where unbalanced). Where effects are tested
    against their own interactions with the blocks, each difference has its own variance, and
    Bonferroni's or Hotelling's multiplier serves, whichever is smaller.

    Parameters
    ----------
    found : AnalysisResult
        Its main effects with their pairs.

    Returns
    -------
    tuple of PairwiseDifference
        Empty where there is no error, or a factor has more levels than anyone compares.
    """
    rows = {row.term: row for row in found.anova.rows}
    return tuple(
        _one(effect, pair, rows.get(effect.term), found)
        for effect in found.effects
        if effect.is_main
        for pair in effect.pairs
    )


def _one(
    effect: Effect, pair: PairDifference, row: Row | None, found: AnalysisResult
) -> PairwiseDifference:
    method, p = _adjusted(effect, pair, row, found)
    ends = pair.difference, pair.lower, pair.upper
    return PairwiseDifference(effect.term, pair.first, pair.second, *ends, p, method)


def _adjusted(
    effect: Effect, pair: PairDifference, row: Row | None, found: AnalysisResult
) -> tuple[str, float | None]:
    if row is None or row.error is None or row.df_error is None or row.df_error <= 0:
        return "", None
    k, alpha = len(effect.levels), found.request.alpha
    size, half = _distances(pair, effect.is_ratio)
    if row.error == "residual":
        critical = pooled_critical(k, k - 1, row.df_error, True, alpha)
        return _of_range(size, half, critical, k, row.df_error)
    if row.error == f"{found.data.block}:{effect.term}" and row.df:
        blocks = round(row.df_error / row.df) + 1
        return _of_blocks(size, half, own_critical(k, k - 1, blocks, alpha), k, blocks, alpha)
    return "", None


def _distances(pair: PairDifference, is_ratio: bool) -> tuple[float, float]:
    """Size of a difference and half-width of its interval on the scale of the analysis."""
    if is_ratio:
        return abs(math.log(pair.difference)), math.log(pair.upper / pair.lower) / 2
    return abs(pair.difference), (pair.upper - pair.lower) / 2


def _of_range(
    size: float, half: float, critical: float, k: int, df: float
) -> tuple[str, float | None]:
    """Tukey's p: that of a studentized range at least this large."""
    method = TWO_LEVELS if k == 2 else TUKEY
    if not (math.isfinite(half) and half > 0):
        return method, None
    t = size / half * critical
    if k == 2:
        return method, _two_sided(t, df)
    return method, max(0.0, 1 - studentized_range_cdf(t * math.sqrt(2), k, df))


def _of_blocks(
    size: float, half: float, critical: float, k: int, blocks: int, alpha: float
) -> tuple[str, float | None]:
    """Give p with its own variance over blocks, by the multiplier that made the interval."""
    from scipy.special import fdtrc

    pairs = k * (k - 1) / 2
    each = t_quantile(alpha / (2 * pairs), blocks - 1)
    method = TWO_LEVELS if k == 2 else BONFERRONI if critical >= each else HOTELLING
    if not (math.isfinite(half) and half > 0):
        return method, None
    t = size / half * critical
    if method != HOTELLING:
        return method, min(1.0, pairs * _two_sided(t, blocks - 1))
    df, rest = k - 1, blocks - k + 1
    return method, float(fdtrc(df, rest, t * t * rest / (df * (blocks - 1))))


def _two_sided(t: float, df: float) -> float:
    from scipy.special import stdtr

    return 2 * float(stdtr(df, -abs(t)))
