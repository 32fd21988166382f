"""A tracker against a better instrument: rigid registration of poses, and errors of targets.

The reference sees another point of the body than the tracker does. While the body is not turned
the arm between both points is absorbed by the registration; what it turns by adds to the
residual, unless further reference points on the body show how it is turned.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from study.ground.arrays import Array
from study.ground.canonical import Keyed
from study.ground.errors import Fault, InputError, settled
from study.ground.tabular import CsvTable, read_csv
from study.ground.units import unit_factor
from study.laboratory.registration.rigid import (
    FEWEST_POINTS,
    PairedFit,
    RigidMotion,
    fit_pairs,
    on_a_line,
    rotation_of,
    rotation_vector,
    target_registration_error,
)
from study.laboratory.tracker.tracker_recording import ReferenceTable, TrackerRecording, coordinates

#: Scale between both sets beyond which one is in another unit.
UNIT_RATIO = 2.0
#: Residual over the extent of the poses beyond which they do not pair. Trackers err by less
#: than 1 % of their workspace; poses paired in the wrong order by tens of percent.
UNPAIRED_SHARE = 0.02
#: Poses that nine parameters (motion and arm) need to leave something over.
FEWEST_FOR_ARM = 5


@dataclass(frozen=True)
class LeverArm:
    """Arm from the reference point to the marker, in the frame of the body."""

    #: shape (3,); along the body's x, y and z, and standard uncertainties.
    arm_mm: Array
    uncertainty_mm: Array
    #: Residual with the arm, RMS of distances.
    rms_mm: float
    #: RMS error of poses predicted from all others, with the arm.
    left_out_rms_mm: float
    #: Of the F test that the arm explains nothing.
    p: float
    #: RMS rotation of the body from its mean over the poses: what makes the arm visible.
    turned_deg: float


@dataclass(frozen=True)
class ReferenceResult(Keyed):
    """A tracker's poses registered to those of a reference."""

    KEYS = (
        "marker poses positions_mm scatter_mm target_error_mm left_out_mm distance_error_mean_mm "
        "distance_error_sd_mm lever_arm registration=fit.motion residuals_mm=fit.residuals "
        "fiducial_registration_error_mm=fit.rms localization_error_mm=fit.localization_error "
        "scale=fit.scale left_out_rms_mm"
    )

    marker: str
    #: Labels, in the order of the recording.
    poses: tuple[str, ...]
    #: Motion from the tracker's to the reference's frame, and its residuals.
    fit: PairedFit
    #: shape (n, 3); mean positions of the marker in the tracker's frame.
    positions_mm: Array
    #: shape (3,); standard deviation of samples within a pose, along the tracker's axes.
    scatter_mm: Array
    #: shape (n,); registration error expected at every pose (Fitzpatrick).
    target_error_mm: Array
    #: shape (n,); error of every pose predicted by a registration of all others.
    left_out_mm: Array
    #: Tracker's less reference's distance over all pairs of poses: needs no registration.
    distance_error_mean_mm: float
    distance_error_sd_mm: float
    #: None where the reference shows no axes, or for fewer than five poses.
    lever_arm: LeverArm | None

    @property
    def left_out_rms_mm(self) -> float:
        """RMS error of poses that did not take part in their registration."""
        return float(np.sqrt((self.left_out_mm**2).mean()))


