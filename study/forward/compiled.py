"""Compilation of kernels, and a disk cache that no edit leaves stale.

Numba keeps machine code beside the file of a function and throws it away when that file
changes, but not when a function that it calls in another file does. The cache used here
is a folder named after the contents of all files with kernels.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba

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
    for path in sorted(_HERE.glob("*.py")):
        content = path.read_bytes()
        if any(mark in content for mark in (b"@kernel(", b"@part(", b"@callback(")):
            digest.update(path.name.encode() + content)
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
