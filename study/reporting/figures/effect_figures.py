"""Figures of the effects on a response: level means, interactions, cells, what matters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations, repeat

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from study.reporting.content.effect_words import (
    apart,
    setting,
    shown_difference,
    size,
    size_interval,
    sole_setting,
)
from study.reporting.content.report_facts import Facts, cells, comparable, practical_of
from study.reporting.content.text import (
    clean,
    level,
    listing,
    name_of,
    p_phrase,
    quantity,
    sentence,
    share,
    significant,
    term_name,
)
from study.reporting.figures import axes as style
from study.reporting.results.study_result import ReportData
from study.statistics.analysis.anova_table import Effect, SimpleEffect
from study.statistics.analysis.simple_effects import MATTERS, NO_DIFFERENCE

# Means of levels of every factor, beside the grand mean.


def level_means(facts: Facts, _data: ReportData) -> pd.DataFrame:
    """Mean of every level of every factor, with its interval where there is one."""
    rows = [
        (effect.term, level, mean, *ends)
        for effect in facts.effects
        for level, mean, ends in zip(
            effect.levels, effect.mean, effect.mean_ci95 or repeat((None, None)), strict=False
        )
    ]
    frame = pd.DataFrame(rows, columns=["factor", "level", "mean", "low", "high"])
    return frame.astype({"mean": float, "low": float, "high": float})


def draw_level_means(facts: Facts, data: ReportData, frame: pd.DataFrame) -> Canvas:
    """Draw the main effects, a panel a factor, grand mean and practical band behind."""
    over_cells = cells(data, facts.name)["mean"].to_numpy(float)
    center = float(np.exp(np.log(over_cells).mean()) if facts.ratio else over_cells.mean())
    practical = next((e.practical for e in facts.effects if e.practical is not None), None)
    factors = list(frame.groupby("factor", sort=False))
    figure = style.canvas(3.5)
    levels = [len(group) for _, group in factors]
    axes = figure.subplots(1, len(factors), squeeze=False, sharey=True, width_ratios=levels)[0]
    for index, (ax, (factor, group)) in enumerate(zip(axes, factors, strict=True)):
        if practical is not None:
            low, high = center - practical / 2, center + practical / 2
            if facts.ratio:
                low, high = center / practical**0.5, center * practical**0.5
            ax.axhspan(low, high, color=style.BAND, zorder=0)
        ax.axhline(center, color=style.MUTED, linewidth=0.8, linestyle=(0, (4, 3)))
        means, color = group["mean"].tolist(), style.color_of(index)
        ax.plot(range(len(means)), means, marker="o", color=color, markersize=5.5)
        ax.vlines(range(len(means)), group["low"], group["high"], colors=color, linewidth=1.1)
        around = [*means[1:2], *means, *means[-2:-1]] if means[1:] else means * 3
        for at, mean in enumerate(means):
            # on the side of the point that no line meets
            is_above = 2 * mean >= around[at] + around[at + 2]
            look = {"ha": "left", "va": "bottom" if is_above else "top"}
            style.note(ax, significant(mean), (at, mean), (3, 4 if is_above else -4), **look)
        names = [style.wrap(level, 12, 40) for level in group["level"]]
        ax.set_xticks(range(len(names)), names, fontsize=7.5)
        ax.set_xlim(-0.5, len(names) - 0.5)
        ax.set_title(style.wrap(name_of(str(factor), data.labels), 9 * len(names), 30))
    style.at_right(axes[-1], f"grand mean {quantity(center, facts.unit)}", center, style.MUTED)
    axes[0].margins(y=0.15)
    axes[0].set_ylabel(style.labeled(facts.title, facts.unit))
    return figure


def means_caption(facts: Facts, data: ReportData, _frame: pd.DataFrame) -> str:
    """Say which share of the variation between cells each factor has."""
    shares = [
        (row.share, term_name(row.term, data.labels))
        for row in facts.rows
        if row.term in data.factors and row.share is not None and row.df
    ]
    text = listing([f"{name} {share(part)}" for part, name in sorted(shares, reverse=True)])
    has_ends = any(effect.mean_ci95 for effect in facts.effects)
    ends = f" with {level(facts.alpha)} intervals" if has_ends else ""
    parts = [f"level means{ends} on one shared axis"]
    if shares:
        parts.append(f"share of the total variation: {text}")
    if facts.has_size:
        parts.append("two means inside the shaded band differ by less than what matters")
    return sentence("; ".join(parts))


# Cells: every combination of levels, its rows and its mean.

#: cells that are drawn, the best of many
_MOST_CELLS = 48


def cell_points(facts: Facts, data: ReportData) -> pd.DataFrame:
    """Every observation of the best cells with the rank of its cell, best first."""
    factors, rows = list(data.factors), comparable(data, facts.name)
    ranked = cells(data, facts.name)[:: -1 if facts.better == "higher" else 1].head(_MOST_CELLS)
    levels = ranked[factors].itertuples(index=False)
    names = [" \N{MIDDLE DOT} ".join(map(clean, cell)) for cell in levels]
    ranked = ranked[factors].assign(label=names, cell_mean=ranked["mean"], rank=range(len(ranked)))
    rows = rows[[*factors, *(["block"] if "block" in rows else [])]].assign(value=rows[facts.name])
    every = rows.astype(dict.fromkeys(factors, str)).merge(ranked, on=factors)
    return every.sort_values("rank", kind="stable", ignore_index=True)


def draw_cells(facts: Facts, data: ReportData, frame: pd.DataFrame) -> Canvas:
    """Draw cells as rows: individual points, mean on top, thin lines pairing the blocks."""
    number = int(frame["rank"].max()) + 1
    figure, ax = style.one_panel(0.8 + 0.24 * number)
    best = float(frame["cell_mean"].iloc[0])
    practical = practical_of(facts, cells(data, facts.name))
    if facts.better and practical > 0:
        sign = -1 if facts.better == "higher" else 1
        ax.axvspan(best, best + sign * practical, color=style.BAND, zorder=0)
        style.above(ax, "as good as the best", best + sign * practical / 2)
    means = frame.drop_duplicates("rank")
    if "block" in frame and 0 < frame["block"].nunique() <= 40:
        for _, of_block in frame.groupby("block", sort=False):
            x, y = of_block["value"], of_block["rank"]
            ax.plot(x, y, color=style.MUTED, alpha=0.28, linewidth=0.5)
    ax.scatter(
        frame["value"], frame["rank"], s=9, color="#56B4E9", alpha=0.8, linewidths=0,
        clip_on=False, zorder=2.5,
    )  # fmt: skip
    ax.scatter(
        means["cell_mean"], means["rank"], s=26, marker="D", color=style.INK, linewidths=0, zorder=3
    )
    for mean, rank in zip(means["cell_mean"], means["rank"], strict=True):
        style.at_right(ax, significant(float(mean)), float(rank))
    style.name_rows(ax, means["rank"], [style.wrap(label, 56, 130) for label in means["label"]])
    ax.set_ylim(number - 0.4, -0.8)
    ax.set(xlabel=style.labeled(facts.title, facts.unit), ylabel="")
    ax.grid(axis="y")
    style.clean_left(ax)
    return figure


def cells_caption(facts: Facts, data: ReportData, frame: pd.DataFrame) -> str:
    """Say what the points are, and how far the cells and the blocks differ."""

    def run(values: pd.Series) -> str:
        return f"run from {significant(values.min())} to {quantity(values.max(), facts.unit)}"

    unit, kind = clean(data.block) or "run", "geometric cell means" if facts.ratio else "cell means"
    text = f"{kind} (diamonds) {run(frame['cell_mean'])}; each dot is one {unit}"
    if "block" in frame and frame["block"].notna().any():
        of_blocks = run(frame.groupby("block")["value"].mean())
        text += f", joined across cells by a thin line; {unit} means {of_blocks}"
    return sentence(text)


# Interactions: a panel for every pair of factors.

#: levels that a panel names
_MOST_NAMED = 7


def pair_means(facts: Facts, data: ReportData) -> pd.DataFrame:
    """Mean of every combination of two levels, for every pair of factors."""
    frame, rows = cells(data, facts.name), []
    values = frame.assign(y=np.log(frame["mean"]) if facts.ratio else frame["mean"])
    for first, other in combinations(data.factors, 2):
        means = values.groupby([first, other], sort=False)["y"].mean()
        for (at, at_other), mean in zip(means.index.tolist(), means.tolist(), strict=True):
            y = float(np.exp(mean)) if facts.ratio else mean
            rows.append((first, at, other, at_other, y))
    return pd.DataFrame(rows, columns=["factor", "level", "other", "other_level", "mean"])


def draw_interactions(facts: Facts, data: ReportData, frame: pd.DataFrame) -> Canvas:
    """Draw a panel a pair of factors: a line for each level of one over the levels of the other."""
    pairs = list(frame.groupby(["factor", "other"], sort=False))
    figure, axes = style.panels(len(pairs), 3, 2.1, 0.3, sharey=True)
    for ax, (names, pair) in zip(axes, pairs, strict=True):
        first, second = map(str, names)
        levels, across = data.factors[first], data.factors[second]
        for k, name in enumerate(levels):
            means = pair[pair["level"] == name].set_index("other_level")["mean"]
            ax.plot(
                range(len(across)), means.reindex(list(across)), color=style.color_of(k),
                marker=style.MARKERS[k % 8], linestyle=style.DASHES[k % len(style.DASHES)],
                markersize=4, markeredgewidth=1,
            )  # fmt: skip
        ax.set_xlim(-0.5, len(across) - 0.5)
        named = [f" {clean(level, 24)}" for level in levels[:_MOST_NAMED]]
        title = clean(name_of(first, data.labels), 22)
        ax.legend(
            ax.lines[: len(named)], named, loc="upper right", title=title, fontsize=7,
            title_fontsize=7,
        )  # fmt: skip
        narrow = max(int(26 / len(across)), 6)
        ax.set_xticks(range(len(across)), [style.wrap(level, narrow, 24) for level in across])
        ax.tick_params(axis="x", labelsize=7, length=0)
        ax.set(xlabel=clean(name_of(second, data.labels), 30), ylabel="")
        ax.grid(axis="y")
    # legends stand above the lines: a line of one takes a ninth of the height
    low, high = axes[0].get_ylim()
    levels_of = [len(data.factors[str(first)]) for first in frame["factor"]]
    axes[0].set_ylim(low, low + (high - low) / (1 - (min(max(levels_of), _MOST_NAMED) + 1) / 12))
    figure.supylabel(style.labeled(facts.title, facts.unit))
    return figure


def interactions_caption(facts: Facts, data: ReportData, _frame: pd.DataFrame) -> str:
    """Say which interaction is the largest."""
    estimated = [e for e in facts.interactions if e.term.count(":") == 1 and e.range is not None]
    key = "lines that are parallel mean that the factors act independently"
    if not estimated:
        return sentence(key)
    first = max(estimated, key=lambda e: abs((e.range or 0) - (1 if e.is_ratio else 0)))
    decided = next((row.p_deciding for row in facts.rows if row.term == first.term), None)
    p = "" if decided is None else f", {p_phrase(decided)}"
    return sentence(
        f"the largest two-factor interaction is {term_name(first.term, data.labels)}, "
        f"{size(first, facts)}{p}; {key}"
    )


# The figure of the first page: every effect of every response against what matters.

_VERDICT_COLOR = {MATTERS: "#D55E00", NO_DIFFERENCE: "#009E73"}
#: marker of each verdict, so that it is not told by its color alone; hollow where nothing is shown
_VERDICT_MARKER = {MATTERS: "o", NO_DIFFERENCE: "s"}
_WORD_COLOR = {MATTERS: style.WORDS[1], NO_DIFFERENCE: style.WORDS[2]}
#: inches of a line of words, of the interval below it, and characters of such a line
_LINE_IN = 0.135
_BAR_IN = 0.15
_CHARACTERS = 86
#: interactions of a response that are drawn
_MOST_INTERACTIONS = 3
#: multiples of what matters up to which an axis is drawn to one scale
_ONE_SCALE = 12.0


def shown_effect_sizes(facts: Facts, labels: Mapping[str, str]) -> Canvas:
    """Draw the largest difference of every term as a notebook shows it."""
    frame = against_limits([facts], labels)
    if frame.empty or frame["difference"].isna().all():
        raise ValueError("there is nothing to draw: no effect could be estimated")
    title = f"largest difference of every term: {facts.title}"
    return style.shown(lambda: draw_against_limits(frame, [facts]), "effects", title)


def against_limits(
    all_facts: Sequence[Facts], labels: Mapping[str, str], *, is_brief: bool = False
) -> pd.DataFrame:
    """Largest difference of every term over the smallest that matters, ratios on the log.

    A term whose verdict is that of one setting has a row for it below its average; a brief figure
    leaves the average out.
    """
    rows = []
    for facts in all_facts:
        strong = [e for e in facts.interactions if e.strength == MATTERS or e.practical is None]
        for effect in (*facts.effects, *strong[:_MOST_INTERACTIONS]):
            limited = effect.practical is not None
            ends = "" if effect.low is None else f"  [{size_interval(effect, facts)}]"
            words = "no estimate" if effect.range is None else f"{size(effect, facts)}{ends}"
            row = {
                "response": facts.name, "term": effect.term, "name": term_name(effect.term, labels),
                "verdict": effect.strength if limited else "",
                **_multiples((effect.range, effect.low, effect.high), effect.u_num, effect),
                "limited": limited, "shown": words,
            }  # fmt: skip
            rows.append(row)
            if (simple := _deciding_setting(effect)) is not None:
                interval = simple.ci_simultaneous or simple.ci or (None, None)
                at = _multiples((simple.difference, *interval), simple.u, effect)
                if at["difference"] < 0:  # which level is the higher one does not matter here
                    at |= {"difference": -at["difference"], "low": -at["high"], "high": -at["low"]}
                size_there = shown_difference(apart(simple.difference, effect), effect, facts)
                rows.append(row | at | {"name": setting(simple, labels), "shown": size_there})
                rows[-2]["verdict"] = ""  # the setting has it, the average has not
                if is_brief:
                    levels = [clean(level) for _, level in simple.at]
                    where = setting(simple, labels)
                    if all(any(map(str.isalpha, level)) for level in levels):
                        where = f"at {', '.join(levels)}"  # words need no names of their factors
                    rows[-1]["name"] = f"{row['name']}, {where}"
                    del rows[-2]
    return pd.DataFrame(rows)


def _deciding_setting(effect: Effect) -> SimpleEffect | None:
    """Return the setting that has the verdict where the average would have another."""
    if effect.practical is None or not effect.depends_on_settings:
        return None
    if effect.verdict in (MATTERS, NO_DIFFERENCE):
        return sole_setting(effect)
    return effect.deciding_simple


def _multiples(values: Sequence[float | None], u: float | None, effect: Effect) -> dict[str, float]:
    """Difference, both ends of its interval and its numerical bound, over what matters."""

    def scaled(value: float | None) -> float:
        if value is None or not math.isfinite(value) or (effect.is_ratio and value <= 0):
            return math.nan
        return math.log(value) if effect.is_ratio else value

    unit = (scaled(effect.practical) if effect.practical else 0.0) or 1.0
    multiples = (scaled(value) / unit for value in values)
    columns = zip(("difference", "low", "high"), multiples, strict=True)
    return {**dict(columns), "bound": (u or 0.0) * effect.u_unit / unit}


def draw_against_limits(frame: pd.DataFrame, all_facts: Sequence[Facts]) -> Canvas:
    """Draw a row a term, the responses below each other, on the band of what does not matter.

    Names and sizes stand above their intervals, so that the figure is read on half a page.
    """
    several, by_name = len(all_facts) > 1, {facts.name: facts for facts in all_facts}
    rows, lines, places, height = [], [], [], 0.0
    for k, (response, name, verdict, shown) in enumerate(
        frame[["response", "name", "verdict", "shown"]].itertuples(index=False)
    ):
        if several and (not k or response != frame["response"].iloc[k - 1]):
            height += 0.5 * _LINE_IN if k else 0.0
            lines.append((height, clean(by_name[response].title, 60), "", "bold"))
            height += 1.3 * _LINE_IN
        words = f"{verdict}:  {shown}" if verdict else shown
        named = style.wrap(name, max(_CHARACTERS - len(words), 24), 80)
        lines.append((height, named, words, "normal"))
        height += _LINE_IN * (named.count("\n") + 1)
        places.append(height + 0.25 * _BAR_IN)
        rows.append(verdict)
        height += _BAR_IN
    # placed in inches: a layout engine would measure every word twice
    figure = style.canvas(0.65 + height, style.HALF_IN, arranged=False)
    ax = figure.add_axes((0.01, 0.48 / (0.65 + height), 0.98, height / (0.65 + height)))
    limited = bool(frame["limited"].all())
    if limited:
        ax.axvspan(-1, 1, color="#e3e8ed", zorder=0)
        style.above(ax, "too small to matter", 0.0)
    colors = [_VERDICT_COLOR.get(verdict, style.MUTED) for verdict in rows]
    low, high, bound, size_of = (
        frame[name].to_numpy(float) for name in ("low", "high", "bound", "difference")
    )
    # without an interval there is still the mesh error about the difference itself
    low, high = np.where(np.isnan(low), size_of, low), np.where(np.isnan(high), size_of, high)
    ax.hlines(places, low - bound, high + bound, colors=colors, linewidth=0.8)
    ax.hlines(places, low, high, colors=colors, linewidth=2.6)
    at = np.asarray(places)  # the line of no difference leaves out the words
    ax.vlines(np.zeros(at.size), at - 0.05, at + 0.05, color=style.MUTED, lw=0.7, zorder=0.5)
    for y, verdict, color, x in zip(places, rows, colors, size_of.tolist(), strict=True):
        face = color if verdict in _VERDICT_MARKER else "white"
        ax.plot(
            [x], [y], _VERDICT_MARKER.get(verdict, "o"), color=color, markerfacecolor=face,
            markersize=5.5, markeredgewidth=1.2,
        )  # fmt: skip
    for y, name, words, weight in lines:
        verdict = words.partition(":  ")[0]
        edge = {"xycoords": ax.get_yaxis_transform(), "annotation_clip": False, "va": "top"}
        style.note(ax, name, (0, y), (0, 0), fontweight=weight, **edge)
        color = _WORD_COLOR.get(verdict, style.INK)
        style.note(ax, words, (1, y), (0, 0), ha="right", color=color, **edge)
    ax.set_ylim(height, -0.05)
    ax.set_yticks([])
    _scale_of_multiples(ax, frame, limited, all_facts)
    style.clean_left(ax)
    return figure


def _scale_of_multiples(
    ax: Axes, frame: pd.DataFrame, limited: bool, all_facts: Sequence[Facts]
) -> None:
    """Scale an axis of multiples; where they reach far, to one scale only up to what matters."""
    facts = all_facts[0]
    if not limited:
        unit = f" ({facts.difference_unit})" if facts.difference_unit else ""
        what = "log of the largest ratio" if facts.ratio else f"largest difference{unit}"
        ax.set_xlabel(f"{what} between levels, with {level(facts.alpha)} interval")
        return
    edges = [frame[name].fillna(frame["difference"]) for name in ("low", "high")]
    low = float(np.nanmin([*(edges[0] - frame["bound"]), *frame["difference"], -1.25]))
    high = float(np.nanmax([*(edges[1] + frame["bound"]), *frame["difference"], 1.6]))
    if max(-low, high) > _ONE_SCALE:
        ax.set_xscale("symlog", linthresh=1.0, linscale=0.4)
        every = [0, *(sign * n * 10**k for sign in (-1, 1) for k in range(6) for n in (1, 2, 5))]
        ticks = [tick for tick in every if low * 1.05 <= tick <= high * 1.05]
        ticks = ticks if len(ticks) < 13 else [t for t in ticks if str(abs(t))[0] in "01"]
        ax.set_xticks(ticks, [f"{tick:g}".replace("-", "\N{MINUS SIGN}") for tick in ticks])
        ax.minorticks_off()
    ax.set_xlim(low * 1.05, high * 1.06)
    ends = f", with {level(facts.alpha)} interval" if frame["low"].notna().any() else ""
    ax.set_xlabel(f"largest difference as a multiple of what matters{ends}")


PLOTS: dict[str, style.Plot] = {
    "means": ("Main effects", level_means, draw_level_means, means_caption),
    "interactions": ("Interactions", pair_means, draw_interactions, interactions_caption),
    "cells": ("Cells", cell_points, draw_cells, cells_caption),
}
