"""Answers by the role of a factor: recommended among choices, given at each condition.

A *choice* is the analyst's, a *condition* belongs to the question, an *unknown* is a fact that
nobody measured (``[analysis] roles`` of a study file).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product

from study.analysis.anova_table import Effect, SimpleEffect
from study.analysis.effects.verdict import CANNOT_TELL, MATTERS, NO_DIFFERENCE, NOT_RESOLVED
from study.reporting.content.sizes import shown_difference
from study.reporting.report import Facts
from study.reporting.text import clean, listing, name_of, sentence, term_name
from study.study_result.report_data import ReportData

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
    """Role of a factor; a choice where none was declared.

    Parameters
    ----------
    data : ReportData
        Declared roles by factor.
    factor : str
        Key of a factor.

    Returns
    -------
    {"choice", "condition", "unknown"}
    """
    return data.roles.get(factor, CHOICE)


def factors_of(data: ReportData, *roles: str) -> list[str]:
    """Factors with one of some roles, in the order of the design.

    Parameters
    ----------
    data : ReportData
        Factors and their declared roles.
    *roles : {"choice", "condition", "unknown"}
        Roles that count.
    """
    return [name for name in data.factors if role(data, name) in roles]


def settings(data: ReportData) -> list[dict[str, str]]:
    """Every combination of the levels of the conditions; one empty one where there are none.

    Parameters
    ----------
    data : ReportData
        A condition with a single level is left out.

    Returns
    -------
    list of dict of str to str
        Level by condition; the last condition changes fastest.
    """
    names = [n for n in factors_of(data, CONDITION) if len(data.factors[n]) > 1]
    combined = product(*(data.factors[name] for name in names))
    return [dict(zip(names, levels, strict=True)) for levels in combined]


def at(data: ReportData, setting: Mapping[str, str]) -> ReportData:
    """Copy of a study with the rows of one setting of its conditions alone.

    Parameters
    ----------
    data : ReportData
        The copy shares all but the table.
    setting : mapping of str to str
        Level by factor; an empty one keeps all rows.
    """
    table = data.table
    for name, level in setting.items():
        table = table[table[name].astype(str) == level]
    return replace(data, table=table)


def named(setting: Mapping[str, str], data: ReportData) -> str:
    """Name a setting: ``range 40 %``.

    Parameters
    ----------
    setting : mapping of str to str
        Level by factor; an empty one has an empty name.
    data : ReportData
        Better names of the factors.
    """
    return ", ".join(f"{name_of(n, data.labels)} {clean(v)}" for n, v in setting.items())


def by_condition(data: ReportData, found: Sequence[Facts]) -> list[str]:
    """Say at which levels of a condition each choice matters.

    Parameters
    ----------
    data : ReportData
        Roles and levels of the factors.
    found : sequence of Facts
        Simple effects of their factors at the levels of the conditions.

    Returns
    -------
    list of str
        A sentence a condition, response and choice, where every level has simple effects.
    """
    return [
        line
        for condition in factors_of(data, CONDITION)
        for facts in found
        for effect in facts.effects
        if role(data, effect.term) == CHOICE
        and (line := _one_condition(condition, effect, facts, data))
    ]


def _one_condition(condition: str, effect: Effect, facts: Facts, data: ReportData) -> str:
    found: dict[str, list[str]] = {}
    for level in data.factors[condition]:
        here = [e for e in effect.simple_effects if dict(e.at).get(condition) == level]
        if not here:
            return ""
        verdict = together([e.verdict for e in here])
        largest = _largest([e for e in here if e.verdict == verdict] or here, effect)
        size = shown_difference(apart(largest.difference, effect), effect, facts)
        found.setdefault(verdict, []).append(f"{clean(level)} ({size})")
    parts = [f"{_SAID[verdict]} at {listing(levels)}" for verdict, levels in found.items()]
    name, by = term_name(effect.term, data.labels), name_of(condition, data.labels)
    return sentence(f"{name} by {by}, for the {facts.title}: {'; '.join(parts)}")


def apart(difference: float, effect: Effect) -> float:
    """How far two levels are apart, whichever is higher.

    Parameters
    ----------
    difference : float
        In the unit of the response, or a ratio where the effect is one.
    effect : Effect
        Tells which of the two it is.

    Returns
    -------
    float
        Not negative, a ratio 1 or more; a ratio that is not positive comes back as it is.
    """
    if effect.is_ratio:
        return max(difference, 1 / difference) if difference > 0 else difference
    return abs(difference)


def _largest(effects: Sequence[SimpleEffect], effect: Effect) -> SimpleEffect:
    return max(effects, key=effect.distance)


def together(verdicts: Sequence[str]) -> str:
    """Verdict of several simple effects: any that matters decides, else all must agree.

    Parameters
    ----------
    verdicts : sequence of str
        Of one factor at one level of a condition.

    Examples
    --------
    >>> together(["no practical difference", "matters"])
    'matters'
    >>> together(["no practical difference", "cannot tell"])
    'cannot tell'
    """
    if MATTERS in verdicts:
        return MATTERS
    if set(verdicts) == {NO_DIFFERENCE}:
        return NO_DIFFERENCE
    return CANNOT_TELL if CANNOT_TELL in verdicts else NOT_RESOLVED


def unknowns(data: ReportData, found: Sequence[Facts]) -> list[str]:
    """Say of every fact that nobody measured what it would change, and whether to measure it.

    Parameters
    ----------
    data : ReportData
        Factors whose role is ``"unknown"``.
    found : sequence of Facts
        Every response; an unknown without an effect on any of them has no sentence.
    """
    lines = []
    for name in factors_of(data, UNKNOWN):
        effects = [(f, e) for f in found for e in f.effects if e.term == name]
        if effects:
            lines.append(_one_unknown(name_of(name, data.labels), effects))
    return lines


def _one_unknown(name: str, effects: Sequence[tuple[Facts, Effect]]) -> str:
    large = [
        f"the {facts.title} by {shown_difference(effect.range, effect, facts)}"
        for facts, effect in effects
        if effect.verdict == MATTERS and effect.range is not None
    ]
    start = f"nobody measured {name}"
    if large:
        return sentence(f"{start}: it changes {listing(large)}, so measuring it pays")
    if all(effect.verdict == NO_DIFFERENCE for _, effect in effects):
        return sentence(f"{start}: it makes no practical difference, so measuring it does not pay")
    return sentence(f"{start}, and this study cannot show whether measuring it pays")
