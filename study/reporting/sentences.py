"""Every sentence of a report, made from numbers.

Each function takes facts and returns finished plain text (never markup: the templates
escape it). Wording rules: p never decides alone; a test is "not rejected", data are never
called "normal"; units always; ratios for log responses.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from study.reporting.data import Failure, ReportData
from study.reporting.facts import CANNOT_TELL, MATTERS, NO_DIFFERENCE, Effect, Facts
from study.reporting.text import (
    MISSING,
    THIN,
    TIMES,
    clean,
    count,
    interval,
    listing,
    name_of,
    p_phrase,
    percent,
    quantity,
    ratio,
    ratio_digits,
    sentence,
    significant,
    term_name,
)

Labels = Mapping[str, str] | None

_SOURCES = {
    "E0": "independent replicates in the cells",
    "E1": "measured replicates as blocks",
    "E2": "measurement noise, by bootstrap through the fit",
    "E3": "mesh-seed replicates",
    "E4": "numerical uncertainty",
    "E5": "pooled high-order interactions (an assumption)",
    "E6": "Lenth's pseudo standard error",
    "E7": "none",
}


def size(effect: Effect, facts: Facts) -> str:
    """Largest difference of an effect with its unit, or as a ratio."""
    if effect.ratio:
        return ratio(effect.difference)
    return quantity(effect.difference, facts.difference_unit)


def size_interval(effect: Effect, facts: Facts) -> str:
    """Simultaneous 95 % interval of the largest difference."""
    if effect.ratio:
        return interval(effect.low, effect.high, "", ratio_digits(effect.difference))
    return interval(effect.low, effect.high, facts.difference_unit)


def practical(effect: Effect, facts: Facts) -> str:
    """Return the smallest difference that matters, as it was declared."""
    if effect.practical is None:
        return MISSING
    text = f"{float(significant(effect.practical).replace(',', '')):g}"
    return f"{TIMES}{THIN}{text}" if effect.ratio else f"{text}{THIN}{facts.difference_unit}"


def verdict(effect: Effect, facts: Facts, labels: Labels = None) -> str:
    """One sentence: what a factor does to a response, and how sure that is.

    The verdict itself comes from the analysis; this says it with its numbers.
    """
    name = term_name(effect.term, labels)
    if effect.difference is None:
        return sentence(f"{name}: {effect.verdict}; {effect.why or 'no effect could be estimated'}")
    numbers = f"{size(effect, facts)} (95{THIN}% interval {size_interval(effect, facts)})"
    if effect.low is None:
        numbers = f"{size(effect, facts)}"
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


def _repeatable(effect: Effect) -> str:
    """Say that a tiny difference may well be real: p never decides alone."""
    if effect.p is None or effect.p >= 0.05:
        return ""
    return f" (repeatable, {p_phrase(effect.p)}, but too small to matter)"


def _matters(effect: Effect, facts: Facts, name: str, numbers: str) -> str:
    if not effect.is_main or effect.pair is None:
        return sentence(f"{name} matters for the {facts.title}: {numbers}")
    low, high = clean(effect.lowest), clean(effect.highest)
    verb = f"{high} gives {size(effect, facts)} " + (
        f"the {facts.title} of {low}" if effect.ratio else f"more {facts.title} than {low}"
    )
    if effect.low is not None:
        verb += f" (95{THIN}% interval {size_interval(effect, facts)})"
    return sentence(f"{name} matters: {verb}")


def answer(data: ReportData, found: Sequence[Facts]) -> tuple[str, ...]:
    """Three sentences that answer the study's question: what matters, what does not, so what."""
    if not any(facts.terms for facts in found):
        return ("No response could be analyzed; the reasons stand below.",)
    return (
        " ".join(_which(data, facts) for facts in found if facts.terms),
        _one_not_other(data, found),
        best_cell(data, found),
    )


def _which(data: ReportData, facts: Facts) -> str:
    named: dict[str, list[Effect]] = {MATTERS: [], NO_DIFFERENCE: [], CANNOT_TELL: []}
    for effect in sorted(facts.effects, key=_magnitude, reverse=True):
        named.setdefault(effect.verdict, named[CANNOT_TELL]).append(effect)
    parts = []
    if named[MATTERS]:
        parts.append(
            listing([f"{_label(e, data)} ({_to_reader(e, facts)})" for e in named[MATTERS]])
            + (" matters" if len(named[MATTERS]) == 1 else " matter")
        )
    if named[NO_DIFFERENCE]:
        names = listing([_label(e, data) for e in named[NO_DIFFERENCE]])
        verb = "makes" if len(named[NO_DIFFERENCE]) == 1 else "make"
        parts.append(f"{names} {verb} no practical difference")
    if named[CANNOT_TELL]:
        names = listing([_label(e, data) for e in named[CANNOT_TELL]])
        parts.append(f"for {names} these data cannot tell")
    return sentence(f"for the {facts.title}, " + "; ".join(parts))


def _label(effect: Effect, data: ReportData) -> str:
    return term_name(effect.term, data.labels)


def _to_reader(effect: Effect, facts: Facts) -> str:
    return size(effect, facts) if effect.ratio else f"{size(effect, facts)} between extremes"


def _magnitude(effect: Effect) -> float:
    if effect.difference is None or not effect.practical:
        return 0.0
    if effect.ratio:
        return abs(effect.difference - 1) / max(abs(effect.practical - 1), 1e-12)
    return abs(effect.difference) / effect.practical


