"""Read a table key by key: every fault is collected, no key is left unread.

A reader takes the raw TOML value and returns it in internal units, or raises
:class:`Bad` with the rule it breaks and how to mend it.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Callable, Iterable, Mapping
from pathlib import PurePosixPath, PureWindowsPath
from typing import Any

from study import units
from study.errors import Fault, UnitError, nearest

Read = Callable[[Any], Any]
REQUIRED: Any = object()
MAX_NAME = 80
MAX_TEXT = 4000


class Bad(ValueError):
    """A value that breaks a rule."""

    def __init__(self, rule: str, mend: str = "") -> None:
        super().__init__(rule)
        self.rule, self.mend = rule, mend


class Faults(list[Fault]):
    """Faults found so far."""

    def add(self, where: str, rule: str, mend: str = "") -> None:
        """Note a fault."""
        fault = Fault(where, rule, mend)
        if fault not in self:
            self.append(fault)


class Section:
    """One table being read; :meth:`finish` reports the keys that nobody took."""

    def __init__(self, table: Any, path: str, faults: Faults) -> None:
        self.path, self.faults = path, faults
        self.broken = not isinstance(table, Mapping)
        if self.broken:
            faults.add(path, f"must be a table, got {shown(table)}", f"write [{path}]")
        self.table: Mapping[str, Any] = {} if self.broken else table
        self.known: list[str] = []

    def __contains__(self, key: str) -> bool:
        return key in self.table

    def where(self, key: str) -> str:
        """Dotted key."""
        return f"{self.path}.{key}" if self.path else key

    def take(self, key: str, read: Read, default: Any = REQUIRED, mend: str = "") -> Any:
        """Value of a key, read; None where it is faulty."""
        self.known.append(key)
        if key not in self.table:
            if default is REQUIRED and not self.broken:
                self.faults.add(self.where(key), "is missing", mend)
            return None if default is REQUIRED else default
        try:
            return read(self.table[key])
        except Bad as bad:
            self.faults.add(self.where(key), bad.rule, bad.mend)
        except UnitError as error:
            fault = error.faults[0]
            self.faults.add(self.where(key), fault.rule, fault.mend)
        return None

    def fault(self, key: str, rule: str, mend: str = "") -> None:
        """Note a fault of a key."""
        self.faults.add(self.where(key), rule, mend)

    def finish(self, also: Iterable[str] = ()) -> None:
        """Report the keys that were not taken."""
        valid = list(dict.fromkeys([*self.known, *also]))
        for key in self.table:
            if key not in valid:
                self.faults.add(self.where(quoted(key)), "unknown key", nearest(key, valid))


def shown(value: Any) -> str:
    """Value as a message shows it, cut short."""
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def quoted(key: str) -> str:
    """Key, quoted and cut where it is not a plain word."""
    plain = key.isascii() and len(key) <= MAX_NAME and key.replace("-", "_").isidentifier()
    return key if plain else ascii(key[:MAX_NAME])


def quantity(
    dimension: str, low: float = 0.0, high: float = math.inf, *, closed: bool = False
) -> Read:
    """Reader of a value with its unit, between ``low`` (excluded unless closed) and ``high``."""

    def read(value: Any) -> float:
        number = units.parse(value, dimension)
        unit = units.INTERNAL[dimension]
        if number < low or (number == low and not closed):
            bound = "at least" if closed else "above"
            raise Bad(f"must be {bound} {low:g} {unit}, got {value!r}")
        if number >= high:
            raise Bad(f"must be below {high:g} {unit}, got {value!r}")
        return number

    return read


def number(
    low: float = -math.inf, high: float = math.inf, *, closed: bool = False, mend: str = ""
) -> Read:
    """Reader of a finite plain number between ``low`` and ``high``."""

    def read(value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            hint = "it has no unit and no quotes" if isinstance(value, str) else ""
            raise Bad(f"must be a plain number, got {shown(value)}", mend or hint)
        if abs(value) > 1e300 or not math.isfinite(value):
            raise Bad(f"must be a finite number, got {shown(value)}")
        inside = low <= value <= high if closed else low < value < high
        if not inside:
            ends = "from {:g} to {:g}" if closed else "between {:g} and {:g} (excluded)"
            raise Bad(f"must be {ends.format(low, high)}, got {value!r}", mend)
        return float(value)

    return read


def integer(low: int, high: int) -> Read:
    """Reader of a whole number from ``low`` to ``high``."""

    def read(value: Any) -> int:
        whole = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not whole or not math.isfinite(value) or value != int(value):
            raise Bad(f"must be a whole number, got {shown(value)}")
        if not low <= value <= high:
            raise Bad(f"must be a whole number from {low} to {high}, got {shown(value)}")
        return int(value)

    return read


def choice(*names: str, synonyms: Mapping[str, str] | None = None) -> Read:
    """Reader of one of several words; a synonym becomes the word it stands for."""
    words = {name: name for name in names} | dict(synonyms or {})

    def read(value: Any) -> str:
        if not isinstance(value, str):
            raise Bad(f"must be a text, got {shown(value)}", nearest("", words))
        if value not in words:
            raise Bad(f"unknown value {shown(value)}", nearest(value[:MAX_NAME], words))
        return words[value]

    return read


def flag(value: Any) -> bool:
    """Read true or false."""
    if not isinstance(value, bool):
        raise Bad(f"must be true or false, got {shown(value)}")
    return value


def text(value: Any) -> str:
    """Read a text without control characters."""
    if not isinstance(value, str):
        raise Bad(f"must be a text, got {shown(value)}", "put it in quotes")
    if len(value) > MAX_TEXT:
        raise Bad(f"has {len(value)} characters, the limit is {MAX_TEXT}")
    if any(unicodedata.category(c) in INVISIBLE and c not in "\n\t" for c in value):
        raise Bad("holds control characters")
    return value.strip()


INVISIBLE = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}


def name(value: Any) -> str:
    """Read a name that may stand in a table, a page or a CSV file.

    A leading ``=``, ``+``, ``-`` or ``@`` is a formula for a spreadsheet (CWE-1236), and no
    quoting survives its next save.
    """
    if not isinstance(value, str):
        raise Bad(f"must be a text, got {shown(value)}", "put it in quotes")
    stripped = value.strip()
    if not stripped:
        raise Bad("is empty")
    if len(stripped) > MAX_NAME:
        raise Bad(f"has {len(stripped)} characters, the limit is {MAX_NAME}")
    if any(unicodedata.category(c) in INVISIBLE for c in value):
        raise Bad(f"holds characters that cannot be seen: {ascii(value)}")
    if stripped[0] in "=+-@":
        rule = f"must not begin with {stripped[0]!r}, which a spreadsheet takes for a formula"
        raise Bad(f"{rule}, got {shown(value)}")
    return stripped


def slug(value: Any) -> str:
    """Read a name that is also a folder's: letters, digits, dash, underscore, dot."""
    plain = name(value)
    if not re.fullmatch(r"[A-Za-z0-9._-]*[A-Za-z0-9_-]", plain):
        raise Bad(f"may have letters, digits, - _ and . (not last) only, got {shown(value)}")
    if plain[0] == ".":
        raise Bad(f"must not begin with a dot, got {shown(value)}")
    return plain


