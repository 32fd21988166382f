"""Statistics on the records of a study: rows and question of each response, as its design says.

With them goes the numerical uncertainty of its effects: what the verdicts are held against.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np

from study.ground.canonical import digest
from study.ground.curve import Curve
from study.ground.errors import InputError, StudyError
from study.ground.tabular import names_of
from study.ground.units import parse_number
from study.harness.design.load import is_constant
from study.harness.design.overview import SAMPLED
from study.harness.design.spec import usual_value
from study.record.record import (
    NumericalCells,
    NumericalRow,
    Record,
    answered_often,
    fault_of_series,
    is_repeat,
    is_same_run,
    table,
)
from study.simulation.response import CURVE_RESPONSES
from study.statistics.analysis.analysis_request import (
    AnalysisRequest,
    AnovaOptions,
    Blocking,
    ResponseScale,
    threshold,
)
from study.statistics.analysis.anova import analyze, effects
from study.statistics.analysis.anova_table import DepthEffect, Effect
from study.statistics.analysis.failures import CaseFate, cause
from study.statistics.analysis.linear_model import Model, terms_of
from study.statistics.analysis.repeats import common_seeds
from study.statistics.convergence.contrast_bound import CellSeries, NumericalBound, SeriesBounds
from study.statistics.convergence.grid_convergence import NumericalUncertainty
from study.statistics.surfaces.surface_factors import NumericFactor, Runs
from study.statistics.surfaces.surface_fitting import compared, counted, surfaces_at
from study.statistics.surfaces.surface_result import FittedSurface, propagate

if TYPE_CHECKING:
    import pandas as pd

    from study.ground.arrays import Array
    from study.harness.design.spec import Design, Factor, ResponseSpec
    from study.record.store import Store
    from study.simulation.cell import Treatment
    from study.statistics.analysis.analysis_result import AnalysisResult


def analyze_records(
    design: Design,
    records: Sequence[Record],
    response: ResponseSpec,
    numerical: Sequence[NumericalUncertainty] = (),
    factors: Sequence[str] = (),
    options: AnovaOptions | None = None,
) -> AnalysisResult:
    """Analyze one response of a study as its design says, but for options that are given."""
    rows, request, notes = _asked(design, records, response, numerical, factors, options or {})
    return analyze(rows, request).warn(*notes)


def effects_of_records(
    design: Design,
    records: Sequence[Record],
    response: ResponseSpec,
    numerical: Sequence[NumericalUncertainty] = (),
) -> tuple[Effect, ...]:
    """Effects alone of :func:`analyze_records`: no checks, and no block left out in turn."""
    rows, request, _ = _asked(design, records, response, numerical, (), {})
    return effects(rows, request)


def _asked(
    design: Design,
    records: Sequence[Record],
    response: ResponseSpec,
    numerical: Sequence[NumericalUncertainty],
    factors: Sequence[str],
    options: AnovaOptions,
) -> tuple[pd.DataFrame, AnalysisRequest, tuple[str, ...]]:
    """Rows to analyze, the request of the analysis, and notes on rows left out."""
    if not any(record.converged for record in records):
        raise InputError(f"no case has an answer for {response.name}")
    spec, blocks = design.analysis, {record.block for record in records} - {None}
    given: AnovaOptions = {
        "type": spec.type,
        "model": spec.model if isinstance(spec.model, (str, int)) else list(spec.model),
        "error": spec.error,
        "alpha": spec.alpha,
        "seed": design.seed,
        "practical": response.practical,
        "transform": response.transform,
        # what was simulated alone says nothing of specimens, and needs none
        "specimens": max(len(blocks), 1) if design.is_measured else None,
    }
    given.update(cast("AnovaOptions", {k: v for k, v in options.items() if v is not None}))
    block = given.get("block") or ("block" if len(blocks) > 1 else None)
    names = [f.name for f in design.factors]
    factors = list(factors) or [f.name for f in design.factors if len(f.levels) > 1]
    whole, gaps = table(list(records)), tuple[str, ...]()
    if isinstance(block, str | None):
        rows = rows_for(whole, response.name, names, given["error"], block)
        whole, gaps = without_gaps(
            design, rows.table, response.name, factors, rows.block, given["model"],
            mesh_levels(design, records),
        )  # fmt: skip
        block = rows.block
    else:  # blocks that cross, as in a Latin square
        rows = RecordRows(whole, None, options.get("error") or "auto")
    u_num = numerical_bound(design, numerical, records, whole, response.name, given["transform"])
    request = AnalysisRequest(
        response.name,
        tuple(factors),
        Blocking(
            names_of(block), given.get("unit"), names_of(given.get("whole_plot")),
            given.get("replicates", rows.replicates), given.get("copies", "refuse"),
        ),
        given["model"],
        given["type"],
        rows.error,
        ResponseScale(given["transform"], threshold(given["practical"], response.unit),
                      given.get("u_num", u_num), given.get("tolerance")),
        records=True,
        specimens=given["specimens"],
        alpha=given["alpha"],
        seed=given["seed"],
        exact=given.get("exact", True),
    )  # fmt: skip
    return whole, request, (*rows.notes, *gaps)


#: spread over the meshes of a cell, over the response, below which the mesh does not enter
_SAME = 1e-12
_NOISE = "noise_seed"
_MESH = "mesh_seed"
_RUN = "replicate"


@dataclass(frozen=True)
class RecordRows:
    """Rows to analyze, and what they are."""

    table: pd.DataFrame
    block: str | None
    #: {"auto", "pooled", "own"}: how the error is found.
    error: str = "auto"
    #: {"auto", "noise"}: what the rows of one cell are.
    replicates: str = "auto"
    #: What was left out and why.
    notes: tuple[str, ...] = ()


def rows_for(
    table: pd.DataFrame, response: str, factors: Sequence[str], error: str, block: str | None
) -> RecordRows:
    """Rows of a study's table for one response."""
    by_replicates = error == "replicates"
    how = "auto" if by_replicates else error
    if _RUN in table:
        shown = table.drop(columns=_RUN)
        return RecordRows(shown, block, how, "runs")
    if _NOISE in table:
        return _noise_rows(table, response, factors, how, by_replicates, block)
    if _MESH not in table:
        return RecordRows(table, block, how)
    cells = [*factors, *([block] if block else [])]
    groups = table.groupby(cells, sort=False, dropna=False)[response]
    widest = (groups.max() - groups.min()).max()
    if not bool(widest > _SAME * table[response].abs().max()):
        first = table[table[_MESH] == table[_MESH].min()].drop(columns=_MESH)
        note = f"the mesh does not enter {response}: it is the same on every mesh, no E3"
        return RecordRows(first, block, how, notes=(note,))
    if block and by_replicates:
        table, block = _over(table, response, [*factors, _MESH]), None
    if block:
        return RecordRows(table, block, how)
    labels = table[list(factors)].astype(str).itertuples(index=False, name=None)
    common, reason = common_seeds(list(labels), table[_MESH].tolist())
    if not common or how == "pooled":
        return RecordRows(table, None, how)
    rows = table[table[_MESH].astype(str).isin(common)]
    return RecordRows(rows, _MESH, how, "mesh-seeds", (reason,))


