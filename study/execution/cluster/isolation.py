"""Tasks in processes of their own, on a machine that others send tasks to.

A worker of a cluster must not die of a task: what it had finished and not yet sent would be
lost with it. So it hands every task to a process beside it, which may die alone (the bulkhead
of Nygard 2018, Release It!, section 5.3), and keeps that process for the next task of the same
sender, who counts on what it remembers.
"""

from __future__ import annotations

import json
import multiprocessing
import queue
import threading
import time
from collections.abc import Callable
from multiprocessing.util import Finalize

from study.execution.loky import Process
from study.execution.supervisor import Answer
from study.execution.task import Perform, stopped_late

#: seconds after which a process that nobody uses ends: its sender may be gone without a word
IDLE_S = 60.0
#: seconds between two looks whether a task is still wanted
LOOK_S = 0.25
#: of all that ends with this process, ours end first
FIRST = 100


class Processes:
    """The processes of one machine, by the run and the slot that they serve."""

    def __init__(self) -> None:
        self._idle: dict[tuple[str, int], tuple[Process, float]] = {}
        self._busy: dict[Process, str] = {}
        self._lock = threading.Lock()
        self._is_watched = False

    def perform(
        self,
        place: tuple[str, int],
        perform: Perform,
        text: str,
        limit_s: float | None,
        unwanted: Callable[[], bool],
    ) -> Answer:
        """Do one task; never raises, never dies.

        Parameters
        ----------
        place : tuple of str and int
            Name of the run and number of its slot.
        perform : callable
            Does one task.
        text : str
            The task as JSON.
        limit_s : float or None
            Wall-clock limit in seconds, from when the process is up.
        unwanted : callable
            Whether nobody waits for the answer any more.

        Returns
        -------
        Answer
            JSON of the result, or how the process died.
        """
        process = self._taken(place, perform)
        try:
            return _watched(process, text, limit_s, unwanted)
        finally:
            self._put_back(place, process)

    def end(self, run: str) -> None:
        """Kill the processes of a run and no other's."""
        with self._lock:
            idle = [place for place in self._idle if place[0] == run]
            ours = [self._idle.pop(place)[0] for place in idle]
            ours += [process for process, name in self._busy.items() if name == run]
        for process in ours:
            process.kill()

    def close(self) -> None:
        """Kill all processes."""
        with self._lock:
            runs = {place[0] for place in self._idle} | set(self._busy.values())
        for run in runs:
            self.end(run)

    def end_idle(self, idle_s: float = IDLE_S) -> None:
        """Kill the processes that had nothing to do for longer than so many seconds."""
        now = time.monotonic()
        with self._lock:
            late = [place for place, (_, since) in self._idle.items() if now - since > idle_s]
            ours = [self._idle.pop(place)[0] for place in late]
        for process in ours:
            process.kill()

    def _taken(self, place: tuple[str, int], perform: Perform) -> Process:
        with self._lock:
            if not self._is_watched:
                self._is_watched = True
                self._prepare()
            process, _ = self._idle.pop(place, (None, 0.0))
            process = process or Process(perform)
            self._busy[process] = place[0]
        return process

    def _put_back(self, place: tuple[str, int], process: Process) -> None:
        with self._lock:
            del self._busy[process]
            other, _ = self._idle.get(place, (None, 0.0))
            if other is None:
                self._idle[place] = process, time.monotonic()
        if other is not None:
            process.kill()

    def _prepare(self) -> None:
        """Make this process one that may have others, and that does not leave them behind."""
        # workers of a cluster are children of their nannies, which may have none of their own
        multiprocessing.current_process().daemon = False
        # not atexit: such a child runs none of its functions, and waits for its own children
        Finalize(None, self.close, exitpriority=FIRST)
        threading.Thread(target=self._watch, daemon=True).start()

    def _watch(self) -> None:
        while True:
            time.sleep(IDLE_S / 6)
            self.end_idle()


def _watched(
    process: Process, text: str, limit_s: float | None, unwanted: Callable[[], bool]
) -> Answer:
    """Answer of a process, or what became of it."""
    done: queue.SimpleQueue[tuple[object, Answer]] = queue.SimpleQueue()
    process.start(text, done, None)
    ends = time.monotonic() + (float("inf") if limit_s is None else limit_s)
    while True:
        try:
            _, answer = done.get(timeout=max(0.0, min(LOOK_S, ends - time.monotonic())))
        except queue.Empty:
            answer = None
        if answer is not None and answer.began:  # the process is up: its task has the whole limit
            ends = time.monotonic() + (float("inf") if limit_s is None else limit_s)
            continue
        if answer is None and unwanted():
            answer = Answer(death="stopped")
        elif answer is None and limit_s is not None and time.monotonic() >= ends:
            process.kill()
            return Answer(json.dumps(stopped_late(limit_s)))
        if answer is not None:
            if answer.death:
                process.kill()
            return answer


#: those of this machine
HERE = Processes()
