"""Figures of a surface over numeric factors: profiles, contours, shares, runs left out."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from study.reporting.content.numbers import percent, quantity
from study.reporting.content.surface_content import title
from study.reporting.content.text import clean, listing, name_of, sentence
from study.reporting.figures.axes import (
    BAND,
    INK,
    MUTED,
    WIDTH_IN,
    canvas,
    color_of,
    name_rows,
    plain_ticks,
    wrap,
)
from study.statistics.surfaces.surface_profile import contour, left_out, profiles, strongest

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

    from study.reporting.results.study_result import ReportData
    from study.statistics.surfaces.surface_profile import FittedSurface
    from study.statistics.surfaces.surface_result import SurfaceAnalysis


#: profiles beside each other
_COLUMNS = 4

Drawn = tuple["pd.DataFrame", "Callable[[], Canvas]", str]


def drawings(fitted: FittedSurface, data: ReportData) -> dict[str, tuple[str, Callable[[], Drawn]]]:
    """Title and maker of every figure of one surface, by kind."""
    surface = fitted.found
    if surface is None:
        return {}
    made: dict[str, tuple[str, Callable[[], Drawn]]] = {}
    if any(item.index is not None for item in surface.sensitivity):
        made["shares"] = ("Shares of the variance", lambda: _shares(surface, fitted, data))
    made["profiles"] = ("Along each factor", lambda: _profiles(surface, fitted, data))
    if len(surface.runs.factors) > 1:
        made["contours"] = (
            "Over the two strongest factors",
            lambda: _contours(surface, fitted, data),
        )
    if left_out(surface) is not None:
        made["left-out"] = (
            "Runs predicted from the others",
            lambda: _left_out(surface, fitted, data),
        )
    return made


def _profiles(surface: SurfaceAnalysis, fitted: FittedSurface, data: ReportData) -> Drawn:
    import pandas as pd

    order = strongest(surface)
    by_factor = profiles(surface)
    frame = pd.concat(
        pd.DataFrame({"factor": n, "setting": at, "value": p.value, "low": p.low, "high": p.high})
        for n, (at, p) in ((name, by_factor[name]) for name in order)
    )
    sizes = [quantity(float(np.ptp(by_factor[n][1].value)), clean(fitted.unit)) for n in order]
    named = [name_of(name, data.labels) for name in order]
    caption = sentence(
        f"{title(fitted, data)} along each factor with the others in the middle of their "
        f"ranges; bands are 95 % intervals of the prediction. It changes by up to "
        f"{listing([f'{s} ({n})' for s, n in zip(sizes, named, strict=True)])}."
    )
    return frame, lambda: _draw_profiles(frame, fitted, data), caption


def _draw_profiles(frame: pd.DataFrame, fitted: FittedSurface, data: ReportData) -> Canvas:
    names = list(dict.fromkeys(frame["factor"]))
    columns = min(_COLUMNS, len(names))
    rows = math.ceil(len(names) / columns)
    figure = canvas(WIDTH_IN, 0.4 + 2.3 * rows)
    axes = figure.subplots(rows, columns, sharey=True, squeeze=False)
    for place, ax in enumerate(axes.ravel()):
        if place >= len(names):
            ax.set_axis_off()
            continue
        part = frame[frame["factor"] == names[place]]
        ax.fill_between(part["setting"], part["low"], part["high"], color=BAND)
        ax.plot(part["setting"], part["value"], color=color_of(0))
        ax.set_xlabel(_axis(names[place], fitted, data))
        ax.set_xmargin(0)
        plain_ticks(ax, "x")
    for ax in axes[:, 0]:
        ax.set_ylabel(_response(fitted, data))
    return figure


def _contours(surface: SurfaceAnalysis, fitted: FittedSurface, data: ReportData) -> Drawn:
    import pandas as pd

    pair = strongest(surface)[:2]
    grid = contour(surface, pair)
    x, y = np.meshgrid(grid.x, grid.y)
    frame = pd.DataFrame({pair[0]: x.ravel(), pair[1]: y.ravel(), "value": grid.value.ravel()})
    low, high = grid.value.min(), grid.value.max()
    unit = clean(fitted.unit)
    others = (
        "; the others are in the middle of their ranges" if len(surface.runs.factors) > 2 else ""
    )
    caption = sentence(
        f"{title(fitted, data)} goes from {quantity(low, unit)} to "
        f"{quantity(high, unit)} over {name_of(pair[0], data.labels)} and "
        f"{name_of(pair[1], data.labels)}{others}. Points are the runs."
    )
    return frame, lambda: _draw_contours(frame, grid.runs, fitted, data), caption


def _draw_contours(
    frame: pd.DataFrame, runs: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    fitted: FittedSurface, data: ReportData,
) -> Canvas:  # fmt: skip
    across, up = frame.columns[:2]
    table = frame.pivot_table(index=up, columns=across, values="value")
    figure = canvas(WIDTH_IN, 4.2)
    ax = figure.subplots()
    x, y, z = table.columns.to_numpy(), table.index.to_numpy(), table.to_numpy()
    filled = ax.contourf(x, y, z, levels=10, cmap="Blues", alpha=0.75)
    ax.contour(x, y, z, levels=filled.levels, colors="white", linewidths=0.6)
    ax.scatter(runs[:, 0], runs[:, 1], s=9, color=INK, linewidths=0)
    bar = figure.colorbar(filled, ax=ax, pad=0.015, aspect=30)
    bar.set_label(_response(fitted, data))
    bar.outline.set_visible(False)
    ax.set_xlabel(_axis(across, fitted, data))
    ax.set_ylabel(_axis(up, fitted, data))
    plain_ticks(ax, "x")
    plain_ticks(ax, "y")
    return figure


def _shares(surface: SurfaceAnalysis, fitted: FittedSurface, data: ReportData) -> Drawn:
    import pandas as pd

    items = sorted(surface.sensitivity, key=lambda item: item.rank)
    frame = pd.DataFrame(
        [
            {
                "factor": item.factor,
                "total": item.index.total,
                "low": item.index.total_interval[0],
                "high": item.index.total_interval[1],
                "alone": item.index.first,
            }
            for item in items
            if item.index is not None
        ]
    )
    first = frame.iloc[0]
    alone = float(frame["alone"].sum())
    caption = sentence(
        f"{name_of(str(first['factor']), data.labels)} carries "
        f"{percent(float(first['total']))} of the variance of {title(fitted, data)} when every "
        f"factor is uniform over its range. Bars are total indices with intervals of about 95 %, "
        f"rings what the factor does alone; all factors alone sum to {percent(min(alone, 1.0))}, "
        "the rest is interaction."
    )
    return frame, lambda: _draw_shares(frame, data), caption


def _draw_shares(frame: pd.DataFrame, data: ReportData) -> Canvas:
    figure = canvas(WIDTH_IN, 0.8 + 0.36 * len(frame))
    ax = figure.subplots()
    places = np.arange(len(frame))
    percents = 100 * frame[["total", "low", "high", "alone"]]
    ax.barh(places, percents["total"], color=color_of(0), height=0.55, alpha=0.35)
    low, high = percents["low"].clip(0), percents["high"].clip(0, 100)
    ax.hlines(places, low, high, color=INK, linewidth=1.4)
    ax.plot(percents["alone"], places, "o", markerfacecolor="none", color=color_of(1), markersize=6)
    name_rows(ax, places, [wrap(name_of(str(n), data.labels), 30) for n in frame["factor"]], 8)
    ax.set_ylim(len(frame) - 0.5, -0.5)
    ax.set_xlim(left=0)
    ax.set_xlabel("share of the variance (%)")
    plain_ticks(ax, "x")
    return figure


def _left_out(surface: SurfaceAnalysis, fitted: FittedSurface, data: ReportData) -> Drawn:
    import pandas as pd

    errors = left_out(surface)
    if errors is None:
        raise ValueError("no run can be left out")
    frame = pd.DataFrame(dict(zip(("simulated", "predicted"), errors, strict=True)))
    worst = float(np.abs(errors[0] - errors[1]).max())
    caption = (
        f"Each run of {title(fitted, data)} against what a surface fitted to all the others "
        f"predicts; the worst is off by {quantity(worst, clean(fitted.unit))}, and Q2 is "
        f"{min(surface.model.q2, 0.9999):.4g}{' or more' if surface.model.q2 > 0.9999 else ''} "
        "(1 is perfect, 0 no better than the mean)."
    )
    return frame, lambda: _draw_left_out(frame, fitted, data), caption


def _draw_left_out(frame: pd.DataFrame, fitted: FittedSurface, data: ReportData) -> Canvas:
    figure = canvas(WIDTH_IN, 3.9)
    ax: Axes = figure.subplots()
    ends = [float(frame.min().min()), float(frame.max().max())]
    ax.plot(ends, ends, color=MUTED, linewidth=0.8)
    ax.scatter(frame["simulated"], frame["predicted"], s=14, color=color_of(0), linewidths=0)
    ax.set_box_aspect(1)
    ax.set_xlabel(f"run: {_response(fitted, data)}")
    ax.set_ylabel("predicted from the others")
    plain_ticks(ax, "x")
    plain_ticks(ax, "y")
    return figure


def _axis(factor: str, fitted: FittedSurface, data: ReportData) -> str:
    unit = clean(fitted.units.get(factor, ""))
    return clean(name_of(factor, data.labels), 40) + (f" ({unit})" if unit else "")


def _response(fitted: FittedSurface, data: ReportData) -> str:
    unit = clean(fitted.unit)
    return clean(name_of(fitted.response, data.labels), 40) + (f" ({unit})" if unit else "")