def _noise_rows(
    table: pd.DataFrame,
    response: str,
    factors: Sequence[str],
    how: str,
    by_replicates: bool,
    block: str | None,
) -> RecordRows:
    """Rows of the refits to resampled noise, or of the fits to the measured curves."""
    fits = table[table[_NOISE] == 0].drop(columns=_NOISE)
    if not is_constant(response):
        note = f"resampled noise is fitted, not predicted with: no E2 for {response}"
        return RecordRows(fits, block, how, notes=(note,))
    if block and not by_replicates:
        note = (
            "several blocks are a better error term than resampled noise (E1 before E2): the fits "
            'to the measured curves are analyzed; [analysis] error = "replicates" asks for E2'
        )
        return RecordRows(fits, block, how, notes=(note,))
    again = table[table[_NOISE] > 0]
    if block:
        again = _over(again, response, [*factors, _NOISE])
    # pooled takes cells for independent, and has no resample in common
    common = None if how == "pooled" else _NOISE
    return RecordRows(again, common, how, "noise")


def _over(table: pd.DataFrame, response: str, keys: list[str]) -> pd.DataFrame:
    """Mean of the response over the blocks; missing where one of them is."""
    groups = table.groupby(keys, sort=False)[response]
    return groups.agg(lambda values: values.mean(skipna=False)).reset_index()


#: levels that a factor needs to be one
_FEWEST = 2
Cell = tuple[str, ...]


