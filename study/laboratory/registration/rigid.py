"""Rigid motions, and the one that carries points best onto points that they pair with.

The rotation comes from the singular value decomposition of the covariance of both sets
(Arun, Huang and Blostein 1987; Horn 1987 by quaternions finds the same); Umeyama 1991 gives
the scale and keeps the rotation proper where the data are close to a plane or mirrored.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.ground.arrays import Array, Flags, Ints
from study.ground.canonical import Keyed
from study.ground.errors import Fault, InputError, RefusedError

#: Fewest points that fix a rigid motion.
FEWEST_POINTS = 3
#: Points count as lying on a line if their second extent is below this share of the first one.
COLLINEAR_SHARE = 1e-6
#: Points closer than this to a line, or to each other, lie on it: below any instrument, in mm.
SAME_PLACE_MM = 1e-9
#: Coordinates from here on are another unit or a mistake: 1000 km, in mm.
FARTHEST_MM = 1e9
#: Points are called mirrored if a reflection leaves less than this share of the residual that
#: the best rotation leaves.
MIRRORED_SHARE = 0.2


@dataclass(frozen=True)
class RigidMotion(Keyed):
    """Rotation about the origin, then a translation: ``x -> R x + t``."""

    KEYS = "rotation translation_mm=translation angle_deg"

    #: shape (3, 3); proper rotation R.
    rotation: Array
    #: shape (3,); t, mm.
    translation: Array

    def __call__(self, points: Array) -> Array:
        """Move points, shape (n, 3), mm."""
        return np.asarray(points @ self.rotation.T + self.translation)

    def after(self, first: RigidMotion) -> RigidMotion:
        """Motion that does ``first`` and then this one."""
        turned = self.rotation @ first.translation + self.translation
        return RigidMotion(self.rotation @ first.rotation, turned)

    @property
    def inverse(self) -> RigidMotion:
        """Motion that undoes this one."""
        back = self.rotation.T
        return RigidMotion(back, -back @ self.translation)

    @property
    def angle_deg(self) -> float:
        """Angle of the rotation, 0 to 180 deg."""
        from scipy.spatial.transform import Rotation

        return float(np.degrees(Rotation.from_matrix(self.rotation).magnitude()))


def identity() -> RigidMotion:
    """Motion that moves nothing."""
    return RigidMotion(np.eye(3), np.zeros(3))


def rotation_of(vector: Array) -> Array:
    """Rotation about a vector by its length in rad (Rodrigues), shape (3, 3); vector (3,)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


def turned_about(center: Array, vector: Array, shift: Array) -> RigidMotion:
    """Motion that turns about a center, then shifts."""
    # Shapes: center (3,), mm; vector (3,), rad; shift (3,), mm.
    rotation = rotation_of(vector)
    return RigidMotion(rotation, center - rotation @ center + shift)


@dataclass(frozen=True)
class PairedFit:
    """Rigid motion between paired points, with what it leaves over."""

    #: Carries the moving points onto the fixed ones.
    motion: RigidMotion
    #: shape (n, 3); fixed minus moved, mm.
    residuals: Array
    #: Factor that Umeyama's similarity would apply besides; 1 where both agree in their unit.
    scale: float
    #: Residual that the best reflection would leave, RMS in mm.
    mirrored_rms: float

    @property
    def rms(self) -> float:
        """Fiducial registration error: RMS of the distances between pairs, mm."""
        return float(np.sqrt((self.residuals**2).sum(axis=1).mean()))

    @property
    def localization_error(self) -> float:
        """RMS error of localizing one point that explains the residual, mm.

        Sibson 1979: E[FRE^2] = (1 - 2/n) FLE^2; both sets' errors are in it.
        """
        n = len(self.residuals)
        return float(self.rms * np.sqrt(n / (n - 2)))

    @property
    def is_mirrored(self) -> bool:
        """Whether a reflection fits far better than any rotation."""
        return self.mirrored_rms < MIRRORED_SHARE * self.rms


def on_a_line(points: Array) -> bool:
    """Whether points lie on one line, or all at one place. Shapes: points (n, 3)."""
    extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(extent[1] <= max(COLLINEAR_SHARE * extent[0], SAME_PLACE_MM))


