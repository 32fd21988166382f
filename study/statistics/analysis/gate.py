"""One gate before every claim, whatever the error source.

A claim (*matters*, *no practical difference*) is made by the printed analysis and must be made by
every rival: an analysis that is as defensible on the same rows. A rival that does not make it
withdraws it, and its reason is printed. Rivals change no number of the table.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Container, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.special import ndtr

from study.ground.arrays import Array, Ints
from study.ground.units import p_phrase
from study.statistics.analysis.analysis_request import ResponseScale
from study.statistics.analysis.analysis_result import AnalysisResult
from study.statistics.analysis.comparisons import t_quantile
from study.statistics.analysis.data import Crossed, Data, chance_of_tie, rows_at_limit
from study.statistics.analysis.effects import (
    DOUBT,
    UNEQUAL,
    Gate,
    Rival,
    cell_welch,
    refusal,
    with_pooled_error,
    with_pseudo_error,
)
from study.statistics.analysis.equal_variance import doubted_variances, volatile_beside_blocks
from study.statistics.analysis.linear_model import (
    CellLayout,
    ModelMatrix,
    Term,
    balanced,
    factorize,
    model_matrix,
    nested_in,
    span,
    term_name,
    terms_of,
)
from study.statistics.analysis.simple_effects import (
    CLAIMS,
    MATTERS,
    NO_DIFFERENCE,
    Confidence,
    Differences,
    Estimates,
    Sample,
)
from study.statistics.analysis.sums_of_squares import (
    Factored,
    FRatioTest,
    TwoWayFit,
    extra_sum,
    factor,
    over_blocks,
)
from study.statistics.analysis.unreplicated import (
    added_contrasts,
    lenth,
    orthonormal_contrasts,
    pseudo_standard_error,
    ulp_floor,
)

#: blocks or rows from which skewness can be told from chance
FEWEST_FOR_SHAPE = 5
#: differences that have one sign in all blocks by chance, of all that are judged together, up to
#: which the logarithms of such differences are analyzed as well
ONE_SIGN = 0.4
#: multiple of the largest value seen beyond which no mean is looked for: draws of one block alone,
#: and logarithms of values that are all but zero, scatter without bound. Simulated with two seeds,
#: 1,000 sets each: of lognormal differences (sigma 1.2) in five blocks, three levels, .057 and .059
#: are claimed falsely (at 1.8: .066 with the second), and of normal ones, four levels in five
#: blocks, .91 of the claims stand (at 2: .89)
_FARTHEST = 1.9
#: share of the largest response below which a difference is rounding
_ROUNDING = 1e-12
#: contrasts that Lenth's method needs
LEAST_CONTRASTS = 7
#: directions that a model of a fraction leaves out from which they are looked at. In a complete
#: factorial six or fewer widen the interval beyond any interaction among them; in twelve runs of
#: Plackett and Burman main effects take a part of it
LEAST_LEFT_OUT = 4
#: size of the test that declares a sample skewed
SKEWED = 0.05
#: resamples of the bootstrap
_DRAWS = 2000
#: values from which on their sums are drawn from a normal distribution
_MANY = 500
#: largest standard deviation of the sum of squares for that, over the sum
_SMALL_SPREAD = 0.06
#: share of a mean within which its interval is told by the digits that are printed
_SURE_MEAN = 0.02
#: contrasts times rows that a rival keeps at once: 160 MB
_MOST_VALUES = 20_000_000
#: rows whose pairs are weighed to tell the variances of cells beside crossing blocks
_MOST_PAIRS = 2000

COARSE = "the readings are too coarse: with their rounding the interval does not allow the claim"
SKEW = "the differences are skewed: an interval without a normal distribution does not allow it"
#: how a note about it begins
LACK = "lack of fit of the declared model"
LACK_OF_FIT = "the declared model leaves out interactions that the data do not rule out"
UNSURE_LIMIT = "the mean, of which the practical difference is a share, is not known well enough"
NO_SCATTER = "the difference is the same in every block to the last digit: no scatter to judge by"
NO_CONTRAST = "most contrasts are zero to the last digit: no scatter to judge by"
#: chance of rows that agree below which a cell is taken to be without scatter
_STILL = 1e-4
STILL = (
    "the rows of a cell are the same to the last digit where others scatter: there is no scatter "
    "to judge it by"
)


def gate_of(
    out: AnalysisResult, fit: Factored, sample: Sample, rivals: Sequence[Rival] = ()
) -> Gate:
    """Return the gate of the claims of an analysis."""
    reasons = [] if out.request.records else [*_numbered_units(out.data, nested_in(out.terms))]
    if not out.request.records and out.request.layout.copies == "refuse":
        reasons += filter(None, [rows_at_limit(out.data)])
    every = (*map(refusal, reasons), *rivals)
    return Gate(fit.matrix, out.scale, sample, every, out.structure.undecided)


#: names of what is numbered, and no setting that anybody chose
_UNITS = re.compile(
    r"batch|lot|charge|specimen|sample|phantom|subject|animal|donor|coil|repeat|replicate|rep|piece"
)


def _numbered_units(data: Data, nested: Container[str]) -> Iterator[str]:
    """Say which factors are units by their name that have numbers, and were not said to nest."""
    for name in data.factors:
        levels, others = data.layout.levels[name], [f for f in data.factors if f != name]
        is_unit = any(map(_UNITS.fullmatch, re.findall(r"[a-z]+", name.lower().rstrip("s"))))
        counted = {str(i + int(levels[0] != "0")) for i in range(len(levels))}
        if others and is_unit and name not in nested and set(levels) == counted:
            yield (
                f"{name} {levels[0]} may be one {name} at all levels of {' and '.join(others)} "
                f"(--block {name}) or another at each (--unit {name}), without {name} in "
                "--factors; a name of its own for each says that these few are meant"
            )


def reading_error(out: AnalysisResult) -> float:
    """Return the standard deviation that rounding alone gives a reading, on the working scale."""
    step = out.structure.resolution
    if out.request.records or not step:
        return 0.0
    if out.request.scale.is_log:
        step /= float(np.exp(np.mean(np.log(out.data.y))))
    return step / math.sqrt(12)


def limit_rivals(scale: ResponseScale, alpha: float, sample: Sample, means: Array) -> list[Rival]:
    """Hold claims against both ends of a difference that is a share of the mean of ``means``."""
    limit = scale.practical
    if limit is None or not limit.relative or scale.is_log or means.size < 2:
        return []
    centre = abs(float(means.mean()))
    error = float(means.std(ddof=1) / math.sqrt(means.size))
    half = t_quantile(alpha / 2, means.size - 1) * error
    low, high = max(limit.value * (centre - half), 1e-300), limit.value * (centre + half)
    share = f"{100 * limit.value:g} % of a mean of {means.mean():.4g} \u00b1 {half:.2g}"
    why = f"{UNSURE_LIMIT}: {share} is {low:.3g} to {high:.3g}"
    note = f"what matters is {share}, so {low:.3g} to {high:.3g}: a claim holds at either end"
    note = note if half > _SURE_MEAN * centre else ""
    return [
        Rival(why, sample, (NO_DIFFERENCE,), practical=low, note=note),
        Rival(why, sample, (MATTERS,), practical=high),
    ]


def block_means(data: Data, y: Array) -> Array:
    """Mean of the response y (n,) in each block, on the working scale."""
    block, shifted = data.layout.codes[str(data.block)], y - y[0]
    return np.asarray(y[0] + np.bincount(block, shifted) / np.bincount(block))


def rivals_over_groups(
    out: AnalysisResult,
    fit: Factored,
    added: Array,
    groups: Sequence[Ints],
    sample: Sample,
    y: Array,
) -> list[Rival]:
    """Rivals where each effect is tested over blocks, which may lie in groups.

    ``added`` (p, b) is what each block of y (cells, b) adds to the coefficients.
    """
    confidence, rivals, reading = out.request.confidence, [], reading_error(out)
    if not out.request.records and out.replicates == "runs":
        rivals.append(Rival(NO_SCATTER, _with_scatter(sample, float(np.abs(y).max()))))
    if reading and out.replicates == "runs":
        rivals.append(rival_of_rounding(sample, lambda rows: rows @ fit.inverse, reading))
    if out.replicates != "noise":
        rivals.append(any_shape(confidence, sample, lambda rows: rows @ added, groups, y))
        rivals += limit_rivals(out.request.scale, confidence.alpha, sample, y.mean(axis=0))
    return rivals


def cell_fit(table: Crossed, terms: Sequence[Term]) -> Factored:
    """Fit of the terms to the means of the cells."""
    return factor(model_matrix(table.layout, terms), table.y.mean(axis=1))


def per_block(fit: Factored, y: Array) -> Array:
    """Find what each block of y (cells, b) adds to the mean coefficients of a fit, shape (p, b)."""
    return np.asarray(fit.inverse @ (fit.q.T @ (y - fit.shift)) / y.shape[1])


def rivals_of_rows(
    out: AnalysisResult, fit: Factored, rss: float, df: float, sample: Sample
) -> list[Rival]:
    """Rivals where one pooled variance serves all rows."""
    confidence, rivals, reading = out.request.confidence, [], reading_error(out)
    if reading and rss < df * reading**2:
        rivals.append(Rival(COARSE, with_pooled_error(fit, df * reading**2, df, confidence)))
    if out.data.block is None and out.replicates in ("runs", "mesh-seeds"):
        rivals += _rivals_of_cells(out, fit, sample, reading)
    elif out.data.block is not None and not out.request.records and out.y.size <= _MOST_PAIRS:
        index = np.unique(out.data.cell, return_inverse=True)[1]
        if variances := volatile_beside_blocks(fit, index):
            rows = np.arange(out.y.size)
            unequal = cell_welch(fit, index, variances, confidence.alpha, reading, rows)
            rivals.append(Rival(UNEQUAL, unequal))
    means = out.y.mean() + fit.residual if out.data.block is None else block_means(out.data, out.y)
    if out.replicates != "noise" and not out.request.records:
        rivals += limit_rivals(out.request.scale, confidence.alpha, sample, means)
    drift = drift_over_rows(out, fit)
    rivals += _rival_of_rows(out, fit) + _rival_of_drift(out, fit, drift, rss, df)
    if (alike := rows_in_line(out, drift)) is not None:
        # as many rows as independent ones, were each like the one before it by so much
        share = (1 - alike.most) / (1 + alike.most)
        left = max(df * share, 1.0)
        fewer = with_pooled_error(fit, rss * left / (df * share), left, confidence)
        rivals.append(Rival(alike.note, fewer))
    return rivals


def rivals_of_contrasts(out: AnalysisResult, fit: Factored, contrasts: Array) -> list[Rival]:
    """Rivals where Lenth's pseudo standard error of contrasts (n, m) serves all rows."""
    reading = reading_error(out)
    if not reading:
        values = contrasts.T @ (out.y - out.y[0])
        floor = ulp_floor(out.y) * math.sqrt(out.y.size)
        return [refusal(NO_CONTRAST)] if float(pseudo_standard_error(values)) <= floor else []
    sample = with_pseudo_error(fit, contrasts, out.request.confidence, out.y)
    return [rival_of_rounding(sample, lambda rows: rows @ fit.inverse, reading)]


