"""Files that are either there whole or not at all.

A file is written beside its place, flushed to the disk, renamed over its final name, and the
folder is flushed: after a crash or a power loss the old content or the new one is there,
never something in between (Pillai et al. 2014, OSDI, "All file systems are not created
equal"). :mod:`study.bounded_file` reads them.
"""

from __future__ import annotations

import os
from pathlib import Path

from study.errors import StoreError

TEMPORARY = ".part"


class FileSystem:
    """The operations that change the disk; tests replace it to crash at each of them."""

    def make_folder(self, path: Path) -> None:
        """Make a folder and those above it."""
        path.mkdir(parents=True, exist_ok=True)

    def write(self, path: Path, data: bytes) -> None:
        """Write a new file."""
        with open(path, "wb") as stream:
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
) -> None:
    """Write ``data`` to ``path`` so that a crash leaves the old content or the new.

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

    Raises
    ------
    StoreError
        If the disk is full, the folder read-only or the name too long; nothing stands under
        the final name that was not there before.
    """
    system = system or FileSystem()
    part = path.with_name(f".{path.name}.{os.getpid()}{TEMPORARY}")
    try:
        for folder in _make_folder(path.parent, system):
            _sync_names(folder, system, later)
        system.write(part, data)
        system.sync_file(part)
        system.replace(part, path)
        _sync_names(path.parent, system, later)
    except OSError as error:
        _discard(part, system)
        raise StoreError(
            f"{path}: could not be written ({error.strerror or error}); what was there before "
            "is unharmed. Free space or choose another folder, then run again: it resumes"
        ) from error


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
