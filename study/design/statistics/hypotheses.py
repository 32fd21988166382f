"""What was expected before the study ran, so that the report can say whether it came true."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Annotated

from study.design.diagnostics import Faults, noted, read_table
from study.design.spec import Expected, Factor, Response
from study.design.toml_document import flatten
from study.errors import nearest
from study.setup.quantity import shown
from study.setup.section import AsWritten, Bad, Reads, as_written, section, written_keys
from study.setup.text import text

MAX_EXPECTED = 50

_Factor = Annotated[object, as_written('name a factor, such as "material"')]
_Factors = Annotated[object, as_written('two factors, such as ["material", "plates"]')]
_Labels = Annotated[object, as_written('one level or several, such as "quadratic"')]
_Cell = Annotated[object, as_written('{ material = "neo-hookean" }')]


@section
class Expectation:
    """One ``[[expected]]``: who said it, and of which response."""

    source: Annotated[str, Reads(text)] = ""
    response: AsWritten = None


@section
class Matters(Expectation):
    """A factor has an effect that matters."""

    matters: _Factor = None


@section
class Larger(Expectation):
    """The effect of a factor is larger than that of another one."""

    larger: _Factor = None
    than: _Factor = None


@section
class Interact(Expectation):
    """Two factors interact."""

    interact: _Factors = None


@section
class Best(Expectation):
    """A cell, mean over all other factors, is the best."""

    best: _Cell = None


@section
class Close(Expectation):
    """Two cells differ by less than what matters."""

    close: _Cell = None
    to: _Cell = None


@section
class Better(Expectation):
    """Levels of a factor score better than its others, or than those named."""

    better: _Labels = None
    than: AsWritten = None


@section
class Fewer(Expectation):
    """Levels of a factor need less of the response than its others, or than those named."""

    fewer: _Labels = None
    than: AsWritten = None


#: every kind by the key that names it
KINDS: Mapping[str, type[Expectation]] = {
    "matters": Matters,
    "larger": Larger,
    "interact": Interact,
    "best": Best,
    "close": Close,
    "better": Better,
    "fewer": Fewer,
}
#: word for every level of a material factor but the linear one
HYPERELASTIC = "hyperelastic"
_LINEAR = "linear-elastic"
_MEND = 'for example matters = "material", or larger = "material" with than = "model.space"'


def expected_from(
    value: object, factors: Sequence[Factor], responses: Sequence[Response], faults: Faults
) -> tuple[Expected, ...]:
    """Read every ``[[expected]]``: one kind of :data:`KINDS` each, ``source`` and ``response``.

    Parameters
    ----------
    value
        Raw list of tables; None where there is none.
    factors : sequence of Factor
        Of the design, without the faulty ones.
    responses : sequence of Response
        Of the design; a faulty one has no name.
    faults : Faults
        Where faults go; a faulty table is left out.
    """
    if value is None:
        return ()
    if not isinstance(value, list) or len(value) > MAX_EXPECTED:
        faults.add("expected", f"must be tables, got {shown(value)}", "write [[expected]]")
        return ()
    named, known = {f.name: f for f in factors}, [r.name for r in responses if r.name]
    found = [
        _expected(table, f"expected[{i}]", named, known, faults) for i, table in enumerate(value)
    ]
    return tuple(one for one in found if one is not None)


def _expected(
    table: object, where: str, named: Mapping[str, Factor], known: Sequence[str], faults: Faults
) -> Expected | None:
    before = len(faults)
    kinds = [kind for kind in KINDS if isinstance(table, Mapping) and kind in table]
    if isinstance(table, Mapping) and len(kinds) != 1:
        rule = f"must hold one of {', '.join(KINDS)}" + (f", got {len(kinds)}" if kinds else "")
        faults.add(where, rule, _MEND)
    kind, others = kinds[0] if kinds else "", [key for k in kinds[1:] for key in _own_keys(k)]
    found = read_table(KINDS.get(kind, Expectation), table, where, faults, others)
    response = known[0] if known else ""
    if found.response is not None:
        response = noted(_one_of(known), found.response, f"{where}.response", faults) or ""
    read = _READERS.get(kind, _factor)
    given = {key: getattr(found, key) for key in _own_keys(kind)}
    values = [
        noted(partial(read, named), value, f"{where}.{key}", faults)
        for key, value in given.items()
        if value is not None
    ]
    if len(faults) > before:
        return None
    cells = tuple(value for value in values if isinstance(value, dict))
    names = tuple(name for value in values if isinstance(value, tuple) for name in value)
    return Expected(kind, names, cells, response, found.source)


def _own_keys(kind: str) -> tuple[str, ...]:
    """Keys of a kind beside those of all kinds; none of an unknown one."""
    declared = written_keys(KINDS.get(kind, Expectation))
    return tuple(key for key in declared if key not in written_keys(Expectation))


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


_READERS: Mapping[
    str, Callable[[Mapping[str, Factor], object], tuple[str, ...] | dict[str, str]]
] = {"interact": _factors, "best": _cell, "close": _cell, "better": _levels, "fewer": _levels}
