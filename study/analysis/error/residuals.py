"""Fits whose residuals are judged: cells and blocks, or the terms of a reduced model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from study.analysis.data import Data
from study.analysis.linear_model.design_matrix import Layout, Term, model_matrix
from study.analysis.linear_model.sums_of_squares import Factored, factor
from study.analysis.linear_model.two_way import TwoWayFit, two_way
from study.arrays import Array, Ints


@dataclass(frozen=True)
class CellGroups:
    """Values that Bartlett and Levene compare."""

    groups: dict[str, Array]
    approximate: bool
    basis: Array | None
    index: Ints


def additive_fit(
    data: Data, y: Array, rows: Ints | None = None, *, plots: Ints | None = None
) -> Factored:
    """Fit of cells plus blocks (or whole plots) to some of the rows: residuals within them.

    Parameters
    ----------
    data : Data
        Checked rows, n of them.
    y : ndarray, shape (n,)
        Response on the working scale.
    rows : ndarray of int, optional
        Indices of the rows that are fitted; all by default.
    plots : ndarray of int, shape (n,), optional
        Whole plot of each row, in place of the blocks.
    """
    keep = np.arange(y.size) if rows is None else rows
    cells, index = np.unique(data.cell[keep], return_inverse=True)
    levels = {"cell": tuple(str(c) for c in cells)}
    codes = {"cell": index.astype(np.int64)}
    extra: list[Term] = []
    for i, code in enumerate(_blocks(data, plots)):
        present, at = np.unique(code[keep], return_inverse=True)
        levels[f"block {i}"] = tuple(str(c) for c in present)
        codes[f"block {i}"] = at.astype(np.int64)
        extra += [(f"block {i}",)] if present.size > 1 else []
    terms: list[Term] = [("cell",)] if cells.size > 1 else []
    return factor(model_matrix(Layout(levels, codes), terms, extra=extra), y[keep])


def within_fit(
    data: Data, y: Array, rows: Ints | None = None, *, plots: Ints | None = None
) -> Factored | TwoWayFit:
    """Fit as :func:`additive_fit`, without the columns of the model where two factors serve.

    Parameters
    ----------
    data, y, rows, plots
        As for :func:`additive_fit`; one block column or whole plots at least.

    Returns
    -------
    Factored or TwoWayFit
        TwoWayFit where there is one block column, or whole plots.
    """
    blocks = _blocks(data, plots)
    if len(blocks) > 1:
        return additive_fit(data, y, rows, plots=plots)
    keep = np.arange(y.size) if rows is None else rows
    cell, block = (np.unique(code[keep], return_inverse=True)[1] for code in (data.cell, blocks[0]))
    return two_way(cell.astype(np.int64), block.astype(np.int64), y[keep])


def _blocks(data: Data, plots: Ints | None) -> list[Ints]:
    return [data.layout.codes[name] for name in data.blocks] if plots is None else [plots]


def reduced_fit(data: Data, y: Array, terms: Sequence[Term], rows: Ints) -> Factored:
    """Fit of the model's terms (and blocks) to some of the rows.

    Parameters
    ----------
    data : Data
        Checked rows, n of them.
    y : ndarray, shape (n,)
        Response on the working scale.
    terms : sequence of Term
        Terms of the model, without the intercept and the blocks.
    rows : ndarray of int
        Indices of the rows that are fitted.
    """
    extra: list[Term] = [(name,) for name in data.blocks]
    return factor(model_matrix(data.layout.take(rows), terms, extra=extra), y[rows])
