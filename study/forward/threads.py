"""Threads of one simulation: for the elements, none for sums of vectors.

Kernels let go of Python's lock and every element writes rows of its own, so that ordinary
threads do; what is found does not depend on their number. As many are used as the worker
of a study or the user allows.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from functools import partial
from typing import Any, TypeVar

import numba
from threadpoolctl import ThreadpoolController

#: quadrature points below which waking a thread costs more than it saves
_FEW = 10_000
#: how long MKL's threads wait for more work
_AWAKE_MS = 1
_CONFIG: Any = numba.config
_Result = TypeVar("_Result")


def smallest_in_slices(shape: tuple[int, ...], loop: Callable[[slice], float]) -> float:
    """Smallest result of ``loop`` over slices of the elements.

    ``shape`` is (n_elements, points of each).
    """
    n_elements, n_points = shape
    count = _worth_waking(n_elements * n_points)
    edges = [n_elements * i // count for i in range(count + 1)]
    parts = [slice(a, b) for a, b in zip(edges, edges[1:], strict=False)]
    return min(_at_once([partial(loop, part) for part in parts]))


def side_by_side(first: Callable[[], None], second: Callable[[], None], points: int) -> None:
    """Run both, at once where a second thread pays for so many quadrature points."""
    if _worth_waking(points) > 1:
        _at_once([first, second])
    else:
        first()
        second()


def _worth_waking(points: int) -> int:
    """Threads that pay for so many quadrature points, this one included."""
    return max(int(_CONFIG.NUMBA_NUM_THREADS), 1) if points >= _FEW else 1


def _at_once(jobs: Sequence[Callable[[], _Result]]) -> list[_Result]:
    """Results of all jobs: the first is done here, every other in a thread."""
    here, *others = jobs
    waiting = [_threads(len(others)).submit(job) for job in others]
    return [here(), *(job.result() for job in waiting)]


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
