"""Where the surface is level, and what it is there (canonical analysis)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from study.arrays import Array, Flags
from study.response_surface.quadratic.polynomial import Polynomial

#: an eigenvalue below this part of the largest makes a ridge: the point slides along it
RIDGE = 0.05

#: points of the box at which the confidence region is asked for
SEARCHED = 4096

Kind = Literal["maximum", "minimum", "saddle", "ridge"]


@dataclass(frozen=True)
class StationaryPoint:
    """Point with gradient zero.

    Parameters
    ----------
    kind : {"maximum", "minimum", "saddle", "ridge"}
        By the signs of the eigenvalues; a ridge if one is below 5 % of the largest.
    at : array, shape (k,)
        Coded settings.
    value : float
        Response there, in its unit.
    eigenvalues : array, shape (k,)
        Of B, in the response's unit, in ascending order.
    eigenvectors : array, shape (k, k)
        One column an eigenvalue, in coded factors.
    inside : bool
        Whether it lies in the box.
    region : Region or None
        Where it may be; None without enough blocks.
    """

    kind: Kind
    at: Array
    value: float
    eigenvalues: Array
    eigenvectors: Array
    inside: bool
    region: Region | None = None

    @property
    def established(self) -> bool:
        """Whether it is known to lie in the box."""
        return self.inside and (self.region is None or not self.region.leaves)


@dataclass(frozen=True)
class Region:
    """95 % confidence region of the stationary point, as far as it lies in the box.

    Parameters
    ----------
    low, high : array, shape (k,)
        Its extent in coded factors; NaN if no point of the box belongs to it.
    leaves : bool
        Whether it reaches the boundary of the box, and may go on beyond it.
    """

    low: Array
    high: Array
    leaves: bool


def stationary_point(surface: Polynomial) -> StationaryPoint | None:
    """Canonical analysis of a surface (Box and Wilson 1951).

    Parameters
    ----------
    surface : Polynomial
        In k coded factors; a square that is not among its terms counts as zero.

    Returns
    -------
    StationaryPoint or None
        None where B is singular: the surface is level nowhere or along a line.
    """
    matrix = surface.quadratic()
    eigenvalues, vectors = np.linalg.eigh(matrix)
    largest = float(np.abs(eigenvalues).max())
    if largest == 0 or float(np.abs(eigenvalues).min()) < 1e-12 * largest:
        return None
    at: Array = np.asarray(-0.5 * np.linalg.solve(matrix, surface.linear()), dtype=np.float64)
    inside = bool(np.abs(at).max() <= 1.0)
    value = float(surface.value(at[None, :])[0])
    return StationaryPoint(_kind(eigenvalues), at, value, eigenvalues, vectors, inside)


def _kind(eigenvalues: Array) -> Kind:
    if np.abs(eigenvalues).min() < RIDGE * np.abs(eigenvalues).max():
        return "ridge"
    if eigenvalues.max() < 0:
        return "maximum"
    return "minimum" if eigenvalues.min() > 0 else "saddle"


def in_region(surfaces: Sequence[Polynomial], coded: Array, level: float = 0.95) -> Flags:
    """Whether the blocks' gradients at each point may have the mean zero (Hotelling's T^2).

    Parameters
    ----------
    surfaces : sequence of Polynomial
        One a block; more of them than factors.
    coded : array, shape (n, k)
        Coded points.
    level : float
        Probability that the true point belongs to the region.
    """
    from scipy import stats

    b, k = len(surfaces), surfaces[0].k
    gradients = np.stack([surface.gradient(coded) for surface in surfaces])  # (b, n, k)
    mean = gradients.mean(axis=0)
    centred = gradients - mean
    covariance = np.einsum("bni,bnj->nij", centred, centred) / (b - 1)
    t2 = b * np.einsum("ni,nij,nj->n", mean, np.linalg.pinv(covariance), mean)
    limit = k * (b - 1) / (b - k) * stats.f.ppf(level, k, b - k)
    return np.asarray(t2 <= limit)


def region_of(surfaces: Sequence[Polynomial], points: Array) -> Region | None:
    """Confidence region over the box.

    Parameters
    ----------
    surfaces : sequence of Polynomial
        One a block.
    points : array, shape (n, k)
        Coded points that fill the box.

    Returns
    -------
    Region or None
        None unless there are more blocks than factors.
    """
    k = surfaces[0].k
    if len(surfaces) <= k:
        return None
    member = points[in_region(surfaces, points)]
    nowhere = np.full(k, np.nan)
    low, high = (member.min(axis=0), member.max(axis=0)) if len(member) else (nowhere, nowhere)
    return Region(low, high, _touches(surfaces, points))


def _touches(surfaces: Sequence[Polynomial], points: Array) -> bool:
    """Whether the region reaches a face of the box."""
    for j in range(points.shape[1]):
        for side in (-1.0, 1.0):
            face = points.copy()
            face[:, j] = side
            if in_region(surfaces, face).any():
                return True
    return False
