"""What the profile z = f(r) of a rigid indenter does to the integral equation of its contact.

Sneddon's (1965, Int. J. Engng Sci. 3, 47) answer to a profile needs of it the transform

    q(t) = t int_0^t f'(r) / sqrt(t^2 - r^2) dr = t int_0^(pi/2) f'(t sin u) du   (mm),

which is the depth at which a half-space is touched up to the radius t.
"""

from __future__ import annotations

import numpy as np

from study.arrays import Array
from study.setup.geometry import Cone, Flat, Indenter, Sphere

#: Gauss points over a rounded edge
_EDGE = 64

#: share of an indenter's radius up to which contact is followed: its wall is upright at all of it
NEARLY = 0.98


def transform(indenter: Indenter, radius_mm: Array, *, paraboloid: bool = False) -> Array:
    """Transform q of a profile, mm, shape (n,).

    Parameters
    ----------
    indenter : Flat, Cone or Sphere
        What is pressed in.
    radius_mm : ndarray, shape (n,)
        Radii t, inside the indenter.
    paraboloid : bool
        Whether a sphere is taken for the paraboloid r^2/(2R), as Hertz did.

    Examples
    --------
    A cone of 45 degrees is touched up to t at the depth pi/2 t:

    >>> float(transform(Cone(45.0), np.array([2.0]))[0] / np.pi)
    1.0
    """
    t = np.asarray(radius_mm, dtype=float)
    if isinstance(indenter, Sphere):
        size = indenter.radius_mm
        return np.asarray(t**2 / size if paraboloid else t * np.arctanh(t / size))
    if isinstance(indenter, Cone):
        return _rounded_cone(indenter, t)
    return _rounded_edge(indenter, t)


def _rounded_cone(cone: Cone, t: Array) -> Array:
    """Spherical up to where the flank is tangent to it, straight beyond."""
    slope = 1 / np.tan(np.radians(cone.half_angle_deg))
    size = cone.tip_radius_mm
    tangent = np.minimum(size * np.cos(np.radians(cone.half_angle_deg)), t)
    share = np.divide(tangent, t, out=np.zeros_like(t), where=t > 0)
    straight = slope * (np.pi / 2 - np.arcsin(np.minimum(share, 1.0)))
    if size == 0:
        return np.asarray(t * straight)
    below = np.sqrt(size**2 - tangent**2) + np.sqrt(t**2 - tangent**2)
    return np.asarray(t * (np.log((size + t) / below) + straight))


def _rounded_edge(flat: Flat, t: Array) -> Array:
    """Zero on the plane face; a quarter of a circle from there to the shaft."""
    size, face = flat.edge_radius_mm, flat.face_radius_mm
    if size == 0:
        return np.zeros_like(t)
    points, weights = np.polynomial.legendre.leggauss(_EDGE)
    wide = np.maximum(t, face)
    first = np.arcsin(np.divide(face, wide, out=np.ones_like(wide), where=wide > 0))
    half = 0.5 * (np.pi / 2 - first)
    angles = first[:, None] + half[:, None] * (points + 1)
    out = np.clip((wide[:, None] * np.sin(angles) - face) / size, 0.0, 1 - 1e-12)
    return np.asarray(t * half * ((out / np.sqrt(1 - out**2)) @ weights))


def contact_range(indenter: Indenter) -> tuple[float, float]:
    """Contact radius at first touch and the largest one that the profile has, mm.

    Parameters
    ----------
    indenter : Flat, Cone or Sphere
        What is pressed in.

    Returns
    -------
    (first, largest) : float
        The largest is infinite for a cone without a shaft.
    """
    if isinstance(indenter, Sphere):
        return 0.0, NEARLY * indenter.radius_mm
    if isinstance(indenter, Cone):
        return 0.0, np.inf if indenter.shaft_radius_mm is None else indenter.shaft_radius_mm
    face = indenter.face_radius_mm
    return face, face + NEARLY * indenter.edge_radius_mm
