"""The kinds of task of a study, each with the function that does it in a worker."""

from __future__ import annotations

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


def processes(jobs: int, timeout_s: float | None = None) -> Executor:
    """Start processes of this machine, which know every kind of task.

    Parameters
    ----------
    jobs : int
        Tasks at once.
    timeout_s : float, optional
        Wall-clock limit of one task in seconds.
    """
    return Loky(perform, jobs, timeout_s)
