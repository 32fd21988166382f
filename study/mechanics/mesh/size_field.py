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

from study.ground.arrays import Array, Ints
from study.ground.compilation import callback, carray, kernel, part
from study.mechanics.mesh.structured import CORNER_FRACTION, GROWTH
from study.mechanics.setup.geometry import Flat, Indenter
from study.mechanics.setup.setup import Model, Space, mesh_level
from study.mechanics.setup.test_kind import AroundContact
from study.mechanics.surface.closed_surface import Body, Triangles

#: elements across the contact radius, and across the radius of a rounded tip or edge
_PER_CONTACT = 7.0
_PER_TIP = 4.0
_PER_EDGE = 3.0
_PER_SHARP_EDGE = 30.0
#: smallest part of a rounded edge that sizes are made for: in 3D it is followed all around
_LEAST_WIDTH = {"axisymmetric": 0.02, "3d": 0.4}
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
    """Element size around the point (or the ring) where an indenter presses."""

    top_mm: float
    #: What ``mesh_size`` names: the size at the contact or at an edge. A rounded tip is finer.
    size_mm: float
    #: Sizes at the sharpest feature and far away.
    finest_mm: float
    largest_mm: float
    #: Distance from the feature within which the size stays the finest.
    feature_mm: float
    #: Radius of the feature: 0 for a tip, that of the edge for a flat end.
    ring_mm: float
    #: Size within the contact radius, and that radius.
    zone_mm: float
    contact_mm: float
    #: Growth of the size per distance.
    growth: float
    #: How many elements around the feature have the finest size, whatever that is. The neighborhood
    #: of a singular edge then looks the same on every mesh of a series, which is what its error of
    #: first order comes from.
    even: float = 0.0
    #: How often that size is halved within the last of these elements.
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

    def scaled(self, factor: float) -> SizeField:
        """Return the field with every size and the growth multiplied by ``factor``."""
        names = ("size_mm", "finest_mm", "largest_mm", "zone_mm", "growth")
        return replace(self, **{name: getattr(self, name) * factor for name in names})


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
    """C function of a mesh generator's size: it asks at tens of thousands of places."""
    # Its arguments are those of gmsh (dimension, tag, x, y, z, size otherwise) and the address of
    # :meth:`SizeField.numbers`.
    plane = dim == 2

    @callback("float64(int32, int32, float64, float64, float64, float64, voidptr)")
    def size(
        _dim: int, _tag: int, x: float, y: float, z: float, _size_mm: float, numbers: object
    ) -> float:
        rho, height = (x, y) if plane else (math.hypot(x, y), z)
        return float(_size(rho, height, carray(numbers, (10,), np.float64)))

    size_function: CFunction = size
    return size_function


def reference_field(
    indenter: Indenter, depth_mm: float, top_mm: float, extent_mm: float, space: Space
) -> SizeField:
    """Sizes of the fine mesh."""
    a, round_mm = indenter.contact_radius_mm(depth_mm), indenter.rounding_mm
    zone, ring, feature = a / _PER_CONTACT, 0.0, 0.0
    size, reach, touched = zone, 1.3 * a, 1.0
    if isinstance(indenter, Flat):
        size = min(round_mm / _PER_EDGE if round_mm > 0 else a / _PER_SHARP_EDGE, zone)
        if round_mm > 0:  # pressed in but a little, a small part of the edge touches
            touched = max(indenter.edge_width_mm(depth_mm) / round_mm, _LEAST_WIDTH[space])
        ring, feature, reach = a - round_mm, 1.5 * touched * round_mm, a
    elif round_mm > 0:
        size = min(zone, round_mm / _PER_TIP)
        # pressed in but a little, a tip touches a small part of its own radius
        feature = min(_TIP_ZONE * round_mm, reach)
    largest = LARGEST * extent_mm
    return SizeField(top_mm, size, touched * size, largest, feature, ring, zone, reach, _GROWTH)


