"""What a surface must be to enclose a specimen: closed, of one piece, and facing outward.

Places in messages are coordinates of the file, as the program that wrote it shows them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from study.arrays import Array, Ints
from study.compilation import kernel, part
from study.errors import Fault, InputError

#: points closer than this fraction of the extent are one point
_MERGE = 1e-7

#: smallest altitude of a triangle over the extent
_FLAT = 1e-7


@dataclass(frozen=True)
class Inspected:
    """A surface without faults: points merged, triangles turned outward, what was done."""

    points: Array
    triangles: Ints
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Edges:
    """Edges of triangles, each once.

    Parameters
    ----------
    ends : ndarray of int, shape (n_edges, 2)
        Lower and higher point.
    count : ndarray of int, shape (n_edges,)
        Triangles at each edge.
    pairs : ndarray of int, shape (n_pairs, 2)
        Triangles on both sides of edges that have two.
    shared : ndarray of int, shape (n_pairs, 2)
        Ends of these edges.
    agree : ndarray of bool, shape (n_pairs,)
        Whether the two run along their edge in opposite directions, as neighbors should.
    """

    ends: Ints
    count: Ints
    pairs: Ints
    shared: Ints
    agree: NDArray[np.bool_]

    @classmethod
    def of(cls, triangles: Ints) -> Edges:
        """Edges of triangles (m, 3)."""
        directed = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        low, high = directed.min(axis=1), directed.max(axis=1)
        # one number for both ends: rows take ten times as long to sort
        size = int(high.max(initial=0)) + 1
        keys, place, count = np.unique(low * size + high, return_inverse=True, return_counts=True)
        ends = np.column_stack([keys // size, keys % size])
        order = np.argsort(place, kind="stable")
        begins = np.concatenate([[0], np.cumsum(count)[:-1]])
        first = begins[count == 2]
        sides = np.column_stack([order[first], order[first + 1]])
        forward = directed[sides, 0] < directed[sides, 1]
        agree = forward[:, 0] != forward[:, 1]
        return cls(ends, count, sides // 3, ends[count == 2], agree)


def volume(points: Array, triangles: Ints) -> float:
    """Volume enclosed by triangles that face outward; negative where they face inward.

    Parameters
    ----------
    points, triangles : ndarray, shape (n, 3) and (m, 3)
        Vertices, whose unit cubed the volume has, and the vertices of each triangle by number.
    """
    corners = points[triangles]
    # from the middle: about a far origin the sum is of products that cancel to their last digits
    corners = corners - corners.mean(axis=(0, 1))
    a, b, c = corners.swapaxes(0, 1)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def area(points: Array, triangles: Ints) -> float:
    """Total area of triangles.

    Parameters
    ----------
    points, triangles : ndarray, shape (n, 3) and (m, 3)
        Vertices, whose unit squared the area has, and the vertices of each triangle by number.
    """
    corners = points[triangles]
    twice = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.linalg.norm(twice, axis=1).sum() / 2)


def inspect(points: Array, triangles: Ints, name: str, unit: str) -> Inspected:
    """Check a surface and turn its triangles outward; one InputError tells all of its faults.

    Parameters
    ----------
    points, triangles : ndarray, shape (n, 3) and (m, 3)
        Vertices in the unit of the file, as it has them, and the vertices of each triangle.
    name, unit : str
        Of the file, for messages.
    """
    where = f"specimen.file: {name}"
    bad = ~np.isfinite(points[triangles]).all(axis=(1, 2))
    if bad.any() or np.abs(points[triangles]).max() > 1e15:
        number = int(np.flatnonzero(bad)[0]) + 1 if bad.any() else 0
        rule = f"{int(bad.sum())} triangles have coordinates that are no numbers (first: {number})"
        rule = rule if bad.any() else "has coordinates beyond 1e15"
        raise InputError(Fault(where, rule, "save the surface again"))
    points, triangles = _merged(points, triangles)
    flat = _degenerate(points, triangles)
    if flat.any():
        first = int(np.flatnonzero(flat)[0])
        rule = f"{int(flat.sum())} triangles have no area (first: triangle {first + 1}, near "
        rule += f"{_place(points[triangles[first]].mean(axis=0), unit)})"
        raise InputError(Fault(where, rule, "remove degenerate faces"))
    edges = Edges.of(triangles)
    found = [*_not_closed(points, edges, unit), *_not_one(points, triangles, edges, unit)]
    found += _crossing(points, triangles, unit)
    if found:
        raise InputError([Fault(where, rule, mend) for rule, mend in found])
    turned, note = _outward(points, triangles, edges)
    return Inspected(points, turned, note)


def _place(point: Array, unit: str) -> str:
    return "(" + ", ".join(f"{v + 0.0:.5g}" for v in point) + f") {unit}"


def _merged(points: Array, triangles: Ints) -> tuple[Array, Ints]:
    """Make one point of those at one place: an STL file repeats the corners of every triangle."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    used, corner = np.unique(triangles, return_inverse=True)
    distinct, place = np.unique(points[used], axis=0, return_inverse=True)
    cells = place.ravel()[corner].reshape(-1, 3)
    near = cKDTree(distinct).query_pairs(
        _MERGE * float(np.ptp(distinct, axis=0).max()), output_type="ndarray"
    )
    if not len(near):
        return distinct, cells
    n = len(distinct)
    graph = coo_matrix((np.ones(len(near)), near.T), shape=(n, n))
    _, group = connected_components(graph, directed=False)
    _, first = np.unique(group, return_index=True)
    return distinct[first], group[cells].astype(np.int64)