def analyze_reference(
    declared: ReferenceTable, recording: TrackerRecording, root: Path
) -> ReferenceResult:
    """Judge a tracker by a reference that measured the same poses."""
    columns = [declared.stage, *declared.position, *(c for t in declared.axes or () for c in t)]
    table = read_csv(root / declared.file, required=columns, source=declared.file)
    poses, rows = _paired(declared, recording, table)
    factor = unit_factor(declared.unit, "length")
    fixed = factor * coordinates(table, declared.position)[rows]
    samples = recording.positions[declared.marker]
    parts = [
        np.concatenate([samples[visit.rows] for visit in recording.visits_of(p)]) for p in poses
    ]
    moving = np.array([part.mean(axis=0) for part in parts])
    fit = fit_pairs(moving, fixed, "reference")
    ratio = _extent(fixed) / _extent(moving)
    if not 1 / UNIT_RATIO < ratio < UNIT_RATIO:
        rule = f"the reference's poses are {ratio:.4g} times as far apart as the tracker's"
        mend = 'one unit is wrong: a factor near 1000 means "m" where "mm" is written'
        raise InputError(Fault("reference.unit", rule, mend))
    if fit.is_mirrored and fit.rms > UNPAIRED_SHARE * _extent(fixed):
        rule = f"the tracker's frame is mirrored: RMS {fit.rms:.3g} mm, {fit.mirrored_rms:.3g} mm "
        rule += "with one axis flipped"
        mend = "exchange or negate one column: one of both frames is left-handed"
        raise InputError(Fault("recording.markers", rule, mend))
    turned = None
    if declared.axes is not None:
        further = [factor * coordinates(table, axis)[rows] for axis in declared.axes]
        _check_axes(fixed, further, poses, declared.file)
        second = further[1]
        x = further[0] - fixed
        x /= np.linalg.norm(x, axis=1, keepdims=True)
        y = second - fixed
        y -= (x * y).sum(axis=1, keepdims=True) * x
        y /= np.linalg.norm(y, axis=1, keepdims=True)
        turned = np.stack([x, y, np.cross(x, y)], axis=-1)
    away = np.concatenate([part - part.mean(axis=0) for part in parts])
    from scipy.spatial.distance import pdist

    errors = np.asarray(pdist(moving) - pdist(fixed))
    lever_arm = _lever_arm(moving, fixed, turned, fit)
    left = fit.rms if lever_arm is None else min(fit.rms, lever_arm.rms_mm)
    if left > UNPAIRED_SHARE * _extent(fixed):
        rule = f"after registration {left:.3g} mm RMS are left over {_extent(fixed):.4g} mm of "
        where, rule = f"{declared.file}: {declared.stage}", f"{rule}extent: the poses do not pair"
        raise InputError(Fault(where, rule, "check the order of the poses in both files"))
    targets = target_registration_error(moving, moving, fit.localization_error)
    return ReferenceResult(
        marker=declared.marker,
        poses=poses,
        fit=fit,
        positions_mm=moving,
        scatter_mm=np.sqrt((away**2).sum(axis=0) / max(len(away) - len(parts), 1)),
        target_error_mm=targets,
        left_out_mm=_left_out(moving, fixed),
        distance_error_mean_mm=float(errors.mean()),
        distance_error_sd_mm=float(errors.std(ddof=1)),
        lever_arm=lever_arm,
    )


def _paired(
    declared: ReferenceTable, recording: TrackerRecording, table: CsvTable
) -> tuple[tuple[str, ...], list[int]]:
    """Poses of both, and the row of each in the reference's table."""
    labels, poses = table.text(declared.stage), recording.stages
    faults = []
    twice = sorted({label for label in labels if labels.count(label) > 1})
    if twice:
        rule = f"poses with several rows: {', '.join(twice[:5])}"
        faults.append(Fault(f"{declared.file}: {declared.stage}", rule, "give one row a pose"))
    for where, missing in (
        (declared.file, [pose for pose in poses if pose not in labels]),
        (recording.table.source, [label for label in labels if label not in poses]),
    ):
        if missing:
            rule = f"poses do not pair: {', '.join(dict.fromkeys(missing[:5]))} "
            rule += f"{'is' if len(missing) == 1 else 'are'} missing here"
            mend = "give the same labels in both files, and drop poses that one has not"
            faults.append(Fault(where, rule, mend))
    if len(poses) < FEWEST_POINTS:
        rule = f"{len(poses)} poses are too few for a registration"
        faults.append(Fault("reference", rule, f"measure {FEWEST_POINTS + 1} or more"))
    if faults:
        raise InputError(faults)
    return poses, [labels.index(pose) for pose in poses]


