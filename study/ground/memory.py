"""Memory of this machine and of this process."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def uncollected() -> Iterator[None]:
    """Context in which nobody looks for reference cycles."""
    # Records and drawings are made of hundreds of thousands of objects that are all in use: walking
    # through them again and again took a fifth of the time of a report and a tenth of a resume.
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def free_memory_MB() -> float | None:  # noqa: N802
    """Memory of this machine that nobody uses now; None where it does not say."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        amounts = {name: rest for name, _, rest in (line.partition(":") for line in lines)}
        return float(amounts["MemAvailable"].split()[0]) * 1.024e-3  # of 1,024 bytes each
    except (OSError, KeyError, ValueError, IndexError):
        return None
