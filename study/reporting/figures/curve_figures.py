"""Figures of curves: fits of a calibration, recordings, markers, predictions of a study."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from study.ground.arrays import Array
from study.ground.curve import Curve
from study.reporting.content.report_facts import block_name
from study.reporting.content.text import THIN, clean, count, listing, name_of, quantity, sentence
from study.reporting.figures import axes as style
from study.reporting.results.study_result import CurvePair, ReportData

#: color of the scatter of repeats
SCATTER = "#c4cad1"
_COLUMNS = 3
_MOST = 12


@dataclass(frozen=True)
class FitPanel:
    """One measured curve of a calibration."""

    title: str
    #: False for a curve that was only predicted.
    fitted: bool
    #: shape (n,); the curve: force over displacement in mm, or over time in s.
    places: Array
    measured_N: Array
    #: Prediction and standard deviation of the repeats, where there are any.
    predicted_N: Array | None
    scatter_N: Array | None
    #: Whether it is a course in time.
    over_time: bool = False
    #: Whether the rows of two directions stand one after the other.
    is_biaxial: bool = False


def draw_fit(panels: Sequence[FitPanel], title: str) -> Canvas:
    """Draw the first curves with their fits, and residuals below each."""
    total, panels = len(panels), panels[:_MOST]
    columns = min(_COLUMNS, len(panels))
    rows = -(-len(panels) // columns)
    figure = style.canvas(0.5 + 3.0 * rows, style.WIDTH_IN if columns > 1 else 0.6 * style.WIDTH_IN)
    axes = figure.subplots(2 * rows, columns, squeeze=False, height_ratios=[2.4, 1.0] * rows)
    for index in range(rows * columns):
        r, c = divmod(index, columns)
        force, residual = axes[2 * r][c], axes[2 * r + 1][c]
        if index >= len(panels):
            force.set_axis_off()
            residual.set_axis_off()
            continue
        _fit_panel(force, residual, panels[index])
        if c == 0:
            force.set_ylabel("force (N)")
            residual.set_ylabel("fit - meas. (N)")
    figure.supxlabel(_axis(panels))
    more = f" (the first {len(panels)} of {total} curves)" if total > len(panels) else ""
    figure.suptitle(clean(title, 120) + more)
    return figure


def _axis(panels: Sequence[FitPanel]) -> str:
    """Label of the common axis."""
    kinds = {panel.over_time for panel in panels}
    if any(panel.is_biaxial for panel in panels):
        return "row, those of the second direction behind those of the first"
    if len(kinds) > 1:
        return "displacement (mm), or time (s) of a course"
    return "time (s)" if kinds == {True} else "displacement (mm)"


def _fit_panel(force: Axes, residual: Axes, panel: FitPanel) -> None:
    d, thin = panel.places, slice(None, None, max(1, panel.places.size // 60))
    if panel.scatter_N is not None:
        s = panel.scatter_N
        low, high = panel.measured_N - s, panel.measured_N + s
        force.fill_between(d, low, high, color=SCATTER, linewidth=0)
        residual.fill_between(
            d, -s, s, color=SCATTER, alpha=0.6, linewidth=0, label="sd of repeats"
        )
    force.plot(
        d[thin], panel.measured_N[thin], "o", color=style.INK, markersize=1.9, label="measured"
    )
    residual.axhline(0, color=style.INK, linewidth=0.6)
    if panel.predicted_N is not None:
        color = style.color_of(0 if panel.fitted else 1)
        label = "fit" if panel.fitted else "prediction (held out)"
        force.plot(d, panel.predicted_N, label=label, color=color, linewidth=1.1)
        residual.plot(d, panel.predicted_N - panel.measured_N, color=color, linewidth=1.1)
    force.set_title(clean(panel.title, 44), fontsize=7.5)
    force.tick_params(labelbottom=False)
    force.legend(loc="upper left", fontsize=7)
    for ax in (force, residual):
        ax.grid(axis="y")


# Recordings with their branches, in the coordinates of the file.

_UNITS = {"displacement": "mm", "force": "N", "stress": "MPa", "true_stress": "MPa",
          "pressure": "MPa"}  # fmt: skip
#: rows of a recording that are drawn
_DRAWN = 2000


def draw_recordings(frame: pd.DataFrame) -> Canvas:
    """Draw a panel a test: rows that are used in color, the others by branch in gray.

    Columns of the frame: test, line, far, hard, branch, set_aside, far_name, hard_name.
    """
    titles = list(dict.fromkeys(frame["test"]))[:_MOST]
    figure, axes = style.panels(len(titles), _COLUMNS, 2.6, 0.3)
    if len(titles) == 1:
        figure.set_figwidth(0.6 * style.WIDTH_IN)
    for ax, title in zip(axes, titles, strict=True):
        rows = frame[frame["test"] == title]
        thin = rows.iloc[:: max(1, len(rows) // _DRAWN)]
        ax.plot(thin["far"], thin["hard"], color=style.RULE, linewidth=0.6, zorder=1)
        grays = itertools.cycle(("#8a929b", "#b3bac1", "#6b737b"))
        for why, part in thin.groupby("set_aside", sort=False):
            used = why == ""
            label = "used" if used else f"set aside: {why}"
            color = style.color_of(0) if used else next(grays)
            ax.plot(part["far"], part["hard"], ".", color=color, markersize=2.4, label=label,
                    zorder=3 if used else 2)  # fmt: skip
        ax.set_title(clean(title, 44), fontsize=7.5)
        for column, write in (("far_name", ax.set_xlabel), ("hard_name", ax.set_ylabel)):
            name = str(rows[column].iloc[0])
            words = style.labeled(f"recorded {name.replace('_', ' ')}", _UNITS.get(name))
            write(words, fontsize=8)
        ax.grid(axis="y")
        ax.legend(loc="best", fontsize=6.5)
    return figure


# Errors of markers inside a specimen, layer by layer and state by state.


def layer_points(data: ReportData) -> pd.DataFrame:
    """RMS error of every layer of every case, all markers fitted with the freest plate."""
    rows = [
        {
            "state": of["state"], "group": clean(next(iter(case.levels.values()), "all"), 30),
            "cell": " / ".join(case.levels.values()), "place": index, "layer": layer,
            "error_mm": math.nan if error is None else error, "floor_mm": of["floor_mm"],
        }
        for case in data.markers
        for of in case.markers
        # the last of the fits to all markers has the freest plate
        for fit in [fit for fit in of["fits"] if fit["fitted"] == "all"][-1:]
        for index, (layer, error) in enumerate(fit["error_by_layer_mm"].items())
    ]  # fmt: skip
    if not rows:
        raise ValueError("no marker has a layer")
    return pd.DataFrame(rows)


def draw_layers(_data: ReportData, frame: pd.DataFrame) -> Canvas:
    """Draw a panel a state: a line for each cell, colored by the first factor."""
    import seaborn as sns

    states = list(dict.fromkeys(frame["state"]))
    figure, axes = style.panels(len(states), len(states), 2.6, 0.0, sharey=True)
    groups = list(dict.fromkeys(frame["group"]))
    colors = {group: style.color_of(number) for number, group in enumerate(groups)}
    for ax, state in zip(axes, states, strict=True):
        part = frame[frame["state"] == state]
        sns.lineplot(
            part, x="place", y="error_mm", hue="group", palette=colors, units="cell",
            estimator=None, linewidth=0.9, legend=ax is axes[0], ax=ax,
        )  # fmt: skip
        floor = part["floor_mm"].dropna()
        if len(floor):
            look: dict[str, Any] = {"color": style.MUTED, "linewidth": 0.8, "linestyle": "--"}
            ax.axhline(float(floor.iloc[0]), label="floor", **look)
        ticks = part[["place", "layer"]].drop_duplicates()
        ax.set_xticks(ticks["place"], [clean(v, 8) for v in ticks["layer"]])
        ax.set_title(clean(state, 30), fontsize=8)
        ax.set(xlabel="", ylabel="")
    axes[0].set_ylabel("RMS error of markers (mm)", fontsize=8.5)
    axes[0].legend(fontsize=6.5, loc="upper left")
    axes[0].set_ylim(bottom=0.0)
    figure.supxlabel("layer of markers, from the base up")
    return figure


def layers_caption(_data: ReportData, frame: pd.DataFrame) -> str:
    """Say which level of the first factor leaves the smallest error in the last state."""
    last = frame[frame["state"] == frame["state"].iloc[-1]]
    mean = last.groupby("group", sort=False)["error_mm"].mean()
    best, error = str(mean.idxmin()), float(mean.min())
    return (
        f"In state {clean(last['state'].iloc[0], 30)} the mean error over layers is smallest with "
        f"{clean(best, 40)} ({error:.3g} mm). Each line is a cell, with any rigid motion of the "
        "plate and slip fitted to all markers; dashed: distance of the markers from a smooth field."
    )


# Which curves are drawn in which panel, sampled, each beside its own measurement.

#: Displacements at which every curve is sampled, from the first measured one to the last.
POINTS = 31
#: Panels that fit on one page.
MOST_PANELS = 24
#: Levels of a factor that fit beside each other.
MOST_COLUMNS = 4
#: Forces in N are drawn on one axis if the largest ones of all panels differ by less than this
#: factor. Otherwise each panel shows shares of its own largest measured force: on an axis that
#: reaches 10 times higher, residuals of some percent could not be seen.
COMPARABLE = 3.0

COLUMNS = (
    "block", "panel", "line", "displacement_mm", "measured_N", "predicted_N", "scatter_N",
)  # fmt: skip


@dataclass(frozen=True)
class CurvePanels:
    """Which curves go where."""

    line: str
    #: Factor that splits each block into panels; empty for none.
    panel: str
    #: Level at which every other factor is held.
    fixed: Mapping[str, str]
    #: Block and level of ``panel``, in reading order.
    panels: tuple[tuple[str, str], ...]
    left_out: int
    #: One row a sampled point: ``COLUMNS``. ``predicted_N`` is missing beyond the end of a
    #: prediction that stopped early, ``scatter_N`` where there are no repeats.
    frame: pd.DataFrame

    @property
    def largest(self) -> pd.Series[float]:
        """Largest measured force of every panel in N."""
        return self.frame.groupby(["block", "panel"], sort=False)["measured_N"].max()

    @property
    def is_relative(self) -> bool:
        """Whether forces are shown as shares of the largest measured one of their panel."""
        return bool(self.largest.max() > COMPARABLE * self.largest.min())

    @property
    def shown(self) -> pd.DataFrame:
        """Points with forces as they are drawn: in N, or in percent of the largest."""
        if not self.is_relative:
            return self.frame
        top = self.frame.groupby(["block", "panel"])["measured_N"].transform("max")
        forces = self.frame[["measured_N", "predicted_N", "scatter_N"]]
        return self.frame.assign(**(100 * forces.div(top.replace(0.0, 1.0), axis=0)))


def curve_panels(data: ReportData, most: int = MOST_PANELS) -> CurvePanels:
    """Choose the panels and sample every curve over the range of its own measurement.

    A factor that changes the measurement itself (its range) is drawn in panels, so that every
    panel shows one measurement. Of the others, lines are the factor whose levels differ most
    among the predictions, panels the next; the first scored curve of a block stands for it.
    """
    scored = [pair for pair in data.curves if pair.role == "score"] or list(data.curves)
    if not scored:
        raise ValueError("no curves were kept")
    first = {pair.block: pair.label for pair in reversed(scored)}
    pairs = [pair for pair in scored if pair.label == first[pair.block]]
    line, panel = _roles(data, pairs)
    fixed = {name: data.factors[name][0] for name in data.factors if name not in (line, panel)}
    chosen = [p for p in pairs if all(p.levels.get(k) == v for k, v in fixed.items())]
    levels = data.factors[panel] if panel else ("",)
    present = dict.fromkeys(pair.block for pair in pairs)
    blocks = [block for block in data.blocks if block in present] or list(present)
    room = max(most // len(levels), 1)
    shown = [blocks[i] for i in np.unique(np.linspace(0, len(blocks) - 1, room).astype(int))]
    panels = tuple((block, level) for block in shown for level in levels)
    rows = [row for pair in chosen if pair.block in shown for row in _samples(pair, line, panel)]
    frame = pd.DataFrame(rows, columns=list(COLUMNS))
    return CurvePanels(line, panel, fixed, panels, len(blocks) - len(shown), frame)


def _roles(data: ReportData, pairs: Sequence[CurvePair]) -> tuple[str, str]:
    """Return the factor drawn as lines and the one drawn in panels."""
    order = sorted(data.factors, key=lambda name: -_spread(pairs, name))
    measuring = [name for name in order if _changes_measurement(pairs, name)]
    others = [name for name in order if name not in measuring]
    few = [name for name in measuring if len(data.factors[name]) <= MOST_COLUMNS]
    if few and others:
        return others[0], few[0]
    panel = order[1] if len(order) > 1 and len(data.factors[order[1]]) <= MOST_COLUMNS else ""
    return order[0], panel


def _changes_measurement(pairs: Sequence[CurvePair], factor: str) -> bool:
    """Whether levels of a factor, all others held, meet measurements that end elsewhere."""
    ends: dict[tuple[str, ...], set[float]] = {}
    for pair in pairs:
        others = (level for name, level in pair.levels.items() if name != factor)
        end = round(float(pair.measured.displacement_mm[-1]), 9)
        ends.setdefault((pair.block, *others), set()).add(end)
    return any(len(end) > 1 for end in ends.values())


def _spread(pairs: Sequence[CurvePair], factor: str) -> float:
    """Variance between levels of the residual averaged at each tenth of the range."""
    groups: dict[str, list[Array]] = {}
    for pair in pairs:
        end = min(pair.measured.displacement_mm[-1], pair.predicted.displacement_mm[-1])
        d = np.linspace(0.1, 1, 10) * float(end)
        gap = pair.predicted.force_at(d) - pair.measured.force_at(d)
        groups.setdefault(pair.levels.get(factor, ""), []).append(gap / pair.measured.force_N.max())
    means = [np.mean(group, axis=0) for group in groups.values()]
    return float(np.var(means, axis=0).sum())


def _samples(pair: CurvePair, line: str, panel: str) -> list[tuple[str | float, ...]]:
    """Points of one pair over its whole measurement."""
    measured_mm = pair.measured.displacement_mm
    d = np.linspace(max(float(measured_mm[0]), 0.0), float(measured_mm[-1]), POINTS)
    end = float(pair.predicted.displacement_mm[-1])
    # a curve that was asked for to the last measured point may end an ulp before it
    reached = d <= end * (1 + 1e-9)
    predicted = np.full(d.size, np.nan)
    predicted[reached] = pair.predicted.force_at(np.minimum(d[reached], end))
    scatter = np.full(d.size, np.nan)
    if pair.scatter_N is not None:
        scatter = np.interp(d, measured_mm, pair.scatter_N)
    key = (pair.block, pair.levels.get(panel, ""), pair.levels.get(line, ""))
    columns = zip(d, pair.measured.force_at(d), predicted, scatter, strict=True)
    return [(*key, *map(float, values)) for values in columns]


# Small multiples of curves: force above, residual below, on axes that can be compared.

#: Longest title of a panel in characters; titles that are alike when cut are numbered.
LONGEST_TITLE = 72
#: Width of one character of a title in inches: 7.5 pt, 0.6 em wide.
CHARACTER_IN = 0.6 * 7.5 / 72
#: Inches of a line of the title or the legend, of the displacements below all panels.
LINE_IN = 0.15
BELOW_IN = 0.44
#: Inches of the axes of one of many panels, and of the whole figure of the first page.
MANY_IN = 1.65
FEW_IN = 3.46
#: Part of the axes that force has; the residual has the rest.
FORCE_PART = 0.62
#: Inches of a column of the legend.
NAME_IN = 1.66


def draw_curves(panels: CurvePanels, data: ReportData, _frame: pd.DataFrame) -> Canvas:
    """Draw every panel: measured points, predictions on them, residuals below.

    Axes are placed in inches: to measure the text of 48 of them takes a layout engine seconds.
    """
    number, levels = len(panels.panels), len(data.factors[panels.panel]) if panels.panel else 1
    is_few = number <= MOST_COLUMNS  # those of the first page
    columns = min(2 if is_few else max(levels, (4 // levels) * levels), number)
    width = style.HALF_IN if is_few else style.WIDTH_IN
    rows, names_in_row = -(-number // columns), int(width / NAME_IN)
    titles = panel_titles(panels, width / columns, data)
    points = Line2D(
        [], [], color=style.INK, marker="o", markersize=3, linestyle="none", label="measured"
    )
    handles: list[Line2D | Patch] = [points]
    if panels.frame["scatter_N"].notna().any():
        handles.append(Patch(color=SCATTER, label="sd of repeats"))
    drawn = set(panels.frame["line"])
    names = [(k, name) for k, name in enumerate(data.factors[panels.line]) if name in drawn]
    handles += [Line2D([], [], label=clean(name, 24), **_look_of(k)) for k, name in names]
    title_in = 0.14 + LINE_IN * max(title.count("\n") + 1 for title in titles)
    top_in = 0.02 + 1.2 * LINE_IN * -(-len(handles) // names_in_row)
    row_in = (FEW_IN - BELOW_IN - top_in) / rows - title_in if is_few else MANY_IN
    height = BELOW_IN + top_in + rows * (title_in + row_in)
    figure = style.canvas(height, width, arranged=False)
    grid = figure.add_gridspec(
        3 * rows, columns, left=0.62 / width, right=0.99, top=1 - top_in / height,
        bottom=BELOW_IN / height, wspace=0.1, hspace=0.06,
        height_ratios=(title_in, FORCE_PART * row_in, (1 - FORCE_PART) * row_in) * rows,
    )  # fmt: skip
    frame = panels.shown
    gap = (frame["predicted_N"] - frame["measured_N"]).abs()
    top = 1.06 * (frame[["measured_N", "predicted_N"]].max().max() or 1.0)
    wide = 1.1 * (np.nanmax([gap.max(), frame["scatter_N"].max()]) or 1.0)
    ends = frame.groupby("panel")["displacement_mm"].max()
    for index, ((block, level), title) in enumerate(zip(panels.panels, titles, strict=True)):
        row, column = divmod(index, columns)
        force = figure.add_subplot(grid[3 * row + 1, column])
        residual = figure.add_subplot(grid[3 * row + 2, column], sharex=force)
        lines = frame[(frame["block"] == block) & (frame["panel"] == level)]
        _plot_panel(force, residual, lines, data.factors[panels.line])
        force.set_title(title, fontsize=7.5)
        force.set(xlim=(0, 1.02 * ends.get(level, 1.0)), ylim=(0, top))
        residual.set_ylim(-wide, wide)
        if column == 0:
            unit = "%" if panels.is_relative else "N"
            force.set_ylabel(f"force ({unit})", fontsize=6.5 if is_few else 8.5)
            # in the unit of the force above; a low panel has no room to say so again
            label = "resid." if is_few else f"resid. ({unit})"
            residual.set_ylabel(label, fontsize=6.5 if is_few else 8.5)
        for ax in (force, residual):
            # the zero of force would touch the highest residual
            nbins, prune = (4, "lower") if ax is force else (3, None)
            ax.locator_params(axis="y", nbins=nbins, prune=prune)
            ax.locator_params(axis="x", nbins=4)
            ax.grid(axis="y")
            # numbers at the outer axes hold for all panels of a row or a column
            is_lowest = ax is residual and index + columns >= number
            ax.tick_params(labelleft=column == 0, labelbottom=is_lowest)
    figure.text(0.5, 0.06 / height, "displacement (mm)", ha="center", fontsize=8.5)
    corner = (0.5 / width, 1.0)
    figure.legend(
        handles=handles, loc="upper left", bbox_to_anchor=corner, ncols=names_in_row,
        borderaxespad=0.2, columnspacing=1.4,
    )  # fmt: skip
    return figure


def curves_caption(panels: CurvePanels, data: ReportData, frame: pd.DataFrame) -> str:
    """Say what is drawn, what is held fixed, and how large the residuals are."""
    gap = (frame["predicted_N"] - frame["measured_N"]).abs()
    worst = frame.iloc[int(np.nanargmax(gap.to_numpy()))]
    of = filter(None, (clean(worst["line"]), block_name(str(worst["block"]), data)))
    text = (
        "force above, predicted minus measured below; the largest residual is "
        f"{quantity(gap.max(), 'N')} ({', '.join(of)})"
    )
    if panels.is_relative:
        text += (
            ". Each panel is in percent of its largest measured force, since forces differ too "
            "much for one axis in N"
        )
    if frame["predicted_N"].isna().any():
        text += ". A line that ends early belongs to a simulation that stopped there"
    if held := [f"{name_of(k, data.labels)} = {clean(v)}" for k, v in panels.fixed.items()]:
        text += f". Shown with {listing(held)}"
    if panels.left_out:
        unit = clean(data.block) or "block"
        text += f"; {count(panels.left_out, f'more {unit}')} not shown"
    return sentence(text)


def panel_titles(panels: CurvePanels, width_in: float, data: ReportData) -> tuple[str, ...]:
    """Title of every panel, wrapped to its width; no two are the same words."""
    width = max(int(width_in / CHARACTER_IN) - 4, 8)
    named = [(block_name(block, data), level) for block, level in panels.panels]
    parts = [[clean(part, LONGEST_TITLE) for part in panel if part] for panel in named]
    joined = [" \N{MIDDLE DOT} ".join(words) for words in parts]
    if len(set(joined)) < len(joined):
        joined = [f"{number}: {words}" for number, words in enumerate(joined, 1)]
    if panels.is_relative:
        tops = panels.largest.reindex(panels.panels)
        joined = [
            f"{words} ({THIN.join(('100', '%', '=', quantity(top, 'N')))})"
            for words, top in zip(joined, tops, strict=True)
        ]
    return tuple(style.wrap(words, width, longest=3 * LONGEST_TITLE) for words in joined)


def _plot_panel(force: Axes, residual: Axes, rows: pd.DataFrame, levels: Sequence[str]) -> None:
    """Draw measurements with the scatter of their repeats, and a line for each prediction."""
    residual.axhline(0, color=style.INK, linewidth=0.6)
    names = ["displacement_mm", "measured_N", "scatter_N"]
    for _, line in rows.round(dict.fromkeys(names, 9)).drop_duplicates(names).groupby("line"):
        d, measured, s = (line[name] for name in names)
        if s.notna().all():
            force.fill_between(d, measured - s, measured + s, color=SCATTER, linewidth=0)
            residual.fill_between(d, -s, s, color=SCATTER, alpha=0.6, linewidth=0)
        force.plot(d.iloc[::2], measured.iloc[::2], "o", color=style.INK, markersize=1.9)
    for index, name in enumerate(levels):
        line = rows[rows["line"] == name]
        d, look = line["displacement_mm"], _look_of(index)
        force.plot(d, line["predicted_N"], **look)
        residual.plot(d, line["predicted_N"] - line["measured_N"], **look)


def _look_of(index: int) -> dict[str, Any]:
    return {"color": style.color_of(index), "linestyle": style.DASHES[index % 4], "linewidth": 1.1}


# One curve by itself.


def draw_curve(curve: Curve) -> Canvas:
    """Draw force against displacement from the unloaded origin, load steps as points."""
    figure, ax = style.one_panel(3.2, 0.6 * style.WIDTH_IN)
    places = np.linspace(0.0, curve.displacement_mm[-1], 200)
    ax.plot(places, curve.force_at(places), color=style.color_of(0))
    ax.plot(curve.displacement_mm, curve.force_N, "o", color=style.color_of(0), markersize=3)
    ax.grid(axis="y")
    ax.set(xlabel="displacement (mm)", ylabel="force (N)")
    return figure


CURVES: style.Plot = (
    "Measured and predicted force",
    lambda panels, _: panels.frame,
    draw_curves,
    curves_caption,
)
MARKERS: style.Plot = ("Errors by layer", layer_points, draw_layers, layers_caption)
