"""Many cases: what is missing is computed in parallel, and every result is written at once.

The parent owns the store; workers only compute. Whatever happens to a worker or to the
parent, finished results stay, and running again does the rest.
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
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

from study.execution.local import Document, Executor, Outcome, Results, Task
from study.external.command import check_allowed
from study.ground.canonical import digest
from study.ground.errors import Fault, InputError, RefusedError, nearest
from study.ground.files import read_json
from study.harness.design.load import dump
from study.harness.design.spec import FINER_MESH, LONGER_LIMIT, MORE_MEMORY, SMALLER_STEPS
from study.harness.runner.expansion import Work, case_job
from study.record.record import ManifestDocument, Record, RetryDocument
from study.record.store import Store
from study.simulation.cell import CellProblem, tested
from study.simulation.job import TRUTH_SUFFIX, CaseJob, FitJob, FitResult, externals, fits_of
from study.simulation.provenance import versions
from study.simulation.refinement import base_size_mm
from study.simulation.solve_task import LASTING
from study.simulation.tasks import Costs, adapted, limit_of

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
            size = base_size_mm(job) / work.design.converge.ratio
            cell = cell.on_mesh(mesh_size_mm=size)
            what = f"elements of {size:.4g} mm instead of {base_size_mm(job):.4g} mm"
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
