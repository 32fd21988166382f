"""Figures of a surface over numeric factors: profiles, contours, shares, runs left out."""

from __future__ import annotations

from contextlib import suppress
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.figure import Figure as Canvas

from study.ground.arrays import Array, gathered
from study.ground.errors import RefusedError
from study.reporting.content.blocks import Figure
from study.reporting.content.surface_content import at_labels, settings, title
from study.reporting.content.text import (
    clean,
    interval,
    listing,
    name_of,
    percent,
    quantity,
    sentence,
    slugs,
)
from study.reporting.figures import axes as style
from study.reporting.figures.axes import Plot, bound, make
from study.statistics.surfaces.quadratic import QuadraticSurface
from study.statistics.surfaces.surface_optimum import check_carries
from study.statistics.surfaces.surface_result import (
    FittedSurface,
    SurfaceAnalysis,
    contour,
    left_out,
    profiles,
    strongest,
)

if TYPE_CHECKING:
    from study.reporting.results.study_result import ReportData

    Rows = list[tuple[FittedSurface, SurfaceAnalysis]]

#: most factors whose profiles stand beside each other, and factors and responses of page one
_COLUMNS = 6
_FEW_COLUMNS = 3
_FEW_ROWS = 2
#: part of a profile's change below which a step back is rounding
_LEVEL = 1e-3


def drawings(fitted: FittedSurface, data: ReportData) -> dict[str, Plot]:
    """Every figure of one surface by kind."""
    surface = fitted.surface
    if surface is None:
        return {}
    has = {
        "shares": any(item.index is not None for item in surface.sensitivity),
        "contours": len(surface.runs.factors) > 1,
        "left-out": bool(left_out(surface)),
    }
    return {kind: bound(_PLOTS[kind], surface, fitted, data) for kind in has if has[kind]}


def profilers(data: ReportData, *, is_first_page: bool = False) -> list[Figure]:
    """Every response along every factor, one figure for each combination of the other factors.

    The first page has the first of them, of the strongest factors and the first responses.
    """
    by_labels = gathered(
        (at_labels(fitted, data), (fitted, fitted.surface))
        for fitted in data.surfaces
        if fitted.surface is not None
    )
    plot: Plot
    if is_first_page:
        plot = ("Predictions", _few_profiles, _draw_profiles, _reference_words)
        firsts = [rows[:_FEW_ROWS] for rows in by_labels.values()][:1]
        return [make("few-profiles", bound(plot, rows, data)) for rows in firsts]
    figures = []
    names = slugs(f"profiler {labels}" for labels in by_labels)
    for labels, rows in by_labels.items():
        plot = (
            f"Every response along every factor{labels and ': '}{labels}",
            _profiles,
            _draw_profiles,
            _profiles_caption,
        )
        figures.append(make(names[f"profiler {labels}"], bound(plot, rows, data)))
    return figures


def _reference(rows: Rows, data: ReportData) -> tuple[Array, str]:
    """Coded setting (k,) that the profiles go through, inside of every response's runs; in words.

    It is the best setting of the only response that has a better end, else the middle.
    """
    coded = [surface.runs.coded for _, surface in rows]
    low = np.max([points.min(axis=0) for points in coded], axis=0)
    high = np.min([points.max(axis=0) for points in coded], axis=0)
    at, words = np.zeros(len(low)), "in the middle of their ranges"
    better = {item.name: item.better for item in data.analyses if item.better}
    goals = [row for row in rows if row[0].response in better]
    if len(goals) == 1:
        fitted, best = goals[0]
        with suppress(RefusedError):  # a surface that predicts badly names no best setting
            check_carries(best.model)
            is_low = better[fitted.response] == "lower"
            at = (best.smallest if is_low else best.largest).at
            words = f"where {title(fitted, data)} is {'low' if is_low else 'high'}est"
    return np.clip(at, low, high), words


def _profiles(rows: Rows, data: ReportData) -> pd.DataFrame:
    at, _ = _reference(rows, data)
    reference = rows[0][1].runs.settings(at)
    orders = [strongest(surface) for _, surface in rows]
    names = sorted(reference, key=lambda name: sum(order.index(name) for order in orders))
    return pd.concat(
        pd.DataFrame({"response": fitted.response, "factor": name, "setting": setting,
                      "value": p.value, "low": p.low, "high": p.high, "reference": reference[name]})
        for fitted, along in [(fitted, profiles(surface, at)) for fitted, surface in rows]
        for name, (setting, p) in ((name, along[name]) for name in names)
    )  # fmt: skip


def _few_profiles(rows: Rows, data: ReportData) -> pd.DataFrame:
    frame = _profiles(rows, data)
    return frame[frame["factor"].isin(frame["factor"].unique()[:_FEW_COLUMNS])]


