"""What was expected before the study ran, beside what it found."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from study.analysis.anova_table import Effect
from study.analysis.effects.verdict import CANNOT_TELL, MATTERS, NO_DIFFERENCE
from study.design.spec import Expected
from study.record.table import cell_names
from study.reporting.content import roles
from study.reporting.content.table import Table
from study.reporting.content.verdicts import size, size_interval
from study.reporting.numbers import (
    MISSING,
    THIN,
    clean,
    decimals_that_count,
    duration,
    level,
    listing,
    name_of,
    percent,
    quantity,
    rounded,
    sentence,
    significant,
    term_name,
)
from study.reporting.report import Facts, cells, practical_of
from study.study_result.report_data import ReportData

if TYPE_CHECKING:
    import pandas as pd

HOLDS = "holds"
FAILS = "does not hold"
_OF_VERDICT = {MATTERS: HOLDS, NO_DIFFERENCE: FAILS}
_UNKNOWN = "the study has no answer"


def table(data: ReportData, found: Sequence[Facts]) -> Table:
    """One row an expectation: what, by whom, what was found, and whether it came true."""
    by_name = {facts.name: facts for facts in found}
    rows = []
    for item in data.expected:
        facts = by_name.get(item.response)
        saw, verdict = _judged(item, facts, data) if facts else (_UNKNOWN, CANNOT_TELL)
        source = clean(item.source) or MISSING
        rows.append((_said(item, data), source, sentence(saw), verdict))
    columns = ("expected", "by", "found", "verdict")
    raw = tuple(dict(zip(columns, row, strict=True)) for row in rows)
    return Table("expected", columns, tuple(rows), 3, 1, raw=raw)


def _said(item: Expected, data: ReportData) -> str:
    names = [name_of(name, data.labels) for name in item.factors]
    cells = [_cell(cell) for cell in item.cells]
    return {
        "matters": lambda: f"{names[0]} matters",
        "larger": lambda: f"{names[0]} has a larger effect than {names[1]}",
        "interact": lambda: f"{names[0]} and {names[1]} interact",
        "best": lambda: f"{cells[0]} is the best",
        "close": lambda: f"{cells[1]} is close to {cells[0]}",
    }[item.kind]()


def _cell(cell: Mapping[str, str]) -> str:
    return " x ".join(clean(level) for level in cell.values())


def _judged(item: Expected, facts: Facts, data: ReportData) -> tuple[str, str]:
    if item.kind in ("best", "close"):
        return _cells(item, facts, data)
    if item.kind == "larger":
        return _larger([_effect_of(facts, name) for name in item.factors], facts, data)
    effect = _effect_of(facts, *item.factors)
    if effect is None or effect.range is None:
        return _UNKNOWN, CANNOT_TELL
    return _sized(effect, facts), _OF_VERDICT.get(effect.strength, CANNOT_TELL)


def _effect_of(facts: Facts, *factors: str) -> Effect | None:
    wanted = set(factors)
    return next((e for e in facts.terms if set(e.term.split(":")) == wanted), None)


def _sized(effect: Effect, facts: Facts) -> str:
    return f"{size(effect, facts)} ({level(facts.alpha)} interval {size_interval(effect, facts)})"


def _larger(effects: Sequence[Effect | None], facts: Facts, data: ReportData) -> tuple[str, str]:
    """One effect is larger than another where their intervals do not overlap."""
    known = [e for e in effects if e is not None and e.range is not None]
    if len(known) < 2:
        return _UNKNOWN, CANNOT_TELL
    parts = [f"{term_name(e.term, data.labels)} {_sized(e, facts)}" for e in known]
    (low, high), (other_low, other_high) = (_magnitudes(e) for e in known)
    verdict = HOLDS if low > other_high else FAILS if high < other_low else CANNOT_TELL
    return ", ".join(parts), verdict


def _magnitudes(effect: Effect) -> tuple[float, float]:
    """Smallest and largest size of an effect within its interval."""
    ends = [effect.range if v is None else v for v in (effect.low, effect.high)]
    if effect.is_ratio:
        ends = [math.log(v) if v and v > 0 else 0.0 for v in ends]
    low, high = sorted(float(v or 0.0) for v in ends)
    inside = low <= 0 <= high
    return (0.0 if inside else min(abs(low), abs(high))), max(abs(low), abs(high))


def _cells(item: Expected, facts: Facts, data: ReportData) -> tuple[str, str]:
    """Compare means of cells with what matters."""
    frame = cells(data, facts.name, list(item.cells[0]))
    levels = frame[list(item.cells[0])].itertuples(index=False, name=None)
    means = dict(zip(levels, frame["mean"].tolist(), strict=True))
    keys = [tuple(cell.values()) for cell in item.cells]
    if any(key not in means for key in keys):
        return _UNKNOWN, CANNOT_TELL
    limit = practical_of(facts, cells(data, facts.name))
    own = _worse(means[keys[0]], facts)
    if item.kind == "close":
        apart = abs(means[keys[1]] - means[keys[0]])
        verdict = CANNOT_TELL if not limit else HOLDS if apart <= limit else FAILS
        return f"{_difference(apart, limit, facts)} apart, {_from(limit, facts)}", verdict
    ranked = sorted(means, key=lambda key: _worse(means[key], facts))
    told = [f"{' x '.join(key)} {quantity(means[key], facts.unit)}" for key in ranked[:3]]
    if keys[0] not in ranked[:3]:
        told.append(f"{_cell(item.cells[0])} {quantity(means[keys[0]], facts.unit)}")
    behind = own - _worse(means[ranked[0]], facts)
    verdict = HOLDS if behind == 0 else CANNOT_TELL if behind <= limit else FAILS
    return f"{listing(told)}, {_from(limit, facts)}", verdict


def _from(limit: float, facts: Facts) -> str:
    if not limit:
        return "and nobody said what matters"
    return f"where {_difference(limit, limit, facts)} matter"


def _worse(mean: float, facts: Facts) -> float:
    return -mean if facts.response.better == "higher" else mean


def _difference(value: float, limit: float, facts: Facts) -> str:
    number = rounded(value, decimals_that_count(limit or None))
    return f"{number}{THIN}{facts.difference_unit}" if facts.difference_unit else number


def cost_front(
    data: ReportData, facts: Facts, factors: Sequence[str] | None = None
) -> pd.DataFrame:
    """Mean seconds and mean response of every cell, and which cells no other one dominates.

    Parameters
    ----------
    factors : sequence of str, optional
        Factors that make a cell, all by default.

    Returns
    -------
    DataFrame
        Factor columns, ``cell``, ``mean`` (response), ``seconds``, ``front`` (bool),
        ``within`` (bool: no more than the practical difference from the best); cheapest
        first. A gain below a thousandth of the practical difference makes no front. Empty
        where no seconds are known.
    """
    import pandas as pd

    factors = list(data.factors if factors is None else factors)
    if "seconds" not in data.table or not data.table["seconds"].notna().any():
        return pd.DataFrame(columns=[*factors, "cell", "mean", "seconds", "front", "within"])
    frame = cells(data, facts.name, factors)
    known = data.table[data.table[facts.name].notna()]
    keys = cell_names(known, factors)
    seconds = known["seconds"].astype(float).groupby(keys).mean()
    frame["seconds"] = frame["cell"].map(seconds)
    frame = frame.dropna(subset=["seconds"]).sort_values(["seconds", "mean"], kind="stable")
    sign = -1.0 if facts.response.better == "higher" else 1.0
    score = sign * frame["mean"]
    limit = practical_of(facts, frame)
    # a gain of less than a thousandth of what matters is no step
    best = score.cummin().shift(fill_value=float("inf"))
    frame["front"] = score < best - limit / 1000
    frame["within"] = score - score.min() <= limit
    return frame.reset_index(drop=True)


def recommendation(data: ReportData, facts: Facts) -> str:
    """Say which choices to use: the cheapest within the practical difference of the best.

    Conditions get a recommendation each; over what nobody measured the mean is taken.
    """
    chosen = roles.factors_of(data, roles.CHOICE)
    if not chosen:
        return "No factor is a choice, so nothing is recommended."
    said: dict[str, list[str]] = {}
    for setting in roles.settings(data):
        text = _recommended(roles.at(data, setting), facts, chosen)
        said.setdefault(text, []).append(roles.named(setting, data))
    return " ".join(
        sentence(f"at {listing(where)}: {text}" if where[0] else text)
        for text, where in said.items()
    )


def _recommended(data: ReportData, facts: Facts, factors: Sequence[str]) -> str:
    frame = cost_front(data, facts, factors)
    if frame.empty:
        return "no computing times are known, so accuracy alone decides"
    sign = -1.0 if facts.response.better == "higher" else 1.0
    best = frame.iloc[int((sign * frame["mean"]).to_numpy().argmin())]
    good = frame[frame["within"]]
    # a quarter more time is no reason to give up accuracy
    quick = good[good["seconds"] <= 1.25 * good["seconds"].min()]
    cheap = quick.iloc[int((sign * quick["mean"]).to_numpy().argmin())]
    named = listing([clean(cheap[name]) for name in factors])
    text = (
        f"use {named}: {quantity(cheap['mean'], facts.unit)} in {duration(cheap['seconds'])} a case"
    )
    if cheap["cell"] == best["cell"]:
        return f"{text}; {_why_best(cheap, good)}"
    limit = practical_of(facts, frame)
    gap = rounded(abs(float(best["mean"] - cheap["mean"])), decimals_that_count(limit))
    if facts.difference_unit:
        gap += f"{THIN}{facts.difference_unit}"
    times = significant(best["seconds"] / max(cheap["seconds"], 1e-9), 2)
    other = listing([clean(best[name]) for name in factors])
    return (
        f"{text}. The most accurate cell ({other}) gains {gap}, less than the "
        f"{limit:.3g}{THIN}{facts.difference_unit} that matters, and takes "
        f"{times} times as long ({duration(best['seconds'])})"
    )


def _why_best(cheap: pd.Series, good: pd.DataFrame) -> str:
    """Say why the most accurate cell is also the one to use."""
    if len(good) == 1:
        return "no other cell comes within the difference that matters"
    share = float(good["seconds"].min()) / max(float(cheap["seconds"]), 1e-9)
    if share >= 1:
        return "it is the most accurate cell, and of those within reach the cheapest"
    return (
        "it is the most accurate cell; the cheapest one within reach takes "
        f"{percent(share)} of its time"
    )


def cheaper(data: ReportData, facts: Facts) -> str:
    """Say which modelling choice (``model.*``) may be the cheaper one, level against level.

    Only factors of the computation are compared: plates or specimens are no choice.
    """
    if not facts.response.better or "seconds" not in data.table:
        return ""
    said = [_cheaper_level(data, effect, facts) for effect in facts.effects]
    return " ".join(text for text in said if text)


def _cheaper_level(data: ReportData, effect: Effect, facts: Facts) -> str:
    if not effect.term.startswith("model.") or effect.range is None:
        return ""
    known = data.table[data.table[facts.name].notna() & data.table["seconds"].notna()]
    seconds = known["seconds"].astype(float).groupby(known[effect.term].astype(str)).mean()
    if len(seconds) < 2:
        return ""
    cheap, dear = str(seconds.idxmin()), str(seconds.idxmax())
    times = significant(float(seconds.max() / max(seconds.min(), 1e-9)), 2)
    cost = (
        f"takes {duration(seconds.min())} a case instead of {duration(seconds.max())} "
        f"({times} times as long)"
    )
    name, gap = name_of(effect.term, data.labels), size(effect, facts)
    if effect.verdict == NO_DIFFERENCE:
        gap = f"less than {gap[2:]}" if gap.startswith("< ") else f"at most {gap}"
        return sentence(
            f"{name}: {clean(cheap)} is enough, for it differs from {clean(dear)} by {gap} "
            f"in the {facts.title} and {cost}"
        )
    weight = "which matters" if effect.verdict == MATTERS else "which may matter or not"
    return sentence(
        f"{name}: to use {clean(cheap)} instead of {clean(dear)} moves the {facts.title} by up to "
        f"{gap} ({level(facts.alpha)} interval {size_interval(effect, facts)}), {weight}; "
        f"it {cost}"
    )
