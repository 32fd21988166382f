"""Surface of a finite-element mesh: faces of one cell only, split into triangles.

A mesh of a quarter, of an upper half or of a meridian section becomes the whole body.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.arrays import Array, Flags, Ints
from study.errors import Fault, InputError

#: Segments of a body of revolution: its chords lie within 1.6e-4 radii of the circle.
SEGMENTS = 180

#: Places within this share of the extent lie in a plane of symmetry, or are one point.
SAME_PLACE = 1e-6

_TRIANGLE = ((0, 1), (1, 2), (2, 0))
_QUADRILATERAL = ((0, 1), (1, 2), (2, 3), (3, 0))
_TETRAHEDRON = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))
_HEXAHEDRON = (
    (0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7),
)  # fmt: skip

#: Corners, sides as their corners, and corners in whose middle every further node lies (VTK).
_SHAPES: dict[str, tuple[int, tuple[tuple[int, ...], ...], tuple[tuple[int, ...], ...]]] = {
    "triangle": (3, _TRIANGLE, ()),
    "triangle6": (3, _TRIANGLE, _TRIANGLE),
    "quad": (4, _QUADRILATERAL, ()),
    "quad9": (4, _QUADRILATERAL, (*_QUADRILATERAL, (0, 1, 2, 3))),
    "tetra": (4, _TETRAHEDRON, ()),
    "tetra10": (4, _TETRAHEDRON, ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))),
    "hexahedron": (8, _HEXAHEDRON, ()),
    "hexahedron27": (
        8,
        _HEXAHEDRON,
        (
            (0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6),
            (3, 7), (0, 3, 4, 7), (1, 2, 5, 6), (0, 1, 4, 5), (2, 3, 6, 7), (0, 1, 2, 3),
            (4, 5, 6, 7), (0, 1, 2, 3, 4, 5, 6, 7),
        ),
    ),
}  # fmt: skip
KINDS = tuple(_SHAPES)
PLANE_KINDS = ("triangle", "triangle6", "quad", "quad9")


@dataclass(frozen=True)
class DeformedMesh:
    """Cells with their nodes before the deformation and their displacements.

    Parameters
    ----------
    points, displacement : ndarray, shape (n_nodes, 3)
        Nodes at rest and displacements, mm; (r, z, 0) on a meridian section.
    kind : str
        Type of the cells as meshio names it.
    cells : ndarray of int, shape (n_cells, nodes of a cell)
        Nodes of each cell.
    """

    points: Array
    displacement: Array
    kind: str
    cells: Ints

    @property
    def is_section(self) -> bool:
        """Whether it is a meridian section of a body of revolution."""
        return self.kind in PLANE_KINDS

    @property
    def axis(self) -> int:
        """Axis of loading: the second coordinate of a section, else the third."""
        return 1 if self.is_section else 2


@dataclass(frozen=True)
class Symmetry:
    """What of a body a mesh is.

    Parameters
    ----------
    section : bool
        A meridian section.
    mirrored : tuple of bool
        Whether planes x = 0 and y = 0 mirror it, and the lowest plane across the axis.
    lowest : float
        Place of that plane, mm.
    """

    section: bool
    mirrored: tuple[bool, bool, bool]
    lowest: float

    def __str__(self) -> str:
        parts = ["meridian section, revolved"] if self.section else []
        names = ("x = 0", "y = 0", f"the middle at z = {self.lowest:.4g} mm")
        planes = [name for name, on in zip(names, self.mirrored, strict=True) if on]
        parts += [f"mirrored at {' and '.join(planes)}"] if planes else []
        return "; ".join(parts) or "whole body"


@dataclass(frozen=True)
class BodySurface:
    """Surface of a whole body at rest, with the displacements of its points.

    Parameters
    ----------
    points, displacement : ndarray, shape (n, 3)
        Vertices at rest and displacements, mm.
    triangles : ndarray of int, shape (m, 3)
        Counterclockwise seen from outside.
    """

    points: Array
    displacement: Array
    triangles: Ints


def symmetry_of(mesh: DeformedMesh) -> Symmetry:
    """Find out what part of a body a mesh is.

    A specimen stands on z = 0; a plane that no node crosses, in which sides lie and out of
    which nothing moves, is one of symmetry.

    Parameters
    ----------
    mesh : DeformedMesh

    Returns
    -------
    Symmetry
    """
    size = float(np.ptp(mesh.points, axis=0).max())
    axis = mesh.axis
    lowest = float(mesh.points[:, axis].min())

    def is_plane(k: int, place: float) -> bool:
        on = np.abs(mesh.points[:, k] - place) < SAME_PLACE * size
        still = np.abs(mesh.displacement[on, k]).max(initial=0.0) < SAME_PLACE * size
        return bool(mesh.points[:, k].min() > place - SAME_PLACE * size and on.sum() > 2 and still)

    half = lowest > SAME_PLACE * size and is_plane(axis, lowest)
    quarter = (False, False) if mesh.is_section else (is_plane(0, 0.0), is_plane(1, 0.0))
    return Symmetry(mesh.is_section, (*quarter, half), lowest)


def surface_of(mesh: DeformedMesh) -> BodySurface:
    """Surface of the whole body that a mesh is a part of.

    Parameters
    ----------
    mesh : DeformedMesh

    Returns
    -------
    BodySurface

    Raises
    ------
    InputError
        For cells of an unknown type, or a surface that does not close.
    """
    if mesh.kind not in _SHAPES:
        rule = f"has cells of type {mesh.kind!r}"
        raise InputError(Fault("simulation", rule, f"known are {', '.join(KINDS)}"))
    symmetry = symmetry_of(mesh)
    keep = _real_sides(mesh, symmetry)
    points, displacement = mesh.points, mesh.displacement
    if mesh.is_section:
        points, displacement, triangles = _revolved(mesh, keep)
    else:
        triangles = keep
        for k in (0, 1):
            if symmetry.mirrored[k]:
                points, displacement, triangles = _mirrored(points, displacement, triangles, k, 0.0)
    if symmetry.mirrored[2]:
        points, displacement, triangles = _mirrored(
            points, displacement, triangles, 2, symmetry.lowest
        )
    return _joined(points, displacement, triangles)


def _real_sides(mesh: DeformedMesh, symmetry: Symmetry) -> Ints:
    """Sides of one cell only, split, turned outward, without those in planes of symmetry."""
    corners, sides, _ = _SHAPES[mesh.kind]
    nodes = np.concatenate([mesh.cells[:, list(side)] for side in sides])
    owner = np.tile(np.arange(len(mesh.cells)), len(sides))
    number = np.repeat(np.arange(len(sides)), len(mesh.cells))
    _, first, count = np.unique(
        np.sort(nodes, axis=1), axis=0, return_index=True, return_counts=True
    )
    alone = first[count == 1]
    alone = alone[~_in_symmetry(mesh, symmetry, nodes[alone])]
    parts = []
    for k in range(len(sides)):
        own = alone[number[alone] == k]
        split = _split(mesh, owner[own], k)
        centers = mesh.points[mesh.cells[owner[own], :corners]].mean(axis=1)
        parts.append(_turned(mesh.points, split, np.repeat(centers, len(split) // max(len(own), 1),
                                                           axis=0)))  # fmt: skip
    return np.concatenate(parts)


def _in_symmetry(mesh: DeformedMesh, symmetry: Symmetry, nodes: Ints) -> Flags:
    """Which sides lie in a plane of symmetry, or on the axis of a section."""
    size = float(np.ptp(mesh.points, axis=0).max())
    planes = [(mesh.axis, symmetry.lowest)] if symmetry.mirrored[2] else []
    planes += [(0, 0.0)] if symmetry.mirrored[0] or symmetry.section else []
    planes += [(1, 0.0)] if symmetry.mirrored[1] else []
    inside = np.zeros(len(nodes), dtype=bool)
    for k, place in planes:
        inside |= (np.abs(mesh.points[nodes, k] - place) < SAME_PLACE * size).all(axis=1)
    return inside


def _split(mesh: DeformedMesh, owners: Ints, side: int) -> Ints:
    """Split one side of some cells into triangles (or lines), those of a cell in a row."""
    pieces = np.array(_pieces(mesh.kind, side))
    return np.asarray(mesh.cells[owners][:, pieces].reshape(-1, pieces.shape[1]))


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


def _mirrored(
    points: Array, displacement: Array, triangles: Ints, axis: int, place: float
) -> tuple[Array, Array, Ints]:
    """Body and its mirror image across a plane."""
    other, moved = points.copy(), displacement.copy()
    other[:, axis] = 2 * place - other[:, axis]
    moved[:, axis] = -moved[:, axis]
    both = np.concatenate([triangles, triangles[:, ::-1] + len(points)])
    return np.concatenate([points, other]), np.concatenate([displacement, moved]), both


def _joined(points: Array, displacement: Array, triangles: Ints) -> BodySurface:
    """Make one point of those at one place, drop triangles without area, and check it closes."""
    size = float(np.ptp(points, axis=0).max())
    used, place = np.unique(triangles, return_inverse=True)
    group, first = _groups(points[used], SAME_PLACE * size)
    joined = group[place.reshape(-1, 3)]
    whole = (joined != np.roll(joined, 1, axis=1)).all(axis=1)
    joined = joined[whole]
    edges = np.sort(joined[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    if (count != 2).any():
        rule = f"its surface does not close: {int((count != 2).sum())} open edges"
        mend = "the mesh must be a whole body, a quarter at x = 0 and y = 0, or a section"
        raise InputError(Fault("simulation", rule, mend))
    return BodySurface(points[used][first], displacement[used][first], joined)


def _groups(points: Array, tolerance: float) -> tuple[Ints, Ints]:
    """Group points at one place: the group of every point, and a point of every group."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    near = cKDTree(points).query_pairs(tolerance, output_type="ndarray")
    links = coo_matrix((np.ones(len(near)), near.T), shape=(len(points), len(points)))
    _, group = connected_components(links, directed=False)
    _, first = np.unique(group, return_index=True)
    return group.astype(np.int64), first
