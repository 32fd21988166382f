"""The discrete equations of one problem: unknowns, boundary conditions, residual and tangent."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from study.ground.arrays import Array, Flags
from study.mechanics.contact.collocation import contact_points, touch_radius
from study.mechanics.contact.contact import (
    Constraints,
    ContactPoints,
    ContactState,
    Glue,
    Meeting,
    TiedPoints,
    constraints,
)
from study.mechanics.element.function_space import (
    Discretization,
    Pattern,
    discretize,
    nodal_volumes,
)
from study.mechanics.material.material import Material
from study.mechanics.mesh.structured import Mesh
from study.mechanics.setup.setup import Problem, Setup
from study.mechanics.solver.internal_force import (
    EVENNESS,
    EVENNESS_OF_SOLIDS,
    LOCAL_BULK,
    ContactBlocks,
    Internal,
    StoredEnergy,
    Tangent,
)
from study.mechanics.solver.linear_solver import KeptFactors, LinearSolver, make_solver

#: powers of two that the shear modulus over the size of an element, MPa/mm, may be away from one
#: before pressures are weighed: an incompressible body of 1 mPa had half its force
_MIXED_UNITS = 17

# -------------------------------------------------------------------------------------------------
# Values of the unknowns, and what is assembled and looked at there.


@dataclass(frozen=True)
class State:
    """Unknowns at one displacement."""

    displacement_mm: float
    #: shape (n,); displacements node by node, then pressures.
    x: Array
    #: Contact pressures, one array for each set of contact points.
    multipliers: tuple[Array, ...] = ()
    #: Imposed active sets; empty where every contact point decides for itself.
    closed: tuple[Flags, ...] = ()
    #: What a bonded indenter has taken hold of.
    glue: Glue | None = None


@dataclass(frozen=True)
class Drag:
    """Resistance to leaving a place: ``weights`` (n,) times the motion from ``center`` (n,)."""

    weights: Array
    center: Array


@dataclass(frozen=True)
class Weight:
    """Gravity, a force that neither turns nor changes with the deformation."""

    #: shape (n,); on every unknown, N.
    forces: Array
    #: Energy of all kinds where the specimen has sagged and nothing touches it, N mm.
    energy_at_rest: float = 0.0

    @classmethod
    def of(cls, problem: Problem, mesh: Mesh, space: Discretization) -> Weight | None:
        """Weight of the modelled part of a specimen; None without gravity."""
        if not problem.test.weight_N_mm3:
            return None
        forces, dim = np.zeros(space.n), space.dim
        axial = np.arange(len(space.nodes)) * dim + dim - 1
        forces[axial] = problem.test.weight_N_mm3 * nodal_volumes(mesh, problem.model)
        return cls(forces)


@dataclass
class Assembly:
    """Residual, tangent entries and contact at one state (arrays are the system's own)."""

    min_j: float
    internal: Array
    residual: Array
    contact: list[ContactState]


@dataclass
class Latest:
    """What was found at the last state, so that it is found once."""

    #: Unknowns and displacement, and where each set of contact points is there.
    meetings: tuple[Array, float, list[Meeting]] | None = None
    ratios: tuple[Array, Array] | None = None
    #: Closed contact points of the last assembly, one set after the other.
    touching: Flags = field(default_factory=lambda: np.zeros(0, bool))


def _evenness(setup: Setup) -> float:
    """Resistance to uneven volume in simplices under an indenter, see :class:`Internal`."""
    model = setup.model
    mixed = model.element_shape == "simplex" and model.formulation != "displacement"
    if not mixed or not setup.kind.strains_locally:
        return 0.0
    if model.element_order == "linear":
        return EVENNESS
    return EVENNESS_OF_SOLIDS if model.space == "3d" else 0.0


@dataclass
class System:
    """One problem on one mesh, ready to be solved for any constants of its material."""

    mesh: Mesh
    space: Discretization
    #: Length whose square carries the first contact; 0 where nothing begins to touch.
    touch_mm: float
    material: Material
    internal: Internal
    constraints: Constraints
    #: Sets of points that may meet a rigid surface, with their places in the tangent.
    blocks: tuple[ContactBlocks, ...]
    tangent: Tangent
    factors: KeptFactors
    seconds: dict[str, float] = field(default_factory=dict)
    drag: Drag | None = None
    weight: Weight | None = None
    latest: Latest = field(default_factory=Latest)

    @classmethod
    def build(
        cls, problem: Problem, mesh: Mesh, *, solver: str = "auto", folding: bool = True
    ) -> System:
        """Discretize, constrain and analyze a problem on a mesh."""
        start, setup = time.perf_counter(), problem.setup
        space = discretize(mesh, setup.model, stretched=setup.kind.strains_locally)
        held = constraints(setup, space, mesh)
        pattern = Pattern.build(space.dofs, space.n, held.dofs)
        direct = make_solver(pattern, solver, plane=space.dim == 2, corrected=True)
        points = contact_points(problem, space, mesh, folding=folding)
        model, mesh = setup.model, replace(mesh, is_whole=setup.is_whole or mesh.is_whole)
        solid = model.space == "3d" and model.element_order == "quadratic"
        local_bulk = LOCAL_BULK if solid and setup.kind.strains_locally else 0.0
        system = cls(
            mesh=mesh,
            space=space,
            touch_mm=touch_radius(setup),
            material=problem.material,
            internal=Internal.on(space, local_bulk, _evenness(setup)),
            constraints=held,
            blocks=ContactBlocks.of(points, space.dim, pattern),
            tangent=Tangent.of(pattern, space.dofs),
            factors=KeptFactors(direct, pattern),
            weight=Weight.of(problem, mesh, space),
        )
        system.seconds["setup"] = time.perf_counter() - start
        return system

    @property
    def contact(self) -> tuple[ContactPoints, ...]:
        """Every set of points that may meet a rigid surface."""
        return tuple(blocks.points for blocks in self.blocks)

    @property
    def force_scale(self) -> float:
        """Force of the whole specimen over that of the model: 4 of a quarter, 8 if it is halved."""
        is_part = self.space.dim == 3 and not self.mesh.is_whole
        return (4.0 if is_part else 1.0) * (2.0 if self.mesh.half_height else 1.0)

    @property
    def rounding_N(self) -> float:  # noqa: N802
        """Norm of the residual that rounding leaves of nodal forces, N of the model."""
        return self.material.mu0 * self.internal.rounding_mm2

    @property
    def pattern(self) -> Pattern:
        """Free unknowns and the entries of the tangent."""
        return self.tangent.pattern

    @property
    def data(self) -> Array:
        """Entries of the last assembled tangent, contact and drag included."""
        return self.tangent.data

    @property
    def solver(self) -> LinearSolver:
        """Direct solver of the tangents."""
        return self.factors.solver

    @property
    def dofs(self) -> int:
        """Number of free unknowns."""
        return int(self.pattern.free.size)

    @property
    def sticks(self) -> bool:
        """Whether points that touch are tied to what they touch."""
        return any(isinstance(points, TiedPoints) for points in self.contact)

    def start(self) -> State:
        """Return the unloaded state."""
        zeros = tuple(np.zeros(c.size) for c in self.contact)
        n, dim = self.contact[0].size if self.sticks else 0, self.space.dim
        glue = Glue(np.zeros(n, dtype=bool), np.zeros((n, dim))) if self.sticks else None
        return State(0.0, np.zeros(self.space.n), zeros, glue=glue)

    def prescribed(self, displacement_mm: float) -> Array:
        """Values of the constrained unknowns."""
        return self.constraints.rate * displacement_mm

    def volume_ratios(self, x: Array) -> Array:
        """J at every quadrature point, shape (n_elements, n_quadrature)."""
        ratios = self.latest.ratios
        if ratios is None or ratios[0] is not x:
            self.latest.ratios = ratios = x, self.internal.volume_ratios(self.material, x)
        return ratios[1]

    def assemble(self, state: State, *, tangent: bool = True) -> Assembly:
        """Residual at a state; the tangent stays in the system's own arrays.

        Where an element is inverted ``min_j`` is not positive and nothing else is valid.
        """
        began = time.perf_counter()
        into = self.tangent if tangent else None
        min_j = self.internal.evaluate(self.material, state.x, into)
        internal = self.internal.gathered()
        if self.weight is not None:
            internal -= self.weight.forces
        residual, contacts = internal.copy(), self.touching(state, state.closed)
        if tangent:
            self.tangent.state = state if self.drag is None else None
        if tangent and self.blocks:
            self.tangent.elastic = self.data.copy()  # to subtract contact later would cost digits
        for points, touch, blocks in zip(self.contact, contacts, self.blocks, strict=True):
            np.add.at(residual, blocks.dofs.ravel(), points.forces(touch).ravel())
            if tangent:
                blocks.fill(points.stiffness(touch), self.data)
        if self.drag is not None:
            residual += self.drag.weights * (state.x - self.drag.center)
            if tangent:  # rows begin with their diagonal
                self.data[self.pattern.indptr[:-1]] += self.drag.weights[self.pattern.free]
        touching = [t.active for t in contacts]
        self.latest.touching = np.concatenate([np.zeros(0, bool), *touching])
        self._count("assembly", began)
        return Assembly(min_j, internal, residual, contacts)

    def touching(self, state: State, sides: tuple[Flags, ...] = ()) -> list[ContactState]:
        """Contact at a state, with imposed active sets or as every point itself decides it."""
        imposed = sides or (None,) * len(self.contact)
        each = zip(self.contact, self._meetings(state), state.multipliers, imposed, strict=True)
        return [p.evaluate(met, m, closed, state.glue) for p, met, m, closed in each]

    def held_against_wish(self, state: State) -> tuple[Flags, ...]:
        """Contact points that are closed in a state although each of them would open."""
        touching = self.touching(state)
        closed = state.closed or [touch.closing for touch in touching]
        return tuple(c & ~touch.closing for c, touch in zip(closed, touching, strict=True))

    def _meetings(self, state: State) -> list[Meeting]:
        """Where the contact points are, found once for the decision and for the forces."""
        met = self.latest.meetings
        if met is None or met[0] is not state.x or met[1] != state.displacement_mm:
            u = self.displacements(state.x)
            meetings = [p.meet(self.space.nodes, u, state.displacement_mm) for p in self.contact]
            self.latest.meetings = met = state.x, state.displacement_mm, meetings
        return met[2]

    def held(self, state: State, assembly: Assembly, rates: Mapping[str, Array]) -> State:
        """Return a converged state with all that touches held by the indenter.

        ``rates`` are the derivatives of the unknowns by every constant.
        """
        if (glue := state.glue) is None:
            return state
        points, (touch, *ties) = self.contact[0], assembly.contact
        new = touch.active
        position = points.interpolated(self.space.nodes + self.displacements(state.x))
        # as seen from the indenter, which moves against the axis
        position[:, -1] += state.displacement_mm
        moves = {n: points.interpolated(self.displacements(rate)) for n, rate in rates.items()}
        moved = {n: np.where(new[:, None], rate, glue.rate(n)) for n, rate in moves.items()}
        pushes = zip(touch.pressure * touch.normal().T, ties, strict=True)
        pushed = [np.where(new, push, tie.pressure) for push, tie in pushes]
        held = Glue(glue.held | new, np.where(new[:, None], position, glue.anchor), moved)
        free = np.where(new, 0.0, touch.pressure)
        return replace(state, glue=held, multipliers=(free, *pushed))

    def factorize(self, *, exact: bool = False) -> None:
        """Factorize the last assembled tangent; ``exact`` asks for double precision."""
        began = time.perf_counter()
        if exact:
            self.solver.sharpen()
        self.solver.weigh(self._weights())
        self.solver.factorize(self.data)
        self.factors.renewed(self.latest.touching, self.tangent.state)
        self._count("factorization", began)

    def _weights(self) -> Array | None:
        """Factors on the equations that bring pressures to the size of displacements.

        None where they are near it: in MPa and mm they are of nearly all soft materials.
        """
        exponent = round(np.log2(self.material.mu0 / self.mesh.contact_size_mm))
        if abs(exponent) <= _MIXED_UNITS:
            return None
        is_pressure = self.pattern.free >= self.space.n_displacement
        return np.where(is_pressure, 2.0**exponent, 1.0)

    def solve(self, right: Array, scale: Array, tolerance: float, change: float) -> Array:
        """Solve with the last assembled tangent, by an older factorization where that pays.

        ``change`` is the residual that the iteration has come down to.
        """
        began = time.perf_counter()
        solved = self.factors.solve(
            self.data, right, scale, tolerance, self.latest.touching, change
        )
        self._count("solve", began)
        if solved is not None:
            return solved
        self.factorize()
        return self.solve_afresh(right, tolerance, scale)

    def solve_afresh(self, right: Array, tolerance: float, scale: Array | None = None) -> Array:
        """Solve with the last assembled tangent, which was just factorized."""
        began = time.perf_counter()
        weights = np.ones(right.shape) if scale is None else scale
        solved = self.factors.solve_afresh(self.data, right, weights, tolerance)
        self._count("solve", began)
        return solved

    def lift_product(self, lift: Array) -> Array:
        """Force of prescribed increments on the free unknowns, contact left out."""
        jump = np.zeros(self.space.n)
        jump[self.constraints.dofs] = lift
        return self.tangent.constrained_product(jump)[self.pattern.free]

    def back_substitute(self, right: Array, *, refined: bool = True) -> Array:
        """Solve with the last factorization for the free unknowns."""
        began = time.perf_counter()
        solution = self.solver.solve(right, refined=refined)
        self._count("solve", began)
        return solution

    def tangent_product(self, v: Array, *, contact: bool = True) -> Array:
        """K v of the last assembled tangent, constrained rows and columns included."""
        if not contact and self.blocks:
            return self.tangent.product(v, self.tangent.elastic)
        out = self.tangent.product(v)
        for blocks in self.blocks:
            blocks.add_constrained(v, out)
        return out

    def constant_derivative(self, state: State, name: str) -> Array:
        """dR/dconstant at fixed unknowns, shape (n,), K(nu) included."""
        return self.internal.constant_derivative(self.material, state.x, name)

    def stored_energy(self, state: State) -> StoredEnergy:
        """Energy of the elements of the model, N mm: of a quarter, say, not of the whole."""
        stored, weight = self.internal.stored(self.material, state.x), self.weight
        if weight is None:
            return stored
        return stored._replace(raised=-float(weight.forces @ state.x) - weight.energy_at_rest)

    def displacements(self, x: Array) -> Array:
        """Nodal displacements, shape (n_nodes, dim)."""
        return x[: self.space.n_displacement].reshape(-1, self.space.dim)

    def _count(self, what: str, began: float) -> None:
        self.seconds[what] = self.seconds.get(what, 0.0) + time.perf_counter() - began
