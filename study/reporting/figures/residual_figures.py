"""Contrasts of an unreplicated two-level design: Pareto chart and half-normal plot."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.typing import HashableList
from scipy.special import chdtri, ndtri

from study.reporting.content.effect_words import normality_phrase
from study.reporting.content.report_facts import Facts
from study.reporting.content.text import (
    clean,
    count,
    listing,
    name_of,
    p_phrase,
    p_value,
    quantity,
    sentence,
    significant,
    term_name,
)
from study.reporting.figures import axes as style
from study.reporting.results.study_result import ReportData
from study.statistics.analysis.unreplicated import pseudo_standard_error

#: color of contrasts beyond the margin of error, and of the others
_CONTRAST_COLORS = {True: "#D55E00", False: "#0072B2"}

_MOST_BARS = 31

_HALF_NORMAL_SIMULATIONS = 2000


def contrasts(facts: Facts, data: ReportData) -> pd.DataFrame:
    """Every contrast with its half-normal score and limits, the largest first."""
    lenth = None if facts.result is None else facts.result.lenth
    if lenth is None:
        raise ValueError("there are no single contrasts: the design is replicated")
    frame = pd.DataFrame(
        {
            "contrast": list(lenth.names),
            "name": [_name(name, data) for name in lenth.names],
            "size": np.abs(np.asarray(lenth.values, dtype=float)),
            "score": np.asarray(lenth.half_normal, dtype=float),
            "p": np.asarray(lenth.p, dtype=float),
            "margin": lenth.me,
            "simultaneous": lenth.sme,
        }
    ).sort_values("size", ascending=False, kind="stable", ignore_index=True)
    low, high = _envelope(len(frame), lenth.pse, data.seed)
    return frame.assign(active=frame["size"] > frame["margin"], low=low, high=high)


def _name(contrast: str, data: ReportData) -> str:
    """Readable name of a contrast; ``material[2]`` is the second one of the material."""
    term = re.sub(r"\[\d+\]", "", contrast)
    numbers = re.findall(r"\[(\d+)\]", contrast)
    return term_name(term, data.labels) + (f" [{', '.join(numbers)}]" if numbers else "")


def _envelope(m: int, pse: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Pointwise 95 % envelope of ``m`` sorted null contrasts, the largest first."""
    z = np.abs(np.random.default_rng(seed).standard_normal((_HALF_NORMAL_SIMULATIONS, m)))
    z *= pse / pseudo_standard_error(z)[:, None]
    low, high = np.quantile(np.sort(z, axis=1)[:, ::-1], [0.025, 0.975], axis=0)
    return low, high


def draw_contrasts(facts: Facts, _data: ReportData, frame: pd.DataFrame) -> Canvas:
    """Draw the Pareto plot on the left, the half-normal plot on the right."""
    import seaborn as sns

    shown = frame.head(_MOST_BARS)
    figure = style.canvas(max(3.4, 1.0 + 0.2 * len(shown)))
    pareto, half = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
    label = style.labeled("absolute contrast", facts.scale)
    places = np.arange(len(shown))
    sns.barplot(
        x=shown["size"], y=places, hue=shown["active"], palette=_CONTRAST_COLORS, orient="y",
        native_scale=True, dodge=False, saturation=1, width=0.66, errorbar=None, legend=False,
        ax=pareto,
    )  # fmt: skip
    limits = ("margin", "--", "one ", "right"), ("simultaneous", ":", " all", "left")
    for column, dashes, name, side in limits:
        limit = float(shown[column].iloc[0])
        pareto.axvline(limit, color=style.INK, linewidth=0.8, linestyle=dashes)
        style.above(pareto, name, limit, ha=side)
    style.name_rows(pareto, places, [style.wrap(name, 30) for name in shown["name"]])
    pareto.set_ylim(len(shown) - 0.4, -0.6)
    style.clean_left(pareto)
    pareto.set_xlabel(f"{label}; limits for one, for all")
    ordered = frame.sort_values("score")
    half.fill_between(
        ordered["score"],
        np.sort(frame["low"]),
        np.sort(frame["high"]),
        color=style.BAND,
        linewidth=0,
    )
    sns.scatterplot(
        frame, x="score", y="size", hue="active", style="active", palette=_CONTRAST_COLORS,
        markers={True: "D", False: "o"}, s=30, linewidth=0, legend=False, ax=half,
    )  # fmt: skip
    for name, score, size in zip(*(frame[c] for c in ("name", "score", "size")), strict=True):
        if size > float(frame["margin"].iloc[0]):
            style.note(half, name, (score, size), (-6, 0), ha="right", va="center")
    half.set_ylim(bottom=0)
    half.set_xlim(left=0)
    half.set(xlabel="half-normal score, with the 95 % envelope of no effect", ylabel=label)
    return figure


