"""What was expected before the study ran, so that the report can say whether it came true."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from study.design.diagnostics import Faults
from study.design.reader import Section
from study.design.spec import Expected, Factor, Response
from study.design.toml_document import flatten
from study.errors import nearest
from study.setup.quantity import shown
from study.setup.section import Bad, Read
from study.setup.text import text

MAX_EXPECTED = 50

#: keys of each kind; the first one names it
KINDS = {
    "matters": ("matters",),
    "larger": ("larger", "than"),
    "interact": ("interact",),
    "best": ("best",),
    "close": ("close", "to"),
}
_MEND = 'for example matters = "material", or larger = "material" with than = "model.space"'


def read_expected(
    value: Any, factors: Sequence[Factor], responses: Sequence[Response], faults: Faults
) -> tuple[Expected, ...]:
    """Read every ``[[expected]]``: one kind of :data:`KINDS` each, ``source`` and ``response``."""
    if value is None:
        return ()
    if not isinstance(value, list) or len(value) > MAX_EXPECTED:
        faults.add("expected", f"must be tables, got {shown(value)}", "write [[expected]]")
        return ()
    named, known = {f.name: f for f in factors}, [r.name for r in responses if r.name]
    found = [
        _expectation(table, f"expected[{i}]", named, known, faults) for i, table in enumerate(value)
    ]
    return tuple(one for one in found if one is not None)


def _expectation(
    table: Any, where: str, named: Mapping[str, Factor], known: Sequence[str], faults: Faults
) -> Expected | None:
    before, section = len(faults), Section(table, where, faults)
    source = section.take("source", text, "")
    response = section.take("response", _one_of(known), known[0] if known else "")
    kinds = [kind for kind in KINDS if kind in section]
    if len(kinds) != 1 and not section.broken:
        rule = f"must hold one of {', '.join(KINDS)}" + (f", got {len(kinds)}" if kinds else "")
        faults.add(where, rule, _MEND)
    read = _reader(kinds[0], named) if kinds else text
    given = [section.take(key, read) for kind in kinds[:1] for key in KINDS[kind]]
    section.finish([key for kind in kinds[1:] for key in KINDS[kind]])
    if len(faults) > before or not kinds:
        return None
    cells = tuple(one for one in given if isinstance(one, dict))
    names = tuple(name for one in given if isinstance(one, tuple) for name in one)
    return Expected(kinds[0], names, cells, response, source)


def _one_of(valid: Sequence[str]) -> Read:
    def read(value: Any) -> str:
        if not isinstance(value, str) or value not in valid:
            raise Bad(f"is none of the study's: {shown(value)}", nearest(str(value)[:80], valid))
        return value

    return read


def _reader(kind: str, named: Mapping[str, Factor]) -> Read:
    """Reader of the values of a kind: a cell, two factors that interact, or one factor."""
    if kind in ("best", "close"):
        return _cell(named)
    one = _one_of(list(named))
    if kind != "interact":
        return lambda value: (one(value),)

    def read(value: Any) -> tuple[str, ...]:
        if not isinstance(value, list) or len(value) != 2:
            raise Bad(f"must be a list of two factors, got {shown(value)}")
        return tuple(one(item) for item in value)

    return read


def _cell(named: Mapping[str, Factor]) -> Read:
    """Reader of the levels of some factors."""

    def read(value: Any) -> dict[str, str]:
        if not isinstance(value, Mapping) or not value:
            raise Bad(f"must name levels, got {shown(value)}", '{ material = "neo-hookean" }')
        cell = {}
        for name, label in flatten(value, "").items():
            factor = named[_one_of(list(named))(name)]
            cell[name] = _one_of([level.label for level in factor.levels])(str(label))
        return cell

    return read
