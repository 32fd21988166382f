"""Each effect against its own interaction with the blocks, Greenhouse-Geisser corrected.

For a term with orthonormal contrasts B (cells x df) every block gives one vector B' y; the
mean vector is the effect, the scatter of the vectors over blocks is its error. Nothing is
pooled, so cells that differ only in discretization add no degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from study.analysis.anova_table import Anova, ErrorTerm, Row
from study.analysis.data import Crossed, crossed
from study.analysis.effects.estimates import (
    TermEstimate,
    over_complete_settings,
    own_critical,
    settings_of,
    t_quantile,
    term_rows,
)
from study.analysis.effects.samples import over_blocks
from study.analysis.effects.sizes import size
from study.analysis.error import ledger, residuals
from study.analysis.gate import judge_factors, rivals_over_blocks
from study.analysis.linear_model.design_matrix import Term, model_matrix, term_name
from study.analysis.linear_model.sphericity import SphericityResult, epsilon_gg, sphericity
from study.analysis.linear_model.sums_of_squares import (
    Factored,
    TermSum,
    alias_warnings,
    factor,
    term_sums,
    with_shares,
)
from study.analysis.outcome import Outcome, kind_of
from study.analysis.pseudoreplication import ulp_floor
from study.arrays import Array


def seed_choice(seeds: int) -> ledger.Choice:
    """E3 with seeds that every cell has: each effect against its own interaction with them.

    Parameters
    ----------
    seeds : int
        Meshes of every cell.
    """
    few = (f"{seeds} mesh seeds: ask for 8 or more",) if seeds < ledger.ENOUGH_SEEDS else ()
    return ledger.Choice(
        "E3",
        ledger.OWN,
        "would another mesh of this size change the effect? (each effect against its own "
        f"interaction with {seeds} mesh seeds, Greenhouse-Geisser deciding)",
        "every cell has the same mesh seeds, so they are blocks",
        (ledger.BIAS, *few),
    )


def own_choice(block: str, blocks: int, error: str) -> ledger.Choice:
    """E1 with every effect against its own interaction.

    Parameters
    ----------
    block, blocks : str, int
        Name of the blocks, and how many there are.
    error : str
        How the error was asked for.
    """
    why = "asked for" if error == "own" else "every cell is seen in the same blocks"
    return ledger.Choice(
        "E1",
        ledger.OWN,
        f"would the ranking change with another {block}? (each effect against its own "
        f"interaction with {blocks} levels of {block}, Greenhouse-Geisser deciding)",
        why,
    )


def noise_choice(resamples: int) -> ledger.Choice:
    """E2 where cells fitted to one curve share its resampled noise.

    Parameters
    ----------
    resamples : int
        Refits of every cell.
    """
    return ledger.Choice(
        "E2",
        ledger.OWN,
        f"{ledger.NOISE_QUESTION} (each effect against its own scatter over {resamples} refits to "
        "resampled residuals, Greenhouse-Geisser deciding)",
        "cells hold refits to resampled measurement noise, the same for all cells of a curve",
        (ledger.ONE_CURVE,),
    )


@dataclass(frozen=True)
class OwnTerm:
    """Test of one term against its own interaction with the blocks."""

    sums: TermSum
    row: Row
    error: Row
    sphericity: SphericityResult
    warning: str = ""


def single_noise(table: Crossed) -> Crossed:
    """Let resamples of one curve scatter as their mean does.

    The scatter over refits is the standard error of the fit itself, however many there are
    (Efron and Tibshirani 1993, chapter 6); that of their mean would fall with their number.

    Parameters
    ----------
    table : Crossed
        Cells against b resamples; deviations from the mean of each cell grow by sqrt(b).
    """
    mean = table.y.mean(axis=1, keepdims=True)
    return replace(table, y=mean + np.sqrt(table.y.shape[1]) * (table.y - mean))


def cell_fit(table: Crossed, terms: Sequence[Term]) -> Factored:
    """Fit of the terms to the means of the cells.

    Parameters
    ----------
    table : Crossed
        Cells against blocks.
    terms : sequence of Term
        Terms of the model, without the intercept.

    Returns
    -------
    Factored
        With one row a cell.
    """
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
    """Test every term against its own interaction with the blocks.

    Parameters
    ----------
    table : Crossed
        Cells against b blocks, on the working scale.
    fit : Factored
        Fit of the terms to the means of the cells.
    kind : {"I", "II", "III"}
        Type of the sums of squares.
    block : str
        Name of the blocks in the rows of the errors.
    floor : float
        Differences up to this size are copies: no F.
    total : float
        Corrected total sum of squares of the table.
    partial : bool
        Whether what is left of a term is tested where cells are empty.

    Returns
    -------
    list of OwnTerm
        In the order of the model. A term with df degrees of freedom has df (b - 1) of the error,
        both times epsilon of Greenhouse and Geisser for the p that decides.
    """
    return [
        _own_term(table, fit, s, block, floor, total, partial=partial) for s in term_sums(fit, kind)
    ]


def _own_term(
    table: Crossed,
    fit: Factored,
    sums: TermSum,
    block: str,
    floor: float,
    total: float,
    *,
    partial: bool,
) -> OwnTerm:
    from scipy.special import fdtrc

    name, blocks, df = term_name(sums.term), table.y.shape[1], sums.df
    contrasts = sums.basis.T @ (fit.q.T @ (table.y - table.y[0, 0]))
    center = contrasts.mean(axis=1)
    scatter = contrasts - center[:, None]
    ss, ss_error = blocks * float(center @ center), float(np.sum(scatter**2))
    df_error = df * (blocks - 1)
    error = Row(f"{block}:{name}", df_error, ss_error, ss_error / df_error if df else None)
    if df == 0:
        return OwnTerm(sums, Row(name, 0, 0.0), error, sphericity(np.zeros((1, blocks))))
    spread = sphericity(contrasts)
    if (
        df < sums.nominal_df and not partial
    ):  # what is left is not the effect: an empty cell, or an alias
        return OwnTerm(sums, Row(name, df, ss, ss / df), error, spread)
    why = _no_test(fit.q, sums.basis, contrasts, floor, name, block)
    if why:
        return OwnTerm(sums, Row(name, df, ss, ss / df), error, spread, why)
    f = (ss / df) / (ss_error / df_error)
    epsilon = epsilon_gg(np.atleast_2d(np.cov(contrasts)))
    ms_error = ss_error / df_error
    row = Row(
        name,
        df,
        ss,
        ss / df,
        f,
        float(fdtrc(df, df_error, f)),
        f"{block}:{name}",
        df_error,
        epsilon,
        float(fdtrc(df * epsilon, df_error * epsilon, f)),
        max(0.0, (ss - df * ms_error) / (total + ms_error)),
        ss / (ss + ss_error),
    )
    return OwnTerm(sums, row, error, spread)


def _no_test(q: Array, basis: Array, contrasts: Array, floor: float, name: str, block: str) -> str:
    """Why an effect cannot be tested: it, or its interaction, is below the tolerance."""
    if float(np.abs(q @ (basis @ contrasts)).max()) <= floor:
        return f"{name}: its levels agree within the solver tolerance in every block, no test"
    scatter = contrasts - contrasts.mean(axis=1, keepdims=True)
    if float(np.abs(q @ (basis @ scatter)).max()) <= floor:
        return f"{name}: its effect is the same in every {block} to the solver tolerance, no test"
    return ""


def own_estimate(
    table: Crossed, fit: Factored, term: Term, df: int, p: float | None, alpha: float
) -> TermEstimate:
    """Estimate of a term; each difference carries its own variance over the blocks.

    Parameters
    ----------
    table : Crossed
        Cells against b blocks, on the working scale.
    fit : Factored
        Fit of the terms to the means of the cells.
    term : Term
        One term of the fit.
    df : int
        Its degrees of freedom that can be estimated.
    p : float or None
        Its deciding p, which the estimate carries on.
    alpha : float
        Error probability; simultaneous intervals have the level 1 - alpha together, and those of
        means 1 - alpha each with b - 1 degrees of freedom.
    """
    levels, component_rows, mean_rows = term_rows(table.layout, fit, term)
    component_rows = over_complete_settings(table.layout, fit, term, component_rows)
    blocks = table.y.shape[1]
    shift, beta = block_coefficients(table, fit)
    component, mean = component_rows @ beta, shift + mean_rows @ beta
    estimable = bool(fit.estimable(component_rows).all())
    mean_half = t_quantile(alpha / 2, blocks - 1) * mean.std(axis=1, ddof=1) / np.sqrt(blocks)
    centers = mean.mean(axis=1)
    centers[np.logical_not(fit.estimable(mean_rows))] = np.nan
    return TermEstimate(
        term,
        levels,
        component.mean(axis=1) if estimable else np.full(len(levels), np.nan),
        centers,
        np.atleast_2d(np.cov(component)) / blocks,
        own_critical(len(levels), max(df, 1), blocks, alpha),
        mean_half,
        p,
        settings_of(table.layout, term),
    )


def block_coefficients(table: Crossed, fit: Factored) -> tuple[float, Array]:
    """Shift of the response, and coefficients of every block, shape (p, b).

    Parameters
    ----------
    table : Crossed
        Cells against b blocks.
    fit : Factored
        Fit of p columns to the means of the cells.

    Returns
    -------
    shift : float
        Response of the first cell in the first block.
    coefficients : ndarray, shape (p, b)
        Of the response less this shift.
    """
    shift = float(table.y[0, 0])
    return shift, fit.model.inverse @ (fit.q.T @ (table.y - shift))


def own(out: Outcome) -> Outcome | None:
    """E1: every effect against its own interaction with the blocks.

    E2 where the blocks are resamples of the noise, which all cells have in common.

    Parameters
    ----------
    out : Outcome
        With one block column, y and scale.

    Returns
    -------
    Outcome or None
        With error term, table and effects; None with fewer than two complete blocks or two cells.
    """
    data, block = out.data, str(out.data.block)
    table = crossed(data, out.y)
    if len(table.blocks) < 2 or table.cells.size < 2:
        return None
    out = out.warn(*table.warnings)
    if out.replicates == "noise":
        table = single_noise(table)
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
    choice = own_choice(block, b, out.request.error)
    if out.replicates in ("noise", "mesh-seeds"):
        choice = noise_choice(b) if out.replicates == "noise" else seed_choice(b)
        out = out.warn(*choice.cautions)
    df = {t.row.term: float(t.error.df) for t in tests}
    judged = cell_fit(table, out.structure.asked) if out.structure.asked else fit
    estimates = [
        own_estimate(table, judged, t.sums.term, t.sums.df, t.row.p_deciding, out.request.alpha)
        for t in tests
    ]
    sample = over_blocks(
        judged, block_coefficients(table, judged)[1], out.request.alpha, out.request.interval_seed
    )
    rivals, notes = rivals_over_blocks(out, table.layout, table.y, judged, sample)
    out = out.warn(*notes)
    simple = judge_factors(out, table.layout, judged, sample, rivals)
    return replace(
        out,
        error=ErrorTerm(choice.source, choice.question, df, choice.reason),
        anova=Anova(kind, with_shares(rows, total), table.y.size - 1, total),
        effects=tuple(size(e, out.scale, simple) for e in estimates),
        sphericity={t.row.term: t.sphericity for t in tests if t.sums.df > 1},
        fit=residuals.within_fit(data, out.y),
        crossed=table,
        cell_model=fit.model,
    )