def without_gaps(
    design: Design,
    table: pd.DataFrame,
    response: str,
    factors: Sequence[str],
    block: str | None,
    model: Model,
    meshes: tuple[str | None, Sequence[str]] = (None, ()),
) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """Rows without the levels of which more than half of the cells have no answer.

    Such a level would leave all its siblings with few settings at which they can be compared. It
    is left out, and that is said. So is a level (an energy that is stretched beyond its
    ellipticity on every fine mesh) without any answer on the finest of
    the meshes: what differs on coarser meshes may be their errors. Any other combination of
    levels that fails, while each is sound by itself, leaves no level out: its factors are judged
    at the settings that have answers.
    """
    cells = (tuple(str(t.levels[name]) for name in factors) for t in design.treatments)
    designed = list(dict.fromkeys(cells))
    complete = table.dropna(subset=[response])
    if block is not None and len(complete):
        complete = complete[answered_often(complete, factors, block, table[block].nunique())]
    answered = {tuple(map(str, row)) for row in complete[list(factors)].to_numpy()}
    terms = [[factors.index(name) for name in term] for term in terms_of(factors, model)]
    mesh, order = meshes
    fine = None if mesh is None or not order else (factors.index(mesh), order[-1])
    notes = []
    while (worst := _worst(designed, answered, terms, fine)) is not None:
        factor_index, level = worst
        cells_here = [cell for cell in designed if cell[factor_index] == level]
        has = sum(cell in answered for cell in cells_here)
        notes.append(
            f"{level} ({factors[factor_index]}) has an answer in {has} of {len(cells_here)} cells: "
            "it is left out of this analysis"
        )
        designed = [cell for cell in designed if cell[factor_index] != level]
        table = table[table[factors[factor_index]].astype(str) != level]
    return table, tuple(notes)


def _worst(
    designed: Sequence[Cell],
    answered: set[Cell],
    terms: Sequence[Sequence[int]],
    fine: tuple[int, str] | None,
) -> tuple[int, str] | None:
    """Level with most of its cells unanswered, of those that leave a combination empty."""
    answered_cells = [cell for cell in designed if cell in answered]
    shares: dict[tuple[int, str], float] = {}
    for term in terms:
        has = {tuple(cell[i] for i in term) for cell in answered_cells}
        for empty in {tuple(cell[i] for i in term) for cell in designed} - has:
            for factor_index, level in zip(term, empty, strict=True):
                if len({cell[factor_index] for cell in designed}) > _FEWEST:
                    cells = [cell for cell in designed if cell[factor_index] == level]
                    on_finest = [cell for cell in cells if fine and cell[fine[0]] == fine[1]]
                    share = sum(cell in answered for cell in cells) / len(cells)
                    if share < 0.5 or (on_finest and answered.isdisjoint(on_finest)):
                        shares[factor_index, level] = 1 - share
    return max(sorted(shares), key=lambda key: shares[key], default=None)


# The same analysis over less of the test, to see whether the answer depends on its depth.
#
# Every case keeps its measured and its predicted curve, so that a response over the first part
# of the range costs no simulation. The constants are those of the whole study. Verdicts are held
# against numerical uncertainty as the study's own are: where meshes are a factor it is followed
# at each depth, elsewhere it is that of the whole test.

#: shares of the displacement that are looked at; the last one is the study itself
SHARES = (0.25, 0.5, 0.75, 1.0)
#: measured points that a response needs at least
_FEWEST_POINTS = 5


def effects_by_depth(
    design: Design, records: Sequence[Record], numerical: Sequence[NumericalUncertainty]
) -> tuple[DepthEffect, ...]:
    """Every main effect over the first part of the test."""
    of_curves = [r for r in design.responses if r.name in CURVE_RESPONSES]
    reached = [
        measured.displacement_mm
        for record in records
        if record.converged
        for measured, _ in _pairs(record)
    ]
    ends = [float(places[-1]) for places in reached]
    # without a displacement that every curve reaches, to 2 %, there is nothing to compare
    if not of_curves or not ends or max(ends) > 1.02 * min(ends):
        return ()
    depth = min(ends)
    shares = [
        s
        for s in SHARES
        if min(int((at <= s * depth * (1 + 1e-9)).sum()) for at in reached) >= _FEWEST_POINTS
    ]
    if len(shares) < 2:
        return ()
    effects = []
    for share, response in product(shares, of_curves):
        part = [_rescored(record, response.name, share * depth) for record in records]
        with suppress(StudyError):  # the study's own analysis says why
            effects += [
                DepthEffect(response.name, share * depth, effect)
                for effect in effects_of_records(design, part, response, numerical)
                if effect.is_main and effect.range is not None
            ]
    return tuple(effects)


