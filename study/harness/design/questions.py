"""What a study is asked: responses, uncertain inputs, expectations, terms of its analysis."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Annotated

import numpy as np

from study.external.forward_model import TAKEN, number_in
from study.ground import units
from study.ground.contrast import Expected, Threshold
from study.ground.declaration import (
    AsWritten,
    Bad,
    Faults,
    Reads,
    Table,
    as_written,
    choice,
    entries,
    flatten,
    integer,
    is_known,
    noted,
    number,
    quantity,
    read_table,
    section,
    shown,
    text,
    with_values,
)
from study.ground.errors import UnitError, nearest
from study.ground.tabular import NUMBER
from study.harness.design.generators import model_columns
from study.harness.design.layouts import word_of, words_of
from study.harness.design.spec import Analysis, Factor, ResponseSpec, Scheme, Terms, grouped
from study.simulation import overlay
from study.simulation.response import (
    AT_DISPLACEMENT,
    RESPONSES,
    SIMULATED,
    is_simulated,
    response_unit,
)
from study.statistics.surfaces.surface_factors import (
    DISTRIBUTION_KEYS,
    PARAMETERS,
    InputDistribution,
    NumericFactor,
)

# The tables ``[[response]]``: what is answered, and the smallest difference that matters.

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
    tables: Sequence[ResponseSpec], declared: Mapping[str, str], alone: bool, faults: Faults
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
    table: ResponseSpec, where: str, declared: Mapping[str, str], alone: bool, faults: Faults
) -> ResponseSpec:
    name, unit = _name(table, where, faults), None
    if name in declared:
        unit = declared[name]
    elif name and (not alone or is_simulated(name) or name == "seconds"):
        unit = response_unit(name)
        if unit is None:
            valid = (*declared, *RESPONSES, *SIMULATED, "or a constant such as C10")
            rule = f"unknown response {shown(name)}"
            faults.add(f"{where}.name", rule, nearest(name[:80], valid))
            name = ""
    elif name in TAKEN:
        rule = f"{name!r} is a column of the table of cases"
        faults.add(f"{where}.name", rule, f"call it, for example, {name}_value")
        name = ""
    if is_known(table.unit) and name:
        if unit is not None and unit != table.unit:
            rule = f"{name} is in {unit or 'no unit'}, not in {table.unit or 'no unit'}"
            faults.add(f"{where}.unit", rule, "leave it out, or name the value's own unit")
        unit = table.unit
    unit, practical = unit or "", None
    if name and table.practical is not None:
        read = partial(_practical, unit)
        practical = noted(read, table.practical, f"{where}.practical", faults)
    return with_values(table, name=name, unit=unit, practical=practical)


def _name(table: ResponseSpec, where: str, faults: Faults) -> str:
    """Name of a response; one at a displacement carries it, so that every table says it."""
    name, displacement_mm = table.name or "", table.displacement
    if name in AT_DISPLACEMENT:
        at = f"{where}.displacement"
        if displacement_mm is None:
            if all(fault.where != at for fault in faults):
                faults.add(at, "is missing", 'for example displacement = "2 mm"')
            return ""
        return f"{name}_{displacement_mm:g}_mm"
    if name and displacement_mm is not None:
        rule = f"{name} is not taken at a displacement"
        mend = f"leave it out, or ask for {' or '.join(AT_DISPLACEMENT)}"
        faults.add(f"{where}.displacement", rule, mend)
    return name


def _practical(unit: str, value: object) -> Threshold:
    """Read the smallest difference that matters, in the response's unit or "5 % of mean"."""
    example = {"%": "2 pp", "": "0.1"}.get(unit, f"0.05 {unit}")
    mend = f'write, for example, "{example}" or "5 % of mean"'
    if unit == "" and isinstance(value, str) and NUMBER.fullmatch(value.strip()):
        value = float(value)
    if unit == "" and isinstance(value, (int, float)):
        return Threshold(number(0)(value))
    if not isinstance(value, str):
        raise Bad(f"needs a unit, got {shown(value)}", mend)
    try:
        amount, written = units.split(value)
    except UnitError as error:
        raise Bad(error.faults[0].rule, mend) from error
    if amount <= 0:
        raise Bad(f"must be positive, got {shown(value)}", mend)
    if written == "% of mean":
        return Threshold(amount / 100, relative=True)
    if unit == "%" and written == "pp":
        return Threshold(amount)
    if unit == "%":
        raise Bad(f"is not in percentage points, got {shown(value)}", mend)
    if unit not in _DIMENSION:
        return Threshold(number_in(value, unit))
    inside = units.parse(value, _DIMENSION[unit])
    return Threshold(1000.0 * inside if unit == "kPa" else inside)


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
    for key, raw in grouped(entries(table, "uncertainty", faults), DISTRIBUTION_KEYS).items():
        where, kind, span = f"uncertainty.{key}", overlay.dimension(key), spans.get(key)
        if kind is None:
            faults.add(where, "names no input with a value", overlay.suggestion(key))
            continue
        if isinstance(raw, Mapping):
            read = _distribution(key, raw, kind, span, list(spans), faults)
        else:
            in_range = _number_of("sd", kind, "" if span is None else span.unit)
            read_size = in_range if kind in ("number", overlay.ANY) else quantity(kind)
            size, read = noted(read_size, raw, where, faults), None
            if size is not None:
                plain[key] = size
            if size is not None and span is not None:
                about = usual_value(key, kind, span, config), in_range(raw)
                read = InputDistribution("normal", about, span.low, span.high)
        if read is not None and read.outside > MOST_OUTSIDE:
            rule = (
                f"{100 * read.outside:.0f} % of it lies outside the range that is run, "
                f"{read.low:g} to {read.high:g}"
            )
            faults.add(where, rule, "widen the range in [factors], or narrow the distribution")
        elif read is not None:
            distributions[key] = read
    return plain, distributions


