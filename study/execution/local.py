"""One loop for every executor, and processes of this machine, by joblib's loky: one a slot.

The loop hands tasks to slots, waits, enforces limits, tries again. An executor of several processes
breaks as a whole when one of them dies, and takes finished answers along; with one process each, a
death costs one task.
"""

from __future__ import annotations

import contextlib
import gc
import heapq
import json
import math
import os
import queue
import re
import signal
import sys
import threading
import time
import traceback
from collections import Counter, defaultdict
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Future
from concurrent.futures import wait as wait_for
from dataclasses import dataclass, field, replace
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Protocol, TypeVar

from study.ground.errors import Fault, InputError
from study.ground.files import UnreadableError, parse_json
from study.ground.working_folder import SafeChildren

# A unit of work, what became of it, and what an executor promises.
#: what JSON can hold under names: the only thing that comes back from a worker
Document = Mapping[str, object]
#: a task in, a document with a ``status`` out; a function of a module, found by name
Perform = Callable[..., Document]
Results = Mapping[str, Document]


@dataclass(frozen=True)
class Task:
    """One unit of work."""

    #: Unlike that of every other task of a run.
    key: str
    #: Makes what a worker gets from the results of the tasks that it needs, once all are there.
    payload: Callable[[Results], object]
    #: Keys of tasks that must be finished first.
    needs: tuple[str, ...] = ()
    #: Tasks of one group share something that a worker keeps: one worker does them all.
    group: str = ""
    #: Predicted duration: what keeps the others waiting longest comes first.
    seconds: float = 0.0
    #: Predicted memory: no more run at once than there is room for.
    memory_MB: float = 0.0  # noqa: N815


@dataclass(frozen=True)
class Outcome:
    """What became of a task; the result always has a ``status``."""

    key: str
    result: Document
    seconds: float = 0.0
    #: whether another one is there already and follows at once
    followed: bool = False

    @property
    def status(self) -> str:
        """Word of what became of it."""
        return str(self.result["status"])

    @property
    def message(self) -> str:
        """Why it has no answer; empty if it has."""
        return str(self.result.get("message", ""))


class Executor(Protocol):
    """Where tasks are computed. The outcomes do not depend on it."""

    def run(
        self, tasks: Sequence[Task], finished: Results | None = None
    ) -> Generator[Outcome, None, None]:
        """Yield the outcome of every task as it comes; ``close()`` stops what still runs."""


def answers(perform: Perform, payloads: Sequence[object]) -> str:
    """JSON of the list of the results of some tasks."""
    # ``status``: ``failed`` with the traceback where ``perform`` raised or gave something that JSON
    # cannot hold, ``out-of-memory`` where memory was short.
    return f"[{','.join(_answer(perform, payload) for payload in payloads)}]"


def _answer(perform: Perform, payload: object) -> str:
    try:
        return json.dumps(perform(payload), allow_nan=False)
    except MemoryError as error:
        failure = {"status": "out-of-memory", "message": f"out of memory: {error}"}
    except Exception as error:  # noqa: BLE001 - the boundary: a bug must not stop the others
        failure = {
            "status": "failed",
            "message": f"{type(error).__name__}: {error}",
            "traceback": "".join(traceback.format_exception(error)),
        }
    # half of a character, which JSON cannot hold, becomes a question mark
    return json.dumps({k: v.encode(errors="replace").decode() for k, v in failure.items()})


def check_limit(seconds: float | None) -> float | None:
    """Wall-clock limit of one task in seconds; None for no limit."""
    if seconds is None or seconds > 0 and seconds != float("inf"):
        return seconds
    rule = f"must be a positive number of seconds, got {seconds:g}"
    raise InputError(Fault("timeout", rule, "leave it out for no limit"))


def stopped_late(limit_s: float) -> Document:
    """Return the result of a task stopped at its wall-clock limit: ``status`` and ``message``."""
    message = f"stopped after {limit_s:g} s, the limit of one computation"
    return {"status": "timeout", "message": message}


# Which task comes next: dependencies, length and groups, in O(log n) a task.


