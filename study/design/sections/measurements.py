"""The table ``[measurements]``: where measured curves are and how rows become curves."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field

from study import units
from study.design.reader import (
    Bad,
    Faults,
    choice,
    flag,
    integer,
    name,
    names,
    quantity,
    relative_path,
    shown,
    text,
)
from study.design.spec import MeasurementSpec, Range
from study.design.table import Reads, Table, read_table
from study.errors import UnitError

MAX_POINTS = 100_000
_FIELD = re.compile(r"\{([^{}]*)\}")


def csv_path(value: Any) -> str:
    """Read the path of a table."""
    path = relative_path(value)
    if not path.lower().endswith((".csv", ".csv.gz")):
        raise Bad(f"must end in .csv or .csv.gz, got {shown(value)}")
    if "{" in path or "}" in path:
        raise Bad(f"is one file, got a pattern {shown(value)}", "write files = ...")
    return path


def csv_pattern(value: Any) -> str:
    """Read a pattern such as ``"indentation-{specimen}.csv"``."""
    pattern = relative_path(value)
    if not pattern.lower().endswith((".csv", ".csv.gz")):
        raise Bad(f"must end in .csv or .csv.gz, got {shown(value)}")
    groups = _FIELD.findall(pattern)
    odd = "{" in _FIELD.sub("", pattern) or "}" in _FIELD.sub("", pattern)
    if odd or not groups or any(not re.fullmatch(r"[A-Za-z]\w{0,79}", g, re.A) for g in groups):
        raise Bad(f"needs groups such as {{specimen}}, got {shown(value)}", "or write file = ...")
    if len(set(groups)) < len(groups):
        raise Bad(f"names a group twice, got {shown(value)}")
    return pattern


def read_range(value: Any) -> Range:
    """Read ``["1 %", "20 %"]`` or ``["0.3 mm", "6 mm"]``."""
    mend = 'write, for example, ["1 %", "20 %"] or ["0.3 mm", "6 mm"]'
    if not isinstance(value, list) or len(value) != 2:
        raise Bad(f"must be two values, got {shown(value)}", mend)
    if not all(isinstance(v, str) for v in value):
        raise Bad(f"needs units, got {shown(value)}", mend)
    percent = [v.rstrip().endswith("%") for v in value]
    if percent[0] != percent[1]:
        raise Bad(f"mixes percent and length, got {shown(value)}", mend)
    try:
        low, high = (
            units.parse_percent(v) if percent[0] else units.parse(v, "length") for v in value
        )
    except UnitError as error:
        raise Bad(error.faults[0].rule, mend) from error
    if not 0 <= low < high:
        raise Bad(f"must rise from 0 or more, got {shown(value)}", mend)
    if percent[0] and high >= 100:
        raise Bad(f"must stay below 100 % of the height, got {shown(value)}", mend)
    return Range("percent" if percent[0] else "mm", low, high)


def rows(value: Any) -> dict[str, Any]:
    """Read a choice of rows: column -> label, or labels."""
    if not isinstance(value, Mapping) or not value:
        raise Bad(f"must be a table, got {shown(value)}", 'for example { specimen = "A" }')
    return {name(column): _labels(wanted) for column, wanted in value.items()}


def _labels(value: Any) -> Any:
    if isinstance(value, list):
        if not value:
            raise Bad("chooses no label at all")
        return tuple(_labels(v) for v in value)
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if isinstance(value, bool) or not isinstance(value, (str, int, float)):
        raise Bad(f"must be a label, got {shown(value)}")
    return text(str(value))


def _unit(dimension: str) -> Any:
    def read(value: Any) -> str:
        unit = text(value)
        units.unit_factor(unit, dimension)
        return unit

    return read


class Columns(Table):
    """Columns of a measured file."""

    displacement: Annotated[str, Reads(name, mend="displacement and force")]
    force: Annotated[str, Reads(name, mend="displacement and force")]


class Units(Table):
    """Units of the columns of a measured file."""

    displacement: Annotated[str, Reads(_unit("length"))]
    force: Annotated[str, Reads(_unit("force"))]


class Measurements(Table):
    """Where measured curves are and how rows become curves."""

    file: Annotated[str | None, Reads(csv_path)] = None
    files: Annotated[str | None, Reads(csv_pattern)] = None
    columns: Columns = Field(
        description='for example columns = { displacement = "displacement_mm", force = "force_N" }'
    )
    units: Units = Field(description='for example units = { displacement = "mm", force = "N" }')
    block: Annotated[str | None, Reads(name)] = None
    average: Annotated[tuple[str, ...], Reads(names)] = ()
    range: Annotated[Range | None, Reads(read_range)] = None
    points: Annotated[int, Reads(integer(2, MAX_POINTS))] = 200
    fit: Annotated[dict[str, Any] | None, Reads(rows)] = None
    score: Annotated[dict[str, Any] | None, Reads(rows)] = None
    swap: Annotated[bool, Reads(flag)] = False
    zero: Annotated[str, Reads(choice("none", "first", "fit"))] = "none"
    toe: Annotated[float | None, Reads(quantity("force"), "force")] = None
    sign: Annotated[str, Reads(choice("positive", "negative"))] = "positive"
    decimal: Annotated[str, Reads(choice(".", ","))] = "."
    citation: Annotated[str, Reads(text)] = ""


def read_measurements_table(
    table: Any, faults: Faults, path: str = "measurements"
) -> MeasurementSpec | None:
    """Specification of the measured curves; None where a fault was found.

    Parameters
    ----------
    table : mapping
        The table as written.
    faults : Faults
        Where faults go.
    path : str
        Of the table.
    """
    before = len(faults)
    found = read_table(Measurements, table, path, faults)
    if isinstance(table, Mapping):
        _check_together(table, path, faults)
    if len(faults) > before:
        return None
    values = found.values()
    values["columns"], values["units"] = found.columns.values(), found.units.values()
    return MeasurementSpec(**values)


def _check_together(table: Mapping[str, Any], path: str, faults: Faults) -> None:
    def fault(key: str, rule: str, mend: str) -> None:
        faults.add(f"{path}.{key}", rule, mend)

    given = [key for key in ("file", "files") if key in table]
    if len(given) != 1:
        rule = "stands beside file" if given else "is missing"
        fault("file" if not given else "files", rule, "give one of file and files")
    for key, other in (("fit", "score"), ("score", "fit")):
        if key in table and other not in table:
            fault(other, f"is missing beside {key}", "give both, or neither")
    if table.get("swap") is True and "fit" not in table:
        fault("swap", "needs fit and score", "say which rows change places")
    block, files = table.get("block"), table.get("files")
    if isinstance(block, str) and isinstance(files, str) and block not in _FIELD.findall(files):
        rule = f"{block!r} is no group of the file names {shown(files)}"
        fault("block", rule, f"write {{{block}}} where its label stands")
