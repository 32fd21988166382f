"""The set of problems with a known answer on which the intervals of mesh convergence are tried.

Each gives a value on a mesh of a given fineness, and the true value: bonded discs (Table C),
a flat punch on a layer (Table D), thick spheres and cylinders (V18, V19), and manufactured
solutions (V13).
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from study.mechanics.material.material import Material
from study.mechanics.setup.setup import Model
from tests.fem.known import Body, body, rectangle, solve, unit_cube
from tests.fem.manufactured import Manufactured
from tests.fem.problems import MOONEY, NEO_HOOKEAN

Array = np.ndarray

LAYERS = Path(__file__).resolve().parents[2] / "validation" / "layers.csv"


def layers(problem: str) -> Iterator[tuple[float, float, float, float]]:
    """Ratio, Poisson's ratio, value and relative uncertainty of each entry of a table."""
    with LAYERS.open(newline="", encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            if row["problem"] == problem:
                names = ("ratio", "poisson_ratio", "value", "digits")
                ratio, nu, value, digits = (float(row[name]) for name in names)
                yield ratio, nu, value, digits


@dataclass(frozen=True)
class Known:
    """One problem of the set: which table and entry, its answer and what is uncertain about it.

    ``formal`` is the order that the element promises for this quantity, ``value`` makes the
    computed one of a number of cells, ``fineness`` are the cells along one side, coarse to fine.
    """

    group: str
    name: str
    model: Model
    truth: float
    digits: float
    formal: float
    value: Callable[[int], float]
    fineness: tuple[int, ...]


def hooke(nu: float) -> Material:
    """Small-strain solid of shear modulus 1."""
    modulus = {"youngs_modulus": 2 * (1 + nu)}
    if nu == 0.5:
        return Material("linear-elastic", modulus, incompressible=True)
    return Material("linear-elastic", modulus, poisson_ratio=nu)


def clamped_corner(nu: float) -> float:
    """Exponent of the displacement at a right angle between a bonded and a free face.

    Root of (3 - 4 nu) sin^2(pi s / 2) = 4 (1 - nu)^2 - s^2 (Williams 1952, J. Appl. Mech. 19).
    """
    from scipy.optimize import brentq

    return float(
        brentq(
            lambda s: (3 - 4 * nu) * np.sin(np.pi * s / 2) ** 2 - 4 * (1 - nu) ** 2 + s**2,
            0.3, 0.999,
        )
    )  # fmt: skip


def degree(model: Model) -> int:
    return 2 if model.element_order == "quadratic" else 1


def smooth(model: Model) -> float:
    """Order of an energy or a reaction without a singularity: twice that of the gradient."""
    return 2.0 * degree(model)


def every_problem(models: tuple[Model, ...]) -> Iterator[Known]:
    """The whole set, each problem with each element."""
    for model in models:
        yield from discs(model)
        yield from punches(model)
        yield from thick_walls(model)
        yield from manufactured(model)


def discs(model: Model) -> Iterator[Known]:
    for ratio, nu, truth, digits in layers("bonded disc"):
        formal = min(smooth(model), 2 * clamped_corner(nu))
        value = partial(apparent_modulus, ratio, nu, model)
        name = f"R/H={ratio:g} nu={nu:g}"
        yield Known("disc", name, model, truth, digits, formal, value, (6, 9, 14))


def apparent_modulus(ratio: float, nu: float, model: Model, n: int) -> float:
    """Ea/E of a disc of height 1 from its upper half, ``n`` cells in half the height."""
    z = 0.5 + 0.5 * (1 - graded(n))
    r = ratio - 0.5 * graded(n)
    inner = np.linspace(0, ratio - 0.5, max(2, round((ratio - 0.5) * 2 * n)) + 1)[:-1]
    mesh = rectangle(np.r_[inner, np.sort(r)], np.sort(z), model)
    made = body(*mesh, model, hooke(nu))
    top = made.dofs_where(lambda X: X[:, 1] > 1 - 1e-12, 1)
    held = [top, top - 1]
    held.append(made.dofs_where(lambda X: X[:, 1] < 0.5 + 1e-12, 1))
    held.append(made.dofs_where(lambda X: X[:, 0] < 1e-12, 0))
    values = [np.full(d.size, -0.5 if k == 0 else 0.0) for k, d in enumerate(held)]
    answer = solve(made, np.concatenate(held), np.concatenate(values))
    force = -answer.forces[top].sum()
    return float(force / (np.pi * ratio**2) / (2 * (1 + nu)))


def graded(n: int) -> Array:
    """Distances from a corner, 0 to 1: the cells grow from a fifth of the largest, always alike."""
    return _spaced(lambda s: np.minimum(0.2 + 1.6 * s, 1.0), n)


def _spaced(size: Callable[[Array], Array], n: int) -> Array:
    """``n`` cells over 0 to 1 whose sizes follow ``size``: the same map for every n."""
    s = np.linspace(0, 1, 4001)
    density = 1 / size(s)
    count = np.concatenate([[0], np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(s))])
    return np.asarray(np.interp(np.linspace(0, count[-1], n + 1), count, s))


