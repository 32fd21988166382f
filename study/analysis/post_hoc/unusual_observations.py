"""Rows that a fit describes badly or leans on: residuals, leverage, Cook's distance, PRESS."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pandas as pd

    from study.analysis.result import AnalysisResult

#: Standardized residuals beyond this are listed, as in Minitab's "Fits and Diagnostics".
LARGE_RESIDUAL = 2.0
#: Leverage above this many times the average is listed, as in Minitab.
LARGE_LEVERAGE = 3.0
#: A row of this leverage is fitted exactly, and nothing of it can be predicted from the others.
EXACT = 1 - 1e-10


@dataclass(frozen=True)
class UnusualObservations:
    """Rows to look at, and how well the model predicts what it was not fitted to.

    Parameters
    ----------
    rows : DataFrame
        ``row`` (from 1), ``response``, ``fitted``, ``residual``, ``standardized``, ``leverage``,
        ``cook``, ``press`` (residual of the row predicted from all others), ``why``; the largest
        standardized residual first.
    press : float or None
        Sum of the squared PRESS residuals; None where a row cannot be predicted.
    r_sq_pred : float or None
        1 - PRESS / total sum of squares.
    cook_limit : float or None
        Median of F(p, n - p): beyond it a row moves the fit (Cook 1977).
    """

    rows: pd.DataFrame
    press: float | None
    r_sq_pred: float | None
    cook_limit: float | None


def diagnosed_rows(found: AnalysisResult) -> pd.DataFrame | None:
    """Every row with its standardized and PRESS residual; None where nothing was left over.

    Parameters
    ----------
    found : AnalysisResult
        Its residuals and leverages.

    Returns
    -------
    DataFrame or None
        The rows of the analysis with ``standardized`` and ``press`` added, in their order.
    """
    rows = found.data.residuals
    if "leverage" not in rows:
        return None
    leverage = rows["leverage"].to_numpy(float)
    residual = rows["residual"].to_numpy(float)
    df = len(rows) - float(leverage.sum())
    rss = float(residual @ residual)
    # half a degree of freedom is rounding of the sum of the leverages
    if df < 0.5 or rss <= 0:
        return None
    s = math.sqrt(rss / df)
    # a row that is fitted exactly leaves 0 / 0: it has no residual to judge
    left = np.where(leverage < EXACT, 1 - leverage, np.nan)
    return rows.assign(
        row=rows["row"] + 1,
        standardized=residual / s / np.sqrt(left),
        press=residual / left,
    )


def unusual_observations(found: AnalysisResult) -> UnusualObservations | None:
    """List the rows with a large residual, leverage or Cook's distance.

    Parameters
    ----------
    found : AnalysisResult
        Its residuals and leverages.

    Returns
    -------
    UnusualObservations or None
        None where nothing was left over by the model.
    """
    rows = diagnosed_rows(found)
    if rows is None:
        return None
    limit = None if found.assumptions.influence is None else found.assumptions.influence.limit
    leverage = rows["leverage"]
    why = _reasons(rows, min(LARGE_LEVERAGE * float(leverage.mean()), 0.99), limit)
    known = ("row", "response", "fitted", "residual", "standardized", "leverage", "cook", "press")
    listed = rows[list(known)].assign(why=why)[np.array([bool(text) for text in why])]
    order = listed["standardized"].abs().sort_values(ascending=False, kind="stable").index
    summary = found.variation.summary
    press = float(np.sum(rows["press"].to_numpy(float) ** 2))
    return UnusualObservations(
        listed.loc[order].reset_index(drop=True),
        press if math.isfinite(press) else None,
        None if summary is None else summary.r_sq_pred,
        limit,
    )


def _reasons(rows: pd.DataFrame, leverage: float, cook: float | None) -> list[str]:
    large = rows["standardized"].abs() > LARGE_RESIDUAL
    remote = rows["leverage"] > leverage
    moves = rows["cook"] > (math.inf if cook is None else cook)
    texts = []
    for flags in zip(large, remote, moves, strict=True):
        named = zip(flags, ("large residual", "high leverage", "moves the fit"), strict=True)
        texts.append(", ".join(text for flag, text in named if flag))
    return texts