def longest_first(tasks: Sequence[Task]) -> list[Task]:
    """Sort tasks by the predicted time until the last one that waits for them is done.

    That is list scheduling by upward rank (Topcuoglu, Hariri and Wu 2002, IEEE Transactions on
    Parallel and Distributed Systems 13, 260, eq. 4): what is needed comes before what needs it,
    and a short tail is left to the end. The tasks of a group follow one another, and are as long
    as all of them together; what any of them needs comes before the first, so that a worker need
    not leave a group, and what it keeps of it, in the middle. Tasks of equal rank keep their order.
    """
    after: dict[str, set[str]] = {task.key: set() for task in tasks}
    group = {task.key: task.group for task in tasks}
    first: dict[str, str] = {}
    last: dict[str, str] = {}
    for task in tasks:
        begun = first.setdefault(task.group, task.key) if task.group else task.key
        for need in task.needs:
            if need in after:
                after[need].add(begun if group[need] != task.group else task.key)
        if task.group:
            if task.group in last:
                after[last[task.group]].add(task.key)
            last[task.group] = task.key
    seconds = {task.key: task.seconds for task in tasks}
    rank: dict[str, float] = {}
    try:
        for key in TopologicalSorter(after).static_order():
            rank[key] = seconds[key] + max((rank[other] for other in after[key]), default=0.0)
    except CycleError:  # nobody will do them: the queue says so when all others are done
        return list(tasks)
    return sorted(tasks, key=lambda task: -rank[task.key])


class ReadyQueue:
    """Tasks, the longest first, each handed out once all that it needs is finished.

    A worker gets the next task of its own group, else the first of those that belong to no
    other worker's group. A result is kept for as long as an unfinished task needs it, so that
    memory does not grow with what is done.
    """

    def __init__(self, tasks: Sequence[Task], finished: Results) -> None:
        self._users = Counter(need for task in tasks for need in set(task.needs))
        self.results: dict[str, Document] = {k: v for k, v in finished.items() if k in self._users}
        self._tasks = longest_first(tasks)
        self._numbers = {task.key: number for number, task in enumerate(self._tasks)}
        self._needs = {task.key: frozenset(task.needs) for task in tasks}
        self._open: dict[int, int] = {}
        self._dependents: dict[str, list[int]] = defaultdict(list)
        self._ready: dict[str, list[int]] = defaultdict(list)
        self._fronts: list[tuple[int, str]] = []
        self._holders: dict[str, int] = defaultdict(int)
        for number, task in enumerate(self._tasks):
            needs = {need for need in task.needs if need not in self.results}
            for need in needs:
                self._dependents[need].append(number)
            self._open[number] = len(needs)
            if not needs:
                self._make_ready(number)

    def __len__(self) -> int:
        return len(self._open)

    @property
    def waiting(self) -> list[str]:
        """Keys of the tasks that are not handed out."""
        return [self._tasks[number].key for number in self._open]

    def finish(self, key: str, result: Document) -> None:
        """Note a result; tasks that waited for it become ready."""
        for need in self._needs.pop(key, ()):
            self._users[need] -= 1
            if not self._users[need]:
                self.results.pop(need, None)
        if self._users[key]:
            self.results[key] = result
        for number in self._dependents.pop(key, ()):
            self._open[number] -= 1
            if self._open[number] == 0:
                self._make_ready(number)

    def put_back(self, task: Task) -> None:
        """Take back a task for which there was no room, or whose worker died, at its place."""
        number = self._numbers[task.key]
        self._open[number] = 0
        self._make_ready(number)

    def take(self, group: str) -> Task | None:
        """Next task for a worker that keeps something of a group; None while there is none."""
        ready = self._ready.get(group) if group else None
        number = heapq.heappop(ready) if ready else self._first_free()
        if number is None:
            return None
        del self._open[number]
        return self._tasks[number]

    def hold(self, group: str) -> None:
        """Give a group to a worker: no other gets its tasks."""
        if group:
            self._holders[group] += 1

    def release(self, group: str) -> None:
        """Take a group back from a worker."""
        if group:
            self._holders[group] -= 1
            if self._ready[group]:
                heapq.heappush(self._fronts, (self._ready[group][0], group))

    def _make_ready(self, number: int) -> None:
        group = self._tasks[number].group
        heapq.heappush(self._ready[group], number)
        heapq.heappush(self._fronts, (number, group))

    def _first_free(self) -> int | None:
        """First ready task without a group, or of a group that no worker holds."""
        while self._fronts:
            number, group = heapq.heappop(self._fronts)
            ready = self._ready[group]
            if self._holders[group] or not ready or ready[0] != number:
                continue
            first = heapq.heappop(ready)
            if ready:
                heapq.heappush(self._fronts, (ready[0], group))
            return first
        return None


