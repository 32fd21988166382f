"""Factors that are a range: ``{ low = "28 mm", high = "32 mm" }``, and their levels."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from study.design import keys
from study.design.reader import Bad, Faults, number, shown
from study.design.spec import Factor, Level, Span
from study.errors import UnitError
from study.units import parse

ENDS = ("low", "high")
_QUANTITY = re.compile(r"\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*(\S.*?)\s*")


def grouped(table: Mapping[str, Any]) -> dict[str, Any]:
    """Join ``KEY.low`` and ``KEY.high``, which joining dotted keys took apart, to ``KEY``.

    Examples
    --------
    >>> grouped({"a.low": 1, "a.high": 2, "b": [3, 4]})
    {'a': {'low': 1, 'high': 2}, 'b': [3, 4]}
    """
    found: dict[str, Any] = {}
    for key, value in table.items():
        name, _, end = key.rpartition(".")
        if name and end in ENDS:
            found.setdefault(name, {})[end] = value
        else:
            found[key] = value
    return found


def read_range(key: str, value: Mapping[str, Any], where: str, faults: Faults) -> Factor | None:
    """Factor of a range, with its two ends as levels."""
    dimension = keys.dimension(key)
    if dimension is None:
        faults.add(where, "is no number, so it has no range", "list its levels: [.., ..]")
        return None
    missing = [end for end in ENDS if end not in value]
    if missing:
        faults.add(where, f"has no {missing[0]}", "write { low = .., high = .. }")
        return None
    try:
        low, high = (_end(value[end], dimension) for end in ENDS)
    except (Bad, UnitError) as error:
        fault = error if isinstance(error, Bad) else error.faults[0]
        faults.add(where, fault.rule, fault.mend)
        return None
    if low[1] != high[1]:
        faults.add(where, f"mixes {low[1]!r} and {high[1]!r}", "write both ends in one unit")
        return None
    if not low[0] < high[0]:
        rule = f"must rise, got {shown(value['low'])} to {shown(value['high'])}"
        faults.add(where, rule, "exchange low and high")
        return None
    span = Span(low[0], high[0], low[1])
    return Factor(key, levels_at(key, span, (0.0, 1.0)), span)


def _end(raw: Any, dimension: str) -> tuple[float, str]:
    """Value and unit of one end, the unit as written."""
    if dimension == "number":
        return number()(raw), ""
    parse(raw, dimension)
    match = _QUANTITY.fullmatch(str(raw))
    if match is None:
        raise Bad(f"must be a number and its unit, got {shown(raw)}", 'for example "28 mm"')
    return float(match[1]), match[2]


def levels_at(key: str, span: Span, shares: Sequence[float]) -> tuple[Level, ...]:
    """Levels at shares of a range, 0 its low and 1 its high end, in as few digits as tell them.

    Examples
    --------
    >>> [level.label for level in levels_at("a", Span(1.0, 2.0, "mm"), [0, 1 / 3, 1])]
    ['1 mm', '1.3333 mm', '2 mm']
    """
    values = [span.low + share * (span.high - span.low) for share in shares]
    fine = 1e-4 * (span.high - span.low)
    for digits in range(1, 17):
        texts = [f"{value:.{digits}g}" for value in values]
        near = all(math.isclose(float(t), v, rel_tol=0, abs_tol=fine)
                   for t, v in zip(texts, values, strict=True))  # fmt: skip
        if near and len(set(texts)) == len(set(values)):
            break
    return tuple(_level(key, text, span.unit) for text in texts)


def _level(key: str, text: str, unit: str) -> Level:
    written = f"{text} {unit}" if unit else float(text)
    return Level(f"{text} {unit}".strip(), {key: written})