def every_term(out: AnalysisResult, layout: CellLayout) -> tuple[Term, ...] | None:
    """Terms of the full model, where fewer were declared and the full one is no giant."""
    full = terms_of(out.data.factors)
    if set(full) <= set(out.terms) or np.prod([len(v) for v in layout.levels.values()]) > 4096:
        return None
    crossed = {frozenset(t) for t in out.terms}
    if any(len(t) > 1 and not {frozenset((f,)) for f in t} <= crossed for t in out.terms):
        return None  # nested: what is left out is no interaction
    return full


def rival_of_every_term(
    out: AnalysisResult, whole: Factored, at: Callable[[Confidence], Sample]
) -> list[Rival]:
    """Rival of the full model, where a coefficient that the declared one leaves out may not be 0.

    ``at`` gives the full model's sample; the coefficients are tested one by one, at the error
    probability of doubt over their number.
    """
    factors = set(out.data.factors)
    left_out = [t for t in whole.matrix.terms if t and t not in out.terms and set(t) <= factors]
    if not left_out:
        return []
    rows = np.eye(whole.columns.shape[1])[np.r_[tuple(map(whole.matrix.of, left_out))]]
    confidence = out.request.confidence
    estimates = at(confidence._replace(alpha=DOUBT / len(rows)))(Differences.alone(rows))
    if estimates.error is None:
        return []
    with np.errstate(invalid="ignore"):
        seen = int(np.sum(np.abs(estimates.value) > estimates.error * estimates.single))
    if not seen:
        return []
    note = f"{LACK}: {seen} of {len(rows)} coefficients that it leaves out may not be zero"
    return [rival_of_lack(note, 0.0, at(confidence), whole.matrix)]