#: a task whose worker died is tried once more: the machine may have been short of memory
MAX_DEATHS = 2
#: longest wait in seconds, so that Ctrl-C is seen at once on every system
LONGEST_WAIT_S = 0.5
#: tasks of at most so many predicted seconds are handed out several at a time, up to so many
#: seconds together: a way to a worker and back costs 1 ms, and each wait of the owner too
SHORT_S = 0.05
TOGETHER_S = 0.4
#: the remaining tasks are divided into at least so many hand-outs a slot, so that none waits long
SHARES = 4
#: seconds within which a worker is up, or never will be: it imports nothing until then
START_LIMIT_S = 60.0


@dataclass(frozen=True)
class Answer:
    """What a slot says of its tasks: JSON of the results, how its worker died, or that it began."""

    text: str = ""
    death: str = ""
    began: bool = False


#: where a slot puts the ticket of its tasks, and what it says of them
Done = queue.SimpleQueue[tuple[object, Answer]]


class Slot(Protocol):
    """Room for one task at a time, whose death, hang or bug costs that task alone."""

    def start(self, payloads: Sequence[object], done: Done, ticket: object) -> bool | None:
        """Begin some tasks, at once: whatever blocks does so elsewhere."""
        # Puts ``(ticket, answer)`` on the queue when it ends. Returns whether it also does so when
        # it begins, for a worker that is still to come up.
        ...

    def kill(self) -> None:
        """End whatever runs; the next start begins afresh."""


@dataclass
class Desk:
    """A slot and what it is doing: one task, or several short ones."""

    slot: Slot
    tasks: tuple[Task, ...] = ()
    ticket: object = None
    started: float = 0.0
    began: bool = False
    group: str = ""


