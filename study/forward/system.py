"""The discrete equations of one problem: unknowns, boundary conditions, residual and tangent."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from study.forward import kernels
from study.forward.contact import STIFFNESS, SWITCHING, ContactPoints, ContactState, Plate
from study.forward.elements import Discretization, discretize
from study.forward.internal import Internal
from study.forward.linear_solver import LinearSolver, make_solver
from study.forward.mesh import Mesh
from study.forward.pattern import Pattern
from study.forward.problem import Problem
from study.material import Material

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Constraints:
    """Prescribed unknowns: ``x[dofs] = rate * displacement``."""

    dofs: Ints
    rate: Array


@dataclass(frozen=True)
class State:
    """Unknowns at one displacement.

    Parameters
    ----------
    displacement_mm : float
        Displacement of the test.
    x : ndarray, shape (n,)
        Displacements node by node, then pressures.
    multipliers : tuple of ndarray
        Contact pressures, one array for each set of contact points.
    """

    displacement_mm: float
    x: Array
    multipliers: tuple[Array, ...] = ()


@dataclass
class Assembly:
    """Residual, tangent entries and contact at one state (arrays are the system's own)."""

    min_j: float
    internal: Array
    residual: Array
    contact: list[ContactState]


@dataclass
class System:
    """One problem on one mesh, ready to be solved for any constants of its material."""

    mesh: Mesh
    space: Discretization
    internal: Internal
    constraints: Constraints
    contact: tuple[ContactPoints, ...]
    force_scale: float
    area_mm2: float
    height_mm: float
    material: Material
    pattern: Pattern
    solver: LinearSolver
    data: Array
    seconds: dict[str, float] = field(default_factory=dict)
    _contact_blocks: list[tuple[Ints, NDArray[np.int32], Array]] = field(default_factory=list)

    @classmethod
    def build(
        cls, problem: Problem, mesh: Mesh, *, solver: str = "auto", folding: bool = True
    ) -> System:
        """Discretize, constrain and analyze a problem on a mesh."""
        start = time.perf_counter()
        space = discretize(mesh, problem.model)
        height = problem.specimen.height_mm  # type: ignore[union-attr]
        constraints = plate_constraints(problem, space, mesh.half_height, height)
        pattern = Pattern.build(space.dofs, space.n, constraints.dofs)
        sector = 1.0 if problem.model.space == "axisymmetric" else 4.0
        bottom = height / 2 if mesh.half_height else 0.0
        system = cls(
            mesh=mesh,
            space=space,
            internal=Internal.on(space),
            constraints=constraints,
            contact=side_contact(problem, space, mesh, height) if folding else (),
            force_scale=sector * (2.0 if mesh.half_height else 1.0),
            area_mm2=float(space.weights.sum()) * sector / (height - bottom),
            height_mm=height,
            material=problem.material,
            pattern=pattern,
            solver=make_solver(pattern, solver),
            data=np.zeros(pattern.indices.size),
        )
        system._place_contact()
        system.seconds["setup"] = time.perf_counter() - start
        return system

    def with_material(self, material: Material) -> System:
        """Return the same discretization for other constants; solver and arrays are shared."""
        return replace(self, material=material)

    @property
    def small_strain(self) -> bool:
        """Whether the material is linear: contact then belongs to the reference state."""
        return self.material.family == "linear-elastic"

    @property
    def dofs(self) -> int:
        """Number of free unknowns."""
        return int(self.pattern.free.size)

    def start(self) -> State:
        """Return the unloaded state."""
        zeros = tuple(np.zeros(c.size) for c in self.contact)
        return State(0.0, np.zeros(self.space.n), zeros)

    def prescribed(self, displacement_mm: float) -> Array:
        """Values of the constrained unknowns."""
        return self.constraints.rate * displacement_mm

    def volume_ratios(self, x: Array) -> Array:
        """J at every quadrature point, shape (n_elements, n_quadrature)."""
        return self.internal.volume_ratios(self.material, x)

    def assemble(self, state: State, *, tangent: bool = True) -> Assembly:
        """Residual at a state; the tangent stays in the system's own arrays.

        Where an element is inverted ``min_j`` is not positive and nothing else is valid.
        """
        began = time.perf_counter()
        min_j = self.internal.evaluate(self.material, state.x, tangent=tangent)
        internal = self.internal.gathered()
        if tangent and min_j > 0:
            self.internal.scatter(self.pattern.positions, self.data)
        residual, contacts = internal.copy(), []
        u = self.displacements(state.x)
        for points, multiplier, (dofs, positions, blocks) in zip(
            self.contact, state.multipliers, self._contact_blocks, strict=True
        ):
            touch = points.evaluate(self.space.nodes, u, state.displacement_mm, multiplier)
            contacts.append(touch)
            np.add.at(residual, dofs.ravel(), points.forces(touch).ravel())
            if tangent:
                blocks[:] = points.stiffness(touch)
                inside = positions >= 0
                np.add.at(self.data, positions[inside], blocks[inside])
        self._count("assembly", began)
        return Assembly(min_j, internal, residual, contacts)

    def factorize(self) -> None:
        """Factorize the last assembled tangent."""
        began = time.perf_counter()
        self.solver.factorize(self.data)
        self._count("factorization", began)

    def back_substitute(self, right: Array) -> Array:
        """Solve with the last factorization for the free unknowns."""
        began = time.perf_counter()
        solution = self.solver.solve(right)
        self._count("solve", began)
        return solution

    def tangent_product(self, v: Array, *, contact: bool = True) -> Array:
        """K v of the last assembled tangent, constrained rows and columns included."""
        out = self.internal.product(v)
        if contact:
            for dofs, _, blocks in self._contact_blocks:
                product = np.zeros(self.space.n)
                kernels.packed_product(dofs.astype(np.int32), blocks, v, product)
                out += product
        return out

    def constant_derivative(self, state: State, name: str) -> Array:
        """dR/dconstant at fixed unknowns, shape (n,), K(nu) included."""
        return self.internal.constant_derivative(self.material, state.x, name)

    def displacements(self, x: Array) -> Array:
        """Nodal displacements, shape (n_nodes, dim)."""
        return x[: self.space.n_displacement].reshape(-1, self.space.dim)

    def _place_contact(self) -> None:
        for points in self.contact:
            dofs = points.dofs(self.space.dim)
            positions = self.pattern.locate(dofs)
            self._contact_blocks.append((dofs, positions, np.zeros(positions.shape)))

    def _count(self, what: str, began: float) -> None:
        self.seconds[what] = self.seconds.get(what, 0.0) + time.perf_counter() - began


def plate_constraints(
    problem: Problem, space: Discretization, half: bool, height: float
) -> Constraints:
    """Plates above and below (or the middle plane) and the planes of symmetry."""
    nodes, dim = space.nodes, space.dim
    tol = 1e-9 * height
    axial = nodes[:, -1]
    bottom = height / 2 if half else 0.0
    top_nodes = np.flatnonzero(np.abs(axial - height) < tol)
    base_nodes = np.flatnonzero(np.abs(axial - bottom) < tol)
    rate = {int(n) * dim + dim - 1: (-0.5 if half else -1.0) for n in top_nodes}
    rate |= {int(n) * dim + dim - 1: 0.0 for n in base_nodes}
    held: list[Ints] = []
    if problem.test.interface == "bonded":
        held.append(top_nodes)
    if problem.test.base == "bonded" and not half:
        held.append(base_nodes)
    for group in held:
        rate |= {int(n) * dim + i: 0.0 for n in group for i in range(dim - 1)}
    for i in range(dim - 1):  # the axis, or the two planes of symmetry
        rate |= {int(n) * dim + i: 0.0 for n in np.flatnonzero(np.abs(nodes[:, i]) < tol)}
    dofs = np.array(sorted(rate), dtype=np.int64)
    return Constraints(dofs, np.array([rate[int(d)] for d in dofs]))


def side_contact(
    problem: Problem, space: Discretization, mesh: Mesh, height: float
) -> tuple[ContactPoints, ...]:
    """Points of the free side that could fold onto a bonded plate."""
    tests = [(problem.test.interface, Plate(height, -1, 0.5 if mesh.half_height else 1.0))]
    if not mesh.half_height:
        tests.append((problem.test.base, Plate(0.0, 1, 0.0)))
    found = []
    for interface, plate in tests:
        if interface == "bonded":
            found.append(_side_points(problem, space, mesh, height, plate))
    return tuple(points for points in found if points.size)


def _side_points(
    problem: Problem, space: Discretization, mesh: Mesh, height: float, plate: Plate
) -> ContactPoints:
    nodes, tol = space.nodes, 1e-9 * height
    facets, areas = _side_facets(space, mesh, height, tol)
    shares = np.repeat(areas / facets.shape[1], facets.shape[1])
    nodal = np.bincount(facets.ravel(), shares, len(nodes)).astype(float)
    free = np.abs(nodes[:, -1] - plate.height_mm) > tol
    chosen = np.flatnonzero((nodal > 0) & free)
    scale = problem.material.mu0 / mesh.size_mm
    return ContactPoints(
        plate,
        chosen[:, None],
        np.ones((chosen.size, 1)),
        nodal[chosen],
        STIFFNESS * scale,
        SWITCHING * scale,
    )


def _side_facets(
    space: Discretization, mesh: Mesh, height: float, tol: float
) -> tuple[Ints, Array]:
    """Boundary facets that lie neither on a plate, nor on a plane of symmetry."""
    planes = [(space.dim - 1, height), (space.dim - 1, height / 2 if mesh.half_height else 0.0)]
    planes += [(i, 0.0) for i in range(space.dim - 1)]
    side = np.ones(len(space.facets), dtype=bool)
    for axis, value in planes:
        side &= ~(np.abs(space.nodes[space.facets][:, :, axis] - value) < tol).all(axis=1)
    return space.facets[side], space.facet_weights[side]
