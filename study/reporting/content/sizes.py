"""Sizes of effects as text: differences and ratios, intervals, what matters, numerical bounds.

A difference is rounded to what the declared threshold makes meaningful: a thousandth of
0.5 pp is 0.0005 pp, so nothing is printed finer than 0.001 pp.
"""

from __future__ import annotations

import math

from study.analysis.anova_table import Effect
from study.reporting.numbers import (
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
from study.reporting.report import Facts

#: ratios effect / u_num beyond this are only said to be so
_FAR = 100.0


def decimals(effect: Effect) -> int | None:
    """Decimals at which an effect is worth printing.

    Parameters
    ----------
    effect : Effect
        A thousandth of its practical difference (of a ratio less 1) is the finest that counts.

    Returns
    -------
    int or None
        None where nobody declared what matters: no decimal is too fine.
    """
    if effect.practical is None:
        return None
    return decimals_that_count(abs(effect.practical - 1) if effect.is_ratio else effect.practical)


def size(effect: Effect, facts: Facts) -> str:
    """Largest difference of an effect with its unit, or as a ratio.

    Parameters
    ----------
    effect : Effect
        In the unit of the response, or a ratio; without a size the text is a dash.
    facts : Facts
        The response, for the unit of a difference.
    """
    number = shown_size(effect)
    if number == MISSING:
        return number
    if effect.is_ratio:
        return f"{TIMES}{THIN}{number}"
    return f"{number}{THIN}{facts.difference_unit}" if facts.difference_unit else number


def shown_size(effect: Effect) -> str:
    """Largest difference or ratio of an effect, without its unit.

    Parameters
    ----------
    effect : Effect
        Its interval adds decimals where the rounded size would else stand outside of it.
    """
    digits, places = ratio_digits(effect.range) if effect.is_ratio else 3, decimals(effect)
    shown = rounded(effect.range, places, digits)
    if shown == MISSING or "<" in shown:
        return shown
    ends = span(effect.low, effect.high, places, digits)
    return inside(effect.range, effect.low, effect.high, shown, ends)


def size_interval(effect: Effect, facts: Facts) -> str:
    """Simultaneous interval of the largest difference.

    Parameters
    ----------
    effect : Effect
        In the unit of the response, or ratios; without an interval the text is a dash.
    facts : Facts
        The response, for the unit of a difference.
    """
    digits = ratio_digits(effect.range) if effect.is_ratio else 3
    places = decimals(effect)
    ends = span(effect.low, effect.high, places, digits)
    low, _, high = ends.partition(" to ")
    if low == high:
        # blocks that answer alike to the last digit leave no width to print
        ends = f"narrower than {10.0**-places:.{places}f}" if places is not None else low
    if ends == MISSING or effect.is_ratio or not facts.difference_unit:
        return ends
    return f"{ends}{THIN}{facts.difference_unit}"


def practical(effect: Effect, facts: Facts) -> str:
    """Return the smallest difference that matters, as it was declared.

    Parameters
    ----------
    effect : Effect
        In the unit of the response, or a ratio; where none was declared the text is a dash.
    facts : Facts
        The response, for the unit of a difference.
    """
    if effect.practical is None:
        return MISSING
    text = f"{float(f'{effect.practical:.3g}'):g}".replace("-", MINUS)
    return f"{TIMES}{THIN}{text}" if effect.is_ratio else with_unit(text, facts.difference_unit)


def numerical(effect: Effect, facts: Facts) -> str:
    """Numerical uncertainty on the scale of the effect: a ratio for a log response.

    Parameters
    ----------
    effect : Effect
        Its ``u_num`` is in the unit of the response; without one the text is a dash.
    facts : Facts
        The response, for its unit.
    """
    if effect.u_num is not None and (not effect.is_ratio or effect.u_unit != 1.0):
        return bound(effect.u_num, effect, facts)
    if effect.effect_over_u_num is None or not effect.effect_over_u_num or not effect.range:
        return quantity(effect.u_num, facts.unit, 2)
    u = math.exp(abs(math.log(effect.range)) / abs(effect.effect_over_u_num))
    return f"{TIMES}{THIN}{rounded(u, decimals(effect), max(ratio_digits(u) - 1, 3))}"


def with_unit(number: str, unit: str) -> str:
    """Return a number as text with its unit, where it has one.

    Parameters
    ----------
    number : str
        A dash (``MISSING``) stays without a unit.
    unit : str
        Empty where there is none.
    """
    return number if number == MISSING or not unit else f"{number}{THIN}{unit}"


def over_numerical(effect: Effect) -> str:
    """Effect over its numerical uncertainty; below 3 it may be the mesh.

    Parameters
    ----------
    effect : Effect
        Where the quotient is not known the text is a dash; from 100 on it is ``> 100``.
    """
    times = effect.effect_over_u_num
    if times is None or not math.isfinite(times):
        return MISSING
    if times >= _FAR:
        return f"> {_FAR:.0f}"
    return f"{times:.2g}" if times >= 0.1 else "< 0.1"


def shown_difference(difference: float, effect: Effect, facts: Facts) -> str:
    """Difference (or ratio) of two levels with its unit, rounded to what counts.

    Parameters
    ----------
    difference : float
        In the unit of the response, or a ratio where the effect is one.
    effect : Effect
        What matters of it sets the decimals.
    facts : Facts
        The response, for the unit of a difference.
    """
    digits = ratio_digits(difference) if effect.is_ratio else 3
    number = rounded(difference, decimals(effect), digits)
    if effect.is_ratio:
        return f"{TIMES}{THIN}{number}"
    return f"{number}{THIN}{facts.difference_unit}" if facts.difference_unit else number


def bound(u: float, effect: Effect, facts: Facts) -> str:
    """Bound of a numerical error in response units, on the scale of the effect.

    Parameters
    ----------
    u : float
        In the unit of the response.
    effect : Effect
        A ratio where the log was analyzed.
    facts : Facts
        With the unit of a difference.
    """
    if not effect.is_ratio:
        return with_unit(rounded(u, decimals(effect), 2), facts.difference_unit)
    ratio = math.exp(u * effect.u_unit)
    return f"{TIMES}{THIN}{rounded(ratio, decimals(effect), max(ratio_digits(ratio) - 1, 3))}"


def change(effect: Effect, facts: Facts) -> str:
    """Size of a change in words: ``37.3 %`` for a ratio of 1.373.

    Parameters
    ----------
    effect : Effect
        A difference is written as by :func:`size`.
    facts : Facts
        The response, for the unit of a difference.
    """
    if effect.is_ratio and effect.range is not None:
        return f"{percent(effect.range - 1)} (ratio {shown_size(effect)})"
    return size(effect, facts)
