"""Brain-shaped surface from a formula: for whoever has no scan at hand.

A rounded body, narrower in front and flatter below, with the groove between its halves: the
features that an indentation away from an axis of symmetry meets. It is no anatomy.
"""

from __future__ import annotations

import numpy as np

from study.ground.arrays import Array, Ints
from study.ground.errors import Fault, InputError
from study.mechanics.setup.geometry import Brain

#: how often the triangles of an octahedron are quartered: 8,192 in all
_QUARTERED = 5
#: how much narrower it is in front and wider behind
_TAPER = 0.12
#: height of the widest section over that of the body
_WAIST = 0.35
#: half width of the groove over its depth: coarse triangles can follow its sides
_GROOVE = 1.7
#: deepest groove over the height, and over the width
_DEEPEST = 0.15


def brain_surface(brain: Brain) -> tuple[Array, Ints]:
    """Vertices and triangles of a brain-shaped phantom."""
    # Shapes: brain mm; returns (n, 3), mm; returns (m, 3).
    deepest = _DEEPEST * min(brain.height_mm, brain.width_mm)
    if brain.fissure_mm > deepest:
        rule = f"{brain.fissure_mm:g} mm is too deep for a body of this height and width"
        raise InputError(Fault("specimen.fissure", rule, f"at most {deepest:.3g} mm"))
    # an octahedron whose triangles are quartered and whose corners are pushed out to radius 1
    points = np.vstack([np.eye(3), -np.eye(3)])
    upper = [(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2)]
    triangles = np.array([*upper, *((b, a, 5) for a, b, _ in upper)], dtype=np.int64)
    for _ in range(_QUARTERED):
        points, triangles = _quartered(points, triangles)
    x, y, z = points.T
    y = y * (1 - _TAPER * x)
    z = np.where(z < 0, _WAIST * z, (1 - _WAIST) * z)
    extents = np.array([brain.length_mm, brain.width_mm, brain.height_mm])
    points = np.column_stack([x, y, z])
    low, high = points.min(axis=0), points.max(axis=0)
    points = (points - low) * (extents / (high - low)) - extents * np.array([0.5, 0.5, 0.0])
    return _grooved(points, brain), triangles


def _grooved(points: Array, brain: Brain) -> Array:
    """Points with the groove, so deep below the highest ones at its side as was asked for."""
    from scipy.optimize import brentq

    if not brain.fissure_mm:
        return points
    above = np.clip(points[:, 2] / brain.height_mm - _WAIST, 0, None) / (1 - _WAIST)
    across = points[:, 1] / (_GROOVE * brain.fissure_mm)
    share = above**2 * np.exp(-(across**2))

    def lowered(by: float) -> Array:
        """Height of every point, stretched back: the round top sinks with the groove."""
        z = points[:, 2] - by * share
        return np.asarray(z * (brain.height_mm / z.max()))

    middle = int(points[:, 2].argmax())
    highest = 0.9 * brain.height_mm
    depth = brentq(
        lambda by: brain.height_mm - lowered(by)[middle] - brain.fissure_mm, 0.0, highest
    )
    return np.column_stack([points[:, :2], lowered(depth)])


def _quartered(points: Array, triangles: Ints) -> tuple[Array, Ints]:
    a, b, c = triangles.T
    sides = np.sort(np.concatenate([[a, b], [b, c], [c, a]], axis=1), axis=0)
    ends, which = np.unique(sides, axis=1, return_inverse=True)
    middles = points[ends[0]] + points[ends[1]]
    middles /= np.linalg.norm(middles, axis=1)[:, None]
    ab, bc, ca = len(points) + which.reshape(3, -1)
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.vstack([points, middles]), np.concatenate([np.column_stack(p) for p in parts])