def rival_of_lack(note: str, p: float, sample: Sample, matrix: ModelMatrix) -> Rival:
    """Rival of a larger model; where a test finds no lack of fit of the declared one, its note."""
    claims = CLAIMS if p < DOUBT else ()
    return Rival(f"{LACK_OF_FIT} ({note})", sample, claims, matrix, note=note)


def rival_over_blocks(fit: Factored, whole: Factored, y: Array, sample: Sample) -> list[Rival]:
    """Rival of the full model, where what the declared one leaves out is seen over the blocks.

    ``sample`` is that of the full model; the terms left out are tested against their own
    interactions in y (cells, b), all together and each direction.
    """
    from scipy.special import stdtr

    rest = span(whole.q - fit.q @ (fit.q.T @ whole.q))
    df, b = rest.shape[1], y.shape[1]
    if not df:
        return []
    z = rest.T @ (y - y[0, 0])
    centre, test = z.mean(axis=1), over_blocks(z)
    if test is None:
        p, note = float(not centre.any()), "lack of fit without any scatter"
    else:
        spread = np.sqrt(np.maximum(z.var(axis=1, ddof=1), 1e-300) / b)
        p = min(test.p, df * float(2 * stdtr(b - 1, -np.abs(centre) / spread).min()))
        of_rows = replace(test, df=float(df), df_error=float(df * (b - 1)))
        note = f"{LACK}: {of_rows.words} against the blocks"
    return [rival_of_lack(note, p, sample, whole.matrix)]


