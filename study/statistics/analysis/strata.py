"""The error model of blocks: strata, in each of which some terms are tested.

Rows divide into strata (blocks, whole plots in blocks, within whole plots), as in Bailey, *Design
of Comparative Experiments* (2008), chapter 8. Where one error serves all terms of a stratum, a
term is tested against it in the last one that holds all of its degrees of freedom. Else every term
has a stratum of its own, its interaction with the blocks (:func:`own`), in which no scatter is
pooled: blocks may lie in groups (a specimen in one mix), whose effects are tested against the
blocks themselves. Each group then has a covariance of its own (Welch-Box) from three blocks on;
with two, one covariance serves all. Where blocks lack cells, strata mix, and a mixed model is
fitted (:func:`incomplete_blocks`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from study.ground.arrays import Array, Ints
from study.ground.errors import Fault, InputError, nearest
from study.statistics.analysis import error_ledger
from study.statistics.analysis.analysis_result import AnalysisResult, Assumptions, kind_of
from study.statistics.analysis.anova_table import ErrorTerm, Row
from study.statistics.analysis.data import (
    Crossed,
    Data,
    blocks_that_lack_cells,
    constant_in_blocks,
    crossed,
)
from study.statistics.analysis.effects import (
    Gate,
    Rival,
    TermEstimate,
    critical,
    over_groups,
    pooled_estimate,
    refusal,
    sampled_estimate,
    with_pooled_error,
    with_sources,
)
from study.statistics.analysis.gate import (
    COARSE,
    block_means,
    cell_fit,
    every_term,
    gate_of,
    limit_rivals,
    per_block,
    reading_error,
    rival_of_every_term,
    rival_of_rounding,
    rival_over_blocks,
    rivals_over_groups,
)
from study.statistics.analysis.linear_model import (
    ALIAS_TOLERANCE,
    CellLayout,
    Factorization,
    Term,
    complement,
    factorize,
    factorize_columns,
    model_matrix,
    span,
    term_name,
    terms_of,
)
from study.statistics.analysis.mixed_model import (
    MixedCells,
    rival_of_shape,
    rivals_of_lack,
)
from study.statistics.analysis.restricted_likelihood import Sandwich, SingularError, fit_restricted
from study.statistics.analysis.simple_effects import Confidence, Sample
from study.statistics.analysis.sums_of_squares import (
    LEAST_OWN,
    Factored,
    SphericityResult,
    TermSum,
    alias_warnings,
    epsilon_gg,
    factor,
    fitted,
    row_of_test,
    sphericity,
    table_of,
    term_row,
    term_sums,
    welch_box,
)
from study.statistics.analysis.unreplicated import ulp_floor


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


def whole_plots(data: Data, named: Sequence[str]) -> Plots | None:
    """Whole plots of a design: the blocks, where factors are constant in them, or as asked."""
    if data.block is None or len(data.blocks) > 1:
        return None
    for name in named:
        if name not in data.factors:
            mend = nearest(name, data.factors)
            raise InputError(Fault("whole plot", f"{name!r} is no factor", mend))
    if named:
        columns = (data.block, *named)
        code = np.unique(data.layout.cell(columns), return_inverse=True)[1]
        return Plots(tuple(named), code, term_name(columns), False)
    # every block holds one level, and a level lies in several blocks
    code, codes = data.layout.codes[data.block], data.layout.codes
    blocks = np.unique(code).size
    constant = [f for f in constant_in_blocks(data) if blocks > np.unique(codes[f]).size]
    return Plots(tuple(constant), code, data.block, True) if constant else None


# -------------------------------------------------------------------------------------------------
# One error for all terms of a stratum: split plots.


@dataclass(frozen=True)
class Stratum:
    """One stratum: its terms, and the residual that they are tested against."""

    name: str
    #: Orthonormal directions of the rows; None of the last one, within all others.
    basis: Array | None
    fit: Factored
    df: int


def error_of_strata(block: str, plots: Plots, others: str, df: dict[str, float]) -> ErrorTerm:
    """E1 of a split plot: some factors vary between whole plots, the others within."""
    named = ", ".join(plots.between)
    return ErrorTerm(
        "E1",
        f"would the ranking change with another {block}? ({named} against whole plots "
        f"({plots.name}), the others against {others})",
        df,
        f"split plot: {named} is the same on the whole of a {plots.name}",
    )


def split_plot(out: AnalysisResult, plots: Plots) -> AnalysisResult:
    """Analysis of a split plot with one pooled error in each stratum."""
    data, alpha, confidence = out.data, out.request.alpha, out.request.confidence
    whole, strata = _strata(out, out.terms, plots)
    kind, out = kind_of(out, all(s.fit.is_orthogonal() for s in strata))
    complete = {s.term: s.df for s in term_sums(whole, "III")}
    sums = {s.name: term_sums(s.fit, kind) for s in strata}
    by_term = {t.term: s for s in strata for t in sums[s.name] if t.df and t.df == complete[t.term]}
    rows = []
    for s in strata:
        tested = [t for t in sums[s.name] if by_term.get(t.term) is s]
        rows += [term_row(t, s.df, s.fit.rss, whole.tss, s.name) for t in tested]
        if s.df or s.fit.rank:  # a block that is itself one whole plot holds none
            rows.append(Row(s.name, s.df, s.fit.rss, s.fit.rss / s.df if s.df else None))
    lost = [term_name(term) for term in out.terms if term not in by_term]
    rows += [Row(name, 0, 0.0) for name in lost]
    out = out.warn(*(f"{name}: is in no stratum whole; no test" for name in lost))
    sample = _over_strata(whole, strata, confidence)
    means = block_means(data, out.y)
    rivals = limit_rivals(out.request.scale, alpha, sample, means)
    if reading := reading_error(out):
        rivals = [Rival(COARSE, _over_strata(whole, strata, confidence, reading)), *rivals]
    if (full := every_term(out, data.layout)) is not None:
        every, within = _strata(out, full, plots)
        rivals += rival_of_every_term(out, every, partial(_over_strata, every, within))
    gate = gate_of(out, whole, sample, rivals)
    estimates, p = [], {row.term: row.p for row in rows}
    for term in out.terms:
        stratum = by_term.get(term)
        fit, df = (whole, 0) if stratum is None else (stratum.fit, stratum.df)
        estimate = pooled_estimate(fit, term, df, p[term_name(term)], alpha, fit.rss)
        of_means = sampled_estimate(whole, term, None, sample)
        estimates.append(replace(estimate, mean=of_means.mean, mean_half=of_means.mean_half))
    df_of = {term_name(t): float(by_term[t].df) for t in complete if t in by_term}
    error = error_of_strata(str(data.block), plots, "the pooled scatter within whole plots", df_of)
    out = out.concluded(error, table_of(kind, rows, out.y.size, whole.tss), estimates, gate)
    judged = error_ledger.within_fit(data, out.y, plots=plots.code)
    return replace(out, plots=plots.code, fit=judged, model=strata[-1].fit)


def _over_strata(
    whole: Factored, strata: Sequence[Stratum], confidence: Confidence, reading: float = 0.0
) -> Sample:
    """Estimate combinations whose variance is that of each stratum in which they lie.

    What has a part in a stratum without an error has no interval. The grand mean varies as the
    outermost stratum with an error does.
    """
    has_error = [s.df > 0 for s in strata]
    ms = np.array([max(s.fit.rss / s.df, reading**2) if s.df else np.inf for s in strata])
    df = np.array([float(max(s.df, 1)) for s in strata])

    def shares(along: Array) -> Array:
        weight = along @ whole.q.T
        parts = [np.sum((weight @ s.basis) ** 2, axis=1) for s in strata if s.basis is not None]
        grand = weight.sum(axis=1) ** 2 / weight.shape[1]
        rest = np.sum(weight**2, axis=1) - np.sum(parts, axis=0) - grand
        parts.append(np.maximum(rest, 0.0))
        parts[has_error.index(True) if any(has_error) else 0] += grand
        length = np.array(parts).T
        length[length < 1e-12 * length.sum(axis=1, keepdims=True)] = 0.0
        return length

    return with_sources(whole, shares, ms, df, confidence.alpha)


def _strata(
    out: AnalysisResult, terms: Sequence[Term], plots: Plots
) -> tuple[Factored, list[Stratum]]:
    """Fit of the terms to all rows, and to the projection of these on each stratum."""
    data, n = out.data, out.y.size
    matrix = model_matrix(data.layout, terms)
    codes = [] if plots.nested else [(str(data.block), data.layout.codes[str(data.block)])]
    earlier, bases = np.ones((n, 1)) / np.sqrt(n), []
    for name, code in [*codes, (plots.name, plots.code)]:
        bases.append((name, complement(earlier, np.eye(int(code.max()) + 1)[code])))
        earlier = np.hstack([earlier, bases[-1][1]])
    scale = np.linalg.norm(matrix.columns, axis=0)
    scale[scale == 0] = 1.0
    strata = []
    for name, basis in [*bases, ("residual", None)]:
        x, y = matrix.columns / scale, out.y - out.y[0]
        if basis is None:  # off all earlier strata, twice: the first time rounding is left
            for _ in range(2):
                x, y = x - earlier @ (earlier.T @ x), y - earlier @ (earlier.T @ y)
        else:
            x, y = basis @ (basis.T @ x), basis @ (basis.T @ y)
        # what rounding leaves of a column that has no part here must not look like a direction
        x[:, np.linalg.norm(x, axis=0) < ALIAS_TOLERANCE] = 0.0
        q = span(x)
        fit = fitted(Factorization(matrix, q, q.T @ x, scale), y, 0.0)
        directions = n - earlier.shape[1] if basis is None else basis.shape[1]
        strata.append(Stratum(name, basis, fit, directions - fit.rank))
    return factor(matrix, out.y), strata


# -------------------------------------------------------------------------------------------------
# A stratum for each term: its own interaction with the blocks, Greenhouse-Geisser corrected.

_COVARIANCES = "every group of blocks has a covariance of its own (Welch-Box)"
_ONE_COVARIANCE = "a group has two blocks only, so one covariance serves all groups"
_LONE_BLOCK = "a group has one block: nothing tells how another one of that group would differ"


@dataclass(frozen=True)
class OwnTests:
    """Tests of terms against their own interactions with the blocks of a group."""

    rows: dict[Term, Row]
    #: Scatter over blocks of the mean and of every term within blocks.
    errors: list[Row]
    sphericity: dict[str, SphericityResult]
    #: Why terms have no test.
    warnings: list[str]
    total: float


def own_tests(
    table: Crossed,
    cells: Factored,
    terms: Sequence[Term],
    kind: str,
    block: str,
    floor: float,
    groups: CellLayout | None = None,
    *,
    partial: bool = False,
) -> OwnTests:
    """Test every term against its own interaction with the blocks, which may lie in groups.

    For a term with orthonormal contrasts B (cells x df) every block gives one vector B' y; means of
    the vectors are the effect, their scatter within groups is its error. Nothing is pooled, so
    cells that differ only in discretization add no degrees of freedom.
    """
    shifted = table.y - table.y[0, 0]  # exact where doubles are close
    n, b = shifted.shape
    between, members = _between(groups, b)
    apart = members if len(members) > 1 and min(map(len, members)) >= LEAST_OWN else []
    total = float(np.sum((shifted - shifted.mean()) ** 2))
    tests = OwnTests({}, [], {}, [], total)
    by_factors = {frozenset(term): term for term in terms}
    mean = TermSum(np.full((n, 1), 1 / np.sqrt(n)), 1)
    inner = [replace(s, basis=cells.q @ s.basis) for s in term_sums(cells, kind)]
    for s in (mean, *inner):
        values = s.basis.T @ shifted
        residual = values - (values @ between.q) @ between.q.T
        df, ss_error = s.df * between.df_residual, float(np.sum(residual**2))
        against = ":".join((block, *s.term))
        tests.errors.append(Row(against, df, ss_error, ss_error / df if df else None))
        if s.df > 1:
            tests.sphericity[term_name(s.term)] = sphericity(residual, between.df_residual)
        for outer, direction in _directions(between, kind, s.term):
            term = by_factors.get(frozenset((*s.term, *outer)))
            if term is None:
                continue
            name, effect = term_name(term), values @ direction
            ss = float(np.sum(effect**2))
            tests.rows[term] = Row(name, effect.size, ss, ss / effect.size if effect.size else None)
            # what is left of a term that lost some is not the effect: an empty cell, or an alias
            if not effect.size or not (partial or s.df == s.nominal_df):
                continue
            if float(np.abs(s.basis @ values).max()) <= floor:
                why = "its levels agree within the solver tolerance in every block, no test"
                tests.warnings.append(f"{name}: {why}")
            elif float(np.abs(s.basis @ residual).max()) <= floor:
                why = f"its effect is the same in every {block} to the solver tolerance, no test"
                tests.warnings.append(f"{name}: {why}")
            else:
                sums = (effect.size, ss), (against, df, ss_error)
                corrected = _corrected(direction, values, residual, apart)
                tests.rows[term] = row_of_test(name, *sums, total, *corrected)
    return tests


def _between(groups: CellLayout | None, blocks: int) -> tuple[Factorization, list[Ints]]:
    """Model of the blocks by their groups, and the blocks of each group."""
    if groups is None:
        return factorize_columns(np.ones((blocks, 1))), [np.arange(blocks)]
    factors = tuple(groups.levels)
    code = groups.cell(factors)
    members = [np.flatnonzero(code == group) for group in np.unique(code)]
    return factorize(model_matrix(groups, terms_of(factors))), members


def _directions(between: Factorization, kind: str, part: Term) -> list[tuple[Term, Array]]:
    """Orthonormal directions over blocks of the mean and of every term between blocks."""
    terms = between.matrix.terms
    spaces = [(terms[i], between.q @ between.space(i, kind).basis) for i in range(1, len(terms))]
    if not part:
        return spaces
    n = between.q.shape[0]
    mean = np.ones((n, 1)) / np.sqrt(n)
    if kind == "III" and spaces:
        mean = between.q @ complement(between.r[:, 1:], between.r[:, :1])
    return [((), mean), *spaces]


def _corrected(
    direction: Array, values: Array, residual: Array, groups: Sequence[Ints]
) -> tuple[float, tuple[float, float] | None]:
    """Epsilon of Greenhouse and Geisser, or of Welch and Box with their F and its error's df."""
    if groups:
        weights = np.array([direction[group].sum(axis=0) for group in groups]).T
        test = welch_box([values[:, group] for group in groups], weights)
        if test is not None:
            f, df1, df2 = test
            epsilon = df1 / (len(values) * direction.shape[1])
            return epsilon, (f, df2 / epsilon)
    return epsilon_gg(residual @ residual.T), None


