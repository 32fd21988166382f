"""Frictionless contact of boundary points with rigid surfaces: a semismooth active set.

A contact point is a place on a boundary facet: nodes, shape values and a weight (area).
Its condition ``gap >= 0, pressure >= 0, gap * pressure = 0`` is solved by the primal-dual
active set of Hueeber and Wohlmuth (2005), with the switching constant ``c`` kept apart
from the stiffness ``eps`` that only regularizes the linear solve: after every Newton
solve the multiplier takes up what the spring carried, so forces do not depend on ``eps``.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp

from study.ground.arrays import Array, Flags, Ints
from study.mechanics.contact.rigid_surface import Press
from study.mechanics.element.function_space import _SAME, Nodes, at_level
from study.mechanics.mesh.structured import Mesh
from study.mechanics.setup.geometry import Enclosed
from study.mechanics.setup.setup import Setup
from study.mechanics.setup.test_kind import FaceCondition
from study.mechanics.surface.closed_surface import body

#: eps = STIFFNESS * mu0 / h and c = SWITCHING * mu0 / h
STIFFNESS = 4e4
SWITCHING = 20.0


@dataclass(frozen=True)
class Glue:
    """Points that an indenter has taken hold of."""

    #: shape (n_points,); which they are.
    held: Flags
    #: shape (n_points, dim); where each is held, in a frame that moves with the indenter, mm.
    anchor: Array
    #: shape (n_points, dim); derivative of ``anchor`` by every constant of the material.
    rates: Mapping[str, Array] = field(default_factory=dict)

    def rate(self, name: str) -> Array:
        """Return d(anchor)/d(constant); zero where nothing has been held yet."""
        return self.rates.get(name, np.zeros_like(self.anchor))


@dataclass(frozen=True)
class Plane:
    """A rigid plane that moves against the axis: a plate, or a coordinate that ties hold."""

    #: Where it is along its own axis at no displacement, mm.
    level_mm: float
    #: {-1, 1}: direction of the normal into the specimen's side.
    sense: int
    #: Axial motion per unit of displacement, against the axis: 1, or 0.5 in a half model;
    #: d(gap)/dd is n_z times it.
    speed: float
    #: Axis that it lies across.
    axis: int

    def gap(self, x: Array, displacement_mm: float) -> tuple[Array, Array, Array]:
        """Signed distance (n,), normal (n, dim) and (zero) Hessian (n, dim, dim)."""
        n, dim = x.shape
        normal = np.zeros((n, dim))
        normal[:, self.axis] = self.sense
        shift = self.speed * displacement_mm if self.axis == dim - 1 else 0.0
        gap = self.sense * (x[:, self.axis] - (self.level_mm - shift))
        return gap, normal, np.zeros((n, dim, dim))


#: a rigid obstacle that moves with the displacement of the test
RigidSurface = Plane | Press


@dataclass(frozen=True)
class ContactPoints:
    """Points that may touch one rigid surface."""

    surface: RigidSurface
    #: shape (n_points, k); nodes of the facet of each point.
    nodes: Ints
    #: shape (n_points, k); shape functions there.
    shape: Array
    #: shape (n_points,); area that the point stands for, mm^2.
    weights: Array
    #: shape (n_points,); stiffness of the regularization, N/mm^3.
    eps: Array
    c: float
    #: Whether gap and normal belong to the reference state (linear elasticity).
    small_strain: bool = False
    #: shape (n_points,); gap below zero at which a point closes.
    allowance_mm: Array | float = 0.0
    #: shape (n_points, n_points); row of a corner of six-node triangles: the mid-side points next
    #: to it.
    middles: sp.csr_matrix | None = None
    #: shape (n_points,); which decide for themselves only until another one touches: the corners of
    #: six-node triangles, and the node on the axis, a fifth of an edge from its first Gauss point.
    first_touch: Flags | None = None

    @property
    def size(self) -> int:
        """Number of points."""
        return int(self.weights.size)

    def dofs(self, dim: int) -> Ints:
        """Displacement unknowns of every point, shape (n_points, dim * k)."""
        each = dim * self.nodes[:, :, None] + np.arange(dim)
        return np.asarray(each.reshape(self.size, -1))

    def meet(self, nodes: Array, u: Array, displacement_mm: float) -> Meeting:
        """Where the points are at displacements ``u`` (n_nodes, dim), as seen by the surface."""
        places = self.interpolated(nodes), self.interpolated(u)
        gap, normal, hessian = self.seen(*places, displacement_mm)
        direction = (self.shape[:, :, None] * normal[:, None, :]).reshape(self.size, -1)
        return Meeting(gap + self.allowance_mm, direction, hessian)

    def seen(
        self, reference: Array, moved: Array, displacement_mm: float
    ) -> tuple[Array, Array, Array]:
        """Gap, normal and Hessian of points from reference positions and displacements."""
        if self.small_strain and isinstance(self.surface, Press):  # a plane is one from both states
            return self.surface.reference_gap(reference, moved, displacement_mm)
        return self.surface.gap(reference + moved, displacement_mm)

    def evaluate(
        self, met: Meeting, multiplier: Array, closed: Flags | None = None, glue: Glue | None = None
    ) -> ContactState:
        """Active set and pressure."""
        # ``closed`` imposes the active set; without it every point decides for itself, but for
        # those that ``glue`` holds by other means.
        urge = multiplier - self.c * met.gap
        held = np.zeros(self.size, dtype=bool) if glue is None else glue.held
        closing, led = self._decided((urge > 0) | held)
        closing &= ~held
        active, gap = closing if closed is None else closed, met.gap
        pressure = np.where(active, multiplier - self.eps * gap, 0.0)
        carried = np.where(active, multiplier, 0.0)
        if self.middles is None and led.any():  # it has no condition of its own any more
            gap = np.where(led, np.maximum(gap, 0.0), gap)
        return ContactState(
            gap, active, pressure, carried, met.direction, met.hessian, closing, urge, led
        )

    def _decided(self, closing: Flags) -> tuple[Flags, Flags]:
        """Who is to be closed by the points' own decision, and which corners are led."""
        # A uniform pressure loads only the mid-sides of six-node triangles, so that the sign of a
        # corner's force says nothing. Amid closed mid-sides a corner is closed as well, whichever
        # way it is pulled; amid open ones it is open. Until the first mid-side touches, corners are
        # all that an indenter narrower than the triangles meets.
        first = self.first_touch
        touched = first is not None and bool(closing[~first].any())
        if self.middles is None:
            led = np.zeros(closing.shape, dtype=bool) if first is None else first & touched
            return closing & ~led, led
        around = np.diff(self.middles.indptr)
        closed = self.middles @ closing.astype(int)
        led = (around > 0) & ((closed == around) | ((closed == 0) & (touched | (first is None))))
        return np.where(led, closed > 0, closing), led

    def admissible(self, multiplier: Array) -> Array:
        """Pressures that points may have: none pulls but the corners that may be led."""
        pressing = multiplier >= 0
        if self.middles is not None:
            pressing |= np.diff(self.middles.indptr) > 0
        return np.where(pressing, multiplier, 0.0)

    def interpolated(self, nodal: Array) -> Array:
        """Values at the points of a nodal field (n_nodes, m), shape (n_points, m)."""
        return np.asarray(np.einsum("ck,ckj->cj", self.shape, nodal[self.nodes]))

    def rotation_forces(self, state: ContactState) -> Array:
        """d(residual)/dd at fixed unknowns from the turning normal, shape (n_points, dim * k)."""
        turning = -self.surface.speed * state.hessian[:, :, -1]
        moments = (self.weights * state.pressure)[:, None] * turning
        return np.asarray(self.shape[:, :, None] * moments[:, None, :]).reshape(self.size, -1)

    def rotation_stiffness(self, state: ContactState, rate: Array) -> float:
        """Return what curved contact owes to dF/dd; ``rate`` is dx/dd of the points' unknowns."""
        dim = state.hessian.shape[1]
        slip = np.einsum("ck,ckj->cj", self.shape, rate.reshape(self.size, -1, dim))
        slip[:, -1] += self.surface.speed
        bent = np.einsum("ci,cij,cj->c", slip, state.hessian, slip)
        return -float((self.weights * state.pressure * bent).sum())

    def forces(self, state: ContactState) -> Array:
        """Residual contributions, shape (n_points, dim * k)."""
        return -(self.weights * state.pressure)[:, None] * state.direction

    def regularization(self, state: ContactState) -> Array:
        """Part of :meth:`forces` that stems from gaps, shape (n_points, dim * k)."""
        return -(self.weights * (state.pressure - state.carried))[:, None] * state.direction

    def stiffness(self, state: ContactState) -> Array:
        """Packed upper stiffness blocks, shape (n_points, m (m + 1) / 2)."""
        rows, columns = _upper_indices(state.direction.shape[1])
        spring = self.weights * np.where(state.active, self.eps, 0.0)
        blocks = spring[:, None] * state.direction[:, rows] * state.direction[:, columns]
        if state.hessian.any():
            dim = state.hessian.shape[1]
            # with the regularization's share a gap left by the last iteration would bend the
            # tangent, and Newton's method would take two iterations for one
            curved = (self.weights * state.carried)[:, None, None] * state.hessian
            a, i, b, j = rows // dim, rows % dim, columns // dim, columns % dim
            blocks = blocks - self.shape[:, a] * self.shape[:, b] * curved[:, i, j]
        return np.asarray(blocks)