def check_places(points: Array, where: str) -> None:
    """Refuse coordinates that are no numbers, or farther away than any instrument sees."""
    # Shapes: points (n, 3), mm.
    wrong = int(np.count_nonzero(~(np.abs(points) < FARTHEST_MM).all(axis=1)))
    if wrong:
        rule = f"{wrong} of {len(points)} points have a coordinate that is no number, or "
        rule += f"{FARTHEST_MM:g} mm and more"
        raise InputError(Fault(where, rule, "delete these rows, or correct the unit"))


def fit_pairs(moving: Array, fixed: Array, where: str = "points") -> PairedFit:
    """Rigid motion that carries points onto those they pair with, in the least-squares sense."""
    # Shapes: moving, fixed (n, 3), mm.
    if len(moving) != len(fixed):
        rule = f"{len(moving)} points do not pair with {len(fixed)}"
        raise InputError(Fault(where, rule, "give every point in both frames"))
    if len(moving) < FEWEST_POINTS:
        rule = f"{len(moving)} pairs do not fix a rigid motion"
        raise InputError(Fault(where, rule, f"give {FEWEST_POINTS} or more, not on a line"))
    check_places(moving, where)
    check_places(fixed, where)
    a, b = moving - moving.mean(axis=0), fixed - fixed.mean(axis=0)
    if on_a_line(a) or on_a_line(b):
        rule = "the points lie on a line: the rotation about it is not fixed"
        raise InputError(Fault(where, rule, "add a point off the line"))
    u, singular, v = np.linalg.svd(b.T @ a)
    sign = np.sign(np.linalg.det(u) * np.linalg.det(v))
    proper = (u * np.array([1.0, 1.0, sign])) @ v
    reflected = (u * np.array([1.0, 1.0, -sign])) @ v
    motion = RigidMotion(proper, fixed.mean(axis=0) - proper @ moving.mean(axis=0))
    left = np.sqrt(((b - a @ reflected.T) ** 2).sum(axis=1).mean())
    scale = (singular * np.array([1.0, 1.0, sign])).sum() / (a**2).sum()
    return PairedFit(motion, fixed - motion(moving), float(scale), float(left))


def target_registration_error(fiducials: Array, targets: Array, localization_error: float) -> Array:
    """Return the expected RMS error of registered targets, shape (n_targets,), mm.

    Fitzpatrick, West and Maurer 1998, equation 46: TRE^2 = FLE^2/n (1 + mean over the three
    principal axes of (distance of the target from the axis)^2 / (RMS distance of the fiducials
    from it)^2), for localization errors that are the same in every direction and point.

    Shapes: fiducials (n, 3); targets (m, 3); returns (m,).
    """
    center = fiducials.mean(axis=0)
    axes = np.linalg.svd(fiducials - center, full_matrices=False)[2]

    def squared_distances(points: Array) -> Array:
        along = (points - center) @ axes.T
        return np.asarray((along**2).sum(axis=1, keepdims=True) - along**2)

    spread = squared_distances(fiducials).mean(axis=0)
    ratio = (squared_distances(targets) / spread).mean(axis=1)
    return np.asarray(localization_error * np.sqrt((1 + ratio) / len(fiducials)))


# Robust scale and weights: Tukey's biweight about a scale from the median (Huber 1981).

#: Median absolute deviation of a normal distribution over its standard deviation.
NORMAL_MAD = 0.6744897501960817
#: Tukey's tuning constant: 95 % efficiency where errors are normal (Holland and Welsch 1977).
BIWEIGHT = 4.685
#: Neighbors whose mean distance tells how isolated a point of a cloud is.
NEIGHBORS = 8
#: Robust standard deviations of log distance beyond which a point is isolated.
ISOLATED = 3.0


def scale_of(residuals: Array, center: float = 0.0) -> float:
    """Estimate the standard deviation of normal residuals by their median size."""
    return float(np.median(np.abs(residuals - center)) / NORMAL_MAD)


def biweight(standardized: Array) -> Array:
    """Weights of residuals over their scale: 1 at zero, 0 from 4.685 on."""
    inside = np.clip(1 - (standardized / BIWEIGHT) ** 2, 0, None)
    return np.asarray(inside**2)


