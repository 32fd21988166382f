"""The table ``[measurements]``: where measured curves are and how rows become curves."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from study import units
from study.design.reader import (
    REQUIRED,
    Bad,
    Faults,
    Section,
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
from study.errors import UnitError

KEYS = (
    *("file", "files", "columns", "units", "block", "average", "range", "points"),
    *("fit", "score", "swap", "zero", "toe", "sign", "decimal", "citation"),
)

#: keys that may differ between cells
FACTOR_KEYS = ("file", "files", "range", "points", "zero", "toe", "sign")
DIMENSIONS: Mapping[str, str] = {"displacement": "length", "force": "force"}
MAX_POINTS = 100_000
_FIELD = re.compile(r"\{([^{}]*)\}")


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
    section = Section(table, path, faults)
    values: dict[str, Any] = {
        "file": section.take("file", csv_path, None),
        "files": section.take("files", csv_pattern, None),
        "columns": _by_quantity(section, "columns", name),
        "units": _units(section),
        "block": section.take("block", name, None),
        "average": section.take("average", names, ()),
        "range": section.take("range", read_range, None),
        "points": section.take("points", integer(2, MAX_POINTS), 200),
        "fit": section.take("fit", rows, None),
        "score": section.take("score", rows, None),
        "swap": section.take("swap", flag, False),
        "zero": section.take("zero", choice("none", "first", "fit"), "none"),
        "toe": section.take("toe", quantity("force"), None),
        "sign": section.take("sign", choice("positive", "negative"), "positive"),
        "decimal": section.take("decimal", choice(".", ","), "."),
        "citation": section.take("citation", text, ""),
    }
    section.finish(KEYS)
    _check_together(section)
    return MeasurementSpec(**values) if len(faults) == before else None


def _check_together(section: Section) -> None:
    given = [key for key in ("file", "files") if key in section]
    if len(given) != 1 and not section.broken:
        rule = "stands beside file" if given else "is missing"
        section.fault("file" if not given else "files", rule, "give one of file and files")
    for key, other in (("fit", "score"), ("score", "fit")):
        if key in section and other not in section:
            section.fault(other, f"is missing beside {key}", "give both, or neither")
    if section.table.get("swap") is True and "fit" not in section:
        section.fault("swap", "needs fit and score", "say which rows change places")
    block, files = section.table.get("block"), section.table.get("files")
    if isinstance(block, str) and isinstance(files, str) and block not in _FIELD.findall(files):
        rule = f"{block!r} is no group of the file names {shown(files)}"
        section.fault("block", rule, f"write {{{block}}} where its label stands")


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


def _by_quantity(section: Section, key: str, read: Any) -> dict[str, str] | None:
    section.known.append(key)
    if key not in section:
        example = '{ displacement = "displacement_mm", force = "force_N" }'
        section.fault(key, "is missing", f"for example {key} = {example}")
        return None
    inner = Section(section.table[key], section.where(key), section.faults)
    values = {k: inner.take(k, read, REQUIRED, "displacement and force") for k in DIMENSIONS}
    inner.finish()
    return values


def _units(section: Section) -> dict[str, str] | None:
    section.known.append("units")
    if "units" not in section:
        example = 'units = { displacement = "mm", force = "N" }'
        section.fault("units", "is missing", f"for example {example}")
        return None
    inner = Section(section.table["units"], section.where("units"), section.faults)
    values = {k: inner.take(k, _unit(d)) for k, d in DIMENSIONS.items()}
    inner.finish()
    return values


def _unit(dimension: str) -> Any:
    def read(value: Any) -> str:
        unit = text(value)
        units.unit_factor(unit, dimension)
        return unit

    return read
