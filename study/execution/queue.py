"""Which task comes next: dependencies, length and groups, in O(log n) a task."""

from __future__ import annotations

import heapq
from collections import Counter, defaultdict
from collections.abc import Sequence
from graphlib import CycleError, TopologicalSorter

from study.execution.task import Document, Results, Task


def longest_first(tasks: Sequence[Task]) -> list[Task]:
    """Sort tasks by the predicted time until the last one that waits for them is done.

    That is list scheduling by upward rank (Topcuoglu, Hariri and Wu 2002, IEEE Transactions on
    Parallel and Distributed Systems 13, 260, eq. 4): what is needed comes before what needs it,
    and a short tail is left to the end. The tasks of a group follow one another, and are as long
    as all of them together; what any of them needs comes before the first, so that a worker need
    not leave a group, and what it keeps of it, in the middle. Tasks of equal rank keep their order.

    Parameters
    ----------
    tasks : sequence of Task
        With their predicted seconds.

    Returns
    -------
    list of Task
        The same tasks.
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
        """Keys of the tasks that were not handed out."""
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

    def give_back(self, task: Task) -> None:
        """Have a task done once more, before all others."""
        self._tasks.append(task)
        self._numbers[task.key] = number = -len(self._tasks)
        self._open[number] = 0
        self._make_ready(number)

    def put_back(self, task: Task) -> None:
        """Take back a task for which there was no room; it keeps its place."""
        self._open[self._numbers[task.key]] = 0
        self._make_ready(self._numbers[task.key])

    def take(self, group: str) -> Task | None:
        """Next task for a worker that keeps something of a group; None while there is none."""
        ready = self._ready.get(group) if group else None
        number = heapq.heappop(ready) if ready else self._first_free()
        if number is None:
            return None
        del self._open[number]
        return self._tasks[number if number >= 0 else -number - 1]

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
        group = self._tasks[number if number >= 0 else -number - 1].group
        heapq.heappush(self._ready[group], number)
        heapq.heappush(self._fronts, (number, group))

    def _first_free(self) -> int | None:
        """First ready task without a group, or of one that no worker holds."""
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