def by_block_interactions(out: AnalysisResult, plots: Plots | None = None) -> AnalysisResult | None:
    """E1: every effect against its own interaction with the blocks.

    E2 where the blocks are resamples of the noise, which all cells have in common. Where blocks are
    ``plots`` of some factors, these lie between groups of blocks. None where too few blocks have
    every cell.
    """
    data, block = out.data, str(out.data.block)
    within = tuple(f for f in data.factors if plots is None or f not in plots.between)
    table = crossed(replace(data, factors=within), out.y)
    n, b = table.y.shape
    if b < 2 or n < (2 if plots is None else 1):
        return None
    groups = None if plots is None else _groups(data, table, plots)
    between, members = _between(groups, b)
    if between.df_residual < 1:
        return None
    out = out.warn(*table.warnings)
    if out.replicates == "noise":
        # the scatter over refits is the standard error of the fit itself, however many there are
        # (Efron and Tibshirani 1993, chapter 6); that of their mean would fall with their number
        mean = table.y.mean(axis=1, keepdims=True)
        table = replace(table, y=mean + np.sqrt(b) * (table.y - mean))
    full = math.prod(len(table.layout.levels[f]) for f in within)
    if plots is None:
        fewer = n < np.unique(data.cell).size
        empty = full - n if fewer or out.structure.empty_cells else 0
        out = replace(out, structure=replace(out.structure, empty_cells=empty))
    kind, out = kind_of(out, n == full and len({len(m) for m in members}) == 1)
    some = kind == "I" and out.structure.empty_cells > 0
    inner = dict.fromkeys(tuple(f for f in term if f in within) for term in out.terms)
    cells = cell_fit(table, [term for term in inner if term])
    floor = max(out.working_tolerance(), ulp_floor(table.y))
    tests = own_tests(table, cells, out.terms, kind, block, floor, groups, partial=some)
    sums = term_sums(cells, kind)
    out = out.warn(*tests.warnings, *alias_warnings(sums, partial=some))
    rest = n - 1 - sum(s.df for s in sums)
    if rest > 0 and plots is None:
        out = out.warn(f"{rest} treatment degrees of freedom are outside the model")
    rows = [tests.rows[term] for term in out.terms if term in tests.rows]
    if plots is None:
        df = {row.term: float(row.df * (b - 1)) for row in rows}
        error, cautions = _own_error(out, b, df)
        out = out.warn(*cautions)
    else:
        df = {row.term: float(row.df_error or 0) for row in rows}
        error = error_of_strata(block, plots, "own interactions", df)
        alike = _COVARIANCES if min(map(len, members)) >= LEAST_OWN else _ONE_COVARIANCE
        is_requested = out.request.error == "own"
        error = replace(error, reason="asked for" if is_requested else f"{error.reason}; {alike}")
    layout = table.layout if groups is None else _product(table.layout, groups)
    estimates, gate = _estimates(out, tests, table, layout, members)
    listed = table_of(kind, [*rows, *tests.errors], n * b, tests.total)
    out = replace(
        out.concluded(error, listed, estimates, gate),
        assumptions=Assumptions(sphericity=tests.sphericity),
        fit=error_ledger.within_fit(data, out.y),
    )
    return replace(out, crossed=table) if plots is None else replace(out, plots=plots.code)