def size_field(model: Model, contact: AroundContact, top_mm: float, extent_mm: float) -> SizeField:
    """Sizes of a model: the reference scaled to its ``mesh_size_mm`` or named level."""
    indenter, depth_mm = contact.indenter, contact.depth_mm
    reference = reference_field(indenter, depth_mm, top_mm, extent_mm, model.space)
    if indenter.is_sharp_edged and model.space == "axisymmetric":
        halvings = int(_is_shallow(contact))
        reference = replace(reference, even=_EVEN, growth=_EVEN_GROWTH, halvings=halvings)
    if indenter.has_face and (model.space, model.element_shape) == ("3d", "tensor"):
        shallow = contact.indenter.is_sharp_edged and _is_shallow(contact)
        finest = reference.finest_mm / (_RING_FINER if shallow else 1.0)
        reference = replace(reference, finest_mm=finest, growth=_FACE_GROWTH)
    if (model.element_order, model.element_shape) == _STRETCHED:
        reference = _quadratic_simplices(reference, contact, model.space)
    if model.mesh_size_mm is not None:
        return reference.scaled(model.mesh_size_mm / reference.size_mm)
    return reference.scaled(mesh_level(model))


def _is_shallow(contact: AroundContact) -> bool:
    """Whether strains at a sharp edge stay so small that smaller elements do not collapse."""
    depth_mm = contact.depth_mm
    return depth_mm <= _SHALLOW * contact.indenter.contact_radius_mm(depth_mm)


def _quadratic_simplices(field: SizeField, contact: AroundContact, space: Space) -> SizeField:
    """Sizes of quadratic triangles and tetrahedra, under a tip or around the edge of a face."""
    indenter = contact.indenter
    if not indenter.has_face:
        core = _TIP_CORE[space]
        finest = indenter.rounding_mm / (_PER_TIP * _TIP_FINER)
        if not 0 < finest < field.finest_mm:
            return field
        return replace(field, finest_mm=finest, feature_mm=core * indenter.rounding_mm)
    slips = contact.depth_mm > _SLIPPING * indenter.contact_radius_mm(contact.depth_mm)
    return field if slips or space == "axisymmetric" else replace(field, growth=_FACE_GROWTH)


# Sizes of elements in a compressed surface: tetrahedra get the volume of the quarter model's
# cells at the same distance from plates and sides, so that one mesh size means one error in both.

#: steps of the table in an element, and the most of them along an edge of the bounding box
_PER_ELEMENT = 4.0
_MOST = 64
#: size that gmsh is told over that of the cells it should be as many as, in a body much larger than
#: they are, and how much less in a smaller one: lines of a quarter model have whole numbers of
#: cells, rounded up, and sizes that grow within a cell are followed but in part. A cylinder of R 10
#: and H 12 mm has 1.1 times the cells of 8 octants at 3.4 and 1.8 mm, and linear ones make it
#: 1.4, 1.4, 0.9 and 0.7 % stiffer at 5, 3.4, 2.5 and 1.8 mm; one of H 6 mm is up to 2 % stiffer
_TOLD = 0.975
_LESS = 0.75
#: height over which a squat body counts as small: it shears across its height, where a quarter
#: model has flat cells and tetrahedra of the same volume are taller
_SQUAT = 1.2


@dataclass(frozen=True)
class SizeTable:
    """Element size on a regular grid, linear between its points."""

    #: What ``mesh_size`` names: the size of a cell far from plates and sides.
    size_mm: float
    #: shape (3,); first point of the grid in mm.
    origin: Array
    step_mm: float
    #: shape (nx, ny, nz); size at every point in mm.
    sizes: Array

    @property
    def finest_mm(self) -> float:
        """Smallest size."""
        return float(self.sizes.min())

    def numbers(self) -> tuple[float, ...]:
        """All that the size at a place depends on, in the order of the compiled formula."""
        grid = (*self.origin, self.step_mm, *(float(n) for n in self.sizes.shape))
        return (*grid, *self.sizes.ravel())


@part()
def _cell(x: float, origin: float, step: float, n: int) -> tuple[int, float]:
    """Grid cell of a coordinate, and how far into it that is."""
    position = min(max((x - origin) / step, 0.0), n - 1.0)
    low = min(int(position), n - 2)
    return low, position - low


@functools.cache
def table_callback() -> CFunction:
    """C function of a size table, called as that of :func:`.size_field.size_callback` is."""

    @callback("float64(int32, int32, float64, float64, float64, float64, voidptr)")
    def size(
        _dim: int, _tag: int, x: float, y: float, z: float, _size_mm: float, numbers: object
    ) -> float:
        head = carray(numbers, (7,), np.float64)
        nx, ny, nz = int(head[4]), int(head[5]), int(head[6])
        every = carray(numbers, (7 + nx * ny * nz,), np.float64)
        i, u = _cell(x, head[0], head[3], nx)
        j, v = _cell(y, head[1], head[3], ny)
        k, w = _cell(z, head[2], head[3], nz)
        total = 0.0
        for a in range(2):
            for b in range(2):
                first = 7 + ((i + a) * ny + j + b) * nz + k
                line = (1.0 - w) * every[first] + w * every[first + 1]
                total += (u if a else 1.0 - u) * (v if b else 1.0 - v) * line
        return total

    size_function: CFunction = size
    return size_function


