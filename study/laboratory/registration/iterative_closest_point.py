"""Rigid registration of a cloud to a surface by iterated closest points.

First trimmed (Chetverikov, Stepanov and Krsek 2005): of every pairing only the nearest share
counts, from several starts. Then Tukey's biweight on the distances along the normals (Chen and
Medioni 1992), whose Gauss-Newton steps converge to the rounding. Directions in which the
surface can slide along itself are found, left alone, and named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from study.ground.arrays import Array, Ints
from study.ground.canonical import Keyed
from study.laboratory.registration.rigid import (
    BIWEIGHT,
    RigidMotion,
    biweight,
    fit_pairs,
    identity,
    inlier_scale,
    on_a_line,
    sandwich,
    turned_about,
)
from study.mechanics.surface.closed_surface import Triangles

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


# Distances along normals, linearized by a small rigid motion. Motions along a surface itself have
# eigenvalues near zero (Gelfand and Guibas 2004).

#: Eigenvalue of the normal matrix, over the largest, below which a direction slides: rotations
#: are counted in arcs at the RMS distance, so that both kinds compare. A smooth ellipsoid of
#: axes 1 : 1.1 has 4e-3 about the third one, a cylinder with 180 facets 1e-4.
SLIDING = 1e-3


@dataclass(frozen=True)
class Sliding:
    """Small motion that the registration does not fix."""

    #: shape (3,); axis, times the share of rotation, in arcs at the RMS distance from the center.
    rotation: Array
    #: shape (3,); direction, times the share of translation.
    translation: Array

    def __str__(self) -> str:
        turns = bool(np.linalg.norm(self.rotation) >= np.linalg.norm(self.translation))
        word = "rotation about" if turns else "translation along"
        vector = self.rotation if turns else self.translation
        vector = vector / max(float(np.linalg.norm(vector)), 1e-300)
        vector = vector * np.sign(vector[np.abs(vector).argmax()])
        listed = ", ".join(f"{v + 0.0:.2f}" for v in np.where(np.abs(vector) < 5e-3, 0.0, vector))
        return f"{word} ({listed})"


def motion_slopes(away: Array) -> Array:
    """Differentiate moved points by a rotation vector and a translation, shape (n, 3, 6)."""
    # Shapes: away (n, 3), mm; returns mm.
    slopes = np.zeros((len(away), 3, 6))
    x, y, z = away.T
    slopes[:, 0, 1], slopes[:, 0, 2] = z, -y
    slopes[:, 1, 0], slopes[:, 1, 2] = -z, x
    slopes[:, 2, 0], slopes[:, 2, 1] = y, -x
    slopes[:, :, 3:] = np.eye(3)
    return slopes


@dataclass(frozen=True)
class NormalEquations:
    """Linearized distances along the normals."""

    #: shape (n,); signed distances, mm.
    residual: Array
    #: shape (n, 6); derivatives by rotation about ``center`` in arcs at ``arm`` and by translation.
    slope: Array
    #: shape (3,); center of rotation, mm.
    center: Array
    #: RMS distance from it, mm: makes rotations lengths.
    arm: float
    #: shape (n, 3); closest points, mm.
    places: Array

    def modes(self, weights: Array) -> tuple[Array, Array]:
        """Eigenvalues over the largest and eigenvectors (columns) of the normal matrix."""
        normal = (self.slope * weights[:, None]).T @ self.slope
        values, vectors = np.linalg.eigh(normal)
        return values / max(float(values[-1]), 1e-300), vectors

    def fixed(self, weights: Array) -> int:
        """Count the motions that do not slide."""
        return int((self.modes(weights)[0] > SLIDING).sum())

    def step(self, weights: Array) -> Array:
        """Least-squares step in the directions that do not slide, shape (6,), mm."""
        values, vectors = self.modes(weights)
        firm = vectors[:, values > SLIDING]
        reduced = self.slope @ firm
        weighted = reduced * weights[:, None]
        return np.asarray(firm @ np.linalg.solve(weighted.T @ reduced, -weighted.T @ self.residual))

    def motion(self, step: Array) -> RigidMotion:
        """Rigid motion of a step."""
        return turned_about(self.center, step[:3] / self.arm, step[3:])


def normal_equations(moved: Array, closest: Closest, weights: Array) -> NormalEquations:
    """Linearize the distances from moved points to their closest ones about their center."""
    # Shapes: moved (n, 3), mm; weights (n,).
    center = np.average(moved, axis=0, weights=weights) if weights.any() else moved.mean(axis=0)
    away = moved - center
    arm = float(np.sqrt(np.average((away**2).sum(axis=1), weights=weights + 1e-300)))
    # between surface and point the normal is the direction of the gap, where there is one
    gap = moved - closest.points
    length = np.linalg.norm(gap, axis=1)
    sharp = length > 1e-9 * max(arm, 1e-300)
    normal = closest.normal.copy()
    sign = np.sign(closest.distance[sharp])
    normal[sharp] = gap[sharp] / (length[sharp] * np.where(sign == 0, 1, sign))[:, None]
    slope = np.einsum("ni,nij->nj", normal, motion_slopes(away))
    slope[:, :3] /= max(arm, 1e-300)
    return NormalEquations(closest.distance, slope, center, arm, closest.points)


#: Share of the nearest pairs that count while it is still far: leaves room for 30 % outliers
#: and for a tenth of the cloud on parts that the surface has not.
TRIM = 0.6
COARSE_POINTS = 400
#: Steps between points from every start, then most steps along the normals.
POINT_STEPS = 4
NORMAL_STEPS = 20
#: Starts that go on to the settled residual.
FINALISTS = 2
#: Relative change of the trimmed residual at which a start is compared, and has settled.
COMPARED = 1e-2
SETTLED = 1e-5
#: Share of the pairs that count where nearly the whole cloud may belong to the surface.
NEARLY_ALL = 0.95
#: Points by which motions of both shares are compared.
COMPARED_POINTS = 1600
#: Points used in the end; more of them no longer change the pose by what matters.
FINE_POINTS = 20_000
FINE_STEPS = 100
#: Rounding of a registration over the size of the surface.
ROUNDING_SHARE = 1e-12
#: Patches of the surface whose residuals may go together in the stated uncertainty.
PATCHES = 60
#: With fewer points in a patch, or fewer patches, residuals are taken as independent.
FEWEST_IN_PATCH = 5
FEWEST_PATCHES = 20
#: Factor by which a robust scale grows that would free a motion.
WIDER = 3.0
#: Steps after which the robust scale is held.
SCALE_SETTLES = 20


@dataclass(frozen=True)
class Registration(Keyed):
    """Cloud registered to a surface."""

    KEYS = (
        "rotation=motion.rotation translation_mm=motion.translation angle_deg=motion.angle_deg "
        "center_mm=center rotation_uncertainty_deg translation_uncertainty_mm "
        "residual_rms_mm=rms_mm residual_scale_mm=scale_mm null_space rejected_points=rejected "
        "points=used steps converged"
    )

    #: Carries the cloud onto the surface.
    motion: RigidMotion
    #: shape (3,); point about which the covariance is stated: the mean of the registered cloud, mm.
    center: Array
    #: shape (6, 6); of the small rotation about ``center`` (rad) and the translation (mm); zero
    #: along directions that slide. Residuals of a patch of the surface may go together in it.
    covariance: Array
    #: RMS of the weighted distances along the normals.
    rms_mm: float
    #: Robust standard deviation of the distances.
    scale_mm: float
    #: Motions that are not fixed: the null space.
    sliding: tuple[Sliding, ...]
    #: Points without weight among those used.
    rejected: int
    used: int
    steps: int
    #: Whether the last step was below the rounding or a thousandth of its uncertainty.
    converged: bool

    def uncertainty_at(self, points: Array) -> Array:
        """Return the standard uncertainty of the place of registered points, shape (n,), mm."""
        slopes = motion_slopes(points - self.center)
        variance = np.einsum("nij,jk,nik->n", slopes, self.covariance, slopes)
        return np.asarray(np.sqrt(variance.clip(0)))

    @property
    def rotation_uncertainty_deg(self) -> Array:
        """Standard uncertainties of the rotation about each axis, shape (3,)."""
        return np.asarray(np.degrees(np.sqrt(np.diag(self.covariance)[:3].clip(0))))

    @property
    def translation_uncertainty_mm(self) -> Array:
        """Standard uncertainties of the translation along each axis, shape (3,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)[3:].clip(0)))

    @property
    def null_space(self) -> list[str]:
        """Motions that the shape does not fix, in words."""
        return [str(motion) for motion in self.sliding]