#: rows and columns of an upper triangle, asked for in every iteration
_upper_indices = functools.cache(np.triu_indices)


@dataclass(frozen=True)
class Meeting:
    """Where contact points are, one row a point.

    ``gap`` in mm, ``direction`` (n_points, dim * k) the derivative of the gap by the points'
    unknowns, ``hessian`` (n_points, dim, dim) its second one by their places.
    """

    gap: Array
    direction: Array
    hessian: Array


@dataclass(frozen=True)
class ContactState:
    """Contact at one configuration; arrays have one row a point.

    ``closing`` is the active set by the points' own decision, ``urge`` how strongly they
    want it (a pressure).
    """

    gap: Array
    active: Flags
    pressure: Array
    carried: Array
    direction: Array
    hessian: Array
    closing: Flags
    urge: Array
    led: Flags

    def normal(self) -> Array:
        """Return the surface's normals, shape (n_points, dim): shape functions sum to 1."""
        parts = self.direction.reshape(len(self.gap), -1, self.hessian.shape[1])
        return np.asarray(parts.sum(axis=1))

    def new_multiplier(self, contact: ContactPoints, increment: Array) -> Array:
        """Multiplier after a solve that moved the points' unknowns by ``increment``."""
        predicted = self.gap + np.einsum("ck,ck->c", self.direction, increment)
        taken = self.pressure + contact.eps * (self.gap - predicted)
        return np.where(self.active, taken, 0.0)

    def largest_pull(self) -> float:
        """Largest tension over the largest pressure: what held points may need to be held."""
        top = float(self.pressure.max(initial=0.0))
        pull = max(0.0, -float(self.pressure[~self.led].min(initial=0.0)))
        return pull / top if top > 0 else 0.0 if pull == 0 else np.inf

    def settled(self, gap_mm: float) -> bool:
        """Whether no open point wants to close, and no closed one is off by a gap."""
        off_mm = float(np.abs(self.gap[self.active]).max(initial=0.0))
        return off_mm < gap_mm and not (self.closing & ~self.active).any()


