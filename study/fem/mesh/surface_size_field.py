"""How large the elements of a compressed surface should be: small at plates that are bonded.

A quarter model divides height and radius by lines of their own, both closer at a bonded
corner. Tetrahedra in a surface are as large in every direction: here they get the volume of
the cells that the quarter model has at the same distance from plates and sides, so that one
mesh size means one density of elements, and one error, in both.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from study.arrays import Array, Ints
from study.compilation import callback, carray, part
from study.fem.mesh.size_field import CFunction
from study.fem.mesh.structured import CORNER_FRACTION, GROWTH
from study.surface.integrity import area
from study.surface.surface import Body

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
    """Element size on a regular grid, linear between its points.

    Parameters
    ----------
    size_mm : float
        What ``mesh_size`` names: the size of a cell far from plates and sides.
    origin : ndarray, shape (3,)
        First point of the grid in mm.
    step_mm : float
        Distance of its points.
    sizes : ndarray, shape (nx, ny, nz)
        Size at every point in mm.
    """

    size_mm: float
    origin: Array
    step_mm: float
    sizes: Array

    @property
    def finest_mm(self) -> float:
        """Smallest size."""
        return float(self.sizes.min())

    def numbers(self) -> tuple[float, ...]:
        """All that the size at a place depends on, in the order of the compiled formula."""
        grid = (*self.origin, self.step_mm, *(float(n) for n in self.sizes.shape))
        return (*grid, *self.sizes.ravel())

    def callback(self, dim: int) -> CFunction:
        """C function that tells gmsh the size at a place."""
        return table_callback()


@part()
def _cell(x: float, origin: float, step: float, n: int) -> tuple[int, float]:
    """Grid cell of a coordinate, and how far into it that is."""
    place = min(max((x - origin) / step, 0.0), n - 1.0)
    low = min(int(place), n - 2)
    return low, place - low


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

    made: CFunction = size
    return made


def graded_table(found: Body, size_mm: float, plates: tuple[float, ...]) -> SizeTable:
    """Sizes in a body whose faces are bonded at some heights.

    Parameters
    ----------
    found : Body
        In mm.
    size_mm : float
        Size of a cell far from plates and sides.
    plates : tuple of float
        Heights of the bonded faces, mm, one or more.
    """
    low, high = found.points.min(axis=0), found.points.max(axis=0)
    step = max(size_mm / _PER_ELEMENT, float((high - low).max()) / _MOST)
    axes = [np.arange(a, b + step, step) for a, b in zip(low, high, strict=True)]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    reach = (1 - CORNER_FRACTION) * size_mm / GROWTH  # farther away sizes grow no more
    beside = _spacing(_from_sides(found, places.reshape(-1, 3), step, reach), size_mm)
    below = _spacing(_from_plates(axes[2], plates), size_mm)
    sizes = _told(found, size_mm) * np.cbrt(size_mm * beside.reshape(places.shape[:3]) * below)
    return SizeTable(size_mm, low, step, sizes)


def expected_cubes(found: Body, size_mm: float, plates: tuple[float, ...]) -> float:
    """Cubes of the sizes that gmsh is told, in a body as if it were a prism.

    At a distance s from the side, a prism of volume V and lateral area A has the part
    (1 - s A / 2V)^2 of its cross-section left.

    Parameters
    ----------
    found, size_mm, plates
        As for :func:`graded_table`.
    """
    height = found.height_mm
    z = np.unique(np.concatenate([np.abs(p - _away(height)) for p in (0.0, height)]))
    high = float(np.trapezoid(1 / _spacing(_from_plates(z, plates), size_mm), z))
    reach = 2 * found.volume_mm3 / area(found.points, _side(found))
    s = _away(reach)
    wide = float(np.trapezoid(2 / reach * (1 - s / reach) / _spacing(s, size_mm), s))
    return found.volume_mm3 / height * wide * high / size_mm / _told(found, size_mm) ** 3


def size_at_plates(found: Body, size_mm: float) -> float:
    """Size that gmsh is told at a bonded plate, far from its rim.

    Parameters
    ----------
    found, size_mm
        As for :func:`graded_table`; the size returned is in mm too.
    """
    return float(_told(found, size_mm) * size_mm * np.cbrt(CORNER_FRACTION))


def _told(found: Body, size_mm: float) -> float:
    """Size that gmsh is told over that of the cells, less in a crude mesh and in a squat body."""
    length = min(float(np.cbrt(found.volume_mm3)), _SQUAT * found.height_mm)
    return _TOLD * max(1 - _LESS * size_mm / length, 0.5)


def _away(length: float) -> Array:
    """Distances up to a length, closer at its start."""
    return np.concatenate([[0.0], np.geomspace(1e-12 * length, length, 400)])


def _spacing(distance: Array, size_mm: float) -> Array:
    """Spacing of a quarter model's lines: see :func:`.structured.graded_line`."""
    return np.asarray(np.minimum(CORNER_FRACTION * size_mm + GROWTH * distance, size_mm))


def _from_plates(z: Array, plates: tuple[float, ...]) -> Array:
    return np.asarray(np.min([np.abs(z - plate) for plate in plates], axis=0))


def _side(found: Body) -> Ints:
    """Triangles that lie in no plate, shape (m, 3)."""
    return np.asarray(found.triangles[~(found.top | found.base)])


def _from_sides(found: Body, places: Array, step: float, reach: float) -> Array:
    """Distance from the free surface, up to about half a step; infinite beyond ``reach``."""
    from scipy.spatial import cKDTree

    points = _sampled(found.points[_side(found)], step)
    _, kept = np.unique(np.round(points / (0.5 * step)).astype(int), axis=0, return_index=True)
    nearest = cKDTree(points[kept]).query  # of a tree of points: no text is evaluated by it
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
