"""A folder of sealed JSON files: crash-safe, one writer at a time, nothing damaged is used."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Self, TypeVar, cast

from study.ground.bounded_file import MAX_JSON_BYTES, NotRegularError, read_regular
from study.ground.errors import NewerSchemaError, StoreError
from study.harness.record import atomic_files
from study.harness.record.atomic_files import Batch, FileSystem, is_leftover, write_error
from study.harness.record.document import ManifestDocument, fault_of
from study.harness.record.record import plain, seal, unseal

Kept = TypeVar("Kept")

ID = re.compile(r"[a-z0-9][a-z0-9-]{0,79}")
#: where a link in a results folder must not lead
OUTSIDE = "the results folder; remove it"


def own_folder(root: Path, name: str) -> Path:
    """Folder of a study or a report below the one that the user named; it is not made."""
    outside = f"{root}, where nothing is written; remove the link, or name another folder"
    return inside(root, Path(name).parts, outside)


def inside(root: Path, below: Sequence[str], outside: str) -> Path:
    """Place below a folder; refuse one that a link leads out of it."""
    places, place = [], str(root)
    for part in below:
        place = os.path.join(place, part)
        places.append(place)
    path = Path(place)
    if not any(map(os.path.islink, places)):
        return path
    try:
        is_inside = path.resolve().is_relative_to(root.resolve())
    except (OSError, RuntimeError, ValueError) as error:
        raise StoreError(f"{path}: cannot be used ({error})") from error
    if not is_inside:
        raise StoreError(f"{path}: a link leads outside {outside}")
    return path


class SealedFolder:
    """Sealed files under names, in a folder that one process at a time may write to."""

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
        #: files that wait for the one that follows them
        self._batch = Batch(self._system)

    @contextlib.contextmanager
    def lock(self) -> Iterator[Self]:
        """Hold the folder for this process and clear what an interrupted run left behind."""
        if self._locked:  # the whole of a run holds it, and its parts as well
            yield self
            return
        try:
            self._system.make_folder(self.path)
        except OSError as error:
            raise write_error(self.path, error) from error
        with atomic_files.exclusive(self.path):
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
            atomic_files.sign(self.path, progress)

    def running(self) -> dict[str, object] | None:
        """Pid, host, start and progress of the runner in this folder; None if there is none."""
        return atomic_files.holder(self.path)

    def write_json(self, name: str, content: object, *, followed: bool = False) -> None:
        """Store any JSON content under a name such as ``"study"``, sealed and atomically."""
        lost: dict[str, str] = {}
        clean = plain(content, name, lost)
        if lost and isinstance(clean, dict):
            clean["not_finite"] = lost
        self._write(self._json(name), seal(clean).encode(), followed)

    def _write(
        self,
        path: Path,
        data: bytes,
        followed: bool = False,
        then: Callable[[], None] | None = None,
    ) -> None:
        """Write a file, and those that it follows; one that is followed waits to be in place."""
        self._batch.add(path, data, then)
        if not followed:
            self._batch.finish()

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
        """Content stored under a name, as its class says; None as for :meth:`read_json`."""
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
        return inside(self.path, f"{name}.json".split("/"), OUTSIDE)

    def _bytes(self, path: Path) -> bytes | None:
        try:
            return read_regular(path, MAX_JSON_BYTES)
        except NotRegularError as error:
            self._set_aside(path, str(error))
            return None

    def _set_aside(self, path: Path, why: str) -> None:
        """Rename a damaged file; a reader without the lock leaves it to the next runner."""
        # Without the lock, a runner could replace the file by a good one between our reading and
        # our renaming.
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


# What each run of a study was: a manifest of its own, and the last finished one to read from.
#     study.json            the last finished run; the first one while none is finished
#     unfinished.json       a run of another design that began later and is not finished
#     unfinished-NAME.json  rows that this run found, beside those of the finished one
#     runs/run-N.json       every run that finished and differs from the one before it

Row = TypeVar("Row")

_STUDY = "study"
_UNFINISHED = "unfinished"
#: what a run may find besides its records
ROWS = frozenset({"numerical", "spaces", "validation"})
#: parts of a manifest that say how a run went, not what it was
_OUTCOME = ("timings", "finished")


class ManifestFolder(SealedFolder):
    """Results folder whose finished study stays readable while an edited one is computed."""

    def write_manifest(self, meta: ManifestDocument) -> None:
        """Store what the study is: name, question, seed, design text, versions."""
        self.write_json(_STUDY, dict(meta))

    def read_manifest(self) -> ManifestDocument | None:
        """Read the last finished run, or the first one; None if it is missing or was damaged."""
        return self._manifest(_STUDY)

    def read_unfinished(self) -> ManifestDocument | None:
        """Read the run that began after the last finished one; None if there is none."""
        later = self._manifest(_UNFINISHED)
        return None if later is None or is_same(self.read_manifest(), later) else later

    def read_runs(self) -> list[ManifestDocument]:
        """Every run that finished, the latest first."""
        manifests = (self._manifest(f"runs/run-{number}") for number in reversed(self._numbers()))
        return [manifest for manifest in manifests if manifest is not None]

    def begin_run(self, meta: ManifestDocument) -> None:
        """Note what is going to be computed; a finished study of another design stays as it is."""
        manifest = self.read_manifest()
        if manifest is None or not manifest.get("finished", True):
            self.write_manifest({**meta, "finished": False})
        elif not is_same(manifest, meta):
            self.write_json(_UNFINISHED, {**meta, "finished": False})

    def finish_run(self, meta: ManifestDocument) -> None:
        """Make a run the one that is read from, with what it found besides its records."""
        # A crash anywhere leaves one of the two readable, and running again finishes.
        done: ManifestDocument = {**meta, "finished": True}
        runs = self.read_runs()
        if not runs or _essence(runs[0]) != _essence(done):
            number = self._numbers()[-1] + 1 if runs else 1
            self.write_json(f"runs/run-{number}", dict(done))
        for name in sorted(ROWS):
            rows = self.read_json(f"{_UNFINISHED}-{name}")
            if rows is not None:
                self.write_json(name, rows)
        self.write_manifest(done)
        for name in (_UNFINISHED, *(f"{_UNFINISHED}-{rows_name}" for rows_name in sorted(ROWS))):
            with contextlib.suppress(OSError):  # it says the same as the finished one
                self._system.unlink(self._json(name))

    def write_rows(self, name: str, rows: Sequence[Mapping[str, object]]) -> None:
        """Store a table of :data:`ROWS` that belongs to the run which is being computed."""
        later = self.read_unfinished() is not None
        self.write_json(f"{_UNFINISHED}-{name}" if later else name, list(rows))

    def read_rows(
        self, name: str, kind: type[Row], fault: Callable[[list[Row]], str] = lambda rows: ""
    ) -> list[Row]:
        """Rows of a table of the finished run; empty without one, or where it is damaged."""
        return self.read_document(name, list[kind], fault) or []  # type: ignore[valid-type]

    def _manifest(self, name: str) -> ManifestDocument | None:
        return self.read_document(name, ManifestDocument)

    def _numbers(self) -> list[int]:
        names = (path.stem.partition("run-")[2] for path in (self.path / "runs").glob("run-*.json"))
        return sorted(int(name) for name in names if name.isascii() and name.isdigit())


def is_same(first: ManifestDocument | None, second: ManifestDocument) -> bool:
    """Whether two runs compute and ask the same."""
    if first is None:
        return False
    return all(first.get(key) == second.get(key) for key in ("cases", "design"))


def _essence(meta: ManifestDocument) -> dict[str, object]:
    return {key: value for key, value in meta.items() if key not in _OUTCOME}
