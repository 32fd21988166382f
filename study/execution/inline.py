"""Tasks in this very process, one after the other: for notebooks, tests and debuggers."""

from __future__ import annotations

import json
import time
from collections.abc import Generator, Sequence
from dataclasses import dataclass

from study.execution.queue import ReadyQueue
from study.execution.task import Outcome, Perform, Results, Task, answer


@dataclass(frozen=True)
class Inline:
    """Executor without processes: a task that dies takes the run along.

    Parameters
    ----------
    perform : callable
        Does one task.
    """

    perform: Perform

    def run(
        self, tasks: Sequence[Task], finished: Results | None = None
    ) -> Generator[Outcome, None, None]:
        """Yield the outcome of every task in its turn."""
        ready, group = ReadyQueue(tasks, finished or {}), ""
        while len(ready):
            task = ready.take(group)
            if task is None:
                names = ", ".join(ready.waiting)
                raise RuntimeError(f"tasks wait for something that nobody makes: {names}")
            group, began = task.group, time.monotonic()
            text = json.dumps(task.payload(ready.results), allow_nan=False)
            result = json.loads(answer(self.perform, text))
            ready.finish(task.key, result)
            yield Outcome(task.key, result, time.monotonic() - began)
