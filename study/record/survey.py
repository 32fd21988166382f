"""What a results folder holds of the cases that a study wants."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field

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
    made_with : mapping of str to str
        Name of the libraries that made each of ``done`` and ``failed``.
    """

    done: tuple[str, ...]
    failed: tuple[str, ...]
    missing: tuple[str, ...]
    foreign: tuple[str, ...]
    statuses: Mapping[str, str] = field(default_factory=dict)
    made_with: Mapping[str, str] = field(default_factory=dict)


class StoredRecords(Mapping[str, Record]):
    """Records by the name of their case, each read when it is first asked for.

    Parameters
    ----------
    cases : collection of str
        Cases that may have one.
    read : callable
        Gives the record of a case; None where there is none that counts.
    """

    def __init__(self, cases: Collection[str], read: Callable[[str], Record | None]) -> None:
        self._cases, self._reader = cases, read
        self._read: dict[str, Record | None] = {}

    def __getitem__(self, case_id: str) -> Record:
        """Record of a case; there is none where another input made it."""
        if case_id not in self._cases:
            raise KeyError(case_id)
        if case_id not in self._read:
            self._read[case_id] = self._reader(case_id)
        found = self._read[case_id]
        if found is None:
            raise KeyError(case_id)
        return found

    def __iter__(self) -> Iterator[str]:
        """Names of the cases that have one, in the order that they were asked for in."""
        return (case_id for case_id in self._cases if case_id in self)

    def __len__(self) -> int:
        """Count the cases that have one."""
        return sum(1 for _ in self)
