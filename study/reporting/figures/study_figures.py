"""Fitted constants with their intervals, one panel a constant."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from study.reporting.content.report_facts import Facts
from study.reporting.content.tables import fit_name, fit_rank
from study.reporting.content.text import clean, duration, listing, name_of, quantity, term_name
from study.reporting.figures import axes as style
from study.reporting.results.study_result import ReportData
from study.statistics.analysis.anova_table import DepthEffect

_MOST_ROWS = 40
_MOST_PANELS = 4


def constant_points(data: ReportData) -> pd.DataFrame:
    """Every fitted constant with its interval, in the order of the design."""
    fits = [fit for fit in data.fits if fit.value is not None]
    if not fits:
        raise ValueError("no constant was fitted")
    every = dict.fromkeys(tuple(fit.levels.items()) for fit in fits)
    ranked = sorted(every, key=lambda levels: fit_rank(dict(levels), data))
    rank_of = {levels: i for i, levels in enumerate(ranked)}
    columns = (
        "constant", "block", "specimen", "value", "low", "high", "standard_error", "unit",
        "identifiable",
    )  # fmt: skip
    frame = pd.DataFrame(
        {"row": fit_name(fit, data), "place": rank_of[tuple(fit.levels.items())]}
        | {name: getattr(fit, name) for name in columns}
        for fit in fits
    )
    numbers = dict.fromkeys(("value", "low", "high", "standard_error"), float)
    frame = frame.astype(numbers)
    return frame[frame["place"] < _MOST_ROWS].sort_values(["constant", "place"], kind="stable")


def draw_constants(frame: pd.DataFrame) -> Canvas:
    """Draw rows of fits; a hollow mark is a constant that the data do not determine."""
    # the constant of most fits first: it is the one that all models share
    names = frame["constant"].value_counts().index.tolist()[:_MOST_PANELS]
    rows = frame.drop_duplicates("place").sort_values("place")
    figure = style.canvas(1.0 + 0.3 * len(rows))
    axes = figure.subplots(1, len(names), squeeze=False, sharey=True)[0]
    for index, (ax, name) in enumerate(zip(axes, names, strict=True)):
        some = frame[frame["constant"] == name]
        _panel(ax, some, style.color_of(index))
        ax.set_xlabel(style.labeled(clean(name, 16), str(some["unit"].iloc[0])))
    style.name_rows(axes[0], rows["place"], [style.wrap(row, 46, 90) for row in rows["row"]])
    axes[0].set_ylim(len(rows) - 0.4, -0.6)
    return figure


def _panel(ax: Axes, frame: pd.DataFrame, color: str) -> None:
    for row, group in frame.groupby("place"):
        # fits of one row stand below each other, so that their intervals can be read
        y = float(str(row)) + np.linspace(-0.3, 0.3, len(group) + 2)[1:-1]
        ax.hlines(y, group["low"], group["high"], color=color, linewidth=0.8)
        sure = group["identifiable"].to_numpy(bool)
        ax.plot(group["value"][sure], y[sure], "o", color=color, markersize=2.8)
        ax.plot(
            group["value"][~sure], y[~sure], "o", color=color, markersize=2.8,
            markerfacecolor="white", markeredgewidth=0.8,
        )  # fmt: skip
    ax.grid(axis="y")
    style.clean_left(ax)
    ax.locator_params(axis="x", nbins=4)


# Figures of cost and of failure: the front of cells worth their seconds, the failure map.

#: levels below each other in a legend beside the axes
_LEGEND_ROWS = 20
#: Seconds that may stand at an axis.
_TIMES = (1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 60.0, 600.0, 3600.0, 36000.0)


def draw_front(frame: pd.DataFrame, facts: Facts, data: ReportData, practical: float) -> Canvas:
    """Draw the mean response of each cell against its seconds, front stepped and labeled."""
    import seaborn as sns

    figure, ax = style.one_panel(3.7)
    shown = frame.astype(dict.fromkeys(data.factors, str))
    shown = shown.rename(columns={name: name_of(name, data.labels) for name in data.factors})
    first, second = _styling(frame, data)
    look = {"hue": name_of(first, data.labels), "hue_order": data.factors[first],
            "palette": [style.color_of(k) for k in range(len(data.factors[first]))],
            "style": name_of(second, data.labels), "style_order": data.factors[second],
            "markers": [style.MARKERS[k % 8] for k, _ in enumerate(data.factors[second])],
            }  # fmt: skip
    sns.scatterplot(shown, x="seconds", y="mean", s=44, alpha=0.85, ax=ax, **look)
    levels = len(data.factors[first]) + len(data.factors[second])
    columns = -(-levels // _LEGEND_ROWS)
    sns.move_legend(ax, "upper left", bbox_to_anchor=(1.0, 1.0), ncols=columns, fontsize=7.5)
    ax.set_xscale("log")
    front = frame[frame["front"]]
    ax.step(front["seconds"], front["mean"], where="post", color=style.MUTED, linewidth=0.9)
    sign = -1.0 if facts.better == "higher" else 1.0
    best = float(sign * (sign * frame["mean"]).min())
    if practical > 0:
        ax.axhspan(best, best + sign * practical, color=style.BAND, zorder=0)
        ax.text(
            1.0, best + sign * practical, "as good as the best ", ha="right", va="bottom",
            transform=ax.get_yaxis_transform(), fontsize=7.5, color=style.MUTED,
        )  # fmt: skip
    ax.margins(x=0.06, y=0.16)
    _front_labels(ax, front, list(data.factors))
    low, high = ax.get_xlim()
    if len(ticks := [t for t in _TIMES if low <= t <= high]) < 2:
        style.log_ticks(ax, "x", duration)
    else:
        ax.set_xticks(ticks, [duration(t) for t in ticks])
    ax.set_xticks([], minor=True)
    ax.set(xlabel="mean computing time of a case", ylabel=style.labeled(facts.title, facts.unit))
    return figure


def _styling(frame: pd.DataFrame, data: ReportData) -> tuple[str, str]:
    """Return the two factors that change the cost most, for color and shape."""
    cost = np.log(frame["seconds"].clip(lower=1e-9))
    moved = {
        name: float(cost.groupby(frame[name]).mean().var() or 0.0)
        for name in data.factors
        if len(data.factors[name]) > 1
    }
    order = sorted(moved, key=lambda name: -moved[name]) or list(data.factors)[:1]
    return order[0], order[min(1, len(order) - 1)]


def _front_labels(ax: Axes, front: pd.DataFrame, factors: Sequence[str]) -> None:
    """Name the front's cells; one whose name would run into another's is left out."""
    low, high = np.log(ax.get_xlim())
    bottom, top = ax.get_ylim()
    taken: list[tuple[float, float]] = []
    for row in reversed(front.to_dict("records")):
        x = float((np.log(row["seconds"]) - low) / (high - low))
        y = float((row["mean"] - bottom) / (top - bottom))
        if any(abs(x - a) < 0.36 and abs(y - b) < 0.07 for a, b in taken):
            continue
        taken.append((x, y))
        text = " \N{MIDDLE DOT} ".join(clean(row[name], 22) for name in factors)
        shift, side = ((-7, -6), "right") if x > 0.6 else ((7, -6), "left")
        style.note(ax, text, (row["seconds"], row["mean"]), shift, va="top", ha=side)


def draw_failures(frame: pd.DataFrame) -> Canvas:
    """Draw cells against blocks, a large mark where a case failed."""
    import seaborn as sns

    statuses = sorted(set(frame["status"]) - {"converged"})
    rows, columns = (list(dict.fromkeys(frame[name])) for name in ("cell", "block"))
    figure, ax = style.one_panel(0.9 + 0.2 * len(rows))
    sns.scatterplot(
        x=frame["block"].map(columns.index), y=frame["cell"].map(rows.index),
        hue=frame["status"], style=frame["status"], size=frame["status"],
        palette={"converged": "#c4cad1"} | dict(zip(statuses, style.WORDS[1:] * 9, strict=False)),
        markers={"converged": "."} | dict(zip(statuses, style.MARKERS * 9, strict=False)),
        sizes={"converged": 16, **dict.fromkeys(statuses, 49)}, linewidth=0, ax=ax,
    )  # fmt: skip
    ax.set_xticks(range(len(columns)), [style.wrap(c, 10, 20) for c in columns], fontsize=7.5)
    style.name_rows(ax, range(len(rows)), [style.wrap(r, 80, 70) for r in rows])
    ax.set(xlabel="", ylabel="", ylim=(len(rows) - 0.5, -0.5), xlim=(-0.5, len(columns) - 0.5))
    ax.tick_params(length=0)
    sns.move_legend(ax, "lower left", bbox_to_anchor=(0.0, 1.0), ncols=6, title="")
    return figure


# Effect of each factor against the depth that the test is scored to.

#: sideways distance of the intervals of two factors, over the distance of two depths
_BESIDE = 0.05


def points(rows: Sequence[DepthEffect], response: str, data: ReportData) -> pd.DataFrame:
    """Rows of one response with the names of their factors."""
    ends = ("term", "low", "high", "practical", "verdict", "highest")
    frame = pd.DataFrame([
        {"response": response, "depth_mm": row.depth_mm, "difference": row.effect.range}
        | {name: getattr(row.effect, name) for name in ends}
        for row in rows if row.response == response
    ])  # fmt: skip
    names = [term_name(str(term), data.labels) for term in frame["term"]]
    numbers = {"difference": float, "low": float, "high": float, "practical": float}
    return frame.assign(name=names).astype(numbers)


def draw(frame: pd.DataFrame, facts: Facts) -> Canvas:
    """Draw the largest difference of every factor with its interval against depth."""
    figure, ax = style.one_panel(3.6)
    _band(ax, frame, facts)
    depths = sorted(frame["depth_mm"].unique())
    apart = _BESIDE * (depths[-1] - depths[0]) / max(len(depths) - 1, 1)
    terms = list(dict.fromkeys(frame["name"]))
    for k, name in enumerate(terms):
        part = frame[frame["name"] == name]
        x = part["depth_mm"] + apart * (k - (len(terms) - 1) / 2)
        marker, color = style.MARKERS[k % len(style.MARKERS)], style.color_of(k)
        ax.plot(x, part["difference"], marker=marker, color=color, label=name, markersize=5)
        ax.vlines(x, part["low"], part["high"], color=color, linewidth=1.2, alpha=0.7)
    ax.set_xticks(depths, [f"{depth:g}" for depth in depths])
    ax.set_xlabel("scored to a displacement of (mm)")
    what = "ratio" if facts.ratio else f"difference ({facts.difference_unit})"
    ax.set_ylabel(f"largest {what} between levels")
    ax.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return figure


def _band(ax: Axes, frame: pd.DataFrame, facts: Facts) -> None:
    """Shade what does not matter; a share of the mean grows with the depth."""
    zero = 1.0 if facts.ratio else 0.0
    ax.axhline(zero, color=style.MUTED, linewidth=0.7)
    limits = frame.dropna(subset=["practical"]).drop_duplicates("depth_mm")
    if limits.empty:
        return
    limits = limits.sort_values("depth_mm")
    below = 1 / limits["practical"] if facts.ratio else -limits["practical"]
    ax.fill_between(limits["depth_mm"], below, limits["practical"], color=style.BAND, zorder=0)
    end = limits["depth_mm"].iloc[-1], below.iloc[-1]
    style.note(ax, "no practical difference", end, (0, 3), ha="right", color=style.INK, alpha=0.7)


def caption(frame: pd.DataFrame, facts: Facts) -> str:
    """Say what changes between the shallowest and the deepest look."""
    depths = sorted(frame["depth_mm"].unique())
    shallow, deep = (
        frame[frame["depth_mm"] == d].set_index("name") for d in (depths[0], depths[-1])
    )
    changed = [
        f"{name} ({shallow.loc[name, 'verdict']} at {depths[0]:g} mm, "
        f"{deep.loc[name, 'verdict']} at {depths[-1]:g} mm)"
        for name in deep.index
        if name in shallow.index and shallow.loc[name, "verdict"] != deep.loc[name, "verdict"]
    ]
    verdicts = (
        f"The verdict depends on it for {listing(changed)}."
        if changed
        else "No verdict depends on it."
    )
    strongest = deep["difference"].idxmax()
    sizes = [quantity(part.loc[strongest, "difference"], "") for part in (shallow, deep)]
    return (
        f"The same cases scored over the first part of the test only; constants are those of "
        f"the whole study. {verdicts} The strongest factor at full depth, {strongest}, goes from "
        f"{sizes[0]} to {sizes[1]}{' ' + facts.difference_unit if not facts.ratio else ''}."
    )
