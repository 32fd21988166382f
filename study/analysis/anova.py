"""Factorial analysis of one response: the error term first, then everything else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from study.analysis import nested
from study.analysis.anova_table import Effect
from study.analysis.assumption import missing_cases
from study.analysis.assumption.robustness import add_robustness
from study.analysis.data import Data, Options, prepare
from study.analysis.effects.numerical_bound import NumericalBound
from study.analysis.error import ledger
from study.analysis.error.block_groups import own_groups
from study.analysis.error.blocked import own
from study.analysis.error.ledger import pooled
from study.analysis.error.split_plot import Plots, split_plot, whole_plots
from study.analysis.linear_model.design_matrix import nested_in, number_within, terms_of
from study.analysis.linear_model.sums_of_squares import one_thread
from study.analysis.outcome import Outcome, range_of_bounds, scale_of
from study.analysis.pseudoreplication import (
    CopyGroups,
    group_cells,
    refuse_fake_replicates,
    ulp_floor,
)
from study.analysis.result import AnalysisResult, assemble
from study.arrays import Array
from study.errors import Fault, InputError, RefusedError
from study.tidy_csv import names_of

if TYPE_CHECKING:
    import pandas as pd

_DEFAULT_TOLERANCE = 1e-8

# columns of a study's table that say what the repeats of a cell are
_SEED_COLUMNS = {"mesh_seed": "mesh-seeds", "noise_seed": "noise"}


@one_thread
def analyze(
    table: pd.DataFrame,
    response: str,
    factors: Sequence[str],
    *,
    block: str | Sequence[str] | None = None,
    unit: str | None = None,
    whole_plot: str | Sequence[str] = (),
    replicates: str = "auto",
    type: str = "auto",  # noqa: A002
    model: Any = "full",
    error: str = "auto",
    records: bool = False,
    tolerance: float | None = None,
    practical: Any = None,
    transform: str = "none",
    u_num: float | Mapping[str, float] | NumericalBound | None = None,
    specimens: int | None = None,
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
        Column of the response; missing values are counted and left out, and what they could
        do to the conclusion is bounded.
    factors : sequence of str
        Columns of the factors.
    block : str or sequence of str, optional
        Column of the replicated unit (specimen, mix, ...); several that cross make a Latin
        square. Where a factor is constant within every block, the blocks are its whole plots.
    unit : str, optional
        Column of the unit on which rows are repeated: its rows are averaged first, and the
        result says how far the analysis of single rows would have misled.
    whole_plot : str or sequence of str
        Factors set once per whole plot of a block: they are tested against whole plots.
    replicates : {"auto", "runs", "mesh-seeds", "noise"}
        What the rows of one cell are: runs set up anew (E0), new meshes (E3), refits to
        resampled measurement noise (E2). ``auto`` looks for the columns ``mesh_seed`` and
        ``noise_seed``.
    type : {"auto", "I", "II", "III"}
        Type of the sums of squares; ``auto`` is II when balanced and III when not.
    model : "full", int or list
        Terms; see :func:`study.analysis.design_matrix.terms_of`.
    error : {"auto", "pooled", "own"}
        How the error is found; see :mod:`study.analysis.error.ledger`.
    records : bool
        Whether the rows are records of a deterministic study.
    tolerance : float, optional
        Solver tolerance in the unit of the response; default 1e-8 of its largest value for
        records, 0 otherwise.
    practical : optional
        Smallest difference that matters; see :func:`study.analysis.data.threshold`.
    transform : {"none", "log"}
        ``log`` reports effects as ratios.
    u_num : float, mapping to float or NumericalBound, optional
        Bound of the numerical error of a difference: one for all effects, or one a term
        (``"A"``, ``"A:B"``; a term that is absent has none) in the unit of the response, or what
        bounds any difference on the scale of the analysis. Cells are one computation where
        they agree within the smallest of them in every block.
    specimens : int, optional
        Specimens that were measured, where the response is a score of theirs: one makes no
        claim, and a claim from two says so. By default the blocks are counted.
    alpha : float
        Size of the tests; intervals have the level 1 - alpha.
    seed : int
        Seed of every simulation.
    exact : bool
        Whether to simulate the exact p of Ryan-Joiner, Bartlett and Levene.

    Returns
    -------
    AnalysisResult
        Error term, table, effects with intervals and verdicts, assumptions.

    Raises
    ------
    InputError
        For columns, levels or values that cannot be analyzed.
    RefusedError
        For copies that pose as replicates.
    """
    options = Options(
        names_of(block),
        unit,
        names_of(whole_plot),
        replicates,
        type,
        model,
        error,
        records,
        tolerance,
        practical,
        transform,
        u_num,
        specimens,
        alpha,
        seed,
        exact,
    )
    options.check()
    if unit is None and _one_cell_a_block(table, response, factors, options):
        # a block that lies in one cell is a replicate of it, and its rows are repeats
        unit = options.block[0]
        options = replace(options, block=(), error="auto", replicates="runs")
    if unit is not None:
        return _with_units(table, response, factors, options, unit)
    return _complete(table, response, factors, options)


