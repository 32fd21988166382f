"""Triangles of a surface that pass through one another.

Pairs whose boxes overlap are found by a sweep along one axis; of each pair the separating
axes of two triangles decide (Gottschalk, Lin, Manocha 1996, SIGGRAPH, 171). Neighbors that
only touch are separated by an axis too, so that shared points and edges need no rule of
their own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from study.forward.compiled import kernel, part

Array = NDArray[np.float64]
Cells = NDArray[np.int64]

#: overlap, over the extent of the surface, below which triangles only touch
_DEPTH = 1e-6


def first_intersection(points: Array, triangles: Cells) -> tuple[int, int, Array, int] | None:
    """First pair of triangles that intersect.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Vertices.
    triangles : ndarray of int, shape (m, 3)
        Points of each triangle, none of them degenerate.

    Returns
    -------
    (a, b, place, count) or None
        Numbers of the two, a point between them, and how many pairs intersect.
    """
    corners = np.ascontiguousarray(points[triangles])
    sides = np.roll(corners, -1, axis=1) - corners
    normals = np.cross(sides[:, 0], sides[:, 1])
    low, high = corners.min(axis=1), corners.max(axis=1)
    axis = min(range(3), key=lambda k: _meetings(low[:, k], high[:, k]))
    order = np.argsort(low[:, axis], kind="stable")
    tolerance = _DEPTH * float(np.ptp(points, axis=0).max())
    a, b, count = _sweep(corners, sides, normals, low, high, order, axis, tolerance)
    if not count:
        return None
    place = (np.maximum(low[a], low[b]) + np.minimum(high[a], high[b])) / 2
    return int(min(a, b)), int(max(a, b)), place, int(count)


def _meetings(low: Array, high: Array) -> int:
    """Count the pairs that a sweep along an axis looks at."""
    begins = np.sort(low)
    return int(np.searchsorted(begins, high, side="right").sum())


@kernel()
def _sweep(
    corners: Array,
    sides: Array,
    normals: Array,
    low: Array,
    high: Array,
    order: Cells,
    axis: int,
    tolerance: float,
) -> tuple[int, int, int]:
    """First pair of triangles that meet in the order of the sweep, and the number of pairs."""
    first, second, count, work = -1, -1, 0, np.empty(3)
    for p in range(order.size):
        i = order[p]
        for q in range(p + 1, order.size):
            j = order[q]
            if low[j, axis] > high[i, axis]:
                break
            apart = False
            for k in range(3):
                apart |= low[i, k] > high[j, k] or low[j, k] > high[i, k]
            if not apart and _meet(corners, sides, normals, i, j, work, tolerance):
                if not count:
                    first, second = i, j
                count += 1
    return first, second, count


@part()
def _meet(
    corners: Array, sides: Array, normals: Array, i: int, j: int, axis: Array, tolerance: float
) -> bool:
    """Whether two triangles overlap along every axis that could separate them."""
    a, b = corners[i], corners[j]
    lies = _extent(a, b, normals[i], tolerance)
    coplanar = lies == 2
    if not coplanar and (lies != 1 or _extent(a, b, normals[j], tolerance) != 1):
        return False
    for k in range(3):
        _cross(normals[i], sides[i, k], axis)
        if _extent(a, b, axis, tolerance) != 1:
            return False
        _cross(normals[j], sides[j, k], axis)
        if _extent(a, b, axis, tolerance) != 1:
            return False
    for k in range(9):
        _cross(sides[i, k // 3], sides[j, k % 3], axis)
        if not coplanar and _extent(a, b, axis, tolerance) != 1:
            return False
    return True


@part()
def _extent(a: Array, b: Array, axis: Array, tolerance: float) -> int:
    """How two triangles lie along an axis: 0 apart or only touching, 1 overlapping, 2 level.

    Level means that all six corners are in one plane across the axis. An axis of length zero
    separates nothing.
    """
    length = np.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2)
    if length == 0.0:
        return 1
    low_a, high_a, low_b, high_b = np.inf, -np.inf, np.inf, -np.inf
    for k in range(3):
        # from a corner, so that a surface far from its origin loses no digits
        pa, pb = 0.0, 0.0
        for c in range(3):
            pa += (a[k, c] - a[0, c]) * axis[c]
            pb += (b[k, c] - a[0, c]) * axis[c]
        low_a, high_a = min(low_a, pa), max(high_a, pa)
        low_b, high_b = min(low_b, pb), max(high_b, pb)
    limit = tolerance * length
    if max(high_a, high_b) - min(low_a, low_b) < limit:
        return 2
    return 1 if min(high_a - low_b, high_b - low_a) > limit else 0


@part()
def _cross(u: Array, v: Array, out: Array) -> None:
    out[0] = u[1] * v[2] - u[2] * v[1]
    out[1] = u[2] * v[0] - u[0] * v[2]
    out[2] = u[0] * v[1] - u[1] * v[0]
