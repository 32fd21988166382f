"""Every sentence of a report, made from numbers.

Each function takes facts and returns finished plain text (never markup: the templates
escape it). Wording rules: p never decides alone; a test is "not rejected", data are never
called "normal"; units always; ratios for log responses.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import permutations
from typing import TYPE_CHECKING

from study.ground.arrays import gathered
from study.record.record import Record, cell_names
from study.reporting.content import effect_words, surface_content
from study.reporting.content.effect_words import (
    blocks_needed,
    change_in_words,
    size,
    size_interval,
    sole_setting,
    with_unit,
)
from study.reporting.content.report_facts import (
    ERROR_TERMS,
    Facts,
    cells,
    comparable,
    practical_of,
)
from study.reporting.content.text import (
    MISSING,
    THIN,
    clean,
    count,
    decimals_that_count,
    duration,
    level,
    listing,
    name_of,
    p_phrase,
    percent,
    plural_of,
    quantity,
    rounded,
    sentence,
    significant,
    term_name,
    trimmed,
)
from study.reporting.results.study_result import ANSWERED, FITTED_CURVE, ReportData
from study.statistics.analysis.anova_table import Effect
from study.statistics.analysis.simple_effects import (
    CANNOT_TELL,
    MATTERS,
    NO_DIFFERENCE,
    NOT_RESOLVED,
    ONE_SPECIMEN,
)

if TYPE_CHECKING:
    import pandas as pd

#: responses that a short answer speaks of one by one
MOST_RESPONSES = 3


def answer(
    data: ReportData, all_facts: Sequence[Facts], *, is_short: bool = False
) -> tuple[str, ...]:
    """Sentences that answer the study's question: what matters, what does not, so what.

    The short ones speak of three responses, and leave what to use to the recommendation.
    """
    analyzed = [facts for facts in all_facts if facts.terms]
    if not analyzed:
        if (failed := data.failures) and len(failed) >= len(data.table):
            causes = Counter(item.message or item.status for item in failed)
            ((message, number),) = causes.most_common(1)
            total, case = len(failed), clean(failed[0].case_id)
            every = "The only case failed" if total == 1 else f"All {total:,} cases failed"
            return (
                f"{every}, so there is nothing to compare.",
                f"What {number:,} of {total:,} reported: {clean(message, 300)}",
                f"The command study why {case} explains the first one.",
            )
        if data.surfaces:
            # of one surface there is room to say all
            in_short = is_short and len(data.surfaces) > 1
            return tuple(
                surface_content.surface_answer(fit, data, is_short=in_short)
                for fit in data.surfaces
            )
        if data.is_table and (notes := [note for facts in all_facts for note in facts.warnings]):
            return tuple(sentence(clean(note)) for note in notes)
        if not data.analyses:
            return (f"{NO_RESPONSE}, so nothing was analyzed: add one, for example peak_force.",)
        return ("No response could be analyzed; the warnings say why.",)
    named = analyzed[:MOST_RESPONSES] if is_short else analyzed
    rest = count(len(analyzed) - len(named), "more response")
    first = [*(verdicts_of(data, facts) for facts in named), *left_out(data, all_facts)]
    has_size = any(facts.has_size for facts in analyzed)
    nouns = [facts.noun for facts in all_facts if not facts.terms]
    parts = (
        *(first if is_short else [" ".join(filter(None, first))]),
        *(sentence(clean(fit.finding)) for fit in data.checks if fit.name in ANSWERED),
        f"The figure below shows the effects on {rest}." if named != analyzed else "",
        without_size(data, all_facts),
        f"There is no verdict on {listing(nouns)}: the checks say why." if nouns else "",
        *effect_words.by_condition(data, all_facts),
        *effect_words.unknowns(data, all_facts),
        _one_not_other(data, all_facts) if has_size else "",
        *(() if is_short else recommendations(data, all_facts)),
    )
    return tuple(text for text in parts if text)


def without_size(data: ReportData, all_facts: Sequence[Facts]) -> str:
    """Say of which responses no smallest difference that matters was given, and how to give it."""
    judged = [facts for facts in all_facts if facts.effects]
    nouns = [facts.noun for facts in judged if not facts.has_size]
    if not nouns:
        return ""
    here = "" if len(nouns) == len(judged) else f" for {listing(nouns)}"
    elsewhere = data.is_table or bool(data.imported)
    mend = "with --practical" if elsewhere else 'as practical = ".." in its [[response]]'
    return (
        f"No smallest difference that matters was given{here}, so no factor has a verdict"
        f"{here and ' there'}: a small p says that an effect is there, not that it is large enough "
        f"to care. Give one {mend}."
    )


def tested(data: ReportData, facts: Facts) -> str:
    """Say which terms differ by Holm's p, and which are not shown to."""
    terms = [e for e in facts.terms if e.p_holm is not None]
    if not terms:
        return "There is no error term, so nothing is tested."
    differ = [e for e in terms if e.p_holm is not None and e.p_holm < facts.alpha]
    shown = [f"{_label(e, data)} ({size(e, facts)}, {p_phrase(e.p_holm)})" for e in differ]
    rest = [_label(e, data) for e in terms if e not in differ]
    parts = [f"an effect is shown of {listing(shown)}"] if shown else []
    none = "none" if shown else "no effect"
    parts += [f"{none} is shown of {listing(rest, 'or')}"] if rest else []
    adjusted = f"at {facts.alpha:g}, adjusted by Holm for {count(len(terms), 'term')}"
    return sentence(f"for {facts.noun}, {'; '.join(parts)} ({adjusted})")


