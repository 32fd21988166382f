"""Estimates of the terms of a model: components, level means and their standard errors."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations, product

import numpy as np
import scipy.sparse

from study.ground.arrays import Array, Flags, Ints
from study.statistics.analysis.anova_table import (
    ON_CONDITION,
    Comparison,
    CompleteSettings,
    Effect,
    SimpleEffect,
)
from study.statistics.analysis.comparisons import (
    all_contrasts,
    block_multiplier,
    letters,
    pooled_multiplier,
    studentized_range_quantile,
    t_quantile,
)
from study.statistics.analysis.linear_model import (
    ModelMatrix,
    Term,
    grid,
    setting_rows,
    term_name,
)
from study.statistics.analysis.simple_effects import (
    CANNOT_TELL,
    CLAIMS,
    MATTERS,
    NO_DIFFERENCE,
    NOT_RESOLVED,
    ONE_SPECIMEN,
    SEE_SIMPLE,
    Confidence,
    Differences,
    Estimates,
    Judgement,
    Sample,
    SimpleEffects,
    columns_at,
    judge_all,
    partners,
    resolution,
    simple_effects,
)
from study.statistics.analysis.sums_of_squares import Factored
from study.statistics.analysis.unreplicated import pseudo_standard_error
from study.statistics.convergence.contrast_bound import NumericalBound


@dataclass(frozen=True)
class TermEstimate:
    """Estimates of one term on the working scale."""

    term: Term
    levels: tuple[str, ...]
    #: shape (k,); pure effect of each level (or combination); differences of level means for a
    #: factor.
    component: Array
    #: shape (k,); marginal means, NaN where not estimable.
    mean: Array
    #: shape (k, k); half-widths of the simultaneous intervals of all differences; None where there
    #: is no error.
    half: Array | None
    #: shape (k,); half-width of the interval of each mean.
    mean_half: Array | None
    p: float | None
    #: Level of each factor of the term in every combination.
    settings: tuple[tuple[str, ...], ...] = ()
    #: Over which settings a factor is averaged beside empty cells; None where over all of them.
    complete: CompleteSettings | None = None


def term_rows(
    fit: Factored, term: Term
) -> tuple[tuple[str, ...], Array, Array, CompleteSettings | None]:
    """Levels of a term, and the combinations (k, p) that give their components and means.

    Beside empty cells the components of a factor are those of the settings of others at which all
    its levels can be compared, if there are any: these are given too.
    """
    matrix, layout = fit.matrix, fit.matrix.layout
    cells = grid(layout, term)
    inner = [t for t in matrix.terms if set(t) <= set(term)]
    mean = setting_rows(matrix, cells.codes, inner)
    component, at = np.zeros_like(mean), matrix.of(term)
    component[:, at] = mean[:, at]
    labels = tuple(map(" ".join, zip(*map(cells.labels, term), strict=True)))
    if len(term) != 1 or fit.estimable(component).all():
        return labels, component, mean, None
    k, names = len(labels), partners(term[0], matrix.terms)
    settings = list(product(*(range(len(layout.levels[name])) for name in names)))
    each = columns_at(term[0], matrix, names, settings).reshape(len(settings), k, -1)
    centred = each - each.mean(axis=1, keepdims=True)
    complete = fit.estimable(centred.reshape(len(settings) * k, -1)).reshape(-1, k).all(axis=1)
    if not complete.any():
        return labels, component, mean, None
    places = CompleteSettings(names, int(complete.sum()), len(settings))
    return labels, centred[complete].mean(axis=0), mean, places


def pooled_estimate(
    fit: Factored, term: Term, df: float, p: float | None, alpha: float, rss: float
) -> TermEstimate:
    """Estimate of a term with the error variance ``rss / df`` (none where df is 0)."""
    sample = with_pooled_error(fit, rss, df, Confidence(alpha))
    levels = [len(fit.matrix.layout.levels[name]) for name in term]
    sizes = math.prod(levels), math.prod(k - 1 for k in levels)
    multiplier = critical(*sizes, df, alpha, main=len(term) == 1) if df > 0 else None
    return sampled_estimate(fit, term, p, sample, multiplier)


def sampled_estimate(
    fit: Factored, term: Term, p: float | None, sample: Sample, multiplier: float | None = None
) -> TermEstimate:
    """Estimate of a term whose differences and means have standard errors of their own each.

    ``multiplier`` is that of the differences; None for the sample's own.
    """
    levels, component_rows, mean_rows, complete = term_rows(fit, term)
    k = len(levels)
    # one after the other: of 4,096 cells the rows of either take 134 MB
    component = sample(Differences.alone(component_rows)).value
    means = sample(Differences.alone(mean_rows))
    if np.isnan(component).any():
        component = np.full(k, np.nan)
    half = mean_half = None
    if means.error is not None:
        mean_half = means.error * means.single
    if mean_half is not None and not np.isnan(component).any():
        first, second = np.triu_indices(k, 1)
        pairs = sample(Differences(component_rows, first, second))
        if pairs.error is not None:
            half = np.zeros((k, k))
            wide = pairs.error * (pairs.simultaneous if multiplier is None else multiplier)
            half[first, second] = half[second, first] = wide
    settings = tuple(product(*(fit.matrix.layout.levels[name] for name in term)))
    mean = fit.shift + means.value
    return TermEstimate(term, levels, component, mean, half, mean_half, p, settings, complete)


def critical(
    k: int, df_term: int, df: float, alpha: float, *, by_block: bool = False, main: bool = False
) -> float:
    """Smallest valid simultaneous multiplier of the differences of k levels of a term.

    Bonferroni's, or that of all contrasts of the term; of a ``main`` effect with a pooled error
    Tukey and Kramer's. With variances of their own ``by_block`` none needs sphericity.
    """
    if k == 2 or df_term == 1:
        return t_quantile(alpha / 2, df)
    options = [t_quantile(alpha / (k * (k - 1)), df)]
    if (every := all_contrasts(df_term, df, alpha, by_block=by_block)) is not None:
        options.append(every)
    if main:
        options.append(studentized_range_quantile(1 - alpha, k, df) / math.sqrt(2))
    return min(options)


# -------------------------------------------------------------------------------------------------
# What is known of combinations of coefficients: over blocks, with a pooled error, or exactly.


def estimable_differences(fit: Factored, differences: Differences) -> Flags:
    """Whether each difference can be estimated: all can where every setting can, shape (m,)."""
    if fit.estimable(differences.settings).all():
        return np.ones(len(differences.first), dtype=bool)
    return differences.each(lambda rows: fit.estimable(rows).astype(float)) > 0


def estimated_differences(fit: Factored, differences: Differences) -> Array:
    """Differences by least squares, NaN where they cannot be estimated, shape (m,)."""
    value = differences.times(fit.coefficients())
    return np.where(estimable_differences(fit, differences), value, np.nan)


def over_groups(
    fit: Factored, added: Array, groups: Sequence[Ints], confidence: Confidence
) -> Sample:
    """Estimate combinations of ``added`` (p, b) by a variance in each group of blocks (Welch)."""

    def estimate(differences: Differences) -> Estimates:
        estimable = estimable_differences(fit, differences)
        value = np.where(estimable[:, None], differences.times(added), np.nan)
        error, df = group_errors(value, groups)
        estimable = np.asarray(np.isfinite(value).all(axis=1))
        wide = np.zeros(len(value))
        if estimable.any():
            wide[estimable] = block_multiplier(value[estimable], groups, df[estimable], confidence)
        single = t_quantile(confidence.alpha / 2, df)
        return Estimates(value.sum(axis=1), error, single, wide, df)

    return estimate


def group_errors(value: Array, groups: Sequence[Ints]) -> tuple[Array, Array]:
    """Find the standard errors (m,) of sums of values (m, b) over blocks, and their df."""
    n = np.array([len(group) for group in groups])
    parts = n[:, None] * np.array([value[:, group].var(axis=1, ddof=1) for group in groups])
    total = parts.sum(axis=0)
    below = np.sum(parts**2 / (n - 1)[:, None], axis=0)
    all_of_them = np.full(len(value), float((n - 1).sum()))
    df = np.divide(total**2, below, out=all_of_them, where=below > 0)
    return np.sqrt(total), df


def with_pooled_error(fit: Factored, rss: float, df: float, confidence: Confidence) -> Sample:
    """Estimate combinations with one error variance, ``rss / df``; none where ``df`` is 0."""

    def estimate(differences: Differences) -> Estimates:
        value = estimated_differences(fit, differences)
        if df <= 0 or rss <= 0:
            return Estimates(value, None)
        estimable, wide = np.isfinite(value), 0.0
        roots = replace(differences, settings=differences.settings @ fit.inverse)
        length = roots.lengths()
        if estimable.any():
            some = roots.take(estimable)
            wide = pooled_multiplier(some, length[estimable], df, confidence)
        error = length * math.sqrt(rss / df)
        return Estimates(value, error, t_quantile(confidence.alpha / 2, df), wide, df)

    return estimate


def by_components(
    share: Array, variance: Array, free: Array, *, cautious: bool = False
) -> tuple[Array, Array]:
    """Find standard errors (m,) of shares (m, k) of independent sources, and Satterthwaite's df.

    The error is infinite where a source that counts has an infinite variance or none does. With
    ``cautious`` a source of one degree of freedom, whose variance may be small by chance, leaves
    no more df than the sum of the shares over its own: simulated, 10 and 2 rows, the two with 3.3
    times the scatter: false claims .085 without, .05 with it.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        part = np.where(share == 0, 0.0, share * variance)
        square = part.sum(axis=1)
        df = square**2 / np.sum(part**2 / free, axis=1)
        if cautious:
            least = np.max(share, axis=1, where=free <= 1, initial=0.0)
            df = np.minimum(df, share.sum(axis=1) / least)
    finite = np.isfinite(square) & np.isfinite(df)
    return np.where(finite, np.sqrt(square), np.inf), np.where(finite, df, 1.0)