def punches(model: Model) -> Iterator[Known]:
    for ratio, nu, truth, digits in layers("punch on layer"):
        # the stress at the edge goes as s^(-1/2): energy and force are of first order
        value = partial(punch, ratio, nu, model)
        name = f"a/h={ratio:g} nu={nu:g}"
        yield Known("punch", name, model, truth, digits, 1.0, value, (12, 18, 27))


def punch(ratio: float, nu: float, model: Model, n: int) -> float:
    """P (1 - nu) / (4 mu a d) of a punch of radius 1 on a bonded layer of height 1/ratio."""
    height = 1 / ratio
    under = 1 - graded(n)
    beside = 1 + graded(n)
    far = 2 + _outward(height, n)
    depth = height - min(height, 1.0) * graded(n)
    deep = np.linspace(0, height - 1, max(1, round((height - 1) * n / 1.5)) + 1)[:-1]
    z = np.r_[deep if height > 1 else [], np.sort(depth)]
    r = np.r_[np.sort(under), beside[1:], far[1:]]
    made = body(*rectangle(r, z, model), model, hooke(nu))
    face = made.dofs_where(lambda X: (X[:, 1] > height - 1e-9) & (X[:, 0] < 1 + 1e-9), 1)
    base = made.dofs_where(lambda X: X[:, 1] < 1e-12, 1)
    rim = made.dofs_where(lambda X: X[:, 0] > r[-1] - 1e-9, 0)
    axis = made.dofs_where(lambda X: X[:, 0] < 1e-12, 0)
    held = [face, base, base - 1, rim, axis]
    values = [np.full(d.size, -1.0 if k == 0 else 0.0) for k, d in enumerate(held)]
    answer = solve(made, np.concatenate(held), np.concatenate(values))
    return float(-answer.forces[face].sum() * (1 - nu) / 4)


def _outward(height: float, n: int) -> Array:
    """Growing cells out to ten heights (or radii) beyond the punch."""
    reach = 10 * max(height, 1.0)
    return reach * _spaced(lambda s: 0.1 + s, max(4, n))


def thick_walls(model: Model) -> Iterator[Known]:
    """Spheres (V18) and cylinders in plane strain (V19), inner radius 1, driven by it."""
    neo = Material("neo-hookean", {"C10": 0.5}, incompressible=True)
    mooney = Material("mooney-rivlin", {"C10": 0.4, "C01": 0.1}, incompressible=True)
    for label, material in (("NH", neo), ("MR", mooney)):
        for la in (1.1, 1.5, 2.0):
            truth = sphere_truth(la, material)
            value = partial(sphere_pressure, la, material, model)
            # straight sides of a curved wall: second order whatever the element
            name = f"sphere {label} la={la}"
            yield Known("wall", name, model, truth, 0.0, 2.0, value, (4, 6, 9))
    for outer in (1.5, 2.0):
        for la in (1.1, 1.5, 2.0):
            truth = cylinder_truth(la, outer)
            value = partial(cylinder_pressure, la, outer, neo, model)
            name = f"cylinder B={outer} la={la}"
            yield Known("wall", name, model, truth, 0.0, smooth(model), value, (3, 5, 8))


def sphere_truth(la: float, material: Material, outer: float = 2.0) -> float:
    lb = (1 + (la**3 - 1) / outer**3) ** (1 / 3)
    c10, c01 = material.constants["C10"], material.constants.get("C01", 0.0)
    p = c10 * (4 / lb + lb**-4 - 4 / la - la**-4)
    return float(p + 4 * c01 * ((la - lb) - (la**-2 - lb**-2) / 2))


def cylinder_truth(la: float, outer: float) -> float:
    lb = (1 + (la**2 - 1) / outer**2) ** 0.5
    return float(np.log(la / lb) + (lb**-2 - la**-2) / 2)


