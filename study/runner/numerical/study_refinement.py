"""Refinement of the mesh under a study: the numerical uncertainty of its responses.

Cells of every kind of discretization are computed again in the first block, calibration and
all, on finer meshes: a change of the constants and of the score is what a finer mesh would
have changed in the study. Only cells whose deformation is not homogeneous have a mesh error.
All of them are refined where that is cheap, and at least two elsewhere: a difference of cells
is bounded by its own series, or by the scatter of the error over those that were refined.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from study.analysis.convergence.grid_convergence import Numerical, grid_convergence
from study.canonical import digest
from study.design.cases import case_id, plain
from study.design.spec import Case, Design
from study.record.record import Record
from study.runner.cost import Costs
from study.runner.expansion import case_job
from study.runner.job import CaseJob, FitJob, Work
from study.runner.numerical.formal_order import base_size_mm, formal_of_case
from study.runner.numerical.judgement import series_sizes

PURPOSE = "refinement"

#: a third mesh is computed where the second is predicted to take less than this
CHEAP_S = 20.0

#: seconds for which all cells of one discretization may be refined; a few are beyond that
ALL_CELLS_S = 60.0

#: cells of one discretization that are refined where all of them would take too long
FEW_CELLS = 2

#: observed order where only two meshes exist: bonded corners limit it to one
ASSUMED_ORDER = 1.0

#: an observed order below this says that the meshes are not in the asymptotic range
MIN_ORDER = 0.5

#: safety factors of the grid convergence index with two meshes (Roache 1994, ASME JFE 116, 405)
TWO_MESH_FACTOR = 3.0


def refinement_work(work: Work, bases: Sequence[CaseJob] = ()) -> Work:
    """List the refined cases of a study, as work like any other.

    Parameters
    ----------
    work : Work
        The study.
    bases : sequence of CaseJob
        Cases to be refined as often as ``[converge] levels`` says; by default those of
        :func:`chosen`, twice where that is cheap and once elsewhere.
    """
    fits: dict[str, FitJob] = {}
    jobs: list[CaseJob] = []
    costs = Costs()
    for base in bases or chosen(work):
        size = base_size_mm(base.case)
        finer = max(2, work.design.converge.levels - 1)
        if not bases:
            finer = _levels(work.design, base.case, size, costs)
        for level in range(1, finer + 1):
            case = _refined(base.case, size / work.design.converge.ratio**level)
            facts = {"purpose": PURPOSE, "of": base.case.case_id, "level": level}
            jobs.append(case_job(case, work.data, fits, work.responses, facts))
    return replace(work, jobs=tuple(jobs), fits=fits)


def chosen(work: Work) -> list[CaseJob]:
    """Choose cases of every kind of discretization, in the first block, before any result is seen.

    All of a kind where that is cheap; else those of fewest and of most constants, which the mesh
    can move most differently.
    """
    groups: dict[str, list[CaseJob]] = {}
    for job in meshed_cells(work):
        groups.setdefault(discretization_key(job.case.config), []).append(job)
    costs, ratio = Costs(), work.design.converge.ratio
    found = []
    for jobs in groups.values():
        twice = _refined(jobs[0].case, base_size_mm(jobs[0].case) / ratio**2)
        if len(jobs) * costs.solve_seconds(twice.config) <= ALL_CELLS_S:
            found += jobs
            continue
        ordered = sorted(jobs, key=_constants)
        spread = np.linspace(0, len(ordered) - 1, min(FEW_CELLS, len(ordered)))
        found += [ordered[round(i)] for i in spread]
    return found


def every_cell(work: Work) -> list[CaseJob]:
    """List the case of every cell in the first block."""
    return [job for job in work.jobs if job.case.block in (None, *work.blocks[:1])]


def meshed_cells(work: Work) -> list[CaseJob]:
    """List those whose answer depends on a mesh: their deformation is not homogeneous."""
    return [job for job in every_cell(work) if not job.case.setup.is_homogeneous]


def numerical(
    work: Work,
    refinement: Work,
    records: Mapping[str, Record],
    responses: Sequence[str],
    bases: Sequence[CaseJob] = (),
) -> list[Numerical]:
    """Uncertainty of every response for every kind of discretization.

    Parameters
    ----------
    records : mapping of str to Record
        Records of the study and of its refinement, by case id.
    responses : sequence of str
        Names of the responses wanted.
    bases : sequence of CaseJob
        Cells that were refined by name; their rows carry all their levels.
    """
    found = []
    for base in bases or chosen(work):
        series = [records.get(base.case.case_id)]
        series += [
            records.get(job.case.case_id)
            for job in refinement.jobs
            if job.extra.get("of") == base.case.case_id
        ]
        levels = dict(base.case.levels)
        found += [_one(work, base, series, name, levels) for name in responses if name != "seconds"]
    return found


def _one(
    work: Work,
    base: CaseJob,
    series: Sequence[Record | None],
    name: str,
    levels: Mapping[str, str],
) -> Numerical:
    good = [(k, r) for k, r in enumerate(series) if r is not None and r.converged]
    values = [(k, r.responses.get(name, {}).get("value")) for k, r in good]
    known = [(k, float(v)) for k, v in values if v is not None]
    ratio, unit = work.design.converge.ratio, work.responses.get(name, "")
    where = base.case.label
    if not known or known[0][0] != 0 or len(known) < 2:
        note = f"no second mesh gave an answer ({where})"
        value = known[0][1] if known and known[0][0] == 0 else None
        return Numerical(levels, name, value, None, unit, "not available", note)
    dofs = " to ".join(str(int(r.mesh.get("dofs", 0))) for _, r in (good[0], good[-1]))
    note = f"{where}; {len(known)} meshes of ratio {ratio:g}, {dofs} unknowns"
    sizes = record_sizes([dict(good)[k] for k, _ in known], base)
    numbers = tuple(v for _, v in known)
    real, formal = ratio_of(sizes, ratio), formal_of_case(base)
    behaviour, u = "two meshes", two_mesh_uncertainty(numbers[0], numbers[1], real)
    if len(known) > 2:
        behaviour, u = series_uncertainty(numbers, ratio, sizes, formal.order)
    return Numerical(
        levels, name, numbers[0], u, unit, behaviour, note, sizes, numbers, formal.order, formal.why
    )


def two_mesh_uncertainty(coarse: float, fine: float, ratio: float) -> float:
    """Half-width for the coarser of two meshes: factor 3 on first-order extrapolation.

    Examples
    --------
    >>> round(two_mesh_uncertainty(1.1, 1.0, 2.0), 10)
    0.6
    """
    error = abs(coarse - fine) / (1 - ratio**-ASSUMED_ORDER)
    return float(TWO_MESH_FACTOR * error)


def record_sizes(found: Sequence[Record], base: CaseJob) -> tuple[float, ...]:
    """Mesh sizes of a series by the elements of its meshes, the first as it was asked for."""
    sizes = [float(record.mesh.get("mesh_size_mm", 0.0)) for record in found]
    elements = [int(record.mesh.get("elements", 0)) for record in found]
    return tuple(series_sizes(sizes, elements, base.case.config, anchor=0))


def ratio_of(sizes: Sequence[float], asked: float) -> float:
    """Ratio that the two first meshes really have, or the one asked for where that is unknown."""
    known = len(sizes) > 1 and sizes[1] > 0 and sizes[0] > sizes[1]
    return sizes[0] / sizes[1] if known else asked


def series_uncertainty(
    values: Sequence[float],
    ratio: float,
    sizes: Sequence[float] = (),
    formal: float | None = None,
) -> tuple[str, float]:
    """Behaviour of a series from coarse to fine, and half-width for its coarsest mesh.

    Where the series converges with an order of its own, the distance to the extrapolated
    value counts, with the factor of the grid convergence index; elsewhere thrice the range of
    the values (Eca and Hoekstra 2014, J. Comput. Phys. 262, 104, for series without an order).

    Examples
    --------
    >>> behaviour, u = series_uncertainty([1.4, 1.2, 1.1], 2.0, formal=1.0)
    >>> behaviour, round(u, 6)
    ('monotone', 0.5)
    >>> behaviour, u = series_uncertainty([1.4, 1.2, 1.1], 2.0)  # without a formal order: thrice
    >>> round(u, 6)
    1.2
    """
    usable = len(set(sizes)) == len(values) and all(size > 0 for size in sizes)
    nominal = [ratio**-k for k in range(len(values))]
    found = grid_convergence(sizes if usable else nominal, values, formal_order=formal)
    ordered = found.observed_order is not None and found.observed_order >= MIN_ORDER
    if ordered and found.extrapolated is not None and found.factor_of_safety is not None:
        error = abs(values[0] - found.extrapolated)
        return found.behaviour, float(found.factor_of_safety * error)
    if found.behaviour == "noise-floor":
        return found.behaviour, abs(values[0] - values[-1])
    return found.behaviour, TWO_MESH_FACTOR * (max(values) - min(values))


def _levels(design: Design, case: Case, size: float, costs: Costs) -> int:
    """Count the refinements: two where the second is cheap, one elsewhere."""
    twice = _refined(case, size / design.converge.ratio**2)
    return 2 if costs.solve_seconds(twice.config) < CHEAP_S else 1


def _refined(case: Case, size: float) -> Case:
    """Copy a case with another mesh; everything else, the block too, stays."""
    model = {**case.config["model"], "mesh": None, "mesh_size_mm": size}
    config = {**case.config, "model": model}
    own = (config.get("calibration") or {}).get("problem")
    if own:
        changed = {**own, "model": {**own["model"], "mesh": None, "mesh_size_mm": size}}
        config["calibration"] = {**config["calibration"], "problem": changed}
    name = case_id({**config, "block": case.block, "purpose": PURPOSE})
    return replace(case, config=config, case_id=name)


def discretization_key(config: Mapping[str, Any]) -> str:
    """Name of a kind of discretization: cells that share it share their mesh error."""
    return case_id(_discretization(config))


def _discretization(config: Mapping[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in config["model"].items() if k not in ("mesh_ratio", "mesh_seed")}


def _constants(job: CaseJob) -> int:
    return len(job.case.material.calibrated_names)


#: keys of a model that choose its mesh
_MESH_KEYS = ("mesh", "mesh_size_mm", "mesh_ratio", "mesh_seed")

#: meshes that an order needs
_NEEDED = 3


def columns(work: Work) -> list[list[CaseJob]]:
    """Cases of the first block that differ in their mesh alone, from coarse to fine.

    Empty unless every column of the study has its three meshes.
    """
    found: dict[str, list[CaseJob]] = {}
    for job in meshed_cells(work):
        found.setdefault(_column(job.case.config), []).append(job)
    series = [sorted(jobs, key=lambda job: -base_size_mm(job.case)) for jobs in found.values()]
    return series if all(len(jobs) >= _NEEDED for jobs in series) else []


def _column(config: Mapping[str, Any]) -> str:
    """Name of a column: everything but the mesh, that of the calibration left out too."""
    own = (config.get("calibration") or {}).get("problem") or {}
    rest = {k: v for k, v in config.items() if k not in ("model", "calibration")}
    return digest([plain(rest), _meshless(config["model"]), _meshless(own.get("model") or {})])


def _meshless(model: Mapping[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in model.items() if k not in _MESH_KEYS}


def numerical_of_columns(
    series: Sequence[Sequence[CaseJob]],
    records: Mapping[str, Record],
    responses: Mapping[str, str],
) -> list[Numerical]:
    """Uncertainty of every response on the finest mesh of every column.

    Parameters
    ----------
    series : sequence of sequence of CaseJob
        As :func:`columns` gives them.
    records : mapping of str to Record
        Records of the study by case id.
    responses : mapping of str to str
        Units by name.
    """
    return [
        _of_column(jobs, records, name, unit)
        for jobs in series
        for name, unit in responses.items()
        if name != "seconds"
    ]


def _of_column(
    jobs: Sequence[CaseJob], records: Mapping[str, Record], name: str, unit: str
) -> Numerical:
    finest = jobs[-1]
    levels = _shared_levels(jobs)
    found = [records.get(job.case.case_id) for job in jobs]
    good = [r for r in found if r is not None and r.converged]
    known = [r.responses.get(name, {}).get("value") for r in good]
    values = tuple(float(v) for v in known if v is not None)
    if len(values) < len(jobs):
        note = f"{len(values)} of {len(jobs)} meshes gave an answer"
        return Numerical(levels, name, None, None, unit, "not available", note)
    sizes, formal = record_sizes(good, jobs[0]), formal_of_case(finest)
    behaviour, u = fine_uncertainty(values, sizes, formal.order)
    dofs = " to ".join(str(int(r.mesh.get("dofs", 0))) for r in (good[0], good[-1]))
    note = f"the study's own {len(values)} meshes, {dofs} unknowns; on the finest"
    return Numerical(
        levels, name, values[-1], u, unit, behaviour, note, sizes, values, formal.order, formal.why
    )


def _shared_levels(jobs: Sequence[CaseJob]) -> dict[str, str]:
    """Levels that all cells of a column have."""
    first, last = jobs[0].case.levels, jobs[-1].case.levels
    return {name: level for name, level in first.items() if last[name] == level}


def fine_uncertainty(
    values: Sequence[float], sizes: Sequence[float], formal: float | None = None
) -> tuple[str, float]:
    """Behaviour of a series from coarse to fine, and half-width for its finest mesh.

    Without an order it is thrice the range of the values (Eca and Hoekstra 2014, J. Comput.
    Phys. 262, 104).

    Examples
    --------
    >>> behaviour, u = fine_uncertainty([1.4, 1.2, 1.1], [4.0, 2.0, 1.0], formal=1.0)
    >>> behaviour, round(u, 6)
    ('monotone', 0.125)
    """
    found = grid_convergence(sizes, values, formal_order=formal)
    if found.u_num:
        return found.behaviour, float(found.u_num)
    spread = max(values) - min(values)
    return found.behaviour, spread if found.behaviour == "noise-floor" else TWO_MESH_FACTOR * spread