def _extent(points: Array) -> float:
    """RMS distance of points from their center, mm."""
    return float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))


def _left_out(moving: Array, fixed: Array) -> Array:
    """Error of every pose that a registration of the others predicts, mm."""
    if len(moving) <= FEWEST_POINTS:
        return np.full(len(moving), np.nan)
    errors = []
    for k in range(len(moving)):
        motion = fit_pairs(np.delete(moving, k, 0), np.delete(fixed, k, 0), "reference").motion
        errors.append(np.linalg.norm(motion(moving[k : k + 1])[0] - fixed[k]))
    return np.array(errors)


def _check_axes(origin: Array, further: list[Array], poses: tuple[str, ...], where: str) -> None:
    """Refuse three points of the body that lie on a line in some pose."""
    lines = [
        pose
        for pose, *points in zip(poses, origin, *further, strict=True)
        if on_a_line(np.array(points))
    ]
    if lines:
        rule = f"the three points on the body lie on a line at: {', '.join(lines[:5])}"
        mend = "name other columns in [reference] axes: two points off the line through the first"
        raise InputError(Fault(f"{where}: axes", rule, mend))


def _lever_arm(
    moving: Array, fixed: Array, turned: Array | None, fit: PairedFit
) -> LeverArm | None:
    """Estimate the arm with the registration, and judge by left-out poses what it is worth."""
    from scipy.stats import f as f_distribution

    n = len(moving)
    if turned is None or n < FEWEST_FOR_ARM:
        return None
    motion, arm, covariance, squares = _with_arm(moving, fixed, turned, fit.motion)
    freedom = 3 * n - 9
    plain = float((fit.residuals**2).sum())
    ratio = (plain - squares) / 3 / (squares / freedom) if squares > 0 else np.inf
    errors = []
    for k in range(n):
        others = np.arange(n) != k
        arm_without, own_arm, _, _ = _with_arm(
            moving[others], fixed[others], turned[others], motion
        )
        errors.append(arm_without(moving[k : k + 1])[0] - fixed[k] - turned[k] @ own_arm)
    # rotation nearest to all in the sense of least squares
    u, _, v = np.linalg.svd(turned.mean(axis=0))
    mean = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    angles = [np.linalg.norm(rotation_vector(mean.T @ turn)) for turn in turned]
    return LeverArm(
        arm_mm=arm,
        uncertainty_mm=np.sqrt(np.diag(covariance)),
        rms_mm=float(np.sqrt(squares / n)),
        left_out_rms_mm=float(np.sqrt((np.array(errors) ** 2).sum(axis=1).mean())),
        p=float(f_distribution.sf(ratio, 3, freedom)),
        turned_deg=float(np.degrees(np.sqrt(np.mean(np.square(angles))))),
    )


def _with_arm(
    moving: Array, fixed: Array, turned: Array, start: RigidMotion
) -> tuple[RigidMotion, Array, Array, float]:
    """Motion and arm with the least squares, covariance of the arm, and the sum of squares."""
    from scipy.optimize import least_squares

    center = moving.mean(axis=0)

    def motion_of(values: Array) -> RigidMotion:
        rotation = start.rotation @ rotation_of(values[:3])
        return RigidMotion(rotation, start(center[None])[0] - rotation @ center + values[3:6])

    def residuals(values: Array) -> Array:
        seen = fixed + np.einsum("nij,j->ni", turned, values[6:])
        return np.asarray((seen - motion_of(values)(moving)).ravel())

    solution = least_squares(residuals, np.zeros(9), x_scale="jac", xtol=1e-12, ftol=1e-14)
    settled(solution, "position of the reference")
    squares = float((solution.fun**2).sum())
    freedom = max(solution.fun.size - 9, 1)
    covariance = (
        np.linalg.pinv(solution.jac.T @ solution.jac, rcond=1e-14)[6:, 6:] * squares / freedom
    )
    return motion_of(solution.x), np.asarray(solution.x[6:]), covariance, squares
