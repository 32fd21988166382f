"""One loop for every executor: hands tasks to slots, waits, enforces limits, tries again."""

from __future__ import annotations

import json
import math
import queue
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

from study.bounded_file import UnreadableError, parse_json
from study.execution.queue import ReadyQueue
from study.execution.task import Outcome, Task, stopped_late

#: a task whose worker died is tried once more: the machine may have been short of memory
MAX_DEATHS = 2
#: longest wait in seconds, so that Ctrl-C is seen at once on every system
LONGEST_WAIT_S = 0.5


#: predicted seconds up to which tasks are handed out several at a time, and those of all together:
#: a way to a worker and back costs a thousandth of a second, and each of the owner's waits too
SHORT_S = 0.05
TOGETHER_S = 0.4
#: hand-outs to each slot into which what is left is divided at least, so that none waits long
SHARES = 4

#: seconds within which a worker is up, or never will be: it imports nothing until then
START_LIMIT_S = 60.0


@dataclass(frozen=True)
class Answer:
    """What a slot says of its task: JSON of the result, how its worker died, or that it began."""

    text: str = ""
    death: str = ""
    began: bool = False


class Slot(Protocol):
    """Room for one task at a time, whose death, hang or bug costs that task alone."""

    def start(
        self, text: str, done: queue.SimpleQueue[tuple[object, Answer]], ticket: object
    ) -> bool | None:
        """Begin a task given as JSON, at once: whatever blocks does so elsewhere.

        Puts ``(ticket, answer)`` on the queue when it ends. Returns whether it also does so when
        it begins, for a worker that is still to come up.
        """
        ...

    def kill(self) -> None:
        """End whatever runs; the next start begins afresh."""
        ...


@dataclass
class Desk:
    """A slot and what it is doing: one task, or several short ones."""

    slot: Slot
    tasks: tuple[Task, ...] = ()
    ticket: object = None
    started: float = 0.0
    began: bool = False
    group: str = ""


