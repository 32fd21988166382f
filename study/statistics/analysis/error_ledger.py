"""The error-term ledger: which source of error is the best available, and what its p answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from study.ground.arrays import Array, Ints
from study.ground.errors import Fault, InputError
from study.statistics.analysis import unreplicated
from study.statistics.analysis.analysis_request import AnalysisRequest
from study.statistics.analysis.analysis_result import AnalysisResult, kind_of
from study.statistics.analysis.anova_table import ErrorTerm, Row
from study.statistics.analysis.data import Data
from study.statistics.analysis.effects import (
    Gate,
    TermEstimate,
    cell_welch,
    pooled_estimate,
    refusal,
    sampled_estimate,
    with_pooled_error,
    with_pseudo_error,
)
from study.statistics.analysis.equal_variance import own_variances, welch_tests
from study.statistics.analysis.gate import (
    LEAST_CONTRASTS,
    gate_of,
    rivals_of_contrasts,
    rivals_of_rows,
)
from study.statistics.analysis.linear_model import (
    CellLayout,
    Term,
    balanced,
    factorize,
    model_matrix,
    nested_in,
    term_name,
    terms_of,
)
from study.statistics.analysis.mixed_model import rivals_beside_crossing_blocks
from study.statistics.analysis.simple_effects import CANNOT_TELL, SimpleEffects
from study.statistics.analysis.sums_of_squares import (
    Factored,
    TermSum,
    TwoWayFit,
    alias_warnings,
    factor,
    table_of,
    term_row,
    term_sums,
    two_way,
)
from study.statistics.analysis.unreplicated import LenthResult

_REPEAT = (
    "no residual degrees of freedom, so no F: replicate runs that are set up anew (E0), score "
    "every cell on several measured specimens as blocks (E1), repeat with mesh seeds or "
    "resampled noise (E3, E2)"
)
REMEDIES = _REPEAT + ", or declare before looking which terms are negligible (E5: {})"
NOISE_QUESTION = "is the effect larger than the noise in the measured data alone would give?"
ONE_CURVE = "one measured curve stands behind all resamples: nothing is said of specimens"

# Below five seeds the scatter of the mesh is not known well enough.
_SEEDS = 5
#: Seeds as blocks find an effect of .6 of the scatter in .93 of studies with 8, in .61 with 5.
ENOUGH_SEEDS = 8
BIAS = "the bias of this mesh size is common to all seeds: read the effect over U"


def best_source(
    out: AnalysisResult, fit: Factored, sums: Sequence[TermSum]
) -> tuple[ErrorTerm, tuple[str, ...]]:
    """Best available error where none is an own interaction, and what to beware of."""
    records, df = out.request.records, float(fit.df_residual)
    if df > 0 and out.data.block is not None:
        why = "asked for" if out.request.error == "pooled" else "independently run trials"
        why = "asked for instead of own interactions" if records else why
        caution = (
            "pooled error on a study's cells: those that differ only in discretization add "
            "degrees of freedom and no variance, so p is far too small (use --error own)"
        )
        blocks = " and ".join(out.data.blocks)
        question = f"would the ranking change with another {blocks}? (interactions with {blocks} "
        return ErrorTerm("E1", f"{question}pooled)", df, why), (caution,) if records else ()
    if df > 0 and int(np.bincount(out.data.cell).max()) > 1:
        return _replicates(out, df)
    contrasts = sum(s.df for s in sums if s.term[0] not in out.data.blocks)
    if records and out.u_num is not None and out.request.model == "full":
        question = (
            "no p: is the effect resolved by the discretization? (effect over numerical "
            "uncertainty: resolved from 3, marginal from 1)"
        )
        reason = "no replicates and no blocks; the numerical uncertainty is known"
        return ErrorTerm("E4", question, 0.0, reason), ()
    if df > 0:
        question = "is the effect larger than the interactions declared negligible?"
        reason = "assumption: the interactions left out of the model are zero"
        return ErrorTerm("E5", question, df, reason), ()
    if _sparse_ready(out, fit) and contrasts >= LEAST_CONTRASTS:
        question = "is the effect an outlier among the effects (effect sparsity)?"
        blocks = " and ".join(out.data.blocks)
        ending = f"; interactions with {blocks} are taken as none" if blocks else " and no blocks"
        reason = f"no replicates{ending}; Lenth's method on {contrasts} contrasts"
        return ErrorTerm("E6", question, df, reason), ()
    question = "no p: shares of variation and effects against the practical threshold"
    reason = "no replicates, no blocks and nothing declared negligible"
    return ErrorTerm("E7", question, df, reason), ()


def _replicates(
    out: AnalysisResult, df: float | dict[str, float]
) -> tuple[ErrorTerm, tuple[str, ...]]:
    """Error of the rows within cells, and what to beware of."""
    largest, cautions = int(np.bincount(out.data.cell).max()), []
    source, rows = "E0", "replicates"
    question = "is the effect larger than the run-to-run scatter within a cell?"
    if out.replicates == "mesh-seeds":
        source, rows = "E3", "repeats with other mesh seeds"
        question = "is the effect larger than the mesh noise at this mesh size?"
        cautions = [BIAS]
        if largest < _SEEDS:
            cautions.append(
                f"{largest} mesh seeds a cell: the scatter of the mesh needs {_SEEDS} or "
                "more to be known"
            )
    elif out.replicates == "noise":
        source, rows = "E2", "refits to resampled measurement noise"
        question, cautions = NOISE_QUESTION, [ONE_CURVE]
    full = out.request.model == "full"
    extra = "" if full else "; interactions left out of the model are pooled with it"
    return ErrorTerm(source, question, df, f"cells hold {rows}{extra}"), tuple(cautions)


def pooled(out: AnalysisResult, untested: str = "") -> AnalysisResult:
    """E0, E1 pooled, E2, E3, E5 with one residual; or E4, E6, E7 without."""
    data = out.data
    extra: list[Term] = [(name,) for name in data.blocks]
    matrix = model_matrix(data.layout, out.terms, extra=extra)
    fit = factor(matrix, out.y)
    even = balanced(data.layout, [*data.factors, *data.blocks]) or fit.is_orthogonal()
    if out.request.sums == "auto" and nested_in(out.terms):
        # a factor given what is nested in it is nothing, so Type III would be empty
        kind, out = "II", out if even else out.warn("unbalanced and nested: Type II")
    else:
        is_full = data.blocks and balanced(data.layout, data.factors)
        adjusted = "incomplete blocks, effects are adjusted for the blocks"
        kind, out = kind_of(out, even, adjusted if is_full else "unbalanced")
    sums = term_sums(fit, kind)
    partial = kind == "I" and out.structure.empty_cells > 0
    out = _undecided_beside_blocks(out.warn(*alias_warnings(sums, partial=partial)), fit)
    if sums and all(s.df == 0 for s in sums):
        out = out.warn("every term is aliased with others: name those wanted, model = 1 say")
    error, cautions = best_source(out, fit, sums)
    if untested:
        error = replace(error, reason=untested)
    if untested and len(data.factors) > 1:
        # with one factor the residual is its own interaction with the blocks
        source = "E7" if error.source == "E6" else error.source
        question = "no p: sizes of effects alone"
        error, cautions = replace(error, source=source, df=0.0, question=question), ()
    df = fit.df_residual if error.df else 0
    if untested or (df == 0 and (out.request.records or out.scale.specimens != 1)):
        out = out.warn(untested or _remedies(out))
    out = out.warn(*cautions)
    ready = error.source in ("E4", "E6") and _sparse_ready(out, fit)
    lenth = unreplicated.lenth_of(data, out.y, out.terms, out.request.seed) if ready else None
    error_rss = fit.rss * _resamples(out)
    rows = [term_row(s, df, error_rss, fit.tss, partial=partial) for s in sums]
    if lenth is not None and error.source == "E6":
        p_of = dict(zip(lenth.names, lenth.p, strict=True))
        rows = [replace(row, p=p_of[row.term], error="Lenth PSE") if row.term in p_of else row
                for row in rows]  # fmt: skip
    ms = error_rss / df if df else None
    left = fit.rss if fit.df_residual and (df or untested) else 0.0
    rows.append(Row("residual", fit.df_residual, left, ms))
    by_name = {row.term: row for row in rows}
    # what the runs do not tell apart is left out of the sums, not of what can be estimated
    declared = out.structure.asked
    judged = factor(model_matrix(data.layout, declared, extra=extra), out.y) if declared else fit

    alpha = out.request.alpha

    def estimated(term: Term) -> TermEstimate:
        p = by_name[term_name(term)].p
        estimate = pooled_estimate(judged, term, df, p, alpha, error_rss)
        if judged is not fit and np.isnan(estimate.component).any():
            return pooled_estimate(fit, term, df, p, alpha, error_rss)
        return estimate

    estimates = [estimated(term) for term in out.terms]
    sample = with_pooled_error(judged, error_rss, df, out.request.confidence)
    gate, simple = gate_of(out, judged, sample), {}
    two_levels = all(len(data.layout.levels[f]) == 2 for f in data.factors)
    if lenth is not None and error.source == "E6" and two_levels and not out.request.records:
        estimates, gate = _by_pseudo_error(out, (judged, fit), estimates, lenth)
        simple = gate.judged(out.terms)
    elif df or out.scale.deterministic:
        rivals = [refusal(untested)] if untested else []
        rivals += rivals_of_rows(out, judged, error_rss, df, sample) if df else []
        rivals += rivals_beside_crossing_blocks(out, judged)
        gate = replace(gate, rivals=(*gate.rivals, *rivals))
        simple = gate.judged(out.terms)
    unjudged = _unjudged(out, has_error=bool(simple))
    gate = replace(gate, undecided=next((e.why for e in unjudged.values()), gate.undecided))
    simple |= unjudged
    table = table_of(kind, rows, out.y.size, fit.tss)
    out = out.concluded(error, table, estimates, gate, simple)
    if untested and df == 0:
        effects = (replace(e, why=untested) if e.is_main else e for e in out.effects)
        out = replace(out, effects=tuple(effects))
    judged_fit = fit if df else None
    return replace(out, fit=judged_fit, model=judged_fit, lenth=lenth)


def _remedies(out: AnalysisResult) -> str:
    """Name what gives an error to test against; of one factor no term is negligible."""
    if len(out.data.factors) == 1:
        return _REPEAT
    order = largest_order(out.data, out.request.lower_order, spare=1)
    option = "model = " if out.request.records else "--model "
    return REMEDIES.format(f"{option}{order}" if order else "name the terms of the model")


def _undecided_beside_blocks(out: AnalysisResult, fit: Factored) -> AnalysisResult:
    """Outcome that claims nothing where blocks change with an interaction of the model."""
    if not out.data.blocks or fit.is_full or out.structure.undecided or not out.request.is_ordered:
        return out
    reason = undecided(out.data, out.request)
    return replace(out, structure=replace(out.structure, undecided=reason))


def undecided(data: Data, request: AnalysisRequest) -> str:
    """Why factors are not judged whose terms the runs cannot tell from others."""
    return (
        "these runs cannot tell effects from interactions that may be there; declare which are "
        f"negligible ({smaller_model(data, request)})"
    )


def smaller_model(data: Data, request: AnalysisRequest) -> str:
    """Words that declare a model whose terms the runs tell apart."""
    order = largest_order(data, request.lower_order)
    return f"--model {order}, or the terms" if order else "--model with the terms"


def largest_order(data: Data, most: int, spare: int = 0) -> int:
    """Highest order of interactions, up to ``most``, whose terms the runs tell apart.

    ``spare`` residual degrees of freedom are left; 0 where no order does.
    """
    cells = data.layout.take(
        np.unique(data.layout.cell([*data.factors, *data.blocks]), return_index=True)[1]
    )
    blocks: list[Term] = [(name,) for name in data.blocks]
    for order in range(most, 0, -1):
        model = factorize(model_matrix(cells, terms_of(data.factors, order), extra=blocks))
        if model.is_full and model.df_residual >= spare:
            return order
    return 0


def welch(out: AnalysisResult) -> AnalysisResult:
    """E0 with a variance of its own in each cell: Welch's tests, Games and Howell's intervals."""
    data = out.data
    _, cell, counts = np.unique(data.cell, return_inverse=True, return_counts=True)
    if counts.min() < 2:
        rule = f"needs two rows or more in every cell, and {(counts < 2).sum()} cells hold one"
        raise InputError(Fault("--welch", rule, "leave it out, or add rows"))
    if out.replicates == "noise":
        rule = "takes the rows of a cell as independent, and resamples of one curve are not"
        raise InputError(Fault("--welch", rule, "leave it out"))
    fit = factor(model_matrix(data.layout, out.terms), out.y)
    sums = term_sums(fit, "III")
    error, cautions = _replicates(out, {})
    out = out.warn(*alias_warnings(sums), *cautions)
    tests = welch_tests(data, out.y, out.terms)
    rows = []
    for s in sums:
        row, test = term_row(s, 0, fit.rss, fit.tss), tests[term_name(s.term)]
        if test is not None:
            row = replace(row, f=test.f, p=test.p, error="cells", df_error=test.df_error)
        rows.append(row)
    rows.append(Row("residual", fit.df_residual, fit.rss))
    variances = own_variances(out.y, cell)
    sample = cell_welch(fit, cell, variances, out.request.alpha, 0.0, cautious=False)
    rivals = rivals_of_rows(out, fit, fit.rss, fit.df_residual, sample)
    gate = gate_of(out, fit, sample, rivals)
    p = {row.term: row.p for row in rows}
    estimates = [sampled_estimate(fit, term, p[term_name(term)], sample) for term in out.terms]
    reason = (
        "as asked for: every cell has a variance of its own (Welch, Johansen 1980; intervals of "
        "one factor by Games and Howell)"
    )
    df = {row.term: row.df_error for row in rows if row.df_error is not None}
    error, table = replace(error, df=df, reason=reason), table_of("III", rows, out.y.size, fit.tss)
    return replace(out.concluded(error, table, estimates, gate), fit=fit, model=fit)


def _resamples(out: AnalysisResult) -> float:
    """Factor of the residual sum: the scatter of refits to noise is the error of the cell itself.

    An F of their means would grow with their number (Efron and Tibshirani 1993, chapter 6).
    """
    counts = np.bincount(out.data.cell)
    return 1.0 if out.replicates != "noise" else float(1 / np.mean(1 / counts[counts > 0]))


def _sparse_ready(out: AnalysisResult, fit: Factored) -> bool:
    """One row in every cell of the full grid or of a saturated model, no copies."""
    data = out.data
    # copies are no separate contrasts: Lenth's limits would not hold
    copied = len(out.copies) < np.unique(data.cell).size
    if copied or int(np.bincount(data.cell).max()) > 1:
        return False
    return fit.df_residual == 0 or (not data.blocks and balanced(data.layout, data.factors))


def _unjudged(out: AnalysisResult, *, has_error: bool) -> dict[str, SimpleEffects]:
    """Factors that are not judged, with the reason and what would mend it.

    All are where no run is repeated, and those within which others lie: their levels are the
    replicates, and not the rows.
    """
    if out.request.records:
        return {}
    why = {
        outer: f"{inner} lies within it, and the rows do not tell how other levels of {inner} "
        f"would differ: --unit {inner} judges by its levels"
        for inner, parents in nested_in(out.terms).items()
        for outer in parents
    }
    if not has_error:
        order = largest_order(out.data, out.request.lower_order, spare=1)
        declare = f", or declare which interactions are negligible (--model {order})"
        text = "there is no error to judge the effect against: repeat runs"
        why = dict.fromkeys(out.data.factors, text + (declare if order else "")) | why
    return {name: SimpleEffects(CANNOT_TELL, text, ()) for name, text in why.items()}


def _by_pseudo_error(
    out: AnalysisResult,
    fits: tuple[Factored, Factored],
    estimates: Sequence[TermEstimate],
    lenth: LenthResult,
) -> tuple[list[TermEstimate], Gate]:
    """Give estimates of two-level factors Lenth's margins, and the gate of claims by them.

    ``fits``: of all requested terms, and of the terms that the runs can separate.
    """
    confidence = out.request.confidence
    _, contrasts, is_orthogonal = unreplicated.saturated_contrasts(out.data, out.terms)
    samples = [with_pseudo_error(fit, contrasts, confidence, out.y) for fit in fits]
    rivals = rivals_of_contrasts(out, fits[0], contrasts)
    gate = gate_of(out, fits[0], samples[0], rivals)
    if is_orthogonal:
        return [_with_margin(e, lenth) for e in estimates], gate
    margin, wide = lenth.sme / max(lenth.pse, 1e-300), []
    for e in estimates:
        each = zip(fits, samples, strict=True)
        halves = (sampled_estimate(fit, e.term, e.p, of, margin).half for fit, of in each)
        wide.append(replace(e, half=next((half for half in halves if half is not None), None)))
    return wide, gate


def _with_margin(estimate: TermEstimate, lenth: LenthResult) -> TermEstimate:
    """Estimate whose difference carries Lenth's simultaneous margin, where it is one contrast.

    In a two-level design a term is one contrast, and its components are plus or minus half the
    effect; contrasts of other designs are in another scale, and get no interval.
    """
    size = np.abs(estimate.component)
    is_contrast = term_name(estimate.term) in lenth.names and size.min() > 0
    if not is_contrast or float(np.ptp(size)) > 1e-9 * float(size.max()):
        return estimate
    side = np.sign(estimate.component) / 2
    return replace(estimate, half=lenth.sme * np.abs(np.subtract.outer(side, side)))


# -------------------------------------------------------------------------------------------------
# Fits whose residuals are judged: cells and blocks, or the terms of a reduced model.


def additive_fit(
    data: Data, y: Array, rows: Ints | None = None, *, plots: Ints | None = None
) -> Factored:
    """Fit of cells plus blocks (or whole plots) to some of the rows of y (n,)."""
    keep = np.arange(y.size) if rows is None else rows
    blocks = {f"block {i}": code for i, code in enumerate(_blocks(data, plots))}
    levels, codes = {}, {}
    for name, code in {"cell": data.cell, **blocks}.items():
        present, codes[name] = np.unique(code[keep], return_inverse=True)
        levels[name] = tuple(map(str, present))
    varying: list[Term] = [(name,) for name, its_levels in levels.items() if len(its_levels) > 1]
    cells, extra = [t for t in varying if t == ("cell",)], [t for t in varying if t != ("cell",)]
    return factor(model_matrix(CellLayout(levels, codes), cells, extra=extra), y[keep])


def within_fit(
    data: Data, y: Array, rows: Ints | None = None, *, plots: Ints | None = None
) -> Factored | TwoWayFit:
    """Fit as :func:`additive_fit`, without the columns of the model where two factors serve."""
    blocks = _blocks(data, plots)
    if len(blocks) > 1:
        return additive_fit(data, y, rows, plots=plots)
    keep = np.arange(y.size) if rows is None else rows
    cell, block = (np.unique(code[keep], return_inverse=True)[1] for code in (data.cell, blocks[0]))
    return two_way(cell.astype(np.int64), block.astype(np.int64), y[keep])


def _blocks(data: Data, plots: Ints | None) -> list[Ints]:
    return [data.layout.codes[name] for name in data.blocks] if plots is None else [plots]
