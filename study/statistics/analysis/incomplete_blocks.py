"""E1 where blocks lack cells: a mixed model whose claims each difference's own scatter confirms.

The factors' interactions with the blocks are random (REML, Kenward and Roger), so an effect is
never tested against less than how it differs between blocks. Such a model gives one variance to
all differences of a term. Where one level scatters more than the others that is too little for
it, so every interval reaches as far as that of the sandwich estimate over the blocks, too (CR2
with Satterthwaite's degrees of freedom: Bell and McCaffrey 2002, Survey Methodology 28, 169;
Pustejovsky and Tipton 2018, J. Bus. Econ. Statist. 36, 672), which is the interval of paired
differences where blocks are complete.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from study.ground.arrays import Array
from study.statistics.analysis import error_ledger
from study.statistics.analysis.analysis_request import AnalysisRequest
from study.statistics.analysis.analysis_result import AnalysisResult
from study.statistics.analysis.anova_table import Anova, ErrorTerm
from study.statistics.analysis.data import blocks_that_lack_cells
from study.statistics.analysis.gate import (
    Rival,
    block_means,
    every_term,
    judge_factors,
    limit_rivals,
    reading_error,
)
from study.statistics.analysis.linear_model import CellLayout, Term, model_matrix, term_name
from study.statistics.analysis.mixed_model import (
    MixedCells,
    rival_of_rounding,
    rival_of_shape,
    rivals_of_lack,
)
from study.statistics.analysis.restricted_likelihood import Sandwich, SingularError, fit_restricted
from study.statistics.analysis.strata import Plots
from study.statistics.analysis.sums_of_squares import (
    alias_warnings,
    factor,
    term_row,
    term_sums,
    with_shares,
)

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
    mixed = mixed_cells(data.layout, out.terms, block, out.y, out.request)
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
        test = fit.test(basis.basis)
        epsilon, p_own = sandwich.test(basis.basis)
        df_error[row.term], p[s.term] = test.df_error, max(test.p, p_own)
        rows[i] = replace(
            row, df=test.df, f=test.f, p=test.p, error="REML", df_error=test.df_error,
            epsilon_gg=epsilon, p_gg=max(test.p, p_own),
        )  # fmt: skip
    rows.append(replace(rows[0], term="residual", df=within.df_residual, ss=within.rss, ms=None))
    out = out.warn(*alias_warnings([bases[term] for term in out.terms]))
    rivals, notes = _rivals(out, model, sandwich)
    out = out.warn(*notes)
    simple = judge_factors(out, data.layout, model.of_factors, model.sample, rivals)
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
    return replace(
        out,
        error_term=ErrorTerm("E1", question, df_error, reason),
        anova=Anova("III", with_shares(rows, within.tss), out.y.size - 1, within.tss),
        effects=model.effects(out.terms, p, out.scale, simple),
        fit=error_ledger.within_fit(data, out.y, plots=None if plots is None else plots.code),
        plots=data.layout.codes[block] if plots is None else plots.code,
    )


def _rivals(
    out: AnalysisResult, model: MixedCells, sandwich: Sandwich
) -> tuple[list[Rival], list[str]]:
    """Rivals where blocks lack cells, and what was seen of the declared model."""
    rivals = limit_rivals(
        out.request.scale, out.request.alpha, model.sample, block_means(out.data, out.y)
    )
    notes: list[str] = []
    if reading := reading_error(out):
        rivals.insert(0, rival_of_rounding(model, reading))
    rivals.append(rival_of_shape(model, sandwich))
    full = every_term(out, out.data.layout)
    if full is None:
        return rivals, notes
    mixed = mixed_cells(out.data.layout, full, str(out.data.block), out.y, out.request)
    if mixed is None:
        return rivals, notes
    whole, of_whole, _ = mixed
    lack, notes = rivals_of_lack(whole, out.terms, lambda basis: of_whole.test(basis)[1])
    return rivals + lack, notes


def mixed_cells(
    layout: CellLayout, terms: Sequence[Term], block: str, y: Array, request: AnalysisRequest
) -> tuple[MixedCells, Sandwich, list[Term]] | None:
    """Mixed model of one row of y (n,) a cell and block, its sandwich and its random terms.

    Random are the blocks and their interactions with the terms, or the whole plots of the factors
    named. None where no model can be fitted.
    """
    bare = model_matrix(layout, terms)
    shift = float(y.mean())
    fixed = factor(bare, y - shift)
    inner = [request.layout.whole_plot] if request.layout.whole_plot else terms
    candidates = [(block,), *((block, *term) for term in inner)]
    codes = {t: np.unique(layout.cell(t), return_inverse=True)[1] for t in candidates}
    # what has a level of its own in every row is the scatter within
    random = [t for t in candidates if int(codes[t].max()) + 1 < y.size]
    while ((len(random) + 1) * fixed.rank) ** 2 > _MOST_PRODUCTS and len(random) > 1:
        random.pop()
    while random and int(codes[random[0]].max()) >= 2:
        try:
            fit = fit_restricted(fixed.q, y - shift, [codes[t] for t in random])
        except SingularError as error:
            if error.which == 0:
                break
            random.pop(min(error.which, len(random) - 1))
            continue
        sandwich = Sandwich(fit, fixed, y - shift, layout.codes[block])
        alpha, seed = request.alpha, request.interval_seed
        model = MixedCells(fit, fixed, bare, layout, shift, alpha, seed, sandwich.errors)
        return model, sandwich, random
    return None
