"""A worker whose tasks misbehave on demand, to see what the pool makes of it."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

from study.runner import worker


def perform(task: dict[str, Any]) -> dict[str, Any]:
    kind = task["kind"]
    if kind == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if kind == "die once" and not Path(task["mark"]).exists():
        Path(task["mark"]).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if kind == "hang":
        time.sleep(60)
    if kind == "print":
        print("noise on stdout", flush=True)
        os.write(1, b"noise of a library\n")
    if kind == "threads":
        return {"status": "converged", "threads": os.environ["OMP_NUM_THREADS"]}
    if kind == "process":
        time.sleep(0.05)
        return {"status": "converged", "process": os.getpid()}
    return {"status": "converged", "value": task.get("value", 0) + 1}


if __name__ == "__main__":
    worker.perform = perform
    worker.main(int(sys.argv[1]))
