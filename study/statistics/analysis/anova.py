"""Factorial analysis of one response: the error term first, then everything else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations, pairwise, product
from typing import TYPE_CHECKING

import numpy as np

from study.ground.arrays import Array, one_thread
from study.ground.errors import Fault, InputError, RefusedError
from study.ground.tabular import names_of
from study.ground.units import unit_of_column
from study.statistics.analysis import error_ledger, failures, repeats
from study.statistics.analysis.analysis_request import (
    AnalysisRequest,
    Blocking,
    NumericalUncertainty,
    Practical,
    ResponseScale,
    on_scale,
    threshold,
    unchecked_unit,
)
from study.statistics.analysis.analysis_result import NO_ERROR, AnalysisResult
from study.statistics.analysis.anova_table import Effect
from study.statistics.analysis.assumptions import assumptions_of
from study.statistics.analysis.data import (
    Data,
    Structure,
    blocks_that_lack_cells,
    prepare,
    refuse_copied_rows,
    structure_of,
)
from study.statistics.analysis.effects import MOST_LEVELS, Scale
from study.statistics.analysis.error_ledger import pooled
from study.statistics.analysis.linear_model import (
    Model,
    Term,
    factorize,
    model_matrix,
    nested_in,
    number_within,
    term_name,
    terms_of,
)
from study.statistics.analysis.mixed_model import FEWEST_LEVELS
from study.statistics.analysis.post_hoc import with_holm
from study.statistics.analysis.power import planned
from study.statistics.analysis.simple_effects import without_each
from study.statistics.analysis.strata import (
    Plots,
    by_block_interactions,
    incomplete_blocks,
    split_plot,
    whole_plots,
)
from study.statistics.analysis.unreplicated import copies_of, refuse_fake_replicates, ulp_floor
from study.statistics.convergence.contrast_bound import SeriesBounds

if TYPE_CHECKING:
    import pandas as pd


# -------------------------------------------------------------------------------------------------
# What an analysis found becomes its result, with every check beside it.


def assemble(out: AnalysisResult) -> AnalysisResult:
    """Check assumptions, adjust p, and plan other numbers of rows."""
    out = assumptions_of(out).warn(*_inestimable(out.effects), *_partial(out.effects))
    groups_of = out.copies
    if len(groups_of) < sum(len(g) for g in groups_of) and out.error_term is not NO_ERROR:
        out = out.warn(
            f"only {len(groups_of)} of {sum(map(len, groups_of))} cells differ: the others give "
            "the same numbers in every block, so checks of the residuals take one cell of each kind"
        )
    notes = tuple(dict.fromkeys(out.notes))
    return replace(out, effects=with_holm(out.effects), power=planned(out), notes=notes)


def _inestimable(effects: Sequence[Effect]) -> list[str]:
    """One sentence about the means that cannot be estimated, of the terms in their order."""
    lost = {e.term: [a for a, m in zip(e.levels, e.mean, strict=True) if m is None]
            for e in effects}  # fmt: skip
    places = [
        f"{term} at {', '.join(levels[:5])}"
        + (f" and {len(levels) - 5} more" if len(levels) > 5 else "")
        for term, levels in lost.items()
        if levels
    ]
    more = f"; and of {len(places) - 5} more terms" if len(places) > 5 else ""
    return [f"means are not estimable: {'; '.join(places[:5])}{more}"] if places else []


def _partial(effects: Sequence[Effect]) -> list[str]:
    """One sentence about the factors that are compared at a part of the others' settings."""
    places = [
        f"{effect.term} at {at.count} of {at.total} settings of {', '.join(at.others)}"
        for effect in effects
        if (at := effect.complete) is not None
    ]
    what = "main effects are those of the settings with all levels of the factor"
    return [f"{what}: {'; '.join(places)}"] if places else []


_DEFAULT_TOLERANCE = 1e-8

# columns of a study's table that say what the repeats of a cell are
_SEED_COLUMNS = {"mesh_seed": "mesh-seeds", "noise_seed": "noise"}


