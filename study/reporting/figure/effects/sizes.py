"""Figures of effects: sizes against what matters, level means, interactions, cells.

Compute, then draw: each ``draw_*`` takes the frame of its function, which is the figure's CSV.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from study.analysis.effects.verdict import MATTERS, NO_DIFFERENCE
from study.reporting.content.sizes import size, size_interval
from study.reporting.figure.axes import clean_left, name_rows, plain_ticks, wrap
from study.reporting.figure.style import BAND, MUTED, WIDTH_IN, canvas, shown
from study.reporting.numbers import level
from study.reporting.report import Facts
from study.reporting.text import term_name

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

_VERDICT_COLOR = {MATTERS: "#D55E00", NO_DIFFERENCE: "#009E73"}


def effect_sizes(facts: Facts, labels: Mapping[str, str]) -> pd.DataFrame:
    """Largest difference of every term with its interval; factors first, then interactions.

    Parameters
    ----------
    facts, labels : Facts, mapping of str to str
        The response; shown names by factor (one that is absent is made from its key).
    """
    import pandas as pd

    strong = [effect for effect in facts.interactions if effect.strength != NO_DIFFERENCE]
    listed = [e for e in (*facts.effects, *strong[:6]) if e.range is not None]
    return pd.DataFrame(
        {
            "term": [effect.term for effect in listed],
            "name": [term_name(effect.term, labels) for effect in listed],
            "difference": [effect.range for effect in listed],
            "low": [effect.low for effect in listed],
            "high": [effect.high for effect in listed],
            "practical": [effect.practical for effect in listed],
            "verdict": [effect.strength for effect in listed],
        }
    ).astype({"difference": float, "low": float, "high": float, "practical": float})


def shown_effect_sizes(facts: Facts, labels: Mapping[str, str]) -> Canvas:
    """Draw the largest difference of every term as a notebook shows it.

    Parameters
    ----------
    facts, labels : Facts, mapping of str to str
        The response; shown names by factor (one that is absent is made from its key).

    Raises
    ------
    ValueError
        If no effect could be estimated.
    """
    frame = effect_sizes(facts, labels)
    if frame.empty:
        raise ValueError("there is nothing to draw: no effect could be estimated")
    title = f"largest difference of every term: {facts.title}"
    return shown(lambda: draw_effect_sizes(frame, facts), "effects", title)


def draw_effect_sizes(frame: pd.DataFrame, facts: Facts) -> Canvas:
    """Draw one row a term: its largest difference and interval against the band.

    Parameters
    ----------
    frame, facts : DataFrame, Facts
        Of :func:`effect_sizes`, with a row at least, and the response.
    """
    figure = canvas(WIDTH_IN, 0.85 + 0.34 * len(frame))
    ax = figure.subplots()
    zero = 1.0 if facts.ratio else 0.0
    limits = frame["practical"].dropna()
    if not limits.empty:
        limit = float(limits.iloc[0])
        below = 1 / limit if facts.ratio else -limit
        ax.axvspan(below, limit, color=BAND, zorder=0)
        ax.text(
            zero,
            1.0,
            "no practical difference",
            transform=ax.get_xaxis_transform(),
            ha="center",
            va="bottom",
            color=MUTED,
            fontsize=7.5,
        )
    ax.axvline(zero, color=MUTED, linewidth=0.7)
    _mark_effects(ax, frame)
    shown = {effect.term: effect for effect in facts.terms}
    for place, term in enumerate(frame["term"]):
        effect = shown[term]
        ax.annotate(
            size(effect, facts)
            + (f"   [{size_interval(effect, facts)}]" if effect.low is not None else ""),
            (1.0, place),
            xycoords=ax.get_yaxis_transform(),
            xytext=(6, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
            annotation_clip=False,
        )
    name_rows(ax, range(len(frame)), [wrap(name, 34) for name in frame["name"]], 8)
    ax.set_ylim(len(frame) - 0.5, -0.6)
    plain_ticks(ax, "x")
    unit = f" ({facts.difference_unit})" if facts.difference_unit else ""
    what = "ratio" if facts.ratio else f"difference{unit}"
    ends = ""
    if frame["low"].notna().any():
        ends = f", with {level(facts.alpha)} simultaneous interval"
    ax.set_xlabel(f"largest {what} between levels, {facts.title}{ends}")
    clean_left(ax)
    return figure


def _mark_effects(ax: Axes, frame: pd.DataFrame) -> None:
    """Draw each difference on its interval, in the color of its verdict."""
    import seaborn as sns

    places = np.arange(len(frame))
    colors = [_VERDICT_COLOR.get(verdict, MUTED) for verdict in frame["verdict"]]
    ax.hlines(places, frame["low"], frame["high"], colors=colors, linewidth=2.2)
    sns.scatterplot(
        x=frame["difference"].to_numpy(),
        y=places,
        hue=colors,
        palette={color: color for color in colors},
        s=49,
        linewidth=0,
        zorder=3,
        legend=False,
        ax=ax,
    )