def cell_welch(
    fit: Factored,
    cell: Ints,
    variances: tuple[Array, Array],
    alpha: float,
    reading: float,
    rows_alike: Ints | None = None,
    *,
    cautious: bool = True,
) -> Sample:
    """Estimate combinations with a variance of its own in each cell (Welch, Satterthwaite).

    Of one factor the simultaneous intervals are those of Games and Howell (1976); a contrast that
    needs a cell with an infinite variance has no interval. Rows that the model describes alike
    have one number in ``rows_alike`` (n,): those of a cell where there are no blocks.
    """
    _, first, count = np.unique(
        cell if rows_alike is None else rows_alike, return_index=True, return_counts=True
    )
    variance = np.maximum(variances[0], reading**2)
    groups = (np.ones(first.size), (np.arange(first.size), cell[first]))
    member = scipy.sparse.csr_array(groups, shape=(first.size, variance.size))

    def shares(along: Array) -> Array:
        weight = along @ fit.q[first].T
        weight[np.abs(weight) < 1e-12 * np.abs(weight).max(initial=0.0)] = 0.0
        return np.asarray((weight**2 * count) @ member)

    return with_sources(fit, shares, variance, variances[1], alpha, ranges=True, cautious=cautious)


def with_sources(
    fit: Factored,
    shares: Callable[[Array], Array],
    variance: Array,
    free: Array,
    alpha: float,
    *,
    ranges: bool = False,
    cautious: bool = False,
) -> Sample:
    """Estimate combinations whose variance is a sum over sources, with Satterthwaite's df.

    ``shares`` gives the part (m, k) that combinations along the orthonormal columns have of each
    source (k,); with ``ranges`` pairs of levels have the multipliers of Games and Howell.
    """

    def estimate(differences: Differences) -> Estimates:
        value = estimated_differences(fit, differences)

        def scatter(rows: Array) -> Array:
            parts = by_components(shares(rows @ fit.inverse), variance, free, cautious=cautious)
            return np.stack(parts, axis=1)

        error, df = differences.each(scatter).T.copy()
        wide = t_quantile(alpha / (2 * max(len(value), 1)), df)
        if ranges:
            wide = games_howell_multiplier(differences, df, alpha)
        return Estimates(value, error, t_quantile(alpha / 2, df), wide, df)

    return estimate