def _groups(data: Data, table: Crossed, plots: Plots) -> CellLayout:
    """Levels between blocks of each block."""
    block = str(data.block)
    index = {name: i for i, name in enumerate(data.layout.levels[block])}
    first = np.unique(data.layout.codes[block], return_index=True)[1]
    rows = first[[index[name] for name in table.blocks]]
    codes = {f: data.layout.codes[f][rows] for f in plots.between}
    return CellLayout({f: data.layout.levels[f] for f in plots.between}, codes)


def _product(cells: CellLayout, blocks: CellLayout) -> CellLayout:
    """Levels of every cell in every block, cell after cell."""
    codes = {name: np.repeat(code, blocks.n) for name, code in cells.codes.items()}
    codes |= {name: np.tile(code, cells.n) for name, code in blocks.codes.items()}
    return CellLayout({**cells.levels, **blocks.levels}, codes)


def _estimates(
    out: AnalysisResult, tests: OwnTests, table: Crossed, layout: CellLayout, groups: Sequence[Ints]
) -> tuple[list[TermEstimate], Gate]:
    """Estimates with variances of their own in each group, and the gate of claims by them.

    Where one of several groups has two blocks, sizes have the pooled error of their stratum.
    """
    request, b = out.request, table.y.shape[1]
    fewest, several = min(map(len, groups)), len(groups) > 1

    def with_parts(terms: Sequence[Term]) -> tuple[Factored, Array]:
        if not several:
            fit = cell_fit(table, terms)
            return fit, per_block(fit, table.y)
        y = table.y.ravel()
        fit = factor(model_matrix(layout, terms), y)
        each = (fit.inverse @ fit.q.T) * (y - fit.shift)
        return fit, each.reshape(len(each), -1, b).sum(axis=1)

    fit, added = with_parts(out.structure.asked or out.terms)
    sample = over_groups(fit, added, groups, request.confidence)
    own_errors = over_groups(fit, added, groups, Confidence(request.alpha))
    if fewest < 2:  # one block tells no scatter
        rivals = [refusal(_LONE_BLOCK)]
        sample = with_pooled_error(fit, fit.rss, fit.df_residual, Confidence(request.alpha))
    else:
        rivals = rivals_over_groups(out, fit, added, groups, sample, table.y)
        if (full := every_term(out, layout)) is not None:
            whole, parts = with_parts(full)
            at = partial(over_groups, whole, parts, groups)
            if several:
                rivals += rival_of_every_term(out, whole, at)
            else:
                rivals += rival_over_blocks(fit, whole, table.y, at(request.confidence))
    by_error = {row.term: row for row in tests.errors}
    estimates = []
    for term in out.terms:
        row = tests.rows.get(term, Row(term_name(term), 0, 0.0))
        p = row.p_deciding
        if not several or fewest >= LEAST_OWN:
            levels = math.prod(len(layout.levels[name]) for name in term)
            of_term = critical(levels, max(int(row.df), 1), b - 1, request.alpha, by_block=True)
            multiplier = None if several else of_term
            estimate = sampled_estimate(fit, term, p, own_errors, multiplier)
        else:
            error = by_error.get(row.error or "", row)
            df = error.df * (row.epsilon_gg or 1.0) if row.error else 0.0
            rss = (error.ms or 0.0) * df
            estimate = pooled_estimate(fit, term, df, p, request.alpha, rss)
            estimate = replace(estimate, mean_half=None)
        estimates.append(estimate)
    return estimates, gate_of(out, fit, sample, rivals)


