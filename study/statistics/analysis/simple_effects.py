"""Simple effects: what a factor does at each setting of the factors that it interacts with.

*No practical difference, whatever the other factors* is claimed where every simple effect lies
inside the practical band. Claiming that all of several hypotheses hold is an intersection-union
test (Berger 1982, Technometrics 24, 295): each interval keeps its own level, and the claim is
false with at most half of alpha. *Matters at some setting* is a claim on one of many and needs
simultaneous intervals.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from study.ground.arrays import Array, Flags, Ints
from study.ground.errors import StudyError
from study.statistics.analysis.anova_table import Effect, SimpleEffect
from study.statistics.analysis.linear_model import ModelMatrix, Term, setting_rows
from study.statistics.convergence.contrast_bound import NumericalBound

if TYPE_CHECKING:
    import pandas as pd


# -------------------------------------------------------------------------------------------------
# The verdict on a difference: its interval, widened by the numerics, against what matters.
#
# A numerical error is a bias, so its bound widens the interval on both sides and is never added
# in quadrature. A verdict is a claim (*matters*, *no practical difference*) or a refusal: the data
# *cannot tell*, or they could and the mesh does not allow it.

MATTERS = "matters"
NO_DIFFERENCE = "no practical difference"
NOT_RESOLVED = "not resolved by the mesh"
CANNOT_TELL = "cannot tell"
CLAIMS = (MATTERS, NO_DIFFERENCE)
REFUSALS = (NOT_RESOLVED, CANNOT_TELL)
#: Why the values of one specimen claim nothing, however far they are from the threshold.
ONE_SPECIMEN = "one specimen: another may differ"
#: Why a difference has no U although meshes were refined.
UNBOUNDED = "with finer meshes a cell moves ever farther, so nothing bounds its error"
#: of an interaction, whose pure components nobody chooses between
SEE_SIMPLE = "see simple effects"


class Judgement(NamedTuple):
    """Verdict on one difference, or on several."""

    #: {"matters", "no practical difference", "not resolved by the mesh", "cannot tell"}: two claims
    #: and two refusals.
    verdict: str
    why: str
    #: Numerical uncertainty at which the mesh would allow the claim that the interval makes.
    u_needed: float | None = None


def claim(low: float, high: float, practical: float) -> str:
    """Claim that an interval allows; empty where it allows none.

    Examples
    --------
    >>> claim(1.2, 1.6, 1.0), claim(-0.3, 0.4, 1.0), claim(0.5, 1.5, 1.0)
    ('matters', 'no practical difference', '')
    """
    if low > practical or high < -practical:
        return MATTERS
    return NO_DIFFERENCE if -practical < low and high < practical else ""


def judge_all(
    low: Array, high: Array, practical: float, u: Array, wide: tuple[Array, Array] | None = None
) -> Judgement:
    """Judge several differences together, by the ends (m,) of their intervals and bounds u (m,).

    That one matters is claimed by its ``wide`` interval, which is the same by default.
    """
    wide_low, wide_high = wide or (low, high)
    beyond = np.maximum(wide_low, -wide_high)
    if (beyond - u > practical).any():
        return Judgement(MATTERS, "the interval lies beyond the practical band")
    inside = practical - np.maximum(-low, high)
    if (inside > u).all():
        return Judgement(NO_DIFFERENCE, "every interval lies inside the practical band")
    far, near = float(beyond.max()) - practical, float(inside.min())
    if far > 0 or near > 0:
        needed = far if far > 0 else near
        return Judgement(NOT_RESOLVED, resolution(needed), needed)
    return Judgement(CANNOT_TELL, "the interval crosses the practical threshold")


def resolution(needed: float) -> str:
    """Say which numerical uncertainty a claim needs.

    Examples
    --------
    >>> resolution(0.0512)
    'the numerical uncertainty would have to be below 0.051'
    """
    return f"the numerical uncertainty would have to be below {needed:.2g}"


#: Simple effects beyond this number are not listed: nobody reads them and none could be tested.
MOST = 20_000


Interval = tuple[float, float]


class Confidence(NamedTuple):
    """Error probability of intervals, and seed of the multipliers of simultaneous ones.

    Without a seed these are Bonferroni's, which are made at once and never narrower.
    """

    alpha: float
    seed: int | None = None


@dataclass(frozen=True)
class Estimates:
    """Contrasts with what their intervals need."""

    #: shape (m,); on the scale of the analysis.
    value: Array
    #: shape (m,); standard errors; None where nothing scatters.
    error: Array | None
    #: shape (m,); multipliers of the standard error, for one interval alone and for all together.
    single: float | Array = 0.0
    simultaneous: float | Array = 0.0
    #: Degrees of freedom of Student's t; None of another distribution.
    df: float | Array | None = None

    def intervals(self) -> Iterator[tuple[float, Interval, Interval]]:
        """Value of each contrast, its interval alone, and that of all of them together.

        Where nothing scatters all ends are the value.
        """
        error = np.zeros_like(self.value) if self.error is None else self.error
        halves = (error * self.single).tolist(), (error * self.simultaneous).tolist()
        for value, alone, every in zip(self.value.tolist(), *halves, strict=True):
            yield value, (value - alone, value + alone), (value - every, value + every)


@dataclass(frozen=True)
class Differences:
    """Differences of pairs of settings, of which there are far fewer than pairs."""

    #: shape (k, p); combinations of the coefficients of the model that give each setting.
    settings: Array
    #: shape (m,); settings of each difference, first - second.
    first: Ints
    second: Ints

    @classmethod
    def alone(cls, settings: Array) -> Differences:
        """Every setting by itself: its difference from nothing."""
        each = np.arange(1, len(settings) + 1)
        return cls(np.vstack([np.zeros((1, settings.shape[1])), settings]), each, 0 * each)

    def take(self, which: Ints | Flags) -> Differences:
        """Return some of the differences."""
        return replace(self, first=self.first[which], second=self.second[which])

    @property
    def rows(self) -> Array:
        """Combinations of the coefficients, shape (m, p); 256 GiB where 4,096 settings are paired.

        Where there may be many pairs, :meth:`each`, :meth:`times` and :meth:`lengths` serve.
        """
        return self.of(self.settings)

    def of(self, values: Array) -> Array:
        """Differences of values of the settings, shape (k, ...)."""
        return np.asarray(values[self.first] - values[self.second])

    @property
    def _are_few(self) -> bool:
        return bool(len(self.first) * self.settings.shape[1] <= AT_ONCE)

    def each(self, answer: Callable[[Array], Array]) -> Array:
        """Answers of each row by itself, shape (m, ...), from as many rows as memory may hold."""
        step = max(1, AT_ONCE // max(self.settings.shape[1], 1))
        ends = range(step, len(self.first), step)
        sides = zip(np.split(self.first, ends), np.split(self.second, ends), strict=True)
        return np.concatenate(
            [answer(self.settings[first] - self.settings[second]) for first, second in sides]
        )

    def times(self, by: Array) -> Array:
        """Rows times a vector, or a matrix of few columns, shape (m, ...)."""
        return self.rows @ by if self._are_few else self.of(self.settings @ by)

    def lengths(self) -> Array:
        """Euclidean lengths of the rows, shape (m,).

        Of many pairs they come from the products of the settings, and from the rows themselves
        where two settings are so near that their products cancel.
        """
        if self._are_few:
            return _lengths(self.rows)
        product = self.settings @ self.settings.T
        square = np.diagonal(product)
        both = square[self.first] + square[self.second]
        length = both - 2 * product[self.first, self.second]
        near = length < _CANCELS * both
        np.sqrt(length, out=length, where=~near)
        if near.any():
            length[near] = self.take(near).each(_lengths)
        return length


#: Numbers of rows of differences that are held at once: 32 MB.
AT_ONCE = 1 << 22
#: Share of the squared lengths of two settings below which that of their difference is not had
#: from products: above it the length has a relative error of 1e-13 at most.
_CANCELS = 1e-3


def _lengths(rows: Array) -> Array:
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", rows, rows)))


#: What is known of linear combinations of the coefficients of the model.
Sample = Callable[[Differences], Estimates]


@dataclass(frozen=True)
class SimpleEffects:
    """All simple effects of one factor and what they say together."""

    #: *matters* at some setting, *no practical difference* at any, or a refusal.
    verdict: str
    why: str
    #: In the order of the settings.
    effects: tuple[SimpleEffect, ...]
    #: Numerical uncertainty that a claim would need.
    u_needed: float | None = None
    #: Pairs (larger, smaller) whose difference is beyond the practical one at every setting.
    always: tuple[tuple[str, str], ...] = ()
    #: Reasons for which claims were withdrawn, of the factor or of one setting.
    withdrawn: tuple[str, ...] = ()
    #: What a claim assumes and the rows hardly tell.
    condition: str = ""


def partners(factor: str, terms: Sequence[Term]) -> tuple[str, ...]:
    """Factors that a factor interacts with in a model.

    Examples
    --------
    >>> partners("A", [("A",), ("B",), ("C",), ("A", "B")])
    ('B',)
    """
    names = (name for term in terms if factor in term for name in term)
    return tuple(dict.fromkeys(name for name in names if name != factor))


def simple_effects(
    factor: str,
    matrix: ModelMatrix,
    sample: Sample,
    practical: float | None,
    bound: NumericalBound | None,
    only: Mapping[str, str] | None = None,
) -> SimpleEffects | None:
    """Judge a factor at every setting of the factors that it interacts with."""
    others, levels_of, only = partners(factor, matrix.terms), matrix.layout.levels, only or {}
    choices = [
        [only[name]] if only.get(name) in levels_of[name] else levels_of[name] for name in others
    ]
    indices = [map(levels_of[n].index, c) for n, c in zip(others, choices, strict=True)]
    settings, levels = list(product(*indices)), levels_of[factor]
    pairs = list(combinations(range(len(levels)), 2))
    if not pairs or len(settings) * len(pairs) > MOST:
        return None
    columns = columns_at(factor, matrix, others, settings)
    start = np.arange(len(settings)) * len(levels)
    first, second = (np.concatenate([start + pair[side] for pair in pairs]) for side in (0, 1))
    estimates = sample(Differences(columns, first, second))
    has_error, effects = estimates.error is not None, []
    each = zip(product(pairs, settings), estimates.intervals(), strict=True)
    for ((i, j), setting), (d, ci, wide) in each:
        if math.isnan(d):  # cells are missing: this difference cannot be estimated
            continue
        at = {name: levels_of[name][c] for name, c in zip(others, setting, strict=True)}
        cells = [{**at, factor: level} for level in (levels[i], levels[j])]
        u = 0.0 if bound is None else bound.of(cells[0], cells[1])
        verdict, sides = verdict_of(ci, wide, u, practical), (levels[i], levels[j])
        shown = (ci if has_error else None, wide if has_error else None)
        bounded = None if u is None else float(u)
        effects.append(SimpleEffect(*sides, tuple(at.items()), d, *shown, bounded, verdict))
    if not effects:
        return None
    lost = len(estimates.value) - len(effects)
    judged = _together(tuple(effects), practical)
    if not lost:
        return judged
    where = "has an empty cell" if lost == 1 else "have an empty cell"
    return replace(judged, why=f"{judged.why}; {lost} of {len(estimates.value)} {where}")


def columns_at(
    factor: str, matrix: ModelMatrix, others: Sequence[str], settings: Sequence[tuple[int, ...]]
) -> Array:
    """Combine the coefficients of a factor at settings of others, shape (settings * k, p)."""
    k = len(matrix.layout.levels[factor])
    codes = {factor: np.tile(np.arange(k), len(settings))}
    codes |= {n: np.repeat([s[i] for s in settings], k) for i, n in enumerate(others)}
    return setting_rows(matrix, codes, [t for t in matrix.terms if factor in t])


def verdict_of(
    ci: tuple[float, float], wide: tuple[float, float], u: float | None, practical: float | None
) -> str:
    """Judge one difference by its own interval and by the simultaneous one.

    Of a quantity that diverges nothing bounds the numerical error (None), and nothing is claimed.
    """
    if practical is None or not (math.isfinite(ci[0]) and math.isfinite(ci[1])):
        return CANNOT_TELL
    if u is not None and claim(wide[0] - u, wide[1] + u, practical) == MATTERS:
        return MATTERS
    if u is not None and claim(ci[0] - u, ci[1] + u, practical) == NO_DIFFERENCE:
        return NO_DIFFERENCE
    resolvable = claim(*wide, practical) == MATTERS or claim(*ci, practical) == NO_DIFFERENCE
    return NOT_RESOLVED if resolvable else CANNOT_TELL


def _together(effects: tuple[SimpleEffect, ...], practical: float | None) -> SimpleEffects:
    if practical is None:
        return SimpleEffects(CANNOT_TELL, "no practical threshold was given", effects)
    low, high = np.array([e.ci or (e.difference, e.difference) for e in effects]).T
    wide = np.array([e.ci_simultaneous or (e.difference, e.difference) for e in effects]).T
    u = np.array([math.inf if e.u is None else e.u for e in effects])
    verdict, why, needed = judge_all(low, high, practical, u, (wide[0], wide[1]))
    unbounded = {e.u for e in effects if e.verdict == NOT_RESOLVED} == {None}
    why = {
        MATTERS: "the simultaneous interval of a simple effect lies beyond the practical band",
        NO_DIFFERENCE: "the interval of every simple effect lies inside the practical band",
        NOT_RESOLVED: UNBOUNDED if unbounded else why,
        CANNOT_TELL: "the interval of a simple effect crosses the practical threshold",
    }[verdict]
    always = _always(effects, practical) if verdict == MATTERS else ()
    return SimpleEffects(verdict, why, effects, needed, always)


def _always(effects: Sequence[SimpleEffect], practical: float) -> tuple[tuple[str, str], ...]:
    """Pairs whose difference lies beyond the practical one, on the same side, at all settings."""
    sides: dict[tuple[str, str], set[int]] = {}
    for e in effects:
        low, high = e.ci or (e.difference, e.difference)
        u = e.u or 0.0
        sign = 1 if low - u > practical else -1 if high + u < -practical else 0
        sides.setdefault((e.first, e.second), set()).add(sign)
    up = [pair for pair, signs in sides.items() if signs == {1}]
    return (*up, *((b, a) for (a, b), signs in sides.items() if signs == {-1}))


# -------------------------------------------------------------------------------------------------
# Claims held against the loss of one block: one that falls with it is fragile.
#
# Blocks are left out one at a time, as in the jackknife (Efron and Tibshirani 1993, chapter 11).

#: effects of some rows
Analysis = Callable[["pd.DataFrame"], Sequence[Effect]]

#: analyses that are made again at most
MOST_BLOCKS = 40
#: rows of a table whose analysis may be made that often
MOST_ROWS = 5000
#: two blocks are the least that an analysis needs, so that three are needed to leave one out
FEWEST_BLOCKS = 3


def without_each(
    table: pd.DataFrame, block: str, effects: Sequence[Effect], analyses: Sequence[Analysis]
) -> tuple[Effect, ...]:
    """Name the blocks without which a claim is not made."""
    labels = table[block].astype(str)
    names = list(dict.fromkeys(labels))
    claims = {e.term: e.verdict for e in effects if e.verdict in CLAIMS}
    if not (claims and FEWEST_BLOCKS <= len(names) <= MOST_BLOCKS and len(table) <= MOST_ROWS):
        return tuple(effects)
    lost: dict[str, list[str]] = {term: [] for term in claims}
    for name in names:
        gone = list(claims)
        try:
            for analyze in analyses:  # the last one that has to be asked decides
                verdicts = {e.term: e.verdict for e in analyze(table[labels != name])}
                gone = [term for term in gone if verdicts.get(term) != claims[term]]
                if not gone:
                    break
        except StudyError:
            return tuple(effects)  # the rest makes no analysis, so nothing is known
        for term in gone:
            lost[term].append(name)
    return tuple(
        replace(e, lost_without=tuple(lost[e.term])) if e.term in lost else e for e in effects
    )
