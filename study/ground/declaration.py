"""Study files: their keys declared once, read with every fault told, and TOML in and out.

A section is a frozen class whose fields are the only declaration of its keys. A field says how its
value is read and what to write where it is missing. Its key is its name without the unit:
``radius_mm`` is written ``radius``. The same class holds the values: from a file a quantity needs
its unit, in Python it is a number in mm, N, MPa or deg.
"""

from __future__ import annotations

import inspect
import json
import math
import re
import tomllib
import typing
import unicodedata
from collections.abc import Callable, Collection, Container, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from numbers import Real
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Annotated, TypeGuard, TypeVar, dataclass_transform

from pydantic import AliasGenerator, ConfigDict, GetCoreSchemaHandler, PlainValidator
from pydantic import Field as Field
from pydantic.dataclasses import dataclass as pydantic_dataclass
from pydantic.fields import FieldInfo

from study.ground import units
from study.ground.errors import Fault, InputError, MissingDataError, UnitError, nearest
from study.ground.files import NotRegularError, UnreadableError, read_regular

#: Reader of a raw value; who declares a key knows what it makes.
Read = Callable[[object], object]
Kind = TypeVar("Kind")


class Bad(ValueError):
    """A value that breaks a rule."""

    def __init__(self, rule: str, mend: str = "") -> None:
        super().__init__(rule)
        self.rule, self.mend = rule, mend


@dataclass_transform(frozen_default=True, field_specifiers=(Field,))
def section(declared: type[Kind]) -> type[Kind]:
    """Make a class a section: frozen, hashable, and without keys that it does not declare."""
    # of 40 sections a file needs half: their validators are built when they are asked for. Their
    # annotations are read here, for pydantic would look names up in the frame that asks first.
    declared.__annotations__ = inspect.get_annotations(declared, eval_str=True)
    config = ConfigDict(
        extra="forbid", validate_by_name=True, validate_by_alias=False, defer_build=True,
        alias_generator=AliasGenerator(validation_alias=_without_unit),
    )  # fmt: skip
    frozen_class: type[Kind] = pydantic_dataclass(frozen=True, config=config)(declared)  # type: ignore[assignment]
    fields: Mapping[str, FieldInfo] = frozen_class.__pydantic_fields__  # type: ignore[attr-defined]
    _DECLARED[frozen_class] = tuple(_key(name, field) for name, field in fields.items())
    return frozen_class


@dataclass(frozen=True)
class Reads:
    """How the raw value of a key is read."""

    #: Raw TOML value to a value in internal units; raises :class:`Bad` or :class:`UnitError`.
    read: Read
    #: What the value measures: ``"length"``, ``"pressure"``, ...; empty for a plain one.
    dimension: str = ""
    #: What to write where the key is missing; a key that has it must stand in a file.
    mend: str = ""
    #: Converts a value given in Python, in internal units, to the stored value; raises
    #: :class:`Bad`. None stores the value as it is.
    given: Read | None = None

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> object:
        """Have pydantic take a value that is given in Python so."""
        taken = PlainValidator(self.given or (lambda value: value))
        return taken.__get_pydantic_core_schema__(source, handler)


def as_written(mend: str = "") -> Reads:
    """Declare a value that is read where what its rule depends on is known."""
    return Reads(lambda value: value, mend=mend)


#: A value that is read later, and may be left out.
AsWritten = Annotated[object, as_written()]
#: Mark of a field that no file may set: what other tables say decides it.
DERIVED = "derived"


@dataclass(frozen=True)
class Rows:
    """Mark of a field that is a list of tables, such as ``[[response]]``."""

    #: How many tables it must have, and may have.
    least: int = 0
    most: int = 10_000
    #: What to write where it is no such list; by default its header.
    mend: str = ""
    #: Rule that another value breaks; by default that it must be tables.
    rule: str = ""


@dataclass(frozen=True)
class Key:
    """Declaration of one key of a section."""

    #: Of the field in Python.
    name: str
    #: Name under which the key stands in a file.
    written: str
    #: Section of a table within the table, or of each of a list of tables.
    kind: type | None
    #: How many tables there may be, if it is a list of them.
    rows: Rows | None
    #: How its value is read, if it says so.
    reads: Reads | None
    #: Value where the key is left out; None for a required one.
    default: object
    #: Whether Python must give it.
    is_required: bool
    #: Whether other tables set it, so that it is no key of a file.
    is_derived: bool
    #: What to write where it is missing; a key that has it must stand in a file.
    mend: str

    @property
    def must_be_written(self) -> bool:
        """Whether a file must say it, although Python may leave it out."""
        return self.is_required or bool(self.mend)