def register(
    surface: TriangleSurface, cloud: Array, starts: Sequence[RigidMotion] | None = None
) -> Registration:
    """Rigid motion that carries a cloud onto a surface. Shapes: cloud (n, 3), mm."""
    _, motion = coarse_registration(surface, cloud, starts)
    # The nearest three fifths of a body that is larger all around meet the surface best where it is
    # pushed to one side. Nearly all of it meet it best in the middle.
    some = _thinned(cloud, COMPARED_POINTS)
    _, other = _trimmed(surface, some, motion, 0, SETTLED, NEARLY_ALL)
    motion = min((motion, other), key=lambda tried: _surprise(surface, tried(some)))
    return _refined(surface, _thinned(cloud, FINE_POINTS), motion)


def usual_starts(surface: TriangleSurface, cloud: Array) -> list[RigidMotion]:
    """Motions to begin from: none, centers together, and principal axes together, four ways."""
    # Shapes: surface mm; cloud (n, 3), mm.
    vertices = surface.points[np.unique(surface.triangles)]
    target, center = np.median(vertices, axis=0), np.median(cloud, axis=0)
    starts = [identity(), RigidMotion(np.eye(3), target - center)]
    axes = [np.linalg.svd(p - p.mean(axis=0), full_matrices=False)[2] for p in (vertices, cloud)]
    for signs in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)):
        turn = axes[0].T @ np.diag(np.array(signs, dtype=float)) @ axes[1]
        if np.linalg.det(turn) < 0:
            turn = axes[0].T @ np.diag(-np.array(signs, dtype=float)) @ axes[1]
        starts.append(RigidMotion(turn, target - turn @ center))
    return starts


