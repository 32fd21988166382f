"""The tables that say what is asked of a study: responses, analysis, convergence, report."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from study import units
from study.design import keys
from study.design.reader import (
    Bad,
    Faults,
    Read,
    Section,
    choice,
    integer,
    number,
    quantity,
    shown,
    slug,
    text,
)
from study.design.spec import (
    AnalysisSpec,
    ConvergeSpec,
    Practical,
    Replicates,
    ReportSpec,
    Response,
)
from study.errors import nearest

#: unit of every response; constants are reported in kPa, exponents plain
RESPONSES = {
    "relative_rms_force_error": "%",
    "rms_force_error": "N",
    "peak_force_error": "N",
    "work_error": "%",
    "mu0": "kPa",
    "seconds": "s",
}

#: responses that compare with measured curves
SCORED = ("relative_rms_force_error", "rms_force_error", "peak_force_error", "work_error")
_CONSTANT = re.compile(r"C\d{2,3}|youngs_modulus|mu[1-9]|alpha[1-9]")
_DIMENSION = {"N": "force", "kPa": "pressure", "s": "time"}
QUANTITIES = ("peak_force", "work", "curve_rms", *RESPONSES)
FORMATS = ("html", "pdf", "tex", "csv")
MAX_RESPONSES = 50

#: least and most meshes of a cell (below five their scatter is not known well enough), and
#: resamples of a fit (the scatter of 20 is known to 16 %, of 200 to 5 %)
SEEDS = (5, 1000)
RESAMPLES = (20, 10_000)


def response_unit(name: str) -> str | None:
    """Find the unit of a response: "" for a plain number, None if there is no such response."""
    if name in RESPONSES:
        return RESPONSES[name]
    if not _CONSTANT.fullmatch(name):
        return None
    return "" if name.startswith("alpha") else "kPa"


def read_study(table: Any, faults: Faults, default_name: str) -> dict[str, Any]:
    """Read ``[study]``: name, question, seed, assumed."""
    section = Section({} if table is None else table, "study", faults)
    values = {
        "name": section.take("name", slug, default_name),
        "question": section.take("question", text, ""),
        "seed": section.take("seed", integer(0, 2**32 - 1), 2011),
        "assumed": section.take("assumed", _assumed, ()),
    }
    section.finish()
    return values


def _assumed(value: Any) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
        raise Bad(f"must be a list of keys, got {shown(value)}", 'for example ["test.interface"]')
    for key in value:
        if key not in keys.TABLES and not keys.may_vary(key):
            raise Bad(f"names no input: {shown(key)}", keys.suggestion(key))
    return tuple(value)


def read_responses(value: Any, faults: Faults) -> tuple[Response, ...]:
    """Read every ``[[response]]``."""
    if not isinstance(value, list) or not value or len(value) > MAX_RESPONSES:
        rule = "is missing" if value is None else f"must be tables, got {shown(value)}"
        faults.add("response", rule, '[[response]] with name = "relative_rms_force_error"')
        return ()
    found = []
    for i, table in enumerate(value):
        section = Section(table, f"response[{i}]", faults)
        name = section.take("name", _response_name, mend="for example relative_rms_force_error")
        unit = (response_unit(name) if name else None) or ""
        practical = section.take("practical", _practical_in(unit if name else None), None)
        transform = section.take("transform", choice("none", "log"), "none")
        section.finish()
        found.append(Response(name or "", unit, practical, transform or "none"))
    given = [r.name for r in found if r.name]
    for name in sorted({n for n in given if given.count(n) > 1}):
        faults.add("response", f"{name} stands {given.count(name)} times", "once is enough")
    return tuple(found)


def _practical_in(unit: str | None) -> Read:
    return lambda value: None if unit is None else read_practical(value, unit)


def _response_name(value: Any) -> str:
    if not isinstance(value, str) or response_unit(value) is None:
        valid = (*RESPONSES, "or a constant such as C10")
        raise Bad(f"unknown response {shown(value)}", nearest(str(value)[:80], valid))
    return value


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


def read_analysis(table: Any, faults: Faults, factors: Sequence[str]) -> AnalysisSpec:
    """Read ``[analysis]``; terms are names of factors, never code."""
    section = Section({} if table is None else table, "analysis", faults)
    spec = AnalysisSpec(
        model=section.take("model", lambda value: _model(value, factors), "full"),
        type=section.take("type", choice("I", "II", "III"), "II"),
        error=section.take("error", choice("auto", "pooled", "own", "replicates"), "auto"),
        alpha=section.take("alpha", number(0, 1), 0.05),
    )
    section.finish()
    return spec


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
    section = Section({} if table is None else table, "uncertainty", faults)
    found: dict[str, float] = {}
    for key in section.table:
        kind = keys.dimension(key)
        if kind is None:
            section.known.append(key)
            section.fault(key, "names no input with a value", keys.suggestion(key))
            continue
        read = number(0) if kind == "number" else quantity(kind)
        found[key] = section.take(key, read)
    return {k: v for k, v in found.items() if v is not None}


def read_converge(table: Any, faults: Faults) -> ConvergeSpec:
    """Read ``[converge]``."""
    section = Section({} if table is None else table, "converge", faults)
    spec = ConvergeSpec(
        ratio=section.take("ratio", number(1, 10), 1.5) or 1.5,
        levels=section.take("levels", integer(2, 10), 3),
        qoi=section.take("qoi", choice(*QUANTITIES), "peak_force"),
        tolerance=section.take("tolerance", _tolerance, None),
        budget_s=section.take("budget", quantity("time"), None),
    )
    section.finish()
    return spec


def _tolerance(value: Any) -> float:
    if isinstance(value, str):
        percent = units.parse_percent(value)
        if not 0 < percent < 100:
            raise Bad(f"must be between 0 % and 100 %, got {shown(value)}")
        return percent / 100
    return float(number(0, 1, mend='for example "1 %"')(value))


def read_replicates(table: Any, faults: Faults) -> Replicates:
    """Read ``[replicates]``: ``mesh_seeds`` or ``noise``, each the number of repeats of a cell."""
    section = Section({} if table is None else table, "replicates", faults)
    seeds = section.take("mesh_seeds", _count(*SEEDS, "the scatter of the mesh is not known"), 0)
    noise = section.take("noise", _count(*RESAMPLES, "the scatter of the fits is not known"), 0)
    section.finish()
    if "mesh_seeds" in section and "noise" in section:
        rule = "mesh_seeds and noise are two error terms, with different questions"
        faults.add("replicates", rule, "give one of them, and the other in a study of its own")
    elif table is not None and not section.broken and not section.table:
        faults.add("replicates", "is empty", "write mesh_seeds = 5 or noise = 200")
    return Replicates(seeds or 0, noise or 0)


def _count(low: int, high: int, why: str) -> Read:
    """Reader of a number of repeats; below ``low`` the reason is told."""
    whole = integer(0, high)

    def read(value: Any) -> int:
        count: int = whole(value)
        if count < low:
            raise Bad(f"must be at least {low}, got {shown(value)}: with fewer {why}")
        return count

    return read


def read_report(table: Any, faults: Faults) -> ReportSpec:
    """Read ``[report]``."""
    section = Section({} if table is None else table, "report", faults)
    formats = section.take("format", _formats, ("html",))
    section.finish()
    return ReportSpec(formats or ("html",))


def _formats(value: Any) -> tuple[str, ...]:
    items = value if isinstance(value, list) else [value]
    return tuple(dict.fromkeys(choice(*FORMATS)(item) for item in items)) or ("html",)
