"""Figures of assumptions: four views of the residuals, and the spread of the cells."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from study.reporting.figure.axes import clean_left, name_rows, plain_ticks, wrap
from study.reporting.figure.style import (
    BAND,
    MUTED,
    RULE,
    WIDTH_IN,
    canvas,
    color_of,
    word_color_of,
)
from study.reporting.numbers import p_value
from study.reporting.report import Facts
from study.reporting.text import clean, name_of
from study.study_result.report_data import ReportData

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

_SIMULATIONS = 1000


def residual_points(facts: Facts) -> pd.DataFrame:
    """Residuals of one representative of each computation, with their normal scores.

    Parameters
    ----------
    facts : Facts
        Response with its residuals.

    Raises
    ------
    ValueError
        If it has none.
    """
    if facts.residuals is None or facts.residuals.empty:
        raise ValueError("there are no residuals")
    frame = facts.residuals
    if "representative" in frame:
        frame = frame[frame["representative"].astype(bool)]
    frame = frame.sort_values("residual", kind="stable").reset_index(drop=True)
    return frame.assign(score=_scores(len(frame)))


def _scores(n: int) -> np.ndarray:
    from scipy.special import ndtri

    return np.asarray(ndtri((np.arange(1, n + 1) - 0.375) / (n + 0.25)))


def envelope(n: int, spread: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Pointwise 95 % envelope of ``n`` sorted independent normal values.

    Parameters
    ----------
    n, spread, seed : int, float, int
        Number of values; their standard deviation, in their unit; seed of 1000 simulations.

    Returns
    -------
    low, high : ndarray, shape (n,)
    """
    draws = np.random.default_rng(seed).standard_normal((_SIMULATIONS, n))
    draws.sort(axis=1)
    draws = (draws - draws.mean(1, keepdims=True)) / draws.std(1, ddof=1, keepdims=True)
    low, high = np.quantile(draws, [0.025, 0.975], axis=0)
    return low * spread, high * spread


def draw_residuals(frame: pd.DataFrame, facts: Facts, data: ReportData) -> Canvas:
    """Draw the four-in-one: normal plot, against fitted, histogram, against the factors.

    Parameters
    ----------
    frame, facts, data : DataFrame, Facts, ReportData
        Of :func:`residual_points`, the response, and better names of factors.
    """
    import seaborn as sns

    figure = canvas(WIDTH_IN, 5.6)
    (normal, fitted), (histogram, factors) = figure.subplots(2, 2)
    unit = "log ratio" if facts.ratio else facts.difference_unit
    label = f"residual ({unit})" if unit else "residual"
    _normal_plot(normal, frame, facts, data.seed, label)
    fitted.axhline(0, color=MUTED, linewidth=0.7)
    sns.scatterplot(
        frame,
        x="fitted",
        y="residual",
        s=10,
        alpha=0.7,
        color=color_of(0),
        linewidth=0,
        zorder=2,
        # clipped, each point of a scatter becomes a group of its own: 27 % more SVG
        clip_on=False,
        ax=fitted,
    )
    where = f"log of {facts.unit}" if facts.ratio else facts.unit
    fitted.set(title="against fitted", xlabel=f"fitted ({where})", ylabel=label)
    sns.histplot(
        frame,
        x="residual",
        bins="fd" if len(frame) > 12 else 6,
        color=color_of(5),
        alpha=1,
        edgecolor="white",
        linewidth=0.6,
        ax=histogram,
    )
    histogram.set(title="histogram", xlabel=label, ylabel="count")
    _against_factors(factors, frame, data, label)
    for ax in (normal, fitted, histogram):
        plain_ticks(ax, "x")
    for ax in (normal, fitted, histogram, factors):
        plain_ticks(ax, "y")
    return figure


def _normal_plot(ax: Axes, frame: pd.DataFrame, facts: Facts, seed: int, label: str) -> None:
    values = frame["residual"].to_numpy(float)
    spread = float(values.std(ddof=1))
    low, high = envelope(values.size, spread, seed)
    ax.fill_between(frame["score"], low, high, color=BAND, linewidth=0)
    ends = np.array([frame["score"].min(), frame["score"].max()])
    ax.plot(ends, ends * spread, color=MUTED, linewidth=0.8)
    ax.plot(
        frame["score"], values, "o", markersize=3.2, alpha=0.8, color=color_of(0), markeredgewidth=0
    )
    found = facts.assumptions.normality
    if found is not None and found.rj is not None:
        text = f"RJ = {found.rj:.4f}"
        if found.p_exact is not None:
            text += f", simulated p {_with_sign(p_value(found.p_exact))}"
        ax.text(0.03, 0.96, text, transform=ax.transAxes, va="top", fontsize=8)
    ax.set(title="normal plot, with 95 % envelope", xlabel="normal score", ylabel=label)


def _with_sign(p: str) -> str:
    return p if p[0] in "<>" else f"= {p}"