def _is_result(content: object) -> bool:
    return isinstance(content, dict) and isinstance(content.get("status"), str)


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
    memory_MB : float, optional
        Room for the predicted memory of all that run at once. A task that is too large for it
        runs alone, and what comes after one that has to wait waits too: else it waited for ever.
    arrivals : callable
        Slots that have come since it was last called; asked every ``LONGEST_WAIT_S`` or more
        often, so that it may also look whether the slots there are still in working order.
    """

    ready: ReadyQueue
    slots: list[Slot]
    limit_s: float | None = None
    memory_MB: float | None = None  # noqa: N815
    arrivals: Callable[[], Sequence[Slot]] = tuple
    deaths: dict[str, int] = field(default_factory=dict)
    #: tasks whose worker died, or was late, while it did several: each has one to itself then
    alone: set[str] = field(default_factory=set)

    def outcomes(self) -> Generator[Outcome, None, None]:
        """Yield every outcome as it comes; kills all slots when closed."""
        desks = [Desk(slot) for slot in self.slots]
        done: queue.SimpleQueue[tuple[object, Answer]] = queue.SimpleQueue()
        try:
            while len(self.ready) or any(desk.tasks for desk in desks):
                desks += [Desk(slot) for slot in self.arrivals()]
                self._hand_out(desks, done)
                busy = [desk for desk in desks if desk.tasks]
                if not busy:
                    names = ", ".join(self.ready.waiting)
                    raise RuntimeError(f"tasks wait for something that nobody makes: {names}")
                found = [*self._answered(busy, done), *self._late(busy)]
                for outcome in found:
                    self.ready.finish(outcome.key, outcome.result)
                    yield replace(outcome, followed=outcome is not found[-1])
        finally:
            for desk in desks:
                desk.slot.kill()

    def _hand_out(self, desks: list[Desk], done: queue.SimpleQueue[tuple[object, Answer]]) -> None:
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
            asked = [one.payload(self.ready.results) for one in desk.tasks]
            text = json.dumps(asked if len(asked) > 1 else asked[0], allow_nan=False)
            desk.started = time.monotonic()
            desk.began = not desk.slot.start(text, done, desk.ticket)

    def _together(self, first: Task, desks: int) -> list[Task]:
        """Short tasks that go to a worker along with a short one."""
        found: list[Task] = []
        if not self._is_short(first):
            return found
        seconds, share = first.seconds, len(self.ready) // (SHARES * desks)
        while len(found) < share and seconds < TOGETHER_S:
            task = self.ready.take("")
            if task is None:
                break
            if not self._is_short(task):
                self.ready.put_back(task)
                break
            found.append(task)
            seconds += task.seconds
        return found

    def _is_short(self, task: Task) -> bool:
        """Whether a task is known to need next to no time and memory, and shares nothing."""
        small = 0 < task.seconds <= SHORT_S and not task.memory_MB
        return small and not task.group and task.key not in self.alone

    def _has_room(self, task: Task, desks: list[Desk]) -> bool:
        """Whether a task fits beside those that run; one always does."""
        running = [one.memory_MB for desk in desks for one in desk.tasks]
        return (
            self.memory_MB is None
            or not running
            or (sum(running) + task.memory_MB <= self.memory_MB)
        )

    def _answered(
        self, busy: list[Desk], done: queue.SimpleQueue[tuple[object, Answer]]
    ) -> list[Outcome]:
        """Outcome of the next task that ends, if one does before somebody may be late."""
        try:
            ticket, answer = done.get(timeout=self._patience(busy))
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
            found = parse_json(answer.text, "a worker's answer")
        except UnreadableError as error:
            return self._died(desk, tasks, seconds, str(error))
        results = found if len(tasks) > 1 and isinstance(found, list) else [found]
        if len(results) != len(tasks) or not all(map(_is_result, results)):
            return self._died(desk, tasks, seconds, "a worker's answer is no result")
        each = seconds / len(tasks)
        return [Outcome(one.key, result, each) for one, result in zip(tasks, results, strict=True)]

    def _died(self, desk: Desk, tasks: tuple[Task, ...], seconds: float, how: str) -> list[Outcome]:
        desk.slot.kill()
        if len(tasks) > 1:
            return self._apart(tasks)
        task = tasks[0]
        self.deaths[task.key] = self.deaths.get(task.key, 0) + 1
        if self.deaths[task.key] < MAX_DEATHS:
            self.ready.give_back(task)
            return []
        return [Outcome(task.key, {"status": "crashed", "message": f"{how}, twice"}, seconds)]

    def _apart(self, tasks: tuple[Task, ...]) -> list[Outcome]:
        """Have tasks done one by one, whose worker died or was late: nobody knows of which."""
        self.alone.update(one.key for one in tasks)
        for one in tasks:
            self.ready.give_back(one)
        return []

    def _patience(self, busy: list[Desk]) -> float:
        """Seconds until somebody may be late."""
        now = time.monotonic()
        ends = [desk.started + limit for desk in busy if (limit := self._limit(desk)) is not None]
        return min(max(min(ends, default=math.inf) - now, 0.0), LONGEST_WAIT_S)

    def _limit(self, desk: Desk) -> float | None:
        """Seconds that a slot may take for what it does: to be up, then its task."""
        return self.limit_s if desk.began else START_LIMIT_S

    def _late(self, busy: list[Desk]) -> list[Outcome]:
        """Stop every task that has run for longer than its limit."""
        found = []
        for desk in busy:
            seconds, limit = time.monotonic() - desk.started, self._limit(desk)
            tasks = desk.tasks
            if not tasks or limit is None or seconds <= limit:
                continue
            desk.tasks = ()
            if not desk.began:
                found += self._died(desk, tasks, seconds, f"no worker was up within {limit:g} s")
                continue
            desk.slot.kill()
            if len(tasks) > 1:
                found += self._apart(tasks)
            else:
                found.append(Outcome(tasks[0].key, stopped_late(limit), seconds))
        return found
