"""Distances along normals, linearized by a small rigid motion, and the motions that slide.

A surface that can move along itself (a plane, a cylinder) leaves eigenvalues of the normal
matrix near zero (Gelfand and Guibas 2004): such motions are not fixed by any scan of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.registration.closest_point import Closest
from study.registration.rigid import RigidMotion, turned_about

#: Eigenvalue of the normal matrix, over the largest, below which a direction slides: rotations
#: are counted in arcs at the RMS distance, so that both kinds compare. A smooth ellipsoid of
#: axes 1 : 1.1 has 4e-3 about the third one, a cylinder with 180 facets 1e-4.
SLIDING = 1e-3


@dataclass(frozen=True)
class Sliding:
    """Small motion that the registration does not fix.

    Parameters
    ----------
    rotation : ndarray, shape (3,)
        Axis, times the share of rotation, in arcs at the RMS distance from the center.
    translation : ndarray, shape (3,)
        Direction, times the share of translation.
    stiffness : float
        Eigenvalue over the largest one.
    """

    rotation: Array
    translation: Array
    stiffness: float

    def __str__(self) -> str:
        turns = bool(np.linalg.norm(self.rotation) >= np.linalg.norm(self.translation))
        word = "rotation about" if turns else "translation along"
        vector = self.rotation if turns else self.translation
        vector = vector / max(float(np.linalg.norm(vector)), 1e-300)
        vector = vector * np.sign(vector[np.abs(vector).argmax()])
        listed = ", ".join(f"{v + 0.0:.2f}" for v in np.where(np.abs(vector) < 5e-3, 0.0, vector))
        return f"{word} ({listed})"


def motion_slopes(away: Array) -> Array:
    """Differentiate moved points by a rotation vector and a translation, shape (n, 3, 6).

    Parameters
    ----------
    away : ndarray, shape (n, 3)
        Points less the center of rotation, mm.

    Returns
    -------
    ndarray, shape (n, 3, 6)
        Derivative of each coordinate at no motion: mm per rad in the first three columns, plain in
        the last three.
    """
    slopes = np.zeros((len(away), 3, 6))
    x, y, z = away.T
    slopes[:, 0, 1], slopes[:, 0, 2] = z, -y
    slopes[:, 1, 0], slopes[:, 1, 2] = -z, x
    slopes[:, 2, 0], slopes[:, 2, 1] = y, -x
    slopes[:, :, 3:] = np.eye(3)
    return slopes


@dataclass(frozen=True)
class NormalEquations:
    """Linearized distances along the normals.

    Parameters
    ----------
    residual : ndarray, shape (n,)
        Signed distances, mm.
    slope : ndarray, shape (n, 6)
        Derivatives by rotation about ``center`` in arcs at ``arm`` and by translation.
    center : ndarray, shape (3,)
        Center of rotation, mm.
    arm : float
        RMS distance from it, mm: makes rotations lengths.
    places : ndarray, shape (n, 3)
        Closest points, mm.
    """

    residual: Array
    slope: Array
    center: Array
    arm: float
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


def normal_equations(moved: Array, found: Closest, weights: Array) -> NormalEquations:
    """Linearize the distances from moved points to their closest ones about their center.

    Parameters
    ----------
    moved : ndarray, shape (n, 3)
        Points, mm.
    found : Closest
        Their closest points.
    weights : ndarray, shape (n,)
        Weights for center and arm, 0 or more; points count alike where all are 0.
    """
    center = np.average(moved, axis=0, weights=weights) if weights.any() else moved.mean(axis=0)
    away = moved - center
    arm = float(np.sqrt(np.average((away**2).sum(axis=1), weights=weights + 1e-300)))
    # between surface and point the normal is the direction of the gap, where there is one
    gap = moved - found.points
    length = np.linalg.norm(gap, axis=1)
    sharp = length > 1e-9 * max(arm, 1e-300)
    normal = found.normal.copy()
    sign = np.sign(found.distance[sharp])
    normal[sharp] = gap[sharp] / (length[sharp] * np.where(sign == 0, 1, sign))[:, None]
    slope = np.einsum("ni,nij->nj", normal, motion_slopes(away))
    slope[:, :3] /= max(arm, 1e-300)
    return NormalEquations(found.distance, slope, center, arm, found.points)
