"""The way to a scheduler, and what is used of Dask's client."""

from __future__ import annotations

import contextlib
import copy
import functools
import hashlib
import json
import logging
import multiprocessing
import os
import queue
import re
import shutil
import sys
import tempfile
import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, is_dataclass
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Protocol

from study.execution.local import (
    Answer,
    Done,
    Outcome,
    Perform,
    Process,
    ReadyQueue,
    Results,
    Supervisor,
    Task,
    check_limit,
    stopped_late,
)
from study.ground.errors import Fault, InputError, RefusedError, SchedulerLostError
from study.ground.files import MAX_BYTES, read_existing

#: seconds to reach a scheduler; a scheduler silent for as long is taken for gone
PATIENCE_S = 30.0


class Pending(Protocol):
    """What is used of a future of Dask, which has no types of its own."""

    status: str
    key: str

    def result(self) -> tuple[str, str]:
        """Text of the answer, and how its process died."""

    def add_done_callback(self, call: Callable[[Pending], None]) -> None:
        """Call with the future when it ends."""


class Client(Protocol):
    """What is used of Dask's client."""

    status: str

    def submit(self, call: Callable[..., object], *args: object, **options: object) -> Pending:
        """Have a call made on a worker."""

    def run(
        self, call: Callable[..., object], *args: object, **options: object
    ) -> dict[str, object]:
        """Make a call on every worker at once, beside its tasks."""

    def nthreads(self) -> Mapping[str, int]:
        """Threads of every worker, by its address."""

    def cancel(self, futures: Sequence[Pending], **options: object) -> None:
        """Give futures up."""

    def close(self) -> None:
        """Leave the cluster."""


#: loggers that tell the loss of a scheduler with a traceback each; our error tells it once
_LOGS = ("distributed.client", "distributed.batched")


@contextlib.contextmanager
def connected(scheduler: str | Path | Client) -> Iterator[Client]:
    """Client of a scheduler, closed again unless it was given."""
    if not isinstance(scheduler, str | os.PathLike):
        yield scheduler
        return
    try:
        from distributed import Client as DaskClient
    except ImportError as error:
        mend = "install it: python -m pip install 'study[dask]'"
        raise InputError(Fault("scheduler", "needs the package distributed", mend)) from error
    where = _place(str(scheduler))
    client = DaskClient.__new__(DaskClient)
    levels = {name: logging.getLogger(name).level for name in _LOGS}
    _set_levels(dict.fromkeys(_LOGS, logging.CRITICAL))
    try:
        client.__init__(**where, timeout=PATIENCE_S, set_as_default=False)
    except Exception as error:  # whatever it is, there is no way in
        client.status = "closed"  # it would else wait for its farewell when it is collected
        mend = (
            "is it running, does the address begin with tls:// where it is encrypted, and are the\n"
            "    certificates those of the cluster?"
        )
        rule = f"{scheduler} cannot be reached: {first_line(error)}"
        raise InputError(Fault("scheduler", rule, mend)) from error
    try:
        yield client
    finally:
        with contextlib.suppress(Exception):  # a cluster that is gone needs no farewell
            client.close()
    _set_levels(levels)  # after a loss they stay quiet: threads of the client still complain


def _set_levels(levels: Mapping[str, int]) -> None:
    for name, level in levels.items():
        logging.getLogger(name).setLevel(level)


def _place(scheduler: str) -> dict[str, str]:
    """Keyword of Dask's client for an address or a scheduler file."""
    if Path(scheduler).is_file():
        return {"scheduler_file": scheduler}
    host, _, port = scheduler.rpartition(":")
    if host and port.isdigit():
        return {"address": scheduler}
    mend = "give tls://HOST:PORT, tcp://HOST:PORT, or the file that dask scheduler wrote"
    raise InputError(Fault("scheduler", f"{scheduler!r} is no address and no file", mend))


def first_line(error: BaseException) -> str:
    """First line of what an error says, or its kind where it says nothing."""
    return (str(error).splitlines() or [type(error).__name__])[0]


# Whether a worker would give the numbers of this machine.

#: names and versions of what decides a number, asked of this machine and of every worker
Identity = Callable[[], Mapping[str, str]]
#: kinds of difference that are listed before "and ... more"
LISTED = 4
#: how an error of an import begins as text
_IMPORT = re.compile(r"(ImportError|ModuleNotFoundError|AttributeError)\b")
#: what is said of a package that is not there
ABSENT = "absent"


