"""Coverage of the bound of a refinement series: random series whose limit is known.

``python -m validation.bounds [SERIES]`` draws so many series of every family (2,000 by default)
and prints the share whose error the bound holds, the series without a number, and the median of
bound over error. Ratios, orders, signs, curvature and noise are drawn independently.

``python -m validation.bounds --problems 240`` solves so many random problems on three meshes each,
as ``study converge`` does, and holds the bound of the finest force against the exact one: that of
an integral equation for spheres, cones, sharp and rounded punches on bonded elastic layers, and a
quadratic mesh three times finer for bonded discs (corners), lubricated cylinders that fold, and
punches in soft solids of large strain. Every problem is solved by linear and quadratic triangles
and quadrilaterals in turn.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from study.ground.arrays import Array
from study.mechanics.forward.contact_law import Layer, force_law
from study.mechanics.forward.formal_order import formal_order
from study.mechanics.material.material import Material
from study.mechanics.mesh.mesher import mesh_size
from study.mechanics.setup.geometry import Cone, Cylinder, Flat, Indenter, Sphere
from study.mechanics.setup.setup import Model, Problem
from study.mechanics.setup.test_kind import Test
from study.mechanics.solver.finite_element_solution import solve
from study.mechanics.solver.solution import Solution
from study.simulation.refinement import series_sizes
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


def line(name: str, u: Array, error: Array, width: int = 12) -> str:
    """Coverage, series without a number, and width of a family."""
    return (
        f"{name:{width}} {u.size:6} series, {100 * np.mean(error <= u):5.1f} % covered, "
        f"{np.isnan(u).sum()} without a number, "
        f"median of bound over error {np.nanmedian(u / error):.2f}"
    )


# Problems that the code solves.

#: relative error of a force at the solver's tolerance, as ``study converge`` takes it
SOLVER_TOLERANCE = 1e-7
#: size of a reference over the finest one's, and largest ratio of the sizes of a series
FINER, RATIO = 3.0, (1.35, 1.7)
ELEMENTS = tuple(product(("linear", "quadratic"), ("simplex", "tensor")))


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(f"{np.exp(rng.uniform(np.log(low), np.log(high))):.3g}")


def _indenter(rng: np.random.Generator, kind: str) -> tuple[Indenter, float]:
    """Indenter of a layer of height 1 mm, and a depth at which the contact is .1 to 1.2 mm wide."""
    a = _log(rng, 0.1, 1.2)
    if kind == "sphere":
        radius = _log(rng, 3, 30)
        return Sphere(radius), float(f"{min(a**2 / radius, 0.2 * radius):.3g}")
    if kind == "cone":
        angle, tip = float(np.round(rng.uniform(60, 85), 1)), _log(rng, 0.05, 1)
        return Cone(angle, tip), float(f"{np.pi / 2 * a / np.tan(np.radians(angle)):.3g}")
    if kind == "sharp":
        return Flat(a), 1e-3
    edge = float(f"{a * rng.uniform(0.1, 0.7):.3g}")
    return Flat(a, edge), float(f"{edge * _log(rng, 0.01, 0.5):.3g}")


def on_layer(rng: np.random.Generator, kind: str) -> tuple[Problem, float]:
    """Indenter on a bonded layer of linear elasticity, and its exact force."""
    indenter, depth = _indenter(rng, kind)
    nu = float(rng.choice([0.3, 0.45, 0.49, 0.5]))
    modulus = {"youngs_modulus": 2 * (1 + nu)}
    material = (
        Material("linear-elastic", modulus, incompressible=True) if nu == 0.5
        else Material("linear-elastic", modulus, poisson_ratio=nu)
    )  # fmt: skip
    test = Test("indentation", depth, "frictionless", "bonded", 1, indenter)
    law = force_law(indenter, Layer(1.0, nu), depth, paraboloid=False)
    exact = 2 / (1 - nu) * float(law.force(np.array([depth]))[0])
    return Problem(Cylinder(10.0, 1.0), test, material, Model()), exact


def soft(rng: np.random.Generator, kind: str) -> Problem:
    """Large strains: a disc that is bonded, or a thick cylinder under an indenter."""
    nu = float(rng.choice([0.45, 0.49, 0.4995]))
    material = Material("neo-hookean", {"C10": 0.5}, poisson_ratio=nu)
    radius, height = _log(rng, 5, 20), _log(rng, 4, 15)
    if kind == "corner":
        depth = float(f"{height * rng.uniform(0.01, 0.1):.3g}")
        test = Test("compression", depth, "bonded", "bonded", 2)
        return Problem(Cylinder(radius, height), test, material, Model())
    size = 0.4 * min(radius, height)
    if kind == "rim":
        pressed: Indenter = Sphere(float(f"{size * rng.uniform(0.5, 2):.3g}"))
        depth = float(f"{size * rng.uniform(0.02, 0.2):.3g}")
    else:
        pressed = Flat(float(f"{size:.3g}"), float(f"{size * rng.uniform(0.1, 0.6):.2g}"))
        depth = float(f"{size * rng.uniform(0.01, 0.15):.3g}")
    test = Test("indentation", depth, "frictionless", "bonded", 2, pressed)
    return Problem(Cylinder(radius, height), test, material, Model())


KINDS: dict[str, Callable[[np.random.Generator], tuple[Problem, float | None]]] = {
    "sphere on layer": lambda rng: on_layer(rng, "sphere"),
    "cone on layer": lambda rng: on_layer(rng, "cone"),
    "sharp punch on layer": lambda rng: on_layer(rng, "sharp"),
    "rounded punch on layer": lambda rng: on_layer(rng, "rounded"),
    "bonded disc": lambda rng: (soft(rng, "corner"), None),
    "sphere, large strain": lambda rng: (soft(rng, "rim"), None),
    "rounded punch, large strain": lambda rng: (soft(rng, "edge"), None),
}


def _solved(problem: Problem, size_mm: float) -> Solution | None:
    model = replace(problem.model, mesh_size_mm=float(f"{size_mm:.4g}"))
    found = solve(replace(problem, model=model), gradients=False)
    return found if found.converged else None


def series_of(problem: Problem, rng: np.random.Generator) -> Known | None:
    """Series of a problem by its own elements, as ``study converge`` judges it."""
    first = mesh_size(replace(problem, model=replace(problem.model, mesh="coarse")).setup)
    first, ratio = first * rng.uniform(0.6, 1.3), rng.uniform(*RATIO)
    levels = [_solved(problem, first / ratio**k) for k in range(3)]
    good = [level for level in levels if level is not None]
    if len(good) < len(levels):
        return None
    sizes = series_sizes(
        [level.mesh_size_mm for level in good], [level.elements for level in good], problem.setup
    )
    forces = np.array([float(level.curve.force_N[-1]) for level in good])
    tolerance = SOLVER_TOLERANCE * float(np.abs(forces).max())
    own = replace(problem, model=replace(problem.model, mesh_size_mm=first))
    order = formal_order(own).order
    return Known(np.array(sizes)[::-1], forces[::-1], np.nan, order, tolerance)


def solved_problems(count: int, seed: int = 0) -> dict[str, list[tuple[str, Known]]]:
    """Series of random problems, by kind, with the elements of each."""
    found: dict[str, list[tuple[str, Known]]] = defaultdict(list)
    for number in range(-(-count // len(ELEMENTS))):
        kind = list(KINDS)[number % len(KINDS)]
        rng = np.random.default_rng([seed, number])
        problem, exact = KINDS[kind](rng)
        for order, shape in ELEMENTS:
            own = replace(problem, model=Model("axisymmetric", order, shape))  # type: ignore[arg-type]
            series = series_of(own, rng)
            if series is None:
                continue
            if exact is None:
                quadratic = replace(problem, model=Model("axisymmetric", "quadratic", "tensor"))
                fine = mesh_size(replace(quadratic, model=Model(mesh="fine")).setup)
                answer = _solved(quadratic, fine / FINER)
                exact = np.nan if answer is None else float(answer.curve.force_N[-1])
            found[kind].append((f"{order} {shape}", replace(series, truth=exact)))
    return found


def _problems(count: int, seed: int) -> None:
    """Print the coverage of every kind of problem and of every element."""
    groups: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for kind, series in solved_problems(count, seed).items():
        for element, one in series:
            result = grid_convergence(
                one.h, one.f, formal_order=one.formal, tolerance=one.tolerance
            )
            pair = (np.nan if result.u_num is None else result.u_num, abs(one.f[0] - one.truth))
            for group in (kind, element, result.behaviour, "all"):
                groups[group].append(pair)
            if not pair[1] <= pair[0]:
                print(f"missed: {kind}, {element}: {one.f.tolist()} at {one.h.tolist()}, "
                      f"formal {one.formal:g}, exact {one.truth:.6g}, bound {pair[0]:.3g}, "
                      f"{result.verdict}")  # fmt: skip
    for group, pairs in groups.items():
        u, error = np.array(pairs).T
        print(line(group, u, error, width=27))


def main() -> None:
    """Print the coverage of every family and of all."""
    parser = argparse.ArgumentParser(description="coverage of the bound of a refinement series")
    parser.add_argument("series", nargs="?", type=int, default=2000, help="series of every family")
    parser.add_argument("--problems", type=int, help="solve so many random problems instead")
    parser.add_argument("--seed", type=int, default=0, help="of the problems (0)")
    given = parser.parse_args()
    if given.problems:
        _problems(given.problems, given.seed)
        return
    every = [coverage(draw, given.series) for draw in FAMILIES]
    for draw, (u, error) in zip(FAMILIES, every, strict=True):
        print(line(draw.__name__, u, error))
    u, error = (np.concatenate(part) for part in zip(*every, strict=True))
    print(line("all", u, error))


if __name__ == "__main__":
    main()
