"""Boundary-value problems with a known answer, on the element arrays of the solver.

Body forces, tractions and any prescribed displacement, which no test between plates has:
manufactured solutions, thick spheres and cylinders, a punch that sticks to nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from study.mechanics.element import function_space
from study.mechanics.element.function_space import Discretization, Pattern, discretize
from study.mechanics.material.material import Material
from study.mechanics.mesh import structured
from study.mechanics.setup.setup import Model
from study.mechanics.solver.internal_force import Internal, Tangent
from study.mechanics.solver.linear_solver import LinearSolver, make_solver

Array = np.ndarray


@dataclass
class Body:
    """A meshed body of one material, without loads."""

    points: Array
    cells: Array
    model: Model
    material: Material
    space: Discretization
    internal: Internal

    @property
    def nodes(self) -> Array:
        return self.space.nodes

    def basis(self, order: int = 8) -> Any:
        """Scalar basis of one displacement component, with as exact a quadrature as asked."""
        mesh: Any = SimpleNamespace(points=self.points, cells=self.cells)
        return function_space.basis_of(mesh, self.model, order)

    def facet_basis(self, on: Callable[[Array], Array]) -> Any:
        """The same on the boundary facets where ``on`` is true."""
        from skfem import FacetBasis

        basis = self.basis(1)
        facets = basis.mesh.facets_satisfying(on, boundaries_only=True)
        return FacetBasis(basis.mesh, basis.elem, facets=facets, intorder=8)

    def dofs_where(self, chosen: Callable[[Array], Array], axis: int) -> Array:
        """Displacement unknowns along one axis of the nodes where ``chosen(nodes)`` is true.

        A bubble is no node, even where its element's centroid is chosen.
        """
        real = np.zeros(len(self.nodes), dtype=bool)
        real[: len(self.nodes) - self._bubbles] = True
        return self.nodes.shape[1] * np.flatnonzero(chosen(self.nodes) & real) + axis

    @property
    def _bubbles(self) -> int:
        mini = (
            self.model.element_order == "linear"
            and self.model.element_shape == "simplex"
            and self.model.formulation == "mixed"
        )
        return len(self.cells) if mini else 0


def body(points: Array, cells: Array, model: Model, material: Material) -> Body:
    mesh: Any = SimpleNamespace(points=points, cells=cells)
    space = discretize(mesh, model)
    return Body(points, cells, model, material, space, Internal.on(space))


def rectangle(r: Array, z: Array, model: Model) -> tuple[Array, Array]:
    return structured.rectangle(np.asarray(r), np.asarray(z), model.element_shape)


def unit_cube(n: int, model: Model) -> tuple[Array, Array]:
    line = np.linspace(0, 1, n + 1)
    plane, faces = structured.rectangle(line, line, model.element_shape)
    return structured.extrude(plane, faces, line)


def tangent_of(made: Body, held: Array) -> Tangent:
    """Room for the tangent of a body with some unknowns held."""
    pattern = Pattern.build(made.space.dofs, made.space.n, held)
    return Tangent.of(pattern, made.space.dofs)


@dataclass
class Answer:
    """Unknowns and the internal forces at them (reactions where unknowns are held)."""

    x: Array
    forces: Array


def solve(
    made: Body, held: Array, values: Array, load: Array | None = None, *, steps: int = 1
) -> Answer:
    """Newton's method in equal steps to prescribed values and a dead load, shape (n,)."""
    load = np.zeros(made.space.n) if load is None else load
    held, first = np.unique(held, return_index=True)
    values = np.asarray(values)[first]
    tangent = tangent_of(made, held)
    solver = make_solver(tangent.pattern)
    x = np.zeros(made.space.n)
    for part in np.arange(1, steps + 1) / steps:
        _step(made, tangent, solver, x, held, part * values, part * load)
    solver.close()
    return Answer(x, made.internal.gathered())


