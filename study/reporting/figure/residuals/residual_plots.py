"""Residual plots of a table of measurements: four in one, against the factors, influence.

At most :data:`MOST_POINTS` rows are drawn, the largest residuals among them: a drawing of 100,000
marks would make a page of 20 MB and show no more.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from study.reporting.figure.axes import plain_ticks
from study.reporting.figure.residuals.diagnostics import _against_factors, envelope
from study.reporting.figure.style import BAND, INK, MUTED, WIDTH_IN, canvas, color_of
from study.reporting.numbers import p_phrase, p_value
from study.reporting.report import Facts
from study.reporting.text import count, sentence
from study.study_result.report_data import ReportData

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

#: Rows drawn at most; 100 of them are the largest residuals, the others a random sample.
MOST_POINTS = 2000
LARGEST_KEPT = 100
#: Rows beyond which single points are no longer joined in run order.
MOST_JOINED = 300
#: Rows that are named in the plot of influence.
NAMED = 5


def residual_points(rows: pd.DataFrame) -> pd.DataFrame:
    """Every row with the normal score of its residual (Blom 1958).

    Parameters
    ----------
    rows : DataFrame
        Of :func:`study.analysis.post_hoc.unusual_observations.diagnosed_rows`.
    """
    from scipy.special import ndtri

    n = len(rows)
    order = rows["residual"].rank(method="first").to_numpy(float)
    return rows.assign(score=ndtri((order - 0.375) / (n + 0.25)))


def thinned(points: pd.DataFrame, seed: int) -> pd.DataFrame:
    """At most ``MOST_POINTS`` rows in their order: the largest residuals and a random sample.

    Parameters
    ----------
    points : DataFrame
        By :func:`residual_points`.
    seed : int
        Of the random sample.
    """
    if len(points) <= MOST_POINTS:
        return points
    size = points["residual"].abs().to_numpy()
    largest = np.argpartition(size, -LARGEST_KEPT)[-LARGEST_KEPT:]
    others = np.setdiff1d(np.arange(len(points)), largest)
    rng = np.random.default_rng(seed)
    sample = rng.choice(others, MOST_POINTS - LARGEST_KEPT, replace=False)
    return points.iloc[np.sort(np.concatenate([largest, sample]))]


def drawn_words(points: pd.DataFrame) -> str:
    """Say how many of the rows are drawn, where not all are.

    Parameters
    ----------
    points : DataFrame
        By :func:`residual_points`, before :func:`thinned`.

    Returns
    -------
    str
        To be appended to a caption; empty where all rows are drawn.
    """
    if len(points) <= MOST_POINTS:
        return ""
    return (
        f"; {MOST_POINTS:,} of {len(points):,} rows are drawn: the {LARGEST_KEPT} largest "
        "residuals and a random sample"
    )


def four_in_one_caption(points: pd.DataFrame, facts: Facts, alpha: float) -> str:
    """Name the panels, and say whether normality is rejected.

    Parameters
    ----------
    points : DataFrame
        By :func:`residual_points`, before :func:`thinned`.
    facts : Facts
        Its test of normality.
    alpha : float
        Normality is rejected where p is below.
    """
    found = facts.assumptions.normality
    verdict = "the test of normality does not apply"
    if found is not None and found.rj is not None:
        p = found.p_exact
        said = f" ({p_phrase(p)}, simulated)" if p is not None else ""
        rejected = p is not None and p < alpha
        verdict = f"normality is {'rejected' if rejected else 'not rejected'} by Ryan-Joiner{said}"
    return sentence(
        f"{count(len(points), 'residual')}; {verdict}. The order is that of the rows in the file: "
        f"the run order only if they were written down as they were run{drawn_words(points)}"
    )


def draw_four_in_one(points: pd.DataFrame, facts: Facts, data: ReportData) -> Canvas:
    """Draw probability plot, residuals against fits, histogram, residuals in the order of rows.

    Parameters
    ----------
    points : DataFrame
        By :func:`residual_points`; here they are thinned, but for the histogram.
    facts : Facts
        For the unit, and the test of normality.
    data : ReportData
        For the seed.
    """
    figure = canvas(WIDTH_IN, 5.8)
    (normal, fits), (histogram, order) = figure.subplots(2, 2)
    shown, label = thinned(points, data.seed), _label(facts)
    _probability(normal, shown, points, facts, data.seed, label)
    _against(fits, shown["fitted"], shown["residual"])
    where = f"log of {facts.unit}" if facts.ratio and facts.unit else facts.unit
    fits.set(title="versus fits", xlabel=f"fit ({where})" if where else "fit", ylabel=label)
    _histogram(histogram, points["residual"].to_numpy(float), label)
    joined = len(shown) <= MOST_JOINED
    order.axhline(0, color=MUTED, linewidth=0.7)
    order.plot(shown["row"], shown["residual"], "o-" if joined else "o", markersize=3.2,
               linewidth=0.7, color=color_of(0), markeredgewidth=0)  # fmt: skip
    order.set(title="versus order", xlabel="row of the file (without the header)", ylabel=label)
    for ax in (normal, fits, histogram, order):
        plain_ticks(ax, "x")
        plain_ticks(ax, "y")
    return figure


def _label(facts: Facts) -> str:
    unit = "log ratio" if facts.ratio else facts.difference_unit
    return f"residual ({unit})" if unit else "residual"


def _probability(
    ax: Axes, shown: pd.DataFrame, points: pd.DataFrame, facts: Facts, seed: int, label: str
) -> None:
    """Draw residuals against normal scores, with the envelope of normal data where n is small."""
    spread = float(points["residual"].std(ddof=1))
    if len(points) <= MOST_POINTS:
        low, high = envelope(len(points), spread, seed)
        ax.fill_between(np.sort(points["score"]), low, high, color=BAND, linewidth=0)
    ends = np.array([points["score"].min(), points["score"].max()])
    ax.plot(ends, ends * spread, color=MUTED, linewidth=0.8)
    ax.plot(shown["score"], shown["residual"], "o", markersize=3.2, alpha=0.8, color=color_of(0),
            markeredgewidth=0)  # fmt: skip
    found = facts.assumptions.normality
    if found is not None and found.rj is not None:
        p = p_value(found.p_exact)
        tail = "" if found.p_exact is None else f", p {p if p[0] in '<>' else f'= {p}'}"
        text = f"RJ = {found.rj:.4f}{tail}"
        ax.text(0.03, 0.97, text, transform=ax.transAxes, va="top", fontsize=8)
    ax.set(title="normal probability plot", xlabel="normal score", ylabel=label)


def _against(ax: Axes, x: pd.Series, residual: pd.Series) -> None:
    ax.axhline(0, color=MUTED, linewidth=0.7)
    ax.plot(x, residual, "o", markersize=3.2, alpha=0.7, color=color_of(0), markeredgewidth=0)


def _histogram(ax: Axes, values: np.ndarray, label: str) -> None:
    import seaborn as sns

    bins = int(np.clip(np.ceil(1 + np.log2(values.size)), 4, 40))  # Sturges 1926
    sns.histplot(x=values, bins=bins, color=color_of(5), alpha=1, edgecolor="white", linewidth=0.6,
                 ax=ax)  # fmt: skip
    ax.set(title="histogram", xlabel=label, ylabel="rows")


def draw_against_factors(points: pd.DataFrame, facts: Facts, data: ReportData) -> Canvas:
    """Draw the residuals at every level of every factor, side by side.

    Parameters
    ----------
    points : DataFrame
        By :func:`residual_points`, with a column for each factor.
    facts : Facts
        For the unit.
    data : ReportData
        For the factors, their levels and shown names, and the seed.
    """
    figure = canvas(WIDTH_IN, 3.2)
    ax = figure.subplots()
    _against_factors(ax, thinned(points, data.seed), data, _label(facts))
    plain_ticks(ax, "y")
    return figure


def influence_caption(points: pd.DataFrame, limit: float | None) -> str:
    """Say how many rows move the fit.

    Parameters
    ----------
    points : DataFrame
        By :func:`residual_points`, before :func:`thinned`.
    limit : float or None
        Cook's distance beyond which a row moves the fit; None where it is not known.
    """
    moving = 0 if limit is None else int((points["cook"] > limit).sum())
    said = f"{count(moving, 'row')} beyond it" if moving else "no row is beyond it"
    line = "" if limit is None else f"; beyond {limit:.2g} a row moves the fit, and {said}"
    return sentence(
        "left, Cook's distance of every row; right, standardized residual against leverage, with "
        f"lines at \N{MINUS SIGN}2 and 2{line}{drawn_words(points)}"
    )


def draw_influence(points: pd.DataFrame, data: ReportData, limit: float | None) -> Canvas:
    """Draw Cook's distance by row, and standardized residual against leverage.

    Parameters
    ----------
    points : DataFrame
        By :func:`residual_points`.
    data : ReportData
        For the seed.
    limit : float or None
        As for :func:`influence_caption`; drawn up to three times the largest distance.
    """
    figure = canvas(WIDTH_IN, 3.2)
    cook, leverage = figure.subplots(1, 2)
    # a row that is fitted exactly has leverage one, and no Cook's distance
    drawn = thinned(points, data.seed)
    shown = drawn[np.isfinite(drawn["cook"].to_numpy(float))]
    cook.vlines(shown["row"], 0, shown["cook"], color=color_of(0), linewidth=1.0)
    largest = float(np.nanmax(shown["cook"].to_numpy(float), initial=0.0))
    if limit is not None and limit <= 3 * largest:
        cook.axhline(limit, color=INK, linewidth=0.8, linestyle="--")
    for row in shown.nlargest(NAMED, "cook").itertuples():
        at = float(str(row.row)), float(str(row.cook))
        cook.annotate(f"{row.row}", at, xytext=(0, 2), textcoords="offset points",
                      ha="center", va="bottom", fontsize=7.5)  # fmt: skip
    cook.set_ylim(bottom=0, top=1.12 * largest if largest > 0 else 1.0)
    cook.set(title="Cook's distance", xlabel="row of the file", ylabel="")
    for height in (-2, 2):
        leverage.axhline(height, color=MUTED, linewidth=0.7, linestyle="--")
    _against(leverage, shown["leverage"], shown["standardized"])
    leverage.set(
        title="residual against leverage", xlabel="leverage", ylabel="standardized residual"
    )
    for ax in (cook, leverage):
        plain_ticks(ax, "x")
        plain_ticks(ax, "y")
    return figure