def inlier_scale(residuals: Array) -> float:
    """Estimate the standard deviation of those residuals that the biweight gives weight."""
    # The median of all would grow by half where three in ten points are outliers.
    # A wider scale lets in more residuals, and so gives a scale that is no narrower: the scales of
    # the rounds rise or fall all the way, and there are no more of them than residuals.
    scale = scale_of(residuals)
    while True:
        inside = residuals[np.abs(residuals) < BIWEIGHT * scale]
        if not inside.size or scale == 0:
            return scale
        before, scale = scale, scale_of(inside)
        if scale == before:
            return scale


def sandwich(slope: Array, residuals: Array, scale: float, groups: Ints | None = None) -> Array:
    """Covariance of a biweight regression, shape (p, p).

    Huber 1981, section 7.6: A^-1 B A^-1 with A = sum psi' x x' and B = sum psi^2 x x'. Where
    residuals of a group go together, B is the sum over groups of what they add up to (Liang
    and Zeger 1986), enlarged by G/(G - p) for G groups.

    Shapes: slope (n, p); residuals (n,); groups (n,).
    """
    u = residuals / scale
    inside = np.clip(1 - (u / BIWEIGHT) ** 2, 0, None)
    psi = scale * u * inside**2
    bread = (slope * (inside**2 - 4 * (u / BIWEIGHT) ** 2 * inside)[:, None]).T @ slope
    scores = slope * psi[:, None]
    size, count = slope.shape[1], int((inside > 0).sum())
    if groups is not None:
        sums = np.zeros((int(groups.max()) + 1, size))
        np.add.at(sums, groups, scores)
        scores = sums[np.bincount(groups, minlength=len(sums)) > 0]
        count = len(scores)
    meat = scores.T @ scores * count / max(count - size, 1)
    inverse = np.linalg.pinv(bread)
    return np.asarray(inverse @ meat @ inverse.T)


def isolated(points: Array) -> Flags:
    """Which points of a cloud have no company: outliers by the cloud alone.

    The mean distance to the nearest neighbors of every point is compared with the others' in
    logarithms (Rusu et al. 2008 do so without). No surface is asked, so a region in which a
    model is wrong is never taken for an outlier.

    Shapes: points (n, 3); returns (n,).
    """
    from scipy.spatial import cKDTree

    if len(points) <= NEIGHBORS:
        return np.zeros(len(points), dtype=bool)
    distances = cKDTree(points).query(points, k=NEIGHBORS + 1)[0][:, 1:].mean(axis=1)
    positive = distances[distances > 0]
    if not positive.size:
        return np.zeros(len(points), dtype=bool)
    logs = np.log(np.maximum(distances, positive.min()))
    middle = float(np.median(logs))
    # the lower half has the cloud alone; outliers would widen the upper one
    spread = scale_of(logs[logs <= middle], middle)
    # a scan on a regular grid has no spread: a factor 3 is far from all of them
    return np.asarray(logs > middle + np.maximum(ISOLATED * spread, np.log(3.0)))


# Spheres fitted to scanned points: a linear fit of a draw that most points are near, then
# Gauss-Newton steps with Tukey's biweight.