def _distribution(
    key: str,
    raw: Table,
    kind: str,
    span: NumericFactor | None,
    ranges: Sequence[str],
    faults: Faults,
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
    values = [
        noted(_number_of(name, kind, span.unit), raw[name], f"{where}.{name}", faults)
        for name in needed
    ]
    nums = tuple(value for value in values if value is not None)
    if len(nums) < len(needed):
        return None
    if word in ("uniform", "triangular") and (list(nums) != sorted(nums) or nums[0] == nums[-1]):
        faults.add(where, f"must rise, got {', '.join(shown(raw[n]) for n in needed)}",
                   "from low to high")  # fmt: skip
        return None
    return InputDistribution(word, nums, span.low, span.high)


def _number_of(name: str, kind: str, unit: str) -> Callable[[object], float]:
    """Reader of a number of a distribution over a range of some dimension, in the range's unit."""
    if name == "factor":
        return number(1.0)
    low = 0.0 if name in ("sd", "median") else -math.inf
    if kind == "number":
        return number(low)

    def read(value: object) -> float:
        if kind == overlay.ANY:
            size = number_in(value, unit)
        else:
            size = units.parse(value, kind) / units.parse(f"1 {unit}", kind)
        if size <= low:
            raise Bad(f"must be above 0, got {shown(value)}")
        return size

    return read


def usual_value(key: str, kind: str, span: NumericFactor, config: Table) -> float:
    """Value that a file gives to a range beside its ends, else the middle of the range."""
    node = overlay.value_at(config, key)
    middle = span.at(0.5)
    if isinstance(node, bool) or not isinstance(node, str | int | float):
        return middle
    try:
        value = _number_of("mean", kind, span.unit)(node)
    except (UnitError, ValueError):  # told where the value stands
        return middle
    return value if span.low <= value <= span.high else middle


# What was expected before the study ran, so that the report can say whether it came true.

MAX_EXPECTED = 50


@section
class Expectation:
    """One ``[[expected]]``: who said it, and of which response; its kind has keys besides."""

    source: Annotated[str, Reads(text)] = ""
    response: AsWritten = None


#: word for every level of a material factor but the linear one
HYPERELASTIC = "hyperelastic"
_LINEAR = "linear-elastic"
_MEND = 'for example matters = "material", or larger = "material" with than = "model.space"'


def expected_from(
    value: object, factors: Sequence[Factor], responses: Sequence[ResponseSpec], faults: Faults
) -> tuple[Expected, ...]:
    """Read every ``[[expected]]``: one kind of :data:`KINDS` each, ``source`` and ``response``."""
    if value is None:
        return ()
    if not isinstance(value, list) or len(value) > MAX_EXPECTED:
        faults.add("expected", f"must be tables, got {shown(value)}", "write [[expected]]")
        return ()
    named, names = {f.name: f for f in factors}, [r.name for r in responses if r.name]
    read = [
        _expected(table, f"expected[{i}]", named, names, faults) for i, table in enumerate(value)
    ]
    return tuple(expectation for expectation in read if expectation is not None)


def _expected(
    table: object, where: str, named: Mapping[str, Factor], responses: Sequence[str], faults: Faults
) -> Expected | None:
    before = faults.mentions
    kinds = [kind for kind in KINDS if isinstance(table, Mapping) and kind in table]
    if isinstance(table, Mapping) and len(kinds) != 1:
        rule = f"must hold one of {', '.join(KINDS)}" + (f", got {len(kinds)}" if kinds else "")
        faults.add(where, rule, _MEND)
    kind, others = kinds[0] if kinds else "", [key for k in kinds[1:] for key in KINDS[k]]
    section = read_table(_SECTIONS.get(kind, Expectation), table, where, faults, others)
    response = responses[0] if responses else ""
    if section.response is not None:
        response = noted(_one_of(responses), section.response, f"{where}.response", faults) or ""
    values = [
        noted(partial(read, named), value, f"{where}.{key}", faults)
        for key, (read, _) in KINDS.get(kind, {}).items()
        if (value := getattr(section, key)) is not None
    ]
    if faults.mentions > before:
        return None
    cells = tuple(value for value in values if isinstance(value, dict))
    names = tuple(name for value in values if isinstance(value, tuple) for name in value)
    return Expected(kind, names, cells, response, section.source)


def _one_of(valid: Sequence[str]) -> Callable[[object], str]:
    def read(value: object) -> str:
        if not isinstance(value, str) or value not in valid:
            raise Bad(f"is none of the study's: {shown(value)}", nearest(str(value)[:80], valid))
        return value

    return read


def _factor(named: Mapping[str, Factor], value: object) -> tuple[str, ...]:
    return (_one_of(list(named))(value),)


def _factors(named: Mapping[str, Factor], value: object) -> tuple[str, ...]:
    if not isinstance(value, list) or len(value) != 2:
        raise Bad(f"must be a list of two factors, got {shown(value)}")
    return tuple(_one_of(list(named))(item) for item in value)


def _cell(named: Mapping[str, Factor], value: object) -> dict[str, str]:
    """Labels of the levels of some factors."""
    if not isinstance(value, Mapping) or not value:
        raise Bad(f"must name levels, got {shown(value)}", '{ material = "neo-hookean" }')
    cell = {}
    for name, label in flatten(value).items():
        factor = named[_one_of(list(named))(name)]
        cell[name] = _one_of(factor.labels)(str(label))
    return cell


def _levels(named: Mapping[str, Factor], value: object) -> dict[str, str]:
    """Levels of one factor, by their labels; the labels are joined by a tab."""
    labels = [value] if isinstance(value, str) else value
    if not isinstance(labels, list) or not labels or not all(isinstance(v, str) for v in labels):
        raise Bad(f"must name levels, got {shown(value)}", 'write "quadratic", or a list of levels')
    for name, factor in named.items():
        if set(labels) <= set(factor.labels):
            return {name: "\t".join(labels)}
        others = [label for label in factor.labels if label != _LINEAR]
        if labels == [HYPERELASTIC] and len(others) < len(factor.labels):
            return {name: "\t".join(others)}
    every = [label for factor in named.values() for label in factor.labels]
    raise Bad(f"are no levels of one factor: {shown(value)}", nearest(str(labels[0])[:80], every))


#: Reader of what is said of factors, and what to write where it is missing; "" where it may be.
Said = tuple[Callable[[Mapping[str, Factor], object], tuple[str, ...] | dict[str, str]], str]

_FACTOR: Said = (_factor, 'name a factor, such as "material"')
_CELL: Said = (_cell, '{ material = "neo-hookean" }')
_LEVELS: Said = (_levels, 'one level or several, such as "quadratic"')
#: keys of every kind, the first of which names it
KINDS: Mapping[str, Mapping[str, Said]] = {
    # a factor has an effect that matters, or a larger one than another factor
    "matters": {"matters": _FACTOR},
    "larger": {"larger": _FACTOR, "than": _FACTOR},
    "interact": {"interact": (_factors, 'two factors, such as ["material", "plates"]')},
    # a cell, mean over all other factors, is the best; two cells differ by less than what matters
    "best": {"best": _CELL},
    "close": {"close": _CELL, "to": _CELL},
    # levels of a factor score better, or need less, than its others, or than those named
    "better": {"better": _LEVELS, "than": (_levels, "")},
    "fewer": {"fewer": _LEVELS, "than": (_levels, "")},
}


def _section_of(keys: Mapping[str, Said]) -> type[Expectation]:
    """Section of a kind: an expectation with the keys of the kind."""
    types = {key: Annotated[object, as_written(mend)] for key, (_, mend) in keys.items()}
    return section(type("Kind", (Expectation,), {"__annotations__": types} | dict.fromkeys(keys)))


_SECTIONS = {kind: _section_of(keys) for kind, keys in KINDS.items()}


# The terms of the analysis: those asked for, or those that a design can tell.

MAX_TERMS = 1000
#: kinds of a design whose cells do not tell every term
_FRACTIONS = ("fractional", "plackett-burman", "d-optimal", "listed")


def analysis_from(
    table: Analysis,
    factors: Sequence[Factor],
    declared: Sequence[str],
    scheme: Scheme,
    faults: Faults,
) -> Analysis:
    """Complete ``[analysis]``: terms are names of factors, never code."""
    model = default_model(scheme, factors)
    if table.model is not None:
        read = partial(_model, declared)
        model = noted(read, table.model, "analysis.model", faults) or model
        if not faults:
            _check_told_apart(model, factors, scheme, faults)
    for name, _ in table.roles or ():
        if name not in declared:
            faults.add("analysis.roles", f"no factor {shown(name)}", nearest(name[:80], declared))
    if table.surface in ("quadratic", "emulator") and all(f.span is None for f in factors):
        mend = 'write one as { low = "28 mm", high = "32 mm" }'
        faults.add("analysis.surface", "no factor is a range", mend)
    if scheme.sequential is not None and table.surface in ("quadratic", "none"):
        rule = "an adaptive design adds cells where an emulator is unsure"
        faults.add("analysis.surface", rule, 'write surface = "emulator", or leave it out')
    for term in table.primary or ():
        noted(partial(_term, factors=declared), term, "analysis.primary", faults)
    return with_values(table, model=model)


def default_model(scheme: Scheme, factors: Sequence[Factor]) -> Terms:
    """Terms that a design can tell, where the file does not ask for others."""
    if scheme.kind == "full":
        terms = terms_of(scheme, factors)
        return "full" if terms is None else terms
    if scheme.terms:
        return scheme.terms
    if scheme.kind == "fractional":
        if scheme.resolution is None:
            return "full"
        return min(max(1, (scheme.resolution - 1) // 2), len(factors))  # free of one another
    return 1


def _model(factors: Sequence[str], value: object) -> Terms:
    if value == "full":
        return "full"
    if isinstance(value, list):
        if not value or len(value) > MAX_TERMS:
            raise Bad(f"must list 1 to {MAX_TERMS} terms")
        return tuple(dict.fromkeys(_term(term, factors) for term in value))
    if isinstance(value, int) and not isinstance(value, bool):
        return integer(1, max(1, len(factors)))(value)
    raise Bad(f'must be "full", a number or a list of terms, got {shown(value)}')


def _term(value: object, factors: Sequence[str]) -> str:
    return ":".join(factors[k] for k in word_of(factors, value))


def _check_told_apart(
    model: Terms, factors: Sequence[Factor], scheme: Scheme, faults: Faults
) -> None:
    """Refuse terms that no analysis of a fraction can tell apart."""
    # Each would be judged by what the others leave of it, which is nothing.
    if scheme.rows is None or scheme.kind not in _FRACTIONS:
        return
    names = [factor.name for factor in factors]
    most = min(model, len(names)) if isinstance(model, int) else len(names)
    words = words_of(names, list(model) if isinstance(model, tuple) else most)
    runs = np.array(scheme.rows)
    columns = model_columns(runs, [len(factor.levels) for factor in factors], words)
    rank, columns_asked = int(np.linalg.matrix_rank(columns)) - 1, columns.shape[1] - 1
    if rank == columns_asked:
        return
    what = "terms" if columns_asked == len(words) else "numbers"
    rule = f"asks for {columns_asked} {what}, of which {len(runs)} cells tell {rank} apart"
    usual = default_model(scheme, factors)
    aliased = f": {scheme.aliases[0]}" if scheme.aliases else ""
    faults.add("analysis.model", rule + aliased, f"leave it out (model = {usual}), or list terms")


def terms_of(scheme: Scheme, factors: Sequence[Factor]) -> tuple[str, ...] | None:
    """Terms of zipped and nested factors; None for a full factorial."""
    # Of zipped factors the first stands for all; a nested factor stands only beside its parent.
    if scheme.rows is None:
        return None
    columns = {f.name: c for f, c in zip(factors, zip(*scheme.rows, strict=True), strict=True)}
    independent: list[str] = []
    for factor in factors:
        column = columns[factor.name]
        others = [columns[other] for other in independent]
        if not any(_determines(column, other) and _determines(other, column) for other in others):
            independent.append(factor.name)
    parents = {
        child: parent
        for child in independent
        for parent in independent
        if child != parent and _determines(columns[child], columns[parent])
    }
    terms = [
        term
        for order in range(1, len(independent) + 1)
        for term in itertools.combinations(independent, order)
        if all(parents[n] in term for n in term if n in parents)
    ]
    return tuple(":".join(term) for term in terms)


def _determines(column: Sequence[int], other: Sequence[int]) -> bool:
    """Whether the level of one factor says the level of another."""
    pairs = set(zip(column, other, strict=True))
    return len(pairs) == len(set(column))
