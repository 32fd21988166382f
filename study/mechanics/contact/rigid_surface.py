"""Rigid indenters: the exact signed distance to a convex body of revolution, and its derivatives.

A profile in the half plane (rho, z), z measured upwards from the lowest point, is a chain
of arcs and straight lines whose normals turn from straight down to straight out. Convex
corners are arcs of radius zero, so that every point outside has one closest feature.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.ground.arrays import Array, Flags
from study.mechanics.setup.geometry import Cone, Flat, Indenter

#: smallest distance to the center of an arc or to the axis that is divided by, mm
_TINY = 1e-12
#: height of a profile where it has none, mm
_FAR = 1e6


@dataclass(frozen=True)
class Arc:
    """Arc about ``center``; its normals point from ``start`` to ``end``.

    Angles are measured from straight down towards straight out (rad).
    """

    center: tuple[float, float]
    radius: float
    start: float
    end: float

    def height(self, rho: Array) -> tuple[Flags, Array]:
        """Which radii the arc spans, and its height there."""
        out = rho - self.center[0]
        inside = (out >= self.radius * np.sin(self.start) - _TINY) & (
            out <= self.radius * np.sin(self.end) + _TINY
        )
        down = np.sqrt(np.maximum(self.radius**2 - out**2, 0.0))
        return inside, self.center[1] - down

    def distance(self, rho: Array, z: Array) -> tuple[Flags, Array]:
        """Which points lie before the arc, and the rows of a distance to its circle, (7, n)."""
        out, up = rho - self.center[0], z - self.center[1]
        far = np.maximum(np.hypot(out, up), _TINY)
        angle = np.arctan2(out, -up)
        near = (angle >= self.start) & (angle <= self.end)
        n_r, n_z = out / far, up / far
        around = 1 / far if self.center[0] == 0.0 else n_r / np.maximum(rho, _TINY)
        curvature = ((1 - n_r**2) / far, -n_r * n_z / far, (1 - n_z**2) / far)
        return near, np.stack([far - self.radius, n_r, n_z, *curvature, around])


@dataclass(frozen=True)
class Line:
    """Straight piece from ``start`` to ``end``; ``end`` may be at infinity (a large number)."""

    start: tuple[float, float]
    end: tuple[float, float]

    def height(self, rho: Array) -> tuple[Flags, Array]:
        """Which radii the line spans, and its height there."""
        (r0, z0), (r1, z1) = self.start, self.end
        if r1 - r0 < _TINY:
            return np.zeros(rho.shape, dtype=bool), rho
        return (rho >= r0) & (rho <= r1), z0 + (rho - r0) * (z1 - z0) / (r1 - r0)

    def distance(self, rho: Array, z: Array) -> tuple[Flags, Array]:
        """Which points lie beside the line, and the rows of a distance to it, (7, n)."""
        (r0, z0), (r1, z1) = self.start, self.end
        parts = np.zeros((7, rho.size))
        length = np.hypot(r1 - r0, z1 - z0)
        if length < _TINY:
            return np.zeros(rho.shape, dtype=bool), parts
        t_r, t_z = (r1 - r0) / length, (z1 - z0) / length
        along = (rho - r0) * t_r + (z - z0) * t_z
        parts[0] = (rho - r0) * t_z - (z - z0) * t_r
        parts[1], parts[2], parts[6] = t_z, -t_r, t_z / np.maximum(rho, _TINY)
        return (along >= 0) & (along <= length), parts


Profile = tuple[Arc | Line, ...]


def profile(indenter: Indenter, *, far_mm: float) -> Profile:
    """Chain of pieces from the axis outwards. Units: indenter mm."""
    if isinstance(indenter, Flat):
        edge = indenter.edge_radius_mm
        inner = indenter.radius_mm - edge
        return (
            Line((0.0, 0.0), (inner, 0.0)),
            Arc((inner, edge), edge, 0.0, np.pi / 2),
            Line((indenter.radius_mm, edge), (indenter.radius_mm, far_mm)),
        )
    if isinstance(indenter, Cone):
        return _cone(indenter, far_mm)
    radius = indenter.radius_mm
    return (
        Arc((0.0, radius), radius, 0.0, np.pi / 2),
        Line((radius, radius), (radius, radius + far_mm)),
    )


def _cone(cone: Cone, far: float) -> Profile:
    angle = np.radians(cone.half_angle_deg)
    turn = np.pi / 2 - angle  # direction of the cone's normal, from straight down
    tip = cone.tip_radius_mm
    start = (tip * np.sin(turn), tip * (1 - np.cos(turn)))
    arc = Arc((0.0, tip), tip, 0.0, turn)
    shaft = cone.shaft_radius_mm
    if shaft is None:
        end = (start[0] + far * np.sin(angle), start[1] + far * np.cos(angle))
        return (arc, Line(start, end))
    corner = (shaft, start[1] + (shaft - start[0]) / np.tan(angle))
    return (
        arc,
        Line(start, corner),
        Arc(corner, 0.0, turn, np.pi / 2),
        Line(corner, (shaft, corner[1] + far)),
    )


def profile_height(pieces: Profile, rho: Array) -> Array:
    """Height of the profile above its lowest point at radius ``rho``, shape (n,).

    What small-strain contact sees; far above everything outside the widest radius.

    Units: pieces mm; rho mm.
    """
    height = np.full(rho.shape, _FAR)
    for piece in pieces:
        inside, value = piece.height(rho)
        height = np.where(inside, np.minimum(height, value), height)
    return height


def signed_distance(pieces: Profile, rho: Array, z: Array) -> Array:
    """Distance to a profile, positive outside, and its derivatives, shape (7, n).

    Rows: the distance g, dg/drho, dg/dz, the second derivatives by rho rho, rho z and z z, and
    (dg/drho) / rho, the curvature that a circle about the axis adds.

    Shapes: rho, z (n,).
    """
    best = np.zeros((7, rho.size))
    best[0] = -np.inf
    for piece in pieces:
        near, parts = piece.distance(rho, z)
        np.copyto(best, parts, where=near & (parts[0] > best[0]))
    return best


@dataclass(frozen=True)
class Press:
    """An indenter that comes down on a surface at ``height_mm``."""

    pieces: Profile
    #: Height of its lowest point at no displacement.
    height_mm: float
    #: Downward motion per unit of displacement.
    speed: float = 1.0

    def gap(self, x: Array, displacement_mm: float) -> tuple[Array, Array, Array]:
        """Signed distance (n,), outward normal (n, dim) and Hessian (n, dim, dim)."""
        z = x[:, -1] - (self.height_mm - self.speed * displacement_mm)
        if x.shape[1] == 2:
            # an iterate may throw a point across the axis, where no piece would be near
            parts = signed_distance(self.pieces, np.maximum(x[:, 0], 0.0), z)
            hessian = np.stack([parts[3:5].T, parts[4:6].T], axis=-1)
            return parts[0], np.stack([parts[1], parts[2]], axis=-1), hessian
        return self._gap_3d(x, z)

    def _gap_3d(self, x: Array, z: Array) -> tuple[Array, Array, Array]:
        """Turn the plane derivatives about the axis."""
        rho = np.hypot(x[:, 0], x[:, 1])
        parts = signed_distance(self.pieces, rho, z)
        safe = np.maximum(rho, _TINY)
        out = np.where((rho > _TINY)[:, None], x[:, :2] / safe[:, None], [1.0, 0.0])
        radial = np.column_stack([out, np.zeros(rho.size)])
        across = np.column_stack([-out[:, 1], out[:, 0], np.zeros(rho.size)])
        axial = np.zeros_like(radial)
        axial[:, 2] = 1.0
        normal = parts[1][:, None] * radial + parts[2][:, None] * axial
        rr, rz, zz, around = (row[:, None, None] for row in parts[3:])
        mixed = _outer(radial, axial)
        hessian = rr * _outer(radial, radial) + zz * _outer(axial, axial)
        hessian += rz * (mixed + mixed.transpose(0, 2, 1))
        hessian += around * _outer(across, across)
        return parts[0], normal, hessian

    def reference_gap(
        self, x: Array, u: Array, displacement_mm: float
    ) -> tuple[Array, Array, Array]:
        """Vertical gap, normal and no Hessian at small strain: the shape is seen undeformed."""
        rho = x[:, 0] if x.shape[1] == 2 else np.hypot(x[:, 0], x[:, 1])
        normal = np.zeros_like(x)
        normal[:, -1] = -1.0
        low = self.height_mm - self.speed * displacement_mm
        gap = low + profile_height(self.pieces, rho) - x[:, -1] - u[:, -1]
        return gap, normal, np.zeros((*x.shape, x.shape[1]))


def _outer(a: Array, b: Array) -> Array:
    return a[:, :, None] * b[:, None, :]
