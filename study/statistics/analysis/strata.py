"""Repeated measures on groups of blocks: own interactions where some factors vary between blocks.

A block (specimen) belongs to one group (its mix, say) and is scored in every cell of the other
factors. An effect within blocks, and its interaction with the groups, is tested against its own
interaction with the blocks of a group; an effect between blocks against the blocks themselves.
Each group has a covariance of its own (Welch-Box) from three blocks a group on; with two, one
covariance serves all groups.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from study.ground.arrays import Array, Ints
from study.ground.errors import Fault, InputError, nearest
from study.statistics.analysis import error_ledger
from study.statistics.analysis.analysis_request import AnalysisOutcome, AnalysisRequest, kind_of
from study.statistics.analysis.anova_table import (
    Anova,
    Effect,
    ErrorTerm,
    NaiveTerm,
    NestedUnits,
    Row,
)
from study.statistics.analysis.data import Crossed, crossed, prepare
from study.statistics.analysis.effects import (
    TermEstimate,
    over_groups,
    own_critical,
    pooled_estimate,
    sampled_estimate,
    size,
    t_quantile,
    with_pooled_error,
)
from study.statistics.analysis.gate import (
    every_term,
    judge_factors,
    per_block,
    refusal,
    rival_of_every_term,
    rivals_over_blocks,
    rivals_over_groups,
)
from study.statistics.analysis.linear_model import (
    CellLayout,
    Term,
    complement,
    model_matrix,
    term_name,
    terms_of,
)
from study.statistics.analysis.split_plot import Plots
from study.statistics.analysis.sums_of_squares import (
    LEAST_OWN,
    Factored,
    SphericityResult,
    TermSum,
    alias_warnings,
    epsilon_gg,
    factor,
    row_of_test,
    sphericity,
    term_sums,
    welch_box,
    with_shares,
)
from study.statistics.analysis.unreplicated import ulp_floor

if TYPE_CHECKING:
    import pandas as pd


_COVARIANCES = "every group of blocks has a covariance of its own (Welch-Box)"
_ONE_COVARIANCE = "a group has two blocks only, so one covariance serves all groups"


@dataclass(frozen=True)
class _Part:
    """One within-block term: its contrasts in every block and their error."""

    name: str
    values: Array
    residual: Array
    df: int


def own_groups(out: AnalysisOutcome, plots: Plots) -> AnalysisOutcome | None:
    """E1 with own interactions, blocks nested in groups; None where groups have no replicates."""
    block = str(out.data.block)
    within = tuple(f for f in out.data.factors if f not in plots.between)
    table, groups = _table(out, within, plots)
    between = model_matrix(groups, terms_of(plots.between))
    fit = factor(between, np.arange(float(groups.n)))
    if fit.df_residual < 1:
        return None
    code = groups.cell(plots.between)
    members = [np.flatnonzero(code == g) for g in np.unique(code)]
    kind, out = kind_of(out, len({len(m) for m in members}) == 1)
    out = out.warn(*table.warnings)
    shifted = table.y - table.y[0, 0]
    total = float(np.sum((shifted - shifted.mean()) ** 2))
    floor = max(out.working_tolerance(), ulp_floor(table.y))
    apart = members if min(len(m) for m in members) >= LEAST_OWN else []
    rows: dict[Term, Row] = {}
    errors, spheres = [], {}
    for part_term, part in _parts(out, table, within, block, fit).items():
        if part.values.shape[0] > 1:
            spheres[term_name(part_term)] = _sphere(part, fit)
        ss = float(np.sum(part.residual**2))
        errors.append(Row(part.name, part.df, ss, ss / part.df))
        for group_term, direction in _directions(fit, kind, part_term):
            term = tuple(f for f in out.data.factors if f in (*part_term, *group_term))
            if term in out.terms:
                rows[term] = _row(term, part, direction, apart, total, floor)
    effects, notes = _effects(out, rows, errors, table, members)
    out = out.warn(*notes)
    listed = [rows[t] for t in out.terms if t in rows]
    df = {r.term: float(r.df_error or 0) for r in listed}
    error = error_ledger.error_of_strata(block, plots.name, plots.between, "own interactions", df)
    covariances = _COVARIANCES if apart else _ONE_COVARIANCE
    reason = "asked for" if out.request.error == "own" else f"{error.reason}; {covariances}"
    error = replace(error, reason=reason)
    return replace(
        out,
        error=error,
        anova=Anova(kind, with_shares([*listed, *errors], total), out.y.size - 1, total),
        effects=effects,
        sphericity=spheres,
        fit=error_ledger.within_fit(out.data, out.y, plots=plots.code),
        plots=plots.code,
    )


def _table(
    out: AnalysisOutcome, within: tuple[str, ...], plots: Plots
) -> tuple[Crossed, CellLayout]:
    """Cells of the factors within blocks against blocks, and the group of each block kept."""
    data = out.data
    block = str(data.block)
    table = crossed(replace(data, factors=within), out.y)
    index = {name: i for i, name in enumerate(data.layout.levels[block])}
    blocks = [index[name] for name in table.blocks]
    first = np.array([int(np.flatnonzero(data.layout.codes[block] == k)[0]) for k in blocks])
    codes = {f: data.layout.codes[f][first] for f in plots.between}
    return table, CellLayout({f: data.layout.levels[f] for f in plots.between}, codes)


def _parts(
    out: AnalysisOutcome, table: Crossed, within: tuple[str, ...], block: str, fit: Factored
) -> dict[Term, _Part]:
    cells = table.y.shape[0]
    bases: dict[Term, Array] = {(): np.ones((cells, 1)) / np.sqrt(cells)}
    terms = dict.fromkeys(tuple(f for f in t if f in within) for t in out.terms)
    inner = [t for t in terms if t]
    if inner:
        cell_model = factor(model_matrix(table.layout, inner), table.y.mean(axis=1))
        for s in term_sums(cell_model, "III"):
            bases[s.term] = cell_model.q @ s.basis
    parts = {}
    for term, basis in bases.items():
        values = basis.T @ (table.y - table.y[0, 0])
        residual = values - (values @ fit.q) @ fit.q.T
        name = f"{block}:{term_name(term)}" if term else block
        parts[term] = _Part(name, values, residual, values.shape[0] * fit.df_residual)
    return parts


def _directions(fit: Factored, kind: str, part: Term) -> list[tuple[Term, Array]]:
    """Orthonormal directions over blocks of the mean and of every term between blocks."""
    directions: list[tuple[Term, Array]] = []
    if part:
        n = fit.q.shape[0]
        mean = np.ones((n, 1)) / np.sqrt(n)
        if kind == "III":
            mean = fit.q @ complement(fit.r[:, 1:], fit.r[:, :1])
        directions.append(((), mean))
    return directions + [(s.term, fit.q @ s.basis) for s in term_sums(fit, kind)]


def _row(
    term: Term,
    part: _Part,
    direction: Array,
    groups: Sequence[Ints],
    total: float,
    floor: float,
) -> Row:
    effect = part.values @ direction
    df, ss = effect.size, float(np.sum(effect**2))
    ss_error = float(np.sum(part.residual**2))
    name = term_name(term)
    if df == 0:
        return Row(name, 0, 0.0)
    if float(np.abs(part.residual).max(initial=0.0)) <= floor:
        return Row(name, df, ss, ss / df)
    sums = (df, ss), (part.name, part.df, ss_error)
    if groups:
        weights = np.array([direction[group].sum(axis=0) for group in groups]).T
        test = welch_box([part.values[:, group] for group in groups], weights)
        if test is not None:
            f, df1, df2 = test
            epsilon = df1 / df
            return row_of_test(name, *sums, total, epsilon, (f, df2 / epsilon))
    return row_of_test(name, *sums, total, epsilon_gg(part.residual @ part.residual.T))


def _sphere(part: _Part, fit: Factored) -> SphericityResult:
    """Sphericity of the residual contrasts: as many free columns as residual df, plus one."""
    left, s, _ = np.linalg.svd(part.residual, full_matrices=False)
    free = fit.df_residual
    scores = (left * s)[:, :free]
    # as deviations of free + 1 columns, which is what the test of one group expects
    helmert = np.linalg.qr(np.column_stack([np.ones(free + 1), np.eye(free + 1, free, -1)]))[0]
    return sphericity(scores @ helmert[:, 1 : scores.shape[1] + 1].T)


_LONE_BLOCK = "a group has one block: nothing tells how another one of that group would differ"


def _effects(
    out: AnalysisOutcome,
    rows: dict[Term, Row],
    errors: list[Row],
    table: Crossed,
    groups: Sequence[Ints],
) -> tuple[tuple[Effect, ...], list[str]]:
    """Effects and verdicts with variances of their own in each group, and what was seen besides.

    Where a group has two blocks, sizes have the pooled error of their stratum.
    """
    data, request = out.data, out.request
    index = {name: i for i, name in enumerate(table.blocks)}
    names = data.layout.levels[str(data.block)]
    of_row = np.array([index.get(names[c], -1) for c in data.layout.codes[str(data.block)]])
    complete = of_row >= 0
    layout = CellLayout(data.layout.levels, {f: c[complete] for f, c in data.layout.codes.items()})
    fewest = min(len(group) for group in groups)
    seed = request.interval_seed if fewest >= LEAST_OWN else None

    def fitted(terms: Sequence[Term]) -> tuple[Factored, Array]:
        fit = factor(model_matrix(layout, terms), out.y[complete])
        per_row = (fit.inverse @ fit.q.T) * (out.y[complete] - fit.shift)
        return fit, per_row @ np.eye(len(table.blocks))[of_row[complete]]

    fit, added = fitted(out.terms)
    sample = over_groups(fit, added, groups, request.alpha, seed)
    notes: list[str] = []
    if fewest < 2:  # one block tells no scatter
        rivals = [refusal(_LONE_BLOCK)]
        sample = with_pooled_error(fit, fit.rss, fit.df_residual, request.alpha, seed)
    else:
        rivals = rivals_over_groups(out, fit, added, groups, sample, table.y)
        if (full := every_term(out, layout)) is not None:
            whole, parts = fitted(full)
            more, notes = rival_of_every_term(
                out, whole, lambda alpha: over_groups(whole, parts, groups, alpha, seed)
            )
            rivals += more
    simple = judge_factors(out, layout, fit, sample, rivals)
    if fewest >= LEAST_OWN:
        own_errors = over_groups(fit, added, groups, request.alpha, None)
        p = {term: row.p_deciding for term, row in rows.items()}
        estimates = [sampled_estimate(data.layout, fit, t, p.get(t), own_errors) for t in out.terms]
    else:
        estimates = _pooled_estimates(out, rows, errors)
    return tuple(size(estimate, out.scale, simple) for estimate in estimates), notes


def _pooled_estimates(
    out: AnalysisOutcome, rows: dict[Term, Row], errors: list[Row]
) -> list[TermEstimate]:
    """Estimates with the pooled error of their stratum."""
    whole = factor(model_matrix(out.data.layout, out.terms), out.y)
    by_error = {row.term: row for row in errors}
    estimates = []
    for term in out.terms:
        row = rows.get(term, Row(term_name(term), 0, 0.0))
        against = by_error.get(row.error or "")
        df = 0.0 if against is None else against.df * (row.epsilon_gg or 1.0)
        rss = 0.0 if against is None else (against.ms or 0.0) * df
        estimate = pooled_estimate(
            out.data.layout, whole, term, df, row.p_deciding, out.request.alpha, rss
        )
        estimates.append(replace(estimate, mean_half=None))
    return estimates


# -------------------------------------------------------------------------------------------------
# Each effect against its own interaction with the blocks, Greenhouse-Geisser corrected.
#
# For a term with orthonormal contrasts B (cells x df) every block gives one vector B' y; the
# mean vector is the effect, the scatter of the vectors over blocks is its error. Nothing is
# pooled, so cells that differ only in discretization add no degrees of freedom.


def _own_error(
    out: AnalysisOutcome, blocks: int, df: dict[str, float]
) -> tuple[ErrorTerm, tuple[str, ...]]:
    """Error of effects against their own interaction with the blocks, and what to beware of."""
    decides = "Greenhouse-Geisser deciding)"
    if out.replicates == "noise":
        question = (
            f"{error_ledger.NOISE_QUESTION} (each effect against its own scatter over {blocks} "
            f"refits to resampled residuals, {decides}"
        )
        why = "cells hold refits to resampled measurement noise, the same for all cells of a curve"
        return ErrorTerm("E2", question, df, why), (error_ledger.ONE_CURVE,)
    against = "(each effect against its own interaction with"
    if out.replicates == "mesh-seeds":
        question = (
            f"would another mesh of this size change the effect? {against} {blocks} mesh seeds, "
            f"{decides}"
        )
        few = blocks < error_ledger.ENOUGH_SEEDS
        cautions = (f"{blocks} mesh seeds: ask for 8 or more",) if few else ()
        why = "every cell has the same mesh seeds, so they are blocks"
        return ErrorTerm("E3", question, df, why), (error_ledger.BIAS, *cautions)
    block = str(out.data.block)
    question = (
        f"would the ranking change with another {block}? {against} {blocks} levels of {block}, "
        f"{decides}"
    )
    why = "asked for" if out.request.error == "own" else "every cell is seen in the same blocks"
    return ErrorTerm("E1", question, df, why), ()


@dataclass(frozen=True)
class OwnTerm:
    """Test of one term against its own interaction with the blocks."""

    sums: TermSum
    row: Row
    error: Row
    sphericity: SphericityResult
    warning: str = ""


def cell_fit(table: Crossed, terms: Sequence[Term]) -> Factored:
    """Fit of the terms to the means of the cells."""
    return factor(model_matrix(table.layout, terms), table.y.mean(axis=1))


def own_terms(
    table: Crossed,
    fit: Factored,
    kind: str,
    block: str,
    floor: float,
    total: float,
    *,
    partial: bool = False,
) -> list[OwnTerm]:
    """Test every term against its own interaction with the blocks."""
    blocks, within = table.y.shape[1], fit.q.T @ (table.y - table.y[0, 0])

    def tested(sums: TermSum) -> OwnTerm:
        name, df, df_error = term_name(sums.term), sums.df, sums.df * (blocks - 1)
        contrasts = sums.basis.T @ within
        center = contrasts.mean(axis=1)
        ss = blocks * float(center @ center)
        ss_error = float(np.sum((contrasts - center[:, None]) ** 2))
        error = Row(f"{block}:{name}", df_error, ss_error, ss_error / df_error if df else None)
        if df == 0:
            return OwnTerm(sums, Row(name, 0, 0.0), error, sphericity(np.zeros((1, blocks))))
        row, spread = Row(name, df, ss, ss / df), sphericity(contrasts)
        if df < sums.nominal_df and not partial:
            # what is left is not the effect: an empty cell, or an alias
            return OwnTerm(sums, row, error, spread)
        if why := _no_test(fit.q, sums.basis, contrasts, floor, name, block):
            return OwnTerm(sums, row, error, spread, why)
        epsilon = epsilon_gg(np.atleast_2d(np.cov(contrasts)))
        row = row_of_test(name, (df, ss), (error.term, df_error, ss_error), total, epsilon)
        return OwnTerm(sums, row, error, spread)

    return [tested(sums) for sums in term_sums(fit, kind)]


def _no_test(q: Array, basis: Array, contrasts: Array, floor: float, name: str, block: str) -> str:
    """Why an effect cannot be tested: it, or its interaction, is below the tolerance."""
    if float(np.abs(q @ (basis @ contrasts)).max()) <= floor:
        return f"{name}: its levels agree within the solver tolerance in every block, no test"
    scatter = contrasts - contrasts.mean(axis=1, keepdims=True)
    if float(np.abs(q @ (basis @ scatter)).max()) <= floor:
        return f"{name}: its effect is the same in every {block} to the solver tolerance, no test"
    return ""


def own(out: AnalysisOutcome) -> AnalysisOutcome | None:
    """E1: every effect against its own interaction with the blocks.

    E2 where the blocks are resamples of the noise, which all cells have in common.
    """
    data, block = out.data, str(out.data.block)
    table = crossed(data, out.y)
    if len(table.blocks) < 2 or table.cells.size < 2:
        return None
    out = out.warn(*table.warnings)
    if out.replicates == "noise":
        # the scatter over refits is the standard error of the fit itself, however many there are
        # (Efron and Tibshirani 1993, chapter 6); that of their mean would fall with their number
        mean = table.y.mean(axis=1, keepdims=True)
        table = replace(table, y=mean + np.sqrt(table.y.shape[1]) * (table.y - mean))
    full = int(np.prod([len(table.layout.levels[f]) for f in data.factors]))
    fewer = table.cells.size < np.unique(data.cell).size
    empty = full - table.cells.size if fewer or out.structure.empty_cells else 0
    out = replace(out, structure=replace(out.structure, empty_cells=empty))
    kind, out = kind_of(out, table.cells.size == full)
    partial = kind == "I" and empty > 0
    fit = cell_fit(table, out.terms)
    # differences from one value are exact where doubles are close
    shifted = table.y - table.y[0, 0]
    total = float(np.sum((shifted - shifted.mean()) ** 2))
    floor = max(out.working_tolerance(), ulp_floor(table.y))
    tests = own_terms(table, fit, kind, block, floor, total, partial=partial)
    out = out.warn(*(t.warning for t in tests if t.warning))
    out = out.warn(*alias_warnings([t.sums for t in tests], partial=partial))
    n_cells, b = table.y.shape
    ss_block = n_cells * float(np.sum((shifted.mean(axis=0) - shifted.mean()) ** 2))
    rows = [t.row for t in tests] + [Row(block, b - 1, ss_block, ss_block / (b - 1))]
    rows += [t.error for t in tests]
    rest = n_cells - 1 - sum(t.sums.df for t in tests)
    if rest > 0:
        out = out.warn(f"{rest} treatment degrees of freedom are outside the model")
    error, cautions = _own_error(out, b, {t.row.term: float(t.error.df) for t in tests})
    out = out.warn(*cautions)
    judged = cell_fit(table, out.structure.asked) if out.structure.asked else fit
    alpha = out.request.alpha
    added, blocks = per_block(judged, table.y), [np.arange(b)]
    own_errors = over_groups(judged, added, blocks, alpha, None)
    estimates = []
    for t in tests:
        levels = int(np.prod([len(table.layout.levels[name]) for name in t.sums.term]))
        critical = own_critical(levels, max(t.sums.df, 1), b, alpha)
        p = t.row.p_deciding
        estimates.append(
            sampled_estimate(table.layout, judged, t.sums.term, p, own_errors, critical)
        )
    sample = over_groups(judged, added, blocks, alpha, out.request.interval_seed)
    rivals, notes = rivals_over_blocks(out, table.layout, table.y, judged, sample)
    out = out.warn(*notes)
    simple = judge_factors(out, table.layout, judged, sample, rivals)
    return replace(
        out,
        error=error,
        anova=Anova(kind, with_shares(rows, total), table.y.size - 1, total),
        effects=tuple(size(e, out.scale, simple) for e in estimates),
        sphericity={t.row.term: t.sphericity for t in tests if t.sums.df > 1},
        fit=error_ledger.within_fit(data, out.y),
        crossed=table,
        cell_model=fit,
    )


# -------------------------------------------------------------------------------------------------
# Repeats on one unit (specimen) are nested in it: average them, and say what that changes.


def average_units(
    table: pd.DataFrame, request: AnalysisRequest, unit: str, block: Sequence[str] = ()
) -> pd.DataFrame:
    """Average the rows of each unit within its cell (geometrically for a log response)."""
    import pandas as pd

    response, factors = request.response, request.factors
    names = [str(c) for c in table.columns]
    if unit not in names:
        raise InputError(Fault(f"unit {unit!r}", "no such column", nearest(unit, names)))
    if unit in (response, *block, *factors):
        raise InputError(Fault("unit", f"{unit!r} is already the response, block or a factor"))
    data = prepare(table, response, factors, block)
    keys = [*factors, *block]
    y = data.y
    if request.scale.is_log:
        if y.min() <= 0:
            raise InputError(Fault(f"response {response!r}", "the log needs positive values"))
        y = np.log(y)
    frame = pd.DataFrame({name: table[name].to_numpy() for name in [*keys, unit]})
    shift = float(y[0])
    frame[response] = np.nan
    frame.loc[data.rows, response] = y - shift
    # a unit without any response stays, so that it is counted among the missing
    means = frame.groupby([*keys, unit], sort=False, observed=True)[response].mean() + shift
    out = means.reset_index()
    if request.scale.is_log:
        out[response] = np.exp(out[response])
    return out


def crosses(table: pd.DataFrame, request: AnalysisRequest, unit: str) -> bool:
    """Whether the same unit is measured in several cells, so that it is a block of them.

    Labels that start again in every cell name other units there; they are told from one unit in
    several cells by a factor of which every label has one level only.
    """
    if unit not in table.columns or unit in (request.response, *request.factors):
        return False
    levels = table.groupby(unit, observed=True)[list(request.factors)].nunique()
    return bool((levels == 1).all(axis=0).any() and (levels > 1).all(axis=0).any())


def compare_naive(
    table: pd.DataFrame, request: AnalysisRequest, unit: str, nested: Anova, naive: Anova
) -> NestedUnits | None:
    """Compare the table of unit means with that of all rows; None without repeats."""
    data = prepare(table, request.response, request.factors, request.layout.block)
    y = np.log(data.y) if request.scale.is_log else data.y
    cell = data.layout.cell([*data.factors, *data.blocks])
    labels = np.unique(table[unit].astype(str).to_numpy()[data.rows], return_inverse=True)[1]
    units = np.unique(np.column_stack([cell, labels]), axis=0, return_inverse=True)[1]
    cells = np.unique(cell, return_inverse=True)[1]
    size = np.bincount(units)
    df_unit, df_row = size.size - int(cells.max()) - 1, y.size - size.size
    if df_unit < 1 or df_row < 1:
        return None
    shifted = y - y[0]
    of_unit = (np.bincount(units, shifted) / size)[units]
    of_cell = (np.bincount(cells, shifted) / np.bincount(cells))[cells]
    ms_unit = float(np.sum((of_unit - of_cell) ** 2)) / df_unit
    ms_row = float(np.sum((shifted - of_unit) ** 2)) / df_row
    # mean number of repeats in the expected mean square (Searle 1971, section 9.7 for balance)
    m = float(y.size / size.size)
    between = max(0.0, (ms_unit - ms_row) / m)
    total = between + ms_row
    correlation = between / total if total > 0 else 0.0
    naive_ms = (df_unit * ms_unit + df_row * ms_row) / (df_unit + df_row)
    wider = t_quantile(0.025, df_unit) / t_quantile(0.025, df_unit + df_row)
    terms = _terms(nested, naive)
    df_term = int(terms[0].df[0]) if terms else 1
    return NestedUnits(
        unit,
        int(y.size),
        int(size.size),
        correlation,
        y.size / (1 + (m - 1) * correlation),
        wider * float(np.sqrt(ms_unit / naive_ms)) if naive_ms > 0 else 1.0,
        _naive_size(
            1 + (m - 1) * correlation, 1 - correlation, df_term, df_unit, df_row, request.seed
        ),
        terms,
    )


def _naive_size(
    unit: float, row: float, df_term: int, df_unit: int, df_row: int, seed: int
) -> float:
    """How often the naive 5 % test rejects a true null, by 200,000 simulated mean squares."""
    from scipy.special import fdtri

    rng = np.random.default_rng(seed)
    count = 200_000
    top = unit * rng.chisquare(df_term, count) / df_term
    rest = unit * rng.chisquare(df_unit, count) + row * rng.chisquare(df_row, count)
    cut = float(fdtri(df_term, df_unit + df_row, 0.95))
    return float(np.mean(top > cut * rest / (df_unit + df_row)))


def _terms(nested: Anova, naive: Anova) -> tuple[NaiveTerm, ...]:
    terms = []
    for row in nested.rows:
        if row.f is None or row.df_error is None or row.p is None:
            continue
        other = naive.row(row.term)
        if other.f is None or other.df_error is None or other.p is None:
            continue
        terms.append(
            NaiveTerm(
                row.term,
                row.f,
                (row.df, row.df_error),
                row.p,
                other.f,
                (other.df, other.df_error),
                other.p,
            )
        )
    return tuple(terms)


def sentences(nested: NestedUnits, alpha: float) -> list[str]:
    """Sentences that say how far the analysis of all rows would have misled."""
    unit = nested.unit
    out = [
        f"{nested.rows} rows are averaged into {nested.units} levels of {unit} within the cells: "
        f"repeats on one {unit} are nested in it",
        f"two rows on one {unit} correlate by {nested.correlation:.2f}: {nested.rows} rows tell as "
        f"much as {nested.effective_rows:.0f} independent ones; taking them as independent would "
        f"give intervals {nested.too_narrow:.2g} times too narrow and reject a true null in "
        f"{100 * nested.naive_size:.0f} % of studies instead of 5 %",
    ]
    for t in nested.terms:
        changed = " (the conclusion changes)" if (t.p < alpha) != (t.naive_p < alpha) else ""
        out.append(
            f"{t.term}: F({t.df[0]:g}, {t.df[1]:g}) = {t.f:.4g}; taking the rows as independent "
            f"would have given F({t.naive_df[0]:g}, {t.naive_df[1]:g}) = {t.naive_f:.4g}{changed}"
        )
    return out


# -------------------------------------------------------------------------------------------------
# Mesh seeds as blocks: whether the seeds of a study are common to all of its cells.
#
# A seed that every cell shares is a block: the effect is tested against its own interaction with
# the seeds, and the question is whether another mesh of this size would change it. Seeds that
# differ between cells are replicates within cells.


def common_seeds(cells: Sequence[Hashable], seeds: Sequence[object]) -> tuple[tuple[str, ...], str]:
    """Seeds that every cell has and that are therefore blocks, and why; none where few are common.

    Examples
    --------
    >>> common_seeds(["a", "a", "b", "b"], [1, 2, 1, 2])[0]
    ('1', '2')
    >>> common_seeds(["a", "a", "b", "b"], [1, 2, 3, 4])[0]
    ()
    """
    if not cells or len(cells) != len(seeds):
        rule = f"one seed for each of {len(cells)} rows is needed, got {len(seeds)}"
        raise InputError(Fault("seeds", rule))
    of_cell: dict[Hashable, set[str]] = {}
    for cell, seed in zip(cells, seeds, strict=True):
        of_cell.setdefault(cell, set()).add(str(seed))
    labels = tuple(dict.fromkeys(str(seed) for seed in seeds))
    common = tuple(s for s in labels if all(s in present for present in of_cell.values()))
    if len(common) < 2 or 2 * len(common) < len(labels):
        return (), "mesh seeds differ between cells: replicates, pooled within cells"
    why = f"the {len(common)} mesh seeds are common to all cells, so they are blocks"
    left = [s for s in labels if s not in common]
    missing = f"; missing in some cell and left out everywhere: {', '.join(left)}" if left else ""
    return common, why + missing