def _own_error(
    out: AnalysisResult, blocks: int, df: dict[str, float]
) -> tuple[ErrorTerm, list[str]]:
    """Error of effects against their own interaction with the blocks, and what to beware of."""
    block = str(out.data.block)
    cautions: list[str] = []
    if out.replicates == "noise":
        source, question = "E2", error_ledger.NOISE_QUESTION
        against = f"scatter over {blocks} refits to resampled residuals"
        why = "cells hold refits to resampled measurement noise, the same for all cells of a curve"
        cautions = [error_ledger.ONE_CURVE]
    elif out.replicates == "mesh-seeds":
        source, question = "E3", "would another mesh of this size change the effect?"
        against = f"interaction with {blocks} mesh seeds"
        why = "every cell has the same mesh seeds, so they are blocks"
        few = blocks < error_ledger.ENOUGH_SEEDS
        cautions = [error_ledger.BIAS, *([f"{blocks} mesh seeds: ask for 8 or more"] * few)]
    else:
        source, question = "E1", f"would the ranking change with another {block}?"
        against = f"interaction with {blocks} levels of {block}"
        is_requested = out.request.error == "own"
        why = "asked for" if is_requested else "every cell is seen in the same blocks"
    question += f" (each effect against its own {against}, Greenhouse-Geisser corrected)"
    return ErrorTerm(source, question, df, why), cautions