def left_out(data: ReportData, all_facts: Sequence[Facts]) -> list[str]:
    """Say which levels failed in too many of their cells to be compared with the others."""
    gone = dict.fromkeys(
        # a number alone names no level
        clean(f"{_label(effect, data)} {lost}" if lost[:1].isdigit() else lost)
        for facts in all_facts
        for effect in facts.effects
        if effect.levels and set(effect.levels) < set(data.factors.get(effect.term, ()))
        for lost in data.factors[effect.term]
        if lost not in effect.levels
    )
    why = "more than half of their cases failed, or every one on the finest mesh"
    return [f"Left out, because {why}: {listing(list(gone))}."] if gone else []


#: how a sentence on a verdict begins that decides nothing
_OPEN = {
    NOT_RESOLVED: "the meshes are too coarse to show whether",
    CANNOT_TELL: "these data cannot show whether",
}


def verdicts_of(data: ReportData, facts: Facts) -> str:
    """Say in one sentence which choices matter for a response, which do not, which is open."""
    if facts.effects and not facts.has_size:
        return tested(data, facts)
    ranked = sorted(effect_words.choices(data, facts), key=_magnitude, reverse=True)
    sure = {MATTERS, NO_DIFFERENCE, NOT_RESOLVED}
    named = gathered((e.verdict if e.verdict in sure else CANNOT_TELL, e) for e in ranked)
    parts = []
    if large := named.get(MATTERS):
        listed = listing([f"{_label(e, data)} ({_to_reader(e, facts, data)})" for e in large])
        several = len(large) > 1
        parts.append(f"the choice{'s' * several} of {listed} matter{'s' * (not several)}")
    if small := named.get(NO_DIFFERENCE):
        with_doubts = [
            _label(e, data)
            + " (where all its levels were measured)" * e.is_partial
            + (f" (not shown if {blocks_needed(e, facts)} is left out)" if e.lost_without else "")
            + f" ({_LIKE_THE_OTHERS})" * (e.term in facts.hang_on_missing)
            + f" ({e.condition})" * bool(e.condition)
            for e in small
        ]
        choice = "that of" if parts else "the choice of"
        parts.append(f"{choice} {listing(with_doubts, 'or')} makes no practical difference")
    parts += [
        f"{start} {listing([_label(e, data) for e in named[verdict]], 'or')} matters"
        for verdict, start in _OPEN.items()
        if verdict in named
    ]
    if not parts:
        return ""
    fitted = facts.scored_on == FITTED_CURVE
    sample = " (of the curves that were fitted: a fit is no prediction)" if fitted else ""
    return sentence(f"for {facts.noun}{sample}, " + "; ".join(parts))