_UNIT_OF_NAME = re.compile(r"_(mm_per_s|kg_m3|mm2|mm|deg|N|MPa|MB|s)$")
#: keys of every section, by its class
_DECLARED: dict[type, tuple[Key, ...]] = {}


def keys_of(kind: type) -> tuple[Key, ...]:
    """Keys of a section, in the order of the declaration."""
    return _DECLARED[kind]


def _without_unit(name: str) -> str:
    return _UNIT_OF_NAME.sub("", name)


def _key(name: str, declared: FieldInfo) -> Key:
    alias, required = declared.validation_alias, declared.is_required()
    # also where the value may be None, or a list of sections
    inner = typing.get_args(declared.annotation)
    marks = (mark for option in inner for mark in typing.get_args(option))
    reads = next((mark for mark in (*declared.metadata, *marks) if isinstance(mark, Reads)), None)
    options = (option for option in (declared.annotation, *inner) if isinstance(option, type))
    within = next((option for option in options if option in _DECLARED), None)
    return Key(
        name=name,
        written=alias if isinstance(alias, str) else _without_unit(name),
        kind=within if reads is None else None,
        rows=next((mark for mark in declared.metadata if isinstance(mark, Rows)), None),
        reads=reads,
        default=None if required else declared.get_default(),
        is_required=required,
        is_derived=DERIVED in declared.metadata,
        mend=(reads.mend if reads else declared.description) or "",
    )


def written_keys(kind: type) -> tuple[str, ...]:
    """Keys as they are written in the file, in the order of the declaration."""
    return tuple(key.written for key in keys_of(kind) if not key.is_derived)


def table_of(resolved: Mapping[str, object], name: str) -> Mapping[str, object]:
    """Return one of the tables of a document; an empty one where there is none."""
    table = resolved.get(name)
    return table if isinstance(table, Mapping) else {}


def with_table(resolved: Mapping[str, object], name: str, **changes: object) -> dict[str, object]:
    """Copy a document with other values in one table.

    Examples
    --------
    >>> with_table({"test": {"kind": "compression"}}, "test", steps=20)
    {'test': {'kind': 'compression', 'steps': 20}}
    """
    return {**resolved, name: {**table_of(resolved, name), **changes}}


def values_of(value: object) -> dict[str, object]:
    """Values of a section by their names, in internal units; sections within it stay."""
    return {key.name: getattr(value, key.name) for key in keys_of(type(value))}


def document_of(value: object, seldom: Container[str] = ()) -> dict[str, object]:
    """Values of a section by their names, those of a section within it as well.

    Keys that are ``seldom`` given are left out where they have their defaults: names made of
    documents are then those of a time before these keys.
    """
    document: dict[str, object] = {}
    for key in keys_of(type(value)):
        item = getattr(value, key.name)
        if key.name not in seldom or item != key.default:
            document[key.name] = document_of(item) if type(item) in _DECLARED else item
    return document


def field_named(section: object, written: str) -> str | None:
    """Name of the field of a section that a file has under a key; None where there is none.

    The length of a gauge section is also found as its height, which it is called in Python.
    """
    keys = _DECLARED.get(type(section), ())
    exact = (k.name for k in keys if k.written == written)
    return next(exact, next((k.name for k in keys if k.name == f"{written}_mm"), None))


def section_of(where: str, kind: type[Kind], resolved: Mapping[str, object]) -> Kind:
    """Make a section of a resolved table, which may hold more: where a file lies, its checksum."""
    declared = keys_of(kind)
    values = {k.name: v for k in declared if (v := resolved.get(k.name)) is not None}
    missing = [k.name for k in declared if k.is_required and k.name not in values]
    if missing:
        raise InputError(Fault(where, f"{kind.__name__} needs {', '.join(missing)}"))
    return kind(**values)


# Quantities of a study file: numbers with a unit, and plain numbers, each with its range.

#: largest and smallest size of a quantity in internal units (mm, N, MPa, s): the fourth power of
#: a length still is a double
LARGEST = 1e12
SMALLEST = 1e-12


