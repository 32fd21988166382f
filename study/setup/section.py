"""Sections of a study file: frozen classes whose fields are the only declaration of the keys.

A field says under which key it is written (``validation_alias``), how its value is read and what
to write where it is missing. The same class holds the values: from a file a quantity needs its
unit, in Python it is a number in mm, N, MPa or deg.
"""

from __future__ import annotations

import typing
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, TypeVar, dataclass_transform

from pydantic import ConfigDict, Field, GetCoreSchemaHandler, PlainValidator, ValidationInfo
from pydantic.dataclasses import dataclass as pydantic_dataclass
from pydantic.fields import FieldInfo

from study.errors import Fault, InputError, UnitError

#: Reader of a raw value; who declares a key knows what it makes.
Read = Callable[[object], object]
Kind = TypeVar("Kind")

#: Context of a validation: the values are those of a file, written by hand.
FROM_FILE: Mapping[str, bool] = {"from_file": True}


class Bad(ValueError):
    """A value that breaks a rule."""

    def __init__(self, rule: str, mend: str = "") -> None:
        super().__init__(rule)
        self.rule, self.mend = rule, mend


@dataclass_transform(frozen_default=True, field_specifiers=(Field,))
def section(declared: type[Kind]) -> type[Kind]:
    """Make a class a section: frozen, hashable, and without keys that it does not declare.

    Parameters
    ----------
    declared : type
        Class with annotated fields.

    Returns
    -------
    type
        Pydantic dataclass; in Python its arguments have the names of the fields, in a file
        the keys have their aliases.
    """
    # of 40 sections a file needs half: their validators are built when they are asked for
    config = ConfigDict(
        extra="forbid", validate_by_name=True, validate_by_alias=False, defer_build=True
    )
    made: type[Kind] = pydantic_dataclass(frozen=True, config=config)(declared)  # type: ignore[assignment]
    fields: Mapping[str, FieldInfo] = made.__pydantic_fields__  # type: ignore[attr-defined]
    _DECLARED[made] = tuple(_key(name, one) for name, one in fields.items())
    return made


@dataclass(frozen=True)
class Reads:
    """How the raw value of a key is read.

    Parameters
    ----------
    read : callable
        Raw TOML value to a value in internal units; raises :class:`Bad` with rule and mend.
    dimension : str
        What the value measures: ``"length"``, ``"pressure"``, ...; empty for a plain one.
    mend : str
        What to write where the key is missing; a key that has it must stand in a file.
    given : callable, optional
        Value given in Python, in internal units, to the one that is kept; raises :class:`Bad`.
        Without it the value is kept as it is.
    """

    read: Read
    dimension: str = ""
    mend: str = ""
    given: Read | None = None

    def __call__(self, value: object) -> object:
        """Value in internal units."""
        try:
            return self.read(value)
        except UnitError as error:
            raise Bad(error.faults[0].rule, error.faults[0].mend) from error

    def validated(self, value: object, info: ValidationInfo) -> object:
        """Value of a file, read; or one given in Python."""
        if info.context is FROM_FILE:
            return self(value)
        return value if self.given is None else self.given(value)

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> object:
        """Have pydantic read a value of this kind so."""
        return PlainValidator(self.validated).__get_pydantic_core_schema__(source, handler)


def as_written(mend: str = "") -> Reads:
    """Declare a value that is read where what its rule depends on is known.

    Parameters
    ----------
    mend : str
        What to write where the key is missing; a key that has it must stand in a file.
    """
    return Reads(_itself, mend=mend)


def _itself(value: object) -> object:
    return value


#: A value that is read later, and may be left out.
AsWritten = Annotated[object, as_written()]

#: Mark of a field that no file may set: what other tables say decides it.
DERIVED = "derived"


@dataclass(frozen=True)
class Rows:
    """Mark of a field that is a list of tables, such as ``[[response]]``.

    Parameters
    ----------
    least, most : int
        How many tables it may have.
    mend : str
        What to write where it is no such list; by default its header.
    rule : str
        Rule that another value breaks; by default that it must be tables.
    """

    least: int = 0
    most: int = 10_000
    mend: str = ""
    rule: str = ""


@dataclass(frozen=True)
class Key:
    """Declaration of one key of a section.

    Parameters
    ----------
    name : str
        Of the field in Python.
    written : str
        Name under which the key stands in a file.
    kind : type or None
        Section of a table within the table, or of each of a list of tables.
    rows : Rows or None
        How many tables there may be, if it is a list of them.
    reads : Reads or None
        How its value is read, if it says so.
    default
        Value where the key is left out; None for a required one.
    is_required : bool
        Whether Python must give it.
    is_derived : bool
        Whether other tables set it, so that it is no key of a file.
    mend : str
        What to write where it is missing; a key that has it must stand in a file.
    """

    name: str
    written: str
    kind: type | None
    rows: Rows | None
    reads: Reads | None
    default: object
    is_required: bool
    is_derived: bool
    mend: str

    @property
    def must_be_written(self) -> bool:
        """Whether a file must say it, although Python may leave it out."""
        return self.is_required or bool(self.mend)


