"""Refinement of the mesh under a study: which cells are refined, and how often.

Cells of every kind of discretization are computed again in the first block, calibration and
all, on finer meshes: a change of the constants and of the score is what a finer mesh would
have changed in the study. Only cells whose deformation is not homogeneous have a mesh error.
All of them are refined where that is cheap, and at least two elsewhere: a difference of cells
is bounded by its own series, or by the scatter of the error over those that were refined.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from study.ground.arrays import Array
from study.ground.canonical import digest
from study.ground.errors import Fault, InputError
from study.harness.design.cell import case_id, plain
from study.harness.design.spec import Case
from study.harness.record.record import Record
from study.harness.runner.case_series import CaseSeries, force_at_places, size_of
from study.harness.runner.cost import Costs
from study.harness.runner.expansion import case_job
from study.harness.runner.job import CaseJob, Origin, Work, varied
from study.harness.runner.problem_tables import (
    OTHER_MESH,
    calibrated_test,
    measurements_of,
    on_mesh,
    value_named,
)
from study.harness.runner.refinement import FEWEST, base_size_mm
from study.harness.runner.solve_task import SolveResult, SolveTask
from study.mechanics.measurement.measurement_section import Range
from study.mechanics.setup.declaration import table_of, with_table
from study.mechanics.setup.geometry import Block, Enclosed
from study.mechanics.setup.setup import Setup, Tables, known_height_mm

PURPOSE: Final = "refinement"

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
    """
    return own_series(work, records) or chosen_series(work, records)


def chosen_series(work: Work, records: Mapping[str, Record]) -> list[CaseSeries]:
    """Series of the cells of :func:`chosen`."""
    costs = Costs()
    return [
        refined_series(work, base, _refinements(work, base, costs), records)
        for base in chosen(work)
    ]


def refinement_work(work: Work) -> Work:
    """List the refined cases of a study, as work like any other."""
    refined_cases = (job for cell in chosen_series(work, {}) for job in cell.every[1:])
    return replace(work, jobs=tuple(refined_cases))


def refined_series(
    work: Work, base: CaseJob, times: int, records: Mapping[str, Record]
) -> CaseSeries:
    """Series of a cell on its own mesh and some finer ones."""
    size, ratio = size_of(base), work.design.converge.ratio
    finer = [
        case_job(
            refined(base.case, size / ratio**level),
            work,
            Origin(purpose=PURPOSE, of=base.case.case_id, level=level),
        )
        for level in range(1, times + 1)
    ]
    return _series(work, (base, *finer), records)


def every_series(
    work: Work, bases: Sequence[CaseJob], records: Mapping[str, Record]
) -> list[CaseSeries]:
    """Series of some cells, each refined as often as ``[converge] levels`` says."""
    times = max(2, work.design.converge.levels - 1)
    return [refined_series(work, base, times, records) for base in bases]


def own_series(work: Work, records: Mapping[str, Record]) -> list[CaseSeries]:
    """Cells of the first block that differ in their mesh alone, from coarse to fine.

    Empty unless every column of the study has its three meshes.
    """
    columns: dict[str, list[CaseJob]] = {}
    for job in meshed_cells(work):
        columns.setdefault(_column(job), []).append(job)
    if any(len(jobs) < FEWEST for jobs in columns.values()):
        return []
    series = []
    for jobs in columns.values():
        ordered = sorted(jobs, key=lambda job: -size_of(job))
        series.append(_series(work, tuple(ordered), records, "finest"))
    return series


def _series(
    work: Work,
    jobs: tuple[CaseJob, ...],
    records: Mapping[str, Record],
    end: Literal["coarsest", "finest"] = "coarsest",
) -> CaseSeries:
    """Series with its records; of a surface with another mesh of the study's own size."""
    base = jobs[0 if end == "coarsest" else -1]
    other = None
    alone = "specimen" not in base.case.config
    if not alone and isinstance(base.case.setup.specimen, Enclosed):
        case = varied(base.case, on_mesh(base.case.config, mesh_seed=OTHER_MESH), PURPOSE)
        origin = Origin(purpose=PURPOSE, of=base.case.case_id, level=0)
        other = case_job(case, work, origin)
    series = CaseSeries(jobs, work.design.converge.ratio, end, other=other)
    for job in series.every:
        record = records.get(job.case.case_id)
        if record is not None:
            series.add(job, record)
    return series