def _pairs(record: Record) -> Iterator[tuple[Curve, Curve]]:
    for fact in record.scores:
        if (pair := record.pair(fact["score"])) is not None:
            yield pair


def _rescored(record: Record, name: str, depth_mm: float) -> Record:
    """Record whose response covers the first part of its curves only."""
    if not record.converged:
        return record
    values = []
    for measured, predicted in _pairs(record):
        inside = measured.displacement_mm <= depth_mm * (1 + 1e-9)
        part = Curve(measured.displacement_mm[inside], measured.force_N[inside])
        values.append(CURVE_RESPONSES[name](predicted, part))
    if not values:
        return record
    entry = record.responses[name].copy()
    entry["value"] = sum(values) / len(values)
    return replace(record, responses={**record.responses, name: entry})


def different_answers(design: Design, records: Sequence[Record]) -> list[str]:
    """Say which cells have equal inputs and different answers: the simulation is stochastic."""
    if design.replicates.key is not None:
        return []
    # a stored record has its factors in the order of the alphabet
    answered = {frozenset(r.levels.items()): r for r in records if r.converged and r.block is None}
    lines = []
    for group in design.duplicates:
        answers = [
            r
            for treatment in group
            if (r := answered.get(frozenset(treatment.levels.items()))) is not None
        ]
        for response in (r.name for r in design.responses if r.name != "seconds"):
            values = {record.value(response): record for record in answers}
            if len(values) > 1:
                texts = " and ".join(
                    f"{v:.6g} in {' / '.join(r.levels.values())} (case {r.case_id})"
                    for v, r in list(values.items())[:2]
                )
                lines.append(
                    f"cells with equal inputs have different answers: {response} is {texts}; make "
                    "the program repeatable, or give it a seed with [replicates] key and n"
                )
    return lines


# Surfaces over the numeric factors of a study's own runs.


def is_numeric(design: Design) -> bool:
    """Whether a surface over the ranges of a design answers its question."""
    kind = design.analysis.surface
    if kind == "auto" and design.scheme.kind not in (*SAMPLED, "listed"):
        return False
    return bool(design.ranges) and kind != "none"


def surfaces(
    design: Design, records: Sequence[Record], numerical: Sequence[NumericalUncertainty]
) -> tuple[FittedSurface, ...]:
    """Fit all responses over the ranges at every combination of levels, without unanswered runs."""
    if not is_numeric(design):
        return ()
    originals = [record for record in records if not is_same_run(record.extra)]
    places, sizes = labels_of(design), [len(labels) for labels in design.lists.values()]
    kind = design.analysis.surface
    if kind == "auto" and design.scheme.kind == "morris":
        kind = "morris"  # whose trajectories are of single runs
        originals = [record for record in originals if not is_repeat(record.extra)]
        treatment_index = {frozenset(t.levels.items()): n for n, t in enumerate(design.treatments)}
        originals.sort(key=lambda record: treatment_index[frozenset(record.levels.items())])
    units_of = {name: span.unit for name, span in design.ranges.items()}
    surfaces_fitted: list[FittedSurface] = []
    for response in design.responses:
        # of a run: of its mesh where one was refined, and of its load steps
        meshes = [row.u_num for row in numerical
                  if row.response == response.name and row.u_num is not None]  # fmt: skip
        steps = u_of_steps(records, response.name, "none")
        half_width = max(meshes) + steps if meshes else None
        makers, lost, ends = makers_of_runs(design, response.name, originals, half_width)
        # each of two settings may be off by its own bound
        bound = None if half_width is None else 2.0 * half_width
        each = surfaces_at(
            FittedSurface(response.name, response.unit, None, bound=bound, units=units_of),
            places, sizes, kind, makers, response.practical,
        )  # fmt: skip
        surfaces_fitted += compared(
            [_finished(design, runs, n, ends) for runs, n in zip(each, lost, strict=True)]
        )
    return tuple(surfaces_fitted)