def graded_table(body: Body, size_mm: float, plates: tuple[float, ...]) -> SizeTable:
    """Sizes in a body whose faces are bonded at some heights. Units: found mm; plates mm."""
    low, high = body.points.min(axis=0), body.points.max(axis=0)
    step = max(size_mm / _PER_ELEMENT, float((high - low).max()) / _MOST)
    axes = [np.arange(a, b + step, step) for a, b in zip(low, high, strict=True)]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    reach = (1 - CORNER_FRACTION) * size_mm / GROWTH  # farther away sizes grow no more
    spacing = _spacing(_from_sides(body, places.reshape(-1, 3), step, reach), size_mm)
    below = _spacing(_from_plates(axes[2], plates), size_mm)
    sizes = _told(body, size_mm) * np.cbrt(size_mm * spacing.reshape(places.shape[:3]) * below)
    return SizeTable(size_mm, low, step, sizes)


def expected_cubes(body: Body, size_mm: float, plates: tuple[float, ...]) -> float:
    """Cubes of the sizes that gmsh is told, in a body as if it were a prism."""
    # At a distance s from the side, a prism of volume V and lateral area A has the part (1 - s A /
    # 2V)^2 of its cross-section left.
    height = body.height_mm
    z = np.unique(np.concatenate([np.abs(p - _away(height)) for p in (0.0, height)]))
    high = float(np.trapezoid(1 / _spacing(_from_plates(z, plates), size_mm), z))
    reach = 2 * body.volume_mm3 / Triangles(body.points, _side(body)).area_mm2
    s = _away(reach)
    wide = float(np.trapezoid(2 / reach * (1 - s / reach) / _spacing(s, size_mm), s))
    return body.volume_mm3 / height * wide * high / size_mm / _told(body, size_mm) ** 3


def size_at_plates(body: Body, size_mm: float) -> float:
    """Size that gmsh is told at a bonded plate, far from its rim."""
    return float(_told(body, size_mm) * size_mm * np.cbrt(CORNER_FRACTION))


def _told(body: Body, size_mm: float) -> float:
    """Size that gmsh is told over that of the cells, less in a crude mesh and in a squat body."""
    length = min(float(np.cbrt(body.volume_mm3)), _SQUAT * body.height_mm)
    return _TOLD * max(1 - _LESS * size_mm / length, 0.5)


def _away(length: float) -> Array:
    """Distances up to a length, closer at its start."""
    return np.concatenate([[0.0], np.geomspace(1e-12 * length, length, 400)])


def _spacing(distance: Array, size_mm: float) -> Array:
    """Spacing of a quarter model's lines: see :func:`.structured.graded_line`."""
    return np.asarray(np.minimum(CORNER_FRACTION * size_mm + GROWTH * distance, size_mm))


def _from_plates(z: Array, plates: tuple[float, ...]) -> Array:
    return np.asarray(np.min([np.abs(z - plate) for plate in plates], axis=0))


def _side(body: Body) -> Ints:
    """Triangles that lie in no plate, shape (m, 3)."""
    return np.asarray(body.triangles[~(body.top | body.base)])


def _from_sides(body: Body, places: Array, step: float, reach: float) -> Array:
    """Distance from the free surface, up to about half a step; infinite beyond ``reach``."""
    from scipy.spatial import cKDTree

    points = _sampled(body.points[_side(body)], step)
    _, distinct = np.unique(np.round(points / (0.5 * step)).astype(int), axis=0, return_index=True)
    nearest = cKDTree(points[distinct]).query  # of a tree of points: no text is evaluated by it
    return np.asarray(nearest(places, distance_upper_bound=reach)[0])


def _sampled(corners: Array, step: float) -> Array:
    """Points on triangles, no further apart than a step."""
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    divisions = np.maximum(1, np.ceil(edges / step)).astype(int)
    points = []
    for n in np.unique(divisions):
        i, j = (index.ravel() for index in np.indices((n + 1, n + 1)))
        inside = i + j <= n
        share = np.column_stack([i, j, n - i - j])[inside] / n
        points.append(np.einsum("qk,mkj->mqj", share, corners[divisions == n]).reshape(-1, 3))
    return np.vstack(points)