#: Fewest points that fix a sphere and leave one over for its scatter.
FEWEST_SPHERE_POINTS = 5
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
class FittedSphere(Keyed):
    """Sphere with the uncertainty of its center and radius."""

    KEYS = (
        "center_mm=center center_uncertainty_mm radius_mm radius_uncertainty_mm scatter_mm points "
        "outliers coverage"
    )

    #: shape (3,); center, mm.
    center: Array
    radius_mm: float
    #: shape (4, 4); of center and radius, mm^2; independent errors along the normal are assumed.
    covariance: Array
    #: Robust standard deviation of the points about the sphere.
    scatter_mm: float
    points: int
    #: Points that the biweight gives no weight.
    outliers: int
    #: Share of the sphere that the points cover, as seen from the center: the solid angle of the
    #: smallest cap about their mean direction that holds them all, over 4 pi.
    coverage: float

    @property
    def center_uncertainty_mm(self) -> Array:
        """Standard uncertainty of the coordinates of the center, shape (3,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)[:3]))

    @property
    def radius_uncertainty_mm(self) -> float:
        """Standard uncertainty of the radius."""
        return float(np.sqrt(self.covariance[3, 3]))


def fit_sphere(points: Array, where: str = "sphere") -> FittedSphere:
    """Sphere through scanned points, with its uncertainty. Shapes: points (n, 3), mm."""
    if len(points) < FEWEST_SPHERE_POINTS:
        rule = f"has {len(points)} points, a sphere needs {FEWEST_SPHERE_POINTS}"
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


def _linear_sphere(points: Array) -> tuple[Array, float]:
    """Center and radius with the least sum of (|x|^2 - 2 c.x - r^2 + |c|^2)^2, mm."""
    # Shapes: points (n, 3), mm; returns (3,). Exact through four points; on a small cap too small.
    middle = points.mean(axis=0)
    x = points - middle
    columns = np.column_stack([2 * x, np.ones(len(x))])
    (*center, rest), _, rank, _ = np.linalg.lstsq(columns, (x**2).sum(axis=1), rcond=None)
    radius = float(np.sqrt(max(np.dot(center, center) + rest, 0.0)))
    return middle + center, radius if rank == 4 else np.inf  # which no point is near


#: Draws of points for a start that outliers cannot spoil: with 35 % outliers a draw of four is
#: clean with probability 0.18, so 60 draws have none with probability 1e-5.
DRAWS = 60


def _consensus(points: Array) -> tuple[Array, float]:
    """Start: the linear fit of all points or of a small draw, whichever most points are near.

    Least median of squares (Rousseeuw 1984); the draws have a fixed seed.
    """
    rng = np.random.default_rng(1984)
    choices = [points, *(points[rng.choice(len(points), 4, replace=False)] for _ in range(DRAWS))]
    best = (np.inf, points.mean(axis=0), 1.0)
    for chosen in choices:
        center, radius = _linear_sphere(chosen)
        off = float(np.median(np.abs(np.linalg.norm(points - center, axis=1) - radius)))
        if off < best[0]:
            best = (off, center, radius)
    center, radius = best[1:]
    off = np.abs(np.linalg.norm(points - center, axis=1) - radius)
    near = points[off <= np.maximum(4 * np.median(off), 1e-9 * radius)]
    return _linear_sphere(near) if len(near) >= FEWEST_SPHERE_POINTS else (center, radius)


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


def _described(points: Array, values: Array, scale: float) -> FittedSphere:
    residual, slope = _distances(points, values)
    weight = biweight(residual / scale)
    directions = -slope[weight > 0, :3]
    mean = directions.mean(axis=0)
    axis = mean / max(float(np.linalg.norm(mean)), 1e-300)
    return FittedSphere(
        center=values[:3].copy(),
        radius_mm=float(values[3]),
        covariance=sandwich(slope, residual, scale),
        scatter_mm=scale,
        points=len(points),
        outliers=int((weight == 0).sum()),
        coverage=float((1 - (directions @ axis).min()) / 2),
    )


def student_interval(
    value: float, error: float, freedom: float, alpha: float
) -> tuple[float, float]:
    """Interval of an estimate with a standard error, by Student's t."""
    from scipy.stats import t

    half = float(t.ppf(1 - alpha / 2, freedom) * error)
    return value - half, value + half


# Agreement of two methods of measurement: bias and limits (Bland and Altman 1986), with exact
# intervals by the noncentral t distribution (Carkeet 2015).

#: Fewest differences whose limits have an interval.
FEWEST = 3
#: Normal quantile of the limits: 95 % of the differences lie between them.
LIMIT = 1.959963984540054


@dataclass(frozen=True)
class MethodAgreement:
    """Differences of two methods."""

    bias: float
    #: Its interval at the level 1 - alpha.
    bias_interval: tuple[float, float]
    sd: float
    #: Limits of agreement: bias less and plus 1.96 standard deviations.
    lower: float
    upper: float
    lower_interval: tuple[float, float]
    upper_interval: tuple[float, float]
    #: Slope of the differences over the means: 0 where the bias is the same everywhere.
    trend: float
    #: Of the test that it is 0; nan where the means do not vary.
    trend_p: float
    #: Number of differences, each of its own specimen, pose or stop.
    points: int


