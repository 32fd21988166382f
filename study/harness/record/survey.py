"""What a results folder holds of the cases that a study wants, and which libraries made it."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from study.harness.record.record import Record, canonical

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


#: name of the file of a case's record
CURRENT = "record.json"


class FileStamp(tuple[int, int, int]):
    """Size and times of a file as it lies on the disk; whoever alters it alters one of these."""

    @classmethod
    def of(cls, path: str | Path) -> FileStamp | None:
        """Stamp of a file; None if there is none."""
        try:
            status = os.stat(path)
        except (OSError, ValueError):
            return None
        return cls((status.st_size, status.st_mtime_ns, status.st_ctime_ns))


@dataclass(frozen=True)
class Entry:
    """What a record says of itself, so that it is read once to be counted."""

    status: str
    input_hash: str
    #: Name of the libraries that made it, by :func:`name_of`.
    libraries: str = ""
    #: Hash of its mesh; empty without one.
    mesh: str = ""

    @classmethod
    def of(cls, record: Record) -> Entry:
        """Entry of a record."""
        made_with, mesh = name_of(record.versions), record.mesh.get("hash", "")
        return cls(record.status, record.input_hash, made_with, mesh)


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

    @property
    def counts(self) -> dict[str, int]:
        """Cases: all, and those that are done, failed and missing."""
        counted = {name: len(getattr(self, name)) for name in ("done", "failed", "missing")}
        return {"total": sum(counted.values()), **counted}


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
