"""Hexahedra under a flat punch: rings of them that follow the edge of its face.

In the middle lies a square block with bulging sides, around it a ring of blocks out to the
circle of the face, and another out to the sides of the specimen, or to a square where it is a
block that is longer than wide. Nodes lie on the circle
whatever the size, so that what the punch holds is a disc on every mesh of a series.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from study.arrays import Array, Ints
from study.fem.mesh.size_field import SizeField
from study.fem.mesh.structured import counted, extrude, line_from, rectangle, spread
from study.setup.geometry import Block, Cylinder, Specimen

Size = Callable[[Array], Array]

#: half-width of the middle block over the radius of the face, and its corner over its half-width:
#: its corners then open to some 120 deg, as where three cells meet
CORE = 0.7
BULGE = 1.15

#: growth of sizes inward from the edge over that outward: material that is held moves with the
#: face, and what the force owes to its sizes is small (0.02 % at a growth of 0.5)
INWARD = 2.0

#: part of their way that lines of the grid go from the edge towards where sizes ask for them:
#: they crowd at the edge and need not elsewhere. A fifth less error at the same cost
_BENT = 0.4

#: radii at which these heights are computed
_COLUMNS = 65


def punched(specimen: Cylinder | Block, field: SizeField) -> tuple[Array, Ints]:
    """Hexahedra of a quarter specimen, one ring of nodes on the circle of radius ``ring_mm``.

    Parameters
    ----------
    specimen : Cylinder or Block
        With room around the circle, see :func:`has_room`.
    field : SizeField
        Sizes in mm around the edge of the face, whose radius is ``ring_mm``.

    Returns
    -------
    points : ndarray, shape (n, 3)
        In mm.
    cells : ndarray of int, shape (m, 8)
        Corners.
    """
    depth = line_from(field.top_mm, partial(_below, field, field.ring_mm))
    core, rings = _rings(specimen, field, depth)
    beyond = _beyond(specimen, field, rings[0, -1])
    plane = np.concatenate(
        [
            np.broadcast_to(core.reshape(-1, 2), (depth.size, core.size // 2, 2)),
            rings[:, 1:].reshape(depth.size, -1, 2),
            np.broadcast_to(beyond.reshape(-1, 2), (depth.size, beyond.size // 2, 2)),
        ],
        axis=1,
    )
    quads = _quadrilaterals(len(core), rings.shape[1] - 1, beyond)
    points, cells = extrude(plane[0], quads, -depth[::-1])
    points[:, :2] = plane[::-1].reshape(-1, 2)
    points[:, 2] = field.top_mm - _depths(plane[0], depth, field)[:, ::-1].T.ravel()
    return points, cells


def has_room(specimen: Specimen, ring: float) -> bool:
    """Whether a circle lies inside a cross-section, so that cells fit in around it.

    Parameters
    ----------
    specimen : Specimen
        A surface never has room.
    ring : float
        Radius of the circle about the axis, mm; there is no room around one of 0.
    """
    if isinstance(specimen, Cylinder):
        return 0 < ring < specimen.radius_mm * (1 - 1e-6)
    if isinstance(specimen, Block):
        return 0 < ring < min(specimen.width_mm, specimen.depth_mm) / 2 * (1 - 1e-6)
    return False


def around(field: SizeField) -> int:
    """Cells on half the quarter circle, as large as those in the middle of the face.

    The solution hardly changes along the circle.

    Parameters
    ----------
    field : SizeField
        Its ``ring_mm`` and ``zone_mm`` count.
    """
    return max(2, int(np.ceil(np.pi / 4 * field.ring_mm / field.zone_mm - 1e-9)))


def inward(field: SizeField) -> SizeField:
    """Sizes from the edge to the middle block.

    Parameters
    ----------
    field : SizeField
        Sizes outward of the edge.
    """
    return replace(field, growth=INWARD * field.growth)


def _rings(specimen: Cylinder | Block, field: SizeField, depth: Array) -> tuple[Array, Array]:
    """Middle block, shape (n, n, 2), and the rings around it at each depth, inside out."""
    ring, n = field.ring_mm, around(field)
    angles = np.linspace(0, np.pi / 2, 2 * n + 1)
    ray = np.column_stack([np.cos(angles), np.sin(angles)])
    ray[0, 1] = ray[-1, 0] = 0.0
    core, sides = _core(ring, ray), _sides(specimen, ray)
    inner = _rays(ring - np.hypot(*core.T), lambda s: inward(field).at(ring - s, field.top_mm))
    outer = _outer(np.hypot(*sides.T) - ring, field, depth)
    inside = np.broadcast_to(ring - inner[:, ::-1], (depth.size, *inner.shape))
    radii = np.concatenate([inside, ring + outer[:, :, 1:]], axis=2).swapaxes(1, 2)
    rings = radii[..., None] * ray
    rings[:, 0], rings[:, -1] = core, sides
    return _filled(core), rings


def _rays(lengths: Array, size: Size) -> Array:
    """Points along rays, of one number on all and spaced as asked where they start."""
    found = [counted(length, size) for length in lengths]
    n = max(2, round(float(np.mean([count[-1] for _, count in found]))))
    return np.array([spread(s, count, n) for s, count in found])


def _outer(lengths: Array, field: SizeField, depth: Array) -> Array:
    """Points along rays from the circle outward at each depth, (n_depths, n_rays, n_points)."""
    straight = _rays(lengths, partial(_beside, field, 0.0))
    steps = straight.shape[1] - 1
    asked = np.array(
        [[_even(length, steps, partial(_beside, field, down)) for length in lengths]
         for down in depth]
    )  # fmt: skip
    return np.asarray((1 - _BENT) * straight + _BENT * asked)


def _core(ring: float, ray: Array) -> Array:
    """Border of the middle block along unit vectors, shape (n, 2)."""
    # 0 on the axes, 1 at the corner of a square
    corner = (1 / ray.max(axis=1) - 1) / (np.sqrt(2) - 1)
    return np.asarray(CORE * ring * (1 + (BULGE - 1) * corner)[:, None] * ray)


def _sides(specimen: Cylinder | Block, ray: Array) -> Array:
    """Outer ends of the rays: on the side of a cylinder, or on a square that fits in a block.

    The polygon of a cylinder has the exact area of the quarter disc.
    """
    if isinstance(specimen, Cylinder):
        step = np.arctan2(ray[1, 1], ray[1, 0])
        return np.asarray(specimen.radius_mm * np.sqrt(step / np.sin(step)) * ray)
    half = min(specimen.width_mm, specimen.depth_mm) / 2
    return np.asarray(half * ray / ray.max(axis=1, keepdims=True))


def _beyond(specimen: Cylinder | Block, field: SizeField, sides: Array) -> Array:
    """Points of what a block has beyond that square, shape (n_lines, n + 1, 2)."""
    n = len(sides) // 2
    if isinstance(specimen, Cylinder) or specimen.width_mm == specimen.depth_mm:
        return np.zeros((0, n + 1, 2))
    axis = 0 if specimen.width_mm > specimen.depth_mm else 1
    start, end = sides[n, axis], max(specimen.width_mm, specimen.depth_mm) / 2
    s, count = counted(end - start, partial(_beside, field, 0.0, start=start))
    line = start + spread(s, count, max(1, round(float(count[-1]))))[1:]
    side = sides[: n + 1] if axis == 0 else sides[n:]
    points = np.tile(side, (line.size, 1, 1))
    points[:, :, axis] = line[:, None]
    return points


def _filled(border: Array) -> Array:
    """Points of the middle block, from its two outer sides, shape (n, n, 2) by y and x.

    Notes
    -----
    Transfinite interpolation: Gordon and Hall 1973, Int. J. Numer. Meth. Eng. 7, 461.
    """
    n = len(border) // 2
    right, upper = border[: n + 1], border[n:][::-1]
    u = np.linspace(0, 1, n + 1)[None, :, None]
    v = u.swapaxes(0, 1)
    foot, left, corner = u * border[0], v * border[-1], border[n]
    sides = (1 - v) * foot + v * upper[None] + (1 - u) * left + u * right[:, None]
    return np.asarray(sides - u * (1 - v) * border[0] - (1 - u) * v * border[-1] - u * v * corner)


def _quadrilaterals(side: int, rings: int, beyond: Array) -> Ints:
    """Corners: of the middle block with ``side`` points, of the rings, and of what is beyond."""
    _, quads = rectangle(np.arange(float(side)), np.arange(float(side)), "tensor")
    index = np.arange(side**2).reshape(side, side)
    border = np.concatenate([index[:, -1], index[-1, -2::-1]])
    new = index.size + np.arange(rings * border.size).reshape(rings, -1)
    found = [quads, _strips(np.vstack([border, new]))]
    if len(beyond):
        along_x = beyond[0, 0, 1] == 0
        last = new[-1, :side] if along_x else new[-1, side - 1 :]
        lines = new.max() + 1 + np.arange(len(beyond) * side).reshape(-1, side)
        found.append(_strips(np.vstack([last, lines])))
    return np.vstack(found)


def _strips(number: Ints) -> Ints:
    """Quadrilaterals between numbered lines of points, each further out than the last."""
    near, far = number[:-1], number[1:]
    cells = [near[:, :-1], far[:, :-1], far[:, 1:], near[:, 1:]]
    return np.stack(cells, axis=-1).reshape(-1, 4)


def _depths(plane: Array, depth: Array, field: SizeField) -> Array:
    """Depths of the layers under each point of the plane mesh, shape (n_points, n_layers + 1)."""
    rho, steps = np.hypot(*plane.T), depth.size - 1
    radii = np.linspace(0, rho.max(), _COLUMNS)
    own = np.array([_even(field.top_mm, steps, partial(_below, field, at)) for at in radii])
    place = rho / rho.max() * (_COLUMNS - 1)
    low = np.minimum(place.astype(int), _COLUMNS - 2)
    part = (place - low)[:, None]
    return np.asarray((1 - _BENT) * depth + _BENT * ((1 - part) * own[low] + part * own[low + 1]))


def _even(length: float, steps: int, size: Size) -> Array:
    """Points from 0 to ``length``, their spacing in proportion to sizes."""
    s, count = counted(length, size, 1001)
    return np.interp(np.linspace(0, count[-1], steps + 1), count, s)


def _below(field: SizeField, radius: float, depth: Array) -> Array:
    """Sizes at depths below a place on the loaded face."""
    return field.at(radius, field.top_mm - depth)


def _beside(field: SizeField, depth: float, away: Array, start: float | None = None) -> Array:
    """Sizes away from the edge, or from another radius, at a depth."""
    return field.at((field.ring_mm if start is None else start) + away, field.top_mm - depth)
