"""Internal forces of the elements: residual, tangent and what they owe to each constant.

The only place that knows which compiled loop a material needs; the system of equations
sees vectors of unknowns and packed element tangents.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from study.forward import kernels
from study.forward.elements import Discretization
from study.forward.pattern import Pattern
from study.forward.swell import add_unevenness
from study.forward.threads import side_by_side, smallest_in_slices
from study.material import Material

Array = NDArray[np.float64]


#: share of the bulk modulus that acts pointwise where elements need it: at a Poisson's ratio of
#: 0.4995 thirty shear moduli, too few to lock a quadratic element
POINTWISE = 0.03
#: kappa over the shear modulus: of linear simplices, whose bubbles collapse without it, and of
#: quadratic tetrahedra, whose surface wrinkles at the edge of a flat end
EVENNESS, EVENNESS_OF_SOLIDS = 20.0, 100.0
#: stands for a volume measure that is not positive, where that means nothing
_SMALLEST = 1e-6


@dataclass(frozen=True)
class Law:
    """What the compiled loop is told of an energy: a family and its array of constants."""

    family: int
    constants: Array


def law_of(material: Material) -> Law:
    """Constants of a material as the compiled loop takes them."""
    if material.family == "polynomial":
        return Law(kernels.POLYNOMIAL, material.coefficient_table())
    if material.family == "ogden":
        return Law(kernels.OGDEN, np.column_stack(material.ogden_terms()))
    return Law(kernels.LINEAR, np.array([[material.mu0]]))


def law_rate(material: Material, name: str) -> Law:
    """Law whose stress is the derivative of the isochoric stress by one constant."""
    if material.family == "polynomial":
        unit = np.zeros_like(material.coefficient_table())
        unit[material.table_index(name)] = 1.0
        return Law(kernels.POLYNOMIAL, unit)
    if material.family == "linear-elastic":
        return Law(kernels.LINEAR, np.array([[material.mu0_gradient()[name]]]))
    term = name.lstrip("mualph")
    mu, alpha = material.constants[f"mu{term}"], material.constants[f"alpha{term}"]
    if name.startswith("mu"):
        return Law(kernels.OGDEN, np.array([[1.0, alpha]]))
    return Law(kernels.OGDEN_BY_EXPONENT, np.array([[mu, alpha]]))


def without_shear(material: Material) -> Law:
    """Law of the same family whose isochoric stress vanishes."""
    law = law_of(material)
    return Law(law.family, np.zeros_like(law.constants))


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
    pointwise : float
        Share of the bulk modulus that acts on J at every quadrature point and not through the
        pressures. A mixed element resists a change of volume on average only: under a sharp
        indenter single points collapse to a third of their volume, and the surface buckles
        with them. The energy is the same.
    evenness : float
        Resistance to uneven volume within an element over the shear modulus, see
        :mod:`study.forward.swell`.
    """

    space: Discretization
    residuals: Array
    tangents: Array
    pointwise: float = 0.0
    evenness: float = 0.0

    @classmethod
    def on(cls, space: Discretization, pointwise: float = 0.0, evenness: float = 0.0) -> Internal:
        """Take the memory for a discretization."""
        n, m = space.n_elements, space.dofs.shape[1]
        # filled, since zeros alone are memory that is only promised until it is written to
        residuals, packed = np.full((n, m), 0.0), np.full((n, m * (m + 1) // 2), 0.0)
        return cls(space, residuals, packed, pointwise, evenness)

    def evaluate(self, material: Material, x: Array, *, tangent: bool) -> float:
        """Fill the element arrays at unknowns ``x``, shape (n,); return the smallest J.

        Where it is not positive nothing else is valid. For small strain it is the smallest
        1 + tr(eps), kept above zero: a linear body cannot be inverted.
        """
        law = law_of(material)
        everywhere, held = self._shares(material.bulk)
        min_j = self._elements(x, law, tangent, everywhere, 1 / held)
        if self._uneven(material) and min_j > 0:
            self._add_unevenness(material, x, self.evenness * material.mu0, tangent)
        return max(min_j, _SMALLEST) if law.family == kernels.LINEAR else min_j

    def _shares(self, K: float) -> tuple[float, float]:
        """Bulk modulus at every point, and that of the pressures."""
        if self.space.pressure_shape.shape[2] == 0:
            return (K if np.isfinite(K) else 0.0), K
        if not np.isfinite(K):
            return 0.0, K
        return self.pointwise * K, (1 - self.pointwise) * K

    def pointwise_bulk(self, material: Material) -> float:
        """Bulk modulus that acts on J at every quadrature point, MPa."""
        return self._shares(material.bulk)[0]

    def gathered(self) -> Array:
        """Sum of the element residuals, shape (n,)."""
        out = np.empty(self.space.n)
        kernels.gathered(self.space.dofs, self.residuals, out)
        return out

    def scatter(self, pattern: Pattern, data: Array) -> None:
        """Put the sum of the element tangents into the entries of a sparsity pattern."""
        positions = pattern.positions.reshape(self.tangents.shape)

        def add(group: NDArray[np.int32]) -> None:
            kernels.scatter(group, positions, self.tangents, data)

        data[:] = 0.0
        first, apart, between = pattern.groups
        side_by_side(partial(add, first), partial(add, apart), self.space.weights.size)
        add(between)

    def product(self, v: Array) -> Array:
        """Tangent times ``v``, shape (n,), constrained rows and columns included."""
        out = np.empty(self.space.n)
        kernels.packed_product(self.space.dofs, self.tangents, v, out)
        return out

    def volume_ratios(self, material: Material, x: Array) -> Array:
        """J at every quadrature point, shape (n_elements, n_quadrature); 1 for small strain.

        What it is compared with is whether elements are about to be inverted, of which a
        linear body knows nothing.
        """
        J = np.ones(self.space.weights.shape)
        if material.family == "linear-elastic":
            return J
        space = self.space

        def loop(e: slice) -> float:
            found = kernels.volume_ratios(space.gradients[e], space.hoop[e], space.dofs[e], x, J[e])
            return float(found)

        smallest_in_slices(J.shape, loop)
        return J

    def constant_derivative(self, material: Material, x: Array, name: str) -> Array:
        """dR/dconstant at fixed unknowns, shape (n,), K(nu) included; tangents are kept."""
        without_pressure = x.copy()
        without_pressure[self.space.n_displacement :] = 0.0
        self._elements(without_pressure, law_rate(material, name), False, 0.0, 0.0)
        out = self.gathered()
        out[self.space.n_displacement :] = 0.0
        bulk_rate, mu_rate = material.bulk_gradient()[name], material.mu0_gradient()[name]
        if self._uneven(material) and mu_rate:
            self.residuals[:] = 0.0
            self._add_unevenness(material, x, self.evenness * mu_rate, tangent=False)
            out += self.gathered()
        return out + bulk_rate * self._bulk_derivative(material, x) if bulk_rate else out

    def _uneven(self, material: Material) -> bool:
        """Whether uneven volume within an element is resisted; small strain has no limit point."""
        return self.evenness > 0 and material.family != "linear-elastic"

    def _add_unevenness(self, material: Material, x: Array, kappa: float, tangent: bool) -> None:
        """Add that resistance to the element arrays."""
        space, J = self.space, self.volume_ratios(material, x)
        add_unevenness(
            space.gradients,
            space.hoop,
            space.weights,
            space.dofs,
            x,
            J,
            kappa,
            tangent,
            self.residuals,
            self.tangents,
        )

    def _bulk_derivative(self, material: Material, x: Array) -> Array:
        """dR/dK at fixed unknowns: p/K^2 N in the mixed form, (J - 1) dJ/dF pointwise."""
        zero = without_shear(material)

        def residual(bulk: float, compliance: float) -> Array:
            self._elements(x, zero, False, bulk, compliance)
            return self.gathered()

        if self.space.pressure_shape.shape[2] == 0:
            return residual(1.0, 0.0)
        plain, share = residual(0.0, 0.0), self.pointwise
        out = (plain - residual(0.0, 1.0)) / ((1 - share) * material.bulk**2)
        return out + share * (residual(1.0, 0.0) - plain) if share else out

    def _elements(self, x: Array, law: Law, tangent: bool, bulk: float, compliance: float) -> float:
        space = self.space
        shared = space.pressure_shape.shape[0] == 1

        def loop(e: slice) -> float:
            return float(
                kernels.element_residuals(
                    space.gradients[e],
                    space.hoop[e],
                    space.pressure_shape if shared else space.pressure_shape[e],
                    space.weights[e],
                    space.dofs[e],
                    x,
                    law.family,
                    law.constants,
                    bulk,
                    compliance,
                    tangent,
                    self.residuals[e],
                    self.tangents[e],
                )
            )

        return smallest_in_slices(space.weights.shape, loop)
