"""Calls in a process of their own: nothing is left over from one to the next unless it is wanted.

A call that takes too long, or takes its process with it, costs its own answer only.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any

#: what numerical libraries read when they are loaded; a process here has one thread
_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class Answer:
    """What a call gave: ``status`` is ok, error, timeout or crashed; ``value`` where it is ok."""

    status: str
    value: Any = None
    message: str = ""

    @property
    def ok(self) -> bool:
        """Whether there is a value."""
        return self.status == "ok"


class Apart:
    """A process that answers one call after the other; it is ended where one is late.

    Examples
    --------
    >>> with Apart() as process:
    ...     process.ask(divmod, (7, 2), 60.0).value
    (3, 1)
    """

    def __init__(self) -> None:
        self._context = multiprocessing.get_context("spawn")
        self._process: Any = None
        self._line: Connection | None = None

    def __enter__(self) -> Apart:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:  # fmt: skip
        self.close()

    def ask(
        self, function: Callable[..., Any], arguments: tuple[Any, ...], seconds: float
    ) -> Answer:
        """Call a function of a module there, and wait so many seconds for what it returns."""
        line = self._started()
        try:
            line.send((function, arguments))
            if not line.poll(seconds):
                self.close()
                return Answer("timeout", message=f"no answer within {seconds:g} s")
            status, value, message = line.recv()
        except (EOFError, OSError) as error:
            self.close()
            return Answer("crashed", message=f"the process ended ({type(error).__name__})")
        return Answer(status, value, message)

    def close(self) -> None:
        """End the process; the next call starts another one."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
        if self._line is not None:
            self._line.close()
        self._process, self._line = None, None

    def _started(self) -> Connection:
        if self._line is None:
            for name in _THREADS:
                os.environ.setdefault(name, "1")
            self._line, other = self._context.Pipe()
            self._process = self._context.Process(target=_serve, args=(other,), daemon=True)
            self._process.start()
            other.close()
        return self._line


def _serve(line: Connection) -> None:
    """Answer calls until the other end is closed."""
    while True:
        try:
            function, arguments = line.recv()
        except EOFError:
            return
        try:
            line.send(("ok", function(*arguments), ""))
        except Exception as error:  # noqa: BLE001 - whatever it is, the caller is told
            line.send(("error", None, f"{type(error).__name__}: {error}"))
