"""The first page in words: an answer of few sentences, a line for every check, what to do."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from study.reporting.content import (
    comparison_content,
    effect_words,
    recommendation,
    sentences,
    surface_content,
)
from study.reporting.content.blocks import Card, CheckGroup, Checks
from study.reporting.content.report_facts import Facts
from study.reporting.content.text import count, listing, sentence
from study.reporting.results.study_result import ReportData

#: sentences of the answer, and responses that it speaks of one by one
MOST_SENTENCES = 5
MOST_RESPONSES = 3
_END = re.compile(r"(?<=[.?!])\s+(?=[A-Z\N{MULTIPLICATION SIGN}])")


def short_answer(data: ReportData, all_facts: Sequence[Facts]) -> tuple[str, ...]:
    """Answer in at most five sentences: verdicts first, then the best setting and the doubts."""
    analyzed = [facts for facts in all_facts if facts.terms]
    if not analyzed:
        return in_few(sentences.answer(data, all_facts))
    lines = [sentences.verdicts_of(data, facts) for facts in analyzed[:MOST_RESPONSES]]
    if len(analyzed) > MOST_RESPONSES:
        more = count(len(analyzed) - MOST_RESPONSES, "more response")
        lines.append(f"The figure below shows the effects on {more}.")
    ranked = (
        *lines,
        *comparison_content.answer_lines(data.beside, data.labels),
        *sentences.left_out(data, all_facts),
        sentences.without_verdict(all_facts),
        recommendation.best_cell(data, all_facts)
        if any(f.response.better for f in analyzed)
        else "",
        *effect_words.unknowns(data, all_facts),
        *effect_words.by_condition(data, all_facts),
        sentences.interactions(data, all_facts),
    )
    return in_few(ranked)


def in_few(lines: Iterable[str]) -> tuple[str, ...]:
    """Return the lines that together have at most five sentences, the first of them cut to that."""
    shown: list[str] = []
    left = MOST_SENTENCES
    for line in filter(None, lines):
        parts = _END.split(line)
        if len(parts) <= left or not shown:
            shown.append(" ".join(parts[:left]))
            left -= min(len(parts), left)
    return tuple(shown)


def report_card(checks: Checks, data: ReportData) -> Card:
    """Return one line a check, the worst first, and one for the notes of the second page."""
    lines = [_card_line(group) for group in checks.groups]
    if data.warnings or data.data_notes:
        notes = count(len(data.warnings) + len(data.data_notes), "note")
        lines.append(("note", "Notes", f"{notes} on the data and the run, on the second page."))
    return Card(lines)


def _card_line(group: CheckGroup) -> tuple[str, str, str]:
    worst = [check for check in group.items if check.outcome == group.outcome]
    meaning = worst[0].consequence or worst[0].finding
    named = listing([check.of for check in worst if check.of])
    if named and len(worst) < len(group.items):
        meaning = f"{named}: {meaning}"
    return group.outcome, sentence(group.name).rstrip("."), sentence(meaning)


def what_to_do(data: ReportData, all_facts: Sequence[Facts]) -> tuple[str, ...]:
    """Recommendation of every response that has a better end; why there is none otherwise."""
    if data.surfaces and not any(facts.terms for facts in all_facts):
        where = {surface_content.title(one, data): one for one in data.surfaces[:MOST_RESPONSES]}
        return tuple(
            sentence(f"{name}: {' '.join(ends)}")
            for name, one in where.items()
            if (ends := surface_content.extremes(one, data))
        )
    if data.is_table:
        return ()
    lines = tuple(
        recommendation.recommendation(data, facts)
        for facts in all_facts
        if facts.terms and facts.response.better and data.table[facts.name].notna().any()
    )
    if lines:
        return lines
    if not any(facts.terms for facts in all_facts):
        return ("Nothing can be recommended, because no response could be analyzed.",)
    return (
        "No goal (minimize or maximize) was given, so no best setting is named: choose by the "
        "effects above and by cost.",
    )
