"""A specimen given as a closed surface: read from a file, checked, and stood on its base.

The file holds triangles in a unit of its own. Inside, the specimen stands on z = 0, its
loading axis is x = y = 0 and lengths are mm.
"""

from __future__ import annotations

import functools
import os
import re
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from study.ground.arrays import Array, Flags, Ints
from study.ground.compilation import kernel, part
from study.ground.errors import Fault, InputError, UnitError
from study.ground.files import UnreadableError, open_regular
from study.ground.units import parse
from study.mechanics.setup.geometry import Brain, Enclosed, Specimen, Surface
from study.mechanics.surface.brain import brain_surface

# Checks that a surface encloses a specimen: closed, of one piece, facing outward. Messages give
# places in the coordinates of the file.

#: points closer than this fraction of the extent are one point
_MERGE = 1e-7
#: smallest altitude of a triangle over the extent
_FLAT = 1e-7


@dataclass(frozen=True)
class Edges:
    """Edges of triangles, each once."""

    #: shape (n_edges, 2); lower and higher point.
    ends: Ints
    #: shape (n_edges,); triangles at each edge.
    count: Ints
    #: shape (n_pairs, 2); triangles on both sides of edges that have two.
    pairs: Ints
    #: shape (n_pairs, 2); ends of these edges.
    shared: Ints
    #: shape (n_pairs,); whether the two run along their edge in opposite directions, as neighbors
    #: should.
    agree: Flags

    @classmethod
    def of(cls, triangles: Ints) -> Edges:
        """Edges of triangles (m, 3)."""
        directed = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        low, high = directed.min(axis=1), directed.max(axis=1)
        # one number for both ends: rows take ten times as long to sort
        size = int(high.max(initial=0)) + 1
        keys, inverse, count = np.unique(low * size + high, return_inverse=True, return_counts=True)
        ends = np.column_stack([keys // size, keys % size])
        order = np.argsort(inverse, kind="stable")
        begins = np.concatenate([[0], np.cumsum(count)[:-1]])
        first = begins[count == 2]
        sides = np.column_stack([order[first], order[first + 1]])
        forward = directed[sides, 0] < directed[sides, 1]
        agree = forward[:, 0] != forward[:, 1]
        return cls(ends, count, sides // 3, ends[count == 2], agree)


@dataclass(frozen=True, eq=False)
class Triangles:
    """Triangles between points, and what is measured of them."""

    #: shape (n, 3); vertices in mm.
    points: Array
    #: shape (m, 3); counterclockwise seen from outside.
    triangles: Ints

    @functools.cached_property
    def corners(self) -> Array:
        """Corners of every triangle, shape (m, 3, 3)."""
        return self.points[self.triangles]

    @functools.cached_property
    def crossed(self) -> Array:
        """Normal of every triangle, twice as long as its area, shape (m, 3)."""
        a, b, c = self.corners.swapaxes(0, 1)
        return np.asarray(np.cross(b - a, c - a))

    @functools.cached_property
    def areas(self) -> Array:
        """Area of every triangle, shape (m,), mm^2."""
        return np.asarray(np.linalg.norm(self.crossed, axis=1) / 2)

    @functools.cached_property
    def normals(self) -> Array:
        """Unit normal of every triangle, shape (m, 3)."""
        return self.crossed / np.maximum(2 * self.areas, 1e-300)[:, None]

    @functools.cached_property
    def area_mm2(self) -> float:
        """Area of all triangles."""
        return float(self.areas.sum())

    @functools.cached_property
    def volume_mm3(self) -> float:
        """Volume enclosed; negative where the triangles face inward."""
        # from the middle: about a far origin products cancel to their last digits
        a, b, c = (self.corners - self.corners.mean(axis=(0, 1))).swapaxes(0, 1)
        return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


@dataclass(frozen=True, eq=False)
class Inspected(Triangles):
    """A surface without faults: points merged, triangles turned outward, what was done."""

    notes: tuple[str, ...] = ()


def inspect(points: Array, triangles: Ints, name: str, unit: str) -> Inspected:
    """Check a surface and turn its triangles outward; one InputError tells all of its faults."""
    # Shapes: points, triangles (n, 3).
    where = f"specimen.file: {name}"
    bad = ~np.isfinite(points[triangles]).all(axis=(1, 2))
    if bad.any() or np.abs(points[triangles]).max() > 1e15:
        number = int(np.flatnonzero(bad)[0]) + 1 if bad.any() else 0
        rule = f"{int(bad.sum())} triangles have coordinates that are no numbers (first: {number})"
        rule = rule if bad.any() else "has coordinates beyond 1e15"
        raise InputError(Fault(where, rule, "save the surface again"))
    # one point of those at one place: an STL file repeats the corners of every triangle
    used, corner = np.unique(triangles, return_inverse=True)
    distinct, inverse = np.unique(points[used], axis=0, return_inverse=True)
    group, first_of = joined(distinct, _MERGE * float(np.ptp(distinct, axis=0).max()))
    points, triangles = distinct[first_of], group[inverse.ravel()[corner].reshape(-1, 3)]
    surface, extent = Triangles(points, triangles), float(np.ptp(points, axis=0).max())
    along = surface.corners - np.roll(surface.corners, 1, axis=1)
    sides = np.linalg.norm(along, axis=2).max(axis=1)
    flat = np.asarray(2 * surface.areas <= _FLAT * extent * np.maximum(sides, 1e-300))
    if flat.any():
        first = int(np.flatnonzero(flat)[0])
        rule = f"{int(flat.sum())} triangles have no area (first: triangle {first + 1}, near "
        rule += f"{_place(points[triangles[first]].mean(axis=0), unit)})"
        raise InputError(Fault(where, rule, "remove degenerate faces"))
    edges = Edges.of(triangles)
    faults = [*_not_closed(points, edges, unit), *_not_one(points, triangles, edges, unit)]
    faults += _crossing(points, triangles, unit)
    if faults:
        raise InputError([Fault(where, rule, mend) for rule, mend in faults])
    turned, note = _outward(points, triangles, edges)
    return Inspected(points, turned, note)


def _place(point: Array, unit: str) -> str:
    return "(" + ", ".join(f"{v + 0.0:.5g}" for v in point) + f") {unit}"


def joined(points: Array, tolerance: float) -> tuple[Ints, Ints]:
    """Join points at one place: the group of every point, and a point of every group."""
    from scipy.spatial import cKDTree

    near = cKDTree(points).query_pairs(tolerance, output_type="ndarray")
    _, group = _components(near, len(points))
    return group, np.unique(group, return_index=True)[1]


def _components(links: Ints, n: int) -> tuple[int, Ints]:
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    graph = coo_matrix((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(n, n))
    count, labels = connected_components(graph, directed=False)
    return int(count), labels.astype(np.int64)


def _not_closed(points: Array, edges: Edges, unit: str) -> Iterator[tuple[str, str]]:
    rim = edges.ends[edges.count == 1]
    if len(rim):
        _, labels = _components(rim, len(points))
        labels_of_rim = labels[rim[:, 0]]
        holes, sizes = np.unique(labels_of_rim, return_counts=True)
        largest = rim[labels_of_rim == holes[sizes.argmax()]]
        near = _place(points[np.unique(largest)].mean(axis=0), unit)
        number = f"{len(holes)} hole{'s' if len(holes) > 1 else ''}"
        rule = f"is not closed: {len(rim)} open edges around {number}, the largest near {near}"
        yield rule, "fill the holes in the program that wrote the file"
    crowded = np.flatnonzero(edges.count > 2)
    if crowded.size:
        middle = points[edges.ends[crowded[0]]].mean(axis=0)
        rule = f"{crowded.size} edges belong to more than two triangles (first near "
        rule += f"{_place(middle, unit)})"
        yield rule, "a surface that encloses a volume has two triangles at every edge"


def _not_one(points: Array, triangles: Ints, edges: Edges, unit: str) -> Iterator[tuple[str, str]]:
    count, labels = _components(edges.pairs, len(triangles))
    if not (edges.count > 2).any() and count > 1:
        sizes = np.bincount(labels)
        places = [_place(points[triangles[labels == k]].mean(axis=(0, 1)), unit) for k in (0, 1)]
        listed = ", ".join(map(str, sizes[:4].tolist())) + (", ..." if sizes.size > 4 else "")
        rule = f"holds {count} separate surfaces, with {listed} triangles "
        rule += f"(the first two about {places[0]} and {places[1]})"
        yield rule, "keep one body without cavities; join touching ones in the modelling program"
    elif not (edges.count != 2).any():
        pinched = _pinched(triangles, edges)
        if pinched.size:
            rule = f"touches itself at {pinched.size} points (first at "
            rule += f"{_place(points[pinched[0]], unit)})"
            yield rule, "separate the parts, or join them by more than a point"
    first, second = np.split(_cover(triangles, edges), 2)
    if (first == second).any():
        yield "has one side only, as a Moebius strip: inside and outside are not defined", ""


def _pinched(triangles: Ints, edges: Edges) -> Ints:
    """Points whose triangles form more than one fan."""
    links = []
    for end in range(2):
        point = edges.shared[:, end]
        at = [(triangles[side] == point[:, None]).argmax(axis=1) for side in edges.pairs.T]
        links.append(3 * edges.pairs + np.column_stack(at))
    _, labels = _components(np.vstack(links), triangles.size)
    fans = np.unique(triangles.ravel() * triangles.size + labels)
    corner_of, count = np.unique(fans // triangles.size, return_counts=True)
    return np.asarray(corner_of[count > 1])


def _cover(triangles: Ints, edges: Edges) -> Ints:
    """Components of the double cover: triangle i as it is, and i + m turned over."""
    m, (a, b) = len(triangles), edges.pairs.T
    other = np.where(edges.agree, b, b + m)
    mirror = np.where(edges.agree, b + m, b)
    links = np.vstack([np.column_stack([a, other]), np.column_stack([a + m, mirror])])
    return _components(links, 2 * m)[1]


def _outward(points: Array, triangles: Ints, edges: Edges) -> tuple[Ints, tuple[str, ...]]:
    """Turn triangles until all face outward: there is one way for a closed body of one piece."""
    m = len(triangles)
    labels = _cover(triangles, edges)
    against = labels[:m] != labels[0]
    turned = triangles.copy()
    turned[against] = turned[against, ::-1]
    if Triangles(points, turned).volume_mm3 < 0:
        turned, against = turned[:, ::-1].copy(), ~against
    number = int(against.sum())
    if not number:
        return turned, ()
    if number == m:
        return turned, ("specimen.file: the surface was inside out; all triangles were turned",)
    return turned, (f"specimen.file: {number} of {m} triangles faced inward and were turned",)


def _crossing(points: Array, triangles: Ints, unit: str) -> Iterator[tuple[str, str]]:
    crossing = first_intersection(points, triangles)
    if crossing is None:
        return
    a, b, point, count = crossing
    rule = f"passes through itself: triangles {a + 1} and {b + 1} meet near {_place(point, unit)}"
    rule += f" ({count} such pairs)" if count > 1 else ""
    yield rule, "repair the surface (remove self-intersections)"


#: overlap, over the extent of the surface, below which triangles only touch
_DEPTH = 1e-6


def first_intersection(points: Array, triangles: Ints) -> tuple[int, int, Array, int] | None:
    """First pair of triangles that intersect. Shapes: points, triangles (n, 3)."""
    corners = np.ascontiguousarray(points[triangles])
    sides = np.roll(corners, -1, axis=1) - corners
    normals = np.cross(sides[:, 0], sides[:, 1])
    low, high = corners.min(axis=1), corners.max(axis=1)
    # pairs that a sweep along each axis looks at
    begins = np.sort(low, axis=0).T
    met = [np.searchsorted(begins[k], high[:, k], side="right").sum() for k in range(3)]
    axis = int(np.argmin(met))
    order = np.argsort(low[:, axis], kind="stable")
    tolerance = _DEPTH * float(np.ptp(points, axis=0).max())
    a, b, count = _sweep(corners, sides, normals, low, high, order, axis, tolerance)
    if not count:
        return None
    point = (np.maximum(low[a], low[b]) + np.minimum(high[a], high[b])) / 2
    return int(min(a, b)), int(max(a, b)), point, int(count)


@kernel()
def _sweep(
    corners: Array,
    sides: Array,
    normals: Array,
    low: Array,
    high: Array,
    order: Ints,
    axis: int,
    tolerance: float,
) -> tuple[int, int, int]:
    """First pair of triangles that meet in the order of the sweep, and the number of pairs."""
    first, second, count, work = -1, -1, 0, np.empty(3)
    for p in range(order.size):
        i = order[p]
        for q in range(p + 1, order.size):
            j = order[q]
            if low[j, axis] > high[i, axis]:
                break
            apart = False
            for k in range(3):
                apart |= low[i, k] > high[j, k] or low[j, k] > high[i, k]
            if not apart and _meet(corners, sides, normals, i, j, work, tolerance):
                if not count:
                    first, second = i, j
                count += 1
    return first, second, count


@part()
def _meet(
    corners: Array, sides: Array, normals: Array, i: int, j: int, axis: Array, tolerance: float
) -> bool:
    """Whether two triangles overlap along every axis that could separate them."""
    a, b = corners[i], corners[j]
    lies = _extent(a, b, normals[i], tolerance)
    coplanar = lies == 2
    if not coplanar and (lies != 1 or _extent(a, b, normals[j], tolerance) != 1):
        return False
    for k in range(3):
        _cross(normals[i], sides[i, k], axis)
        if _extent(a, b, axis, tolerance) != 1:
            return False
        _cross(normals[j], sides[j, k], axis)
        if _extent(a, b, axis, tolerance) != 1:
            return False
    for k in range(9):
        _cross(sides[i, k // 3], sides[j, k % 3], axis)
        if not coplanar and _extent(a, b, axis, tolerance) != 1:
            return False
    return True


@part()
def _extent(a: Array, b: Array, axis: Array, tolerance: float) -> int:
    """How two triangles lie along an axis: 0 apart or only touching, 1 overlapping, 2 level.

    Level means that all six corners are in one plane across the axis. An axis of length zero
    separates nothing.
    """
    length = np.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2)
    if length == 0.0:
        return 1
    low_a, high_a, low_b, high_b = np.inf, -np.inf, np.inf, -np.inf
    for k in range(3):
        # from a corner, so that a surface far from its origin loses no digits
        pa, pb = 0.0, 0.0
        for c in range(3):
            pa += (a[k, c] - a[0, c]) * axis[c]
            pb += (b[k, c] - a[0, c]) * axis[c]
        low_a, high_a = min(low_a, pa), max(high_a, pa)
        low_b, high_b = min(low_b, pb), max(high_b, pb)
    limit = tolerance * length
    if max(high_a, high_b) - min(low_a, low_b) < limit:
        return 2
    return 1 if min(high_a - low_b, high_b - low_a) > limit else 0


@part()
def _cross(u: Array, v: Array, out: Array) -> None:
    out[0] = u[1] * v[2] - u[2] * v[1]
    out[1] = u[2] * v[0] - u[0] * v[2]
    out[2] = u[0] * v[1] - u[1] * v[0]


SUFFIXES = (".stl", ".ply", ".obj")
MAX_BYTES = 200 * 1024**2
#: bytes of a binary STL before its triangles, and of each of them
_STL_HEADER = 84
_STL_TRIANGLE = 50
#: bytes of a PLY header, comments included
_PLY_HEADER = 64 * 1024
#: more triangles than any mesh for a laptop can follow
MAX_TRIANGLES = 500_000
#: faces within this fraction of the height of the lowest or highest point touch the plates
PLATE_TOLERANCE = 1e-4
#: cosine of the angle that such a face may have to the plate (10 deg)
_LEVEL = 0.985
#: lengths of a specimen, in mm, outside which a unit is suspect
PLAUSIBLE_MM = (2.0, 1000.0)
#: file coordinates (columns, signs) that become x, y and z where this axis points up
_TURNS: dict[str, tuple[tuple[int, int, int], tuple[int, int, int]]] = {
    "z": ((0, 1, 2), (1, 1, 1)),
    "-z": ((0, 1, 2), (1, -1, -1)),
    "x": ((1, 2, 0), (1, 1, 1)),
    "-x": ((1, 2, 0), (1, -1, -1)),
    "y": ((2, 0, 1), (1, 1, 1)),
    "-y": ((2, 0, 1), (1, -1, -1)),
}
AXES = tuple(_TURNS)


def _turn(u: Array, v: Array) -> Array:
    """Twice the area between two rows of points and the axis, seen from above."""
    return np.asarray(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


@dataclass(frozen=True, eq=False)
class Body(Triangles):
    """A checked surface that stands on z = 0 below its plate."""

    #: shape (m,); triangles that lie in the upper and in the lower plate.
    top: Flags
    base: Flags
    #: Position of z = 0 along the axis of the file.
    lowest_mm: float
    #: What was mended, and what looks strange.
    notes: tuple[str, ...] = ()

    @property
    def height_mm(self) -> float:
        """Height of the highest point."""
        return float(self.points[:, 2].max())

    @property
    def half_width_mm(self) -> float:
        """Distance from the loading axis to the nearest side of the bounding box."""
        low, high = self.points[:, :2].min(axis=0), self.points[:, :2].max(axis=0)
        return float(max(min(high.min(), -low.max()), 0.0))

    @functools.cached_property
    def axis_height_mm(self) -> float:
        """Height of the highest point on the loading axis; 0 where it misses the body."""
        a, b, c = self.corners.swapaxes(0, 1)
        shares = np.column_stack([_turn(b, c), _turn(c, a), _turn(a, b)])
        twice = shares.sum(axis=1)
        hit = (twice > 0) & (shares >= 0).all(axis=1)  # those that face up
        if not hit.any():
            return 0.0
        z = np.column_stack([a[hit, 2], b[hit, 2], c[hit, 2]])
        return float(((shares[hit] * z).sum(axis=1) / twice[hit]).max())

    def rounding_mm(self, sharp: float) -> float:
        """Integral of the mean curvature over the round part of the surface, mm.

        Half the sum of length times angle over all edges (Steiner 1840) that are bent by less
        than ``sharp`` (rad): 4 pi R of a ball, 0 of a box.
        """
        edges = Edges.of(self.triangles)  # closed: every edge has two triangles
        order = np.lexsort(edges.shared.T)
        first, second = edges.pairs[order].T
        between = (self.normals[first] * self.normals[second]).sum(axis=1)
        angle = np.arccos(np.clip(between, -1, 1))
        ends = self.points[edges.shared[order]]
        bent = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) * angle
        return float(bent[angle < sharp].sum() / 2)

    def plate_area_mm2(self, which: str) -> float:
        """Area that lies in the plate above (``"top"``) or below (``"base"``)."""
        chosen = self.crossed[self.top if which == "top" else self.base]
        return float(np.abs(chosen[:, 2]).sum() / 2)

    def touches(self, which: str) -> bool:
        """Whether a face lies in a plate: more than a thousandth of the cross-section."""
        return self.plate_area_mm2(which) > 1e-3 * self.volume_mm3 / self.height_mm


def height_of(specimen: Specimen) -> float:
    """Height of a specimen in mm; that of a surface is read from its file."""
    return body(specimen).height_mm if isinstance(specimen, Enclosed) else specimen.height_mm


def body(surface: Enclosed) -> Body:
    """Read or make, check and stand up the surface of a specimen."""
    if isinstance(surface, Brain):
        return _made(surface)
    path = Path(surface.file)
    try:
        state = path.stat()
    except (OSError, ValueError) as error:
        rule = f"{surface.file!r} cannot be read ({getattr(error, 'strerror', None) or error})"
        raise InputError(Fault("specimen.file", rule, "check the path")) from error
    return _body(surface, state.st_mtime_ns, state.st_size)


@functools.lru_cache(maxsize=8)
def _body(surface: Surface, changed: int, size: int) -> Body:
    """Body of a file as it is now; ``changed`` and ``size`` tell versions of it apart."""
    path = Path(surface.file)
    where = f"specimen.file: {path.name}"
    points, triangles = read_mesh(path, where)
    if not len(triangles):
        raise InputError(Fault(where, "holds no triangles", "save the surface, not its points"))
    if len(triangles) > MAX_TRIANGLES:
        rule = f"has {len(triangles)} triangles, the limit is {MAX_TRIANGLES}"
        raise InputError(Fault(where, rule, "decimate the surface: a mesh cannot follow it"))
    inspected = inspect(points, triangles, path.name, surface.unit)
    try:
        scale = parse(f"1 {surface.unit}", "length")
    except UnitError as error:
        mend = 'for example unit = "mm"; an STL file does not say in which unit it is'
        rule = f"{surface.unit!r} is not a length unit"
        raise InputError(Fault("specimen.unit", rule, mend)) from error
    turned = turned_up(inspected.points * scale, surface.axis)
    extent, notes = np.ptp(turned, axis=0), inspected.notes
    low, high = PLAUSIBLE_MM
    if not low <= float(extent.max()) <= high:
        lengths = " x ".join(f"{v:.4g}" for v in extent)
        notes += (
            f"specimen.unit: the specimen is {lengths} mm, outside {low:g} to {high:g} mm: is it "
            f"really in {surface.unit}?",
        )
    return _stood(turned, inspected.triangles, surface, notes)


@functools.lru_cache(maxsize=8)
def _made(brain: Brain) -> Body:
    """Body of a formula, checked as a file would be."""
    inspected = inspect(*brain_surface(brain), "brain", "mm")
    return _stood(inspected.points, inspected.triangles, brain, inspected.notes)


def _stood(turned: Array, triangles: Ints, surface: Enclosed, notes: tuple[str, ...]) -> Body:
    """Stand a surface on z = 0, its loading axis at x = y = 0."""
    low, high = turned.min(axis=0), turned.max(axis=0)
    origin = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    press_mm = []
    for k, given in enumerate((surface.press_x_mm, surface.press_y_mm)):
        origin[k] = origin[k] if given is None else given
        if not low[k] <= origin[k] <= high[k]:
            rule = f"{given:g} mm is beside the specimen, which reaches from {low[k]:.8g} to "
            mend = "choose press_x and press_y inside its outline"
            press_mm.append(Fault(f"specimen.press_{'xy'[k]}", f"{rule}{high[k]:.8g} mm", mend))
    if press_mm:
        raise InputError(press_mm)
    height = float(high[2] - low[2])
    tolerance = surface.plate_tolerance_mm
    within = PLATE_TOLERANCE * height if tolerance is None else tolerance
    standing, top, base = _flattened(turned - origin, triangles, height, within)
    return Body(standing, triangles, top, base, float(low[2]), notes)


def turned_up(points: Array, axis: str) -> Array:
    """Turn points, never mirrored, so that an axis of theirs points up. Shapes: points (n, 3)."""
    if axis not in _TURNS:
        rule = f"must be one of {', '.join(AXES)}, got {axis!r}"
        raise InputError(Fault("specimen.axis", rule, "it is the axis of the file that points up"))
    columns, signs = _TURNS[axis]
    return np.asarray(points[:, columns] * np.array(signs, dtype=float))


def _flattened(
    points: Array, triangles: Ints, height: float, tolerance: float
) -> tuple[Array, Flags, Flags]:
    """Put the corners of all faces that touch a plate exactly into it."""
    surface = Triangles(points, triangles)
    level, z = surface.normals[:, 2], surface.corners[:, :, 2]
    top = (z > height - tolerance).all(axis=1) & (level > _LEVEL)
    base = (z < tolerance).all(axis=1) & (level < -_LEVEL)
    out = points.copy()
    out[np.unique(triangles[top]), 2] = height
    out[np.unique(triangles[base]), 2] = 0.0
    return out, top, base


def read_mesh(path: Path, where: str) -> tuple[Array, Ints]:
    """Read the points and triangles of an STL, PLY or OBJ file; there may be points alone."""
    # Shapes: returns (n, 3); returns (m, 3).
    try:
        stream = open_regular(path, sys.maxsize)
    except UnreadableError as error:
        raise InputError(Fault(where, error.rule, "check the path")) from error
    if stream is None:
        rule = "cannot be read (there is no such file)"
        raise InputError(Fault(where, rule, "check the path"))
    with stream:
        raw_size, head = os.fstat(stream.fileno()).st_size, stream.read(_PLY_HEADER)
    if path.suffix.lower() not in SUFFIXES:
        rule = f"must end in {', '.join(SUFFIXES)}, got {path.suffix!r}"
        raise InputError(Fault(where, rule, "save the surface as STL"))
    if not raw_size:
        raise InputError(Fault(where, "is empty", "save the surface again"))
    if raw_size > MAX_BYTES:
        rule = f"has {raw_size / 1024**2:.0f} MB, the limit is {MAX_BYTES // 1024**2} MB"
        raise InputError(Fault(where, rule, "decimate the surface: a mesh cannot follow it"))
    if path.suffix.lower() == ".ply":
        _check_ply_header(head, raw_size, where)
    if path.suffix.lower() == ".stl":
        _check_stl_size(head[:1024], raw_size, where)
    return _parsed(path, where)


def _parsed(path: Path, where: str) -> tuple[Array, Ints]:
    from meshio import obj, ply, stl

    read = {".stl": stl.read, ".ply": ply.read, ".obj": obj.read}[path.suffix.lower()]
    mend = "save the surface again, as binary STL"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # a text that ends early is no more than a warning
            # meshio counts the triangles of a text as if it were binary
            warnings.filterwarnings("ignore", message="overflow encountered")
            mesh = read(str(path))
            points = np.array(mesh.points, dtype=float).reshape(-1, 3)
            blocks = [(block.type, np.asarray(block.data, dtype=np.int64)) for block in mesh.cells]
    except Exception as error:  # meshio's parsers raise whatever they stumble over
        reason = str(error).split("\n")[0][:120] or "it breaks the rules of its format"
        raise InputError(Fault(where, f"is malformed: {reason}", mend)) from error
    other = sorted({kind for kind, _ in blocks if kind not in ("triangle", "line", "vertex")})
    if other:
        rule = f"holds faces that are no triangles ({', '.join(other)})"
        raise InputError(Fault(where, rule, "triangulate the surface"))
    faces = [data.reshape(-1, 3) for kind, data in blocks if kind == "triangle"]
    triangles = np.concatenate(faces) if faces else np.zeros((0, 3), dtype=np.int64)
    if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(points):
        rule = "is malformed: a triangle names a point that is not there"
        raise InputError(Fault(where, rule, mend))
    return points, triangles


def _check_stl_size(head: bytes, size: int, where: str) -> None:
    """Refuse a binary STL that is shorter or longer than its own count of triangles says."""
    if head.lstrip().startswith(b"solid") and b"facet" in head:
        return
    count = int.from_bytes(head[80:84], "little")
    if size < _STL_HEADER or size != _STL_HEADER + _STL_TRIANGLE * count:
        room = max(size - _STL_HEADER, 0) / _STL_TRIANGLE
        rule = f"is malformed: its header promises {count} triangles, it has room for {room:.4g}"
        raise InputError(Fault(where, rule, "save the surface again: it may have been cut short"))


def _check_ply_header(head: bytes, size: int, where: str) -> None:
    """Refuse a header without end, which meshio would read for ever, or with too large counts."""
    end = re.search(rb"^end_header[ \t]*\r?$", head, re.MULTILINE)
    if end is None:
        rule = "is malformed: its header has no end"
        raise InputError(Fault(where, rule, "save the surface again, as binary STL"))
    head = head[: end.start()]
    for count in re.findall(rb"element\s+\w+\s+(\d+)", head):
        if len(count) > 12 or int(count) > size:
            rule = "is malformed: its header promises more than the file holds"
            raise InputError(Fault(where, rule, "save the surface again, as binary STL"))
