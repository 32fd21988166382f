"""A unit of work, what became of it, and what an executor promises."""

from __future__ import annotations

import json
import traceback
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from study.ground.errors import Fault, InputError

#: what JSON can hold under names: the only thing that crosses to a worker and back
Document = Mapping[str, object]
#: a document as a worker gets it, to be read at once by the task that it describes
Received = Mapping[str, Any]
#: a task's document in, a document with a ``status`` out; a function of a module, found by name
Perform = Callable[[dict[str, object]], Document]
Results = Mapping[str, Document]


@dataclass(frozen=True)
class Task:
    """One unit of work."""

    #: Unlike that of every other task of a run.
    key: str
    #: Makes the plain data of the task from the results of those that it needs, once all are there.
    payload: Callable[[Results], Document]
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
        ...


def answer(perform: Perform, text: str) -> str:
    """JSON of the result of one task, or of the list of them, given as JSON."""
    # ``status``: ``failed`` with the traceback where ``perform`` raised or gave something that JSON
    # cannot hold, ``out-of-memory`` where memory was short.
    asked = json.loads(text)
    if isinstance(asked, list):
        return f"[{','.join(_answer(perform, one) for one in asked)}]"
    return _answer(perform, asked)


def _answer(perform: Perform, asked: dict[str, object]) -> str:
    try:
        return json.dumps(perform(asked), allow_nan=False)
    except MemoryError as error:
        return json.dumps({"status": "out-of-memory", "message": f"out of memory: {error}"})
    except Exception as error:  # noqa: BLE001 - the boundary: a bug must not stop the others
        return json.dumps(
            {
                "status": "failed",
                "message": f"{type(error).__name__}: {error}",
                "traceback": "".join(traceback.format_exception(error)),
            }
        )


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
