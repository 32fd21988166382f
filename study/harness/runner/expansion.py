"""A design and its data -> every computation that is needed, each once, with its name.

Treatments become cases, cases their replicates, these become jobs with their fits, and the jobs
of resampled residuals follow: each step takes the values of the one before and changes none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from pathlib import Path

from study.external.forward_model import ForwardModel
from study.ground.arrays import gathered
from study.ground.canonical import digest, numbered
from study.ground.errors import Fault, InputError
from study.harness.design.spec import MAX_CASES, Design, cases
from study.record.record import Record, is_repeat
from study.simulation.cell import Case, Treatment
from study.simulation.job import (
    NOTHING,
    Allowed,
    CaseJob,
    DataCache,
    FitJob,
    FitProblem,
    Forward,
    Origin,
    check_templates,
    fit_problem,
    fits_of,
    folders,
    identity,
    located_cell,
    placed_files,
    placed_model,
    repeated,
    score_pairs,
    surface_notes,
)
from study.simulation.provenance import code_version
from study.simulation.response import units_of


@dataclass(frozen=True)
class Work:
    """Everything that a study computes."""

    design: Design
    #: One for every case, in the order of the design.
    jobs: tuple[CaseJob, ...]
    #: Unit of every response that a record holds.
    responses: Mapping[str, str]
    blocks: tuple[str, ...]
    #: The measurements, each specification read once.
    data: DataCache
    #: What may be used besides this package.
    allowed: Allowed = NOTHING

    @cached_property
    def fits(self) -> dict[str, FitJob]:
        """Every fit by its key, those that give start values included."""
        return fits_of(self.jobs)

    @property
    def cautions(self) -> tuple[str, ...]:
        """What was done to measurements and surfaces that may not be what they seem."""
        mended = surface_notes(job.case.cell for job in self.jobs)
        return (*self.data.cautions(), *mended)

    def plain(self) -> Work:
        """Leave the replicates out: the first mesh of a cell, the curve as measured."""
        originals = [job for job in self.jobs if not is_repeat(job.origin.to_json())]
        return replace(self, jobs=tuple(originals))

    @property
    def cases(self) -> dict[str, Case]:
        """Every case by its id."""
        return {job.case.case_id: job.case for job in self.jobs}

    @property
    def input_hashes(self) -> dict[str, str]:
        """Case id -> hash of everything that decides its record."""
        return {job.case.case_id: job.input_hash for job in self.jobs}


# Repeats of every cell for an error term: other meshes, or fits to resampled noise.


def seeded(distinct: Sequence[Case], design: Design) -> tuple[tuple[Case, Origin], ...]:
    """Every case on each of its meshes, with the number of the mesh; once where none are asked.

    Seeds are hashes of the study's seed, the cell and the number: the meshes of one cell are the
    same in every block, and those of two cells have nothing to do with each other.
    """
    replicates = design.replicates
    count = replicates.mesh_seeds if replicates.key is None else replicates.n
    if not count:
        return tuple((case, Origin()) for case in distinct)
    _check_count(len(distinct) * count)
    repeats = []
    for case in distinct:
        content = [design.seed, case.cell.document()]
        for number, name in enumerate(numbered(content, count, 8), 1):
            seed = int(name, 16)
            if replicates.key is None:
                cell = case.cell.on_mesh(mesh_seed=seed)
                repeats.append(
                    (repeated(case, ["mesh seed", seed], cell), Origin(mesh_seed=number))
                )
            else:  # of a stochastic simulation, which no two cells share
                problem = case.problem.with_parameter(replicates.key.partition(".")[2], seed)
                cell = replace(case.cell, problem=problem)
                again = repeated(case, ["replicate", number, seed], cell)
                repeats.append((again, Origin(replicate=number)))
    return tuple(repeats)


def _check_count(count: int) -> None:
    if count > MAX_CASES:
        rule = f"{count} cases with their replicates are more than {MAX_CASES}"
        raise InputError(Fault("replicates", rule, "ask for fewer, or use fewer levels"))


def resampled(jobs: Sequence[CaseJob], design: Design) -> tuple[CaseJob, ...]:
    """Cases whose fits see resampled noise, beside the case of the fit itself."""
    _check_count(len(jobs) * (1 + design.replicates.noise))
    numbers = range(1, design.replicates.noise + 1)
    return tuple(_again(job, design.seed, number) for job in jobs for number in numbers)


def _again(job: CaseJob, seed: int, number: int) -> CaseJob:
    directions = tuple(
        (pair if pair.fit is None else replace(pair, fit=pair.fit.resampled(seed, number)))
        for pair in job.directions
    )
    keys = {pair.fit_key for pair in directions} - {None}
    return replace(
        job,
        case=repeated(job.case, ["noise", number]),
        directions=directions,
        input_hash=digest([job.input_hash, "noise", seed, number, sorted(map(str, keys))]),
        origin=replace(job.origin, noise_seed=number),
        group="",
        anchor=None,
    )


def expand(design: Design, data_root: Path, allowed: Allowed = NOTHING) -> Work:
    """List every case and every fit of a design."""
    cells = design.treatments
    problems = [cell.cell.problem for cell in cells]
    tests = {problem.test_name: problem for problem in problems if problem.test_name}
    data = DataCache(data_root, tuple(tests.values()))
    blocks = _common_blocks(cells, data)
    places = folders(design.source, data_root)
    # each forward model is looked for once for all cells that share it
    units, model_of = units_asked(design), cache(partial(placed_model, places, allowed.function))
    jobs_of: dict[int, Callable[[Case, Origin], CaseJob]] = {}

    def job(case: Case, origin: Origin) -> CaseJob:
        cell_id = id(case.cell)  # one for all blocks of a cell, kept alive by its cases
        if cell_id not in jobs_of:
            jobs_of[cell_id] = _jobs_of_cell(_located(case, places, model_of), data, design, units)
        return jobs_of[cell_id](case, origin)

    # a replicate is named by what was written, not by where its surface was found
    jobs = _anchored(job(case, origin) for case, origin in planned(design, blocks))
    every = (*jobs, *resampled(jobs, design))
    return Work(design, every, units, blocks, data, allowed)


def planned(design: Design, blocks: Sequence[str]) -> tuple[tuple[Case, Origin], ...]:
    """Every case but those of resampled noise, and why it is computed."""
    return seeded(_distinct(cases(design, blocks)), design)


def cases_by_id(design: Design, blocks: Sequence[str]) -> dict[str, Case]:
    """List every case that :func:`expand` makes of a design; nothing measured is read."""
    every_case = [case for case, _ in planned(design, blocks)]
    numbers = range(1, design.replicates.noise + 1)
    again = [repeated(case, ["noise", number]) for case in every_case for number in numbers]
    return {case.case_id: case for case in (*every_case, *again)}


def relabeled(
    records: Iterable[Record], design: Design, cases: Mapping[str, Case]
) -> tuple[Record, ...]:
    """Give records the levels of their cases: a level of another name is computed no more."""
    relabelled, labels_of = [], {factor.name: factor.labels for factor in design.factors}
    for record in records:
        case = cases.get(record.case_id)
        if case is None:
            is_of = labels_of.keys() == record.levels.keys() and all(
                record.levels[name] in labels for name, labels in labels_of.items()
            )
            relabelled += [record] if is_of else []
        elif case.levels == record.levels and case.block == record.block:
            relabelled.append(record)
        else:
            relabelled.append(replace(record, levels=dict(case.levels), block=case.block))
    return tuple(relabelled)


def units_asked(design: Design) -> dict[str, str]:
    """List every response that the records of a design hold, with its unit."""
    if design.is_alone:
        return {response.name: response.unit for response in design.responses}
    forwards = {cell.cell.problem.forward for cell in design.treatments}
    values = {k: u for forward in forwards if forward is not None for k, u in forward.units.items()}
    names = [response.name for response in design.responses if response.name not in values]
    of_program = {r.name: r.unit for r in design.responses if r.name in values}
    return units_of(names, design.is_measured) | of_program


def _common_blocks(cells: Sequence[Treatment], data: DataCache) -> tuple[str, ...]:
    """Labels of the blocks, the same in the measurements of every treatment."""
    common: tuple[str, ...] | None = None
    for cell in cells:
        measured, marked = data.scored(cell.cell.problem), cell.cell.problem.markers
        labels = () if measured is None else measured.blocks
        labels = labels if marked is None else marked.labels
        if common is not None and labels != common:
            rule = f"treatments have different blocks: {', '.join(common)} and {', '.join(labels)}"
            raise InputError(Fault("measurements.block", rule))
        common = labels
    return common or ()


def _distinct(repeated_cases: Sequence[Case]) -> tuple[Case, ...]:
    """Give cells of equal content names of their own, so that none hides the other's record."""
    seen: set[str] = set()
    out = []
    for case in repeated_cases:
        named_case = repeated(case, [case.levels]) if case.case_id in seen else case
        seen.add(named_case.case_id)
        out.append(named_case)
    return tuple(out)