def games_howell_multiplier(differences: Differences, df: Array, alpha: float) -> Array:
    """Multipliers (m,) of standard errors: Games and Howell's at each setting, or Bonferroni's."""
    m = len(df)
    safe = t_quantile(alpha / (2 * max(m, 1)), df)
    levels = len(differences.settings)
    if m > MOST_RANGES or m != levels * (levels - 1) // 2:
        return safe
    ranges = [studentized_range_quantile(1 - alpha, levels, d) / math.sqrt(2) for d in df.tolist()]
    return np.minimum(safe, ranges)


#: Differences whose studentized ranges are integrated one by one, at 2 ms each.
MOST_RANGES = 66
#: Draws of null contrasts behind the limits of a pseudo standard error.
PSEUDO_DRAWS = 4000


def with_pseudo_error(fit: Factored, contrasts: Array, confidence: Confidence, y: Array) -> Sample:
    """Estimate combinations of an unreplicated design with Lenth's pseudo standard error.

    Limits are quantiles of the same combinations of simulated null contrasts over their own
    pseudo standard error, as those of :func:`study.statistics.analysis.unreplicated.lenth`.
    """
    values = contrasts.T @ (y - y[0])
    pse = float(pseudo_standard_error(values))

    def estimate(differences: Differences) -> Estimates:
        along = fit.q.T @ contrasts
        weight = differences.each(lambda rows: (rows @ fit.inverse) @ along)
        length = np.linalg.norm(weight, axis=1)
        estimable = estimable_differences(fit, differences) & (length > 0)
        single, largest = np.full(len(weight), np.inf), np.zeros(PSEUDO_DRAWS)
        random, share = np.random.default_rng(confidence.seed or 0), 1 - confidence.alpha
        z = random.standard_normal((PSEUDO_DRAWS, len(values)))
        null = pseudo_standard_error(z)
        for i in np.flatnonzero(estimable):
            t = np.abs(z @ weight[i]) / length[i] / null
            largest = np.maximum(largest, t)
            single[i] = np.quantile(t, share)
        value = np.where(estimable, weight @ values, np.nan)
        return Estimates(value, pse * length, single, float(np.quantile(largest, share)))

    return estimate