@one_thread
def analyze(table: pd.DataFrame, request: AnalysisRequest) -> AnalysisResult:
    """Answer one question to a table: error term, table, effects with verdicts, assumptions."""
    table, request, alone = _of_one_block(table, request)
    request, note = _of_units(table, request)
    note = alone or note
    chain = _nested_chain(table, request)
    if chain:
        within = " and ".join(f"{b} lies within {a}" for a, b in pairwise(chain))
        note = (
            f"{within} (levels with names of their own): "
            + "".join(f"{a} is tested against {b}, " for a, b in pairwise(chain))
            + f"and {chain[-1]} against the rows within; --model "
            + ",".join(":".join(chain[: k + 1]) for k in range(len(chain)))
            + " tests all of them against the rows"
        )
        return _with_nested(table, request, chain).warn(note)
    if request.layout.unit is not None:
        result = _with_units(table, request, request.layout.unit)
    else:
        result = _complete(table, request)
    return result.warn(note) if note else result


@one_thread
def effects(table: pd.DataFrame, request: AnalysisRequest) -> tuple[Effect, ...]:
    """Effects with their verdicts alone, as :func:`analyze` has them; p are not adjusted.

    No assumption is checked and no block is left out in turn, which takes most of the time.
    """
    table, request, _ = _of_one_block(table, request)
    request, _ = _of_units(table, request)
    if request.layout.unit is not None:
        table = repeats.average_units(table, request, request.layout.unit, request.layout.block)
    return _effects_alone(table, request)


def _effects_alone(rows: pd.DataFrame, request: AnalysisRequest) -> tuple[Effect, ...]:
    return _found(rows, request).effects


def _of_one_block(
    table: pd.DataFrame, request: AnalysisRequest
) -> tuple[pd.DataFrame, AnalysisRequest, str]:
    """Means of the cells where there is one block alone, which no analysis can claim from.

    The text says so; it is empty where there are several blocks or none.
    """
    layout = request.layout
    if len(layout.block) != 1 or layout.unit or not {*layout.block, request.response} <= set(table):
        return table, request, ""
    name = layout.block[0]
    labels = table.loc[table[request.response].notna(), name].dropna().unique()
    if len(labels) != 1 or name in request.factors:
        return table, request, ""
    request = replace(request, specimens=1, error="auto", layout=replace(layout, block=()))
    means = repeats.average_units(table[table[name].notna()], request, name)
    note = (
        f"one {name} ({labels[0]}): differences are those of this {name}, and how another one "
        "would differ cannot be told; measure two or more"
    )
    return means, request, note


def _of_units(table: pd.DataFrame, request: AnalysisRequest) -> tuple[AnalysisRequest, str]:
    """Take a block that lies in one cell for a replicate of it, and a unit in several for a block.

    The text says so of a unit; it is empty otherwise.
    """
    unit = request.layout.unit
    if unit is not None and not request.layout.block and repeats.crosses(table, request, unit):
        layout = replace(request.layout, block=(unit,), unit=None)
        note = f"every {unit} is measured in several cells: it is a block (--block {unit})"
        return replace(request, layout=layout), note
    if unit is not None and (label := repeats.named_again(table, request, unit)):
        return request, (
            f"{unit} {label} stands in several cells, and is taken for another {unit} in each: "
            f"where it is one and the same, --block {unit} compares the cells within it"
        )
    if unit is not None or not _one_cell_a_block(table, request):
        return request, ""
    layout = replace(
        request.layout, block=(), unit=request.layout.block[0], whole_plot=(), replicates="runs"
    )
    return replace(request, layout=layout, error="auto"), ""