def _located(
    case: Case, places: Sequence[Path], model_of: Callable[[ForwardModel], ForwardModel]
) -> Case:
    """Copy a case with its surfaces, and the files of its forward model, found and checked."""
    cell = located_cell(case.cell, places)
    section = cell.problem.forward
    if section is not None and section.is_external:
        problem = replace(cell.problem, forward=model_of(section))
        check_templates(problem, case.case_id)
        cell = replace(cell, problem=problem)
    return replace(case, cell=cell)


def case_job(case: Case, work: Work, origin: Origin) -> CaseJob:
    """Make the job of one more case of a study."""
    return _jobs_of_cell(case, work.data, work.design, work.responses)(case, origin)


def _jobs_of_cell(
    case: Case, data: DataCache, design: Design, units: Mapping[str, str]
) -> Callable[[Case, Origin], CaseJob]:
    """Find what makes the jobs of a cell: all that is not measured is the same in every block."""
    cell, problem = case.cell, fit_problem(case.cell)
    forward = _forward_of(case, problem)
    files = (file.sha256 for file in placed_files(cell))
    names = (sorted(units), code_version(), *files, *identity(cell.problem))

    def job(each: Case, origin: Origin) -> CaseJob:
        placed = replace(each, cell=cell)
        pairs = tuple(
            score_pairs(placed, problem, data, design.asks_for_scores, design.asks_for_constants)
        )
        name = digest([each.case_id, [pair.identity for pair in pairs], *names])
        return CaseJob(placed, pairs, name, forward, origin, study=design.name, units=units)

    return job