def _one_not_other(data: ReportData, found: Sequence[Facts]) -> str:
    """Say where a factor is immaterial for one response and material for another."""
    by_factor: dict[str, dict[str, Effect]] = {}
    for facts in found:
        for effect in facts.effects:
            by_factor.setdefault(effect.term, {})[facts.name] = effect
    titles = {facts.name: facts for facts in found}
    for term, effects in by_factor.items():
        yes = [n for n, e in effects.items() if e.verdict == MATTERS]
        no = [n for n, e in effects.items() if e.verdict != MATTERS]
        if yes and no:
            changed = titles[yes[0]]
            return sentence(
                f"the choice of {name_of(term, data.labels)} "
                f"{_cannot_be_seen(effects[no[0]])} the {titles[no[0]].title}, yet it changes the "
                f"{changed.title} by {change(effects[yes[0]], changed)}"
            )
    return _interactions(data, found)


def _cannot_be_seen(effect: Effect) -> str:
    if effect.verdict == NO_DIFFERENCE:
        return "makes no practical difference to"
    return "cannot be told from"


def change(effect: Effect, facts: Facts) -> str:
    """Size of a change in words: ``37.3 %`` for a ratio of 1.373."""
    if effect.ratio and effect.difference is not None:
        return f"{percent(effect.difference - 1)} (ratio {significant(effect.difference)})"
    return size(effect, facts)


def _interactions(data: ReportData, found: Sequence[Facts]) -> str:
    strong = [
        (facts, effect)
        for facts in found
        for effect in facts.interactions
        if effect.verdict == MATTERS
    ]
    if not strong:
        return "No interaction was found to matter: each factor may be chosen on its own."
    facts, effect = max(strong, key=lambda item: _magnitude(item[1]))
    return sentence(
        f"the factors do not act alone: {term_name(effect.term, data.labels)} matters for the "
        f"{facts.title} ({size(effect, facts)})"
    )


def best_cell(data: ReportData, found: Sequence[Facts]) -> str:
    """Name the best cell of the first response that has a better end, and the tie around it."""
    from study.reporting.facts import cells
    from study.reporting.front import practical_of

    for facts in found:
        if facts.response.better not in ("lower", "higher"):
            continue
        frame = cells(data, facts.name)
        if frame.empty:
            continue
        if facts.response.better == "higher":
            frame = frame.iloc[::-1].reset_index(drop=True)
        mean = float(frame["mean"].iloc[0])
        levels = listing([clean(v) for v in frame.loc[0, list(data.factors)]], "and")
        limit = practical_of(facts, frame)
        near = int(((frame["mean"] - mean).abs() <= limit).sum()) - 1
        tie = (
            f"; {count(near, 'other cell')} {'lies' if near == 1 else 'lie'} within "
            f"{limit:.3g}{THIN}{facts.difference_unit} of it, so cost may decide"
            if near
            else "; no other cell comes within the difference that matters"
        )
        word = "lowest" if facts.response.better == "lower" else "highest"
        return sentence(
            f"the {word} {facts.title} is {quantity(mean, facts.unit)}, with {levels}{tie}"
        )
    return "No response has a better end, so no cell is the best; the effects are what counts."


def would_change(data: ReportData, found: Sequence[Facts]) -> str:
    """Say what would change the answer."""
    doubts = [
        term_name(effect.term, data.labels)
        for facts in found
        for effect in facts.effects
        if effect.verdict == CANNOT_TELL
    ]
    parts = []
    if doubts:
        unit = clean(data.block) if data.block else "replicate"
        parts.append(
            f"more {unit}s would narrow the interval"
            f"{'s' if len(set(doubts)) > 1 else ''} of {listing(list(dict.fromkeys(doubts)))}"
        )
    if data.assumed:
        names = listing([name_of(key, data.labels) for key in data.assumed])
        parts.append(f"a measured value of what is assumed here ({names}) could move every result")
    if data.failures:
        parts.append(f"{count(len(data.failures), 'failed case')} may hide an effect")
    if data.virtual:
        parts.append("real measurements would, since these were generated")
    if not parts:
        parts.append(
            "a different smallest difference that matters, or measurements of another material"
        )
    return sentence("; ".join(parts))


def error_term(facts: Facts, data: ReportData) -> str:
    """Say where the error of the table comes from and what its p answers."""
    if not facts.source:
        return "No error term: the response was not analyzed."
    what = _SOURCES.get(facts.source, facts.source)
    reason = f": {facts.reason}" if facts.reason else ""
    text = sentence(f"the error term is {facts.source}, {what}{reason}")
    if facts.question:
        question = facts.question.rstrip(".")
        if data.block and data.block != "block":
            question = re.sub(r"\bblock\b", lambda _: clean(data.block), question)
        end = "" if question.endswith(("?", ")")) else "."
        text += f" The p-values answer one question: {question}{end}"
    if data.virtual:
        text += (
            " The measurements are virtual, so p describes the scatter of their generator; the "
            "verdicts rest on the effects against what matters and on the numerical uncertainty."
        )
    return text


def distinct(facts: Facts, data: ReportData) -> str:
    """Say how many computations were really different."""
    total = 1
    for levels in data.factors.values():
        total *= len(levels)
    if facts.distinct is None or facts.distinct >= total:
        return ""
    return (
        f"Of {count(total, 'cell')} only {facts.distinct} are distinct computations: the others "
        "agree in every block. Tests of the residuals use one of each group."
    )


def failures(items: Sequence[Failure], total: int) -> str:
    """Failures in one sentence; none is said plainly."""
    if not items:
        return f"None: {'the case' if total == 1 else f'all {total:,} cases'} gave a response."
    kinds: dict[str, int] = {}
    for item in items:
        kinds[item.status] = kinds.get(item.status, 0) + 1
    named = listing([f"{number} {clean(status)}" for status, number in kinds.items()])
    share = percent(len(items) / total) if total else MISSING
    return (
        f"{count(len(items), 'case')} of {total:,} ({share}) failed: {named}. They are not missing "
        "at random, so effects of the factors they share are uncertain beyond their intervals."
    )