def about(identity: Identity) -> dict[str, str]:
    """Versions of this machine, Dask's included."""
    import distributed

    return {**identity(), "distributed": str(distributed.__version__)}


def differences(here: Mapping[str, str], there: object) -> str:
    """Say what differs between this machine and a worker; empty if nothing does."""
    if not isinstance(there, Mapping):
        text = first_line(there) if isinstance(there, BaseException) else str(there)
        # the scheduler hands over errors of a worker as text
        is_import = isinstance(there, ImportError) or _IMPORT.match(text) is not None
        return f"study cannot be imported there: {text}" if is_import else text
    return ", ".join(
        f"{name} {there.get(name, ABSENT)} (here {here.get(name, ABSENT)})"
        for name in dict.fromkeys([*here, *there])
        if here.get(name) != there.get(name)
    )


def refusal(different: Mapping[str, str]) -> str:
    """Say which workers cannot be used and why, those with the same differences together."""
    alike = Counter(different.values())
    lines = [
        f"    {count} worker{'s' if count > 1 else ''}: {difference}"
        for difference, count in alike.most_common(LISTED)
    ]
    if len(alike) > LISTED:
        lines.append(f"    and {len(alike) - LISTED} more kinds of difference")
    return (
        "workers of the cluster would not give the numbers of this machine:\n"
        + "\n".join(lines)
        + "\n    install the same versions there: python -m pip install --require-hashes -r\n"
        "    requirements.lock, then study itself"
    )


# Tasks in processes beside a cluster's worker, which must not die of a task (the bulkhead of
# Nygard 2018, Release It!, section 5.3).

#: seconds after which a process that nobody uses ends: its sender may be gone without a word
IDLE_S = 60.0
#: seconds between two looks whether a task is still wanted
ISOLATION_LOOK_S = 0.25
#: of all that ends with this process, ours end first
FIRST = 100


class Processes:
    """The processes of one machine, by the run and the slot that they serve."""

    def __init__(self) -> None:
        self._processes: dict[tuple[str, int], Process] = {}
        #: since when those that do nothing have done so
        self._idle_since: dict[tuple[str, int], float] = {}
        self._lock = threading.Lock()
        self._is_watched = False

    def perform(
        self,
        run_slot: tuple[str, int],
        perform: Perform,
        payloads: Sequence[object],
        limit_s: float | None,
        unwanted: Callable[[], bool],
    ) -> Answer:
        """Do some tasks; never raises, never dies."""
        with self._lock:
            if not self._is_watched:
                self._is_watched = True
                self._prepare()
            is_idle = self._idle_since.pop(run_slot, None) is not None
            process = self._processes[run_slot] if is_idle else Process(perform)
            self._processes[run_slot] = process
        try:
            return _watched(process, payloads, limit_s, unwanted)
        finally:
            with self._lock:
                is_ours = self._processes.get(run_slot) is process
                if is_ours:
                    self._idle_since[run_slot] = time.monotonic()
            if not is_ours:  # the run has ended, or its slot began anew beside a task given up
                process.kill()

    def end(self, run: str) -> None:
        """Kill the processes of a run and no other's."""
        self._end(lambda run_slot: run_slot[0] == run)

    def end_idle(self, idle_s: float = IDLE_S) -> None:
        """Kill the processes that had nothing to do for longer than so many seconds."""
        now = time.monotonic()
        self._end(lambda run_slot: now - self._idle_since.get(run_slot, now) > idle_s)

    def _end(self, is_over: Callable[[tuple[str, int]], bool]) -> None:
        with self._lock:
            ended = [run_slot for run_slot in self._processes if is_over(run_slot)]
            processes = [self._processes.pop(run_slot) for run_slot in ended]
            for run_slot in ended:
                self._idle_since.pop(run_slot, None)
        for process in processes:
            process.kill()

    def _prepare(self) -> None:
        """Let this process have child processes, and end them with it."""
        # workers of a cluster are children of their nannies, which may have none of their own
        multiprocessing.current_process().daemon = False
        # not atexit: such a child runs none of its functions, and waits for its own children
        Finalize(None, self._end, (lambda _: True,), exitpriority=FIRST)
        threading.Thread(target=self._watch, daemon=True).start()

    def _watch(self) -> None:
        while True:
            time.sleep(IDLE_S / 6)
            self.end_idle()


