"""Boundary-value problems with a known answer, on the element arrays of the solver.

Body forces, tractions and any prescribed displacement, which no test between plates has:
manufactured solutions, thick spheres and cylinders, a punch that sticks to nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from study.mechanics.element import function_space
from study.mechanics.mesh import structured
from study.mechanics.mesh.structured import Mesh
from study.mechanics.setup.setup import Model
from study.mechanics.solver.newton import solve_step
from study.mechanics.solver.system import State, System, Weight
from tests.fem.homogeneous import TIGHT, held, system_of

Array = np.ndarray


@dataclass
class Body:
    """A meshed body of one material, without loads."""

    model: Model
    system: System

    @property
    def space(self):
        return self.system.space

    @property
    def nodes(self):
        return self.space.nodes

    def basis(self, order=8):
        """Scalar basis of one displacement component, with as exact a quadrature as asked."""
        return function_space.basis_of(self.system.mesh, self.model, order)

    def facet_basis(self, on):
        """The same on the boundary facets where ``on`` is true."""
        from skfem import FacetBasis

        basis = self.basis(1)
        facets = basis.mesh.facets_satisfying(on, boundaries_only=True)
        return FacetBasis(basis.mesh, basis.elem, facets=facets, intorder=8)

    def dofs_where(self, chosen, axis):
        """Displacement unknowns along one axis of the nodes where ``chosen(nodes)`` is true.

        A bubble is no node, even where its element's centroid is chosen.
        """
        real = np.zeros(len(self.nodes), dtype=bool)
        real[: len(self.nodes) - self._bubbles] = True
        return self.nodes.shape[1] * np.flatnonzero(chosen(self.nodes) & real) + axis

    @property
    def _bubbles(self):
        mini = (
            self.model.element_order == "linear"
            and self.model.element_shape == "simplex"
            and self.model.formulation == "mixed"
        )
        return len(self.system.mesh.cells) if mini else 0


ELEMENT = ("space", "element_order", "element_shape", "formulation")


def body(points, cells, model, material):
    element = {name: getattr(model, name) for name in ELEMENT}
    return Body(model, system_of(material, Mesh(points, cells, False, 1.0), **element))


def rectangle(r, z, model):
    return structured.rectangle(np.asarray(r), np.asarray(z), model.element_shape)


def unit_cube(n, model):
    line = np.linspace(0, 1, n + 1)
    plane, faces = structured.rectangle(line, line, model.element_shape)
    return structured.extrude(plane, faces, line)


def unit(model, n, material):
    """Unit cylinder or unit cube of n cells a side."""
    line = np.linspace(0, 1, n + 1)
    mesh = rectangle(line, line, model) if model.space == "axisymmetric" else unit_cube(n, model)
    return body(*mesh, model, material)


@dataclass
class Answer:
    """Unknowns and the internal forces at them (reactions where unknowns are held)."""

    x: Array
    forces: Array


def solve(made, dofs, values, load=None, *, steps=1):
    """Equilibrium in equal steps to prescribed values and a dead load, shape (n,)."""
    load = np.zeros(made.space.n) if load is None else load
    dofs, first = np.unique(dofs, return_index=True)
    system = held(made.system, dofs, np.asarray(values)[first])
    state = system.start()
    for part in np.arange(1, steps + 1) / steps:
        loaded = replace(system, weight=Weight(part * load))
        found = solve_step(loaded, State(float(part), state.x), TIGHT, lifted_from=state)
        assert found.converged, found.reason
        state = found.state
    return Answer(state.x, system.internal.gathered())


def load_vector(made, force, volume_source, traction, on):
    """Loads of a body force (dim, ...), a source of volume and a traction on facets ``on``."""
    out = np.zeros(made.space.n)
    basis = made.basis()
    _add(out, made, basis, force)
    if volume_source is not None:
        x, dx = np.asarray(basis.global_coordinates()), measure(made, basis)
        shape, numbers = function_space.pressure_of(basis, made.model)
        local = np.einsum("eqb,eq->eb", np.broadcast_to(shape, (*dx.shape, shape.shape[2])),
                          volume_source(x) * dx)  # fmt: skip
        np.add.at(out, made.space.n_displacement + numbers, local)
    _add(out, made, made.facet_basis(on), traction)
    return out


def _add(out, made, basis, force):
    x, dx = np.asarray(basis.global_coordinates()), measure(made, basis)
    dim = made.nodes.shape[1]
    f = force(x)
    for local, field in enumerate(basis.basis):
        value = np.broadcast_to(np.asarray(field[0]), dx.shape)
        for i in range(dim):
            np.add.at(out, dim * basis.element_dofs[local] + i, (f[i] * value * dx).sum(axis=1))


def measure(made, basis):
    """Volume or area of the quadrature points, all around the axis."""
    dx = np.array(basis.dx)
    if made.model.space == "axisymmetric":
        dx = dx * 2 * np.pi * np.asarray(basis.global_coordinates())[0]
    return dx


def pressures(made, basis, x):
    """Pressure at the quadrature points."""
    shape, numbers = function_space.pressure_of(basis, made.model)
    return np.asarray((shape * x[made.space.n_displacement + numbers][:, None, :]).sum(axis=2))


def interpolated(made, basis, x):
    """Components of the displacement on a basis, with their gradients."""
    nodal = x[: made.space.n_displacement].reshape(-1, made.nodes.shape[1])
    return [basis.interpolate(np.ascontiguousarray(column)) for column in nodal.T]
