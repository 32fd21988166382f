"""Correlation of two points by their distance, with one length scale a factor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.distance import cdist

from study.arrays import Array

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
    """

    family: Family
    lengths: Array

    def correlation(self, x: Array, other: Array) -> Array:
        """Correlations, shape (n, m), of points of shape (n, k) and (m, k)."""
        if self.family == "Gaussian":
            return np.asarray(np.exp(-0.5 * self._squared(x, other)))
        a = np.sqrt(5.0 * self._squared(x, other))
        return np.asarray((1.0 + a + a * a / 3.0) * np.exp(-a))

    def with_slope(self, x: Array) -> tuple[Array, Array]:
        """Correlations R of points of shape (n, k), and H: dR/d ln l_j = H (x_ij - x_kj)^2/l_j^2.

        All slopes share H, so that no array of n times n times k numbers is ever made.
        """
        squared = self._squared(x, x)
        if self.family == "Gaussian":
            r = np.exp(-0.5 * squared)
            return r, r
        a = np.sqrt(5.0 * squared)
        decay = np.exp(-a)
        return (1.0 + a + a * a / 3.0) * decay, 5.0 / 3.0 * (1.0 + a) * decay

    def frequencies(self, rng: np.random.Generator, n: int) -> Array:
        """Draw frequencies, shape (n, k), from the spectrum of the correlation (Bochner)."""
        normal = rng.standard_normal((n, self.lengths.size))
        if self.family == "Matern 5/2":
            normal /= np.sqrt(rng.chisquare(SPECTRAL_DF, (n, 1)) / SPECTRAL_DF)
        return np.asarray(normal / self.lengths)

    def _squared(self, x: Array, other: Array) -> Array:
        return np.asarray(cdist(x / self.lengths, other / self.lengths, "sqeuclidean"))
