"""Checks of normality and equal spread: on the residuals, or contrast by contrast over blocks.

Where every effect is tested against its own interaction with the blocks, no residual is pooled
and none may be tested as if it were: the contrasts differ in spread, which looks like heavy
tails. Each contrast is then a sample of its own over the blocks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from study.analysis.assumption.normality import RyanJoinerResult, ryan_joiner
from study.analysis.assumption.row_normality import (
    RowTest,
    block_share,
    helmert_contrasts,
    row_normality,
)
from study.analysis.assumption.variance import (
    BartlettResult,
    LeveneResult,
    ResidualDesign,
    bartlett,
    levene,
)
from study.analysis.data import Crossed
from study.analysis.error import residuals
from study.analysis.linear_model.sums_of_squares import Factored
from study.analysis.linear_model.two_way import TwoWayFit
from study.analysis.outcome import Outcome
from study.arrays import Array, Flags
from study.errors import InputError

_MONTE_CARLO = 10_000
#: Residuals that normality is tested on at most: beyond, a random sample of as many.
MOST_TESTED = 5000
#: Numbers simulated at most for a spread test of many rows; 10,000 designs of 1,000 rows.
_MOST_NUMBERS = 1e7
#: A block that carries more than this share of the interaction, with this p, is named.
SHARE_P = 0.05
_OWN = "each effect is tested against its own interaction with the blocks, whose spreads may differ"


@dataclass(frozen=True)
class Diagnostics:
    """Tests of the assumptions; ``rows`` holds those of single contrasts over blocks."""

    normality: RyanJoinerResult | None
    bartlett: BartlettResult | None
    levene: LeveneResult | None
    warnings: tuple[str, ...]
    rows: tuple[RowTest, ...] = ()


def diagnose(out: Outcome) -> Diagnostics:
    """Check the assumptions that the tests of an analysis rest on.

    Parameters
    ----------
    out : Outcome
        With its fit; cells against blocks in ``crossed`` are tested contrast by contrast.

    Returns
    -------
    Diagnostics
        With the warnings of ``out`` and those added here.
    """
    if out.crossed is not None and out.replicates != "noise":
        return _by_contrast(out, out.crossed)
    out, normality, groups = _of_residuals(out)
    equal, spread = _spread_tests(out, groups)
    warnings = (*out.warnings, *_inapplicable(bartlett=equal, levene=spread))
    return Diagnostics(normality, equal, spread, warnings)


def _by_contrast(out: Outcome, table: Crossed) -> Diagnostics:
    """Test each contrast over the blocks, and find the block that carries most of them."""
    unequal = (
        BartlettResult(None, None, None, False, _OWN),
        LeveneResult(None, None, None, False, _OWN),
    )
    warnings = _inapplicable(bartlett=unequal[0], levene=unequal[1])
    try:
        contrasts = helmert_contrasts(table.layout, out.terms, table.y)
    except InputError:
        why = "normality: not applicable: a combination of levels is missing"
        return Diagnostics(None, *unequal, (*warnings, why))
    tolerance = out.working_tolerance() / 10
    found = row_normality(
        contrasts, tolerance=tolerance, alpha=out.request.alpha, seed=out.request.seed
    )
    if found.p is None:
        return Diagnostics(
            None, *unequal, (*warnings, f"normality: not applicable: {found.warning}")
        )
    if found.warning:
        warnings.append(f"Ryan-Joiner over blocks: {found.warning}")
    warnings += _heavy_block(contrasts, tolerance, table.blocks, out)
    worst = min(found.rows, key=lambda row: row.p)
    values = contrasts[worst.term][worst.contrast]
    one = ryan_joiner(values, seed=out.request.seed, exact=False, alpha=out.request.alpha)
    decision = f"{'rejected' if found.rejected else 'not rejected'} at {out.request.alpha:g}"
    summary = replace(
        one,
        p_exact=found.p,
        decision=f"normality {decision}: the smallest of {len(found.rows)} "
        f"contrasts over {found.blocks} blocks, {worst.term}, p times their number {found.p:.3g}",
    )
    return Diagnostics(summary, *unequal, tuple(warnings), found.rows)


def _heavy_block(
    contrasts: dict[str, Array], tolerance: float, blocks: tuple[str, ...], out: Outcome
) -> list[str]:
    share = block_share(contrasts, tolerance=tolerance, seed=out.request.seed)
    if share is None or share.p >= SHARE_P:
        return []
    return [
        f"{out.data.block} {blocks[share.block]} carries {100 * share.share:.0f} % of the "
        "interactions with the blocks: see what is special about it"
    ]


def is_representative(out: Outcome) -> Flags:
    """Whether each row belongs to the cell that stands for its copies.

    Parameters
    ----------
    out : Outcome
        With its groups of copies.

    Returns
    -------
    ndarray of bool, shape (n,)
        One a row of the data.
    """
    return np.isin(out.data.cell, out.copies.representatives)


def _inapplicable(**tests: BartlettResult | LeveneResult | None) -> list[str]:
    return [
        f"{name}: not applicable: {test.reason}"
        for name, test in tests.items()
        if test is not None and test.reason
    ]


def _spread_tests(
    out: Outcome, groups: residuals.CellGroups | None
) -> tuple[BartlettResult | None, LeveneResult | None]:
    if groups is None:
        return None, None
    # residuals of a blocked fit are correlated: their own design is simulated
    n = groups.index.size
    # of more rows than are tested, the residuals are as good as independent
    near = groups.basis is None or n > MOST_TESTED
    design = None if near or groups.basis is None else ResidualDesign(groups.basis, groups.index)
    count = int(min(_MONTE_CARLO, _MOST_NUMBERS / n)) if out.request.exact else 0
    rough, seed = groups.approximate, out.request.seed
    return (
        bartlett(groups.groups, approximate=rough, simulations=count, seed=seed, design=design),
        levene(
            groups.groups,
            center="auto" if out.request.exact or design else "median",
            approximate=rough,
            simulations=count if design else 0,
            seed=seed,
            design=design,
        ),
    )


def _ryan_joiner(out: Outcome, fit: Factored | TwoWayFit) -> tuple[Outcome, RyanJoinerResult]:
    """Ryan-Joiner of the residuals; of many a random sample, which is said."""
    asked, n = out.request, fit.residual.size
    if n <= MOST_TESTED:
        return out, ryan_joiner(
            fit.residual,
            model_matrix=fit.columns,
            seed=asked.seed,
            exact=asked.exact,
            alpha=asked.alpha,
        )
    # among so many rows a few residuals are as independent as a plain sample
    chosen = np.random.default_rng(asked.seed).choice(n, MOST_TESTED, replace=False)
    sample = fit.residual[np.sort(chosen)]
    result = ryan_joiner(sample, seed=asked.seed, exact=asked.exact, alpha=asked.alpha)
    note = (
        f"Ryan-Joiner tests a random {MOST_TESTED:,} of the {n:,} residuals: with more, departures "
        "from normality that change no conclusion are found as well"
    )
    return out.warn(note), result


def _of_residuals(
    out: Outcome,
) -> tuple[Outcome, RyanJoinerResult | None, residuals.CellGroups | None]:
    """Ryan-Joiner on one representative of each computation, and the groups for Bartlett."""
    rows = np.flatnonzero(is_representative(out))
    if out.fit is None or out.fit.df_residual == 0:
        reason = "there are no residuals"
        return (
            out.warn(f"normality: not applicable: {reason}", f"variance: not applicable: {reason}"),
            None,
            None,
        )
    if out.data.block is not None:
        # of more rows than are tested, nobody asks for the columns of the model
        fit_of = residuals.within_fit if rows.size > MOST_TESTED else residuals.additive_fit
        fit: Factored | TwoWayFit = fit_of(out.data, out.y, rows, plots=out.plots)
    elif rows.size == out.y.size:
        fit = out.fit
    else:
        fit = residuals.reduced_fit(out.data, out.y, out.terms, rows)
    out, result = _ryan_joiner(out, fit)
    if not result.applicable:
        out = out.warn(f"normality: not applicable: {result.reason}")
    if result.warning:
        out = out.warn(result.warning)
    values = out.y[rows] if out.data.block is None else fit.residual
    cells, names = out.data.cell[rows], out.data.cell_names()
    present, index = np.unique(cells, return_inverse=True)
    groups = {names[c]: values[index == i] for i, c in enumerate(present)}
    blocked = out.data.block is not None
    basis = fit.q if blocked and isinstance(fit, Factored) else None
    return out, result, residuals.CellGroups(groups, blocked, basis, index)
