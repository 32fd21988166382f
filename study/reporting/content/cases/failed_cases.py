"""Which settings fail: rules in words, then a test of every factor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from study.reporting.content.table import Table
from study.reporting.numbers import MISSING
from study.reporting.text import clean, count, listing, name_of

if TYPE_CHECKING:
    from study.analysis.assumption.failed_cases import FailurePattern, FailureRule, FailureTest
    from study.study_result.report_data import Retried

#: levels of a factor that the table lists, those that fail most, and causes in a sentence
_LISTED = 4
#: p below which a factor has to do with failing
_ALPHA = 0.05


def sentences(pattern: FailurePattern, labels: Mapping[str, str]) -> tuple[str, ...]:
    """Say where cases fail, why, and which factors have to do with it.

    Parameters
    ----------
    pattern : FailurePattern
        Of a study with failed cases.
    labels : mapping of str to str
        Better names of factors.

    Returns
    -------
    tuple of str
        Sentences, the plainest first.
    """
    causes = _causes(pattern)
    if pattern.failed == pattern.total:
        return (
            f"Every case failed ({causes}): no setting of this study gives an answer, so none of "
            "its factors can be blamed.",
        )
    where = "; ".join(_rule(rule, labels) for rule in pattern.rules)
    bad, rest = pattern.elsewhere
    if where and rest:
        found = f"Where cases fail: {where}; elsewhere {bad:,} of {rest:,}."
    elif where:
        found = f"Where cases fail: {where}."
    else:
        found = (
            f"{pattern.failed:,} of {pattern.total:,} cases failed. No level of a factor, and no "
            "combination of two or three, holds enough of them to be named as the place."
        )
    return found, f"Causes: {causes}.", _blamed(pattern, labels)


def _causes(pattern: FailurePattern) -> str:
    """Count the causes, those behind the most frequent ones together."""
    counted = [f"{number:,} {clean(cause)}" for cause, number in pattern.causes.items()]
    others = sum(list(pattern.causes.values())[_LISTED:])
    return "; ".join([*counted[:_LISTED], *([f"{others:,} others"] if others else [])])


def _rule(rule: FailureRule, labels: Mapping[str, str]) -> str:
    """Write the settings of a rule and how many of its cases failed."""
    settings = [
        f"{name_of(factor, labels)} {clean(level)}" for factor, level in rule.settings.items()
    ]
    return f"{', '.join(settings)}: {rule.failed:,} of {rule.total:,}"


def _blamed(pattern: FailurePattern, labels: Mapping[str, str]) -> str:
    blamed = [
        f"{name_of(test.factor, labels)} (p {_p(test.p_holm)})"
        for test in pattern.tests
        if test.p_holm < _ALPHA
    ]
    if not blamed:
        return (
            "No factor's levels differ in how often their cases fail by more than chance explains."
        )
    return f"Failing depends on {listing(blamed)}, adjusted for the number of factors."


def tests(pattern: FailurePattern, labels: Mapping[str, str]) -> Table:
    """Test of every factor: failed cases by level, p, and p adjusted for their number.

    Parameters
    ----------
    pattern : FailurePattern
        One row of the table for each of its tests; ``raw`` has a row a factor and level.
    labels : mapping of str to str
        Better names of factors.
    """
    rows = tuple(
        (name_of(one.factor, labels), _p(one.p), _p(one.p_holm), _levels(one), one.method)
        for one in pattern.tests
    )
    raw = tuple(
        {
            "factor": one.factor,
            "level": level,
            "failed": bad,
            "cases": total,
            "p": one.p,
            "p_holm": one.p_holm,
            "method": one.method,
        }
        for one in pattern.tests
        for level, (bad, total) in one.counts.items()
    )
    note = (
        "Fisher's exact test of levels against failed and not failed (Freeman and Halton 1951 for "
        "more than two levels), with Holm's adjustment. Cases of one cell mostly fail together, so "
        "whole cells are permuted where a cell has several."
    )
    columns = ("factor", "p", "p (Holm)", "failed by level", "method")
    return Table("failure_tests", columns, rows, 1, 2, note, raw)


def retried_sentence(items: Sequence[Retried]) -> str:
    """Say how many cases have other settings than the design's; empty where none has.

    Parameters
    ----------
    items : sequence of Retried
        One a case; the status ``"converged"`` counts as an answer.
    """
    if not items:
        return ""
    solved = sum(item.status == "converged" for item in items)
    were = "was" if len(items) == 1 else "were"
    return (
        f"{count(len(items), 'case')} failed as designed and {were} "
        f"computed with other settings, as the design declares: {solved:,} then gave an answer. "
        "What was changed is part of their difference from the other cases."
    )


def retried_table(items: Sequence[Retried], block: str) -> Table:
    """List every case whose settings are not those of the design: why, what, and the outcome.

    Parameters
    ----------
    items : sequence of Retried
        One row each; several attempts at a case are joined in order.
    block : str
        What a block is (``"phantom"``), the head of its column; empty gives ``block``.
    """
    rows = tuple(
        (
            clean(item.case_id, 16),
            " \N{MIDDLE DOT} ".join(clean(level) for level in item.levels.values()),
            clean(item.block) or MISSING,
            "; then ".join(f"{clean(n['cause'])}: {clean(n['message'], 200)}" for n in item.notes),
            "; ".join(clean(n["what"]) for n in item.notes),
            clean(item.status),
        )
        for item in items
    )
    return Table(
        "retried", ("case", "cell", block or "block", "failed", "changed", "outcome"), rows, 6
    )


def _levels(test: FailureTest) -> str:
    shares = sorted(test.counts.items(), key=lambda one: -one[1][0] / one[1][1])
    shown = [f"{clean(level)}: {bad:,} of {total:,}" for level, (bad, total) in shares[:_LISTED]]
    return "; ".join([*shown, *(["\N{HORIZONTAL ELLIPSIS}"] if len(shares) > _LISTED else [])])


def _p(value: float) -> str:
    return "< 0.001" if value < 0.001 else f"{value:.3f}"
