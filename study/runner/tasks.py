"""The kinds of task of a study, each with the function that does it in a worker."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeGuard, cast

from study.errors import Fault, InputError, UnitError
from study.execution.cluster.connection import Client
from study.execution.cluster.executor import Cluster
from study.execution.loky import Loky
from study.execution.task import Document, Executor, Perform
from study.runner import case
from study.runner.fitting import fit_task, residual_bootstrap
from study.runner.numerical import solve_task
from study.runner.provenance import versions
from study.runner.virtual import reference
from study.units import parse

#: where a study is computed: an executor, or the scheduler of a Dask cluster by its address, its
#: scheduler file or a client of it
Engine = Executor | Client | str | Path

KINDS: dict[str, Perform] = {
    "case": case.perform,
    "fit": fit_task.perform,
    "noise": residual_bootstrap.perform,
    "reference": reference.perform,
    "solve": solve_task.perform,
    "ping": lambda task: {"status": "converged"},
}


def perform(task: dict[str, object]) -> Document:
    """Do one task, named by its ``kind``.

    Parameters
    ----------
    task : dict
        Plain data with a key of :data:`KINDS` under ``kind``, and what its function reads.

    Returns
    -------
    mapping
        Plain data with the ``status`` of the task.
    """
    return KINDS[str(task["kind"])](task)


def processes(
    jobs: int,
    timeout_s: float | None = None,
    memory_MB: float | None = None,  # noqa: N803
) -> Executor:
    """Start processes of this machine, which know every kind of task.

    Parameters
    ----------
    jobs : int
        Tasks at once.
    timeout_s : float, optional
        Wall-clock limit of one task in seconds.
    memory_MB : float, optional
        Room for the predicted memory of all tasks that run at once; by default what the machine
        has free.
    """
    return Loky(perform, jobs, timeout_s, memory_MB or free_memory_MB())


def free_memory_MB() -> float | None:  # noqa: N802
    """Memory of this machine that nobody uses now; None where it does not say."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        found = {name: rest for name, _, rest in (line.partition(":") for line in lines)}
        return float(found["MemAvailable"].split()[0]) * 1.024e-3  # of 1,024 bytes each
    except (OSError, KeyError, ValueError, IndexError):
        return None


def memory_of(text: str) -> float:
    """Read an amount of memory in MB.

    Parameters
    ----------
    text : str
        Number with a unit: MB, GB, MiB or GiB.

    Raises
    ------
    InputError
        If it is none, or not more than zero.

    Examples
    --------
    >>> memory_of("20 GB")
    20000.0
    """
    try:
        found = parse(text, "memory")
    except UnitError as error:
        raise InputError([replace(fault, where="memory") for fault in error.faults]) from error
    if found <= 0:
        raise InputError(Fault("memory", f"must be more than zero, got {text!r}"))
    return found


def computing_on(
    engine: Engine,
    jobs: int | None = None,
    timeout_s: float | None = None,
    files: Sequence[Path] = (),
) -> tuple[Executor, int | None]:
    """Find the executor that an engine means, and how many tasks it does at once.

    Parameters
    ----------
    engine : Executor, str, Path or distributed.Client
        Where to compute. A scheduler is reached, its workers are compared with this machine.
    jobs : int, optional
        Tasks at once; by default one a thread of the cluster.
    timeout_s : float, optional
        Wall-clock limit of one task in seconds; an executor has its own.
    files : sequence of Path
        Files that tasks read on the machine where they are done.

    Raises
    ------
    InputError
        If the scheduler cannot be reached.
    RefusedError
        If versions of a worker differ from those of this machine.
    """
    if not _is_scheduler(engine):
        return cast("Executor", engine), jobs
    cluster = Cluster(perform, engine, versions, jobs, timeout_s, files)
    return cluster, cluster.slots()


def _is_scheduler(engine: Engine) -> TypeGuard[str | Path | Client]:
    """Whether it leads to a cluster; a client of Dask has a ``run`` too, which is another one."""
    return isinstance(engine, str | os.PathLike) or hasattr(engine, "nthreads")


def limit_of(place: Executor) -> float | None:
    """Wall-clock limit of one task of an executor in seconds; None where there is none.

    Parameters
    ----------
    place : Executor
        Processes of this machine or a cluster; the limit of any other is not known, so None.
    """
    return place.limit_s if isinstance(place, Loky | Cluster) else None


def adapted(place: Executor, longer: float = 1.0, alone: bool = False) -> Executor:
    """Copy an executor with a longer limit, or with one task at a time.

    Parameters
    ----------
    place : Executor
        One that is not ours stays as it is.
    longer : float
        Times the limit of one task.
    alone : bool
        Whether a task has the memory of the machine to itself.
    """
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
