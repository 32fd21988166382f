"""The error tree.

::

    StudyError                 anything a user can mend; carries the exit code of the command line
    |-- InputError             bad input (exit 2): one or many Faults, nothing was written
    |   |-- MissingDataError   a measurement file that is not there
    |   `-- UnitError          a value without its unit, or with one of the wrong dimension
    |-- MeshError            no usable mesh; a status of its case
    |-- RefusedError           the answer would be meaningless (exit 3)
    |-- StoreError             records that cannot be read, written or locked (exit 2)
    |   |-- NewerSchemaError   written by a newer version: neither damage nor ours to replace
    |   `-- WriteError         a file that cannot be written (exit 2)
    |       `-- StoppedError     after records were written (exit 1, a run 130)
    |           `-- DiskFullError  no space, no quota or no disk any more
    `-- SchedulerLostError     the cluster is gone in the middle of a run (exit 130, resumable)

Expected failure of a computation (a case that did not converge) is a status in a
record, never an exception that leaves ``runner``.
"""

from __future__ import annotations

import difflib
import errno
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol, TypeVar


class StudyError(Exception):
    """Base of every error that a user can mend."""

    exit_code = 2


@dataclass(frozen=True)
class Fault:
    """One thing wrong with an input."""

    #: File, key or line, for example ``"design.toml: model.mesh_size"``.
    where: str
    #: The rule and the offending value.
    rule: str
    #: How to mend it; may be empty.
    mend: str = ""

    def __str__(self) -> str:
        return f"{self.where}: {self.rule}" + (f"\n    {self.mend}" if self.mend else "")


class InputError(StudyError):
    """Bad input: all faults of a file at once."""

    def __init__(self, faults: Fault | str | Iterable[Fault]) -> None:
        if isinstance(faults, str):
            faults = Fault("input", faults)
        self.faults: tuple[Fault, ...] = (faults,) if isinstance(faults, Fault) else tuple(faults)
        super().__init__("\n".join(str(fault) for fault in self.faults))


@contextmanager
def names_in_bounds() -> Iterator[None]:
    """Context, or decorator, in which a name of a file that is too long is bad input.

    Every question about such a file raises, whether it is there or a folder.
    """
    try:
        yield
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        name = str(error.filename)
        rule = f"a name of {len(name)} characters is too long for this system"
        raise InputError(Fault(f"{name[:40]}...", rule, "shorten it")) from error


class MissingDataError(InputError):
    """A measurement file that is not there: a plan can do without, a run cannot."""


class UnitError(InputError):
    """A value without its unit, or with one of the wrong dimension."""


class MeshError(StudyError):
    """No usable mesh could be made; the forward solver turns it into a status."""


class RefusedError(StudyError):
    """The computation would give a meaningless answer; the message says what to do instead."""

    exit_code = 3


class Search(Protocol):
    """Result of a search of scipy.optimize: whether and how it ended, and its words."""

    success: bool
    status: int
    message: str


_Search = TypeVar("_Search", bound=Search)
#: status of L-BFGS-B where rounding leaves no lower value along a line: as good as converged
_AT_ROUNDING = 2


def settled(search: _Search, what: str, *, by_lines: bool = False) -> _Search:
    """Give back a search that converged, or ended at rounding where it is one ``by_lines``."""
    if not search.success and not (by_lines and search.status == _AT_ROUNDING):
        raise RefusedError(f"{what}: the search has not converged ({search.message})")
    return search


class StoreError(StudyError):
    """Records on disk that cannot be read, written or locked."""


class NewerSchemaError(StoreError):
    """What a newer version wrote: it is whole, and this one must not touch it."""


class WriteError(StoreError):
    """A file that could not be written, of a run that had written nothing before."""


class StoppedError(WriteError):
    """Writing that became impossible on the way; what was written before is whole."""

    exit_code = 1


class DiskFullError(StoppedError):
    """The disk took no more."""


class SchedulerLostError(StudyError):
    """The scheduler of a cluster was lost while tasks ran; what is finished is kept."""

    exit_code = 130


def nearest(name: str, valid: Iterable[str]) -> str:
    """Sentence naming the valid name nearest to ``name``.

    Examples
    --------
    >>> nearest("hieght", ["height", "radius"])
    "did you mean 'height'? Valid: height, radius"
    >>> nearest("RADIUS", ["height", "radius"])
    "did you mean 'radius'? Valid: height, radius"
    >>> nearest("zzz", ["height", "radius"])
    'Valid: height, radius'
    """
    names = list(valid)
    # a name in other letters, LIFE for life, shares no character with what was meant
    same = [other for other in names if other.casefold() == name.casefold()]
    close = same or difflib.get_close_matches(name, names, n=1)
    listed = "Valid: " + ", ".join(names)
    return f"did you mean {close[0]!r}? {listed}" if close else listed