def coarse_registration(
    surface: TriangleSurface, cloud: Array, starts: Sequence[RigidMotion] | None = None
) -> tuple[float, RigidMotion]:
    """Find the best trimmed registration; only the first few starts go all the way."""
    # Shapes: cloud (n, 3), mm.
    starts = starts or usual_starts(surface, cloud)
    some = _thinned(cloud, COARSE_POINTS)
    first = [_trimmed(surface, some, start, POINT_STEPS, COMPARED) for start in starts]
    first.sort(key=lambda candidate: candidate[0])
    last = [_trimmed(surface, some, motion, 0, SETTLED) for _, motion in first[:FINALISTS]]
    return min(last, key=lambda candidate: candidate[0])


def _thinned(cloud: Array, most: int) -> Array:
    """At most so many points of a cloud, spread over its order."""
    if len(cloud) <= most:
        return cloud
    return cloud[np.random.default_rng(2005).choice(len(cloud), most, replace=False)]


def _trimmed(
    surface: TriangleSurface,
    cloud: Array,
    start: RigidMotion,
    point_steps: int,
    settled: float,
    share: float = TRIM,
) -> tuple[float, RigidMotion]:
    """Trimmed registration from one start: its residual, RMS in mm, and the motion."""
    # Far away a step between points goes the right way, one along normals may not. Where the steps
    # end before the residual has settled, the motion is a start like others: `_refined` says
    # whether the registration that begins there has converged.
    motion, count, last = start, max(int(share * len(cloud)), 3), np.inf
    for number in range(point_steps + NORMAL_STEPS):
        moved = motion(cloud)
        closest = surface.closest(moved, exact=False)
        nearest = np.argsort(np.abs(closest.distance), kind="stable")[:count]
        rms = float(np.sqrt((closest.distance[nearest] ** 2).mean()))
        if number > point_steps and abs(last - rms) <= settled * rms:
            break
        last = rms
        if number < point_steps:
            near, partner = moved[nearest], closest.points[nearest]
            if on_a_line(partner) or on_a_line(near):  # a single edge fixes a shift alone
                step = RigidMotion(np.eye(3), (partner - near).mean(axis=0))
            else:
                step = fit_pairs(near, partner).motion
        else:
            weights = np.zeros(len(cloud))
            weights[nearest] = 1.0
            system = normal_equations(moved, closest, weights)
            step = system.motion(system.step(weights))
        motion = step.after(motion)
    return rms, motion


