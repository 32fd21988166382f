"""Meshes under an indenter: graded from the contact outwards, by gmsh or as a tensor grid.

The one file that imports gmsh: its state is global, so that each mesh is made in one
session of one thread and closed before anything else happens.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from types import ModuleType
from typing import Protocol

import numpy as np

from study.arrays import Array, Ints
from study.errors import MeshError
from study.fem.mesh.mesh import Mesh
from study.fem.mesh.rings import has_room, punched
from study.fem.mesh.size_field import CFunction, SizeField, size_field
from study.fem.mesh.structured import (
    equivalent_radius,
    extrude,
    half_hexagon,
    line_about,
    line_by_size,
    line_from,
    quarter_disc_of_quadrilaterals,
    rectangle,
)
from study.setup.geometry import Block, Cylinder
from study.setup.setup import Setup
from study.setup.test_kind import AroundContact

#: gmsh's numbers: frontal triangles, Delaunay tetrahedra
_FRONTAL = 6
_DELAUNAY = 1

#: sizes of grids along the top and along the axis under a cone, over those of the field: what
#: begins tall ends less flat where a needle stretches the surface to three times its length
UNDER_CONE = {"linear": (1.0, 2.0), "quadratic": (0.8, 2.0)}

#: smallest quality (gmsh's inverse condition number) of a tetrahedron or triangle
_POOREST = 0.02


class Sizes(Protocol):
    """Sizes of elements, as gmsh asks for them."""

    def numbers(self) -> tuple[float, ...]:
        """All that the size at a place depends on."""

    def callback(self, dim: int) -> CFunction:
        """C function of these numbers and a place."""


def indentation_mesh(setup: Setup) -> Mesh:
    """Mesh of an indented cylinder or block.

    Parameters
    ----------
    setup : Setup
        Test with an indenter; in 3D a quarter of the specimen is meshed.

    Raises
    ------
    MeshError
        If gmsh fails or leaves elements too flat to be used.
    """
    specimen, model = setup.specimen, setup.model
    if not isinstance(specimen, Cylinder | Block):
        raise MeshError("a graded mesh needs a cylinder or a block")
    height, field, contact = specimen.height_mm, sizes_of(setup), contact_of(setup)
    ring = contact.indenter.face_radius_mm
    solid = model.space == "3d"
    if model.element_shape == "tensor" and solid and has_room(specimen, ring):
        points, cells = punched(specimen, field)
    elif model.element_shape == "tensor":
        points, cells = _grid(setup, specimen, field, ring)
    elif model.space == "axisymmetric":
        points, cells = _triangles(equivalent_radius(specimen), height, field, ring)
    else:
        points, cells = _tetrahedra(_outline(specimen, field), height, field, ring)
    return Mesh(points, cells, False, field.size_mm, field.finest_mm)


def graded_size(setup: Setup) -> float:
    """Element size of an indented cylinder or block, as ``mesh_size`` names it.

    Parameters
    ----------
    setup : Setup
        Test with an indenter; the size is in mm.
    """
    return sizes_of(setup).size_mm


def contact_of(setup: Setup) -> AroundContact:
    """Indenter and depth that sizes are made for.

    Parameters
    ----------
    setup : Setup
        Test whose elements grow from a contact outwards.

    Raises
    ------
    MeshError
        If the test has no indenter.
    """
    if not isinstance(setup.grading, AroundContact):
        raise MeshError("a mesh graded around a contact needs an indenter")
    return setup.grading


def sizes_of(setup: Setup) -> SizeField:
    """Sizes of the elements of an indented cylinder or block.

    Parameters
    ----------
    setup : Setup
        Test with an indenter on a cylinder or block.

    Raises
    ------
    MeshError
        If the specimen is neither of them.
    """
    specimen = setup.specimen
    if not isinstance(specimen, Cylinder | Block):
        raise MeshError("an indentation mesh needs a cylinder or a block")
    extent = min(specimen.half_width_mm, specimen.height_mm)
    return size_field(setup.model, contact_of(setup), specimen.height_mm, extent)


def _grid(
    setup: Setup, specimen: Cylinder | Block, field: SizeField, ring: float
) -> tuple[Array, Ints]:
    """Quadrilaterals or hexahedra on lines that follow the sizes along the top and the axis."""
    space, order = setup.model.space, setup.model.element_order
    wide, tall = UNDER_CONE[order] if contact_of(setup).indenter.is_pointed else (1.0, 1.0)
    top = np.array([field.top_mm])

    def along_top(rho: Array) -> Array:
        return wide * field.at(rho, top)

    def along_axis(depth: Array) -> Array:
        return tall * field.at(np.full(depth.shape, field.ring_mm), field.top_mm - depth)

    if field.even and 0 < ring < equivalent_radius(specimen):  # in a plane: see size_field
        r = line_about(equivalent_radius(specimen), along_top, ring)
        depth = line_from(field.top_mm, along_axis)
        return rectangle(r, field.top_mm - depth[::-1], "tensor")
    z = field.top_mm - line_by_size(field.top_mm, along_axis)[::-1]
    if space == "axisymmetric":
        return rectangle(line_by_size(equivalent_radius(specimen), along_top, ring), z, "tensor")
    if isinstance(specimen, Block):
        x = line_by_size(specimen.width_mm / 2, along_top, ring)
        y = line_by_size(specimen.depth_mm / 2, along_top, ring)
        return extrude(*rectangle(x, y, "tensor"), z)
    lines = line_by_size(specimen.radius_mm, along_top, ring)
    return extrude(*quarter_disc_of_quadrilaterals(lines), z)


def _outline(specimen: Cylinder | Block, field: SizeField) -> Array:
    """Quarter cross-section as a polygon from the x axis to the y axis, shape (n, 2).

    The polygon of a cylinder has the exact area of the quarter disc.
    """
    if isinstance(specimen, Block):
        w, d = specimen.width_mm / 2, specimen.depth_mm / 2
        return np.array([[w, 0.0], [w, d], [0.0, d]])
    radius = specimen.radius_mm
    size = float(field.at(radius, field.top_mm))
    segments = max(4, int(np.ceil(np.pi / 2 * radius / size)))
    angle = np.pi / 2 / segments
    theta = np.linspace(0, np.pi / 2, segments + 1)
    scaled = radius * np.sqrt(angle / np.sin(angle))
    corners = scaled * np.column_stack([np.cos(theta), np.sin(theta)])
    corners[0, 1] = corners[-1, 0] = 0.0
    return np.asarray(corners)


@contextmanager
def gmsh_session(field: Sizes, dim: int) -> Iterator[ModuleType]:
    """One model in one quiet, single-threaded session of gmsh.

    Parameters
    ----------
    field, dim : Sizes and {2, 3}
        Sizes in mm that gmsh asks for; 2 where x is the radius and y the height.

    Raises
    ------
    MeshError
        If gmsh does not take the sizes.
    """
    import gmsh

    # without readConfigFiles, which takes options of whoever's home or working folder it is
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.NumThreads", 1)
        gmsh.option.setNumber("Mesh.RandomSeed", 1)
        for off in ("FromPoints", "FromCurvature", "ExtendFromBoundary"):
            gmsh.option.setNumber(f"Mesh.MeshSize{off}", 0)
        gmsh.model.add("specimen")
        numbers = np.array(field.numbers())  # gmsh reads them until the session ends
        address, failed = numbers.ctypes.data_as(ctypes.c_void_p), ctypes.c_int()
        # not through gmsh's Python function: its calls back take longer than the mesh
        gmsh.lib.gmshModelMeshSetSizeCallback(
            field.callback(dim).ctypes, address, ctypes.byref(failed)
        )
        if failed.value:
            raise MeshError(f"gmsh: {gmsh.logger.getLastError()}")
        yield gmsh
    finally:
        gmsh.finalize()


def generated(gmsh: ModuleType, dim: int) -> tuple[Array, Ints]:
    """Mesh the model; points (n, 3) and simplices with consecutive numbers.

    Parameters
    ----------
    gmsh, dim : module and {2, 3}
        From :func:`gmsh_session`, the geometry in its model; 2 for triangles, 3 for tetrahedra.

    Raises
    ------
    MeshError
        If gmsh fails, or makes no elements or one that is too flat.
    """
    gmsh.option.setNumber("Mesh.Algorithm", _FRONTAL)
    gmsh.option.setNumber("Mesh.Algorithm3D", _DELAUNAY)
    gmsh.logger.start()
    try:
        gmsh.model.geo.synchronize()
        gmsh.model.mesh.generate(dim)
        if dim == 3:
            gmsh.model.mesh.optimize("Netgen")
    except Exception as error:  # gmsh raises nothing more specific
        raise MeshError(f"gmsh: {error}; {' '.join(gmsh.logger.get()[-3:])}") from error
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    cell_tags, corners = gmsh.model.mesh.getElementsByType(2 if dim == 2 else 4)
    if not len(cell_tags):
        raise MeshError(f"gmsh made no elements: {' '.join(gmsh.logger.get()[-3:])}")
    poorest = float(np.min(gmsh.model.mesh.getElementQualities(cell_tags, "minSICN")))
    if poorest < _POOREST:
        raise MeshError(
            f"an element is too flat (quality {poorest:.2g}): change mesh_size a little"
        )
    number = np.zeros(int(max(tags)) + 1, dtype=np.int64)
    cells = np.asarray(corners, dtype=np.int64).reshape(-1, dim + 1)
    used = np.unique(cells)  # nodes of embedded construction points may belong to no cell
    number[used] = np.arange(used.size)
    order = np.argsort(tags)
    place = np.searchsorted(np.asarray(tags)[order], used)
    points = np.asarray(coordinates).reshape(-1, 3)[order][place]
    return points, number[cells]


def _triangles(radius: float, height: float, field: SizeField, ring: float) -> tuple[Array, Ints]:
    """Triangles by gmsh; those next to a sharp edge are the same on every mesh of a series."""
    patch = _even_patch(radius, height, field, ring)
    corners = [(0.0, 0.0), (radius, 0.0), (radius, height)]
    if patch:
        corners += [(float(r), float(z)) for r, z in patch[0][patch[2]]]
    elif 0 < ring < radius:
        corners += [(ring, height)]
    corners += [(0.0, height)]

    with gmsh_session(field, 2) as gmsh:
        tags = [gmsh.model.geo.addPoint(r, z, 0.0) for r, z in corners]
        lines: dict[tuple[int, int], int] = {}
        _face(gmsh, tags, lines)
        if patch:  # its sides are not to be divided
            for a, b in pairwise(tags[3 : 3 + len(patch[2])]):
                gmsh.model.geo.mesh.setTransfiniteCurve(lines[(a, b)], 2)
        points, cells = generated(gmsh, 2)
    points = snapped(points[:, :2], [(0, 0.0), (0, radius), (1, 0.0), (1, height)])
    if patch:
        points, cells = _joined(points, cells, patch)
    return points, turned(points, cells)


def _even_patch(
    radius: float, height: float, field: SizeField, ring: float
) -> tuple[Array, Ints, Ints] | None:
    """Triangles of one size around a sharp edge, or none where there is no room for them."""
    room = min(ring, radius - ring, height)
    if not field.even or room < 2.5 * field.finest_mm:
        return None
    points, cells, rim = half_hexagon(field.finest_mm, field.halvings)
    points = points + np.array([ring, height])
    points[points[:, 1] > height - 1e-12 * height, 1] = height
    return points, cells, rim


def _joined(points: Array, cells: Ints, patch: tuple[Array, Ints, Ints]) -> tuple[Array, Ints]:
    """Mesh around a patch together with it; they share the points of its rim.

    Raises MeshError if gmsh put further points between those of the rim.
    """
    inner, inside, rim = patch
    gap = np.linalg.norm(points[None] - inner[rim][:, None], axis=2)
    size = np.linalg.norm(inner[rim[1]] - inner[rim[0]])
    if gap.min(axis=1).max() > 1e-6 * size:
        raise MeshError("the triangles around the edge do not meet the others: change mesh_size")
    number = np.empty(len(inner), dtype=np.int64)
    new = np.setdiff1d(np.arange(len(inner)), rim)
    number[rim] = gap.argmin(axis=1)
    number[new] = len(points) + np.arange(new.size)
    return np.vstack([points, inner[new]]), np.vstack([cells, number[inside]])


def _tetrahedra(outline: Array, height: float, field: SizeField, ring: float) -> tuple[Array, Ints]:
    with gmsh_session(field, 3) as gmsh:
        _quarter(gmsh, outline, height, ring, field)
        points, cells = generated(gmsh, 3)
    points = snapped(points, [(0, 0.0), (1, 0.0), (2, 0.0), (2, height)])
    return points, turned(points, cells)


def _quarter(
    gmsh: ModuleType, outline: Array, height: float, ring: float, field: SizeField
) -> None:
    """Quarter prism over an outline; the edge of a flat end is a curve on its top."""
    geo, lines = gmsh.model.geo, dict[tuple[int, int], int]()
    low = [geo.addPoint(0, 0, 0), *(geo.addPoint(x, y, 0) for x, y in outline)]
    high = [geo.addPoint(0, 0, height), *(geo.addPoint(x, y, height) for x, y in outline)]
    arc = _arc(gmsh, ring, height, field) if 0 < ring < outline[:, 0].max() else []
    faces = [_face(gmsh, low, lines)]
    n = len(low)
    for i in range(n):
        a, b = i, (i + 1) % n
        top = [high[b], high[a]]
        if arc and a == 0:  # along the x axis: the arc starts there
            top = [high[b], arc[0], high[a]]
        if arc and b == 0:
            top = [high[b], arc[-1], high[a]]
        faces.append(_face(gmsh, [low[a], low[b], *top], lines))
    if arc:
        faces.append(_face(gmsh, [high[0], *arc], lines))
        faces.append(_face(gmsh, [*arc, *reversed(high[1:])], lines))
    else:
        faces.append(_face(gmsh, high, lines))
    geo.addVolume([geo.addSurfaceLoop(faces)])


def _arc(gmsh: ModuleType, ring: float, height: float, field: SizeField) -> list[int]:
    """Points of the polygon that follows a circle about the axis, from x to y."""
    segments = max(4, int(np.ceil(np.pi / 2 * ring / float(field.at(ring, height)))))
    theta = np.linspace(0, np.pi / 2, segments + 1)
    places = ring * np.column_stack([np.cos(theta), np.sin(theta)])
    places[0, 1] = places[-1, 0] = 0.0
    return [int(gmsh.model.geo.addPoint(x, y, height)) for x, y in places]


def _face(gmsh: ModuleType, corners: list[int], lines: dict[tuple[int, int], int]) -> int:
    """Plane face through points; lines between two points are made once and shared."""
    loop = []
    for a, b in zip(corners, [*corners[1:], corners[0]], strict=True):
        if (a, b) not in lines:
            lines[(a, b)] = int(gmsh.model.geo.addLine(a, b))
            lines[(b, a)] = -lines[(a, b)]
        loop.append(lines[(a, b)])
    return int(gmsh.model.geo.addPlaneSurface([gmsh.model.geo.addCurveLoop(loop)]))


def snapped(points: Array, planes: list[tuple[int, float]]) -> Array:
    """Put points that belong to a plane exactly onto it.

    Parameters
    ----------
    points, planes : ndarray, shape (n, dim), and list of (int, float)
        Overwritten; axis from 0 and coordinate of each plane. Points within 1e-8 of the extent
        belong to one.
    """
    extent = np.ptp(points, axis=0).max()
    for axis, value in planes:
        near = np.abs(points[:, axis] - value) < 1e-8 * extent
        points[near, axis] = value
    return points


def turned(points: Array, cells: Ints) -> Ints:
    """Cells with positive volume.

    Parameters
    ----------
    points, cells : ndarray, shapes (n, dim) and (m, dim + 1)
        Simplices; ``cells`` is overwritten.
    """
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    inverted = np.linalg.det(edges) < 0
    cells[inverted, :2] = cells[inverted, 1::-1]
    return cells