def _forward_of(case: Case, problem: FitProblem) -> Forward:
    if problem.method in ("inverse-fem", "external") and problem.shares_scored_problem:
        return "fit"
    forward = case.problem.forward
    if forward is not None:
        return "closed-form" if forward.model == "closed-form" else "external"
    is_analytic = case.cell.method == "analytic" and case.problem.is_homogeneous
    has_none = case.tested.setup.has_no_elements
    return "closed-form" if is_analytic or has_none else "simulation"


def _anchored(jobs: Iterable[CaseJob]) -> tuple[CaseJob, ...]:
    """Give a cell's cases its anchor, which decides last digits: its first direction's fit."""

    def group_of(job: CaseJob) -> str:
        # predictions, all of one depth, may start from another specimen's load steps
        shares = (
            len({pair.depth_mm for pair in job.directions}) == 1
            and job.forward == "simulation"
            and not job.case.tested.setup.has_close_equilibria
        )
        return digest([job.case.cell.content_key, job.depth_mm], 32) if shares else ""

    grouped = [(group_of(job), job) for job in jobs]
    cells = gathered(grouped)
    solutions = {group: sum(len(job.scored) for job in cell) for group, cell in cells.items()}
    anchored = []
    for group, job in grouped:
        if group and solutions[group] > 1:
            anchor = cells[group][0].directions[0].fit
            name = digest([job.input_hash, None if anchor is None else anchor.key])
            anchored.append(replace(job, group=group, anchor=anchor, input_hash=name))
        else:
            anchored.append(job)
    return tuple(anchored)
