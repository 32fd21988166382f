"""The figures of a report: each drawn with its data, its caption and its failure.

A figure that cannot be drawn never stops the report: the page says which one is missing. Those of
constants, cost, failures and depth are drawn here.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from matplotlib.figure import Figure as Canvas

from study.reporting.content.blocks import Figure
from study.reporting.content.report_facts import Facts, practical_of
from study.reporting.content.sentences import cost_front, failures
from study.reporting.content.tables import fit_name, fit_rank, in_order
from study.reporting.content.text import (
    THIN,
    clean,
    count,
    duration,
    listing,
    name_of,
    plural_of,
    quantity,
    sentence,
    share,
    slugs,
    term_name,
    trimmed,
)
from study.reporting.figures import axes as style
from study.reporting.figures import (
    convergence_figures,
    curve_figures,
    effect_figures,
    residual_figures,
)
from study.reporting.figures.axes import Plot, bound, figures_of, make
from study.reporting.results.study_result import ReportData
from study.statistics.analysis.simple_effects import CANNOT_TELL, MATTERS, NO_DIFFERENCE

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


def draw_constants(_data: ReportData, frame: pd.DataFrame) -> Canvas:
    """Draw rows of fits; a hollow mark is a constant that the data do not determine."""
    # the constant of most fits first: it is the one that all models share
    names = frame["constant"].value_counts().index.tolist()[:_MOST_PANELS]
    rows = frame.drop_duplicates("place").sort_values("place")
    figure = style.canvas(1.0 + 0.3 * len(rows))
    axes = figure.subplots(1, len(names), squeeze=False, sharey=True)[0]
    for index, (ax, name) in enumerate(zip(axes, names, strict=True)):
        some = frame[frame["constant"] == name]
        color = style.color_of(index)
        for row, group in some.groupby("place"):
            # fits of one row stand below each other, so that their intervals can be read
            y = float(str(row)) + np.linspace(-0.3, 0.3, len(group) + 2)[1:-1]
            ax.hlines(y, group["low"], group["high"], color=color, linewidth=0.8)
            sure, values = group["identifiable"].to_numpy(bool), group["value"]
            mark = {"marker": "o", "linestyle": "none", "color": color, "markersize": 2.8}
            ax.plot(values[sure], y[sure], **mark)
            hollow = {"markerfacecolor": "white", "markeredgewidth": 0.8}
            ax.plot(values[~sure], y[~sure], **mark | hollow)
        ax.grid(axis="y")
        style.clean_left(ax)
        ax.locator_params(axis="x", nbins=4)
        ax.set_xlabel(style.labeled(clean(name, 16), str(some["unit"].iloc[0])))
    style.name_rows(axes[0], rows["place"], [style.wrap(row, 46, 90) for row in rows["row"]])
    axes[0].set_ylim(len(rows) - 0.4, -0.6)
    return figure


def constants_caption(data: ReportData, frame: pd.DataFrame) -> str:
    """Compare the scatter between fits with the uncertainty of one fit."""
    sure = frame[frame["identifiable"]]
    vague = len(frame) - len(sure)
    text = f"each mark is one fit with its 95{THIN}% interval"
    grouped = sure.groupby(["constant", "place"])["value"]
    apart = (grouped.std() / grouped.mean().abs()).median()
    relative_error = (sure["standard_error"] / sure["value"].abs()).median()
    if pd.notna(apart) and pd.notna(relative_error):
        of_blocks, of_fit = (
            share(part).replace("< ", "less than ") for part in (apart, relative_error)
        )
        text = (
            f"a constant differs between {plural_of(clean(data.block) or 'run')} by {of_blocks} "
            f"(median standard deviation), one fit alone is uncertain by {of_fit}; {text}"
        )
    if vague:
        text += f"; hollow: {vague} of {len(frame)} that the data do not determine"
    return sentence(text)


# Figures of cost and of failure: the front of cells worth their seconds, the failure map.

#: levels below each other in a legend beside the axes
_LEGEND_ROWS = 20
#: Seconds that may stand at an axis.
_TIMES = (1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 60.0, 600.0, 3600.0, 36000.0)


def draw_front(facts: Facts, data: ReportData, frame: pd.DataFrame) -> Canvas:
    """Draw the mean response of each cell against its seconds, front stepped and labeled."""
    import seaborn as sns

    figure, ax = style.one_panel(3.7)
    practical = practical_of(facts, frame)
    shown = frame.astype(dict.fromkeys(data.factors, str))
    shown = shown.rename(columns={name: name_of(name, data.labels) for name in data.factors})
    # color and shape are of the two factors that change the cost most
    cost = np.log(frame["seconds"].clip(lower=1e-9))
    moved = {
        name: float(cost.groupby(frame[name]).mean().var() or 0.0)
        for name in data.factors
        if len(data.factors[name]) > 1
    }
    order = sorted(moved, key=lambda name: -moved[name]) or list(data.factors)[:1]
    first, second = order[0], order[min(1, len(order) - 1)]
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
    low, high = np.log(ax.get_xlim())
    bottom, top = ax.get_ylim()
    taken: list[tuple[float, float]] = []  # where a cell is named another's name would run into it
    for row in reversed(front.to_dict("records")):
        x = float((np.log(row["seconds"]) - low) / (high - low))
        y = float((row["mean"] - bottom) / (top - bottom))
        if any(abs(x - a) < 0.36 and abs(y - b) < 0.07 for a, b in taken):
            continue
        taken.append((x, y))
        text = " \N{MIDDLE DOT} ".join(clean(row[name], 22) for name in data.factors)
        shift, side = ((-7, -6), "right") if x > 0.6 else ((7, -6), "left")
        style.note(ax, text, (row["seconds"], row["mean"]), shift, va="top", ha=side)
    low, high = ax.get_xlim()
    if len(ticks := [t for t in _TIMES if low <= t <= high]) < 2:
        style.log_ticks(ax, "x", duration)
    else:
        ax.set_xticks(ticks, [duration(t) for t in ticks])
    ax.set_xticks([], minor=True)
    ax.set(xlabel="mean computing time of a case", ylabel=style.labeled(facts.title, facts.unit))
    return figure


def front_caption(facts: Facts, _data: ReportData, frame: pd.DataFrame) -> str:
    """Say how cheap a cell within the practical difference is."""
    near = frame[frame["within"]]
    dear, cheap = float(frame["seconds"].max()), float(near["seconds"].min())
    lie = "lies" if len(near) == 1 else "lie"
    return sentence(
        f"{count(len(near), 'cell')} of {len(frame)} {lie} within "
        f"{trimmed(practical_of(facts, frame))}{THIN}{facts.difference_unit} of the best; the "
        f"cheapest of them takes {duration(cheap)} a case, the most expensive of all cells "
        f"{duration(dear)}"
    )


def failed_cases(data: ReportData) -> pd.DataFrame:
    """Cell, block and status of every case, in the order of the design."""
    factors, table = list(data.factors), in_order(data)
    frame = table[[*factors, "status"]].astype(str)
    block = table["block"].astype(str) if "block" in table else "all"
    return frame.assign(block=block, cell=frame[factors].agg(" · ".join, axis=1))


def draw_failures(_data: ReportData, frame: pd.DataFrame) -> Canvas:
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


def failures_caption(data: ReportData, _frame: pd.DataFrame) -> str:
    """Count the failed cases, and say what rows and columns of the map are."""
    failed = failures(data.failures, len(data.table)).split(". ")[0]
    named = ", ".join(name_of(name, data.labels) for name in data.factors)
    return f"{failed}: large marks; rows are cells ({named}), columns are blocks."


# Effect of each factor against the depth that the test is scored to.

#: sideways distance of the intervals of two factors, over the distance of two depths
_BESIDE = 0.05


def depth_points(facts: Facts, data: ReportData) -> pd.DataFrame:
    """Rows of one response with the names of their factors."""
    ends = ("term", "low", "high", "practical", "verdict", "highest")
    frame = pd.DataFrame([
        {"response": facts.name, "depth_mm": row.depth_mm, "difference": row.effect.range}
        | {name: getattr(row.effect, name) for name in ends}
        for row in data.depths if row.response == facts.name
    ])  # fmt: skip
    names = [term_name(str(term), data.labels) for term in frame["term"]]
    numbers = {"difference": float, "low": float, "high": float, "practical": float}
    return frame.assign(name=names).astype(numbers)


def draw_depths(facts: Facts, _data: ReportData, frame: pd.DataFrame) -> Canvas:
    """Draw the largest difference of every factor with its interval against depth."""
    figure, ax = style.one_panel(3.6)
    ax.axhline(1.0 if facts.ratio else 0.0, color=style.MUTED, linewidth=0.7)
    limits = frame.dropna(subset=["practical"]).drop_duplicates("depth_mm")
    if not limits.empty:  # a share of the mean grows with the depth
        limits = limits.sort_values("depth_mm")
        below = 1 / limits["practical"] if facts.ratio else -limits["practical"]
        ax.fill_between(limits["depth_mm"], below, limits["practical"], color=style.BAND, zorder=0)
        end, look = (limits["depth_mm"].iloc[-1], below.iloc[-1]), {"ha": "right", "alpha": 0.7}
        style.note(ax, "no practical difference", end, (0, 3), color=style.INK, **look)
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


def depths_caption(facts: Facts, _data: ReportData, frame: pd.DataFrame) -> str:
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


_OF_RESPONSE: dict[str, Plot] = {
    "depth": ("Effects against depth", depth_points, draw_depths, depths_caption),
    "front": ("Cost against accuracy", cost_front, draw_front, front_caption),
}
_CONSTANTS: Plot = ("Fitted constants", constant_points, draw_constants, constants_caption)
_FAILURES: Plot = ("Failure map", failed_cases, draw_failures, failures_caption)


# Which figures a report has.


def of_response(data: ReportData, facts: Facts, without: Collection[str] = ()) -> dict[str, Figure]:
    """Figures of one response by kind, but those ``without``; none where it was not analyzed."""
    if (result := facts.result) is None or not facts.terms:
        return {}
    facts = replace(facts, title=clean(facts.title, 60), unit=clean(facts.unit, 16))
    # nothing is left over by a saturated model
    is_saturated = "residual" not in result.residuals
    timed = "seconds" in data.table and bool(data.table["seconds"].notna().any())
    has = {
        # the sentences say that nothing could be estimated
        "means": any(effect.range is not None for effect in facts.terms),
        "interactions": len(data.factors) > 1,
        "residuals": not is_saturated,
        "spread": not is_saturated,
        "contrasts": result.lenth is not None,
        "depth": any(row.response == facts.name for row in data.depths),
        "front": bool(facts.better) and timed,
    }
    plots = {**effect_figures.PLOTS, **residual_figures.PLOTS, **_OF_RESPONSE}
    chosen = {
        kind: bound(plot, facts, data)
        for kind, plot in plots.items()
        if has.get(kind, True) and kind not in without
    }
    stem = slugs(response.name for response in data.analyses)[facts.name]
    return figures_of(chosen, stem, facts.title)


def overview(data: ReportData, all_facts: Sequence[Facts]) -> Figure | None:
    """Figure of the first page: every effect against what matters; None without an effect."""
    analyzed = [facts for facts in all_facts if facts.terms]
    limited = [facts for facts in analyzed if facts.has_size]
    # without a limit there is no common scale: the first response stands for itself
    shown = limited or analyzed[:1]
    if not any(effect.range is not None for facts in shown for effect in facts.terms):
        return None

    def rows() -> pd.DataFrame:
        frame = effect_figures.against_limits(shown, data.labels)
        if len(frame) > _MOST_EFFECTS:
            frame = effect_figures.against_limits(shown, data.labels, is_brief=True)
        return frame

    plot: Plot = (
        "Every effect against what matters" if limited else "Every effect",
        rows,
        lambda frame: effect_figures.draw_against_limits(frame, shown),
        lambda frame: _against_limits(frame, analyzed, shown, data),
    )
    return make("overview", plot)


#: rows beyond which a term whose verdict is that of one setting has no row for its average
_MOST_EFFECTS = 10
#: part of the width of the figure that the mark of an effect covers
_MARK = 0.02


def _against_limits(
    frame: pd.DataFrame, analyzed: Sequence[Facts], shown: Sequence[Facts], data: ReportData
) -> str:
    """Count the effects on either side of what matters, and say what the marks are."""
    if frame["limited"].all():
        verdicts = frame.loc[frame["verdict"] != "", "verdict"].tolist()
        large, small = verdicts.count(MATTERS), verdicts.count(NO_DIFFERENCE)
        rest = len(verdicts) - large - small
        parts = [
            f"{number} {words}"
            for number, words in (
                (large, f"matter{'s' * (large == 1)} (orange circle)"),
                (small, f"{'is' if small == 1 else 'are'} too small to matter (green square)"),
                (rest, "cannot be judged with these data (hollow)"),
            )
            if number
        ]
        parts[0] = parts[0].replace(" ", f" of {count(len(verdicts), 'effect')} ", 1)
    else:
        parts = ["no smallest difference that matters was given, so no effect has a verdict"]
    if (frame["bound"] > 0).any():
        parts.append(f"thin ends: {data.refinement.name} error")
    # an interval that would allow a claim says why there is none
    beyond = frame[(frame["verdict"] == CANNOT_TELL) & (frame["low"] > 1)]
    for (response, term), names in beyond.groupby(["response", "term"], sort=False)["name"]:
        (facts,) = (facts for facts in shown if facts.name == response)
        why = next((e.why for e in facts.effects if e.term == term), "")
        if why:
            name = term_name(str(term), data.labels)
            where = "" if names.iloc[0] == name else f" {names.iloc[0]}"
            parts.append(f"{name}{where} lies beyond what matters, but {why}")
    width = frame["high"].max() - min(frame["low"].min(), 0.0)
    if data.blocks and (frame["high"] - frame["low"] < _MARK * width).any():
        block = clean(data.block) or "block"
        parts.append(f"no thick bar: the difference is nearly the same in every {block}")
    left = [facts.title for facts in analyzed if facts not in shown]
    if left:
        parts.append(f"not drawn, on the second page: {listing(left)}")
    return sentence("; ".join(parts))


def of_study(data: ReportData) -> dict[str, Figure]:
    """Figures that belong to no single response."""
    plots: dict[str, Plot] = {}
    if data.curves:
        every, curves = curve_figures.curve_panels(data), curve_figures.CURVES
        plots["curves"] = bound(curves, every, data)
        if len(every.panels) > curve_figures.MOST_COLUMNS:
            few = curve_figures.curve_panels(data, curve_figures.MOST_COLUMNS)
            plots["few-curves"] = bound((f"{curves[0]}, a part", *curves[1:]), few, data)
    if any(fit.value is not None for fit in data.fits):
        plots["constants"] = bound(_CONSTANTS, data)
    marked = (document for case in data.markers for document in case.markers)
    if any(fit["error_by_layer_mm"] for document in marked for fit in document["fits"]):
        plots["markers"] = bound(curve_figures.MARKERS, data)
    if data.refinement.series:
        plot = convergence_figures.values_against(data.refinement.size)
        plots["convergence"] = bound(plot, data.refinement.series)
    if data.validation:
        # the first block stands for the others
        rows = [row for row in data.validation if row["block"] == data.validation[0]["block"]]
        plots["validation"] = bound(convergence_figures.VALIDATION, rows)
    if data.failures:
        plots["failures"] = bound(_FAILURES, data)
    return {name: make(name, plot) for name, plot in plots.items()}


def of_recordings(frame: pd.DataFrame) -> Figure:
    """Figure of the rows of a calibration as they were recorded, with their branches."""
    aside = frame[frame["set_aside"] != ""]
    why = [f"{n} {reason}" for reason, n in aside.groupby("set_aside", sort=False).size().items()]
    caption = f"{len(frame)} recorded rows, {len(frame) - len(aside)} used"
    caption += f"; set aside: {listing(why)}" if why else ""
    plot: Plot = (
        "Recording and its branches",
        lambda: frame,
        curve_figures.draw_recordings,
        sentence(caption),
    )
    return make("recording", plot)
