"""What a planned number of specimens or mesh seeds can detect, before anything is run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from study.ground.errors import Fault, InputError
from study.ground.noncentral_f import noncentral_f_sf
from study.statistics.analysis.anova_table import PowerRow
from study.statistics.analysis.comparisons import scale_rule

if TYPE_CHECKING:
    from study.statistics.analysis.analysis_result import AnalysisResult


def planned(out: AnalysisResult) -> dict[str, tuple[PowerRow, ...]]:
    """Tell what other numbers of blocks, or of replicates in a cell, would find, by factor.

    Each level is a mean over ``cells / levels`` cells, so its error variance in one block is the
    error mean square over that number.
    """
    number = np.bincount(out.data.cell)
    number, blocked = number[number > 0], out.crossed is not None
    if out.replicates == "noise":
        return {}  # more resamples show no smaller effect: the noise of the curve is what it is
    if not (blocked or (out.error_term.source in ("E0", "E3") and number.min() >= 2)):
        return {}
    n = round(float(number.mean())) if out.crossed is None else len(out.crossed.blocks)
    counts = sorted({max(2, math.ceil(n / 2)), n, 2 * n, 4 * n} - {1})
    by_factor, cells = {}, number.size
    for name in (f for f in out.data.factors if (f,) in out.terms):
        row, levels = out.anova.row(name), len(out.data.layout.levels[name])
        if row.f is None or not row.f > 0 or row.ms is None:
            continue
        sd, rows = math.sqrt(row.ms / row.f / (cells / levels)), []
        for count in counts:
            df2 = (levels - 1) * (count - 1) if blocked else cells * (count - 1)
            size = detectable(sd, count, (levels - 1, df2), out.request.alpha, 0.8)
            value = math.exp(size) if out.request.scale.is_log else size
            rows.append(PowerRow(count, value, (levels - 1, df2)))
        by_factor[name] = tuple(rows)
    return by_factor


#: differences over the scatter that no number of runs has to find: beyond, powers overflow
_LARGEST = 1e100


def detectable(sd: float, n: int, df: tuple[int, int], alpha: float, power: float) -> float:
    """Smallest largest difference of ``n`` blocks or replicates that is found with this power."""
    from scipy.optimize import brentq

    def gap(d: float) -> float:
        return power_of(n * d**2 / 2, df, alpha) - power

    # statsmodels 0.15 would end here, without a warning, at a power of 0.05 for 3 or 5 blocks:
    # its solve_power takes a root of f^2 between -1 and 1
    high = 1.0
    while gap(high) < 0:
        high *= 2
        if high > _LARGEST:
            return math.inf
    difference: float = brentq(gap, 0.0, high)
    return difference * sd


def power_of(noncentrality: float, df: tuple[int, int], alpha: float) -> float:
    """Power of the F test of two extreme means: lambda = n d^2 / (2 sd^2), the least it can be."""
    from scipy.special import fdtri

    if noncentrality == 0:
        return alpha
    return noncentral_f_sf(*df, noncentrality, float(fdtri(*df, 1 - alpha)))


# -------------------------------------------------------------------------------------------------
# Before a study is run: how probable each verdict is with so many specimens and mesh seeds.
#
# The verdict of a contrast rests on its interval d +- t s / sqrt(b) widened by U. Given the
# standard deviation over blocks, d is normal and s^2 a multiple of chi-squared, so that every
# probability is one integral over s: the noncentral t for *matters*, Owen's Q (Owen 1965,
# Biometrika 52, 437-446) for *no practical difference*.

#: numbers of blocks beyond this are not looked for
MOST_BLOCKS = 200


@dataclass(frozen=True)
class VerdictProbabilities:
    """Probability of each verdict; they add to one."""

    matters: float
    no_practical_difference: float
    not_resolved: float
    cannot_tell: float


@dataclass(frozen=True)
class PlannedVerdicts:
    """What a number of blocks and seeds would tell, and what it costs."""

    #: Specimens, and mesh seeds for each: one, as a verb plans them.
    blocks: int
    seeds: int
    #: If the true difference is zero.
    equal: VerdictProbabilities
    #: If it is twice the practical difference.
    double: VerdictProbabilities
    cases: int
    seconds: float | None

    @property
    def right(self) -> float:
        """Smaller probability of the right claim, over both truths."""
        return min(self.equal.no_practical_difference, self.double.matters)


def verdict_probabilities(
    blocks: int, sd: float, practical: float, truth: float, *, u: float = 0.0
) -> VerdictProbabilities:
    """Probability of each verdict of a contrast.

    Examples
    --------
    >>> round(verdict_probabilities(3, 0.3, 1.0, 0.0).no_practical_difference, 2)
    0.73
    """
    _verdict_power_check(blocks, sd, practical, u)
    if blocks == 1:
        return VerdictProbabilities(0.0, 0.0, 0.0, 1.0)
    matters, none = _claimed(blocks, sd, practical, truth, u)
    able = _claimed(blocks, sd, practical, truth, 0.0)
    unresolved = max(0.0, sum(able) - matters - none)
    return VerdictProbabilities(matters, none, unresolved, max(0.0, 1 - sum(able)))


def _claimed(
    blocks: int, sd: float, practical: float, truth: float, u: float
) -> tuple[float, float]:
    """Probability of *matters* and of *no practical difference*."""
    from scipy.special import ndtr, stdtrit

    error = sd / math.sqrt(blocks)
    t = float(stdtrit(blocks - 1, 0.975)) * error
    s, weights = scale_rule(blocks - 1)
    outer = practical + u + t * s
    above = ndtr((truth - outer) / error) + ndtr((-outer - truth) / error)
    # no interval that is wider than the band lies within it
    s, narrow = scale_rule(blocks - 1, (practical - u) / t)
    inner = practical - u - t * s
    within = ndtr((inner - truth) / error) - ndtr((-inner - truth) / error)
    return float(weights @ above), float(narrow @ np.maximum(within, 0.0))


def planned_verdicts(
    counts: Sequence[int],
    sd: float,
    practical: float,
    *,
    u: float = 0.0,
    cells: int = 2,
    seconds: float | None = None,
) -> tuple[PlannedVerdicts, ...]:
    """Tell what each number of blocks would find, with its cost.

    Units: seconds s.
    """
    rows = []
    for blocks in counts:
        equal, double = (
            verdict_probabilities(blocks, sd, practical, truth, u=u)
            for truth in (0.0, 2 * practical)
        )
        cases = cells * blocks
        cost = None if seconds is None else cases * seconds
        rows.append(PlannedVerdicts(blocks, 1, equal, double, cases, cost))
    return tuple(rows)


def fewest_blocks(
    sd: float, practical: float, *, u: float = 0.0, powers: Sequence[float] = (0.8, 0.9)
) -> tuple[int | None, ...]:
    """Smallest numbers of blocks whose right claim reaches each wanted probability.

    Examples
    --------
    >>> fewest_blocks(0.3, 1.0)
    (4, 4)
    """
    fewest: list[int | None] = []
    for level in powers:
        rows = (planned_verdicts([b], sd, practical, u=u)[0] for b in range(2, MOST_BLOCKS + 1))
        fewest.append(next((row.blocks for row in rows if row.right >= level), None))
    return tuple(fewest)


def _verdict_power_check(blocks: int, sd: float, practical: float, u: float) -> None:
    rules = [
        ("blocks", blocks >= 1, f"at least one is needed, got {blocks}"),
        ("sd", 0 < sd < math.inf, f"must be a positive number, got {sd!r}"),
        ("practical", 0 < practical < math.inf, f"must be a positive number, got {practical!r}"),
        ("numerical uncertainty", 0 <= u < math.inf,
         f"must be zero or a positive number, got {u!r}"),
    ]  # fmt: skip
    faults = [Fault(name, rule) for name, holds, rule in rules if not holds]
    if faults:
        raise InputError(faults)
