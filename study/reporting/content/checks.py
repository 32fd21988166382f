"""Checks that follow from the analysis: outcome, finding, and what it means for the reader."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from study.analysis.anova_table import Effect
from study.analysis.effects.verdict import NOT_RESOLVED
from study.reporting.content import sentences, verdicts
from study.reporting.content.cases import failed_cases
from study.reporting.content.sizes import bound
from study.reporting.content.surfaces import response_surface
from study.reporting.numbers import p_phrase
from study.reporting.report import Facts
from study.reporting.text import clean, count, listing, plural_of, term_name
from study.response_surface.emulator.emulator import GIVEN, RANKED
from study.study_result.report_data import Check, ReportData
from study.study_result.response_surface import FittedSurface

_ORDER = {"fail": 0, "caution": 1, "not applicable": 2, "pass": 3}


@dataclass(frozen=True)
class CheckGroup:
    """One check for all responses; its outcome is the worst of them."""

    name: str
    items: tuple[Check, ...]

    @property
    def outcome(self) -> str:
        """Worst outcome."""
        return min((check.outcome for check in self.items), key=_ORDER.__getitem__)

    @property
    def consequence(self) -> str:
        """What follows, where it is the same for two responses or more; else empty."""
        said = [check.consequence for check in self.items if check.consequence]
        return said[0] if len(said) > 1 and len(set(said)) == 1 else ""

    @property
    def agreed(self) -> bool:
        """Whether every response has the same outcome."""
        return len({check.outcome for check in self.items}) == 1


def grouped(made: Sequence[Check]) -> tuple[CheckGroup, ...]:
    """Gather checks of the same name into one, the worst first.

    Parameters
    ----------
    made : sequence of Check
        In any order; within a group their order stays.

    Returns
    -------
    tuple of CheckGroup
        By outcome: fail, caution, not applicable, pass.
    """
    by_name: dict[str, list[Check]] = {}
    for check in made:
        by_name.setdefault(check.name, []).append(check)
    found = [CheckGroup(name, tuple(items)) for name, items in by_name.items()]
    return tuple(sorted(found, key=lambda group: _ORDER[group.outcome]))


def all_checks(data: ReportData, found: Sequence[Facts]) -> tuple[Check, ...]:
    """Gather the checks of the run, then the controls, then those of each analysis, worst first.

    Parameters
    ----------
    data : ReportData
        Of its controls only those that fail or caution: the others stand elsewhere on the page.
    found : sequence of Facts
        Every response of ``data``; one without effects fails, unless there are surfaces.
    """
    # controls that pass stand under numerical credibility alone
    bad = [check for check in data.controls if check.outcome in ("fail", "caution")]
    made = [*data.checks, *bad, *_of_cases(data)]
    for facts in found:
        if facts.terms:
            made += [
                _normality(facts, data.alpha),
                _spread(facts, data.alpha),
                *_sphericity(facts, data),
                *_additivity(facts, data),
                _resolution(facts, data),
                *_fragile(facts, data),
            ]
        elif not data.surfaces:
            made.append(_not_analyzed(facts))
    made += [_surface(one, data) for one in data.surfaces]
    return tuple(sorted(made, key=lambda check: _ORDER[check.outcome]))


def _of_cases(data: ReportData) -> list[Check]:
    found = []
    if data.failures:
        finding = sentences.failures(data.failures, len(data.table))
        found.append(Check("Failed cases", "caution", finding, "See the failure map."))
    if data.retried:
        finding = failed_cases.retried_sentence(data.retried)
        told = "They are listed among the failures."
        found.append(Check("Cases with other settings", "caution", finding, told))
    return found


def _surface(one: FittedSurface, data: ReportData) -> Check:
    """Whether a surface predicts runs that it has not seen."""
    name, of = "Surface predicts runs left out", response_surface.title(one, data)
    if one.found is None:
        return Check(name, "fail", clean(one.refused), "No verdict for this response.", of)
    found = response_surface.quality(one.found)
    if found >= GIVEN:
        return Check(name, "pass", response_surface.accuracy(one), of=of)
    outcome = "caution" if found >= RANKED else "fail"
    return Check(name, outcome, response_surface.accuracy(one), "Add runs.", of)


def _not_analyzed(facts: Facts) -> Check:
    why = facts.warnings[0] if facts.warnings else "no reason was recorded"
    return Check("Analysis", "fail", why, "No verdict for this response.", facts.title)


def _normality(facts: Facts, alpha: float) -> Check:
    found, name = facts.assumptions.normality, "Residuals as from a normal distribution"
    if found is None or found.rj is None:
        finding = verdicts.normality(facts, alpha)
        return Check(name, "not applicable", finding, of=facts.title)
    rejected = verdicts.rejects_normality(facts, alpha)
    finding = f"{'rejected' if rejected else 'not rejected'} by Ryan-Joiner"
    if found.p_exact is not None:
        finding += f" ({p_phrase(found.p_exact)})"
    if not rejected:
        return Check(name, "pass", finding, of=facts.title)
    return Check(
        name,
        "caution",
        finding,
        "Small p-values are approximate; the verdicts rest on the size of the effect "
        "against what matters."
        + ("" if facts.ratio else " The log of a positive response often helps."),
        facts.title,
    )


def _untested(tests: Mapping[str, verdicts.SpreadTest], alpha: float) -> str:
    """Why neither test of the spread applies, said once where both have one reason."""
    reasons = {test.reason for test in tests.values()}
    if len(tests) == 2 and len(reasons) == 1:
        return f"neither Bartlett's nor Levene's test applies: {reasons.pop()}"
    return " ".join(verdicts.spread(k, tests.get(k), alpha) for k in ("bartlett", "levene"))


def _spread(facts: Facts, alpha: float) -> Check:
    name = "Equal spread of the cells"
    tests = facts.assumptions.spread
    applicable = {k: t for k, t in tests.items() if t.statistic is not None}
    if not applicable:
        return Check(name, "not applicable", _untested(tests, alpha), of=facts.title)
    against = [k.capitalize() for k, t in applicable.items() if verdicts.rejects(t, alpha)]
    said = listing(
        [f"{k.capitalize()} {p_phrase(verdicts.p_of(t))}" for k, t in applicable.items()]
    )
    if not against:
        return Check(name, "pass", f"not rejected ({said})", of=facts.title)
    return Check(
        name,
        "caution",
        f"rejected by {listing(against)} ({said})",
        "Intervals are too short for the cells that scatter most and too long for the others.",
        facts.title,
    )


def _sphericity(facts: Facts, data: ReportData) -> list[Check]:
    least = verdicts.least_sphericity(facts)
    if least is None:
        return []
    term, epsilon = least
    name = "Sphericity"
    finding = f"smallest epsilon {epsilon:.2f}, of {term_name(term, data.labels)}"
    changed = [
        term_name(row.term, data.labels)
        for row in facts.rows
        if row.p is not None and row.p_gg is not None and row.p < data.alpha <= row.p_gg
    ]
    if changed:
        return [
            Check(
                name,
                "caution",
                finding,
                f"The correction decides for {listing(changed)}: read the corrected p.",
                facts.title,
            )
        ]
    return [Check(name, "pass", f"{finding}; the correction changes no decision", of=facts.title)]


def _additivity(facts: Facts, data: ReportData) -> list[Check]:
    found = facts.assumptions.non_additivity
    if found is None or found.p is None or not math.isfinite(found.p):
        return []
    p = found.p
    name = f"Cells and {clean(data.block) or 'blocks'} add up"
    if p >= data.alpha:
        finding = f"not rejected by Tukey's one-degree test ({p_phrase(p)})"
        return [Check(name, "pass", finding, of=facts.title)]
    return [
        Check(
            name,
            "caution",
            f"rejected by Tukey's one-degree test ({p_phrase(p)})",
            f"Effects grow or shrink with the level of the {clean(data.block) or 'block'}: "
            "consider the log.",
            facts.title,
        )
    ]


def _resolution(facts: Facts, data: ReportData) -> Check:
    name = "Effects resolved by the mesh"
    known = [effect for effect in facts.effects if effect.u_num is not None]
    if not known:
        return Check(
            name,
            "not applicable",
            "No numerical uncertainty is known.",
            "Every claim holds at this mesh: the discretization was not examined.",
            facts.title,
        )
    open_ones = [effect for effect in facts.effects if effect.verdict == NOT_RESOLVED]
    if not open_ones:
        finding = f"U, added to the interval, leaves {_every(known, 'verdict')} as it is"
        return Check(name, "pass", finding, of=facts.title)
    needed = [
        f"below {bound(effect.u_needed, effect, facts)} for {term_name(effect.term, data.labels)}"
        for effect in open_ones
        if effect.u_needed is not None
    ]
    named = listing([term_name(effect.term, data.labels) for effect in open_ones])
    finding = f"U leaves {named} open, which the interval alone would decide"
    mend = f"Refine: U would have to be {listing(needed)}." if needed else "Refine the mesh."
    return Check(name, "caution", finding, mend, facts.title)


def _every(items: Sequence[Effect], noun: str) -> str:
    return f"the {noun}" if len(items) == 1 else f"each of {count(len(items), noun)}"


def _fragile(facts: Facts, data: ReportData) -> list[Check]:
    """Say which claims fall with one block."""
    known = [effect for effect in facts.effects if effect.lost_without is not None]
    if not known:
        return []
    block = clean(data.block) or "block"
    name = f"Claims hold with any one {block} left out"
    lost = [
        f"{term_name(effect.term, data.labels)} (not without {_some(effect.lost_without)})"
        for effect in known
        if effect.lost_without
    ]
    if not lost:
        many = {1: "the claim does", 2: "both claims do"}
        said = many.get(len(known), f"all {len(known)} claims do")
        return [Check(name, "pass", said, of=facts.title)]
    more = (
        f"Measure more {plural_of(block)} before relying on {'it' if len(lost) == 1 else 'them'}."
    )
    return [Check(name, "caution", f"fragile: {listing(lost)}", more, facts.title)]


def _some(blocks: Sequence[str] | None) -> str:
    named = [clean(name) for name in blocks or ()]
    return listing(named, "or") if len(named) < 4 else f"any one of {len(named)}"
