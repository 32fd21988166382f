"""Structured meshes: graded lines, rings and layers, and the cells between them.

Bonded corners get smaller elements; cross-sections keep their exact area.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from study.ground.arrays import Array, Ints
from study.ground.errors import Fault, InputError
from study.mechanics.setup.geometry import Block, Cylinder, Enclosed, Specimen

#: largest side of the square in a disc of quadrilaterals, over the radius: from 1 / sqrt(2) on
#: the cells at the square's corner fold over
LARGEST_SQUARE = 0.7
#: size at a bonded corner over the size inside, and how fast sizes grow away from it
CORNER_FRACTION = 0.2
GROWTH = 0.35


#: corners whose middle each further node of a VTK cell is, in VTK's order
_TRIANGLE = [(0, 1), (1, 2), (2, 0)]
_QUAD = [(0, 1), (1, 2), (2, 3), (3, 0)]
_HEX_EDGES = [
    *_QUAD, (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7),
]  # fmt: skip
_HEX_FACES = [
    (3, 0, 4, 7), (1, 2, 6, 5), (0, 1, 5, 4), (2, 3, 7, 6), (0, 1, 2, 3), (4, 5, 6, 7),
]  # fmt: skip
MIDDLES: dict[str, list[tuple[int, ...]]] = {
    "triangle6": [*_TRIANGLE],
    "quad9": [*_QUAD, (0, 1, 2, 3)],
    "tetra10": [*_TRIANGLE, (0, 3), (1, 3), (2, 3)],
    "hexahedron27": [*_HEX_EDGES, *_HEX_FACES, tuple(range(8))],
}
#: cells by their dimension and number of corners, as meshio names them, and those with all middles
KINDS = {(2, 3): "triangle", (2, 4): "quad", (3, 4): "tetra", (3, 8): "hexahedron"}
QUADRATIC = dict(zip(KINDS.values(), MIDDLES, strict=True))
#: corners of a cell in the order that its mirror image needs
_MIRRORED = {
    "triangle": [1, 0, 2], "quad": [1, 0, 3, 2], "tetra": [0, 1, 3, 2],
    "hexahedron": [4, 5, 6, 7, 0, 1, 2, 3],
}  # fmt: skip


def mirror(
    points: Array, cells: Ints, kind: str, axis: int, level: float
) -> tuple[Array, Ints, Ints]:
    """Body and its image in a plane, whose points both share.

    The third are the points that have an image of their own: the images follow in that order.

    Units: level mm.
    """
    image, number = points.copy(), np.arange(len(points))
    image[:, axis] = 2 * level - image[:, axis]
    beyond = np.flatnonzero(np.abs(image - points)[:, axis] > 1e-9 * np.ptp(points, axis=0).max())
    number[beyond] = len(points) + np.arange(beyond.size)
    corners = _MIRRORED[kind.rstrip("0123456789")]
    middles = [frozenset(m) for m in MIDDLES.get(kind, [])]
    moved = [frozenset(corners[c] for c in middle) for middle in middles]
    order = [*corners, *(len(corners) + middles.index(m) for m in moved)]
    return np.vstack([points, image[beyond]]), np.vstack([cells, number[cells[:, order]]]), beyond


def edges_and_facets(kind: str) -> tuple[list[tuple[int, ...]], list[tuple[int, ...]]]:
    """Edges and outer facets of a cell by their corners in a row; in a plane they are the same."""
    middles = MIDDLES[QUADRATIC[kind]]
    edges: list[tuple[int, ...]] = [m for m in middles if len(m) == 2]
    faces: list[tuple[int, ...]] = [m for m in middles if len(m) == 4]
    if kind == "tetra":
        return edges, [*combinations(range(4), 3)]
    return edges, faces if kind == "hexahedron" else edges


def outer(facets: Ints) -> Ints:
    """Places, in a list of all cells' facets, of those that belong to one cell alone."""
    rows = np.sort(facets, axis=1)
    _, first, count = np.unique(rows, axis=0, return_index=True, return_counts=True)
    return np.asarray(first[count == 1])


def graded_line(length: float, h: float, *, towards_end: bool) -> Array:
    """Points from 0 to ``length``, ``h`` apart, closer towards the end where asked."""
    # Units: length, h mm.
    if not towards_end:
        return np.linspace(0, length, max(1, round(length / h)) + 1)
    distance = np.linspace(0, length, 4001)
    spacing = points_by_density(distance, lambda s: np.minimum(CORNER_FRACTION * h + GROWTH * s, h))
    return np.asarray((length - spacing)[::-1])


