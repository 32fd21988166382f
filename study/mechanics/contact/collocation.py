"""Where contact is enforced: collocation points of contact pairs, and their areas."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from study.ground.arrays import Array, Flags, Ints
from study.ground.errors import Fault, InputError
from study.mechanics.contact.contact import (
    STIFFNESS,
    SWITCHING,
    ContactPoints,
    Plane,
    RigidSurface,
    gripping,
    prescribed_rates,
)
from study.mechanics.contact.rigid_surface import Press, profile, profile_height
from study.mechanics.element.function_space import (
    _SAME,
    Discretization,
    _side_facets,
    at_level,
    middle_nodes,
)
from study.mechanics.mesh.structured import Mesh
from study.mechanics.setup.geometry import Enclosed, Indenter
from study.mechanics.setup.setup import Problem, Setup
from study.mechanics.setup.test_kind import IndenterContact, PlateContact
from study.mechanics.surface.closed_surface import height_of

#: allowance of a corner over the size of its facets
CORNER_ALLOWANCE = 0.2


def touch_radius(setup: Setup) -> float:
    """Length whose square carries the first contact, mm; 0 where nothing begins to touch."""
    pressed = [c.indenter for c in setup.contacts if isinstance(c, IndenterContact)]
    limit, depth = 0.1 * height_of(setup.specimen), setup.test.depth_mm
    return max((min(surface.contact_radius_mm(depth), limit) for surface in pressed), default=0.0)


def contact_points(
    problem: Problem, space: Discretization, mesh: Mesh, *, folding: bool = True
) -> tuple[ContactPoints, ...]:
    """Every set of points that may meet a rigid surface."""
    whole = isinstance(problem.specimen, Enclosed)
    points: list[ContactPoints] = []
    for pair in problem.setup.contacts:
        if isinstance(pair, IndenterContact):
            points += _under_indenter(problem, pair, space, mesh)
        elif folding:
            onto = _onto_plane if whole else _side_onto_plate
            points += [p for p in onto(problem, pair, space, mesh) if p.size]
    return tuple(points)


def _under_indenter(
    problem: Problem, pair: IndenterContact, space: Discretization, mesh: Mesh
) -> tuple[ContactPoints, ...]:
    """Points of the loaded face, or of a whole surface but for its base."""
    if isinstance(problem.specimen, Enclosed):
        on_base = np.isin(space.facets, at_level(space, mesh, 0.0))
        chosen = np.asarray(~on_base.all(axis=1))
        corners = mesh.points[space.facets[chosen][:, :3]]
        touch = touch_mm(pair.indenter, corners, mesh.height_mm)
    else:
        axial, touch = space.nodes[space.facets][:, :, -1], mesh.height_mm
        chosen = np.asarray((np.abs(axial - touch) < _SAME * touch).all(axis=1))
    press = Press(profile(pair.indenter, far_mm=1e3 * mesh.height_mm), touch)
    points = meeting(problem, space, mesh, press, chosen)
    if pair.indenter.is_sharp_edged:
        rho = np.linalg.norm(space.nodes[:, : space.dim - 1], axis=1)
        under = rho <= pair.indenter.face_radius_mm * (1 + _SAME)
        face = Plane(touch, -1, 1.0, space.dim - 1)
        below = meeting(problem, space, mesh, face, chosen, nodal=True)
        inside = only(below, under[below.nodes].all(axis=1))
        outside = only(points, ~under[points.nodes].all(axis=1))
        return tuple(part for part in (inside, outside) if part.size)
    if not pair.is_bonded:
        return (points,)
    return gripping(points, space.dim, touch_radius(problem.setup))


def meeting(
    problem: Problem,
    space: Discretization,
    mesh: Mesh,
    surface: RigidSurface,
    chosen: Flags,
    *,
    nodal: bool = False,
) -> ContactPoints:
    """Points of some facets that a surface may meet. Shapes: chosen (n_facets,)."""
    points = _points_of(problem, mesh, surface, *_collocation(space, chosen, nodal=nodal))
    facets, pressed = space.facets[chosen], problem.test.indenter
    slips = pressed is not None and problem.test.interface != "bonded"
    rounded = pressed is None or not pressed.has_face
    if space.dim == 2 and facets.shape[1] == 3 and slips and rounded:
        return _with_apex(space, points)
    if facets.shape[1] != 6:
        return points
    if rounded:
        middles = _middles(space, points, facets)
        first = np.diff(middles.indptr) > 0 if slips else None
        return replace(points, middles=middles, first_touch=first)
    corners = np.isin(points.nodes[:, 0], facets[:, :3])
    # a corner of six facets of area A has the weight A / 2
    allowance = np.where(corners, CORNER_ALLOWANCE * np.sqrt(4 * points.weights), 0.0)
    return replace(points, allowance_mm=allowance)


def _with_apex(space: Discretization, points: ContactPoints) -> ContactPoints:
    """Points with one on the axis, which stands for the disc up to the first Gauss point."""
    on_axis = np.abs(space.nodes[points.nodes, 0]) <= _SAME * np.ptp(space.nodes[:, 0])
    row = int(np.flatnonzero(on_axis.any(axis=1))[0])
    radii = points.interpolated(space.nodes)[:, 0]
    return replace(
        points,
        nodes=np.vstack([points.nodes, points.nodes[row]]),
        shape=np.vstack([points.shape, on_axis[row].astype(float)]),
        weights=np.append(points.weights, np.pi * radii.min() ** 2),
        eps=np.append(points.eps, points.eps[row]),
        first_touch=np.arange(points.size + 1) == points.size,
    )


def only(points: ContactPoints, chosen: Flags) -> ContactPoints:
    """Keep some of the points. Shapes: kept (n_points,)."""
    allowance = np.broadcast_to(points.allowance_mm, chosen.shape)[chosen]
    return replace(
        points,
        allowance_mm=allowance,
        nodes=points.nodes[chosen],
        shape=points.shape[chosen],
        weights=points.weights[chosen],
        eps=points.eps[chosen],
        middles=None if points.middles is None else points.middles[chosen][:, chosen],
        first_touch=None if points.first_touch is None else points.first_touch[chosen],
    )


def _middles(space: Discretization, points: ContactPoints, facets: Ints) -> sp.csr_matrix:
    """Mid-side points next to each corner of six-node triangles, shape (n_points, n_points)."""
    number = np.full(len(space.nodes), -1)
    number[points.nodes[:, 0]] = np.arange(points.size)
    corners = facets[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    middles = middle_nodes(space, np.repeat(facets[:, 3:], 3, axis=0), corners)
    pairs = number[corners.ravel()], number[np.repeat(middles, 2)]
    return sp.csr_matrix((np.ones(corners.size, int), pairs), (points.size, points.size)) > 0


def _points_of(
    problem: Problem, mesh: Mesh, surface: RigidSurface, nodes: Ints, shape: Array, weights: Array
) -> ContactPoints:
    scale = problem.material.mu0 / mesh.contact_size_mm
    small = problem.material.small_strain
    return ContactPoints(
        surface, nodes, shape, weights, np.full(weights.shape, STIFFNESS * scale),
        SWITCHING * scale, small,
    )  # fmt: skip


def _collocation(
    space: Discretization, chosen: Flags, *, nodal: bool = False
) -> tuple[Ints, Array, Array]:
    """Contact points of some facets: as many conditions as their surface can satisfy."""
    # Quadratic edges carry two Gauss points (unless ``nodal``: then all nodes but that on the axis,
    # which a uniform pressure does not load), everything else its nodes. More points than the
    # surface has normal displacements over-constrain it.
    facets, areas = space.facets[chosen], space.facet_weights[chosen]
    k = facets.shape[1]
    if space.dim == 2 and k == 3 and not nodal:
        s = np.array([-1, 1]) / np.sqrt(3)
        N = np.stack([s * (s - 1) / 2, s * (s + 1) / 2, 1 - s**2], axis=-1)
        ends = space.nodes[facets]
        length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        radius = np.einsum("qa,ea->eq", N, ends[:, :, 0])
        weights = 2 * np.pi * radius * length[:, None] / 2
        return np.repeat(facets, 2, axis=0), np.tile(N, (len(facets), 1)), weights.ravel()
    # of an edge, consistent with the radius
    share = _ring_shares(space.nodes[facets][:, :, 0]) if space.dim == 2 else _SHARES[k]
    return _at_nodes(_nodal_areas(space, facets, areas[:, None] * share))


#: part of the area of a facet in 3D that each of its nodes stands for
_SHARES = {
    3: np.full(3, 1 / 3),
    4: np.full(4, 1 / 4),
    6: np.array([1, 1, 1, 3, 3, 3]) / 12,
    9: np.array([1, 1, 1, 1, 4, 4, 4, 4, 16]) / 36,
}


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


def _side_onto_plate(
    problem: Problem, pair: PlateContact, space: Discretization, mesh: Mesh
) -> tuple[ContactPoints, ...]:
    """Points of the free side that could fold onto a bonded plate; another one is plane."""
    if not pair.is_bonded or (mesh.half_height and pair.face == "base"):
        return ()
    plate = _plate(problem, pair, mesh)
    side = _side_facets(space, mesh)
    facets, areas = space.facets[side], space.facet_weights[side]
    nodal = _nodal_areas(space, facets, np.repeat(areas / facets.shape[1], facets.shape[1]))
    nodal[at_level(space, mesh, plate.level_mm)] = 0.0
    return (_points_of(problem, mesh, plate, *_at_nodes(nodal)),)


def _plate(problem: Problem, pair: PlateContact, mesh: Mesh) -> Plane:
    """Plane of a plate, which moves as the face that it holds; half as far in a half model."""
    is_top = pair.face == "top"
    axial = next(f.axial for f in problem.setup.faces if f.face == pair.face)
    speed = (0.0 - axial) * (0.5 if mesh.half_height else 1.0)
    level, last = mesh.height_mm if is_top else 0.0, mesh.points.shape[1] - 1
    return Plane(level, -1 if is_top else 1, speed, last)


#: subdivisions of the triangles where an indenter could touch first, and how many are kept
_DIVISIONS = 14
_KEPT = 48
#: points of a triangle in halves: its corners and the middles of its sides, and the quarters
_HALVES = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5]])
_QUARTERS = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])


def _onto_plane(
    problem: Problem, pair: PlateContact, space: Discretization, mesh: Mesh
) -> tuple[ContactPoints, ...]:
    """Points of a whole surface that may come to lie in a plate; a clamp stands for the base."""
    specimen = problem.specimen
    clamped = isinstance(specimen, Enclosed) and specimen.clamp_below_mm is not None
    if clamped and pair.face == "base":
        return ()
    held = np.array(sorted(prescribed_rates(problem.setup, space, mesh)), dtype=np.int64)
    nodes = np.unique(held[held % space.dim == space.dim - 1] // space.dim)
    chosen = np.asarray(~np.isin(space.facets, nodes).all(axis=1))
    points = meeting(problem, space, mesh, _plate(problem, pair, mesh), chosen)
    return (only(points, ~np.isin(points.nodes[:, 0], nodes)),)


def touch_mm(indenter: Indenter, triangles: Array, height: float) -> float:
    """Height of the lowest point of an indenter that just touches some triangles, mm.

    Shapes: triangles (m, 3, 3).

    Notes
    -----
    The height of the profile is convex, that of a triangle linear: their difference has one
    greatest value in each triangle, found by halving its sides where it is greatest.
    """
    pieces = profile(indenter, far_mm=1e3 * height)
    x, y = triangles[:, :, 0], triangles[:, :, 1]
    area = np.stack([x[:, k - 1] * y[:, k] - x[:, k] * y[:, k - 1] for k in range(3)], axis=1)
    if not ((area >= 0).all(axis=1) | (area <= 0).all(axis=1)).any():
        mend = "choose press_x and press_y inside its outline"
        raise InputError(Fault("specimen.press_x", "the indenter misses the specimen", mend))
    best, near = -np.inf, triangles
    for _ in range(_DIVISIONS):
        places = np.einsum("qk,mkj->mqj", _HALVES, near)
        rho = np.hypot(places[:, :, 0], places[:, :, 1])
        level = places[:, :, 2] - profile_height(pieces, rho.ravel()).reshape(rho.shape)
        best = max(best, float(level.max()))
        quarters = places[:, _QUARTERS].reshape(-1, 3, 3)
        order = np.argsort(-level[:, _QUARTERS].max(axis=2).ravel(), kind="stable")
        near = quarters[order[:_KEPT]]
    return best
