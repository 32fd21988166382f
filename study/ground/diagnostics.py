"""Errors of a study file as faults: where, which rule, how to mend it."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TypeGuard, TypeVar

from study.ground.declaration import (
    Bad,
    Key,
    choice,
    keys_of,
    quoted,
    shown,
    values_of,
    written_keys,
)
from study.ground.errors import Fault, InputError, MissingDataError, UnitError, nearest
from study.ground.files import NotRegularError, UnreadableError, read_regular

Kind = TypeVar("Kind")
Raw = TypeVar("Raw")
Value = TypeVar("Value")
#: a table as it is written
Table = Mapping[str, object]


class Faults(list[Fault]):
    """Faults found so far."""

    #: How often one was noted: a table that is read again is as faulty as the first time.
    mentions: int = 0

    def add(self, where: str, rule: str, mend: str = "") -> None:
        """Note a fault, once however often it is found."""
        fault = Fault(where, rule, mend)
        self.mentions += 1
        if fault not in self:
            self.append(fault)

    @contextmanager
    def gathered(self) -> Iterator[None]:
        """Context that notes the faults of a part, and lets the next one be looked at."""
        try:
            yield
        except MissingDataError:  # told at once
            raise
        except InputError as error:
            for fault in error.faults:
                self.add(fault.where, fault.rule, fault.mend)

    def refuse(self, source: str = "") -> None:
        """Raise the faults together, each with the name of its file, where there are any."""
        before = f"{source}: " if source else ""
        if self:
            raise InputError([Fault(f"{before}{f.where}", f.rule, f.mend) for f in self])


def read_table(
    kind: type[Kind], table: object, path: str, faults: Faults, also: Collection[str] = ()
) -> Kind:
    """Read one table and the tables in it; every fault is noted, and a faulty value is None."""
    # A section with None where it must not be lives as long as the file is checked: whoever loads
    # one raises the faults.
    written: Table = {}
    if isinstance(table, Mapping):
        written = {key: value for key, value in table.items() if key not in also}
    else:
        faults.add(path, f"must be a table, got {shown(table)}", f"write [{path}]")
    valid = written_keys(kind)
    for key in (key for key in written if key not in valid):
        faults.add(_dotted(path, quoted(key)), "unknown key", nearest(key, [*valid, *also]))
    values: dict[str, object] = {}
    for declared in keys_of(kind):
        where, key = _dotted(path, declared.written), declared.written
        values[declared.name] = declared.default
        if key in valid and key in written:
            values[declared.name] = _read_key(declared, written[key], where, faults)
        elif declared.must_be_written:
            values[declared.name] = None
            if isinstance(table, Mapping):
                faults.add(where, "is missing", declared.mend)
    return unchecked(kind, values)


def _read_key(key: Key, value: object, where: str, faults: Faults) -> object:
    """Read the value of a key, a table within a table, or a list of tables."""
    if key.kind is None:
        return value if key.reads is None else noted(key.reads, value, where, faults)
    rows, kind = key.rows, key.kind
    if rows is None:
        return read_table(kind, value, where, faults)
    if not isinstance(value, list) or not rows.least <= len(value) <= rows.most:
        rule = rows.rule or f"must be tables, got {shown(value)}"
        faults.add(where, rule, rows.mend or f"write [[{where}]]")
        return ()
    return tuple(read_table(kind, row, f"{where}[{i}]", faults) for i, row in enumerate(value))


def unchecked(kind: type[Kind], values: Mapping[str, object]) -> Kind:
    """Section of values that nobody checks again, None where one is faulty."""
    section = object.__new__(kind)
    for name, value in values.items():
        object.__setattr__(section, name, value)
    return section


def read_variant(
    kinds: Mapping[str, type[Kind]], ruling: str, table: object, path: str, faults: Faults
) -> Kind:
    """Read a table one of whose words says which section it is."""
    if not isinstance(table, Mapping):
        faults.add(path, f"must be a table, got {shown(table)}", f"write [{path}]")
    elif ruling not in table:
        faults.add(_dotted(path, ruling), "is missing", f"one of {', '.join(kinds)}")
    else:
        word = noted(choice(*kinds), table[ruling], _dotted(path, ruling), faults)
        if word is not None:
            return read_table(kinds[word], table, path, faults)
    first = next(iter(kinds.values()))
    read = {key.name: key.default if key.reads is None else None for key in keys_of(first)}
    return unchecked(first, read)


def entries(value: object, path: str, faults: Faults) -> Table:
    """Entries of a table whose keys are the user's own names; none where it is no table."""
    if value is None or isinstance(value, Mapping):
        return value or {}
    faults.add(path, f"must be a table, got {shown(value)}", f"write [{path}]")
    return {}


