"""Figures of curves and of cost: predictions on measurements, cost front, failure map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from study.reporting.data import CurvePair, ReportData
from study.reporting.facts import Facts
from study.reporting.figures_effects import axis_label, plain_ticks, wrap
from study.reporting.style import (
    DASHES,
    INK,
    MARKERS,
    MUTED,
    RULE,
    WIDTH_IN,
    canvas,
    color_of,
)
from study.reporting.text import clean, duration, name_of

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

_POINTS = 31
_MOST_PANELS = 24


@dataclass(frozen=True)
class CurvePanels:
    """Which curves go where.

    ``line`` is the factor drawn as lines, ``panel`` the factor (empty for none) that splits
    each block into panels; the other factors are held at ``fixed``.
    """

    line: str
    panel: str
    fixed: dict[str, str]
    panels: tuple[tuple[str, str], ...]
    left_out: int
    frame: pd.DataFrame


def curve_panels(data: ReportData) -> CurvePanels:
    """Choose the panels and sample every curve at the same few displacements.

    Lines are the factor whose levels differ most among the predictions, panels the next;
    the first scored curve of a block stands for it.
    """
    import pandas as pd

    pairs = [pair for pair in data.curves if pair.role == "score"] or list(data.curves)
    if not pairs:
        raise ValueError("no curves were kept")
    first: dict[str, str] = {}
    for pair in pairs:
        first.setdefault(pair.block, pair.label)
    pairs = [pair for pair in pairs if pair.label == first[pair.block]]
    order = sorted(data.factors, key=lambda name: -_spread(pairs, name))
    line = order[0]
    panel = order[1] if len(order) > 1 and len(data.factors[order[1]]) <= 4 else ""
    fixed = {name: data.factors[name][0] for name in data.factors if name not in (line, panel)}
    chosen = [p for p in pairs if all(p.levels.get(k) == v for k, v in fixed.items())]
    levels = data.factors[panel] if panel else ("",)
    blocks = list(dict.fromkeys(pair.block for pair in pairs))
    room = max(_MOST_PANELS // len(levels), 1)
    kept = [blocks[i] for i in np.unique(np.linspace(0, len(blocks) - 1, room).astype(int))]
    panels = tuple((block, level) for block in kept for level in levels)
    rows = [row for pair in chosen if pair.block in kept for row in _samples(pair, line, panel)]
    columns = [
        "block",
        "panel",
        "line",
        "displacement_mm",
        "measured_N",
        "predicted_N",
        "scatter_N",
    ]
    return CurvePanels(
        line, panel, fixed, panels, len(blocks) - len(kept), pd.DataFrame(rows, columns=columns)
    )


def _spread(pairs: Sequence[CurvePair], factor: str) -> float:
    """Variance between levels of the residual averaged at each tenth of the range."""
    groups: dict[str, list[Any]] = {}
    for pair in pairs:
        d = np.linspace(0.1, 1, 10) * _end(pair)
        gap = pair.predicted.force_at(d) - pair.measured.force_at(d)
        groups.setdefault(pair.levels.get(factor, ""), []).append(gap / pair.measured.force_N.max())
    means = [np.mean(group, axis=0) for group in groups.values()]
    return float(np.var(means, axis=0).sum())


def _end(pair: CurvePair) -> float:
    return float(min(pair.measured.displacement_mm[-1], pair.predicted.displacement_mm[-1]))


def _samples(pair: CurvePair, line: str, panel: str) -> list[tuple[Any, ...]]:
    start = max(float(pair.measured.displacement_mm[0]), 0.0)
    d = np.linspace(start, _end(pair), _POINTS)
    measured, predicted = pair.measured.force_at(d), pair.predicted.force_at(d)
    scatter = np.full(d.size, np.nan)
    if pair.scatter_N is not None:
        scatter = np.interp(d, pair.measured.displacement_mm, pair.scatter_N)
    key = (pair.block, pair.levels.get(panel, ""), pair.levels.get(line, ""))
    return [(*key, *values) for values in zip(d, measured, predicted, scatter, strict=True)]


def draw_curves(found: CurvePanels, data: ReportData) -> Canvas:
    """Draw small multiples: force on top, residual below, on shared axes."""
    levels = len(data.factors[found.panel]) if found.panel else 1
    columns = max(levels, (6 // levels) * levels)
    columns = min(columns, len(found.panels))
    rows = -(-len(found.panels) // columns)
    figure = canvas(WIDTH_IN, 0.6 + 2.05 * rows)
    heights = [2.2, 1.0] * rows
    axes = figure.subplots(2 * rows, columns, sharex=True, squeeze=False, height_ratios=heights)
    frame = found.frame
    top = 1.06 * float(frame[["measured_N", "predicted_N"]].max().max())
    gap = float((frame["predicted_N"] - frame["measured_N"]).abs().max()) * 1.1
    for place in range(rows * columns):
        r, c = divmod(place, columns)
        force, residual = axes[2 * r][c], axes[2 * r + 1][c]
        if place >= len(found.panels):
            force.set_axis_off()
            residual.set_axis_off()
            continue
        _panel(force, residual, found, place, data)
        force.set_ylim(0, top)
        residual.set_ylim(-gap, gap)
        force.tick_params(labelleft=c == 0, labelbottom=False)
        residual.tick_params(labelleft=c == 0, labelbottom=place + columns >= len(found.panels))
        if c == 0:
            force.set_ylabel("force (N)")
            residual.set_ylabel("resid. (N)")
    figure.supxlabel("displacement (mm)", fontsize=8.5)
    _curve_legend(figure, found, data)
    return figure


def _panel(force: Axes, residual: Axes, found: CurvePanels, place: int, data: ReportData) -> None:
    block, level = found.panels[place]
    rows = found.frame[(found.frame["block"] == block) & (found.frame["panel"] == level)]
    title = " \N{MIDDLE DOT} ".join(clean(part, 16) for part in (block, level) if part)
    force.set_title(title, fontsize=7.5)
    residual.axhline(0, color=INK, linewidth=0.6)
    drawn = False
    for index, name in enumerate(data.factors[found.line]):
        one = rows[rows["line"] == name]
        if one.empty:
            continue
        if not drawn:
            _measured(force, residual, one)
            drawn = True
        look = {"color": color_of(index), "linestyle": DASHES[index % 4], "linewidth": 1.1}
        force.plot(one["displacement_mm"], one["predicted_N"], **look)
        residual.plot(one["displacement_mm"], one["predicted_N"] - one["measured_N"], **look)
    for ax in (force, residual):
        plain_ticks(ax, "y")
        ax.locator_params(axis="y", nbins=4 if ax is force else 3)
        ax.grid(axis="y", color=RULE, linewidth=0.4)


def _measured(force: Axes, residual: Axes, one: pd.DataFrame) -> None:
    if one["scatter_N"].notna().all():
        d, s = one["displacement_mm"], one["scatter_N"]
        force.fill_between(
            d, one["measured_N"] - s, one["measured_N"] + s, color="#c4cad1", linewidth=0
        )
        residual.fill_between(d, -s, s, color="#e3e7eb", linewidth=0)
    thin = one.iloc[::3]
    force.plot(thin["displacement_mm"], thin["measured_N"], "o", color=INK, markersize=1.9)


def _curve_legend(figure: Canvas, found: CurvePanels, data: ReportData) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D(
            [],
            [],
            color=INK,
            marker="o",
            markersize=3,
            linestyle="none",
            label="measured (band: sd of repeats)"
            if found.frame["scatter_N"].notna().any()
            else "measured",
        )
    ]
    handles += [
        Line2D([], [], color=color_of(i), linestyle=DASHES[i % 4], label=clean(level, 24))
        for i, level in enumerate(data.factors[found.line])
    ]
    figure.legend(
        handles=handles,
        loc="outside upper left",
        ncols=min(len(handles), 6),
        handlelength=2.6,
        columnspacing=1.4,
    )


def draw_front(frame: pd.DataFrame, facts: Facts, data: ReportData, practical: float) -> Canvas:
    """Draw the mean response of each cell against its seconds, front stepped and labeled."""
    figure = canvas(WIDTH_IN, 3.7)
    ax = figure.subplots()
    color_by, shape_by = _styling(frame, data)
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
    _front_legend(ax, color_by[0], shape_by[0], data)
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
    """Name the front's cells, one for all that cost the same within a quarter."""
    named: list[dict[str, Any]] = []
    for row in reversed(front.to_dict("records")):
        if not named or row["seconds"] < named[-1]["seconds"] / 1.25:
            named.append(row)
    middle = float(np.sqrt(np.prod(ax.get_xlim())))
    for row in named[:6]:
        text = " \N{MIDDLE DOT} ".join(clean(row[name], 22) for name in factors)
        right = row["seconds"] > middle
        ax.annotate(
            text,
            (row["seconds"], row["mean"]),
            fontsize=7.5,
            va="top",
            ha="right" if right else "left",
            xytext=(-7 if right else 7, -5),
            textcoords="offset points",
        )


def _front_legend(ax: Axes, color_by: str, shape_by: str, data: ReportData) -> None:
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
        ncols=len(handles),
        loc="lower left",
        bbox_to_anchor=(0, 1.0),
        alignment="left",
        borderpad=0,
    )


def _time_ticks(ax: Axes, frame: pd.DataFrame) -> None:
    low, high = float(frame["seconds"].min()), float(frame["seconds"].max())
    ticks = [1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 60.0, 600.0, 3600.0, 36000.0]
    inside = [t for t in ticks if low / 2 <= t <= high * 2] or [low]
    ax.set_xticks(inside, [duration(t) for t in inside])
    ax.set_xticks([], minor=True)


def draw_failures(frame: pd.DataFrame, statuses: Sequence[str]) -> Canvas:
    """Draw cells against blocks, a mark where a case failed."""
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
    ax.set_yticks(range(len(rows)), [wrap(r, 80, 70) for r in rows], fontsize=7.5)
    ax.set_ylim(len(rows) - 0.5, -0.5)
    ax.set_xlim(-0.5, len(columns) - 0.5)
    ax.tick_params(length=0)
    figure.legend(loc="outside upper left", ncols=6)
    return figure