def contrasts_caption(facts: Facts, _data: ReportData, frame: pd.DataFrame) -> str:
    """Say which contrasts stand out, and what the limits are."""
    beyond = frame[frame["active"]]
    m = count(len(frame), "contrast")
    if beyond.empty:
        finding = f"none of the {m} exceeds the margin of error"
    else:
        named = [
            f"{name} ({p_phrase(p)})" for name, p in zip(beyond["name"], beyond["p"], strict=True)
        ]
        shown = named if len(named) <= 5 else [*named[:5], f"{len(named) - 5} more"]
        finding = f"beyond the margin of error, of {m}: {listing(shown)}"
    margin, every = (quantity(frame[k].iloc[0], facts.scale) for k in ("margin", "simultaneous"))
    return sentence(
        f"{finding}. Dashed: limit of one contrast, {margin}; dotted: of all together, {every} "
        "(Lenth, simulated); contrasts that follow the shaded envelope look like no effect at all"
    )


# Figures of assumptions: four views of the residuals, and the spread of the cells.

_SIMULATIONS = 1000


def diagnostic_residual_points(facts: Facts, _data: ReportData) -> pd.DataFrame:
    """Residuals of one representative of each computation, with their normal scores."""
    if facts.result is None or facts.result.residuals.empty:
        raise ValueError("there are no residuals")
    frame = facts.result.residuals
    if "representative" in frame:
        frame = frame[frame["representative"].astype(bool)]
    return residual_points(frame.sort_values("residual", kind="stable").reset_index(drop=True))


