"""TOML in and out: size caps, positions of errors, overrides, canonical dump.

Nothing here knows what a key means.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeGuard

from study.bounded_file import NotRegularError, UnreadableError, read_regular
from study.errors import Fault, InputError, nearest

#: nested tables of a file
Tables = dict[str, object]
MAX_BYTES = 256 * 1024
MAX_LINE = 4096
MAX_DOTS = 32  # before an equals sign: tomllib takes quadratic time in the parts of a key
MAX_DEPTH = 12
_PLACE = re.compile(r"^(.*) \((?:at line (\d+), column (\d+)|at end of document)\)$", re.DOTALL)


def read_text(path: str | Path) -> str:
    """Text of a file, refused when it is missing, too large or not UTF-8.

    Parameters
    ----------
    path : str or Path
        A file of at most :data:`MAX_BYTES` bytes.

    Raises
    ------
    InputError
        With the reason.
    """
    source = str(path)
    try:
        raw = read_regular(path, MAX_BYTES)
    except NotRegularError as error:
        raise InputError(Fault(source, error.rule, "keep measured data in CSV files")) from error
    except UnreadableError as error:
        raise InputError(Fault(repr(source), error.rule)) from error
    if raw is None:
        raise InputError(Fault(source, "there is no such file", _beside(Path(path))))
    return decode(raw, source)


def _beside(path: Path) -> str:
    """Name the files in the same folder that could have been meant."""
    names = sorted(p.name for p in path.parent.glob(f"*{path.suffix}") if p.is_file())[:20]
    return nearest(path.name, names) if names else "study new FILE writes a design to start from"


def decode(raw: bytes, source: str) -> str:
    """Text of the bytes of a file.

    Parameters
    ----------
    raw : bytes
        UTF-8; a byte-order mark at its start is removed.
    source : str
        Name of the file, for messages.

    Raises
    ------
    InputError
        If there are too many, or they are not UTF-8.
    """
    if len(raw) > MAX_BYTES:
        rule = f"is larger than {MAX_BYTES // 1024} KiB, which no study file needs"
        raise InputError(Fault(source, rule, "keep measured data in CSV files"))
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        rule = f"is not UTF-8 (byte {raw[error.start]:#04x})"
        raise InputError(Fault(f"{source}:{line}", rule, "save it as UTF-8 text")) from error


def parse_toml(text: str, source: str) -> Tables:
    """Tables of a TOML text.

    Parameters
    ----------
    text : str
        TOML, with lines and depth that no honest file exceeds.
    source : str
        Name of the file, for messages.

    Raises
    ------
    InputError
        With file, line and column of a syntax error.
    """
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
        layer = [v for x in layer if isinstance(x, (dict, list)) for v in _children(x)]
        if any(isinstance(v, int) and abs(v) >= 2**63 for v in layer):
            return "holds a whole number beyond 64 bits"
        if not layer:
            return ""
    return f"is nested more than {MAX_DEPTH} levels deep"


def _children(value: dict[str, object] | list[object]) -> Iterable[object]:
    return value.values() if isinstance(value, dict) else value


def flatten(table: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    """Dotted keys of nested tables; an empty table stays, as what nothing can be.

    Parameters
    ----------
    table : mapping
        Nested at will; some of its keys may be dotted already.
    prefix : str
        Put before every key; ends with a dot unless it is empty.

    Raises
    ------
    InputError
        If a key stands twice, once quoted and once not.

    Examples
    --------
    >>> flatten({"model": {"space": "3d"}, "model.mesh": "fine"})
    {'model.space': '3d', 'model.mesh': 'fine'}
    """
    flat: dict[str, object] = {}
    for key, value in _leaves(table, prefix):
        if key in flat:
            rule = "stands twice, quoted and unquoted"
            raise InputError(Fault(key, rule, "keep one of the two"))
        flat[key] = value
    return flat


def _leaves(table: Mapping[str, object], prefix: str) -> Iterable[tuple[str, object]]:
    for key, value in table.items():
        if isinstance(value, Mapping) and value:
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def split_key(key: str) -> list[str]:
    """Parts of a dotted key as TOML reads it, quotes included.

    Parameters
    ----------
    key : str
        As given on the command line; quoted where a part holds a dot.

    Raises
    ------
    InputError
        If it is no key.

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
    """Key and value of ``"key=value"``; the value is TOML, or else a bare text.

    Parameters
    ----------
    text : str
        As given to ``-s`` on the command line.

    Raises
    ------
    InputError
        If there is no ``=`` or the key is none.

    Examples
    --------
    >>> parse_override("model.mesh_size=2 mm"), parse_override("test.steps=5")
    ((['model', 'mesh_size'], '2 mm'), (['test', 'steps'], 5))
    """
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
    """Set one key in nested tables, made where missing; a number in the path counts entries.

    Parameters
    ----------
    tables : dict
        Changed in place.
    path : sequence of str
        Parts of the dotted key, the outermost table first.
    value
        As TOML would give it.

    Raises
    ------
    InputError
        If the path runs through something that is no table.
    """
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
    """Canonical TOML of nested tables: one spelling for equal content, read back identically.

    Parameters
    ----------
    tables : mapping
        Values that TOML has: texts, numbers, booleans, lists and tables of them.

    Examples
    --------
    >>> print(dump_toml({"schema": 1, "model": {"space": "3d"}}), end="")
    schema = 1
    <BLANKLINE>
    [model]
    space = "3d"
    """
    return _block(tables, ()).lstrip("\n")


def _block(table: Mapping[str, object], path: tuple[str, ...]) -> str:
    """Write the plain keys of a table first, then its tables under headers of their own."""
    nested = {k: v for k, v in table.items() if isinstance(v, Mapping) or _is_tables(v)}
    text = "".join(f"{_key(k)} = {_value(v)}\n" for k, v in table.items() if k not in nested)
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


def _value(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _string(value)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        items = [_value(v) for v in value]
        one_line = "[" + ", ".join(items) + "]"
        return one_line if len(one_line) < 100 else "[\n    " + ",\n    ".join(items) + "\n]"
    return repr(value)  # whole numbers and floats: TOML writes them as Python does
