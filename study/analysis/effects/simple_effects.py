"""Simple effects: what a factor does at each setting of the factors that it interacts with.

*No practical difference, whatever the other factors* is claimed where every simple effect lies
inside the practical band. Claiming that all of several hypotheses hold is an intersection-union
test (Berger 1982, Technometrics 24, 295): each interval keeps its own level, and the claim is
false with at most half of alpha. *Matters at some setting* is a claim on one of many and needs
simultaneous intervals.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import Protocol

import numpy as np

from study.analysis.anova_table import SimpleEffect
from study.analysis.effects.numerical_bound import NumericalBound
from study.analysis.effects.verdict import (
    CANNOT_TELL,
    MATTERS,
    NO_DIFFERENCE,
    NOT_RESOLVED,
    UNBOUNDED,
    claim,
    resolution,
)
from study.analysis.linear_model.design_matrix import Layout, ModelMatrix, Term, model_matrix
from study.arrays import Array, Ints

#: Simple effects beyond this number are not listed: nobody reads them and none could be tested.
MOST = 20_000


@dataclass(frozen=True)
class Estimates:
    """Contrasts with what their intervals need.

    Parameters
    ----------
    value : ndarray, shape (m,)
        On the scale of the analysis.
    error : ndarray, shape (m,), or None
        Standard errors; None where nothing scatters.
    single, simultaneous : float or ndarray, shape (m,)
        Multipliers of the standard error, for one interval alone and for all together.
    """

    value: Array
    error: Array | None
    single: float | Array = 0.0
    simultaneous: float | Array = 0.0


@dataclass(frozen=True)
class Differences:
    """Differences of pairs of settings, of which there are far fewer than pairs.

    Parameters
    ----------
    settings : ndarray, shape (k, p)
        Combinations of the coefficients of the model that give each setting.
    first, second : ndarray of int, shape (m,)
        Settings of each difference, first - second.
    """

    settings: Array
    first: Ints
    second: Ints

    @property
    def rows(self) -> Array:
        """Combinations of the coefficients, shape (m, p)."""
        return self.of(self.settings)

    def of(self, values: Array) -> Array:
        """Differences of values of the settings, shape (k, ...)."""
        return np.asarray(values[self.first] - values[self.second])


class Sample(Protocol):
    """What is known of linear combinations of the coefficients of the model."""

    def __call__(self, asked: Differences) -> Estimates:
        """Estimate some differences."""
        ...


@dataclass(frozen=True)
class SimpleEffects:
    """All simple effects of one factor and what they say together.

    Parameters
    ----------
    verdict, why : str
        *matters* at some setting, *no practical difference* at any, or a refusal.
    effects : tuple of SimpleEffect
        In the order of the settings.
    u_needed : float or None
        Numerical uncertainty that a claim would need.
    always : tuple of (str, str)
        Pairs (larger, smaller) whose difference is beyond the practical one at every setting.
    """

    factor: str
    verdict: str
    why: str
    effects: tuple[SimpleEffect, ...]
    u_needed: float | None = None
    always: tuple[tuple[str, str], ...] = ()

    @property
    def largest(self) -> SimpleEffect:
        """The one with the largest difference."""
        return max(self.effects, key=lambda effect: abs(effect.difference))


def partners(factor: str, terms: Sequence[Term]) -> tuple[str, ...]:
    """Factors that a factor interacts with in a model.

    Parameters
    ----------
    factor : str
        Name of the factor.
    terms : sequence of Term
        Terms of the model.

    Examples
    --------
    >>> partners("A", [("A",), ("B",), ("C",), ("A", "B")])
    ('B',)
    """
    found = (name for term in terms if factor in term for name in term)
    return tuple(dict.fromkeys(name for name in found if name != factor))


def simple_effects(
    factor: str,
    layout: Layout,
    matrix: ModelMatrix,
    sample: Sample,
    practical: float | None,
    bound: NumericalBound | None,
    only: Mapping[str, str] | None = None,
) -> SimpleEffects | None:
    """Judge a factor at every setting of the factors that it interacts with.

    Parameters
    ----------
    factor : str
        Factor whose levels are compared in pairs.
    layout : Layout
        Levels of all factors.
    matrix : ModelMatrix
        Columns of the fitted model.
    sample : Sample
        Estimates of combinations of its coefficients.
    practical : float or None
        Smallest difference that matters, on the scale of the analysis.
    bound : NumericalBound or None
        None where there is no numerical error.
    only : mapping of str to str, optional
        The one level of a factor that counts: the finest mesh, for the limit is asked for.

    Returns
    -------
    SimpleEffects or None
        None where there are too many to be judged.
    """
    others = partners(factor, matrix.terms)
    settings = list(_settings(layout, others, only or {}))
    pairs = list(combinations(range(len(layout.levels[factor])), 2))
    if not pairs or len(settings) * len(pairs) > MOST:
        return None
    found = sample(_differences(factor, layout, matrix, others, settings, pairs))
    effects = tuple(_effects(factor, layout, others, settings, pairs, found, bound, practical))
    if not effects:
        return None
    lost = len(found.value) - len(effects)
    judged = _together(factor, effects, practical)
    if not lost:
        return judged
    where = "has an empty cell" if lost == 1 else "have an empty cell"
    return replace(judged, why=f"{judged.why}; {lost} of {len(found.value)} {where}")


def _settings(
    layout: Layout, others: Sequence[str], only: Mapping[str, str]
) -> Iterator[tuple[int, ...]]:
    choices = [
        [layout.levels[name].index(only[name])]
        if only.get(name) in layout.levels[name]
        else range(len(layout.levels[name]))
        for name in others
    ]
    yield from product(*choices)


def _differences(
    factor: str,
    layout: Layout,
    matrix: ModelMatrix,
    others: Sequence[str],
    settings: Sequence[tuple[int, ...]],
    pairs: Sequence[tuple[int, int]],
) -> Differences:
    """Combine the coefficients to every difference."""
    k = len(layout.levels[factor])
    columns = columns_at(factor, layout, matrix, others, settings)
    start = np.arange(len(settings)) * k
    first = np.concatenate([start + i for i, _ in pairs])
    return Differences(columns, first, np.concatenate([start + j for _, j in pairs]))


def columns_at(
    factor: str,
    layout: Layout,
    matrix: ModelMatrix,
    others: Sequence[str],
    settings: Sequence[tuple[int, ...]],
) -> Array:
    """Combine the coefficients in which a factor enters, at settings of its partners.

    Parameters
    ----------
    factor : str
        Factor with k levels.
    layout : Layout
        Levels of all factors.
    matrix : ModelMatrix
        Columns of the fitted model, p of them.
    others : sequence of str
        Its partners.
    settings : sequence of tuple of int
        Level of each partner, by its index.

    Returns
    -------
    ndarray, shape (settings * k, p)
        The levels of the factor change fastest.
    """
    k = len(layout.levels[factor])
    codes = {name: np.zeros(len(settings) * k, dtype=np.int64) for name in layout.levels}
    codes[factor] = np.tile(np.arange(k), len(settings))
    for i, name in enumerate(others):
        codes[name] = np.repeat([setting[i] for setting in settings], k)
    cells = model_matrix(Layout(layout.levels, codes), [t for t in matrix.terms if t])
    columns = np.zeros((len(settings) * k, matrix.columns.shape[1]))
    for term in matrix.terms:
        if factor in term:
            columns[:, matrix.of(term)] = cells.columns[:, cells.of(term)]
    return columns


def _effects(
    factor: str,
    layout: Layout,
    others: Sequence[str],
    settings: Sequence[tuple[int, ...]],
    pairs: Sequence[tuple[int, int]],
    found: Estimates,
    bound: NumericalBound | None,
    practical: float | None,
) -> Iterator[SimpleEffect]:
    levels = layout.levels[factor]
    zero = np.zeros_like(found.value)
    error = zero if found.error is None else found.error
    one = (error * found.single).tolist()
    every = (error * found.simultaneous).tolist()
    for n, ((i, j), setting) in enumerate(product(pairs, settings)):
        at = {name: layout.levels[name][c] for name, c in zip(others, setting, strict=True)}
        u = 0.0
        if bound is not None:
            known = bound.of({**at, factor: levels[i]}, {**at, factor: levels[j]})
            u = np.nan if known is None else known
        d = float(found.value[n])
        if math.isnan(d):  # cells are missing: this difference cannot be estimated
            continue
        ci, wide = ((d - h, d + h) for h in (one[n], every[n]))
        yield SimpleEffect(
            levels[i],
            levels[j],
            tuple(at.items()),
            d,
            None if found.error is None else ci,
            None if found.error is None else wide,
            None if math.isnan(u) else float(u),
            verdict_of(ci, wide, u, practical),
        )


def verdict_of(
    ci: tuple[float, float], wide: tuple[float, float], u: float, practical: float | None
) -> str:
    """Judge one difference by its own interval and by the simultaneous one.

    Parameters
    ----------
    ci, wide : tuple of float
        Of this difference alone, and of all together.
    u : float
        Bound of its numerical error; NaN where nothing bounds it.
    practical : float or None
        Smallest difference that matters.
    """
    if practical is None or not (math.isfinite(ci[0]) and math.isfinite(ci[1])):
        return CANNOT_TELL
    # nothing bounds the numerical error of a quantity that diverges, so nothing is claimed of it
    if not math.isnan(u) and claim(wide[0] - u, wide[1] + u, practical) == MATTERS:
        return MATTERS
    if not math.isnan(u) and claim(ci[0] - u, ci[1] + u, practical) == NO_DIFFERENCE:
        return NO_DIFFERENCE
    resolvable = claim(*wide, practical) == MATTERS or claim(*ci, practical) == NO_DIFFERENCE
    return NOT_RESOLVED if resolvable else CANNOT_TELL


def _together(
    factor: str, effects: tuple[SimpleEffect, ...], practical: float | None
) -> SimpleEffects:
    verdicts = {effect.verdict for effect in effects}
    if practical is None:
        return SimpleEffects(factor, CANNOT_TELL, "no practical threshold was given", effects)
    if MATTERS in verdicts:
        why = "the simultaneous interval of a simple effect lies beyond the practical band"
        return SimpleEffects(factor, MATTERS, why, effects, always=_always(effects, practical))
    if verdicts == {NO_DIFFERENCE}:
        why = "the interval of every simple effect lies inside the practical band"
        return SimpleEffects(factor, NO_DIFFERENCE, why, effects)
    needed = _needed(effects, practical)
    if needed is not None:
        open_ones = [e for e in effects if e.verdict == NOT_RESOLVED]
        why = resolution(needed)
        if open_ones and all(e.u is None for e in open_ones):
            why = UNBOUNDED
        return SimpleEffects(factor, NOT_RESOLVED, why, effects, needed)
    why = "the interval of a simple effect crosses the practical threshold"
    return SimpleEffects(factor, CANNOT_TELL, why, effects)


def _needed(effects: Sequence[SimpleEffect], practical: float) -> float | None:
    """Numerical uncertainty that a claim needs; None where the scatter alone forbids it."""
    intervals = [e.ci or (e.difference, e.difference) for e in effects]
    wide = [e.ci_simultaneous or (e.difference, e.difference) for e in effects]
    beyond = [max(low, -high) - practical for low, high in wide]
    if max(beyond) > 0:
        return max(beyond)
    if all(claim(*ci, practical) == NO_DIFFERENCE for ci in intervals):
        return min(practical - max(-low, high) for low, high in intervals)
    return None


def _always(effects: Sequence[SimpleEffect], practical: float) -> tuple[tuple[str, str], ...]:
    """Pairs whose difference lies beyond the practical one, on the same side, at all settings."""
    found: dict[tuple[str, str], set[int]] = {}
    for e in effects:
        low, high = e.ci or (e.difference, e.difference)
        u = e.u or 0.0
        sign = 1 if low - u > practical else -1 if high + u < -practical else 0
        found.setdefault((e.first, e.second), set()).add(sign)
    up = [pair for pair, signs in found.items() if signs == {1}]
    return (*up, *((b, a) for (a, b), signs in found.items() if signs == {-1}))
