"""The workers of a cluster as one run uses them: every thread of theirs is a slot."""

from __future__ import annotations

import contextlib
import functools
import os
import queue
import sys
import threading
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from study.bounded_file import MAX_BYTES, read_existing
from study.errors import RefusedError, SchedulerLostError
from study.execution.cluster.connection import Client, Pending, first_line
from study.execution.cluster.serving import end_run, keep_files, serve
from study.execution.cluster.versions import Identity, about, differences, refusal
from study.execution.supervisor import Answer
from study.execution.task import Perform

#: where the outcome of a slot's task is put
Done = queue.SimpleQueue[tuple[object, Answer]]

#: seconds between two looks at the workers
LOOK_S = 1.0
#: seconds for the workers to end the processes of a run that is over
FAREWELL_S = 5.0


@dataclass(eq=False)
class Worker:
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
    worker: Worker | None = None
    future: Pending | None = None
    waiting: tuple[str, Done, object] | None = None
    end: Callable[[Answer], None] | None = None

    def start(self, text: str, done: Done, ticket: object) -> None:
        """Begin a task given as JSON, at once or when a worker comes."""
        self.waiting = text, done, ticket
        self.begin()

    def begin(self) -> None:
        """Send what waits to a worker, if there is one."""
        if self.waiting is None or not self.crew.place(self):
            return
        (text, done, ticket), self.waiting = self.waiting, None
        told: list[bool] = []

        def end(answer: Answer) -> None:
            """Tell once: of a worker that was lost, the answer may still come."""
            if not told:
                told.append(True)
                done.put((ticket, answer))

        self.end = end
        self.future = self.crew.send(self.number, self.worker, text)
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
    workers: dict[str, Worker] = field(default_factory=dict)
    slots: list[RemoteSlot] = field(default_factory=list)
    #: slots whose future was cancelled, for a reason that is still to be found
    dropped: queue.SimpleQueue[RemoteSlot] = field(default_factory=queue.SimpleQueue)
    _strangers: set[str] = field(default_factory=set)
    _looked: float = float("-inf")
    _call: Pending | None = None

    @property
    def wanted(self) -> int:
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
        """Look at the workers now and then; slots for those that have come.

        Raises
        ------
        SchedulerLostError
            If the scheduler is gone.
        """
        if time.monotonic() - self._looked >= LOOK_S or not self.dropped.empty():
            for address, told in self._look().items():
                print(f"warning: {address} gets no task of this study: {told}", file=sys.stderr)
            self._explain_dropped()
            if self.workers:
                self._end_call()
            elif any(slot.waiting for slot in self.slots):
                self._call_for_workers()
            for slot in self.slots:
                slot.begin()
        known = len(self.slots)
        self.slots += [RemoteSlot(self, k) for k in range(known, max(self.wanted, known))]
        return self.slots[known:]

    def place(self, slot: RemoteSlot) -> bool:
        """Find a worker for a slot: its own, unless it is gone or another has more room."""
        best = max(self.workers.values(), key=lambda worker: worker.free, default=None)
        own = slot.worker
        if own is not None and (best is None or self.workers.get(own.address) is not own):
            own.load, own, slot.worker = own.load - 1, None, None
        if best is not None and (own is None or best.free - own.free > 1):
            if own is not None:
                own.load -= 1
            best.load, slot.worker = best.load + 1, best
        return slot.worker is not None

    def send(self, number: int, worker: Worker | None, text: str) -> Pending:
        """Submit a task to one worker.

        Raises
        ------
        SchedulerLostError
            If the scheduler is gone.
        """
        if worker is None:
            raise RuntimeError("a slot without a worker sends no task")
        self._check_scheduler()
        return self.client.submit(
            serve, (self.name, number), self.perform, text, self.limit_s,
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
            self._lost_worker(self.workers.pop(address))
        new = [a for a in there if a not in self.workers and a not in self._strangers]
        different = self._differences(new) if new else {}
        self._strangers |= set(different)
        known = [address for address in new if address not in different]
        if known and self.files:
            contents = {str(path): read_existing(path, MAX_BYTES) for path in self.files}
            self.client.run(keep_files, self.name, contents, workers=known, on_error="ignore")
        for address in known:
            self.workers[address] = Worker(address, max(there[address], 1))
        return different

    def _lost_worker(self, worker: Worker) -> None:
        for slot in self.slots:
            if slot.worker is worker and slot.future is not None:
                slot.lose(f"lost with its worker {worker.address}")

    def _differences(self, addresses: Sequence[str]) -> dict[str, str]:
        """Ask workers for their versions; say of each with other ones what differs."""
        here = about(self.identity)
        answers = self.client.run(about, self.identity, workers=list(addresses), on_error="return")
        found = {}
        for address in addresses:
            there = answers.get(address, "it gave no answer")
            told = differences(here, there)
            if told:
                found[address] = told
        return found

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
