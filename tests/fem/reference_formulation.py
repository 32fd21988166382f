"""The discrete equations written as scikit-fem forms, to be read and to compare kernels with.

Mixed form of a nearly incompressible solid (Holzapfel 2000, sec. 8.5): find u and p such that

    int P(F, p) : grad v dV = 0           P = P_iso(F) + p J F^-T
    int q (J - 1 - p / K)  dV = 0

for all v and q; without pressures p = K (J - 1) at every point. In axisymmetric space dV is
2 pi r dA, F_33 = 1 + u_r / r, and v_r / r works with P_33. Small strain: J - 1 is tr(F) - 3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from skfem import Basis, BilinearForm, LinearForm

from study.mechanics.element import function_space
from study.mechanics.element.function_space import Discretization, deformation_gradient
from study.mechanics.material.material import Material
from study.mechanics.mesh.structured import Mesh
from study.mechanics.setup.setup import Model
from tests.fem import reference_law

Array = np.ndarray


@dataclass(frozen=True)
class Point:
    """What a material answers at one F and p: P (3, 3), J - 1 and their derivatives by F."""

    P: Array
    growth: float
    dP: Array
    cofactor: Array


def volume(material: Material, F: Array) -> tuple[Any, Array]:
    """J - 1 and its derivative by F."""
    if material.small_strain:
        return np.trace(F) - 3, np.eye(3)
    return np.linalg.det(F) - 1, np.linalg.det(F) * np.linalg.inv(F).T


def isochoric(material: Material, F: Array) -> Array:
    """Stress that carries no pressure: 2 mu dev(eps) at small strain."""
    if not material.small_strain:
        return reference_law.stress(material, F)
    strain = 0.5 * (F + F.T) - np.eye(3)
    return 2 * material.mu0 * (strain - np.trace(strain) / 3 * np.eye(3))


def at_point(material: Material, F: Array, p: float | None) -> Point:
    """Answer of a material; ``p`` is None where the pressure is K (J - 1)."""

    def total(F: Array) -> Array:
        growth, cofactor = volume(material, F)
        pressure = material.bulk * growth if p is None else p
        return isochoric(material, F) + pressure * cofactor

    step = 1e-30
    dP = np.empty((3, 3, 3, 3))
    for k, m in np.ndindex(3, 3):
        D = np.zeros((3, 3), complex)
        D[k, m] = 1j * step
        dP[:, :, k, m] = total(F + D).imag / step
    growth, cofactor = volume(material, F)
    return Point(total(F).real, float(growth), dP, cofactor)


def pressure_shape(space: Discretization) -> Array:
    """Shape functions of the pressures, one row an element."""
    return np.broadcast_to(
        space.pressure_shape, (space.n_elements, *space.pressure_shape.shape[1:])
    )


@dataclass(frozen=True)
class Formulation:
    """Bases of displacement and pressure, and the states of all quadrature points."""

    space: Discretization
    u: Basis
    p: Basis | None
    around: Array
    states: dict[str, Array]
    compliance: float

    @classmethod
    def of(
        cls, mesh: Mesh, model: Model, space: Discretization, material: Material, x: Array
    ) -> Formulation:
        """State of every quadrature point at unknowns ``x``."""
        axisymmetric = model.space == "axisymmetric"
        rule = function_space._RULES[(model.space, model.element_order, model.element_shape)]
        basis = function_space.basis_of(mesh, model, rule)
        n = space.n_displacement
        F = deformation_gradient(space, x[:n].reshape(-1, space.dim))
        pressures = x[space.dofs[:, space.dim * space.element_nodes.shape[1] :]]
        mixed = pressures.shape[1] > 0
        field = np.einsum("ek,eqk->eq", pressures, pressure_shape(space))
        points = [
            [at_point(material, F[:, :, e, q], field[e, q] if mixed else None)
             for q in range(F.shape[3])] for e in range(F.shape[2])
        ]  # fmt: skip
        states = {
            name: np.moveaxis(np.array([[getattr(one, name) for one in row] for row in points]),
                              (0, 1), (-2, -1))
            for name in ("P", "growth", "dP", "cofactor")
        }  # fmt: skip
        radius = np.asarray(basis.global_coordinates())[0]
        around = radius if axisymmetric else np.full(radius.shape, np.inf)
        measure = {"dV": 2 * np.pi * radius if axisymmetric else np.ones(radius.shape)}
        compliance = 1 / material.bulk if mixed and np.isfinite(material.bulk) else 0.0
        return cls(space, basis, None, around, {**states, **measure, "p": field}, compliance)

    def _data(self, **more: Array) -> dict[str, Array]:
        return {**self.states, "r": self.around, **more}

    def forces(self) -> Array:
        """Residual of the displacements, node by node."""
        dim = self.space.dim
        out = np.empty((self.space.n_displacement // dim, dim))
        for i in range(dim):

            @LinearForm
            def work(v: Any, w: Any, i: int = i) -> Any:
                """int P_ij dv_i/dx_j, and P_33 v_r / r around the axis."""
                value = sum(w["P"][i, j] * v.grad[j] for j in range(dim))
                hoop = w["P"][2, 2] * v / w["r"] if i == 0 else 0.0
                return (value + hoop) * w["dV"]

            out[:, i] = work.assemble(self.u, **self._data())
        return out.ravel()

    def volumes(self) -> Array:
        """Residual of the pressures: int q (J - 1 - p / K)."""
        s = self.states
        density = (s["growth"] - self.compliance * s["p"]) * s["dV"] * np.asarray(self.u.dx)
        local = np.einsum("eq,eqk->ek", density, pressure_shape(self.space))
        out = np.zeros(self.space.n)
        first = self.space.dim * self.space.element_nodes.shape[1]
        np.add.at(out, self.space.dofs[:, first:], local)
        return out[self.space.n_displacement :]

    def stiffness(self) -> sp.csr_matrix:
        """Derivative of the displacements' residual by the displacements."""
        dim = self.space.dim
        blocks = []
        for i in range(dim):
            row = []
            for k in range(dim):

                @BilinearForm
                def tangent(u: Any, v: Any, w: Any, i: int = i, k: int = k) -> Any:
                    """int dv_i/dx_j A_ijkl du_k/dx_l, with v_r / r and u_r / r as a third row."""
                    test = [(i, j, v.grad[j]) for j in range(dim)]
                    trial = [(k, j, u.grad[j]) for j in range(dim)]
                    test += [(2, 2, v / w["r"])] if i == 0 else []
                    trial += [(2, 2, u / w["r"])] if k == 0 else []
                    return (
                        sum(a * w["dP"][m, n, o, q] * b for m, n, a in test for o, q, b in trial)
                        * w["dV"]
                    )

                row.append(tangent.assemble(self.u, **self._data()))
            blocks.append(row)
        # unknown i of node a stands at dim a + i
        whole = sp.csr_matrix(sp.bmat(blocks))
        n = self.space.n_displacement // dim
        order = (np.arange(n)[:, None] + n * np.arange(dim)).ravel()
        return whole[order][:, order]

    def coupling(self) -> Array:
        """Derivative of the pressures' residual by the displacements, dense."""
        dim, space = self.space.dim, self.space
        cofactor, first = self.states["cofactor"], dim * space.element_nodes.shape[1]
        local = np.einsum("ijeq,eqaj->eqai", cofactor[:dim, :dim], space.gradients)
        if dim == 2:
            local[..., 0] += np.einsum("eq,eqa->eqa", cofactor[2, 2], space.hoop)
        weight = self.states["dV"] * np.asarray(self.u.dx)
        shape = pressure_shape(space)
        found = np.einsum("eq,eqk,eqai->ekai", weight, shape, local)
        out = np.zeros((space.n, space.n_displacement))
        if shape.shape[2] == 0:
            return out[space.n_displacement :]
        rows, columns = space.dofs[:, first:], space.dofs[:, :first]
        np.add.at(out, (rows[:, :, None], columns[:, None, :]), found.reshape(*rows.shape, -1))
        return out[space.n_displacement :]