def chosen(work: Work) -> list[CaseJob]:
    """Choose cases of every kind of discretization, in the first block, before any result is seen.

    All of a kind where that is cheap; else those of fewest and of most constants, which the mesh
    can move most differently.
    """
    groups: dict[str, list[CaseJob]] = {}
    for job in meshed_cells(work):
        problem = job.case.treatment.cell.problem
        kind = problem.discretization if problem.refinement else discretization_key(job.case.config)
        groups.setdefault(kind, []).append(job)
    costs = Costs()
    cells = []
    for jobs in groups.values():
        ordered = sorted(
            jobs, key=lambda job: len(job.case.treatment.cell.problem.calibrated_names)
        )
        priced = _spread(ordered, PRICED_CELLS)
        finest = [_refined_seconds(work, job, costs) for job in priced]
        cheap = len(jobs) * float(np.mean(finest)) <= ALL_CELLS_S
        cells += jobs if cheap else _spread(ordered, FEW_CELLS)
    return cells


def _spread(jobs: Sequence[CaseJob], count: int) -> list[CaseJob]:
    """Take a few from the first to the last."""
    return [jobs[round(i)] for i in np.linspace(0, len(jobs) - 1, min(count, len(jobs)))]


def every_cell(work: Work) -> list[CaseJob]:
    """List the case of every cell in the first block."""
    return [job for job in work.jobs if job.case.block in (None, *work.blocks[:1])]


def meshed_cells(work: Work) -> list[CaseJob]:
    """List those whose answer depends on a mesh: their deformation is not homogeneous."""
    return [job for job in every_cell(work) if job.case.is_refinable]


def _refinements(work: Work, job: CaseJob, costs: Costs) -> int:
    """Count the refinements: two where the second is cheap, one elsewhere."""
    if job.case.treatment.cell.problem.refinement is not None:
        return max(2, work.design.converge.levels - 1)
    return 2 if _refined_seconds(work, job, costs) < CHEAP_S else 1


def _refined_seconds(work: Work, job: CaseJob, costs: Costs) -> float:
    """Seconds of a case on the second finer mesh; of a stranger's solver those it says."""
    if job.case.treatment.cell.problem.refinement is not None:
        return costs.case_seconds(job)
    finer = refined(job.case, size_of(job) / work.design.converge.ratio**2)
    return costs.solve_seconds(finer.config)


def refined(case: Case, size: float) -> Case:
    """Copy a case with another mesh in mm, or another value of the parameter that refines it."""
    refinement = case.treatment.cell.problem.refinement
    if refinement is not None:
        return varied(case, refinement.refined(case.config, size), PURPOSE)
    return varied(case, on_mesh(case.config, mesh=None, mesh_size_mm=size), PURPOSE)


def discretization_key(tables: Tables) -> str:
    """Name of a kind of discretization: cells that share it share their mesh error."""
    apart = ("mesh_ratio", "mesh_seed")
    return case_id({k: v for k, v in table_of(tables, "model").items() if k not in apart})


def _column(job: CaseJob) -> str:
    """Name of a column: everything but the mesh, that of the calibration left out too."""
    tables, refinement = job.case.config, job.case.treatment.cell.problem.refinement
    if refinement is not None:
        return digest(plain(refinement.without(tables)))
    other = calibrated_test(tables)
    rest = {k: v for k, v in tables.items() if k not in ("model", "calibration")}
    return digest(
        [plain(rest), _meshless(table_of(tables, "model")), _meshless(table_of(other, "model"))]
    )


def _meshless(model: Tables) -> dict[str, object]:
    return {k: v for k, v in model.items() if k not in _MESH_KEYS}


# What the uncertainty of the inputs does: cases computed again with one input moved.
#
# One cell of every combination of the factors that are no discretization, the one that costs
# least, in the first block, is computed again for every input of ``[uncertainty]``, calibration
# and all; the change is carried to the other discretizations in proportion to their force.

#: levels of the factors that are no discretization
Physics = tuple[tuple[str, str], ...]

INPUT_PURPOSE: Final = "input"


def input_work(work: Work) -> Work:
    """List the cases with one input moved by its standard uncertainty, as work like any other."""
    jobs = []
    for base in representatives(work):
        for key, amount in (
            {
                k: float(u)
                for k, u in work.design.uncertainty.items()
                if u and not k.startswith("measurements.")
            }
        ).items():
            # Copy a case with one input moved; the measured points stay where they are.
            config = shifted(_fixed_range(base.case.config), key, amount)
            calibrated = calibrated_test(config)
            if calibrated and key.split(".")[0] in calibrated:
                inner = shifted(_fixed_range(calibrated), key, amount)
                config = with_table(config, "calibration", problem=inner)
            case = varied(base.case, config, INPUT_PURPOSE)
            origin = Origin(purpose=INPUT_PURPOSE, of=base.case.case_id, input=key)
            jobs.append(case_job(case, work, origin))
    return replace(work, jobs=tuple(jobs))