def envelope(n: int, spread: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Pointwise 95 % envelope of ``n`` sorted independent normal values.

    Shapes: returns (n,).
    """
    draws = np.random.default_rng(seed).standard_normal((_SIMULATIONS, n))
    draws.sort(axis=1)
    draws = (draws - draws.mean(1, keepdims=True)) / draws.std(1, ddof=1, keepdims=True)
    low, high = np.quantile(draws, [0.025, 0.975], axis=0)
    return low * spread, high * spread


def _against_factors(ax: Axes, frame: pd.DataFrame, data: ReportData, label: str) -> None:
    """Draw the residuals of every level of every factor, side by side."""
    ax.axhline(0, color=style.MUTED, linewidth=0.7)
    # seaborn's jitter differs at every run
    rng = np.random.default_rng(data.seed)
    names: dict[float, str] = {}
    start = 0.0
    for number, (factor, levels) in enumerate(data.factors.items()):
        if factor not in frame:
            continue
        for index, level in enumerate(levels, 1):
            values = frame.loc[frame[factor].astype(str) == level, "residual"]
            across = start + index + rng.uniform(-0.18, 0.18, len(values))
            ax.scatter(across, values, s=7, alpha=0.7, linewidth=0, color=style.color_of(number))
            names[start + index] = clean(level, 20)
        name = style.wrap(name_of(factor, data.labels), 16, 24)
        bold = {"color": style.word_color_of(number), "fontweight": "bold"}
        style.above(ax, name, start + (len(levels) + 1) / 2, **bold)
        start += len(levels) + 0.7  # parts the factors
    ax.set_xticks(
        list(names), [*names.values()], rotation=40, ha="right", rotation_mode="anchor", fontsize=7
    )
    ax.set(xlabel="", ylabel=label)


def spread_of_cells(facts: Facts, data: ReportData) -> pd.DataFrame:
    """Give each cell's deviation with a chi-squared interval, approximate after blocks."""
    frame = diagnostic_residual_points(facts, data)
    grouped = frame.groupby("cell", sort=False)["residual"].agg(["std", "count"])
    grouped = grouped[grouped["count"] > 1].sort_values("std", ascending=False)
    if grouped.empty:
        raise ValueError("no cell holds two residuals")
    tail = data.alpha / (2 * len(grouped))
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


#: number of cells drawn, of the largest spread
MOST_SPREAD = 60


def draw_spread(facts: Facts, _data: ReportData, frame: pd.DataFrame) -> Canvas:
    """Draw one row a cell: its standard deviation and interval."""
    import seaborn as sns

    frame = frame.head(MOST_SPREAD)
    figure, ax = style.one_panel(0.9 + 0.22 * len(frame))
    places = np.arange(len(frame))
    ax.hlines(places, frame["low"], frame["high"], color=style.color_of(0), linewidth=1.6)
    sns.scatterplot(
        x=frame["sd"], y=places, color=style.color_of(0), s=36, linewidth=0, zorder=3, ax=ax
    )
    style.name_rows(ax, places, [style.wrap(cell, 70, 70) for cell in frame["cell"]])
    ax.set_ylim(len(frame) - 0.4, -0.6)
    ax.set_xlim(left=0)
    ax.grid(axis="y")
    style.clean_left(ax)
    label = style.labeled("standard deviation of residuals", facts.scale)
    ax.set_xlabel(f"{label}, 95 % Bonferroni intervals")
    return figure


def spread_caption(_facts: Facts, _data: ReportData, frame: pd.DataFrame) -> str:
    """Say how far the largest and the smallest standard deviation are apart."""
    low, high = float(frame["sd"].min()), float(frame["sd"].max())
    apart = float(frame["low"].max()) > float(frame["high"].min())
    ratio = f"{significant(high / low)} times" if low > 0 else "far above"
    few = f"; the {MOST_SPREAD} largest of {len(frame)} are drawn" * (len(frame) > MOST_SPREAD)
    return sentence(
        f"the largest standard deviation is {ratio} the smallest, and the intervals "
        f"{'do not all overlap' if apart else 'all overlap'}{few}"
    )


# Residual plots of a table of measurements: four in one, against the factors, influence.
#
# At most :data:`MOST_POINTS` rows are drawn, the largest residuals among them: a drawing of 100,000
# marks would make a page of 20 MB and show no more.

#: Rows drawn at most; 100 of them are the largest residuals, the others a random sample.
MOST_POINTS = 2000
LARGEST_KEPT = 100
#: Rows beyond which single points are no longer joined in run order.
MOST_JOINED = 300
#: Rows that are named in the plot of influence.
NAMED = 5


def residual_points(rows: pd.DataFrame) -> pd.DataFrame:
    """Every row with the normal score of its residual (Blom 1958)."""
    n = len(rows)
    order = rows["residual"].rank(method="first").to_numpy(float)
    return rows.assign(score=ndtri((order - 0.375) / (n + 0.25)))


def thinned(points: pd.DataFrame, seed: int) -> pd.DataFrame:
    """At most ``MOST_POINTS`` rows in their order: the largest residuals and a random sample."""
    if len(points) <= MOST_POINTS:
        return points
    largest = points["residual"].abs().nlargest(LARGEST_KEPT).index
    others = points.drop(largest).sample(MOST_POINTS - LARGEST_KEPT, random_state=seed)
    return points.loc[largest.union(others.index)]


def drawn_words(points: pd.DataFrame) -> str:
    """Say how many of the rows are drawn, where not all are."""
    if len(points) <= MOST_POINTS:
        return ""
    return (
        f"; {MOST_POINTS:,} of {len(points):,} rows are drawn: the {LARGEST_KEPT} largest "
        "residuals and a random sample"
    )


def draw_residuals(
    facts: Facts, data: ReportData, points: pd.DataFrame, *, ordered: bool = False
) -> Canvas:
    """Draw views of the residuals; rows of a table have an order, runs have none."""
    rows: list[HashableList[str]]
    rows = [["normal", "fits"], ["histogram", "order"], ["factors", "factors"]]
    if not ordered:
        rows = [["normal", "fits"], ["histogram", "factors"]]
    figure = style.canvas(2.85 * len(rows))
    panels = figure.subplot_mosaic(rows)
    shown, label = thinned(points, data.seed), style.labeled("residual", facts.scale)
    ax = panels["normal"]
    spread = float(points["residual"].std(ddof=1))
    if len(points) <= MOST_POINTS:
        low, high = envelope(len(points), spread, data.seed)
        ax.fill_between(np.sort(points["score"]), low, high, color=style.BAND, linewidth=0)
    ends = np.array([points["score"].min(), points["score"].max()])
    ax.plot(ends, ends * spread, color=style.MUTED, linewidth=0.8)
    look: dict[str, Any] = {"color": style.color_of(0), "markersize": 3.2, "markeredgewidth": 0}
    ax.plot(shown["score"], shown["residual"], "o", alpha=0.8, **look)
    normality = facts.assumptions.normality
    if normality is not None and normality.rj is not None:
        p = p_value(normality.p_exact)
        tail = "" if normality.p_exact is None else f", p {p if p[0] in '<>' else f'= {p}'}"
        text = f"RJ = {normality.rj:.4f}{tail}"
        ax.text(0.03, 0.97, text, transform=ax.transAxes, va="top", fontsize=8)
    ax.set(title="normal probability plot", xlabel="normal score", ylabel=label)
    _against(panels["fits"], shown["fitted"], shown["residual"])
    where = f"log of {facts.unit}" if facts.ratio and facts.unit else facts.unit
    panels["fits"].set(title="versus fits", xlabel=style.labeled("fit", where), ylabel=label)
    bins = int(np.clip(np.ceil(1 + np.log2(len(points))), 4, 40))  # Sturges 1926
    look = {"color": style.color_of(5), "edgecolor": "white", "linewidth": 0.6}
    panels["histogram"].hist(points["residual"].to_numpy(float), bins=bins, **look)
    panels["histogram"].set(title="histogram", xlabel=label, ylabel="rows")
    _against_factors(panels["factors"], shown, data, label)
    if ordered:
        last = panels["order"]
        _against(last, shown["row"], shown["residual"])
        if len(shown) <= MOST_JOINED:
            last.lines[-1].set(linestyle="-", linewidth=0.7)
        last.set(title="versus order", xlabel="row of the file (without the header)", ylabel=label)
    return figure


def residuals_caption(facts: Facts, data: ReportData, frame: pd.DataFrame) -> str:
    """Summarize the four panels and the test."""
    return sentence(
        f"{count(len(frame), 'residual')} of block and cell, one cell for each distinct "
        f"computation; {normality_phrase(facts, data.alpha)}. Run order means nothing for "
        "deterministic runs, so residuals stand against the factors instead"
    )


def _against(ax: Axes, x: pd.Series, residual: pd.Series) -> None:
    ax.axhline(0, color=style.MUTED, linewidth=0.7)
    ax.plot(x, residual, "o", markersize=3.2, alpha=0.7, color=style.color_of(0), markeredgewidth=0)


def influence_caption(points: pd.DataFrame, limit: float | None) -> str:
    """Say how many rows move the fit."""
    moving = 0 if limit is None else int((points["cook"] > limit).sum())
    finding = f"{count(moving, 'row')} beyond it" if moving else "no row is beyond it"
    line = "" if limit is None else f"; beyond {limit:.2g} a row moves the fit, and {finding}"
    return sentence(
        "left, Cook's distance of every row; right, standardized residual against leverage, with "
        f"lines at \N{MINUS SIGN}2 and 2{line}{drawn_words(points)}"
    )


def draw_influence(points: pd.DataFrame, data: ReportData, limit: float | None) -> Canvas:
    """Draw Cook's distance by row, and standardized residual against leverage."""
    figure = style.canvas(3.2)
    cook, leverage = figure.subplots(1, 2)
    # a row that is fitted exactly has leverage one, and no Cook's distance
    drawn = thinned(points, data.seed)
    shown = drawn[np.isfinite(drawn["cook"].to_numpy(float))]
    cook.vlines(shown["row"], 0, shown["cook"], color=style.color_of(0), linewidth=1.0)
    largest = float(np.nanmax(shown["cook"].to_numpy(float), initial=0.0))
    if limit is not None and limit <= 3 * largest:
        cook.axhline(limit, color=style.INK, linewidth=0.8, linestyle="--")
    for row in shown.nlargest(NAMED, "cook").itertuples():
        at = float(str(row.row)), float(str(row.cook))
        style.note(cook, f"{row.row}", at, (0, 2), ha="center", va="bottom")
    cook.set_ylim(bottom=0, top=1.12 * largest if largest > 0 else 1.0)
    cook.set(title="Cook's distance", xlabel="row of the file", ylabel="")
    for height in (-2, 2):
        leverage.axhline(height, color=style.MUTED, linewidth=0.7, linestyle="--")
    _against(leverage, shown["leverage"], shown["standardized"])
    leverage.set(
        title="residual against leverage", xlabel="leverage", ylabel="standardized residual"
    )
    return figure


PLOTS: dict[str, style.Plot] = {
    "residuals": ("Residuals", diagnostic_residual_points, draw_residuals, residuals_caption),
    "spread": ("Spread of the cells", spread_of_cells, draw_spread, spread_caption),
    "contrasts": ("Contrasts without replicates", contrasts, draw_contrasts, contrasts_caption),
}
