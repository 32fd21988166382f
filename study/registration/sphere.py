"""Spheres fitted to scanned points.

Start: the algebraic fit that Pratt 1987 normalizes by the gradient, solved as an eigenproblem;
it stays unbiased enough on a small cap, where the plain linear fit shrinks. Then the geometric
distances are least in a robust sense: Tukey's biweight with Gauss-Newton steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.errors import Fault, InputError, RefusedError
from study.registration.rigid import SAME_PLACE_MM, check_places
from study.registration.robust import biweight, inlier_scale, sandwich

#: Fewest points that fix a sphere and leave one over for its scatter.
FEWEST_POINTS = 5

#: Steps of the geometric fit; from the algebraic start it takes about six.
MAX_STEPS = 100

#: Steps after which the scale is held, so that the fit has one minimum to go to.
SCALE_SETTLES = 10

#: Relative change of center and radius at which the fit has converged.
CONVERGED = 1e-12

#: the same above which there is no answer after the last of them
SETTLED = 1e-6

#: Residuals below this share of the radius are rounding.
ROUNDING_SHARE = 1e-12

#: Standard uncertainty over radius beyond which the points do not fix a sphere.
LARGEST_UNCERTAINTY = 0.5


@dataclass(frozen=True)
class Sphere:
    """Sphere with the uncertainty of its center and radius.

    Parameters
    ----------
    center : ndarray, shape (3,)
        Center, mm.
    radius_mm : float
        Radius.
    covariance : ndarray, shape (4, 4)
        Of center and radius, mm^2; independent errors along the normal are assumed.
    scatter_mm : float
        Robust standard deviation of the points about the sphere.
    points : int
        Number of points.
    outliers : int
        Points that the biweight gives no weight.
    coverage : float
        Share of the sphere that the points cover, as seen from the center: the solid angle of
        the smallest cap about their mean direction that holds them all, over 4 pi.
    """

    center: Array
    radius_mm: float
    covariance: Array
    scatter_mm: float
    points: int
    outliers: int
    coverage: float

    @property
    def center_uncertainty_mm(self) -> Array:
        """Standard uncertainty of the coordinates of the center, shape (3,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)[:3]))

    @property
    def radius_uncertainty_mm(self) -> float:
        """Standard uncertainty of the radius."""
        return float(np.sqrt(self.covariance[3, 3]))

    def to_json(self) -> dict[str, object]:
        """Plain values; lengths in mm."""
        return {
            "center_mm": self.center.tolist(),
            "center_uncertainty_mm": self.center_uncertainty_mm.tolist(),
            "radius_mm": self.radius_mm,
            "radius_uncertainty_mm": self.radius_uncertainty_mm,
            "scatter_mm": self.scatter_mm,
            "points": self.points,
            "outliers": self.outliers,
            "coverage": self.coverage,
        }


def fit_sphere(points: Array, where: str = "sphere") -> Sphere:
    """Sphere through scanned points, with its uncertainty.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Points on the sphere, mm; up to about a third may be outliers.
    where : str
        Name of the scan in messages.

    Returns
    -------
    Sphere

    Raises
    ------
    InputError
        For fewer than five points, points in a plane, or a cap too flat for a radius.
    """
    if len(points) < FEWEST_POINTS:
        rule = f"has {len(points)} points, a sphere needs {FEWEST_POINTS}"
        raise InputError(Fault(where, rule, "scan more of it"))
    check_places(points, where)
    extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if extents[2] <= max(1e-9 * extents[0], SAME_PLACE_MM):
        rule = "the points lie in a plane, on a line or at one place: no sphere is fixed"
        raise InputError(Fault(where, rule, "scan a larger part of the sphere"))
    center, radius = _consensus(points)
    values, scale = _geometric(points, np.append(center, radius))
    sphere = _described(points, values, scale)
    if sphere.radius_uncertainty_mm > LARGEST_UNCERTAINTY * sphere.radius_mm:
        rule = f"the points cover {100 * sphere.coverage:.2g} % of a sphere: its radius is open"
        raise InputError(Fault(where, rule, "scan a larger part of the sphere"))
    return sphere


