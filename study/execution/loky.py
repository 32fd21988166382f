"""Tasks on processes of this machine, by joblib's loky: one process a slot.

An executor of several processes breaks as a whole when one of them dies, and takes finished
answers along; with one process each, a death costs one task.
"""

from __future__ import annotations

import contextlib
import os
import queue
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Future
from dataclasses import dataclass
from typing import Protocol, TypeVar

from study.execution.queue import ReadyQueue
from study.execution.supervisor import Answer, Supervisor
from study.execution.task import Outcome, Perform, Results, Task, answer, check_limit

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
#: what a call in a process gives
Given = TypeVar("Given")

#: seconds within which a worker notices that its parent is gone
PARENT_CHECK_S = 1.0


@dataclass(frozen=True)
class Loky:
    """Executor on processes of this machine.

    Parameters
    ----------
    perform : callable
        Does one task; a function of a module that the processes can import.
    jobs : int
        Tasks at once.
    limit_s : float, optional
        Wall-clock limit of one task in seconds.
    """

    perform: Perform
    jobs: int
    limit_s: float | None = None

    def run(
        self, tasks: Sequence[Task], finished: Results | None = None
    ) -> Generator[Outcome, None, None]:
        """Yield the outcome of every task as it comes; ``close()`` kills what still runs.

        Raises
        ------
        InputError
            If the limit is not a positive number.
        """
        limit = check_limit(self.limit_s)
        slots = [Process(self.perform) for _ in range(min(self.jobs, max(len(tasks), 1)))]
        try:
            for slot in slots:
                slot.open()
            yield from Supervisor(ReadyQueue(tasks, finished or {}), list(slots), limit).outcomes()
        finally:
            for slot in slots:
                slot.kill()


class ProcessPool(Protocol):
    """What is used of loky's executor, which has no types of its own."""

    def submit(self, call: Callable[..., Given], /, *args: object) -> Future[Given]:
        """Begin a call in a process."""
        ...

    def shutdown(self, wait: bool = True, kill_workers: bool = False) -> None:
        """End the processes."""
        ...


class Process:
    """Slot with one process, replaced when a task kills it or takes too long."""

    def __init__(self, perform: Perform) -> None:
        self._perform = perform
        self._executor: ProcessPool | None = None
        self._up: Future[int] | None = None

    def open(self) -> ProcessPool:
        """Let the process start; several slots do so at the same time."""
        from joblib.externals.loky import ProcessPoolExecutor

        capped = dict.fromkeys(THREAD_VARIABLES, "1")
        pool: ProcessPool = ProcessPoolExecutor(1, env=capped, initializer=serve_quietly)
        self._executor, self._up = pool, pool.submit(os.getpid)
        return pool

    def start(
        self, text: str, done: queue.SimpleQueue[tuple[object, Answer]], ticket: object
    ) -> None:
        """Begin a task given as JSON."""

        def ended(future: Future[str]) -> None:
            done.put((ticket, _judged(future)))

        try:
            future = self._warm().submit(answer, self._perform, text)
        except (BrokenExecutor, OSError, RuntimeError) as error:  # it died while it was idle
            done.put((ticket, Answer(death=cause_of_death(str(error)))))
            return
        future.add_done_callback(ended)

    def kill(self) -> None:
        """End the process and everything that it started."""
        executor, up = self._executor, self._up
        self._executor = self._up = None
        if executor is None:
            return
        if up is not None and up.done() and up.exception() is None:
            # from outside, so that loky sees a death: asked to kill while it hands a task
            # over, it loses track of that task
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(up.result(), signal.SIGKILL)
            executor.shutdown(wait=True)
        else:
            executor.shutdown(wait=True, kill_workers=True)

    def _warm(self) -> ProcessPool:
        """Executor with a process that is up, so that its start is in nobody's limit."""
        pool = self._executor or self.open()
        if self._up is not None:
            self._up.result()
        return pool


def serve_quietly() -> None:
    """Prepare a worker process: no output, a group of its own, no life without its parent.

    Ctrl-C then reaches the parent alone, and what a task starts dies with its worker.

    loky's processes outlive a killed parent: they wait on a pipe whose other end they hold.
    They are also replaced once they keep 300 MB, and ours keep solutions on purpose.
    """
    from joblib.externals.loky import process_executor

    process_executor._MAX_MEMORY_LEAK_SIZE = sys.maxsize
    # libraries that print to stdout must not disturb anybody: stdout belongs to --json
    os.dup2(2, 1)
    os.setpgid(0, 0)
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(PARENT_CHECK_S)
        os.killpg(0, signal.SIGKILL)  # with every program that the task started

    threading.Thread(target=watch, daemon=True).start()


def _judged(future: Future[str]) -> Answer:
    """Answer of a future that ended: what it gave, or how its process died."""
    with contextlib.suppress(CancelledError):
        error = future.exception()
        if error is None:
            return Answer(future.result())
        return Answer(death=cause_of_death(str(error)))
    return Answer(death="stopped")


def cause_of_death(said: str) -> str:
    """How a process died, in a few words.

    Examples
    --------
    >>> cause_of_death("... exit codes of the workers are {SIGKILL(-9)}")
    'crashed (signal 9) (out of memory?)'
    >>> cause_of_death("... exit codes of the workers are {EXIT(3)}")
    'crashed (exit code 3)'
    """
    found = re.search(r"exit codes of the workers are \{\w+\((-?\d+)\)", said)
    if found is None:
        return "crashed"
    code = int(found[1])
    if code >= 0:
        return f"crashed (exit code {code})"
    hint = " (out of memory?)" if -code == signal.SIGKILL else ""
    return f"crashed (signal {-code}){hint}"