def labels_of(design: Design) -> list[dict[str, str]]:
    """Every combination of labels of the factors that are no numbers."""
    combinations = itertools.product(*design.lists.values())
    return [dict(zip(design.lists, labels, strict=True)) for labels in combinations]


T = TypeVar("T", "Record", "Treatment")


def at_levels(records: Sequence[T], labels: Mapping[str, str]) -> list[T]:
    """Choose the records, or the cells, at a combination of labels."""
    return [r for r in records if all(r.levels[name] == label for name, label in labels.items())]


def makers_of_runs(
    design: Design, response: str, records: Sequence[Record], half_width: float | None = None
) -> tuple[list[Callable[[], Runs]], list[int], tuple[str, ...]]:
    """Makers of the runs at every combination of labels, how many have no answer, and notes."""
    factors, ends = _answered(design, response, records)
    here = [at_levels(records, labels) for labels in labels_of(design)]
    good = [[r for r in some if r.value(response) is not None] for some in here]
    lost = [len(some) - len(answered) for some, answered in zip(here, good, strict=True)]
    return [partial(runs_of_records, response, r, half_width, factors) for r in good], lost, ends


def _finished(
    design: Design, fitted: FittedSurface, lost: int, ends: Sequence[str]
) -> FittedSurface:
    """Add notes on the runs, and the effect of uncertain inputs."""
    if fitted.surface is None:
        return fitted
    left_out = f"{counted(lost)} without an answer left out; nothing is put in the place"
    notes = [*([left_out] if lost else []), *ends]
    uncertain = None
    if design.inputs:
        fixed = {
            n: usual_value(n, span, design.config)
            for n, span in design.ranges.items()
            if n not in design.inputs
        }
        try:
            uncertain = propagate(fitted.surface, design.inputs, fixed, design.seed)
        except StudyError as error:
            notes.insert(0, str(error))
    return replace(
        fitted, surface=fitted.surface.noted(*notes), uncertain=uncertain,
        inputs={name: span.words(fitted.units[name]) for name, span in design.inputs.items()},
    )  # fmt: skip


def coded_settings(factors: Sequence[NumericFactor], levels: Sequence[Mapping[str, str]]) -> Array:
    """Coded settings of some runs by their levels, such as ``"3 mm"`` or ``"3"``, shape (n, k)."""
    return np.column_stack([
        factor.coded(np.array([parse_number(at[factor.name].partition(" ")[0]) for at in levels]))
        for factor in factors
    ])  # fmt: skip


def _answered(
    design: Design, response: str, records: Sequence[Record]
) -> tuple[tuple[NumericFactor, ...], tuple[str, ...]]:
    """Ranges of a design without the ends where no run has an answer, and sentences about these.

    A surface beyond its last run is a guess, and where runs fail there may be nothing to guess.
    """
    factors = tuple(design.ranges.values())
    coded = coded_settings(factors, [record.levels for record in records])
    good = np.array([record.value(response) is not None for record in records], dtype=bool)
    if good.all() or not good.any():
        return factors, ()
    complete, ends = [], []
    for factor, every, its_values in zip(factors, coded.T, coded[good].T, strict=True):
        low, high = factor.low, factor.high
        # what is one share of the sample from an end is as near as runs are to each other
        near = 2.0 / len(records)
        if every.min() < its_values.min() and its_values.min() > near - 1.0:
            low = factor.setting(float(its_values.min()))
            ends.append(_end(factor.name, "below", low))
        if every.max() > its_values.max() and its_values.max() < 1.0 - near:
            high = factor.setting(float(its_values.max()))
            ends.append(_end(factor.name, "above", high))
        complete.append(replace(factor, low=low, high=high) if low < high else factor)
    return tuple(complete), tuple(ends)


def _end(name: str, side: str, value: float) -> str:
    return f"no run with {name} {side} {value:.4g} has an answer: nothing is said there"


def runs_of_records(
    response: str,
    records: Sequence[Record],
    half_width: float | None,
    factors: tuple[NumericFactor, ...],
) -> Runs:
    """Coded settings and responses; a numerical half-width is two standard uncertainties."""
    values = np.array([record.value(response) for record in records], dtype=np.float64)
    blocks = tuple(str(record.block) for record in records if record.block is not None)
    u = None if half_width is None else np.full(values.size, half_width / 2.0)
    coded = coded_settings(factors, [record.levels for record in records])
    return Runs(response, factors, coded, values, blocks, u)


