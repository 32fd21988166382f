"""Means of levels of every factor, beside the grand mean."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from study.reporting.figure.axes import at_right, plain_ticks, wrap
from study.reporting.figure.style import BAND, MUTED, WIDTH_IN, canvas, color_of, word_color_of
from study.reporting.numbers import quantity, significant
from study.reporting.report import Facts, cells
from study.reporting.text import clean, name_of
from study.study_result.report_data import ReportData

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas


def level_means(facts: Facts) -> pd.DataFrame:
    """Mean of every level of every factor.

    Parameters
    ----------
    facts : Facts
        Response whose factors are shown.
    """
    import pandas as pd

    return pd.DataFrame(
        [
            {"factor": effect.term, "level": level, "mean": mean}
            for effect in facts.effects
            for level, mean in zip(effect.levels, effect.mean, strict=False)
        ],
        columns=["factor", "level", "mean"],
    ).astype({"mean": float})


def grand_mean(data: ReportData, facts: Facts) -> float:
    """Mean over the cells, geometric for a log response.

    Parameters
    ----------
    data, facts : ReportData, Facts
        Study and response.
    """
    means = cells(data, facts.name)["mean"].to_numpy(float)
    return float(np.exp(np.log(means).mean()) if facts.ratio else means.mean())


def draw_level_means(
    frame: pd.DataFrame, facts: Facts, center: float, practical: float | None, data: ReportData
) -> Canvas:
    """Draw the main effects on one shared axis, grand mean and practical band behind.

    Parameters
    ----------
    frame, facts : DataFrame, Facts
        Of :func:`level_means`, and the response.
    center : float
        Grand mean, in the unit of the response.
    practical : float or None
        Difference or ratio that matters; the band is half of it to both sides.
    data : ReportData
        Better names of factors.
    """
    figure = canvas(WIDTH_IN, 3.5)
    ax = figure.subplots()
    if practical is not None:
        low, high = center - practical / 2, center + practical / 2
        if facts.ratio:
            low, high = center / practical**0.5, center * practical**0.5
        ax.axhspan(low, high, color=BAND, zorder=0)
    ax.axhline(center, color=MUTED, linewidth=0.8, linestyle=(0, (4, 3)))
    at_right(ax, f"grand mean {quantity(center, facts.unit)}", center, color=MUTED)
    placed = _connect_levels(ax, frame)
    for index, (factor, group) in enumerate(placed.groupby("factor", sort=False)):
        _number_points(ax, group["place"].tolist(), group["mean"].tolist())
        ax.text(
            float(group["place"].mean()),
            1.02,
            clean(name_of(str(factor), data.labels), 30),
            transform=ax.get_xaxis_transform(),
            ha="center",
            fontweight="bold",
            color=word_color_of(index),
        )
    names = [wrap(level, 12, 40) for level in frame["level"]]
    many = len(names) > 13
    ax.set_xticks(
        placed["place"],
        names,
        rotation=45 if many else 0,
        ha="right" if many else "center",
        fontsize=7.5 if len(names) < 9 else 7,
    )
    ax.set_xlim(-0.7, float(placed["place"].iloc[-1]) + 0.7)
    ax.margins(y=0.2)
    plain_ticks(ax, "y")
    ax.set(xlabel="", ylabel=axis_label(facts))
    ax.tick_params(axis="x", length=0)
    return figure


def _connect_levels(ax: Axes, frame: pd.DataFrame) -> pd.DataFrame:
    """Draw a line a factor through its level means; return them with their places."""
    import seaborn as sns

    factors = frame.groupby("factor", sort=False)
    # levels are 1 apart, and half a step more parts the factors
    placed = frame.assign(place=np.arange(len(frame)) + 0.5 * factors.ngroup())
    sns.pointplot(
        placed,
        x="place",
        y="mean",
        hue="factor",
        palette=[color_of(index) for index in range(factors.ngroups)],
        native_scale=True,
        errorbar=None,
        legend=False,
        linewidth=1.4,
        markersize=5.5,
        markeredgewidth=1,
        ax=ax,
    )
    return placed


def _number_points(ax: Axes, places: Sequence[float], means: Sequence[float]) -> None:
    """Write its number at the mean of every level of one factor."""
    for place, mean, side in zip(places, means, _sides(means), strict=True):
        ax.annotate(
            significant(mean),
            (place, mean),
            xytext=(0, 6 * side),
            textcoords="offset points",
            ha="center",
            fontsize=7.5,
            va="bottom" if side > 0 else "top",
        )


def _sides(means: Sequence[float]) -> list[int]:
    """Side of each point on which its number meets no line: 1 above, -1 below."""
    values = np.asarray(means, dtype=float)
    left = np.r_[values[1:2], values[:-1]]
    right = np.r_[values[1:], values[-2:-1]]
    return [1 if v >= (a + b) / 2 else -1 for v, a, b in zip(values, left, right, strict=True)]


def axis_label(facts: Facts) -> str:
    """Name and unit of a response for an axis.

    Parameters
    ----------
    facts : Facts
        The response; the name stands alone where it has no unit.
    """
    return f"{facts.title} ({facts.unit})" if facts.unit else facts.title