def points_by_density(s: Array, size: Callable[[Array], Array]) -> Array:
    """Points along ``s`` whose spacing follows ``size(s)``: equal steps of its integral."""
    # Shapes: s (n,), mm; size mm.
    density = 1 / size(s)
    count = np.concatenate([[0], np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(s))])
    n = max(2, int(np.ceil(count[-1] - 1e-9)))
    points = np.interp(np.linspace(0, count[-1], n + 1), count, s)
    points[0], points[-1] = s[0], s[-1]
    return np.asarray(points)


def line_by_size(length: float, size: Callable[[Array], Array], through: float = 0.0) -> Array:
    """Points from 0 to ``length`` spaced by ``size(s)``, one of them at ``through``."""
    # Units: through mm.
    if not 0.0 < through < length:
        return points_by_density(np.linspace(0, length, 4001), size)
    inner = points_by_density(np.linspace(0, through, 4001), size)
    outer = points_by_density(np.linspace(through, length, 4001), size)
    return np.concatenate([inner, outer[1:]])


def line_from(length: float, size: Callable[[Array], Array]) -> Array:
    """Points from 0 to ``length`` with a spacing of ``size(0)`` at 0, however many fit in."""
    # A whole number of steps is off by up to half a step; that is laid where the steps are many,
    # with the square of their number, so that a series of sizes is alike at the start.
    s, count = counted(length, size)
    return spread(s, count, max(2, round(float(count[-1]))))


def counted(
    length: float, size: Callable[[Array], Array], places: int = 8001
) -> tuple[Array, Array]:
    """Places from 0 to ``length``, and how many steps of ``size`` lead to each of them."""
    # Units: length mm; size mm.
    s = length * np.linspace(0.0, 1.0, places) ** 2  # sizes may jump next to the start
    density = 1 / size(s)
    return s, np.concatenate([[0], np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(s))])


def spread(s: Array, count: Array, n: int) -> Array:
    """Points of ``n`` steps, the first of which are as large as those that were counted.

    What there is to gain or to lose grows with the square of the steps, unless it is too much.

    Shapes: s, count (places,).
    """
    k, rest = np.arange(n + 1), count[-1] - n
    steps = k + rest * (k / n) ** 2 if -n / 4 <= rest <= n / 2 else k * count[-1] / n
    points = np.interp(steps, count, s)
    points[0], points[-1] = s[0], s[-1]
    return np.asarray(points)


def line_about(length: float, size: Callable[[Array], Array], center: float) -> Array:
    """Points from 0 to ``length``, one at ``center``, where their spacing is ``size(center)``."""
    # Units: center mm.
    inner = line_from(center, lambda s: size(center - s))
    outer = line_from(length - center, lambda s: size(center + s))
    return np.concatenate([center - inner[::-1], center + outer[1:]])


def half_hexagon(side: float, halvings: int) -> tuple[Array, Ints, Ints]:
    """Triangles of a half hexagon around the middle of its upper side, smaller towards it."""
    # Shapes: returns (n_points, 2); returns (12 + 12 halvings, 3); returns (7,).
    corner = np.array([[1, 0], [0.5, -np.sqrt(0.75)], [-0.5, -np.sqrt(0.75)], [-1, 0]])
    double = np.vstack([corner[:1], *((a + b, b * 2) for a, b in pairwise(corner))])
    double[0] *= 2
    core = np.vstack([np.zeros((1, 2)), corner])
    sizes = side * 0.5 ** np.arange(halvings, -1.0, -1.0)
    points = np.vstack([core * sizes[0], *(size * double for size in sizes)])
    cells = [(0, k, k + 1) for k in (1, 2, 3)]
    for k in (1, 2, 3):  # from the inner hexagon, one edge a side, to two edges a side
        out = 5 + 2 * (k - 1)
        cells += [(k, out, out + 1), (k, out + 1, k + 1), (k + 1, out + 1, out + 2)]
    for first in 5 + 7 * np.arange(halvings):
        for k in range(first, first + 6):
            cells += [(k, k + 7, k + 8), (k, k + 8, k + 1)]
    rim = np.arange(7) + 5 + 7 * halvings
    return points, np.array(cells, dtype=np.int64), rim


def layers(height: float, h: float, *, half: bool, top: bool, base: bool) -> Array:
    """Heights of the layers, closer at bonded plates; of the upper half only where asked."""
    # Units: height, h mm.
    upper = height / 2 + graded_line(height / 2, h, towards_end=top)
    if half:
        return upper
    lower = height / 2 - graded_line(height / 2, h, towards_end=base)[::-1]
    return np.concatenate([lower, upper[1:]])