def _one_cell_a_block(
    table: pd.DataFrame, response: str, factors: Sequence[str], options: Options
) -> bool:
    if len(options.block) != 1 or options.whole_plot:
        return False
    data = prepare(table, response, factors, options.block)
    plots = whole_plots(data, ())
    return plots is not None and set(plots.between) == set(data.factors)


def _complete(
    table: pd.DataFrame, response: str, factors: Sequence[str], options: Options
) -> AnalysisResult:
    """Analysis of the rows there are, and what the missing ones could do to it."""
    out = _found(table, response, factors, options)
    result = assemble(add_robustness(out))
    if not out.data.missing:
        return result

    def effects(completed: pd.DataFrame) -> tuple[Effect, ...]:
        return _found(completed, response, factors, options).effects

    found = missing_cases.bounds(table, response, factors, out.effects, options.alpha, effects)
    notes = missing_cases.sentences(found, out.data.missing)
    return replace(result, bounds=found, warnings=(*result.warnings, *notes))


def _with_units(
    table: pd.DataFrame, response: str, factors: Sequence[str], options: Options, unit: str
) -> AnalysisResult:
    """Analysis of the means of the units, set beside that of all rows."""
    blocks, transform = options.block, options.transform
    means = nested.average_units(table, response, factors, unit, block=blocks, transform=transform)
    result = _complete(means, response, factors, options)
    if result.error_term.source == "E0":
        asked = replace(
            result.error_term,
            question=f"would the effect show with other levels of {unit}? (scatter between them "
            "within a cell)",
            reason=f"cells hold several levels of {unit}; the rows of each are averaged",
        )
        result = replace(result, error_term=asked)
    rows = _found(table, response, factors, options)
    naive = rows.anova
    if rows.data.missing:
        lost = tuple(w for w in rows.data.warnings if w not in result.warnings)
        result = replace(result, warnings=(*lost, *result.warnings))
    found = nested.compare_naive(
        table,
        response,
        factors,
        unit,
        result,
        naive,
        block=blocks,
        transform=transform,
        seed=options.seed,
    )
    if found is None:
        return result
    notes = nested.sentences(found, options.alpha)
    return replace(result, nested=found, warnings=(*result.warnings, *notes))


def _found(table: pd.DataFrame, response: str, factors: Sequence[str], options: Options) -> Outcome:
    """Table and effects of one analysis, before the checks of its assumptions."""
    out = _start(table, response, factors, options)
    if float(np.ptp(out.data.y)) <= max(10 * out.tolerance, 4 * ulp_floor(out.data.y)):
        return out.constant()
    notes = refuse_fake_replicates(out.data, table, records=out.records, tolerance=out.tolerance)
    _refuse_undeclared(out)
    if _repeats_in_blocks(out.data):
        out = _averaged(out, table, options)
        notes.append("repeats of a cell within a block are averaged: they are nested in it")
    plots = whole_plots(out.data, options.whole_plot)
    data = out.data
    y = _transformed(data, response, out.transform)
    scale = scale_of(out, y, options)
    low, high = range_of_bounds(out, scale)
    out = replace(out, y=y, scale=scale, u_cells=low, u_raw=high)
    out = replace(out, warnings=(*data.warnings, *notes))
    out = replace(out, copies=_copies(out))
    declared = data.also or (options.whole_plot and options.error == "auto")
    how = ledger.method(options.error, None if declared else data.block)
    if how == ledger.OWN:
        tested = _own(out, options, plots)
        if tested is not None:
            return tested
        out = out.warn(f"fewer than two complete levels of {data.block}: no test against blocks")
    if plots is not None:
        return split_plot(out, options.type, plots)
    return pooled(out, options.type, options.error, options.model)


