"""Worker processes that may die without taking anything with them.

Each worker is a fresh interpreter that reads one JSON task at a time from a pipe and
answers with one JSON result. A worker that is killed, hangs or runs out of memory costs
its own task and nothing else (joblib and ``ProcessPoolExecutor`` lose the whole batch).
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, Pipe, wait
from typing import Any

#: one thread a worker, set before numpy loads: workers times threads must not exceed the cores,
#: and a sum split over threads could depend on their number
THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMEXPR_NUM_THREADS",
)

#: seconds between two looks at workers that say nothing
_GLANCE_S = 0.5
WORKER_COMMAND = (sys.executable, "-m", "study.runner.worker")


@dataclass(frozen=True)
class Task:
    """One unit of work: ``payload`` is made only when every task it needs is finished.

    Tasks of one ``group`` share something that a worker keeps: one worker does them all.
    """

    key: str
    payload: Callable[[Mapping[str, dict[str, Any]]], dict[str, Any]]
    needs: tuple[str, ...] = ()
    group: str = ""


@dataclass(frozen=True)
class Outcome:
    """What became of a task; the result always has a ``status``."""

    key: str
    result: dict[str, Any]
    seconds: float = 0.0


@dataclass
class _Worker:
    process: subprocess.Popen[bytes]
    connection: Connection
    task: Task | None = None
    started: float = 0.0
    group: str = ""


def run_tasks(
    tasks: Sequence[Task],
    *,
    jobs: int,
    finished: Mapping[str, dict[str, Any]] | None = None,
    timeout_s: float | None = None,
    command: Sequence[str] | None = None,
) -> Generator[Outcome, None, None]:
    """Run tasks in dependency order on ``jobs`` workers; yield each outcome as it comes.

    A worker that dies is replaced and its task tried once more; the second death is its
    outcome. Leaving the loop early (an exception, Ctrl-C) kills every worker.

    Parameters
    ----------
    finished : mapping of str to dict
        Results that exist already, by key; tasks may need them.
    timeout_s : float, optional
        Wall-clock limit of one task in seconds.
    command : sequence of str, optional
        Program of a worker; gets the number of its pipe as last argument.
    """
    run = _Run(list(tasks), dict(finished or {}), jobs, timeout_s, tuple(command or WORKER_COMMAND))
    try:
        yield from run.outcomes()
    finally:
        run.close()


@dataclass
class _Run:
    waiting: list[Task]
    results: dict[str, dict[str, Any]]
    jobs: int
    timeout_s: float | None
    command: tuple[str, ...]
    workers: list[_Worker] = field(default_factory=list)
    deaths: dict[str, int] = field(default_factory=dict)

    def outcomes(self) -> Generator[Outcome, None, None]:
        while self.waiting or any(w.task for w in self.workers):
            self._dispatch()
            busy = [w for w in self.workers if w.task]
            if not busy:
                names = ", ".join(t.key for t in self.waiting)
                raise RuntimeError(f"tasks wait for something that nobody makes: {names}")
            for worker in self._ready(busy):
                outcome = self._collect(worker)
                if outcome is not None:
                    self.results[outcome.key] = outcome.result
                    yield outcome

    def close(self) -> None:
        for worker in self.workers:
            _kill(worker)
        self.workers.clear()

    def _dispatch(self) -> None:
        for worker in [w for w in self.workers if w.task is None]:
            task = self._next(worker.group)
            if task is not None:
                self._send(worker, task)
        while len(self.workers) < self.jobs:
            task = self._next("")
            if task is None:
                return
            self._send(self._start(), task)

    def _send(self, worker: _Worker, task: Task) -> None:
        worker.task, worker.started = task, time.monotonic()
        worker.group = task.group or worker.group  # kept while it does other things
        message = json.dumps(task.payload(self.results), allow_nan=False).encode()
        with contextlib.suppress(OSError):  # a dead worker is noticed when collecting
            worker.connection.send_bytes(message)

    def _next(self, group: str) -> Task | None:
        """Take a ready task: of the worker's own group, else of one that no worker has."""
        held = {w.group for w in self.workers if w.group}
        ready = [t for t in self.waiting if all(need in self.results for need in t.needs)]
        own = (t for t in ready if group and t.group == group)
        free = (t for t in ready if t.group not in held)
        task = next(own, None) or next(free, None)
        if task is not None:
            self.waiting.remove(task)
        return task

    def _start(self) -> _Worker:
        ours, theirs = Pipe()
        environment = dict(os.environ) | dict.fromkeys(THREAD_VARIABLES, "1")
        process = subprocess.Popen(
            [*self.command, str(theirs.fileno())],
            pass_fds=[theirs.fileno()],
            env=environment,
            stdin=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C reaches the parent alone, which then kills the group
        )
        theirs.close()
        worker = _Worker(process, ours)
        self.workers.append(worker)
        return worker

    def _ready(self, busy: list[_Worker]) -> list[_Worker]:
        ready = set(wait([w.connection for w in busy], timeout=self._patience(busy)))
        late = [w for w in busy if w.connection not in ready and self._is_late(w)]
        return [w for w in busy if w.connection in ready] + late

    def _patience(self, busy: list[_Worker]) -> float:
        """Seconds until somebody may be late, half of one at most."""
        if self.timeout_s is None:
            return _GLANCE_S
        longest = max((time.monotonic() - w.started for w in busy), default=0.0)
        return min(max(self.timeout_s - longest, 0.0), _GLANCE_S)

    def _is_late(self, worker: _Worker) -> bool:
        return self.timeout_s is not None and time.monotonic() - worker.started > self.timeout_s

    def _collect(self, worker: _Worker) -> Outcome | None:
        task, seconds = worker.task, time.monotonic() - worker.started
        if task is None:
            raise RuntimeError("a worker without a task was collected")
        if not worker.connection.poll():
            self._drop(worker)
            message = f"stopped after {self.timeout_s:g} s, the limit of one computation"
            return Outcome(task.key, {"status": "timeout", "message": message}, seconds)
        try:
            result = json.loads(worker.connection.recv_bytes())
        except (EOFError, OSError):
            return self._died(worker, task, seconds)
        worker.task = None
        return Outcome(task.key, result, seconds)

    def _died(self, worker: _Worker, task: Task, seconds: float) -> Outcome | None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            worker.process.wait(timeout=5)  # its pipe is closed: let it tell how it died
        code = worker.process.returncode
        self._drop(worker)
        self.deaths[task.key] = self.deaths.get(task.key, 0) + 1
        if self.deaths[task.key] < 2:
            self.waiting.insert(0, task)
            return None
        return Outcome(task.key, {"status": "crashed", "message": _cause_of_death(code)}, seconds)

    def _drop(self, worker: _Worker) -> None:
        _kill(worker)
        self.workers.remove(worker)


def _cause_of_death(code: int | None) -> str:
    if code is not None and code < 0:
        number = -code
        hint = " (out of memory?)" if number == signal.SIGKILL else ""
        return f"crashed (signal {number}){hint}, twice"
    return f"crashed (exit code {code}), twice"


def _kill(worker: _Worker) -> None:
    process = worker.process
    if process.poll() is None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    worker.connection.close()
