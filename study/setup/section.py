"""Sections of a study file: frozen classes whose fields are the only declaration of the keys.

A field says under which key it is written (``validation_alias``), how its value is read and what
to write where it is missing. The same class holds the values: from a file a quantity needs its
unit, in Python it is a number in mm, N, MPa or deg.
"""

from __future__ import annotations

import typing
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar, dataclass_transform

from pydantic import ConfigDict, Field, GetCoreSchemaHandler, PlainValidator, ValidationInfo
from pydantic.dataclasses import dataclass as pydantic_dataclass
from pydantic.fields import FieldInfo

from study.errors import UnitError

Read = Callable[[Any], Any]
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
    config = ConfigDict(extra="forbid", validate_by_name=True, validate_by_alias=False)
    made: type[Kind] = pydantic_dataclass(frozen=True, config=config)(declared)  # type: ignore[assignment]
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

    def __call__(self, value: Any) -> Any:
        """Value in internal units."""
        try:
            return self.read(value)
        except UnitError as error:
            raise Bad(error.faults[0].rule, error.faults[0].mend) from error

    def validated(self, value: Any, info: ValidationInfo) -> Any:
        """Value of a file, read; or one given in Python."""
        if info.context is FROM_FILE:
            return self(value)
        return value if self.given is None else self.given(value)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> Any:
        """Have pydantic read a value of this kind so."""
        return PlainValidator(self.validated).__get_pydantic_core_schema__(source, handler)


def declared_fields(kind: type) -> Mapping[str, FieldInfo]:
    """Fields of a section by their names in Python."""
    fields: Mapping[str, FieldInfo] = kind.__pydantic_fields__  # type: ignore[attr-defined]
    return fields


def key_of(name: str, declared: FieldInfo) -> str:
    """Key under which a field is written in a file."""
    alias = declared.validation_alias
    return alias if isinstance(alias, str) else name


def written_keys(kind: type) -> tuple[str, ...]:
    """Keys as they are written in the file, in the order of the declaration."""
    return tuple(
        key_of(name, one) for name, one in declared_fields(kind).items() if not is_derived(one)
    )


#: Mark of a field that no file may set: what other tables say decides it.
DERIVED = "derived"


def is_derived(declared: FieldInfo) -> bool:
    """Whether a field is set by other tables, so that it is no key of a file."""
    return DERIVED in declared.metadata


def must_be_written(declared: FieldInfo) -> bool:
    """Whether a file must say the value of a field, although Python may leave it out."""
    found = reads_of(declared)
    return declared.is_required() or bool(found and found.mend)


def reads_of(declared: FieldInfo) -> Reads | None:
    """How a field is read, if it says so; also where it may be None."""
    options: Iterable[Any] = typing.get_args(declared.annotation)
    inner = (mark for option in options for mark in typing.get_args(option))
    return next((mark for mark in (*declared.metadata, *inner) if isinstance(mark, Reads)), None)


def values_of(value: object) -> dict[str, Any]:
    """Values of a section by their names, in internal units; sections within it stay."""
    return {name: getattr(value, name) for name in declared_fields(type(value))}


def read_section(kind: type[Kind], table: Mapping[str, Any]) -> Kind:
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