def _rival_of_rows(out: AnalysisResult, fit: Factored) -> list[Rival]:
    """Rival of the full model, where the rows do not rule out what the declared one leaves out."""
    confidence, data = out.request.confidence, out.data
    full = every_term(out, data.layout)
    if full is None:
        return []
    blocks = [(name,) for name in data.blocks]
    whole = factor(model_matrix(data.layout, full, extra=blocks), out.y)
    df, left = fit.df_residual - whole.df_residual, whole.df_residual
    if df <= 0:
        return []
    if (test := extra_sum(fit.rss - whole.rss, df, whole.rss, left)) is not None:
        p, note = test.p, f"{LACK}: {test.words}"
        sample = with_pooled_error(whole, whole.rss, left, confidence)
    elif data.block is not None or int(np.bincount(data.cell).max()) > 1:
        return []
    else:
        whole, names, contrasts, declared = _one_df_directions(out)
        left_out, is_full = names[declared:], balanced(data.layout, data.factors)
        if len(left_out) < (LEAST_CONTRASTS if is_full else LEAST_LEFT_OUT):
            return []
        values = contrasts[:, declared:].T @ (out.y - out.y[0])
        sparse = lenth(values, left_out, seed=out.request.seed)
        p, largest = min(sparse.p) * len(left_out), left_out[int(np.argmin(sparse.p))]
        seen = "stands out" if p < DOUBT else "is the largest and does not stand out"
        note = f"of the interactions declared negligible, {largest} {seen}: {p_phrase(min(1.0, p))}"
        sample = with_pseudo_error(whole, contrasts, confidence, out.y)
    return [rival_of_lack(note, p, sample, whole.matrix)]


