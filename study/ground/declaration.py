"""Sections of a study file: frozen classes whose fields are the only declaration of the keys.

A field says how its value is read and what to write where it is missing. Its key is its name
without the unit: ``radius_mm`` is written ``radius``. The same class holds the values: from a file
a quantity needs its unit, in Python it is a number in mm, N, MPa or deg.
"""

from __future__ import annotations

import inspect
import math
import re
import typing
import unicodedata
from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass
from numbers import Real
from pathlib import PurePosixPath, PureWindowsPath
from typing import Annotated, TypeVar, dataclass_transform

from pydantic import AliasGenerator, ConfigDict, GetCoreSchemaHandler, PlainValidator
from pydantic import Field as Field
from pydantic.dataclasses import dataclass as pydantic_dataclass
from pydantic.fields import FieldInfo

from study.ground import units
from study.ground.errors import Fault, InputError, UnitError, nearest

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

    #: Raw TOML value to a value in internal units; raises :class:`Bad` with rule and mend.
    read: Read
    #: What the value measures: ``"length"``, ``"pressure"``, ...; empty for a plain one.
    dimension: str = ""
    #: What to write where the key is missing; a key that has it must stand in a file.
    mend: str = ""
    #: Converts a value given in Python, in internal units, to the stored value; raises
    #: :class:`Bad`. None stores the value as it is.
    given: Read | None = None

    def __call__(self, value: object) -> object:
        """Value in internal units."""
        try:
            return self.read(value)
        except UnitError as error:
            raise Bad(error.faults[0].rule, error.faults[0].mend) from error

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
