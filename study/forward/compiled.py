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
        if b"@kernel(" in content or b"@part(" in content:
            digest.update(path.name.encode() + content)
    base = Path(_CONFIG.CACHE_DIR or _HERE / "__pycache__")
    return str(base / f"kernels-{digest.hexdigest()[:16]}")


def kernel(**options: Any) -> Callable[[_Function], _Function]:
    """Decorate a function to be compiled on first use and kept on disk; options are numba's."""

    def decorate(function: _Function) -> _Function:
        usual = _CONFIG.CACHE_DIR
        _CONFIG.CACHE_DIR = cache_folder()
        try:
            compiled: _Function = numba.njit(cache=True, **options)(function)
            return compiled
        finally:
            _CONFIG.CACHE_DIR = usual

    return decorate


def part(**options: Any) -> Callable[[_Function], _Function]:
    """Decorate a function that kernels alone call: each of them gets a copy of its own.

    Shared machine code is taken from whoever brought it first, and that differs between the
    process that compiles and those that find the kernels on disk; so would the last digits.
    """
    return kernel(forceinline=True, **options)
