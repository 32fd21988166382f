"""Factorial analysis of one response: the error term first, then everything else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from study.analysis import checks, error_term
from study.analysis.blocks import cell_fit, crossed, own_estimate, own_terms
from study.analysis.copies import CopyGroups, group_cells, refuse_fake_replicates, ulp_floor
from study.analysis.effects import Scale, TermEstimate, pooled_estimate, size
from study.analysis.matrix import Array, Term, balanced, model_matrix, term_name, terms_of
from study.analysis.nested import average_units, misleading
from study.analysis.outcome import Outcome, assemble
from study.analysis.practical import threshold
from study.analysis.results import AnalysisResult, Anova, ErrorTerm, Row
from study.analysis.sums import Factored, TermSum, factor, term_sums
from study.analysis.threads import one_thread
from study.analysis.tidy import Data, prepare
from study.analysis.unreplicated import LenthResult
from study.errors import Fault, InputError

if TYPE_CHECKING:
    import pandas as pd

_DEFAULT_TOLERANCE = 1e-8


@one_thread
def analyze(
    table: pd.DataFrame,
    response: str,
    factors: Sequence[str],
    *,
    block: str | None = None,
    unit: str | None = None,
    type: str = "auto",  # noqa: A002
    model: Any = "full",
    error: str = "auto",
    records: bool = False,
    tolerance: float | None = None,
    practical: Any = None,
    transform: str = "none",
    u_num: float | Mapping[str, float] | None = None,
    alpha: float = 0.05,
    seed: int = 2011,
    exact: bool = True,
) -> AnalysisResult:
    """Analyze one response of a factorial.

    Parameters
    ----------
    table : DataFrame
        One row a run.
    response : str
        Column of the response; missing values are counted and left out.
    factors : sequence of str
        Columns of the factors.
    block : str, optional
        Column of the replicated unit (specimen, mix, ...).
    unit : str, optional
        Column of the unit on which rows are repeated: its rows are averaged first, and a
        warning says how far the analysis of single rows would have misled.
    type : {"auto", "I", "II", "III"}
        Type of the sums of squares; ``auto`` is II when balanced and III when not.
    model : "full", int or list
        Terms; see :func:`study.analysis.matrix.terms_of`.
    error : {"auto", "pooled", "own"}
        How the error is found; see :mod:`study.analysis.error_term`.
    records : bool
        Whether the rows are records of a deterministic study.
    tolerance : float, optional
        Solver tolerance in the unit of the response; default 1e-8 of its largest value for
        records, 0 otherwise.
    practical : optional
        Smallest difference that matters; see :func:`study.analysis.practical.threshold`.
    transform : {"none", "log"}
        ``log`` reports effects as ratios.
    u_num : float or mapping to float, optional
        Numerical uncertainty in the unit of the response (the largest of a mapping).
    exact : bool
        Whether to simulate the exact Ryan-Joiner p.

    Raises
    ------
    InputError
        For columns, levels or values that cannot be analyzed.
    RefusedError
        For copies that pose as replicates.
    """
    _check_options(type, transform, alpha)
    if unit is not None:
        means = average_units(table, response, factors, unit, block=block, transform=transform)
        options: dict[str, Any] = {
            "block": block,
            "type": type,
            "model": model,
            "error": error,
            "tolerance": tolerance,
            "practical": practical,
            "transform": transform,
            "u_num": u_num,
            "alpha": alpha,
            "seed": seed,
        }
        nested = analyze(means, response, factors, records=records, exact=exact, **options)
        naive = analyze(table, response, factors, exact=False, **options)
        return replace(nested, warnings=(*nested.warnings, *misleading(nested, naive, unit)))
    data = prepare(table, response, factors, block)
    terms = terms_of(data.factors, model)
    limit = threshold(practical)
    u_raw = _largest(u_num)
    tol = _DEFAULT_TOLERANCE * float(np.abs(data.y).max()) if tolerance is None else tolerance
    tol = tol if records or tolerance is not None else 0.0
    out = Outcome(data, response, terms, transform, alpha, seed, exact, tol, u_raw, records)
    if float(np.ptp(data.y)) <= max(10 * tol, 4 * ulp_floor(data.y)):
        return assemble(out.constant())
    notes = refuse_fake_replicates(data, table, records=records, tolerance=tol)
    y = _transformed(data, response, transform)
    scale = _scale(y, data, transform, limit, u_raw, records)
    out = replace(out, y=y, scale=scale, warnings=(*data.warnings, *notes))
    out = replace(out, copies=_copies(out))
    copied = len(out.copies.groups) < sum(len(group) for group in out.copies.groups)
    how = error_term.method(error, block, records, copies=copied)
    if how == error_term.OWN:
        own = _own(out, type, error)
        if own is not None:
            return assemble(own)
        out = out.warn(f"fewer than two complete levels of {block}: no test against blocks")
    return assemble(_pooled(out, type, error, model))


def _check_options(kind: str, transform: str, alpha: float) -> None:
    faults = []
    if kind not in ("auto", "I", "II", "III"):
        faults.append(Fault("type", f"must be auto, I, II or III, got {kind!r}"))
    if transform not in ("none", "log"):
        faults.append(Fault("transform", f"must be none or log, got {transform!r}"))
    if not 0 < alpha < 1:
        faults.append(Fault("alpha", f"must be between 0 and 1, got {alpha!r}"))
    if faults:
        raise InputError(faults)


def _largest(u_num: float | Mapping[str, float] | None) -> float | None:
    if isinstance(u_num, Mapping):
        known = [float(v) for v in u_num.values() if v is not None and np.isfinite(v)]
        return max(known, default=None)
    return None if u_num is None else float(u_num)


def _transformed(data: Data, response: str, transform: str) -> Array:
    if transform == "none":
        return data.y
    if data.y.min() <= 0:
        raise InputError(
            Fault(f"response {response!r}", f"the log needs positive values, got {data.y.min():g}")
        )
    return np.asarray(np.log(data.y))


def _scale(
    y: Array, data: Data, transform: str, limit: Any, u_raw: float | None, records: bool
) -> Scale:
    mean = float(np.exp(y.mean())) if transform == "log" else float(y.mean())
    practical = None if limit is None else limit.on_scale(mean, transform)
    u = u_raw
    if u_raw is not None and transform == "log":
        u = u_raw / mean
    return Scale(transform, practical, u, u_raw, records and data.block is None)


def _copies(out: Outcome) -> CopyGroups:
    """Cells that are one computation, judged on the raw response."""
    data = out.data
    cells = np.unique(data.cell)
    blocks = 1 if data.block is None else len(data.layout.levels[data.block])
    within = max(10 * out.tolerance, out.u_raw or 0.0, ulp_floor(data.y))
    # values of a CSV may tie by chance; equality in three or more blocks is no chance
    if not (out.records or out.tolerance > 0) and (data.block is None or blocks < 3):
        return CopyGroups(tuple((int(c),) for c in cells))
    table = np.full((cells.size, blocks), np.nan)
    at = np.searchsorted(cells, data.cell)
    column = 0 if data.block is None else data.layout.codes[data.block]
    table[at, column] = data.y
    found = group_cells(table, within)
    return CopyGroups(tuple(tuple(int(cells[i]) for i in g) for g in found.groups))


def _kind(out: Outcome, kind: str, even: bool) -> tuple[str, Outcome]:
    """Type of the sums; unbalanced data take Type III with sum contrasts, and say so."""
    if even:
        return ("II" if kind == "auto" else kind), out
    if kind == "auto" or (out.records and kind == "II"):
        return "III", out.warn("unbalanced: Type III with sum-to-zero contrasts")
    return kind, out.warn(f"unbalanced: Type {kind} as asked")


def _own(out: Outcome, kind: str, error: str) -> Outcome | None:
    """E1: every effect against its own interaction with the blocks."""
    data, block = out.data, str(out.data.block)
    table = crossed(data, out.y)
    if len(table.blocks) < 2 or table.cells.size < 2:
        return None
    out = out.warn(*table.warnings)
    full = int(np.prod([len(data.layout.levels[f]) for f in data.factors]))
    kind, out = _kind(out, kind, table.cells.size == full)
    fit = cell_fit(table, out.terms)
    total = float(np.sum((table.y - table.y.mean()) ** 2))
    floor = max(out.working_tolerance(), ulp_floor(table.y))
    tests = own_terms(table, fit, kind, block, floor, total)
    out = out.warn(*(t.warning for t in tests if t.warning))
    out = out.warn(*_alias_warnings([t.sums for t in tests]))
    n_cells, b = table.y.shape
    ss_block = n_cells * float(np.sum((table.y.mean(axis=0) - table.y.mean()) ** 2))
    rows = [t.row for t in tests] + [Row(block, b - 1, ss_block, ss_block / (b - 1))]
    rows += [t.error for t in tests]
    rest = n_cells - 1 - sum(t.sums.df for t in tests)
    if rest > 0:
        out = out.warn(f"{rest} treatment degrees of freedom are outside the model")
    choice = error_term.own_choice(block, b, error)
    df = {t.row.term: float(t.error.df) for t in tests}
    estimates = [
        own_estimate(table, fit, t.sums.term, t.sums.df, t.row.p_deciding, out.alpha) for t in tests
    ]
    return replace(
        out,
        error=ErrorTerm(choice.source, choice.question, df, choice.reason),
        anova=Anova(kind, _with_shares(rows, total)),
        effects=tuple(size(e, out.scale) for e in estimates),
        sphericity={t.row.term: t.sphericity for t in tests if t.sums.df > 1},
        fit=checks.additive_fit(data, out.y),
        crossed=table,
    )


def _pooled(out: Outcome, kind: str, error: str, model: Any) -> Outcome:
    """One residual for all terms: E0, E1 pooled, E5; or none: E6, E7."""
    data = out.data
    extra: list[Term] = [(data.block,)] if data.block else []
    matrix = model_matrix(data.layout, out.terms, extra=extra)
    fit = factor(matrix, out.y)
    names = [*data.factors, *([data.block] if data.block else [])]
    kind, out = _kind(out, kind, balanced(data.layout, names))
    sums = term_sums(fit, kind)
    out = out.warn(*_alias_warnings(sums))
    counts = np.bincount(data.cell)
    single = bool(counts.max() == 1)
    # copies are no separate contrasts: Lenth's limits would not hold
    copied = len(out.copies.groups) < np.unique(data.cell).size
    complete = single and not copied and balanced(data.layout, data.factors)
    situation = error_term.Situation(
        out.records,
        data.block,
        not single,
        fit.df_residual,
        model == "full",
        int(np.sum([s.df for s in sums])),
        complete,
    )
    choice = error_term.choose(situation, error)
    df = fit.df_residual if choice.how == error_term.POOLED else 0
    if df == 0:
        out = out.warn(error_term.REMEDIES)
    lenth = checks.lenth_of(out.data, out.y, out.terms, out.seed) if choice.source == "E6" else None
    rows = [_row(s, fit, df) for s in sums]
    if lenth is not None:
        rows = [_lenth_row(row, lenth) for row in rows]
    ms = fit.rss / df if df else None
    rows.append(Row("residual", fit.df_residual, fit.rss if df else 0.0, ms))
    by_name = {row.term: row for row in rows}
    estimates: list[TermEstimate] = [
        pooled_estimate(data.layout, fit, t, df, by_name[term_name(t)].p, out.alpha)
        for t in out.terms
    ]
    return replace(
        out,
        error=ErrorTerm(choice.source, choice.question, float(df), choice.reason),
        anova=Anova(kind, _with_shares(rows, fit.tss)),
        effects=tuple(size(e, out.scale) for e in estimates),
        fit=fit if df else None,
        lenth=lenth,
    )


def _row(s: TermSum, fit: Factored, df: int) -> Row:
    from scipy.special import fdtrc

    name = term_name(s.term)
    if s.df == 0:
        return Row(name, 0, 0.0)
    ms = s.ss / s.df
    # a residual made of rounding alone is no error term
    if df == 0 or fit.rss <= 1e-28 * max(fit.tss, s.ss):
        return Row(name, s.df, s.ss, ms)
    mse = fit.rss / df
    if s.df < s.nominal_df:
        return Row(name, s.df, s.ss, ms, error="residual", df_error=df)
    f = ms / mse
    return Row(
        name,
        s.df,
        s.ss,
        ms,
        f,
        float(fdtrc(s.df, df, f)),
        "residual",
        df,
        None,
        None,
        max(0.0, (s.ss - s.df * mse) / (fit.tss + mse)),
        s.ss / (s.ss + fit.rss),
    )


def _lenth_row(row: Row, lenth: LenthResult) -> Row:
    if row.term not in lenth.names:
        return row
    return replace(row, p=lenth.p[lenth.names.index(row.term)], error="Lenth PSE")


def _with_shares(rows: Sequence[Row], total: float) -> tuple[Row, ...]:
    done = []
    for row in rows:
        share = row.ss / total if total > 0 else None
        done.append(replace(row, share=share, partial_eta_sq_ci95=checks.eta_interval(row)))
    return tuple(done)


def _alias_warnings(sums: Sequence[TermSum]) -> list[str]:
    out = []
    for s in sums:
        if s.df < s.nominal_df:
            partly = f" (aliased with {', '.join(s.aliases)})" if s.aliases else ""
            out.append(
                f"{term_name(s.term)}: {s.nominal_df - s.df} of {s.nominal_df} degrees of "
                f"freedom are not estimable{partly}: empty cells or a confounded design; no test"
            )
    return out