#: pairs of rows that follow one another from which a correlation shows
_FEWEST_IN_LINE = 10
#: share of the rows of a cell that stand next to another of it, where cells were run one by one
_NEIGHBORS = 0.8
#: p of such a correlation below which it counts, so many tables without one have it, too. Of 150
#: tables each (autoregression .5, .8 of 2 x 20 rows; 4 x 3 rows of pieces) .21, .41, .24 make false
#: claims without it
_IN_LINE = 0.05
#: p of a trend over the rows below which it counts: so many tables without one have it, too
TREND = 0.01


@dataclass(frozen=True)
class RowDrift:
    """Straight line over the rows of a table, of weight if they stand in the order of the runs."""

    #: shape (n,); numbers of the rows about their mean, and what of them the model leaves.
    rows: Array
    along: Array
    slope: float
    test: FRatioTest


def drift_over_rows(out: AnalysisResult, fit: Factored | TwoWayFit) -> RowDrift | None:
    """Drift of the residuals; None where there is none, or rows are no runs."""
    rows = out.data.rows - out.data.rows.mean()
    along = rows - fit.projected(rows)
    square = float(along @ along)
    if out.replicates != "runs" or square <= 1e-6 * float(rows @ rows):
        return None
    slope = float(along @ fit.residual) / square
    explained = slope**2 * square
    test = extra_sum(explained, 1, fit.rss - explained, fit.df_residual - 1)
    if test is None or test.p >= TREND:
        return None
    return None if _is_sorted(out) else RowDrift(rows, along, slope, test)


def _is_sorted(out: AnalysisResult) -> bool:
    """Whether a table is sorted by the response within its cells, so in no order of runs."""
    order = np.argsort(out.data.cell, kind="stable")
    steps = np.diff(out.y[order])[np.diff(out.data.cell[order]) == 0]
    return bool((steps >= 0).all() or (steps <= 0).all())


@dataclass(frozen=True)
class RowsAlike:
    """Correlation of the rows of a cell that follow one another."""

    #: Upper end of its interval.
    most: float
    p: float
    note: str


def rows_in_line(out: AnalysisResult, drift: RowDrift | None) -> RowsAlike | None:
    """Correlation of rows of a cell that follow one another, beside a drift, where there is one.

    They share a piece that nobody named, or the response wanders from run to run: either way
    they are fewer than they seem. Tables whose cells were run in turn have no such neighbors.
    """
    if out.replicates != "runs" or out.request.records or out.data.blocks or _is_sorted(out):
        return None
    order = np.argsort(out.data.cell, kind="stable")
    cell = np.unique(out.data.cell[order], return_inverse=True)[1]
    same = np.diff(cell) == 0
    in_line = np.sum(same & (np.diff(out.data.rows[order]) == 1))
    if in_line < max(_FEWEST_IN_LINE, _NEIGHBORS * same.sum()):
        return None
    shifted, n = out.y[order] - out.y[0], np.bincount(cell)
    if drift is not None:
        shifted -= drift.slope * drift.rows[order]
    away = shifted - (np.bincount(cell, shifted) / n)[cell]
    squares = np.bincount(cell, away**2)
    # moments of normal deviates about their mean (Moran 1948, Biometrika 35, 255)
    above = float(np.sum((away[1:] * away[:-1])[same]) + np.sum(squares / n))
    variance = np.sum((squares * (n - 2) / n) ** 2 / np.maximum(n - 1, 1))
    p = float(ndtr(-above / math.sqrt(variance))) if variance > 0 else 1.0
    if p >= _IN_LINE:
        return None
    r = above / float(squares.sum())
    note = (
        f"rows of a cell that follow one another are alike (correlation {r:.2f}, {p_phrase(p)}): "
        "they are repeats on one piece (--unit with its column) or the response wanders from run "
        "to run, and tell less than independent rows"
    )
    # Fisher's z, up to two standard errors above it
    most = math.tanh(math.atanh(min(r, 0.99)) + 2 / math.sqrt(same.sum()))
    return RowsAlike(most, p, note)


