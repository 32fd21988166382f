"""How large elements should be around an indenter: one reference field, scaled as a whole.

A mesh level multiplies the whole field, so that coarse, medium and fine are a refinement
series with one ratio everywhere, as an observed order of convergence presumes.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from study.arrays import Array
from study.compilation import callback, carray, kernel, part
from study.setup.geometry import Indenter
from study.setup.setup import Model, Space, mesh_level
from study.setup.test_kind import AroundContact

#: elements across the contact radius, and across the radius of a rounded tip or edge
_PER_CONTACT = 7.0
_PER_TIP = 4.0
_PER_EDGE = 3.0
_PER_SHARP_EDGE = 30.0

#: part of a tip's radius within which sizes are the finest; for quadratic simplices they are finer
#: still, within a smaller part: the surface is stretched three times there, five times if its
#: energy softens in tension, and facets as wide as the tip let it snap (linear and tensor elements
#: collapse the sooner the smaller they are)
_TIP_ZONE = 1.5
_TIP_FINER = 7.0
_TIP_CORE = {"axisymmetric": 0.3, "3d": 0.2}
_STRETCHED = ("quadratic", "simplex")

#: elements of one size around a sharp edge, and the growth beyond them, in a plane
_EVEN = 4.0
_EVEN_GROWTH = 0.12

#: up to this depth over the radius the last of them is halved, and with it the error; deeper,
#: the smaller an element at a sharp edge is, the sooner it collapses
_SHALLOW = 0.1

#: growth beyond the edge of a face in 3D, where hexahedra lie in rings or tetrahedra are quadratic:
#: the edge's singular strains reach far. Quadratic tetrahedra (1 mm deep, edge 0.3 mm, nu 0.4999)
#: are 0.94 % too stiff on the coarse mesh with 0.4, at 0.7 times the unknowns of 0.24, 0.31 %
_FACE_GROWTH = 0.27

#: depth over the radius of a face up to which tetrahedra grow so slowly. Deeper, the surface slips
#: over the edge facet by facet, and only with the faster growth a neo-Hookean solid is known to
#: reach the radius: the more facets there are, the more of them have to slip
_SLIPPING = 0.5

#: how much finer rings of hexahedra are across a sharp edge
_RING_FINER = 3.0

#: how fast sizes grow away from the contact, and the largest part of the specimen
_GROWTH = 0.4
LARGEST = 0.3


class CFunction(Protocol):
    """Compiled function that a library in C may call."""

    @property
    def ctypes(self) -> object:
        """Pointer to it, as ctypes hands it over."""


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

    def at(self, rho: ArrayLike, z: ArrayLike) -> Array:
        """Size at radius ``rho`` from the axis and height ``z``, of their common shape."""
        both = np.broadcast_arrays(np.asarray(rho, float), np.asarray(z, float))
        sizes = _sizes(both[0].ravel(), both[1].ravel(), np.array(self.numbers()))
        return np.asarray(sizes.reshape(both[0].shape))

    @classmethod
    def uniform(cls, size_mm: float) -> SizeField:
        """Return a field of one size."""
        return cls(0.0, size_mm, size_mm, size_mm, 0.0, 0.0, size_mm, 0.0, 0.0)

    def numbers(self) -> tuple[float, ...]:
        """All that the size at a place depends on, in the order of the compiled formula."""
        return (
            self.top_mm, self.finest_mm, self.largest_mm, self.feature_mm, self.ring_mm,
            self.zone_mm, self.contact_mm, self.growth, self.even, float(self.halvings),
        )  # fmt: skip

    def callback(self, dim: int) -> CFunction:
        """C function that tells gmsh the size at a place."""
        return size_callback(dim)

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


@part()
def _size(rho: float, z: float, numbers: Array) -> float:
    """Size at one place; the numbers are those of :meth:`SizeField.numbers`."""
    top, finest, largest = numbers[0], numbers[1], numbers[2]
    feature, ring, zone, contact = numbers[3], numbers[4], numbers[5], numbers[6]
    growth, even, halvings = numbers[7], numbers[8], numbers[9]
    depth = z - top
    from_feature = math.hypot(rho - ring, depth)
    if ring > 0.0:
        outside = math.hypot(max(rho - contact, 0.0), depth)
    else:
        outside = math.hypot(rho, depth) - contact
    near = finest + growth * max(from_feature - feature - even * finest, 0.0)
    size = min(near, zone + growth * max(outside, 0.0), largest)
    if halvings > 0.0:
        rings = max(from_feature / finest, 0.5**halvings)
        if rings < 1.0:
            size *= 0.5 ** math.ceil(-math.log2(rings))
    return float(size)


@kernel()
def _sizes(rho: Array, z: Array, numbers: Array) -> Array:
    """Sizes at places, shape (n,)."""
    out = np.empty(rho.size)
    for i in range(rho.size):
        out[i] = _size(rho[i], z[i], numbers)
    return out


@functools.cache
def size_callback(dim: int) -> CFunction:
    """C function of a mesh generator's size: it asks at tens of thousands of places.

    Its arguments are those of gmsh (dimension, tag, x, y, z, size otherwise) and the address
    of :meth:`SizeField.numbers`.

    Parameters
    ----------
    dim : {2, 3}
        2 where x is the radius and y the height, 3 where the axis is z.
    """
    plane = dim == 2

    @callback("float64(int32, int32, float64, float64, float64, float64, voidptr)")
    def size(
        _dim: int, _tag: int, x: float, y: float, z: float, _size_mm: float, numbers: object
    ) -> float:
        rho, height = (x, y) if plane else (math.hypot(x, y), z)
        return float(_size(rho, height, carray(numbers, (10,), np.float64)))

    made: CFunction = size
    return made


def reference_field(
    indenter: Indenter, depth_mm: float, top_mm: float, extent_mm: float
) -> SizeField:
    """Sizes of the fine mesh.

    Parameters
    ----------
    indenter : Flat, Cone or Sphere
        At whose contact elements are smallest.
    depth_mm : float
        Displacement at the end of the test.
    top_mm, extent_mm : float
        Height of the loaded surface, and the smaller of height and half-width.
    """
    a, round_mm = indenter.contact_radius_mm(depth_mm), indenter.rounding_mm
    zone, ring, feature = a / _PER_CONTACT, 0.0, 0.0
    size, reach = zone, 1.3 * a
    if indenter.has_face:
        size = min(round_mm / _PER_EDGE if round_mm > 0 else a / _PER_SHARP_EDGE, zone)
        ring, feature, reach = a - round_mm, 1.5 * round_mm, a
    elif round_mm > 0:
        size = min(zone, round_mm / _PER_TIP)
        # pressed in but a little, a tip touches a small part of its own radius
        feature = min(_TIP_ZONE * round_mm, reach)
    largest = LARGEST * extent_mm
    return SizeField(top_mm, size, size, largest, feature, ring, zone, reach, _GROWTH)


def size_field(model: Model, contact: AroundContact, top_mm: float, extent_mm: float) -> SizeField:
    """Sizes of a model: the reference scaled to its ``mesh_size_mm`` or named level.

    Parameters
    ----------
    model : Model
        Discretization.
    contact : AroundContact
        Indenter and depth.
    top_mm, extent_mm : float
        Height of the loaded surface, and the smaller of height and half-width.
    """
    indenter, depth_mm = contact.indenter, contact.depth_mm
    reference = reference_field(indenter, depth_mm, top_mm, extent_mm)
    if indenter.is_sharp_edged and model.space == "axisymmetric":
        reference = _about_sharp_edge(reference, contact)
    if indenter.has_face and (model.space, model.element_shape) == ("3d", "tensor"):
        reference = _of_rings(reference, contact)
    if (model.element_order, model.element_shape) == _STRETCHED:
        reference = _quadratic_simplices(reference, contact, model.space)
    if model.mesh_size_mm is not None:
        return reference.scaled(model.mesh_size_mm / reference.size_mm)
    return reference.scaled(mesh_level(model))


def _is_shallow(contact: AroundContact) -> bool:
    """Whether strains at a sharp edge stay so small that smaller elements do not collapse."""
    depth_mm = contact.depth_mm
    return depth_mm <= _SHALLOW * contact.indenter.contact_radius_mm(depth_mm)


def _about_sharp_edge(field: SizeField, contact: AroundContact) -> SizeField:
    """Let the error of the edge, of first order, rule that of the smooth rest.

    In 3D so slow a growth would cost too much.
    """
    halvings = int(_is_shallow(contact))
    return replace(field, even=_EVEN, growth=_EVEN_GROWTH, halvings=halvings)


def _of_rings(field: SizeField, contact: AroundContact) -> SizeField:
    """Sizes of rings of hexahedra around an edge, which are cheap to be small across it.

    Linear ones need a slower growth; the singular edge takes as much off the force as they do.
    """
    shallow = contact.indenter.is_sharp_edged and _is_shallow(contact)
    finest = field.finest_mm / (_RING_FINER if shallow else 1.0)
    return replace(field, finest_mm=finest, growth=_FACE_GROWTH)


def _quadratic_simplices(field: SizeField, contact: AroundContact, space: Space) -> SizeField:
    """Sizes of quadratic triangles and tetrahedra, under a tip or around the edge of a face."""
    indenter = contact.indenter
    if not indenter.has_face:
        return _under_tip(field, indenter.rounding_mm, _TIP_CORE[space])
    slips = contact.depth_mm > _SLIPPING * indenter.contact_radius_mm(contact.depth_mm)
    return field if slips or space == "axisymmetric" else replace(field, growth=_FACE_GROWTH)


def _under_tip(field: SizeField, tip_mm: float, core: float) -> SizeField:
    """Smaller elements under a rounded tip, where a deep needle stretches them most."""
    finest = tip_mm / (_PER_TIP * _TIP_FINER)
    if not 0 < finest < field.finest_mm:
        return field
    return replace(field, finest_mm=finest, feature_mm=core * tip_mm)
