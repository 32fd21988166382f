"""Memory of this process."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


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
