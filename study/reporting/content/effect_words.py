"""Effects as text: sizes, verdicts, answers by the role of a factor, and what was expected."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product

from study.ground.arrays import gathered
from study.ground.contrast import Expected
from study.reporting.content.blocks import Table
from study.reporting.content.report_facts import Facts, cells, practical_of
from study.reporting.content.text import (
    MISSING,
    THIN,
    TIMES,
    clean,
    count,
    decimals_that_count,
    inside,
    level,
    listing,
    name_of,
    p_phrase,
    percent,
    quantity,
    ratio_digits,
    rounded,
    sentence,
    span,
    term_name,
    trimmed,
)
from study.reporting.results.study_result import ReportData
from study.statistics.analysis.anova_table import Effect, SimpleEffect
from study.statistics.analysis.equal_variance import SpreadTest
from study.statistics.analysis.simple_effects import (
    CANNOT_TELL,
    MATTERS,
    NO_DIFFERENCE,
    NOT_RESOLVED,
)

Labels = Mapping[str, str] | None

# Sizes of effects as text: differences and ratios, intervals, what matters, numerical bounds.
#
# A difference is rounded to what the declared threshold makes meaningful: a thousandth of
# 0.5 pp is 0.0005 pp, so nothing is printed finer than 0.001 pp.


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
    return scaled(trimmed(effect.practical), effect, facts)


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


def shown_difference(difference: float, effect: Effect, facts: Facts) -> str:
    """Difference (or ratio) of two levels with its unit, rounded to what counts."""
    digits = digits_of(difference, effect)
    return scaled(rounded(difference, decimals(effect), digits), effect, facts)


def bound(u: float, effect: Effect, facts: Facts) -> str:
    """Bound of a numerical error in response units, on the scale of the effect."""
    if not effect.is_ratio:
        return with_unit(rounded(u, decimals(effect), 2), facts.difference_unit)
    return _bounding(math.exp(u * effect.u_unit), effect)


def change(
    effect: Effect, facts: Facts, labels: Labels = None, *, in_brackets: bool = False
) -> str:
    """Size of a change that matters, at the setting where it does if it does not on average."""
    if simple := sole_setting(effect):
        number = shown_difference(apart(simple.difference, effect), effect, facts)
        where = setting(simple, labels)
        return f"{number} ({where})" if in_brackets else f"{number} {where}"
    return size(effect, facts)


def change_in_words(effect: Effect, facts: Facts, labels: Labels = None) -> str:
    """Size of a change that matters: ``37.3 %`` for a ratio of 1.373."""
    if effect.is_ratio and effect.range is not None and sole_setting(effect) is None:
        return f"{percent(effect.range - 1)} (ratio {shown_size(effect)})"
    return change(effect, facts, labels)


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


def factors_of(data: ReportData, role: str) -> list[str]:
    """Factors of a role, in the order of the design; a choice where none was declared."""
    return [name for name in data.factors if data.roles.get(name, CHOICE) == role]


def choices(data: ReportData, facts: Facts) -> list[Effect]:
    """Effects of the factors that are choices."""
    return [effect for effect in facts.effects if data.roles.get(effect.term, CHOICE) == CHOICE]


def settings(data: ReportData) -> list[dict[str, str]]:
    """Every combination of the levels of the conditions; one empty one where there are none."""
    names = [n for n in factors_of(data, CONDITION) if len(data.factors[n]) > 1]
    combined = product(*(data.factors[name] for name in names))
    return [dict(zip(names, levels, strict=True)) for levels in combined]


def at(data: ReportData, setting: Mapping[str, str]) -> ReportData:
    """Copy of a study with the rows of one setting of its conditions alone."""
    table = data.table
    for name, label in setting.items():
        table = table[table[name].astype(str) == label]
    return replace(data, table=table)


def named(setting: Mapping[str, str], data: ReportData) -> str:
    """Name a setting: ``range 40 %``."""
    return ", ".join(f"{name_of(n, data.labels)} {clean(v)}" for n, v in setting.items())


def by_condition(data: ReportData, all_facts: Sequence[Facts]) -> list[str]:
    """Say at which levels of a condition each choice matters."""
    lines = []
    for condition, facts in product(factors_of(data, CONDITION), all_facts):
        for effect in choices(data, facts):
            at = gathered((dict(e.at).get(condition), e) for e in effect.simple_effects)
            if any(label not in at for label in data.factors[condition]):
                continue
            shown = []
            for label in data.factors[condition]:
                verdict = together([e.verdict for e in at[label]])
                alike = [e for e in at[label] if e.verdict == verdict] or at[label]
                difference = apart(max(alike, key=effect.distance).difference, effect)
                size_there = shown_difference(difference, effect, facts)
                shown.append((verdict, f"{clean(label)} ({size_there})"))
            parts = [f"{_SAID[v]} at {listing(levels)}" for v, levels in gathered(shown).items()]
            name, by = term_name(effect.term, data.labels), name_of(condition, data.labels)
            lines.append(sentence(f"{name} by {by}, for {facts.noun}: {'; '.join(parts)}"))
    return lines


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


def unknowns(data: ReportData, all_facts: Sequence[Facts]) -> Iterator[str]:
    """Effect of every assumed factor, and whether it has to be measured."""
    by_factor = gathered((e.term, (f, e)) for f in all_facts for e in f.effects)
    for factor in factors_of(data, UNKNOWN):
        effects = by_factor.get(factor, [])
        start = f"the level of {name_of(factor, data.labels)} was assumed"
        large = [
            f"{facts.noun} by {change(effect, facts, data.labels, in_brackets=True)}"
            for facts, effect in effects
            if effect.verdict == MATTERS and effect.range is not None
        ]
        if large:
            yield f"{sentence(f'{start}, and it changes {listing(large)}')} Measure it."
        elif effects and all(effect.verdict == NO_DIFFERENCE for _, effect in effects):
            yield sentence(f"{start}. It makes no practical difference, so it need not be measured")
        elif effects:
            yield sentence(f"{start}. This study cannot tell whether it has to be measured")


#: *matters* where the average over the other factors does not
MATTERS_AT_SETTINGS = "matters at some settings"

PLUS_MINUS = "\u00b1"


def open_verdict(effect: Effect, facts: Facts, labels: Labels = None) -> str:
    """Say why data or meshes cannot show whether a factor matters."""
    name = term_name(effect.term, labels)
    if effect.range is None:
        return sentence(f"{name}: {effect.verdict}; {effect.why or 'no effect could be estimated'}")
    numbers = size(effect, facts) if effect.low is None else _sized(effect, facts)
    if effect.verdict == NOT_RESOLVED:
        return sentence(
            f"{name}: not resolved by the mesh; {'on average ' * effect.depends_on_settings}the "
            f"largest difference in {facts.noun} is {numbers}"
            f"{_unresolved(effect, facts, labels)}"
        )
    text = f"{name}: these data cannot show whether it matters for {facts.noun}"
    text += f"; the largest difference is {numbers}"
    if effect.practical is not None:
        text += f" against {practical(effect, facts)} that matters"
    text += f" ({effect.why})" if effect.why else ""
    least = effect.deciding_simple
    if least is not None and effect.depends_on_settings and least.ci is not None:
        shown = simple(least, effect, facts)
        text += f"; the largest single one is {shown}, {setting(least, labels)}"
    return sentence(text)


def sole_setting(effect: Effect) -> SimpleEffect | None:
    """Return the simple effect that carries *matters* where the average does not."""
    if effect.verdict != MATTERS or effect.matters_on_average or not effect.depends_on_settings:
        return None
    return effect.deciding_simple


def told(effect: Effect) -> str:
    """Verdict as a table says it, at some settings where not on average; a dash without a limit."""
    if effect.practical is None:
        return MISSING
    return MATTERS_AT_SETTINGS if sole_setting(effect) else effect.verdict


def _unresolved(effect: Effect, facts: Facts, labels: Labels) -> str:
    """Say at which setting the numerical uncertainty leaves a factor open, and what it may be."""
    least = effect.deciding_simple
    if effect.u_needed is None:
        return f", and {clean(effect.why)}"
    below = f"would have to be below {bound(effect.u_needed, effect, facts)}"
    same = least and not least.at and {least.first, least.second} == set(effect.largest or ())
    if least is None or (same and least.u is not None):
        return f", and its numerical uncertainty {numerical(effect, facts)} {below}"
    # another setting, or another pair of levels, has the larger uncertainty
    pair = f"between {clean(least.first)} and {clean(least.second)}"
    unbounded = "which these meshes do not bound"
    return (
        f"; {setting(least, labels) if least.at else pair} it is "
        f"{shown_difference(least.difference, effect, facts)}, and the numerical uncertainty "
        f"there, {unbounded if least.u is None else bound(least.u, effect, facts)}, {below}"
    )


def simple(effect_there: SimpleEffect, effect: Effect, facts: Facts) -> str:
    """Return a simple effect with its interval and its numerical uncertainty."""
    number = shown_difference(effect_there.difference, effect, facts)
    ends = effect_there.ci_simultaneous if effect_there.verdict == MATTERS else effect_there.ci
    if ends is None:
        return number
    shown = span(*ends, decimals(effect), digits_of(effect_there.difference, effect))
    note = ""
    if effect_there.u and not effect.is_ratio:
        note = f", numerics {PLUS_MINUS}{THIN}{rounded(effect_there.u, decimals(effect), 2)}"
    return f"{number} ({shown}{note})"


def setting(simple: SimpleEffect, labels: Labels = None) -> str:
    """Name a setting: ``at element order linear, mesh fine``."""
    listed = ", ".join(f"{name_of(name, labels or {})} {clean(level)}" for name, level in simple.at)
    return f"at {listed}" if listed else "whatever the other factors"


def blocks_needed(effect: Effect, facts: Facts) -> str:
    """Name the blocks without any one of which a claim is not made."""
    named = [clean(name) for name in effect.lost_without or ()]
    several = f"any one of {count(len(named), facts.block)}"
    return f"{facts.block} {listing(named, 'or')}" if len(named) < 4 else several


def rejects_normality(facts: Facts, alpha: float) -> bool:
    """Whether Ryan-Joiner rejects: the simulated p decides, else the tabled one."""
    if (tested := facts.assumptions.normality) is None:
        return False
    if tested.p_exact is not None:
        return tested.p_exact < alpha
    printed = tested.p_minitab or ""
    number = printed.strip("<> ")
    if not number or printed.startswith(">"):
        return False
    return float(number) <= alpha if printed.startswith("<") else float(number) < alpha


def normality_phrase(facts: Facts, alpha: float) -> str:
    """Ryan-Joiner as a caption says it."""
    test_result = facts.assumptions.normality
    if test_result is None or test_result.rj is None:
        return "the test of normality does not apply"
    p = "" if test_result.p_exact is None else f" ({p_phrase(test_result.p_exact)}, simulated)"
    rejected = "rejected" if rejects_normality(facts, alpha) else "not rejected"
    return f"normality is {rejected} by Ryan-Joiner{p}"


def p_of(test: SpreadTest) -> float | None:
    """Return the p of a test that decides: the Monte-Carlo one where there is one."""
    return test.p if test.p_monte_carlo is None else test.p_monte_carlo


def least_sphericity(facts: Facts) -> tuple[str, float] | None:
    """Term with the smallest Greenhouse-Geisser epsilon, and that epsilon."""
    epsilons = [
        (term, sphericity.epsilon_gg)
        for term, sphericity in facts.assumptions.sphericity.items()
        if math.isfinite(sphericity.epsilon_gg) and sphericity.df != 0
    ]
    return min(epsilons, key=lambda of: of[1], default=None)


HOLDS = "holds"
FAILS = "does not hold"
_OF_VERDICT = {MATTERS: HOLDS, NO_DIFFERENCE: FAILS}
#: words that a page gives a color and a sign
VERDICTS = frozenset(
    (MATTERS, MATTERS_AT_SETTINGS, NO_DIFFERENCE, NOT_RESOLVED, CANNOT_TELL, HOLDS, FAILS)
)
_NO_ANSWER = ("the study has no answer", CANNOT_TELL)


def table(data: ReportData, all_facts: Sequence[Facts]) -> Table:
    """One row an expectation: what, by whom, what was found, and whether it came true."""
    by_name = {facts.name: facts for facts in all_facts}
    rows = []
    for item in data.expected:
        facts = by_name.get(item.response)
        saw, verdict = _judged(item, facts, data) if facts else _NO_ANSWER
        rows.append((_said(item, data), clean(item.source) or MISSING, sentence(saw), verdict))
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
        return _NO_ANSWER
    return _sized(effect, facts), _OF_VERDICT.get(effect.strength, CANNOT_TELL)


def _effect_of(facts: Facts, *factors: str) -> Effect | None:
    names = set(factors)
    return next((e for e in facts.terms if set(e.term.split(":")) == names), None)


def _sized(effect: Effect, facts: Facts) -> str:
    return f"{size(effect, facts)} ({level(facts.alpha)} interval {size_interval(effect, facts)})"


def _larger(effects: Sequence[Effect | None], facts: Facts, data: ReportData) -> tuple[str, str]:
    """One effect is larger than another where their intervals do not overlap."""
    estimated = [e for e in effects if e is not None and e.range is not None]
    if len(estimated) < 2:
        return _NO_ANSWER
    parts = [f"{term_name(e.term, data.labels)} {_sized(e, facts)}" for e in estimated]
    (low, high), (other_low, other_high) = map(_magnitudes, estimated)
    verdict = HOLDS if low > other_high else FAILS if high < other_low else CANNOT_TELL
    return ", ".join(parts), verdict


def _directed(item: Expected, facts: Facts) -> tuple[str, str]:
    """Levels are better, or less, where every interval of a difference lies on that side of zero.

    One interval on the other side, and the expectation does not hold.
    """
    factor, labels = next(iter(item.cells[0].items()))
    effect = _effect_of(facts, factor)
    if effect is None or (item.kind == "better" and not facts.better):
        return _NO_ANSWER
    named = set(labels.split("\t"))
    against = set(effect.levels) - named
    if len(item.cells) > 1:
        against = set(item.cells[1].get(factor, "").split("\t"))
    up = item.kind == "better" and facts.better == "higher"
    zero = 1.0 if effect.is_ratio else 0.0
    parts, sides = [], set()
    for pair in effect.pairs:
        if {pair.first, pair.second} & named and {pair.first, pair.second} & against:
            side = 1 if pair.lower > zero else -1 if pair.upper < zero else 0
            sides.add(side if (pair.first in named) == up else -side)
            ends = span(pair.lower, pair.upper, decimals_that_count(effect.practical))
            parts.append(f"{clean(pair.first)} less {clean(pair.second)} {ends}")
    if not sides:
        return _NO_ANSWER
    return listing(parts), HOLDS if sides == {1} else FAILS if -1 in sides else CANNOT_TELL


def _magnitudes(effect: Effect) -> tuple[float, float]:
    """Smallest and largest size of an effect within its interval."""
    ends = [effect.range if v is None else v for v in (effect.low, effect.high)]
    if effect.is_ratio:
        ends = [math.log(v) if v and v > 0 else 0.0 for v in ends]
    low, high = sorted(float(v or 0.0) for v in ends)
    least, most = sorted((abs(low), abs(high)))
    return (0.0 if low <= 0 <= high else least), most


def _cells(item: Expected, facts: Facts, data: ReportData) -> tuple[str, str]:
    frame = cells(data, facts.name, list(item.cells[0]))
    levels = frame[list(item.cells[0])].itertuples(index=False, name=None)
    means = dict(zip(levels, frame["mean"].tolist(), strict=True))
    keys = [tuple(cell.values()) for cell in item.cells]
    if any(key not in means for key in keys):
        return _NO_ANSWER
    limit = practical_of(facts, cells(data, facts.name))
    rank = _worse(means[keys[0]], facts)
    if item.kind == "close":
        apart = abs(means[keys[1]] - means[keys[0]])
        verdict = CANNOT_TELL if not limit else HOLDS if apart <= limit else FAILS
        return f"{_difference(apart, limit, facts)} apart, {_from(limit, facts)}", verdict
    ranked = sorted(means, key=lambda key: _worse(means[key], facts))
    shown = [f"{' x '.join(key)} {quantity(means[key], facts.unit)}" for key in ranked[:3]]
    if keys[0] not in ranked[:3]:
        shown.append(f"{_cell(item.cells[0])} {quantity(means[keys[0]], facts.unit)}")
    behind = rank - _worse(means[ranked[0]], facts)
    verdict = HOLDS if behind == 0 else CANNOT_TELL if behind <= limit else FAILS
    return f"{listing(shown)}, {_from(limit, facts)}", verdict


def _from(limit: float, facts: Facts) -> str:
    if not limit:
        return "and no difference that matters was given"
    return f"where {_difference(limit, limit, facts)} matter"


def _worse(mean: float, facts: Facts) -> float:
    return -mean if facts.better == "higher" else mean


def _difference(value: float, limit: float, facts: Facts) -> str:
    return with_unit(rounded(value, decimals_that_count(limit or None)), facts.difference_unit)
