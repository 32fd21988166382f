"""What holds and what touches a whole specimen, one without symmetries, given as a surface.

Faces that lie in a plate move with it, freely along it where the plate is frictionless. All
other points may come to lie on a plate by contact: round ends roll out on it. An indenter
meets the surface where it first touches it, which is where its displacement counts from.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from study.errors import Fault, InputError
from study.forward.boundary import (
    Constraints,
    Nodes,
    at_level,
    base_rates,
    meeting,
    only,
    plate_rates,
)
from study.forward.contact import ContactPoints, Plate
from study.forward.elements import Discretization
from study.forward.glue import gripping
from study.forward.indenters import Press, profile, profile_height
from study.forward.mesh import Mesh
from study.forward.pins import pins
from study.forward.problem import Indenter, Problem, Surface
from study.forward.surface import body

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: subdivisions of the triangles where an indenter could touch first, and how many are kept
_DIVISIONS, _KEPT = 14, 48
#: points of a triangle in halves: its corners and the middles of its sides, and the quarters
_HALVES = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5]])
_QUARTERS = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])


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


def whole_contact(
    problem: Problem, space: Discretization, mesh: Mesh, *, folding: bool
) -> tuple[ContactPoints, ...]:
    """Points of the whole surface that may meet the plates or the indenter."""
    test = problem.test
    if test.kind == "indentation":
        if test.indenter is None:
            return ()
        held = _in_plate(space, mesh, 0.0)
        corners = mesh.points[space.facets[~held][:, :3]]
        touch = touch_mm(test.indenter, corners, mesh.height_mm)
        press = Press(profile(test.indenter, far_mm=1e3 * mesh.height_mm), touch)
        points = meeting(problem, space, mesh, press, ~held)
        return gripping(points, test.interface, space.dim)
    axial = np.array(sorted(_rates(problem, space, mesh)), dtype=np.int64)
    nodes = np.unique(axial[axial % space.dim == space.dim - 1] // space.dim)
    plates = [Plate(mesh.height_mm, -1, 1.0)]
    if problem.specimen.clamp_below_mm is None:  # type: ignore[union-attr]
        plates.append(Plate(0.0, 1, 0.0))
    found = [_on_plate(problem, space, mesh, plate, nodes) for plate in plates] if folding else []
    return tuple(points for points in found if points.size)


def _in_plate(space: Discretization, mesh: Mesh, level: float) -> NDArray[np.bool_]:
    """Facets that lie in a plate."""
    held = np.zeros(len(space.nodes), dtype=bool)
    held[at_level(space, mesh, level)] = True
    return np.asarray(held[space.facets].all(axis=1))


def _on_plate(
    problem: Problem, space: Discretization, mesh: Mesh, plate: Plate, nodes: Ints
) -> ContactPoints:
    """Points that may meet a plate; ``nodes`` are held in one already, or clamped."""
    chosen = np.asarray(~np.isin(space.facets, nodes).all(axis=1))
    points = meeting(problem, space, mesh, plate, chosen)
    held = np.isin(points.nodes[:, 0], nodes)
    return only(points, ~held)


def touch_mm(indenter: Indenter, triangles: Array, height: float) -> float:
    """Height of the lowest point of an indenter that just touches some triangles, mm.

    Parameters
    ----------
    triangles : ndarray, shape (m, 3, 3)
        Corners; the axis of the indenter is x = y = 0.
    height : float
        Of the specimen, for messages and lengths.

    Raises
    ------
    InputError
        If nothing is below the indenter.

    Notes
    -----
    The height of the profile is convex, that of a triangle linear: their difference has one
    greatest value in each triangle, found by halving its sides where it is greatest.
    """
    pieces = profile(indenter, far_mm=1e3 * height)
    _under_axis(triangles)
    best, kept = -np.inf, triangles
    for _ in range(_DIVISIONS):
        places = np.einsum("qk,mkj->mqj", _HALVES, kept)
        rho = np.hypot(places[:, :, 0], places[:, :, 1])
        level = places[:, :, 2] - profile_height(pieces, rho.ravel()).reshape(rho.shape)
        best = max(best, float(level.max()))
        quarters = places[:, _QUARTERS].reshape(-1, 3, 3)
        order = np.argsort(-level[:, _QUARTERS].max(axis=2).ravel(), kind="stable")
        kept = quarters[order[:_KEPT]]
    return best


def _under_axis(triangles: Array) -> None:
    """Refuse an axis that passes beside the specimen."""
    x, y = triangles[:, :, 0], triangles[:, :, 1]
    area = np.stack([x[:, k - 1] * y[:, k] - x[:, k] * y[:, k - 1] for k in range(3)], axis=1)
    if not ((area >= 0).all(axis=1) | (area <= 0).all(axis=1)).any():
        mend = "choose press_x and press_y inside its outline"
        raise InputError(Fault("specimen.press_x", "the indenter misses the specimen", mend))
