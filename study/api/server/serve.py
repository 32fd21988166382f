"""Serve pages until the user stops it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from study.api.folders import REPORTS, RESULTS
from study.api.server.request import StudyServer
from study.api.server.states import Folders
from study.errors import Fault, InputError


def serve(
    *,
    results: str | Path = RESULTS,
    reports: str | Path = REPORTS,
    port: int = 8765,
    ready: Callable[[str], None] | None = None,
) -> None:
    """Show studies at work, finished ones and their reports in a browser, until Ctrl-C.

    Nobody but this machine is answered, and nothing is written.

    Parameters
    ----------
    results, reports : str or Path
        Folders that ``study run`` writes; they may be made later.
    port : int
        Port on 127.0.0.1; 0 takes a free one.
    ready : callable, optional
        Called with the address once it is answered.

    Raises
    ------
    InputError
        If the port is taken.
    KeyboardInterrupt
        On Ctrl-C.
    """
    try:
        server = StudyServer(Folders(Path(results), Path(reports)), port)
    except OSError as error:
        rule = f"{port} cannot be listened on ({error.strerror or error})"
        raise InputError(Fault("--port", rule, "name another one; 0 takes a free one")) from None
    with server:
        if ready is not None:
            ready(server.address)
        server.serve_forever(poll_interval=0.2)