def _surprise(surface: TriangleSurface, cloud: Array) -> float:
    """Return - log of the likelihood of distances: normal ones, or anywhere on the surface's size.

    A mixture of both, each point in the one that the robust scale gives it to.
    """
    away = surface.closest(cloud, exact=False).distance
    inside = away[np.abs(away) < BIWEIGHT * inlier_scale(away)]
    if not inside.size:
        return float(len(away) * np.log(surface.size))
    scale = max(float(np.sqrt(np.mean(inside**2))), ROUNDING_SHARE * surface.size)
    normal = inside.size * np.log(np.sqrt(2 * np.pi * np.e) * scale)
    return float(normal + (len(away) - inside.size) * np.log(surface.size))


def _refined(surface: TriangleSurface, cloud: Array, motion: RigidMotion) -> Registration:
    """Registration by the biweight, from a motion near to it."""
    floor = ROUNDING_SHARE * surface.size
    scale, converged, last = np.inf, False, np.zeros(6)
    for number in range(FINE_STEPS):
        moved = motion(cloud)
        closest = surface.closest(moved)
        if number < SCALE_SETTLES:
            scale = _fixing_scale(moved, closest, max(inlier_scale(closest.distance), floor))
        weights = biweight(closest.distance / scale)
        system = normal_equations(moved, closest, weights)
        last = _shortened(system.step(weights), last)
        small = max(1e-4 * scale / np.sqrt(len(cloud)), 10 * floor)
        converged = bool(np.linalg.norm(last) <= small)
        if converged:
            break
        motion = system.motion(last).after(motion)
    values, vectors = system.modes(weights)
    firm, loose = vectors[:, values > SLIDING], vectors[:, values <= SLIDING]
    reduced = sandwich(system.slope @ firm, system.residual, scale, _patches(system.places))
    units = np.diag(np.r_[np.full(3, 1 / system.arm), np.ones(3)])
    return Registration(
        motion=motion,
        center=system.center,
        covariance=units @ firm @ reduced @ firm.T @ units,
        rms_mm=float(np.sqrt(np.average(system.residual**2, weights=weights))),
        scale_mm=scale,
        sliding=tuple(Sliding(mode[:3], mode[3:]) for mode in loose.T),
        rejected=int((weights == 0).sum()),
        used=len(weights),
        steps=number + 1,
        converged=converged,
    )


def _shortened(step: Array, last: Array) -> Array:
    """Return a step, shorter where it goes back on the last one."""
    # The linear distances leave out that a body which is larger all around turns with a bend of its
    # own: steps of twice the right length then go to and fro for ever (Aitken's extrapolation).
    back = -float(step @ last) / max(float(last @ last), 1e-300)
    return step / (1 + back) if back > 0 else step


def _fixing_scale(moved: Array, closest: Closest, scale: float) -> float:
    """Return the least scale, from a given one up, whose weights free no motion that is fixed."""
    # Where half of a body is met exactly (flat ends) and the rest to the sag of its facets, the
    # robust scale is that of the exact half, and all that fixes the others would be outliers.
    every = np.ones(len(moved))
    fixed = normal_equations(moved, closest, every).fixed(every)
    while scale < np.abs(closest.distance).max():
        weights = biweight(closest.distance / scale)
        if weights.any() and normal_equations(moved, closest, weights).fixed(weights) >= fixed:
            break
        scale *= WIDER
    return scale


def _patches(places: Array) -> Ints | None:
    """Group closest points by patches; None where there are too few to group."""
    from scipy.cluster.vq import kmeans2
    from scipy.spatial import cKDTree

    count = min(PATCHES, len(places) // FEWEST_IN_PATCH)
    if count < FEWEST_PATCHES:
        return None
    some = _thinned(places, COARSE_POINTS * 4)
    centers, _ = kmeans2(some, count, minit="++", rng=np.random.default_rng(1986))
    return np.asarray(cKDTree(centers).query(places, k=1)[1], dtype=np.int64)


# Closest points on a triangulated surface, exact, and the signed distance to it.
#
# The sign comes from angle-weighted pseudo-normals: that of the face, edge or vertex on which the
# closest point lies, for which Baerentzen and Aanaes 2005 prove that it is right everywhere.


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
    #: shape (n,); signed distance, positive outside, mm.
    distance: Array
    #: shape (n, 3); unit pseudo-normal of the surface there.
    normal: Array


class TriangleSurface(Triangles):
    """Triangulated surface, none of whose triangles is without area, asked for closest points."""

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
        return Closest(nearest, np.where(outside, distance, -distance), normal)

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
        square = np.maximum(_dot(along, along), 1e-300)
        share = np.clip(_dot(points - corners[..., first, :], along) / square, 0, 1)
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