def noted(read: Callable[[Raw], Value], value: Raw, where: str, faults: Faults) -> Value | None:
    """Read one value whose rule depends on other tables; None, and a fault, where it breaks it."""
    try:
        return read(value)
    except Bad as bad:
        faults.add(where, bad.rule, bad.mend)
    except UnitError as error:
        faults.add(where, error.faults[0].rule, error.faults[0].mend)
    return None


def is_known(*values: object) -> bool:
    """Whether all values of sections that may be faulty could be read."""
    return not any(value is None for value in values)


def with_values(section: Kind, **values: object) -> Kind:
    """Copy of a section that may be faulty with other values, which nobody checks again."""
    return unchecked(type(section), {**values_of(section), **values})


def _dotted(path: str, key: str) -> str:
    return f"{path}.{key}" if path and key else path or key


def quoted_path(key: str) -> str:
    """Dotted key whose odd parts are quoted."""
    return ".".join(quoted(part) for part in key[:500].split("."))


def is_about(fault: Fault, table: str) -> bool:
    """Whether a fault is one of a table, or of a key in it."""
    return fault.where == table or fault.where.startswith(f"{table}.")


def all_about(faults: Faults, table: str) -> bool:
    """Whether nothing but one table has faults, so that all others can be relied on."""
    return all(is_about(fault, table) for fault in faults)


# TOML in and out: size caps, positions of errors, overrides, canonical dump.

Tables = dict[str, object]
MAX_BYTES = 256 * 1024
MAX_LINE = 4096
MAX_DOTS = 32  # before an equals sign: tomllib takes quadratic time in the parts of a key
MAX_DEPTH = 12
_TEXT = "save it as UTF-8 text"
_PLACE = re.compile(r"^(.*) \((?:at line (\d+), column (\d+)|at end of document)\)$", re.DOTALL)


def read_text(path: str | Path, needed: str = "a study") -> str:
    """Text of a file, refused when it is a table of data, missing, too large or not UTF-8."""
    source = str(path)
    if Path(path).suffix.lower() in (".csv", ".tsv", ".xlsx"):
        rule = f"is a table, not the file of {needed}"
        mend = "use `study analyze`, `study import` or `study inspect` with it"
        raise InputError(Fault(source, rule, mend))
    try:
        raw = read_regular(path, MAX_BYTES)
    except NotRegularError as error:
        raise InputError(Fault(source, error.rule, "keep measured data in CSV files")) from error
    except UnreadableError as error:
        raise InputError(Fault(repr(source), error.rule)) from error
    if raw is None:
        file = Path(path)
        names = sorted(p.name for p in file.parent.glob(f"*{file.suffix}") if p.is_file())[:20]
        mend = "study new FILE writes a design to start from"
        mend = nearest(file.name, names) if names else mend
        raise InputError(Fault(source, "there is no such file", mend))
    return decode(raw, source)