def representatives(work: Work) -> list[CaseJob]:
    """List the cheapest cell for every combination of the other factors, in the first block."""
    costs = Costs()
    best: dict[Physics, tuple[float, CaseJob]] = {}
    for job in every_cell(work):
        key = physics_of(job.case.levels)
        price = costs.case_seconds(job)
        if key not in best or price < best[key][0]:
            best[key] = (price, job)
    return [job for _, job in best.values()]


def physics_of(levels: Mapping[str, str]) -> Physics:
    """Levels of the factors that are no discretization."""
    return tuple(
        sorted((k, v) for k, v in levels.items() if k != "model" and not k.startswith("model."))
    )


def shifted(config: Tables, key: str, amount: float) -> Tables:
    """Copy of a configuration with one value moved, named as in the file.

    Examples
    --------
    >>> shifted({"specimen": {"height_mm": 30.0}}, "specimen.height", 0.5)
    {'specimen': {'height_mm': 30.5}}
    """
    path = key.split(".")
    return _shifted(config, path, amount, key)


def _shifted(section: Tables, path: Sequence[str], amount: float, key: str) -> Tables:
    inner = table_of(section, path[0])
    if len(path) > 1 and inner:
        return {**section, path[0]: _shifted(inner, path[1:], amount, key)}
    constants = section.get("constants")
    if isinstance(constants, Mapping) and path[-1] in constants:
        return {**section, "constants": _shifted(constants, path[-1:], amount, key)}
    entry = value_named(section, path[-1])
    if entry is not None:
        return {**section, entry[0]: entry[1] + amount}
    rule = "has no value in the design that could be uncertain"
    raise InputError(Fault(f"uncertainty.{key}", rule, "give the input, or leave this out"))


def _fixed_range(config: Tables) -> Tables:
    """Say the measured range in mm, so that another height does not move it."""
    made, height = measurements_of(config), known_height_mm(table_of(config, "specimen"))
    if made is None or height is None or made.range is None:
        return config
    if made.range.kind == "mm":
        return config
    low, high = made.range.in_mm(height)
    return {**config, "measurements": replace(made, range=Range("mm", low, high))}


def input_shares(work: Work, moved: Work, records: Mapping[str, Record]) -> dict[Physics, Array]:
    """Relative standard uncertainty of the force from all inputs, at the places of a series.

    Shapes: returns (places,).
    """
    shares: dict[Physics, Array] = {}
    for base in representatives(work):
        record = records.get(base.case.case_id)
        if record is None or not record.converged:
            continue
        force = force_at_places(record)
        changes = [
            force_at_places(other) - force
            for job in moved.jobs
            if job.origin.of == base.case.case_id
            and (other := records.get(job.case.case_id)) is not None
            and other.converged
        ]
        if changes:
            squares = np.sum([change**2 for change in changes], axis=0)
            shares[physics_of(base.case.levels)] = np.sqrt(squares) / np.abs(force)
    return shares


# The same cylinder in both spaces: what they differ by where the geometry does not.


SPACES = ("axisymmetric", "3d")


@dataclass(frozen=True)
class SpacePair:
    """One kind of element on its finest mesh: tasks of two solutions, in the order of SPACES."""

    #: Levels of the factors of the discretization, space left out.
    levels: Mapping[str, str]
    tasks: tuple[SolveTask, SolveTask]


def pairs(work: Work, records: Mapping[str, Record]) -> list[SpacePair]:
    """List what to solve for a study that holds both spaces and a block; empty elsewhere."""
    solved_cells = [job for job in in_blocks(work) if _constants(records.get(job.case.case_id))]
    compared_pairs = []
    for levels, chosen in _chosen(solved_cells):
        first, second = (_task(job, _constants(records[job.case.case_id])) for job in chosen)
        compared_pairs.append(SpacePair(levels, (first, second)))
    return compared_pairs


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
    open_cells = []
    for _, chosen in _chosen(hopeful):
        for job in chosen:
            constants = given[job.case.case_id]
            if not constants or not solved(_task(job, constants)):
                open_cells.append(job)
    return open_cells


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