NO_RESPONSE = "The design names no [[response]]"
_LIKE_THE_OTHERS = "only if the missing responses are like the others"


def _label(effect: Effect, data: ReportData) -> str:
    return term_name(effect.term, data.labels)


def _to_reader(effect: Effect, facts: Facts, data: ReportData) -> str:
    """Size of an effect that matters, and the blocks without which the claim falls."""
    shown = effect_words.change(effect, facts, data.labels)
    if sole_setting(effect):
        shown += f"; {size(effect, facts)} on average"
    elif not effect.is_ratio:
        shown += " between extremes"
    if effect.lost_without:
        shown += f"; not so if {blocks_needed(effect, facts)} is left out"
    shown += f"; {effect.condition}" * bool(effect.condition)
    return shown + f"; {_LIKE_THE_OTHERS}" * (effect.term in facts.hang_on_missing)


def _magnitude(effect: Effect) -> float:
    if effect.range is None or not effect.practical:
        return 0.0
    if effect.is_ratio:
        return abs(effect.range - 1) / max(abs(effect.practical - 1), 1e-12)
    return abs(effect.range) / effect.practical


def _one_not_other(data: ReportData, all_facts: Sequence[Facts]) -> str:
    """Say where a factor is immaterial for one response and material for another."""
    by_factor = gathered(
        (effect.term, (effect, facts))
        for facts in all_facts
        for effect in effect_words.choices(data, facts)
    )
    contrasts = [
        (*unseen, *seen)
        for effects in by_factor.values()
        for unseen, seen in permutations(effects, 2)
        if seen[0].verdict == MATTERS
        and unseen[0].verdict != MATTERS
        and unseen[0].practical is not None
    ]
    if not contrasts:
        return interactions(data, all_facts)
    # two claims say more than a claim and a doubt
    unseen, where, seen, facts = min(contrasts, key=lambda of: of[0].verdict != NO_DIFFERENCE)
    changed, other = f"{facts.noun} by {change_in_words(seen, facts, data.labels)}", where.noun
    choice = f"the choice of {name_of(seen.term, data.labels)}"
    if unseen.verdict == NO_DIFFERENCE:
        return sentence(
            f"{choice} makes no practical difference to {other}, yet it changes {changed}"
        )
    return sentence(
        f"{choice} changes {changed}; these data cannot show whether it changes {other}"
    )


def interactions(data: ReportData, all_facts: Sequence[Facts]) -> str:
    """Say which factors do not act alone, or which may be chosen independently; of one, nothing."""
    strong = [
        (effect, facts)
        for facts in all_facts
        for effect in facts.interactions
        if effect.strength == MATTERS
    ]
    if not strong:
        return _no_interaction(data, all_facts)
    effect, facts = max(strong, key=lambda of: _magnitude(of[0]))
    return sentence(
        f"the factors do not act alone: in {facts.noun}, {_label(effect, data)} differ by "
        f"{size(effect, facts)} from what each does on average"
    )


def _no_interaction(data: ReportData, all_facts: Sequence[Facts]) -> str:
    if sum(len(levels) > 1 for levels in data.factors.values()) < 2:
        return ""
    if not any(facts.interactions for facts in all_facts):
        return "Interactions are no part of this analysis, so it cannot rule them out."
    every_factor = [e for facts in all_facts for e in effect_words.choices(data, facts)]
    names = dict.fromkeys(_label(e, data) for e in every_factor)
    together = {_label(e, data) for e in every_factor if not _may_be_chosen_alone(e)}
    alone = [name for name in names if name not in together]
    if not together:
        measured = " that was measured" * any(e.is_partial for e in every_factor)
        return (
            f"Each factor can be chosen independently: at every setting of the others{measured} it "
            "makes no practical difference, or the same level is best."
        )
    if not alone:
        return "An interaction cannot be excluded; choose these factors jointly."
    rest = listing([name for name in names if name in together])
    independent = sentence(f"{listing(alone)} can be chosen independently of the other factors")
    return f"{independent} For {rest} this is unproven."