@dataclass
class Supervisor:
    """Runs the tasks of a queue on slots."""

    ready: ReadyQueue
    #: As many as tasks may run at once.
    slots: list[Slot]
    #: Wall-clock limit of one task in seconds, enforced from outside: a task that holds the
    #: interpreter, or whose answer never leaves its pipe, is stopped all the same. None also where
    #: the slots enforce it themselves.
    limit_s: float | None = None
    #: Room for the predicted memory of all that run at once. A task that is too large for it runs
    #: alone, and what comes after one that has to wait waits too: else it waited for ever.
    memory_MB: float | None = None  # noqa: N815
    #: Slots that have come since it was last called; asked every ``LONGEST_WAIT_S`` or more often,
    #: so that it may also look whether the slots there are still in working order.
    arrivals: Callable[[], Sequence[Slot]] = tuple
    deaths: dict[str, int] = field(default_factory=dict)
    #: tasks whose worker died, or was late, while it did several: each has one to itself then
    alone: set[str] = field(default_factory=set)

    def outcomes(self) -> Generator[Outcome, None, None]:
        """Yield every outcome as it comes; kills all slots when closed."""
        desks = [Desk(slot) for slot in self.slots]
        done: Done = queue.SimpleQueue()
        try:
            while len(self.ready) or any(desk.tasks for desk in desks):
                desks += [Desk(slot) for slot in self.arrivals()]
                self._hand_out(desks, done)
                busy = [desk for desk in desks if desk.tasks]
                if not busy:
                    waiting = ", ".join(self.ready.waiting)
                    raise RuntimeError(f"tasks wait for something that nobody makes: {waiting}")
                ended = [*self._answered(busy, done), *self._late(busy)]
                for outcome in ended:
                    self.ready.finish(outcome.key, outcome.result)
                    yield replace(outcome, followed=outcome is not ended[-1])
        finally:
            for desk in desks:
                desk.slot.kill()

    def _hand_out(self, desks: list[Desk], done: Done) -> None:
        for desk in desks:
            task = None if desk.tasks else self.ready.take(desk.group)
            if task is None:
                continue
            if not self._has_room(task, desks):
                self.ready.put_back(task)
                continue
            if task.group and task.group != desk.group:
                self.ready.release(desk.group)
                self.ready.hold(task.group)
                desk.group = task.group  # kept while the worker does tasks of no group
            desk.tasks, desk.ticket = (task, *self._together(task, len(desks))), object()
            payloads = [each.payload(self.ready.results) for each in desk.tasks]
            desk.started = time.monotonic()
            desk.began = not desk.slot.start(payloads, done, desk.ticket)

    def _together(self, first: Task, desks: int) -> list[Task]:
        """Short tasks that go to a worker along with a short one."""
        short: list[Task] = []
        if not self._is_short(first):
            return short
        seconds, share = first.seconds, len(self.ready) // (SHARES * desks)
        while len(short) < share and seconds < TOGETHER_S:
            task = self.ready.take("")
            if task is None:
                break
            if not self._is_short(task):
                self.ready.put_back(task)
                break
            short.append(task)
            seconds += task.seconds
        return short

    def _is_short(self, task: Task) -> bool:
        """Whether a task is known to need next to no time and memory, and shares nothing."""
        small = 0 < task.seconds <= SHORT_S and not task.memory_MB
        return small and not task.group and task.key not in self.alone

    def _has_room(self, task: Task, desks: list[Desk]) -> bool:
        """Whether a task fits beside those that run; one always does."""
        running = [running_task.memory_MB for desk in desks for running_task in desk.tasks]
        return (
            self.memory_MB is None
            or not running
            or (sum(running) + task.memory_MB <= self.memory_MB)
        )

    def _answered(self, busy: list[Desk], done: Done) -> list[Outcome]:
        """Outcome of the next task that ends, if one does before somebody may be late."""
        now = time.monotonic()
        ends = [desk.started + limit for desk in busy if (limit := self._limit(desk)) is not None]
        patience = min(max(min(ends, default=math.inf) - now, 0.0), LONGEST_WAIT_S)
        try:
            ticket, answer = done.get(timeout=patience)
        except queue.Empty:
            return []
        desk = next((d for d in busy if d.ticket is ticket), None)
        if desk is None or not desk.tasks:
            return []  # of a task that was stopped: its limit has been told already
        if answer.began:
            desk.started, desk.began = time.monotonic(), True
            return []
        tasks, seconds = desk.tasks, time.monotonic() - desk.started
        desk.tasks = ()
        if answer.death:
            return self._died(desk, tasks, seconds, answer.death)
        try:
            results = parse_json(answer.text, "a worker's answer")
        except UnreadableError as error:
            return self._died(desk, tasks, seconds, str(error))
        if not isinstance(results, list) or len(results) != len(tasks):
            results = [None]
        if not all(isinstance(r, dict) and isinstance(r.get("status"), str) for r in results):
            return self._died(desk, tasks, seconds, "a worker's answer is no result")
        each = seconds / len(tasks)
        return [Outcome(t.key, result, each) for t, result in zip(tasks, results, strict=True)]

    def _died(self, desk: Desk, tasks: tuple[Task, ...], seconds: float, how: str) -> list[Outcome]:
        desk.slot.kill()
        if len(tasks) > 1:
            return self._apart(tasks)
        task = tasks[0]
        self.deaths[task.key] = self.deaths.get(task.key, 0) + 1
        if self.deaths[task.key] < MAX_DEATHS:
            self.ready.put_back(task)
            return []
        return [Outcome(task.key, {"status": "crashed", "message": f"{how}, twice"}, seconds)]

    def _apart(self, tasks: tuple[Task, ...]) -> list[Outcome]:
        """Have tasks done one by one, whose worker died or was late: nobody knows of which."""
        self.alone.update(task.key for task in tasks)
        for task in tasks:
            self.ready.put_back(task)
        return []

    def _limit(self, desk: Desk) -> float | None:
        """Seconds that a slot may take for what it does: to be up, then its task."""
        return self.limit_s if desk.began else START_LIMIT_S

    def _late(self, busy: list[Desk]) -> list[Outcome]:
        """Stop every task that has run for longer than its limit."""
        ended = []
        for desk in busy:
            seconds, limit = time.monotonic() - desk.started, self._limit(desk)
            tasks = desk.tasks
            if not tasks or limit is None or seconds <= limit:
                continue
            desk.tasks = ()
            if not desk.began:
                ended += self._died(desk, tasks, seconds, f"no worker was up within {limit:g} s")
                continue
            desk.slot.kill()
            if len(tasks) > 1:
                ended += self._apart(tasks)
            else:
                ended.append(Outcome(tasks[0].key, stopped_late(limit), seconds))
        return ended


# Tasks in this very process, one after the other: for notebooks, tests and debuggers.


@dataclass(frozen=True)
class Inline:
    """Executor without processes, and its only slot: a task that dies takes the run along."""

    perform: Perform

    def run(
        self, tasks: Sequence[Task], finished: Results | None = None
    ) -> Generator[Outcome, None, None]:
        """Yield the outcome of every task in its turn."""
        yield from Supervisor(ReadyQueue(tasks, finished or {}), [self]).outcomes()

    def start(self, payloads: Sequence[object], done: Done, ticket: object) -> None:
        """Do some tasks."""
        done.put((ticket, Answer(answers(self.perform, payloads))))

    def kill(self) -> None:
        """Nothing runs elsewhere."""


# Processes of this machine.


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
