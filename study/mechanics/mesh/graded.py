"""Meshes under an indenter: graded from the contact outwards, by gmsh or as a tensor grid.

The one file that imports gmsh: its state is global, so that each mesh is made in one
session of one thread and closed before anything else happens.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import pairwise
from types import ModuleType

import numpy as np

from study.ground.arrays import Array, Ints
from study.ground.errors import MeshError
from study.mechanics.mesh.size_field import CFunction, SizeField, size_callback, size_field
from study.mechanics.mesh.structured import (
    Mesh,
    counted,
    equivalent_radius,
    extrude,
    half_hexagon,
    line_about,
    line_by_size,
    line_from,
    quarter_circle,
    quarter_disc_of_quadrilaterals,
    rectangle,
    ringed,
    spread,
    strips,
)
from study.mechanics.setup.geometry import Block, Cylinder, Specimen
from study.mechanics.setup.setup import Setup
from study.mechanics.setup.test_kind import AroundContact

# Hexahedra under a flat punch: a square block with bulging sides, a ring of blocks out to the
# circle of the face, and another out to the sides of the specimen. Nodes lie on the circle
# whatever the size.

Size = Callable[[Array], Array]
#: half-width of the middle block over the radius of the face, and its corner over its half-width:
#: its corners then open to some 120 deg, as where three cells meet
CORE = 0.7
BULGE = 1.15
#: growth of sizes inward from the edge over that outward: material that is held moves with the
#: face, and what the force owes to its sizes is small (0.02 % at a growth of 0.5)
INWARD = 2.0
#: part of their way that lines of the grid go from the edge towards where sizes ask for them:
#: they crowd at the edge and need not elsewhere. A fifth less error at the same cost
_BENT = 0.4
#: radii at which these heights are computed
_COLUMNS = 65


def punched(specimen: Cylinder | Block, field: SizeField) -> tuple[Array, Ints]:
    """Hexahedra of a quarter specimen, one ring of nodes on the circle of radius ``ring_mm``."""
    # Shapes: field mm; returns (n, 3), mm; returns (m, 8).
    depth = line_from(field.top_mm, partial(_below, field, field.ring_mm))
    core, rings = _rings(specimen, field, depth)
    beyond = _beyond(specimen, field, rings[0, -1])
    inside, outside = (
        np.broadcast_to(part.reshape(-1, 2), (depth.size, part.size // 2, 2))
        for part in (core, beyond)
    )
    plane = np.concatenate([inside, rings[:, 1:].reshape(depth.size, -1, 2), outside], axis=1)
    quads = _quadrilaterals(len(core), rings.shape[1] - 1, beyond)
    points, cells = extrude(plane[0], quads, -depth[::-1])
    points[:, :2] = plane[::-1].reshape(-1, 2)
    points[:, 2] = field.top_mm - _depths(plane[0], depth, field)[:, ::-1].T.ravel()
    return points, cells


def has_room(specimen: Specimen, ring: float) -> bool:
    """Whether a circle lies inside a cross-section, so that cells fit in around it."""
    # Units: ring mm.
    if isinstance(specimen, Cylinder):
        return 0 < ring < specimen.radius_mm * (1 - 1e-6)
    if isinstance(specimen, Block):
        return 0 < ring < min(specimen.width_mm, specimen.depth_mm) / 2 * (1 - 1e-6)
    return False


def around(field: SizeField) -> int:
    """Cells on half the quarter circle, as large as those in the middle of the face."""
    # The solution hardly changes along the circle.
    return max(2, int(np.ceil(np.pi / 4 * field.ring_mm / field.zone_mm - 1e-9)))


def inward(field: SizeField) -> SizeField:
    """Sizes from the edge to the middle block."""
    return replace(field, growth=INWARD * field.growth)


def _rings(specimen: Cylinder | Block, field: SizeField, depth: Array) -> tuple[Array, Array]:
    """Middle block, shape (n, n, 2), and the rings around it at each depth, inside out."""
    ring, n = field.ring_mm, around(field)
    ray = quarter_circle(1.0, np.linspace(0, np.pi / 2, 2 * n + 1))
    # 0 on the axes, 1 at the corner of a square
    corner = (1 / ray.max(axis=1) - 1) / (np.sqrt(2) - 1)
    core = np.asarray(CORE * ring * (1 + (BULGE - 1) * corner)[:, None] * ray)
    sides = _sides(specimen, ray)
    inner = _rays(ring - np.hypot(*core.T), lambda s: inward(field).at(ring - s, field.top_mm))
    lengths = np.hypot(*sides.T) - ring
    straight = _rays(lengths, partial(_beside, field, 0.0))
    steps = straight.shape[1] - 1
    at_depths = [partial(_beside, field, down) for down in depth]
    sizes = np.array([[_even(length, steps, size) for length in lengths] for size in at_depths])
    outer = np.asarray((1 - _BENT) * straight + _BENT * sizes)
    inside = np.broadcast_to(ring - inner[:, ::-1], (depth.size, *inner.shape))
    radii = np.concatenate([inside, ring + outer[:, :, 1:]], axis=2).swapaxes(1, 2)
    rings = radii[..., None] * ray
    rings[:, 0], rings[:, -1] = core, sides
    return _filled(core), rings


def _rays(lengths: Array, size: Size) -> Array:
    """Points along rays, of one number on all and spaced as asked where they start."""
    counts = [counted(length, size) for length in lengths]
    n = max(2, round(float(np.mean([count[-1] for _, count in counts]))))
    return np.array([spread(s, count, n) for s, count in counts])


def _sides(specimen: Cylinder | Block, ray: Array) -> Array:
    """Outer ends of the rays: on the side of a cylinder, or on a square that fits in a block."""
    # The polygon of a cylinder has the exact area of the quarter disc.
    if isinstance(specimen, Cylinder):
        step = np.arctan2(ray[1, 1], ray[1, 0])
        return np.asarray(specimen.radius_mm * np.sqrt(step / np.sin(step)) * ray)
    half = min(specimen.width_mm, specimen.depth_mm) / 2
    return np.asarray(half * ray / ray.max(axis=1, keepdims=True))


def _beyond(specimen: Cylinder | Block, field: SizeField, sides: Array) -> Array:
    """Points of what a block has beyond that square, shape (n_lines, n + 1, 2)."""
    n = len(sides) // 2
    if isinstance(specimen, Cylinder) or specimen.width_mm == specimen.depth_mm:
        return np.zeros((0, n + 1, 2))
    axis = 0 if specimen.width_mm > specimen.depth_mm else 1
    start, end = sides[n, axis], max(specimen.width_mm, specimen.depth_mm) / 2
    s, count = counted(end - start, partial(_beside, field, 0.0, start=start))
    line = start + spread(s, count, max(1, round(float(count[-1]))))[1:]
    side = sides[: n + 1] if axis == 0 else sides[n:]
    points = np.tile(side, (line.size, 1, 1))
    points[:, :, axis] = line[:, None]
    return points


def _filled(border: Array) -> Array:
    """Points of the middle block, from its two outer sides, shape (n, n, 2) by y and x.

    Notes
    -----
    Transfinite interpolation: Gordon and Hall 1973, Int. J. Numer. Meth. Eng. 7, 461.
    """
    n = len(border) // 2
    right, upper = border[: n + 1], border[n:][::-1]
    u = np.linspace(0, 1, n + 1)[None, :, None]
    v = u.swapaxes(0, 1)
    foot, left, corner = u * border[0], v * border[-1], border[n]
    sides = (1 - v) * foot + v * upper[None] + (1 - u) * left + u * right[:, None]
    return np.asarray(sides - u * (1 - v) * border[0] - (1 - u) * v * border[-1] - u * v * corner)


def _quadrilaterals(side: int, rings: int, beyond: Array) -> Ints:
    """Corners: of the middle block with ``side`` points, of the rings, and of what is beyond."""
    cells = [*ringed(side, rings)]
    if len(beyond):
        count = side**2 + rings * (2 * side - 1)
        last = np.arange(count - 2 * side + 1, count)
        last = last[:side] if beyond[0, 0, 1] == 0 else last[side - 1 :]  # along x, else y
        lines = count + np.arange(len(beyond) * side).reshape(-1, side)
        cells.append(strips(np.vstack([last, lines])))
    return np.vstack(cells)


def _depths(plane: Array, depth: Array, field: SizeField) -> Array:
    """Depths of the layers under each point of the plane mesh, shape (n_points, n_layers + 1)."""
    rho, steps = np.hypot(*plane.T), depth.size - 1
    radii = np.linspace(0, rho.max(), _COLUMNS)
    depths = np.array([_even(field.top_mm, steps, partial(_below, field, at)) for at in radii])
    column = rho / rho.max() * (_COLUMNS - 1)
    low = np.minimum(column.astype(int), _COLUMNS - 2)
    part = (column - low)[:, None]
    between = (1 - part) * depths[low] + part * depths[low + 1]
    return np.asarray((1 - _BENT) * depth + _BENT * between)


def _even(length: float, steps: int, size: Size) -> Array:
    """Points from 0 to ``length``, their spacing in proportion to sizes."""
    s, count = counted(length, size, 1001)
    return np.interp(np.linspace(0, count[-1], steps + 1), count, s)


def _below(field: SizeField, radius: float, depth: Array) -> Array:
    """Sizes at depths below a place on the loaded face."""
    return field.at(radius, field.top_mm - depth)


def _beside(field: SizeField, depth: float, away: Array, start: float | None = None) -> Array:
    """Sizes away from the edge, or from another radius, at a depth."""
    return field.at((field.ring_mm if start is None else start) + away, field.top_mm - depth)


#: gmsh's numbers: frontal triangles, Delaunay tetrahedra
_FRONTAL = 6
_DELAUNAY = 1
#: sizes of grids along the top and along the axis under a cone, over those of the field: what
#: begins tall ends less flat where a needle stretches the surface to three times its length
UNDER_CONE = {"linear": (1.0, 2.0), "quadratic": (0.8, 2.0)}
#: smallest quality (gmsh's inverse condition number) of a tetrahedron or triangle
_POOREST = 0.02


def indentation_mesh(setup: Setup) -> Mesh:
    """Mesh of an indented cylinder or block."""
    (specimen, contact), model = _indented(setup), setup.model
    height, field = specimen.height_mm, sizes_of(setup)
    ring, solid = contact.indenter.face_radius_mm, model.space == "3d"
    if model.element_shape == "tensor" and solid and has_room(specimen, ring):
        points, cells = punched(specimen, field)
    elif model.element_shape == "tensor":
        points, cells = _grid(setup, field)
    elif model.space == "axisymmetric":
        points, cells = _triangles(equivalent_radius(specimen), height, field, ring)
    else:
        points, cells = _tetrahedra(_outline(specimen, field), height, field, ring)
    return Mesh(points, cells, False, field.size_mm, field.finest_mm)


def _indented(setup: Setup) -> tuple[Cylinder | Block, AroundContact]:
    """Specimen, and the indenter and depth that sizes are made for."""
    specimen, contact = setup.specimen, setup.grading
    if not (isinstance(specimen, Cylinder | Block) and isinstance(contact, AroundContact)):
        raise MeshError("a mesh graded around a contact needs an indenter on a cylinder or a block")
    return specimen, contact


def sizes_of(setup: Setup) -> SizeField:
    """Sizes of the elements of an indented cylinder or block."""
    specimen, contact = _indented(setup)
    extent = min(specimen.half_width_mm, specimen.height_mm)
    return size_field(setup.model, contact, specimen.height_mm, extent)


def _grid(setup: Setup, field: SizeField) -> tuple[Array, Ints]:
    """Quadrilaterals or hexahedra on lines that follow the sizes along the top and the axis."""
    (specimen, contact), space = _indented(setup), setup.model.space
    ring, (along_top, along_axis) = contact.indenter.face_radius_mm, grid_sizes(setup, field)
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


def grid_sizes(setup: Setup, field: SizeField) -> tuple[Size, Size]:
    """Sizes of a grid along the top, and along the axis by the depth."""
    pointed = _indented(setup)[1].indenter.is_pointed
    wide, tall = UNDER_CONE[setup.model.element_order] if pointed else (1.0, 1.0)

    def along_top(rho: Array) -> Array:
        return wide * field.at(rho, field.top_mm)

    def along_axis(depth: Array) -> Array:
        return tall * _below(field, field.ring_mm, depth)

    return along_top, along_axis


def _outline(specimen: Cylinder | Block, field: SizeField) -> Array:
    """Quarter cross-section as a polygon from the x axis to the y axis, shape (n, 2)."""
    # The polygon of a cylinder has the exact area of the quarter disc.
    if isinstance(specimen, Block):
        w, d = specimen.width_mm / 2, specimen.depth_mm / 2
        return np.array([[w, 0.0], [w, d], [0.0, d]])
    radius = specimen.radius_mm
    size = float(field.at(radius, field.top_mm))
    segments = max(4, int(np.ceil(np.pi / 2 * radius / size)))
    angle = np.pi / 2 / segments
    scaled = radius * np.sqrt(angle / np.sin(angle))
    return quarter_circle(scaled, np.linspace(0, np.pi / 2, segments + 1))


@contextmanager
def gmsh_session(size: CFunction, numbers: Array) -> Iterator[ModuleType]:
    """One model in one quiet, single-threaded session of gmsh; sizes by a function of numbers."""
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
        # gmsh reads the numbers until the session ends
        address, failed = numbers.ctypes.data_as(ctypes.c_void_p), ctypes.c_int()
        # not through gmsh's Python function: its calls back take longer than the mesh
        gmsh.lib.gmshModelMeshSetSizeCallback(size.ctypes, address, ctypes.byref(failed))
        if failed.value:
            raise MeshError(f"gmsh: {gmsh.logger.getLastError()}")
        yield gmsh
    finally:
        gmsh.finalize()


def generated(gmsh: ModuleType, dim: int) -> tuple[Array, Ints]:
    """Mesh the model; points (n, 3) and simplices with consecutive numbers."""
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
    # nodes of embedded construction points may belong to no cell
    used, cells = np.unique(np.asarray(corners, dtype=np.int64), return_inverse=True)
    order = np.argsort(tags)
    index = np.searchsorted(np.asarray(tags)[order], used)
    points = np.asarray(coordinates).reshape(-1, 3)[order][index]
    return points, cells.reshape(-1, dim + 1)


def _triangles(radius: float, height: float, field: SizeField, ring: float) -> tuple[Array, Ints]:
    """Triangles by gmsh; those next to a sharp edge are the same on every mesh of a series."""
    patch = _even_patch(radius, height, field, ring)
    corners = [(0.0, 0.0), (radius, 0.0), (radius, height)]
    if patch:
        corners += [(float(r), float(z)) for r, z in patch[0][patch[2]]]
    elif 0 < ring < radius:
        corners += [(ring, height)]
    corners += [(0.0, height)]

    with gmsh_session(size_callback(2), np.array(field.numbers())) as gmsh:
        tags = [gmsh.model.geo.addPoint(r, z, 0.0) for r, z in corners]
        lines: dict[tuple[int, int], int] = {}
        _face(gmsh, tags, lines)
        if patch:  # its sides are not to be divided
            for a, b in pairwise(tags[3 : 3 + len(patch[2])]):
                gmsh.model.geo.mesh.setTransfiniteCurve(lines[(a, b)], 2)
        points, cells = generated(gmsh, 2)
    points = snapped(points[:, :2], [(0, 0.0), (0, radius), (1, 0.0), (1, height)])
    if patch:
        inner, inside, rim = patch
        gap = np.linalg.norm(points[None] - inner[rim][:, None], axis=2)
        size = np.linalg.norm(inner[rim[1]] - inner[rim[0]])
        if gap.min(axis=1).max() > 1e-6 * size:
            raise MeshError(
                "the triangles around the edge do not meet the others: change mesh_size"
            )
        number = np.empty(len(inner), dtype=np.int64)
        new = np.setdiff1d(np.arange(len(inner)), rim)
        number[rim] = gap.argmin(axis=1)
        number[new] = len(points) + np.arange(new.size)
        points, cells = np.vstack([points, inner[new]]), np.vstack([cells, number[inside]])
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


def _tetrahedra(outline: Array, height: float, field: SizeField, ring: float) -> tuple[Array, Ints]:
    with gmsh_session(size_callback(3), np.array(field.numbers())) as gmsh:
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
    arc: list[int] = []
    if 0 < ring < outline[:, 0].max():  # of the polygon that follows the circle, from x to y
        segments = max(4, int(np.ceil(np.pi / 2 * ring / float(field.at(ring, height)))))
        circle = quarter_circle(ring, np.linspace(0, np.pi / 2, segments + 1))
        arc = [int(geo.addPoint(x, y, height)) for x, y in circle]
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
    """Put points that belong to a plane exactly onto it. Shapes: points, planes (n, dim)."""
    extent = np.ptp(points, axis=0).max()
    for axis, value in planes:
        near = np.abs(points[:, axis] - value) < 1e-8 * extent
        points[near, axis] = value
    return points


def turned(points: Array, cells: Ints) -> Ints:
    """Cells with positive volume. Shapes: points, cells (n, dim)."""
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    inverted = np.linalg.det(edges) < 0
    cells[inverted, :2] = cells[inverted, 1::-1]
    return cells
