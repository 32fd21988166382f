"""What every record says of itself, so that nobody has to read them all to count them.

An entry holds for as long as its file is the one that was read: same size, same times. Whatever
differs is read again. The index decides nothing: without it, everything is read again.

Times have a grain, some milliseconds on most file systems: a file that changed twice within one
grain looks unchanged. An entry is therefore believed only where the index was written later than
its record (as git does, "Racy Git", Documentation/technical/racy-git.txt).
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from study.ground.bounded_file import read_regular
from study.ground.errors import StoreError
from study.harness.record.record import CONVERGED, Record, canonical, seal, unseal

# Versions of the libraries that made a result: no part of its key, compared when it is used
# again.

#: entries of a record's versions that are no library: the package's own code is part of every
#: key, and the interpreter computes no number by itself
_OTHERS = ("study", "python")
#: digits of a name
_DIGITS = 16


def libraries_of(versions: Mapping[str, str]) -> dict[str, str]:
    """Leave the versions of libraries alone."""
    return {name: version for name, version in versions.items() if name not in _OTHERS}


def name_of(versions: Mapping[str, str]) -> str:
    """Short name of a set of libraries; empty where none is known."""
    libraries = libraries_of(versions)
    return hashlib.sha256(canonical(libraries).encode()).hexdigest()[:_DIGITS] if libraries else ""


@dataclass(frozen=True)
class OtherLibraries:
    """Results that were made with other libraries than there are now."""

    cases: tuple[str, ...]
    #: Version then and now of each library that differs; ``"none"`` where it was not installed.
    changes: Mapping[str, tuple[str, str]]

    @property
    def sentence(self) -> str:
        """One line for a warning."""
        what = ", ".join(f"{name} {then}, now {now}" for name, (then, now) in self.changes.items())
        count = "1 result was" if len(self.cases) == 1 else f"{len(self.cases)} results were"
        return f"{count} made with other libraries: {what}"


def differences(then: Mapping[str, str], now: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """List the libraries that differ, each with both versions."""
    old, new = libraries_of(then), libraries_of(now)
    names = dict.fromkeys([*old, *new])
    pairs = {name: (old.get(name, "none"), new.get(name, "none")) for name in names}
    return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}


#: name of the stored file, of which a study's own files must not be
NAME = "index"
#: name of the file of a case's record
CURRENT = "record.json"
#: entries that are noted before the index is written, at least; then a share of those it has,
#: so that all writing together grows no faster than the number of records
FEWEST = 500
SHARE = 4


@dataclass(frozen=True)
class FileStamp:
    """A file as it lies on the disk; whoever alters it alters one of these."""

    size: int
    modified_ns: int
    changed_ns: int

    @classmethod
    def of(cls, path: str | Path) -> FileStamp | None:
        """Stamp of a file; None if there is none."""
        try:
            status = os.stat(path)
        except (OSError, ValueError):
            return None
        return cls(status.st_size, status.st_mtime_ns, status.st_ctime_ns)


NOWHERE = FileStamp(0, 0, 0)


@dataclass(frozen=True)
class Entry:
    """What a record said when it was read."""

    stamp: FileStamp
    status: str
    input_hash: str
    #: Name of the libraries that made it, by :func:`study.harness.record.index.name_of`.
    libraries: str = ""
    #: Hash of its mesh; empty without one.
    mesh: str = ""

    @property
    def converged(self) -> bool:
        """Whether the case has an answer."""
        return self.status == CONVERGED

    @property
    def row(self) -> list[object]:
        """Plain data for the file."""
        stamp = self.stamp
        times = stamp.size, stamp.modified_ns, stamp.changed_ns
        return [*times, self.status, self.input_hash, self.libraries, self.mesh]

    @classmethod
    def of(cls, record: Record, stamp: FileStamp = NOWHERE) -> Entry:
        """Entry of a record, from the file of that stamp."""
        made_with, mesh = name_of(record.versions), record.mesh.get("hash", "")
        return cls(stamp, record.status, record.input_hash, made_with, mesh)


class RecordIndex:
    """Entries of the records of a results folder."""

    def __init__(self, folder: Path) -> None:
        self._cases = os.path.join(folder, "cases", "")
        self._path = folder / f"{NAME}.json"
        self._written_ns = 0
        self._known: dict[str, Entry] = {}
        self._fresh: dict[str, Entry] = {}
        self._altered = False
        self._load()

    def entry(self, case_id: str) -> Entry | None:
        """Entry of a record that was not touched since; None where it has to be read."""
        entry = self._known.get(case_id)
        if entry is None or entry.stamp.changed_ns >= self._written_ns:
            return None
        stamp = FileStamp.of(f"{self._cases}{case_id}{os.sep}{CURRENT}")
        return entry if stamp == entry.stamp else None

    def note(self, record: Record, stamp: FileStamp | None) -> None:
        """Keep what a record says that was read or written whole, from the file of that stamp."""
        if stamp is None:
            return
        entry = Entry.of(record, stamp)
        if self._known.get(record.case_id) != entry or stamp.changed_ns >= self._written_ns:
            self._fresh[record.case_id] = entry

    def forget(self, case_id: str) -> None:
        """Drop the entry of a record that is damaged or gone."""
        lost = self._known.pop(case_id, None), self._fresh.pop(case_id, None)
        self._altered |= any(lost)

    @property
    def is_due(self) -> bool:
        """Whether so much was noted that it should be written now."""
        return len(self._fresh) >= max(FEWEST, len(self._known) // SHARE)

    @property
    def is_stale(self) -> bool:
        """Whether the file says something else than is known."""
        new = any(self._known.get(name) != entry for name, entry in self._fresh.items())
        # an entry as young as the file is not believed
        racy = any(entry.stamp.changed_ns >= self._written_ns for entry in self._known.values())
        return self._altered or new or racy

    def text(self) -> str:
        """Everything that is known, sealed."""
        whole = {**self._known, **self._fresh}
        return seal({name: entry.row for name, entry in whole.items()})

    def written(self) -> None:
        """Take over what was noted, once :meth:`text` lies on the disk."""
        self._known |= self._fresh
        self._fresh, self._altered = {}, False
        stamp = FileStamp.of(self._path)
        self._written_ns = 0 if stamp is None else stamp.modified_ns

    def _load(self) -> None:
        """Read the file; one that is missing, damaged or foreign is as none."""
        stamp = FileStamp.of(self._path)  # taken first: an older index is believed less
        try:
            data = read_regular(self._path)
            content = {} if data is None else unseal(data, str(self._path))
        except StoreError:
            return
        if stamp is None or not isinstance(content, dict):
            return
        try:
            self._known = {str(name): _entry(row) for name, row in content.items()}
        except (TypeError, ValueError):
            return
        self._written_ns = stamp.modified_ns


def _entry(row: object) -> Entry:
    """Read an entry back."""
    if not isinstance(row, list):
        raise TypeError("an entry is a list")
    size, modified, changed, *words = row
    if not all(isinstance(n, int) for n in (size, modified, changed)):
        raise TypeError("a stamp has whole numbers")
    status, input_hash, libraries, mesh = map(str, words)
    return Entry(FileStamp(size, modified, changed), status, input_hash, libraries, mesh)


# What a results folder holds of the cases that a study wants.


@dataclass(frozen=True)
class Survey:
    """What a results folder holds of the cases that a study wants."""

    #: Case ids whose record is valid and converged.
    done: tuple[str, ...]
    #: Case ids whose record is valid and says why there is no answer.
    failed: tuple[str, ...]
    #: Case ids without a usable record.
    missing: tuple[str, ...]
    #: Those of ``missing`` that have a record of another configuration, data or version.
    foreign: tuple[str, ...]
    statuses: Mapping[str, str] = field(default_factory=dict)
    #: Name of the libraries that made each of ``done`` and ``failed``.
    made_with: Mapping[str, str] = field(default_factory=dict)


class StoredRecords(Mapping[str, Record]):
    """Records by the name of their case, each read when it is first asked for."""

    def __init__(self, cases: Collection[str], read: Callable[[str], Record | None]) -> None:
        self._cases, self._reader = cases, read
        self._read: dict[str, Record | None] = {}

    def __getitem__(self, case_id: str) -> Record:
        """Record of a case; there is none where another input made it."""
        if case_id not in self._cases:
            raise KeyError(case_id)
        if case_id not in self._read:
            self._read[case_id] = self._reader(case_id)
        record = self._read[case_id]
        if record is None:
            raise KeyError(case_id)
        return record

    def __iter__(self) -> Iterator[str]:
        """Names of the cases that have one, in the order that they were asked for in."""
        return (case_id for case_id in self._cases if case_id in self)

    def __len__(self) -> int:
        """Count the cases that have one."""
        return sum(1 for _ in self)