def limits_of_agreement(
    first: Array, second: Array, alpha: float = 0.05, where: str = "agreement"
) -> MethodAgreement:
    """Bias and limits of agreement of ``first - second``. Shapes: first, second (n,)."""
    from scipy.stats import linregress, nct

    n = len(first)
    if n < FEWEST:
        rule = f"limits of agreement need {FEWEST} items, got {n}"
        raise InputError(Fault(where, rule, "measure at more positions"))
    difference = first - second
    bias, sd = float(difference.mean()), float(difference.std(ddof=1))
    shift = LIMIT * np.sqrt(n)
    ends = nct.ppf([alpha / 2, 1 - alpha / 2], n - 1, shift) * sd / np.sqrt(n)
    mean = (first + second) / 2
    varies = bool(np.ptp(mean) > 0) and sd > 0
    slope = linregress(mean, difference) if varies else None
    return MethodAgreement(
        bias=bias,
        bias_interval=student_interval(bias, sd / np.sqrt(n), n - 1, alpha),
        sd=sd,
        lower=bias - LIMIT * sd,
        upper=bias + LIMIT * sd,
        lower_interval=(bias - float(ends[1]), bias - float(ends[0])),
        upper_interval=(bias + float(ends[0]), bias + float(ends[1])),
        trend=float(slope.slope) if slope else 0.0,
        trend_p=float(slope.pvalue) if slope else float("nan"),
        points=n,
    )


# A straight line between two measured quantities: errors in both, their variance ratio known
# (Deming 1943). Standard errors by the jackknife (Linnet 1993) need no normal errors.

#: Fewest points of a line whose scatter is to be told.
FEWEST_PAIRS = 4


@dataclass(frozen=True)
class DemingLine:
    """Line ``y = offset + scale x`` with its uncertainty."""

    #: Slope, and value at x = 0 in the unit of y.
    scale: float
    offset: float
    scale_uncertainty: float
    offset_uncertainty: float
    #: Intervals at the level 1 - alpha, by Student's t with n - 2 degrees of freedom.
    scale_interval: tuple[float, float]
    offset_interval: tuple[float, float]
    #: Standard deviation of y about the line, in the unit of y.
    residual_sd: float
    points: int


def deming_line(
    x: Array, y: Array, variance_ratio: float, alpha: float = 0.05, where: str = "regression"
) -> DemingLine:
    """Line between two quantities that both have errors. Shapes: x, y (n,)."""
    n = len(x)
    values, counts = np.unique(x, return_counts=True)
    if n < FEWEST_PAIRS or values.size < 2:
        rule = f"a line needs {FEWEST_PAIRS} pairs at different places, got {n}"
        raise InputError(Fault(where, rule, "measure at more positions"))
    if values.size == 2 and counts.min() == 1:
        rule = f"{n - 1} of {n} pairs are at one place: the scale rests on the other one alone"
        raise InputError(Fault(where, rule, "measure at more positions"))
    offset, scale = _line(x, y, variance_ratio)
    left_out = np.array([_line(np.delete(x, k), np.delete(y, k), variance_ratio) for k in range(n)])
    if not np.isfinite(left_out).all() or not np.isfinite(scale):
        rule = "y does not go with x, with all pairs or without one of them: no line is fixed"
        raise InputError(Fault(where, rule, "compare the columns of both quantities"))
    pseudo = n * np.array([offset, scale]) - (n - 1) * left_out
    errors = pseudo.std(axis=0, ddof=1) / np.sqrt(n)
    residual = y - offset - scale * x
    return DemingLine(
        scale=scale,
        offset=offset,
        scale_uncertainty=float(errors[1]),
        offset_uncertainty=float(errors[0]),
        scale_interval=student_interval(scale, errors[1], n - 2, alpha),
        offset_interval=student_interval(offset, errors[0], n - 2, alpha),
        residual_sd=float(np.sqrt((residual**2).sum() / (n - 2))),
        points=n,
    )


def _line(x: Array, y: Array, ratio: float) -> tuple[float, float]:
    """Offset and scale, NaN where every line is as good."""
    dx, dy = x - x.mean(), y - y.mean()
    xx, xy, yy = float(dx @ dx), float(dx @ dy), float(dy @ dy)
    if np.isinf(ratio):
        scale = xy / xx if xx else float("nan")
    else:
        lead = yy - ratio * xx
        root = float(np.hypot(lead, 2 * np.sqrt(ratio) * xy))
        # the same root in the form that cancels nothing
        above, below = (lead + root, 2 * xy) if lead > 0 else (2 * ratio * xy, root - lead)
        scale = above / below if below else float("nan")
    return float(y.mean() - scale * x.mean()), float(scale)
