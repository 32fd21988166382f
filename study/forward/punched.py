"""Hexahedra under a flat punch: rings of them that follow the edge of its face.

In the middle lies a square block with bulging sides, around it a ring of blocks out to the
circle of the face, and another out to the sides of the specimen. Nodes lie on the circle
whatever the size, so that what the punch holds is a disc on every mesh of a series.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from study.forward.problem import Block, Cylinder
from study.forward.sizes import SizeField
from study.forward.structured import counted, extrude, line_from, rectangle, spread

Array = NDArray[np.float64]
Cells = NDArray[np.int64]
Size = Callable[[Array], Array]

#: half-width of the middle block over the radius of the face, and its corner over its half-width:
#: its corners then open to some 120 deg, as where three cells meet
CORE, BULGE = 0.7, 1.15
#: growth of sizes inward from the edge over that outward: material that is held moves with the
#: face, and what the force owes to its sizes is small (0.02 % at a growth of 0.5)
INWARD = 2.0
#: part of their way that lines of the grid go from the edge towards where sizes ask for them:
#: they crowd at the edge and need not elsewhere. A fifth less error at the same cost
_BENT = 0.4
#: radii at which these heights are computed
_COLUMNS = 65


def punched(specimen: Cylinder | Block, field: SizeField) -> tuple[Array, Cells]:
    """Hexahedra of a quarter specimen, one ring of nodes on the circle of radius ``ring_mm``."""
    depth = line_from(field.top_mm, lambda s: _below(field, field.ring_mm, s))
    core, rings = _plane(specimen, field, depth)
    plane, quads = _joined(core, rings[0])
    points, cells = extrude(plane, quads, -depth[::-1])
    middle = np.broadcast_to(core.reshape(-1, 2), (depth.size, core.size // 2, 2))
    around_it = rings[:, 1:].reshape(depth.size, -1, 2)
    points[:, :2] = np.concatenate([middle, around_it], axis=1)[::-1].reshape(-1, 2)
    points[:, 2] = field.top_mm - _depths(plane, depth, field)[:, ::-1].T.ravel()
    return points, cells


def has_room(specimen: Cylinder | Block, ring: float) -> bool:
    """Whether a circle lies inside a cross-section, so that cells fit in around it."""
    if isinstance(specimen, Cylinder):
        return 0 < ring < specimen.radius_mm * (1 - 1e-6)
    return 0 < ring < min(specimen.width_mm, specimen.depth_mm) / 2 * (1 - 1e-6)


def around(field: SizeField) -> int:
    """Cells on half the quarter circle, as large as those in the middle of the face.

    The solution hardly changes along the circle.
    """
    return max(2, int(np.ceil(np.pi / 4 * field.ring_mm / field.zone_mm - 1e-9)))


def inward(field: SizeField) -> SizeField:
    """Sizes from the edge to the middle block."""
    return replace(field, growth=INWARD * field.growth)


def _plane(specimen: Cylinder | Block, field: SizeField, depth: Array) -> tuple[Array, Array]:
    """Middle block, shape (n, n, 2), and the rings around it at each depth, inside out."""
    ring, n = field.ring_mm, around(field)
    angles = np.linspace(0, np.pi / 2, 2 * n + 1)
    core, sides = _core(ring, angles), _sides(specimen, angles)
    inner = _rays(ring - np.hypot(*core.T), lambda s: inward(field).at(ring - s, field.top_mm))
    outer = _outer(np.hypot(*sides.T) - ring, field, depth)
    inside = np.broadcast_to(ring - inner[:, ::-1], (depth.size, *inner.shape))
    radii = np.concatenate([inside, ring + outer[:, :, 1:]], axis=2)
    # rays run out from the circle and turn towards where the side is divided
    turn = np.linspace(0, 1, outer.shape[2])[1:] * (np.arctan2(*sides.T[::-1]) - angles)[:, None]
    turned = angles[:, None] + np.hstack([np.zeros(inner.shape), turn])
    rings = np.stack([radii * np.cos(turned), radii * np.sin(turned)], axis=-1).swapaxes(1, 2)
    rings[:, 0], rings[:, -1] = core, sides
    rings[:, :, 0, 1] = rings[:, :, -1, 0] = 0.0
    return _filled(core), rings


def _rays(lengths: Array, size: Size) -> Array:
    """Points along rays, of one number on all and spaced as asked where they start."""
    found = [counted(length, size) for length in lengths]
    n = max(2, round(float(np.mean([count[-1] for _, count in found]))))
    return np.array([spread(s, count, n) for s, count in found])


def _outer(lengths: Array, field: SizeField, depth: Array) -> Array:
    """Points along rays from the circle outward at each depth, (n_depths, n_rays, n_points)."""
    straight = _rays(lengths, lambda s: field.at(field.ring_mm + s, field.top_mm))
    steps = straight.shape[1] - 1
    asked = [[_even(length, steps, lambda s, down=down: _beside(field, s, down))
              for length in lengths] for down in depth]  # fmt: skip
    return np.asarray((1 - _BENT) * straight + _BENT * np.array(asked))


def _core(ring: float, angles: Array) -> Array:
    """Border of the middle block, shape (n, 2)."""
    ray = np.column_stack([np.cos(angles), np.sin(angles)])
    # 0 on the axes, 1 at the corner of a square
    corner = (1 / ray.max(axis=1) - 1) / (np.sqrt(2) - 1)
    border = CORE * ring * (1 + (BULGE - 1) * corner)[:, None] * ray
    border[0, 1] = border[-1, 0] = 0.0
    return np.asarray(border)


def _sides(specimen: Cylinder | Block, angles: Array) -> Array:
    """Points on the sides of the quarter specimen, shape (n, 2); that of 45 deg is a corner.

    The polygon of a cylinder has the exact area of the quarter disc.
    """
    ray = np.column_stack([np.cos(angles), np.sin(angles)])
    ray[0, 1] = ray[-1, 0] = 0.0
    if isinstance(specimen, Cylinder):
        step = angles[1] - angles[0]
        return np.asarray(specimen.radius_mm * np.sqrt(step / np.sin(step)) * ray)
    half = np.array([specimen.width_mm / 2, specimen.depth_mm / 2])
    return np.asarray(half * ray / ray.max(axis=1, keepdims=True))


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


def _joined(core: Array, rings: Array) -> tuple[Array, Cells]:
    """Quadrilaterals of the middle block and of the rings; they share the first ring."""
    n = len(core) - 1
    _, quads = rectangle(np.arange(n + 1.0), np.arange(n + 1.0), "tensor")
    index = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    border = np.concatenate([index[:, n], index[n, n - 1 :: -1]])
    new = index.size + np.arange((len(rings) - 1) * border.size).reshape(-1, border.size)
    number = np.vstack([border, new])
    near, far = number[:-1], number[1:]
    cells = np.stack([near[:, :-1], far[:, :-1], far[:, 1:], near[:, 1:]], axis=-1)
    points = np.vstack([core.reshape(-1, 2), rings[1:].reshape(-1, 2)])
    return points, np.vstack([quads, cells.reshape(-1, 4)])


def _depths(plane: Array, depth: Array, field: SizeField) -> Array:
    """Depths of the layers under each point of the plane mesh, shape (n_points, n_layers + 1)."""
    rho, steps = np.hypot(*plane.T), depth.size - 1
    radii = np.linspace(0, rho.max(), _COLUMNS)
    own = np.array(
        [_even(field.top_mm, steps, lambda s, at=at: _below(field, at, s)) for at in radii]
    )
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


def _beside(field: SizeField, away: Array, depth: float) -> Array:
    """Sizes away from the edge, at a depth."""
    return field.at(field.ring_mm + away, field.top_mm - depth)
