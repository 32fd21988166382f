"""The same mesh with its nodes moved at random: what another mesh of this size would say.

Every node steps a random part of the way towards a few of its neighbors. Steps along edges
are as long as the elements are there, in every direction of its own, so that graded and thin
elements keep their proportions. A node on the boundary steps only towards neighbors in all
the planes that meet in it: faces, edges, corners, the volume and the axis stay as they are.
Midside nodes lie on straight edges and follow their ends.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from study.ground.arrays import Array, Ints
from study.ground.errors import MeshError
from study.mechanics.mesh.structured import KINDS, Mesh, edges_and_facets

#: longest step towards one neighbor over the length of the edge to it, by dimension; a node
#: then moves by some 0.12 of the element size (root mean square) in both
FRACTION = {2: 0.2, 3: 0.15}
#: smallest volume of an element corner over that before; nodes of flatter elements go back
_KEPT = 0.3
_TRIES = 12
#: out of the plane of a facet, over the size of the specimen
_FLAT = 1e-9
#: by (dimension, vertices): for every corner the vertex and its neighbors
_CORNERS: dict[tuple[int, int], list[tuple[int, ...]]] = {
    (2, 3): [(0, 1, 2)],
    (2, 4): [(0, 1, 3), (1, 2, 0), (2, 3, 1), (3, 0, 2)],
    (3, 4): [(0, 1, 2, 3)],
    (3, 8): [(0, 1, 3, 4), (1, 2, 0, 5), (2, 3, 1, 6), (3, 0, 2, 7), (4, 7, 5, 0), (5, 4, 6, 1),
             (6, 5, 7, 2), (7, 6, 4, 3)],
}  # fmt: skip


def jittered(mesh: Mesh, seed: int, fixed: NDArray[np.bool_] | None = None) -> Mesh:
    """Move the nodes of a mesh at random; element size, boundary and topology stay."""
    # Shapes: fixed (n_points,).
    nodes, neighbors = _steps_allowed(mesh)
    if fixed is not None:
        kept = ~fixed[nodes]
        nodes, neighbors = nodes[kept], neighbors[kept]
    moved = _random_steps(mesh.points, nodes, neighbors, np.random.default_rng(seed))
    return replace(mesh, points=_tamed(mesh, moved))


def _kind(mesh: Mesh) -> tuple[int, int]:
    return mesh.points.shape[1], mesh.cells.shape[1]


def _steps_allowed(mesh: Mesh) -> tuple[Ints, Ints]:
    """Pairs of a node and a neighbor that it may step towards, sorted by node."""
    edges = np.vstack(
        [mesh.cells[:, list(edge)] for edge in edges_and_facets(KINDS[_kind(mesh)])[0]]
    )
    pairs = np.unique(np.vstack([edges, edges[:, ::-1]]), axis=0)
    corner, normal = _boundary_normals(mesh)
    first, last = (np.searchsorted(pairs[:, 0], corner, side) for side in ("left", "right"))
    count = last - first
    # every pair of a boundary node against every facet that the node belongs to
    at = np.repeat(first - np.cumsum(count) + count, count) + np.arange(count.sum())
    step = mesh.points[pairs[at, 1]] - mesh.points[pairs[at, 0]]
    size = float(np.ptp(mesh.points, axis=0).max())
    leaves = np.abs(np.einsum("ij,ij->i", step, np.repeat(normal, count, axis=0))) > _FLAT * size
    allowed = np.ones(len(pairs), bool)
    allowed[at[leaves]] = False
    return pairs[allowed, 0], pairs[allowed, 1]


def _boundary_normals(mesh: Mesh) -> tuple[Ints, Array]:
    """Nodes of boundary facets and the facets' unit normals, one row for each pair of them."""
    parts = edges_and_facets(KINDS[_kind(mesh)])[1]
    facets = np.vstack([mesh.cells[:, list(facet)] for facet in parts])
    _, first, count = np.unique(
        np.sort(facets, axis=1), axis=0, return_index=True, return_counts=True
    )
    outer = facets[first[count == 1]]
    along = mesh.points[outer[:, 1:]] - mesh.points[outer[:, :1]]
    if mesh.points.shape[1] == 2:
        normal = np.column_stack([along[:, 0, 1], -along[:, 0, 0]])
    else:
        normal = np.cross(along[:, 0], along[:, 1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return outer.ravel(), np.repeat(normal, outer.shape[1], axis=0)


def _random_steps(
    points: Array, nodes: Ints, neighbors: Ints, random: np.random.Generator
) -> Array:
    """Step a part of the way, up to :data:`FRACTION`, towards one neighbor per dimension."""
    n, dim = len(points), points.shape[1]
    first, last = (np.searchsorted(nodes, np.arange(n), side) for side in ("left", "right"))
    free = np.flatnonzero(last > first)
    moved = points.copy()
    for _ in range(dim):
        # numbers are drawn for all nodes, so that they do not depend on which are free
        choice, part = random.random(n)[free], random.random(n)[free]
        to = neighbors[first[free] + (choice * (last - first)[free]).astype(np.int64)]
        moved[free] += FRACTION[dim] * part[:, None] * (points[to] - points[free])
    return moved


def _tamed(mesh: Mesh, moved: Array) -> Array:
    """Halve the steps of the nodes of elements that became too flat, until none is."""
    before = _volumes(mesh, mesh.points)
    share = np.ones(len(moved))
    for _ in range(_TRIES):
        points = mesh.points + share[:, None] * (moved - mesh.points)
        # a ratio, for extruded tetrahedra may be numbered either way round
        flat = (_volumes(mesh, points) / before < _KEPT).any(axis=0)
        if not flat.any():
            return points
        share[np.unique(mesh.cells[flat])] /= 2
    raise MeshError(f"{int(flat.sum())} elements would be too flat with their nodes moved")


def _volumes(mesh: Mesh, points: Array) -> Array:
    """Signed volume (times a constant) at the corners of elements, shape (corners, n_cells)."""
    found = []
    for vertex, *others in _CORNERS[_kind(mesh)]:
        origin = points[mesh.cells[:, vertex]]
        found.append(np.linalg.det(points[mesh.cells[:, others]] - origin[:, None]))
    return np.array(found)
