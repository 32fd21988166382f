"""Figures of curves: predictions on measurements, in small multiples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from study.arrays import Array
from study.reporting.figure.style import (
    DASHES,
    INK,
    RULE,
    WIDTH_IN,
    canvas,
    color_of,
    plain_ticks,
    render,
)
from study.reporting.numbers import clean
from study.study_result.report_data import CurvePair, ReportData

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
    present = dict.fromkeys(pair.block for pair in pairs)
    blocks = [block for block in data.blocks if block in present] or list(present)
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
    groups: dict[str, list[Array]] = {}
    for pair in pairs:
        d = np.linspace(0.1, 1, 10) * _end(pair)
        gap = pair.predicted.force_at(d) - pair.measured.force_at(d)
        groups.setdefault(pair.levels.get(factor, ""), []).append(gap / pair.measured.force_N.max())
    means = [np.mean(group, axis=0) for group in groups.values()]
    return float(np.var(means, axis=0).sum())


def _end(pair: CurvePair) -> float:
    return float(min(pair.measured.displacement_mm[-1], pair.predicted.displacement_mm[-1]))


def _samples(pair: CurvePair, line: str, panel: str) -> list[tuple[str | float, ...]]:
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
    figure = canvas(WIDTH_IN, 0.85 + 2.05 * rows, arranged=False)
    limits = _limits(found.frame)
    own = len(set(limits.values())) > 1
    axes = _grid(figure, rows, columns, 0.24 if own else 0.08)
    for place, (force, residual) in enumerate(axes):
        if place >= len(found.panels):
            force.set_axis_off()
            residual.set_axis_off()
            continue
        _panel(force, residual, found, place, data)
        first = place % (levels if own else columns) == 0
        top, gap = limits[found.panels[place][0]]
        force.set_ylim(0, top)
        residual.set_ylim(-gap, gap)
        force.tick_params(labelleft=first, labelbottom=False)
        residual.tick_params(labelleft=first, labelbottom=place + columns >= len(found.panels))
        if place % columns == 0:
            force.set_ylabel("force (N)")
            residual.set_ylabel("resid. (N)")
    figure.text(0.5, 0.08 / figure.get_figheight(), "displacement (mm)", ha="center", fontsize=8.5)
    _curve_legend(figure, found, data)
    return figure


def _limits(frame: pd.DataFrame) -> dict[str, tuple[float, float]]:
    """Largest force and residual of each block; those of all where blocks are alike."""
    gap = (frame["predicted_N"] - frame["measured_N"]).abs().groupby(frame["block"]).max()
    top = frame[["measured_N", "predicted_N"]].max(axis=1).groupby(frame["block"]).max()
    if float(top.max()) < 3 * float(top.min()):
        gap[:], top[:] = gap.max(), top.max()
    return {
        str(block): (1.06 * float(top[block]), 1.1 * float(gap[block]) or 1.0)
        for block in top.index
    }


def _grid(figure: Canvas, rows: int, columns: int, between: float) -> list[tuple[Axes, Axes]]:
    """Pairs of axes in reading order, placed in inches: no layout engine has to measure text."""
    height = figure.get_figheight()
    outer = figure.add_gridspec(
        rows,
        columns,
        left=0.62 / WIDTH_IN,
        right=1 - 0.06 / WIDTH_IN,
        top=1 - 0.52 / height,
        bottom=0.48 / height,
        wspace=between,
        hspace=0.2,
    )
    pairs: list[tuple[Axes, Axes]] = []
    for place in range(rows * columns):
        inner = outer[place // columns, place % columns].subgridspec(
            2, 1, height_ratios=(2.2, 1.0), hspace=0.12
        )
        shared = pairs[0][0] if pairs else None
        force = figure.add_subplot(inner[0], sharex=shared)
        pairs.append((force, figure.add_subplot(inner[1], sharex=force)))
    return pairs


def _panel(force: Axes, residual: Axes, found: CurvePanels, place: int, data: ReportData) -> None:
    block, level = found.panels[place]
    rows = found.frame[(found.frame["block"] == block) & (found.frame["panel"] == level)]
    title = " \N{MIDDLE DOT} ".join(clean(part, 16) for part in (block, level) if part)
    # a given height spares matplotlib the search for one among all ticks
    force.set_title(title, fontsize=7.5, y=1.0)
    residual.set_title("", y=1.0)
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
        loc="upper left",
        bbox_to_anchor=(0.5 / WIDTH_IN, 1.0),
        ncols=min(len(handles), 6),
        handlelength=2.6,
        columnspacing=1.4,
        borderaxespad=0.2,
    )


_COLUMNS = 3
_MOST = 12


@dataclass(frozen=True)
class FitPanel:
    """One measured curve of a calibration.

    Parameters
    ----------
    title : str
        File and specimen.
    fitted : bool
        False for a curve that was only predicted.
    displacement_mm, measured_N : ndarray, shape (n,)
        The curve.
    predicted_N, scatter_N : ndarray or None
        Prediction and standard deviation of the repeats, where there are any.
    """

    title: str
    fitted: bool
    displacement_mm: Array
    measured_N: Array
    predicted_N: Array | None
    scatter_N: Array | None


def fit_figure(panels: Sequence[FitPanel], title: str) -> str:
    """Return the figure as SVG, the same bytes for the same data."""
    return render(lambda: _draw(panels[:_MOST], title, len(panels)), "calibration", title)


def _draw(panels: Sequence[FitPanel], title: str, total: int) -> Canvas:
    columns = min(_COLUMNS, len(panels))
    rows = -(-len(panels) // columns)
    figure = canvas(WIDTH_IN if columns > 1 else 0.6 * WIDTH_IN, 0.5 + 3.0 * rows)
    axes = figure.subplots(2 * rows, columns, squeeze=False, height_ratios=[2.4, 1.0] * rows)
    for place in range(rows * columns):
        r, c = divmod(place, columns)
        force, residual = axes[2 * r][c], axes[2 * r + 1][c]
        if place >= len(panels):
            force.set_axis_off()
            residual.set_axis_off()
            continue
        _fit_panel(force, residual, panels[place])
        if c == 0:
            force.set_ylabel("force (N)")
            residual.set_ylabel("fit - meas. (N)")
    figure.supxlabel("displacement (mm)", fontsize=8.5)
    more = f" (the first {len(panels)} of {total} curves)" if total > len(panels) else ""
    figure.suptitle(clean(title, 120) + more, fontsize=9)
    return figure


def _fit_panel(force: Axes, residual: Axes, panel: FitPanel) -> None:
    d, thin = panel.displacement_mm, slice(None, None, max(1, panel.displacement_mm.size // 60))
    if panel.scatter_N is not None:
        s = panel.scatter_N
        low, high = panel.measured_N - s, panel.measured_N + s
        force.fill_between(d, low, high, color="#c4cad1", linewidth=0)
        residual.fill_between(d, -s, s, color="#e3e7eb", linewidth=0, label="sd of repeats")
    force.plot(d[thin], panel.measured_N[thin], "o", color=INK, markersize=1.9, label="measured")
    residual.axhline(0, color=INK, linewidth=0.6)
    if panel.predicted_N is not None:
        color = color_of(0 if panel.fitted else 1)
        label = "fit" if panel.fitted else "prediction (held out)"
        force.plot(d, panel.predicted_N, label=label, color=color, linewidth=1.1)
        residual.plot(d, panel.predicted_N - panel.measured_N, color=color, linewidth=1.1)
    force.set_title(clean(panel.title, 44), fontsize=7.5)
    force.tick_params(labelbottom=False)
    force.legend(loc="upper left", fontsize=7)
    for ax in (force, residual):
        ax.grid(axis="y", color=RULE, linewidth=0.4)