def shown(value: object) -> str:
    """Value as a message shows it, cut short."""
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def quantity(
    dimension: str, low: float = 0.0, high: float = math.inf, *, closed: bool = False
) -> Callable[[object], float]:
    """Reader of a value with its unit, within a range. Units: returns mm."""

    def read(value: object) -> float:
        number = units.parse(value, dimension)
        unit = units.INTERNAL[dimension]
        if number < low or (number == low and not closed):
            bound = "at least" if closed else "above"
            raise Bad(f"must be {bound} {low:g} {unit}, got {value!r}")
        if number >= high:
            raise Bad(f"must be below {high:g} {unit}, got {value!r}")
        if number and not SMALLEST <= abs(number) <= LARGEST:
            kind = "large" if abs(number) > LARGEST else "small"
            raise Bad(f"is too {kind} for any test, got {value!r}", "check its unit and exponent")
        return number

    return read


def measured(
    dimension: str,
    low: float = 0.0,
    high: float = math.inf,
    *,
    closed: bool = False,
    mend: str = "",
) -> Reads:
    """Declare a quantity: with its unit in a file, a number in internal units in Python."""
    return Reads(quantity(dimension, low, high, closed=closed), dimension, mend, finite)


def finite(value: object) -> float:
    """Take a number given in Python; a problem checks the range that it needs."""
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
        raise Bad(f"must be a finite number, got {shown(value)}")
    return float(value)


def number(
    low: float = -math.inf, high: float = math.inf, *, closed: bool = False, mend: str = ""
) -> Callable[[object], float]:
    """Reader of a finite plain number within a range."""

    def read(value: object) -> float:
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


def integer(low: int, high: int) -> Callable[[object], int]:
    """Reader of a whole number within a range."""

    def read(value: object) -> int:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise Bad(f"must be a whole number, got {shown(value)}")
        if not math.isfinite(value) or value != int(value):
            raise Bad(f"must be a whole number, got {shown(value)}")
        if not low <= value <= high:
            raise Bad(f"must be a whole number from {low} to {high}, got {shown(value)}")
        return int(value)

    return read


def unit_of_length(value: object) -> str:
    """Read the name of a unit of length. Units: value mm."""
    if not isinstance(value, str):
        raise Bad(f"must be a text, got {shown(value)}", 'for example unit = "mm"')
    try:
        units.parse(f"1 {value}", "length")
    except UnitError:
        raise Bad(f"must be a length unit, got {shown(value)}", 'for example unit = "mm"') from None
    return value.strip()


Length = Annotated[float, measured("length")]
#: a length that may be 0, as that of a rounding
LengthOrZero = Annotated[float, measured("length", closed=True)]
#: a coordinate, of either sign
Coordinate = Annotated[float, measured("length", -math.inf)]
Pressure = Annotated[float, measured("pressure")]
Duration = Annotated[float, measured("time")]
Force = Annotated[float, measured("force")]


# Texts of a study file: words to choose from, names, paths; each refused with its rule.

MAX_NAME = 80
MAX_TEXT = 4000
#: categories of Unicode that a reader cannot see, or that steer a terminal
INVISIBLE = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}


def quoted(key: str) -> str:
    """Key, quoted and cut where it is not a plain word."""
    plain = key.isascii() and len(key) <= MAX_NAME and key.replace("-", "_").isidentifier()
    return key if plain else ascii(key[:MAX_NAME])


def choice(*names: str, synonyms: Mapping[str, str] | None = None) -> Callable[[object], str]:
    """Reader of one of several words; a synonym becomes the word it stands for."""
    words = {name: name for name in names} | dict(synonyms or {})

    def read(value: object) -> str:
        if not isinstance(value, str):
            raise Bad(f"must be a text, got {shown(value)}", nearest("", words))
        if value not in words:
            raise Bad(f"unknown value {shown(value)}", nearest(value[:MAX_NAME], words))
        return words[value]

    return read


def word(*names: str, synonyms: Mapping[str, str] | None = None, mend: str = "") -> Reads:
    """Declare one of several words, the same in a file and in Python; see :func:`choice`."""
    read = choice(*names, synonyms=synonyms)
    return Reads(read, mend=mend, given=read)