#: keys of every section, by its class
_DECLARED: dict[type, tuple[Key, ...]] = {}


def keys_of(kind: type) -> tuple[Key, ...]:
    """Keys of a section, in the order of the declaration.

    Parameters
    ----------
    kind : type
        Class made by :func:`section`.
    """
    return _DECLARED[kind]


def _key(name: str, declared: FieldInfo) -> Key:
    alias, reads = declared.validation_alias, _reads_of(declared)
    required = declared.is_required()
    return Key(
        name=name,
        written=alias if isinstance(alias, str) else name,
        kind=_section_within(declared) if reads is None else None,
        rows=next((mark for mark in declared.metadata if isinstance(mark, Rows)), None),
        reads=reads,
        default=None if required else declared.get_default(),
        is_required=required,
        is_derived=DERIVED in declared.metadata,
        mend=(reads.mend if reads else declared.description) or "",
    )


def _section_within(declared: FieldInfo) -> type | None:
    """Section of a field that pydantic reads itself; also where it may be None, or a list."""
    options = (declared.annotation, *typing.get_args(declared.annotation))
    return next((one for one in options if isinstance(one, type) and one in _DECLARED), None)


def _reads_of(declared: FieldInfo) -> Reads | None:
    """How a field is read; also where it may be None."""
    options: Iterable[object] = typing.get_args(declared.annotation)
    inner = (mark for option in options for mark in typing.get_args(option))
    return next((mark for mark in (*declared.metadata, *inner) if isinstance(mark, Reads)), None)


def written_keys(kind: type) -> tuple[str, ...]:
    """Keys as they are written in the file, in the order of the declaration.

    Parameters
    ----------
    kind : type
        Class made by :func:`section`; derived fields are left out, for no file may hold them.
    """
    return tuple(key.written for key in keys_of(kind) if not key.is_derived)


def table_of(resolved: Mapping[str, object], name: str) -> Mapping[str, object]:
    """Return one of the tables of a document; an empty one where there is none.

    Parameters
    ----------
    resolved : mapping
        Document in internal units.
    name : str
        Of the table, such as ``"specimen"``.
    """
    found = resolved.get(name)
    return found if isinstance(found, Mapping) else {}


def with_table(resolved: Mapping[str, object], name: str, **changes: object) -> dict[str, object]:
    """Copy a document with other values in one table.

    Parameters
    ----------
    resolved : mapping
        Document of a problem.
    name : str
        Table, such as ``"test"``.
    **changes
        Values by their keys, in internal units.

    Examples
    --------
    >>> with_table({"test": {"kind": "compression"}}, "test", steps=20)
    {'test': {'kind': 'compression', 'steps': 20}}
    """
    return {**resolved, name: {**table_of(resolved, name), **changes}}


def values_of(value: object) -> dict[str, object]:
    """Values of a section by their names, in internal units; sections within it stay.

    Parameters
    ----------
    value
        Instance of a class made by :func:`section`.
    """
    return {key.name: getattr(value, key.name) for key in keys_of(type(value))}


def read_section(kind: type[Kind], table: Mapping[str, object]) -> Kind:
    """Read one table of a file.

    Parameters
    ----------
    kind : type
        Class made by :func:`section`.
    table : mapping
        The table as written.

    Raises
    ------
    pydantic.ValidationError
        With every fault of the table.
    """
    validator = kind.__pydantic_validator__  # type: ignore[attr-defined]
    found: Kind = validator.validate_python(table, by_alias=True, by_name=False, context=FROM_FILE)
    return found


def section_of(where: str, kind: type[Kind], resolved: Mapping[str, object]) -> Kind:
    """Make a section of a resolved table, which may hold more: where a file lies, its checksum.

    Parameters
    ----------
    where : str
        Table of the study file, for messages.
    kind : type
        Class made by :func:`section`.
    resolved : mapping
        Values in internal units by the names of the fields; None counts as left out.

    Raises
    ------
    InputError
        If a value is missing.
    """
    known = keys_of(kind)
    values = {k.name: v for k in known if (v := resolved.get(k.name)) is not None}
    missing = [k.name for k in known if k.is_required and k.name not in values]
    if missing:
        raise InputError(Fault(where, f"{kind.__name__} needs {', '.join(missing)}"))
    return kind(**values)
