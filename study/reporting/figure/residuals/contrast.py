"""Contrasts of an unreplicated two-level design: Pareto chart and half-normal plot."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from study.analysis.unreplicated import pseudo_standard_error
from study.reporting.figure.axes import clean_left, name_rows, plain_ticks, wrap
from study.reporting.figure.style import BAND, INK, MUTED, WIDTH_IN, canvas
from study.reporting.report import Facts
from study.reporting.text import term_name
from study.study_result.report_data import ReportData

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas


_ACTIVE = "#D55E00"

_PASSIVE = "#0072B2"

_MOST_BARS = 31

_HALF_NORMAL_SIMULATIONS = 2000


def contrasts(facts: Facts, data: ReportData) -> pd.DataFrame:
    """Every contrast with its half-normal score and limits, the largest first.

    Parameters
    ----------
    facts, data : Facts, ReportData
        With Lenth's analysis (a ValueError is raised without one); for shown names and the seed.

    Returns
    -------
    DataFrame
        ``contrast``, ``name``, ``size`` (absolute), ``score``, ``p``, ``margin``,
        ``simultaneous``, ``active`` (beyond the margin of error), ``low`` and ``high``
        (95 % envelope of as many null contrasts with the same pseudo standard error).
    """
    import pandas as pd

    found = facts.lenth
    if found is None:
        raise ValueError("there are no single contrasts: the design is replicated")
    frame = pd.DataFrame(
        {
            "contrast": list(found.names),
            "name": [_name(name, data) for name in found.names],
            "size": np.abs(np.asarray(found.values, dtype=float)),
            "score": np.asarray(found.half_normal, dtype=float),
            "p": np.asarray(found.p, dtype=float),
            "margin": found.me,
            "simultaneous": found.sme,
        }
    ).sort_values("size", ascending=False, kind="stable", ignore_index=True)
    low, high = _envelope(len(frame), found.pse, data.seed)
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
    z = np.sort(z, axis=1)[:, ::-1]
    low, high = np.quantile(z, [0.025, 0.975], axis=0)
    return low, high


def draw_contrasts(frame: pd.DataFrame, facts: Facts) -> Canvas:
    """Draw the Pareto plot on the left, the half-normal plot on the right.

    Parameters
    ----------
    frame, facts : DataFrame, Facts
        Of :func:`contrasts`, largest first, and the response.
    """
    shown = frame.head(_MOST_BARS)
    figure = canvas(WIDTH_IN, max(3.4, 1.0 + 0.2 * len(shown)))
    pareto, half = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
    unit = "log ratio" if facts.ratio else facts.difference_unit
    label = f"absolute contrast ({unit})" if unit else "absolute contrast"
    _pareto(pareto, shown, label)
    _half_normal(half, frame, label)
    return figure


def _pareto(ax: Axes, frame: pd.DataFrame, label: str) -> None:
    import seaborn as sns

    places = np.arange(len(frame))
    sns.barplot(
        x=frame["size"],
        y=places,
        hue=frame["active"],
        orient="y",
        native_scale=True,
        dodge=False,
        palette={True: _ACTIVE, False: _PASSIVE},
        saturation=1,
        width=0.66,
        errorbar=None,
        legend=False,
        ax=ax,
    )
    for column, style, name in (("margin", "--", "one"), ("simultaneous", ":", "all")):
        limit = float(frame[column].iloc[0])
        ax.axvline(limit, color=INK, linewidth=0.8, linestyle=style)
        ax.text(
            limit,
            1.0,
            name,
            transform=ax.get_xaxis_transform(),
            ha="center",
            va="bottom",
            fontsize=7.5,
            color=MUTED,
        )
    name_rows(ax, places, [wrap(name, 30) for name in frame["name"]])
    ax.set_ylim(len(frame) - 0.4, -0.6)
    clean_left(ax)
    ax.set_xlabel(f"{label}; limits for one, for all")
    plain_ticks(ax, "x")


def _half_normal(ax: Axes, frame: pd.DataFrame, label: str) -> None:
    import seaborn as sns

    ordered = frame.sort_values("score")
    ax.fill_between(
        ordered["score"], np.sort(frame["low"]), np.sort(frame["high"]), color=BAND, linewidth=0
    )
    sns.scatterplot(
        frame,
        x="score",
        y="size",
        hue="active",
        style="active",
        palette={True: _ACTIVE, False: _PASSIVE},
        markers={True: "D", False: "o"},
        s=30,
        linewidth=0,
        legend=False,
        ax=ax,
    )
    for name, score, size in zip(*(frame[c] for c in ("name", "score", "size")), strict=True):
        if size > float(frame["margin"].iloc[0]):
            ax.annotate(
                name,
                (score, size),
                xytext=(-6, 0),
                textcoords="offset points",
                ha="right",
                va="center",
                fontsize=7.5,
            )
    ax.set_ylim(bottom=0)
    ax.set_xlim(left=0)
    ax.set_xlabel("half-normal score, with the 95 % envelope of no effect")
    ax.set_ylabel(label)
    plain_ticks(ax, "y")
