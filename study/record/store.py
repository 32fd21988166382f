"""The results folder of one study: crash-safe, one runner at a time, nothing damaged is used.

::

    results/<study>/
        study.json                  manifest
        fits/<fit_id>.json          calibrations shared by cases
        cases/<case_id>/record.json
        cases/<case_id>/fields-<hash>.npz
        cases/<case_id>/*.corrupt-1 what was damaged, set aside
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import re
import zipfile
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from study.errors import StoreError
from study.record import lock
from study.record.atomic_files import FileSystem, is_leftover, write_atomic
from study.record.document import ManifestDocument
from study.record.record import Record, plain, seal, unseal

#: an array as it was kept: of numbers, flags or text
Stored = NDArray[np.generic]

MAX_JSON_BYTES = 200_000_000
MAX_FIELD_BYTES = 4_000_000_000
_ID = re.compile(r"[a-z0-9][a-z0-9-]{0,79}")
_FIELDS = re.compile(r"fields-[0-9a-f]{16}\.npz")


@dataclass(frozen=True)
class Survey:
    """What a results folder holds of the cases that a study wants.

    Parameters
    ----------
    done : tuple of str
        Case ids whose record is valid and converged.
    failed : tuple of str
        Case ids whose record is valid and says why there is no answer.
    missing : tuple of str
        Case ids without a usable record.
    foreign : tuple of str
        Those of ``missing`` that have a record of another configuration, data or version.
    """

    done: tuple[str, ...]
    failed: tuple[str, ...]
    missing: tuple[str, ...]
    foreign: tuple[str, ...]


class Store:
    """Records, shared fits and manifest of one study.

    Parameters
    ----------
    path : Path
        Folder of the study's results; made when first written to.
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

    @contextlib.contextmanager
    def lock(self) -> Iterator[Store]:
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
                self._clear_leftovers()
                yield self
            finally:
                self._locked = False

    def note(self, progress: Mapping[str, object]) -> None:
        """Say to other processes how far the runner is, while this one holds the folder."""
        if self._locked:
            lock.sign(self.path, progress)

    def running(self) -> dict[str, object] | None:
        """Pid, host, start and progress of the runner in this folder; None if there is none."""
        return lock.holder(self.path) if lock.is_locked(self.path) else None

    def write(self, record: Record, fields: Mapping[str, ArrayLike] | None = None) -> Record:
        """Store a record, whole or not at all, and after its fields.

        Parameters
        ----------
        record : Record
            What to store; a record of the same case is replaced.
        fields : mapping of str to ndarray, optional
            Arrays to keep beside it.

        Returns
        -------
        Record
            As stored (it names its fields in ``extra["fields"]``).

        Raises
        ------
        StoreError
            If it cannot be written; the former state is unharmed.
        """
        folder = self._case(record.case_id)
        name = ""
        if fields:
            data = _pack(fields)
            name = f"fields-{hashlib.sha256(data).hexdigest()[:16]}.npz"
            record = replace(record, extra={**record.extra, "fields": name})
            write_atomic(folder / name, data, self._system)
        write_atomic(folder / "record.json", record.to_json().encode(), self._system)
        self._drop_other_fields(folder, name)
        return record

    def read(self, case_id: str) -> Record | None:
        """Record of a case; None if there is none or it is damaged (set aside, and warned)."""
        path = self._case(case_id) / "record.json"
        data = self._bytes(path)
        if data is None:
            return None
        try:
            record = Record.from_json(data, str(path))
            if record.case_id != case_id:
                raise StoreError(f"{path}: belongs to case {record.case_id!r}")
        except StoreError as error:
            self._set_aside(path, str(error))
            return None
        return record

    def read_all(self) -> list[Record]:
        """Every valid record, by case id: the order of the runs leaves no trace."""
        return [record for name in self._case_ids() if (record := self.read(name)) is not None]

    def read_fields(self, record: Record) -> dict[str, Stored]:
        """Arrays kept with a record; empty if it has none.

        Raises
        ------
        StoreError
            If they are missing or damaged.
        """
        name = record.extra.get("fields")
        if not name:
            return {}
        if not isinstance(name, str) or not _FIELDS.fullmatch(name):
            raise StoreError(f"case {record.case_id}: {name!r} is no name of a field file")
        path = self._case(record.case_id) / name
        data = self._bytes(path, MAX_FIELD_BYTES)
        if data is None or hashlib.sha256(data).hexdigest()[:16] != name[7:23]:
            raise StoreError(f"{path}: is missing or damaged; delete the case to run it again")
        return _unpack(data, path)

    def survey(self, input_hashes: Mapping[str, str]) -> Survey:
        """Sort the wanted cases into done, failed and missing.

        Parameters
        ----------
        input_hashes : mapping of str to str
            Wanted case ids and the input hash that their records must have.

        Returns
        -------
        Survey
            A record with another input hash counts as missing, and a warning says so.
        """
        done: list[str] = []
        failed: list[str] = []
        missing: list[str] = []
        foreign: list[str] = []
        for case_id, wanted in input_hashes.items():
            record = self.read(case_id)
            if record is None or record.input_hash != wanted:
                missing.append(case_id)
                if record is not None:
                    foreign.append(case_id)
            else:
                (done if record.converged else failed).append(case_id)
        if foreign:
            self._say(
                f"{self.path}: {len(foreign)} records come from another version of the program, "
                "its settings or the data; they are not used and will be computed again"
            )
        return Survey(tuple(done), tuple(failed), tuple(missing), tuple(foreign))

    def done_ids(
        self, input_hashes: Mapping[str, str], retry: Collection[str] = ()
    ) -> frozenset[str]:
        """Cases that need no run: a valid record of this input, whatever its status.

        Parameters
        ----------
        input_hashes : mapping of str to str
            Wanted case ids and their input hashes.
        retry : collection of str
            Statuses that are to be tried again, for example ``("crashed", "timeout")``.
        """
        found = self.survey(input_hashes)
        again = {
            case_id
            for case_id in (found.failed if retry else ())
            if (record := self.read(case_id)) is None or record.status in retry
        }
        return frozenset(found.done + found.failed) - again

    def records(self, input_hashes: Mapping[str, str]) -> list[Record]:
        """Read the records of this very input, in the order of ``input_hashes``."""
        found = (self.read(case_id) for case_id in input_hashes)
        return [r for r in found if r is not None and r.input_hash == input_hashes[r.case_id]]

    def by_case(self, input_hashes: Mapping[str, str]) -> dict[str, Record]:
        """Read the records of this very input, by the name of their case."""
        return {record.case_id: record for record in self.records(input_hashes)}

    def write_json(self, name: str, content: object) -> None:
        """Store any JSON content under a name such as ``"study"``, sealed and atomically."""
        lost: dict[str, str] = {}
        clean = plain(content, name, lost)
        if lost and isinstance(clean, dict):
            clean["not_finite"] = lost
        write_atomic(self._json(name), seal(clean).encode(), self._system)

    def read_json(self, name: str) -> object:
        """Content stored under a name; None if there is none or it is damaged (set aside)."""
        path = self._json(name)
        data = self._bytes(path)
        if data is None:
            return None
        try:
            return unseal(data, str(path))
        except StoreError as error:
            self._set_aside(path, str(error))
            return None

    def read_rows(self, name: str) -> list[dict[str, Any]]:
        """Rows of a table stored under a name, to be read by who wrote them; empty if none is."""
        found = self.read_json(name)
        return found if isinstance(found, list) else []

    def write_manifest(self, meta: ManifestDocument) -> None:
        """Store what the study is: name, question, seed, design text, versions."""
        self.write_json("study", dict(meta))

    def read_manifest(self) -> ManifestDocument | None:
        """Read what :meth:`write_manifest` stored; None if it is missing or was damaged."""
        found = self.read_json("study")
        return cast(ManifestDocument, found) if isinstance(found, dict) else None

    def write_fit(self, fit_id: str, content: Mapping[str, object]) -> None:
        """Store a calibration that several cases share."""
        self.write_json(f"fits/{fit_id}", dict(content))

    def read_fit(self, fit_id: str) -> dict[str, object] | None:
        """Read a shared calibration; None if it is missing or was damaged."""
        found = self.read_json(f"fits/{fit_id}")
        return found if isinstance(found, dict) else None

    def _case(self, case_id: str) -> Path:
        if not _ID.fullmatch(case_id):
            raise StoreError(f"{case_id!r} is no case id (small letters, digits and hyphens)")
        return self._inside(self.path / "cases" / case_id)

    def _json(self, name: str) -> Path:
        if not all(_ID.fullmatch(part) for part in name.split("/")):
            raise StoreError(f"{name!r} is no name of a stored file (a-z, 0-9, hyphens)")
        return self._inside(self.path / f"{name}.json")

    def _inside(self, path: Path) -> Path:
        """Refuse a place that a link leads out of the results folder."""
        try:
            inside = path.resolve().is_relative_to(self.path.resolve())
        except (OSError, RuntimeError, ValueError) as error:
            raise StoreError(f"{path}: cannot be used ({error})") from error
        if not inside:
            raise StoreError(f"{path}: a link leads outside the results folder; remove it")
        return path

    def _case_ids(self) -> list[str]:
        folder = self.path / "cases"
        try:
            return sorted(entry.name for entry in folder.iterdir() if _ID.fullmatch(entry.name))
        except FileNotFoundError:
            return []
        except OSError as error:
            raise StoreError(f"{folder}: cannot be read ({error.strerror or error})") from error

    def _bytes(self, path: Path, limit: int = MAX_JSON_BYTES) -> bytes | None:
        try:
            if path.stat().st_size > limit:
                self._set_aside(path, f"{path}: is larger than {limit} bytes, which no record is")
                return None
            return path.read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            raise StoreError(f"{path}: cannot be read ({error.strerror or error})") from error

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

    def _drop_other_fields(self, folder: Path, keep: str) -> None:
        for path in folder.glob("fields-*.npz"):
            if path.name != keep:
                with contextlib.suppress(OSError):  # only space is lost
                    self._system.unlink(path)

    def _clear_leftovers(self) -> None:
        folders = [self.path, self.path / "fits"]
        folders += [self.path / "cases" / name for name in self._case_ids()]
        for folder in folders:
            for path in folder.glob(".*"):
                if is_leftover(path):
                    with contextlib.suppress(OSError):  # ignored by every reader anyway
                        self._system.unlink(path)

    def _say(self, message: str) -> None:
        if message in self.warnings:
            return
        self.warnings.append(message)
        if self._warn is not None:
            self._warn(message)


def _pack(fields: Mapping[str, ArrayLike]) -> bytes:
    arrays = {name: np.asarray(value) for name, value in fields.items()}
    bad = [name for name, value in arrays.items() if value.dtype.hasobject]
    if bad:
        raise TypeError(f"field {bad[0]!r} holds Python objects, which are never stored")
    stream = io.BytesIO()
    np.savez_compressed(stream, allow_pickle=False, **arrays)
    return stream.getvalue()


def _unpack(data: bytes, path: Path) -> dict[str, Stored]:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(info.file_size for info in archive.infolist())
        if size > MAX_FIELD_BYTES:
            raise StoreError(f"{path}: unpacks to {size} bytes, which no field file does")
        with np.load(io.BytesIO(data), allow_pickle=False) as found:
            return {name: found[name] for name in found.files}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise StoreError(f"{path}: is no field file ({error})") from error
