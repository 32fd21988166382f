"""Least squares with two factors and no interaction, by elimination of the larger one.

With 1,000 cells in 100 blocks the orthonormal columns of the model are 100,000 x 1,099 numbers,
almost all of them zero before they are made orthogonal. The normal equations of two factors are
diagonal in each; what is left after one is eliminated has the size of the other (Searle 1987,
Linear Models for Unbalanced Data, section 4.9).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from study.arrays import Array, Ints

# eigenvalues of the reduced equations below this share of the largest are of parts of the table
# that no row connects
_SINGULAR = 1e-10


@dataclass(frozen=True)
class _Equations:
    """Normal equations after the first factor is eliminated."""

    first: Ints
    second: Ints
    counts: Array

    @cached_property
    def rows_first(self) -> Array:
        return np.asarray(self.counts.sum(axis=1))

    @cached_property
    def share(self) -> Array:
        """Part of each level of the second factor in the rows of each level of the first."""
        return np.asarray(self.counts / self.rows_first[:, None])

    @cached_property
    def _solved(self) -> tuple[Array, int]:
        """Pseudo-inverse of the reduced equations, and its rank."""
        reduced = np.diag(self.counts.sum(axis=0)) - self.counts.T @ self.share
        values, vectors = np.linalg.eigh(reduced)
        kept = values > _SINGULAR * values.max(initial=0.0)
        root = vectors[:, kept] / np.sqrt(values[kept])
        return root @ root.T, int(kept.sum())

    @property
    def inverse(self) -> Array:
        return self._solved[0]

    @property
    def rank(self) -> int:
        return int(self.counts.shape[0]) + self._solved[1]

    def project(self, y: Array) -> Array:
        """Part of ``y`` that the two factors describe."""
        means = np.bincount(self.first, y, self.counts.shape[0]) / self.rows_first
        left = np.bincount(self.second, y, self.counts.shape[1]) - self.counts.T @ means
        effect = self.inverse @ left
        return np.asarray((means - self.share @ effect)[self.first] + effect[self.second])

    def leverage(self) -> Array:
        inverse = self.inverse
        across = self.share @ inverse
        own = np.einsum("ab,ab->a", across, self.share)
        by_pair = (np.diag(inverse) - 2 * across) + (own + 1 / self.rows_first)[:, None]
        return np.asarray(by_pair[self.first, self.second])


@dataclass(frozen=True)
class TwoWayFit:
    """Fit of two factors without interaction.

    Parameters
    ----------
    fitted, residual : ndarray, shape (n,)
        In the units of the response.
    leverage : ndarray, shape (n,)
        Diagonal of the hat matrix.
    rank : int
        Rank of the model.
    rss, tss : float
        Residual and corrected total sums of squares.
    """

    equations: _Equations
    fitted: Array
    residual: Array
    leverage: Array
    rank: int
    rss: float
    tss: float

    @property
    def df_residual(self) -> int:
        """Residual degrees of freedom."""
        return int(self.residual.size - self.rank)

    def projected(self, y: Array) -> Array:
        """Part of other values that the model describes, shape (n,)."""
        return self.equations.project(y)

    @property
    def columns(self) -> None:
        """No columns: they are what is spared."""
        return None


def two_way(first: Ints, second: Ints, y: Array) -> TwoWayFit:
    """Fit the levels of two factors, unbalanced or not.

    Parameters
    ----------
    first, second : ndarray of int, shape (n,)
        Level of each factor in every row; every level occurs.
    y : ndarray, shape (n,)
        Response.

    Returns
    -------
    TwoWayFit
        What is left over, and the leverage of every row.

    Examples
    --------
    >>> fit = two_way(np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1]), np.array([1.0, 2, 3, 5]))
    >>> fit.residual.round(6).tolist(), fit.leverage.round(6).tolist()
    ([0.25, -0.25, -0.25, 0.25], [0.75, 0.75, 0.75, 0.75])
    """
    a, b = int(first.max()) + 1, int(second.max()) + 1
    if a < b:
        first, second, a, b = second, first, b, a
    counts = np.bincount(first * b + second, minlength=a * b).reshape(a, b).astype(float)
    equations = _Equations(first, second, counts)
    shifted = y - y[0]
    residual = shifted - equations.project(shifted)
    # a second projection removes what rounding left of the model in the residual
    residual = residual - equations.project(residual)
    centered = shifted - shifted.mean()
    return TwoWayFit(
        equations,
        y - residual,
        residual,
        equations.leverage(),
        equations.rank,
        float(residual @ residual),
        float(centered @ centered),
    )
