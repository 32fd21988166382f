"""Fitted constants with their intervals, one panel a constant."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from study.reporting.content.cases.fit_tables import fit_name, fit_rank
from study.reporting.figure.axes import clean_left, name_rows, plain_ticks, wrap
from study.reporting.figure.style import RULE, WIDTH_IN, canvas, color_of
from study.reporting.text import clean
from study.study_result.report_data import ReportData

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

_MOST_ROWS = 40
_MOST_PANELS = 4


def constant_points(data: ReportData) -> pd.DataFrame:
    """Every fitted constant with its interval, in the order of the design.

    Parameters
    ----------
    data : ReportData
        Its fits; one without a value is passed over.

    Returns
    -------
    DataFrame
        ``row`` (levels that enter the fit), ``place`` (its index), ``constant``, ``block``,
        ``specimen``, ``value``, ``low``, ``high``, ``standard_error``, ``unit``,
        ``identifiable``.

    Raises
    ------
    ValueError
        If no constant was fitted.
    """
    import pandas as pd

    fits = [fit for fit in data.fits if fit.value is not None]
    if not fits:
        raise ValueError("no constant was fitted")
    every = dict.fromkeys(tuple(fit.levels.items()) for fit in fits)
    ranked = sorted(every, key=lambda levels: fit_rank(dict(levels), data))
    place = {levels: i for i, levels in enumerate(ranked)}
    frame = pd.DataFrame(
        {
            "row": [fit_name(fit, data) for fit in fits],
            "place": [place[tuple(fit.levels.items())] for fit in fits],
            "constant": [fit.constant for fit in fits],
            "block": [fit.block for fit in fits],
            "specimen": [fit.specimen for fit in fits],
            "value": [fit.value for fit in fits],
            "low": [fit.low for fit in fits],
            "high": [fit.high for fit in fits],
            "standard_error": [fit.standard_error for fit in fits],
            "unit": [fit.unit for fit in fits],
            "identifiable": [fit.identifiable for fit in fits],
        }
    )
    numbers = dict.fromkeys(("value", "low", "high", "standard_error"), float)
    frame = frame.astype(numbers)
    return frame[frame["place"] < _MOST_ROWS].sort_values(["constant", "place"], kind="stable")


def draw_constants(frame: pd.DataFrame) -> Canvas:
    """Draw rows of fits; a hollow mark is a constant that the data do not determine.

    Parameters
    ----------
    frame : DataFrame
        By :func:`constant_points`; the four constants with the most fits are drawn.
    """
    # the constant of most fits first: it is the one that all models share
    names = frame["constant"].value_counts().index.tolist()[:_MOST_PANELS]
    rows = frame.drop_duplicates("place").sort_values("place")
    figure = canvas(WIDTH_IN, 1.0 + 0.3 * len(rows))
    axes = figure.subplots(1, len(names), squeeze=False, sharey=True)[0]
    for index, (ax, name) in enumerate(zip(axes, names, strict=True)):
        some = frame[frame["constant"] == name]
        _panel(ax, some, color_of(index))
        unit = str(some["unit"].iloc[0])
        ax.set_xlabel(f"{clean(name, 16)} ({unit})" if unit else clean(name, 16))
    name_rows(axes[0], rows["place"], [wrap(row, 46, 90) for row in rows["row"]])
    axes[0].set_ylim(len(rows) - 0.4, -0.6)
    return figure


def _panel(ax: Axes, frame: pd.DataFrame, color: str) -> None:
    for place, group in frame.groupby("place"):
        # fits of one row stand below each other, so that their intervals can be read
        y = float(str(place)) + np.linspace(-0.3, 0.3, len(group) + 2)[1:-1]
        ax.hlines(y, group["low"], group["high"], color=color, linewidth=0.8)
        sure = group["identifiable"].to_numpy(bool)
        ax.plot(group["value"][sure], y[sure], "o", color=color, markersize=2.8)
        ax.plot(
            group["value"][~sure],
            y[~sure],
            "o",
            color=color,
            markersize=2.8,
            markerfacecolor="white",
            markeredgewidth=0.8,
        )
    ax.grid(axis="y", color=RULE, linewidth=0.4)
    clean_left(ax)
    plain_ticks(ax, "x")
    ax.locator_params(axis="x", nbins=4)
