"""Compilation of kernels, and a disk cache that no edit leaves stale.

Numba keeps machine code beside the file of a function and throws it away when that file
changes, but not when a function that it calls in another file does. The cache used here
is a folder named after the contents of all files with kernels, in the user's private folder:
whoever can write into it can have his code run.
"""

from __future__ import annotations

import functools
import hashlib
import multiprocessing
import os
import re
import stat
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, Protocol, TypeVar, cast

import numba
from numba.core.caching import UserProvidedCacheLocator
from numba.core.compiler_lock import global_compiler_lock
from threadpoolctl import ThreadpoolController

from study.ground.arrays import Elements

# One folder for caches that are run as code: the user's, with rights for nobody else.

#: owner of files whose owner a container does not know
_UNMAPPED = 65534


@functools.cache
def private_folder() -> Path | None:
    """Folder of this user for caches of this package; None where there is none to be trusted."""
    # It is ``study`` in XDG_CACHE_HOME or ``~/.cache``; where neither can be written, or others
    # could write there, one in the folder for temporary files.
    cache = os.environ.get("XDG_CACHE_HOME", "")
    home = os.path.expanduser(os.path.join("~", ".cache"))
    temporary = os.environ.get("TMPDIR", "")
    for folder in [
        Path(cache if os.path.isabs(cache) else home, "study"),
        Path(temporary if os.path.isabs(temporary) else "/tmp", f"study-{os.geteuid()}"),
    ]:
        try:
            folder.parent.mkdir(parents=True, exist_ok=True)
            folder.mkdir(mode=0o700, exist_ok=True)
            fault = fault_of(folder)
        except OSError:  # a home that cannot be written
            continue
        if fault is None and os.access(folder, os.W_OK | os.X_OK):
            return folder
        if fault is not None and multiprocessing.current_process().name == "MainProcess":
            print(f"warning: the cache {folder} is not used: {fault}", file=sys.stderr)
    return None


def fault_of(folder: Path) -> str | None:
    """Say what lets others put files into a folder, and how to mend it; None if nothing does."""
    real = folder.resolve()
    for path in dict.fromkeys([folder, real, *folder.absolute().parents, *real.parents]):
        status = path.lstat()
        is_leaf, is_link = path in (folder, real), stat.S_ISLNK(status.st_mode)
        trusted = {os.geteuid()} if is_leaf else {os.geteuid(), 0, _UNMAPPED}
        if status.st_uid not in trusted:
            return f"{path} belongs to another user\n    {_mend(folder, path)}"
        others = 0o077 if is_leaf else 0o002 if status.st_gid == os.getgid() else 0o022
        is_sticky = not is_leaf and status.st_mode & stat.S_ISVTX
        if status.st_mode & others and not is_link and not is_sticky:
            mode = stat.S_IMODE(status.st_mode)
            return f"others have rights in {path} (mode {mode:o})\n    {_mend(folder, path)}"
    return None


def _mend(folder: Path, path: Path) -> str:
    if path in (folder, folder.resolve()):
        return f"remove it, it is made again: rm -r {path}"
    return f"chmod go-w {path}, or name another folder: XDG_CACHE_HOME=/a/folder/of/yours"


_Function = TypeVar("_Function", bound=Callable[..., Any])
#: names of constants that a module takes from another
_CONSTANTS = re.compile(rb"^from ([\w.]+) import (?:\([^)]*|.*)\b[A-Z][A-Z_]+\b", re.MULTILINE)
#: reorder and contract sums, but keep NaN: an inverted element must still be seen
FAST = {"contract", "reassoc", "arcp", "nsz"}
#: the longest compilation takes 15 s, and four times that on a busy machine
_PATIENCE_S = 120.0
#: folder of the whole package, wherever in it this module is
_PACKAGE = Path(str(sys.modules[__name__.partition(".")[0]].__file__)).resolve().parent
_CONFIG: Any = numba.config
# numba looks for settings in the working folder again at every compilation
_CONFIG._config_fname = os.devnull


@functools.cache
def cache_folder() -> Path | None:
    """Folder for machine code of the kernels as they are; None where no folder can be trusted."""
    home = private_folder()
    if home is None:
        return None
    marks = b"@kernel(", b"@part(", b"@callback("
    contents = [(path, path.read_bytes()) for path in _PACKAGE.rglob("*.py")]
    kernels = [text for _, text in contents if any(mark in text for mark in marks)]
    sources = {source.split(b".")[-1].decode() for t in kernels for source in _CONSTANTS.findall(t)}
    constants = [text for path, text in contents if path.stem in sources]
    digest = hashlib.sha256(
        b"".join(hashlib.sha256(text).digest() for text in sorted({*kernels, *constants}))
    )
    return home / f"kernels-{digest.hexdigest()[:16]}"


@contextmanager
def only_process(work: str) -> Iterator[None]:
    """Context in which no other process does the same work on the kernels of this package."""
    # The operating system frees a lock when its process ends. Where a folder cannot be written or
    # locked, and after the patience for the longest compilation, work is done twice.
    from filelock import FileLock

    folder = cache_folder()
    with ExitStack() as held:
        if folder is not None:
            with suppress(OSError):
                folder.mkdir(parents=True, exist_ok=True)
                name = hashlib.sha256(work.encode()).hexdigest()[:16]
                held.enter_context(FileLock(folder / f"{name}.lock", timeout=_PATIENCE_S))
        yield


