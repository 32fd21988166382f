"""Errors of a study file as faults: where, which rule, how to mend it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeVar

from pydantic import ValidationError

from study.errors import Fault, nearest
from study.setup.quantity import shown
from study.setup.section import Bad, Read, Reads, keys_of, read_section, written_keys
from study.setup.text import quoted

Kind = TypeVar("Kind")


class Faults(list[Fault]):
    """Faults found so far."""

    def add(self, where: str, rule: str, mend: str = "") -> None:
        """Note a fault."""
        fault = Fault(where, rule, mend)
        if fault not in self:
            self.append(fault)


def read_table(
    kind: type[Kind], table: Any, path: str, faults: Faults, also: Iterable[str] = ()
) -> Kind:
    """Read one table; every fault is noted, and a faulty value is None.

    Parameters
    ----------
    kind : type
        Section that declares the table.
    table : mapping
        The table as written.
    path : str
        Where it stands in the file.
    faults : Faults
        Where faults go.
    also : iterable of str
        Keys that may stand there and are read elsewhere.

    Returns
    -------
    section
        The values; None where a key is faulty or missing without a default.
    """
    broken = not isinstance(table, Mapping)
    written: Mapping[str, Any] = {} if broken else table
    if broken:
        faults.add(path, f"must be a table, got {shown(table)}", f"write [{path}]")
    left_to = set(also)
    own = {key: value for key, value in written.items() if key not in left_to}
    bad = _unwritten(kind, own, path, Faults() if broken else faults)
    bad |= _foreign(kind, own, path, faults, also)
    try:
        found = read_section(kind, {key: value for key, value in own.items() if key not in bad})
    except ValidationError as error:
        bad |= _invalid(kind, error, path, faults, bad)
    else:
        if not bad:
            return found
    return _partial(kind, own, bad)


def noted(read: Read, value: Any, where: str, faults: Faults) -> Any:
    """Read one value whose rule depends on other tables; None, and a fault, where it breaks it.

    Parameters
    ----------
    read : callable
        As of :class:`study.setup.section.Reads`.
    value
        Raw value.
    where : str
        Dotted key.
    faults : Faults
        Where a fault goes.
    """
    try:
        return Reads(read)(value)
    except Bad as bad:
        faults.add(where, bad.rule, bad.mend)
        return None


def one_of(names: Iterable[str]) -> Callable[[Any], str]:
    """Reader of the word that says which section a table is."""
    known = tuple(names)

    def read(value: Any) -> str:
        if not isinstance(value, str):
            raise Bad(f"must be a text, got {shown(value)}", nearest("", known))
        if value not in known:
            raise Bad(f"unknown value {shown(value)}", nearest(value[:80], known))
        return value

    return read


def _unwritten(kind: type, written: Mapping[str, Any], path: str, faults: Faults) -> set[str]:
    """Note the keys that must stand in a file and do not."""
    missing = [k for k in keys_of(kind) if k.must_be_written and k.written not in written]
    for key in missing:
        faults.add(_dotted(path, key.written), "is missing", key.mend)
    return {key.written for key in missing}


def _foreign(
    kind: type, written: Mapping[str, Any], path: str, faults: Faults, also: Iterable[str]
) -> set[str]:
    """Note the keys that nobody declares."""
    valid = written_keys(kind)
    foreign = [key for key in written if key not in valid]
    for key in foreign:
        faults.add(_dotted(path, quoted(key)), "unknown key", nearest(key, [*valid, *also]))
    return set(foreign)


def _invalid(
    kind: type, found: ValidationError, path: str, faults: Faults, noted: set[str]
) -> set[str]:
    """Note the errors of pydantic, but for the keys that are noted."""
    errors = [(tuple(map(str, one["loc"])), one) for one in found.errors(include_url=False)]
    for keys, error in errors:
        if keys[0] not in noted:
            _note(kind, error, keys, path, faults)
    return {keys[0] for keys, _ in errors}


def _dotted(path: str, key: str) -> str:
    return f"{path}.{key}" if path and key else path or key


def _note(
    kind: type, error: Mapping[str, Any], keys: Sequence[str], path: str, faults: Faults
) -> None:
    """Note one error of pydantic as a fault."""
    *parents, key = keys
    above, where = _dotted(path, ".".join(parents)), _dotted(path, ".".join(keys))
    if error["type"] == "missing":
        _unwritten(_inner(kind, parents), error["input"], above, faults)
    elif error["type"] == "unexpected_keyword_argument":
        valid = written_keys(_inner(kind, parents))
        faults.add(_dotted(above, quoted(key)), "unknown key", nearest(key, valid))
    elif error["type"] == "dataclass_type":
        faults.add(where, f"must be a table, got {shown(error['input'])}", f"write [{where}]")
    else:
        bad = error["ctx"]["error"]
        faults.add(where, bad.rule, bad.mend)


def _inner(kind: type, parents: Sequence[str]) -> type:
    """Find the declaration of a table within a table."""
    for parent in parents:
        kind = next(key.kind or kind for key in keys_of(kind) if key.written == parent)
    return kind


def _partial(kind: type[Kind], written: Mapping[str, Any], bad: set[str]) -> Kind:
    """Values of the keys that are right, the defaults of those left out, None for the others."""
    found = object.__new__(kind)
    for key in keys_of(kind):
        value = None if key.written in bad else key.default
        if key.written in written and key.written not in bad and key.reads is not None:
            value = key.reads(written[key.written])
        object.__setattr__(found, key.name, value)
    return found
