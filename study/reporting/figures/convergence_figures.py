"""Figures of mesh convergence: value and fit, error and slope, error and seconds, meshes.

Everything comes as plain values: a series is the document that ``study converge`` gives.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure as Canvas
from numpy.typing import NDArray

from study.ground.arrays import Array
from study.reporting.content.blocks import Document
from study.reporting.content.tables import label_of
from study.reporting.content.text import clean, count, name_of, percent, sentence
from study.reporting.figures import axes as style

#: more panels than these are no picture any more; the table has them all
MOST_PANELS = 12
COLUMNS = 4
#: what is refined where no parameter of a program is
MESH_SIZE = "mesh size (mm)"


#: behaviour whose bound is a scatter and no interval of a limit
DIVERGENT = "divergent"


def value_points(cells: Sequence[Document]) -> pd.DataFrame:
    """One row a mesh: size, value, and what the series says of it."""
    rows = [
        {
            "cell": label_of(cell), "panel": title, "quantity": cell["qoi"], "unit": cell["unit"],
            "mesh_size": h, "value": v, "behaviour": cell["behaviour"],
            "observed_order": cell["observed_order"], "formal_order": cell["formal_order"],
            "order_used": cell.get("order_used"), "extrapolated": cell["extrapolated"],
            "u_num": cell["u_num"] if k == 0 and cell["behaviour"] != DIVERGENT else None,
        }
        for cell, title in zip(cells, _titles(cells), strict=True)
        for k, (h, v) in enumerate(zip(cell["mesh_size"], cell["value"], strict=True))
    ]  # fmt: skip
    return pd.DataFrame(rows)


def _titles(cells: Sequence[Document]) -> list[str]:
    """Name cells by the levels in which they differ; the quantity stands at the axis."""
    levels = [{k: str(v) for k, v in (cell.get("levels") or {}).items()} for cell in cells]
    differ = [
        key
        for key in dict.fromkeys(key for labels in levels for key in labels)
        if key != "response" and len({labels.get(key) for labels in levels}) > 1
    ]
    cells_named = {tuple(labels.get(key) for key in differ) for labels in levels}
    # of a sample of ranges all levels differ: one that is a name and tells all cells apart is best
    enough = [
        key
        for key in differ
        if len({labels.get(key) for labels in levels}) == len(cells_named)
        and not any(labels.get(key, "0")[:1].isdigit() for labels in levels)
    ]
    shown = enough[:1] or differ
    return [" / ".join(labels[key] for key in shown if key in labels) for labels in levels]


def draw_values(size: str, _cells: Sequence[Document], frame: pd.DataFrame) -> Canvas:
    """Draw value against size, a panel a cell: fit, limit at zero, interval at the finest."""
    groups = list(frame.groupby("cell", sort=False))[:MOST_PANELS]
    figure, axes = style.panels(len(groups), COLUMNS, 2.1)
    if engine := figure.get_layout_engine():
        engine.set(wspace=0.05)  # type: ignore[call-arg]
    several = len(set(frame["quantity"])) > 1
    for ax, (_, part) in zip(axes, groups, strict=True):
        h, v = part["mesh_size"].to_numpy(float), part["value"].to_numpy(float)
        limit, order = part["extrapolated"].iloc[0], part["order_used"].iloc[0]
        if limit is not None and np.isfinite(limit) and order is not None and np.isfinite(order):
            x = np.linspace(0, h.max(), 100)
            power_law = limit + (v[0] - limit) * (x / h[0]) ** order
            ax.plot(x, power_law, color=style.MUTED, linewidth=1.0)
            ax.plot([0], [limit], marker="D", color=style.MUTED, markersize=4, clip_on=False)
        u = part["u_num"].iloc[0]
        if u is not None and np.isfinite(u):
            ax.errorbar(h[:1], v[:1], yerr=[u], color=style.INK, linewidth=1.0, capsize=3)
        ax.plot(h, v, marker="o", linestyle="none", color=style.color_of(0), markersize=4.5)
        order_seen = part["observed_order"].iloc[0]
        is_estimated = order_seen is not None and np.isfinite(order_seen)
        text = f"order {order_seen:.2f}" if is_estimated else str(part["behaviour"].iloc[0])
        # on the right, above or below, where it is farther from all points
        across, up = h / h.max(), (v - v.min()) / (float(np.ptp(v)) or 1.0)
        room = [float(np.min(np.hypot(across - 0.85, up - height))) for height in (0.0, 1.0)]
        free = 0.07 if room[0] >= room[1] else 0.93
        ax.text(
            0.97, free, text, transform=ax.transAxes, ha="right", va="center", fontsize=7.5,
            color=style.MUTED,
        )  # fmt: skip
        ax.set_xlim(0, 1.06 * h.max())
        ax.margins(y=0.15)
        ax.set_title(style.wrap(part["panel"].iloc[0], 30, 90), fontsize=7.5)
        if several:
            ax.set_ylabel(style.wrap(_axis(part), 24), fontsize=7.5)
    figure.supxlabel(size)
    if not several:
        figure.supylabel(_axis(frame))
    return figure


def _axis(frame: pd.DataFrame) -> str:
    """Name of the quantity with its unit."""
    return style.labeled(name_of(str(frame["quantity"].iloc[0])), clean(str(frame["unit"].iloc[0])))


def error_points(cells: Sequence[Document]) -> pd.DataFrame:
    """Relative distance of every mesh to the limit of its own series, where there is one."""
    frame = value_points(cells)
    limit = frame["extrapolated"].astype(float)
    frame["error"] = (frame["value"] - limit).abs() / limit.abs()
    positive: pd.DataFrame = frame[np.isfinite(frame["error"]) & (frame["error"] > 0)]
    return positive.reset_index(drop=True)


def draw_errors(_cells: Sequence[Document], frame: pd.DataFrame) -> Canvas:
    """Draw the error against the mesh size in logarithms, with the formal slope beside."""
    figure, ax = style.one_panel(3.8)
    _errors_of_cells(ax, frame, "mesh_size")
    h = np.array([frame["mesh_size"].min(), frame["mesh_size"].max()])
    start = float(frame["error"].min()) / 2
    for k, order in enumerate(sorted({round(float(p), 2) for p in frame["formal_order"].dropna()})):
        y = start * 0.7**k * (h / h[0]) ** order
        ax.plot(h, y, color=style.RULE, linewidth=1.2, linestyle="--", zorder=0)
        ax.text(h[1], y[1], f" formal {order:g}", fontsize=7.5, color=style.MUTED, va="center")
    _logarithmic(ax, MESH_SIZE, "distance to the limit, part of it")
    sizes = np.geomspace(frame["mesh_size"].min(), frame["mesh_size"].max(), 5)
    ax.set_xticks(sizes, [f"{size:.2g}" for size in sizes])
    return figure


def _errors_of_cells(ax: Axes, frame: pd.DataFrame, across: str) -> None:
    """Draw the errors of every cell as a line with marks, with a legend beside."""
    for k, (cell, part) in enumerate(frame.groupby("cell", sort=False)):
        ax.plot(
            part[across], part["error"], marker=style.MARKERS[k % 8], color=style.color_of(k),
            markersize=4.5, label=clean(cell, 60),
        )  # fmt: skip


def front_points(front: Document) -> pd.DataFrame:
    """Error and seconds of every solution."""
    return pd.DataFrame(front["points"])


def draw_front(front: Document, frame: pd.DataFrame) -> Canvas:
    """Draw the error against seconds, a line a cell, and the accuracy that is wanted."""
    figure, ax = style.one_panel(3.8)
    accuracy, frame = front["accuracy"], frame.assign(error=frame["error"].clip(lower=1e-12))
    ax.axhspan(float(frame["error"].min()) / 3, accuracy, color=style.BAND, zorder=0)
    ax.axhline(accuracy, color=style.MUTED, linewidth=0.8)
    _errors_of_cells(ax, frame, "seconds")
    _logarithmic(ax, "seconds of one solution", "error, part of the limit")
    ax.text(
        0.01, accuracy, f"{100 * accuracy:g} % ", transform=ax.get_yaxis_transform(),
        va="bottom", fontsize=7.5, color=style.MUTED,
    )  # fmt: skip
    return figure


def draw_meshes(meshes: Sequence[tuple[str, Array, NDArray[np.int64]]], window: Array) -> Canvas:
    """Draw plane meshes side by side, all in the same window.

    Shapes: meshes (n, 2), mm; window (2, 2), mm.
    """
    figure, axes = style.panels(len(meshes), COLUMNS, 2.3, 0.4)
    for ax, (label, points, cells) in zip(axes, meshes, strict=True):
        corners = points[cells]
        low, high = corners.min(axis=1), corners.max(axis=1)
        near = cells[np.asarray(((high > window[0]) & (low < window[1])).all(axis=1))]
        shapes = PolyCollection(
            list(points[near]), facecolors="none", edgecolors=style.INK, linewidths=0.35
        )
        ax.add_collection(shapes)
        ax.set_xlim(window[0, 0], window[1, 0])
        ax.set_ylim(window[0, 1], window[1, 1])
        ax.set_aspect("equal")
        ax.set_title(style.wrap(label, 34), fontsize=7.5)
    figure.supxlabel("distance from the axis (mm)")
    figure.supylabel("height (mm)")
    return figure


def _logarithmic(ax: Axes, x: str, y: str) -> None:
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.grid(visible=True)
    ax.set(xlabel=x, ylabel=y)
    ax.margins(x=0.12)
    style.log_ticks(ax)
    ax.legend(loc="center left", bbox_to_anchor=(1.02, 0.5))


def value_caption(cells: Sequence[Document], _frame: pd.DataFrame) -> str:
    """State how many cells converge, and what the marks are."""
    good = [c for c in cells if c["u_num"] is not None and c["behaviour"] != DIVERGENT]
    shares = [c["u_num"] / abs(c["value"][0]) for c in good if c["value"][0]]
    text = f"{len(good)} of {len(cells)} series have an interval"
    if shares:
        text += f"; the widest is {percent(max(shares), 2)} of its value"
    left = len(cells) - MOST_PANELS
    more = f" {left} more series stand in the table." if left > 0 else ""
    has_limit = any(cell["extrapolated"] is not None for cell in cells)
    line = "; line and diamond: power law and its limit" * has_limit
    bar = "; bar: interval at the finest size" * bool(good)
    return f"{text}. Points: sizes that were solved{line}{bar}.{more}"


def error_caption(cells: Sequence[Document], _frame: pd.DataFrame) -> str:
    """State observed beside formal orders, and why the formal order is what it is."""
    orders = [c["observed_order"] for c in cells if c["observed_order"] is not None]
    if not orders:
        return "No series has an order."
    why = "; ".join(dict.fromkeys(str(c["formal_reason"]) for c in cells if c.get("formal_reason")))
    text = f"Observed orders {min(orders):.2f} to {max(orders):.2f}."
    return f"{text} Dashed: the formal order, limited by {why}." if why else text


def values_against(size: str = MESH_SIZE) -> style.Plot:
    """Plot of the values against what was refined, named with its unit."""
    title = f"Value against {size.partition(' (')[0]}"
    return title, value_points, partial(draw_values, size), value_caption


FRONT: style.Plot = (
    "Error against seconds",
    front_points,
    draw_front,
    lambda front, _: sentence(front["answer"]),
)
ERRORS: style.Plot = ("Error and formal order", error_points, draw_errors, error_caption)


# Comparison of simulation and measurement: E and u_val along the curve (ASME V&V 20).


def validation_error_points(rows: Sequence[Document]) -> pd.DataFrame:
    """One row a place of a curve: E and each part of its uncertainty."""
    names = ("displacement_mm", "simulated_N", "measured_N", "error_N", "u_num_N", "u_input_N",
             "u_data_N", "u_val_N")  # fmt: skip
    frames = [
        pd.DataFrame({name: row[name] for name in names}).assign(
            cell=label_of(row), block=row["block"] or ""
        )
        for row in rows
    ]
    return pd.concat(frames, ignore_index=True)


def draw_validation_errors(_rows: Sequence[Document], frame: pd.DataFrame) -> Canvas:
    """Draw E along the curve on the band of u_val, a panel a cell, on shared axes."""
    groups = list(frame.groupby("cell", sort=False))[:MOST_PANELS]
    figure, axes = style.panels(len(groups), COLUMNS, 1.9, sharex=True, sharey=True)
    for ax, (cell, part) in zip(axes, groups, strict=True):
        d, u = part["displacement_mm"], part["u_val_N"]
        ax.fill_between(d, -u, u, color=style.BAND, linewidth=0)
        ax.axhline(0.0, color=style.MUTED, linewidth=0.6)
        ax.plot(d, part["error_N"], color=style.color_of(0))
        ax.set_title(style.wrap(cell, 30), fontsize=7.5)
    figure.supxlabel("displacement (mm)")
    figure.supylabel("simulated minus measured force (N)")
    return figure


def validation_caption(rows: Sequence[Document], _frame: pd.DataFrame) -> str:
    """State in how many cells the model's error shows, and what is not known."""
    judged = [row for row in rows if row["u_val_N"][-1] > 0]
    rest = len(rows) - len(judged)
    unjudged = f"; {count(rest, 'cell')} without a known one" if rest else ""
    beyond = sum(abs(row["error_N"][-1]) > row["u_val_N"][-1] for row in judged)
    unknown = sorted({name for row in rows for name in row.get("unknown") or ()})
    lacking = f" Not known, and so left out: {', '.join(unknown)}." if unknown else ""
    block = f" (block {clean(rows[0]['block'], 30)})" if rows[0]["block"] else ""
    return (
        f"At the end of the curve E exceeds its uncertainty in {beyond} of {len(judged)} "
        f"cells{block}{unjudged}. Band: u_val, from mesh, uncertain "
        f"inputs and scatter of the data.{lacking}"
    )


VALIDATION: style.Plot = (
    "Comparison error along the curve",
    validation_error_points,
    draw_validation_errors,
    validation_caption,
)
