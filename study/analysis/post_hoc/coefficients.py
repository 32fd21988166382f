"""Table of regression coefficients, with the standard error that the error term gives.

Factors have sum-to-zero contrasts (Minitab's ``-1, 0, +1``): the coefficient of a level is how
far its mean lies from the mean of all, and the last level is minus the sum of the others.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from study.analysis.linear_model.design_matrix import (
    Layout,
    Term,
    model_matrix,
    nested_in,
    terms_of,
)
from study.arrays import Array, Ints

if TYPE_CHECKING:
    import pandas as pd

    from study.analysis.result import AnalysisResult

#: Columns beyond which a table of coefficients is not read; the QR of 200 columns takes 0.1 s.
MOST_COEFFICIENTS = 200
#: A direction of the columns shorter than this, of 1, is no estimate: its terms are aliased.
ALIASED = 1e-9


@dataclass(frozen=True)
class Coefficient:
    """One coefficient on the scale of the analysis.

    Parameters
    ----------
    term : str
        ``Constant``, or the term with its level: ``material[2]``, ``A:B[a1 b2]``.
    estimate, standard_error, t, p : float or None
        None where it cannot be given.
    df : float
        Degrees of freedom of t.
    vif : float or None
        Variance inflation factor; 1 where the columns are orthogonal.
    """

    term: str
    estimate: float
    standard_error: float | None
    t: float | None
    p: float | None
    df: float
    vif: float | None


@dataclass(frozen=True)
class CoefficientTable:
    """Coefficients in the order of the model; without any, ``reason`` says why."""

    coefficients: tuple[Coefficient, ...] = ()
    reason: str = ""


def coefficient_table(found: AnalysisResult) -> CoefficientTable:
    """Give the coefficients of the model that an analysis fitted.

    With a pooled error they are those of least squares. Where effects are tested against their
    own interactions with the blocks, the model is fitted to each block alone, and a standard
    error is that of the mean of the blocks' coefficients: no sphericity is assumed.

    Parameters
    ----------
    found : AnalysisResult
        With its rows.

    Returns
    -------
    CoefficientTable
        On the scale of the analysis (logarithms for a log response).
    """
    tested = {row.error for row in found.anova.rows if row.f is not None}
    terms = terms_of(found.request.factors, found.request.model)
    if not tested:
        return CoefficientTable(reason="there is no error term to judge a coefficient by")
    if nested_in(terms):
        return CoefficientTable(
            reason="the levels of a nested factor have no contrasts of their own"
        )
    layout = _layout(found)
    if layout is None:
        return CoefficientTable(reason="a level of a factor has no row")
    names = column_names(layout, terms)
    if len(names) > MOST_COEFFICIENTS:
        return CoefficientTable(reason=f"{len(names)} coefficients are more than anyone reads")
    block = found.data.block
    if found.data.model_matrix is not None and all(":" not in str(error) for error in tested):
        return _pooled(found, names)
    if block is not None and all(str(error).startswith(f"{block}:") for error in tested):
        return _own(found, layout, terms, names)
    return CoefficientTable(reason="the strata of the table have different errors")


def column_names(layout: Layout, terms: tuple[Term, ...]) -> tuple[str, ...]:
    """Names of the coefficients: the constant, then every level of a term but the last ones.

    Parameters
    ----------
    layout : Layout
        Levels of all factors.
    terms : tuple of Term
        Terms of the model, without the intercept.
    """
    names = ["Constant"]
    for term in terms:
        levels = product(*(layout.levels[name][:-1] for name in term))
        names += [f"{':'.join(term)}[{' '.join(combination)}]" for combination in levels]
    return tuple(names)


def _layout(found: AnalysisResult) -> Layout | None:
    """Levels of every row that was fitted; None where a factor has no effect to list them."""
    rows = found.data.residuals
    levels: dict[str, tuple[str, ...]] = {}
    codes = {}
    for name in found.request.factors:
        own = next((e.levels for e in found.effects if e.term == name), ())
        index = {level: i for i, level in enumerate(own)}
        labels = rows[name].astype(str).tolist()
        if len(own) < 2 or not set(labels) <= set(own):
            return None
        levels[name] = own
        codes[name] = np.array([index[label] for label in labels], dtype=np.int64)
    return Layout(levels, codes)


def _pooled(found: AnalysisResult, names: tuple[str, ...]) -> CoefficientTable:
    matrix, residual = found.data.model_matrix, found.anova.row("residual")
    if matrix is None or not residual.ms:
        return CoefficientTable(reason="nothing is left over to estimate an error from")
    y = _working(found, found.data.residuals["response"].to_numpy(float))
    length = np.linalg.norm(matrix, axis=0)
    q, r = np.linalg.qr(matrix / length)
    if np.abs(np.linalg.svd(r, compute_uv=False)).min() < ALIASED:
        return CoefficientTable(reason="some terms are aliased with others")
    inverse = np.linalg.inv(r)
    beta = inverse @ (q.T @ (y - y[0])) / length
    beta[0] += y[0]
    spread = np.einsum("ij,ij->i", inverse, inverse) / length**2
    # blocks stand between the constant and the factors, and are no coefficients of interest
    kept = np.r_[0, matrix.shape[1] - len(names) + 1 : matrix.shape[1]]
    error = np.sqrt(spread * residual.ms)
    return _table(names, beta[kept], error[kept], residual.df, _inflation(matrix, spread)[kept])


def _inflation(matrix: Array, spread: Array) -> Array:
    """Variance inflation factors (Marquardt 1970): variance over that without the other columns."""
    centered = matrix - matrix.mean(axis=0)
    return np.asarray(spread * np.einsum("ij,ij->j", centered, centered))


def _own(
    found: AnalysisResult, layout: Layout, terms: tuple[Term, ...], names: tuple[str, ...]
) -> CoefficientTable:
    """Mean of the blocks' own coefficients, and its standard error."""
    cells, values = _by_block(found, layout)
    if values.shape[1] < 2:
        return CoefficientTable(reason="fewer than two blocks have every cell")
    matrix = model_matrix(cells, terms).columns
    if np.linalg.matrix_rank(matrix) < matrix.shape[1]:
        return CoefficientTable(reason="some terms are aliased with others")
    shift = float(values[0, 0])
    beta = np.linalg.lstsq(matrix, values - shift, rcond=None)[0]
    beta[0] += shift
    blocks = values.shape[1]
    error = beta.std(axis=1, ddof=1) / np.sqrt(blocks)
    return _table(names, beta.mean(axis=1), error, blocks - 1.0, None)


