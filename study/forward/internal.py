"""Internal forces of the elements: residual, tangent and what they owe to each constant.

The only place that knows which compiled loop a material needs; the system of equations
sees vectors of unknowns and packed element tangents.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from study.forward import kernels
from study.forward.elements import Discretization
from study.material import Material

Array = NDArray[np.float64]


@dataclass
class Internal:
    """Element residuals and tangents on one discretization, overwritten by each evaluation.

    Parameters
    ----------
    space : Discretization
        Shape-function arrays.
    residuals : ndarray, shape (n_elements, m)
        Of the last evaluation.
    tangents : ndarray, shape (n_elements, m (m + 1) / 2)
        Packed upper triangles of the last evaluation that asked for them.
    """

    space: Discretization
    residuals: Array
    tangents: Array

    @classmethod
    def on(cls, space: Discretization) -> Internal:
        """Take the memory for a discretization."""
        m = space.dofs.shape[1]
        return cls(
            space, np.zeros((space.n_elements, m)), np.zeros((space.n_elements, m * (m + 1) // 2))
        )

    def evaluate(self, material: Material, x: Array, *, tangent: bool) -> float:
        """Fill the element arrays at unknowns ``x``, shape (n,); return the smallest J.

        Where it is not positive nothing else is valid.
        """
        K = material.bulk
        finite = K if np.isfinite(K) else 0.0
        return self._elements(x, material.coefficient_table(), tangent, finite, 1 / K)

    def gathered(self) -> Array:
        """Sum of the element residuals, shape (n,)."""
        dofs, values = self.space.dofs.ravel(), self.residuals.ravel()
        return np.bincount(dofs, values, minlength=self.space.n).astype(float)

    def scatter(self, positions: NDArray[np.int32], data: Array) -> None:
        """Put the sum of the element tangents into the entries of a sparsity pattern."""
        kernels.scatter(positions, self.tangents.ravel(), data)

    def product(self, v: Array) -> Array:
        """Tangent times ``v``, shape (n,), constrained rows and columns included."""
        out = np.empty(self.space.n)
        kernels.packed_product(self.space.dofs, self.tangents, v, out)
        return out

    def volume_ratios(self, material: Material, x: Array) -> Array:
        """J at every quadrature point, shape (n_elements, n_quadrature)."""
        del material
        J = np.empty(self.space.weights.shape)
        kernels.volume_ratios(self.space.gradients, self.space.hoop, self._local_u(x), J)
        return J

    def constant_derivative(self, material: Material, x: Array, name: str) -> Array:
        """dR/dconstant at fixed unknowns, shape (n,), K(nu) included; tangents are kept."""
        unit = np.zeros_like(material.coefficient_table())
        unit[material.table_index(name)] = 1.0
        without_pressure = x.copy()
        without_pressure[self.space.n_displacement :] = 0.0
        self._elements(without_pressure, unit, False, 0.0, 0.0)
        out = self.gathered()
        out[self.space.n_displacement :] = 0.0
        bulk_rate = material.bulk_gradient()[name]
        return out + bulk_rate * self._bulk_derivative(material, x) if bulk_rate else out

    def _bulk_derivative(self, material: Material, x: Array) -> Array:
        """dR/dK at fixed unknowns: p/K^2 N in the mixed form, (J - 1) dJ/dF in the other."""
        zero = np.zeros((1, 1))
        if self.space.pressure_shape.shape[2] == 0:
            self._elements(x, zero, False, 1.0, 0.0)
            return self.gathered()
        rates = []
        for compliance in (0.0, 1.0):
            self._elements(x, zero, False, 0.0, compliance)
            rates.append(self.gathered())
        return (rates[0] - rates[1]) / material.bulk**2

    def _elements(
        self, x: Array, table: Array, tangent: bool, bulk: float, compliance: float
    ) -> float:
        space = self.space
        return float(
            kernels.element_residuals(
                space.gradients,
                space.hoop,
                space.pressure_shape,
                space.weights,
                self._local_u(x),
                x[space.dofs[:, space.dim * space.element_nodes.shape[1] :]],
                table,
                bulk,
                compliance,
                tangent,
                self.residuals,
                self.tangents,
            )
        )

    def _local_u(self, x: Array) -> Array:
        u = x[: self.space.n_displacement].reshape(-1, self.space.dim)
        return np.ascontiguousarray(u[self.space.element_nodes])
