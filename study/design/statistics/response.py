"""The tables ``[[response]]``: what a study answers, and the smallest difference that matters."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from study import units
from study.design.diagnostics import Faults, noted
from study.design.sections.simulated import AT_DISPLACEMENT
from study.design.spec import Practical, Response
from study.design.study_file import ResponseTable, response_unit
from study.setup.quantity import number, shown
from study.setup.section import Bad

_DIMENSION = {
    "N": "force",
    "kPa": "pressure",
    "s": "time",
    "mm": "length",
    "N/mm": "stiffness",
    "N mm": "work",
}


def responses_from(tables: Sequence[ResponseTable], faults: Faults) -> tuple[Response, ...]:
    """Responses with their units; a faulty one has no name.

    Parameters
    ----------
    tables : sequence of ResponseTable
        As read.
    faults : Faults
        Where faults go.
    """
    found = [_response(table, f"response[{i}]", faults) for i, table in enumerate(tables)]
    given = [response.name for response in found if response.name]
    for name in sorted({n for n in given if given.count(n) > 1}):
        faults.add("response", f"{name} stands {given.count(name)} times", "once is enough")
    return tuple(found)


def _response(table: ResponseTable, where: str, faults: Faults) -> Response:
    name = _name(table, where, faults)
    unit, practical = (response_unit(name) if name else None) or "", None
    if name and table.practical is not None:
        read = partial(_practical, unit)
        practical = noted(read, table.practical, f"{where}.practical", faults)
    return Response(name, unit, practical, table.transform or "none")


def _name(table: ResponseTable, where: str, faults: Faults) -> str:
    """Name of a response; one at a displacement carries it, so that every table says it."""
    name, place = table.name or "", table.displacement
    if name in AT_DISPLACEMENT:
        at = f"{where}.displacement"
        if place is None:
            if all(fault.where != at for fault in faults):
                faults.add(at, "is missing", 'for example displacement = "2 mm"')
            return ""
        return f"{name}_{place:g}_mm"
    if name and place is not None:
        rule = f"{name} is not taken at a displacement"
        mend = f"leave it out, or ask for {' or '.join(AT_DISPLACEMENT)}"
        faults.add(f"{where}.displacement", rule, mend)
    return name


def _practical(unit: str, value: object) -> Practical:
    """Read the smallest difference that matters, in the response's unit or "5 % of mean"."""
    example = {"%": "2 pp", "": "0.1"}.get(unit, f"0.05 {unit}")
    mend = f'write, for example, "{example}" or "5 % of mean"'
    if unit == "" and isinstance(value, (int, float)):
        return Practical(number(0)(value), unit, relative=False)
    if not isinstance(value, str):
        raise Bad(f"needs a unit, got {shown(value)}", mend)
    amount, written = units.split(value)
    if amount <= 0:
        raise Bad(f"must be positive, got {shown(value)}", mend)
    if written == "% of mean":
        return Practical(amount, "%", relative=True)
    if unit == "%" and written == "pp":
        return Practical(amount, "pp", relative=False)
    if unit not in _DIMENSION:
        raise Bad(f"is not in percentage points, got {shown(value)}", mend)
    inside = units.parse(value, _DIMENSION[unit])
    return Practical(units.to_display(inside, "MPa")[0] if unit == "kPa" else inside, unit, False)
