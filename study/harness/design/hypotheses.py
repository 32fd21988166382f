"""What was expected before the study ran, so that the report can say whether it came true."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Annotated

import numpy as np

from study.ground.errors import nearest
from study.harness.design.diagnostics import Faults, flatten, noted, read_table, with_values
from study.harness.design.generators import clear_order, model_columns
from study.harness.design.layout_kinds import word_of, words_of
from study.harness.design.spec import Expected, Factor, ResponseSpec, Scheme
from study.harness.design.study_file import Analysis, Terms
from study.mechanics.setup.declaration import (
    AsWritten,
    Bad,
    Reads,
    as_written,
    integer,
    section,
    shown,
    text,
)

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
    before = len(faults)
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
    if len(faults) > before:
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
        order = clear_order(scheme.resolution)
        return "full" if order is None else min(order, len(factors))
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
        if not any(_same(columns[factor.name], columns[other]) for other in independent):
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


def _same(column: Sequence[int], other: Sequence[int]) -> bool:
    return _determines(column, other) and _determines(other, column)
