"""Frictionless contact of a rigid body of revolution with an elastic layer, by its radius.

The pressure follows from a function phi on the contact, 0 <= t <= a, that solves the Fredholm
equation of the second kind

    phi(t) - int_0^a k(s, t) phi(s) ds = d - q(t),    F = 2 E* int_0^a phi(t) dt,

with the layer's kernel k (:mod:`study.contact_mechanics.layer`), the profile's transform q
(:mod:`study.contact_mechanics.profile`), the depth d and E* = E / (1 - nu^2). Where the profile
is smooth at the rim the pressure ends there with zero: phi(a) = 0, which makes the depth follow
from the radius. Nystrom's method with Gauss points is exact to rounding up to a = 5 h.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.contact_mechanics.layer import Layer
from study.contact_mechanics.profile import transform
from study.setup.geometry import Indenter

#: Gauss points over the contact radius
_POINTS = 48


@dataclass(frozen=True)
class ContactState:
    """One contact of a given radius.

    Parameters
    ----------
    depth_mm : float
        Depth at which the radius is reached; 0 on the face of a flat punch.
    force_mm2 : float
        Force there over E*.
    stiffness_mm : float
        Force over E* and depth of a flat punch of the radius, 2 a on a half-space: the slope of
        force over depth of every indenter (Pharr, Oliver and Brotzen 1992).
    """

    depth_mm: float
    force_mm2: float
    stiffness_mm: float


def contact_state(
    layer: Layer, indenter: Indenter, radius_mm: float, *, paraboloid: bool = False
) -> ContactState:
    """Depth, force and stiffness of the contact of a given radius.

    Parameters
    ----------
    layer : Layer
        What is indented.
    indenter : Flat, Cone or Sphere
        What is pressed in.
    radius_mm : float
        Contact radius, above zero.
    paraboloid : bool
        Whether a sphere is taken for a paraboloid.
    """
    points, weights = np.polynomial.legendre.leggauss(_POINTS)
    t, w = 0.5 * radius_mm * (points + 1), 0.5 * radius_mm * weights
    matrix = np.eye(_POINTS) - layer.coupling(t, t) * w
    given = np.column_stack([np.ones(_POINTS), transform(indenter, t, paraboloid=paraboloid)])
    plain, shaped = np.linalg.solve(matrix, given).T
    rim = np.array([radius_mm])
    onto = (layer.coupling(rim, t) * w)[0]
    at_rim = float(transform(indenter, rim, paraboloid=paraboloid)[0] + onto @ shaped)
    depth = at_rim / float(1 + onto @ plain)
    return ContactState(depth, float(2 * w @ (depth * plain - shaped)), float(2 * w @ plain))
