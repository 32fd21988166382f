"""Which libraries made a result, and whether those of today are others.

Their versions are no part of a result's key, for an update would then send every finished study
back to work; they are kept with it and compared when it is used again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

from study.record.record import canonical

#: entries of a record's versions that are no library: the package's own code is part of every
#: key, and the interpreter computes no number by itself
_OTHERS = ("study", "python")

#: digits of a name
_DIGITS = 16


def libraries_of(versions: Mapping[str, str]) -> dict[str, str]:
    """Leave the versions of libraries alone.

    Parameters
    ----------
    versions : mapping of str to str
        Of this program, of Python and of libraries, by name.

    Examples
    --------
    >>> libraries_of({"study": "1+ab", "python": "3.11.7", "numpy": "2.2.1"})
    {'numpy': '2.2.1'}
    """
    return {name: version for name, version in versions.items() if name not in _OTHERS}


def name_of(versions: Mapping[str, str]) -> str:
    """Short name of a set of libraries; empty where none is known.

    Parameters
    ----------
    versions : mapping of str to str
        As :func:`libraries_of` takes them.
    """
    found = libraries_of(versions)
    return hashlib.sha256(canonical(found).encode()).hexdigest()[:_DIGITS] if found else ""


@dataclass(frozen=True)
class OtherLibraries:
    """Results that were made with other libraries than there are now.

    Parameters
    ----------
    cases : tuple of str
        Whose records they are.
    changes : mapping of str to tuple of (str, str)
        Version then and now of each library that differs; ``"none"`` where it was not installed.
    """

    cases: tuple[str, ...]
    changes: Mapping[str, tuple[str, str]]

    @property
    def sentence(self) -> str:
        """One line for a warning."""
        what = ", ".join(f"{name} {then}, now {now}" for name, (then, now) in self.changes.items())
        count = "1 result was" if len(self.cases) == 1 else f"{len(self.cases)} results were"
        return f"{count} made with other libraries: {what}"


def differences(then: Mapping[str, str], now: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """List the libraries that differ, each with both versions.

    Parameters
    ----------
    then, now : mapping of str to str
        As :func:`libraries_of` takes them.

    Returns
    -------
    dict of str to (str, str)
        Version then and now; ``"none"`` where it was not installed.

    Examples
    --------
    >>> differences({"numpy": "1.26.4", "gmsh": "4.13"}, {"numpy": "2.2.1", "gmsh": "4.13"})
    {'numpy': ('1.26.4', '2.2.1')}
    """
    old, new = libraries_of(then), libraries_of(now)
    names = dict.fromkeys([*old, *new])
    pairs = {name: (old.get(name, "none"), new.get(name, "none")) for name in names}
    return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}
