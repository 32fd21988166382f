"""Simulated refinements of a contrast of two cells: the errors that its bound must hold.

A cell's error is A (C (h/ha)^p + G/2 (h/hc)^(p+1) (hc/ha)^p + 2 % noise) with ha the mesh
analyzed and hc the coarsest; the constants of the cells are normal, or of one sign, with a
given correlation; the study estimates the contrast from 9 blocks with standard error se.
All values are in units of the practical difference.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.special import stdtrit

from study.statistics.convergence.contrast_bound import (
    FLOOR,
    difference_bounds,
    inherited_uncertainty,
    response_bounds,
)
from study.statistics.convergence.grid_convergence import series_bounds

BLOCKS = 9
WEIGHTS = np.array([1.0, -1.0])
#: true orders of the two cells, and the formal orders given (None for none)
ORDERS = {
    "2": ((2.0, 2.0), (2.0, 2.0)),
    "1": ((1.0, 1.0), (1.0, 1.0)),
    "1.5 said to be 2": ((1.5, 1.5), (2.0, 2.0)),
    "0.7 said to be 1": ((0.7, 0.7), (1.0, 1.0)),
    "1 against 2": ((1.0, 2.0), (1.0, 2.0)),
    "none given": ((2.0, 2.0), (None, None)),
}


@dataclass(frozen=True)
class Setting:
    """One point of the grid."""

    orders: str = "2"
    one_sign: bool = False
    correlation: float = 0.8
    error: float = 0.3
    ratio: float = 2.0
    se: float = 0.1
    coarsest: bool = False


def settings():
    """The whole grid."""
    axes = {
        "orders": list(ORDERS), "one_sign": [False, True], "correlation": [0.0, 0.8, 1.0],
        "error": [0.1, 0.3, 1.0], "ratio": [1.5, 2.0], "se": [0.02, 0.1],
        "coarsest": [False, True],
    }  # fmt: skip
    return [Setting(*values) for values in product(*axes.values())]


def constants(rng, n, cells, at):
    """Equicorrelated constants of the cells, mean square 1."""
    rho = at.correlation
    common, own = rng.standard_normal((n, 1)), rng.standard_normal((n, cells))
    drawn = np.sqrt(rho) * common + np.sqrt(1 - rho) * own
    return np.abs(drawn) if at.one_sign else drawn


def errors(rng, n, at, orders, h):
    """Errors of the cells on each mesh, shape (n, meshes, cells)."""
    analyzed = h[-1] if at.coarsest else h[0]
    leading, second = (constants(rng, n, orders.size, at)[:, None, :] for _ in range(2))
    x, coarse = h[:, None] / analyzed, h[-1] / analyzed
    decay = x**orders
    bent = 0.5 * second * (h[:, None] / h[-1]) ** (orders + 1) * coarse**orders
    noise = 0.02 * decay * rng.standard_normal((n, h.size, orders.size))
    return at.error * (leading * decay + bent + noise)


def bounded(kind, at, n, seed, noise=0.0):
    """True error of the contrast on the mesh analyzed, and the bound of ``kind``.

    ``kind`` is "three", "two", or "inherited 1" to "inherited 4"; growing changes up to
    ``noise`` are taken for noise of the meshes, larger ones for divergence.
    """
    rng = np.random.default_rng(seed)
    meshes = 2 if kind == "two" else 3
    h = at.ratio ** np.arange(float(meshes))
    true, formal = ORDERS[at.orders]
    place = meshes - 1 if at.coarsest else 0
    if kind.startswith("inherited"):
        return _inherited(rng, at, n, h, int(kind.split()[1]), place)
    values = errors(rng, n, at, np.array(true), h)
    parts = [[0, 1]] if true[0] == true[1] else [[0], [1]]
    u = sum(
        composed(values[..., cells], WEIGHTS[cells], h, formal[cells[0]], noise) for cells in parts
    )
    moved = np.abs((values[:, place] - values[:, 0]) @ WEIGHTS)
    return values[:, place] @ WEIGHTS, np.asarray(u + moved)


def composed(values, weights, h, formal, noise):
    """Bound within one discretization, as ``contrast_uncertainty`` composes it, for many."""
    sizes = h.tolist()
    cells = np.moveaxis(values, -1, -2)
    ceiling = response_bounds(cells, sizes, formal, noise) @ np.abs(weights)
    bound = difference_bounds(values @ weights, sizes, formal)
    with np.errstate(invalid="ignore"):
        return np.minimum(np.maximum(bound, FLOOR * ceiling), ceiling)


def _inherited(rng, at, n, h, m, place):
    """Cells 0 and 1 are those of the contrast, the other m were refined."""
    true, formal = ORDERS[at.orders]
    values = errors(rng, n, at, np.full(2 + m, true[0]), h)
    refined = np.moveaxis(values[..., 2:], -1, -2)
    error, bound = limits(refined, h, formal[0], place)
    u = [
        inherited_uncertainty(WEIGHTS, e, b) if np.isfinite(b).all() else np.inf
        for e, b in zip(error, bound, strict=True)
    ]
    return values[:, place, :2] @ WEIGHTS, np.array(u)


def limits(f, h, formal, place):
    """Signed errors and bounds of cells, as ``limit_of`` finds them, for many."""
    used = series_bounds(h, f, formal).order_used
    fine = np.where(np.isnan(used), 0.0, (f[..., 1] - f[..., 0]) / ((h[1] / h[0]) ** used - 1))
    moved = f[..., place] - f[..., 0]
    bound = response_bounds(f, h.tolist(), formal)
    return fine + moved, bound + np.abs(moved)


@dataclass(frozen=True)
class Rates:
    """Rates over data sets; a bound that does not exist makes no claim."""

    matters: float
    no_difference: float
    beyond: float


def rates(kind, at, n, seed, truth=1.0, noise=0.0):
    """Claims at a true difference, and how often the error exceeds its bound."""
    actual, u = bounded(kind, at, n, seed, noise)
    rng = np.random.default_rng([seed, 1])
    estimate = truth + actual + at.se * rng.standard_normal(n)
    spread = at.se * np.sqrt(rng.chisquare(BLOCKS - 1, n) / (BLOCKS - 1))
    half = stdtrit(BLOCKS - 1, 0.975) * spread
    low, high = estimate - half - u, estimate + half + u
    known = np.isfinite(u)
    beyond = np.abs(actual[known]) > u[known]
    return Rates(
        float(np.mean((low > 1) | (high < -1))),
        float(np.mean((low > -1) & (high < 1))),
        float(beyond.mean()),
    )