# Numerical uncertainty of the effects of a study: what the verdicts are held against.


def stored_numerical(store: Store, cases: Mapping[str, str]) -> tuple[NumericalUncertainty, ...]:
    """Numerical uncertainty of a study: as its run found it, and then ``study converge``."""
    document = store.read_document(
        "numerical-cells", NumericalCells, lambda cells: fault_of_series(cells["rows"])
    )
    rows = store.read_rows("numerical", NumericalRow, fault_of_series)
    if document is not None and document["of"] == digest(cases):
        rows = [*rows, *document["rows"]]
    lists = ("mesh_size", "series")
    return tuple(
        NumericalUncertainty(**{k: tuple(v) if k in lists else v for k, v in row.items()})  # type: ignore[arg-type]
        for row in rows
    )


#: factors whose levels are meshes
MESH_FACTORS = ("model.mesh", "model.mesh_size")

#: meshes that a series needs
_NEEDED = 3


def numerical_bound(
    design: Design,
    numerical: Sequence[NumericalUncertainty],
    records: Sequence[Record],
    table: pd.DataFrame,
    response: str,
    transform: str,
) -> NumericalBound | None:
    """Bound of the numerical error of every difference of a response.

    Where the meshes are a factor, the study's own cells are the refinement series, averaged over
    its blocks; elsewhere the cells that were refined are, in the first block. A cell whose
    deformation is homogeneous has no mesh error. The load steps count by the largest change of
    the response in any case where every other load step is left out.
    """
    rows = [row for row in numerical if row.response == response]
    if not rows:
        return None
    cells = [
        (dict(treatment.levels), treatment.cell.problem.discretization)
        for treatment in design.treatments
    ]
    mesh, meshes = mesh_levels(design, records)
    names = [f.name for f in design.factors]
    if mesh is not None and meshes and set(meshes) <= set(table[mesh].astype(str)):
        names.remove(mesh)
        series = _own_series(rows, table, response, transform, names, mesh, meshes)
        finest = {mesh: meshes[-1]}
    else:
        series, finest = _refined_series(rows, names, transform, [c for c, _ in cells]), {}
    elements = {tuple(levels[n] for n in names): element for levels, element in cells}
    more = u_of_steps(records, response, transform)
    combinations = tuple(dict.fromkeys(tuple(levels[n] for n in names) for levels, _ in cells))
    named = {
        cell: replace(s, discretization=elements[cell])
        for cell, s in series.items()
        if elements.get(cell)
    }
    return SeriesBounds(tuple(names), combinations, named, elements, more, mesh, finest)


def _own_series(
    rows: Sequence[NumericalUncertainty],
    table: pd.DataFrame,
    response: str,
    transform: str,
    names: Sequence[str],
    mesh: str,
    meshes: Sequence[str],
) -> dict[Cell, CellSeries]:
    """Series of the columns of a study whose meshes are a factor, averaged over the blocks."""
    y = table[response]
    values = np.log(y.where(y > 0)) if transform == "log" else y
    labels = [table[name].astype(str) for name in (*names, mesh)]
    mean = values.groupby(labels, sort=False).mean()
    by_cell = {}
    for row in rows:
        if set(row.levels) != set(names) or len(row.series) < _NEEDED:
            continue
        cell = tuple(row.levels[name] for name in names)
        by_mesh = [float(mean.get((*cell, level), math.nan)) for level in meshes]
        if np.isfinite(by_mesh).all() and len(row.mesh_size) == len(by_mesh):
            studied = math.fsum(by_mesh) / len(by_mesh)
            by_cell[cell] = _cell_series(row, by_mesh, studied, transform)
    return by_cell


def _refined_series(
    rows: Sequence[NumericalUncertainty],
    names: Sequence[str],
    transform: str,
    cells: Sequence[Mapping[str, str]],
) -> dict[Cell, CellSeries]:
    """Series of the cells that were refined beside the study."""
    by_cell = {}
    for row in rows:
        values = row.series
        if transform == "log":
            values = tuple(math.log(v) for v in values if v > 0)
        if len(values) < 2 or len(values) != len(row.mesh_size) or min(row.mesh_size) <= 0:
            continue
        levels = {name: level for name, level in row.levels.items() if name in names}
        at = next((c for c in cells if levels.items() <= c.items()), None)
        if at is not None:
            cell = tuple(at[name] for name in names)
            by_cell[cell] = _cell_series(row, values, values[0], transform)
    return by_cell


