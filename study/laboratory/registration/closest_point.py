"""Closest points on a triangulated surface, exact, and the signed distance to it.

The sign comes from angle-weighted pseudo-normals: that of the face, edge or vertex on which the
closest point lies, for which Baerentzen and Aanaes 2005 prove that it is right everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from study.ground.arrays import Array, Ints

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


#: Triangles looked at in the first round; a round multiplies it by four where that is too few.
FIRST_CANDIDATES = 8
#: Barycentric coordinate below which a closest point lies on the edge across.
ON_EDGE = 1e-9
#: Pairs of points and triangles computed at once: 2e5 of them take about 100 MB.
PAIRS_AT_ONCE = 200_000


@dataclass(frozen=True)
class Closest:
    """Closest points of a surface."""

    #: shape (n, 3); closest points, mm.
    points: Array
    #: shape (n,); triangle on which each lies.
    triangle: Ints
    #: shape (n, 3); its barycentric coordinates there.
    weights: Array
    #: shape (n,); signed distance, positive outside, mm.
    distance: Array
    #: shape (n, 3); unit pseudo-normal of the surface there.
    normal: Array


@dataclass(frozen=True)
class TriangleSurface:
    """Triangulated surface that can be asked for its closest points."""

    #: shape (n, 3); vertices, mm.
    points: Array
    #: shape (m, 3); counterclockwise seen from outside; none without area.
    triangles: Ints

    @cached_property
    def corners(self) -> Array:
        """Corners of every triangle, shape (m, 3, 3)."""
        return self.points[self.triangles]

    @cached_property
    def _crossed(self) -> Array:
        """Normal of every triangle, twice as long as its area, shape (m, 3)."""
        a, b, c = self.corners[:, 0], self.corners[:, 1], self.corners[:, 2]
        return np.cross(b - a, c - a)

    @cached_property
    def normals(self) -> Array:
        """Unit normal of every triangle, shape (m, 3)."""
        return _unit(self._crossed)

    @cached_property
    def vertex_normals(self) -> Array:
        """Pseudo-normal of every vertex: normals weighted by the angle there, shape (n, 3)."""
        total = np.zeros_like(self.points)
        for k in range(3):
            here, ahead, behind = (self.corners[:, (k + j) % 3] for j in range(3))
            u, v = _unit(ahead - here), _unit(behind - here)
            angle = np.arccos(np.clip((u * v).sum(axis=1), -1, 1))
            np.add.at(total, self.triangles[:, k], angle[:, None] * self.normals)
        return _unit(total)

    @cached_property
    def edge_normals(self) -> Array:
        """Pseudo-normal of the edge across from every corner, shape (m, 3, 3)."""
        # It is the sum of the normals on both sides; an open edge has that of its only triangle.
        across = self.triangles[:, [1, 2, 2, 0, 0, 1]].reshape(-1, 2)
        _, edge = np.unique(np.sort(across, axis=1), axis=0, return_inverse=True)
        edge = edge.ravel()
        total = np.zeros((int(edge.max()) + 1, 3))
        np.add.at(total, edge, np.repeat(self.normals, 3, axis=0))
        return _unit(total)[edge].reshape(-1, 3, 3)

    @cached_property
    def size(self) -> float:
        """Length of the diagonal of the bounding box, mm."""
        return float(np.linalg.norm(np.ptp(self.points[np.unique(self.triangles)], axis=0)))

    @cached_property
    def areas(self) -> Array:
        """Area of every triangle, shape (m,), mm^2."""
        return np.asarray(np.linalg.norm(self._crossed, axis=1) / 2)

    @cached_property
    def _classes(self) -> tuple[tuple[Ints, cKDTree, float], ...]:
        """Triangles of about one size: their numbers, a tree of their centers, their radius."""
        # One large triangle would make every ball large that is searched for candidates, so those
        # beyond twice the median form classes of their own; small ones do no harm.
        from scipy.spatial import cKDTree

        centers = self.corners.mean(axis=1)
        radii = np.linalg.norm(self.corners - centers[:, None], axis=2).max(axis=1)
        octave = np.ceil(np.log2(radii / np.median(radii)).clip(1)).astype(int)
        classes = []
        for k in np.unique(octave):
            members = np.flatnonzero(octave == k)
            classes.append((members, cKDTree(centers[members]), float(radii[members].max())))
        return tuple(classes)

    def closest(self, points: Array, *, exact: bool = True) -> Closest:
        """Closest point of the surface to each of some points. Shapes: points (n, 3), mm."""
        distance = np.full(len(points), np.inf)
        triangle = np.zeros(len(points), dtype=np.int64)
        weights = np.zeros((len(points), 3))
        for members, tree, radius in self._classes:
            reach = radius if exact else -np.inf
            self._search(points, members, tree, reach, (distance, triangle, weights))
        nearest = np.einsum("nk,nkj->nj", weights, self.corners[triangle])
        normal = self._pseudo_normals(triangle, weights)
        outside = ((points - nearest) * normal).sum(axis=1) >= 0
        return Closest(nearest, triangle, weights, np.where(outside, distance, -distance), normal)

    def _search(
        self,
        points: Array,
        members: Ints,
        tree: cKDTree,
        radius: float,
        best: tuple[Array, Ints, Array],
    ) -> None:
        """Improve the best triangles by those of one class."""
        # A triangle is no nearer than its center less its radius, so a point is done when the
        # farthest center that was looked at is beyond the best distance by a radius (which is minus
        # infinity where one round is enough).
        distance, triangle, weights = best
        left, count = np.arange(len(points)), FIRST_CANDIDATES
        while left.size:
            count = min(count, len(members))
            step = max(PAIRS_AT_ONCE // count, 1)
            open_ones = []
            for begin in range(0, left.size, step):
                some = left[begin : begin + step]
                away, near = tree.query(points[some], k=count)
                away, near = away.reshape(len(some), -1), near.reshape(len(some), -1)
                d, w = point_triangle(points[some, None], self.corners[members[near]])
                which = d.argmin(axis=1)
                row = np.arange(len(some))
                better = d[row, which] < distance[some]
                distance[some[better]] = d[row, which][better]
                triangle[some[better]] = members[near[row, which]][better]
                weights[some[better]] = w[row, which][better]
                open_ones.append(some[away[:, -1] - radius < distance[some]])
            if count == len(members):
                return
            left, count = np.concatenate(open_ones), 4 * count

    def _pseudo_normals(self, triangle: Ints, weights: Array) -> Array:
        """Find the normal of the face, edge or vertex that holds each point."""
        zero = weights < ON_EDGE
        count = zero.sum(axis=1)
        normal = self.normals[triangle].copy()
        on_edge, on_vertex = count == 1, count == 2
        across = zero.argmax(axis=1)
        normal[on_edge] = self.edge_normals[triangle[on_edge], across[on_edge]]
        corner = weights.argmax(axis=1)
        vertex = self.triangles[triangle[on_vertex], corner[on_vertex]]
        normal[on_vertex] = self.vertex_normals[vertex]
        return normal


def _unit(vectors: Array) -> Array:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, 1e-300))


def point_triangle(points: Array, corners: Array) -> tuple[Array, Array]:
    """Distance from points to triangles, and the barycentric coordinates of the closest point.

    The nearest of the three edges, unless the foot of the perpendicular lies inside
    (Ericson 2005, section 5.1.5, without its branches).

    Shapes: points (..., 1, 3), mm; corners (..., k, 3, 3), mm; returns (..., k); returns (..., k,
    3).
    """
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    ab, ac, ap = b - a, c - a, points - a
    d_bb, d_bc, d_cc = _dot(ab, ab), _dot(ab, ac), _dot(ac, ac)
    p_b, p_c = _dot(ap, ab), _dot(ap, ac)
    determinant = np.maximum(d_bb * d_cc - d_bc**2, 1e-300)
    v = (d_cc * p_b - d_bc * p_c) / determinant
    w = (d_bb * p_c - d_bc * p_b) / determinant
    weights = np.stack([1 - v - w, v, w], axis=-1)
    inside = (weights >= 0).all(axis=-1)
    best = np.where(inside, _squared(weights, corners, points), np.inf)
    for first, second in ((0, 1), (1, 2), (2, 0)):
        along = corners[..., second, :] - corners[..., first, :]
        share = _dot(points - corners[..., first, :], along) / np.maximum(
            _dot(along, along), 1e-300
        )
        share = np.clip(share, 0, 1)
        edge = np.zeros_like(weights)
        edge[..., first], edge[..., second] = 1 - share, share
        away = _squared(edge, corners, points)
        nearer = away < best
        best = np.where(nearer, away, best)
        weights = np.where(nearer[..., None], edge, weights)
    return np.sqrt(best), weights


def _dot(u: Array, v: Array) -> Array:
    return np.asarray(np.einsum("...i,...i->...", u, v))


def _squared(weights: Array, corners: Array, points: Array) -> Array:
    away = np.einsum("...k,...kj->...j", weights, corners) - points
    return _dot(away, away)