def _watched(
    process: Process,
    payloads: Sequence[object],
    limit_s: float | None,
    unwanted: Callable[[], bool],
) -> Answer:
    """Answer of a process, or what became of it."""
    done: Done = queue.SimpleQueue()
    process.start(payloads, done, None)
    limit = float("inf") if limit_s is None else limit_s
    ends = time.monotonic() + limit
    while True:
        try:
            _, answer = done.get(timeout=max(0.0, min(ISOLATION_LOOK_S, ends - time.monotonic())))
        except queue.Empty:
            if unwanted():
                answer = Answer(death="stopped")
            elif time.monotonic() >= ends:
                process.kill()
                return Answer(json.dumps([stopped_late(limit)]))
            else:
                continue
        if answer.began:  # the process is up: its task has the whole limit
            ends = time.monotonic() + limit
            continue
        if answer.death:
            process.kill()
        return answer


HERE = Processes()


# What a worker of the cluster does: found there by its name.

#: folder of each run's files, and where it has the copy of each file of the study's machine
_COPIES: dict[str, tuple[str, Mapping[str, str]]] = {}


def keep_files(run: str, files: Mapping[str, bytes]) -> None:
    """Keep copies of the files that the tasks of a run read, until the run ends."""
    folder = tempfile.mkdtemp(prefix="study-")
    copies = {}
    for path, content in files.items():
        name = hashlib.sha256(path.encode()).hexdigest()[:16] + os.path.splitext(path)[1]
        copies[path] = os.path.join(folder, name)
        with open(copies[path], "wb") as stream:
            stream.write(content)
    _COPIES[run] = folder, copies


def with_copies(value: object, copies: Mapping[str, str]) -> object:
    """Tasks in which the path of each file of the study's machine is that of its copy here."""
    if isinstance(value, str):
        return copies.get(value, value)
    if isinstance(value, dict):
        return {name: with_copies(item, copies) for name, item in value.items()}
    if isinstance(value, list | tuple) and type(value) in (list, tuple):
        return type(value)(with_copies(item, copies) for item in value)
    if is_dataclass(value) and not isinstance(value, type):
        changed = copy.copy(value)
        changed.__dict__.update({k: with_copies(v, copies) for k, v in vars(value).items()})
        return changed
    return value


def serve(
    run_slot: tuple[str, int], perform: Perform, payloads: Sequence[object], limit_s: float | None
) -> tuple[str, str]:
    """Do some tasks on a worker: what the cluster calls."""
    from distributed import get_worker

    worker = get_worker()
    key = worker.get_current_task()

    def unwanted() -> bool:
        task = worker.state.tasks.get(key)
        return task is None or task.state in ("cancelled", "released", "forgotten")

    copies = _COPIES.get(run_slot[0], ("", {}))[1]
    there = [with_copies(payload, copies) for payload in payloads] if copies else payloads
    answer = HERE.perform(run_slot, perform, there, limit_s, unwanted)
    return answer.text, answer.death


def end_run(run: str) -> None:
    """End the processes of a run on this worker, and remove its files."""
    HERE.end(run)
    folder, _ = _COPIES.pop(run, ("", {}))
    if folder:
        shutil.rmtree(folder, ignore_errors=True)


# The workers of a cluster as one run uses them: every thread of theirs is a slot.

#: seconds between two looks at the workers
LOOK_S = 1.0
#: seconds for the workers to end the processes of a run that is over
FAREWELL_S = 5.0


@dataclass(eq=False)
class ClusterWorker:
    """Worker of the cluster with the versions of this machine."""

    address: str
    threads: int
    load: int = 0

    @property
    def free(self) -> int:
        """Threads beyond the slots that it has; negative where it has more slots."""
        return self.threads - self.load


