"""Split plots: factors that vary between whole plots are tested against whole plots.

The rows are projected on orthogonal strata (blocks, whole plots in blocks, within whole
plots), as in Bailey, *Design of Comparative Experiments* (2008), chapter 8. A term is tested in
the last stratum that holds all of its degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from study.ground.arrays import Array, Ints
from study.ground.errors import Fault, InputError, nearest
from study.statistics.analysis import error_ledger
from study.statistics.analysis.analysis_request import AnalysisOutcome, kind_of
from study.statistics.analysis.anova_table import Anova, Row
from study.statistics.analysis.comparisons import bonferroni
from study.statistics.analysis.data import Data
from study.statistics.analysis.effects import (
    by_components,
    pooled_estimate,
    sampled_estimate,
    size,
    t_quantile,
)
from study.statistics.analysis.gate import (
    COARSE,
    Rival,
    block_means,
    every_term,
    judge_factors,
    limit_rivals,
    reading_error,
    rival_of_every_term,
)
from study.statistics.analysis.linear_model import (
    ALIAS_TOLERANCE,
    ModelMatrix,
    Term,
    complement,
    model_matrix,
    span,
    term_name,
)
from study.statistics.analysis.simple_effects import Differences, Estimates, Sample
from study.statistics.analysis.sums_of_squares import (
    Factored,
    TermSum,
    factor,
    term_row,
    term_sums,
    with_shares,
)


@dataclass(frozen=True)
class Plots:
    """Whole plots of a split plot."""

    #: Factors that are constant within every whole plot.
    between: tuple[str, ...]
    #: shape (n,); index of the whole plot of each row.
    code: Ints
    #: Name of the whole plots, ``specimen`` or ``block:A``.
    name: str
    #: Whether the block itself is the whole plot.
    nested: bool


@dataclass(frozen=True)
class Stratum:
    """One stratum: its terms, and the residual that they are tested against."""

    name: str
    fit: Factored
    sums: tuple[TermSum, ...]
    df: int


def whole_plots(data: Data, named: Sequence[str]) -> Plots | None:
    """Whole plots of a design: the blocks, where factors are constant in them, or as asked."""
    if data.block is None or data.also:
        return None
    block = data.layout.codes[data.block]
    if named:
        for name in named:
            if name not in data.factors:
                mend = nearest(name, data.factors)
                raise InputError(Fault("whole plot", f"{name!r} is no factor", mend))
        pair = data.layout.cell([data.block, *named])
        name = ":".join([data.block, *named])
        return Plots(tuple(named), np.unique(pair, return_inverse=True)[1], name, False)
    # every block holds one level, and a level lies in several blocks
    blocks, codes = np.unique(block).size, data.layout.codes
    constant = [
        f
        for f in data.factors
        if np.unique(data.layout.cell([data.block, f])).size == blocks > np.unique(codes[f]).size
    ]
    if not constant:
        return None
    return Plots(tuple(constant), block, data.block, True)


def split_plot(out: AnalysisOutcome, plots: Plots) -> AnalysisOutcome:
    """Analysis of a split plot with one pooled error in each stratum."""
    data = out.data
    matrix = model_matrix(data.layout, out.terms)
    whole = factor(matrix, out.y)
    bases = _even(whole, data, plots)
    strata = _strata(out, matrix, plots, bases)
    kind, out = kind_of(out, all(s.fit.is_orthogonal() for s in strata))
    strata = [replace(s, sums=tuple(term_sums(s.fit, kind))) for s in strata]
    place = _place(out.terms, strata, whole)
    rows, df = _rows(strata, place, whole.tss)
    lost = [term_name(t) for t, s in place.items() if s is None]
    out = out.warn(*(f"{name}: is in no stratum whole; no test" for name in lost))
    by_name = {row.term: row for row in rows}
    sample = _over_strata(out, whole, [basis for _, basis in bases], strata, reading=0.0)
    rivals = limit_rivals(out, sample, block_means(out))
    if reading := reading_error(out):
        coarse = _over_strata(out, whole, [basis for _, basis in bases], strata, reading=reading)
        rivals = [Rival(COARSE, coarse), *rivals]
    if (full := every_term(out, data.layout)) is not None:
        more, notes = _rival_of_every_term(out, full, plots, bases)
        rivals, out = [*rivals, *more], out.warn(*notes)
    simple = judge_factors(out, data.layout, whole, sample, rivals)
    effects = []
    for term in out.terms:
        stratum = place[term]
        fit, rest = (whole, 0) if stratum is None else (stratum.fit, stratum.df)
        estimate = pooled_estimate(
            data.layout, fit, term, rest, by_name[term_name(term)].p, out.request.alpha, fit.rss
        )
        of_means = sampled_estimate(data.layout, whole, term, None, sample)
        estimate = replace(estimate, mean=of_means.mean, mean_half=of_means.mean_half)
        effects.append(size(estimate, out.scale, simple))
    within = "the pooled scatter within whole plots"
    error = error_ledger.error_of_strata(str(data.block), plots.name, plots.between, within, df)
    return replace(
        out,
        error=error,
        anova=Anova(kind, with_shares(rows, whole.tss), out.y.size - 1, whole.tss),
        effects=tuple(effects),
        fit=error_ledger.within_fit(data, out.y, plots=plots.code),
        plots=plots.code,
    )


def _rival_of_every_term(
    out: AnalysisOutcome, full: Sequence[Term], plots: Plots, bases: list[tuple[str, Array]]
) -> tuple[list[Rival], list[str]]:
    """Rival of the model with every interaction, each stratum with the scatter that this leaves."""
    matrix = model_matrix(out.data.layout, full)
    whole = factor(matrix, out.y)
    strata = _strata(replace(out, terms=tuple(full)), matrix, plots, bases)

    def at(alpha: float) -> Sample:
        at_level = replace(out, request=replace(out.request, alpha=alpha))
        return _over_strata(at_level, whole, [basis for _, basis in bases], strata, reading=0.0)

    return rival_of_every_term(out, whole, at)


def _over_strata(
    out: AnalysisOutcome,
    whole: Factored,
    bases: Sequence[Array],
    strata: Sequence[Stratum],
    *,
    reading: float,
) -> Sample:
    """Estimate combinations whose variance is that of each stratum in which they lie.

    Degrees of freedom are Satterthwaite's; what has a part in a stratum without an error has no
    interval. The grand mean varies as the outermost stratum does.
    """
    mean = np.ones((out.y.size, 1)) / np.sqrt(out.y.size)
    coefficients, alpha = whole.coefficients(), out.request.alpha
    has_error = [s.df > 0 for s in strata]
    ms = np.array([max(s.fit.rss / s.df, reading**2) if s.df else np.inf for s in strata])
    df = np.array([float(max(s.df, 1)) for s in strata])

    def estimate(differences: Differences) -> Estimates:
        rows = differences.rows
        weight = (rows @ whole.inverse) @ whole.q.T
        parts = [np.sum((weight @ basis) ** 2, axis=1) for basis in bases]
        parts.append(np.sum(weight**2, axis=1) - np.sum(parts, axis=0))
        grand = np.sum((weight @ mean) ** 2, axis=1)
        parts[-1] = np.maximum(parts[-1] - grand, 0.0)
        parts[has_error.index(True) if any(has_error) else 0] += grand
        length = np.array(parts).T
        length[length < 1e-12 * length.sum(axis=1, keepdims=True)] = 0.0
        error, free = by_components(length, ms, df)
        value = np.where(whole.estimable(rows), rows @ coefficients, np.nan)
        wide = bonferroni(max(len(value), 1), free, alpha)
        return Estimates(value, error, t_quantile(alpha / 2, free), wide)

    return estimate


def _even(whole: Factored, data: Data, plots: Plots) -> list[tuple[str, Array]]:
    """Names and orthonormal bases of the strata, the last one (within) left to the caller."""
    mean = np.ones((data.y.size, 1)) / np.sqrt(data.y.size)
    parts = [] if plots.nested else [(str(data.block), data.layout.codes[str(data.block)])]
    bases, before = [], mean
    for name, code in [*parts, (plots.name, plots.code)]:
        basis = complement(before, np.eye(int(code.max()) + 1)[code])
        bases.append((name, basis))
        before = np.hstack([before, basis])
    return bases


def _strata(
    out: AnalysisOutcome, matrix: ModelMatrix, plots: Plots, bases: list[tuple[str, Array]]
) -> list[Stratum]:
    n = out.y.size
    within = np.hstack([np.ones((n, 1)) / np.sqrt(n), *(basis for _, basis in bases)])
    scale = np.linalg.norm(matrix.columns, axis=0)
    scale[scale == 0] = 1.0
    strata = []
    for name, basis in [*bases, ("residual", within)]:
        x, y = matrix.columns / scale, out.y - out.y[0]
        if basis is within:  # off all earlier strata, twice: the first time rounding is left
            for _ in range(2):
                x, y = x - within @ (within.T @ x), y - within @ (within.T @ y)
        else:
            x, y = basis @ (basis.T @ x), basis @ (basis.T @ y)
        # what rounding leaves of a column that has no part here must not look like a direction
        x[:, np.linalg.norm(x, axis=0) < ALIAS_TOLERANCE] = 0.0
        q = span(x)
        z = q.T @ y
        residual = y - q @ z
        rss, tss = float(residual @ residual), float(y @ y)
        fit = Factored(matrix, q, q.T @ x, scale, z, q @ z, residual, rss, tss, 0.0)
        size = n - within.shape[1] if basis is within else basis.shape[1]
        strata.append(Stratum(name, fit, (), size - fit.rank))
    return strata


def _place(
    terms: Sequence[Term], strata: Sequence[Stratum], whole: Factored
) -> dict[Term, Stratum | None]:
    """Stratum of each term: the last that holds all the degrees of freedom it has at all."""
    full = {s.term: s.df for s in term_sums(whole, "III")}
    place: dict[Term, Stratum | None] = {}
    for term in terms:
        holding = [s for s in strata if any(t.term == term and t.df == full[term] for t in s.sums)]
        place[term] = holding[-1] if holding and full[term] else None
    return place


def _rows(
    strata: Sequence[Stratum], place: dict[Term, Stratum | None], total: float
) -> tuple[list[Row], dict[str, float]]:
    rows, df = [], {}
    for stratum in strata:
        for s in stratum.sums:
            if place.get(s.term) is not stratum:
                continue
            df[term_name(s.term)] = float(stratum.df)
            rows.append(term_row(s, stratum.df, stratum.fit.rss, total, stratum.name))
        ms = stratum.fit.rss / stratum.df if stratum.df else None
        rows.append(Row(stratum.name, stratum.df, stratum.fit.rss, ms))
    rows += [Row(term_name(t), 0, 0.0) for t, s in place.items() if s is None]
    return rows, df
