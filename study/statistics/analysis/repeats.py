"""Repeats that are no replicates: rows of one unit, and mesh seeds that all cells share."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from study.ground.arrays import gathered
from study.ground.errors import Fault, InputError, nearest
from study.ground.units import times
from study.statistics.analysis.analysis_request import AnalysisRequest
from study.statistics.analysis.anova_table import Anova, NaiveTerm, NestedUnits, Row
from study.statistics.analysis.comparisons import t_quantile
from study.statistics.analysis.data import prepare

if TYPE_CHECKING:
    import pandas as pd


# -------------------------------------------------------------------------------------------------
# Repeats on one unit (specimen) are nested in it: average them, and say what that changes.


def average_units(
    table: pd.DataFrame, request: AnalysisRequest, unit: str, block: Sequence[str] = ()
) -> pd.DataFrame:
    """Average the rows of each unit within its cell (geometrically for a log response)."""
    import pandas as pd

    response, factors = request.response, request.factors
    names = [str(c) for c in table.columns]
    if unit not in names:
        raise InputError(Fault(f"unit {unit!r}", "no such column", nearest(unit, names)))
    if unit in (response, *block, *factors):
        raise InputError(Fault("unit", f"{unit!r} is already the response, block or a factor"))
    data = prepare(table, response, factors, block)
    keys = [*factors, *block]
    y = data.y
    if request.scale.is_log and y.min() <= 0:
        raise InputError(Fault(f"response {response!r}", "the log needs positive values"))
    y = np.log(y) if request.scale.is_log else y
    frame = pd.DataFrame({name: table[name].to_numpy() for name in [*keys, unit]})
    shift = float(y[0])
    frame[response] = np.nan
    frame.loc[data.rows, response] = y - shift
    # a unit without any response stays, so that it is counted among the missing
    means = frame.groupby([*keys, unit], sort=False, observed=True)[response].mean() + shift
    out = means.reset_index()
    if request.scale.is_log:
        out[response] = np.exp(out[response])
    return out


def crosses(table: pd.DataFrame, request: AnalysisRequest, unit: str) -> bool:
    """Whether the same unit is measured in several cells, so that it is a block of them.

    Labels that start again in every cell name other units there; they are told from one unit in
    several cells by a factor of which every label has one level only.
    """
    if unit not in table.columns or unit in (request.response, *request.factors):
        return False
    levels = table.groupby(unit, observed=True)[list(request.factors)].nunique()
    return bool((levels == 1).all(axis=0).any() and (levels > 1).all(axis=0).any())


def named_again(table: pd.DataFrame, request: AnalysisRequest, unit: str) -> str:
    """Name a unit with a name of its own, and no number, in several cells; empty without one."""
    if unit not in table.columns or unit in (request.response, *request.factors):
        return ""
    cells = table[[unit, *request.factors]].drop_duplicates()[unit].astype(str).value_counts()
    return next((label for label in cells.index[cells > 1] if not label.isdigit()), "")


def compare_naive(
    table: pd.DataFrame, request: AnalysisRequest, unit: str, nested: Anova, naive: Anova
) -> NestedUnits | None:
    """Compare the table of unit means with that of all rows; None without repeats."""
    data = prepare(table, request.response, request.factors, request.layout.block)
    y = np.log(data.y) if request.scale.is_log else data.y
    cell = data.layout.cell([*data.factors, *data.blocks])
    labels = np.unique(table[unit].astype(str).to_numpy()[data.rows], return_inverse=True)[1]
    units = np.unique(np.column_stack([cell, labels]), axis=0, return_inverse=True)[1]
    cells = np.unique(cell, return_inverse=True)[1]
    size = np.bincount(units)
    df_unit, df_row = size.size - int(cells.max()) - 1, y.size - size.size
    if df_unit < 1 or df_row < 1:
        return None
    shifted = y - y[0]
    of_unit = (np.bincount(units, shifted) / size)[units]
    of_cell = (np.bincount(cells, shifted) / np.bincount(cells))[cells]
    ms_unit = float(np.sum((of_unit - of_cell) ** 2)) / df_unit
    ms_row = float(np.sum((shifted - of_unit) ** 2)) / df_row
    # mean number of repeats in the expected mean square (Searle 1971, section 9.7 for balance)
    m = float(y.size / size.size)
    between = max(0.0, (ms_unit - ms_row) / m)
    total = between + ms_row
    correlation = between / total if total > 0 else 0.0
    naive_ms = (df_unit * ms_unit + df_row * ms_row) / (df_unit + df_row)
    wider = t_quantile(0.025, df_unit) / t_quantile(0.025, df_unit + df_row)
    terms = _terms(nested, naive)
    df_term = int(terms[0].df[0]) if terms else 1
    inflation = 1 + (m - 1) * correlation
    too_narrow = wider * float(np.sqrt(ms_unit / naive_ms)) if naive_ms > 0 else 1.0
    df = df_term, df_unit, df_row
    size_of_naive = _naive_size(inflation, 1 - correlation, *df, request.seed)
    rows = y.size, size.size, correlation, y.size / inflation
    return NestedUnits(unit, *rows, too_narrow, size_of_naive, terms)


def _naive_size(
    unit: float, row: float, df_term: int, df_unit: int, df_row: int, seed: int
) -> float:
    """How often the naive 5 % test rejects a true null, by 200,000 simulated mean squares."""
    from scipy.special import fdtri

    rng = np.random.default_rng(seed)
    count = 200_000
    top = unit * rng.chisquare(df_term, count) / df_term
    rest = unit * rng.chisquare(df_unit, count) + row * rng.chisquare(df_row, count)
    cut = float(fdtri(df_term, df_unit + df_row, 0.95))
    return float(np.mean(top > cut * rest / (df_unit + df_row)))


def _terms(nested: Anova, naive: Anova) -> tuple[NaiveTerm, ...]:
    def tested(row: Row) -> tuple[float, tuple[float, float], float] | None:
        if row.f is None or row.df_error is None or row.p is None:
            return None
        return row.f, (row.df, row.df_error), row.p

    each = [(row.term, tested(row)) for row in nested.rows]
    both = [
        (term, nested_row, tested(naive.row(term)))
        for term, nested_row in each
        if nested_row is not None
    ]
    return tuple(
        NaiveTerm(term, *nested_row, *rows) for term, nested_row, rows in both if rows is not None
    )


def sentences(nested: NestedUnits, alpha: float) -> list[str]:
    """Sentences that say how far the analysis of all rows would have misled."""
    unit = nested.unit
    out = [
        f"{nested.rows} rows are averaged into {nested.units} levels of {unit} within the cells: "
        f"repeats on one {unit} are nested in it",
        f"two rows on one {unit} correlate by {nested.correlation:.2f}: {nested.rows} rows tell as "
        f"much as {nested.effective_rows:.0f} independent ones; taking them as independent would "
        f"give intervals {times(nested.too_narrow, 2)} too narrow and reject a true null in "
        f"{100 * nested.naive_size:.0f} % of studies instead of 5 %",
    ]
    for t in nested.terms:
        changed = " (the conclusion changes)" if (t.p < alpha) != (t.naive_p < alpha) else ""
        out.append(
            f"{t.term}: F({t.df[0]:g}, {t.df[1]:g}) = {t.f:.4g}; taking the rows as independent "
            f"would have given F({t.naive_df[0]:g}, {t.naive_df[1]:g}) = {t.naive_f:.4g}{changed}"
        )
    return out


# -------------------------------------------------------------------------------------------------
# Mesh seeds as blocks: whether the seeds of a study are common to all of its cells.
#
# A seed that every cell shares is a block: the effect is tested against its own interaction with
# the seeds, and the question is whether another mesh of this size would change it. Seeds that
# differ between cells are replicates within cells.


def common_seeds(cells: Sequence[Hashable], seeds: Sequence[object]) -> tuple[tuple[str, ...], str]:
    """Seeds that every cell has and that are therefore blocks, and why; none where few are common.

    Examples
    --------
    >>> common_seeds(["a", "a", "b", "b"], [1, 2, 1, 2])[0]
    ('1', '2')
    >>> common_seeds(["a", "a", "b", "b"], [1, 2, 3, 4])[0]
    ()
    """
    if not cells or len(cells) != len(seeds):
        rule = f"one seed for each of {len(cells)} rows is needed, got {len(seeds)}"
        raise InputError(Fault("seeds", rule))
    of_cell = gathered(zip(cells, map(str, seeds), strict=True)).values()
    labels = tuple(dict.fromkeys(map(str, seeds)))
    in_all = set.intersection(*map(set, of_cell))
    common = tuple(s for s in labels if s in in_all)
    if len(common) < 2 or 2 * len(common) < len(labels):
        return (), "mesh seeds differ between cells: replicates, pooled within cells"
    why = f"the {len(common)} mesh seeds are common to all cells, so they are blocks"
    left = [s for s in labels if s not in common]
    missing = f"; missing in some cell and left out everywhere: {', '.join(left)}" if left else ""
    return common, why + missing