def _degenerate(points: Array, triangles: Ints) -> NDArray[np.bool_]:
    corners = points[triangles]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    extent = float(np.ptp(points, axis=0).max())
    return np.asarray(np.linalg.norm(area, axis=1) <= _FLAT * extent * np.maximum(sides, 1e-300))


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
        own = labels[rim[:, 0]]
        holes, sizes = np.unique(own, return_counts=True)
        largest = rim[own == holes[sizes.argmax()]]
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
        rule = f"holds {count} separate surfaces, with {_listed(sizes)} triangles "
        rule += f"(the first two about {places[0]} and {places[1]})"
        yield rule, "keep one body without cavities; join touching ones in the modelling program"
    elif not (edges.count != 2).any():
        pinched = _pinched(triangles, edges)
        if pinched.size:
            rule = f"touches itself at {pinched.size} points (first at "
            rule += f"{_place(points[pinched[0]], unit)})"
            yield rule, "separate the parts, or join them by more than a point"
    if _one_sided(triangles, edges):
        yield "has one side only, as a Moebius strip: inside and outside are not defined", ""


def _listed(sizes: Ints) -> str:
    shown = ", ".join(str(int(v)) for v in sizes[:4])
    return shown + (", ..." if sizes.size > 4 else "")


def _pinched(triangles: Ints, edges: Edges) -> Ints:
    """Points whose triangles form more than one fan."""
    links = []
    for end in range(2):
        point = edges.shared[:, end]
        corner = [
            3 * edges.pairs[:, s] + (triangles[edges.pairs[:, s]] == point[:, None]).argmax(axis=1)
            for s in range(2)
        ]
        links.append(np.column_stack(corner))
    _, labels = _components(np.vstack(links), triangles.size)
    fans = np.unique(triangles.ravel() * triangles.size + labels)
    own, count = np.unique(fans // triangles.size, return_counts=True)
    return np.asarray(own[count > 1])


def _cover(triangles: Ints, edges: Edges) -> Ints:
    """Components of the double cover: triangle i as it is, and i + m turned over."""
    m, (a, b) = len(triangles), edges.pairs.T
    other = np.where(edges.agree, b, b + m)
    mirror = np.where(edges.agree, b + m, b)
    links = np.vstack([np.column_stack([a, other]), np.column_stack([a + m, mirror])])
    return _components(links, 2 * m)[1]


def _one_sided(triangles: Ints, edges: Edges) -> bool:
    labels = _cover(triangles, edges)
    m = len(triangles)
    return bool((labels[:m] == labels[m:]).any())


def _outward(points: Array, triangles: Ints, edges: Edges) -> tuple[Ints, tuple[str, ...]]:
    """Turn triangles until all face outward: there is one way for a closed body of one piece."""
    m = len(triangles)
    labels = _cover(triangles, edges)
    against = labels[:m] != labels[0]
    turned = triangles.copy()
    turned[against] = turned[against, ::-1]
    if volume(points, turned) < 0:
        turned, against = turned[:, ::-1].copy(), ~against
    number = int(against.sum())
    if not number:
        return turned, ()
    if number == m:
        return turned, ("specimen.file: the surface was inside out; all triangles were turned",)
    return turned, (f"specimen.file: {number} of {m} triangles faced inward and were turned",)


def _crossing(points: Array, triangles: Ints, unit: str) -> Iterator[tuple[str, str]]:
    found = first_intersection(points, triangles)
    if found is None:
        return
    a, b, place, count = found
    rule = f"passes through itself: triangles {a + 1} and {b + 1} meet near {_place(place, unit)}"
    rule += f" ({count} such pairs)" if count > 1 else ""
    yield rule, "repair the surface (remove self-intersections)"


#: overlap, over the extent of the surface, below which triangles only touch
_DEPTH = 1e-6


def first_intersection(points: Array, triangles: Ints) -> tuple[int, int, Array, int] | None:
    """First pair of triangles that intersect.

    Parameters
    ----------
    points, triangles : ndarray, shape (n, 3) and (m, 3)
        Vertices, and the vertices of each triangle, none of them degenerate.

    Returns
    -------
    (a, b, place, count) or None
        Numbers of the two, a point between them, and how many pairs intersect.
    """
    corners = np.ascontiguousarray(points[triangles])
    sides = np.roll(corners, -1, axis=1) - corners
    normals = np.cross(sides[:, 0], sides[:, 1])
    low, high = corners.min(axis=1), corners.max(axis=1)
    axis = min(range(3), key=lambda k: _meetings(low[:, k], high[:, k]))
    order = np.argsort(low[:, axis], kind="stable")
    tolerance = _DEPTH * float(np.ptp(points, axis=0).max())
    a, b, count = _sweep(corners, sides, normals, low, high, order, axis, tolerance)
    if not count:
        return None
    place = (np.maximum(low[a], low[b]) + np.minimum(high[a], high[b])) / 2
    return int(min(a, b)), int(max(a, b)), place, int(count)


def _meetings(low: Array, high: Array) -> int:
    """Count the pairs that a sweep along an axis looks at."""
    begins = np.sort(low)
    return int(np.searchsorted(begins, high, side="right").sum())


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