def equivalent_radius(specimen: Specimen) -> float:
    """Radius of the circle with the specimen's cross-section area. Units: specimen mm."""
    if isinstance(specimen, Enclosed):
        raise InputError("a surface has no one radius: take a cylinder or a block")
    return float(np.sqrt(specimen.volume_mm3 / specimen.height_mm / np.pi))


def rectangle(r: Array, z: Array, shape: str) -> tuple[Array, Ints]:
    """Grid of (r, z), each cell cut from its outer upper corner (the bonded one) inwards."""
    # Shapes: r, z (nr,), mm.
    nr, nz = r.size, z.size
    points = np.column_stack([np.tile(r, nz), np.repeat(z, nr)])
    corner = (np.arange(nz - 1)[:, None] * nr + np.arange(nr - 1)).ravel()
    quads = np.column_stack([corner, corner + 1, corner + nr + 1, corner + nr])
    if shape == "tensor":
        return points, quads
    return points, np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def cross_section(
    specimen: Specimen, h: float, graded: bool, shape: str, *, whole: bool = False
) -> tuple[Array, Ints]:
    """Triangles or quadrilaterals of the quarter cross-section (or the whole), closer at its rim.

    Units: h, graded mm.
    """
    if isinstance(specimen, Block):
        x = graded_line(specimen.width_mm / 2, h, towards_end=graded)
        y = graded_line(specimen.depth_mm / 2, h, towards_end=graded)
        return rectangle(_both_sides(x), _both_sides(y), shape) if whole else rectangle(x, y, shape)
    if whole:
        raise InputError(Fault("specimen.shape", "only a block is meshed whole", "write block"))
    if not isinstance(specimen, Cylinder):
        raise InputError("compression takes a cylinder or a block")
    rings = graded_line(specimen.radius_mm, h, towards_end=graded)
    return quarter_disc_of_quadrilaterals(rings) if shape == "tensor" else quarter_disc(rings, h)


def _both_sides(line: Array) -> Array:
    """Points of a line from 0 and their mirror images."""
    return np.concatenate([-line[:0:-1], line])


def quarter_circle(radius: float, angles: Array) -> Array:
    """Points at angles from 0 to a right one, the first and last exactly on their axes, (n, 2)."""
    points = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    points[0, 1] = points[-1, 0] = 0.0
    return np.asarray(points)


def quarter_disc(rings: Array, h: float) -> tuple[Array, Ints]:
    """Triangles of a quarter disc: every ring carries segments about as long as ``h``.

    All radii are scaled so that the polygon has the exact area of the disc: straight
    sides would otherwise lose a factor sin(t)/t and look like an effect of the space.

    Shapes: rings (n,), mm; h mm.
    """
    radius = rings[-1]
    last = max(4, int(np.ceil(np.pi / 2 * radius / h)))
    segments = np.maximum(1, np.ceil(last * rings[1:] / radius)).astype(int)
    angle = np.pi / 2 / last
    scale = np.sqrt(angle / np.sin(angle))
    points = [np.zeros((1, 2))]
    cells: list[tuple[int, int, int]] = []
    inner = np.array([0])
    for r, n in zip(rings[1:], segments, strict=True):
        ring = quarter_circle(scale * r, np.linspace(0, np.pi / 2, n + 1))
        outer = np.arange(n + 1) + sum(len(p) for p in points)
        points.append(ring)
        cells += _stitch(inner, outer)
        inner = outer
    return np.vstack(points), np.array(cells)


def quarter_disc_of_quadrilaterals(line: Array, square: float = 0.5) -> tuple[Array, Ints]:
    """Quadrilaterals of a quarter disc: a square at the center, two blocks out to the rim.

    Shapes: line (n,).

    Notes
    -----
    The rim is a polygon of the exact area of the quarter disc. A line of one step, or one whose
    square would reach the rim, has its square made as large as was asked for.
    """
    radius = line[-1]
    if line.size < 3:
        line = radius * np.array([0.0, square, 1.0])
    m = int(np.clip(np.searchsorted(line, square * radius), 1, line.size - 2))
    inner, outer = line[: m + 1], line[m + 1 :]
    fraction = (outer - inner[-1]) / (radius - inner[-1])
    if inner[-1] > LARGEST_SQUARE * radius:
        inner = inner * (square * radius / inner[-1])
    side = inner[-1]
    angle = np.pi / 4 * inner / side
    angles = np.concatenate([angle, np.pi / 2 - angle[-2::-1]])
    rim = radius * np.sqrt(np.pi / 2 / np.sin(np.diff(angles)).sum())
    along_y, along_x = np.full(m + 1, side), np.full(m, side)
    border = np.column_stack([np.r_[along_y, inner[-2::-1]], np.r_[inner, along_x]])
    rings = border + fraction[:, None, None] * (quarter_circle(rim, angles) - border)
    points = np.vstack([rectangle(inner, inner, "tensor")[0], rings.reshape(-1, 2)])
    return points, np.vstack(ringed(m + 1, fraction.size))


