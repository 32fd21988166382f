"""The interaction matrix: lines above the diagonal, cell means below."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from study.reporting.data import ReportData
from study.reporting.facts import Facts, cells
from study.reporting.figures_effects import axis_label
from study.reporting.style import (
    DASHES,
    MARKERS,
    RULE,
    WIDTH_IN,
    canvas,
    color_of,
)
from study.reporting.text import (
    clean,
    name_of,
    significant,
)
from study.reporting.ticks import name_rows, plain_ticks, wrap

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas


def pair_means(data: ReportData, facts: Facts) -> pd.DataFrame:
    """Mean of every combination of two levels, for every pair of factors."""
    import pandas as pd

    frame = cells(data, facts.name)
    log = facts.ratio
    rows = []
    names = list(data.factors)
    for i, first in enumerate(names):
        for second in names[i + 1 :]:
            values = frame.assign(y=np.log(frame["mean"]) if log else frame["mean"])
            means = values.groupby([first, second], sort=False)["y"].mean()
            for key, mean in zip(means.index.tolist(), means.to_numpy(float), strict=True):
                rows.append((first, key[0], second, key[1], float(np.exp(mean) if log else mean)))
    return pd.DataFrame(rows, columns=["factor", "level", "other", "other_level", "mean"])


def draw_interactions(
    frame: pd.DataFrame, facts: Facts, factors: Mapping[str, Sequence[str]], data: ReportData
) -> Canvas:
    """Draw a matrix: lines above the diagonal, the same means as numbers below it."""
    k = len(factors)
    figure = canvas(WIDTH_IN, 0.7 + 1.45 * k)
    axes = figure.subplots(k, k, squeeze=False)
    keys = zip(*(frame[name] for name in frame.columns[:4]), strict=True)
    lookup = dict(zip(keys, frame["mean"].astype(float), strict=True))
    low, high = float(frame["mean"].min()), float(frame["mean"].max())
    pad = 0.08 * (high - low or abs(high) or 1.0)
    names = list(factors)
    for i, first in enumerate(names):
        for j, second in enumerate(names):
            ax = axes[i][j]
            if i == j:
                _diagonal(ax, name_of(first, data.labels), factors[first])
            elif i < j:
                _lines(ax, lookup, (first, factors[first]), (second, factors[second]))
                ax.set_ylim(low - pad, high + pad)
                _upper_ticks(ax, i, j, k, factors[second])
            else:
                _numbers(ax, lookup, (second, factors[second]), (first, factors[first]), low, high)
                _lower_ticks(ax, factors[second], i == k - 1)
    figure.suptitle(axis_label(facts), x=0.01, ha="left", fontsize=8.5)
    return figure


def _diagonal(ax: Axes, name: str, levels: Sequence[str]) -> None:
    ax.set_axis_off()
    ax.set_xlim(0, 1)
    ax.set_ylim(0, 1)
    shown = list(levels)[:7]
    step = min(0.15, 0.7 / len(shown))
    top = 0.5 + step * (len(shown) + 0.4) / 2
    ax.text(0.02, top, clean(name, 22), fontweight="bold", va="center")
    for index, level in enumerate(shown):
        y = top - step * (index + 1.2)
        ax.plot(
            [0.03, 0.17],
            [y, y],
            color=color_of(index),
            linestyle=_dash(index),
            marker=MARKERS[index % 7],
            markersize=3.5,
        )
        ax.text(0.22, y, clean(level, 24), va="center", fontsize=7.5)


def _dash(index: int) -> Any:
    return DASHES[index % len(DASHES)]


def _lines(
    ax: Axes,
    lookup: Mapping[Any, float],
    first: tuple[str, Sequence[str]],
    second: tuple[str, Sequence[str]],
) -> None:
    x = np.arange(len(second[1]))
    for index, level in enumerate(first[1]):
        y = [lookup.get((first[0], level, second[0], other), np.nan) for other in second[1]]
        ax.plot(
            x,
            y,
            color=color_of(index),
            linestyle=_dash(index),
            marker=MARKERS[index % 7],
            markersize=4,
        )
    ax.set_xlim(-0.35, x[-1] + 0.35)
    ax.grid(axis="y", color=RULE, linewidth=0.4)


def _upper_ticks(ax: Axes, i: int, j: int, k: int, levels: Sequence[str]) -> None:
    ax.xaxis.tick_top()
    ax.spines["top"].set_visible(True)
    ax.spines["bottom"].set_visible(False)
    narrow = max(int(26 / len(levels)), 6)
    ax.set_xticks(range(len(levels)), [wrap(v, narrow, 24) for v in levels] if i == 0 else [])
    ax.tick_params(axis="x", labelsize=7, length=0)
    ax.yaxis.tick_right()
    ax.spines["left"].set_visible(False)
    ax.spines["right"].set_visible(j == k - 1)
    plain_ticks(ax, "y")
    if j < k - 1:
        ax.tick_params(axis="y", length=0, labelright=False)


def _numbers(
    ax: Axes,
    lookup: Mapping[Any, float],
    column: tuple[str, Sequence[str]],
    row: tuple[str, Sequence[str]],
    low: float,
    high: float,
) -> None:
    ax.set_xlim(-0.5, len(column[1]) - 0.5)
    ax.set_ylim(len(row[1]) - 0.5, -0.5)
    for spine in ax.spines.values():
        spine.set_visible(False)
    for a, across in enumerate(column[1]):
        for b, down in enumerate(row[1]):
            mean = lookup.get((column[0], across, row[0], down))
            if mean is None:
                continue
            depth = 0.04 + 0.30 * (mean - low) / ((high - low) or 1.0)
            ax.fill_between(
                [a - 0.48, a + 0.48], b - 0.46, b + 0.46, color="#0072B2", alpha=depth, linewidth=0
            )
            size = 7.5 if len(column[1]) < 5 else 6.5
            ax.text(a, b, significant(mean), ha="center", va="center", fontsize=size)
    name_rows(ax, range(len(row[1])), [wrap(v, 12, 24) for v in row[1]], 7)
    ax.tick_params(length=0, pad=2)


def _lower_ticks(ax: Axes, levels: Sequence[str], last: bool) -> None:
    narrow = max(27 // len(levels), 6)
    names = [wrap(v, narrow, 24) if len(levels) < 4 else clean(v, 24) for v in levels]
    ax.set_xticks(range(len(levels)), names if last else [])
    if last and len(levels) > 3:
        ax.set_xticks(range(len(levels)), names, rotation=35, ha="right", rotation_mode="anchor")
    ax.tick_params(axis="x", labelsize=7)
