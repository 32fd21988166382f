"""Correlation of the functions that belong to categories: what they share, and what each has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np

from study.arrays import Array

#: distances of a category from the shared part: below, it is the shared part; beyond, alone
DISTANCES = (1e-5, 3.0)

#: where the first search begins: two categories correlate by .82
FIRST_DISTANCE = 0.1
RESTART_DISTANCES = (0.01, 1.0)


@dataclass(frozen=True)
class CategoryCorrelation:
    """Correlation exp(-(d_r + d_s)) of categories r and s, multiplied over the factors.

    McMillan, Sacks, Welch and Gao (1999, J. Biopharm. Stat. 9, 417), in the family of Qian, Wu
    and Wu (2008, Technometrics 50, 383). The function of category r is exp(-d_r) times one that
    all share, and the rest its own. With equal distances it is the exchangeable correlation; one
    distance is fitted to two categories, for only the sum of theirs counts.

    Parameters
    ----------
    distances : tuple of array, shape (c,)
        Of every category of each factor, from the shared part; positive.
    """

    distances: tuple[Array, ...]

    @classmethod
    def of(cls, values: Array, sizes: Sequence[int]) -> CategoryCorrelation:
        """Read what is fitted, shape (`fitted(sizes)`,)."""
        parts = np.split(values, np.cumsum([_own(c) for c in sizes])[:-1])
        return cls(tuple(np.broadcast_to(p, c) for p, c in zip(parts, sizes, strict=True)))

    @cached_property
    def matrix(self) -> Array:
        """Correlations, shape (p, p), of all combinations; the last factor changes fastest."""
        return reduce(np.kron, [np.exp(m) for m in self._logarithms])

    @cached_property
    def parts(self) -> Array:
        """Weights, shape (p, p), of independent functions: a root of the matrix."""
        return np.asarray(np.linalg.cholesky(self.matrix + 1e-12 * np.eye(len(self.matrix))))

    def slopes(self) -> list[Array]:
        """List the derivatives of ln(matrix) by the logarithm of each distance that is fitted."""
        found = []
        for q, own in enumerate(self.distances):
            c = own.size
            for r in range(_own(c)):
                slope = np.zeros((c, c))
                slope[r, :] -= own[r]
                slope[:, r] -= own[r]
                if c == 2:  # both are the same number
                    slope[:] = -2.0 * own[0]
                np.fill_diagonal(slope, 0.0)
                around = [np.zeros_like(m) for m in self._logarithms]
                around[q] = slope
                found.append(_spread(around))
        return found

    @cached_property
    def _logarithms(self) -> list[Array]:
        made = [-(own[:, None] + own) for own in self.distances]
        for one in made:
            np.fill_diagonal(one, 0.0)
        return made


def fitted(sizes: Sequence[int]) -> int:
    """Count the distances that are fitted to factors with so many categories.

    Parameters
    ----------
    sizes : sequence of int
        Number of categories of each factor; two of them need one distance, c > 2 need c.
    """
    return sum(_own(c) for c in sizes)


def _own(c: int) -> int:
    return 1 if c == 2 else c


def _spread(logarithms: Sequence[Array]) -> Array:
    """Sum over the factors, shape (p, p), as the Kronecker product multiplies."""

    def summed(a: Array, b: Array) -> Array:
        return np.asarray(np.kron(a, np.ones_like(b)) + np.kron(np.ones_like(a), b))

    return reduce(summed, logarithms)