def flag(value: object) -> bool:
    """Read true or false."""
    if not isinstance(value, bool):
        raise Bad(f"must be true or false, got {shown(value)}")
    return value


def text(value: object) -> str:
    """Read a text without control characters."""
    if not isinstance(value, str):
        raise Bad(f"must be a text, got {shown(value)}", "put it in quotes")
    if len(value) > MAX_TEXT:
        raise Bad(f"has {len(value)} characters, the limit is {MAX_TEXT}")
    if any(unicodedata.category(c) in INVISIBLE and c not in "\n\t" for c in value):
        raise Bad("holds control characters")
    return value.strip()


def reason(value: object) -> str:
    """Read why something is left out, which may not be empty."""
    why = text(value)
    if not why:
        raise Bad("is empty", "say why these cells are left out")
    return why


def name(value: object) -> str:
    """Read a name that may stand in a table, a page or a CSV file."""
    # A leading ``=``, ``+``, ``-`` or ``@`` is a formula for a spreadsheet (CWE-1236), and no
    # quoting survives its next save.
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


def slug(value: object) -> str:
    """Read a name that is also a folder's: letters, digits, dash, underscore, dot."""
    plain = name(value)
    if not re.fullmatch(r"[A-Za-z0-9._-]*[A-Za-z0-9_-]", plain):
        raise Bad(f"may have letters, digits, - _ and . (not last) only, got {shown(value)}")
    if plain[0] == ".":
        raise Bad(f"must not begin with a dot, got {shown(value)}")
    return plain


def names(value: object) -> tuple[str, ...]:
    """Read a list of names, without those that repeat."""
    items = value if isinstance(value, list) else [value]
    if len(items) > 100:
        raise Bad(f"lists {len(items)} names, the limit is 100")
    return tuple(dict.fromkeys(name(item) for item in items))


def texts(what: str, example: str) -> Callable[[object], tuple[str, ...]]:
    """Reader of a list of texts."""

    def read(value: object) -> tuple[str, ...]:
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            raise Bad(f"must be a list of {what}, got {shown(value)}", f'for example ["{example}"]')
        return tuple(value)

    return read


def relative_path(value: object) -> str:
    """Read a path below the data root."""
    mend = "write it relative to the data root (--data DIR)"
    if not isinstance(value, str) or not value.strip():
        raise Bad(f"must be a path, got {shown(value)}", mend)
    if any(unicodedata.category(c) in INVISIBLE for c in value) or len(value) > 500:
        raise Bad("is too long or holds characters that cannot be seen", mend)
    if value.startswith(("/", "\\", "~")) or PureWindowsPath(value).drive:
        raise Bad(f"must be relative, got {shown(value)}", mend)
    if ".." in PurePosixPath(value.replace("\\", "/")).parts:
        raise Bad(f"must not climb with '..', got {shown(value)}", mend)
    return value


#: version of the files that are read
SCHEMA = 1


def _schema(value: object) -> int:
    if isinstance(value, bool) or value != SCHEMA:
        raise Bad(f"must be {SCHEMA}, got {shown(value)}", "this version reads schema 1 only")
    return SCHEMA


Schema = Annotated[int, Reads(_schema, mend=f"write schema = {SCHEMA} on the first line")]


# Tables of a file, read with every fault as a place, a rule and how to mend it.

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
        return value if key.reads is None else noted(key.reads.read, value, where, faults)
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
    text = "".join(f"{_bare(k)} = {toml_value(v)}\n" for k, v in table.items() if k not in nested)
    for name, value in nested.items():
        header = ".".join(_bare(part) for part in (*path, name))
        if isinstance(value, Mapping):
            text += f"\n[{header}]\n" + _block(value, (*path, name))
        else:
            text += "".join(f"\n[[{header}]]\n" + _block(row, (*path, name)) for row in value)
    return text


def _is_tables(value: object) -> TypeGuard[list[Mapping[str, object]]]:
    return isinstance(value, list) and bool(value) and all(isinstance(v, Mapping) for v in value)


def _bare(key: str) -> str:
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
        return "{ " + ", ".join(f"{_bare(k)} = {toml_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        items = [toml_value(v) for v in value]
        one_line = "[" + ", ".join(items) + "]"
        return one_line if len(one_line) < 100 else "[\n    " + ",\n    ".join(items) + "\n]"
    return repr(value)  # whole numbers and floats: TOML writes them as Python does
