"""Words for one effect: its size, its interval, what matters, its verdict.

A difference is rounded to what the declared threshold makes meaningful: a thousandth of
0.5 pp is 0.0005 pp, so nothing is printed finer than 0.001 pp.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from study.reporting.facts import MATTERS, NO_DIFFERENCE, Effect, Facts
from study.reporting.text import (
    MINUS,
    MISSING,
    THIN,
    TIMES,
    clean,
    decimals_that_count,
    p_phrase,
    percent,
    quantity,
    ratio_digits,
    rounded,
    sentence,
    span,
    term_name,
)

Labels = Mapping[str, str] | None

#: ratios effect / u_num beyond this are only said to be so
_FAR = 100.0


def decimals(effect: Effect) -> int | None:
    """Decimals at which an effect is worth printing."""
    if effect.practical is None:
        return None
    return decimals_that_count(abs(effect.practical - 1) if effect.ratio else effect.practical)


def size(effect: Effect, facts: Facts) -> str:
    """Largest difference of an effect with its unit, or as a ratio."""
    number = _number(effect)
    if number == MISSING:
        return number
    if effect.ratio:
        return f"{TIMES}{THIN}{number}"
    return f"{number}{THIN}{facts.difference_unit}" if facts.difference_unit else number


def _number(effect: Effect) -> str:
    digits = ratio_digits(effect.difference) if effect.ratio else 3
    return rounded(effect.difference, decimals(effect), digits)


def size_interval(effect: Effect, facts: Facts) -> str:
    """Simultaneous 95 % interval of the largest difference."""
    digits = ratio_digits(effect.difference) if effect.ratio else 3
    places = decimals(effect)
    ends = span(effect.low, effect.high, places, digits)
    low, _, high = ends.partition(" to ")
    if low == high:
        # blocks that answer alike to the last digit leave no width to print
        ends = f"narrower than {10.0**-places:.{places}f}" if places is not None else low
    if ends == MISSING or effect.ratio or not facts.difference_unit:
        return ends
    return f"{ends}{THIN}{facts.difference_unit}"


def practical(effect: Effect, facts: Facts) -> str:
    """Return the smallest difference that matters, as it was declared."""
    if effect.practical is None:
        return MISSING
    text = f"{float(f'{effect.practical:.3g}'):g}".replace("-", MINUS)
    return f"{TIMES}{THIN}{text}" if effect.ratio else f"{text}{THIN}{facts.difference_unit}"


def numerical(effect: Effect, facts: Facts) -> str:
    """Numerical uncertainty on the scale of the effect: a ratio for a log response."""
    if not effect.ratio:
        return _with_unit(rounded(effect.u_num, decimals(effect), 2), facts.difference_unit)
    if effect.over_u_num is None or not effect.over_u_num or not effect.difference:
        return quantity(effect.u_num, facts.unit, 2)
    u = math.exp(abs(math.log(effect.difference)) / abs(effect.over_u_num))
    return f"{TIMES}{THIN}{rounded(u, decimals(effect), max(ratio_digits(u) - 1, 3))}"


def _with_unit(number: str, unit: str) -> str:
    return number if number == MISSING or not unit else f"{number}{THIN}{unit}"


def over_numerical(effect: Effect) -> str:
    """Effect over its numerical uncertainty; below 3 it may be the mesh."""
    times = effect.over_u_num
    if times is None or not math.isfinite(times):
        return MISSING
    if times >= _FAR:
        return f"> {_FAR:.0f}"
    return f"{times:.2g}" if times >= 0.1 else "< 0.1"


def verdict(effect: Effect, facts: Facts, labels: Labels = None) -> str:
    """One sentence: what a factor does to a response, and how sure that is.

    The verdict itself comes from the analysis; this says it with its numbers.
    """
    name = term_name(effect.term, labels)
    if effect.difference is None:
        return sentence(f"{name}: {effect.verdict}; {effect.why or 'no effect could be estimated'}")
    numbers = f"{size(effect, facts)} ({_ninety_five(effect, facts)})"
    if effect.low is None:
        numbers = size(effect, facts)
    if effect.verdict == MATTERS:
        return _matters(effect, facts, name, numbers)
    if effect.verdict == NO_DIFFERENCE:
        return sentence(
            f"{name}: no practical difference in the {facts.title}; the largest is {numbers}, "
            f"within {practical(effect, facts)}{_repeatable(effect)}"
        )
    limit = practical(effect, facts)
    against = "" if limit == MISSING else f" against {limit} that matters"
    return sentence(
        f"{name}: these data cannot tell whether it matters for the {facts.title}; the largest "
        f"difference is {numbers}{against}{f' ({effect.why})' if effect.why else ''}"
    )


def _ninety_five(effect: Effect, facts: Facts) -> str:
    return f"95{THIN}% interval {size_interval(effect, facts)}"


def _repeatable(effect: Effect) -> str:
    """Say that a tiny difference may well be real: p never decides alone."""
    if effect.p is None or effect.p >= 0.05:
        return ""
    return f" (repeatable, {p_phrase(effect.p)}, but too small to matter)"


def _matters(effect: Effect, facts: Facts, name: str, numbers: str) -> str:
    if not effect.is_main or effect.pair is None:
        return sentence(f"{name}: matters for the {facts.title}, {numbers}")
    low, high = clean(effect.lowest), clean(effect.highest)
    # "1.37 times the modulus", yet "1.20 pp more error"
    text = f"{high} gives " + (
        f"{_number(effect)} times the {facts.title} of {low}"
        if effect.ratio
        else f"{size(effect, facts)} more {facts.title} than {low}"
    )
    if effect.low is not None:
        text += f" ({_ninety_five(effect, facts)})"
    return sentence(f"{name}: matters; {text}")


def change(effect: Effect, facts: Facts) -> str:
    """Size of a change in words: ``37.3 %`` for a ratio of 1.373."""
    if effect.ratio and effect.difference is not None:
        return f"{percent(effect.difference - 1)} (ratio {_number(effect)})"
    return size(effect, facts)
