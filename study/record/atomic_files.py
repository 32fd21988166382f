"""Files that are either there whole or not at all.

A file is written beside its place, flushed to the disk, renamed over its final name, and the
folder is flushed: after a crash or a power loss the old content or the new one is there,
never something in between (Pillai et al. 2014, OSDI, "All file systems are not created
equal"). :mod:`study.bounded_file` reads them.
"""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterator
from pathlib import Path

from study.errors import DiskFullError, StoreError

TEMPORARY = ".part"

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

    def sync_file(self, path: Path) -> None:
        """Flush a file to the disk."""
        _sync(path, os.O_RDONLY)

    def replace(self, source: Path, target: Path) -> None:
        """Rename, atomically, over whatever stands there."""
        os.replace(source, target)

    def sync_folder(self, path: Path) -> None:
        """Flush the names in a folder to the disk."""
        _sync(path, os.O_RDONLY)

    def unlink(self, path: Path) -> None:
        """Delete a file."""
        path.unlink(missing_ok=True)


def _sync(path: Path, flags: int) -> None:
    handle = os.open(path, flags)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_atomic(
    path: Path,
    data: bytes,
    system: FileSystem | None = None,
    later: dict[Path, None] | None = None,
    *,
    flush: bool = True,
) -> None:
    """Write ``data`` to ``path`` so that a crash leaves the old content or the new.

    A link that stands at ``path`` is replaced, not followed.

    Parameters
    ----------
    path : Path
        Where the file belongs.
    data : bytes
        All of it.
    system : FileSystem, optional
        Operations that change the disk.
    later : dict of Path, optional
        Takes the folders whose names are still to be flushed, for a caller that writes many files
        and flushes each folder once. Until then a loss of power may bring the old content back.
    flush : bool
        False for what can be made again, such as a report: a loss of power may leave it empty.

    Raises
    ------
    DiskFullError
        If the disk takes no more.
    StoreError
        If the folder is read-only or the name too long. In both cases nothing stands under the
        final name that was not there before, and no part of it beside.
    """
    system = system or FileSystem()
    part = _part(path)
    try:
        for folder in _make_folder(path.parent, system):
            _sync_names(folder, system, later)
        system.write(part, data)
        if flush:
            system.sync_file(part)
        system.replace(part, path)
        if flush:
            _sync_names(path.parent, system, later)
    except OSError as error:
        _discard(part, system)
        raise write_error(path, error) from error
    except KeyboardInterrupt:
        _discard(part, system)
        raise


@contextlib.contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """Name beside ``path`` for a writer that takes names alone; it stands there when all is well.

    Raises
    ------
    StoreError
        As of :func:`write_atomic`.
    """
    part = _part(path)
    try:
        yield part
        os.replace(part, path)
    except OSError as error:
        raise write_error(path, error) from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


def write_new(path: Path, text: str) -> None:
    """Write a file where there is none, whole or not at all.

    Raises
    ------
    FileExistsError
        If there is one.
    StoreError
        As of :func:`write_atomic`.
    """
    with open(path, "x", encoding="utf-8"):
        pass
    try:
        write_atomic(path, text.encode())
    except BaseException:
        _discard(path, FileSystem())
        raise


def write_error(path: str | Path, error: OSError) -> StoreError:
    """Error of a file that could not be written, by what the system says of it."""
    text = f"{path}: could not be written ({error.strerror or error}); what was there before is "
    if error.errno in FULL:
        return DiskFullError(f"{text}unharmed. Free space, then run again")
    return StoreError(f"{text}unharmed. Choose another folder, or mend this one, then run again")


def _part(path: Path) -> Path:
    return path.with_name(f".{path.name}.{os.getpid()}{TEMPORARY}")


def _sync_names(folder: Path, system: FileSystem, later: dict[Path, None] | None) -> None:
    """Flush the names in a folder, now or later."""
    if later is None:
        system.sync_folder(folder)
    else:
        later[folder] = None


def _make_folder(folder: Path, system: FileSystem) -> list[Path]:
    """Make a folder; those to be flushed for its name to survive a power loss too."""
    if folder.is_dir():
        return []
    new = [path for path in (folder, *folder.parents) if not path.exists()]
    if new:
        system.make_folder(folder)
    return [path.parent for path in reversed(new)]


def is_leftover(name: str) -> bool:
    """Whether the name of a file is of those that an interrupted write leaves behind.

    Parameters
    ----------
    name : str
        Without its folder.
    """
    return name.startswith(".") and name.endswith(TEMPORARY)


def _discard(part: Path, system: FileSystem) -> None:
    try:
        system.unlink(part)
    except OSError:
        return  # the disk refuses even this; the next run clears the leftover
