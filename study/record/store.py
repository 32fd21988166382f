"""The results folder of one study: crash-safe, one runner at a time, nothing damaged is used.

::

    results/<study>/
        study.json                  manifest
        index.json                  what each record says of itself, so that counting reads none
        fits/<fit_id>.json          calibrations shared by cases
        cases/<case_id>/record.json
        cases/<case_id>/fields-<hash>.npz
        cases/<case_id>/*.corrupt-1 what was damaged, set aside
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import cast

from numpy.typing import ArrayLike

from study.errors import NewerSchemaError, StoreError
from study.record import fields as field_files
from study.record.atomic_files import write_atomic
from study.record.document import ManifestDocument
from study.record.fields import MAX_FIELD_BYTES, Stored
from study.record.folder import ID, SealedFolder
from study.record.index import NAME as INDEX
from study.record.index import FileStamp, RecordIndex
from study.record.record import Record


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
    statuses : mapping of str to str
        Status of each of ``failed``.
    """

    done: tuple[str, ...]
    failed: tuple[str, ...]
    missing: tuple[str, ...]
    foreign: tuple[str, ...]
    statuses: Mapping[str, str] = field(default_factory=dict)


class Store(SealedFolder):
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
            name, data = field_files.pack(fields)
            record = replace(record, extra={**record.extra, "fields": name})
            write_atomic(folder / name, data, self._system)
        path = folder / "record.json"
        write_atomic(path, record.to_json().encode(), self._system)
        self._drop_other_fields(folder, name)
        if self._locked:
            self._index.note(record, FileStamp.of(path))
            if self._index.is_due:
                self._write_index()
        return record

    def read(self, case_id: str) -> Record | None:
        """Record of a case; None if there is none or it is damaged (set aside, and warned)."""
        path = self._case(case_id) / "record.json"
        stamp = FileStamp.of(path)  # taken first: a file that changes meanwhile is read again
        data = self._bytes(path)
        if data is None:
            return None
        try:
            record = Record.from_json(data, str(path))
            if record.case_id != case_id:
                raise StoreError(f"{path}: belongs to case {record.case_id!r}")
        except NewerSchemaError:
            raise
        except StoreError as error:
            self._set_aside(path, str(error))
            self._distrust(case_id)
            return None
        if self._locked:
            self._index.note(record, stamp)
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
        if not isinstance(name, str) or not field_files.is_name(name):
            raise StoreError(f"case {record.case_id}: {name!r} is no name of a field file")
        path = self._case(record.case_id) / name
        data = self._bytes(path, MAX_FIELD_BYTES)
        if data is None or not field_files.fits(name, data):
            raise StoreError(f"{path}: is missing or damaged; delete the case to run it again")
        return field_files.unpack(data, path)

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
        statuses: dict[str, str] = {}
        missing: list[str] = []
        foreign: list[str] = []
        for case_id, wanted in input_hashes.items():
            said = self._index.entry(case_id) or self.read(case_id)
            if said is None or said.input_hash != wanted:
                missing.append(case_id)
                if said is not None:
                    foreign.append(case_id)
            elif said.converged:
                done.append(case_id)
            else:
                statuses[case_id] = said.status
        if foreign:
            self._say(
                f"{self.path}: {len(foreign)} records come from another version of the program, "
                "its settings or the data; they are not used and will be computed again"
            )
        return Survey(tuple(done), tuple(statuses), tuple(missing), tuple(foreign), statuses)

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
        again = {case_id for case_id, status in found.statuses.items() if status in retry}
        return frozenset(found.done + found.failed) - again

    def records(self, input_hashes: Mapping[str, str]) -> list[Record]:
        """Read the records of this very input, in the order of ``input_hashes``."""
        found = (self.read(case_id) for case_id in input_hashes)
        return [r for r in found if r is not None and r.input_hash == input_hashes[r.case_id]]

    def by_case(self, input_hashes: Mapping[str, str]) -> Mapping[str, Record]:
        """Map cases to their records of this very input, each read when it is asked for."""
        return StoredRecords(self, input_hashes)

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

    @cached_property
    def _index(self) -> RecordIndex:
        return RecordIndex(self.path)

    def _begin(self) -> None:
        self.__dict__.pop("_index", None)  # another runner may have written since
        names = [os.path.join(self.path, "cases", name) for name in self._case_ids()]
        self._clear_leftovers([str(self.path), str(self.path / "fits"), *names])

    def _end(self) -> None:
        self._write_index()

    def _write_index(self) -> None:
        """Write the index where it would say something new."""
        index = self._index
        if index.is_stale:
            write_atomic(self._json(INDEX), index.text().encode(), self._system)
            index.written()

    def _distrust(self, case_id: str) -> None:
        """Forget a damaged record; an index that vouched for it is worth nothing."""
        vouched = self._index.entry(case_id) is not None
        self._index.forget(case_id)
        if vouched:
            with contextlib.suppress(OSError):  # who may not delete it may not run here either
                self._system.unlink(self._json(INDEX))

    def _case(self, case_id: str) -> Path:
        if not ID.fullmatch(case_id):
            raise StoreError(f"{case_id!r} is no case id (small letters, digits and hyphens)")
        return self._inside(self.path / "cases" / case_id)

    def _case_ids(self) -> list[str]:
        folder = self.path / "cases"
        try:
            return sorted(entry.name for entry in folder.iterdir() if ID.fullmatch(entry.name))
        except FileNotFoundError:
            return []
        except OSError as error:
            raise StoreError(f"{folder}: cannot be read ({error.strerror or error})") from error

    def _drop_other_fields(self, folder: Path, keep: str) -> None:
        for name in os.listdir(folder):
            if field_files.is_name(name) and name != keep:
                with contextlib.suppress(OSError):  # only space is lost
                    self._system.unlink(folder / name)


class StoredRecords(Mapping[str, Record]):
    """Records of a store by the name of their case, each read when it is first asked for.

    Parameters
    ----------
    store : Store
        Where they are.
    input_hashes : mapping of str to str
        Wanted cases and the input hash that their records must have.
    """

    def __init__(self, store: Store, input_hashes: Mapping[str, str]) -> None:
        self._store, self._wanted = store, input_hashes
        self._read: dict[str, Record | None] = {}

    def __getitem__(self, case_id: str) -> Record:
        """Record of a case; there is none where another input made it."""
        if case_id not in self._read:
            wanted = {case_id: self._wanted[case_id]}
            self._read[case_id] = next(iter(self._store.records(wanted)), None)
        found = self._read[case_id]
        if found is None:
            raise KeyError(case_id)
        return found

    def __iter__(self) -> Iterator[str]:
        """Names of the cases that have one, in the order that they were asked for in."""
        return (case_id for case_id in self._wanted if case_id in self)

    def __len__(self) -> int:
        """Count the cases that have one."""
        return sum(1 for _ in self)
