"""Files that are either there whole or not at all.

A file is written beside its place, flushed to the disk, renamed over its final name, and the
folder is flushed: after a crash or a power loss the old content or the new one is there,
never something in between (Pillai et al. 2014, OSDI, "All file systems are not created
equal"). :mod:`study.ground.bounded_file` reads them.
"""

from __future__ import annotations

import contextlib
import datetime
import errno
import json
import os
import re
import socket
import stat
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from study.ground.bounded_file import parse_json
from study.ground.errors import DiskFullError, StoreError, WriteError

# Places in a results folder, none of which a link leads out of it.
ID = re.compile(r"[a-z0-9][a-z0-9-]{0,79}")
#: where a link in a results folder must not lead
OUTSIDE = "the results folder; remove it"


def own_folder(root: Path, name: str) -> Path:
    """Folder of a study or a report below the one that the user named; it is not made."""
    outside = f"{root}, where nothing is written; remove the link, or name another folder"
    return inside(root, Path(name).parts, outside)


def inside(root: Path, below: Sequence[str], outside: str) -> Path:
    """Place below a folder; refuse one that a link leads out of it."""
    places, nested = [], str(root)
    for part in below:
        nested = os.path.join(nested, part)
        places.append(nested)
    path = Path(nested)
    if not any(map(os.path.islink, places)):
        return path
    try:
        is_inside = path.resolve().is_relative_to(root.resolve())
    except (OSError, RuntimeError, ValueError) as error:
        raise StoreError(f"{path}: cannot be used ({error})") from error
    if not is_inside:
        raise StoreError(f"{path}: a link leads outside {outside}")
    return path


TEMPORARY = ".part"
#: files that are flushed one by one; more of them together with their whole file system
_FEW = 4
#: what the system says of a disk that takes no more: no space, quota, size of a file, broken disk
FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO})


class FileSystem:
    """The operations that change the disk; tests replace it to crash at each of them."""

    def make_folder(self, path: Path) -> None:
        """Make a folder and those above it."""
        path.mkdir(parents=True, exist_ok=True)

    def write(self, path: Path, data: bytes) -> None:
        """Write a new file; what was left there, a link too, is not written through."""
        path.unlink(missing_ok=True)
        with open(path, "xb") as stream:
            stream.write(data)

    def sync(self, paths: Sequence[Path]) -> None:
        """Flush files, and the names in folders, to the disk."""
        if len(paths) > _FEW and _sync_all_of(paths[0]):
            return
        for path in paths:
            _sync(path, os.fsync)

    def replace(self, source: Path, target: Path) -> None:
        """Rename, atomically, over whatever stands there."""
        os.replace(source, target)

    def unlink(self, path: Path) -> None:
        """Delete a file."""
        path.unlink(missing_ok=True)


def _sync(path: Path, call: Callable[[int], object]) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        call(handle)
    finally:
        os.close(handle)


def _sync_all_of(path: Path) -> bool:
    """Flush the file system that a path lies on with syncfs(2); False where there is none."""
    # Linux tells of a failed write here since 5.8; 64 files take a quarter of the time of fsync.
    if sys.platform != "linux":
        return False
    release = os.uname().release.split(".")[:2]
    if [int(part) for part in release if part.isdigit()] < [5, 8]:
        return False
    import ctypes

    library = ctypes.CDLL(None, use_errno=True)

    def call(handle: int) -> None:
        if library.syncfs(handle):
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number), str(path))

    _sync(path, call)
    return True


def is_special(path: Path) -> bool:
    """Whether a device, a pipe or a socket stands there, which a new file would destroy."""
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def _part_of(path: Path) -> Path:
    """Name beside a file under which its new content is written."""
    if is_special(path):
        raise WriteError(f"{path}: is a device or a pipe, which stays as it is. Name a file")
    return path.with_name(f".{path.name}.{os.getpid()}{TEMPORARY}")


class Batch:
    """Files that become those of their names together, once all of them lie on the disk."""

    def __init__(self, system: FileSystem) -> None:
        self._system = system
        self._parts: dict[Path, Path] = {}
        self._folders: dict[Path, None] = {}
        self._then: list[Callable[[], None]] = []

    def add(self, path: Path, data: bytes, then: Callable[[], None] | None = None) -> None:
        """Write a file beside its place; ``then`` is called once it is there."""
        part = _part_of(path)
        with self._discarding([path]):  # the others are whole, and stay
            self._parts[path] = part
            for folder in _make_folder(path.parent, self._system):
                self._folders[folder] = None
            self._system.write(part, data)
        if then is not None:
            self._then.append(then)

    def finish(self, *, flush: bool = True) -> None:
        """Put every file in its place: after a crash the old content is there, or the new."""
        then, self._then = self._then, []
        if not self._parts:
            return
        with self._discarding(list(self._parts)):
            if flush:
                self._system.sync(list(self._parts.values()))
            for path in list(self._parts):
                # a link that stands there is replaced, not followed
                self._system.replace(self._parts[path], path)
                del self._parts[path]
                self._folders[path.parent] = None
            if flush:
                self._system.sync(list(self._folders))
        self._folders = {}
        for call in then:
            call()

    @contextmanager
    def _discarding(self, paths: Sequence[Path]) -> Iterator[None]:
        """Context that leaves no part of some files behind when it is not gone through."""
        try:
            yield
        except (OSError, KeyboardInterrupt) as error:
            for path in paths:
                if path in self._parts:
                    _discard(self._parts.pop(path), self._system)
            if isinstance(error, OSError):
                raise write_error(paths[0], error) from error
            raise


