"""The same cylinder in both spaces: what they differ by where the geometry does not.

A block has no axis, so that axisymmetric space replaces it by the cylinder of its
cross-section. How far 3D and axisymmetric space then differ on that cylinder is the share of
the discretization in the effect of the space.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from study.harness.record.record import Record
from study.harness.runner.job import CaseJob, Work
from study.harness.runner.refinement import base_size_mm
from study.harness.runner.solve_task import SolveResult, SolveTask
from study.harness.runner.study_refinement import meshed_cells
from study.mechanics.setup.declaration import with_table
from study.mechanics.setup.geometry import Block
from study.mechanics.setup.setup import Setup, Tables

SPACES = ("axisymmetric", "3d")


@dataclass(frozen=True)
class SpacePair:
    """One kind of element on its finest mesh: tasks of two solutions, in the order of SPACES."""

    #: Levels of the factors of the discretization, space left out.
    levels: Mapping[str, str]
    tasks: tuple[SolveTask, SolveTask]


def pairs(work: Work, records: Mapping[str, Record]) -> list[SpacePair]:
    """List what to solve for a study that holds both spaces and a block; empty elsewhere."""
    known = [job for job in in_blocks(work) if _constants(records.get(job.case.case_id))]
    found = []
    for levels, chosen in _chosen(known):
        first, second = (_task(job, _constants(records[job.case.case_id])) for job in chosen)
        found.append(SpacePair(levels, (first, second)))
    return found


def upcoming(
    work: Work, records: Mapping[str, Record], solved: Callable[[SolveTask], bool]
) -> list[CaseJob]:
    """List the cells whose cylinder is still to be solved, before the cases are computed.

    A solution costs what the cell's own does, for the cylinder has its section and height.
    """
    given = {job.case.case_id: _constants(records.get(job.case.case_id)) for job in in_blocks(work)}
    hopeful = [
        job for job in in_blocks(work) if job.case.case_id not in records or given[job.case.case_id]
    ]
    found = []
    for _, chosen in _chosen(hopeful):
        for job in chosen:
            constants = given[job.case.case_id]
            if not constants or not solved(_task(job, constants)):
                found.append(job)
    return found


def in_blocks(work: Work) -> list[CaseJob]:
    """List the cells whose specimen has no axis, in the first block of the study."""
    cells = meshed_cells(work)
    ours = [job for job in cells if "forward" not in job.case.config]
    return [job for job in ours if isinstance(job.case.setup.specimen, Block)]


def _chosen(
    cells: Sequence[CaseJob],
) -> Iterator[tuple[dict[str, str], tuple[CaseJob, CaseJob]]]:
    """Finest mesh of both spaces for every kind of element, of the material of fewest constants."""
    kinds: dict[tuple[tuple[str, str], ...], list[CaseJob]] = {}
    for job in cells:
        kinds.setdefault(_levels(job), []).append(job)
    for levels, jobs in kinds.items():
        flat, solid = (
            [job for job in jobs if job.case.setup.model.space == space] for space in SPACES
        )
        if flat and solid:
            yield dict(levels), (min(flat, key=_preference), min(solid, key=_preference))


def _levels(job: CaseJob) -> tuple[tuple[str, str], ...]:
    """Levels that name a kind of element: of the model, but for its space and its mesh."""
    apart = ("model.space", "model.mesh", "model.mesh_size")
    levels = job.case.levels.items()
    return tuple((k, v) for k, v in levels if k.startswith("model.") and k not in apart)


def _preference(job: CaseJob) -> tuple[int, str, float]:
    material = job.case.material
    return len(material.calibrated_names), material.model, base_size_mm(job)


def _task(job: CaseJob, constants: Mapping[str, float]) -> SolveTask:
    depth = job.case.setup.test.displacement_mm
    changed = {**job.case.config, "specimen": _equivalent_cylinder(job.case.setup)}
    changed = with_table(changed, "material", constants=dict(constants))
    changed = with_table(changed, "test", displacement_mm=job.depth_mm if depth is None else depth)
    return SolveTask.of(changed, base_size_mm(job))


def _constants(record: Record | None) -> dict[str, float]:
    """Constants (MPa) of a case's first fit; empty without an answer."""
    if record is None or not record.converged or not record.fits:
        return {}
    return record.fits[0]["values"]


def _equivalent_cylinder(setup: Setup) -> Tables:
    """Cylinder of the same cross-section and height."""
    from study.mechanics.mesh.structured import equivalent_radius

    radius = equivalent_radius(setup.specimen)
    return {"shape": "cylinder", "radius_mm": radius, "height_mm": setup.height_mm}


@dataclass(frozen=True)
class SpaceComparison:
    """How far the forces of the two spaces differ on one cylinder."""

    #: Of the discretization, space left out.
    levels: Mapping[str, str]
    unknowns: tuple[int, int]
    depth_mm: float
    #: Relative difference of the force, 3D over axisymmetric, at the end and over the second half
    #: of the depth; None where a solution failed.
    at_end: float | None = None
    largest: float | None = None
    message: str = ""


def compared(pair: SpacePair, flat: SolveResult, solid: SolveResult) -> SpaceComparison:
    """Compare the forces of the two spaces."""
    row = SpaceComparison(
        pair.levels,
        (flat.dofs, solid.dofs),
        Setup.of(pair.tasks[0].tables).test.depth_mm,
    )
    failed = [result.message for result in (flat, solid) if not result.converged]
    if failed:
        return replace(row, message=failed[0])
    # each may have load steps of its own, where its curve bends
    d = solid.curve.displacement_mm
    apart = solid.curve.force_N / flat.curve.force_at(d) - 1
    deep = d >= d.max() / 2
    largest = apart[deep][abs(apart[deep]).argmax()]
    return replace(row, at_end=float(apart[-1]), largest=float(largest))
