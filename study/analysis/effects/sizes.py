"""Sizes of effects: level means, interval of the largest difference, simple effects, verdict.

The verdict rests on the intervals against the practical band, widened by the bound of the
numerical error; p never decides alone. That of a factor is the verdict of its simple effects:
an average that does not matter may hide settings at which it does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from study.analysis.anova_table import Effect, PairDifference, SimpleEffect
from study.analysis.effects.comparisons import holm as adjusted_p
from study.analysis.effects.comparisons import letters
from study.analysis.effects.estimates import TermEstimate
from study.analysis.effects.scale import Scale
from study.analysis.effects.simple_effects import SimpleEffects
from study.analysis.effects.verdict import (
    CANNOT_TELL,
    MATTERS,
    NO_DIFFERENCE,
    NOT_RESOLVED,
    ONE_SPECIMEN,
    SEE_SIMPLE,
    Judgement,
    judge_all,
    resolution,
)
from study.analysis.linear_model.design_matrix import term_name
from study.arrays import Array

#: Levels beyond which nobody reads all pairs.
MOST_LEVELS = 20
#: Simple effects that are listed: the largest ones.
LISTED = 400


def size(
    estimate: TermEstimate, scale: Scale, simple: Mapping[str, SimpleEffects] | None = None
) -> Effect:
    """Turn an estimate into the reported effect with its verdict.

    Parameters
    ----------
    estimate : TermEstimate
        Estimates of one term on the working scale.
    scale : Scale
        Transformation, practical difference, numerical bound and specimens.
    simple : mapping of str to SimpleEffects, optional
        By factor; without them a factor is judged by its average differences.

    Returns
    -------
    Effect
        In the unit of the response, or as ratios for a log response.
    """
    own = (simple or {}).get(term_name(estimate.term))
    back = scale.back
    mean = tuple(None if math.isnan(m) else back(float(m)) for m in estimate.mean)
    effect = Effect(
        term_name(estimate.term),
        estimate.levels,
        mean,
        None,
        None,
        CANNOT_TELL,
        "ratio" if scale.transform == "log" else "difference",
        practical=None if scale.practical is None else back(scale.practical),
        p=estimate.p,
    )
    if np.isnan(estimate.component).any():
        return replace(effect, why="not estimable")
    top, bottom = int(np.argmax(estimate.component)), int(np.argmin(estimate.component))
    largest = float(estimate.component[top] - estimate.component[bottom])
    half = _half_widths(estimate)
    interval = None
    if half is not None:
        interval = (largest - half[top, bottom], largest + half[top, bottom])
    u = scale.between(estimate, top, bottom)
    found = _judged(estimate, half, scale, own)
    main = len(estimate.term) == 1
    pairs, tags = _pairs(estimate, half, back)
    return replace(
        effect,
        ci95=None if interval is None else (back(interval[0]), back(interval[1])),
        range=back(largest),
        verdict=found.verdict if main else SEE_SIMPLE,
        of_components="" if main else found.verdict,
        largest=(estimate.levels[top], estimate.levels[bottom]),
        mean_ci95=_mean_intervals(estimate, back),
        u_num=None if u is None else u / scale.unit,
        effect_over_u_num=largest / u if u else None,
        resolved=_resolved(largest / u) if u else None,
        why=found.why if main else "an interaction is read from the simple effects of its factors",
        pairs=pairs,
        letters=tags,
        u_needed=None if found.u_needed is None else found.u_needed / scale.unit,
        u_unit=scale.unit,
        simple_effects=() if own is None else _listed(own, scale),
        always=() if own is None else own.always,
    )


def _judged(
    estimate: TermEstimate, half: Array | None, scale: Scale, simple: SimpleEffects | None
) -> Judgement:
    """Verdict of a term: that of its simple effects where it has some."""
    if scale.practical is None:
        return Judgement(CANNOT_TELL, "no practical threshold was given")
    if scale.specimens == 1:
        return Judgement(CANNOT_TELL, ONE_SPECIMEN)
    if half is None and not scale.deterministic:
        return Judgement(CANNOT_TELL, "there is no error to judge the effect against")
    if simple is not None:
        found = _of_settings(simple, scale)
    else:
        found = _of_components(estimate, half, scale)
    if found.verdict not in (MATTERS, NO_DIFFERENCE):
        return found
    beside = [] if half is not None else ["no p"]
    if scale.specimens == 2:
        beside.append("2 specimens")
    return replace(found, why=f"{found.why} ({', '.join(beside)})") if beside else found


def _of_settings(simple: SimpleEffects, scale: Scale) -> Judgement:
    """Verdict of a factor over all settings; what an open one needs, in response units."""
    why = simple.why
    open_ones = [e for e in simple.effects if e.verdict == NOT_RESOLVED]
    if simple.u_needed is not None and open_ones:
        worst = max(open_ones, key=lambda e: abs(e.difference))
        at = ", ".join(f"{name} {level}" for name, level in worst.at)
        why = resolution(simple.u_needed / scale.unit) + (f" at {at}" if at else "")
    return Judgement(simple.verdict, why, simple.u_needed)


def _of_components(estimate: TermEstimate, half: Array | None, scale: Scale) -> Judgement:
    """Verdict of the pure components of a term, over all pairs of levels."""
    k = len(estimate.levels)
    wide = np.zeros((k, k)) if half is None else half
    first, second = np.triu_indices(k, 1)
    d = estimate.component[first] - estimate.component[second]
    u = np.zeros(d.size)
    if scale.bound is not None:
        # all pairs of many levels would take longer than the study: the largest bound serves
        pairs = list(zip(first.tolist(), second.tolist(), strict=True))
        if k > MOST_LEVELS:
            pairs = [(int(np.argmax(estimate.component)), int(np.argmin(estimate.component)))]
        known = [scale.between(estimate, i, j) for i, j in pairs]
        # nothing bounds the numerical error of a quantity that diverges
        u = np.array([math.inf if v is None else v for v in known])
        u = u if u.size == d.size else np.full(d.size, u.max(initial=0.0))
    w = wide[first, second]
    return judge_all(d - w, d + w, scale.practical or 0.0, u)


def _listed(simple: SimpleEffects, scale: Scale) -> tuple[SimpleEffect, ...]:
    """List simple effects on the scale of the report, the largest ones where there are many."""
    kept = simple.effects
    if len(kept) > LISTED:
        kept = tuple(sorted(kept, key=lambda e: -abs(e.difference))[:LISTED])
    return tuple(
        replace(
            e,
            difference=scale.back(e.difference),
            ci=_ends(e.ci, scale.back),
            ci_simultaneous=_ends(e.ci_simultaneous, scale.back),
            u=None if e.u is None else e.u / scale.unit,
        )
        for e in kept
    )


def _ends(
    interval: tuple[float, float] | None, back: Callable[[float], float]
) -> tuple[float, float] | None:
    return None if interval is None else (back(interval[0]), back(interval[1]))


def holm(effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """Adjust the p of all terms of one table together (Holm 1979, Scand. J. Statist. 6, 65).

    Parameters
    ----------
    effects : sequence of Effect
        All terms of one table; those without a p are no tests and stay as they are.
    """
    adjusted = iter(adjusted_p([effect.p for effect in effects if effect.p is not None]).tolist())
    return tuple(
        effect if effect.p is None else replace(effect, p_holm=next(adjusted)) for effect in effects
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


def _pairs(
    estimate: TermEstimate, half: Array | None, back: Callable[[float], float]
) -> tuple[tuple[PairDifference, ...], tuple[str, ...]]:
    """Differences of all pairs of levels of a factor, and the letters of the levels."""
    k = len(estimate.levels)
    if half is None or len(estimate.term) != 1 or k > MOST_LEVELS:
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