def sphere_pressure(la: float, material: Material, model: Model, n: int) -> float:
    """Work conjugate of the inner volume: forces times rate of the prescribed motion."""
    radius, angle = np.linspace(1, 2, n + 1), np.linspace(0, np.pi / 2, 2 * n + 1)
    points, cells = rectangle(radius, angle, model)
    points = points[:, :1] * np.column_stack([np.cos(points[:, 1]), np.sin(points[:, 1])])
    points[np.abs(points) < 1e-12] = 0.0
    made = body(points, cells, model, material)
    inner = (np.linalg.norm(made.nodes, axis=1) < 1 + 1e-9) | _on_chords(made.nodes, angle)
    held, values = [], []
    for axis in (0, 1):
        dofs = made.dofs_where(lambda X: inner, axis)
        held.append(dofs)
        values.append((la - 1) * made.nodes[dofs // 2, axis])
    for axis in (0, 1):
        dofs = made.dofs_where(lambda X, axis=axis: X[:, axis] < 1e-12, axis)
        held.append(dofs)
        values.append((la - 1) * made.nodes[dofs // 2, axis] * inner[dofs // 2])
    answer = solve(made, np.concatenate(held), np.concatenate(values), steps=max(2, round(4 * la)))
    work = sum(float(answer.forces[d] @ made.nodes[d // 2, k]) for k, d in enumerate(held[:2]))
    return work / (2 * np.pi * la**2)


def _on_chords(nodes: Array, angle: Array) -> Array:
    """Midpoints of the straight inner edges, which lie a little inside the circle."""
    middle = (angle[1:] + angle[:-1]) / 2
    chord = np.cos((angle[1] - angle[0]) / 2) * np.column_stack([np.cos(middle), np.sin(middle)])
    gap = np.linalg.norm(nodes[:, None] - chord[None], axis=2).min(axis=1)
    return np.asarray(gap < 1e-9)


def cylinder_pressure(la: float, outer: float, material: Material, model: Model, n: int) -> float:
    """One slice of a long tube: ends stay in their planes."""
    points, cells = rectangle(np.linspace(1, outer, n + 1), np.linspace(0, 0.5, 3), model)
    made = body(points, cells, model, material)
    inner = made.dofs_where(lambda X: X[:, 0] < 1 + 1e-12, 0)
    ends = made.dofs_where(lambda X: (X[:, 1] < 1e-12) | (X[:, 1] > 0.5 - 1e-12), 1)
    held = np.r_[inner, ends]
    values = np.r_[np.full(inner.size, la - 1), np.zeros(ends.size)]
    answer = solve(made, held, values, steps=max(2, round(4 * la)))
    return float(answer.forces[inner].sum() / (2 * np.pi * la * 0.5))


def manufactured(model: Model) -> Iterator[Known]:
    """Three fields in each space, three quantities of each."""
    fields = {
        "shear": Manufactured(True, 0.1, NEO_HOOKEAN),
        "barrel": Manufactured(True, 0.1, MOONEY, barrel=0.3),
        "strong barrel": Manufactured(True, 0.2, NEO_HOOKEAN, barrel=0.5),
        "3D shears": Manufactured(False, 0.1, NEO_HOOKEAN),
        "3D shears MR": Manufactured(False, 0.15, MOONEY),
        "3D strong": Manufactured(False, 0.2, NEO_HOOKEAN),
    }
    for name, case in fields.items():
        own = replace(model, space="axisymmetric" if case.axisymmetric else "3d")
        truth = case.quantities(_fine(case))
        solved = cache(partial(computed, case, own))
        for k, quantity in enumerate(("mean rise of the top", "mean square of u", "mean of p")):
            # duality: two orders of the gradient for a smooth functional of u and p
            meshes = (6, 9, 14) if case.axisymmetric else (3, 4, 6)
            yield Known(
                "manufactured", f"{name}: {quantity}", own, truth[k], 0.0, smooth(own),
                partial(_quantity, solved, k), meshes,
            )  # fmt: skip


def _quantity(solved: Callable[[int], tuple[float, ...]], k: int, n: int) -> float:
    return solved(n)[k]


def _fine(case: Manufactured) -> Body:
    """A mesh whose quadrature of eighth order integrates the exact fields to rounding."""
    model = Model("axisymmetric" if case.axisymmetric else "3d", "linear", "tensor")
    return unit(model, 12 if case.axisymmetric else 6, case.material)


def unit(model: Model, n: int, material: Material) -> Body:
    """Unit cylinder or unit cube of n cells a side."""
    line = np.linspace(0, 1, n + 1)
    mesh = rectangle(line, line, model) if model.space == "axisymmetric" else unit_cube(n, model)
    return body(*mesh, model, material)


def computed(case: Manufactured, model: Model, n: int) -> tuple[float, float, float]:
    """Quantities of the discrete solution."""
    made = unit(model, n, case.material)
    return case.quantities(made, case.solve(made, steps=4).x)
