"""Correlation of two points by their distance, with one length scale a factor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.distance import cdist

from study.arrays import Array, Ints
from study.response_surface.emulator.category_correlation import CategoryCorrelation

Family = Literal["Matern 5/2", "Gaussian"]
FAMILIES: tuple[Family, ...] = ("Matern 5/2", "Gaussian")

#: degrees of freedom of the t distribution that is the spectrum of Matern 5/2
SPECTRAL_DF = 5


@dataclass(frozen=True)
class Kernel:
    """A stationary correlation (Rasmussen and Williams 2006, section 4.2).

    Parameters
    ----------
    family : {"Matern 5/2", "Gaussian"}
        Twice differentiable, or without end.
    lengths : array, shape (k,)
        Length scales, in the unit box.
    categories : CategoryCorrelation, optional
        Where the runs belong to combinations of categories: points have the number of theirs in
        a last column, and correlations are multiplied by those of the combinations.
    """

    family: Family
    lengths: Array
    categories: CategoryCorrelation | None = None

    def correlation(self, x: Array, other: Array) -> Array:
        """Correlations, shape (n, m), of points of shape (n, k) and (m, k)."""
        if self.family == "Gaussian":
            found = np.asarray(np.exp(-0.5 * self._squared(x, other)))
        else:
            a = np.sqrt(5.0 * self._squared(x, other))
            found = np.asarray((1.0 + a + a * a / 3.0) * np.exp(-a))
        return self._among(found, x, other)

    def with_slope(self, x: Array) -> tuple[Array, Array]:
        """Correlations R of points of shape (n, k), and H: dR/d ln l_j = H (x_ij - x_kj)^2/l_j^2.

        All slopes share H, so that no array of n times n times k numbers is ever made.
        """
        squared = self._squared(x, x)
        if self.family == "Gaussian":
            r = self._among(np.exp(-0.5 * squared), x, x)
            return r, r
        a = np.sqrt(5.0 * squared)
        decay = self._among(np.exp(-a), x, x)
        return (1.0 + a + a * a / 3.0) * decay, 5.0 / 3.0 * (1.0 + a) * decay

    def numbers(self, x: Array) -> Array:
        """Columns (n, k) of the points that are no categories."""
        return x[:, : self.lengths.size]

    def combination(self, x: Array) -> Ints:
        """Give the combination of categories of each point, shape (n,); 0 where there are none."""
        if self.categories is None:
            return np.zeros(len(x), dtype=np.int64)
        return np.asarray(x[:, -1], dtype=np.int64)

    def constants(self, x: Array) -> Array:
        """Columns (n, p) of the constant mean of every combination of categories."""
        p = 1 if self.categories is None else len(self.categories.matrix)
        return np.asarray(np.eye(p)[self.combination(x)])

    def _among(self, found: Array, x: Array, other: Array) -> Array:
        if self.categories is None:
            return found
        rows, columns = self.combination(x), self.combination(other)
        return np.asarray(found * self.categories.matrix[np.ix_(rows, columns)])

    def frequencies(self, rng: np.random.Generator, n: int) -> Array:
        """Draw frequencies, shape (n, k), from the spectrum of the correlation (Bochner)."""
        normal = rng.standard_normal((n, self.lengths.size))
        if self.family == "Matern 5/2":
            normal /= np.sqrt(rng.chisquare(SPECTRAL_DF, (n, 1)) / SPECTRAL_DF)
        return np.asarray(normal / self.lengths)

    def _squared(self, x: Array, other: Array) -> Array:
        scaled = (self.numbers(points) / self.lengths for points in (x, other))
        return np.asarray(cdist(*scaled, "sqeuclidean"))