def _against_factors(ax: Axes, frame: pd.DataFrame, data: ReportData, label: str) -> None:
    """Draw the residuals of every level of every factor, side by side."""
    import seaborn as sns

    ax.axhline(0, color=MUTED, linewidth=0.7)
    levels = _level_places(frame, data)
    if levels.empty:
        return
    sns.scatterplot(
        _jittered(frame, levels, data.seed),
        x="place",
        y="residual",
        hue="number",
        palette={number: color_of(number) for number in levels["number"]},
        s=7,
        alpha=0.7,
        linewidth=0,
        zorder=2,
        clip_on=False,
        legend=False,
        ax=ax,
    )
    for number, factor in levels.groupby("number"):
        ax.text(
            float(factor["place"].mean()),
            1.0,
            wrap(name_of(factor["factor"].iloc[0], data.labels), 16, 24),
            transform=ax.get_xaxis_transform(),
            ha="center",
            va="bottom",
            fontsize=7.5,
            color=word_color_of(int(str(number))),
            fontweight="bold",
        )
    names = [clean(level, 20) for level in levels["level"]]
    ax.set_xticks(
        levels["place"], names, rotation=40, ha="right", rotation_mode="anchor", fontsize=7
    )
    ax.set(xlabel="", ylabel=label)


def _level_places(frame: pd.DataFrame, data: ReportData) -> pd.DataFrame:
    """Place of every level on the shared axis; 0.7 of a step more parts the factors."""
    import pandas as pd

    rows: list[tuple[int, str, str, float]] = []
    start = 0.0
    for number, (factor, levels) in enumerate(data.factors.items()):
        if factor in frame:
            rows += [(number, factor, level, start + i) for i, level in enumerate(levels)]
            start += len(levels) + 0.7
    return pd.DataFrame(rows, columns=["number", "factor", "level", "place"])


def _jittered(frame: pd.DataFrame, levels: pd.DataFrame, seed: int) -> pd.DataFrame:
    """Residuals spread about the place of their level; seaborn's jitter differs at every run."""
    import pandas as pd

    rng = np.random.default_rng(seed)
    parts = []
    for number, factor, level, place in levels.itertuples(index=False):
        values = frame.loc[frame[factor].astype(str) == level, "residual"]
        spread = place + rng.uniform(-0.18, 0.18, len(values))
        parts.append(pd.DataFrame({"place": spread, "residual": values, "number": number}))
    return pd.concat(parts, ignore_index=True)


def spread_of_cells(facts: Facts, alpha: float) -> pd.DataFrame:
    """Return the standard deviation of the residuals of each cell, with Bonferroni intervals.

    Intervals are those of the chi-squared distribution with n - 1 degrees of freedom:
    approximate where the residuals come from a fit with blocks.

    Parameters
    ----------
    facts, alpha : Facts, float
        Response with its residuals; error probability of all intervals together.

    Raises
    ------
    ValueError
        If no cell holds two residuals.
    """
    import pandas as pd
    from scipy.special import chdtri

    frame = residual_points(facts)
    grouped = frame.groupby("cell", sort=False)["residual"].agg(["std", "count"])
    grouped = grouped[grouped["count"] > 1].sort_values("std", ascending=False)
    if grouped.empty:
        raise ValueError("no cell holds two residuals")
    tail = alpha / (2 * len(grouped))
    df = grouped["count"].to_numpy(float) - 1
    sd = grouped["std"].to_numpy(float)
    return pd.DataFrame(
        {
            "cell": grouped.index.astype(str),
            "n": grouped["count"].to_numpy(),
            "sd": sd,
            # chdtri takes the upper tail
            "low": sd * np.sqrt(df / chdtri(df, tail)),
            "high": sd * np.sqrt(df / chdtri(df, 1 - tail)),
        }
    )


def draw_spread(frame: pd.DataFrame, facts: Facts) -> Canvas:
    """Draw one row a cell: its standard deviation and interval.

    Parameters
    ----------
    frame, facts : DataFrame, Facts
        Of :func:`spread_of_cells`, and the response.
    """
    import seaborn as sns

    figure = canvas(WIDTH_IN, 0.9 + 0.22 * len(frame))
    ax = figure.subplots()
    places = np.arange(len(frame))
    ax.hlines(places, frame["low"], frame["high"], color=color_of(0), linewidth=1.6)
    sns.scatterplot(x=frame["sd"], y=places, color=color_of(0), s=36, linewidth=0, zorder=3, ax=ax)
    name_rows(ax, places, [wrap(cell, 70, 70) for cell in frame["cell"]])
    ax.set_ylim(len(frame) - 0.4, -0.6)
    ax.set_xlim(left=0)
    ax.grid(axis="y", color=RULE, linewidth=0.4)
    clean_left(ax)
    unit = "log ratio" if facts.ratio else facts.difference_unit
    shown = f" ({unit})" if unit else ""
    ax.set_xlabel(f"standard deviation of residuals{shown}, 95 % Bonferroni intervals")
    plain_ticks(ax, "x")
    return figure
