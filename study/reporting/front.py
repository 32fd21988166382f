"""Cost against accuracy: which cells are worth their seconds."""

from __future__ import annotations

from typing import TYPE_CHECKING

from study.record import cell_names
from study.reporting.data import ReportData
from study.reporting.facts import MATTERS, NO_DIFFERENCE, Effect, Facts, cells
from study.reporting.text import (
    THIN,
    clean,
    decimals_that_count,
    duration,
    listing,
    name_of,
    quantity,
    rounded,
    sentence,
    significant,
)
from study.reporting.verdicts import size, size_interval

if TYPE_CHECKING:
    import pandas as pd


def practical_of(facts: Facts, frame: pd.DataFrame) -> float:
    """Smallest difference that matters in the response's unit; 0 where none was declared."""
    value = facts.response.practical or 0.0
    return value * abs(float(frame["mean"].mean())) if facts.response.relative else value


def cost_front(data: ReportData, facts: Facts) -> pd.DataFrame:
    """Mean seconds and mean response of every cell, and which cells no other one dominates.

    Returns
    -------
    DataFrame
        Factor columns, ``cell``, ``mean`` (response), ``seconds``, ``front`` (bool),
        ``within`` (bool: no more than the practical difference from the best); cheapest
        first. A gain below a thousandth of the practical difference makes no front. Empty
        where no seconds are known.
    """
    import pandas as pd

    factors = list(data.factors)
    if "seconds" not in data.table or not data.table["seconds"].notna().any():
        return pd.DataFrame(columns=[*factors, "cell", "mean", "seconds", "front", "within"])
    frame = cells(data, facts.name)
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
    """Say which cell to use: the cheapest within the practical difference of the best."""
    frame = cost_front(data, facts)
    if frame.empty:
        return "No computing times are known, so accuracy alone decides."
    sign = -1.0 if facts.response.better == "higher" else 1.0
    best = frame.iloc[int((sign * frame["mean"]).to_numpy().argmin())]
    good = frame[frame["within"]]
    # a quarter more time is no reason to give up accuracy
    quick = good[good["seconds"] <= 1.25 * good["seconds"].min()]
    cheap = quick.iloc[int((sign * quick["mean"]).to_numpy().argmin())]
    factors = list(data.factors)
    named = listing([clean(cheap[name]) for name in factors])
    cost = duration(cheap["seconds"])
    text = f"use {named}: {quantity(cheap['mean'], facts.unit)} in {cost} a case"
    if cheap["cell"] == best["cell"]:
        return sentence(f"{text}; it is the most accurate cell and none within reach is cheaper")
    places = decimals_that_count(practical_of(facts, frame))
    gap = rounded(abs(float(best["mean"] - cheap["mean"])), places)
    if facts.difference_unit:
        gap += f"{THIN}{facts.difference_unit}"
    times = significant(best["seconds"] / max(cheap["seconds"], 1e-9), 2)
    other = listing([clean(best[name]) for name in factors])
    return sentence(
        f"{text}. The most accurate cell ({other}) gains {gap}, less than the "
        f"{practical_of(facts, frame):.3g}{THIN}{facts.difference_unit} that matters, and takes "
        f"{times} times as long ({duration(best['seconds'])})"
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
    if not effect.term.startswith("model.") or effect.difference is None:
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
        f"{gap} (95 % interval {size_interval(effect, facts)}), {weight}; it {cost}"
    )
