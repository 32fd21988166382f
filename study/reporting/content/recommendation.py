"""What to use: the best cell, the cheapest within reach of it, what a cheaper level costs.

And what would change the answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from study.ground.arrays import gathered
from study.harness.record.record import cell_names
from study.reporting.content import effect_words, surface_content
from study.reporting.content.effect_words import size, size_interval, with_unit
from study.reporting.content.report_facts import Facts, cells, comparable, practical_of
from study.reporting.content.text import (
    THIN,
    clean,
    count,
    decimals_that_count,
    duration,
    level,
    listing,
    name_of,
    percent,
    plural_of,
    quantity,
    rounded,
    sentence,
    significant,
    term_name,
)
from study.reporting.results.study_result import ReportData
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


def _over_fewer(data: ReportData, facts: Facts) -> str:
    """Say where means are taken over fewer blocks than there are."""
    if not data.blocks or "block" not in data.table:
        return ""
    shared = comparable(data, facts.name)["block"].nunique()
    if shared == len(data.blocks):
        return ""
    blocks = plural_of(clean(data.block) or "block")
    return f" (over the {shared} of {len(data.blocks)} {blocks} in which every cell has an answer)"


def cost_front(
    data: ReportData, facts: Facts, factors: Sequence[str] | None = None
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
    """Recommendation of every response that has a better end and an answer."""
    return tuple(
        recommendation(data, facts)
        for facts in all_facts
        if facts.terms and facts.better and data.table[facts.name].notna().any()
    )


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
        mean = quantity(cell["mean"], facts.unit)
        return f"use {named(cell)}: {mean}{_over_fewer(data, facts)}"

    front, sign = cost_front(data, facts, factors), -1.0 if facts.better == "higher" else 1.0
    frame = cells(data, facts.name, factors) if front.empty else front
    if frame.empty:
        return "no cell has an answer"
    best, limit = best_of(frame), practical_of(facts, frame)
    within = f"{limit:.3g}{THIN}{facts.difference_unit}"
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
    share = float(good["seconds"].min()) / max(float(cheap["seconds"]), 1e-9)
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
    if not parts:
        measured = (
            "rows of other conditions" if data.is_table else "measurements of another material"
        )
        other = measured if data.is_measured else "other given values"
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
        several = "s" if len(doubts) > 1 else ""
        parts.append(
            f"more {plural_of(unit)} would narrow the interval{several} of {listing(doubts)}"
        )
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
        coarse = list(
            dict.fromkeys([*coarse, *_names([e for e in open_ones if e not in lost], data)])
        )
    if coarse:
        parts.append(f"finer meshes could resolve {listing(coarse)}")
    if is_computed and effects and all(e.u_num is None for e in effects):
        has_mesh = "dofs" in data.table and data.table["dofs"].notna().any()
        untried = "a refined mesh, which was not tried"
        if not has_mesh:
            untried = "the numerical error of the program, which [converge] would show"
        parts.append(f"{untried}, could move every result")
    return parts


def _closer_to_reality(data: ReportData) -> list[str]:
    parts = []
    if data.assumed:
        names = listing([name_of(key, data.labels) for key in data.assumed])
        parts.append(f"a measured value of what is assumed here ({names}) could move every result")
    if data.failures:
        some = len(data.failures) < len(data.table)
        hidden = "may hide an effect" if some else "hide every effect"
        parts.append(f"{count(len(data.failures), 'failed case')} {hidden}")
    if data.virtual:
        parts.append("real measurements would, since these were generated")
    return parts


def _names(effects: Sequence[Effect], data: ReportData) -> list[str]:
    return list(dict.fromkeys(term_name(effect.term, data.labels) for effect in effects))