def decode(raw: bytes, source: str) -> str:
    """Text of the bytes of a file."""
    if len(raw) > MAX_BYTES:
        rule = f"is larger than {MAX_BYTES // 1024} KiB, which no study file needs"
        raise InputError(Fault(source, rule, "keep measured data in CSV files"))
    if b"\0" in raw:
        line = raw.count(b"\n", 0, raw.index(b"\0")) + 1
        raise InputError(Fault(f"{source}:{line}", "holds a NUL byte: it is no text file", _TEXT))
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        rule = f"is not UTF-8 (byte {raw[error.start]:#04x})"
        raise InputError(Fault(f"{source}:{line}", rule, _TEXT)) from error


def parse_toml(text: str, source: str) -> Tables:
    """Tables of a TOML text."""
    if len(text) > MAX_BYTES:
        raise InputError(Fault(source, f"is longer than {MAX_BYTES // 1024} KiB"))
    for number, line in enumerate(text.split("\n"), 1):
        rule = _unfit_line(line)
        if rule:
            raise InputError(Fault(f"{source}:{number}", rule, "break it into several lines"))
    try:
        tables = tomllib.loads(text)
    except RecursionError as error:
        raise InputError(Fault(source, "is nested too deeply")) from error
    except ValueError as error:  # TOMLDecodeError, or an integer of thousands of digits
        raise InputError(_syntax_fault(str(error), text, source)) from error
    unfit = _unfit(tables)
    if unfit:
        raise InputError(Fault(source, unfit))
    return tables


def _unfit_line(line: str) -> str:
    """Reason why a line is refused before it is parsed."""
    if len(line) > MAX_LINE:
        return f"this line has {len(line)} characters, the limit is {MAX_LINE}"
    *left, last = line.split("=")
    keys = [*left, last] if line.lstrip().startswith("[") else left
    if any(key.count(".") > MAX_DOTS for key in keys):
        return f"this key has more than {MAX_DOTS} dots"
    return ""


def _syntax_fault(message: str, text: str, source: str) -> Fault:
    match = _PLACE.match(message)
    if match is None:
        return Fault(source, f"not valid TOML: {message}")
    if match[2]:
        line, column = int(match[2]), int(match[3])
    else:
        lines = text.split("\n")
        line, column = len(lines), len(lines[-1]) + 1
    mend = "a text needs quotes, and every key of a table may stand once"
    return Fault(f"{source}:{line}:{column}", f"not valid TOML: {match[1]}", mend)


def _unfit(tables: Tables) -> str:
    """Reason why nested tables are refused, found without recursion."""
    layer: list[object] = [tables]
    for _ in range(MAX_DEPTH + 1):
        nodes = [x.values() if isinstance(x, dict) else x for x in layer
                 if isinstance(x, (dict, list))]  # fmt: skip
        layer = [value for node in nodes for value in node]
        if any(isinstance(v, int) and abs(v) >= 2**63 for v in layer):
            return "holds a whole number beyond 64 bits"
        if not layer:
            return ""
    return f"is nested more than {MAX_DEPTH} levels deep"


def flatten(
    table: Mapping[str, object], prefix: str = "", whole: Collection[str] = ()
) -> dict[str, object]:
    """Dotted keys of nested tables; empty tables, and tables that are one value, stay."""
    flat: dict[str, object] = {}
    for key, value in _leaves(table, prefix, whole):
        if key in flat:
            rule = "stands twice, quoted and unquoted"
            raise InputError(Fault(key, rule, "keep one of the two"))
        flat[key] = value
    return flat


def _leaves(
    table: Mapping[str, object], prefix: str, whole: Collection[str]
) -> Iterable[tuple[str, object]]:
    for key, value in table.items():
        if isinstance(value, Mapping) and value and f"{prefix}{key}" not in whole:
            yield from _leaves(value, f"{prefix}{key}.", whole)
        else:
            yield f"{prefix}{key}", value


