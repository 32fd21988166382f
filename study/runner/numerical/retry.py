"""What is tried when a case has no answer: declared in the design, by cause, and never silent.

``[execution] retry`` names the changes of every cause, in the order in which they are tried; each
is made besides those before it. The record of the case says of every attempt what was changed and
why, so that a report can list the cases whose setting is not that of the design.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from study.design.study_file import FINER_MESH, LONGER_LIMIT, MORE_MEMORY, SMALLER_STEPS
from study.record.record import Record
from study.record.store import Store
from study.runner.expansion import case_job
from study.runner.job import CaseJob, Work
from study.runner.numerical.formal_order import base_size_mm
from study.runner.tables import on_mesh, with_both
from study.setup.setup import Setup, Tables

#: what is kept in a record of its attempts, under this name
RETRIES = "retries"

#: how many load steps replace one, and how many times the limit is prolonged
STEPS_FACTOR = 4
LIMIT_FACTOR = 4.0

#: letters of a message that a record keeps of an attempt that failed
MESSAGE = 300


@dataclass(frozen=True)
class Attempt:
    """A case to be computed once more.

    Parameters
    ----------
    job : CaseJob
        Under its own name, with the changed tables.
    notes : tuple of mapping of str to str
        Every change so far: ``cause`` and ``message`` of the failure before it, the ``change``,
        and ``what`` it is in numbers.
    longer : float
        Times the limit of one computation.
    alone : bool
        Whether nothing else may be computed beside it.
    """

    job: CaseJob
    notes: tuple[Mapping[str, str], ...]
    longer: float = 1.0
    alone: bool = False


def attempts(work: Work, store: Store, limited: bool) -> list[Attempt]:
    """List the cases that failed for a cause of which something is still to be tried.

    Parameters
    ----------
    work : Work
        The study, or a part of it.
    store : Store
        Holds the records of what failed.
    limited : bool
        Whether computations have a limit, which could be longer.
    """
    if not work.design.retry:
        return []
    failed = store.survey(work.input_hashes).failed
    jobs = {job.case.case_id: job for job in work.jobs}
    found = []
    for case_id in failed:
        record = store.read(case_id)
        if record is not None and case_id in jobs:
            attempt = _next(work, jobs[case_id], record, limited)
            found += [] if attempt is None else [attempt]
    return found


def _next(work: Work, job: CaseJob, record: Record, limited: bool) -> Attempt | None:
    """Next change of a failed case; None where there is none left."""
    before = notes_of(record)
    done = [note["change"] for note in before]
    for change in work.design.retry.get(record.status, ()):
        if change in done or not _applies(change, job, limited):
            continue
        changed, what = _changed(job, [*done, change], work)
        note = {
            "cause": record.status,
            "message": record.message[:MESSAGE],
            "change": change,
            "what": what,
        }
        longer = LIMIT_FACTOR if LONGER_LIMIT in (*done, change) else 1.0
        return Attempt(changed, (*before, note), longer, MORE_MEMORY in (*done, change))
    return None


def notes_of(record: Record) -> tuple[Mapping[str, str], ...]:
    """Every attempt that a record tells of; empty where the design's own setting gave it.

    Parameters
    ----------
    record : Record
        Of a case with or without an answer.

    Returns
    -------
    tuple of mapping of str to str
        The first attempt first, each as in the notes of :class:`Attempt`.
    """
    kept = record.extra.get(RETRIES)
    return tuple(kept) if isinstance(kept, (list, tuple)) else ()


def has_other_mesh(record: Record) -> bool:
    """Whether a case was computed on a finer mesh than its own.

    Parameters
    ----------
    record : Record
        Its attempts count, see :func:`notes_of`.
    """
    return any(note["change"] == FINER_MESH for note in notes_of(record))


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
    tables: Tables = job.case.config
    what = ""
    for change in changes:
        if change == SMALLER_STEPS:
            tables, what = _with_steps(tables)
        elif change == FINER_MESH:
            old = base_size_mm(job)
            size = old / work.design.converge.ratio
            tables = on_mesh(tables, mesh=None, mesh_size_mm=size)
            what = f"elements of {size:.4g} mm instead of {old:.4g} mm"
        elif change == LONGER_LIMIT:
            what = f"a limit {LIMIT_FACTOR:g} times as long"
        else:
            what = "computed with nothing else beside it"
    if tables is job.case.config:
        return job, what
    case = replace(job.case, config=dict(tables))
    made = case_job(case, work.data, work.design, job.origin)
    return replace(made, input_hash=job.input_hash), what


def _with_steps(tables: Tables) -> tuple[Tables, str]:
    """Copy tables with smaller load steps, in the problem of the calibration too."""
    old = Setup.of(tables).test.steps
    new = STEPS_FACTOR * old
    return with_both(tables, "test", steps=new), f"{new} load steps instead of {old}"
