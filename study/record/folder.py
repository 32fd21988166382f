"""A folder of sealed JSON files: crash-safe, one writer at a time, nothing damaged is used."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Self, TypeVar, cast

from study.bounded_file import MAX_JSON_BYTES, NotRegularError, read_regular
from study.errors import NewerSchemaError, StoreError
from study.record import lock
from study.record.atomic_files import FileSystem, is_leftover, write_atomic, write_error
from study.record.document_checks import fault_of
from study.record.record import plain, seal, unseal

Kept = TypeVar("Kept")

ID = re.compile(r"[a-z0-9][a-z0-9-]{0,79}")


def own_folder(root: Path, name: str) -> Path:
    """Return the folder of a study or a report below the one that the user named; it is not made.

    Parameters
    ----------
    root : Path
        Folder that the user named, which may be a link.
    name : str
        Of the folder in it.

    Raises
    ------
    StoreError
        If it is a link that leads out of ``root``, or nowhere.
    """
    return _inside(
        root,
        root / name,
        f"{root}, where nothing is written; remove the link, or name another folder",
    )


def _inside(root: Path, path: Path, outside: str) -> Path:
    """Refuse a place that a link leads out of a folder."""
    below = path.relative_to(root).parts
    names = [os.path.join(root, *below[: k + 1]) for k in range(len(below))]
    if not any(map(os.path.islink, names)):
        return path
    try:
        inside = path.resolve().is_relative_to(root.resolve())
    except (OSError, RuntimeError, ValueError) as error:
        raise StoreError(f"{path}: cannot be used ({error})") from error
    if not inside:
        raise StoreError(f"{path}: a link leads outside {outside}")
    return path


class SealedFolder:
    """Sealed files under names, in a folder that one process at a time may write to.

    Parameters
    ----------
    path : Path
        The folder; made when first written to.
    warn : callable, optional
        Receives each warning; all are also kept in ``warnings``.
    system : FileSystem, optional
        Operations that change the disk.
    """

    def __init__(
        self,
        path: Path | str,
        warn: Callable[[str], None] | None = None,
        system: FileSystem | None = None,
    ) -> None:
        self.path = Path(path)
        self.warnings: list[str] = []
        self._warn = warn
        self._system = system or FileSystem()
        self._locked = False
        #: folders with names that a loss of power may still take back
        self._unflushed: dict[Path, None] = {}

    @contextlib.contextmanager
    def lock(self) -> Iterator[Self]:
        """Hold the folder for this process and clear what an interrupted run left behind.

        Raises
        ------
        StoreError
            If another runner holds it (the message names it) or the folder is read-only.
        """
        if self._locked:  # the whole of a run holds it, and its parts as well
            yield self
            return
        self._make(self.path)
        with lock.exclusive(self.path):
            self._locked = True
            try:
                self._begin()
                yield self
            except (Exception, KeyboardInterrupt):
                with contextlib.suppress(StoreError):  # what went wrong matters more
                    self._end()
                raise
            else:
                self._end()
            finally:
                self._locked = False

    def note(self, progress: Mapping[str, object]) -> None:
        """Say to other processes how far the runner is, while this one holds the folder."""
        if self._locked:
            lock.sign(self.path, progress)

    def running(self) -> dict[str, object] | None:
        """Pid, host, start and progress of the runner in this folder; None if there is none."""
        return lock.holder(self.path) if lock.is_locked(self.path) else None

    def write_json(self, name: str, content: object, *, followed: bool = False) -> None:
        """Store any JSON content under a name such as ``"study"``, sealed and atomically.

        Parameters
        ----------
        followed : bool
            Whether another write comes at once, with which its folder is flushed: a runner that
            is killed loses nothing by that, a machine without power what follows at once.
        """
        lost: dict[str, str] = {}
        clean = plain(content, name, lost)
        if lost and isinstance(clean, dict):
            clean["not_finite"] = lost
        self._write(self._json(name), seal(clean).encode(), followed)

    def _write(self, path: Path, data: bytes, followed: bool = False) -> None:
        """Write a file; what went before it and was left unflushed is flushed first."""
        if not followed:
            self._flush()
        write_atomic(path, data, self._system, self._unflushed if followed else None)

    def _flush(self) -> None:
        """Make the names of all that was written survive a loss of power."""
        try:
            while self._unflushed:
                self._system.sync_folder(next(iter(self._unflushed)))
                del self._unflushed[next(iter(self._unflushed))]
        except OSError as error:
            raise write_error(self.path, error) from error

    def read_json(self, name: str) -> object:
        """Content stored under a name; None if there is none or it is damaged (set aside)."""
        path = self._json(name)
        data = self._bytes(path)
        if data is None:
            return None
        try:
            content = unseal(data, str(path))
            if content is None:
                raise StoreError(f"{path}: holds nothing")
        except NewerSchemaError:
            raise
        except StoreError as error:
            self._set_aside(path, str(error))
            return None
        return content

    def read_document(
        self, name: str, kind: type[Kept], fault: Callable[[Kept], str] = lambda content: ""
    ) -> Kept | None:
        """Content stored under a name, as its class says; None as for :meth:`read_json`.

        Parameters
        ----------
        kind : type
            Class of :mod:`study.record.document`, or a list of one.
        fault : callable, optional
            Says what is wrong with a content of the right keys and types; empty if nothing is.
        """
        content = self.read_json(name)
        if content is None:
            return None
        why = fault_of(content, kind) or fault(cast(Kept, content))
        if not why:
            return cast(Kept, content)
        path = self._json(name)
        self._set_aside(path, f"{path}: is not what a study writes there, {why}")
        return None

    def _begin(self) -> None:
        """Do what the owner of the folder does first."""

    def _end(self) -> None:
        """Do what the owner of the folder does last."""

    def _json(self, name: str) -> Path:
        if not all(ID.fullmatch(part) for part in name.split("/")):
            raise StoreError(f"{name!r} is no name of a stored file (a-z, 0-9, hyphens)")
        return self._inside(self.path / f"{name}.json")

    def _inside(self, path: Path) -> Path:
        """Refuse a place that a link leads out of the results folder."""
        return _inside(self.path, path, "the results folder; remove it")

    def _bytes(self, path: Path, limit: int = MAX_JSON_BYTES) -> bytes | None:
        try:
            return read_regular(path, limit)
        except NotRegularError as error:
            self._set_aside(path, str(error))
            return None

    def _make(self, folder: Path) -> None:
        try:
            self._system.make_folder(folder)
        except OSError as error:
            raise StoreError(f"{folder}: cannot be made ({error.strerror or error})") from error

    def _set_aside(self, path: Path, why: str) -> None:
        """Rename a damaged file; a reader without the lock leaves it to the next runner.

        Without the lock, a runner could replace the file by a good one between our reading
        and our renaming.
        """
        if not self._locked:
            self._say(f"{why}; it is not used, and the next run replaces it")
            return
        number = 1
        while (target := path.with_name(f"{path.name}.corrupt-{number}")).exists():
            number += 1
        try:
            self._system.replace(path, target)
        except OSError as error:
            self._say(f"{why}; it is not used, but could not be renamed ({error})")
            return
        self._say(f"{why}; it was renamed to {target.name} and will be computed again")

    def _clear_leftovers(self, folders: Iterable[str]) -> None:
        for folder in folders:
            with contextlib.suppress(OSError):  # ignored by every reader anyway
                for name in filter(is_leftover, os.listdir(folder)):
                    self._system.unlink(Path(folder, name))

    def _say(self, message: str) -> None:
        if message in self.warnings:
            return
        self.warnings.append(message)
        if self._warn is not None:
            self._warn(message)
