"""One residual for all terms: replicates, pooled blocks, declared negligible; or no error."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from study.analysis import checks, error_term
from study.analysis.effects import TermEstimate, pooled_estimate, size
from study.analysis.matrix import Term, balanced, model_matrix, nested_in, term_name
from study.analysis.outcome import Outcome
from study.analysis.results import Anova, ErrorTerm, Row
from study.analysis.rows import (
    alias_warnings,
    kind_of,
    orthogonal,
    summary_of,
    term_row,
    with_shares,
)
from study.analysis.sums import Factored, TermSum, factor, term_sums
from study.analysis.unreplicated import LenthResult


def pooled(out: Outcome, kind: str, error: str, model: Any) -> Outcome:
    """E0, E1 pooled, E2, E3, E5 with one residual; or E4, E6, E7 without."""
    data = out.data
    extra: list[Term] = [(name,) for name in data.blocks]
    matrix = model_matrix(data.layout, out.terms, extra=extra)
    fit = factor(matrix, out.y)
    even = balanced(data.layout, [*data.factors, *data.blocks]) or orthogonal(fit)
    if kind == "auto" and nested_in(out.terms):
        # a factor given what is nested in it is nothing, so Type III would be empty
        kind, out = "II", out if even else out.warn("unbalanced and nested: Type II")
    else:
        kind, out = kind_of(out, kind, even, _why_uneven(out))
    sums = term_sums(fit, kind)
    out = out.warn(*alias_warnings(sums))
    if sums and all(s.df == 0 for s in sums):
        out = out.warn("every term is aliased with others: name those wanted, model = 1 say")
    choice = error_term.choose(_situation(out, fit, sums, model), error)
    df = fit.df_residual if choice.how == error_term.POOLED else 0
    if df == 0:
        out = out.warn(error_term.REMEDIES)
    out = out.warn(*choice.cautions)
    ready = choice.source in ("E4", "E6") and _sparse_ready(out, fit)
    lenth = checks.lenth_of(data, out.y, out.terms, out.seed) if ready else None
    error_rss = fit.rss * _resamples(out)
    rows = [term_row(s, df, error_rss, fit.tss) for s in sums]
    if lenth is not None and choice.source == "E6":
        rows = [_lenth_row(row, lenth) for row in rows]
    ms = error_rss / df if df else None
    rows.append(Row("residual", fit.df_residual, fit.rss if df else 0.0, ms))
    by_name = {row.term: row for row in rows}
    estimates: list[TermEstimate] = [
        pooled_estimate(data.layout, fit, t, df, by_name[term_name(t)].p, out.alpha, error_rss)
        for t in out.terms
    ]
    two_levels = all(len(data.layout.levels[f]) == 2 for f in data.factors)
    if lenth is not None and choice.source == "E6" and two_levels and not out.records:
        estimates = [_with_margin(e, lenth) for e in estimates]
    return replace(
        out,
        error=ErrorTerm(choice.source, choice.question, float(df), choice.reason),
        anova=Anova(kind, with_shares(rows, fit.tss), out.y.size - 1, fit.tss),
        effects=tuple(size(e, out.scale) for e in estimates),
        fit=fit if df else None,
        lenth=lenth,
        summary=summary_of(fit) if df else None,
    )


def _resamples(out: Outcome) -> float:
    """Factor of the residual sum: resamples of one curve do not average its noise.

    The scatter over refits is the standard error of the cell itself, however many there are
    (Efron and Tibshirani 1993, chapter 6); an F of their means would grow with their number.
    """
    if out.replicates != "noise":
        return 1.0
    counts = np.bincount(out.data.cell)
    return float(1 / np.mean(1 / counts[counts > 0]))


def _why_uneven(out: Outcome) -> str:
    if not out.data.blocks:
        return "unbalanced"
    if balanced(out.data.layout, out.data.factors):
        return "incomplete blocks, effects are adjusted for the blocks"
    return "unbalanced"


def _sparse_ready(out: Outcome, fit: Factored) -> bool:
    """One row in every cell of the full grid or of a saturated orthogonal fraction, no copies."""
    data = out.data
    # copies are no separate contrasts: Lenth's limits would not hold
    copied = len(out.copies.groups) < np.unique(data.cell).size
    if copied or int(np.bincount(data.cell).max()) > 1:
        return False
    return balanced(data.layout, data.factors) or (fit.df_residual == 0 and orthogonal(fit))


def _situation(
    out: Outcome, fit: Factored, sums: list[TermSum], model: Any
) -> error_term.Situation:
    return error_term.Situation(
        out.records,
        " and ".join(out.data.blocks) or None,
        bool(np.bincount(out.data.cell).max() > 1),
        fit.df_residual,
        model == "full",
        int(np.sum([s.df for s in sums])),
        _sparse_ready(out, fit),
        out.replicates,
        int(np.bincount(out.data.cell).max()),
        out.u_raw is not None,
    )


def _with_margin(estimate: TermEstimate, lenth: LenthResult) -> TermEstimate:
    """Estimate whose difference carries Lenth's simultaneous margin, where it is one contrast.

    In a two-level design a term is one contrast, and its components are plus or minus half the
    effect; contrasts of other designs are in another scale, and get no interval.
    """
    size = np.abs(estimate.component)
    one = term_name(estimate.term) in lenth.names and size.min() > 0
    if not one or float(np.ptp(size)) > 1e-9 * float(size.max()):
        return estimate
    half = np.sign(estimate.component) / 2
    return replace(estimate, covariance=np.outer(half, half), critical=lenth.sme)


def _lenth_row(row: Row, lenth: LenthResult) -> Row:
    if row.term not in lenth.names:
        return row
    return replace(row, p=lenth.p[lenth.names.index(row.term)], error="Lenth PSE")
