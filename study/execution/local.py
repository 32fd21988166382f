"""Tasks on processes of this machine, by joblib's loky: one process a slot.

An executor of several processes breaks as a whole when one of them dies, and takes finished
answers along; with one process each, a death costs one task.
"""

from __future__ import annotations

import contextlib
import gc
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Future
from concurrent.futures import wait as wait_for
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar

from study.execution.supervisor import (
    Answer,
    Done,
    Outcome,
    Perform,
    ReadyQueue,
    Results,
    Supervisor,
    Task,
    answers,
    check_limit,
)
from study.ground.working_folder import SafeChildren

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
    """Executor on processes of this machine."""

    #: Does one task; a function of a module that the processes can import.
    perform: Perform
    jobs: int
    #: Wall-clock limit of one task in seconds.
    limit_s: float | None = None
    #: Room for the predicted memory of all tasks that run at once.
    memory_MB: float | None = None  # noqa: N815

    def run(
        self, tasks: Sequence[Task], finished: Results | None = None
    ) -> Generator[Outcome, None, None]:
        """Yield the outcome of every task as it comes; ``close()`` kills what still runs."""
        limit = check_limit(self.limit_s)
        slots = [Process(self.perform) for _ in range(min(self.jobs, max(len(tasks), 1)))]
        try:
            for slot in slots:
                slot.open()
            ready = ReadyQueue(tasks, finished or {})
            yield from Supervisor(ready, list(slots), limit, memory_MB=self.memory_MB).outcomes()
        finally:
            for slot in slots:
                slot.kill()


class ProcessPool(Protocol):
    """What is used of loky's executor, which has no types of its own."""

    def submit(self, call: Callable[..., Given], /, *args: object) -> Future[Given]:
        """Begin a call in a process."""

    def shutdown(self, wait: bool = True, kill_workers: bool = False) -> None:
        """End the processes."""


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
        with SafeChildren():  # the process, and the trackers that loky starts beside it
            pool: ProcessPool = ProcessPoolExecutor(
                1, env=capped, initializer=serve_quietly, initargs=(os.getpid(),)
            )
            self._executor, self._up = pool, pool.submit(os.getpid)
        return pool

    def start(self, payloads: Sequence[object], done: Done, ticket: object) -> bool:
        """Begin some tasks; a process that is not up yet is waited for by a thread."""
        pool = self._executor or self.open()
        up = self._up
        if up is None or up.done():
            self._hand_over(pool, payloads, done, ticket)
            return False

        def wait() -> None:
            wait_for([up])  # whatever became of it is said when the task is handed over
            done.put((ticket, Answer(began=True)))
            self._hand_over(pool, payloads, done, ticket)

        threading.Thread(target=wait, daemon=True).start()
        return True

    def _hand_over(
        self, pool: ProcessPool, payloads: Sequence[object], done: Done, ticket: object
    ) -> None:
        def ended(future: Future[str]) -> None:
            """Answer with what the future gave, or with how its process died."""
            answer = Answer(death="stopped")
            with contextlib.suppress(CancelledError):
                error = future.exception()
                answer = Answer(death=cause_of_death(str(error)))
                if error is None:
                    answer = Answer(future.result())
            done.put((ticket, answer))

        try:
            future = pool.submit(answers, self._perform, payloads)
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


def serve_quietly(parent: int) -> None:
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

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(PARENT_CHECK_S)
        os.killpg(0, signal.SIGKILL)  # with every program that the task started

    threading.Thread(target=watch, daemon=True).start()


def cause_of_death(message: str) -> str:
    """How a process died, in a few words.

    Examples
    --------
    >>> cause_of_death("... exit codes of the workers are {SIGKILL(-9)}")
    'crashed (signal 9) (out of memory?)'
    >>> cause_of_death("... exit codes of the workers are {EXIT(3)}")
    'crashed (exit code 3)'
    """
    match = re.search(r"exit codes of the workers are \{\w+\((-?\d+)\)", message)
    if match is None:
        return "crashed"
    code = int(match[1])
    if code >= 0:
        return f"crashed (exit code {code})"
    hint = " (out of memory?)" if -code == signal.SIGKILL else ""
    return f"crashed (signal {-code}){hint}"


# One process that works beside this one: what it cannot do is done here.


class Worker:
    """Context with a process that begins calls while this one goes on.

    It may start long before its first call, with what that call will import. A death, or
    arguments that cannot be sent, cost nothing but the time: the call is then made here.
    """

    def __init__(self, prepare: Callable[[], object]) -> None:
        self._prepare = prepare
        self._process = Process(dict)

    def __enter__(self) -> Worker:
        """Start the process."""
        self._pool = self._process.open()
        self._pool.submit(self._prepare)
        return self

    def __exit__(self, *_: object) -> None:
        """End the process, whatever it does."""
        self._process.kill()

    def begin(self, call: Callable[..., Given], *arguments: object) -> Callable[[], Given]:
        """Begin a call there."""
        try:
            future: Future[Given] = self._pool.submit(call, *arguments)
        except Exception:  # noqa: BLE001 - the process has died: the call itself can still be made
            return lambda: call(*arguments)

        def given() -> Given:
            try:
                return future.result()
            except Exception:  # noqa: BLE001 - as above; a fault of the call itself is raised here
                return call(*arguments)

        return given


# Memory of this machine and of this process.


@contextlib.contextmanager
def uncollected() -> Iterator[None]:
    """Context in which nobody looks for reference cycles."""
    # Records and drawings are made of hundreds of thousands of objects that are all in use: walking
    # through them again and again took a fifth of the time of a report and a tenth of a resume.
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def free_memory_MB() -> float | None:  # noqa: N802
    """Memory of this machine that nobody uses now; None where it does not say."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        amounts = {name: rest for name, _, rest in (line.partition(":") for line in lines)}
        return float(amounts["MemAvailable"].split()[0]) * 1.024e-3  # of 1,024 bytes each
    except (OSError, KeyError, ValueError, IndexError):
        return None