def _step(
    made: Body, tangent: Tangent, solver: LinearSolver, x: Array, held: Array, values: Array,
    load: Array,
) -> None:  # fmt: skip
    free = tangent.pattern.free
    lift = np.zeros(x.size)
    lift[held] = values - x[held]
    for _ in range(20):
        assert made.internal.evaluate(made.material, x, tangent) > 0
        residual = made.internal.gathered() - load
        scale = np.abs(made.internal.gathered()).max() + np.abs(load).max() + 1e-300
        if not lift.any() and np.abs(residual[free]).max() < 1e-11 * scale:
            return
        solver.factorize(tangent.data)
        move = lift.copy()
        move[free] = solver.solve(-(residual + tangent.product(lift))[free])
        x += move
        if not lift.any() and np.abs(move).max() < 1e-13:
            return
        lift[:] = 0.0
    raise AssertionError("no equilibrium after 20 iterations")


def linear(made: Body, held: Array, values: Array) -> Answer:
    """Small-strain answer: one solve with the tangent of the undeformed body."""
    held, first = np.unique(held, return_index=True)
    tangent = tangent_of(made, held)
    free, solver = tangent.pattern.free, make_solver(tangent.pattern)
    x = np.zeros(made.space.n)
    made.internal.evaluate(made.material, x, tangent)
    solver.factorize(tangent.data)
    x[held] = np.asarray(values)[first]
    x[free] = solver.solve(-tangent.product(x)[free])
    solver.close()
    return Answer(x, tangent.product(x))


def load_vector(
    made: Body,
    force: Callable[[Array], Array],
    volume_source: Callable[[Array], Array] | None = None,
    traction: Callable[[Array], Array] | None = None,
    on: Callable[[Array], Array] | None = None,
) -> Array:
    """Loads of a body force (dim, ...), a source of volume and a traction on facets ``on``."""
    out = np.zeros(made.space.n)
    dim = made.nodes.shape[1]
    basis = made.basis()
    _add(out, made, basis, force, dim)
    if volume_source is not None:
        x, dx = np.asarray(basis.global_coordinates()), _measure(made, basis)
        shape, numbers = function_space.pressure_of(basis, made.model)
        local = np.einsum("eqb,eq->eb", np.broadcast_to(shape, (*dx.shape, shape.shape[2])),
                          volume_source(x) * dx)  # fmt: skip
        np.add.at(out, made.space.n_displacement + numbers, local)
    if traction is not None and on is not None:
        _add(out, made, made.facet_basis(on), traction, dim)
    return out


def _add(out: Array, made: Body, basis: Any, force: Callable[[Array], Array], dim: int) -> None:
    x, dx = np.asarray(basis.global_coordinates()), _measure(made, basis)
    f = force(x)
    for local, field in enumerate(basis.basis):
        value = np.broadcast_to(np.asarray(field[0]), dx.shape)
        for i in range(dim):
            np.add.at(out, dim * basis.element_dofs[local] + i, (f[i] * value * dx).sum(axis=1))


def _measure(made: Body, basis: Any) -> Array:
    dx = np.array(basis.dx)
    if made.model.space == "axisymmetric":
        dx = dx * 2 * np.pi * np.asarray(basis.global_coordinates())[0]
    return dx


@dataclass(frozen=True)
class Errors:
    """Norms of the error: L2 of displacement and pressure, H1 seminorm of displacement."""

    u: float
    gradient: float
    pressure: float


def errors(
    made: Body, x: Array, displacement: Callable[[Array], Array],
    gradient: Callable[[Array], Array], pressure: Callable[[Array], Array],
) -> Errors:  # fmt: skip
    basis = made.basis()
    at, dx, dim = np.asarray(basis.global_coordinates()), _measure(made, basis), made.nodes.shape[1]
    nodal = x[: made.space.n_displacement].reshape(-1, dim)
    exact, slope = displacement(at), gradient(at)
    u = h1 = 0.0
    for i in range(dim):
        field = basis.interpolate(np.ascontiguousarray(nodal[:, i]))
        u += float(((np.asarray(field) - exact[i]) ** 2 * dx).sum())
        h1 += sum(float(((field.grad[j] - slope[i, j]) ** 2 * dx).sum()) for j in range(dim))
    shape, numbers = function_space.pressure_of(basis, made.model)
    p = 0.0
    if numbers.size:
        found = (shape * x[made.space.n_displacement + numbers][:, None, :]).sum(axis=2)
        p = float(((found - pressure(at)) ** 2 * dx).sum())
    return Errors(u**0.5, h1**0.5, p**0.5)
