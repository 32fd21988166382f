"""A unit of work, what became of it, and what an executor promises."""

from __future__ import annotations

import json
import traceback
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from study.ground.errors import Fault, InputError

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