UNEQUAL = (
    "cells scatter unequally or too few rows tell their scatter: with variances of their own "
    "(Welch) the interval does not allow the claim"
)
#: p of a preliminary test below which the assumption that it tests is not relied on. The usual
#: .05 leaves errors that it has little power to see (Bancroft 1964, Biometrics 20, 427-442).
DOUBT = 0.25


# -------------------------------------------------------------------------------------------------
# The working scale of a response: what matters on it, and what bounds its numerical error.


def _exp(value: float) -> float:
    """Exponential; infinite where a double is too small for it."""
    try:
        return math.exp(value)
    except OverflowError:
        return math.inf


@dataclass(frozen=True)
class Scale:
    """What turns an estimate into a verdict, on the working scale."""

    #: {"none", "log"}: of the response.
    transform: str
    practical: float | None
    #: Of the numerical error; None where none is known.
    bound: NumericalBound | None
    #: Whether the differences are known without scatter.
    deterministic: bool
    #: Unit of the response on the working scale.
    unit: float = 1.0
    #: Blocks that were measured; None where the rows are no scores of specimens.
    specimens: int | None = None
    #: Level of a factor that alone counts for the simple effects of the others.
    only: Mapping[str, str] = field(default_factory=dict)

    @property
    def back(self) -> Callable[[float], float]:
        """From the working scale to that of the report."""
        return _exp if self.transform == "log" else float

    def ends(self, interval: tuple[float, float] | None) -> tuple[float, float] | None:
        """Interval on the scale of the report."""
        return None if interval is None else (self.back(interval[0]), self.back(interval[1]))

    def between(self, estimate: TermEstimate, first: int, second: int) -> float | None:
        """Bound of the difference of two levels (or combinations) of a term, by their index."""
        if self.bound is None:
            return None
        sides = [
            dict(zip(estimate.term, estimate.settings[i], strict=True)) for i in (first, second)
        ]
        bound_between = self.bound.of if len(estimate.term) == 1 else self.bound.of_component
        return bound_between(*sides)


