"""Numerical uncertainty of a study whose meshes are a factor: from its own cases, nothing refined.

A column holds the cells that differ in their mesh alone. Three of them or more, under one
block, are a refinement series of everything that the study does, calibration included.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from study.analysis.convergence import grid_convergence
from study.design import plain
from study.record import Record
from study.runner.expand import CaseJob, Work
from study.runner.identity import digest
from study.runner.refine import (
    TWO_MESH_FACTOR,
    Numerical,
    base_size_mm,
    meshed_cells,
    record_sizes,
)
from study.runner.refine_formal import formal_of_case

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
    >>> behaviour, u = fine_uncertainty([1.4, 1.2, 1.1], [4.0, 2.0, 1.0])
    >>> behaviour, round(u, 6)
    ('monotone', 0.125)
    """
    found = grid_convergence(sizes, values, formal_order=formal)
    if found.u_num:
        return found.behaviour, float(found.u_num)
    spread = max(values) - min(values)
    return found.behaviour, spread if found.behaviour == "noise-floor" else TWO_MESH_FACTOR * spread
