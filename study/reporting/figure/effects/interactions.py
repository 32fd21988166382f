"""The interaction matrix: lines above the diagonal, cell means below."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from study.reporting.figure.axes import name_rows, plain_ticks, wrap
from study.reporting.figure.effects.level import axis_label
from study.reporting.figure.style import DASHES, INK, MARKERS, RULE, WIDTH_IN, canvas, color_of
from study.reporting.numbers import significant
from study.reporting.report import Facts, cells
from study.reporting.text import clean, name_of
from study.study_result.report_data import ReportData

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas


def pair_means(data: ReportData, facts: Facts) -> pd.DataFrame:
    """Mean of every combination of two levels, for every pair of factors.

    Parameters
    ----------
    data : ReportData
        For the factors and the rows.
    facts : Facts
        The response; means of a log response are geometric.

    Returns
    -------
    DataFrame
        ``factor``, ``level``, ``other``, ``other_level``, ``mean`` of the cells in the response's
        unit.
    """
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
    """Draw a matrix: lines above the diagonal, the same means as numbers below it.

    Parameters
    ----------
    frame : DataFrame
        By :func:`pair_means`.
    facts : Facts
        For name and unit of the response.
    factors : mapping of str to sequence of str
        Levels of every factor, both in the order to be drawn.
    data : ReportData
        For the shown names of factors.
    """
    k = len(factors)
    figure = canvas(WIDTH_IN, 0.7 + 1.45 * k)
    axes = figure.subplots(k, k, squeeze=False)
    low, high = float(frame["mean"].min()), float(frame["mean"].max())
    pad = 0.08 * (high - low or abs(high) or 1.0)
    names = list(factors)
    for i, first in enumerate(names):
        _diagonal(axes[i][i], name_of(first, data.labels), factors[first])
        for j in range(i + 1, k):
            second = names[j]
            pair = frame[(frame["factor"] == first) & (frame["other"] == second)]
            # a combination that has no mean is NaN: no point, no number
            table = pair.pivot_table(index="level", columns="other_level", values="mean").reindex(
                index=list(factors[first]), columns=list(factors[second])
            )
            upper, lower = axes[i][j], axes[j][i]
            _lines(upper, table)
            upper.set_ylim(low - pad, high + pad)
            _upper_ticks(upper, i, j, k, factors[second])
            _numbers(lower, table.T, low, high)
            _lower_ticks(lower, factors[first], j == k - 1)
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


def _lines(ax: Axes, table: pd.DataFrame) -> None:
    """Draw a line for every row of a table of means, a point for every column."""
    import seaborn as sns

    rows, columns = table.shape
    sns.pointplot(
        x=np.tile(np.arange(columns), rows),
        y=table.to_numpy(float).ravel(),
        hue=np.repeat(np.asarray(table.index, dtype=object), columns),
        hue_order=list(table.index),
        palette=[color_of(index) for index in range(rows)],
        markers=[MARKERS[index % 7] for index in range(rows)],
        linestyles=[_dash(index) for index in range(rows)],
        native_scale=True,
        errorbar=None,
        legend=False,
        linewidth=1.4,
        markersize=4,
        markeredgewidth=1,
        ax=ax,
    )
    ax.set_xlim(-0.35, columns - 0.65)
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


def _numbers(ax: Axes, table: pd.DataFrame, low: float, high: float) -> None:
    """Write a table of means, the larger the darker."""
    import seaborn as sns
    from matplotlib.colors import LinearSegmentedColormap, to_rgba

    shades = [to_rgba("#0072B2", 0.04), to_rgba("#0072B2", 0.34)]
    sns.heatmap(
        table.to_numpy(float),
        vmin=low,
        vmax=high,
        cmap=LinearSegmentedColormap.from_list("means", shades),
        annot=table.map(significant).to_numpy(),
        fmt="",
        annot_kws={"color": INK, "fontsize": 7.5 if table.shape[1] < 5 else 6.5},
        linewidths=2,
        linecolor="white",
        cbar=False,
        xticklabels=False,
        yticklabels=False,
        ax=ax,
    )
    names = [wrap(level, 12, 24) for level in table.index]
    name_rows(ax, 0.5 + np.arange(len(table)), names, 7)
    ax.tick_params(length=0, pad=2)


def _lower_ticks(ax: Axes, levels: Sequence[str], last: bool) -> None:
    narrow = max(27 // len(levels), 6)
    names = [wrap(v, narrow, 24) if len(levels) < 4 else clean(v, 24) for v in levels]
    places = 0.5 + np.arange(len(levels))
    ax.set_xticks(places, names if last else [])
    if last and len(levels) > 3:
        ax.set_xticks(places, names, rotation=35, ha="right", rotation_mode="anchor")
    ax.tick_params(axis="x", labelsize=7)
