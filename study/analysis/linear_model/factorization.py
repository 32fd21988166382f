"""Orthogonal factorization of a model: decomposed once, whatever is asked of it afterwards.

The columns are scaled to unit length and factored once, X = Q R; every later projection works
on the small R. What a question needs beside it (the inverse, the space of a term) is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy import linalg

from study.analysis.linear_model.design_matrix import ModelMatrix, Term, term_name
from study.arrays import Array, Flags, Ints

# A unit column that keeps less than this length outside the others is aliased with them.
# Rounding leaves about 1e-15; an estimable column of a real design keeps more than 1e-4.
ALIAS_TOLERANCE = 1e-9
# entries of R below this are rounding of terms that are orthogonal
_ORTHOGONAL = 1e-13


@dataclass(frozen=True)
class TermSpace:
    """Orthonormal directions of one term given others, and what is lost to aliasing."""

    basis: Array
    nominal_df: int
    aliases: tuple[str, ...] = ()


@dataclass(frozen=True)
class Factorization:
    """Columns of a model as orthonormal columns times a small matrix.

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
    """

    matrix: ModelMatrix
    q: Array
    r: Array
    scale: Array
    _spaces: dict[tuple[str, int], TermSpace] = field(
        default_factory=dict, repr=False, compare=False
    )

    @property
    def rank(self) -> int:
        """Rank of the model."""
        return int(self.r.shape[0])

    @property
    def is_full(self) -> bool:
        """Whether no column depends on the others."""
        return self.rank == int(self.r.shape[1])

    @cached_property
    def is_triangular(self) -> bool:
        """Whether the first columns of ``q`` span the first columns of the model."""
        return self.is_full and bool(np.array_equal(self.r, np.triu(self.r)))

    @cached_property
    def leverage(self) -> Array:
        """Leverage of every row: the diagonal of the hat matrix, shape (n,)."""
        return np.asarray(np.einsum("ij,ij->i", self.q, self.q))

    @cached_property
    def inverse(self) -> Array:
        """Coefficients from coordinates along ``q``, of minimum norm, shape (p, r)."""
        exact = _inverse(self.r) if self.is_triangular else None
        found = np.linalg.pinv(self.r, rcond=ALIAS_TOLERANCE) if exact is None else exact
        return np.asarray(found / self.scale[:, None])

    @cached_property
    def unscaled_covariance(self) -> Array:
        """(X'X)^+, shape (p, p)."""
        return np.asarray(self.inverse @ self.inverse.T)

    @cached_property
    def _estimable_basis(self) -> Array:
        _, s, vt = np.linalg.svd(self.r, full_matrices=False)
        return np.asarray(vt[s > ALIAS_TOLERANCE * s[0]])

    def estimable(self, rows: Array) -> Flags:
        """Whether each linear combination of coefficients can be estimated, shape (m,)."""
        if self.is_triangular:  # of full rank: every coefficient can
            return np.ones(len(rows), dtype=bool)
        scaled = rows / self.scale
        basis = self._estimable_basis
        outside = scaled - scaled @ basis.T @ basis
        size = np.maximum(np.linalg.norm(scaled, axis=1), 1e-300)
        return np.asarray(np.linalg.norm(outside, axis=1) <= 1e-8 * size)

    def space(self, i: int, kind: str) -> TermSpace:
        """Directions of term ``i`` given the terms that a type of sums of squares names.

        Parameters
        ----------
        i : int
            Number of the term.
        kind : {"I", "II", "III"}
            Given the terms before it; given every term that does not contain it; given all
            others.
        """
        if (kind, i) not in self._spaces:
            others = _others(self.matrix.terms, i, kind)
            basis = self._basis_of_full(i, others, kind) if self.is_triangular else None
            self._spaces[kind, i] = (
                self._space(i, others) if basis is None else TermSpace(basis, basis.shape[1])
            )
        return self._spaces[kind, i]

    @cached_property
    def _is_block_diagonal(self) -> bool:
        rest = np.abs(self.r)
        for block in self.matrix.blocks:
            rest[block, block] = 0.0
        return bool(rest.max(initial=0.0) < _ORTHOGONAL)

    def _basis_of_full(self, i: int, others: list[int], kind: str) -> Array:
        """Directions of a term where nothing is aliased, without factoring all columns again."""
        own = self.matrix.blocks[i]
        if kind == "I" or self._is_block_diagonal:
            return np.eye(self.rank)[:, own]
        if kind == "III":
            # R^-1 R = 1: these rows of the inverse are orthogonal to the columns of all others
            rows = self.inverse[own] * self.scale[own, None]
            return np.asarray(np.linalg.qr((rows / np.linalg.norm(rows, axis=1)[:, None]).T)[0])
        blocks = [self.r[:, self.matrix.blocks[j]] for j in others]
        q = np.linalg.qr(np.hstack([*blocks, self.r[:, own]]))[0]
        return np.asarray(q[:, q.shape[1] - (own.stop - own.start) :])

    def _space(self, i: int, others: list[int]) -> TermSpace:
        own = self.r[:, self.matrix.blocks[i]]
        rest = np.hstack([self.r[:, self.matrix.blocks[j]] for j in others])
        basis = complement(rest, own)
        nominal = int(span(own).shape[1])
        aliases = self._aliases(i, others) if basis.shape[1] < nominal else ()
        return TermSpace(basis, nominal, aliases)

    def _aliases(self, i: int, others: list[int]) -> tuple[str, ...]:
        """Terms that hold, alone, a direction of term ``i``."""
        own = span(self.r[:, self.matrix.blocks[i]])
        found = []
        for j in others:
            overlap = span(self.r[:, self.matrix.blocks[j]]).T @ own
            if overlap.size and np.linalg.norm(overlap, 2) > 1 - 1e-9:
                found.append(term_name(self.matrix.terms[j]) or "mean")
        return tuple(found)

    def is_orthogonal(self) -> bool:
        """Whether the terms span orthogonal spaces, so that all types of sums agree."""
        gram = self.r.T @ self.r
        for block in self.matrix.blocks:
            gram[block, block] = 0.0
        return bool(np.abs(gram).max() < 1e-9)


def factorize(matrix: ModelMatrix) -> Factorization:
    """Factor the columns of a model.

    Parameters
    ----------
    matrix : ModelMatrix
        Columns of shape (n, p); they may depend on each other.

    Returns
    -------
    Factorization
        Of rank r, the number of columns that are not aliased.
    """
    scale = np.linalg.norm(matrix.columns, axis=0)
    scale[scale == 0] = 1.0
    scaled = matrix.columns / scale
    cells = distinct_rows(scaled)
    q, r = np.linalg.qr(scaled if cells is None else cells.rows)
    if not _is_regular(r):
        u, s, _ = np.linalg.svd(r)
        rank = int(np.count_nonzero(s > ALIAS_TOLERANCE * np.sqrt(r.shape[1])))
        if rank < r.shape[1]:
            q = q @ u[:, :rank]
            r = u[:, :rank].T @ r
    return Factorization(matrix, q if cells is None else cells.spread(q), r, scale)


def _is_regular(r: Array) -> bool:
    """Whether a square triangle is certainly of full rank: 1 / |R^-1| bounds its singular values.

    The norm of Frobenius is never below that of the largest singular value.
    """
    if r.shape[0] < r.shape[1]:
        return False
    inverse = _inverse(r)
    if inverse is None:
        return False
    return bool(np.linalg.norm(inverse) * ALIAS_TOLERANCE * np.sqrt(r.shape[1]) < 1)


def _inverse(r: Array) -> Array | None:
    """Inverse of an upper triangle; None where a number on its diagonal is zero."""
    found, info = linalg.lapack.dtrtri(r)
    return np.asarray(found) if info == 0 and np.isfinite(found).all() else None


def _others(terms: Sequence[Term], i: int, kind: str) -> list[int]:
    if kind == "I":
        return list(range(i))
    rest = [j for j in range(len(terms)) if j != i]
    if kind == "III":
        return rest
    return [j for j in rest if not set(terms[i]) < set(terms[j])]


def span(columns: Array) -> Array:
    """Orthonormal basis of the columns, shape (r, rank).

    Parameters
    ----------
    columns : ndarray, shape (r, m)
        A direction counts if it is longer than 1e-9 times the longest column, and than 1e-9.
    """
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
    """Distinct rows of a tall matrix; None where there are few rows, or few that repeat.

    Parameters
    ----------
    columns : ndarray, shape (n, p)
        Few rows are fewer than 2,000; few repeat where a distinct row stands for fewer than four on
        average.
    """
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
    """Orthonormal basis of what ``own`` adds to ``rest``, shape (r, df).

    Parameters
    ----------
    rest, own : ndarray, shapes (r, m) and (r, k)
        Columns in the same r rows; ``own`` may lie in the span of ``rest``, and df is then 0.
    """
    base = span(rest)
    left = own - base @ (base.T @ own)
    left = left - base @ (base.T @ left)
    length = np.linalg.norm(own, axis=0)
    length[length == 0] = 1.0
    return span(left / length)
