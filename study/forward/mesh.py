"""Meshes of specimens between plates: graded towards bonded corners, exact in cross-section.

Structured, so that the same problem gives the same mesh everywhere and a refinement
series has the ratio that was asked for. Points are (r, z) in axisymmetric space and
(x, y, z) in 3D, where the quarter with x, y >= 0 is meshed.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from study.errors import InputError
from study.forward.problem import MESH_LEVELS, Block, Cylinder, Problem, Specimen

Array = NDArray[np.float64]
Cells = NDArray[np.int64]

#: reference sizes in one cube root of the volume; the finest named mesh has this size
CELLS_PER_LENGTH = 20.0
#: size at a bonded corner over the size inside, and how fast sizes grow away from it
CORNER_FRACTION, GROWTH = 0.2, 0.35


@dataclass(frozen=True)
class Mesh:
    """Points and cells of the modelled part of a specimen.

    Parameters
    ----------
    points : ndarray, shape (n_points, dim)
        Coordinates in mm.
    cells : ndarray, shape (n_cells, vertices)
        Triangles or quadrilaterals (axisymmetric), tetrahedra or hexahedra (3D).
    half_height : bool
        Whether only the half above the middle plane is meshed.
    size_mm : float
        Element size inside.
    """

    points: Array
    cells: Cells
    half_height: bool
    size_mm: float

    def digest(self) -> str:
        """Hash that tells whether two meshes are the same."""
        h = hashlib.sha256(np.round(self.points, 9).tobytes())
        h.update(self.cells.tobytes())
        return h.hexdigest()[:16]


def volume_mm3(specimen: Specimen) -> float:
    """Volume of a specimen."""
    if isinstance(specimen, Cylinder):
        return float(np.pi * specimen.radius_mm**2 * specimen.height_mm)
    if isinstance(specimen, Block):
        return specimen.width_mm * specimen.depth_mm * specimen.height_mm
    raise InputError("compression takes a cylinder or a block")


def mesh_size(problem: Problem) -> float:
    """Element size in mm: the given one, or that of the named level."""
    model = problem.model
    if model.mesh_size_mm is not None:
        return model.mesh_size_mm
    reference = volume_mm3(problem.specimen) ** (1 / 3) / CELLS_PER_LENGTH
    steps = len(MESH_LEVELS) - 1 - MESH_LEVELS.index(model.mesh)
    return float(reference * model.mesh_ratio**steps)


def build_mesh(problem: Problem) -> Mesh:
    """Mesh of a compressed specimen; the half above the middle plane where that is a symmetry."""
    h = mesh_size(problem)
    half = problem.test.interface == problem.test.base
    height = problem.specimen.height_mm  # type: ignore[union-attr]
    bonded_top = problem.test.interface == "bonded"
    bonded_base = problem.test.base == "bonded"
    z = _layers(height, h, half=half, top=bonded_top, base=bonded_base)
    graded = bonded_top or bonded_base
    if problem.model.space == "axisymmetric":
        radius = _equivalent_radius(problem.specimen)
        r = graded_line(radius, h, towards_end=graded)
        points, cells = _rectangle(r, z, problem.model.element_shape)
    else:
        plane, faces = _cross_section(problem.specimen, h, graded, problem.model.element_shape)
        points, cells = _extrude(plane, faces, z)
    return Mesh(points, cells, half, h)


def graded_line(length: float, h: float, *, towards_end: bool) -> Array:
    """Points from 0 to ``length``, ``h`` apart, closer towards the end where asked."""
    if not towards_end:
        return np.linspace(0, length, max(1, round(length / h)) + 1)
    distance = np.linspace(0, length, 4001)
    spacing = _density_points(distance, lambda s: np.minimum(CORNER_FRACTION * h + GROWTH * s, h))
    return np.asarray((length - spacing)[::-1])


def _density_points(s: Array, size: Callable[[Array], Array]) -> Array:
    """Points along ``s`` whose spacing follows ``size(s)``: equal steps of its integral."""
    density = 1 / size(s)
    count = np.concatenate([[0], np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(s))])
    n = max(2, int(np.ceil(count[-1] - 1e-9)))
    points = np.interp(np.linspace(0, count[-1], n + 1), count, s)
    points[0], points[-1] = s[0], s[-1]
    return np.asarray(points)


def _layers(height: float, h: float, *, half: bool, top: bool, base: bool) -> Array:
    if half:
        return height / 2 + graded_line(height / 2, h, towards_end=top)
    upper = height / 2 + graded_line(height / 2, h, towards_end=top)
    lower = height / 2 - graded_line(height / 2, h, towards_end=base)[::-1]
    return np.concatenate([lower, upper[1:]])


def _equivalent_radius(specimen: Specimen) -> float:
    """Radius of the circle with the specimen's cross-section area."""
    return float(np.sqrt(volume_mm3(specimen) / specimen.height_mm / np.pi))  # type: ignore[union-attr]


