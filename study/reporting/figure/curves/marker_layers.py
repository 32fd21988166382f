"""Errors of markers inside a specimen, layer by layer and state by state."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from study.reporting.figure.style import MUTED, WIDTH_IN, canvas, color_of
from study.reporting.text import clean
from study.study_result.report_data import MarkedCase, ReportData

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas


def layer_points(data: ReportData) -> pd.DataFrame:
    """RMS error of every layer of every case, all markers fitted with the freest plate.

    Parameters
    ----------
    data : ReportData
        Its cases with markers.

    Returns
    -------
    DataFrame
        ``state``, ``group`` (level of the first factor), ``cell``, ``place``, ``layer``,
        ``error_mm``, ``floor_mm``.

    Raises
    ------
    ValueError
        If no marker has a layer.
    """
    import pandas as pd

    rows = [
        {
            "state": one.state,
            "group": next(iter(one.levels.values()), "all"),
            "cell": " / ".join(one.levels.values()),
            "place": place,
            "layer": layer,
            "error_mm": error,
            "floor_mm": one.floor_mm,
        }
        for one in data.markers
        for place, (layer, error) in enumerate(_freest(one).items())
    ]
    if not rows:
        raise ValueError("no marker has a layer")
    return pd.DataFrame(rows)


def _freest(one: MarkedCase) -> dict[str, float]:
    """Errors by layer under the last of the fits to all markers."""
    every = [fit for fit in one.fits if fit["fitted"] == "all"]
    known = every[-1]["error_by_layer_mm"] if every else {}
    return {layer: math.nan if error is None else error for layer, error in known.items()}


def draw_layers(frame: pd.DataFrame) -> Canvas:
    """Draw a panel a state: a line for each cell, colored by the first factor.

    Parameters
    ----------
    frame : DataFrame
        By :func:`layer_points`.
    """
    states = list(dict.fromkeys(frame["state"]))
    figure = canvas(WIDTH_IN, 2.6)
    panels = figure.subplots(1, len(states), squeeze=False, sharey=True)[0]
    for ax, state in zip(panels, states, strict=True):
        _panel(ax, frame[frame["state"] == state], list(dict.fromkeys(frame["group"])))
        ax.set_title(clean(state, 30), fontsize=8)
    panels[0].set_ylabel("RMS error of markers (mm)", fontsize=8.5)
    panels[0].legend(fontsize=6.5, frameon=False, loc="upper left")
    panels[0].set_ylim(bottom=0.0)
    figure.supxlabel("layer of markers, from the base up", fontsize=8.5)
    return figure


def _panel(ax: Axes, part: pd.DataFrame, groups: list[str]) -> None:
    for number, group in enumerate(groups):
        own = part[part["group"] == group]
        for k, (_, line) in enumerate(own.groupby("cell", sort=False)):
            label = clean(group, 30) if k == 0 else None
            ax.plot(line["place"], line["error_mm"], color=color_of(number), lw=0.9, label=label)
    floor = part["floor_mm"].dropna()
    if len(floor):
        ax.axhline(float(floor.iloc[0]), color=MUTED, linewidth=0.8, linestyle="--", label="floor")
    ticks = part[["place", "layer"]].drop_duplicates()
    ax.set_xticks(ticks["place"], [clean(v, 8) for v in ticks["layer"]])


def caption(frame: pd.DataFrame) -> str:
    """Say which level of the first factor leaves the smallest error in the last state.

    Parameters
    ----------
    frame : DataFrame
        By :func:`layer_points`.
    """
    last = frame[frame["state"] == frame["state"].iloc[-1]]
    mean = last.groupby("group", sort=False)["error_mm"].mean()
    best, error = str(mean.idxmin()), float(mean.min())
    return (
        f"In state {clean(last['state'].iloc[0], 30)} the mean error over layers is smallest with "
        f"{clean(best, 40)} ({error:.3g} mm). Each line is a cell, with any rigid motion of the "
        "plate and slip fitted to all markers; dashed: distance of the markers from a smooth field."
    )
