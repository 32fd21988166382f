"""Means of cells: every combination of levels, its rows and its mean."""

from __future__ import annotations

from typing import TYPE_CHECKING

from study.reporting.figure.axes import at_right, clean_left, name_rows, plain_ticks, wrap
from study.reporting.figure.effects.level import axis_label
from study.reporting.figure.style import BAND, INK, MUTED, RULE, WIDTH_IN, canvas
from study.reporting.numbers import significant
from study.reporting.report import Facts, comparable, describe, groups
from study.study_result.report_data import ReportData

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas


def cell_points(data: ReportData, facts: Facts, most: int = 48) -> pd.DataFrame:
    """Every observation of each distinct computation with its rank, best first.

    Parameters
    ----------
    data, facts, most : ReportData, Facts, int
        The report; the response; computations at most.

    Returns
    -------
    DataFrame
        ``label`` names and ``copies`` counts the cells of a computation; levels are of the first.
    """
    import pandas as pd

    ranked = groups(data, facts)
    if facts.response.better == "higher":
        ranked = ranked[::-1]
    factors = list(data.factors)
    known = comparable(data, facts.name)
    levels = known[factors].astype(str).agg(tuple, axis=1)
    columns = [*factors, *(["block"] if "block" in known else [])]
    parts = []
    for rank, group in enumerate(ranked[:most]):
        first = group.members[0]
        rows = known[levels == tuple(first[name] for name in factors)]
        parts.append(
            rows[columns].assign(
                label=describe(group, data),
                copies=len(group),
                value=rows[facts.name],
                cell_mean=group.mean,
                rank=rank,
            )
        )
    return pd.concat(parts, ignore_index=True)


def draw_cells(frame: pd.DataFrame, facts: Facts, practical: float) -> Canvas:
    """Draw computations as rows: individual points, mean on top, thin lines pairing the blocks.

    Parameters
    ----------
    frame, facts, practical : DataFrame, Facts, float
        Of :func:`cell_points`; the response, and what matters in it, 0 where that is not given.
    """
    count = int(frame["rank"].max()) + 1
    figure = canvas(WIDTH_IN, 0.8 + 0.24 * count)
    ax = figure.subplots()
    best = float(frame["cell_mean"].iloc[0])
    if facts.response.better and practical > 0:
        sign = -1 if facts.response.better == "higher" else 1
        ax.axvspan(best, best + sign * practical, color=BAND, zorder=0)
        ax.text(
            best + sign * practical / 2,
            1.0,
            "as good as the best",
            transform=ax.get_xaxis_transform(),
            ha="center",
            va="bottom",
            fontsize=7.5,
            color=MUTED,
        )
    means = frame.drop_duplicates("rank")
    _mark_cells(ax, frame, means)
    for mean, place in zip(means["cell_mean"], means["rank"], strict=True):
        at_right(ax, significant(float(mean)), float(place))
    name_rows(ax, means["rank"], [wrap(label, 56, 130) for label in means["label"]])
    ax.set_ylim(count - 0.4, -0.8)
    plain_ticks(ax, "x")
    ax.set(xlabel=axis_label(facts), ylabel="")
    ax.grid(axis="y", color=RULE, linewidth=0.4)
    clean_left(ax)
    return figure


def _mark_cells(ax: Axes, frame: pd.DataFrame, means: pd.DataFrame) -> None:
    """Draw a row of points a computation, its mean on top and the lines of the blocks behind."""
    import seaborn as sns

    if "block" in frame and frame["block"].nunique() <= 40:
        sns.lineplot(
            frame,
            x="value",
            y="rank",
            units="block",
            estimator=None,
            sort=False,
            color=MUTED,
            alpha=0.28,
            linewidth=0.5,
            ax=ax,
        )
    sns.stripplot(
        frame,
        x="value",
        y="rank",
        orient="y",
        native_scale=True,
        jitter=False,
        color="#56B4E9",
        size=3,
        clip_on=False,
        alpha=0.8,
        zorder=2.5,
        ax=ax,
    )
    sns.scatterplot(
        means,
        x="cell_mean",
        y="rank",
        marker="D",
        color=INK,
        s=26,
        linewidth=0,
        zorder=3,
        legend=False,
        ax=ax,
    )
