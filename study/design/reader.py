"""Read a table key by key where its keys depend on one another; no key is left unread."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from study.design.diagnostics import Faults
from study.errors import UnitError, nearest
from study.setup.quantity import shown
from study.setup.section import Bad, Read
from study.setup.text import quoted

REQUIRED: Any = object()


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