def ringed(side: int, rings: int) -> tuple[Ints, Ints]:
    """Quadrilaterals of a square of ``side`` by ``side`` points, and of the rings about it.

    A ring has a point for each on the two outer sides of the square; they are numbered after it.
    """
    _, quads = rectangle(np.arange(float(side)), np.arange(float(side)), "tensor")
    index = np.arange(side**2).reshape(side, side)
    border = np.concatenate([index[:, -1], index[-1, -2::-1]])
    new = index.size + np.arange(rings * border.size).reshape(rings, -1)
    return quads, strips(np.vstack([border, new]))


def strips(number: Ints) -> Ints:
    """Quadrilaterals between numbered lines of points, each further out than the last."""
    near, far = number[:-1], number[1:]
    cells = [near[:, :-1], far[:, :-1], far[:, 1:], near[:, 1:]]
    return np.stack(cells, axis=-1).reshape(-1, 4)


def _stitch(inner: Ints, outer: Ints) -> list[tuple[int, int, int]]:
    """Triangles between two rings with any numbers of points, advancing by angle."""
    i = j = 0
    ni, nj = max(inner.size - 1, 1), outer.size - 1
    cells = []
    while i < inner.size - 1 or j < nj:
        advance_outer = i == inner.size - 1 or (j < nj and (j + 1) * ni <= (i + 1) * nj)
        if advance_outer:
            cells.append((int(inner[i]), int(outer[j]), int(outer[j + 1])))
            j += 1
        else:
            cells.append((int(inner[i]), int(outer[j]), int(inner[i + 1])))
            i += 1
    return cells


def extrude(plane: Array, faces: Ints, z: Array) -> tuple[Array, Ints]:
    """Prisms (cut into three tetrahedra each) or hexahedra over a plane mesh."""
    # Shapes: plane (n, 2), mm; faces (m, 3); z (k,), mm.
    n = len(plane)
    points = np.column_stack([np.tile(plane, (z.size, 1)), np.repeat(z, n)])
    shift = n * np.arange(z.size - 1)[:, None, None]
    if faces.shape[1] == 4:
        prisms = np.concatenate([faces + shift, faces + shift + n], axis=2)
        return points, prisms.reshape(-1, 8)
    a, b, c = np.sort(faces, axis=1).T
    # diagonals run from the lower-numbered foot to the higher-numbered head, so that
    # neighbouring prisms cut their common side alike
    parts = [[a, b, c, c + n], [a, b, b + n, c + n], [a, a + n, b + n, c + n]]
    tetrahedra = np.concatenate([np.column_stack(corners) for corners in parts])
    return points, (tetrahedra[None] + shift).reshape(-1, 4)


# The mesh as a value: nodes, cells and the element they carry.


@dataclass(frozen=True)
class Mesh:
    """Points and cells of the modelled part of a specimen."""

    #: shape (n_points, dim); coordinates in mm.
    points: Array
    #: shape (n_cells, vertices); triangles or quadrilaterals (axisymmetric), tetrahedra or
    #: hexahedra (3D).
    cells: Ints
    #: Whether only the half above the middle plane is meshed.
    half_height: bool
    #: Element size inside, or under the indenter.
    size_mm: float
    #: Size at the sharpest feature of an indenter, where that is finer.
    finest_mm: float | None = None
    #: Whether nothing is left out that symmetry would add, whatever its setup needs.
    is_whole: bool = False

    @property
    def kind(self) -> str:
        """Name of its cells."""
        return KINDS[(self.points.shape[1], self.cells.shape[1])]

    @property
    def contact_size_mm(self) -> float:
        """Size of the smallest elements in contact."""
        return self.finest_mm or self.size_mm

    @property
    def height_mm(self) -> float:
        """Height of the loaded surface; of the whole specimen where it stands on z = 0."""
        return float(self.points[:, -1].max())

    def digest(self) -> str:
        """Hash that tells whether two meshes are the same."""
        h = hashlib.sha256(np.round(self.points, 9).tobytes())
        h.update(self.cells.tobytes())
        return h.hexdigest()[:16]
