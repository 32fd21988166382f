"""Effect of each factor against the depth that the test is scored to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from study.reporting.figure.style import BAND, INK, MARKERS, MUTED, WIDTH_IN, canvas, color_of
from study.reporting.numbers import quantity
from study.reporting.report import Facts
from study.reporting.text import listing, term_name
from study.study_result.report_data import DepthEffect, ReportData

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas


#: sideways distance of the intervals of two factors, over the distance of two depths
_BESIDE = 0.05


def points(rows: Sequence[DepthEffect], response: str, data: ReportData) -> pd.DataFrame:
    """Rows of one response with the names of their factors.

    Parameters
    ----------
    rows : sequence of DepthEffect
        Of every response and depth.
    response : str
        Column of the response that is drawn; at least one row is of this response.
    data : ReportData
        For the shown names of factors.

    Returns
    -------
    DataFrame
        Fields of :class:`DepthEffect` and ``name``; a number that is None becomes NaN.
    """
    import pandas as pd

    frame = pd.DataFrame([asdict(row) for row in rows if row.response == response])
    names = [term_name(str(term), data.labels) for term in frame["term"]]
    numbers = {"difference": float, "low": float, "high": float, "practical": float}
    return frame.assign(name=names).astype(numbers)


def draw(frame: pd.DataFrame, facts: Facts) -> Canvas:
    """Draw the largest difference of every factor with its interval against depth.

    Parameters
    ----------
    frame : DataFrame
        By :func:`points`, depths in mm.
    facts : Facts
        For the unit of a difference, and whether it is a ratio.
    """
    figure = canvas(WIDTH_IN, 3.6)
    ax = figure.subplots()
    _band(ax, frame, facts)
    depths = sorted(frame["depth_mm"].unique())
    apart = _BESIDE * (depths[-1] - depths[0]) / max(len(depths) - 1, 1)
    terms = list(dict.fromkeys(frame["name"]))
    for k, name in enumerate(terms):
        part = frame[frame["name"] == name]
        x = part["depth_mm"] + apart * (k - (len(terms) - 1) / 2)
        marker, color = MARKERS[k % len(MARKERS)], color_of(k)
        ax.plot(x, part["difference"], marker=marker, color=color, label=name, markersize=5)
        ax.vlines(x, part["low"], part["high"], color=color, linewidth=1.2, alpha=0.7)
    ax.set_xticks(depths, [f"{depth:g}" for depth in depths])
    ax.set_xlabel("scored to a displacement of (mm)")
    what = "ratio" if facts.ratio else f"difference ({facts.difference_unit})"
    ax.set_ylabel(f"largest {what} between levels")
    ax.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1.0))
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    return figure


def _band(ax: Axes, frame: pd.DataFrame, facts: Facts) -> None:
    """Shade what does not matter; a share of the mean grows with the depth."""
    zero = 1.0 if facts.ratio else 0.0
    ax.axhline(zero, color=MUTED, linewidth=0.7)
    limits = frame.dropna(subset=["practical"]).drop_duplicates("depth_mm")
    if limits.empty:
        return
    limits = limits.sort_values("depth_mm")
    below = 1 / limits["practical"] if facts.ratio else -limits["practical"]
    ax.fill_between(limits["depth_mm"], below, limits["practical"], color=BAND, zorder=0)
    ax.annotate(
        "no practical difference",
        (limits["depth_mm"].iloc[-1], below.iloc[-1]),
        xytext=(0, 3),
        textcoords="offset points",
        ha="right",
        color=INK,
        fontsize=7.5,
        alpha=0.7,
    )


def caption(frame: pd.DataFrame, facts: Facts) -> str:
    """Say what changes between the shallowest and the deepest look.

    Parameters
    ----------
    frame : DataFrame
        By :func:`points`.
    facts : Facts
        For the unit of a difference, and whether it is a ratio.
    """
    depths = sorted(frame["depth_mm"].unique())
    shallow, deep = (
        frame[frame["depth_mm"] == d].set_index("name") for d in (depths[0], depths[-1])
    )
    changed = [
        f"{name} ({shallow.loc[name, 'verdict']} at {depths[0]:g} mm, "
        f"{deep.loc[name, 'verdict']} at {depths[-1]:g} mm)"
        for name in deep.index
        if name in shallow.index and shallow.loc[name, "verdict"] != deep.loc[name, "verdict"]
    ]
    verdicts = (
        f"The verdict depends on it for {listing(changed)}."
        if changed
        else "No verdict depends on it."
    )
    strongest = deep["difference"].idxmax()
    sizes = [quantity(part.loc[strongest, "difference"], "") for part in (shallow, deep)]
    return (
        f"The same cases scored over the first part of the test only; constants are those of "
        f"the whole study. {verdicts} The strongest factor at full depth, {strongest}, goes from "
        f"{sizes[0]} to {sizes[1]}{' ' + facts.difference_unit if not facts.ratio else ''}."
    )