def names(value: Any) -> tuple[str, ...]:
    """Read a list of names; one name may stand alone."""
    items = value if isinstance(value, list) else [value]
    if len(items) > 100:
        raise Bad(f"lists {len(items)} names, the limit is 100")
    return tuple(dict.fromkeys(name(item) for item in items))


def unit_of_length(value: Any) -> str:
    """Read the name of a unit of length."""
    if not isinstance(value, str):
        raise Bad(f"must be a text, got {shown(value)}", 'for example unit = "mm"')
    try:
        units.parse(f"1 {value}", "length")
    except UnitError:
        raise Bad(f"is no unit of length: {shown(value)}", 'for example unit = "mm"') from None
    return value.strip()


def relative_path(value: Any) -> str:
    """Read a path below the data root."""
    if not isinstance(value, str) or not value.strip():
        raise Bad(f"must be a path, got {shown(value)}")
    mend = "write it relative to the data root (--data DIR)"
    if any(unicodedata.category(c) in INVISIBLE for c in value) or len(value) > 500:
        raise Bad("is too long or holds characters that cannot be seen", mend)
    if value.startswith(("/", "\\", "~")) or PureWindowsPath(value).drive:
        raise Bad(f"must be relative, got {shown(value)}", mend)
    if ".." in PurePosixPath(value.replace("\\", "/")).parts:
        raise Bad(f"must not climb with '..', got {shown(value)}", mend)
    return value