# -------------------------------------------------------------------------------------------------
# Blocks that lack cells: a mixed model whose claims each difference's own scatter confirms.
#
# The factors' interactions with the blocks are random (REML, Kenward and Roger), so an effect is
# never tested against less than how it differs between blocks. Such a model gives one variance to
# all differences of a term. Where one level scatters more than the others that is too little for
# it, so every interval reaches as far as that of the sandwich estimate over the blocks, too (CR2
# with Satterthwaite's degrees of freedom: Bell and McCaffrey 2002, Survey Methodology 28, 169;
# Pustejovsky and Tipton 2018, J. Bus. Econ. Statist. 36, 672), which is the interval of paired
# differences where blocks are complete.

#: numbers in the products of all pairs of variances and of fixed effects: 160 MB
_MOST_PRODUCTS = 20_000_000


def incomplete_blocks(out: AnalysisResult, plots: Plots | None = None) -> AnalysisResult | None:
    """E1 by a mixed model; None where every block has all cells, or none can be fitted.

    Where factors were declared to be set once for a whole plot, blocks and whole plots are random.
    """
    data, block = out.data, str(out.data.block)
    lacking, b = blocks_that_lack_cells(data, data.factors)
    if not lacking or out.replicates in ("noise", "mesh-seeds"):
        return None
    mixed = mixed_cells(out, out.terms)
    if mixed is None:
        return None
    model, sandwich, sources = mixed
    fit, fixed = model.fit, model.fixed
    # sums of squares within blocks: shares of what varies there
    within = factor(model_matrix(data.layout, out.terms, extra=[(block,)]), out.y)
    sums = term_sums(within, "III")
    rows = [term_row(s, 0, within.rss, within.tss) for s in sums]
    bases = {s.term: s for s in term_sums(fixed, "III")}
    df_error, p = {}, {}
    for i, (row, s) in enumerate(zip(rows, sums, strict=True)):
        basis = bases.get(s.term)
        if basis is None or basis.df == 0 or basis.df < basis.nominal_df:
            continue
        if s.df < basis.df:
            # blocks differ in it: its sum of squares is one of theirs
            row = term_row(basis, 0, within.rss, within.tss)
        test = fit.test(basis.basis)
        epsilon, p_own = sandwich.test(basis.basis)
        df_error[row.term], p[s.term] = test.df_error, max(test.p, p_own)
        rows[i] = replace(
            row, df=test.df, f=test.f, p=test.p, error="REML", df_error=test.df_error,
            epsilon_gg=epsilon, p_gg=max(test.p, p_own),
        )  # fmt: skip
    rows.append(Row("residual", within.df_residual, within.rss))
    out = out.warn(*alias_warnings([bases[term] for term in out.terms]))
    gate = gate_of(out, model.of_factors, model.sample, _rivals(out, model, sandwich))
    scatter = f"interactions with {b} levels of {block}"
    if plots is not None:
        scatter = f"{b} levels of {block} and their whole plots ({plots.name})"
    question = (
        f"would the ranking change with another {block}? (mixed model by REML: {scatter} are "
        "random; Kenward and Roger)"
    )
    reason = (
        f"{lacking} of {b} levels of {block} lack a cell; random are "
        f"{', '.join(map(term_name, sources))} and the rest; each interval also reaches as far as "
        f"the scatter of its difference over the levels of {block} tells (CR2)"
    )
    error = ErrorTerm("E1", question, df_error, reason)
    listed = table_of("III", rows, out.y.size, within.tss)
    return replace(
        out.concluded(error, listed, model.estimates(out.terms, p), gate),
        fit=error_ledger.within_fit(data, out.y, plots=None if plots is None else plots.code),
        plots=data.layout.codes[block] if plots is None else plots.code,
    )


