"""Waiting in tests: until something holds, and for processes that end."""

import time
from pathlib import Path

#: seconds after which a test gives up: an error of the code, on the busiest of machines
CAP_S = 600.0


def until(true):
    """Wait until it holds; a killed process, for one, ends only when the kernel gives it a turn."""
    deadline = time.monotonic() + CAP_S
    while not true():
        if time.monotonic() > deadline:
            raise TimeoutError(f"waited {CAP_S:g} s for nothing")
        time.sleep(0.05)


def state_of(pid):
    """Letter of what a process does as /proc has it: T stopped, Z dead and not collected."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
    except (FileNotFoundError, ProcessLookupError):
        return ""
    return stat.rpartition(")")[2].split()[0]


def is_alive(pid):
    """Whether a process runs."""
    return state_of(pid) not in ("", "Z")