def _may_be_chosen_alone(effect: Effect) -> bool:
    """Whether a factor makes no difference anywhere, or one level is the best everywhere."""
    if effect.verdict != MATTERS:
        return effect.verdict == NO_DIFFERENCE
    return any(
        all((level, other) in effect.always for other in effect.levels if other != level)
        or all((other, level) in effect.always for other in effect.levels if other != level)
        for level in effect.levels
    )


def error_term(facts: Facts, data: ReportData) -> str:
    """Say where the error of the table comes from, what its p answers and how it was made."""
    if facts.result is None:
        return "No error term: the response was not analyzed."
    term = facts.result.error_term
    reason = f": {term.reason}" if term.reason else ""
    what = f"the error term is {term.source}, {ERROR_TERMS.get(term.source, term.source)}{reason}"
    question = term.question.rstrip(".")
    if match := re.fullmatch(r"(.*\?)\s*\((.*)\)", question):
        question = f"{match[1]} {sentence(match[2])}"
    if question:
        start = "The p-values answer one question"
        if question.startswith("no p: "):
            start, question = "There are no p-values", question.removeprefix("no p: ")
        question = f" {start}: {question}{'' if question[-1] in '.?' else '.'}"
    text, block = f"{sentence(what)}{question}", clean(data.block)
    if block in ("", "block"):
        return text
    # what the blocks are: phantoms, batches
    many = plural_of(block)
    return re.sub(r"levels of block|blocks?\b", lambda m: block if m[0] == "block" else many, text)


_BY_TERM = 'U bounds the %s error of the difference (how: docs/verdicts.md, "Numerical error").'
_OF_MESH = " For mesh density the difference is itself the mesh error, so no U is given."
_BY_COLUMN = "U, the bound of the numerical error, is the same for every factor."


def numerical(all_facts: Sequence[Facts], refined: str = "mesh") -> str:
    """Say what the numerical uncertainty beside an effect is; empty where none is known."""
    bounded = [facts for facts in all_facts if any(e.u_num is not None for e in facts.terms)]
    if not bounded:
        return ""
    by_term = [f for f in bounded if f.result and f.result.u_num_by_term]
    open_terms = {e.term for facts in bounded for e in facts.effects if e.u_num is None}
    meshes = open_terms & {"model.mesh", "model.mesh_size"}
    unknown = _OF_MESH * bool(meshes) + _NO_BOUND * bool(open_terms - meshes)
    if not by_term:
        return _BY_COLUMN + unknown
    if len(by_term) == len(bounded):
        return _BY_TERM % refined + unknown
    titles = listing([facts.title for facts in by_term])
    return f"For the {titles}, {_BY_TERM % refined} Elsewhere {_BY_COLUMN}{unknown}"


_NO_BOUND = f" {MISSING}: no bound is known, as the meshes show no limit of a part of it."

VIRTUAL = (
    "The measurements are virtual, so p describes the scatter of their generator; the verdicts "
    "rest on the effects against what matters and on the numerical uncertainty."
)


def error_terms(data: ReportData, all_facts: Sequence[Facts]) -> tuple[tuple[str, str], ...]:
    """Statements about the error term, each once, with the responses that it holds for."""
    by_text = gathered(
        (text, facts.title)
        for facts in all_facts
        for text in (error_term(facts, data), distinct(facts, data))
        if text
    )
    return tuple(
        ("" if len(titles) == len(all_facts) > 1 else sentence(listing(titles)), text)
        for text, titles in by_text.items()
    )


def distinct(facts: Facts, data: ReportData) -> str:
    """Say how many computations were really different."""
    total = data.planned
    if facts.result is None or (number := facts.result.distinct) >= total:
        return ""
    differ = f"only {number} differ" if number > 1 else "none differs from another"
    return (
        f"Of {count(total, 'cell')} {differ}: the others give the same numbers"
        f"{f' in every {clean(data.block)}' if data.block else ''}, so tests of the residuals take "
        "one cell of each kind."
    )