# -------------------------------------------------------------------------------------------------
# Claims, and the analyses as defensible as the printed one that have to make them too.


@dataclass(frozen=True)
class Rival:
    """Analysis as defensible as the printed one.

    ``why`` is the reason for which a claim is withdrawn that this analysis does not make;
    ``matrix`` and ``practical`` replace those of the printed analysis.
    """

    why: str
    sample: Sample
    #: Those that have to be made here as well; of none it is its note alone that is told.
    claims: tuple[str, ...] = CLAIMS
    matrix: ModelMatrix | None = None
    practical: float | None = None
    #: What a test of the printed analysis has shown, whether it asks for this one or not.
    note: str = ""
    #: What claims assume that a test of too little power has not contradicted.
    condition: str = ""


def refusal(why: str) -> Rival:
    """Rival that makes no claim: no analysis of these rows is defensible enough."""

    def estimate(differences: Differences) -> Estimates:
        zero = np.zeros(len(differences.first))
        return Estimates(zero, zero + np.inf, 1.0, 1.0)

    return Rival(why, estimate)


@dataclass(frozen=True)
class Gate:
    """The printed analysis of differences, and the rivals that every claim of it has to pass."""

    matrix: ModelMatrix
    scale: Scale
    sample: Sample
    rivals: tuple[Rival, ...] = ()
    #: Why differences that average over factors are not judged; empty if they are.
    undecided: str = ""

    @property
    def notes(self) -> tuple[str, ...]:
        """What the tests behind the rivals have shown."""
        return tuple(rival.note for rival in self.rivals if rival.note)

    @property
    def condition(self) -> str:
        """What claims assume and the rows hardly tell; empty where there is nothing of the kind."""
        return " and ".join(rival.condition for rival in self.rivals if rival.condition)

    def judged(self, terms: Sequence[Term]) -> dict[str, SimpleEffects]:
        """Judge every factor of a model by its simple effects."""
        judged_factors, scale = {}, self.scale
        for (name,) in (term for term in terms if len(term) == 1):
            judged = partial(simple_effects, name, bound=scale.bound, only=scale.only)
            printed = judged(self.matrix, self.sample, practical=scale.practical)
            if printed is None:
                if self.undecided:
                    judged_factors[name] = SimpleEffects(CANNOT_TELL, self.undecided, ())
                continue
            for rival in self.rivals:
                if not {e.verdict for e in printed.effects} & set(CLAIMS) & set(rival.claims):
                    continue
                limit = rival.practical or scale.practical
                other = judged(rival.matrix or self.matrix, rival.sample, practical=limit)
                printed = _agreed(printed, other, rival)
            judged_factors[name] = replace(printed, condition=self.condition)
        return judged_factors


def _agreed(printed: SimpleEffects, other: SimpleEffects | None, rival: Rival) -> SimpleEffects:
    """Withdraw those printed verdicts that a rival does not make."""
    by_setting = {(e.first, e.second, e.at): e.verdict for e in (other.effects if other else ())}
    whole = CANNOT_TELL if other is None else other.verdict

    def agreed(e: SimpleEffect) -> SimpleEffect:
        same = by_setting.get((e.first, e.second, e.at), whole) == e.verdict
        return e if same or e.verdict not in rival.claims else replace(e, verdict=CANNOT_TELL)

    effects = tuple(map(agreed, printed.effects))
    left = {effect.verdict for effect in effects}
    some_matter, none_matters = MATTERS in left, left == {NO_DIFFERENCE} == {whole}
    stands = some_matter if printed.verdict == MATTERS else none_matters
    stands = stands or printed.verdict not in rival.claims
    if not stands or effects != printed.effects:
        printed = replace(printed, effects=effects, withdrawn=(*printed.withdrawn, rival.why))
    if not stands:
        return replace(printed, verdict=CANNOT_TELL, why=rival.why, always=())
    always = tuple(pair for pair in printed.always if other and pair in other.always)
    return replace(printed, always=always)


