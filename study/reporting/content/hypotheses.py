"""What was expected before the study ran, beside what it found."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from study.analysis.anova_table import Effect
from study.analysis.effects.verdict import CANNOT_TELL, MATTERS, NO_DIFFERENCE
from study.design.spec import Expected
from study.reporting.content.sizes import size, size_interval
from study.reporting.content.table import Table
from study.reporting.numbers import (
    MISSING,
    THIN,
    decimals_that_count,
    level,
    quantity,
    rounded,
    span,
)
from study.reporting.report import Facts, cells, practical_of
from study.reporting.text import clean, listing, name_of, sentence, term_name
from study.study_result.report_data import ReportData

HOLDS = "holds"
FAILS = "does not hold"
_OF_VERDICT = {MATTERS: HOLDS, NO_DIFFERENCE: FAILS}
_UNKNOWN = "the study has no answer"


def table(data: ReportData, found: Sequence[Facts]) -> Table:
    """One row an expectation: what, by whom, what was found, and whether it came true.

    Parameters
    ----------
    data : ReportData
        Its expectations, and the rows that cells are compared by.
    found : sequence of Facts
        An expectation of a response that is not among them has no answer.

    Returns
    -------
    Table
        The verdict is ``holds``, ``does not hold`` or ``cannot tell``.
    """
    by_name = {facts.name: facts for facts in found}
    rows = []
    for item in data.expected:
        facts = by_name.get(item.response)
        saw, verdict = _judged(item, facts, data) if facts else (_UNKNOWN, CANNOT_TELL)
        source = clean(item.source) or MISSING
        rows.append((_said(item, data), source, sentence(saw), verdict))
    columns = ("expected", "by", "found", "verdict")
    raw = tuple(dict(zip(columns, row, strict=True)) for row in rows)
    return Table("expected", columns, tuple(rows), 3, 1, raw=raw)


def _said(item: Expected, data: ReportData) -> str:
    names = [name_of(name, data.labels) for name in item.factors]
    cells = [_cell(cell) for cell in item.cells]
    return {
        "matters": lambda: f"{names[0]} matters",
        "larger": lambda: f"{names[0]} has a larger effect than {names[1]}",
        "interact": lambda: f"{names[0]} and {names[1]} interact",
        "best": lambda: f"{cells[0]} is the best",
        "close": lambda: f"{cells[1]} is close to {cells[0]}",
        "better": lambda: " is better than ".join([*cells, "the others"][:2]),
        "fewer": lambda: " needs less than ".join([*cells, "the others"][:2]),
    }[item.kind]()


def _cell(cell: Mapping[str, str]) -> str:
    return " x ".join(
        listing([clean(label) for label in level.split("\t")]) for level in cell.values()
    )


def _judged(item: Expected, facts: Facts, data: ReportData) -> tuple[str, str]:
    if item.kind in ("best", "close"):
        return _cells(item, facts, data)
    if item.kind in ("better", "fewer"):
        return _directed(item, facts)
    if item.kind == "larger":
        return _larger([_effect_of(facts, name) for name in item.factors], facts, data)
    effect = _effect_of(facts, *item.factors)
    if effect is None or effect.range is None:
        return _UNKNOWN, CANNOT_TELL
    return _sized(effect, facts), _OF_VERDICT.get(effect.strength, CANNOT_TELL)


def _effect_of(facts: Facts, *factors: str) -> Effect | None:
    wanted = set(factors)
    return next((e for e in facts.terms if set(e.term.split(":")) == wanted), None)


def _sized(effect: Effect, facts: Facts) -> str:
    return f"{size(effect, facts)} ({level(facts.alpha)} interval {size_interval(effect, facts)})"


def _larger(effects: Sequence[Effect | None], facts: Facts, data: ReportData) -> tuple[str, str]:
    """One effect is larger than another where their intervals do not overlap."""
    known = [e for e in effects if e is not None and e.range is not None]
    if len(known) < 2:
        return _UNKNOWN, CANNOT_TELL
    parts = [f"{term_name(e.term, data.labels)} {_sized(e, facts)}" for e in known]
    (low, high), (other_low, other_high) = (_magnitudes(e) for e in known)
    verdict = HOLDS if low > other_high else FAILS if high < other_low else CANNOT_TELL
    return ", ".join(parts), verdict


def _directed(item: Expected, facts: Facts) -> tuple[str, str]:
    """Levels are better, or less, where every interval of a difference lies on that side of zero.

    One interval on the other side, and the expectation does not hold.
    """
    factor, labels = next(iter(item.cells[0].items()))
    effect = _effect_of(facts, factor)
    better = facts.response.better
    if effect is None or (item.kind == "better" and not better):
        return _UNKNOWN, CANNOT_TELL
    named = set(labels.split("\t"))
    against = set(effect.levels) - named
    if len(item.cells) > 1:
        against = set(item.cells[1].get(factor, "").split("\t"))
    up = item.kind == "better" and better == "higher"
    zero = 1.0 if effect.is_ratio else 0.0
    parts, sides = [], []
    for pair in effect.pairs:
        if {pair.first, pair.second} & named and {pair.first, pair.second} & against:
            lower, upper = pair.lower, pair.upper
            side = 1 if lower > zero else -1 if upper < zero else 0
            sides.append(side if (pair.first in named) == up else -side)
            ends = span(lower, upper, decimals_that_count(effect.practical))
            parts.append(f"{clean(pair.first)} less {clean(pair.second)} {ends}")
    if not sides:
        return _UNKNOWN, CANNOT_TELL
    verdict = HOLDS if set(sides) == {1} else FAILS if -1 in sides else CANNOT_TELL
    return listing(parts), verdict


def _magnitudes(effect: Effect) -> tuple[float, float]:
    """Smallest and largest size of an effect within its interval."""
    ends = [effect.range if v is None else v for v in (effect.low, effect.high)]
    if effect.is_ratio:
        ends = [math.log(v) if v and v > 0 else 0.0 for v in ends]
    low, high = sorted(float(v or 0.0) for v in ends)
    inside = low <= 0 <= high
    return (0.0 if inside else min(abs(low), abs(high))), max(abs(low), abs(high))


def _cells(item: Expected, facts: Facts, data: ReportData) -> tuple[str, str]:
    """Compare means of cells with what matters."""
    frame = cells(data, facts.name, list(item.cells[0]))
    levels = frame[list(item.cells[0])].itertuples(index=False, name=None)
    means = dict(zip(levels, frame["mean"].tolist(), strict=True))
    keys = [tuple(cell.values()) for cell in item.cells]
    if any(key not in means for key in keys):
        return _UNKNOWN, CANNOT_TELL
    limit = practical_of(facts, cells(data, facts.name))
    own = _worse(means[keys[0]], facts)
    if item.kind == "close":
        apart = abs(means[keys[1]] - means[keys[0]])
        verdict = CANNOT_TELL if not limit else HOLDS if apart <= limit else FAILS
        return f"{_difference(apart, limit, facts)} apart, {_from(limit, facts)}", verdict
    ranked = sorted(means, key=lambda key: _worse(means[key], facts))
    told = [f"{' x '.join(key)} {quantity(means[key], facts.unit)}" for key in ranked[:3]]
    if keys[0] not in ranked[:3]:
        told.append(f"{_cell(item.cells[0])} {quantity(means[keys[0]], facts.unit)}")
    behind = own - _worse(means[ranked[0]], facts)
    verdict = HOLDS if behind == 0 else CANNOT_TELL if behind <= limit else FAILS
    return f"{listing(told)}, {_from(limit, facts)}", verdict


def _from(limit: float, facts: Facts) -> str:
    if not limit:
        return "and nobody said what matters"
    return f"where {_difference(limit, limit, facts)} matter"


def _worse(mean: float, facts: Facts) -> float:
    return -mean if facts.response.better == "higher" else mean


def _difference(value: float, limit: float, facts: Facts) -> str:
    number = rounded(value, decimals_that_count(limit or None))
    return f"{number}{THIN}{facts.difference_unit}" if facts.difference_unit else number