def _start(table: pd.DataFrame, response: str, factors: Sequence[str], options: Options) -> Outcome:
    """Check the data and gather terms and tolerances."""
    data = prepare(table, response, factors, options.block)
    terms = terms_of(data.factors, options.model)
    nested_factors = nested_in(terms)
    if nested_factors:
        data = replace(
            data,
            layout=number_within(data.layout, nested_factors),
            warnings=(*data.warnings, *_nested_notes(nested_factors)),
        )
    tol = options.tolerance
    if tol is None:
        tol = _DEFAULT_TOLERANCE * float(np.abs(data.y).max()) if options.records else 0.0
    return Outcome(
        data,
        response,
        terms,
        options.transform,
        options.alpha,
        options.seed,
        options.exact,
        tol,
        None,
        options.records,
        replicates=_replicates(table, data, options),
    )


def _nested_notes(found: Mapping[str, tuple[str, ...]]) -> list[str]:
    return [
        f"{name} is nested in {' and '.join(parents)}, which is tested against the rows within: "
        f"to ask whether other levels of {name} would show it, use --unit {name}"
        for name, parents in found.items()
    ]


def _replicates(table: pd.DataFrame, data: Data, options: Options) -> str:
    """Tell what the rows of one cell are, from what was said or from the columns."""
    if options.replicates != "auto":
        return options.replicates
    for column, kind in _SEED_COLUMNS.items():
        if column in table.columns and column not in (*data.factors, *data.blocks):
            return kind
    return "auto" if options.records else "runs"


def _repeats_in_blocks(data: Data) -> bool:
    """Whether a cell has several rows in one block, which are no independent trials."""
    if data.block is None:
        return False
    _, counts = np.unique(data.layout.cell([*data.factors, *data.blocks]), return_counts=True)
    return bool(counts.max() > 1)


def _averaged(out: Outcome, table: pd.DataFrame, options: Options) -> Outcome:
    """Outcome of the means of the cells in each block; missing rows stay counted."""
    first, *others = out.data.blocks
    means = nested.average_units(
        table, out.response, out.data.factors, first, block=others, transform=out.transform
    )
    start = _start(means, out.response, out.data.factors, options)
    data = replace(start.data, missing=out.data.missing, warnings=out.data.warnings)
    return replace(start, data=data, tolerance=out.tolerance)


def _refuse_undeclared(out: Outcome) -> None:
    """Refuse several records of a cell that nobody declared to be replicates.

    Raises
    ------
    RefusedError
        If a cell of a study holds several runs that nothing tells apart.
    """
    data = out.data
    counts = np.bincount(data.cell)
    if out.replicates != "auto" or data.block is not None or counts.max() == 1:
        return
    names = data.cell_names()
    double = [names[c] for c in np.flatnonzero(counts > 1)]
    raise RefusedError(
        f"{len(double)} cells hold several runs ({'; '.join(double[:3])}, ...) that differ in "
        "something not named: a deterministic study has no replicates. Name all factors, or "
        "--block, or say what the repeats are (--replicates mesh-seeds or noise)"
    )


def _own(out: Outcome, options: Options, plots: Plots | None) -> Outcome | None:
    if plots is not None and plots.nested:
        return own_groups(out, options.type, options.error, plots)
    return own(out, options.type, options.error)


def _transformed(data: Data, response: str, transform: str) -> Array:
    if transform == "none":
        return data.y
    if data.y.min() <= 0:
        raise InputError(
            Fault(f"response {response!r}", f"the log needs positive values, got {data.y.min():g}")
        )
    return np.asarray(np.log(data.y))


def _copies(out: Outcome) -> CopyGroups:
    """Cells that are one computation, judged on the raw response."""
    data = out.data
    cells = np.unique(data.cell)
    blocks = 1 if data.block is None else len(data.layout.levels[data.block])
    within = max(10 * out.tolerance, out.u_cells or 0.0, ulp_floor(data.y))
    # values of a CSV may tie by chance; equality in three or more blocks is no chance
    if not (out.records or out.tolerance > 0) and (data.block is None or blocks < 3):
        return CopyGroups(tuple((int(c),) for c in cells))
    table = np.full((cells.size, blocks), np.nan)
    at = np.searchsorted(cells, data.cell)
    column = 0 if data.block is None else data.layout.codes[data.block]
    table[at, column] = data.y
    found = group_cells(table, within)
    return CopyGroups(tuple(tuple(int(cells[i]) for i in g) for g in found.groups))
