"""One runner per results folder.

The lock is the operating system's (flock), so it dies with its owner: there is no stale lock
to clear by hand. On a network file system flock may hold on one machine only.
"""

from __future__ import annotations

import contextlib
import datetime
import fcntl
import json
import os
import socket
import stat
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from study.bounded_file import parse_json
from study.errors import StoreError

LOCK_NAME = ".lock"

#: times that a lock is tried for, and seconds between them
_GLANCES = 5
_GLANCE_S = 0.01

#: what the lock file says of its owner, and the bytes that this and its progress take
_OWNER = ("pid", "host", "since")
_LENGTH = 512


@contextmanager
def exclusive(folder: Path) -> Iterator[None]:
    """Hold the lock of a results folder, or say who holds it.

    Parameters
    ----------
    folder : Path
        An existing one; the lock is held until the context ends.

    Raises
    ------
    StoreError
        If another process holds it, or the folder cannot be written.
    """
    path = folder / LOCK_NAME
    try:
        handle = _opened(folder, os.O_RDWR | os.O_CREAT)
    except OSError as error:
        raise StoreError(f"{path}: cannot be written ({error.strerror or error})") from error
    try:
        try:
            _take(handle)
        except BlockingIOError as error:
            raise StoreError(_held(folder, path)) from error
        except OSError as error:
            raise StoreError(
                f"{path}: this file system cannot lock files ({error.strerror or error}); keep "
                "results on a local disk"
            ) from error
        _sign(handle)
        yield
    finally:
        os.close(handle)  # releases the lock


def _opened(folder: Path, flags: int) -> int:
    """Open the lock file, and nothing else in its place: to open a pipe may take forever.

    Raises
    ------
    OSError
        If there is none, it is no file, or it may not be opened.
    """
    handle = os.open(folder / LOCK_NAME, flags | os.O_NOFOLLOW | os.O_NONBLOCK, 0o644)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError("it is no file; remove it")
    return handle


def _take(handle: int) -> None:
    """Take the lock; one who only looks whether it is held has it for some microseconds."""
    for _ in range(_GLANCES):
        with contextlib.suppress(BlockingIOError):
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        time.sleep(_GLANCE_S)
    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def holder(folder: Path) -> dict[str, object]:
    """Read what the lock file says of its owner; empty if unreadable or never locked.

    Parameters
    ----------
    folder : Path
        Results folder.

    Returns
    -------
    dict
        ``pid``, ``host`` and ``since`` (ISO time in UTC) of the last owner, and its progress.
    """
    try:
        handle = _opened(folder, os.O_RDONLY)
    except OSError:
        return {}
    try:
        found = parse_json(os.read(handle, 4096), LOCK_NAME)
    except (OSError, StoreError):
        return {}
    finally:
        os.close(handle)
    return found if isinstance(found, dict) else {}


def is_locked(folder: Path) -> bool:
    """Whether a runner is at work in the folder just now.

    Parameters
    ----------
    folder : Path
        Results folder; false also where its lock file cannot be opened.
    """
    try:
        handle = _opened(folder, os.O_RDONLY)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    finally:
        os.close(handle)
    return False


def sign(folder: Path, progress: Mapping[str, object]) -> None:
    """Add progress to what the owner of the lock says of itself.

    Parameters
    ----------
    folder : Path
        Results folder, locked by this process; nothing is written where it has no lock file.
    progress : mapping
        Values that JSON has; it replaces the progress that was written before.
    """
    owner = {name: value for name, value in holder(folder).items() if name in _OWNER}
    try:
        handle = _opened(folder, os.O_WRONLY)
    except OSError:
        return  # nobody depends on it
    try:
        _write(handle, owner | dict(progress))
    finally:
        os.close(handle)


def _sign(handle: int) -> None:
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    _write(handle, dict(zip(_OWNER, (os.getpid(), socket.gethostname(), now), strict=True)))


def _write(handle: int, facts: Mapping[str, object]) -> None:
    """Replace what the file says in one write: blanks cover what was there before."""
    text = json.dumps(facts).encode().ljust(_LENGTH)
    try:
        os.pwrite(handle, text, 0)
        os.ftruncate(handle, len(text))
    except OSError:
        return  # a full disk: the lock holds all the same, it only cannot name its owner


def _held(folder: Path, path: Path) -> str:
    owner = holder(folder)
    if not owner:
        return f"{path.parent}: locked by another runner; wait for it or stop it"
    return (
        f"{path.parent}: locked by pid {owner.get('pid')} on host {owner.get('host')} since "
        f"{owner.get('since')}; wait for it or stop it"
    )
