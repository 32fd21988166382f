"""What holds and what touches a specimen: prescribed unknowns and contact points of a test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from study.arrays import Array, Ints
from study.errors import InputError
from study.fem.element.function_space import _SAME, Nodes, at_level
from study.fem.mesh.mesh import Mesh
from study.setup.geometry import Flat, Surface
from study.setup.setup import Problem
from study.surface.surface import body


@dataclass(frozen=True)
class Constraints:
    """Prescribed unknowns: ``x[dofs] = rate * displacement``.

    ``pins`` are those that only keep the specimen in its place and should carry nothing.
    """

    dofs: Ints
    rate: Array
    pins: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @classmethod
    def of(cls, rate: Mapping[int, float], pins: Sequence[int] | Ints = ()) -> Constraints:
        """Prescribed unknowns with their rates, and the pins, which do not move."""
        every = {**rate, **{int(d): 0.0 for d in pins}}
        dofs = np.array(sorted(every), dtype=np.int64)
        rates = np.array([every[int(d)] for d in dofs])
        return cls(dofs, rates, np.array(pins, dtype=np.int64))


def constraints(problem: Problem, space: Nodes, mesh: Mesh) -> Constraints:
    """Held and driven unknowns of a test, the planes of symmetry (or the axis) included."""
    if isinstance(problem.specimen, Surface):
        # it builds on this module

        return whole_constraints(problem, space, mesh)
    if problem.test.kind == "compression":
        rate = plate_rates(problem, space, mesh)
    else:
        rate = base_rates(problem, space, mesh) | _bonded_punch(problem, space, mesh)
    tol = _SAME * mesh.height_mm
    for i in range(space.dim - 1):
        symmetric = np.flatnonzero(np.abs(space.nodes[:, i]) < tol)
        rate |= {int(n) * space.dim + i: 0.0 for n in symmetric}
    return Constraints.of(rate)


def plate_rates(problem: Problem, space: Nodes, mesh: Mesh) -> dict[int, float]:
    """Plates above and below, or the middle plane instead of the one below."""
    dim, half = space.dim, mesh.half_height
    top = at_level(space, mesh, mesh.height_mm)
    base = at_level(space, mesh, mesh.height_mm / 2 if half else 0.0)
    rate = {int(n) * dim + dim - 1: (-0.5 if half else -1.0) for n in top}
    rate |= {int(n) * dim + dim - 1: 0.0 for n in base}
    if problem.test.interface == "bonded":
        rate |= _sideways(top, dim)
    if problem.test.base == "bonded" and not half:
        rate |= _sideways(base, dim)
    return rate


def base_rates(problem: Problem, space: Nodes, mesh: Mesh) -> dict[int, float]:
    """Support of an indented specimen."""
    dim = space.dim
    base = at_level(space, mesh, 0.0)
    rate = {int(n) * dim + dim - 1: 0.0 for n in base}
    return rate | (_sideways(base, dim) if problem.test.base == "bonded" else {})


def _bonded_punch(problem: Problem, space: Nodes, mesh: Mesh) -> dict[int, float]:
    """Nodes under a flat indenter that sticks: a prescribed displacement."""
    pressed = problem.test.indenter
    if problem.test.interface != "bonded" or not isinstance(pressed, Flat):
        return {}
    top, dim = at_level(space, mesh, mesh.height_mm), space.dim
    rho = np.linalg.norm(space.nodes[top][:, : dim - 1], axis=1)
    held = top[rho <= (pressed.radius_mm - pressed.edge_radius_mm) * (1 + _SAME)]
    return {int(n) * dim + dim - 1: -1.0 for n in held} | _sideways(held, dim)


def _sideways(nodes: Ints, dim: int) -> dict[int, float]:
    """Hold nodes across the axis."""
    return {int(n) * dim + i: 0.0 for n in nodes for i in range(dim - 1)}


def whole_constraints(problem: Problem, space: Nodes, mesh: Mesh) -> Constraints:
    """Held and driven unknowns, and the pins that keep the specimen in its place."""
    rate = _rates(problem, space, mesh)
    return Constraints.of(rate, pins(space.nodes, len(mesh.points), rate))


def _rates(problem: Problem, space: Nodes, mesh: Mesh) -> dict[int, float]:
    """Unknowns that plates, base and clamp prescribe."""
    specimen, dim = problem.specimen, space.dim
    if not isinstance(specimen, Surface):
        raise InputError("whole specimens are surfaces")
    if problem.test.kind == "compression":
        rate = plate_rates(problem, space, mesh)
        rate = rate if body(specimen).touches("top") else _without_top(rate, space, mesh)
    else:
        rate = base_rates(problem, space, mesh)
    return rate | {int(n) * dim + i: 0.0 for n in _clamped(specimen, space) for i in range(dim)}


def _without_top(rate: dict[int, float], space: Nodes, mesh: Mesh) -> dict[int, float]:
    """Leave a round top to contact: it has no face that a plate could move as a whole."""
    top = {int(n) for n in at_level(space, mesh, mesh.height_mm)}
    return {dof: v for dof, v in rate.items() if dof // space.dim not in top}


def _clamped(specimen: Surface, space: Nodes) -> Ints:
    """Nodes below the clamp; the clamp is given along the axis of the file."""
    if specimen.clamp_below_mm is None:
        return np.zeros(0, dtype=np.int64)
    level = specimen.clamp_below_mm - body(specimen).lowest_mm
    return np.flatnonzero(space.nodes[:, -1] < level)


#: motion, over that of the largest, below which a rigid motion counts as held
_HELD = 1e-6


def rigid_motions(places: Array) -> Array:
    """List translations and rotations about the middle of some points, shape (3 n, 6)."""
    middle = (places.min(axis=0) + places.max(axis=0)) / 2
    x, y, z = (places - middle).T / float(np.ptp(places, axis=0).max())
    zero = np.zeros(len(places))
    motions = np.zeros((len(places), 3, 6))
    motions[:, :, :3] = np.eye(3)
    motions[:, :, 3] = np.column_stack([zero, -z, y])
    motions[:, :, 4] = np.column_stack([z, zero, -x])
    motions[:, :, 5] = np.column_stack([-y, x, zero])
    return motions.reshape(-1, 6)


def pins(places: Array, n_free: int, held: Mapping[int, float]) -> Ints:
    """Unknowns that have to be held besides those that are.

    Parameters
    ----------
    places : ndarray, shape (n_nodes, 3)
        Nodes.
    n_free : int
        Only the first so many nodes may be pinned (vertices; a bubble moves nothing).
    held : mapping of int to float
        Unknowns that are prescribed already.

    Returns
    -------
    ndarray of int
        At most six unknowns, chosen where they move most in the motions that are left.
    """
    motions = rigid_motions(places)
    rows = motions[sorted(held)]
    values, directions = np.linalg.eigh(rows.T @ rows) if held else (np.zeros(6), np.eye(6))
    free = directions[:, values < _HELD**2 * max(float(values.max(initial=0.0)), 1.0)]
    chosen: list[int] = []
    while free.shape[1]:
        left = motions[: 3 * n_free] @ free
        # rounded, so that equal places do not change with the last digit
        dof = int(np.round(np.linalg.norm(left, axis=1), 9).argmax())
        chosen.append(dof)
        # the motions left are those that do not move this unknown
        free = free @ np.linalg.svd(left[dof : dof + 1])[2][1:].T
    return np.array(sorted(chosen), dtype=np.int64)
