"""Frictionless contact of boundary points with rigid surfaces: a semismooth active set.

A contact point is a place on a boundary facet: nodes, shape values and a weight (area).
Its condition ``gap >= 0, pressure >= 0, gap * pressure = 0`` is solved by the primal-dual
active set of Hueeber and Wohlmuth (2005), with the switching constant ``c`` kept apart
from the stiffness ``eps`` that only regularizes the linear solve: after every Newton
solve the multiplier takes up what the spring carried, so forces do not depend on ``eps``.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import scipy.sparse as sp

from study.arrays import Array, Flags, Ints

#: eps = STIFFNESS * mu0 / h and c = SWITCHING * mu0 / h
STIFFNESS = 4e4
SWITCHING = 20.0


class RigidSurface(Protocol):
    """A rigid obstacle that moves with the displacement of the test."""

    @property
    def speed(self) -> float:
        """Axial motion against the axis per unit of displacement: d(gap)/dd = n_z speed."""

    def gap(self, x: Array, displacement_mm: float) -> tuple[Array, Array, Array]:
        """Signed distance (n,), outward unit normal (n, dim) and Hessian (n, dim, dim)."""

    def reference_gap(self, x: Array, u: Array, displacement_mm: float) -> tuple[Array, Array]:
        """Gap (n,) and normal (n, dim) of small-strain contact, from reference positions ``x``."""


@dataclass(frozen=True)
class Glue:
    """Points that an indenter has taken hold of.

    Parameters
    ----------
    held : ndarray of bool, shape (n_points,)
        Which they are.
    anchor : ndarray, shape (n_points, dim)
        Where each is held, in a frame that moves with the indenter, mm.
    rates : mapping of str to ndarray, shape (n_points, dim)
        Derivative of ``anchor`` by every constant of the material.
    """

    held: Flags
    anchor: Array
    rates: Mapping[str, Array] = field(default_factory=dict)

    def rate(self, name: str) -> Array:
        """Return d(anchor)/d(constant); zero where nothing has been held yet."""
        return self.rates.get(name, np.zeros_like(self.anchor))


@dataclass(frozen=True)
class Plate:
    """A rigid plane across the axis that presses downwards (``sense = -1``) or stands below (+1).

    Parameters
    ----------
    height_mm : float
        Axial position at no displacement.
    sense : {-1, 1}
        Direction of the normal into the specimen's side.
    speed : float
        Axial motion per unit of displacement, against the axis: 1, or 0.5 in a half model.
    """

    height_mm: float
    sense: int
    speed: float

    def gap(self, x: Array, displacement_mm: float) -> tuple[Array, Array, Array]:
        """Signed distance, normal and (zero) Hessian."""
        n, dim = x.shape
        normal = np.zeros((n, dim))
        normal[:, -1] = self.sense
        level = self.height_mm - self.speed * displacement_mm
        return self.sense * (x[:, -1] - level), normal, np.zeros((n, dim, dim))

    def reference_gap(self, x: Array, u: Array, displacement_mm: float) -> tuple[Array, Array]:
        """As :meth:`gap`: a plane looks the same from both states."""
        return self.gap(x + u, displacement_mm)[:2]


@dataclass(frozen=True)
class ContactPoints:
    """Points that may touch one rigid surface.

    Parameters
    ----------
    surface : RigidSurface
        The obstacle.
    nodes : ndarray of int, shape (n_points, k)
        Nodes of the facet of each point.
    shape : ndarray, shape (n_points, k)
        Shape functions there.
    weights : ndarray, shape (n_points,)
        Area that the point stands for, mm^2.
    eps : ndarray, shape (n_points,)
        Stiffness of the regularization, N/mm^3.
    c : float
        Switching constant, N/mm^3.
    small_strain : bool
        Whether gap and normal belong to the reference state (linear elasticity).
    allowance_mm : ndarray, shape (n_points,), optional
        Gap below zero at which a point closes.
    middles : sparse matrix of bool, shape (n_points, n_points), optional
        Row of a corner of six-node triangles: the mid-side points next to it.
    """

    surface: RigidSurface
    nodes: Ints
    shape: Array
    weights: Array
    eps: Array
    c: float
    small_strain: bool = False
    allowance_mm: Array | float = 0.0
    middles: sp.csr_matrix | None = None
    _dofs: dict[int, Ints] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def size(self) -> int:
        """Number of points."""
        return int(self.weights.size)

    def dofs(self, dim: int) -> Ints:
        """Displacement unknowns of every point, shape (n_points, dim * k)."""
        if dim not in self._dofs:
            each = dim * self.nodes[:, :, None] + np.arange(dim)
            self._dofs[dim] = np.asarray(each.reshape(self.size, -1))
        return self._dofs[dim]

    def meet(self, nodes: Array, u: Array, displacement_mm: float) -> Meeting:
        """Where the points are at displacements ``u`` (n_nodes, dim), as seen by the surface."""
        place, moved = self.interpolated(nodes), self.interpolated(u)
        if self.small_strain:
            gap, normal = self.surface.reference_gap(place, moved, displacement_mm)
            hessian = np.zeros((self.size, place.shape[1], place.shape[1]))
        else:
            gap, normal, hessian = self.surface.gap(place + moved, displacement_mm)
        direction = (self.shape[:, :, None] * normal[:, None, :]).reshape(self.size, -1)
        return Meeting(gap + self.allowance_mm, direction, hessian)

    def evaluate(
        self,
        met: Meeting,
        multiplier: Array,
        closed: Flags | None = None,
        glue: Glue | None = None,
    ) -> ContactState:
        """Active set and pressure.

        ``closed`` imposes the active set; without it every point decides for itself, but for
        those that ``glue`` holds by other means.
        """
        urge = multiplier - self.c * met.gap
        held = np.zeros(self.size, dtype=bool) if glue is None else glue.held
        wanted, led = self._decided((urge > 0) | held)
        wanted &= ~held
        active = wanted if closed is None else closed
        pressure = np.where(active, multiplier - self.eps * met.gap, 0.0)
        carried = np.where(active, multiplier, 0.0)
        return ContactState(
            met.gap, active, pressure, carried, met.direction, met.hessian, wanted, urge, led
        )

    def _decided(self, own: Flags) -> tuple[Flags, Flags]:
        """Who is to be closed by the points' own decision, and which corners are led.

        A uniform pressure loads only the mid-sides of six-node triangles, so that the sign of
        a corner's force says nothing. Amid closed mid-sides a corner is closed as well,
        whichever way it is pulled; amid open ones it is open.
        """
        if self.middles is None:
            return own, np.zeros(own.shape, dtype=bool)
        around = np.diff(self.middles.indptr)
        closed = self.middles @ own.astype(int)
        led = (around > 0) & ((closed == around) | (closed == 0))
        return np.where(led, closed > 0, own), led

    def admissible(self, multiplier: Array) -> Array:
        """Pressures that points may have: none pulls but the corners that may be led."""
        own = multiplier >= 0
        if self.middles is not None:
            own |= np.diff(self.middles.indptr) > 0
        return np.where(own, multiplier, 0.0)

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
        rows, columns = _upper(state.direction.shape[1])
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


@functools.cache
def _upper(m: int) -> tuple[Ints, Ints]:
    """Rows and columns of a packed upper triangle."""
    return np.triu_indices(m)


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

    ``wanted`` is the active set by the points' own decision, ``urge`` how strongly they
    want it (a pressure).
    """

    gap: Array
    active: Flags
    pressure: Array
    carried: Array
    direction: Array
    hessian: Array
    wanted: Flags
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

    def settled(self) -> bool:
        """Whether no open point wants to close."""
        return not bool((self.wanted & ~self.active).any())

    def largest_violation(self) -> float:
        """Largest |gap| of the active points, mm."""
        return float(np.abs(self.gap[self.active]).max()) if self.active.any() else 0.0