def algebraic_sphere(points: Array) -> tuple[Array, float]:
    """Center and radius by Pratt's algebraic fit.

    Least sum of (A |x|^2 + B.x + D)^2 under |B|^2 - 4 A D = 1, so that near the sphere the
    algebraic distance is the geometric one.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        On or near the sphere, mm.

    Returns
    -------
    center : ndarray, shape (3,)
        In mm.
    radius : float
        In mm.

    Raises
    ------
    InputError
        If the points lie in a plane.
    """
    middle = points.mean(axis=0)
    size = float(np.sqrt(((points - middle) ** 2).sum(axis=1).mean()))
    x = (points - middle) / size
    moments = np.column_stack([(x**2).sum(axis=1), x, np.ones(len(x))])
    # eigenvectors of C^-1 M, M the moments and C the constraint: the smallest positive value
    constraint = np.zeros((5, 5))
    constraint[1:4, 1:4] = np.eye(3)
    constraint[0, 4] = constraint[4, 0] = -2.0
    values, vectors = np.linalg.eig(np.linalg.solve(constraint, moments.T @ moments / len(x)))
    real = np.real(values)
    # the positive definite moments leave one negative eigenvalue; rounding may bring one to 0
    order = np.argsort(np.where(real < -1e-9 * np.abs(real).max(), np.inf, np.abs(real)))
    a, *b, d = np.real(vectors[:, order[0]])
    if abs(a) < 1e-12 * np.abs(b).max():
        raise InputError(Fault("sphere", "the points lie in a plane: no sphere is fixed"))
    center = -np.array(b) / (2 * a)
    radius = float(np.sqrt(max(center @ center - d / a, 0.0)))
    return middle + size * center, size * radius


#: Draws of points for a start that outliers cannot spoil: with 35 % outliers a draw of four is
#: clean with probability 0.18, so 60 draws have none with probability 1e-5.
DRAWS = 60


def _consensus(points: Array) -> tuple[Array, float]:
    """Start: the algebraic fit of all points or of a small draw, whichever most points are near.

    Least median of squares (Rousseeuw 1984); the draws have a fixed seed.
    """
    rng = np.random.default_rng(1984)
    choices = [points, *(points[rng.choice(len(points), 4, replace=False)] for _ in range(DRAWS))]
    best = (np.inf, points.mean(axis=0), 1.0)
    for k, chosen in enumerate(choices):
        found = algebraic_sphere(chosen) if k == 0 else _through(chosen)
        if found is None:
            continue
        center, radius = found
        off = float(np.median(np.abs(np.linalg.norm(points - center, axis=1) - radius)))
        if off < best[0]:
            best = (off, center, radius)
    center, radius = best[1:]
    off = np.abs(np.linalg.norm(points - center, axis=1) - radius)
    near = points[off <= np.maximum(4 * np.median(off), 1e-9 * radius)]
    return algebraic_sphere(near) if len(near) >= FEWEST_POINTS else (center, radius)


def _through(four: Array) -> tuple[Array, float] | None:
    """Sphere through four points; None where they lie in a plane."""
    matrix = 2 * (four[1:] - four[0])
    right = (four[1:] ** 2).sum(axis=1) - (four[0] ** 2).sum()
    if abs(np.linalg.det(matrix)) <= 1e-12 * np.abs(matrix).max() ** 3:
        return None
    center = np.linalg.solve(matrix, right)
    return center, float(np.linalg.norm(four[0] - center))


def _geometric(points: Array, start: Array) -> tuple[Array, float]:
    """Center and radius with the least robust sum of distances, and their scale."""
    values = start
    scale = _scale(points, values)
    for step_number in range(MAX_STEPS):
        residual, slope = _distances(points, values)
        weighted = slope * biweight(residual / scale)[:, None]
        step = np.linalg.lstsq(weighted.T @ slope, -weighted.T @ residual, rcond=None)[0]
        values = values + step
        if step_number < SCALE_SETTLES:
            scale = _scale(points, values)
        if np.abs(step).max() < CONVERGED * abs(values[3]):
            break
    # of points on a small cap rounding leaves the last digits moving to and fro
    if not np.abs(step).max() < SETTLED * abs(values[3]):
        raise RefusedError(f"no sphere fits the points: not settled in {MAX_STEPS} steps")
    return values, scale


def _scale(points: Array, values: Array) -> float:
    """Scatter about a sphere; a fit with four values leaves residuals short by about 4/(2n)."""
    residual, _ = _distances(points, values)
    n = len(points)
    scale = inlier_scale(residual) * np.sqrt(n / (n - 4))
    return max(float(scale), ROUNDING_SHARE * abs(float(values[3])))


def _distances(points: Array, values: Array) -> tuple[Array, Array]:
    """Signed distances to a sphere, and their derivatives by center and radius."""
    away = points - values[:3]
    length = np.linalg.norm(away, axis=1)
    slope = np.column_stack([-away / length[:, None], -np.ones(len(points))])
    return length - values[3], slope


def _described(points: Array, values: Array, scale: float) -> Sphere:
    residual, slope = _distances(points, values)
    weight = biweight(residual / scale)
    directions = -slope[weight > 0, :3]
    mean = directions.mean(axis=0)
    axis = mean / max(float(np.linalg.norm(mean)), 1e-300)
    return Sphere(
        center=values[:3].copy(),
        radius_mm=float(values[3]),
        covariance=sandwich(slope, residual, scale),
        scatter_mm=scale,
        points=len(points),
        outliers=int((weight == 0).sum()),
        coverage=float((1 - (directions @ axis).min()) / 2),
    )
