"""The tables ``[[response]]``: what a study answers, and the smallest difference that matters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

from study.ground import units
from study.ground.errors import UnitError, nearest
from study.harness.design import overlay
from study.harness.design.diagnostics import Faults, Table, entries, noted
from study.harness.design.forward_section import TAKEN
from study.harness.design.material_table import DISTRIBUTION_KEYS, PARAMETERS, InputDistribution
from study.harness.design.parameters import number_in
from study.harness.design.spec import Factor, Practical, ResponseSpec, Span
from study.harness.design.study_file import (
    AT_DISPLACEMENT,
    RESPONSES,
    SIMULATED,
    ResponseTable,
    is_simulated,
    response_unit,
)
from study.mechanics.setup.declaration import Bad, choice, number, quantity, shown

_DIMENSION = {
    "N": "force",
    "kPa": "pressure",
    "s": "time",
    "mm": "length",
    "N/mm": "stiffness",
    "N mm": "work",
    "mm^2": "area",
}


def responses_from(
    tables: Sequence[ResponseTable], declared: Mapping[str, str], alone: bool, faults: Faults
) -> tuple[ResponseSpec, ...]:
    """Responses with their units; a faulty one has no name.

    ``declared`` has the units of the values that a program leaves; a function of parameters alone
    may return others, whose unit stands in the table of the response.
    """
    responses = [
        _response(table, f"response[{i}]", declared, alone, faults)
        for i, table in enumerate(tables)
    ]
    given = [response.name for response in responses if response.name]
    for name in sorted({n for n in given if given.count(n) > 1}):
        faults.add("response", f"{name} stands {given.count(name)} times", "once is enough")
    return tuple(responses)


def _response(
    table: ResponseTable, where: str, declared: Mapping[str, str], alone: bool, faults: Faults
) -> ResponseSpec:
    name, unit = _name(table, where, faults), None
    if name in declared:
        unit = declared[name]
    elif name and (not alone or is_simulated(name) or name == "seconds"):
        unit = response_unit(name)
        if unit is None:
            valid = (*declared, *RESPONSES, *SIMULATED, "or a constant such as C10")
            faults.add(
                f"{where}.name", f"unknown response {shown(name)}", nearest(name[:80], valid)
            )
            name = ""
    elif name in TAKEN:
        rule = f"{name!r} is a column of the table of cases"
        faults.add(f"{where}.name", rule, f"call it, for example, {name}_value")
        name = ""
    if table.unit is not None and name:
        if unit is not None and unit != table.unit:
            rule = f"{name} is in {unit or 'no unit'}, not in {table.unit or 'no unit'}"
            faults.add(f"{where}.unit", rule, "leave it out, or name the value's own unit")
        unit = table.unit
    unit, practical = unit or "", None
    if name and table.practical is not None:
        read = partial(_practical, unit)
        practical = noted(read, table.practical, f"{where}.practical", faults)
    return ResponseSpec(name, unit, practical, table.transform or "none")


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
    if unit == "%":
        raise Bad(f"is not in percentage points, got {shown(value)}", mend)
    if unit not in _DIMENSION:
        return Practical(number_in(value, unit), unit, relative=False)
    inside = units.parse(value, _DIMENSION[unit])
    return Practical(units.to_display(inside, "MPa")[0] if unit == "kPa" else inside, unit, False)


# Table ``[uncertainty]``: standard uncertainties of inputs, and distributions over ranges.
#     [uncertainty]
#     specimen.radius = "0.1 mm"         # a standard uncertainty: normal about the file's value
#     material.C10 = { distribution = "normal", mean = "7 kPa", sd = "0.5 kPa" }
#     material.C20 = { distribution = "lognormal", median = "1 kPa", factor = 1.3 }
#     specimen.height = { distribution = "uniform", low = "19 mm", high = "21 mm" }
#     test.indenter.tip_radius = { distribution = "triangular", low = .., mode = .., high = .. }

#: most of a distribution that may lie outside of the range that is run, and is cut off
MOST_OUTSIDE = 0.05

_EXAMPLE = '{ distribution = "normal", mean = "7 kPa", sd = "0.5 kPa" }'


def uncertainty_from(
    table: object, factors: Sequence[Factor], config: Table, faults: Faults
) -> tuple[dict[str, float], dict[str, InputDistribution]]:
    """Read ``[uncertainty]``, dotted keys already joined."""
    plain: dict[str, float] = {}
    distributions: dict[str, InputDistribution] = {}
    spans = {factor.name: factor.span for factor in factors if factor.span is not None}
    for key, raw in _grouped(entries(table, "uncertainty", faults)).items():
        where, kind, span = f"uncertainty.{key}", overlay.dimension(key), spans.get(key)
        if kind is None:
            faults.add(where, "names no input with a value", overlay.suggestion(key))
            continue
        if isinstance(raw, Mapping):
            read = _distribution(key, raw, kind, span, list(spans), faults)
        else:
            read_size = number(0) if kind == "number" else quantity(kind)
            if kind == overlay.ANY:
                read_size = partial(number_in, unit="" if span is None else span.unit)
            size = noted(read_size, raw, where, faults)
            if size is not None:
                plain[key] = size
            read = None if size is None or span is None else _about(key, size, kind, span, config)
        if read is not None and read.outside > MOST_OUTSIDE:
            rule = (
                f"{100 * read.outside:.0f} % of it lies outside the range that is run, "
                f"{read.low:g} to {read.high:g}"
            )
            faults.add(where, rule, "widen the range in [factors], or narrow the distribution")
        elif read is not None:
            distributions[key] = read
    return plain, distributions


def _grouped(table: Table) -> dict[str, object]:
    """Join the keys of a distribution, which joining dotted keys took apart."""
    joined: dict[str, object] = {}
    parts: dict[str, dict[str, object]] = {}
    for key, value in table.items():
        name, _, last = key.rpartition(".")
        if name and last in DISTRIBUTION_KEYS and not overlay.may_vary(key):
            joined[name] = parts.setdefault(name, {})
            parts[name][last] = value
        else:
            joined[key] = value
    return joined


def _distribution(
    key: str, raw: Table, kind: str, span: Span | None, ranges: Sequence[str], faults: Faults
) -> InputDistribution | None:
    where = f"uncertainty.{key}"
    if span is None:
        rule = "has a distribution and is no range of [factors], which alone a surface knows"
        mend = nearest(key, ranges) if ranges else "give it a range, or a standard uncertainty"
        faults.add(where, rule, mend)
        return None
    word = noted(choice(*PARAMETERS), raw.get("distribution"), f"{where}.distribution", faults)
    if word is None:
        return None
    needed = PARAMETERS[word]
    for name in (n for n in needed if n not in raw):
        faults.add(f"{where}.{name}", "is missing", f"for example {_EXAMPLE}")
    for name in (n for n in raw if n not in (*needed, "distribution")):
        rule = f"is no number of a {word} distribution"
        faults.add(f"{where}.{name}", rule, nearest(name, needed))
    if set(raw) != {"distribution", *needed}:
        return None
    values = [_value(raw[name], name, kind, span, f"{where}.{name}", faults) for name in needed]
    if any(value is None for value in values):
        return None
    nums = tuple(value for value in values if value is not None)
    if word in ("uniform", "triangular") and (list(nums) != sorted(nums) or nums[0] == nums[-1]):
        faults.add(where, f"must rise, got {', '.join(shown(raw[n]) for n in needed)}",
                   "from low to high")  # fmt: skip
        return None
    return InputDistribution(word, nums, span.low, span.high)


def _in_unit(kind: str, unit: str) -> Callable[[object], float]:
    """Reader of a value of some dimension in a unit of it."""
    if kind == overlay.ANY:
        return partial(number_in, unit=unit)
    if kind == "number":
        return number()
    return lambda value: units.parse(value, kind) / units.parse(f"1 {unit}", kind)


def _value(
    raw: object, name: str, kind: str, span: Span, where: str, faults: Faults
) -> float | None:
    """One number of a distribution, in the unit of the range."""
    if name == "factor":
        return noted(number(1.0), raw, where, faults)
    positive = name in ("sd", "median")
    if kind == "number":
        return noted(number(0.0) if positive else number(), raw, where, faults)
    size = noted(_in_unit(kind, span.unit), raw, where, faults)
    if size is not None and positive and size <= 0:
        faults.add(where, f"must be above 0, got {shown(raw)}")
        return None
    return size


def _about(key: str, size: float, kind: str, span: Span, config: Table) -> InputDistribution:
    """Make a normal distribution about the value of the file, or the middle of the range."""
    plain = kind in ("number", overlay.ANY)  # of a parameter it was read in the range's unit
    scale = 1.0 if plain else units.parse(f"1 {span.unit}", kind)
    return InputDistribution(
        "normal", (usual_value(key, kind, span, config), size / scale), span.low, span.high
    )


def usual_value(key: str, kind: str, span: Span, config: Table) -> float:
    """Value that a file gives to a range beside its ends, else the middle of the range."""
    node: object = config
    for part in key.split("."):
        node = node.get(part) if isinstance(node, Mapping) else None
    middle = span.at(0.5)
    if isinstance(node, bool) or not isinstance(node, str | int | float):
        return middle
    try:
        value = _in_unit(kind, span.unit)(node)
    except (UnitError, ValueError):  # told where the value stands
        return middle
    return value if span.low <= value <= span.high else middle
