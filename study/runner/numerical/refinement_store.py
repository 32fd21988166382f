"""Solutions of refinement series: computed once, kept on disk, made here or by workers."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from study.execution.loky import Loky
from study.execution.task import Executor, Task
from study.record.store import Store
from study.runner.numerical import refinement
from study.runner.numerical.refinement import Solver, task_key

#: results that the same input gives again; memory and time may be better another day
_KEPT = ("converged", "not-converged", "unstable", "mesh-failed")


def in_process(tasks: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Solve one after another in this process."""
    return [refinement.perform(task) for task in tasks]


def by_workers(
    jobs: int,
    executor: Executor | None = None,
    finished: Callable[[Mapping[str, Any], dict[str, Any]], object] = lambda task, result: None,
) -> Solver:
    """Solve on several worker processes; a worker that dies costs its own solution only.

    Parameters
    ----------
    executor : Executor, optional
        Where the tasks run; by default ``jobs`` processes of this machine.
    finished : callable
        Called with every task and its result as soon as it is there.
    """

    def solve(tasks: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        by_key = {task_key(task): dict(task) for task in tasks}
        work = [Task(key, _as_is(task)) for key, task in by_key.items()]
        found: dict[str, dict[str, Any]] = {}
        for outcome in (executor or Loky(refinement.perform, jobs)).run(work):
            found[outcome.key] = outcome.result
            finished(by_key[outcome.key], outcome.result)
        return [found[task_key(task)] for task in tasks]

    return solve


def _as_is(task: dict[str, Any]) -> Callable[[Mapping[str, dict[str, Any]]], dict[str, Any]]:
    """Payload of a task that needs no other's result."""
    return lambda _: task


def kept(solve: Solver, store: Store) -> Solver:
    """Read what is stored of a list of tasks, solve the rest, and store it at once."""

    def looked_up(tasks: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = []
        for task in tasks:
            known = store.read_json(f"solves/{task_key(task)}")
            found.append(known if known is not None else keep(store, task, solve([task])[0]))
        return found

    return looked_up


def kept_by_workers(
    jobs: int,
    store: Store,
    executor: Executor | None = None,
    finished: Callable[[Mapping[str, Any], dict[str, Any]], object] = lambda task, result: None,
) -> Solver:
    """Solve what is not stored yet on workers; every result is stored as it comes.

    ``finished`` is called after that with the task and its result.
    """

    def stored(task: Mapping[str, Any], result: dict[str, Any]) -> None:
        keep(store, task, result)
        finished(task, result)

    solve = by_workers(jobs, executor, stored)

    def looked_up(tasks: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        known = {task_key(t): store.read_json(f"solves/{task_key(t)}") for t in tasks}
        todo = [t for t in tasks if known[task_key(t)] is None]
        made = solve(todo) if todo else []
        known |= {task_key(t): result for t, result in zip(todo, made, strict=True)}
        return [dict(known[task_key(t)] or {}) for t in tasks]

    return looked_up


def is_kept(task: Mapping[str, Any], store: Store) -> bool:
    """Whether the solution of a task is stored."""
    return store.read_json(f"solves/{task_key(task)}") is not None


def keep(store: Store, task: Mapping[str, Any], result: dict[str, Any]) -> dict[str, Any]:
    """Store a result that would come out again."""
    if result.get("status") in _KEPT:
        with store.lock():
            store.write_json(f"solves/{task_key(task)}", result)
    return result


def store_of(results: Path, name: str) -> Store:
    """Store of a problem or a design by its name."""
    return Store(results / slug(name))


def slug(name: str) -> str:
    """Name of a folder from any name."""
    return re.sub(r"[^A-Za-z0-9_-]+", "-", name).strip("-")[:80] or "problem"
