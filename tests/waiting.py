"""Waiting in tests: until something holds, and for processes that end."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path


def until(true: Callable[[], object], seconds: float = 60.0) -> None:
    """Wait until it holds; a killed process, for one, ends only when the kernel gives it a turn."""
    deadline = time.monotonic() + seconds
    while not true():
        if time.monotonic() > deadline:
            raise TimeoutError(f"waited {seconds:g} s for nothing")
        time.sleep(0.05)


def is_alive(pid: int | str) -> bool:
    """Whether a process runs; one that is dead and not collected by its parent (Z) does not."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
    except (FileNotFoundError, ProcessLookupError):
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"
