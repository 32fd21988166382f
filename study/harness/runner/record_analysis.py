"""Statistics on the records of a study: rows and question of each response, as its design says.

With them goes the numerical uncertainty of its effects: what the verdicts are held against.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, cast

import numpy as np

from study.ground.canonical import digest
from study.ground.errors import InputError
from study.ground.tabular import names_of
from study.harness.design.load import is_constant
from study.harness.record.document import NumericalCells, NumericalRow, fault_of_series
from study.harness.record.record import answered_often, table
from study.statistics.analysis.analysis_request import (
    AnalysisRequest,
    Blocking,
    ResponseScale,
    threshold,
)
from study.statistics.analysis.anova import analyze, effects
from study.statistics.analysis.linear_model import Model, terms_of
from study.statistics.analysis.repeats import common_seeds
from study.statistics.convergence.contrast_bound import CellSeries, NumericalBound, SeriesBounds
from study.statistics.convergence.grid_convergence import NumericalUncertainty

if TYPE_CHECKING:
    import pandas as pd

    from study.harness.design.spec import Design
    from study.harness.design.study_file import ResponseSpec
    from study.harness.record.record import Record
    from study.harness.record.store import Store
    from study.statistics.analysis.analysis_request import AnovaOptions
    from study.statistics.analysis.analysis_result import AnalysisResult
    from study.statistics.analysis.anova_table import Effect


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
    return analyze(rows, request).noted(*notes)


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
    """Rows to analyze, what is asked of them, and what was left out of them."""
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
        ResponseScale(given["transform"], threshold(given["practical"]),
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
        kept = table.drop(columns=_RUN)
        return RecordRows(kept, block, how, "runs")
    if _NOISE in table:
        return _noise_rows(table, response, factors, error, block)
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
    table: pd.DataFrame, response: str, factors: Sequence[str], error: str, block: str | None
) -> RecordRows:
    """Rows of the refits to resampled noise, or of the fits to the measured curves."""
    by_replicates = error == "replicates"
    how = "auto" if by_replicates else error
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
    meshes: tuple[str, list[str]] | None = None,
) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """Rows without the levels of which half of the cells or more have no answer.

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
    fine = None if meshes is None else (factors.index(meshes[0]), meshes[1][-1])
    notes = []
    while (worst := _worst(designed, answered, terms, fine)) is not None:
        place, level = worst
        cells_here = [cell for cell in designed if cell[place] == level]
        has = sum(cell in answered for cell in cells_here)
        notes.append(
            f"{level} ({factors[place]}) has an answer in {has} of {len(cells_here)} cells: it is "
            "left out of this analysis"
        )
        designed = [cell for cell in designed if cell[place] != level]
        table = table[table[factors[place]].astype(str) != level]
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
            for place, level in zip(term, empty, strict=True):
                if len({cell[place] for cell in designed}) > _FEWEST:
                    cells = [cell for cell in designed if cell[place] == level]
                    on_finest = [cell for cell in cells if fine and cell[fine[0]] == fine[1]]
                    share = sum(cell in answered for cell in cells) / len(cells)
                    if share <= 0.5 or (on_finest and answered.isdisjoint(on_finest)):
                        shares[place, level] = 1 - share
    return max(sorted(shares), key=lambda key: shares[key], default=None)


# Numerical uncertainty of the effects of a study: what the verdicts are held against.


def stored_numerical(store: Store, cases: Mapping[str, str]) -> tuple[NumericalUncertainty, ...]:
    """Numerical uncertainty of a study: as its run found it, and then ``study converge``."""
    document = store.read_document(
        "numerical-cells", NumericalCells, lambda cells: fault_of_series(cells["rows"])
    )
    rows = store.read_rows("numerical", NumericalRow, fault_of_series)
    if document is not None and document["of"] == digest(cases):
        rows = [*rows, *document["rows"]]
    return tuple(
        NumericalUncertainty(
            row["levels"], row["response"], row["value"], row["u_num"], row["unit"],
            row["behaviour"], row["note"], tuple(row.get("mesh_size", ())),
            tuple(row.get("series", ())), row.get("formal_order"), row.get("formal_reason", ""),
        )
        for row in rows
    )  # fmt: skip


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
    cells = [(dict(one.levels), one.cell.problem.discretization) for one in design.treatments]
    mesh, meshes = mesh_levels(design, records) or (None, [])
    names = [f.name for f in design.factors]
    if mesh is not None and set(meshes) <= set(table[mesh].astype(str)):
        names.remove(mesh)
        series = _own_series(rows, table, response, transform, names, mesh, meshes)
        finest = {mesh: meshes[-1]}
    else:
        series, finest = _refined_series(rows, names, transform, [c for c, _ in cells]), {}
    elements = {tuple(levels[n] for n in names): element for levels, element in cells}
    more = u_of_steps(records, response, transform)
    if transform == "log" and more:
        more /= _geometric_mean(records, response)
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
    """Largest uncertainty from load steps in the unit, on the log scale by shares; or 0."""
    entries = [r.responses[response] for r in records if r.converged and response in r.responses]
    pairs = [(u, e["value"]) for e in entries if (u := e.get("u_steps")) is not None]
    if transform != "log":
        return max((u for u, _ in pairs), default=0.0)
    shares = [u / abs(value) for u, value in pairs if value]
    return max(shares) * _geometric_mean(records, response) if any(shares) else 0.0


def mesh_levels(design: Design, records: Sequence[Record]) -> tuple[str, list[str]] | None:
    """Factor whose levels are meshes, from coarse to fine; None without, or with no one order."""
    names = (*MESH_FACTORS, design.converge.key)
    factors = [f.name for f in design.factors if f.name in names and len(f.levels) > 1]
    meshes = _ordered(design, records, factors[0]) if len(factors) == 1 else None
    return None if meshes is None else (factors[0], meshes)


def _ordered(design: Design, records: Sequence[Record], mesh: str) -> list[str] | None:
    """Meshes from coarse to fine; None where that order differs between columns."""
    if mesh == design.converge.key:
        sizes = {t.levels[mesh]: t.cell.problem.parameters[mesh.partition(".")[2]]
                 for t in design.treatments}  # fmt: skip
        ordered = sorted(sizes, key=lambda label: -float(sizes[label]))
        return ordered if len(ordered) >= _NEEDED else None
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
    return list(orders.pop()) if len(orders) == 1 and longest >= _NEEDED else None


def _geometric_mean(records: Sequence[Record], response: str) -> float:
    values = [r.response(response) for r in records]
    positive = [math.log(v) for v in values if math.isfinite(v) and v > 0]
    return math.exp(math.fsum(positive) / len(positive))