# Sticking to a rigid indenter without slip and release (Spence 1968, Proc. R. Soc. A 305, 55).
# New contact is tied at the end of its load step, an error of first order in the step.


@dataclass(frozen=True)
class TiedPoints(ContactPoints):
    """Contact points along one axis of the indenter's frame, where they are held."""

    surface: Plane

    def evaluate(
        self, met: Meeting, multiplier: Array, closed: Flags | None = None, glue: Glue | None = None
    ) -> ContactState:
        """Distance from the place where each point is held, and the force that holds it."""
        if glue is None:
            raise ValueError("ties need to know which points are held")
        held = glue.held
        gap = np.where(held, met.gap - glue.anchor[:, self.surface.axis], 0.0)
        pressure = np.where(held, multiplier - self.eps * gap, 0.0)
        carried = np.where(held, multiplier, 0.0)
        no_urge, led = np.zeros_like(gap), np.ones(gap.shape, dtype=bool)
        return ContactState(
            gap, held, pressure, carried, met.direction, met.hessian, held, no_urge, led
        )

    def admissible(self, multiplier: Array) -> Array:
        """Whatever there is: ties pull as well as they push."""
        return multiplier


#: area over the square of the contact radius that every tie is at least as stiff as
_TIED_AREA = 0.01


def gripping(points: ContactPoints, dim: int, reach_mm: float) -> tuple[ContactPoints, ...]:
    """Points that meet a bonded indenter, with a set of ties for every axis.

    The Gauss points of quadratic edges all miss one mode of the surface, in which corners and
    mid-sides move against each other. Only symmetry forbids it, through the points next to the
    axis, which stand for next to no area: they get the stiffness of more of it. With their own,
    two fifths of a gap were left by every iteration.
    """
    least = _TIED_AREA * reach_mm**2
    eps = points.eps * np.maximum(1.0, least / points.weights)
    ties = (
        TiedPoints(
            surface=Plane(0.0, 1, 1.0, axis), nodes=points.nodes, shape=points.shape,
            weights=points.weights, eps=eps, c=points.c, small_strain=points.small_strain,
        )
        for axis in range(dim)
    )  # fmt: skip
    return (points, *ties)