def write_atomic(
    path: Path, data: bytes, system: FileSystem | None = None, *, flush: bool = True
) -> None:
    """Write ``data`` to ``path`` so that a crash leaves the old content or the new."""
    batch = Batch(system or FileSystem())
    batch.add(path, data)
    batch.finish(flush=flush)


@contextlib.contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """Name beside ``path`` for a writer that takes names alone; renamed when all is well."""
    part = _part_of(path)
    try:
        yield part
        os.replace(part, path)
    except OSError as error:
        raise write_error(path, error) from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


def write_new(path: Path, text: str) -> None:
    """Write a file where there is none, whole or not at all."""
    with open(path, "x", encoding="utf-8"):
        pass
    try:
        write_atomic(path, text.encode())
    except BaseException:
        _discard(path, FileSystem())
        raise


def write_error(path: str | Path, error: OSError) -> WriteError:
    """Error of a file that could not be written, by what the system says of it."""
    text = f"{path}: could not be written ({error.strerror or error}); what was there before is "
    if error.errno in FULL:
        return DiskFullError(f"{text}unharmed. Free space, then run again")
    return WriteError(f"{text}unharmed. Choose another folder, or mend this one, then run again")


def _make_folder(folder: Path, system: FileSystem) -> list[Path]:
    """Make a folder; those to be flushed for its name to survive a power loss too."""
    if folder.is_dir():
        return []
    new = [path for path in (folder, *folder.parents) if not path.exists()]
    if new:
        system.make_folder(folder)
    return [path.parent for path in reversed(new)]


def is_leftover(name: str) -> bool:
    """Whether the name of a file is of those that an interrupted write leaves behind."""
    return name.startswith(".") and name.endswith(TEMPORARY)


def _discard(part: Path, system: FileSystem) -> None:
    try:
        system.unlink(part)
    except OSError:
        return  # the disk refuses even this; the next run clears the leftover


# One runner per results folder: a lock of the operating system on an open file (filelock: flock, on
# Windows LockFileEx), which dies with its owner. NFS carries it to other machines where the server
# locks files; other network file systems may hold it on one machine only.

LOCK_NAME = ".lock"
#: times that a lock is tried for, and seconds between them
_GLANCES = 5
_GLANCE_S = 0.01
#: what the lock file says of its owner, and the bytes that this and its progress take
_OWNER = ("pid", "host", "since")
_LENGTH = 512
#: Windows locks the first byte for reading, too: what the file says begins behind it
_BEGIN = 1
#: neither a link is followed nor a pipe waited for, where there are any
_AS_IT_LIES = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)


@contextmanager
def exclusive(folder: Path) -> Iterator[None]:
    """Hold the lock of a results folder, or say who holds it."""
    path = folder / LOCK_NAME
    with contextlib.ExitStack() as held:
        try:
            handle = held.enter_context(_opened(path, os.O_RDWR | os.O_CREAT))
        except OSError as error:
            raise StoreError(f"{path}: cannot be written ({error.strerror or error})") from error
        try:
            taken = _take(handle)
        except OSError as error:
            raise StoreError(
                f"{path}: this file system cannot lock files ({error.strerror or error}); keep "
                "results on a local disk"
            ) from error
        if not taken:
            owner = _read(handle)
            who = "another runner"
            if owner:
                who = "pid {} on host {} since {}".format(*(owner.get(key) for key in _OWNER))
            raise StoreError(f"{folder}: locked by {who}; wait for it or stop it")
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        _write(handle, dict(zip(_OWNER, (os.getpid(), socket.gethostname(), now), strict=True)))
        yield


@contextmanager
def _opened(path: Path, flags: int) -> Iterator[int]:
    """Context with the lock file open, and nothing else in its place; its end frees the lock."""
    handle = os.open(path, flags | _AS_IT_LIES, 0o644)
    try:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise OSError("it is no file; remove it")
        yield handle
    finally:
        os.close(handle)


def _take(handle: int) -> bool:
    """Take the lock if it is free; one who only looks whether it is has it for microseconds."""
    from filelock import lock_descriptor

    for _ in range(_GLANCES):
        if lock_descriptor(handle, blocking=False):
            return True
        time.sleep(_GLANCE_S)
    return False


def holder(folder: Path) -> dict[str, object] | None:
    """Read what the runner at work in a folder says of itself; None where there is none."""
    path = folder / LOCK_NAME
    # NFS locks for those alone who may write
    flags = os.O_RDWR if os.access(path, os.W_OK) else os.O_RDONLY
    with contextlib.suppress(OSError), _opened(path, flags) as handle:
        return None if _take(handle) else _read(handle)
    return None


def sign(folder: Path, progress: Mapping[str, object]) -> None:
    """Add progress to what the owner of the lock says of itself, on which nobody depends."""
    with contextlib.suppress(OSError), _opened(folder / LOCK_NAME, os.O_RDWR) as handle:
        owner = {name: value for name, value in _read(handle).items() if name in _OWNER}
        _write(handle, owner | dict(progress))


def _read(handle: int) -> dict[str, object]:
    """Read what the file says of the owner of the lock; nothing where that is damaged."""
    try:
        os.lseek(handle, _BEGIN, os.SEEK_SET)
        content = parse_json(os.read(handle, 4096), LOCK_NAME)
    except (OSError, StoreError):
        return {}
    return content if isinstance(content, dict) else {}


def _write(handle: int, facts: Mapping[str, object]) -> None:
    """Replace what the file says in one write: blanks cover what was there before."""
    text = json.dumps(facts).encode().ljust(_LENGTH)
    # on a full disk the lock holds all the same, it only cannot name its owner
    with contextlib.suppress(OSError):
        os.lseek(handle, _BEGIN, os.SEEK_SET)
        os.write(handle, text)
        os.ftruncate(handle, _BEGIN + len(text))
