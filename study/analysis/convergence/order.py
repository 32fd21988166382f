"""Order of a refinement series: through three meshes, by least squares, and how sure it is.

References: Celik et al. (2008), J. Fluids Eng. 130, 078001 (three meshes, unequal ratios);
Eca and Hoekstra (2014), J. Comput. Phys. 262, 104-130 (least squares for four or more).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from study.arrays import Array

#: an order that the algebraic error moves by more than this is not carried by the data
RESOLVED_ORDER = 0.05

#: two triples of meshes that differ by less in order are in the asymptotic range
SAME_ORDER = 0.3
_LOWEST = 0.05
_HIGHEST = 20.0


def classify(h: Array, f: Array, tolerance: float = 0.0) -> str:
    """Behaviour of the finest three meshes (all of them for the noise floor).

    Parameters
    ----------
    h, f : ndarray, shape (n,)
        Mesh sizes and values, fine to coarse, n >= 3.
    tolerance : float
        Bound of the algebraic error of every value; changes up to ten of it are noise.

    Returns
    -------
    str
        "noise-floor", "inconclusive", "monotone", "oscillatory" or "divergent"; inconclusive where
        one of the two changes is noise alone.

    Examples
    --------
    >>> classify(np.array([1, 2, 2.6]), np.array([1.0, 2.0, 2.6]))
    'monotone'
    >>> classify(np.array([1, 2, 4.0]), np.array([4.0, 2.0, 1.0]))
    'divergent'
    """
    floor = max(10 * tolerance, 4 * float(np.spacing(np.abs(f).max())))
    if float(np.abs(np.diff(f)).max()) <= floor:
        return "noise-floor"
    e21, e32 = f[1] - f[0], f[2] - f[1]
    if min(abs(e21), abs(e32)) <= floor:
        return "inconclusive"
    ratio, limit = e21 / e32, math.log(h[1] / h[0]) / math.log(h[2] / h[1])
    if 0 < ratio < limit * (1 - 1e-12):
        return "monotone"
    return "oscillatory" if -1 <= ratio < 0 else "divergent"


@dataclass(frozen=True)
class OrderFit:
    """Order and limit of a monotone series.

    Parameters
    ----------
    order, extrapolated : float
        p and f0 of f = f0 + C h^p.
    scatter, misfit : float
        Standard deviation of the fit, and its miss at the finest mesh; zero for three meshes.
    consistent : bool
        Whether the two finest triples of meshes agree in order.
    interval : tuple of float
        Orders that values within the algebraic error could have.
    """

    order: float
    extrapolated: float
    scatter: float = 0.0
    misfit: float = 0.0
    consistent: bool = True
    interval: tuple[float, float] = (0.0, 0.0)

    @property
    def carried(self) -> bool:
        """Whether the values determine the order to within 0.05."""
        return (self.interval[1] - self.interval[0]) / 2 <= RESOLVED_ORDER


def fitted_order(h: Array, f: Array, tolerance: float = 0.0) -> OrderFit:
    """Order of a series that was found monotone, fine to coarse.

    Parameters
    ----------
    h, f : ndarray, shape (n,)
        Mesh sizes and values, n >= 3.
    tolerance : float
        Bound of the algebraic error of every value.
    """
    if h.size == 3:
        p = observed_order(h, f)
        limit = f[0] + (f[0] - f[1]) / ((h[1] / h[0]) ** p - 1)
        fit = OrderFit(p, float(limit))
        return replace(fit, interval=_three_mesh_interval(h, f, tolerance, p))
    fit = _least_squares(h, f)
    half = _fitted_half_width(h, f, tolerance, fit.order)
    return replace(fit, interval=(max(fit.order - half, 0.0), fit.order + half))


def observed_order(h: Sequence[float] | Array, f: Sequence[float] | Array) -> float:
    """Order p of f = f0 + C h^p through three meshes, fine to coarse.

    The root of (r21^p - 1) / (r21^p (r32^p - 1)) = e21 / e32, which is where the fixed point
    of Celik et al. (2008) ends; a bracketed root also converges for ratios near 1.

    Parameters
    ----------
    h, f : sequence of float or ndarray, shape (3,)
        Mesh sizes, of which only the ratios count, and values of a monotone series.
    """
    return _order(h, (f[1] - f[0]) / (f[2] - f[1]))


def _order(h: Sequence[float] | Array, ratio: float) -> float:
    from scipy.optimize import brentq

    a, b = math.log(h[1] / h[0]), math.log(h[2] / h[1])
    target = math.log(ratio)

    def mismatch(p: float) -> float:
        # logarithm of the ratio, without overflow for a large p
        return math.log(-math.expm1(-p * a)) - math.log(-math.expm1(-p * b)) - p * b - target

    low, high = 1e-8, 1.0
    while mismatch(high) > 0 and high < 1e3:
        high *= 2
    if mismatch(low) <= 0:
        return low
    return float(brentq(mismatch, low, high, xtol=1e-14, rtol=1e-14))


def _three_mesh_interval(h: Array, f: Array, tolerance: float, p: float) -> tuple[float, float]:
    """Orders when the middle value and an outer one err by the tolerance in opposite ways."""
    if tolerance == 0:
        return p, p
    e21, e32 = abs(f[1] - f[0]), abs(f[2] - f[1])
    least = max(e32 - 2 * tolerance, 1e-300)
    low = _order(h, (e21 + 2 * tolerance) / least)
    smallest = e21 - 2 * tolerance
    high = math.inf if smallest <= 0 else _order(h, smallest / (e32 + 2 * tolerance))
    return low, high


def _least_squares(h: Array, f: Array) -> OrderFit:
    """Fit f0 + a h^p, plain and weighted by 1/h; the one with less scatter is kept."""
    candidates = [_weighted_fit(h, f, weight) for weight in (np.ones_like(h), 1 / h)]
    p, limit, slope, scatter = min(candidates, key=lambda item: item[3])
    misfit = float(abs(f[0] - limit - slope * h[0] ** p))
    agree = False
    if classify(h[1:], f[1:]) == "monotone":
        gap = abs(observed_order(h[:3], f[:3]) - observed_order(h[1:4], f[1:4]))
        agree = gap <= SAME_ORDER
    return OrderFit(p, limit, scatter, misfit, agree)


def _weighted_fit(h: Array, f: Array, weight: Array) -> tuple[float, float, float, float]:
    """Order, limit, slope and scatter of one weighted fit."""
    from scipy.optimize import minimize_scalar

    solve = _linear_part(h, f, weight)
    orders = np.geomspace(_LOWEST, _HIGHEST, 120)
    best = int(np.argmin([solve(p)[1] for p in orders]))
    low, high = orders[max(best - 1, 0)], orders[min(best + 1, orders.size - 1)]
    found = minimize_scalar(
        lambda p: solve(p)[1], bounds=(low, high), method="bounded", options={"xatol": 1e-13}
    )
    p = float(found.x)
    (limit, slope), rss = solve(p)
    scatter = math.sqrt(rss * h.size / (h.size - 3))
    return p, float(limit + f[0]), float(slope / h[-1] ** p), scatter


def _linear_part(h: Array, f: Array, weight: Array) -> Callable[[float], tuple[Array, float]]:
    """Limit and slope by linear least squares at a given order, with the sum of squares."""
    root = np.sqrt(weight / weight.sum())
    x, y = h / h[-1], f - f[0]

    def solve(p: float) -> tuple[Array, float]:
        columns = np.column_stack([root, root * x**p])
        coefficients, *_ = np.linalg.lstsq(columns, root * y, rcond=None)
        rest = root * y - columns @ coefficients
        return coefficients, float(rest @ rest)

    return solve


def _fitted_half_width(h: Array, f: Array, tolerance: float, p: float) -> float:
    """Sum over the values of what an error of the tolerance does to the fitted order."""
    if tolerance == 0:
        return 0.0
    moved = 0.0
    for k in range(h.size):
        changed = f.copy()
        changed[k] += tolerance
        moved += abs(_least_squares(h, changed).order - p)
    return moved
