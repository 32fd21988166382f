"""Tables of a study file as pydantic models; their errors as faults with a place and a mend."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from pydantic import (
    BaseModel,
    ConfigDict,
    GetCoreSchemaHandler,
    PlainValidator,
    ValidationError,
)
from pydantic.fields import FieldInfo

from study.design.reader import Bad, Faults, Read, quoted, shown
from study.errors import UnitError, nearest


class Table(BaseModel):
    """A table of the file: its fields are the only declaration of its keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @classmethod
    def written_keys(cls) -> tuple[str, ...]:
        """Keys as they are written in the file, in the order of the declaration."""
        return tuple(field.alias or name for name, field in cls.model_fields.items())

    def values(self) -> dict[str, Any]:
        """Values by their names inside, in internal units."""
        return {name: getattr(self, name) for name in type(self).model_fields}


Model = TypeVar("Model", bound=Table)


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
        What to write where the key is missing.
    """

    read: Read
    dimension: str = ""
    mend: str = ""

    def __call__(self, value: Any) -> Any:
        """Value in internal units."""
        try:
            return self.read(value)
        except UnitError as error:
            raise Bad(error.faults[0].rule, error.faults[0].mend) from error

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> Any:
        """Have pydantic read a value of this kind so."""
        return PlainValidator(self).__get_pydantic_core_schema__(source, handler)


def reads_of(field: FieldInfo) -> Reads | None:
    """How a field is read, if it says so."""
    return next((one for one in field.metadata if isinstance(one, Reads)), None)


def read_table(
    model: type[Model], table: Any, path: str, faults: Faults, also: Iterable[str] = ()
) -> Model:
    """Read one table; every fault is noted, and a faulty value is None.

    Parameters
    ----------
    model : type of Table
        Declaration of the table.
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
    Table
        The values; None where a key is faulty or missing without a default.
    """
    written = table if isinstance(table, Mapping) else {}
    if not isinstance(table, Mapping):
        faults.add(path, f"must be a table, got {shown(table)}", f"write [{path}]")
    known = {key: value for key, value in written.items() if key not in set(also)}
    try:
        return model.model_validate(known)
    except ValidationError as error:
        bad = set()
        for one in error.errors(include_url=False):
            keys = tuple(str(part) for part in one["loc"])
            bad.add(keys[0])
            if one["type"] == "missing" and not isinstance(table, Mapping):
                continue
            _note(model, one, keys, path, faults, also)
    return model.model_construct(**_partial(model, known, bad))


def noted(read: Read, value: Any, where: str, faults: Faults) -> Any:
    """Read one value whose rule depends on other tables; None, and a fault, where it breaks it.

    Parameters
    ----------
    read : callable
        As of :class:`Reads`.
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


def _note(
    model: type[Table],
    error: Mapping[str, Any],
    keys: Sequence[str],
    path: str,
    faults: Faults,
    also: Iterable[str],
) -> None:
    """Note one error of pydantic as a fault: where, which rule, how to mend it."""
    *parents, key = keys
    inner = _inner(model, parents)
    above = ".".join([*([path] if path else []), *parents])
    where = f"{above}.{key}" if above else key
    if error["type"] == "missing":
        field = next(f for n, f in inner.model_fields.items() if (f.alias or n) == key)
        found = reads_of(field)
        faults.add(where, "is missing", found.mend if found else field.description or "")
    elif error["type"] == "extra_forbidden":
        plain = quoted(key)
        valid = [*inner.written_keys(), *(also if not parents else ())]
        place = f"{above}.{plain}" if above else plain
        faults.add(place, "unknown key", nearest(key, valid))
    elif error["type"] == "model_type":
        faults.add(where, f"must be a table, got {shown(error['input'])}", f"write [{where}]")
    else:
        bad = error["ctx"]["error"]
        faults.add(where, bad.rule, bad.mend)


def _inner(model: type[Table], parents: Sequence[str]) -> type[Table]:
    """Find the declaration of a table within a table."""
    for key in parents:
        field = next(f for n, f in model.model_fields.items() if (f.alias or n) == key)
        annotation = field.annotation
        if isinstance(annotation, type) and issubclass(annotation, Table):
            model = annotation
    return model


def _partial(model: type[Table], written: Mapping[str, Any], bad: set[str]) -> dict[str, Any]:
    """Values of the keys that are right, the defaults of those left out, None for the others."""
    values: dict[str, Any] = {}
    for name, field in model.model_fields.items():
        key, read = field.alias or name, reads_of(field)
        if key in bad:
            values[name] = None
        elif key in written:
            values[name] = read(written[key]) if read else None
        else:
            values[name] = None if field.is_required() else field.get_default()
    return values


def one_of(tables: Mapping[str, type[Table]]) -> Callable[[Any], Any]:
    """Reader of the word that says which table it is."""

    def read(value: Any) -> str:
        if not isinstance(value, str):
            raise Bad(f"must be a text, got {shown(value)}", nearest("", tables))
        if value not in tables:
            raise Bad(f"unknown value {shown(value)}", nearest(value[:80], tables))
        return value

    return read
