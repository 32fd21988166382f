"""Largest and smallest prediction in the box of coded factors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy import optimize

from study.arrays import Array

#: most factors whose corners are all asked: 2^10 = 1,024
CORNERS = 10

#: best points from which the search goes on
STARTS = 5

#: a coordinate this near to 1 in size lies on the boundary
BOUNDARY = 1e-6


@dataclass(frozen=True)
class Extreme:
    """A largest or smallest prediction.

    Parameters
    ----------
    at : array, shape (k,)
        Coded settings.
    value : float
        Prediction, in the response's unit.
    half_width : float
        Half of the interval around it, in the same unit.
    """

    at: Array
    value: float
    half_width: float

    @property
    def on_boundary(self) -> bool:
        """Whether a factor stands at an end of its range."""
        return bool(np.abs(self.at).max() >= 1.0 - BOUNDARY)


def box_points(k: int, n: int, seed: int = 0) -> Array:
    """Points that fill the box [-1, 1]^k evenly, shape (n, k); n is a power of two.

    Parameters
    ----------
    k : int
        Number of factors.
    n : int
        Number of points.
    seed : int
        Of the scrambled Sobol sequence.
    """
    from scipy.stats import qmc

    return np.asarray(2.0 * qmc.Sobol(k, seed=seed).random(n) - 1.0)


def extremes(value: Callable[[Array], Array], k: int, half_width: float) -> tuple[Extreme, Extreme]:
    """Smallest and largest prediction in the box.

    Parameters
    ----------
    value : callable
        Predictions of shape (n,) at coded points of shape (n, k).
    k : int
        Number of factors.
    half_width : float
        Half of the interval around a prediction.
    """
    points = box_points(k, 4096)
    if k <= CORNERS:
        points = np.vstack([points, np.array(list(product((-1.0, 1.0), repeat=k)))])
    values = value(points)
    low = _polished(value, points[np.argsort(values)[:STARTS]], 1.0, half_width)
    high = _polished(value, points[np.argsort(-values)[:STARTS]], -1.0, half_width)
    return low, high


def _polished(
    value: Callable[[Array], Array], starts: Array, sign: float, half_width: float
) -> Extreme:
    scale = float(np.abs(value(starts)).max()) or 1.0

    def goal(x: Array) -> float:
        return sign * float(value(x[None, :])[0]) / scale

    bounds = [(-1.0, 1.0)] * starts.shape[1]
    found = [optimize.minimize(goal, x, method="L-BFGS-B", bounds=bounds).x for x in starts]
    best = min([*found, *starts], key=goal)
    return Extreme(np.asarray(best), float(value(best[None, :])[0]), half_width)
