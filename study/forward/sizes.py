"""How large elements should be around an indenter: one reference field, scaled as a whole.

A mesh level multiplies the whole field, so that coarse, medium and fine are a refinement
series with one ratio everywhere, as an observed order of convergence presumes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from study.forward.problem import Cone, Flat, Indenter, Model, Sphere, mesh_level

Array = NDArray[np.float64]

#: elements across the contact radius, and across the radius of a rounded tip or edge
_PER_CONTACT, _PER_TIP, _PER_EDGE, _PER_SHARP_EDGE = 7.0, 4.0, 3.0, 30.0
#: part of a tip's radius within which sizes are the finest; for quadratic simplices they are finer
#: still, within a smaller part: the surface is stretched three times and more there, and facets as
#: wide as the tip let it snap (linear and tensor elements collapse the sooner the smaller they are)
_TIP_ZONE, _TIP_CORE = 1.5, 0.3
#: what a plane can afford carries energies that soften in tension, where it is stretched five times
_TIP_FINER = {"axisymmetric": 7.0, "3d": 5.0}
_STRETCHED = ("quadratic", "simplex")
#: elements of one size around a sharp edge, and the growth beyond them, in a plane
_EVEN, _EVEN_GROWTH = 4.0, 0.12
#: up to this depth over the radius the last of them is halved, and with it the error; deeper,
#: the smaller an element at a sharp edge is, the sooner it collapses
_SHALLOW = 0.1
#: how fast sizes grow away from the contact, and the largest part of the specimen
_GROWTH, _LARGEST = 0.4, 0.3


@dataclass(frozen=True)
class SizeField:
    """Element size around the point (or the ring) where an indenter presses.

    Parameters
    ----------
    top_mm : float
        Height of the loaded surface.
    size_mm : float
        What ``mesh_size`` names: the size at the contact or at an edge. A rounded tip is finer.
    finest_mm, largest_mm : float
        Sizes at the sharpest feature and far away.
    feature_mm : float
        Distance from the feature within which the size stays the finest.
    ring_mm : float
        Radius of the feature: 0 for a tip, that of the edge for a flat end.
    zone_mm, contact_mm : float
        Size within the contact radius, and that radius.
    growth : float
        Growth of the size per distance.
    even : float
        How many elements around the feature have the finest size, whatever that is. The
        neighborhood of a singular edge then looks the same on every mesh of a series, which
        is what its error of first order comes from.
    halvings : int
        How often that size is halved within the last of these elements.
    """

    top_mm: float
    size_mm: float
    finest_mm: float
    largest_mm: float
    feature_mm: float
    ring_mm: float
    zone_mm: float
    contact_mm: float
    growth: float
    even: float = 0.0
    halvings: int = 0

    def at(self, rho: Array, z: Array) -> Array:
        """Size at radius ``rho`` from the axis and height ``z``, shape (n,)."""
        depth = z - self.top_mm
        from_feature = np.hypot(rho - self.ring_mm, depth)
        feature = from_feature - self.feature_mm - self.even * self.finest_mm
        if self.ring_mm:
            outside = np.hypot(np.maximum(rho - self.contact_mm, 0.0), depth)
        else:
            outside = np.hypot(rho, depth) - self.contact_mm
        near = self.finest_mm + self.growth * np.maximum(feature, 0.0)
        zone = self.zone_mm + self.growth * np.maximum(outside, 0.0)
        size = np.minimum(np.minimum(near, zone), self.largest_mm)
        if self.halvings:
            rings = np.maximum(from_feature / self.finest_mm, 0.5**self.halvings)
            size = np.where(rings < 1.0, 0.5 ** np.ceil(-np.log2(rings)) * size, size)
        return np.asarray(size)

    def scaled(self, factor: float) -> SizeField:
        """Return the field with every size and the growth multiplied by ``factor``."""
        return replace(
            self,
            size_mm=self.size_mm * factor,
            finest_mm=self.finest_mm * factor,
            largest_mm=self.largest_mm * factor,
            zone_mm=self.zone_mm * factor,
            growth=self.growth * factor,
        )


def contact_radius(indenter: Indenter, depth_mm: float) -> float:
    """Contact radius on a half-space of the same indenter, mm (Hertz; Sneddon 1965)."""
    if isinstance(indenter, Flat):
        return indenter.radius_mm
    if isinstance(indenter, Sphere):
        return float(min(np.sqrt(indenter.radius_mm * depth_mm), indenter.radius_mm))
    sharp = 2 / np.pi * depth_mm * np.tan(np.radians(indenter.half_angle_deg))
    wide = max(sharp, np.sqrt(indenter.tip_radius_mm * depth_mm) if _round(indenter) else 0.0)
    return float(min(wide, indenter.shaft_radius_mm or np.inf))


def sharp_edge(indenter: Indenter | None) -> bool:
    """Whether an indenter ends in a flat face with a sharp edge."""
    return isinstance(indenter, Flat) and indenter.edge_radius_mm == 0


def _round(cone: Cone) -> bool:
    """Whether the contact at small depth is that of the tip's sphere."""
    return cone.tip_radius_mm > 0