def _cell_series(
    row: NumericalUncertainty, values: Sequence[float], studied: float, transform: str
) -> CellSeries:
    """Series of a cell from fine to coarse."""
    finest, reference = np.argsort(row.mesh_size), 1.0 if transform == "log" else None
    sizes, ordered = (tuple(of[i] for i in finest) for of in (row.mesh_size, values))
    return CellSeries(sizes, ordered, row.formal_order, studied=studied, reference=reference)


def u_of_steps(records: Sequence[Record], response: str, transform: str) -> float:
    """Largest uncertainty from load steps in the unit, as a share on the log scale; or 0."""
    entries = [r.responses[response] for r in records if r.converged and response in r.responses]
    pairs = [(u, e["value"]) for e in entries if (u := e.get("u_steps")) is not None]
    if transform == "log":
        pairs = [(u / abs(value), value) for u, value in pairs if value]
    return max((u for u, _ in pairs), default=0.0)


def mesh_levels(design: Design, records: Sequence[Record]) -> tuple[str | None, list[str]]:
    """Factor whose levels are meshes, and these from coarse to fine; none where no order is one."""
    names = (*MESH_FACTORS, design.converge.key)
    factors = [f.name for f in design.factors if f.name in names and len(f.levels) > 1]
    if len(factors) != 1:
        return None, []
    return factors[0], _ordered(design, records, factors[0])


def _ordered(design: Design, records: Sequence[Record], mesh: str) -> list[str]:
    """Meshes from coarse to fine; none where that order differs between columns."""
    if mesh == design.converge.key:
        sizes = {t.levels[mesh]: t.cell.problem.parameters[mesh.partition(".")[2]]
                 for t in design.treatments}  # fmt: skip
        ordered = sorted(sizes, key=lambda label: -float(sizes[label]))
        return ordered if len(ordered) >= _NEEDED else []
    columns: dict[tuple[tuple[str, str], ...], dict[str, float]] = {}
    for record in records:
        size = record.mesh.get("mesh_size_mm")
        if record.converged and size:
            key = tuple(sorted((k, v) for k, v in record.levels.items() if k != mesh))
            columns.setdefault(key, {})[record.levels[mesh]] = float(size)
    longest = max((len(sizes) for sizes in columns.values()), default=0)
    orders = {
        tuple(sorted(sizes, key=lambda level: -sizes[level]))
        for sizes in columns.values()
        if len(sizes) == longest
    }
    return list(orders.pop()) if len(orders) == 1 and longest >= _NEEDED else []


# The cases of a study as their failures are looked at: by level, or by part of a range.

#: equal parts of a range in whose stead its settings stand, where these are as good as all
#: different: no setting of a Latin hypercube stands twice, so that none could be blamed
PARTS = 4
#: most settings of a range that are levels of their own
GRID = 5


def fates(design: Design, records: Sequence[Record]) -> list[CaseFate]:
    """Collect the settings of every case that ended, and whether it failed."""
    parts = {
        factor.name: parts_of(factor, factor.span)
        for factor in design.factors
        if factor.span is not None and len(factor.levels) > GRID
    }
    return [
        CaseFate(
            {name: parts.get(name, {}).get(level, level) for name, level in record.levels.items()},
            record.block or "",
            not record.converged,
            "" if record.converged else cause(record.status, record.message),
        )
        for record in records
    ]


def parts_of(factor: Factor, span: NumericFactor) -> Mapping[str, str]:
    """Part of a range that the setting of every label lies in, by its ends in words."""
    ends = [span.at(k / PARTS) for k in range(PARTS + 1)]
    unit = f" {span.unit}" if span.unit else ""
    words = [f"{low:.4g} to {high:.4g}{unit}" for low, high in zip(ends, ends[1:], strict=False)]
    return {
        label: words[sum(value >= end for end in ends[1:-1])]
        for label, value in factor.settings.items()
    }


def unit_of(design: Design, manifest: Mapping[str, Any]) -> str:
    """Say what a block is: a column of the measurements or of imported runs, a marked state."""
    spec = design.identification.measurements
    if spec is not None:
        return spec.block or "block"
    return manifest.get("unit") or ("state" if "markers" in design.config else "block")