def _reference_words(rows: Rows, data: ReportData, frame: pd.DataFrame) -> str:
    _, where = _reference(rows, data)
    at = dict(zip(frame["factor"], frame["reference"], strict=True))
    number, of_all = min(len(at), _COLUMNS), len(rows[0][1].runs.factors)
    more = f"; drawn are the {number} strongest factors" if number < of_all else ""
    others = f" with the others {where} (lines: {settings(at, rows[0][0], data)})"
    return sentence(f"predictions along each factor{others}, with 95 % intervals as bands{more}")


def _profiles_caption(rows: Rows, data: ReportData, frame: pd.DataFrame) -> str:
    shown = _reference_words(rows, data, frame)
    rest = [_finding(*row, data, frame[frame["response"] == row[0].response]) for row in rows]
    return " ".join(map(sentence, (shown, *rest)))


def _finding(
    fit: FittedSurface, surface: SurfaceAnalysis, data: ReportData, row: pd.DataFrame
) -> str:
    """Say what every factor does to a response by itself."""
    named, unit = name_of(fit.response, data.labels), clean(fit.unit)
    model = surface.model
    if isinstance(model, QuadraticSurface):
        is_carried = model.carries or model.error != "none"
    else:
        is_carried = model.gate != "refused"
    if not is_carried:
        return f"the runs do not carry the surface of {named}, so its row says nothing"
    parts: list[str] = []
    small: list[str] = []
    unclear: list[str] = []
    for name, along in row.groupby("factor", sort=False):
        factor, value = name_of(str(name), data.labels), along["value"].to_numpy()
        steps, change = np.diff(value), float(np.ptp(value))
        if fit.practical is not None and change < fit.practical:
            # the whole band must lie within it, for what the prediction does is no claim yet
            is_small = along["high"].max() - along["low"].min() < fit.practical
            (small if is_small else unclear).append(factor)
        elif (steps > -_LEVEL * change).all() or (steps < _LEVEL * change).all():
            verb = "rises" if value[-1] > value[0] else "falls"
            parts.append(f"{verb} with {factor} from {interval(value[0], value[-1], unit)}")
        else:
            ends = interval(value.min(), value.max(), unit)
            parts.append(f"lies between {ends.replace(' to ', ' and ')} along {factor}")
    limit = f"what matters ({quantity(fit.practical, unit)})"
    if small:
        parts.append(f"changes by less than {limit} with {listing(small)}")
    if unclear:
        parts.append(f"may change by more or less than {limit} with {listing(unclear)}")
    return f"{named} {listing(parts)}"


def _draw_profiles(rows: Rows, data: ReportData, frame: pd.DataFrame) -> Canvas:
    names = list(dict.fromkeys(frame["factor"]))[:_COLUMNS]
    number, shared = len(rows) * len(names), {"sharex": "col", "sharey": "row"}
    is_few = len(names) <= _FEW_COLUMNS and len(rows) <= _FEW_ROWS
    figure, axes = style.panels(number, len(names), 1.6 if is_few else 1.9, 0.5, **shared)
    if is_few:
        figure.set_figwidth(style.HALF_IN)
    panels = frame.groupby(["response", "factor"])
    for ax, ((fitted, _), name) in zip(axes, product(rows, names), strict=True):
        part = panels.get_group((fitted.response, name))
        color = style.color_of(0)
        ax.fill_between(part["setting"], part["low"], part["high"], color=color, alpha=0.2, lw=0)
        ax.plot(part["setting"], part["value"], color=color)
        ax.axvline(part["reference"].iloc[0], color=style.MUTED, linewidth=0.8, linestyle="--")
        ax.set_xmargin(0)
        ax.locator_params(axis="x", nbins=4)
        if fitted is rows[-1][0]:
            ax.set_xlabel(style.wrap(_axis(name, fitted, data), 24))
        if name == names[0]:
            ax.set_ylabel(style.wrap(_axis(fitted.response, fitted, data), 22))
    return figure


def _contours(surface: SurfaceAnalysis, _fitted: FittedSurface, _data: ReportData) -> pd.DataFrame:
    return pd.DataFrame(contour(surface, strongest(surface)[:2])[0])


def _contours_caption(
    surface: SurfaceAnalysis, fitted: FittedSurface, data: ReportData, frame: pd.DataFrame
) -> str:
    low, high = (quantity(end, clean(fitted.unit)) for end in frame["value"].agg(["min", "max"]))
    over = " and ".join(name_of(str(name), data.labels) for name in frame.columns[:2])
    several = len(surface.runs.factors) > 2
    others = "; the others are in the middle of their ranges" if several else ""
    return sentence(
        f"{title(fitted, data)} goes from {low} to {high} over {over}{others}. Points are the runs."
    )


