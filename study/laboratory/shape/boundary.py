"""Surface of a finite-element mesh: faces of one cell only, split into triangles.

A mesh of a quarter, of an upper half or of a meridian section becomes the whole body.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study.ground.arrays import Array, Ints
from study.ground.errors import Fault, InputError
from study.ground.files import Unpacker, open_regular
from study.ground.units import unit_factor
from study.laboratory.registration.iterative_closest_point import TriangleSurface
from study.mechanics.mesh.structured import KINDS as CELLS
from study.mechanics.mesh.structured import MIDDLES, QUADRATIC, edges_and_facets, outer
from study.mechanics.surface.closed_surface import Edges, Triangles, inspect, joined, read_mesh

if TYPE_CHECKING:
    from scipy.interpolate import LinearNDInterpolator


#: Segments of a body of revolution: its chords lie within 1.6e-4 radii of the circle.
SEGMENTS = 180
#: Places within this share of the extent lie in a plane of symmetry, or are one point.
SAME_PLACE = 1e-6

#: Corners, sides, and corners in whose middle every further node lies.
_SHAPES = {
    kind: (corners, edges_and_facets(linear)[1], MIDDLES.get(kind, []))
    for (_, corners), linear in CELLS.items()
    for kind in (linear, QUADRATIC[linear])
}
KINDS = tuple(_SHAPES)
PLANE_KINDS = ("triangle", "triangle6", "quad", "quad9")


@dataclass(frozen=True)
class DeformedMesh:
    """Cells with their nodes before the deformation and their displacements."""

    #: shape (n_nodes, 3); nodes at rest and displacements, mm; (r, z, 0) on a meridian section.
    points: Array
    displacement: Array
    #: Type of the cells as meshio names it.
    kind: str
    #: shape (n_cells, nodes of a cell); nodes of each cell.
    cells: Ints

    @property
    def is_section(self) -> bool:
        """Whether it is a meridian section of a body of revolution."""
        return self.kind in PLANE_KINDS


@dataclass(frozen=True)
class Symmetry:
    """What of a body a mesh is."""

    section: bool = False
    #: Whether planes x = 0 and y = 0 mirror it, and the lowest plane across the axis.
    mirrored: tuple[bool, bool, bool] = (False, False, False)
    #: Place of that plane, mm.
    lowest: float = 0.0
    #: What the base would rise by if that plane rested, mm.
    rise_mm: float = 0.0

    def __str__(self) -> str:
        parts = ["meridian section, revolved"] if self.section else []
        names = ("x = 0", "y = 0", f"the middle at z = {self.lowest:.4g} mm")
        planes = [name for name, on in zip(names, self.mirrored, strict=True) if on]
        parts += [f"mirrored at {' and '.join(planes)}"] if planes else []
        return "; ".join(parts) or "whole body"


@dataclass(frozen=True, eq=False)
class BodySurface(Triangles):
    """Surface of a whole body at rest, with the displacements of its points."""

    #: shape (n, 3); mm.
    displacement: Array


def symmetry_of(mesh: DeformedMesh) -> Symmetry:
    """Find out what part of a body a mesh is."""
    # A specimen stands on z = 0; a plane that no node crosses, in which sides lie and out of which
    # nothing moves, is one of symmetry.
    size = float(np.ptp(mesh.points, axis=0).max())
    # that of loading
    axis = 1 if mesh.is_section else 2
    lowest = float(mesh.points[:, axis].min())

    def is_plane(k: int, level: float) -> bool:
        on = np.abs(mesh.points[:, k] - level) < SAME_PLACE * size
        still = np.abs(mesh.displacement[on, k]).max(initial=0.0) < SAME_PLACE * size
        return bool(mesh.points[:, k].min() > level - SAME_PLACE * size and on.sum() > 2 and still)

    half = lowest > SAME_PLACE * size and is_plane(axis, lowest)
    quarter = (False, False) if mesh.is_section else (is_plane(0, 0.0), is_plane(1, 0.0))
    # of an upper half the middle rests; the whole stands on a plate that does
    top = np.abs(mesh.points[:, axis] - mesh.points[:, axis].max()) < SAME_PLACE * size
    rise = -float(mesh.displacement[top, axis].mean()) if half else 0.0
    return Symmetry(mesh.is_section, (*quarter, half), lowest, rise)


def surface_of(mesh: DeformedMesh) -> BodySurface:
    """Surface of the whole body that a mesh is a part of."""
    if mesh.kind not in _SHAPES:
        rule = f"has cells of type {mesh.kind!r}"
        raise InputError(Fault("simulation", rule, f"known are {', '.join(KINDS)}"))
    points, displacement, triangles = mesh.points, mesh.displacement, _outer_sides(mesh)
    if mesh.is_section:
        points, displacement, triangles = _revolved(mesh, triangles)
    symmetry = symmetry_of(mesh)
    for axis, mirrored in enumerate(symmetry.mirrored):
        if mirrored:
            other, moved = points.copy(), displacement.copy()
            other[:, axis] = 2 * (symmetry.lowest if axis == 2 else 0.0) - other[:, axis]
            moved[:, axis] = -moved[:, axis]
            triangles = np.concatenate([triangles, triangles[:, ::-1] + len(points)])
            points = np.concatenate([points, other])
            displacement = np.concatenate([displacement, moved])
    displacement = displacement - [0.0, 0.0, symmetry.rise_mm]
    return _joined(points, displacement, triangles)


def _outer_sides(mesh: DeformedMesh) -> Ints:
    """Sides of one cell only, split, turned outward."""
    corners, sides, _ = _SHAPES[mesh.kind]
    nodes = np.concatenate([mesh.cells[:, list(side)] for side in sides])
    owner = np.tile(np.arange(len(mesh.cells)), len(sides))
    number = np.repeat(np.arange(len(sides)), len(mesh.cells))
    alone, parts = outer(nodes), []
    for k in range(len(sides)):
        cells = mesh.cells[owner[alone[number[alone] == k]]]
        pieces = np.array(_pieces(mesh.kind, k))
        split = np.asarray(cells[:, pieces].reshape(-1, pieces.shape[1]))
        centers = mesh.points[cells[:, :corners]].mean(axis=1)
        parts.append(_turned(mesh.points, split, np.repeat(centers, len(pieces), axis=0)))
    return np.concatenate(parts)


def _pieces(kind: str, side: int) -> list[tuple[int, ...]]:
    """Nodes of a cell that make up the lines or triangles of one of its sides."""
    count, sides, middles = _SHAPES[kind]
    corners = sides[side]
    n = len(corners)
    local = {frozenset(middle): count + k for k, middle in enumerate(middles)}
    if not middles:
        fan = [(corners[0], corners[k], corners[k + 1]) for k in range(1, n - 1)]
        return [corners] if n == 2 else [*fan]
    between = [local[frozenset((corners[k], corners[(k + 1) % n]))] for k in range(n)]
    if n == 2:
        return [(corners[0], between[0]), (between[0], corners[1])]
    ends = [(corners[k], between[k], between[k - 1]) for k in range(n)]
    if n == 3:
        return [*ends, (between[0], between[1], between[2])]
    center = local[frozenset(corners)]
    return [*ends, *((center, between[k - 1], between[k]) for k in range(n))]


def _turned(points: Array, pieces: Ints, inside: Array) -> Ints:
    """Turn triangles away from the middle of their cell; lines keep it on their left."""
    a = points[pieces[:, 0]]
    along = points[pieces[:, 1]] - a
    if pieces.shape[1] == 2:
        normal = np.column_stack([along[:, 1], -along[:, 0], np.zeros(len(pieces))])
    else:
        normal = np.cross(along, points[pieces[:, 2]] - a)
    inward = ((points[pieces].mean(axis=1) - inside) * normal).sum(axis=1) < 0
    turned = pieces.copy()
    turned[inward] = turned[inward, ::-1]
    return turned


def _revolved(mesh: DeformedMesh, lines: Ints) -> tuple[Array, Array, Ints]:
    """Revolve lines of a section (r, z) about the axis r = 0."""
    angle = 2 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]

    def around(section: Array) -> Array:
        r, z = section[:, 0], np.broadcast_to(section[:, 1], (SEGMENTS, len(section)))
        return np.stack([c * r, s * r, z], axis=-1).reshape(-1, 3)

    n = len(mesh.points)
    here = np.arange(SEGMENTS)[:, None] * n
    there = np.roll(np.arange(SEGMENTS), -1)[:, None] * n
    a, b = lines.T
    # outside is on the right of a line in (r, z); seen from there a quadrilateral runs so
    quads = np.stack([here + a, there + a, there + b, here + b], axis=-1).reshape(-1, 4)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return around(mesh.points), around(mesh.displacement), triangles


def _joined(points: Array, displacement: Array, triangles: Ints) -> BodySurface:
    """Make one point of those at one place, and check that the surface closes.

    Triangles without area are dropped (on an axis), and those that lie on both sides of a plane.
    """
    size = float(np.ptp(points, axis=0).max())
    group, first = joined(points, SAME_PLACE * size)
    cells = group[triangles]
    cells = cells[(cells != np.roll(cells, 1, axis=1)).all(axis=1)]
    rows = np.sort(cells, axis=1)
    _, unique_index, count = np.unique(rows, axis=0, return_inverse=True, return_counts=True)
    used, cells = np.unique(cells[count[unique_index.ravel()] == 1], return_inverse=True)
    cells = cells.reshape(-1, 3)
    count = Edges.of(cells).count
    if (count != 2).any():
        rule = f"its surface does not close: {int((count != 2).sum())} open edges"
        mend = "the mesh must be a whole body, a quarter at x = 0 and y = 0, or a section"
        raise InputError(Fault("simulation", rule, mend))
    return BodySurface(points[first][used], cells, displacement[first][used])


# A simulated body: its surface before and after the deformation, and what moves inside.

#: Name of the displacements in a VTU file.
DISPLACEMENT = "displacement_mm"


@dataclass(frozen=True)
class SimulatedBody:
    """Simulated body in its own frame."""

    #: Surface at rest with its displacements; none where only the deformed surface is known.
    body: BodySurface
    #: Mesh that it comes from; None for a surface file.
    mesh: DeformedMesh | None = None
    #: What part of the body the mesh is.
    symmetry: Symmetry = Symmetry()
    notes: tuple[str, ...] = ()

    def at(self, share: float) -> TriangleSurface:
        """Surface at a share of the displacement: 0 at rest, 1 deformed."""
        points = self.body.points + share * self.body.displacement
        return TriangleSurface(points, self.body.triangles)

    @cached_property
    def deformed(self) -> TriangleSurface:
        """Deformed surface."""
        return self.at(1.0)

    @cached_property
    def _interpolator(self) -> LinearNDInterpolator:
        from scipy.interpolate import LinearNDInterpolator

        if self.mesh is None:
            raise InputError(Fault("--markers", "a surface file says nothing of points inside it",
                                   "give the problem or its VTU file"))  # fmt: skip
        size = 2 if self.mesh.is_section else 3
        used = np.unique(self.mesh.cells)
        return LinearNDInterpolator(
            self.mesh.points[used, :size], self.mesh.displacement[used, :size]
        )

    def displacement_at(self, points: Array) -> Array:
        """Displacement of material points, shape (n, 3), mm; nan outside the body."""
        # Between nodes it is linear on tetrahedra of Delaunay, whose error is of the second order
        # in the element size, as that of linear elements.
        interpolate, symmetry = self._interpolator, self.symmetry
        signs = np.ones_like(points)
        places = points.copy()
        for k, mirrored in enumerate(symmetry.mirrored):
            plane = symmetry.lowest if k == 2 else 0.0
            flipped = mirrored & (points[:, k] < plane)
            places[flipped, k] = 2 * plane - places[flipped, k]
            signs[flipped, k] = -1.0
        if not symmetry.section:
            return np.asarray(interpolate(places) * signs) - [0.0, 0.0, symmetry.rise_mm]
        radius = np.hypot(points[:, 0], points[:, 1])
        moved = interpolate(np.column_stack([radius, places[:, 2]]))
        outward = points[:, :2] / np.maximum(radius, 1e-300)[:, None]
        axial = moved[:, 1] * signs[:, 2] - symmetry.rise_mm
        return np.column_stack([moved[:, [0]] * outward, axial])


def body_of_mesh(mesh: DeformedMesh) -> SimulatedBody:
    """Body that a mesh is a part of."""
    return SimulatedBody(surface_of(mesh), mesh, symmetry_of(mesh))


def read_body(path: Path, unit: str) -> SimulatedBody:
    """Read a simulated body from a file. Units: unit mm."""
    if path.suffix.lower() == ".vtu":
        return body_of_mesh(_read_vtu(path))

    where = f"simulation: {path.name}"
    points, triangles = read_mesh(path, where)
    if not len(triangles):
        raise InputError(Fault(where, "holds no triangles", "the cloud is given by --scan"))
    try:
        surface = inspect(points, triangles, path.name, unit)
    except InputError as error:
        raise InputError(
            [Fault(f.where.replace("specimen.file", "simulation"), f.rule, f.mend)
             for f in error.faults]
        ) from None  # fmt: skip
    scaled = unit_factor(unit, "length") * surface.points
    notes = tuple(note.replace("specimen.file", "simulation") for note in surface.notes)
    body = BodySurface(scaled, surface.triangles, np.zeros_like(scaled))
    return SimulatedBody(body, notes=notes)


def _read_vtu(path: Path) -> DeformedMesh:
    """Read cells, points and displacements of a VTU file."""
    from meshio.vtu import _vtu as vtu

    where = f"simulation: {path.name}"
    try:
        stream = open_regular(path)
        if stream is not None:
            stream.close()
        unbounded = vtu.zlib, vtu.lzma
        vtu.zlib = vtu.lzma = Unpacker(path.name)
        try:
            mesh = vtu.read(str(path))
        finally:
            vtu.zlib, vtu.lzma = unbounded
    except Exception as error:  # meshio's parsers raise whatever they stumble over
        reason = str(error).split("\n")[0][:120] or type(error).__name__
        raise InputError(Fault(where, f"cannot be read: {reason}", "write it again")) from error
    data: Mapping[str, Array] = mesh.point_data
    if DISPLACEMENT not in data:
        mend = f"study solve FILE --vtu OUT.vtu writes it; it holds {', '.join(data) or 'none'}"
        raise InputError(Fault(where, f"has no point data {DISPLACEMENT!r}", mend))
    blocks = [(block.type, block.data) for block in mesh.cells if block.type in KINDS]
    kinds = {kind for kind, _ in blocks}
    if len(kinds) != 1:
        rule = f"has cells of types {', '.join(sorted(block.type for block in mesh.cells))}"
        raise InputError(Fault(where, rule, f"one of {', '.join(KINDS)} is read"))
    cells = np.concatenate([np.asarray(cells, dtype=np.int64) for _, cells in blocks])
    points = np.array(mesh.points, dtype=float)
    return DeformedMesh(points, np.array(data[DISPLACEMENT], dtype=float), kinds.pop(), cells)
