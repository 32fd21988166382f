"""Effects as text: their sizes, and their answers by the role of a factor."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product

from study.reporting.content.numbers import (
    MINUS,
    MISSING,
    THIN,
    TIMES,
    decimals_that_count,
    inside,
    percent,
    quantity,
    ratio_digits,
    rounded,
    span,
)
from study.reporting.content.report_facts import Facts
from study.reporting.content.text import clean, listing, name_of, sentence, term_name
from study.reporting.results.study_result import ReportData
from study.statistics.analysis.anova_table import Effect
from study.statistics.analysis.simple_effects import (
    CANNOT_TELL,
    MATTERS,
    NO_DIFFERENCE,
    NOT_RESOLVED,
)

# Sizes of effects as text: differences and ratios, intervals, what matters, numerical bounds.
#
# A difference is rounded to what the declared threshold makes meaningful: a thousandth of
# 0.5 pp is 0.0005 pp, so nothing is printed finer than 0.001 pp.

#: ratios effect / u_num beyond this are only said to be so
_FAR = 100.0


def decimals(effect: Effect) -> int | None:
    """Decimals at which an effect is worth printing."""
    if effect.practical is None:
        return None
    return decimals_that_count(abs(effect.practical - 1) if effect.is_ratio else effect.practical)


def size(effect: Effect, facts: Facts) -> str:
    """Largest difference of an effect with its unit, or as a ratio."""
    return scaled(shown_size(effect), effect, facts)


def scaled(number: str, effect: Effect, facts: Facts) -> str:
    """Return a number as text with the unit of a difference, or as a ratio."""
    if number == MISSING or not effect.is_ratio:
        return with_unit(number, facts.difference_unit)
    return f"{TIMES}{THIN}{number}"


def digits_of(value: float | None, effect: Effect) -> int:
    """Digits that a size on the scale of an effect needs."""
    return ratio_digits(value) if effect.is_ratio else 3


def shown_size(effect: Effect) -> str:
    """Largest difference or ratio of an effect, without its unit."""
    digits, places = digits_of(effect.range, effect), decimals(effect)
    shown = rounded(effect.range, places, digits)
    if shown == MISSING or "<" in shown:
        return shown
    ends = span(effect.low, effect.high, places, digits)
    return inside(effect.range, effect.low, effect.high, shown, ends)


def size_interval(effect: Effect, facts: Facts) -> str:
    """Simultaneous interval of the largest difference."""
    places = decimals(effect)
    ends = span(effect.low, effect.high, places, digits_of(effect.range, effect))
    low, _, high = ends.partition(" to ")
    if low == high:
        # blocks that answer alike to the last digit leave no width to print
        ends = f"narrower than {10.0**-places:.{places}f}" if places is not None else low
    return ends if effect.is_ratio else with_unit(ends, facts.difference_unit)


def practical(effect: Effect, facts: Facts) -> str:
    """Return the smallest difference that matters, as it was declared."""
    if effect.practical is None:
        return MISSING
    text = f"{float(f'{effect.practical:.3g}'):g}".replace("-", MINUS)
    return scaled(text, effect, facts)


def numerical(effect: Effect, facts: Facts) -> str:
    """Numerical uncertainty on the scale of the effect: a ratio for a log response."""
    if effect.u_num is not None and (not effect.is_ratio or effect.u_unit != 1.0):
        return bound(effect.u_num, effect, facts)
    if effect.effect_over_u_num is None or not effect.effect_over_u_num or not effect.range:
        return quantity(effect.u_num, facts.unit, 2)
    return _bounding(math.exp(abs(math.log(effect.range) / effect.effect_over_u_num)), effect)


def _bounding(ratio: float, effect: Effect) -> str:
    return f"{TIMES}{THIN}{rounded(ratio, decimals(effect), max(ratio_digits(ratio) - 1, 3))}"


def with_unit(number: str, unit: str) -> str:
    """Return a number as text with its unit, where it has one."""
    return number if number == MISSING or not unit else f"{number}{THIN}{unit}"


def over_numerical(effect: Effect) -> str:
    """Effect over its numerical uncertainty; below 3 it may be the mesh."""
    times = effect.effect_over_u_num
    if times is None or not math.isfinite(times):
        return MISSING
    if times >= _FAR:
        return f"> {_FAR:.0f}"
    return f"{times:.2g}" if times >= 0.1 else "< 0.1"


def shown_difference(difference: float, effect: Effect, facts: Facts) -> str:
    """Difference (or ratio) of two levels with its unit, rounded to what counts."""
    digits = digits_of(difference, effect)
    return scaled(rounded(difference, decimals(effect), digits), effect, facts)


def bound(u: float, effect: Effect, facts: Facts) -> str:
    """Bound of a numerical error in response units, on the scale of the effect."""
    if not effect.is_ratio:
        return with_unit(rounded(u, decimals(effect), 2), facts.difference_unit)
    return _bounding(math.exp(u * effect.u_unit), effect)


def change(effect: Effect, facts: Facts) -> str:
    """Size of a change in words: ``37.3 %`` for a ratio of 1.373."""
    if effect.is_ratio and effect.range is not None:
        return f"{percent(effect.range - 1)} (ratio {shown_size(effect)})"
    return size(effect, facts)


# Answers by the role of a factor: recommended among choices, given at each condition.
#
# A *choice* is the analyst's, a *condition* belongs to the question, an *unknown* is a fact that
# nobody measured (``[analysis] roles`` of a study file).

CHOICE = "choice"
CONDITION = "condition"
UNKNOWN = "unknown"
_SAID = {
    MATTERS: "it matters",
    NO_DIFFERENCE: "no practical difference",
    NOT_RESOLVED: "the meshes are too coarse to tell",
    CANNOT_TELL: "these data cannot tell",
}


def role(data: ReportData, factor: str) -> str:
    """Role of a factor; a choice where none was declared."""
    return data.roles.get(factor, CHOICE)


def factors_of(data: ReportData, *roles: str) -> list[str]:
    """Factors with one of some roles, in the order of the design."""
    return [name for name in data.factors if role(data, name) in roles]


def choices(data: ReportData, facts: Facts) -> list[Effect]:
    """Effects of the factors that are choices."""
    return [effect for effect in facts.effects if role(data, effect.term) == CHOICE]


def settings(data: ReportData) -> list[dict[str, str]]:
    """Every combination of the levels of the conditions; one empty one where there are none."""
    names = [n for n in factors_of(data, CONDITION) if len(data.factors[n]) > 1]
    combined = product(*(data.factors[name] for name in names))
    return [dict(zip(names, levels, strict=True)) for levels in combined]


def at(data: ReportData, setting: Mapping[str, str]) -> ReportData:
    """Copy of a study with the rows of one setting of its conditions alone."""
    table = data.table
    for name, level in setting.items():
        table = table[table[name].astype(str) == level]
    return replace(data, table=table)


def named(setting: Mapping[str, str], data: ReportData) -> str:
    """Name a setting: ``range 40 %``."""
    return ", ".join(f"{name_of(n, data.labels)} {clean(v)}" for n, v in setting.items())


def by_condition(data: ReportData, all_facts: Sequence[Facts]) -> list[str]:
    """Say at which levels of a condition each choice matters."""
    return [
        line
        for condition in factors_of(data, CONDITION)
        for facts in all_facts
        for effect in choices(data, facts)
        if (line := _one_condition(condition, effect, facts, data))
    ]


def _one_condition(condition: str, effect: Effect, facts: Facts, data: ReportData) -> str:
    by_verdict: dict[str, list[str]] = {}
    for level in data.factors[condition]:
        here = [e for e in effect.simple_effects if dict(e.at).get(condition) == level]
        if not here:
            return ""
        verdict = together([e.verdict for e in here])
        largest = max([e for e in here if e.verdict == verdict] or here, key=effect.distance)
        size = shown_difference(apart(largest.difference, effect), effect, facts)
        by_verdict.setdefault(verdict, []).append(f"{clean(level)} ({size})")
    parts = [f"{_SAID[verdict]} at {listing(levels)}" for verdict, levels in by_verdict.items()]
    name, by = term_name(effect.term, data.labels), name_of(condition, data.labels)
    return sentence(f"{name} by {by}, for the {facts.title}: {'; '.join(parts)}")


def apart(difference: float, effect: Effect) -> float:
    """How far two levels are apart, whichever is higher."""
    if effect.is_ratio:
        return max(difference, 1 / difference) if difference > 0 else difference
    return abs(difference)


def together(verdicts: Sequence[str]) -> str:
    """Verdict of several simple effects: any that matters decides, else all must agree."""
    if MATTERS in verdicts:
        return MATTERS
    if set(verdicts) == {NO_DIFFERENCE}:
        return NO_DIFFERENCE
    return CANNOT_TELL if CANNOT_TELL in verdicts else NOT_RESOLVED


def unknowns(data: ReportData, all_facts: Sequence[Facts]) -> list[str]:
    """Effect of every assumed factor, and whether it has to be measured."""
    lines = []
    for name in factors_of(data, UNKNOWN):
        effects = [(f, e) for f in all_facts for e in f.effects if e.term == name]
        if effects:
            lines.append(_one_unknown(name_of(name, data.labels), effects))
    return lines


def _one_unknown(name: str, effects: Sequence[tuple[Facts, Effect]]) -> str:
    large = [
        f"the {facts.title} by {shown_difference(effect.range, effect, facts)}"
        for facts, effect in effects
        if effect.verdict == MATTERS and effect.range is not None
    ]
    start = f"the level of {name} was assumed"
    if large:
        return f"{sentence(f'{start}, and it changes {listing(large)}')} Measure it."
    if all(effect.verdict == NO_DIFFERENCE for _, effect in effects):
        return sentence(f"{start}. It makes no practical difference, so it need not be measured")
    return sentence(f"{start}. This study cannot tell whether it has to be measured")