@dataclass(eq=False)
class RemoteSlot:
    """Room for one task at a time on some worker of the cluster."""

    crew: Crew
    number: int
    worker: ClusterWorker | None = None
    future: Pending | None = None
    waiting: tuple[Sequence[object], Done, object] | None = None
    end: Callable[[Answer], None] | None = None

    def start(self, payloads: Sequence[object], done: Done, ticket: object) -> None:
        """Begin some tasks, at once or when a worker comes."""
        self.waiting = payloads, done, ticket
        self.begin()

    def begin(self) -> None:
        """Send what waits to a worker, if there is one."""
        if self.waiting is None or (worker := self.crew.worker_for(self)) is None:
            return
        (payloads, done, ticket), self.waiting = self.waiting, None
        answered: list[bool] = []

        def end(answer: Answer) -> None:
            """Tell once: of a worker that was lost, the answer may still come."""
            if not answered:
                answered.append(True)
                done.put((ticket, answer))

        self.end = end
        self.future = self.crew.send(self.number, worker, payloads)
        self.future.add_done_callback(functools.partial(self._ended, end))

    def kill(self) -> None:
        """Give up what runs; its worker notices within a second."""
        future, self.future = self.future, None
        self.waiting = None
        if future is not None:
            self.crew.give_up([future])

    def lose(self, why: str) -> None:
        """Report the death of what runs here."""
        end = self.end
        if end is not None:
            end(Answer(death=why))

    def _ended(self, end: Callable[[Answer], None], future: Pending) -> None:
        """Hand over what became of a future; called in a thread of the client."""
        if future.status == "cancelled":
            self.crew.dropped.put(self)  # by us, by the end of the scheduler, or by a stranger
            return
        try:
            text, death = future.result()
        except Exception as error:  # noqa: BLE001 - whatever became of it, the study goes on
            text, death = "", f"lost by the cluster: {first_line(error)}"
        if self.future is future:
            self.future = None  # a worker keeps an answer for as long as somebody holds its future
        end(Answer(text, death))


@dataclass(eq=False)
class Crew:
    """The workers of a cluster as one run uses them."""

    client: Client
    perform: Perform
    identity: Identity
    jobs: int | None
    limit_s: float | None
    files: Sequence[Path] = ()
    name: str = field(default_factory=lambda: uuid.uuid4().hex)
    workers: dict[str, ClusterWorker] = field(default_factory=dict)
    slots: list[RemoteSlot] = field(default_factory=list)
    #: slots whose future was cancelled, for a reason that is still to be found
    dropped: queue.SimpleQueue[RemoteSlot] = field(default_factory=queue.SimpleQueue)
    _strangers: set[str] = field(default_factory=set)
    _looked: float = float("-inf")
    _call: Pending | None = None

    @property
    def capacity(self) -> int:
        """Tasks that run at once."""
        return self.jobs or sum(worker.threads for worker in self.workers.values())

    def gather(self) -> None:
        """Wait for a worker, and refuse those whose versions differ."""
        while not self.workers:
            different = self._look()
            if different:
                raise RefusedError(refusal(different))
            if not self.workers:
                self._call_for_workers()
                time.sleep(LOOK_S)

    def arrivals(self) -> list[RemoteSlot]:
        """Look at the workers now and then; slots for those that have come."""
        if time.monotonic() - self._looked >= LOOK_S or not self.dropped.empty():
            for address, why in self._look().items():
                print(f"warning: {address} gets no task of this study: {why}", file=sys.stderr)
            self._explain_dropped()
            if self.workers:
                self._end_call()
            elif any(slot.waiting for slot in self.slots):
                self._call_for_workers()
            for slot in self.slots:
                slot.begin()
        count = len(self.slots)
        self.slots += [RemoteSlot(self, k) for k in range(count, max(self.capacity, count))]
        return self.slots[count:]

    def worker_for(self, slot: RemoteSlot) -> ClusterWorker | None:
        """Find a worker for a slot: its own, unless it is gone or another has more room."""
        best = max(self.workers.values(), key=lambda worker: worker.free, default=None)
        old = slot.worker
        if old is not None and (best is None or self.workers.get(old.address) is not old):
            old.load, old, slot.worker = old.load - 1, None, None
        if best is not None and (old is None or best.free - old.free > 1):
            if old is not None:
                old.load -= 1
            best.load, slot.worker = best.load + 1, best
        return slot.worker

    def send(self, number: int, worker: ClusterWorker, payloads: Sequence[object]) -> Pending:
        """Submit tasks to one worker."""
        self._check_scheduler()
        return self.client.submit(
            serve, (self.name, number), self.perform, payloads, self.limit_s,
            workers=[worker.address], pure=False, key=f"study-{self.name}-{uuid.uuid4().hex}",
        )  # fmt: skip

    def give_up(self, futures: Sequence[Pending]) -> None:
        """Cancel futures of ours."""
        if self.client.status == "running":
            with contextlib.suppress(Exception):  # what is gone already needs no cancelling
                self.client.cancel(futures, force=True)

    def dismiss(self) -> None:
        """Cancel what runs for this run alone, and end its processes on the workers."""
        self._end_call()
        self.give_up([slot.future for slot in self.slots if slot.future is not None])
        if self.client.status != "running":
            return
        # of a worker that hangs nobody waits for a farewell: its idle processes end by themselves
        farewell = threading.Thread(target=self._say_farewell, daemon=True)
        farewell.start()
        farewell.join(FAREWELL_S)

    def _say_farewell(self) -> None:
        with contextlib.suppress(Exception):  # a worker that is gone has ended them already
            self.client.run(end_run, self.name, workers=list(self.workers), on_error="ignore")

    def _look(self) -> dict[str, str]:
        """Notice who came and who went; what is different about those that cannot be used."""
        self._looked = time.monotonic()
        self._check_scheduler()
        try:
            there = dict(self.client.nthreads())
        except Exception as error:
            raise SchedulerLostError(_lost(error)) from error
        for address in [address for address in self.workers if address not in there]:
            worker = self.workers.pop(address)
            for slot in self.slots:
                if slot.worker is worker and slot.future is not None:
                    slot.lose(f"lost with its worker {address}")
        new = [a for a in there if a not in self.workers and a not in self._strangers]
        different = self._differences(new) if new else {}
        self._strangers |= set(different)
        usable = [address for address in new if address not in different]
        if usable and self.files:
            contents = {str(path): read_existing(path, MAX_BYTES) for path in self.files}
            self.client.run(keep_files, self.name, contents, workers=usable, on_error="ignore")
        for address in usable:
            self.workers[address] = ClusterWorker(address, max(there[address], 1))
        return different

    def _differences(self, addresses: Sequence[str]) -> dict[str, str]:
        """Ask workers for their versions; say of each with other ones what differs."""
        here = about(self.identity)
        answers = self.client.run(about, self.identity, workers=list(addresses), on_error="return")
        different = {}
        for address in addresses:
            there = answers.get(address, "it gave no answer")
            difference = differences(here, there)
            if difference:
                different[address] = difference
        return different

    def _explain_dropped(self) -> None:
        """Report tasks that somebody else cancelled, the scheduler being there."""
        while not self.dropped.empty():
            slot = self.dropped.get()
            if slot.future is not None and slot.future.status == "cancelled":
                slot.lose("cancelled on the cluster")

    def _check_scheduler(self) -> None:
        if self.client.status != "running":
            raise SchedulerLostError(_lost())

    def _call_for_workers(self) -> None:
        """Leave a task that anybody may do: a cluster that grows on demand sees a demand."""
        if self._call is None:
            print("waiting for a worker of the cluster", file=sys.stderr, flush=True)
            self._check_scheduler()
            self._call = self.client.submit(os.getpid, pure=False)

    def _end_call(self) -> None:
        call, self._call = self._call, None
        if call is not None:
            self.give_up([call])


