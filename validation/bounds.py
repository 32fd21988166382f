"""Coverage of the bound of a refinement series: random series whose limit is known.

``python -m validation.bounds [SERIES]`` draws so many series of every family (2,000 by default)
and prints the share whose error the bound holds, the series without a number, and the median of
bound over error. Ratios, orders, signs, curvature and noise are drawn independently.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from study.ground.arrays import Array
from study.statistics.convergence.grid_convergence import grid_convergence

#: Formal orders of the force of the elements: sharp edge, bonded corner, linear, quadratic.
FORMAL = (1.0, 1.19, 2.0, 4.0)


@dataclass(frozen=True)
class Known:
    """Series of values, fine to coarse, with its limit."""

    h: Array
    f: Array
    truth: float
    formal: float | None = None
    tolerance: float = 0.0


Draw = Callable[[np.random.Generator], Known]


def _sizes(rng: np.random.Generator, meshes: int = 3) -> Array:
    return np.cumprod([1.0, *rng.uniform(1.3, 2.2, meshes - 1)])


def _curved(
    rng: np.random.Generator, formal: float, more: float, bend: float, level: float
) -> Known:
    """Leading term of the formal order, and a higher one that is ``bend`` times it at coarsest."""
    h = _sizes(rng)
    x = h / h[-1]
    return Known(
        h, level + rng.choice([-1, 1]) * (x**formal + bend * x ** (formal + more)), level, formal
    )


def monotone(rng: np.random.Generator) -> Known:
    """Formal order and little curvature."""
    return _curved(rng, rng.choice(FORMAL), rng.uniform(0.5, 2), rng.uniform(-0.2, 0.2), 10.0)


def mixed(rng: np.random.Generator) -> Known:
    """Orders one and two mixed: h + h^2 of either sign."""
    return _curved(rng, 1.0, 1.0, rng.uniform(-0.9, 2.0), 10.0)


def above(rng: np.random.Generator) -> Known:
    """Linear elements far from their asymptote: an observed order above the formal one."""
    return _curved(rng, rng.choice(FORMAL[:3]), rng.uniform(1, 3), rng.uniform(0.5, 8.0), 10.0)


def below(rng: np.random.Generator) -> Known:
    """Promise too high an order, as for a singularity that is not declared."""
    series = _curved(rng, rng.uniform(0.6, 1.5), 1.0, rng.uniform(-0.2, 0.5), 10.0)
    return Known(series.h, series.f, series.truth, 2.0)


def unpromised(rng: np.random.Generator) -> Known:
    """No formal order."""
    series = _curved(rng, rng.uniform(0.8, 4), rng.uniform(0.5, 2), rng.uniform(-0.3, 0.8), 10.0)
    return Known(series.h, series.f, series.truth)


def noisy(rng: np.random.Generator) -> Known:
    """Meshes that differ by more than their size: noise of 1 to 50 % of the error of each."""
    h, formal = _sizes(rng, int(rng.integers(3, 6))), rng.choice(FORMAL[:3])
    x = h / h[-1]
    scatter = 10 ** rng.uniform(-2, -0.3) * rng.standard_normal(h.size)
    return Known(h, 10 + x**formal * (1 + scatter), 10.0, formal)


def oscillating(rng: np.random.Generator) -> Known:
    """Error of changing sign and falling size."""
    h = _sizes(rng, int(rng.integers(3, 6)))
    sign = np.where(np.arange(h.size) % 2, -1, 1)
    size = (h / h[-1]) ** rng.uniform(0.3, 2) * rng.uniform(0.5, 1, h.size)
    return Known(h, 10 + 0.1 * sign * size, 10.0, rng.choice(FORMAL[:3]))


def noise_floor(rng: np.random.Generator) -> Known:
    """Values that differ by the solver's tolerance alone."""
    tolerance, h = 10 ** rng.uniform(-9, -6), _sizes(rng)
    f = 10 + tolerance * rng.uniform(-3, 3, 3)
    return Known(h, f, 10.0, rng.choice(FORMAL), tolerance)


def mesh_noise(rng: np.random.Generator) -> Known:
    """Scatter of the meshes, below a hundredth of the value, around the limit."""
    h = _sizes(rng, int(rng.integers(3, 6)))
    return Known(h, 10 + 0.02 * rng.standard_normal(h.size), 10.0, rng.choice(FORMAL))


def near_zero(rng: np.random.Generator) -> Known:
    """Limit of zero."""
    return _curved(rng, rng.choice(FORMAL[:3]), rng.uniform(0.5, 2), rng.uniform(-0.4, 1.0), 0.0)


def two_meshes(rng: np.random.Generator) -> Known:
    """Two meshes and a formal order."""
    series = monotone(rng)
    return Known(series.h[:2], series.f[:2], series.truth, series.formal)


FAMILIES: tuple[Draw, ...] = (
    monotone, mixed, above, below, unpromised, noisy, oscillating, noise_floor, mesh_noise,
    near_zero, two_meshes,
)  # fmt: skip


def coverage(draw: Draw, series: int, seed: int = 0) -> tuple[Array, Array]:
    """Half-width and error of some series of one family."""
    rng = np.random.default_rng(seed)
    pairs = []
    for _ in range(series):
        one = draw(rng)
        result = grid_convergence(one.h, one.f, formal_order=one.formal, tolerance=one.tolerance)
        pairs.append((np.nan if result.u_num is None else result.u_num, abs(one.f[0] - one.truth)))
    u, error = np.array(pairs).T
    return u, error


def line(name: str, u: Array, error: Array) -> str:
    """Coverage, series without a number, and width of a family."""
    return (
        f"{name:12} {u.size:6} series, {100 * np.mean(error <= u):5.1f} % covered, "
        f"{np.isnan(u).sum()} without a number, "
        f"median of bound over error {np.nanmedian(u / error):.2f}"
    )


def main() -> None:
    """Print the coverage of every family and of all."""
    series = int(sys.argv[1]) if len(sys.argv) > 1 else 2000
    every = [coverage(draw, series) for draw in FAMILIES]
    for draw, (u, error) in zip(FAMILIES, every, strict=True):
        print(line(draw.__name__, u, error))
    u, error = (np.concatenate(part) for part in zip(*every, strict=True))
    print(line("all", u, error))


if __name__ == "__main__":
    main()