def partial(data: ReportData) -> str:
    """Say how much of a study is done, for the top of its page; empty where all of it is."""
    planned = data.planned * max(len(data.blocks), 1)
    if data.is_table or data.imported or len(data.table) >= planned:  # these rows are all there are
        return ""
    return (
        f"{len(data.table):,} of {count(planned, 'case')} have ended. Everything below holds for "
        "these alone and may change; run the study again to compute the others."
    )


def failures(items: Sequence[Record], total: int) -> str:
    """Failures in one sentence; none is said plainly."""
    if not items:
        return f"None: {'the case' if total == 1 else f'all {total:,} cases'} gave a response."
    kinds = Counter(item.status for item in items)
    named = listing([f"{number} {clean(status)}" for status, number in kinds.items()])
    share = percent(len(items) / total) if total else MISSING
    return (
        f"{count(len(items), 'case')} of {total:,} ({share}) failed: {named}. "
        "Cases that fail are not missing at random, so effects of the factors they share are "
        "uncertain beyond their intervals."
    )


_MOST = 4


def folded(warnings: Sequence[tuple[str, str]], data: ReportData) -> tuple[str, ...]:
    """Fold warnings of several responses and terms that differ in names and numbers alone."""
    groups = gathered(
        # warnings about a term may differ in their numbers, others must be the same
        ((re.sub(r"\d+", "#", text) if term else text, bool(term)), (title, term, text))
        for title, warning in warnings
        for term, text in (_split(warning, data),)
    )
    lines = []
    for items in groups.values():
        titles = listing(list(dict.fromkeys(title for title, _, _ in items)))
        terms = list(dict.fromkeys(term for _, term, _ in items if term))
        if len(terms) > _MOST:
            terms = [*terms[:_MOST], f"{len(terms) - _MOST} more terms"]
        about = f"{listing(terms)}: " if terms else ""
        lines.append(sentence(f"{titles}: {about}{items[0][2]}"))
    return tuple(lines)


def _split(warning: str, data: ReportData) -> tuple[str, str]:
    """Term that a warning is about (empty for none) and what it says."""
    head, colon, rest = warning.partition(": ")
    if colon and set(head.split(":")) <= set(data.factors):
        return term_name(head, data.labels), rest
    return "", warning


# What to use: the best cell, the cheapest within reach of it; and what would change the answer.


def cost_front(
    facts: Facts, data: ReportData, factors: Sequence[str] | None = None
) -> pd.DataFrame:
    """Mean seconds and mean response of every cell, and which cells no other one dominates."""
    import pandas as pd

    factors = list(data.factors if factors is None else factors)
    if "seconds" not in data.table or not data.table["seconds"].notna().any():
        return pd.DataFrame(columns=[*factors, "cell", "mean", "seconds", "front", "within"])
    frame = cells(data, facts.name, factors)
    answered = data.table[data.table[facts.name].notna()]
    keys = cell_names(answered, factors)
    seconds = answered["seconds"].astype(float).groupby(keys).mean()
    frame["seconds"] = frame["cell"].map(seconds)
    frame = frame.dropna(subset=["seconds"]).sort_values(["seconds", "mean"], kind="stable")
    sign = -1.0 if facts.better == "higher" else 1.0
    score = sign * frame["mean"]
    limit = practical_of(facts, frame)
    # a gain of less than a thousandth of what matters is no step
    best = score.cummin().shift(fill_value=float("inf"))
    frame["front"] = score < best - limit / 1000
    frame["within"] = score - score.min() <= limit
    return frame.reset_index(drop=True)


def recommendations(data: ReportData, all_facts: Sequence[Facts]) -> tuple[str, ...]:
    """Recommendation of every response that has a better end: time is weighed in the others'."""
    ended = [facts for facts in all_facts if facts.terms and facts.better]
    answered = [facts for facts in ended if data.table[facts.name].notna().any()]
    others = [facts for facts in answered if facts.name != "seconds"]
    return tuple(recommendation(data, facts) for facts in others or answered)


