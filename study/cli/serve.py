"""The verb that shows studies in a browser."""

from __future__ import annotations

import contextlib
from typing import Annotated

import typer

from study.cli.studies import REPORTS, RESULTS, Reports, Results


def serve(
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port on 127.0.0.1; 0 takes a free one.")
    ] = 8765,
    results: Results = RESULTS,
    reports: Reports = REPORTS,
) -> None:
    """Show studies at work, finished ones and their reports in a browser, on this machine alone."""
    from study import api

    with contextlib.suppress(KeyboardInterrupt):  # the usual end, nothing was interrupted
        api.serve(results=results, reports=reports, port=port, ready=_say)


def _say(address: str) -> None:
    print(f"{address}  (Ctrl-C ends it)", flush=True)
