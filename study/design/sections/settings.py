"""The tables that say what is asked of a study: responses, analysis, convergence, report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Annotated, Any

from study import units
from study.design import overlay
from study.design.diagnostics import Faults, noted, read_table
from study.design.reader import Section
from study.design.spec import Practical, Response
from study.design.study_file import RESPONSES, Analysis, Converge, Replicates, Report
from study.errors import nearest
from study.material.registry import is_constant, is_dimensionless
from study.setup.quantity import integer, number, quantity, shown
from study.setup.section import Bad, Reads, section, values_of
from study.setup.text import choice, slug, text

_DIMENSION = {"N": "force", "kPa": "pressure", "s": "time"}
MAX_RESPONSES = 50


def response_unit(name: str) -> str | None:
    """Find the unit of a response: "" for a plain number, None if there is no such response."""
    if name in RESPONSES:
        return RESPONSES[name]
    if not is_constant(name):
        return None
    return "" if is_dimensionless(name) else "kPa"


def _assumed(value: Any) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
        raise Bad(f"must be a list of keys, got {shown(value)}", 'for example ["test.interface"]')
    for key in value:
        if key not in overlay.TABLES and not overlay.may_vary(key):
            raise Bad(f"names no input: {shown(key)}", overlay.suggestion(key))
    return tuple(value)


def _response_name(value: Any) -> str:
    if not isinstance(value, str) or response_unit(value) is None:
        valid = (*RESPONSES, "or a constant such as C10")
        raise Bad(f"unknown response {shown(value)}", nearest(str(value)[:80], valid))
    return value


@section
class Study:
    """Name, question, seed and what is assumed."""

    name: Annotated[str, Reads(slug)] = ""
    question: Annotated[str, Reads(text)] = ""
    seed: Annotated[int, Reads(integer(0, 2**32 - 1))] = 2011
    assumed: Annotated[tuple[str, ...], Reads(_assumed)] = ()


@section
class ResponseTable:
    """One ``[[response]]``; the unit of ``practical`` is that of the response."""

    name: Annotated[str, Reads(_response_name, mend="for example relative_rms_force_error")]
    practical: Annotated[Any, Reads(lambda value: value)] = None
    transform: Annotated[str, Reads(choice("none", "log"))] = "none"


def read_study(table: Any, faults: Faults, default_name: str) -> dict[str, Any]:
    """Read ``[study]``: name, question, seed, assumed."""
    found = values_of(read_table(Study, {} if table is None else table, "study", faults))
    if not isinstance(table, Mapping) or "name" not in table:
        found["name"] = default_name
    return found


def read_responses(value: Any, faults: Faults) -> tuple[Response, ...]:
    """Read every ``[[response]]``."""
    if not isinstance(value, list) or not value or len(value) > MAX_RESPONSES:
        rule = "is missing" if value is None else f"must be tables, got {shown(value)}"
        faults.add("response", rule, '[[response]] with name = "relative_rms_force_error"')
        return ()
    found = []
    for i, table in enumerate(value):
        path = f"response[{i}]"
        one = read_table(ResponseTable, table, path, faults)
        unit = (response_unit(one.name) if one.name else None) or ""
        practical = None
        if one.name and one.practical is not None:
            read = partial(read_practical, unit=unit)
            practical = noted(read, one.practical, f"{path}.practical", faults)
        found.append(Response(one.name or "", unit, practical, one.transform or "none"))
    given = [r.name for r in found if r.name]
    for name in sorted({n for n in given if given.count(n) > 1}):
        faults.add("response", f"{name} stands {given.count(name)} times", "once is enough")
    return tuple(found)


def read_practical(value: Any, unit: str) -> Practical:
    """Read the smallest difference that matters, in the response's unit or "5 % of mean".

    Parameters
    ----------
    value : str
        Raw value.
    unit : str
        Of the response.
    """
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


def read_analysis(table: Any, faults: Faults, factors: Sequence[str]) -> Analysis:
    """Read ``[analysis]``; terms are names of factors, never code."""
    found = read_table(Analysis, {} if table is None else table, "analysis", faults)
    model = noted(partial(_model, factors=factors), found.model, "analysis.model", faults)
    for name, _ in found.roles or ():
        if name not in factors:
            faults.add("analysis.roles", f"no factor {shown(name)}", nearest(name[:80], factors))
    return replace(found, model=model)


def _model(value: Any, factors: Sequence[str]) -> str | int | tuple[str, ...]:
    if value == "full":
        return "full"
    if isinstance(value, list):
        if not value or len(value) > 1000:
            raise Bad("must list 1 to 1000 terms")
        return tuple(dict.fromkeys(_term(term, factors) for term in value))
    if isinstance(value, int) and not isinstance(value, bool):
        return int(integer(1, max(1, len(factors)))(value))
    raise Bad(f'must be "full", a number or a list of terms, got {shown(value)}')


def _term(value: Any, factors: Sequence[str]) -> str:
    parts = [p.strip() for p in value.split(":")] if isinstance(value, str) else [value]
    for part in parts:
        if part not in factors:
            raise Bad(f"no factor {shown(part)}", nearest(str(part)[:80], factors))
    if len(set(parts)) < len(parts):
        raise Bad(f"a factor stands twice in {shown(value)}")
    return ":".join(sorted(parts, key=list(factors).index))


def read_uncertainty(table: Any, faults: Faults) -> dict[str, float]:
    """Read ``[uncertainty]``: dotted key -> standard uncertainty in internal units."""
    reading = Section({} if table is None else table, "uncertainty", faults)
    found: dict[str, float] = {}
    for key in reading.table:
        kind = overlay.dimension(key)
        if kind is None:
            reading.known.append(key)
            reading.fault(key, "names no input with a value", overlay.suggestion(key))
            continue
        read = number(0) if kind == "number" else quantity(kind)
        found[key] = reading.take(key, read)
    return {k: v for k, v in found.items() if v is not None}


def read_converge(table: Any, faults: Faults) -> Converge:
    """Read ``[converge]``."""
    return read_table(Converge, {} if table is None else table, "converge", faults)


def read_replicates(table: Any, faults: Faults) -> Replicates:
    """Read ``[replicates]``: ``mesh_seeds`` or ``noise``, each the number of repeats of a cell."""
    found = read_table(Replicates, {} if table is None else table, "replicates", faults)
    if isinstance(table, Mapping) and {"mesh_seeds", "noise"} <= set(table):
        rule = "mesh_seeds and noise are two error terms, with different questions"
        faults.add("replicates", rule, "give one of them, and the other in a study of its own")
    elif isinstance(table, Mapping) and not table:
        faults.add("replicates", "is empty", "write mesh_seeds = 5 or noise = 200")
    return found


def read_report(table: Any, faults: Faults) -> Report:
    """Read ``[report]``."""
    return read_table(Report, {} if table is None else table, "report", faults)
