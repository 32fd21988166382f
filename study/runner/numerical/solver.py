"""Where solutions of refinement series come from: this process, workers, or the store."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from study.execution.loky import Loky
from study.execution.task import Document, Executor, Results, Task
from study.record.folder import own_folder
from study.record.store import Store
from study.runner.numerical.solve_task import Solver, SolveResult, SolveTask, perform, solved

#: results that the same input gives again; memory and time may be better another day
_KEPT = ("converged", "not-converged", "unstable", "mesh-failed")


def in_process(tasks: Sequence[SolveTask]) -> Iterator[tuple[str, SolveResult]]:
    """Solve one after another in this process.

    Parameters
    ----------
    tasks : sequence of SolveTask
        Equal ones are solved again.

    Yields
    ------
    str
        Key of a task.
    SolveResult
        What became of it.
    """
    for task in tasks:
        yield task.key, solved(task)


def by_workers(jobs: int, executor: Executor | None = None) -> Solver:
    """Solve on several worker processes; a worker that dies costs its own solution only.

    Parameters
    ----------
    jobs : int
        Number of processes; without effect where an executor is given.
    executor : Executor, optional
        Where the tasks run; by default ``jobs`` processes of this machine.
    """

    def solve(tasks: Sequence[SolveTask]) -> Iterator[tuple[str, SolveResult]]:
        work = [Task(task.key, partial(_as_is, task.to_json())) for task in tasks]
        for outcome in (executor or Loky(perform, jobs)).run(work):
            yield outcome.key, SolveResult.from_json(outcome.result)

    return solve


def _as_is(document: Document, results: Results) -> Document:
    """Payload of a task that needs no other's result."""
    return document


def kept(solve: Solver, store: Store) -> Solver:
    """Read what is stored, solve the rest, and store each result as it comes.

    Parameters
    ----------
    solve : Solver
        Gets the tasks that are not stored, all at once; not called where there are none.
    store : Store
        Keeps solutions by the keys of their tasks; not those that failed for want of memory or
        time, by a crash or by another fault.
    """

    def looked_up(tasks: Sequence[SolveTask]) -> Iterator[tuple[str, SolveResult]]:
        missing = []
        for task in tasks:
            known = store.read_solution(task.key)
            if known is not None:
                yield task.key, SolveResult.from_json(known)
            else:
                missing.append(task)
        for key, result in solve(missing) if missing else ():
            if result.status in _KEPT:
                with store.lock():
                    store.write_solution(key, result.to_json())
            yield key, result

    return looked_up


def is_kept(task: SolveTask, store: Store) -> bool:
    """Whether the solution of a task is stored.

    Parameters
    ----------
    task : SolveTask
        Its key counts, which changes with the code.
    store : Store
        Of the study or the problem.
    """
    return store.read_solution(task.key) is not None


def store_of(results: Path, name: str) -> Store:
    """Store of a problem or a design by its name.

    Parameters
    ----------
    results : Path
        Folder of all results.
    name : str
        Any text; :func:`slug` makes the name of the folder of it.
    """
    return Store(own_folder(results, slug(name)))


def slug(name: str) -> str:
    """Name of a folder from any name.

    Parameters
    ----------
    name : str
        Every run of characters other than ASCII letters, digits, ``_`` and ``-`` becomes one ``-``;
        the rest is cut after 80 characters. Where nothing is left, the folder is ``problem``.
    """
    return re.sub(r"[^A-Za-z0-9_-]+", "-", name).strip("-")[:80] or "problem"
