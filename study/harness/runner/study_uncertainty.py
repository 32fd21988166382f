"""What a study's numbers owe to its discretization: meshes refined, spaces compared."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from study.ground.arrays import Array
from study.ground.canonical import digest
from study.ground.errors import StoreError
from study.harness.record.document import NumericalCells, NumericalRow, fault_of_series
from study.harness.runner import study_refinement
from study.harness.runner.batch import Progress, computed, run_batch
from study.harness.runner.case_series import COSTS, PLACES, CaseSeries, places_of, refine_cases
from study.harness.runner.solve_task import SolveResult, by_workers, kept
from study.harness.runner.study_refinement import input_shares, input_work, physics_of
from study.statistics.convergence.contrast_bound import CellSeries, NumericalBound, SeriesBounds
from study.statistics.convergence.grid_convergence import NumericalUncertainty, compare

if TYPE_CHECKING:
    import pandas as pd

    from study.ground.curve import Curve
    from study.harness.design.spec import Design
    from study.harness.execution.task import Executor
    from study.harness.record.record import Record
    from study.harness.record.store import Store
    from study.harness.runner.job import CaseJob, Work


def refine(
    work: Work, store: Store, executor: Executor, progress: Callable[[Progress], None]
) -> None:
    """Compute the refined cases and store what they say of every response."""
    series = study_refinement.study_series(work, store.on_demand(work.input_hashes))
    refine_cases(series, partial(computed, work, store, executor, progress))
    with store.lock():
        store.write_rows("numerical", [asdict(row) for row in uncertainties(work, series)])


def uncertainties(work: Work, series: Sequence[CaseSeries]) -> list[NumericalUncertainty]:
    """Numerical uncertainty of every response that a study asks for, by series."""
    names = [response.name for response in work.design.responses if response.name not in COSTS]
    return [
        case_series.uncertainty(name, work.responses[name])
        for case_series in series
        for name in names
    ]


def compare_spaces(
    work: Work, store: Store, executor: Executor, progress: Callable[[Progress], None]
) -> None:
    """Solve the equivalent cylinder of a block in both spaces, where a study holds both."""
    pairs = study_refinement.pairs(work, store.on_demand(work.input_hashes))
    if not pairs:
        return
    began, results = time.monotonic(), dict[str, SolveResult]()
    # the solids take longest: all of them first
    tasks = [tasks[k] for k in (1, 0) for _, tasks in pairs]
    unsolved = {task.key for task in tasks if store.read_solution(task.key) is None}
    for key, result in kept(by_workers(executor), store)(tasks):
        results[key] = result
        if key in unsolved:
            done, seconds = len(unsolved & results.keys()), time.monotonic() - began
            label = "one cylinder in both spaces, a control"
            progress(Progress(done, len(unsolved), 0, seconds, label))
    rows = [
        study_refinement.compared(pair, *(results[task.key] for task in pair[1])) for pair in pairs
    ]
    with store.lock():
        store.write_rows("spaces", rows)


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
Cell = tuple[str, ...]


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
    mesh = mesh_factor(design)
    meshes = None if mesh is None else _ordered(design, records, mesh)
    names = [f.name for f in design.factors]
    if mesh is not None and meshes is not None and set(meshes) <= set(table[mesh].astype(str)):
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
    u_by_cell = {}
    for row in rows:
        if set(row.levels) != set(names) or len(row.series) < _NEEDED:
            continue
        cell = tuple(row.levels[name] for name in names)
        by_mesh = [float(mean.get((*cell, level), math.nan)) for level in reversed(meshes)]
        if np.isfinite(by_mesh).all() and len(row.mesh_size) == len(by_mesh):
            u_by_cell[cell] = CellSeries(
                tuple(reversed(row.mesh_size)),
                tuple(by_mesh),
                row.formal_order,
                studied=math.fsum(by_mesh) / len(by_mesh),
                reference=1.0 if transform == "log" else None,
            )
    return u_by_cell


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
        if at is None:
            continue
        finest = np.argsort(row.mesh_size)
        by_cell[tuple(at[name] for name in names)] = CellSeries(
            tuple(row.mesh_size[i] for i in finest),
            tuple(values[i] for i in finest),
            row.formal_order,
            studied=values[0],
            reference=1.0 if transform == "log" else None,
        )
    return by_cell


def u_of_steps(records: Sequence[Record], response: str, transform: str) -> float:
    """Largest uncertainty from load steps in the unit, on the log scale by shares; or 0."""
    entries = [r.responses[response] for r in records if r.converged and response in r.responses]
    pairs = [(u, e["value"]) for e in entries if (u := e.get("u_steps")) is not None]
    if transform != "log":
        return max((u for u, _ in pairs), default=0.0)
    shares = [u / abs(value) for u, value in pairs if value]
    return max(shares) * _geometric_mean(records, response) if any(shares) else 0.0


def mesh_factor(design: Design) -> str | None:
    """Name of the factor whose levels are meshes; None without, or with several."""
    names = (*MESH_FACTORS, design.converge.key)
    found = [f.name for f in design.factors if f.name in names and len(f.levels) > 1]
    return found[0] if len(found) == 1 else None


def finest_mesh(design: Design, records: Sequence[Record]) -> tuple[str, str] | None:
    """Factor whose levels are meshes, and its finest level; None without, or with no one order."""
    mesh = mesh_factor(design)
    meshes = None if mesh is None else _ordered(design, records, mesh)
    return None if mesh is None or meshes is None else (mesh, meshes[-1])


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


# Comparison with the measurements, E +- u_val, of every case of a study (ASME V&V 20-2009).


def validate(
    work: Work, store: Store, executor: Executor, progress: Callable[[Progress], None]
) -> list[dict[str, object]]:
    """Move the uncertain inputs, compare every case, and store the rows as ``validation``."""
    moved = input_work(work)
    if moved.jobs:
        run_batch(moved, store, executor, progress)
    rows = compared(work, moved, store)
    with store.lock():
        store.write_rows("validation", rows)
    return rows


def compared(work: Work, moved: Work, store: Store) -> list[dict[str, object]]:
    """One row for every case: E and its uncertainty along the curve, places in mm."""
    records = store.by_case({**work.input_hashes, **moved.input_hashes})
    inputs, mesh = input_shares(work, moved, records), _mesh_shares(work, records, store)
    rows = []
    for job in work.jobs:
        record = records.get(job.case.case_id)
        if record is None or not record.converged:
            continue
        # where the deformation is the same everywhere no mesh matters
        share = np.zeros(PLACES.size) if job.case.problem.is_homogeneous else mesh(job)
        relabeled_record = replace(record, levels=job.case.levels)
        physics = inputs.get(physics_of(job.case.levels))
        rows.append(_row(relabeled_record, share, physics, work.design.uncertainty))
    return rows


def _mesh_shares(
    work: Work, records: Mapping[str, Record], store: Store
) -> Callable[[CaseJob], Array | None]:
    """Look up the relative u_num of a case: of its own column, or of its kind of discretization."""
    series = study_refinement.own_series(work, records)
    finest = bool(series)
    series = series or study_refinement.chosen_series(work, records)
    stored = store.by_case(
        {j.case.case_id: j.input_hash for case_series in series for j in case_series.every}
    )

    def key(job: CaseJob) -> object:
        """Levels of a case, whatever its block; or its kind of discretization."""
        of_kind = study_refinement.discretization_key
        return frozenset(job.case.levels.items()) if finest else of_kind(job.case.problem)

    shares: dict[object, Array | None] = {}
    for case_series in series:
        case_series.records.update(stored)
        share = case_series.shares()
        jobs = case_series.jobs if finest else (case_series.base,)
        shares |= {key(job): share.get(job.case.case_id) for job in jobs}
    return lambda job: shares.get(key(job))


def _row(
    record: Record, mesh: Array | None, inputs: Array | None, uncertainty: Mapping[str, float]
) -> dict[str, object]:
    fact, pair = next(iter(record.scores), None), record.first_pair()
    if fact is None or pair is None:
        raise StoreError(
            f"case {record.case_id}: its record has an answer and no curve beside a measured one; "
            "delete its folder below cases and run the design again"
        )
    measured, predicted = pair
    d = places_of(measured)
    force = predicted.force_at(d)
    u = {
        "numerics": None if mesh is None else mesh * np.abs(force),
        "inputs": None if inputs is None else inputs * np.abs(force),
        "data": _data(measured, d, fact.get("scatter_N"), uncertainty),
    }
    agreement = compare(d, force, measured.force_at(d), u)
    facts = {"case_id": record.case_id, "levels": dict(record.levels), "block": record.block}
    return facts | {"label": fact["score"], "role": fact["role"]} | agreement


def _data(
    measured: Curve,
    d: Array,
    scatter: Sequence[float | None] | None,
    uncertainty: Mapping[str, float],
) -> Array | None:
    """Add up the standard uncertainty of the measured force: single repeats, and the gauges.

    The scatter is that of one repeat, not of their mean: repeats on one specimen are no
    independent evidence.
    """
    parts = []
    if scatter is not None:
        parts.append(np.interp(d, measured.displacement_mm, np.asarray(scatter, float)))
    if uncertainty.get("measurements.force"):
        parts.append(np.full(d.size, float(uncertainty["measurements.force"])))
    if uncertainty.get("measurements.displacement"):
        slope = np.gradient(measured.force_at(d), d)
        parts.append(np.abs(slope) * float(uncertainty["measurements.displacement"]))
    return np.sqrt(np.sum(np.square(parts), axis=0)) if parts else None