def _rival_of_drift(
    out: AnalysisResult, fit: Factored, drift: RowDrift | None, rss: float, df: float
) -> list[Rival]:
    """Rival with the number of the row as a covariate, where the residuals drift."""
    if drift is None or df <= 1:
        return []
    square = float(drift.along @ drift.along)
    left = rss - drift.slope**2 * square
    printed = with_pooled_error(fit, left, df - 1, out.request.confidence)
    # what the model gives for the number of the row
    explained = fit.inverse @ (fit.q.T @ drift.rows)

    def estimate(differences: Differences) -> Estimates:
        estimates, apart = printed(differences), differences.of(differences.settings @ explained)
        if estimates.error is None:
            return estimates
        of_slope = np.abs(apart) * math.sqrt(left / (df - 1) / square)
        return replace(
            estimates,
            value=estimates.value - drift.slope * apart,
            error=np.hypot(estimates.error, of_slope),
        )

    why = "the response drifts over the rows: without the drift the interval does not allow it"
    return [Rival(why, estimate)]


def _one_df_directions(out: AnalysisResult) -> tuple[Factored, list[str], Array, int]:
    """Fit all that rows without repeats tell, with its directions of one degree of freedom each.

    Directions, shape (n, m), are orthonormal; those of the declared terms stand first, and the
    number of these is last. Terms that the rows of a fraction do not tell from earlier ones have
    none and are left out of the fit.
    """
    data, full = out.data, terms_of(out.data.factors)
    ordered = [*out.terms, *(term for term in full if term not in out.terms)]
    if balanced(data.layout, data.factors):
        names, contrasts = orthonormal_contrasts(data.layout, ordered)
        declared = len(orthonormal_contrasts(data.layout, out.terms)[0])
        return factor(model_matrix(data.layout, full), out.y), names, contrasts, declared
    every = factorize(model_matrix(data.layout, ordered))
    names, contrasts = added_contrasts(every, ordered)
    declared = len(added_contrasts(every, out.terms)[0])
    told_apart = [term for term in ordered if term_name(term) in names]
    return factor(model_matrix(data.layout, told_apart), out.y), names, contrasts, declared


def _rivals_of_cells(
    out: AnalysisResult, fit: Factored, sample: Sample, reading: float
) -> list[Rival]:
    """Welch's intervals of each difference, and bootstrap-t where a cell is skewed."""
    _, index, counts = np.unique(out.data.cell, return_inverse=True, return_counts=True)
    if counts.max() < 2:
        return []
    rivals = []
    if out.replicates == "runs" and _still(out.y, index, counts, reading):
        rivals.append(refusal(STILL))
    if variances := doubted_variances(out.y, index):
        rivals.append(Rival(UNEQUAL, cell_welch(fit, index, variances, out.request.alpha, reading)))
    is_small = fit.q.shape[0] * fit.matrix.columns.shape[1] < 2e6
    if counts.max() >= FEWEST_FOR_SHAPE and counts.min() >= 2 and is_small:
        groups = np.split(np.argsort(index, kind="stable"), np.cumsum(counts)[:-1])
        added = (fit.inverse @ fit.q.T) * (out.y - fit.shift)
        confidence = out.request.confidence
        rivals.append(any_shape(confidence, sample, lambda rows: rows @ added, groups, out.y))
    return rivals


def _still(y: Array, cell: Ints, counts: Ints, reading: float) -> bool:
    """Whether the rows of a cell agree, which the scatter of the others and rounding exclude."""
    shifted = y - y[0]
    residual = shifted - (np.bincount(cell, shifted) / counts)[cell]
    away = np.bincount(cell, np.abs(residual))
    still = away <= 16 * counts * float(np.spacing(np.abs(y).max()))
    free = float(np.sum(counts[~still] - 1))
    if not free or not still.any():
        return False
    sd = math.sqrt(float(np.sum(residual[~still[cell]] ** 2)) / free)
    chance = chance_of_tie(math.sqrt(12) * reading, sd)
    return bool(counts.size * chance ** float(counts[still].max() - 1) < _STILL)


