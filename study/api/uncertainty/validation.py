"""Comparison with the measurements, E +- u_val, of every case of a study (ASME V&V 20-2009)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from study.analysis.convergence.validation import compare
from study.arrays import Array
from study.errors import StoreError
from study.runner.batch import run_batch
from study.runner.numerical import study_refinement
from study.runner.numerical.case_series import PLACES, places_of
from study.runner.numerical.input_uncertainty import input_shares, input_work, physics_of

if TYPE_CHECKING:
    from study.curve import Curve
    from study.execution.task import Executor
    from study.record.record import Record
    from study.record.store import Store
    from study.runner.batch import Progress
    from study.runner.job import CaseJob, Work


def validate(
    work: Work,
    store: Store,
    jobs: int | None = None,
    progress: Callable[[Progress], None] | None = None,
    timeout_s: float | None = None,
    executor: Executor | None = None,
) -> list[dict[str, object]]:
    """Move the uncertain inputs, compare every case, and store the rows as ``validation``.

    Parameters
    ----------
    work : Work
        A study whose cases and refinement are computed.
    store : Store
        Its results.
    jobs : int, optional
        Worker processes; one a core by default.
    progress : callable, optional
        Called after every computation.
    timeout_s : float, optional
        Wall-clock limit of one computation in seconds.
    executor : Executor, optional
        Where cases are computed; by default ``jobs`` processes of this machine.

    Returns
    -------
    list of dict
        Of :func:`compared`.
    """
    moved = input_work(work)
    if moved.jobs:
        run_batch(
            moved, store, jobs=jobs, progress=progress, timeout_s=timeout_s, executor=executor
        )
    rows = compared(work, moved, store)
    with store.lock():
        store.write_rows("validation", rows)
    return rows


def compared(work: Work, moved: Work, store: Store) -> list[dict[str, object]]:
    """One row for every case: E and its uncertainty along the curve.

    Parameters
    ----------
    work : Work
        The study.
    moved : Work
        Some of its cases again, each with one input moved by its standard uncertainty.
    store : Store
        Results with the records of both.

    Returns
    -------
    list of dict
        Forces and uncertainties in N at displacements in mm, with case id, levels and block; cases
        without an answer are left out.
    """
    records = store.by_case({**work.input_hashes, **moved.input_hashes})
    inputs, mesh = input_shares(work, moved, records), _mesh_shares(work, records, store)
    rows = []
    for job in work.jobs:
        record = records.get(job.case.case_id)
        if record is None or not record.converged:
            continue
        # where the deformation is the same everywhere no mesh matters
        share = np.zeros(PLACES.size) if job.case.setup.is_homogeneous else mesh(job)
        own = replace(record, levels=job.case.levels)
        physics = inputs.get(physics_of(job.case.levels))
        rows.append(_row(own, share, physics, work.design.uncertainty))
    return rows


def _mesh_shares(
    work: Work, records: Mapping[str, Record], store: Store
) -> Callable[[CaseJob], Array | None]:
    """Look up the relative u_num of a case: of its own column, or of its kind of discretization.

    Where the meshes are a factor nothing was refined, and the study's own cases are the series.
    """
    series = study_refinement.own_series(work, records)
    finest = bool(series)
    series = series or study_refinement.chosen_series(work, records)
    known = store.by_case({j.case.case_id: j.input_hash for one in series for j in one.every})
    for one in series:
        one.records.update(known)
    if finest:
        own = {case: share for one in series for case, share in one.shares().items()}
        of_cell = {_cell(job): own.get(job.case.case_id) for one in series for job in one.jobs}
        return lambda job: of_cell.get(_cell(job))
    of_model = {}
    for one in series:
        share = one.shares().get(one.base.case.case_id)
        of_model[study_refinement.discretization_key(one.base.case.config)] = share
    return lambda job: of_model.get(study_refinement.discretization_key(job.case.config))


def _cell(job: CaseJob) -> frozenset[tuple[str, str]]:
    """Levels of a case, whatever its block."""
    return frozenset(job.case.levels.items())


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
    found = compare(
        d, force, measured.force_at(d),
        None if mesh is None else mesh * np.abs(force),
        None if inputs is None else inputs * np.abs(force),
        _data(measured, d, fact.get("scatter_N"), uncertainty),
    )  # fmt: skip
    facts = {"case_id": record.case_id, "levels": dict(record.levels), "block": record.block}
    return facts | {"label": fact["score"], "role": fact["role"]} | found.to_json()


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
