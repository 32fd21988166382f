"""One code on one task, in a process of its own: ``python -m benchmarks.child``.

The first, small task is not timed: it imports, compiles and loads what the code needs.
"""

from __future__ import annotations

import argparse
import importlib
import logging
import re
import resource
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.exchange import NoAnswerError, NotInstalledError, Task, write_json
from benchmarks.peers import NAMES


def peak_MB() -> float:
    """Largest resident memory of this process.

    Linux hands ``ru_maxrss`` down from the parent of a process; its own figure does without.
    """
    try:
        found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text("ascii"))
    except OSError:
        found = None
    if found:
        return int(found[1]) / 1024
    unit = 2**20 if sys.platform == "darwin" else 2**10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def measured(peer: Any, warm_up: Task, task: Task, repeats: int) -> dict[str, Any]:
    """Seconds (of the clock, of all cores) of every run, and the last answer."""
    peer.solve(warm_up)
    everywhere = getattr(peer, "everywhere", float)
    seconds, cpu = [], []
    for _ in range(repeats):
        began, busy = time.perf_counter(), time.process_time()
        answer = peer.solve(task)
        took, spent = time.perf_counter() - began, everywhere(time.process_time() - busy)
        seconds.append(took if answer.seconds is None else answer.seconds)
        cpu.append(spent if answer.cpu_s is None else answer.cpu_s)
    peak = answer.peak_MB or everywhere(peak_MB())
    return asdict(answer) | {"seconds": seconds, "cpu_s": cpu, "peak_MB": peak}


def outcome(code: str, warm_up: Task, task: Task, repeats: int) -> tuple[dict[str, Any], int]:
    """Give the result or the reason why there is none, and the rank of this process."""
    try:
        peer = importlib.import_module(f"benchmarks.peers.{NAMES[code].module}")
    except NotInstalledError:
        return {"problem": "not installed"}, 0
    try:
        return measured(peer, warm_up, task, repeats), getattr(peer, "RANK", 0)
    except NoAnswerError as error:
        return {"problem": str(error)}, getattr(peer, "RANK", 0)


def main() -> None:
    """Read the tasks, write the result."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.child", description=__doc__)
    parser.add_argument("code", choices=NAMES)
    parser.add_argument("folder", type=Path, help="holds warm.npz and task.npz")
    parser.add_argument("result", type=Path)
    parser.add_argument("--repeats", type=int, default=1)
    chosen = parser.parse_args()
    logging.disable(logging.INFO)
    warm_up, task = (Task.read(chosen.folder / name) for name in ("warm.npz", "task.npz"))
    found, rank = outcome(chosen.code, warm_up, task, chosen.repeats)
    if rank == 0:
        write_json(chosen.result, found)


if __name__ == "__main__":
    main()
