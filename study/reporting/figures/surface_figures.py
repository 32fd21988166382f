"""Figures of a surface over numeric factors: profiles, contours, shares, runs left out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.figure import Figure as Canvas

from study.reporting.content.surface_content import title
from study.reporting.content.text import clean, listing, name_of, percent, quantity, sentence
from study.reporting.figures import axes as style
from study.statistics.surfaces.surface_profile import contour, left_out, profiles, strongest

if TYPE_CHECKING:
    from study.reporting.figures.axes import Plot
    from study.reporting.results.study_result import ReportData
    from study.statistics.surfaces.surface_profile import FittedSurface
    from study.statistics.surfaces.surface_result import SurfaceAnalysis


#: profiles beside each other
_COLUMNS = 4


def drawings(fitted: FittedSurface, data: ReportData) -> dict[str, Plot]:
    """Every figure of one surface by kind."""
    surface = fitted.found
    if surface is None:
        return {}
    pair, errors = strongest(surface)[:2], left_out(surface) or ()
    plots: dict[str, Plot] = {
        "shares": (
            "Shares of the variance",
            lambda: _shares(surface),
            lambda frame: _draw_shares(frame, data),
            lambda frame: _shares_caption(frame, fitted, data),
        ),
        "profiles": (
            "Along each factor",
            lambda: _profiles(surface),
            lambda frame: _draw_profiles(frame, fitted, data),
            lambda frame: _profiles_caption(frame, fitted, data),
        ),
        "contours": (
            "Over the two strongest factors",
            lambda: _contours(surface, pair),
            lambda frame: _draw_contours(frame, contour(surface, pair).runs, fitted, data),
            lambda frame: _contours_caption(frame, fitted, data),
        ),
        "left-out": (
            "Runs predicted from the others",
            lambda: pd.DataFrame(dict(zip(("simulated", "predicted"), errors, strict=True))),
            lambda frame: _draw_left_out(frame, fitted, data),
            lambda frame: _left_out_caption(frame, fitted, data),
        ),
    }
    has = {
        "shares": any(item.index is not None for item in surface.sensitivity),
        "contours": len(surface.runs.factors) > 1,
        "left-out": bool(errors),
    }
    return {kind: plot for kind, plot in plots.items() if has.get(kind, True)}


def _profiles(surface: SurfaceAnalysis) -> pd.DataFrame:
    by_factor = profiles(surface)
    return pd.concat(
        pd.DataFrame({"factor": n, "setting": at, "value": p.value, "low": p.low, "high": p.high})
        for n, (at, p) in ((name, by_factor[name]) for name in strongest(surface))
    )


def _profiles_caption(frame: pd.DataFrame, fitted: FittedSurface, data: ReportData) -> str:
    named = []
    for name, values in frame.groupby("factor", sort=False)["value"]:
        size = quantity(float(np.ptp(values)), clean(fitted.unit))
        named.append(f"{size} ({name_of(str(name), data.labels)})")
    return sentence(
        f"{title(fitted, data)} along each factor with the others in the middle of their "
        f"ranges; bands are 95 % intervals of the prediction. It changes by up to {listing(named)}."
    )


def _draw_profiles(frame: pd.DataFrame, fitted: FittedSurface, data: ReportData) -> Canvas:
    names = list(dict.fromkeys(frame["factor"]))
    figure, axes = style.panels(len(names), _COLUMNS, 2.3, 0.4, sharey=True)
    for ax, name in zip(axes, names, strict=True):
        part = frame[frame["factor"] == name]
        ax.fill_between(part["setting"], part["low"], part["high"], color=style.BAND)
        ax.plot(part["setting"], part["value"], color=style.color_of(0))
        ax.set_xlabel(_axis(name, fitted, data))
        ax.set_xmargin(0)
    for ax in axes[::_COLUMNS]:
        ax.set_ylabel(_response(fitted, data))
    return figure


def _contours(surface: SurfaceAnalysis, pair: Sequence[str]) -> pd.DataFrame:
    grid = contour(surface, pair)
    x, y = np.meshgrid(grid.x, grid.y)
    return pd.DataFrame({pair[0]: x.ravel(), pair[1]: y.ravel(), "value": grid.value.ravel()})


def _contours_caption(frame: pd.DataFrame, fitted: FittedSurface, data: ReportData) -> str:
    ends = [
        quantity(float(v), clean(fitted.unit)) for v in (frame["value"].min(), frame["value"].max())
    ]
    over = " and ".join(name_of(str(name), data.labels) for name in frame.columns[:2])
    several = fitted.found is not None and len(fitted.found.runs.factors) > 2
    others = "; the others are in the middle of their ranges" if several else ""
    return sentence(
        f"{title(fitted, data)} goes from {ends[0]} to {ends[1]} over {over}{others}. Points are "
        "the runs."
    )


def _draw_contours(
    frame: pd.DataFrame, runs: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    fitted: FittedSurface, data: ReportData,
) -> Canvas:  # fmt: skip
    across, up = frame.columns[:2]
    table = frame.pivot_table(index=up, columns=across, values="value")
    figure, ax = style.one_panel(4.2)
    x, y, z = table.columns.to_numpy(), table.index.to_numpy(), table.to_numpy()
    filled = ax.contourf(x, y, z, levels=10, cmap="Blues", alpha=0.75)
    ax.contour(x, y, z, levels=filled.levels, colors="white", linewidths=0.6)
    ax.scatter(runs[:, 0], runs[:, 1], s=9, color=style.INK, linewidths=0)
    bar = figure.colorbar(filled, ax=ax, pad=0.015, aspect=30)
    bar.set_label(_response(fitted, data))
    bar.outline.set_visible(False)
    ax.set_xlabel(_axis(across, fitted, data))
    ax.set_ylabel(_axis(up, fitted, data))
    return figure


def _shares(surface: SurfaceAnalysis) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "factor": item.factor, "total": item.index.total, "low": item.index.total_interval[0],
            "high": item.index.total_interval[1], "alone": item.index.first,
        }
        for item in sorted(surface.sensitivity, key=lambda item: item.rank)
        if item.index is not None
    )  # fmt: skip


def _shares_caption(frame: pd.DataFrame, fitted: FittedSurface, data: ReportData) -> str:
    first, alone = frame.iloc[0], float(frame["alone"].sum())
    return sentence(
        f"{name_of(str(first['factor']), data.labels)} carries "
        f"{percent(float(first['total']))} of the variance of {title(fitted, data)} when every "
        f"factor is uniform over its range. Bars are total indices with intervals of about 95 %, "
        f"rings what the factor does alone; all factors alone sum to {percent(min(alone, 1.0))}, "
        "the rest is interaction."
    )


def _draw_shares(frame: pd.DataFrame, data: ReportData) -> Canvas:
    figure, ax = style.one_panel(0.8 + 0.36 * len(frame))
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


def _left_out_caption(frame: pd.DataFrame, fitted: FittedSurface, data: ReportData) -> str:
    worst = float((frame["simulated"] - frame["predicted"]).abs().max())
    q2 = 0.0 if fitted.found is None else fitted.found.model.q2
    return (
        f"Each run of {title(fitted, data)} against what a surface fitted to all the others "
        f"predicts; the worst is off by {quantity(worst, clean(fitted.unit))}, and Q2 is "
        f"{min(q2, 0.9999):.4g}{' or more' if q2 > 0.9999 else ''} "
        "(1 is perfect, 0 no better than the mean)."
    )


def _draw_left_out(frame: pd.DataFrame, fitted: FittedSurface, data: ReportData) -> Canvas:
    figure, ax = style.one_panel(3.9)
    ends = [float(frame.min().min()), float(frame.max().max())]
    ax.plot(ends, ends, color=style.MUTED, linewidth=0.8)
    ax.scatter(frame["simulated"], frame["predicted"], s=14, color=style.color_of(0), linewidths=0)
    ax.set_box_aspect(1)
    ax.set_xlabel(f"run: {_response(fitted, data)}")
    ax.set_ylabel("predicted from the others")
    return figure


def _axis(factor: str, fitted: FittedSurface, data: ReportData) -> str:
    unit = clean(fitted.units.get(factor, ""))
    return style.labeled(clean(name_of(factor, data.labels), 40), unit)


def _response(fitted: FittedSurface, data: ReportData) -> str:
    return style.labeled(clean(name_of(fitted.response, data.labels), 40), clean(fitted.unit))
