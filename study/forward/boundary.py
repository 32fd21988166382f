"""What holds and what touches a specimen: prescribed unknowns and contact points of a test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from study.forward.contact import STIFFNESS, SWITCHING, ContactPoints, Plate, RigidSurface
from study.forward.elements import Discretization
from study.forward.glue import gripping
from study.forward.indenters import Press, profile
from study.forward.mesh import Mesh
from study.forward.problem import Flat, Problem, Surface
from study.forward.sizes import contact_radius, sharp_edge

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: allowance of a corner over the size of its facets
CORNER_ALLOWANCE = 0.2
#: coordinates closer than this fraction of the height are the same
_SAME = 1e-9


@dataclass(frozen=True)
class Constraints:
    """Prescribed unknowns: ``x[dofs] = rate * displacement``.

    ``pins`` are those that only keep the specimen in its place and should carry nothing.
    """

    dofs: Ints
    rate: Array
    pins: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @classmethod
    def of(cls, rate: Mapping[int, float], pins: Sequence[int] | Ints = ()) -> Constraints:
        """Prescribed unknowns with their rates, and the pins, which do not move."""
        every = {**rate, **{int(d): 0.0 for d in pins}}
        dofs = np.array(sorted(every), dtype=np.int64)
        rates = np.array([every[int(d)] for d in dofs])
        return cls(dofs, rates, np.array(pins, dtype=np.int64))


class Nodes(Protocol):
    """Places that boundary conditions are laid on."""

    @property
    def nodes(self) -> Array:
        """Reference positions, shape (n_nodes, dim)."""

    @property
    def dim(self) -> int:
        """Number of displacement components."""


def constraints(problem: Problem, space: Nodes, mesh: Mesh) -> Constraints:
    """Held and driven unknowns of a test, the planes of symmetry (or the axis) included."""
    if isinstance(problem.specimen, Surface):
        from study.forward.whole import whole_constraints  # it builds on this module

        return whole_constraints(problem, space, mesh)
    if problem.test.kind == "compression":
        rate = plate_rates(problem, space, mesh)
    else:
        rate = base_rates(problem, space, mesh) | _bonded_punch(problem, space, mesh)
    tol = _SAME * mesh.height_mm
    for i in range(space.dim - 1):
        symmetric = np.flatnonzero(np.abs(space.nodes[:, i]) < tol)
        rate |= {int(n) * space.dim + i: 0.0 for n in symmetric}
    return Constraints.of(rate)


def at_level(space: Nodes, mesh: Mesh, level: float) -> Ints:
    """Nodes at an axial position."""
    return np.flatnonzero(np.abs(space.nodes[:, -1] - level) < _SAME * mesh.height_mm)


def plate_rates(problem: Problem, space: Nodes, mesh: Mesh) -> dict[int, float]:
    """Plates above and below, or the middle plane instead of the one below."""
    dim, half = space.dim, mesh.half_height
    top = at_level(space, mesh, mesh.height_mm)
    base = at_level(space, mesh, mesh.height_mm / 2 if half else 0.0)
    rate = {int(n) * dim + dim - 1: (-0.5 if half else -1.0) for n in top}
    rate |= {int(n) * dim + dim - 1: 0.0 for n in base}
    if problem.test.interface == "bonded":
        rate |= _sideways(top, dim)
    if problem.test.base == "bonded" and not half:
        rate |= _sideways(base, dim)
    return rate


def base_rates(problem: Problem, space: Nodes, mesh: Mesh) -> dict[int, float]:
    """Support of an indented specimen."""
    dim = space.dim
    base = at_level(space, mesh, 0.0)
    rate = {int(n) * dim + dim - 1: 0.0 for n in base}
    return rate | (_sideways(base, dim) if problem.test.base == "bonded" else {})


def _bonded_punch(problem: Problem, space: Nodes, mesh: Mesh) -> dict[int, float]:
    """Nodes under a flat indenter that sticks: a prescribed displacement."""
    pressed = problem.test.indenter
    if problem.test.interface != "bonded" or not isinstance(pressed, Flat):
        return {}
    top, dim = at_level(space, mesh, mesh.height_mm), space.dim
    rho = np.linalg.norm(space.nodes[top][:, : dim - 1], axis=1)
    held = top[rho <= (pressed.radius_mm - pressed.edge_radius_mm) * (1 + _SAME)]
    return {int(n) * dim + dim - 1: -1.0 for n in held} | _sideways(held, dim)


def _sideways(nodes: Ints, dim: int) -> dict[int, float]:
    """Hold nodes across the axis."""
    return {int(n) * dim + i: 0.0 for n in nodes for i in range(dim - 1)}


def touch_radius(problem: Problem) -> float:
    """Length whose square carries the first contact, mm; 0 where nothing begins to touch."""
    pressed = problem.test.indenter
    if problem.test.kind == "compression" or pressed is None or problem.test.holds_face:
        return 0.0
    height = problem.specimen.height_mm
    return min(contact_radius(pressed, problem.test.displacement_mm), 0.1 * height)


def contact_points(
    problem: Problem, space: Discretization, mesh: Mesh, *, folding: bool = True
) -> tuple[ContactPoints, ...]:
    """Every set of points that may meet a rigid surface.

    Parameters
    ----------
    folding : bool
        Whether the free side of a compressed specimen is kept from passing through plates.
    """
    if isinstance(problem.specimen, Surface):
        from study.forward.whole import whole_contact

        return whole_contact(problem, space, mesh, folding=folding)
    if problem.test.kind == "indentation":
        return _under_indenter(problem, space, mesh)
    return _side_contact(problem, space, mesh) if folding else ()


def _under_indenter(
    problem: Problem, space: Discretization, mesh: Mesh
) -> tuple[ContactPoints, ...]:
    test = problem.test
    if test.indenter is None or test.holds_face:
        return ()
    press = Press(profile(test.indenter, far_mm=1e3 * mesh.height_mm), mesh.height_mm)
    if sharp_edge(test.indenter):
        return _under_sharp_edge(problem, space, mesh, press)
    return gripping(_on_top(problem, space, mesh, press), test.interface, space.dim)


def _on_top(
    problem: Problem,
    space: Discretization,
    mesh: Mesh,
    surface: RigidSurface,
    *,
    nodal: bool = False,
) -> ContactPoints:
    """Points of the loaded face that a surface may meet."""
    return meeting(problem, space, mesh, surface, _top_facets(space, mesh), nodal=nodal)


def meeting(
    problem: Problem,
    space: Discretization,
    mesh: Mesh,
    surface: RigidSurface,
    chosen: NDArray[np.bool_],
    *,
    nodal: bool = False,
) -> ContactPoints:
    """Points of some facets that a surface may meet."""
    points = _points_of(problem, mesh, surface, *_collocation(space, chosen, nodal=nodal))
    return _with_corners(problem, space, points, space.facets[chosen])


def _under_sharp_edge(
    problem: Problem, space: Discretization, mesh: Mesh, press: Press
) -> tuple[ContactPoints, ...]:
    """Points of the closed disc under a flat face meet its plane, the others the whole punch.

    The node at a sharp edge carries the largest pressure. Whether it is under the face must
    not hang on its last digit, and a point that the face has run past must be pushed down by
    it, not out by the nearer side. Quadratic edges touch with their nodes here: they can lie
    in the plane exactly, and the force then comes from above as an energy does.
    """
    pressed = problem.test.indenter
    rho = np.linalg.norm(space.nodes[:, : space.dim - 1], axis=1)
    under = rho <= pressed.radius_mm * (1 + _SAME)  # type: ignore[union-attr]
    below = _on_top(problem, space, mesh, Plate(mesh.height_mm, -1, 1.0), nodal=True)
    beside = _on_top(problem, space, mesh, press)
    parts = (
        only(below, under[below.nodes].all(axis=1)),
        only(beside, ~under[beside.nodes].all(axis=1)),
    )
    return tuple(points for points in parts if points.size)


def only(points: ContactPoints, kept: NDArray[np.bool_]) -> ContactPoints:
    """Keep some of the points."""
    allowance = np.broadcast_to(points.allowance_mm, kept.shape)[kept]
    return replace(
        points,
        allowance_mm=allowance,
        nodes=points.nodes[kept],
        shape=points.shape[kept],
        weights=points.weights[kept],
        middles=None if points.middles is None else points.middles[kept][:, kept],
    )


def _with_corners(
    problem: Problem, space: Discretization, points: ContactPoints, facets: Ints
) -> ContactPoints:
    """Say how the corners of six-node triangles take part.

    A uniform pressure loads only their mid-sides, so that the sign of a corner's force says
    nothing. Under a cone or a sphere they go with their mid-sides: left alone they open, and
    let the surface buckle. Under a flat indenter they may sink in a little: held to a gap of
    zero they stop a specimen that turns about the edge.
    """
    if facets.shape[1] != 6:
        return points
    if not isinstance(problem.test.indenter, Flat):
        return replace(points, middles=_middles(space, points, facets))
    corners = np.isin(points.nodes[:, 0], facets[:, :3])
    # a corner of six facets of area A has the weight A / 2
    allowance = np.where(corners, CORNER_ALLOWANCE * np.sqrt(4 * points.weights), 0.0)
    return replace(points, allowance_mm=allowance)


def _middles(space: Discretization, points: ContactPoints, facets: Ints) -> sp.csr_matrix:
    """Mid-side points next to each corner of six-node triangles, shape (n_points, n_points)."""
    number = np.full(len(space.nodes), -1)
    number[points.nodes[:, 0]] = np.arange(points.size)
    ends = np.array([[0, 1], [1, 2], [2, 0]])
    halfway = space.nodes[facets[:, ends]].mean(axis=2)
    apart = np.linalg.norm(space.nodes[facets[:, 3:]][:, :, None] - halfway[:, None], axis=-1)
    corners = number[np.take_along_axis(facets[:, None], ends[apart.argmin(axis=2)], axis=2)]
    middles = np.repeat(number[facets[:, 3:]][:, :, None], 2, axis=2)
    entries = np.ones(corners.size, dtype=int)
    shape = (points.size, points.size)
    return sp.csr_matrix((entries, (corners.ravel(), middles.ravel())), shape) > 0


def _points_of(
    problem: Problem, mesh: Mesh, surface: RigidSurface, nodes: Ints, shape: Array, weights: Array
) -> ContactPoints:
    scale = problem.material.mu0 / mesh.contact_size_mm
    small = problem.material.family == "linear-elastic"
    return ContactPoints(
        surface, nodes, shape, weights, STIFFNESS * scale, SWITCHING * scale, small
    )


def _top_facets(space: Discretization, mesh: Mesh) -> NDArray[np.bool_]:
    axial = space.nodes[space.facets][:, :, -1]
    return np.asarray((np.abs(axial - mesh.height_mm) < _SAME * mesh.height_mm).all(axis=1))


def _collocation(
    space: Discretization, chosen: NDArray[np.bool_], *, nodal: bool = False
) -> tuple[Ints, Array, Array]:
    """Contact points of some facets: as many conditions as their surface can satisfy.

    Quadratic edges carry two Gauss points (unless ``nodal``: then all nodes but that on the
    axis, which a uniform pressure does not load), everything else its nodes. More points than
    the surface has normal displacements over-constrain it.
    """
    facets, areas = space.facets[chosen], space.facet_weights[chosen]
    k = facets.shape[1]
    if space.dim == 2 and k == 3 and not nodal:
        return _gauss_edges(space, facets)
    share = {
        (2, 2): None,  # consistent with the radius, below
        (2, 3): None,
        (3, 3): np.full(3, 1 / 3),
        (3, 4): np.full(4, 1 / 4),
        (3, 6): np.array([1, 1, 1, 3, 3, 3]) / 12,
        (3, 9): np.array([1, 1, 1, 1, 4, 4, 4, 4, 16]) / 36,
    }[(space.dim, k)]
    if share is None:
        r = space.nodes[facets][:, :, 0]
        share = _ring_shares(r)
    return _at_nodes(_nodal_areas(space, facets, areas[:, None] * share))


def _ring_shares(r: Array) -> Array:
    """Part of an edge's ring-shaped area that each node stands for (end, end, middle)."""
    ends = r[:, :2]
    both = ends.sum(axis=1, keepdims=True)
    if r.shape[1] == 2:
        return np.asarray((ends + both) / (3 * both))
    return np.hstack([ends / (3 * both), np.full((len(r), 1), 2 / 3)])