def anova(  # noqa: PLR0913  # the public face: one keyword for each thing that may be asked
    table: pd.DataFrame,
    response: str,
    factors: Sequence[str],
    *,
    block: str | Sequence[str] | None = None,
    unit: str | None = None,
    whole_plot: str | Sequence[str] = (),
    replicates: str = "auto",
    copies: str = "refuse",
    type: str = "auto",  # noqa: A002
    model: Model = "full",
    error: str = "auto",
    records: bool = False,
    tolerance: float | None = None,
    practical: Practical = None,
    transform: str = "none",
    u_num: NumericalUncertainty = None,
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
    copies : {"refuse", "independent"}
        What rows are that repeat others in every digit: copies, or measured each.
    type : {"auto", "I", "II", "III"}
        Type of the sums of squares; ``auto`` is II when balanced and III when not.
    model : "full", int or list
        Terms; see :func:`study.statistics.analysis.linear_model.terms_of`.
    error : {"auto", "pooled", "own"}
        How the error is found; see :mod:`study.statistics.analysis.error_ledger`.
    records : bool
        Whether the rows are records of a deterministic study.
    tolerance : float, optional
        Solver tolerance in the unit of the response; default 1e-8 of its largest value for
        records, 0 otherwise.
    practical : optional
        Smallest difference that matters; see ``threshold``.
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
    request = AnalysisRequest(
        response,
        tuple(str(name) for name in factors),
        Blocking(names_of(block), unit, names_of(whole_plot), replicates, copies),
        model,
        type,
        error,
        ResponseScale(transform, threshold(practical, unit_of_column(response)), u_num, tolerance),
        records,
        specimens,
        alpha,
        seed,
        exact,
    )
    return analyze(table, request).warn(*unchecked_unit(practical, response))


def _one_cell_a_block(table: pd.DataFrame, request: AnalysisRequest) -> bool:
    layout = request.layout
    if len(layout.block) != 1 or layout.whole_plot:
        return False
    data = prepare(table, request.response, request.factors, layout.block)
    plots = whole_plots(data, ())
    return plots is not None and set(plots.between) == set(data.factors)


def _complete(table: pd.DataFrame, request: AnalysisRequest) -> AnalysisResult:
    """Analysis of the rows there are, and what the missing ones could do to it."""
    out = _found(table, request)
    if len(request.layout.block) == 1 and out.error_term.source == "E1":
        quick = replace(request, simulated=False)
        again = [partial(_effects_alone, request=each) for each in (quick, request)]
        out = replace(out, effects=without_each(table, *request.layout.block, out.effects, again))
    result = assemble(out)
    if not out.data.missing:
        return result

    # what is filled in repeats the extremes, and is neither a copy nor a limit of the readings
    measured = replace(request, layout=replace(request.layout, copies="independent"))
    filled = partial(_effects_alone, request=measured)
    failure_bounds = failures.bounds(table, request, out.effects, filled)
    notes = failures.sentences(failure_bounds, out.data.missing)
    shared = [] if request.records else failures.shared_settings(table, request)
    return replace(result, failure_bounds=failure_bounds).warn(*shared, *notes)


def _nested_chain(table: pd.DataFrame, request: AnalysisRequest) -> tuple[str, ...]:
    """Factors of which each lies within the one before, with levels of its own names."""
    layout = request.layout
    if layout.block or layout.unit or layout.whole_plot or request.model != "full":
        return ()
    if request.records or len(request.factors) < 2:
        return ()
    data = prepare(table, request.response, request.factors)
    pairs = structure_of(data).nested
    inside = [f for f in request.factors if any(f == inner for inner, _ in pairs)]
    if len(pairs) <= 1:
        return pairs[0][::-1] if pairs else ()
    chain = sorted(request.factors, key=lambda name: len(data.layout.levels[name]))
    if all((b, a) in pairs for a, b in pairwise(chain)):
        return tuple(chain)
    nesting = ", ".join(f"{inner} lies within {outer}" for inner, outer in pairs)
    raise RefusedError(
        f"{nesting}: name the strata. --error reml "
        f"--factors {','.join(f for f in request.factors if f not in inside)} "
        f"--random {','.join(inside)} takes the levels of the latter as drawn from many; --unit "
        f"{inside[-1]} without the other in --factors averages the rows of each"
    )


def _with_nested(
    table: pd.DataFrame, request: AnalysisRequest, chain: tuple[str, ...]
) -> AnalysisResult:
    """Analysis of the other factors against the nested one, and of that one against the rows.

    Of several (plants, their laboratories, batches of these) each is tested against the next.
    """
    *above, inner = chain
    outer, error = above[-1], ":".join(chain)
    factors = tuple(f for f in request.factors if f != inner)
    upper = replace(request, factors=factors, layout=replace(request.layout, unit=inner))
    # one that meets several levels of a third factor is a block of these, not a repeat of its cell
    upper, _ = _of_units(table, upper)
    crosses = upper.layout.unit is None
    if len(above) > 1:
        means = repeats.average_units(table, upper, inner)
        result = _with_nested(means, replace(request, factors=factors), tuple(above))
        terms = tuple(chain[: k + 1] for k in range(len(chain)))
    else:
        result = _complete(table, upper) if crosses else _with_units(table, upper, inner)
        terms = tuple(t for t in terms_of(request.factors) if inner not in t or outer in t)
    rows = _found(table, replace(request, model=[list(t) for t in terms], sums="auto"))
    tested = {row.term: row for row in result.anova.rows}
    listed = []
    for row in rows.anova.rows:
        higher = tested.get(row.term)
        if higher is None or row.term == "residual":
            listed.append(row)
            continue
        against = higher.error if len(above) > 1 and ":" in (higher.error or "") else error
        against = f"{outer}:{higher.error}" if crosses else against
        test = replace(higher, df=row.df, ss=row.ss, ms=row.ms, share=row.share, omega_sq=None)
        listed.append(replace(test, error=against))
    return replace(result, anova=replace(rows.anova, rows=tuple(listed)))


def _with_units(table: pd.DataFrame, request: AnalysisRequest, unit: str) -> AnalysisResult:
    """Analysis of the means of the units, set beside that of all rows."""
    means = repeats.average_units(table, request, unit, request.layout.block)
    result = _complete(means, request)
    if result.error_term.source == "E0":
        between_units = replace(
            result.error_term,
            question=f"would the effect show with other levels of {unit}? (scatter between them "
            "within a cell)",
            reason=f"cells hold several levels of {unit}; the rows of each are averaged",
        )
        result = replace(result, error_term=between_units)
    rows = _found(table, request)
    if rows.data.missing:
        lost = tuple(w for w in rows.data.warnings if w not in result.notes)
        result = replace(result, notes=(*lost, *result.notes))
    nested = repeats.compare_naive(table, request, unit, result.anova, rows.anova)
    if nested is None:
        return result
    notes = repeats.sentences(nested, request.alpha)
    return replace(result, nested=nested).warn(*notes)


def _found(table: pd.DataFrame, request: AnalysisRequest) -> AnalysisResult:
    """Table and effects of one analysis, before the checks of its assumptions."""
    out = _start(table, request)
    if request.scale.is_log and out.data.y.min() <= 0:
        rule = f"the log needs positive values, got {out.data.y.min():g}"
        raise InputError(Fault(f"response {request.response!r}", rule))
    if float(np.ptp(out.data.y)) <= max(10 * out.tolerance, 4 * ulp_floor(out.data.y)):
        return out.constant()
    notes = refuse_fake_replicates(
        out.data, table, records=request.records, tolerance=out.tolerance
    )
    if not request.records and request.layout.copies == "refuse":
        refuse_copied_rows(out.data)
    _refuse_undeclared(out)
    _refuse_confounded(out.data)
    unit = out.data.layout.cell([*out.data.factors, *out.data.blocks])
    if out.data.block is not None and int(np.unique(unit, return_counts=True)[1].max()) > 1:
        out = _averaged(out, table)
        notes.append("repeats of a cell within a block are averaged: they are nested in it")
    plots = whole_plots(out.data, request.layout.whole_plot)
    data = out.data
    y = np.asarray(np.log(data.y)) if request.scale.is_log else data.y
    scale = _scale_of(out, y)
    low, high = _range_of_bounds(out, scale)
    within, computed = max(10 * out.tolerance, low or 0.0), request.records or out.tolerance > 0
    copies = copies_of(data, within, computed=computed)
    out = replace(out, y=y, scale=scale, u_num=high, copies=copies).warn(*data.warnings, *notes)
    declared = len(data.blocks) > 1 or (request.layout.whole_plot and request.error == "auto")
    # pooled over unequal variances the test of a true null rejects in up to .48 of cases
    if data.block is not None and not declared and request.error != "pooled":
        between_blocks = plots if plots is not None and plots.nested else None
        judged = None if between_blocks else incomplete_blocks(out)
        if (judged := judged or by_block_interactions(out, between_blocks)) is not None:
            return judged
        if lacking := _lacking(data, between_blocks):
            return pooled(out, untested=lacking)
    if plots is not None:
        asked_for = request.layout.whole_plot and request.error != "pooled"
        return (incomplete_blocks(out, plots) if asked_for else None) or split_plot(out, plots)
    return error_ledger.welch(out) if request.error == "welch" else pooled(out)


def _scale_of(out: AnalysisResult, y: Array) -> Scale:
    """Scale of a response y (n,): its practical difference and numerical bound as was asked."""
    scale, block, specimens = out.request.scale, out.data.block, out.request.specimens
    mean = float(np.exp(y.mean())) if scale.is_log else float(y.mean())
    practical = on_scale(scale.practical, mean, scale.transform)
    unit = 1 / mean if scale.is_log else 1.0
    bound = scale.bound(map(term_name, out.terms), unit)
    if specimens is None and block is not None and out.replicates not in ("mesh-seeds", "noise"):
        specimens = len(out.data.layout.levels[block])
    deterministic = out.request.records and block is None
    only = bound.only if isinstance(bound, SeriesBounds) else {}
    return Scale(scale.transform, practical, bound, deterministic, unit, specimens, only)


def _range_of_bounds(out: AnalysisResult, scale: Scale) -> tuple[float | None, float | None]:
    """Smallest and largest bound of a difference of two levels, in the unit of the response.

    A difference without a numerical error, such as one between meshes, does not count.
    """
    if scale.bound is None:
        return None, None
    pairs = (
        ({name: first}, {name: second})
        for (name,) in (term for term in out.terms if len(term) == 1)
        for first, second in combinations(out.data.layout.levels[name][:MOST_LEVELS], 2)
    )
    bounds = [u for pair in pairs if (u := scale.bound.of(*pair))]
    if not bounds:
        return None, None
    return min(bounds) / scale.unit, max(bounds) / scale.unit


def _start(table: pd.DataFrame, request: AnalysisRequest) -> AnalysisResult:
    """Check the data and gather terms and tolerances."""
    data = prepare(table, request.response, request.factors, request.layout.block)
    terms = terms_of(data.factors, request.model)
    nested_factors = nested_in(terms)
    notes = [
        f"{name} is nested in {' and '.join(parents)}, which is tested against the rows within: "
        f"to ask whether other levels of {name} would show it, use --unit {name}"
        for name, parents in nested_factors.items()
    ]
    if nested_factors:
        data = replace(data, layout=number_within(data.layout, nested_factors))
    structure = structure_of(data)
    if structure.empty_cells:
        structure, terms, left_out = _with_empty_cells(data, request, structure, terms)
        notes += left_out
    data = replace(data, warnings=(*data.warnings, *notes))
    tol = request.scale.tolerance
    if tol is None:
        tol = _DEFAULT_TOLERANCE * float(np.abs(data.y).max()) if request.records else 0.0
    replicates = request.layout.replicates
    if replicates == "auto":
        others = set(table.columns) - {*data.factors, *data.blocks}
        kinds = [kind for column, kind in _SEED_COLUMNS.items() if column in others]
        replicates = kinds[0] if kinds else "auto" if request.records else "runs"
    return AnalysisResult(request, data, terms, tol, replicates, structure)


def _with_empty_cells(
    data: Data, request: AnalysisRequest, structure: Structure, terms: tuple[Term, ...]
) -> tuple[Structure, tuple[Term, ...], list[str]]:
    """Structure without the cells that the model does not need, and the terms that are told apart.

    Terms that add nothing to those before them are left out; a note names them with their aliases.
    """
    cells = np.unique(data.cell, return_index=True)[1]
    model = factorize(model_matrix(data.layout.take(cells), terms))
    if model.is_full or nested_in(terms):
        return replace(structure, empty_cells=0), terms, []
    spaces = {t: model.space(i, "I") for i, t in enumerate(model.matrix.terms) if t}
    told_apart = tuple(t for t, space in spaces.items() if space.basis.shape[1])
    reduced = factorize(model_matrix(data.layout.take(cells), told_apart))
    if len(told_apart) < len(terms) and reduced.is_full and reduced.is_orthogonal():
        structure = replace(structure, empty_cells=0)  # of a fraction
    if len(told_apart) == len(terms) or not (request.is_ordered and request.any_type):
        return structure, terms, []
    lost = [
        term_name(t)
        + (f" (= {space.aliases[0]})" if space.aliases and space.nominal_df == 1 else "")
        for t, space in spaces.items()
        if t not in told_apart
    ]
    listed = ", ".join(lost[:8]) + (f" and {len(lost) - 8} more" if len(lost) > 8 else "")
    note = (
        f"{listed}: left out, for these runs cannot tell them from the terms before them; declare "
        "which are negligible to have all factors judged "
        f"({error_ledger.smaller_model(data, request)})"
    )
    reason = error_ledger.undecided(data, request)
    return replace(structure, undecided=reason, asked=terms), told_apart, [note]


def _lacking(data: Data, plots: Plots | None) -> str:
    """Why effects have no error where blocks lack cells; empty where no block does.

    ``plots`` are blocks between which some factors lie.
    """
    between = () if plots is None else plots.between
    lacking, blocks = blocks_that_lack_cells(data, [f for f in data.factors if f not in between])
    if not lacking:
        return ""
    mixed = "--error reml fits a mixed model to all rows; " if blocks >= FEWEST_LEVELS else ""
    return (
        f"{lacking} of {blocks} levels of {data.block} lack a cell, and too few have all of them "
        f"to test effects against their own interaction with the blocks: {mixed}--error pooled "
        "takes all these interactions to be of one size"
    )


def _averaged(out: AnalysisResult, table: pd.DataFrame) -> AnalysisResult:
    """Outcome of the means of the cells in each block; missing rows stay counted."""
    first, *others = out.data.blocks
    means = repeats.average_units(table, out.request, first, others)
    start = _start(means, out.request)
    data = replace(start.data, missing=out.data.missing, warnings=out.data.warnings)
    return replace(start, data=data, tolerance=out.tolerance, structure=out.structure)


def _refuse_confounded(data: Data) -> None:
    """Refuse a block that changes with a factor, level by level."""
    sizes = {name: len(data.layout.levels[name]) for name in (*data.factors, *data.blocks)}
    for factor_name, block in product(data.factors, data.blocks):
        pairs = np.unique(data.layout.cell([factor_name, block])).size
        if pairs == sizes[factor_name] == sizes[block]:
            others = ",".join(f for f in data.factors if f != factor_name)
            rest = f", or test the others alone (--factors {others})" if others else ""
            raise RefusedError(
                f"{block} changes with {factor_name}: every level of {factor_name} was measured "
                f"in one {block} and no other, so nothing tells their effects apart. Measure the "
                f"levels of {factor_name} in the same {block}{rest}; without --block {block} a "
                f"difference between its levels counts as one of {factor_name}"
            )


def _refuse_undeclared(out: AnalysisResult) -> None:
    """Refuse several records of a cell that nobody declared to be replicates."""
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