def _rivals(out: AnalysisResult, model: MixedCells, sandwich: Sandwich) -> list[Rival]:
    """Rivals where blocks lack cells."""
    rivals = limit_rivals(
        out.request.scale, out.request.alpha, model.sample, block_means(out.data, out.y)
    )
    if reading := reading_error(out):
        rivals.insert(0, rival_of_rounding(model.sample, model.along, reading))
    rivals.append(rival_of_shape(model, sandwich))
    full = every_term(out, out.data.layout)
    mixed = None if full is None else mixed_cells(out, full)
    if mixed is not None:
        whole, of_whole, _ = mixed
        rivals += rivals_of_lack(whole, out.terms, lambda basis: of_whole.test(basis)[1])
    return rivals


def mixed_cells(
    out: AnalysisResult, terms: Sequence[Term]
) -> tuple[MixedCells, Sandwich, list[Term]] | None:
    """Mixed model of terms with one row a cell and block, its sandwich and its random terms.

    Random are the blocks and their interactions with the terms, or the whole plots of the factors
    named. None where no model can be fitted.
    """
    layout, block, shift = out.data.layout, str(out.data.block), float(out.y.mean())
    bare, y = model_matrix(layout, terms), out.y - shift
    fixed, whole_plot = factor(bare, y), out.request.layout.whole_plot
    inner = [whole_plot] if whole_plot else terms
    candidates = [(block,), *((block, *term) for term in inner)]
    codes = {t: np.unique(layout.cell(t), return_inverse=True)[1] for t in candidates}
    # what has a level of its own in every row is the scatter within
    random = [t for t in candidates if int(codes[t].max()) + 1 < y.size]
    while ((len(random) + 1) * fixed.rank) ** 2 > _MOST_PRODUCTS and len(random) > 1:
        random.pop()
    while random and int(codes[random[0]].max()) >= 2:
        try:
            fit = fit_restricted(fixed.q, y, [codes[t] for t in random])
        except SingularError as error:
            if error.which == 0:
                break
            random.pop(min(error.which, len(random) - 1))
            continue
        sandwich = Sandwich(fit, layout.codes[block])
        model = MixedCells(fit, fixed, bare, shift, out.request.confidence, sandwich.errors)
        return model, sandwich, random
    return None