def reference_field(
    indenter: Indenter, depth_mm: float, top_mm: float, extent_mm: float
) -> SizeField:
    """Sizes of the fine mesh.

    Parameters
    ----------
    depth_mm : float
        Displacement at the end of the test.
    top_mm, extent_mm : float
        Height of the loaded surface, and the smaller of height and half-width.
    """
    a = contact_radius(indenter, depth_mm)
    zone, ring, feature = a / _PER_CONTACT, 0.0, 0.0
    size, reach = zone, 1.3 * a
    if isinstance(indenter, Cone) and indenter.tip_radius_mm > 0:
        size = min(zone, indenter.tip_radius_mm / _PER_TIP)
        feature = _TIP_ZONE * indenter.tip_radius_mm
    elif isinstance(indenter, Flat):
        edge = indenter.edge_radius_mm
        size = min(edge / _PER_EDGE if edge > 0 else a / _PER_SHARP_EDGE, zone)
        ring, feature, reach = a - edge, 1.5 * edge, a
    largest = _LARGEST * extent_mm
    return SizeField(top_mm, size, size, largest, feature, ring, zone, reach, _GROWTH)


def size_field(
    model: Model, indenter: Indenter, depth_mm: float, top_mm: float, extent_mm: float
) -> SizeField:
    """Sizes of a model: the reference scaled to its ``mesh_size_mm`` or named level."""
    reference = reference_field(indenter, depth_mm, top_mm, extent_mm)
    if sharp_edge(indenter) and model.space == "axisymmetric":
        reference = _about_sharp_edge(reference, indenter, depth_mm)
    if isinstance(indenter, Cone) and (model.element_order, model.element_shape) == _STRETCHED:
        reference = _under_tip(reference, indenter, _TIP_FINER[model.space])
    if model.mesh_size_mm is not None:
        return reference.scaled(model.mesh_size_mm / reference.size_mm)
    return reference.scaled(mesh_level(model))


def _about_sharp_edge(field: SizeField, indenter: Indenter, depth_mm: float) -> SizeField:
    """Let the error of the edge, of first order, rule that of the smooth rest.

    In 3D so slow a growth would cost too much.
    """
    halvings = int(depth_mm <= _SHALLOW * contact_radius(indenter, depth_mm))
    return replace(field, even=_EVEN, growth=_EVEN_GROWTH, halvings=halvings)


def _under_tip(field: SizeField, cone: Cone, finer: float) -> SizeField:
    """Smaller elements under a rounded tip, where a deep needle stretches them most."""
    finest = cone.tip_radius_mm / (_PER_TIP * finer)
    if not 0 < finest < field.finest_mm:
        return field
    return replace(field, finest_mm=finest, feature_mm=_TIP_CORE * cone.tip_radius_mm)