def _nodal_areas(space: Discretization, facets: Ints, shares: Array) -> Array:
    """Sum over facets of the area that each gives to its nodes, shape (n_nodes,)."""
    nodal = np.bincount(facets.ravel(), shares.ravel(), minlength=len(space.nodes))
    return nodal.astype(float)


def _at_nodes(areas: Array) -> tuple[Ints, Array, Array]:
    """Contact points at the nodes that have an area."""
    nodes = np.flatnonzero(areas > 0)
    return nodes[:, None], np.ones((nodes.size, 1)), areas[nodes]


def _gauss_edges(space: Discretization, edges: Ints) -> tuple[Ints, Array, Array]:
    """Two Gauss points on each quadratic edge (end, end, middle) of an axisymmetric mesh."""
    s = np.array([-1, 1]) / np.sqrt(3)
    N = np.stack([s * (s - 1) / 2, s * (s + 1) / 2, 1 - s**2], axis=-1)
    ends = space.nodes[edges]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    radius = np.einsum("qa,ea->eq", N, ends[:, :, 0])
    weights = 2 * np.pi * radius * length[:, None] / 2
    return np.repeat(edges, 2, axis=0), np.tile(N, (len(edges), 1)), weights.ravel()


def _side_contact(problem: Problem, space: Discretization, mesh: Mesh) -> tuple[ContactPoints, ...]:
    """Points of the free side that could fold onto a bonded plate."""
    half, height = mesh.half_height, mesh.height_mm
    tests = [(problem.test.interface, Plate(height, -1, 0.5 if half else 1.0))]
    if not half:
        tests.append((problem.test.base, Plate(0.0, 1, 0.0)))
    bonded = [plate for interface, plate in tests if interface == "bonded"]
    found = [_side_points(problem, space, mesh, plate) for plate in bonded]
    return tuple(points for points in found if points.size)


def _side_points(
    problem: Problem, space: Discretization, mesh: Mesh, plate: Plate
) -> ContactPoints:
    side = _side_facets(space, mesh)
    facets, areas = space.facets[side], space.facet_weights[side]
    nodal = _nodal_areas(space, facets, np.repeat(areas / facets.shape[1], facets.shape[1]))
    nodal[at_level(space, mesh, plate.height_mm)] = 0.0  # held by the plate already
    return _points_of(problem, mesh, plate, *_at_nodes(nodal))


def _side_facets(space: Discretization, mesh: Mesh) -> NDArray[np.bool_]:
    """Boundary facets that lie neither on a plate, nor on a plane of symmetry."""
    height = mesh.height_mm
    planes = [(space.dim - 1, height), (space.dim - 1, height / 2 if mesh.half_height else 0.0)]
    planes += [(i, 0.0) for i in range(space.dim - 1)]
    side = np.ones(len(space.facets), dtype=bool)
    for axis, value in planes:
        level = space.nodes[space.facets][:, :, axis]
        side &= ~(np.abs(level - value) < _SAME * height).all(axis=1)
    return side
