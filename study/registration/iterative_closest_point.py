"""Rigid registration of a cloud to a surface by iterated closest points.

First trimmed (Chetverikov, Stepanov and Krsek 2005): of every pairing only the nearest share
counts, from several starts. Then Tukey's biweight on the distances along the normals (Chen and
Medioni 1992), whose Gauss-Newton steps converge to the rounding. Directions in which the
surface can slide along itself are found, left alone, and named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from study.arrays import Array, Ints
from study.registration.closest_point import Closest, TriangleSurface
from study.registration.normal_equations import (
    SLIDING,
    NormalEquations,
    Sliding,
    motion_slopes,
    normal_equations,
)
from study.registration.rigid import (
    RigidMotion,
    fit_pairs,
    identity,
    on_a_line,
)
from study.registration.robust import BIWEIGHT, biweight, inlier_scale, sandwich

#: Share of the nearest pairs that count while it is still far: leaves room for 30 % outliers
#: and for a tenth of the cloud on parts that the surface has not.
TRIM = 0.6

#: Points used from every start.
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
class Registration:
    """Cloud registered to a surface.

    Parameters
    ----------
    motion : RigidMotion
        Carries the cloud onto the surface.
    center : ndarray, shape (3,)
        Point about which the covariance is stated: the mean of the registered cloud, mm.
    covariance : ndarray, shape (6, 6)
        Of the small rotation about ``center`` (rad) and the translation (mm); zero along
        directions that slide. Residuals of a patch of the surface may go together in it.
    rms_mm : float
        RMS of the weighted distances along the normals.
    scale_mm : float
        Robust standard deviation of the distances.
    sliding : tuple of Sliding
        Motions that are not fixed: the null space.
    rejected : int
        Points without weight among those used.
    used : int
        Points used.
    steps : int
        Steps of the last stage.
    converged : bool
        Whether the last step was below the rounding or a thousandth of its uncertainty.
    """

    motion: RigidMotion
    center: Array
    covariance: Array
    rms_mm: float
    scale_mm: float
    sliding: tuple[Sliding, ...]
    rejected: int
    used: int
    steps: int
    converged: bool

    def uncertainty_at(self, points: Array) -> Array:
        """Return the standard uncertainty of the place of registered points, shape (n,), mm."""
        slopes = motion_slopes(points - self.center)
        return np.asarray(
            np.sqrt(np.einsum("nij,jk,nik->n", slopes, self.covariance, slopes).clip(0))
        )

    def to_json(self) -> dict[str, object]:
        """Plain values; lengths in mm, angles in deg."""
        deviations = np.sqrt(np.diag(self.covariance).clip(0))
        return {
            **self.motion.to_json(),
            "center_mm": self.center.tolist(),
            "rotation_uncertainty_deg": np.degrees(deviations[:3]).tolist(),
            "translation_uncertainty_mm": deviations[3:].tolist(),
            "residual_rms_mm": self.rms_mm,
            "residual_scale_mm": self.scale_mm,
            "null_space": [str(one) for one in self.sliding],
            "rejected_points": self.rejected,
            "points": self.used,
            "steps": self.steps,
            "converged": self.converged,
        }


def register(
    surface: TriangleSurface, cloud: Array, starts: Sequence[RigidMotion] | None = None
) -> Registration:
    """Rigid motion that carries a cloud onto a surface.

    Parameters
    ----------
    surface : TriangleSurface
        The fixed surface.
    cloud : ndarray, shape (n, 3)
        Points, mm; up to a third may be outliers.
    starts : sequence of RigidMotion, optional
        Motions to begin from; by default as it lies, shifted, and along the principal axes.

    Returns
    -------
    Registration
    """
    _, motion = coarse_registration(surface, cloud, starts)
    motion = _likelier(surface, _thinned(cloud, COMPARED_POINTS), motion)
    return _refined(surface, _thinned(cloud, FINE_POINTS), motion)


def usual_starts(surface: TriangleSurface, cloud: Array) -> list[RigidMotion]:
    """Motions to begin from: none, centers together, and principal axes together, four ways.

    Parameters
    ----------
    surface : TriangleSurface
        The fixed surface, mm.
    cloud : ndarray, shape (n, 3)
        Points that are to be moved, mm.
    """
    vertices = surface.points[np.unique(surface.triangles)]
    target, own = np.median(vertices, axis=0), np.median(cloud, axis=0)
    starts = [identity(), RigidMotion(np.eye(3), target - own)]
    axes = [np.linalg.svd(p - p.mean(axis=0), full_matrices=False)[2] for p in (vertices, cloud)]
    for signs in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)):
        turn = axes[0].T @ np.diag(np.array(signs, dtype=float)) @ axes[1]
        if np.linalg.det(turn) < 0:
            turn = axes[0].T @ np.diag(-np.array(signs, dtype=float)) @ axes[1]
        starts.append(RigidMotion(turn, target - turn @ own))
    return starts


def coarse_registration(
    surface: TriangleSurface, cloud: Array, starts: Sequence[RigidMotion] | None = None
) -> tuple[float, RigidMotion]:
    """Find the best trimmed registration; only the first few starts go all the way.

    Parameters
    ----------
    surface : TriangleSurface
        The fixed surface.
    cloud : ndarray, shape (n, 3)
        Points, mm.
    starts : sequence of RigidMotion, optional
        As of :func:`register`.

    Returns
    -------
    rms_mm : float
        RMS distance of the nearest share of the cloud.
    motion : RigidMotion
        Carries the cloud near the surface.
    """
    starts = starts or usual_starts(surface, cloud)
    some = _thinned(cloud, COARSE_POINTS)
    first = [_trimmed(surface, some, start, POINT_STEPS, COMPARED) for start in starts]
    first.sort(key=lambda found: found[0])
    last = [_trimmed(surface, some, motion, 0, SETTLED) for _, motion in first[:FINALISTS]]
    return min(last, key=lambda found: found[0])


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
    """Trimmed registration from one start: its residual, RMS in mm, and the motion.

    Far away a step between points goes the right way, one along normals may not.
    """
    motion, count, last = start, max(int(share * len(cloud)), 3), np.inf
    for number in range(point_steps + NORMAL_STEPS):
        moved = motion(cloud)
        found = surface.closest(moved, exact=False)
        kept = np.argsort(np.abs(found.distance), kind="stable")[:count]
        rms = float(np.sqrt((found.distance[kept] ** 2).mean()))
        if number > point_steps and abs(last - rms) <= settled * rms:
            break
        last = rms
        if number < point_steps:
            step = _point_step(moved[kept], found.points[kept])
        else:
            step = _step(moved, found, _kept_weights(len(cloud), kept))
        motion = step.after(motion)
    return rms, motion


def _likelier(surface: TriangleSurface, cloud: Array, motion: RigidMotion) -> RigidMotion:
    """Motion near a given one under which a cloud is likelier.

    The nearest three fifths of a body that is larger all around meet the surface best where it
    is pushed to one side. Nearly all of it meet it best in the middle.
    """
    _, other = _trimmed(surface, cloud, motion, 0, SETTLED, NEARLY_ALL)
    return min((motion, other), key=lambda one: _surprise(surface, one(cloud)))


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


def _point_step(moved: Array, found: Array) -> RigidMotion:
    """Motion between points and their closest ones; a shift where those are a single edge."""
    if on_a_line(found) or on_a_line(moved):
        return RigidMotion(np.eye(3), (found - moved).mean(axis=0))
    return fit_pairs(moved, found).motion


def _kept_weights(n: int, kept: Ints) -> Array:
    weights = np.zeros(n)
    weights[kept] = 1.0
    return weights


def _step(moved: Array, found: Closest, weights: Array) -> RigidMotion:
    system = normal_equations(moved, found, weights)
    return system.motion(system.step(weights))


def _refined(surface: TriangleSurface, cloud: Array, motion: RigidMotion) -> Registration:
    """Registration by the biweight, from a motion near to it."""
    floor = ROUNDING_SHARE * surface.size
    scale, converged, steps, last = np.inf, False, 0, np.zeros(6)
    for number in range(FINE_STEPS):
        moved = motion(cloud)
        found = surface.closest(moved)
        if number < SCALE_SETTLES:
            scale = _fixing_scale(moved, found, max(inlier_scale(found.distance), floor))
        weights = biweight(found.distance / scale)
        system = normal_equations(moved, found, weights)
        last = step = _shortened(system.step(weights), last)
        steps = number + 1
        small = max(1e-4 * scale / np.sqrt(len(cloud)), 10 * floor)
        if np.linalg.norm(step) <= small:
            converged = True
            break
        motion = system.motion(step).after(motion)
    return _described(motion, system, weights, scale, (steps, converged))


def _shortened(step: Array, last: Array) -> Array:
    """Return a step, shorter where it goes back on the last one.

    The linear distances leave out that a body which is larger all around turns with a bend of its
    own: steps of twice the right length then go to and fro for ever (Aitken's extrapolation).
    """
    back = -float(step @ last) / max(float(last @ last), 1e-300)
    return step / (1 + back) if back > 0 else step


def _fixing_scale(moved: Array, found: Closest, scale: float) -> float:
    """Return the least scale, from a given one up, whose weights free no motion that is fixed.

    Where half of a body is met exactly (flat ends) and the rest to the sag of its facets, the
    robust scale is that of the exact half, and all that fixes the others would be outliers.
    """
    every = np.ones(len(moved))
    fixed = normal_equations(moved, found, every).fixed(every)
    while scale < np.abs(found.distance).max():
        weights = biweight(found.distance / scale)
        if weights.any() and normal_equations(moved, found, weights).fixed(weights) >= fixed:
            break
        scale *= WIDER
    return scale


def _described(
    motion: RigidMotion,
    system: NormalEquations,
    weights: Array,
    scale: float,
    end: tuple[int, bool],
) -> Registration:
    values, vectors = system.modes(weights)
    firm, loose = vectors[:, values > SLIDING], values <= SLIDING
    patches = _patches(system.places)
    reduced = sandwich(system.slope @ firm, system.residual, scale, patches)
    units = np.diag(np.r_[np.full(3, 1 / system.arm), np.ones(3)])
    covariance = units @ firm @ reduced @ firm.T @ units
    sliding = tuple(
        Sliding(vectors[:3, k], vectors[3:, k], float(values[k])) for k in np.flatnonzero(loose)
    )
    return Registration(
        motion=motion,
        center=system.center,
        covariance=covariance,
        rms_mm=float(np.sqrt(np.average(system.residual**2, weights=weights))),
        scale_mm=scale,
        sliding=sliding,
        rejected=int((weights == 0).sum()),
        used=len(weights),
        steps=end[0],
        converged=end[1],
    )


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