# -------------------------------------------------------------------------------------------------
# Sizes of effects: level means, interval of the largest difference, simple effects, verdict.
#
# The verdict rests on the intervals against the practical band, widened by the bound of the
# numerical error; p never decides alone. That of a factor is the verdict of its simple effects:
# an average that does not matter may hide settings at which it does.

#: Levels beyond which nobody reads all pairs.
MOST_LEVELS = 20
#: Simple effects that are listed: the largest ones.
LISTED = 400


def size(
    estimate: TermEstimate, scale: Scale, simple: Mapping[str, SimpleEffects] | None = None
) -> Effect:
    """Turn an estimate into the reported effect with its verdict."""
    name, back = term_name(estimate.term), scale.back
    effect = Effect(
        name,
        estimate.levels,
        tuple(None if math.isnan(m) else back(float(m)) for m in estimate.mean),
        None,
        None,
        CANNOT_TELL,
        "ratio" if scale.transform == "log" else "difference",
        practical=None if scale.practical is None else back(scale.practical),
        p=estimate.p,
        complete=estimate.complete,
    )
    if estimate.mean_half is not None:
        around = zip(estimate.mean.tolist(), estimate.mean_half.tolist(), strict=True)
        ends = ((None, None) if math.isnan(m) else (back(m - h), back(m + h)) for m, h in around)
        effect = replace(effect, mean_ci95=tuple(ends))
    if np.isnan(estimate.component).any():
        return replace(effect, why="not estimable")
    top, bottom = int(np.argmax(estimate.component)), int(np.argmin(estimate.component))
    largest = float(estimate.component[top] - estimate.component[bottom])
    simple_effects = (simple or {}).get(name)
    verdict, why, needed = _judged(estimate, scale, simple_effects)
    pairs, tags = _pairs(estimate, back)
    u = scale.between(estimate, top, bottom)
    effect = replace(
        effect,
        range=back(largest),
        verdict=verdict,
        largest=(estimate.levels[top], estimate.levels[bottom]),
        u_num=None if u is None else u / scale.unit,
        effect_over_u_num=largest / u if u else None,
        resolved=_resolved(largest / u) if u else None,
        why=why,
        pairs=pairs,
        letters=tags,
        u_needed=None if needed is None else needed / scale.unit,
        u_unit=scale.unit,
    )
    if estimate.half is not None:
        wide = estimate.half[top, bottom]
        effect = replace(effect, ci95=(back(largest - wide), back(largest + wide)))
    if simple_effects is not None:
        listed, always = _listed(simple_effects, scale), simple_effects.always
        withdrawn = simple_effects.withdrawn
        effect = replace(effect, simple_effects=listed, always=always, withdrawn=withdrawn)
        if verdict in CLAIMS and simple_effects.condition:
            effect = replace(effect, why=f"{why}{ON_CONDITION}{simple_effects.condition}")
    if effect.is_main:
        return effect
    why = "an interaction is read from the simple effects of its factors"
    return replace(effect, verdict=SEE_SIMPLE, of_components=verdict, why=why)


def _judged(estimate: TermEstimate, scale: Scale, simple: SimpleEffects | None) -> Judgement:
    """Verdict of a term: that of its simple effects where it has some."""
    if scale.practical is None:
        return Judgement(CANNOT_TELL, "no practical threshold was given")
    if scale.specimens == 1:
        return Judgement(CANNOT_TELL, ONE_SPECIMEN)
    if estimate.half is None and not scale.deterministic:
        why = "there is no error to judge the effect against"
        return Judgement(CANNOT_TELL, simple.why if simple else why)
    if simple is None:
        verdict, why, needed = _of_components(estimate, scale)
    else:
        verdict, why, needed = _of_settings(simple, scale)
    remarks = ["no p" if estimate.p is None else "no interval"] * (estimate.half is None)
    remarks += ["2 specimens"] * (scale.specimens == 2)
    if remarks and verdict in CLAIMS:
        why = f"{why} ({', '.join(remarks)})"
    return Judgement(verdict, why, needed)


