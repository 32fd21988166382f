"""One loop for every executor: hands tasks to slots, waits, enforces limits, tries again."""

from __future__ import annotations

import json
import queue
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from study.execution.queue import ReadyQueue
from study.execution.task import Outcome, Task, stopped_late

#: a task whose worker died is tried once more: the machine may have been short of memory
MAX_DEATHS = 2
#: longest wait in seconds, so that Ctrl-C is seen at once on every system
LONGEST_WAIT_S = 0.5


@dataclass(frozen=True)
class Answer:
    """What a slot says of its task: JSON of the result, or how its worker died."""

    text: str = ""
    death: str = ""


class Slot(Protocol):
    """Room for one task at a time, whose death, hang or bug costs that task alone."""

    def start(
        self, text: str, done: queue.SimpleQueue[tuple[object, Answer]], ticket: object
    ) -> None:
        """Begin a task given as JSON; puts ``(ticket, answer)`` on the queue when it ends."""
        ...

    def kill(self) -> None:
        """End whatever runs; the next start begins afresh."""
        ...


@dataclass
class Desk:
    """A slot and what it is doing."""

    slot: Slot
    task: Task | None = None
    ticket: object = None
    started: float = 0.0
    group: str = ""


@dataclass
class Supervisor:
    """Runs the tasks of a queue on slots.

    Parameters
    ----------
    ready : ReadyQueue
        The tasks.
    slots : list of Slot
        As many as tasks may run at once.
    limit_s : float, optional
        Wall-clock limit of one task in seconds, enforced from outside: a task that holds the
        interpreter, or whose answer never leaves its pipe, is stopped all the same. None also
        where the slots enforce it themselves.
    arrivals : callable
        Slots that have come since it was last called; asked every ``LONGEST_WAIT_S`` or more
        often, so that it may also look whether the slots there are still in working order.
    """

    ready: ReadyQueue
    slots: list[Slot]
    limit_s: float | None = None
    arrivals: Callable[[], Sequence[Slot]] = tuple
    deaths: dict[str, int] = field(default_factory=dict)

    def outcomes(self) -> Generator[Outcome, None, None]:
        """Yield every outcome as it comes; kills all slots when closed."""
        desks = [Desk(slot) for slot in self.slots]
        done: queue.SimpleQueue[tuple[object, Answer]] = queue.SimpleQueue()
        try:
            while len(self.ready) or any(desk.task for desk in desks):
                desks += [Desk(slot) for slot in self.arrivals()]
                self._hand_out(desks, done)
                busy = [desk for desk in desks if desk.task]
                if not busy:
                    names = ", ".join(self.ready.waiting)
                    raise RuntimeError(f"tasks wait for something that nobody makes: {names}")
                for outcome in [*self._answered(busy, done), *self._late(busy)]:
                    self.ready.finish(outcome.key, outcome.result)
                    yield outcome
        finally:
            for desk in desks:
                desk.slot.kill()

    def _hand_out(self, desks: list[Desk], done: queue.SimpleQueue[tuple[object, Answer]]) -> None:
        for desk in desks:
            task = self.ready.take(desk.group) if desk.task is None else None
            if task is None:
                continue
            if task.group and task.group != desk.group:
                self.ready.release(desk.group)
                self.ready.hold(task.group)
                desk.group = task.group  # kept while the worker does tasks of no group
            text = json.dumps(task.payload(self.ready.results), allow_nan=False)
            desk.task, desk.ticket, desk.started = task, object(), time.monotonic()
            desk.slot.start(text, done, desk.ticket)

    def _answered(
        self, busy: list[Desk], done: queue.SimpleQueue[tuple[object, Answer]]
    ) -> list[Outcome]:
        """Outcome of the next task that ends, if one does before somebody may be late."""
        try:
            ticket, answer = done.get(timeout=self._patience(busy))
        except queue.Empty:
            return []
        desk = next((d for d in busy if d.ticket is ticket), None)
        if desk is None or desk.task is None:
            return []  # of a task that was stopped: its limit has been told already
        task, seconds = desk.task, time.monotonic() - desk.started
        desk.task = None
        if answer.death:
            return self._died(desk, task, seconds, answer.death)
        return [Outcome(task.key, json.loads(answer.text), seconds)]

    def _died(self, desk: Desk, task: Task, seconds: float, how: str) -> list[Outcome]:
        desk.slot.kill()
        self.deaths[task.key] = self.deaths.get(task.key, 0) + 1
        if self.deaths[task.key] < MAX_DEATHS:
            self.ready.give_back(task)
            return []
        return [Outcome(task.key, {"status": "crashed", "message": f"{how}, twice"}, seconds)]

    def _patience(self, busy: list[Desk]) -> float:
        """Seconds until somebody may be late."""
        if self.limit_s is None:
            return LONGEST_WAIT_S
        longest = max(time.monotonic() - desk.started for desk in busy)
        return min(max(self.limit_s - longest, 0.0), LONGEST_WAIT_S)

    def _late(self, busy: list[Desk]) -> list[Outcome]:
        """Stop every task that has run for longer than its limit."""
        found = []
        for desk in busy:
            seconds = time.monotonic() - desk.started
            if desk.task is None or self.limit_s is None or seconds <= self.limit_s:
                continue
            desk.slot.kill()
            found.append(Outcome(desk.task.key, stopped_late(self.limit_s), seconds))
            desk.task = None
        return found