def split_key(key: str) -> list[str]:
    """Parts of a dotted key as TOML reads it, quotes included.

    Examples
    --------
    >>> split_key('presets.material."a.b".C10')
    ['presets', 'material', 'a.b', 'C10']
    """
    text = key.strip()
    if "\n" in text or "=" in text or len(text) > MAX_LINE:
        raise InputError(Fault(f"-s {key[:80]}", "is no dotted key", "for example model.space=3d"))
    node: object = parse_toml(f"{text} = 0", f"-s {text}")
    parts: list[str] = []
    while isinstance(node, dict):
        part, node = next(iter(node.items()), ("", 0))
        parts.append(part)
    return parts


def parse_override(text: str) -> tuple[list[str], object]:
    """Key and value of ``"key=value"``; the value is TOML, or else a bare text."""
    key, equals, value = text.partition("=")
    if not equals:
        rule = f"must be key=value, got {text[:80]!r}"
        raise InputError(Fault("-s", rule, 'for example -s model.mesh_size="2 mm"'))
    return split_key(key), _toml_value(value.strip())


def _toml_value(text: str) -> object:
    if "\n" in text:
        return text
    try:
        value = parse_toml(f"v = {text}", "-s")
    except InputError:
        return text
    return value["v"] if _plain(value["v"]) else text


def _plain(value: object) -> bool:
    """Whether a value is no date or time, which a bare text such as 10:30 would become."""
    if isinstance(value, list):
        return all(_plain(v) for v in value)
    return isinstance(value, (str, bool, int, float, dict))


def set_value(tables: Tables, path: Sequence[str], value: object) -> None:
    """Set one key in nested tables, made where missing; a number in the path counts entries."""
    where = "-s " + ".".join(path)
    node: dict[str, object] | list[object] = tables
    for part in path[:-1]:
        if isinstance(node, list):
            inner = node[_index(part, node, where)]
        else:
            inner = node.setdefault(part, {})
        if not isinstance(inner, (dict, list)):
            raise InputError(Fault(where, f"{part!r} is a value, no table"))
        node = inner
    if isinstance(node, list):
        node[_index(path[-1], node, where)] = value
    else:
        node[path[-1]] = value


def _index(part: str, items: list[object], where: str) -> int:
    if part.isascii() and part.isdigit() and len(part) < 6 and int(part) < len(items):
        return int(part)
    raise InputError(Fault(where, f"needs a number from 0 to {len(items) - 1}, got {part!r}"))


_BARE = re.compile(r"[A-Za-z0-9_-]+")


def dump_toml(tables: Mapping[str, object]) -> str:
    """Canonical TOML of nested tables: one spelling for equal content, read back identically."""
    return _block(tables, ()).lstrip("\n")


def _block(table: Mapping[str, object], path: tuple[str, ...]) -> str:
    """Write the plain keys of a table first, then its tables under headers of their own."""
    nested = {k: v for k, v in table.items() if isinstance(v, Mapping) or _is_tables(v)}
    text = "".join(f"{_key(k)} = {toml_value(v)}\n" for k, v in table.items() if k not in nested)
    for name, value in nested.items():
        header = ".".join(_key(part) for part in (*path, name))
        if isinstance(value, Mapping):
            text += f"\n[{header}]\n" + _block(value, (*path, name))
        else:
            text += "".join(f"\n[[{header}]]\n" + _block(row, (*path, name)) for row in value)
    return text


def _is_tables(value: object) -> TypeGuard[list[Mapping[str, object]]]:
    return isinstance(value, list) and bool(value) and all(isinstance(v, Mapping) for v in value)


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else _string(key)


def _string(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def toml_value(value: object) -> str:
    """Value as TOML writes it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _string(value)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {toml_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        items = [toml_value(v) for v in value]
        one_line = "[" + ", ".join(items) + "]"
        return one_line if len(one_line) < 100 else "[\n    " + ",\n    ".join(items) + "\n]"
    return repr(value)  # whole numbers and floats: TOML writes them as Python does