# What holds and what touches a specimen: prescribed unknowns and contact points of a test.


@dataclass(frozen=True)
class Constraints:
    """Prescribed unknowns: ``x[dofs] = rate * displacement``.

    ``pins`` are those that only keep the specimen in its place and should carry nothing; ``axial``
    is the rate of the motion along the axis alone, where a plate has others besides.
    """

    dofs: Ints
    rate: Array
    pins: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    axial: Array | None = None

    @classmethod
    def of(cls, rate: Mapping[int, float], pins: Sequence[int] | Ints = ()) -> Constraints:
        """Prescribed unknowns with their rates, and the pins, which do not move."""
        every = {**rate, **{int(d): 0.0 for d in pins}}
        dofs = np.array(sorted(every), dtype=np.int64)
        rates = np.array([every[int(d)] for d in dofs])
        return cls(dofs, rates, np.array(pins, dtype=np.int64))


def constraints(setup: Setup, space: Nodes, mesh: Mesh) -> Constraints:
    """Held and driven unknowns of a test, the planes of symmetry (or the axis) included."""
    rate = prescribed_rates(setup, space, mesh)
    if setup.is_whole or mesh.is_whole:  # what is left may move
        held = Constraints.of(rate, pins(space.nodes, len(mesh.points), rate))
        if all(face.besides is None for face in setup.faces):
            return held
        straight = [replace(face, besides=None) for face in setup.faces]
        alone = {d: v for face in straight for d, v in _face_rates(face, space, mesh).items()}
        return replace(held, axial=np.array([alone.get(int(d), 0.0) for d in held.dofs]))
    tol = _SAME * mesh.height_mm
    for i in range(space.dim - 1):
        symmetric = np.flatnonzero(np.abs(space.nodes[:, i]) < tol)
        rate |= {int(n) * space.dim + i: 0.0 for n in symmetric}
    return Constraints.of(rate)


