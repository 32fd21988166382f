"""Indentation in closed form, for the size of a modulus: half-space, layer, whole specimen.

Force and depth of a rigid body of revolution that is pressed without friction into an elastic
half-space (Sneddon 1965, Int. J. Engng Sci. 3, 47), times the correction for a layer of finite
height (Dimitriadis et al. 2002, Biophys. J. 82, 2798). Strains are small and the specimen is
linear and wide in all of it: good for a start value within a factor of about 2, not for an
answer.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from study.arrays import Array
from study.fem.contact.rigid_surface import Line, Profile, profile
from study.setup.geometry import Cone, Flat, Indenter

#: points of the quadrature over the contact, and contact radii that are tabulated
_POINTS = 64
_RADII = 400

#: contact radius over height up to which the series of a thick layer holds
_SERIES_ENDS = 1.0

#: share of a round indenter's radius up to which contact spreads: at all of it the wall is steep
_NEARLY = 0.999


def indentation(
    indenter: Indenter,
    depth_mm: Array,
    *,
    height_mm: float,
    poisson_ratio: float = 0.5,
    bonded: bool = True,
) -> Array:
    """Force over Young's modulus of an indented layer, mm^2, shape (n,).

    Parameters
    ----------
    indenter : Flat, Cone or Sphere
        What is pressed in.
    depth_mm : ndarray, shape (n,)
        Depths, not negative.
    height_mm : float
        Height of the layer.
    poisson_ratio : float
        Of the layer.
    bonded : bool
        Whether it sticks to what it lies on.

    Examples
    --------
    A sphere on a high specimen follows Hertz, 16/9 sqrt(R) d^1.5:

    >>> from study.setup.geometry import Sphere
    >>> force = indentation(Sphere(8.0), np.array([0.01]), height_mm=1e6)
    >>> float(force[0] / (16 / 9 * 8**0.5 * 0.01**1.5))
    1.000
    """
    radius, force = _half_space(indenter, depth_mm)
    layer = _layer(radius / height_mm, poisson_ratio, bonded)
    return np.asarray(force * layer / (1 - poisson_ratio**2))


def _half_space(indenter: Indenter, depth: Array) -> tuple[Array, Array]:
    """Contact radius and force over the plane-strain modulus, each of shape (n,).

    d = a int f'(a sin t) dt and F = 2 E* a^2 int sin(t)^2 f'(a sin t) dt, t from 0 to pi/2, for
    the profile f and the contact radius a.
    """
    deepest = float(depth.max(initial=0.0))
    first, widest = _contact(indenter, deepest)
    # closer where contact begins: the force is interpolated, and rises from there as a power
    radii = first + (widest - first) * np.linspace(0.0, 1.0, _RADII) ** 2
    angles = (np.arange(_POINTS) + 0.5) * (0.5 * np.pi / _POINTS)
    pieces = profile(indenter, far_mm=10 * (deepest + widest))
    slopes = _slope(pieces, radii[:, None] * np.sin(angles))
    step = 0.5 * np.pi / _POINTS
    depths = radii * slopes.sum(axis=1) * step
    forces = 2 * radii**2 * (slopes @ np.sin(angles) ** 2) * step
    # a contact that has reached the indenter's full width goes on as that of a flat punch
    beyond = np.maximum(depth - depths[-1], 0.0)
    force = np.interp(depth, depths, forces) + 2 * widest * beyond
    return np.interp(depth, depths, radii), force


def _contact(indenter: Indenter, deepest: float) -> tuple[float, float]:
    """Radius at which contact begins, and the largest one that a depth can bring, mm."""
    if isinstance(indenter, Flat):
        return indenter.face_radius_mm, indenter.radius_mm
    if isinstance(indenter, Cone):
        run = deepest * math.tan(math.radians(indenter.half_angle_deg))
        free = 2 * (run + indenter.tip_radius_mm)
        return 0.0, free if indenter.shaft_radius_mm is None else indenter.shaft_radius_mm
    return 0.0, _NEARLY * indenter.radius_mm


def _slope(pieces: Profile, rho: Array) -> Array:
    """Slope of a profile at radius ``rho``, of the same shape."""
    slope = np.zeros(rho.shape)
    for piece in pieces:
        if isinstance(piece, Line):
            slope = np.where(*_along(piece, rho), slope)
        elif piece.radius > 0:  # a corner has no width
            out = (rho - piece.center[0]) / piece.radius
            inside = (out > np.sin(piece.start)) & (out < np.sin(piece.end))
            slope = np.where(inside, out / np.sqrt(np.maximum(1 - out**2, 1e-12)), slope)
    return slope


def _along(line: Line, rho: Array) -> tuple[NDArray[np.bool_], float]:
    """Where a straight piece lies, and its slope."""
    (r0, z0), (r1, z1) = line.start, line.end
    rise = (z1 - z0) / (r1 - r0) if r1 > r0 else 0.0
    return (rho >= r0) & (rho <= r1) & (r1 > r0), rise


def _layer(ratio: Array, poisson_ratio: float, bonded: bool) -> Array:
    """Stiffening of a layer by the contact radius over its height, shape (n,).

    Dimitriadis et al. 2002, to third order, made for a sphere; straight on where it ends. A flat
    punch on a bonded layer stiffens by 14 % less at a ratio of 1 and by 10 % less at 2 (nu = 0.5,
    punch: validation/layers.csv).
    """
    nu = poisson_ratio
    if bonded:
        alpha = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1 - nu)
        beta = (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1 - nu)
    else:
        alpha = -0.347 * (3 - 2 * nu) / (1 - nu)
        beta = 0.056 * (5 - 2 * nu) / (1 - nu)
    third = alpha**3 + 4 * np.pi**2 / 15 * beta
    series = np.polynomial.Polynomial([1.0, -2 * alpha, 4 * alpha**2, -8 * third])
    x, end = ratio / np.pi, _SERIES_ENDS / np.pi
    return np.asarray(series(np.minimum(x, end)) + series.deriv()(end) * np.maximum(x - end, 0.0))
