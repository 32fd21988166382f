"""Tests that are adjusted together: those of a response, those declared, those of a whole study."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from study.analysis.effects.multiplicity import FamilyTest, response_family, study_family
from study.study_result.report_data import ResponseAnalysis

if TYPE_CHECKING:
    from study.design.sections.analysis import Analysis


def adjusted(analyses: Sequence[ResponseAnalysis], asked: Analysis) -> tuple[ResponseAnalysis, ...]:
    """Adjust p by Holm's method over the family that a design declares.

    Parameters
    ----------
    analyses : sequence of ResponseAnalysis
        Adjusted within each response, which is the default.
    asked : Analysis
        Its ``family`` and ``primary`` terms.

    Returns
    -------
    tuple of ResponseAnalysis
        With the p of Holm, and a note that says which tests it covers.
    """
    if asked.family == "response" and not asked.primary:
        return tuple(analyses)
    raw = {
        a.name: {effect.term: effect.p for effect in a.result.effects}
        for a in analyses
        if a.result is not None
    }
    if asked.family == "study":
        tests = list(study_family(raw, asked.primary))
    else:
        tests = [t for name, p in raw.items() for t in response_family(name, p, asked.primary)]
    return tuple(_with(a, [t for t in tests if t.response == a.name], asked) for a in analyses)


def _with(
    analysis: ResponseAnalysis, tests: Sequence[FamilyTest], asked: Analysis
) -> ResponseAnalysis:
    if analysis.result is None:
        return analysis
    p = {test.term: test.p_holm for test in tests}
    effects = tuple(replace(e, p_holm=p[e.term]) for e in analysis.result.effects)
    which = f"the primary terms {', '.join(asked.primary)}" if asked.primary else "all terms"
    where = "all responses together" if asked.family == "study" else "this response"
    count = max((test.family for test in tests), default=0)
    note = f"p (Holm) is adjusted for {count} tests: {which} of {where}"
    return replace(analysis, result=replace(analysis.result, effects=effects).noted(note))
