"""Pieces that an analysis computes beside its table: residual fit, Lenth, intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from study.analysis.matrix import Array, Codes, Layout, Term, balanced, model_matrix, terms_of
from study.analysis.results import Row
from study.analysis.sums import Factored, factor
from study.analysis.tidy import Data
from study.analysis.unreplicated import LenthResult, lenth, orthonormal_contrasts


@dataclass(frozen=True)
class CellGroups:
    """Values that Bartlett and Levene compare."""

    groups: dict[str, Array]
    approximate: bool
    basis: Array | None
    index: Codes


def additive_fit(data: Data, y: Array, rows: Any = None, *, plots: Codes | None = None) -> Factored:
    """Fit of cells plus blocks (or whole plots) to some of the rows: residuals within them."""
    keep = np.arange(y.size) if rows is None else rows
    cells, index = np.unique(data.cell[keep], return_inverse=True)
    levels = {"cell": tuple(str(c) for c in cells)}
    codes = {"cell": index.astype(np.int64)}
    extra: list[Term] = []
    blocks = [data.layout.codes[name] for name in data.blocks] if plots is None else [plots]
    for i, code in enumerate(blocks):
        present, at = np.unique(code[keep], return_inverse=True)
        levels[f"block {i}"] = tuple(str(c) for c in present)
        codes[f"block {i}"] = at.astype(np.int64)
        extra += [(f"block {i}",)] if present.size > 1 else []
    terms: list[Term] = [("cell",)] if cells.size > 1 else []
    return factor(model_matrix(Layout(levels, codes), terms, extra=extra), y[keep])


def reduced_fit(data: Data, y: Array, terms: Sequence[Term], rows: Any) -> Factored:
    """Fit of the model's terms (and blocks) to some of the rows."""
    extra: list[Term] = [(name,) for name in data.blocks]
    return factor(model_matrix(data.layout.take(rows), terms, extra=extra), y[rows])


def lenth_of(data: Data, y: Array, terms: Sequence[Term], seed: int) -> LenthResult:
    """Lenth's method on the one-df contrasts of an unreplicated factorial.

    In a two-level design the values are the classical effects. A full grid gives the contrasts
    of all terms; of a saturated fraction the terms of the model fill the space.
    """
    every = terms_of(data.factors) if balanced(data.layout, data.factors) else tuple(terms)
    names, contrasts = orthonormal_contrasts(data.layout, every)
    values = contrasts.T @ (y - y[0])
    if all(len(data.layout.levels[f]) == 2 for f in data.factors):
        values = 2 * values / np.sqrt(y.size)
    return lenth(values, names, seed=seed)


def eta_interval(row: Row, level: float = 0.95) -> tuple[float, float] | None:
    """Interval of partial eta squared from the noncentral F (Smithson 2001).

    The noncentrality bounds lambda solve F(f; df1, df2, lambda) = 0.975 and 0.025;
    eta = lambda / (lambda + df1 + df2 + 1).
    """
    if row.f is None or row.df_error is None or not 0 < row.f < 1e5:
        return None
    total = row.df + row.df_error + 1
    bounds = []
    for q in ((1 + level) / 2, (1 - level) / 2):
        value = _noncentrality(row.f, row.df, row.df_error, q)
        if value is None:
            return None
        bounds.append(value / (value + total))
    return bounds[0], bounds[1]


def _noncentrality(f: float, df1: float, df2: float, q: float) -> float | None:
    from scipy.optimize import brentq
    from scipy.special import ncfdtr

    def gap(value: float) -> float:
        return float(ncfdtr(df1, df2, value, f)) - q

    if gap(1e-9) <= 0:
        return 0.0
    high = 10.0 + 2 * f * df1
    while gap(high) > 0:
        high *= 2
        if high > 1e8:
            return None
    value = float(brentq(gap, 1e-9, high, xtol=1e-9))
    return value if np.isfinite(value) else None