def recommendation(data: ReportData, facts: Facts) -> str:
    """Say for each condition the cheapest choices within what matters of the best."""
    chosen = effect_words.factors_of(data, effect_words.CHOICE)
    if not chosen:
        return "No factor is a choice, so nothing is recommended."
    by_setting = gathered(
        (_recommended(effect_words.at(data, setting), facts, chosen),
         effect_words.named(setting, data))
        for setting in effect_words.settings(data)
    )  # fmt: skip
    return " ".join(
        sentence(f"at {listing(where)}: {text}" if where[0] else text)
        for text, where in by_setting.items()
    )


def _recommended(data: ReportData, facts: Facts, factors: Sequence[str]) -> str:
    def best_of(frame: pd.DataFrame) -> pd.Series:
        return frame.iloc[int((sign * frame["mean"]).to_numpy().argmin())]

    def named(cell: pd.Series) -> str:
        return listing([clean(cell[name]) for name in factors])

    def use(cell: pd.Series) -> str:
        text = f"use {named(cell)}: {quantity(cell['mean'], facts.unit)}"
        total = len(data.blocks) if "block" in data.table else 0
        if not total or (shared := comparable(data, facts.name)["block"].nunique()) == total:
            return text
        blocks = plural_of(clean(data.block) or "block")
        return f"{text} (over the {shared} of {total} {blocks} in which every cell has an answer)"

    front, sign = cost_front(facts, data, factors), -1.0 if facts.better == "higher" else 1.0
    frame = cells(data, facts.name, factors) if front.empty else front
    if frame.empty:
        return "no cell has an answer"
    best, limit = best_of(frame), practical_of(facts, frame)
    within = f"{trimmed(limit)}{THIN}{facts.difference_unit}"
    if front.empty:
        near = int((abs(frame["mean"] - best["mean"]) <= limit).sum()) - 1
        others = f"; {count(near, 'other cell')} within {within} of it"
        return use(best) + (others if near else "")
    good = frame[frame["within"]]
    # a quarter more time is no reason to give up accuracy
    cheap = best_of(good[good["seconds"] <= 1.25 * good["seconds"].min()])
    text = f"{use(cheap)} in {duration(cheap['seconds'])} a case"
    if cheap["cell"] == best["cell"]:
        return f"{text}; {_why_best(cheap, good)}"
    gap = rounded(abs(float(best["mean"] - cheap["mean"])), decimals_that_count(limit))
    times = significant(best["seconds"] / max(cheap["seconds"], 1e-9), 2)
    return (
        f"{text}. The most accurate cell ({named(best)}) gains "
        f"{with_unit(gap, facts.difference_unit)}, less than the {within} that matters, and takes "
        f"{times} times as long ({duration(best['seconds'])})"
    )


def _why_best(cheap: pd.Series, good: pd.DataFrame) -> str:
    if len(good) == 1:
        return "no other cell comes within the difference that matters"
    share = good["seconds"].min() / max(cheap["seconds"], 1e-9)
    if share >= 1:
        return "it is the most accurate cell, and the cheapest of those as good in practice"
    return (
        "it is the most accurate cell; the cheapest of those as good in practice takes "
        f"{percent(share)} of its time"
    )


def cheaper(data: ReportData, facts: Facts) -> str:
    """Say which level of a ``model.*`` factor may be the cheaper one: plates are no choice."""
    if not facts.better or "seconds" not in data.table:
        return ""
    return " ".join(filter(None, (_cheaper_level(data, e, facts) for e in facts.effects)))


def _cheaper_level(data: ReportData, effect: Effect, facts: Facts) -> str:
    if not effect.term.startswith("model.") or effect.range is None:
        return ""
    answered = data.table[data.table[facts.name].notna() & data.table["seconds"].notna()]
    seconds = answered["seconds"].astype(float).groupby(answered[effect.term].astype(str)).mean()
    if len(seconds) < 2:
        return ""
    cheap, dear = str(seconds.idxmin()), str(seconds.idxmax())
    times = significant(float(seconds.max() / max(seconds.min(), 1e-9)), 2)
    cost = (
        f"takes {duration(seconds.min())} a case, the other {duration(seconds.max())} "
        f"({times} times as long)"
    )
    name, gap = name_of(effect.term, data.labels), size(effect, facts)
    if effect.verdict == NO_DIFFERENCE:
        gap = f"less than {gap[2:]}" if gap.startswith("< ") else f"at most {gap}"
        return sentence(
            f"{name}: {clean(cheap)} is enough, for it differs from {clean(dear)} by {gap} "
            f"in {facts.noun} and {cost}"
        )
    weight = "which matters" if effect.verdict == MATTERS else "which may matter or not"
    return sentence(
        f"{name}: to use {clean(cheap)} instead of {clean(dear)} moves {facts.noun} by up to "
        f"{gap} ({level(facts.alpha)} interval {size_interval(effect, facts)}), {weight}; "
        f"it {cost}"
    )


