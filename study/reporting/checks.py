"""Checks that follow from the analysis: outcome, finding, and what it means for the reader."""

from __future__ import annotations

from collections.abc import Sequence

from study.reporting import assumptions, sentences
from study.reporting.data import Check, ReportData
from study.reporting.facts import MATTERS, Facts
from study.reporting.text import count, listing, term_name


def all_checks(data: ReportData, found: Sequence[Facts]) -> tuple[Check, ...]:
    """Gather the checks of the run, then the controls, then those of each analysis, worst first."""
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
            ]
        else:
            made.append(_not_analyzed(facts))
    order = {"fail": 0, "caution": 1, "not applicable": 2, "pass": 3}
    return tuple(sorted(made, key=lambda check: order[check.outcome]))


def _of_cases(data: ReportData) -> list[Check]:
    if not data.failures:
        return []
    finding = sentences.failures(data.failures, len(data.table))
    return [Check("Failed cases", "caution", finding, "See the failure map.")]


def _not_analyzed(facts: Facts) -> Check:
    why = facts.warnings[0] if facts.warnings else "no reason was recorded"
    return Check(f"Analysis of {facts.title}", "fail", why, "No verdict for this response.")


def _normality(facts: Facts, alpha: float) -> Check:
    found, name = facts.normality, f"Normal residuals, {facts.title}"
    finding = assumptions.normality(facts, alpha)
    if not found or found.get("rj") is None:
        return Check(name, "not applicable", finding)
    if assumptions.rejects_normality(facts, alpha):
        return Check(
            name,
            "caution",
            finding,
            "Small p-values are approximate; the verdicts rest on the size of the effect "
            "against what matters. A log transform often helps a positive response.",
        )
    return Check(name, "pass", finding)


def _spread(facts: Facts, alpha: float) -> Check:
    name = f"Equal spread, {facts.title}"
    tests = {key: test for key, test in facts.variance.items() if test}
    applicable = {k: t for k, t in tests.items() if t.get("statistic") is not None}
    both = ("bartlett", "levene")
    finding = " ".join(assumptions.spread(key, tests.get(key), alpha) for key in both)
    if not applicable:
        return Check(name, "not applicable", finding)
    if any(assumptions.rejects(test, alpha) for test in applicable.values()):
        return Check(
            name,
            "caution",
            finding,
            "Intervals are too short for the cells that scatter most and too long for the others.",
        )
    return Check(name, "pass", finding)


def _sphericity(facts: Facts, data: ReportData) -> list[Check]:
    finding = assumptions.sphericity(facts, data.labels)
    if not finding:
        return []
    name = f"Sphericity, {facts.title}"
    changed = [
        term_name(str(row["term"]), data.labels)
        for row in facts.rows
        if row.get("p_gg") is not None and row["p"] < data.alpha <= row["p_gg"]
    ]
    if changed:
        return [
            Check(
                name,
                "caution",
                finding,
                f"The correction decides for {listing(changed)}: read the corrected p.",
            )
        ]
    return [Check(name, "pass", finding, "No decision depends on the correction.")]


def _additivity(facts: Facts, data: ReportData) -> list[Check]:
    found = facts.non_additivity
    if not found or found.get("p") is None:
        return []
    p = float(found["p"])
    name = f"Additive blocks, {facts.title}"
    finding = assumptions.additivity(found, data)
    if p < data.alpha:
        return [
            Check(
                name,
                "caution",
                finding,
                "Effects grow or shrink with the level of the block: consider the log.",
            )
        ]
    return [Check(name, "pass", finding)]


def _resolution(facts: Facts, data: ReportData) -> Check:
    name = f"Effects resolved by the mesh, {facts.title}"
    known = [effect for effect in facts.effects if effect.over_u_num is not None]
    if not known:
        return Check(
            name,
            "not applicable",
            "No numerical uncertainty is known.",
            "Refine the mesh of one block before trusting small differences.",
        )
    weak = [e for e in known if (e.over_u_num or 0) < 3]
    named = listing([term_name(effect.term, data.labels) for effect in weak])
    if any(effect.verdict == MATTERS for effect in weak):
        return Check(name, "fail", f"Within 3 u_num: {named}.", "Refine before believing these.")
    if weak:
        return Check(
            name,
            "pass",
            f"{count(len(known) - len(weak), 'effect')} of {len(known)} exceed 3 u_num; "
            f"{named} {'is' if len(weak) == 1 else 'are'} within it.",
            "What lies within 3 u_num may be the mesh; none of it is called a difference.",
        )
    return Check(name, "pass", f"All {count(len(known), 'effect')} exceed 3 u_num.")
