"""Cells of the mesh of a cylinder or a block from its sizes alone, before it is made."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from study.arrays import Array
from study.fem.mesh.graded import UNDER_CONE, sizes_of
from study.fem.mesh.mesher import mesh_size
from study.fem.mesh.rings import BULGE, CORE, around, has_room, inward
from study.fem.mesh.size_field import SizeField
from study.fem.mesh.structured import CORNER_FRACTION, GROWTH, equivalent_radius
from study.setup.geometry import Block, Indenter, Specimen
from study.setup.setup import Setup
from study.setup.test_kind import AroundContact, TowardsPlates
from study.surface.surface import height_of

#: cells of gmsh in a square or a cube of one size
_PER_SQUARE = 2.4
_PER_CUBE = 5.3

#: the same on a line or a square of one size on the surface
_PER_LINE = 1.0
_PER_FACE = 2.3

#: places at which sizes are looked at, on each side of a feature
_SAMPLES = 80


def expected_cells(setup: Setup) -> float:
    """Cells that a mesh will have: the density of elements is integrated.

    Parameters
    ----------
    setup : Setup
        Of a cylinder or a block.
    """
    grading = setup.grading
    if isinstance(grading, AroundContact):
        return _under_indenter(setup, grading.indenter)
    return _between_plates(setup, grading)


def _between_plates(setup: Setup, grading: TowardsPlates) -> float:
    """Cells of a structured mesh: see :func:`study.fem.mesh.mesher.compressed_mesh`."""
    specimen, h, bonded = setup.specimen, mesh_size(setup), (grading.top, grading.base)
    half = height_of(specimen) / 2
    high = sum(_line(half, h, graded=plate) for plate in bonded)
    if setup.has_middle_plane:
        high /= 2  # the half above the middle plane
    simplex, rim = setup.model.element_shape == "simplex", any(bonded)
    radius = equivalent_radius(specimen)
    if setup.model.space == "axisymmetric":
        return high * _line(radius, h, graded=rim) * (2 if simplex else 1)
    if isinstance(specimen, Block):
        plane = _line(specimen.width_mm / 2, h, graded=rim)
        plane *= _line(specimen.depth_mm / 2, h, graded=rim) * (4 if setup.is_whole else 1)
        return high * plane * (6 if simplex else 1)
    if not simplex:
        return high * _disc(_line(radius / 2, h, graded=False), _line(radius, h, graded=rim))
    # ring k of triangles carries segments of the size h, see quarter_disc
    inner = np.pi * radius**2 / (2 * h**2)
    extra = _line(radius, h, graded=rim) - radius / h
    return high * 3 * (inner + np.pi * radius / h * extra)


def _line(length: float, h: float, *, graded: bool) -> float:
    """Count the steps of :func:`study.fem.mesh.structured.graded_line`."""
    if not graded:
        return max(1.0, length / h)
    coarse = min((1 - CORNER_FRACTION) * h / GROWTH, length)
    return float(np.log1p(GROWTH * coarse / (CORNER_FRACTION * h)) / GROWTH + (length - coarse) / h)


def _disc(inner: float, line: float) -> float:
    """Quadrilaterals of a quarter disc: a square of half the radius, two blocks around it."""
    return inner**2 + 2 * inner * max(line - inner, 1.0)


def _under_indenter(setup: Setup, indenter: Indenter) -> float:
    """Cells of a graded mesh: see :func:`study.fem.mesh.graded.indentation_mesh`."""
    specimen, field = setup.specimen, sizes_of(setup)
    radius, flat = equivalent_radius(specimen), setup.model.space == "axisymmetric"
    if setup.model.element_shape == "tensor":
        return _grid(setup, indenter, field, radius)
    rho = _places(radius, field.ring_mm, field)
    z = height_of(specimen) - _places(height_of(specimen), 0.0, field)
    h = field.at(*(a.ravel() for a in np.meshgrid(rho, z))).reshape(z.size, rho.size)
    density = np.asarray(1 / h**2 if flat else np.pi / 2 * rho / h**3)
    total = abs(float(np.trapezoid(np.trapezoid(density, rho, axis=1), z)))
    filled = (_PER_SQUARE if flat else _PER_CUBE) * total
    # a specimen thinner than its elements has as many as its upper and lower face ask for
    h = field.at(rho, np.array([field.top_mm]))
    thin = 2 * float(np.trapezoid(1 / h if flat else np.pi / 2 * rho / h**2, rho))
    return max(filled, (_PER_LINE if flat else _PER_FACE) * thin)


def _grid(setup: Setup, indenter: Indenter, field: SizeField, radius: float) -> float:
    """Quadrilaterals or hexahedra between lines."""
    specimen = setup.specimen
    wide, tall = UNDER_CONE[setup.model.element_order] if indenter.is_pointed else (1, 1)
    top = np.array([field.top_mm])

    def along_top(length: float) -> float:
        return _steps(length, field.ring_mm, field, lambda rho: wide * field.at(rho, top))

    def along_axis(depth: Array) -> Array:
        return tall * field.at(np.full(depth.shape, field.ring_mm), field.top_mm - depth)

    high = _steps(height_of(specimen), 0.0, field, along_axis)
    solid = setup.model.space == "3d"
    if solid and indenter.has_face and has_room(specimen, field.ring_mm):
        return high * _rings(specimen, field)
    if setup.model.space == "axisymmetric":
        return high * along_top(radius)
    if isinstance(specimen, Block):
        return high * along_top(specimen.width_mm / 2) * along_top(specimen.depth_mm / 2)
    return high * _disc(along_top(radius / 2), along_top(radius))


def _rings(specimen: Specimen, field: SizeField) -> float:
    """Quadrilaterals of :func:`study.fem.mesh.rings.punched` over a cross-section."""
    n, ring = around(field), field.ring_mm
    half = equivalent_radius(specimen)
    if isinstance(specimen, Block):  # the mean of where rays meet a square
        half = 0.56 * min(specimen.width_mm, specimen.depth_mm)
    core = 0.5 * (1 + BULGE) * CORE * ring

    def steps(own: SizeField, start: float, end: float) -> float:
        places = np.unique(np.clip(_places(end, ring, own), start, end))
        return float(np.trapezoid(1 / own.at(places, own.top_mm), places))

    around_it = steps(inward(field), core, ring) + steps(field, ring, max(half, ring))
    beyond = 0.0
    if isinstance(specimen, Block):
        ends = sorted((specimen.width_mm / 2, specimen.depth_mm / 2))
        beyond = steps(field, *ends)
    return n**2 + 2 * n * around_it + n * beyond


def _steps(length: float, at: float, field: SizeField, size: Callable[[Array], Array]) -> float:
    """Count the steps of a line whose spacing follows ``size``."""
    places = _places(length, at, field)
    return max(2.0, float(np.trapezoid(1 / size(places), places)))


def _places(length: float, at: float, field: SizeField) -> Array:
    """Places from 0 to ``length``, closer around ``at``."""
    away = np.geomspace(0.1 * min(field.finest_mm, length), length, _SAMPLES)
    kept = [at + away, at - away, np.array([0.0, at, length])]
    kept += [edge + away * sign for edge in _edges(field, at) for sign in (1, -1)]
    every = np.unique(np.concatenate(kept))
    return np.asarray(every[(every >= 0) & (every <= length)])


def _edges(field: SizeField, at: float) -> tuple[float, ...]:
    """Distances where a zone of one size ends."""
    return (at + field.feature_mm, field.contact_mm)
