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
    """One unit of work.

    Parameters
    ----------
    key : str
        Name, unlike that of every other task of a run.
    payload : callable
        Makes the plain data of the task from the results of the tasks it needs; called only
        when all of them are finished.
    needs : tuple of str
        Keys of tasks that must be finished first.
    group : str
        Tasks of one group share something that a worker keeps: one worker does them all.
    seconds : float
        How long it is predicted to take: what keeps the others waiting longest comes first.
    memory_MB : float
        Memory that it is predicted to take: no more run at once than there is room for.
    """

    key: str
    payload: Callable[[Results], Document]
    needs: tuple[str, ...] = ()
    group: str = ""
    seconds: float = 0.0
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
    """Do one task given as JSON, or a list of them, and answer in JSON; a bug is an answer too.

    Parameters
    ----------
    perform : callable
        Does the task.
    text : str
        The task's plain data as JSON, or those of several.

    Returns
    -------
    str
        JSON of the result, or of the list of them; its ``status`` is ``failed`` with the traceback
        where ``perform`` raised or gave something that JSON cannot hold, ``out-of-memory`` where
        memory was short.
    """
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
    """Wall-clock limit of one task in seconds, if it is one.

    Parameters
    ----------
    seconds : float or None
        None for no limit.

    Raises
    ------
    InputError
        If the limit is not a positive number.
    """
    if seconds is None or seconds > 0 and seconds != float("inf"):
        return seconds
    rule = f"must be a positive number of seconds, got {seconds:g}"
    raise InputError(Fault("timeout", rule, "leave it out for no limit"))


def stopped_late(limit_s: float) -> Document:
    """Say that a task was stopped at its wall-clock limit.

    Parameters
    ----------
    limit_s : float
        The limit, s.

    Returns
    -------
    dict
        ``status``, which is ``timeout``, and ``message``.
    """
    message = f"stopped after {limit_s:g} s, the limit of one computation"
    return {"status": "timeout", "message": message}