def prescribed_rates(setup: Setup, space: Nodes, mesh: Mesh) -> dict[int, float]:
    """Unknowns that the test's faces and the clamp of a surface prescribe."""
    # A face that a surface does not have, as it is round there, is left to contact.
    specimen, dim, rate = setup.specimen, space.dim, dict[int, float]()
    for face in setup.faces:
        rate |= _face_rates(face, space, mesh)
    if not isinstance(specimen, Enclosed):
        return rate
    if not body(specimen).touches("top"):
        top = {int(n) for n in at_level(space, mesh, mesh.height_mm)}
        rate = {dof: v for dof, v in rate.items() if dof // space.dim not in top}
    if specimen.clamp_below_mm is None:
        return rate
    level = specimen.clamp_below_mm - body(specimen).lowest_mm
    below = np.flatnonzero(space.nodes[:, -1] < level)
    if setup.model.element_order == "linear":
        # a bubble is no point of the body: held, it would carry a force that no one applied
        below = below[below < len(mesh.points)]
    return rate | {int(n) * dim + i: 0.0 for n in below for i in range(dim)}


def _face_rates(face: FaceCondition, space: Nodes, mesh: Mesh) -> dict[int, float]:
    """Unknowns of one face; in a half model the middle plane stands for the one below."""
    dim, half, is_top = space.dim, mesh.half_height, face.face == "top"
    level = mesh.height_mm if is_top else mesh.height_mm / 2 if half else 0.0
    nodes = at_level(space, mesh, level)
    if face.within_mm is not None:
        rho = np.linalg.norm(space.nodes[nodes][:, : dim - 1], axis=1)
        nodes = nodes[rho <= face.within_mm * (1 + _SAME)]
    axial = 0.5 * face.axial if half else face.axial
    rate = {int(n) * dim + dim - 1: axial for n in nodes}
    is_plane_of_symmetry = half and not is_top
    if not face.is_held or is_plane_of_symmetry:
        return rate
    further = face.besides
    motion = np.zeros(BESIDES) if further is None else face.share_per_mm * further.components()
    moved = face_motions(space, nodes) @ motion
    held = {int(n) * dim + i: float(moved[k, i]) for k, n in enumerate(nodes) for i in range(dim)}
    return {dof: held[dof] + rate.get(dof, 0.0) for dof in held}


#: motions of a face besides that along the axis: two shifts, three small rotations, spread
BESIDES = 6


def face_motions(space: Nodes, nodes: Ints) -> Array:
    """Displacements of nodes of a face for a unit of each motion besides that along the axis."""
    # Shapes: nodes (n,); returns (n, dim, 6), mm, rad.
    dim, places = space.dim, space.nodes[nodes]
    motions = np.zeros((len(nodes), dim, BESIDES))
    motions[:, : dim - 1, 5] = places[:, : dim - 1]
    if dim == 3:  # turned about its own plane
        motions[:, :, :5] = rigid_motions(places * [1.0, 1.0, 0.0])[:, :, [0, 1, 3, 4, 5]]
    return motions


#: motion, over that of the largest, below which a rigid motion counts as held
_HELD = 1e-6


def rigid_motions(places: Array) -> Array:
    """Displacements by a unit of each translation and rotation about the origin, (n, 3, 6)."""
    # Shapes: places (n, 3), mm.
    x, y, z = places.T
    motions = np.zeros((len(places), 3, 6))
    motions[:, :, :3] = np.eye(3)
    motions[:, 1, 3], motions[:, 2, 3] = -z, y
    motions[:, 0, 4], motions[:, 2, 4] = z, -x
    motions[:, 0, 5], motions[:, 1, 5] = -y, x
    return motions


def pins(places: Array, n_free: int, held: Mapping[int, float]) -> Ints:
    """Unknowns that have to be held besides those that are. Shapes: places (n_nodes, 3)."""
    middle, extent = (places.min(axis=0) + places.max(axis=0)) / 2, np.ptp(places, axis=0).max()
    motions = rigid_motions((places - middle) / float(extent)).reshape(-1, 6)
    rows = motions[sorted(held)]
    values, directions = np.linalg.eigh(rows.T @ rows) if held else (np.zeros(6), np.eye(6))
    free = directions[:, values < _HELD**2 * max(float(values.max(initial=0.0)), 1.0)]
    chosen: list[int] = []
    while free.shape[1]:
        left = motions[: 3 * n_free] @ free
        # rounded, so that equal places do not change with the last digit
        dof = int(np.round(np.linalg.norm(left, axis=1), 9).argmax())
        chosen.append(dof)
        # the motions left are those that do not move this unknown
        free = free @ np.linalg.svd(left[dof : dof + 1])[2][1:].T
    return np.array(sorted(chosen), dtype=np.int64)