def kernel(**options: Any) -> Callable[[_Function], _Function]:
    """Decorate a function to be compiled on first use and kept on disk."""
    decorate = _kept_on_disk(functools.partial(numba.njit, **options))

    def decorated(function: _Function) -> _Function:
        dispatcher: _Function = decorate(function)
        _compile_once(cast(_Dispatcher, dispatcher))
        return dispatcher

    return decorated


class PackageCacheLocator(UserProvidedCacheLocator):
    """Place of a kernel in the cache: that of its file in the package, in whatever clone it is."""

    @classmethod
    def get_suitable_cache_subpath(cls, py_file: str) -> str:
        """Say the folder of a file's kernels, under the cache."""
        path = Path(py_file).resolve()
        if path.is_relative_to(_PACKAGE):
            return str(path.parent.relative_to(_PACKAGE))
        return str(super().get_suitable_cache_subpath(py_file))  # type: ignore[no-untyped-call]


def _kept_on_disk(compiler: Callable[..., Any]) -> Callable[[_Function], Any]:
    def decorate(function: _Function) -> Any:
        folder = cache_folder()
        if folder is None:
            return compiler(cache=False)(function)
        usual = _CONFIG.CACHE_DIR, _CONFIG.CACHE_LOCATOR_CLASSES
        # no other folder, should this one fail: numba would take the next that has a cache
        locator = f"{__name__}.{PackageCacheLocator.__name__}"
        _CONFIG.CACHE_DIR, _CONFIG.CACHE_LOCATOR_CLASSES = str(folder), locator
        try:
            return compiler(cache=True)(function)
        finally:
            _CONFIG.CACHE_DIR, _CONFIG.CACHE_LOCATOR_CLASSES = usual

    return decorate


class _Cache(Protocol):
    """What numba's dispatcher keeps machine code with."""

    save_overload: Callable[[object, object], None]


class _Dispatcher(Protocol):
    """What numba makes of a function."""

    py_func: Callable[..., object]
    compile: Callable[[object], object]
    _cache: _Cache


def _compile_once(dispatcher: _Dispatcher) -> None:
    """Let one process compile a signature of a kernel: others wait, and find it on disk."""
    # Numba lets each process that starts on an empty cache compile all of it, and of two that add
    # to a kernel's index at once one loses its entry.
    name = f"{dispatcher.py_func.__module__}.{dispatcher.py_func.__qualname__}"
    compile_signature, save = dispatcher.compile, dispatcher._cache.save_overload

    def compile_alone(signature: object) -> object:
        # numba's own lock first: with both in turn, two threads could wait for each other
        with global_compiler_lock, only_process(f"{name}{signature}"):
            return compile_signature(signature)

    def save_alone(signature: object, compiled: object) -> None:
        with only_process(name):
            save(signature, compiled)

    dispatcher.compile, dispatcher._cache.save_overload = compile_alone, save_alone


#: array over the memory that a C library hands to a :func:`callback`
carray: Any = numba.carray  # type: ignore[attr-defined]


def callback(signature: str) -> Callable[[_Function], Any]:
    """Decorate a function that a C library calls; its ``ctypes`` is what to hand over."""
    # It is compiled or found on disk at once, so decorate it where it is first needed.
    return _kept_on_disk(functools.partial(numba.cfunc, signature))


def part(**options: Any) -> Callable[[_Function], _Function]:
    """Decorate a function that kernels alone call: each of them gets a copy of its own.

    Shared machine code is taken from whoever brought it first, and that differs between the
    process that compiles and those that find the kernels on disk; so would the last digits.

    It may take memory from its caller and none of its own: references to arrays are then not
    counted, which took two thirds of the time of an axisymmetric assembly. Numba refuses to
    compile a part that allocates.
    """
    return kernel(forceinline=True, _nrt=False, **options)


#: how long MKL's threads wait for more work
_AWAKE_MS = 1


def smallest(phases: Sequence[Sequence[Elements]], loop: Callable[[Elements], float]) -> float:
    """Smallest result of a loop over all parts: those of a phase at once, phases in turn."""
    # The first share of a phase is done here, every other in a thread.
    smallest_of_parts = []
    for parts in phases:
        count = min(len(parts), max(int(_CONFIG.NUMBA_NUM_THREADS), 1))
        here, *others = [partial(_in_turn, parts[i::count], loop) for i in range(count)]
        waiting = [_threads(len(others)).submit(share) for share in others]
        smallest_of_parts += [here(), *(share.result() for share in waiting)]
    return min(smallest_of_parts)


def _in_turn(parts: Sequence[Elements], loop: Callable[[Elements], float]) -> float:
    return min(loop(part) for part in parts)


def vectors_alone() -> AbstractContextManager[Any]:
    """Context in which NumPy and SciPy add up vectors without threads."""
    # Those of OpenBLAS go on spinning after a sum and take the time of what comes next.
    limited: AbstractContextManager[Any] = _openblas().limit(limits=1)
    return limited


def threads_sleep_after_work() -> None:
    """Let MKL's threads sleep after a millisecond."""
    # By default they keep a core busy for a fifth of a second, in which the next assembly runs.
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