def would_change(data: ReportData, all_facts: Sequence[Facts]) -> str:
    """Say what would change the answer."""
    if data.surfaces:
        return surface_content.would_change(data)
    parts = [*_surer(data, all_facts), *_closer_to_reality(data)]
    if not data.analyses:
        parts = ["a [[response]] in the design"]
    if not parts:
        other = "measurements of another material" if data.is_measured else "other given values"
        if data.is_table and data.is_measured:
            other = "rows of other conditions"
        parts = [f"a different smallest difference that matters, or {other}"]
    return sentence("; ".join(parts))


def _surer(data: ReportData, all_facts: Sequence[Facts]) -> list[str]:
    """More units, or finer meshes: each where it is the cause of a doubt."""
    parts, unit = [], clean(data.block) or ("row" if data.is_table else "replicate")
    unstated = [facts.noun for facts in all_facts if facts.effects and not facts.has_size]
    if unstated:
        parts.append(f"the smallest difference that matters, stated for {listing(unstated)}")
    effects = [e for facts in all_facts if facts.has_size for e in facts.effects]
    alone = _names([e for e in effects if e.why == ONE_SPECIMEN], data)
    if alone:
        parts.append(f"measurements of more specimens, for one tells nothing of {listing(alone)} "
                     "in others, however often it is measured")  # fmt: skip
    open_ones = [e for e in effects if e.verdict == CANNOT_TELL and e.why != ONE_SPECIMEN]
    doubts = _names(open_ones, data)
    # the same computation gives the same answer: nothing is gained from it again
    if doubts and (data.imported or data.is_table or (data.is_measured and data.blocks)):
        ends = "intervals" if len(doubts) > 1 else "interval"
        parts.append(f"more {plural_of(unit)} would narrow the {ends} of {listing(doubts)}")
    claims = _names([e for e in effects if e.lost_without], data)
    if claims:
        more = plural_of(clean(data.block) or "block")
        parts.append(f"more {more} could overturn or confirm what is said of {listing(claims)}")
    coarse = _names([e for e in effects if e.verdict == NOT_RESOLVED], data)
    is_computed = not data.is_measured and not data.imported
    if is_computed:
        lost = [e for e in open_ones if None in e.mean or e.range is None]
        if lost:
            parts.append(f"answers where cases failed, for {listing(_names(lost, data))}")
        unsure = _names([e for e in open_ones if e not in lost], data)
        coarse = list(dict.fromkeys([*coarse, *unsure]))
    if coarse:
        parts.append(f"finer meshes could resolve {listing(coarse)}")
    if is_computed and effects and all(e.u_num is None for e in effects):
        has_mesh = "dofs" in data.table and data.table["dofs"].notna().any()
        untried = "a refined mesh, which was not tried"
        if not has_mesh:
            untried = "the numerical error of the program, which [converge] would show"
        parts.append(f"{untried}, could move every result")
    return parts


def _closer_to_reality(data: ReportData) -> Iterator[str]:
    if data.assumed:
        names = listing([name_of(key, data.labels) for key in data.assumed])
        yield f"a measured value of what is assumed here ({names}) could move every result"
    if data.failures:
        some = len(data.failures) < len(data.table)
        hidden = "may hide an effect" if some else "hide every effect"
        yield f"{count(len(data.failures), 'failed case')} {hidden}"
    if data.virtual:
        yield "real measurements would, since these were generated"


def _names(effects: Sequence[Effect], data: ReportData) -> list[str]:
    return list(dict.fromkeys(_label(effect, data) for effect in effects))
