"""Sums of squares of Types I, II and III from one orthogonal factorization.

The response is shifted by its first value (exact for close doubles, Sterbenz's lemma), the
columns are scaled to unit length and factored once, X = Q R; every later projection works on
the small R. Certified against the NIST StRD sets.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from typing import ParamSpec, TypeVar

import numpy as np
from scipy import linalg

from study.analysis.anova_table import Row
from study.analysis.linear_model.design_matrix import ModelMatrix, Term, term_name
from study.arrays import Array, Ints

# A unit column that keeps less than this length outside the others is aliased with them.
# Rounding leaves about 1e-15; an estimable column of a real design keeps more than 1e-4.
ALIAS_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Factored:
    """A least-squares problem after its orthogonal factorization.

    Parameters
    ----------
    matrix : ModelMatrix
        The model.
    q : ndarray, shape (n, r)
        Orthonormal columns that span the model.
    r : ndarray, shape (r, p)
        ``columns / scale = q @ r``.
    scale : ndarray, shape (p,)
        Length of each column.
    z : ndarray, shape (r,)
        ``q.T @ (y - shift)``.
    fitted, residual : ndarray, shape (n,)
        Fit and residual in the units of y.
    rank : int
        Rank of the model.
    rss, tss : float
        Residual and corrected total sums of squares.
    """

    matrix: ModelMatrix
    q: Array
    r: Array
    scale: Array
    z: Array
    fitted: Array
    residual: Array
    rank: int
    rss: float
    tss: float
    shift: float

    @property
    def df_residual(self) -> int:
        """Residual degrees of freedom."""
        return int(self.q.shape[0] - self.rank)

    @property
    def leverage(self) -> Array:
        """Leverage of every row: the diagonal of the hat matrix, shape (n,)."""
        return np.asarray(np.einsum("ij,ij->i", self.q, self.q))

    def coefficients(self) -> Array:
        """Minimum-norm coefficients of the shifted response, shape (p,)."""
        return np.asarray(np.linalg.pinv(self.r, rcond=ALIAS_TOLERANCE) @ self.z / self.scale)

    def unscaled_covariance(self) -> Array:
        """(X'X)^+, shape (p, p)."""
        inverse = np.linalg.pinv(self.r, rcond=ALIAS_TOLERANCE) / self.scale[:, None]
        return np.asarray(inverse @ inverse.T)

    def estimable(self, rows: Array) -> Array:
        """Whether each linear combination of coefficients can be estimated, shape (m,)."""
        scaled = rows / self.scale
        _, s, vt = np.linalg.svd(self.r, full_matrices=False)
        basis = vt[s > ALIAS_TOLERANCE * s[0]]
        outside = scaled - scaled @ basis.T @ basis
        size = np.maximum(np.linalg.norm(scaled, axis=1), 1e-300)
        return np.asarray(np.linalg.norm(outside, axis=1) <= 1e-8 * size)


@dataclass(frozen=True)
class TermSum:
    """Sum of squares of one term, the space it lives in, and what is lost to aliasing."""

    term: Term
    df: int
    ss: float
    basis: Array
    nominal_df: int
    aliases: tuple[str, ...] = ()


def factor(matrix: ModelMatrix, y: Array) -> Factored:
    """Factor the model and fit the response."""
    scale = np.linalg.norm(matrix.columns, axis=0)
    scale[scale == 0] = 1.0
    scaled = matrix.columns / scale
    cells = distinct_rows(scaled)
    if cells is None:
        q, r = np.linalg.qr(scaled)
    else:
        q, r = np.linalg.qr(cells.rows)
        q = cells.spread(q)
    shift = float(y[0])
    shifted = y - shift
    rank = int(np.linalg.matrix_rank(r, tol=ALIAS_TOLERANCE * np.sqrt(r.shape[1])))
    if rank < r.shape[1]:
        u, s, _ = np.linalg.svd(r)
        q = q @ u[:, :rank]
        r = u[:, :rank].T @ r
    z = q.T @ shifted
    # a second projection removes what rounding left of the model in the residual
    residual = shifted - q @ z
    correction = q.T @ residual
    residual = residual - q @ correction
    z = z + correction
    centered = shifted - shifted.mean()
    return Factored(
        matrix,
        q,
        r,
        scale,
        z,
        y - residual,
        residual,
        rank,
        float(residual @ residual),
        float(centered @ centered),
        shift,
    )


def term_sums(fit: Factored, kind: str, skip: Sequence[Term] = ()) -> list[TermSum]:
    """Sum of squares of every term but the intercept and ``skip``.

    Parameters
    ----------
    fit : Factored
        The factored model.
    kind : {"I", "II", "III"}
        Given the terms before it; given every term that does not contain it; given all others.
    """
    terms = fit.matrix.terms
    return [
        _term_sum(fit, i, _others(terms, i, kind))
        for i in range(1, len(terms))
        if terms[i] not in skip
    ]


def _others(terms: Sequence[Term], i: int, kind: str) -> list[int]:
    if kind == "I":
        return list(range(i))
    rest = [j for j in range(len(terms)) if j != i]
    if kind == "III":
        return rest
    return [j for j in rest if not set(terms[i]) < set(terms[j])]


def _term_sum(fit: Factored, i: int, others: list[int]) -> TermSum:
    blocks = fit.matrix.blocks
    own = fit.r[:, blocks[i]]
    rest = np.hstack([fit.r[:, blocks[j]] for j in others])
    basis = complement(rest, own)
    part = basis.T @ fit.z
    term = fit.matrix.terms[i]
    nominal = span(own).shape[1] if not _is_full(own) else own.shape[1]
    names: tuple[str, ...] = ()
    if basis.shape[1] < nominal:
        names = _aliases(fit, i, others)
    return TermSum(term, basis.shape[1], float(part @ part), basis, nominal, names)


def _is_full(columns: Array) -> bool:
    return bool(span(columns).shape[1] == columns.shape[1])


def _aliases(fit: Factored, i: int, others: list[int]) -> tuple[str, ...]:
    """Terms that hold, alone, a direction of term ``i``."""
    own = span(fit.r[:, fit.matrix.blocks[i]])
    found = []
    for j in others:
        overlap = span(fit.r[:, fit.matrix.blocks[j]]).T @ own
        if overlap.size and np.linalg.norm(overlap, 2) > 1 - 1e-9:
            found.append(term_name(fit.matrix.terms[j]) or "mean")
    return tuple(found)


def span(columns: Array) -> Array:
    """Orthonormal basis of the columns, shape (r, rank)."""
    if columns.size == 0:
        return np.zeros((columns.shape[0], 0))
    cells = distinct_rows(columns)
    if cells is not None:
        return cells.spread(span(cells.rows))
    q, r, _ = linalg.qr(columns, mode="economic", pivoting=True)
    size = np.abs(np.diag(r))
    return np.asarray(q[:, : size.size][:, size > ALIAS_TOLERANCE * max(1.0, size[0])])


# From this many rows on a table is factored by its distinct rows. A QR of 100,000 x 100 takes
# 1.2 s, that of its 100 cells 1 ms; finding them takes 0.05 s.
_MANY_ROWS = 2000
# Fewest rows a cell, on average, for which that pays.
_FEWEST_A_CELL = 4


@dataclass(frozen=True)
class DistinctRows:
    """The distinct rows of a tall matrix, each weighted by the root of its number.

    Parameters
    ----------
    rows : ndarray, shape (cells, p)
        X'X of these is that of the whole matrix, so both have the same R.
    index : ndarray, shape (n,)
        Distinct row of every row.
    weight : ndarray, shape (cells,)
        Root of the number of rows that are the same.
    """

    rows: Array
    index: Ints
    weight: Array

    def spread(self, q: Array) -> Array:
        """Orthonormal columns of the whole matrix from those of the distinct rows."""
        return np.asarray((q / self.weight[:, None])[self.index])


def distinct_rows(columns: Array) -> DistinctRows | None:
    """Distinct rows of a tall matrix; None where there are few rows, or few that repeat."""
    n = columns.shape[0]
    if n < _MANY_ROWS:
        return None
    # rows that agree have the same product; that those of one product agree is checked
    product = columns @ np.random.default_rng(0).standard_normal(columns.shape[1])
    _, first, index, number = np.unique(
        product, return_index=True, return_inverse=True, return_counts=True
    )
    if first.size * _FEWEST_A_CELL > n or not np.array_equal(columns[first][index], columns):
        return None
    weight = np.sqrt(number.astype(float))
    return DistinctRows(columns[first] * weight[:, None], index, weight)


def complement(rest: Array, own: Array) -> Array:
    """Orthonormal basis of what ``own`` adds to ``rest``, shape (r, df)."""
    base = span(rest)
    left = own - base @ (base.T @ own)
    left = left - base @ (base.T @ left)
    length = np.linalg.norm(own, axis=0)
    length[length == 0] = 1.0
    return span(left / length)


# a residual this small beside the total is rounding, no error term
_ROUNDING = 1e-28


def orthogonal(fit: Factored) -> bool:
    """Whether the terms span orthogonal spaces, so that all types of sums agree."""
    gram = fit.r.T @ fit.r
    for block in fit.matrix.blocks:
        gram[block, block] = 0.0
    return bool(np.abs(gram).max() < 1e-9)


def term_row(s: TermSum, df: int, rss: float, total: float, error: str = "residual") -> Row:
    """One line: a term against an error of ``df`` degrees of freedom and sum ``rss``."""
    from scipy.special import fdtrc

    name = term_name(s.term)
    if s.df == 0:
        return Row(name, 0, 0.0)
    ms = s.ss / s.df
    if df == 0 or rss <= _ROUNDING * max(total, s.ss):
        return Row(name, s.df, s.ss, ms)
    if s.df < s.nominal_df:
        return Row(name, s.df, s.ss, ms, error=error, df_error=df)
    mse = rss / df
    f = ms / mse
    return Row(
        name,
        s.df,
        s.ss,
        ms,
        f,
        float(fdtrc(s.df, df, f)),
        error,
        df,
        None,
        None,
        max(0.0, (s.ss - s.df * mse) / (total + mse)),
        s.ss / (s.ss + rss),
    )


def with_shares(rows: Sequence[Row], total: float) -> tuple[Row, ...]:
    """Rows with their share of the variation and the interval of partial eta squared."""
    done = []
    for row in rows:
        share = row.ss / total if total > 0 else None
        done.append(replace(row, share=share, partial_eta_sq_ci95=eta_interval(row)))
    return tuple(done)


def alias_warnings(sums: Sequence[TermSum]) -> list[str]:
    """One sentence for every term that lost degrees of freedom, with what it is aliased."""
    out = []
    for s in sums:
        if s.df < s.nominal_df:
            partly = f" (aliased with {', '.join(s.aliases)})" if s.aliases else ""
            out.append(
                f"{term_name(s.term)}: {s.nominal_df - s.df} of {s.nominal_df} degrees of "
                f"freedom are not estimable{partly}: empty cells or a confounded design; no test"
            )
    return out


P = ParamSpec("P")
R = TypeVar("R")


def one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Run ``function`` with one linear-algebra thread.

    On a busy machine the threads of a small product wait for each other (15 s instead of
    0.5 s for 10,000 rows), and the last digits of a sum would depend on their number.
    """

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1):
            return function(*args, **kwargs)

    return limited


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
