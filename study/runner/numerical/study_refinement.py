"""Refinement of the mesh under a study: which cells are refined, and how often.

Cells of every kind of discretization are computed again in the first block, calibration and
all, on finer meshes: a change of the constants and of the score is what a finer mesh would
have changed in the study. Only cells whose deformation is not homogeneous have a mesh error.
All of them are refined where that is cheap, and at least two elsewhere: a difference of cells
is bounded by its own series, or by the scatter of the error over those that were refined.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final, Literal

import numpy as np

from study.canonical import digest
from study.design.sections.content import case_id, plain
from study.design.spec import Case
from study.record.record import Record
from study.runner.case_task import Origin
from study.runner.cost import Costs
from study.runner.expansion import case_job
from study.runner.job import CaseJob, Work, varied
from study.runner.numerical.case_series import CaseSeries
from study.runner.numerical.formal_order import base_size_mm
from study.runner.numerical.refinement import FEWEST
from study.runner.tables import CalibrationTable, on_mesh
from study.setup.geometry import Enclosed
from study.setup.section import table_of
from study.setup.setup import Tables

PURPOSE: Final = "refinement"

#: Seed of the other mesh of a surface, whose difference tells how far a choice of meshes moves it.
OTHER_MESH = 1

#: Seconds below which the solution on a third mesh is predicted to be cheap, so that it is made.
CHEAP_S = 20.0

#: Seconds for which all cells of one discretization may be refined; a few are beyond that.
ALL_CELLS_S = 60.0

#: Cells of one discretization that are refined where all of them would take too long.
FEW_CELLS = 2

#: Cells whose mean cost is taken for that of all: indenters, depths, interfaces may be factors.
PRICED_CELLS = 8

#: Keys of a model that choose its mesh.
_MESH_KEYS = ("mesh", "mesh_size_mm", "mesh_ratio", "mesh_seed")


def study_series(work: Work, records: Mapping[str, Record]) -> list[CaseSeries]:
    """Series that tell the numerical uncertainty of a study.

    Its own columns where its meshes are a factor; else the cells of :func:`chosen`, each to be
    refined twice where that is cheap and once elsewhere.

    Parameters
    ----------
    work : Work
        The study without its replicates.
    records : mapping of str to Record
        Records of the study, by case id; those of the refined cases too, where they are known.
    """
    return own_series(work, records) or chosen_series(work, records)


def chosen_series(work: Work, records: Mapping[str, Record]) -> list[CaseSeries]:
    """Series of the cells of :func:`chosen`.

    Parameters
    ----------
    work : Work
        The study; ``[converge] ratio`` of its design is the ratio of the element sizes.
    records : mapping of str to Record
        By case id, of the cells and of the refined cases, where they are known; else empty.

    Returns
    -------
    list of CaseSeries
        Each of two refinements where the second is cheap and of one elsewhere.
    """
    costs = Costs()
    return [
        refined_series(work, base, _refinements(work, base, costs), records)
        for base in chosen(work)
    ]


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
    series = every_series(work, bases, {}) if bases else chosen_series(work, {})
    return replace(work, jobs=tuple(job for one in series for job in one.every[1:]))


def refined_series(
    work: Work, base: CaseJob, times: int, records: Mapping[str, Record]
) -> CaseSeries:
    """Series of a cell on its own mesh and some finer ones.

    Parameters
    ----------
    work : Work
        The study; ``[converge] ratio`` of its design is the ratio of the element sizes.
    base : CaseJob
        The cell, which is the coarsest of the series.
    times : int
        Number of finer meshes.
    records : mapping of str to Record
        By case id, of the cell and of the refined cases, where they are known; else empty.
    """
    size, ratio = base_size_mm(base), work.design.converge.ratio
    finer = [
        case_job(
            refined(base.case, size / ratio**level),
            work.data,
            work.design,
            Origin(purpose=PURPOSE, of=base.case.case_id, level=level),
        )
        for level in range(1, times + 1)
    ]
    return _series(work, (base, *finer), records)


def every_series(
    work: Work, bases: Sequence[CaseJob], records: Mapping[str, Record]
) -> list[CaseSeries]:
    """Series of some cells, each refined as often as ``[converge] levels`` says.

    Parameters
    ----------
    work : Work
        The study; ``[converge] levels`` counts the cell's own mesh, and at least three are made.
    bases : sequence of CaseJob
        The cells, each the coarsest of its series.
    records : mapping of str to Record
        By case id, of the cells and of the refined cases, where they are known; else empty.
    """
    times = max(2, work.design.converge.levels - 1)
    return [refined_series(work, base, times, records) for base in bases]


def own_series(work: Work, records: Mapping[str, Record]) -> list[CaseSeries]:
    """Cells of the first block that differ in their mesh alone, from coarse to fine.

    Empty unless every column of the study has its three meshes.

    Parameters
    ----------
    work : Work
        The study without its replicates; homogeneous cells are left out.
    records : mapping of str to Record
        By case id, where they are known; else empty.
    """
    found: dict[str, list[CaseJob]] = {}
    for job in meshed_cells(work):
        found.setdefault(_column(job.case.config), []).append(job)
    if any(len(jobs) < FEWEST for jobs in found.values()):
        return []
    series = []
    for jobs in found.values():
        ordered = sorted(jobs, key=lambda job: -base_size_mm(job))
        series.append(_series(work, tuple(ordered), records, "finest"))
    return series


def _series(
    work: Work,
    jobs: tuple[CaseJob, ...],
    records: Mapping[str, Record],
    own: Literal["coarsest", "finest"] = "coarsest",
) -> CaseSeries:
    """Series with its records; of a surface with another mesh of the study's own size."""
    base = jobs[0 if own == "coarsest" else -1]
    other = None
    if isinstance(base.case.setup.specimen, Enclosed):
        case = varied(base.case, on_mesh(base.case.config, mesh_seed=OTHER_MESH), PURPOSE)
        origin = Origin(purpose=PURPOSE, of=base.case.case_id, level=0)
        other = case_job(case, work.data, work.design, origin)
    series = CaseSeries(jobs, work.design.converge.ratio, own, other=other)
    for job in series.every:
        record = records.get(job.case.case_id)
        if record is not None:
            series.add(job, record)
    return series


