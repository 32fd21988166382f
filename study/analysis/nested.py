"""Repeats on one unit (specimen) are nested in it: average them, and say what that changes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from study.analysis.results import AnalysisResult
from study.analysis.tidy import prepare
from study.errors import Fault, InputError, nearest

if TYPE_CHECKING:
    import pandas as pd


def average_units(
    table: pd.DataFrame,
    response: str,
    factors: Sequence[str],
    unit: str,
    *,
    block: str | None = None,
    transform: str = "none",
) -> pd.DataFrame:
    """Average the rows of each unit within its cell (geometrically for a log response).

    Parameters
    ----------
    unit : str
        Column of the unit; its labels may start again in every cell.

    Raises
    ------
    InputError
        If the column is unknown or is a factor.
    """
    import pandas as pd

    names = [str(c) for c in table.columns]
    if unit not in names:
        raise InputError(Fault(f"unit {unit!r}", "no such column", nearest(unit, names)))
    if unit in (response, block, *factors):
        raise InputError(Fault("unit", f"{unit!r} is already the response, block or a factor"))
    data = prepare(table, response, factors, block)
    keys = [*factors, *([block] if block else [])]
    kept = table.iloc[data.rows]
    y = data.y
    if transform == "log":
        if y.min() <= 0:
            raise InputError(Fault(f"response {response!r}", "the log needs positive values"))
        y = np.log(y)
    frame = pd.DataFrame({name: kept[name].to_numpy() for name in [*keys, unit]})
    shift = float(y[0])
    frame[response] = y - shift
    means = frame.groupby([*keys, unit], sort=False, observed=True)[response].mean() + shift
    out = means.reset_index()
    if transform == "log":
        out[response] = np.exp(out[response])
    return out


def misleading(nested: AnalysisResult, naive: AnalysisResult, unit: str) -> tuple[str, ...]:
    """Sentences that say how far the analysis of all rows would have misled."""
    out = [
        f"{naive.n} rows are averaged into {nested.n} levels of {unit} within the cells: "
        f"repeats on one {unit} are nested in it"
    ]
    for row in nested.anova.rows:
        if row.f is None or row.df_error is None:
            continue
        other = naive.anova.row(row.term)
        if other.f is None or other.df_error is None:
            continue
        out.append(
            f"{row.term}: F({row.df:g}, {row.df_error:g}) = {row.f:.3g}; taking the rows as "
            f"independent would have given F({other.df:g}, {other.df_error:g}) = {other.f:.3g}"
        )
    return tuple(out)
