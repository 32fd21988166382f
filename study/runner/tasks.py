"""The kinds of task of a study, each with the function that does it in a worker."""

from __future__ import annotations

from pathlib import Path

from study.execution.loky import Loky
from study.execution.task import Document, Executor, Perform
from study.runner import case
from study.runner.fitting import fit_task, residual_bootstrap
from study.runner.numerical import solve_task
from study.runner.virtual import reference

KINDS: dict[str, Perform] = {
    "case": case.perform,
    "fit": fit_task.perform,
    "noise": residual_bootstrap.perform,
    "reference": reference.perform,
    "solve": solve_task.perform,
    "ping": lambda task: {"status": "converged"},
}


def perform(task: dict[str, object]) -> Document:
    """Do one task, named by its ``kind``."""
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
        return float(found["MemAvailable"].split()[0]) / 1024
    except (OSError, KeyError, ValueError, IndexError):
        return None
