"""One process that works beside this one: what it cannot do is done here."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from types import TracebackType
from typing import TypeVar

from study.execution.loky import Process

Given = TypeVar("Given")


class Worker:
    """Context with a process that begins calls while this one goes on.

    It may start long before its first call, with what that call will import. A death, or
    arguments that cannot be sent, cost nothing but the time: the call is then made here.

    Parameters
    ----------
    prepare : callable
        What the process does first; a function of a module.

    Examples
    --------
    >>> with Worker(dict) as worker:
    ...     later = worker.begin(max, [2, 3])
    ...     later()
    3
    """

    def __init__(self, prepare: Callable[[], object]) -> None:
        self._prepare = prepare
        self._process = Process(dict)

    def __enter__(self) -> Worker:
        """Start the process."""
        self._pool = self._process.open()
        self._pool.submit(self._prepare)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """End the process, whatever it does."""
        self._process.kill()

    def begin(self, call: Callable[..., Given], *arguments: object) -> Callable[[], Given]:
        """Begin a call there.

        Parameters
        ----------
        call : callable
            A function of a module.
        *arguments : object
            What it is called with.

        Returns
        -------
        callable
            Waits for what the call gives, and returns it.
        """
        try:
            future: Future[Given] = self._pool.submit(call, *arguments)
        except Exception:  # noqa: BLE001 - the process has died: the call itself can still be made
            return lambda: call(*arguments)

        def given() -> Given:
            try:
                return future.result()
            except Exception:  # noqa: BLE001 - as above; a fault of the call itself is raised here
                return call(*arguments)

        return given
