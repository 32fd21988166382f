"""Force of an indenter on a layer over its depth: one table for all curves of a test.

The contact is solved at radii that grow by even ratios; between them force follows a cubic in
logarithms with the exact slope dF/dd = E* stiffness. Beyond the indenter's own width contact goes
on as that of a flat punch.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from study.arrays import Array
from study.contact_mechanics import thin_layer
from study.contact_mechanics.integral_equation import ContactState, contact_state
from study.contact_mechanics.layer import Layer
from study.contact_mechanics.profile import contact_range
from study.design.sections.calibration import Theory
from study.setup.geometry import Flat, Indenter, Sphere

#: contact radii that are tabulated, over three decades: force is interpolated to 1e-6
_RADII = 60
_DECADES = 3.0

#: contact radius over height beyond which nothing is tabulated
WIDEST = 5.0


@dataclass(frozen=True)
class ForceLaw:
    """Force over E* and contact radius, by depth.

    Parameters
    ----------
    depth_mm, force_mm2, stiffness_mm, radius_mm : ndarray, shape (n,)
        Tabulated contacts, rising; all above zero.
    """

    depth_mm: Array
    force_mm2: Array
    stiffness_mm: Array
    radius_mm: Array

    def force(self, depth_mm: Array) -> Array:
        """Force over E* at depths, mm^2, of their shape; zero where they are negative."""
        d = np.maximum(depth_mm, 0.0)
        x = np.log(np.clip(d, self.depth_mm[0], self.depth_mm[-1]))
        within = np.exp(self._spline(x))
        power = self.stiffness_mm[0] * self.depth_mm[0] / self.force_mm2[0]
        early = np.minimum(d / self.depth_mm[0], 1.0) ** power
        return np.asarray(within * early + self._beyond(d) * self.stiffness_mm[-1])

    def stiffness(self, depth_mm: Array) -> Array:
        """Slope of force over E* by depth, mm, of the shape of the depths."""
        d = np.maximum(depth_mm, 1e-12 * self.depth_mm[0])
        ends = np.clip(d, self.depth_mm[0], self.depth_mm[-1])
        slope = self._spline(np.log(ends), 1)
        inside = slope * (self.force(d) - self._beyond(d) * self.stiffness_mm[-1]) / ends
        early = np.where(d < self.depth_mm[0], ends / d, 1.0)
        found = np.where(d > self.depth_mm[-1], self.stiffness_mm[-1], inside * early)
        return np.where(np.asarray(depth_mm) > 0, found, 0.0)

    def radius(self, depth_mm: Array) -> Array:
        """Contact radius at depths, mm, of their shape."""
        d = np.maximum(depth_mm, 1e-12 * self.depth_mm[0])
        log = np.interp(np.log(d), np.log(self.depth_mm), np.log(self.radius_mm))
        return np.asarray(np.exp(log))

    def _beyond(self, depth: Array) -> Array:
        return np.asarray(np.maximum(depth - self.depth_mm[-1], 0.0))

    @cached_property
    def _spline(self) -> CubicHermiteSpline:
        slope = self.stiffness_mm * self.depth_mm / self.force_mm2
        return CubicHermiteSpline(np.log(self.depth_mm), np.log(self.force_mm2), slope)


def force_law(
    indenter: Indenter,
    layer: Layer,
    deepest_mm: float,
    *,
    theory: Theory = "integral-equation",
    paraboloid: bool = False,
) -> ForceLaw:
    """Tabulate the force of an indenter up to a depth.

    Parameters
    ----------
    indenter : Flat, Cone or Sphere
        What is pressed in, without friction.
    layer : Layer
        What is indented.
    deepest_mm : float
        Largest depth that is asked for, above zero.
    theory : {"integral-equation", "dimitriadis", "half-space"}
        Whether the support is exact, a published series for spheres, or far away.
    paraboloid : bool
        Whether a sphere is taken for a paraboloid, as Hertz did; the published series does.

    Returns
    -------
    ForceLaw

    Raises
    ------
    ValueError
        For the published series and no sphere.

    Examples
    --------
    Hertz, 4/3 E* sqrt(R) d^1.5:

    >>> law = force_law(Sphere(4.0), Layer(np.inf, 0.5), 0.5, paraboloid=True)
    >>> float(law.force(np.array([0.25]))[0] / (4 / 3 * 2 * 0.125))
    1.000
    """
    if theory == "dimitriadis":
        if not isinstance(indenter, Sphere):
            raise ValueError(f"the published series is for spheres, got {indenter}")
        return _by_series(indenter, layer, deepest_mm)
    support = layer if theory == "integral-equation" else _far(layer)
    radii = _radii(indenter, support, deepest_mm, paraboloid)
    states = [contact_state(support, indenter, a, paraboloid=paraboloid) for a in radii]
    if isinstance(indenter, Flat) and indenter.is_sharp_edged:
        return _flat(states[0], indenter.radius_mm, deepest_mm)
    columns = ([s.depth_mm, s.force_mm2, s.stiffness_mm] for s in states)
    depth, force, stiffness = np.array(list(columns)).T
    return ForceLaw(depth, force, stiffness, radii)


def _far(layer: Layer) -> Layer:
    return Layer(np.inf, layer.poisson_ratio, layer.bonded)


def _flat(state: ContactState, radius: float, deepest: float) -> ForceLaw:
    """Sharp-edged punch: force in proportion to depth."""
    depth = deepest * np.array([1e-3, 1.0])
    stiffness = np.full(2, state.stiffness_mm)
    return ForceLaw(depth, stiffness * depth, stiffness, np.full(2, radius))


def _radii(indenter: Indenter, layer: Layer, deepest: float, paraboloid: bool) -> Array:
    """Contact radii up to that of the deepest indentation, mm."""
    first, most = contact_range(indenter)
    if first == most:
        return np.array([first])
    most = min(most, max(WIDEST * layer.height_mm, 1.001 * first))
    wide = max(1e-3 * min(most, deepest), 1.0001 * first)
    while wide < most:
        if contact_state(layer, indenter, wide, paraboloid=paraboloid).depth_mm >= deepest:
            break
        wide = first + 1.5 * (wide - first)
    spread = min(wide, most) - first
    return np.asarray(first + spread * np.logspace(-_DECADES, 0, _RADII))


def _by_series(sphere: Sphere, layer: Layer, deepest: float) -> ForceLaw:
    """Force of the published series; its contact radius is Hertz's."""
    depth = deepest * np.logspace(-2 * _DECADES, 0, _RADII)
    size, step = sphere.radius_mm, 1e-6

    def force(d: Array) -> Array:
        hertz = 4 / 3 * np.sqrt(size) * d**1.5
        return np.asarray(hertz * thin_layer.correction(layer, size, d))

    slope = (force(depth * (1 + step)) - force(depth * (1 - step))) / (2 * step * depth)
    return ForceLaw(depth, force(depth), slope, np.sqrt(size * depth))
