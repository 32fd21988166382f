"""Cost against accuracy: which cells are worth their seconds."""

from __future__ import annotations

from typing import TYPE_CHECKING

from study.reporting.data import ReportData
from study.reporting.facts import Facts, cells
from study.reporting.text import THIN, clean, duration, listing, quantity, sentence, significant

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
        first. Empty where no seconds are known.
    """
    import pandas as pd

    factors = list(data.factors)
    if "seconds" not in data.table or not data.table["seconds"].notna().any():
        return pd.DataFrame(columns=[*factors, "cell", "mean", "seconds", "front", "within"])
    frame = cells(data, facts.name)
    known = data.table[data.table[facts.name].notna()]
    keys = known[factors].astype(str).agg(":".join, axis=1)
    seconds = known["seconds"].astype(float).groupby(keys).mean()
    frame["seconds"] = frame["cell"].map(seconds)
    frame = frame.dropna(subset=["seconds"]).sort_values(["seconds", "mean"], kind="stable")
    sign = -1.0 if facts.response.better == "higher" else 1.0
    score = sign * frame["mean"]
    frame["front"] = score < score.cummin().shift(fill_value=float("inf"))
    frame["within"] = score - score.min() <= practical_of(facts, frame)
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
    gap = quantity(abs(float(best["mean"] - cheap["mean"])), facts.difference_unit)
    times = significant(best["seconds"] / max(cheap["seconds"], 1e-9), 2)
    other = listing([clean(best[name]) for name in factors])
    return sentence(
        f"{text}. The most accurate cell ({other}) gains {gap}, less than the "
        f"{practical_of(facts, frame):.3g}{THIN}{facts.difference_unit} that matters, and takes "
        f"{times} times as long ({duration(best['seconds'])})"
    )