def _of_settings(simple: SimpleEffects, scale: Scale) -> Judgement:
    """Verdict of a factor over all settings; what an open one needs, in response units."""
    why = simple.why
    open_ones = [e for e in simple.effects if e.verdict == NOT_RESOLVED]
    if simple.u_needed is not None and open_ones:
        worst = max(open_ones, key=lambda e: abs(e.difference))
        at = ", ".join(f"{name} {level}" for name, level in worst.at)
        why = resolution(simple.u_needed / scale.unit) + (f" at {at}" if at else "")
    return Judgement(simple.verdict, why, simple.u_needed)


def _of_components(estimate: TermEstimate, scale: Scale) -> Judgement:
    """Verdict of the pure components of a term, over all pairs of levels."""
    k = len(estimate.levels)
    top, bottom = int(np.argmax(estimate.component)), int(np.argmin(estimate.component))
    # all pairs of many levels would take longer than the study: the largest bound serves
    is_common = scale.bound is None or k > MOST_LEVELS
    first, second = np.triu_indices(k, 1)
    if estimate.half is None and is_common:  # no pair says more than the two farthest apart
        first, second = np.array([top]), np.array([bottom])
    d = estimate.component[first] - estimate.component[second]
    bounds: list[float | None] = [0.0]
    if scale.bound is not None:
        pairs = [(top, bottom)] if is_common else zip(first.tolist(), second.tolist(), strict=True)
        bounds = [scale.between(estimate, i, j) for i, j in pairs]
    # nothing bounds the numerical error of a quantity that diverges
    u = np.broadcast_to([math.inf if v is None else v for v in bounds], d.shape)
    w = np.zeros(d.size) if estimate.half is None else estimate.half[first, second]
    judged = judge_all(d - w, d + w, scale.practical or 0.0, u)
    needed = judged.u_needed
    return judged if needed is None else judged._replace(u_needed=float(f"{needed:.6g}"))


def _listed(simple: SimpleEffects, scale: Scale) -> tuple[SimpleEffect, ...]:
    """List simple effects on the scale of the report, the largest ones where there are many."""
    largest = simple.effects
    if len(largest) > LISTED:
        largest = tuple(sorted(largest, key=lambda e: -abs(e.difference))[:LISTED])
    return tuple(
        replace(
            e,
            difference=scale.back(e.difference),
            ci=scale.ends(e.ci),
            ci_simultaneous=scale.ends(e.ci_simultaneous),
            u=None if e.u is None else e.u / scale.unit,
        )
        for e in largest
    )


def _resolved(ratio: float) -> str:
    if ratio >= 3:
        return "resolved"
    return "marginal" if ratio >= 1 else "not resolved"


def _pairs(
    estimate: TermEstimate, back: Callable[[float], float]
) -> tuple[tuple[Comparison, ...], tuple[str, ...]]:
    """Differences of all pairs of levels of a factor, and the letters of the levels."""
    levels, pairs = estimate.levels, []
    if estimate.half is None or len(estimate.term) != 1 or len(levels) > MOST_LEVELS:
        return (), ()
    for i, j in combinations(range(len(levels)), 2):
        d, h = float(estimate.component[i] - estimate.component[j]), float(estimate.half[i, j])
        ends = back(d), back(d - h), back(d + h)
        pairs.append(Comparison(levels[i], levels[j], *ends, different=abs(d) > h))
    apart = {frozenset((pair.first, pair.second)) for pair in pairs if pair.different}
    by_level = letters([levels[i] for i in np.argsort(-estimate.component, kind="stable")], apart)
    return tuple(pairs), tuple(by_level[level] for level in levels)
