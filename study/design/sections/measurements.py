"""The table ``[measurements]``: its keys read, and checked against one another."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from study.design.diagnostics import Faults, Table, read_table
from study.measurement.marker_section import MarkerSpec
from study.measurement.quantities import KINEMATIC, KINETIC
from study.measurement.section import MeasurementSpec, groups_of
from study.setup.quantity import shown


def measurements_from(
    table: object, faults: Faults, path: str = "measurements"
) -> MeasurementSpec | None:
    """Read where measured curves are; None where a fault was found.

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
    found = read_table(MeasurementSpec, table, path, faults)
    if isinstance(table, Mapping):
        _check_together(table, path, faults)
    return None if len(faults) > before else found


def markers_from(table: object, faults: Faults, path: str = "markers") -> MarkerSpec | None:
    """Read where markers inside a specimen are; None without them, or where a fault was found.

    Parameters
    ----------
    table : mapping or None
        The table as written.
    faults : Faults
        Where faults go.
    path : str
        Of the table.
    """
    if table is None:
        return None
    before = len(faults)
    found = read_table(MarkerSpec, table, path, faults)
    if len(faults) == before and found.fit and found.layer is None:
        faults.add(f"{path}.layer", "is missing beside fit", "name the column of the layers")
    return None if len(faults) > before else found


def _check_columns(table: Table, fault: Callable[[str, str, str], None]) -> None:
    """One column says how far, one how hard, and each has its unit."""
    columns, units = table.get("columns"), table.get("units")
    if not isinstance(columns, Mapping):
        return
    for quantities, usual in ((KINEMATIC, "displacement"), (KINETIC, "force")):
        given = [key for key in quantities if key in columns]
        if not given:
            fault(f"columns.{usual}", "is missing", "displacement and force")
        if len(given) > 1:
            rule = f"stands beside {given[0]}"
            fault(f"columns.{given[1]}", rule, f"give one of {', '.join(quantities)}")
        wanted = given[0] if given else usual
        if isinstance(units, Mapping) and wanted not in units:
            fault(f"units.{wanted}", "is missing", f'for example {wanted} = "{_UNITS[wanted]}"')
    if isinstance(units, Mapping) and "time" in columns and "time" not in units:
        fault("units.time", "is missing", 'for example time = "s"')


_UNITS = {
    **dict.fromkeys(KINEMATIC, "1"),
    **dict.fromkeys(KINETIC, "kPa"),
    "displacement": "mm",
    "force": "N",
}


def _check_course(table: Table, fault: Callable[[str, str, str], None]) -> None:
    """Keep rules that take rows out, or move them, from tests whose course in time matters."""
    columns = table.get("columns")
    if not isinstance(columns, Mapping) or "time" not in columns:
        return
    asked = {
        "points": table.get("points", "raw") != "raw",
        "range": "range" in table,
        "toe": "toe" in table,
        "zero": table.get("zero") == "fit",
    }
    mends = {"points": 'write points = "raw"', "zero": 'write zero = "first"'}
    rule = "has no meaning for a test with a column of time, whose rows all count"
    for key in (key for key, given in asked.items() if given):
        fault(key, rule, mends.get(key, "leave it out"))


def _check_together(table: Table, path: str, faults: Faults) -> None:
    def fault(key: str, rule: str, mend: str) -> None:
        faults.add(f"{path}.{key}", rule, mend)

    _check_columns(table, fault)
    _check_course(table, fault)
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
    if isinstance(block, str) and isinstance(files, str) and block not in groups_of(files):
        rule = f"{block!r} is no group of the file names {shown(files)}"
        fault("block", rule, f"write {{{block}}} where its label stands")