def _lost(error: BaseException | None = None) -> str:
    why = f" ({first_line(error)})" if error is not None and str(error) else ""
    return (
        f"the scheduler of the cluster is gone{why}: what is finished is kept\n"
        "    start the cluster again, then the same command: it resumes"
    )


# Tasks on a Dask cluster that exists. Tasks travel whole and results as text, so that workers share
# no disk with the study; where a worker is gone, its tasks are done once more elsewhere.


@dataclass(frozen=True)
class Cluster:
    """Executor on the workers of a Dask cluster."""

    #: Does one task; a function of a module that the workers can import.
    perform: Perform
    #: Address (``tls://host:8786``), scheduler file, or a client that is connected.
    scheduler: str | Path | Client
    #: Versions of what decides a number; a worker with others is refused.
    identity: Identity = dict
    #: Tasks at once; by default one a thread of the workers, of those that come later too.
    jobs: int | None = None
    #: Wall-clock limit of one task in seconds, which waiting for a worker does not use up.
    limit_s: float | None = None
    #: Files that tasks name by their whole path: every worker gets a copy, and tasks its name.
    files: Sequence[Path] = ()

    def run(
        self, tasks: Sequence[Task], finished: Results | None = None
    ) -> Generator[Outcome, None, None]:
        """Yield the outcome of every task as it comes; ``close()`` stops this run's alone."""
        limit = check_limit(self.limit_s)
        with connected(self.scheduler) as client:
            crew = Crew(client, self.perform, self.identity, self.jobs, limit, self.files)
            try:
                crew.gather()
                ready = ReadyQueue(tasks, finished or {})
                yield from Supervisor(ready, [], arrivals=crew.arrivals).outcomes()
            finally:
                crew.dismiss()

    def reached(self) -> Cluster:
        """Return it, having waited for a worker and compared versions."""
        with connected(self.scheduler) as client:
            Crew(client, self.perform, self.identity, self.jobs, None).gather()
        return self
