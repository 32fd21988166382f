"""One worker process: JSON tasks in, JSON results out, until the pipe closes.

Started by :mod:`study.runner.pool` as ``python -m study.runner.worker FD``.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from study.runner import case, residual_bootstrap, virtual
from study.runner.fitting import fit_task
from study.runner.numerical import refinement


def main(descriptor: int) -> None:
    """Serve tasks on the inherited pipe."""
    connection = Connection(descriptor)
    # libraries that print to stdout must not disturb anybody: stdout belongs to --json
    os.dup2(sys.stderr.fileno(), 1)
    _leave_with_parent(os.getppid())
    while True:
        try:
            task = json.loads(connection.recv_bytes())
        except (EOFError, OSError):
            return
        connection.send_bytes(json.dumps(perform(task), allow_nan=False).encode())


def perform(task: dict[str, Any]) -> dict[str, Any]:
    """Do one task; a bug becomes a result with status ``failed`` and its traceback."""
    try:
        return _perform(task)
    except MemoryError as error:
        return {"status": "out-of-memory", "message": f"out of memory: {error}"}
    except Exception as error:  # noqa: BLE001 - the boundary: a bug must not stop the others
        return {
            "status": "failed",
            "message": f"{type(error).__name__}: {error}",
            "traceback": "".join(traceback.format_exception(error)),
        }


def _perform(task: dict[str, Any]) -> dict[str, Any]:
    if task["kind"] == "ping":
        return {"status": "converged"}

    doers: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
        "fit": fit_task.perform,
        "noise": residual_bootstrap.perform,
        "case": case.perform,
        "reference": virtual.perform,
        "solve": refinement.perform,
    }
    return doers[task["kind"]](task)


def _leave_with_parent(parent: int) -> None:
    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


if __name__ == "__main__":
    main(int(sys.argv[1]))
