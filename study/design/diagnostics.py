"""Errors of a study file as faults: where, which rule, how to mend it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from typing import TypeVar

from pydantic import ValidationError

from study.errors import Fault, UnitError, nearest
from study.setup.quantity import shown
from study.setup.section import Bad, Key, keys_of, read_section, written_keys
from study.setup.text import quoted

Kind = TypeVar("Kind")
Value = TypeVar("Value")

#: a table as it is written
Table = Mapping[str, object]


class Faults(list[Fault]):
    """Faults found so far."""

    def add(self, where: str, rule: str, mend: str = "") -> None:
        """Note a fault."""
        fault = Fault(where, rule, mend)
        if fault not in self:
            self.append(fault)


def read_table(
    kind: type[Kind], table: object, path: str, faults: Faults, also: Collection[str] = ()
) -> Kind:
    """Read one table and the tables in it; every fault is noted, and a faulty value is None.

    A section with None where it must not be lives as long as the file is checked: whoever
    loads one raises the faults.

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
    also : collection of str
        Keys that may stand there and are read elsewhere.

    Returns
    -------
    section
        The values; None where a key is faulty or missing without a default.
    """
    if not isinstance(table, Mapping):
        faults.add(path, f"must be a table, got {shown(table)}", f"write [{path}]")
        return _partial(kind, {}, {key.written for key in keys_of(kind) if key.must_be_written})
    own = {key: value for key, value in table.items() if key not in also}
    bad = _unwritten(kind, own, path, faults) | _foreign(kind, own, path, faults, also)
    for key in keys_of(kind):
        if key.kind is not None and key.written in own:
            own[key.written] = _within(key, key.kind, own[key.written], path, faults)
    try:
        found = read_section(kind, {key: value for key, value in own.items() if key not in bad})
    except ValidationError as error:
        bad |= _invalid(error, path, faults, bad)
    else:
        if not bad:
            return found
    return _partial(kind, own, bad)


def _within(key: Key, kind: type, value: object, path: str, faults: Faults) -> object:
    """Read a table within a table, or a list of tables."""
    where, rows = _dotted(path, key.written), key.rows
    if rows is None:
        return read_table(kind, value, where, faults)
    if not isinstance(value, list) or not rows.least <= len(value) <= rows.most:
        rule = rows.rule or f"must be tables, got {shown(value)}"
        faults.add(where, rule, rows.mend or f"write [[{where}]]")
        return ()
    return tuple(read_table(kind, one, f"{where}[{i}]", faults) for i, one in enumerate(value))


def read_variant(
    kinds: Mapping[str, type[Kind]], ruling: str, table: object, path: str, faults: Faults
) -> Kind:
    """Read a table one of whose words says which section it is.

    Parameters
    ----------
    kinds : mapping of str to type
        Every section by its word.
    ruling : str
        Key of that word.
    table : mapping
        The table as written.
    path : str
        Where it stands in the file.
    faults : Faults
        Where faults go.

    Returns
    -------
    section
        The first of the kinds, without any value, where the word is faulty.
    """
    if not isinstance(table, Mapping):
        faults.add(path, f"must be a table, got {shown(table)}", f"write [{path}]")
    elif ruling not in table:
        faults.add(_dotted(path, ruling), "is missing", f"one of {', '.join(kinds)}")
    else:
        word = noted(one_of(kinds), table[ruling], _dotted(path, ruling), faults)
        if word is not None:
            return read_table(kinds[word], table, path, faults)
    first = next(iter(kinds.values()))
    return _partial(first, {}, {key.written for key in keys_of(first) if key.reads is not None})


def entries(value: object, path: str, faults: Faults) -> Table:
    """Entries of a table whose keys are the user's own names; none where it is no table.

    Parameters
    ----------
    value : mapping or None
        The table as written; None where it is left out.
    path : str
        Where it stands in the file.
    faults : Faults
        Where a fault goes.
    """
    if value is None or isinstance(value, Mapping):
        return value or {}
    faults.add(path, f"must be a table, got {shown(value)}", f"write [{path}]")
    return {}


def noted(
    read: Callable[[object], Value], value: object, where: str, faults: Faults
) -> Value | None:
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
        return read(value)
    except Bad as bad:
        faults.add(where, bad.rule, bad.mend)
    except UnitError as error:
        faults.add(where, error.faults[0].rule, error.faults[0].mend)
    return None


def one_of(names: Iterable[str]) -> Callable[[object], str]:
    """Reader of the word that says which section a table is.

    Parameters
    ----------
    names : iterable of str
        Words that are allowed.

    Returns
    -------
    callable
        Raw value to the word; raises :class:`Bad` for anything else.
    """
    known = tuple(names)

    def read(value: object) -> str:
        if not isinstance(value, str):
            raise Bad(f"must be a text, got {shown(value)}", nearest("", known))
        if value not in known:
            raise Bad(f"unknown value {shown(value)}", nearest(value[:80], known))
        return value

    return read


def is_known(*values: object) -> bool:
    """Whether all values of sections that may be faulty could be read.

    Parameters
    ----------
    *values
        As :func:`read_table` leaves them: None for a faulty one.
    """
    return not any(value is None for value in values)


def with_values(section: Kind, **values: object) -> Kind:
    """Copy of a section that may be faulty with other values, which nobody checks again.

    Parameters
    ----------
    section
        Instance of a class made by :func:`study.setup.section.section`.
    **values
        New values in internal units, by the names of the fields; an unknown name is ignored.
    """
    kind = type(section)
    made = object.__new__(kind)
    for key in keys_of(kind):
        object.__setattr__(made, key.name, values.get(key.name, getattr(section, key.name)))
    return made


def _unwritten(kind: type, written: Table, path: str, faults: Faults) -> set[str]:
    """Note the keys that must stand in a file and do not."""
    missing = [k for k in keys_of(kind) if k.must_be_written and k.written not in written]
    for key in missing:
        faults.add(_dotted(path, key.written), "is missing", key.mend)
    return {key.written for key in missing}


def _foreign(
    kind: type, written: Table, path: str, faults: Faults, also: Collection[str]
) -> set[str]:
    """Note the keys that nobody declares."""
    valid = written_keys(kind)
    foreign = [key for key in written if key not in valid]
    for key in foreign:
        faults.add(_dotted(path, quoted(key)), "unknown key", nearest(key, [*valid, *also]))
    return set(foreign)


def _invalid(found: ValidationError, path: str, faults: Faults, noted: set[str]) -> set[str]:
    """Note the errors of pydantic, each of one key, but for the keys that are noted."""
    errors = {str(one["loc"][0]): one for one in found.errors(include_url=False)}
    for key, error in errors.items():
        if key not in noted:
            broken = error["ctx"]["error"]
            faults.add(_dotted(path, key), broken.rule, broken.mend)
    return set(errors)


def _dotted(path: str, key: str) -> str:
    return f"{path}.{key}" if path and key else path or key


def _partial(kind: type[Kind], written: Table, bad: set[str]) -> Kind:
    """Values of the keys that are right, the defaults of those left out, None for the others."""
    found = object.__new__(kind)
    for key in keys_of(kind):
        value = None if key.written in bad else key.default
        if key.written in written and key.written not in bad:
            raw = written[key.written]
            value = raw if key.reads is None else key.reads(raw)
        object.__setattr__(found, key.name, value)
    return found


def quoted_path(key: str) -> str:
    """Dotted key whose odd parts are quoted.

    Parameters
    ----------
    key : str
        As written, of any length; what is shown ends at 500 characters.
    """
    return ".".join(quoted(part) for part in key[:500].split("."))


def is_about(fault: Fault, table: str) -> bool:
    """Whether a fault is one of a table, or of a key in it.

    Parameters
    ----------
    fault, table : Fault, str
        The table by its dotted name.
    """
    return fault.where == table or fault.where.startswith(f"{table}.")


def all_about(faults: Faults, table: str) -> bool:
    """Whether nothing but one table has faults, so that all others can be relied on.

    Parameters
    ----------
    faults, table : Faults, str
        What was found so far; the table by its dotted name.
    """
    return all(is_about(fault, table) for fault in faults)
