"""Figures of cost and of failure: the front of cells worth their seconds, the failure map."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from study.reporting.figure.axes import log_ticks, name_rows, plain_ticks, wrap
from study.reporting.figure.effects.level import axis_label
from study.reporting.figure.style import MARKERS, MUTED, WIDTH_IN, canvas, color_of
from study.reporting.numbers import duration
from study.reporting.report import Facts
from study.reporting.text import clean, name_of
from study.study_result.report_data import ReportData

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas


#: a row of a legend in small type, a letter in it, what its mark and gaps take, inches; and the
#: share of the figure's width beside the labels of the vertical axis
_LEGEND_ROW_IN = 0.16
_LEGEND_LETTER_IN = 0.062
_LEGEND_MARK_IN = 0.5
_LEGEND_SHARE = 0.9


def draw_front(frame: pd.DataFrame, facts: Facts, data: ReportData, practical: float) -> Canvas:
    """Draw the mean response of each cell against its seconds, front stepped and labeled.

    Parameters
    ----------
    frame : DataFrame
        By :func:`study.reporting.content.recommendation.cost_front`; seconds are of one case.
    facts : Facts
        For the unit, and which end is better.
    data : ReportData
        For the factors, their levels and shown names: two factors are color and shape.
    practical : float
        Smallest difference that matters, in the response's unit; 0 for none.
    """
    color_by, shape_by = _styling(frame, data)
    columns, rows = _legend_shape(color_by[0], shape_by[0], data)
    figure = canvas(WIDTH_IN, 3.7 + _LEGEND_ROW_IN * (rows - 1))
    ax = figure.subplots()
    for row in frame.to_dict("records"):
        ax.plot(
            row["seconds"],
            row["mean"],
            marker=MARKERS[shape_by[1].get(row["cell"], 0) % 7],
            color=color_of(color_by[1].get(row["cell"], 0)),
            markersize=6.5,
            alpha=0.85,
            markeredgecolor="white",
            markeredgewidth=0.5,
            linestyle="none",
        )
    ax.set_xscale("log")
    front = frame[frame["front"]]
    ax.step(front["seconds"], front["mean"], where="post", color=MUTED, linewidth=0.9)
    sign = -1.0 if facts.response.better == "higher" else 1.0
    best = float(sign * (sign * frame["mean"]).min())
    if practical > 0:
        ax.axhspan(best, best + sign * practical, color="#eef1f4", zorder=0)
        ax.text(
            1.0,
            best + sign * practical,
            "as good as the best ",
            ha="right",
            va="bottom",
            transform=ax.get_yaxis_transform(),
            fontsize=7.5,
            color=MUTED,
        )
    ax.margins(x=0.06, y=0.16)
    _front_labels(ax, front, list(data.factors))
    _front_legend(ax, color_by[0], shape_by[0], data, columns)
    _time_ticks(ax, frame)
    plain_ticks(ax, "y")
    ax.set_xlabel("mean computing time of a case")
    ax.set_ylabel(axis_label(facts))
    return figure


def _styling(
    frame: pd.DataFrame, data: ReportData
) -> tuple[tuple[str, dict[str, int]], tuple[str, dict[str, int]]]:
    """Color and shape by the two factors that change the cost most."""
    cost = np.log(frame["seconds"].clip(lower=1e-9))
    moved = {
        name: float(cost.groupby(frame[name]).mean().var() or 0.0)
        for name in data.factors
        if len(data.factors[name]) > 1
    }
    order = sorted(moved, key=lambda name: -moved[name]) or list(data.factors)[:1]
    chosen = (order[0], order[1] if len(order) > 1 else order[0])

    def index(name: str) -> dict[str, int]:
        places = {level: i for i, level in enumerate(data.factors[name])}
        return {
            str(cell): places.get(str(level), 0)
            for cell, level in zip(frame["cell"], frame[name], strict=True)
        }

    return (chosen[0], index(chosen[0])), (chosen[1], index(chosen[1]))


def _front_labels(ax: Axes, front: pd.DataFrame, factors: Sequence[str]) -> None:
    """Name the front's cells; one whose name would run into another's is left out."""
    low, high = np.log(ax.get_xlim())
    bottom, top = ax.get_ylim()
    taken: list[tuple[float, float]] = []
    for row in reversed(front.to_dict("records")):
        x = float((np.log(row["seconds"]) - low) / (high - low))
        y = float((row["mean"] - bottom) / (top - bottom))
        if any(abs(x - a) < 0.36 and abs(y - b) < 0.07 for a, b in taken):
            continue
        taken.append((x, y))
        text = " \N{MIDDLE DOT} ".join(clean(row[name], 22) for name in factors)
        ax.annotate(
            text,
            (row["seconds"], row["mean"]),
            fontsize=7.5,
            va="top",
            ha="right" if x > 0.6 else "left",
            xytext=(-7 if x > 0.6 else 7, -6),
            textcoords="offset points",
        )


def _legend_shape(color_by: str, shape_by: str, data: ReportData) -> tuple[int, int]:
    """Columns and rows of the legend: no more columns than the width of the figure holds."""
    shown = [clean(level, 22) for name in dict.fromkeys((color_by, shape_by))
             for level in data.factors[name]]  # fmt: skip
    wide = _LEGEND_MARK_IN + _LEGEND_LETTER_IN * max(map(len, shown))
    columns = max(1, min(len(shown), int(_LEGEND_SHARE * WIDTH_IN / wide)))
    return columns, -(-len(shown) // columns)


def _front_legend(ax: Axes, color_by: str, shape_by: str, data: ReportData, columns: int) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D(
            [],
            [],
            color=color_of(i),
            marker="o",
            linestyle="none",
            markersize=5,
            label=clean(level, 22),
        )
        for i, level in enumerate(data.factors[color_by])
    ]
    if shape_by != color_by:
        handles += [
            Line2D(
                [],
                [],
                color=MUTED,
                marker=MARKERS[i % 7],
                linestyle="none",
                markersize=5,
                label=clean(level, 22),
            )
            for i, level in enumerate(data.factors[shape_by])
        ]
    title = clean(name_of(color_by, data.labels), 30)
    if shape_by != color_by:
        title += f" (color), {clean(name_of(shape_by, data.labels), 30)} (shape)"
    ax.legend(
        handles=handles,
        title=title,
        title_fontsize=7.5,
        fontsize=7.5,
        ncols=columns,
        loc="lower left",
        bbox_to_anchor=(0, 1.0),
        alignment="left",
        borderpad=0,
    )


def _time_ticks(ax: Axes, frame: pd.DataFrame) -> None:
    low, high = float(frame["seconds"].min()), float(frame["seconds"].max())
    ticks = [1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 60.0, 600.0, 3600.0, 36000.0]
    inside = [t for t in ticks if low / 2 <= t <= high * 2]
    seen = [t for t in inside if ax.get_xlim()[0] <= t <= ax.get_xlim()[1]]
    if len(seen) < 2:
        log_ticks(ax, "x", duration)
    else:
        ax.set_xticks(inside, [duration(t) for t in inside])
    ax.set_xticks([], minor=True)


def draw_failures(frame: pd.DataFrame, statuses: Sequence[str]) -> Canvas:
    """Draw cells against blocks, a mark where a case failed.

    Parameters
    ----------
    frame : DataFrame
        One row a case: ``cell``, ``block``, ``status``, in the order to be drawn.
    statuses : sequence of str
        In the order of the legend; ``converged`` gets a small gray point.
    """
    rows = list(dict.fromkeys(frame["cell"]))
    columns = list(dict.fromkeys(frame["block"]))
    figure = canvas(WIDTH_IN, 0.9 + 0.2 * len(rows))
    ax = figure.subplots()
    for index, status in enumerate(statuses):
        some = frame[frame["status"] == status]
        good = status == "converged"
        ax.plot(
            [columns.index(b) for b in some["block"]],
            [rows.index(c) for c in some["cell"]],
            linestyle="none",
            marker="." if good else MARKERS[(index + 1) % 7],
            color="#c4cad1" if good else color_of(index),
            markersize=4 if good else 7,
            label=clean(status, 24),
        )
    ax.set_xticks(range(len(columns)), [wrap(c, 10, 20) for c in columns], fontsize=7.5)
    name_rows(ax, range(len(rows)), [wrap(r, 80, 70) for r in rows])
    ax.set_ylim(len(rows) - 0.5, -0.5)
    ax.set_xlim(-0.5, len(columns) - 0.5)
    ax.tick_params(length=0)
    figure.legend(loc="outside upper left", ncols=6)
    return figure
