"""Rigid motions, and the one that carries points best onto points that they pair with.

The rotation comes from the singular value decomposition of the covariance of both sets
(Arun, Huang and Blostein 1987; Horn 1987 by quaternions finds the same); Umeyama 1991 gives
the scale and keeps the rotation proper where the data are close to a plane or mirrored.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.errors import Fault, InputError

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
class RigidMotion:
    """Rotation about the origin, then a translation: ``x -> R x + t``.

    Parameters
    ----------
    rotation : ndarray, shape (3, 3)
        Proper rotation R.
    translation : ndarray, shape (3,)
        t, mm.
    """

    rotation: Array
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
        return float(np.degrees(np.linalg.norm(rotation_vector(self.rotation))))

    def to_json(self) -> dict[str, object]:
        """Rotation, translation in mm and angle in deg."""
        return {
            "rotation": self.rotation.tolist(),
            "translation_mm": self.translation.tolist(),
            "angle_deg": self.angle_deg,
        }


def identity() -> RigidMotion:
    """Motion that moves nothing."""
    return RigidMotion(np.eye(3), np.zeros(3))


def rotation_of(vector: Array) -> Array:
    """Rotation about a vector by its length in rad (Rodrigues), shape (3, 3).

    Parameters
    ----------
    vector : ndarray, shape (3,)
        Axis times the angle in rad.
    """
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


def rotation_vector(rotation: Array) -> Array:
    """Axis of a rotation times its angle in rad, shape (3,).

    Parameters
    ----------
    rotation : ndarray, shape (3, 3)
        Proper rotation.
    """
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation).as_rotvec())


def turned_about(center: Array, vector: Array, shift: Array) -> RigidMotion:
    """Motion that turns about a center, then shifts.

    Parameters
    ----------
    center : ndarray, shape (3,)
        Center of the rotation, mm.
    vector : ndarray, shape (3,)
        Axis of the rotation times its angle in rad.
    shift : ndarray, shape (3,)
        Translation, mm.
    """
    rotation = rotation_of(vector)
    return RigidMotion(rotation, center - rotation @ center + shift)


@dataclass(frozen=True)
class PairedFit:
    """Rigid motion between paired points, with what it leaves over.

    Parameters
    ----------
    motion : RigidMotion
        Carries the moving points onto the fixed ones.
    residuals : ndarray, shape (n, 3)
        Fixed minus moved, mm.
    scale : float
        Factor that Umeyama's similarity would apply besides; 1 where both agree in their unit.
    mirrored_rms : float
        Residual that the best reflection would leave, RMS in mm.
    """

    motion: RigidMotion
    residuals: Array
    scale: float
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
    """Whether points lie on one line, or all at one place.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        At least two.
    """
    extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(extent[1] <= max(COLLINEAR_SHARE * extent[0], SAME_PLACE_MM))


def check_places(points: Array, where: str) -> None:
    """Refuse coordinates that are no numbers, or farther away than any instrument sees.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        In mm.
    where : str
        Name of the points in messages.

    Raises
    ------
    InputError
        With the number of such points.
    """
    wrong = int(np.count_nonzero(~(np.abs(points) < FARTHEST_MM).all(axis=1)))
    if wrong:
        rule = f"{wrong} of {len(points)} points have a coordinate that is no number, or "
        rule += f"{FARTHEST_MM:g} mm and more"
        raise InputError(Fault(where, rule, "delete these rows, or correct the unit"))


def fit_pairs(moving: Array, fixed: Array, where: str = "points") -> PairedFit:
    """Rigid motion that carries points onto those they pair with, in the least-squares sense.

    Parameters
    ----------
    moving, fixed : ndarray, shape (n, 3)
        Row by row the same points in two frames, mm.
    where : str
        Name of the pairs in messages.

    Returns
    -------
    PairedFit

    Raises
    ------
    InputError
        For fewer than three pairs, or points on a line: a rotation about it is not fixed.
    """
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

    Parameters
    ----------
    fiducials : ndarray, shape (n, 3)
        Points by which the frames were registered, mm.
    targets : ndarray, shape (m, 3)
        Points of interest in the same frame, mm.
    localization_error : float
        RMS error of localizing one fiducial (FLE), mm.

    Returns
    -------
    ndarray, shape (m,)
    """
    center = fiducials.mean(axis=0)
    axes = np.linalg.svd(fiducials - center, full_matrices=False)[2]

    def squared_distances(points: Array) -> Array:
        along = (points - center) @ axes.T
        return np.asarray((along**2).sum(axis=1, keepdims=True) - along**2)

    spread = squared_distances(fiducials).mean(axis=0)
    ratio = (squared_distances(targets) / spread).mean(axis=1)
    return np.asarray(localization_error * np.sqrt((1 + ratio) / len(fiducials)))