def _with_scatter(sample: Sample, largest: float) -> Sample:
    """Return the same estimates; a difference that does not scatter at all tells nothing."""
    floor = 16 * float(np.spacing(largest))

    def estimate(differences: Differences) -> Estimates:
        estimates = sample(differences)
        if estimates.error is None:
            return estimates
        return replace(estimates, error=np.where(estimates.error <= floor, np.inf, estimates.error))

    return estimate


def rival_of_rounding(sample: Sample, along: Callable[[Array], Array], reading: float) -> Rival:
    """Rival whose rows scatter at least by what rounding gives a reading (standard deviation).

    ``along`` turns combinations of the coefficients to those of orthonormal columns.
    """

    def estimate(differences: Differences) -> Estimates:
        estimates = sample(differences)
        least = reading * replace(differences, settings=along(differences.settings)).lengths()
        error = least if estimates.error is None else np.maximum(estimates.error, least)
        return replace(estimates, error=error)

    return Rival(COARSE, estimate)


def any_shape(
    confidence: Confidence,
    sample: Sample,
    values: Callable[[Array], Array],
    groups: Sequence[Ints],
    y: Array,
) -> Rival:
    """Rival without a normal distribution, where the values show that they have none.

    ``values`` gives what each block (or row) adds to combinations of the coefficients.

    A contrast whose values (one a block, or one a row of each cell) are skewed beyond chance gets
    the interval of bootstrap-t (Efron and Tibshirani 1993, section 12.5). One whose values in all
    blocks have one sign, beyond chance, may be as large as the mean of a lognormal (upper limit by
    Cox's method; Zhou and Gao 1997, Statist. Med. 16, 783-790).
    """
    rounding, (alpha, seed) = _ROUNDING * float(np.abs(y).max()), confidence

    def estimate(differences: Differences) -> Estimates:
        estimates = sample(differences)
        if estimates.error is None or len(estimates.value) * y.size > _MOST_VALUES:
            return estimates
        value = values(differences.rows)
        m = len(value)
        # equal but for rounding: the last digits of what was subtracted have no distribution
        differs = np.abs(value).sum(axis=1) > rounding
        ends = {
            i: _bootstrap_t(value[i], groups, alpha, m, seed or 0)
            for i in np.flatnonzero(differs & _skewed(value, groups))
        }
        b = value.shape[1]
        if len(groups) == 1 and b >= FEWEST_FOR_SHAPE and m * 2.0 ** (1 - b) <= ONE_SIGN:
            same = differs & (np.abs(np.sign(value).sum(axis=1)) == b)
            for i in np.flatnonzero(same):
                # end far from zero of the interval of a lognormal mean
                log = np.log(np.abs(value[i] * b))
                variance = float(log.var(ddof=1))
                sigma = math.sqrt(variance / b + variance**2 / (2 * (b - 1)))
                end = float(log.mean()) + variance / 2 + t_quantile(alpha / 4, b - 1) * sigma
                end = float(np.sign(value[i, 0])) * math.exp(min(end, 700.0))
                low, high, wide = ends.get(i, (end, end, 0.0))
                ends[i] = (min(low, end), max(high, end), wide)
        if not ends:
            return estimates
        centre, error = estimates.value.copy(), estimates.error.copy()
        single, every = (np.full(m, k, dtype=float)
                         for k in (estimates.single, estimates.simultaneous))  # fmt: skip
        for i, (low, high, widest) in ends.items():
            farthest = _FARTHEST * b * float(np.abs(value[i]).max())
            half = error[i] * single[i]
            low = min(max(low, -farthest), centre[i] - half)
            high = max(min(high, farthest), centre[i] + half)
            every[i] = max(min(widest, farthest), error[i] * every[i])
            centre[i], error[i], single[i] = (low + high) / 2, 1.0, (high - low) / 2
        return Estimates(centre, error, single, every)

    return Rival(SKEW, estimate)


