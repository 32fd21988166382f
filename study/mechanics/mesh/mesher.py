"""The mesh of a setup, whatever its specimen and its test.

Points are (r, z) in axisymmetric space and (x, y, z) in 3D, where the quarter with
x, y >= 0 is meshed (of a specimen given as a surface the whole). The same setup gives the
same mesh everywhere, and a refinement series has the ratio that was asked for.
"""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from study.ground.arrays import Array, Flags, Ints
from study.ground.errors import MeshError
from study.mechanics.mesh.graded import indentation_mesh, sizes_of
from study.mechanics.mesh.solid import surface_mesh, surface_mesh_size
from study.mechanics.mesh.structured import (
    Mesh,
    cross_section,
    edges_and_facets,
    equivalent_radius,
    extrude,
    graded_line,
    layers,
    outer,
    rectangle,
)
from study.mechanics.setup.geometry import Enclosed, Specimen
from study.mechanics.setup.setup import Model, Setup, mesh_level
from study.mechanics.setup.test_kind import AroundContact, MeshGrading, Test, TowardsPlates
from study.mechanics.surface.closed_surface import height_of

#: reference sizes in one cube root of the volume; the finest named mesh has this size
CELLS_PER_LENGTH = 20.0
#: the same of a whole block, which has four times the cells of its quarter
CELLS_OF_WHOLE = 6.5
#: meshes of this process that are kept
_KEPT = 4


def mesh_size(setup: Setup) -> float:
    """Element size in mm: the given one, or that of the named level."""
    model = setup.model
    if isinstance(setup.specimen, Enclosed):
        return surface_mesh_size(setup)
    if isinstance(setup.grading, AroundContact):
        return sizes_of(setup).size_mm
    if model.mesh_size_mm is not None:
        return model.mesh_size_mm
    cells = CELLS_OF_WHOLE if setup.is_whole else CELLS_PER_LENGTH
    reference = setup.specimen.volume_mm3 ** (1 / 3) / cells
    return float(reference * mesh_level(model))


def build_mesh(setup: Setup) -> Mesh:
    """Mesh of a setup; with a ``mesh_seed`` another of the same size."""
    # A seed moves nodes at random, and has a specimen given as a surface meshed anew: with the
    # topology of one mesh, forces on a round body scatter by 1.5 %, over all meshes by 5 %.
    if isinstance(setup.specimen, Enclosed):  # not kept: its file may have changed
        return surface_mesh(setup)
    seed, test = setup.model.mesh_seed, replace(setup.test, steps=1)
    mesh = regular_mesh(setup.specimen, test, replace(setup.model, mesh_seed=None))
    if seed is None:
        return mesh
    nodes, neighbors = _steps_allowed(mesh)
    movable = ~_at_edge(setup.grading, mesh)[nodes]
    nodes, neighbors = nodes[movable], neighbors[movable]
    moved = _random_steps(mesh.points, nodes, neighbors, np.random.default_rng(seed))
    return replace(mesh, points=_tamed(mesh, moved))


def _at_edge(grading: MeshGrading, mesh: Mesh) -> Flags:
    """Nodes that follow the edge of a flat end: they are part of what is modelled."""
    if not isinstance(grading, AroundContact) or not grading.indenter.has_face:
        return np.zeros(len(mesh.points), dtype=bool)
    ring = grading.indenter.face_radius_mm
    rho = np.linalg.norm(mesh.points[:, :-1], axis=1)
    on_top = mesh.points[:, -1] >= mesh.height_mm * (1 - 1e-9)
    # in 3D the nodes lie on chords as long as the elements there
    sagitta = mesh.size_mm**2 / (8 * ring) if mesh.points.shape[1] == 3 and ring > 0 else 0.0
    return np.asarray(on_top & (np.abs(rho - ring) <= 1.2 * sagitta + 1e-9 * mesh.height_mm))


@functools.lru_cache(maxsize=_KEPT)
def regular_mesh(specimen: Specimen, test: Test, model: Model) -> Mesh:
    """Mesh before nodes are moved: the last few are kept."""
    setup = Setup(specimen, test, model)
    if isinstance(setup.grading, AroundContact):
        mesh = indentation_mesh(setup)
    else:
        mesh = compressed_mesh(setup, setup.grading)
    mesh.points.flags.writeable = mesh.cells.flags.writeable = False  # many will use them
    return mesh