def _rectangle(r: Array, z: Array, shape: str) -> tuple[Array, Cells]:
    """Grid of (r, z), each cell cut from its outer upper corner (the bonded one) inwards."""
    nr, nz = r.size, z.size
    points = np.column_stack([np.tile(r, nz), np.repeat(z, nr)])
    corner = (np.arange(nz - 1)[:, None] * nr + np.arange(nr - 1)).ravel()
    quads = np.column_stack([corner, corner + 1, corner + nr + 1, corner + nr])
    if shape == "tensor":
        return points, quads
    return points, np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _cross_section(specimen: Specimen, h: float, graded: bool, shape: str) -> tuple[Array, Cells]:
    if isinstance(specimen, Block):
        x = graded_line(specimen.width_mm / 2, h, towards_end=graded)
        y = graded_line(specimen.depth_mm / 2, h, towards_end=graded)
        return _rectangle(x, y, shape)
    if shape == "tensor":
        raise InputError("hexahedra mesh blocks only: use element_shape = 'simplex' here")
    if not isinstance(specimen, Cylinder):
        raise InputError("compression takes a cylinder or a block")
    return _quarter_disc(graded_line(specimen.radius_mm, h, towards_end=graded), h)


def _quarter_disc(rings: Array, h: float) -> tuple[Array, Cells]:
    """Triangles of a quarter disc: ring k carries segments of about its own spacing.

    All radii are scaled so that the polygon has the exact area of the disc: straight
    sides would otherwise lose a factor sin(t)/t and look like an effect of the space.
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
        theta = np.linspace(0, np.pi / 2, n + 1)
        ring = scale * r * np.column_stack([np.cos(theta), np.sin(theta)])
        ring[0, 1] = ring[-1, 0] = 0.0
        outer = np.arange(n + 1) + sum(len(p) for p in points)
        points.append(ring)
        cells += _stitch(inner, outer)
        inner = outer
    return np.vstack(points), np.array(cells)


def _stitch(inner: Cells, outer: Cells) -> list[tuple[int, int, int]]:
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


def _extrude(plane: Array, faces: Cells, z: Array) -> tuple[Array, Cells]:
    """Prisms (cut into three tetrahedra each) or hexahedra over a plane mesh."""
    n = len(plane)
    points = np.column_stack([np.tile(plane, (z.size, 1)), np.repeat(z, n)])
    shift = n * np.arange(z.size - 1)[:, None, None]
    if faces.shape[1] == 4:
        prisms = np.concatenate([faces + shift, faces + shift + n], axis=2)
        return points, prisms.reshape(-1, 8)
    a, b, c = np.sort(faces, axis=1).T
    # diagonals run from the lower-numbered foot to the higher-numbered head, so that
    # neighbouring prisms cut their common side alike
    tetrahedra = np.stack(
        [
            np.stack([a, b, c, c + n], axis=-1),
            np.stack([a, b, b + n, c + n], axis=-1),
            np.stack([a, a + n, b + n, c + n], axis=-1),
        ]
    ).reshape(-1, 4)
    return points, (tetrahedra[None] + shift).reshape(-1, 4)