def _skewed(value: Array, groups: Sequence[Ints]) -> Array:
    """Whether the values of a contrast in a group are skewed beyond chance, shape (m,)."""
    skewed = np.zeros(len(value), dtype=bool)
    m = len(value) * len(groups)
    for group in groups:
        n = len(group)
        if n < FEWEST_FOR_SHAPE:
            continue
        centred = value[:, group] - value[:, group].mean(axis=1, keepdims=True)
        size = np.abs(value[:, group]).max(axis=1, initial=1e-60)
        varies = np.mean(centred**2, axis=1) > (_ROUNDING * size) ** 2
        centred[~varies] = 1.0
        skewed |= varies & (_skewness(centred) > _limit_of_skewness(n, min(m, 1000)))
    return skewed


def _skewness(centred: Array) -> Array:
    """Size of the skewness of samples about their means, shape (m,)."""
    return np.asarray(np.abs(np.mean(centred**3, axis=1)) / np.mean(centred**2, axis=1) ** 1.5)


@lru_cache(maxsize=256)
def _limit_of_skewness(n: int, tests: int) -> float:
    """Size of the skewness of n normals that is exceeded with .05 over all tests."""
    if n > 200:
        from scipy.special import ndtri

        return float(-ndtri(SKEWED / (2 * tests)) * math.sqrt(6 * (n - 2) / ((n + 1) * (n + 3))))
    z = np.random.default_rng(2011).standard_normal((20_000, n))
    z -= z.mean(axis=1, keepdims=True)
    return float(np.quantile(_skewness(z), 1 - SKEWED / tests))


def _bootstrap_t(
    value: Array, groups: Sequence[Ints], alpha: float, m: int, seed: int
) -> tuple[float, float, float]:
    """Find the ends of one interval of a sum over groups, and half the simultaneous one."""
    random = np.random.default_rng(seed)
    shift, variance, total = np.zeros(_DRAWS), np.zeros(_DRAWS), 0.0
    least = _ROUNDING * float(np.abs(value).max())
    for group in groups:
        part = value[group]
        if float(np.abs(part).max()) <= least:  # a cell outside the contrast adds nothing
            continue
        moved, scatter = _resampled(part, random)
        shift += moved
        variance += part.size * scatter
        total += part.size * float(part.var(ddof=1))
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(variance > 1e-24 * total, shift / np.sqrt(variance), np.sign(shift) * np.inf)
    t = np.sort(np.where(np.isnan(t), 0.0, t))
    error, centre = math.sqrt(total), float(value.sum())

    def quantile(p: float) -> float:
        return float(t[min(_DRAWS - 1, max(0, math.floor(p * (_DRAWS - 1))))])

    low, high = centre - quantile(1 - alpha / 2) * error, centre - quantile(alpha / 2) * error
    tail = max(alpha / (2 * m), 1 / _DRAWS)
    return low, high, max(abs(quantile(1 - tail)), abs(quantile(tail))) * error


def _resampled(part: Array, random: np.random.Generator) -> tuple[Array, Array]:
    """Draw how far sums of resampled values lie from the sum, and their variances, shape (draws,).

    Sums of many values and of their squares are normal with the covariance that the first four
    moments give (central limit theorem), unless tails are so heavy that single values decide.
    """
    n = part.size
    apart = part - part.mean()
    squares = apart**2
    second = float(squares.mean())
    spread = float(squares.var())
    if n < _MANY or spread > n * (_SMALL_SPREAD * second) ** 2:
        drawn = part[random.integers(0, n, (_DRAWS, n))]
        return drawn.sum(axis=1) - part.sum(), drawn.var(axis=1, ddof=1)
    skew = float(np.mean(squares * apart))
    first, other = random.standard_normal((2, _DRAWS)) * math.sqrt(n)
    shift = math.sqrt(second) * first
    slope = skew / second if second else 0.0
    rest = math.sqrt(max(spread - skew * slope, 0.0))
    summed = n * second + slope * shift + rest * other
    return shift, (summed - shift**2 / n) / (n - 1)