def compressed_mesh(setup: Setup, bonded: TowardsPlates) -> Mesh:
    """Mesh of a specimen between plates; the upper half where the middle plane is a symmetry."""
    h, half = mesh_size(setup), setup.has_middle_plane
    height = height_of(setup.specimen)
    z = layers(height, h, half=half, top=bonded.top, base=bonded.base)
    graded = bonded.top or bonded.base
    if setup.model.space == "axisymmetric":
        radius = equivalent_radius(setup.specimen)
        r = graded_line(radius, h, towards_end=graded)
        points, cells = rectangle(r, z, setup.model.element_shape)
    else:
        plane, faces = cross_section(
            setup.specimen, h, graded, setup.model.element_shape, whole=setup.is_whole
        )
        points, cells = extrude(plane, faces, z)
    return Mesh(points, cells, half, h)


# -------------------------------------------------------------------------------------------------
# The same mesh with its nodes moved at random: what another mesh of this size would say.
#
# Every node steps a random part of the way towards a few of its neighbors. Steps along edges
# are as long as the elements are there, in every direction of its own, so that graded and thin
# elements keep their proportions. A node on the boundary steps only towards neighbors in all
# the planes that meet in it: faces, edges, corners, the volume and the axis stay as they are.
# Midside nodes lie on straight edges and follow their ends.

#: longest step towards one neighbor over the length of the edge to it, by dimension; a node
#: then moves by some 0.12 of the element size (root mean square) in both
FRACTION = {2: 0.2, 3: 0.15}
#: smallest volume of an element corner over that before; nodes of flatter elements go back
_LEAST_SHARE = 0.3
_TRIES = 12
#: out of the plane of a facet, over the size of the specimen
_FLAT = 1e-9
#: for every corner of a cell the vertex and its neighbors
_CORNERS: dict[str, list[tuple[int, ...]]] = {
    "triangle": [(0, 1, 2)],
    "quad": [(0, 1, 3), (1, 2, 0), (2, 3, 1), (3, 0, 2)],
    "tetra": [(0, 1, 2, 3)],
    "hexahedron": [(0, 1, 3, 4), (1, 2, 0, 5), (2, 3, 1, 6), (3, 0, 2, 7), (4, 7, 5, 0),
                   (5, 4, 6, 1), (6, 5, 7, 2), (7, 6, 4, 3)],
}  # fmt: skip


def _steps_allowed(mesh: Mesh) -> tuple[Ints, Ints]:
    """Pairs of a node and a neighbor that it may step towards, sorted by node."""
    edges = np.vstack([mesh.cells[:, list(edge)] for edge in edges_and_facets(mesh.kind)[0]])
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
    parts = edges_and_facets(mesh.kind)[1]
    facets = np.vstack([mesh.cells[:, list(facet)] for facet in parts])
    rim = facets[outer(facets)]
    along = mesh.points[rim[:, 1:]] - mesh.points[rim[:, :1]]
    if mesh.points.shape[1] == 2:
        normal = np.column_stack([along[:, 0, 1], -along[:, 0, 0]])
    else:
        normal = np.cross(along[:, 0], along[:, 1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return rim.ravel(), np.repeat(normal, rim.shape[1], axis=0)


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
        flat = (_volumes(mesh, points) / before < _LEAST_SHARE).any(axis=0)
        if not flat.any():
            return points
        share[np.unique(mesh.cells[flat])] /= 2
    raise MeshError(f"{int(flat.sum())} elements would be too flat with their nodes moved")


def _volumes(mesh: Mesh, points: Array) -> Array:
    """Signed volume (times a constant) at the corners of elements, shape (corners, n_cells)."""
    volumes = []
    for vertex, *others in _CORNERS[mesh.kind]:
        origin = points[mesh.cells[:, vertex]]
        volumes.append(np.linalg.det(points[mesh.cells[:, others]] - origin[:, None]))
    return np.array(volumes)