def _by_block(found: AnalysisResult, layout: Layout) -> tuple[Layout, Array]:
    """Means of the cells in every complete block, shape (cells, blocks), and their levels."""
    rows = found.data.residuals
    names = tuple(layout.levels)
    index = layout.cell(names)
    wide = _wide(index, rows, _working(found, rows["response"].to_numpy(float)))
    kept = wide[wide.notna().mean(axis=1) > 0.5].dropna(axis=1)
    first = np.array([int(np.flatnonzero(index == cell)[0]) for cell in kept.index])
    return layout.take(first), kept.to_numpy(float)


def _wide(index: Ints, rows: pd.DataFrame, y: Array) -> pd.DataFrame:
    import pandas as pd

    frame = pd.DataFrame({"cell": index, "block": rows["block"].astype(str).to_numpy(), "y": y})
    return frame.pivot_table("y", "cell", "block", aggfunc="mean")


def _working(found: AnalysisResult, y: Array) -> Array:
    return np.log(y) if found.request.scale.is_log else y


def _table(
    names: tuple[str, ...], beta: Array, error: Array, df: float, inflation: Array | None
) -> CoefficientTable:
    from scipy.special import stdtr

    rows = []
    for i, name in enumerate(names):
        se = float(error[i])
        known = np.isfinite(se) and se > 0
        t = float(beta[i]) / se if known else None
        p = None if t is None else 2 * float(stdtr(df, -abs(t)))
        vif = None if inflation is None or i == 0 else float(inflation[i])
        rows.append(Coefficient(name, float(beta[i]), se if known else None, t, p, df, vif))
    return CoefficientTable(tuple(rows))
