"""The kinds of task of a study, each with the function that does it in a worker."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

from study.ground.errors import Fault, InputError, UnitError
from study.ground.memory import free_memory_MB
from study.ground.units import parse
from study.harness.execution.cluster import Client, Cluster
from study.harness.execution.local import Loky
from study.harness.execution.task import Document, Executor, Perform
from study.harness.runner import case, fit_task, solve_task
from study.harness.runner.job import CaseJob
from study.harness.runner.provenance import versions

#: where a study is computed: an executor, or the scheduler of a Dask cluster by its address, its
#: scheduler file or a client of it
Engine = Executor | Client | str | Path

#: a task that only asks whether a worker answers
PING = "ping"
#: what does a task, by its class
KINDS: dict[type, Perform] = {
    CaseJob: case.perform,
    fit_task.FitTask: fit_task.perform,
    solve_task.SolveTask: solve_task.perform,
    str: lambda task: {"status": "converged"},
}


def perform(task: object) -> Document:
    """Do one task in a worker."""
    return KINDS[type(task)](task)


def processes(
    jobs: int | None = None,
    timeout_s: float | None = None,
    memory_MB: float | None = None,  # noqa: N803
) -> Executor:
    """Start processes of this machine, which know every kind of task."""
    return Loky(perform, jobs or default_jobs(), timeout_s, memory_MB or free_memory_MB())


def memory_of(text: str) -> float:
    """Read an amount of memory in MB.

    Examples
    --------
    >>> memory_of("20 GB")
    20000.0
    """
    try:
        amount_MB = parse(text, "memory")
    except UnitError as error:
        raise InputError([replace(fault, where="memory") for fault in error.faults]) from error
    if amount_MB <= 0:
        raise InputError(Fault("memory", f"must be more than zero, got {text!r}"))
    return amount_MB


def computing_on(
    engine: Engine,
    jobs: int | None = None,
    timeout_s: float | None = None,
    files: Sequence[Path] = (),
) -> Executor:
    """Find the executor that an engine means."""
    # a client of Dask has a ``run`` too, which is another one
    if isinstance(engine, str | os.PathLike) or hasattr(engine, "nthreads"):
        scheduler = cast("str | Path | Client", engine)
        return Cluster(perform, scheduler, versions, jobs, timeout_s, files).reached()
    return engine


def limit_of(place: Executor) -> float | None:
    """Wall-clock limit of one task of an executor in seconds; None where there is none."""
    return place.limit_s if isinstance(place, Loky | Cluster) else None


def adapted(place: Executor, longer: float = 1.0, alone: bool = False) -> Executor:
    """Copy an executor with a longer limit, or with one task at a time."""
    if not isinstance(place, Loky | Cluster):
        return place
    limit = None if place.limit_s is None else longer * place.limit_s
    longest = replace(place, limit_s=limit)
    return replace(longest, jobs=1) if alone else longest


def default_jobs() -> int:
    """One worker for each core that this process may use."""
    with contextlib.suppress(AttributeError):
        return max(1, len(os.sched_getaffinity(0)))
    return os.cpu_count() or 1
