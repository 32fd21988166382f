"""Compilation of kernels, and a disk cache that no edit leaves stale.

Numba keeps machine code beside the file of a function and throws it away when that file
changes, but not when a function that it calls in another file does. The cache used here
is a folder named after the contents of all files with kernels.
"""

from __future__ import annotations

import functools
import hashlib
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numba
from threadpoolctl import ThreadpoolController

from study.arrays import Elements

_Function = TypeVar("_Function", bound=Callable[..., Any])

#: reorder and contract sums, but keep NaN: an inverted element must still be seen
FAST = {"contract", "reassoc", "arcp", "nsz"}
_HERE = Path(__file__).resolve().parent
_CONFIG: Any = numba.config


@functools.cache
def cache_folder() -> str:
    """Folder for machine code of the kernels as they are, under NUMBA_CACHE_DIR where set.

    Numba falls back to a folder of the user where this one cannot be written.
    """
    digest = hashlib.sha256()
    for path in sorted(_HERE.rglob("*.py")):
        content = path.read_bytes()
        if any(mark in content for mark in (b"@kernel(", b"@part(", b"@callback(")):
            digest.update(str(path.relative_to(_HERE)).encode() + content)
    base = Path(_CONFIG.CACHE_DIR or _HERE / "__pycache__")
    return str(base / f"kernels-{digest.hexdigest()[:16]}")


def kernel(**options: Any) -> Callable[[_Function], _Function]:
    """Decorate a function to be compiled on first use and kept on disk; options are numba's."""
    return _kept_on_disk(functools.partial(numba.njit, **options))


def _kept_on_disk(compiler: Callable[..., Any]) -> Callable[[_Function], Any]:
    def decorate(function: _Function) -> Any:
        usual = _CONFIG.CACHE_DIR
        _CONFIG.CACHE_DIR = cache_folder()
        try:
            return compiler(cache=True)(function)
        finally:
            _CONFIG.CACHE_DIR = usual

    return decorate


#: array over the memory that a C library hands to a :func:`callback`
carray: Any = numba.carray  # type: ignore[attr-defined]


def callback(signature: str) -> Callable[[_Function], Any]:
    """Decorate a function that a C library calls; its ``ctypes`` is what to hand over.

    It is compiled or found on disk at once, so decorate it where it is first needed.
    """
    return _kept_on_disk(functools.partial(numba.cfunc, signature))


def part(**options: Any) -> Callable[[_Function], _Function]:
    """Decorate a function that kernels alone call: each of them gets a copy of its own.

    Shared machine code is taken from whoever brought it first, and that differs between the
    process that compiles and those that find the kernels on disk; so would the last digits.
    """
    return kernel(forceinline=True, **options)


#: how long MKL's threads wait for more work
_AWAKE_MS = 1


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