def chosen(work: Work) -> list[CaseJob]:
    """Choose cases of every kind of discretization, in the first block, before any result is seen.

    All of a kind where that is cheap; else those of fewest and of most constants, which the mesh
    can move most differently.

    Parameters
    ----------
    work : Work
        The study; homogeneous cells are left out, and predicted seconds decide what is cheap.
    """
    groups: dict[str, list[CaseJob]] = {}
    for job in meshed_cells(work):
        groups.setdefault(discretization_key(job.case.config), []).append(job)
    costs = Costs()
    found = []
    for jobs in groups.values():
        ordered = sorted(jobs, key=lambda job: len(job.case.material.calibrated_names))
        priced = _spread(ordered, PRICED_CELLS)
        finest = [costs.solve_seconds(_twice(work, job).config) for job in priced]
        cheap = len(jobs) * float(np.mean(finest)) <= ALL_CELLS_S
        found += jobs if cheap else _spread(ordered, FEW_CELLS)
    return found


def _spread(jobs: Sequence[CaseJob], count: int) -> list[CaseJob]:
    """Take a few from the first to the last."""
    return [jobs[round(i)] for i in np.linspace(0, len(jobs) - 1, min(count, len(jobs)))]


def every_cell(work: Work) -> list[CaseJob]:
    """List the case of every cell in the first block.

    Parameters
    ----------
    work : Work
        The study without its replicates; cases without a block count too.
    """
    return [job for job in work.jobs if job.case.block in (None, *work.blocks[:1])]


def meshed_cells(work: Work) -> list[CaseJob]:
    """List those whose answer depends on a mesh: their deformation is not homogeneous.

    Parameters
    ----------
    work : Work
        As in :func:`every_cell`.
    """
    return [job for job in every_cell(work) if not job.case.setup.is_homogeneous]


def _refinements(work: Work, job: CaseJob, costs: Costs) -> int:
    """Count the refinements: two where the second is cheap, one elsewhere."""
    return 2 if costs.solve_seconds(_twice(work, job).config) < CHEAP_S else 1


def _twice(work: Work, job: CaseJob) -> Case:
    return refined(job.case, base_size_mm(job) / work.design.converge.ratio**2)


def refined(case: Case, size_mm: float) -> Case:
    """Copy a case with another mesh; everything else, the block too, stays.

    Parameters
    ----------
    case : Case
        The problem of its calibration gets the mesh too.
    size_mm : float
        Element size, instead of a named mesh.
    """
    return varied(case, on_mesh(case.config, mesh=None, mesh_size_mm=size_mm), PURPOSE)


def discretization_key(tables: Tables) -> str:
    """Name of a kind of discretization: cells that share it share their mesh error.

    Parameters
    ----------
    tables : mapping
        Document of a case; its table ``model`` counts, without ``mesh_ratio`` and ``mesh_seed``.
    """
    apart = ("mesh_ratio", "mesh_seed")
    return case_id({k: v for k, v in table_of(tables, "model").items() if k not in apart})


def _column(tables: Tables) -> str:
    """Name of a column: everything but the mesh, that of the calibration left out too."""
    own = CalibrationTable.of(tables).problem or {}
    rest = {k: v for k, v in tables.items() if k not in ("model", "calibration")}
    return digest(
        [plain(rest), _meshless(table_of(tables, "model")), _meshless(table_of(own, "model"))]
    )


def _meshless(model: Tables) -> dict[str, object]:
    return {k: v for k, v in model.items() if k not in _MESH_KEYS}
