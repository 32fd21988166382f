"""The way to a scheduler, and what is used of Dask's client."""

from __future__ import annotations

import contextlib
import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Protocol

from study.errors import Fault, InputError

#: seconds to reach a scheduler, and those after which one that is silent is taken for gone
PATIENCE_S = 30.0


class Pending(Protocol):
    """What is used of a future of Dask, which has no types of its own."""

    status: str
    key: str

    def result(self) -> tuple[str, str]:
        """Text of the answer, and how its process died."""
        ...

    def add_done_callback(self, call: Callable[[Pending], None]) -> None:
        """Call with the future when it ends."""
        ...


class Client(Protocol):
    """What is used of Dask's client."""

    status: str

    def submit(self, call: Callable[..., object], *args: object, **options: object) -> Pending:
        """Have a call made on a worker."""
        ...

    def run(
        self, call: Callable[..., object], *args: object, **options: object
    ) -> dict[str, object]:
        """Make a call on every worker at once, beside its tasks."""
        ...

    def nthreads(self) -> Mapping[str, int]:
        """Threads of every worker, by its address."""
        ...

    def cancel(self, futures: Sequence[Pending], **options: object) -> None:
        """Give futures up."""
        ...

    def close(self) -> None:
        """Leave the cluster."""
        ...


#: loggers that tell the loss of a scheduler with a traceback each; our error tells it once
_LOGS = ("distributed.client", "distributed.batched")


@contextlib.contextmanager
def connected(scheduler: str | Path | Client) -> Iterator[Client]:
    """Client of a scheduler, closed again unless it was given.

    Parameters
    ----------
    scheduler : str, Path or Client
        Address of a scheduler, its file, or a client that stays open.

    Raises
    ------
    InputError
        If Dask is not installed, or the scheduler cannot be reached.
    """
    if not isinstance(scheduler, str | os.PathLike):
        yield scheduler
        return
    try:
        from distributed import Client as DaskClient
    except ImportError as error:
        mend = "install it: python -m pip install 'study[dask]'"
        raise InputError(Fault("scheduler", "needs the package distributed", mend)) from error
    where = _place(str(scheduler))
    client = DaskClient.__new__(DaskClient)
    levels = {name: logging.getLogger(name).level for name in _LOGS}
    _set_levels(dict.fromkeys(_LOGS, logging.CRITICAL))
    try:
        client.__init__(**where, timeout=PATIENCE_S, set_as_default=False)
    except Exception as error:  # whatever it is, there is no way in
        client.status = "closed"  # it would else wait for its farewell when it is collected
        mend = (
            "is it running, does the address begin with tls:// where it is encrypted, and are the\n"
            "    certificates those of the cluster?"
        )
        rule = f"{scheduler} cannot be reached: {first_line(error)}"
        raise InputError(Fault("scheduler", rule, mend)) from error
    try:
        yield client
    finally:
        with contextlib.suppress(Exception):  # a cluster that is gone needs no farewell
            client.close()
    _set_levels(levels)  # after a loss they stay quiet: threads of the client still complain


def _set_levels(levels: Mapping[str, int]) -> None:
    for name, level in levels.items():
        logging.getLogger(name).setLevel(level)


def _place(scheduler: str) -> dict[str, str]:
    """Keyword of Dask's client for an address or a scheduler file.

    Raises
    ------
    InputError
        If it is neither.
    """
    if Path(scheduler).is_file():
        return {"scheduler_file": scheduler}
    host, _, port = scheduler.rpartition(":")
    if host and port.isdigit():
        return {"address": scheduler}
    mend = "give tls://HOST:PORT, tcp://HOST:PORT, or the file that dask scheduler wrote"
    raise InputError(Fault("scheduler", f"{scheduler!r} is no address and no file", mend))


def first_line(error: BaseException) -> str:
    """First line of what an error says, or its kind where it says nothing.

    Parameters
    ----------
    error : BaseException
        Of any kind; its further lines are left out.
    """
    return (str(error).splitlines() or [type(error).__name__])[0]