def _draw_contours(
    surface: SurfaceAnalysis, fitted: FittedSurface, data: ReportData, frame: pd.DataFrame
) -> Canvas:
    across, up = frame.columns[:2]
    runs = contour(surface, strongest(surface)[:2])[1]
    table = frame.pivot_table(index=up, columns=across, values="value")
    figure, ax = style.one_panel(4.2)
    x, y, z = table.columns.to_numpy(), table.index.to_numpy(), table.to_numpy()
    filled = ax.contourf(x, y, z, levels=10, cmap="Blues", alpha=0.75)
    ax.contour(x, y, z, levels=filled.levels, colors="white", linewidths=0.6)
    ax.scatter(runs[:, 0], runs[:, 1], s=9, color=style.INK, linewidths=0)
    bar = figure.colorbar(filled, ax=ax, pad=0.015, aspect=30)
    bar.set_label(_axis(fitted.response, fitted, data))
    bar.outline.set_visible(False)
    ax.set(xlabel=_axis(across, fitted, data), ylabel=_axis(up, fitted, data))
    return figure


def _shares(surface: SurfaceAnalysis, _fitted: FittedSurface, _data: ReportData) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "factor": item.factor, "total": item.index.total, "low": item.index.total_interval[0],
            "high": item.index.total_interval[1], "alone": item.index.first,
        }
        for item in sorted(surface.sensitivity, key=lambda item: item.rank)
        if item.index is not None
    )  # fmt: skip


def _shares_caption(
    _surface: SurfaceAnalysis, fitted: FittedSurface, data: ReportData, frame: pd.DataFrame
) -> str:
    first, alone = frame.iloc[0], float(frame["alone"].sum())
    return sentence(
        f"{name_of(str(first['factor']), data.labels)} carries "
        f"{percent(float(first['total']))} of the variance of {title(fitted, data)} when every "
        f"factor is uniform over its range. Bars are total indices with intervals of about 95 %, "
        f"rings what the factor does alone; all factors alone sum to {percent(min(alone, 1.0))}, "
        "the rest is interaction."
    )


def _draw_shares(
    _surface: SurfaceAnalysis, _fitted: FittedSurface, data: ReportData, frame: pd.DataFrame
) -> Canvas:
    figure, ax = style.one_panel(0.8 + 0.3 * len(frame), style.HALF_IN)
    places = np.arange(len(frame))
    percents = 100 * frame[["total", "low", "high", "alone"]]
    ax.barh(places, percents["total"], color=style.color_of(0), height=0.55, alpha=0.35)
    low, high = percents["low"].clip(0), percents["high"].clip(0, 100)
    ax.hlines(places, low, high, color=style.INK, linewidth=1.4)
    color = style.color_of(1)
    ax.plot(percents["alone"], places, "o", markerfacecolor="none", color=color, markersize=6)
    style.name_rows(
        ax, places, [style.wrap(name_of(str(n), data.labels), 30) for n in frame["factor"]], 8
    )
    ax.set_ylim(len(frame) - 0.5, -0.5)
    ax.set_xlim(left=0)
    ax.set_xlabel("share of the variance (%)")
    return figure


def _left_out(surface: SurfaceAnalysis, _fitted: FittedSurface, _data: ReportData) -> pd.DataFrame:
    return pd.DataFrame(dict(zip(("simulated", "predicted"), left_out(surface) or (), strict=True)))


def _left_out_caption(
    surface: SurfaceAnalysis, fitted: FittedSurface, data: ReportData, frame: pd.DataFrame
) -> str:
    worst, q2 = float((frame["simulated"] - frame["predicted"]).abs().max()), surface.model.q2
    return (
        f"Each run of {title(fitted, data)} against what a surface fitted to all the others "
        f"predicts; the worst is off by {quantity(worst, clean(fitted.unit))}, and Q2 is "
        f"{min(q2, 0.9999):.4g}{' or more' if q2 > 0.9999 else ''} "
        "(1 is perfect, 0 no better than the mean)."
    )


def _draw_left_out(
    _surface: SurfaceAnalysis, fitted: FittedSurface, data: ReportData, frame: pd.DataFrame
) -> Canvas:
    figure, ax = style.one_panel(3.9, style.HALF_IN)
    ends = [float(frame.min().min()), float(frame.max().max())]
    ax.plot(ends, ends, color=style.MUTED, linewidth=0.8)
    ax.scatter(frame["simulated"], frame["predicted"], s=14, color=style.color_of(0), linewidths=0)
    ax.set_box_aspect(1)
    ax.set_xlabel(f"run: {_axis(fitted.response, fitted, data)}")
    ax.set_ylabel("predicted from the others")
    return figure


def _axis(name: str, fitted: FittedSurface, data: ReportData) -> str:
    """Name of a factor, or of the response, with its unit."""
    unit = {**fitted.units, fitted.response: fitted.unit}.get(name, "")
    return style.labeled(clean(name_of(name, data.labels), 40), clean(unit))


_PLOTS: dict[str, Plot] = {
    "shares": ("Shares of the variance", _shares, _draw_shares, _shares_caption),
    "contours": ("Over the two strongest factors", _contours, _draw_contours, _contours_caption),
    "left-out": ("Runs predicted from the others", _left_out, _draw_left_out, _left_out_caption),
}
