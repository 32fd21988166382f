"""Small multiples of curves: force above, residual below, on axes that can be compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from study.reporting.figure.axes import plain_ticks, wrap
from study.reporting.figure.curves.samples import CurvePanels, measurements
from study.reporting.figure.style import (
    DASHES,
    INK,
    MUTED,
    RULE,
    WIDTH_IN,
    canvas,
    color_of,
    word_color_of,
)
from study.reporting.numbers import THIN, quantity
from study.reporting.text import clean
from study.study_result.report_data import ReportData

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

#: Longest title of a panel in characters; titles that are alike when cut are numbered.
LONGEST_TITLE = 72
#: Width of one character of a title in inches: 7.5 pt, 0.6 em wide.
CHARACTER_IN = 0.6 * 7.5 / 72
#: Room to the right of the last column for the names of the lines, in inches.
NAMES_IN = 1.35
#: Distance of two names in points: 7 pt text.
NAME_PT = 8.5
#: Inches that a pair of axes is high, without its title.
PAIR_IN = 1.85
TITLE_LINE_IN = 0.125
#: Height of a force axis over that of its residual axis.
FORCE_SHARE = 1.7


@dataclass(frozen=True)
class PanelScale:
    """Units and limits of one panel.

    Parameters
    ----------
    unit_N : float
        Force of one unit of the vertical axis, in N.
    end_mm : float
        End of the horizontal axis, in mm.
    top, gap : float
        Ends of the force axis and, to both sides, of the residual axis, in that unit.
    """

    unit_N: float
    end_mm: float
    top: float
    gap: float


def draw_curves(found: CurvePanels, data: ReportData) -> Canvas:
    """Draw every panel: measured points, predictions on them, residuals below.

    Parameters
    ----------
    found : CurvePanels
        From :func:`study.reporting.figure.curves.samples.curve_panels`.
    data : ReportData
        The report, for the order and the names of levels.

    Returns
    -------
    Figure
    """
    columns = _columns(found, data)
    rows = -(-len(found.panels) // columns)
    titles = panel_titles(found, (WIDTH_IN - NAMES_IN) / columns)
    lines = max(title.count("\n") + 1 for title in titles)
    high = PAIR_IN + 0.28 + TITLE_LINE_IN * lines
    figure = canvas(WIDTH_IN, 0.72 + high * rows, arranged=False)
    scales = panel_scales(found, columns)
    axes = _grid(figure, rows, columns, (0.28 + TITLE_LINE_IN * lines) / high)
    for place, (force, residual) in enumerate(axes):
        if place >= len(found.panels):
            force.set_axis_off()
            residual.set_axis_off()
            continue
        _panel(force, residual, found.rows(found.panels[place]), scales[place], found, data)
        force.set_title(titles[place], fontsize=7.5, y=1.0, va="bottom", linespacing=1.15)
        _ticks(force, residual, place, columns, found)
        if place % columns == columns - 1 or place == len(found.panels) - 1:
            _name_lines(force, residual, found, place, scales[place], data)
    x_label = "displacement (mm)"
    figure.text(0.45, 0.08 / figure.get_figheight(), x_label, ha="center", fontsize=8.5)
    _legend(figure, found)
    return figure


def _columns(found: CurvePanels, data: ReportData) -> int:
    """Panels beside each other: the levels of one block, or of several blocks."""
    levels = len(data.factors[found.panel]) if found.panel else 1
    return min(max(levels, (4 // levels) * levels), len(found.panels))


def panel_titles(found: CurvePanels, width_in: float) -> tuple[str, ...]:
    """Title of every panel, wrapped to its width; no two are the same words.

    Parameters
    ----------
    found : CurvePanels
    width_in : float
        Width of a panel in inches.

    Returns
    -------
    tuple of str
        Block and level, and the largest measured force where axes are relative.
    """
    width = max(int(width_in / CHARACTER_IN) - 4, 8)
    parts = [[clean(part, LONGEST_TITLE) for part in panel if part] for panel in found.panels]
    joined = [" \N{MIDDLE DOT} ".join(words) for words in parts]
    if len(set(joined)) < len(joined):
        joined = [f"{number}: {words}" for number, words in enumerate(joined, 1)]
    if found.is_relative:
        tops = [_largest(found.rows(panel)["measured_N"]) for panel in found.panels]
        joined = [
            f"{words} ({THIN.join(('100', '%', '=', quantity(top, 'N')))})"
            for words, top in zip(joined, tops, strict=True)
        ]
    return tuple(wrap(words, width, longest=3 * LONGEST_TITLE) for words in joined)


def panel_scales(found: CurvePanels, columns: int) -> tuple[PanelScale, ...]:
    """Units and limits of every panel: the same forces for all, the same lengths where alike.

    Parameters
    ----------
    found : CurvePanels
    columns : int
        Panels beside each other; those below each other end at the same displacement where
        each column shows one level.

    Returns
    -------
    tuple of PanelScale
    """
    units, ends, tops, gaps = [], [], [], []
    for panel in found.panels:
        rows = found.rows(panel)
        unit = _largest(rows["measured_N"]) / 100 if found.is_relative else 1.0
        unit = unit or 1.0  # a cell that was never computed leaves its panel empty
        residual = (rows["predicted_N"] - rows["measured_N"]).abs()
        units.append(unit)
        ends.append(_largest(rows["displacement_mm"]))
        tops.append(max(_largest(rows["measured_N"]), _largest(rows["predicted_N"])) / unit)
        gaps.append(max(_largest(residual), _largest(rows["scatter_N"])) / unit)
    top, gap = 1.06 * max(tops) or 1.0, 1.1 * max(gaps) or 1.0
    together = [
        max(ends if found.has_one_length else ends[place % columns :: columns])
        for place in range(len(ends))
    ]
    return tuple(PanelScale(unit, end, top, gap) for unit, end in zip(units, together, strict=True))


def _largest(values: pd.Series[float]) -> float:
    """Return the largest of the known values, 0 if there are none."""
    known = values.dropna()
    return float(known.max()) if len(known) else 0.0


def _grid(figure: Canvas, rows: int, columns: int, titles: float) -> list[tuple[Axes, Axes]]:
    """Pairs of axes in reading order, placed in inches: no layout engine has to measure text."""
    height = figure.get_figheight()
    outer = figure.add_gridspec(
        rows,
        columns,
        left=0.62 / WIDTH_IN,
        right=1 - NAMES_IN / WIDTH_IN,
        top=1 - 0.62 / height,
        bottom=0.48 / height,
        wspace=0.1,
        hspace=titles / (1 - titles),
    )
    pairs: list[tuple[Axes, Axes]] = []
    for place in range(rows * columns):
        inner = outer[place // columns, place % columns].subgridspec(
            2, 1, height_ratios=(FORCE_SHARE, 1.0), hspace=0.12
        )
        force = figure.add_subplot(inner[0])
        pairs.append((force, figure.add_subplot(inner[1], sharex=force)))
    return pairs


def _panel(
    force: Axes,
    residual: Axes,
    rows: pd.DataFrame,
    scale: PanelScale,
    found: CurvePanels,
    data: ReportData,
) -> None:
    residual.set_title("", y=1.0)
    residual.axhline(0, color=INK, linewidth=0.6)
    for number, one in enumerate(measurements(rows)):
        _measured(force, residual, one, scale.unit_N, filled=number == 0)
    for index, name in enumerate(data.factors[found.line]):
        one = rows[rows["line"] == name]
        if one.empty:
            continue
        look = {"color": color_of(index), "linestyle": DASHES[index % 4], "linewidth": 1.1}
        predicted = one["predicted_N"] / scale.unit_N
        gap = predicted - one["measured_N"] / scale.unit_N
        force.plot(one["displacement_mm"], predicted, **look)
        residual.plot(one["displacement_mm"], gap, **look)
    force.set_xlim(0, 1.02 * scale.end_mm)
    force.set_ylim(0, scale.top)
    residual.set_ylim(-scale.gap, scale.gap)


def _measured(
    force: Axes, residual: Axes, one: pd.DataFrame, unit_N: float, *, filled: bool
) -> None:
    """Points of a measurement, with a band of the standard deviation of its repeats."""
    d, measured = one["displacement_mm"], one["measured_N"] / unit_N
    if one["scatter_N"].notna().all():
        s = one["scatter_N"] / unit_N
        force.fill_between(d, measured - s, measured + s, color="#c4cad1", linewidth=0)
        residual.fill_between(d, -s, s, color="#dde2e7", linewidth=0)
    ground = INK if filled else "#ffffff"
    force.plot(
        d.iloc[::2],
        measured.iloc[::2],
        "o",
        color=INK,
        markersize=1.9,
        markerfacecolor=ground,
        markeredgewidth=0.5,
    )


def _ticks(force: Axes, residual: Axes, place: int, columns: int, found: CurvePanels) -> None:
    """Write numbers at the outer axes only, which hold for all panels of a row or a column."""
    first, last = place % columns == 0, place + columns >= len(found.panels)
    for ax in (force, residual):
        plain_ticks(ax, "y")
        plain_ticks(ax, "x")
        ax.locator_params(axis="y", nbins=4 if ax is force else 3)
        ax.locator_params(axis="x", nbins=4)
        ax.grid(axis="y", color=RULE, linewidth=0.4)
        ax.tick_params(labelleft=first)
    force.tick_params(labelbottom=False)
    residual.tick_params(labelbottom=last)
    if first:
        unit = "% of largest" if found.is_relative else "N"
        force.set_ylabel(f"force ({unit})")
        residual.set_ylabel("resid. (%)" if found.is_relative else "resid. (N)")


def _name_lines(
    force: Axes,
    residual: Axes,
    found: CurvePanels,
    place: int,
    scale: PanelScale,
    data: ReportData,
) -> None:
    """Write the level of every line to the right of a row, joined to the end of its residual."""
    rows = found.rows(found.panels[place])
    ends: list[tuple[float, float, int, str]] = []
    for index, name in enumerate(data.factors[found.line]):
        one = rows[rows["line"] == name].dropna(subset=["predicted_N"])
        if not one.empty:
            last = one.iloc[-1]
            gap = (last["predicted_N"] - last["measured_N"]) / scale.unit_N
            ends.append((float(gap), float(last["displacement_mm"]), index, name))
    ends.sort()
    # two axes and between them 0.12 of their mean height
    height_pt = 72 * PAIR_IN / (FORCE_SHARE + 1.0 + 0.06 * (FORCE_SHARE + 1.0))
    wanted = [height_pt * (gap / scale.gap + 1) / 2 for gap, *_ in ends]
    for (gap, d, index, name), at in zip(ends, spread(wanted, NAME_PT), strict=True):
        residual.annotate(
            clean(name, 24),
            xy=(d, gap),
            xytext=(1.09, at / height_pt),
            textcoords="axes fraction",
            fontsize=7,
            va="center",
            color=word_color_of(index),
            annotation_clip=False,
            arrowprops={
                "arrowstyle": "-",
                "color": MUTED,
                "linewidth": 0.4,
                "shrinkA": 0,
                "shrinkB": 0,
            },
        )


def spread(wanted: Sequence[float], distance: float) -> tuple[float, ...]:
    """Places in rising order, at least a distance apart, as near to the wanted ones as they can.

    Parameters
    ----------
    wanted : sequence of float
        Rising.
    distance : float

    Returns
    -------
    tuple of float

    Examples
    --------
    >>> spread([0.0, 1.0, 9.0], 4.0)
    (-1.5, 2.5, 9.0)
    """
    # neighbors that are too near each other become a block around the mean of what they wanted
    blocks: list[list[float]] = []
    for place in wanted:
        blocks.append([place])
        while len(blocks) > 1 and _low(blocks[-1], distance) - _high(blocks[-2], distance) < (
            distance
        ):
            blocks[-2:] = [blocks[-2] + blocks[-1]]
    return tuple(
        _low(block, distance) + number * distance
        for block in blocks
        for number in range(len(block))
    )


def _low(block: Sequence[float], distance: float) -> float:
    return float(np.mean(block)) - distance * (len(block) - 1) / 2


def _high(block: Sequence[float], distance: float) -> float:
    return float(np.mean(block)) + distance * (len(block) - 1) / 2


def _legend(figure: Canvas, found: CurvePanels) -> None:
    """Say what points and bands are; lines are named where they end."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    points = Line2D([], [], color=INK, marker="o", markersize=3, linestyle="none", label="measured")
    handles: list[Line2D | Patch] = [points]
    if found.frame["scatter_N"].notna().any():
        handles.append(Patch(color="#c4cad1", label="standard deviation of the repeats"))
    figure.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(0.5 / WIDTH_IN, 1.0),
        ncols=len(handles),
        handlelength=1.6,
        columnspacing=1.4,
        borderaxespad=0.2,
    )
