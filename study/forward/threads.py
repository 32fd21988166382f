"""Threads of one simulation: for the elements, none for sums of vectors.

Kernels let go of Python's lock, and parts that share nothing are worked on at once, so that
ordinary threads do; what is found does not depend on their number. As many are used as the
worker of a study or the user allows.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from functools import partial
from typing import Any

import numba
from threadpoolctl import ThreadpoolController

from study.forward.handed import Elements

#: how long MKL's threads wait for more work
_AWAKE_MS = 1
_CONFIG: Any = numba.config


def smallest(phases: Sequence[Sequence[Elements]], loop: Callable[[Elements], float]) -> float:
    """Smallest result of ``loop`` over all parts: those of a phase at once, phases in turn.

    The first share of a phase is done here, every other in a thread.
    """
    found = []
    for parts in phases:
        count = min(len(parts), max(int(_CONFIG.NUMBA_NUM_THREADS), 1))
        here, *others = [partial(_in_turn, parts[i::count], loop) for i in range(count)]
        waiting = [_threads(len(others)).submit(share) for share in others]
        found += [here(), *(share.result() for share in waiting)]
    return min(found)


def _in_turn(parts: Sequence[Elements], loop: Callable[[Elements], float]) -> float:
    return min(loop(part) for part in parts)


def vectors_alone() -> AbstractContextManager[Any]:
    """Context in which NumPy and SciPy add up vectors without threads.

    Those of OpenBLAS go on spinning after a sum and take the time of what comes next.
    """
    limited: AbstractContextManager[Any] = _openblas().limit(limits=1)
    return limited


def threads_sleep_after_work() -> None:
    """Let MKL's threads sleep after a millisecond.

    By default they keep a core busy for a fifth of a second, in which the next assembly runs.
    """
    for library in ThreadpoolController().select(internal_api="openmp").lib_controllers:
        if library.prefix == "libiomp":
            library.dynlib.kmp_set_blocktime(_AWAKE_MS)


@functools.cache
def _openblas() -> Any:
    """Find the libraries once: that takes longer than to limit them."""
    return ThreadpoolController().select(internal_api="openblas")


@functools.cache
def _threads(count: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count, thread_name_prefix="elements")


# a forked process has none of its parent's threads
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_threads.cache_clear)
