"""The work of a study: every computation that a design and its data need, and its doing.

Treatments become cases, cases their replicates, these become jobs with their fits, and the jobs
of resampled residuals follow: each step takes the values of the one before and changes none, and
each computation stands once, with its name.

What is missing is computed in parallel, and every result is written at once. The parent owns the
store; workers only compute. Whatever happens to a worker or to the parent, finished results stay,
and running again does the rest.
"""

from __future__ import annotations

import base64
import contextlib
import datetime
import math
import signal
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any, cast

from study.execution.local import Document, Executor, Outcome, Results, Task
from study.external.command import check_allowed
from study.external.forward_model import ForwardModel
from study.ground.arrays import gathered
from study.ground.canonical import digest, numbered
from study.ground.errors import Fault, InputError, RefusedError, nearest
from study.ground.files import read_json
from study.harness.design.load import dump
from study.harness.design.spec import (
    FINER_MESH,
    LONGER_LIMIT,
    MAX_CASES,
    MORE_MEMORY,
    SMALLER_STEPS,
    Design,
    cases,
)
from study.record.record import ManifestDocument, Record, RetryDocument, is_repeat
from study.record.store import Store
from study.simulation.cell import Case, CellProblem, Treatment, tested
from study.simulation.job import (
    NOTHING,
    TRUTH_SUFFIX,
    Allowed,
    CaseJob,
    DataCache,
    FitJob,
    FitProblem,
    FitResult,
    Forward,
    Origin,
    check_templates,
    externals,
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
from study.simulation.provenance import code_version, versions
from study.simulation.response import units_of
from study.simulation.solve_task import LASTING
from study.simulation.tasks import Costs, adapted, limit_of


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
    units = {response.name: response.unit for response in design.responses}
    return units if design.is_alone else units_of((), design.is_measured) | units


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


# What is tried when a case has no answer: declared in the design, by cause, and never silent.
#
# ``[execution] retry`` names the changes of every cause, in the order in which they are tried; each
# is made besides those before it. The record of the case says of every attempt what was changed and
# why, so that a report can list the cases whose setting is not that of the design.

#: how many load steps replace one, and how many times the limit is prolonged
STEPS_FACTOR = 4
LIMIT_FACTOR = 4.0

#: letters of a message that a record keeps of an attempt that failed
MESSAGE = 300

Notes = tuple[RetryDocument, ...]

#: what is tried of some cases at once: how many times the limit of one computation, and whether
#: nothing else may be computed beside it; each case under its own name, with the changes so far
Attempts = dict[tuple[float, bool], list[tuple[CaseJob, Notes]]]


def attempts(work: Work, store: Store, limited: bool) -> Attempts:
    """List the cases that failed for a cause of which something is still to be tried."""
    again: Attempts = {}
    if not work.design.retry:
        return again
    jobs = {job.case.case_id: job for job in work.jobs}
    for case_id in store.survey(work.input_hashes).statuses:
        record = store.read(case_id)
        if record is None:
            continue
        job, before = jobs[case_id], record.retries
        done = [note["change"] for note in before]
        open_changes = (
            change
            for change in work.design.retry.get(record.status, ())
            if change not in done and _applies(change, job, limited)
        )
        change = next(open_changes, None)
        if change is None:
            continue
        changes = [*done, change]
        changed, what = _changed(job, changes, work)
        note: RetryDocument = {
            "cause": record.status,
            "message": record.message[:MESSAGE],
            "change": change,
            "what": what,
        }
        way = (LIMIT_FACTOR if LONGER_LIMIT in changes else 1.0, MORE_MEMORY in changes)
        again.setdefault(way, []).append((changed, (*before, note)))
    return again


def has_other_mesh(record: Record) -> bool:
    """Whether a case was computed on a finer mesh than its own."""
    return any(note["change"] == FINER_MESH for note in record.retries)


def _applies(change: str, job: CaseJob, limited: bool) -> bool:
    """Whether a change can be made of a case.

    A refined case is one of a series of meshes, a refit belongs to the residuals of a fit, and
    other programs have steps and meshes of their own.
    """
    if change == LONGER_LIMIT:
        return limited
    if change == MORE_MEMORY:
        return True
    if job.origin.noise_seed or job.forward in ("closed-form", "external"):
        return False
    return change == SMALLER_STEPS or job.origin.purpose is None


def _changed(job: CaseJob, changes: Sequence[str], work: Work) -> tuple[CaseJob, str]:
    """Job of a case with changes, and the last of them in numbers; its name stays."""
    cell, what = job.case.cell, ""
    for change in changes:
        if change == SMALLER_STEPS:
            old = tested(cell.problem).test.steps
            new = STEPS_FACTOR * old  # in the test of the calibration too
            cell = cell.changed(partial(CellProblem.loaded, steps=new))
            what = f"{new} load steps instead of {old}"
        elif change == FINER_MESH:
            size = job.mesh_size_mm / work.design.converge.ratio
            cell = cell.on_mesh(mesh_size_mm=size)
            what = f"elements of {size:.4g} mm instead of {job.mesh_size_mm:.4g} mm"
        elif change == LONGER_LIMIT:
            what = f"a limit {LIMIT_FACTOR:g} times as long"
        else:
            what = "computed with nothing else beside it"
    if cell is job.case.cell:
        return job, what
    changed_job = case_job(replace(job.case, cell=cell), work, job.origin)
    return replace(changed_job, input_hash=job.input_hash), what


#: what may go better next time: memory and time depend on the machine
RETRIED = ("crashed", "timeout", "out-of-memory")


@dataclass(frozen=True)
class Progress:
    """State of a run after each finished computation; what a progress line shows.

    Of ``done`` and ``total`` computations, ``fits_done`` and ``fits`` are calibrations; the others
    are cases. ``share`` is the part of the predicted work that is done; ``phase`` names what is
    computed after the cases of the design, such as finer meshes.
    """

    done: int
    total: int
    failed: int
    seconds: float
    label: str
    fits_done: int = 0
    fits: int = 0
    share: float = 0.0
    phase: str = ""

    @property
    def seconds_left(self) -> float | None:
        """Seconds for the work left, at the rate of what is done; None where too little is."""
        if self.done == self.total:
            return 0.0
        if self.share < LEAST_SHARE:
            return None
        return self.seconds * (1 - self.share) / self.share

    @property
    def counted(self) -> str:
        """Cases and calibrations in words: ``finer meshes: 3/6 cases, 4/4 calibrations``."""
        cases = f"{self.done - self.fits_done}/{self.total - self.fits} cases"
        fits = f", {self.fits_done}/{self.fits} calibrations" if self.fits else ""
        return f"{self.phase}{': ' * bool(self.phase)}{cases}{fits}"


#: part of the predicted work from which on the time left is worth a number
LEAST_SHARE = 0.02


def in_phase(progress: Callable[[Progress], None], phase: str) -> Callable[[Progress], None]:
    """Progress of what is computed after the cases of a design, under its name."""
    return lambda state: progress(replace(state, phase=phase))


#: seconds between two notes for other shells: nobody reads them faster
NOTED_S = 0.2


def noted_progress(
    store: Store, progress: Callable[[Progress], None] | None
) -> Callable[[Progress], None]:
    """Progress that is also left beside the lock, for other shells."""
    noted = -math.inf

    def note(state: Progress) -> None:
        nonlocal noted
        now = time.monotonic()
        if now - noted > NOTED_S or state.done == state.total:
            noted = now
            counts = {k: getattr(state, k) for k in ("done", "total", "counted", "failed")}
            at = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
            note_of_run = counts | {"label": state.label[:80], "at": at}
            if (left := state.seconds_left) is not None:
                note_of_run["seconds_left"] = round(left, 1)
            store.note(note_of_run)
        if progress is not None:
            progress(state)

    return note


def run_batch(
    work: Work,
    store: Store,
    executor: Executor,
    progress: Callable[[Progress], None] = lambda _: None,
) -> int:
    """Compute every case of ``work`` that the store does not hold yet; how many these are.

    Of those that failed, what the design says is tried until nothing is left to be tried.
    """
    with store.lock(), _terminate_is_interrupt():
        todo = missing(work, store)
        check_allowed(externals(job.case.problem for job in todo), work.allowed.commands)
        _compute([(job, ()) for job in todo], store, executor, progress)
        while again := attempts(work, store, limit_of(executor) is not None):
            for (longer, alone), alike in again.items():
                again_progress = in_phase(progress, "other settings")
                _compute(alike, store, adapted(executor, longer, alone), again_progress)
        return len(todo)


def computed(
    work: Work,
    store: Store,
    executor: Executor,
    progress: Callable[[Progress], None],
    cases: Sequence[CaseJob],
) -> list[Record | None]:
    """Compute further cases of a study; the record of each."""
    part = replace(work, jobs=tuple(cases))
    run_batch(part, store, executor, progress)
    records = store.by_case(part.input_hashes)
    return [records.get(case.case.case_id) for case in cases]


def missing(work: Work, store: Store) -> list[CaseJob]:
    """Cases without a usable record of this very input."""
    done = store.done_ids(work.input_hashes, RETRIED)
    return [job for job in work.jobs if job.case.case_id not in done]


def open_fits(todo: Sequence[CaseJob], store: Store) -> list[FitJob]:
    """Fits that the cases need and that are not stored yet."""
    return [job for job in fits_of(todo).values() if store.read_fit(job.key) is None]


def _compute(
    todo: Sequence[tuple[CaseJob, Notes]],
    store: Store,
    executor: Executor,
    progress: Callable[[Progress], None],
) -> None:
    """Compute cases, and the fits that they need, and store each as it comes."""
    cases = {f"case-{job.case.case_id}": (job, notes) for job, notes in todo}
    fits: dict[str, FitJob] = {}
    stored: dict[str, Document] = {}
    for fit in fits_of(job for job, _ in todo).values():
        stored_fit = store.read_fit(fit.key)
        if stored_fit is None:
            fits[fit.key] = fit
        else:
            stored[fit.key] = stored_fit
    costs, jobs = Costs(), dict[str, FitJob | CaseJob](fits)
    jobs |= {key: job for key, (job, _) in cases.items()}
    tasks = [  # what they are predicted to take gives their order
        Task(key, partial(_sent, job), job.needs, job.group, costs.seconds(job), costs.MB(job))
        for key, job in jobs.items()
    ]
    began, failed, fits_done = time.monotonic(), 0, 0
    work = {task.key: task.seconds for task in tasks}
    work_s, done_s = math.fsum(work.values()), 0.0
    with contextlib.closing(executor.run(tasks, stored)) as outcomes:
        for count, outcome in enumerate(outcomes, 1):
            if outcome.key in fits:
                fits_done += 1
                label = f"calibration of {fits[outcome.key].label}"
                if outcome.status in LASTING:
                    store.write_fit(outcome.key, outcome.result, followed=outcome.followed)
            else:
                job, notes = cases[outcome.key]
                label = job.case.label
                failed += not _written(job, notes, outcome, store).converged
            seconds, done_s = time.monotonic() - began, done_s + work[outcome.key]
            share, counts = done_s / work_s, (fits_done, len(fits))
            progress(Progress(count, len(tasks), failed, seconds, label, *counts, share))


def _written(job: CaseJob, notes: Notes, outcome: Outcome, store: Store) -> Record:
    """Store the record of a case, and the folder of a program where that is kept."""
    text = outcome.result.get("record")
    if isinstance(text, str):
        record = Record.from_json(text, f"worker, {job.case.label}")
    else:
        why = str(outcome.result.get("traceback", ""))
        record = job.record(
            outcome.status, outcome.message, extra={"traceback": why} if why else {},
            seconds={"total": outcome.seconds},
        )  # fmt: skip
    if notes:
        record = replace(record, extra={**record.extra, "retries": [dict(n) for n in notes]})
    store.write(record, followed=outcome.followed)
    folder = outcome.result.get("folder")
    if isinstance(folder, str):
        store.write_folder(record.case_id, base64.b64decode(folder))
    return record


def _sent(job: FitJob | CaseJob, results: Results) -> FitJob | CaseJob:
    return job.sent({key: FitResult.from_json(results[key]) for key in job.needs})


@contextlib.contextmanager
def _terminate_is_interrupt() -> Iterator[None]:
    """Let SIGTERM, and SIGHUP without nohup, stop a run of the main thread as Ctrl-C does."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, stop)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


# What a run is, and what becomes of results of other libraries, other code or another mesh.


def read_truths(root: Path, files: Mapping[str, str]) -> dict[str, Any]:
    """How the virtual specimens of measurement files were made, by name of the file."""
    notes = {name: root / f"{name}{TRUTH_SUFFIX}" for name in files}
    return {
        name: cast("dict[str, Any]", read_json(path))
        for name, path in notes.items()
        if path.is_file()
    }


def manifest_of(work: Work) -> ManifestDocument:
    """Say what a study is, before anything of it is computed."""
    truths = read_truths(work.data.root, work.data.files())
    return {
        "name": work.design.name,
        "design": dump(work.design),
        "text": work.design.text,
        "source": Path(work.design.source).name,
        "cases": work.input_hashes,
        "blocks": list(work.blocks),
        "notes": list(work.data.notes()),
        "files": work.data.files(),
        "virtual": bool(truths),
        "truths": truths,
        "versions": versions(),
        "timings": {},
    }


REFUSE = "refuse"
WARN = "warn"
RERUN = "rerun"
CHOICES = (REFUSE, WARN, RERUN)
_MEND = (
    "    --stale warn goes on with what still counts, --stale rerun computes again what does not"
)


def check_choice(stale: str) -> None:
    """Refuse a word that is none of :data:`CHOICES`."""
    if stale not in CHOICES:
        raise InputError(Fault("stale", f"there is no choice {stale!r}", nearest(stale, CHOICES)))


def check_stale(work: Work, store: Store, stale: str) -> list[str]:
    """Decide what becomes of results that would come out of other code or libraries today.

    Those of another design, other data or other code of this package have another key and never
    count; those of other libraries count unless they are to be computed again.
    """
    now = versions()
    others = store.other_libraries(work.input_hashes, now)
    store.made_with(now, strict=stale == RERUN)
    if stale == REFUSE:
        foreign = len(store.survey(work.input_hashes).foreign)
        if foreign:
            others.append(f"{foreign} results have another input: study why CASE names it")
        if others:
            listed = "\n".join(f"    {change}" for change in others)
            raise RefusedError(
                f"{store.path}: its results are not those of today:\n{listed}\n{_MEND}"
            )
    if stale == RERUN:
        return []
    return [
        f"{change}; they are used, and study run --stale rerun makes them again"
        for change in others
    ]


def mixed_meshes(work: Work, store: Store) -> list[str]:
    """Warn of cells whose meshes should be one and are not: the work of another gmsh or machine."""
    meshes = store.meshes(work.input_hashes)
    meshes_of: dict[str, set[str]] = defaultdict(set)
    labels: dict[str, str] = {}
    for job in work.jobs:
        mesh = meshes.get(job.case.case_id)
        if mesh is not None:
            fits = [() if pair.fit is None else pair.fit.measured for pair in job.directions]
            fitted = [[float(curve.displacement_mm.max()) for curve in curves] for curves in fits]
            scored = [pair.depth_mm for pair in job.directions]
            name = digest([job.case.cell.content_key, job.forward, scored, fitted], 32)
            meshes_of[name].add(mesh)
            labels.setdefault(name, job.case.label)
    mixed = [labels[name] for name, several in meshes_of.items() if len(several) > 1]
    if not mixed:
        return []
    more = f" and {len(mixed) - 1} more" if len(mixed) > 1 else ""
    return [
        f"{mixed[0]}{more}: the cases of this cell were computed on different meshes, by another "
        "gmsh or on another machine; study run --stale rerun makes them again on one"
    ]
