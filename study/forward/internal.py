"""Internal forces of the elements: residual, tangent and what they owe to each constant.

The only place that knows which compiled loop a material needs; the system of equations
sees vectors of unknowns and the sum of the tangents.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from study.forward import kernels
from study.forward.elements import Discretization
from study.forward.handed import Elements, Energy, Sums
from study.forward.slabs import Slabs, slabs
from study.forward.stored_energy import stored_energy
from study.forward.tangent import Tangent
from study.forward.threads import smallest
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
#: where no tangent is asked for
_NOWHERE = Sums(np.zeros((0, 0), np.int32), np.zeros(0), np.zeros(0, np.int32), np.zeros((0, 0)))


class StoredEnergy(NamedTuple):
    """Energy of the elements, N mm.

    Parameters
    ----------
    material : float
        Of the material.
    stabilization : float
        Of the resistance to uneven volume, which is none of the material's.
    """

    material: float
    stabilization: float

    @property
    def total(self) -> float:
        """What the work of the test goes into."""
        return self.material + self.stabilization


class Law(NamedTuple):
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
    """Element residuals on one discretization, overwritten by each evaluation.

    Parameters
    ----------
    space : Discretization
        Shape-function arrays.
    phases : tuple of tuple of ndarray of uint32
        Elements that may be worked on at once, see :mod:`study.forward.slabs`.
    residuals : ndarray, shape (n_elements, m)
        Of the last evaluation.
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
    phases: tuple[Slabs, ...]
    residuals: Array
    pointwise: float = 0.0
    evenness: float = 0.0

    @classmethod
    def on(cls, space: Discretization, pointwise: float = 0.0, evenness: float = 0.0) -> Internal:
        """Take the memory for a discretization."""
        return cls(space, slabs(space), np.full(space.dofs.shape, 0.0), pointwise, evenness)

    def evaluate(self, material: Material, x: Array, into: Tangent | None = None) -> float:
        """Residuals at unknowns ``x``, shape (n,), and tangents where asked; return the smallest J.

        Where it is not positive nothing else is valid. For small strain it is the smallest
        1 + tr(eps), kept above zero: a linear body cannot be inverted.
        """
        energy = self._energy(material)
        if into is not None:
            into.data[:] = 0.0
        min_j = self._elements(x, energy, into)
        return max(min_j, _SMALLEST) if energy.family == kernels.LINEAR else min_j

    def stored(self, material: Material, x: Array) -> StoredEnergy:
        """Energy that all elements store at unknowns ``x``, shape (n,)."""
        shapes, energy = self.space.shapes, self._energy(material)
        out = np.zeros((self.space.n_elements, 2))
        smallest(self.phases, lambda e: float(stored_energy(e, shapes, energy, x, out)))
        return StoredEnergy(*(float(part) for part in out.sum(axis=0)))

    def _energy(self, material: Material) -> Energy:
        """Return what the compiled loops are told of a material."""
        everywhere, held = self._shares(material.bulk)
        uneven = self._unevenness(material, material.mu0)
        return Energy(*law_of(material), everywhere, 1 / held, uneven)

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

    def volume_ratios(self, material: Material, x: Array) -> Array:
        """J at every quadrature point, shape (n_elements, n_quadrature); 1 for small strain.

        What it is compared with is whether elements are about to be inverted, of which a
        linear body knows nothing.
        """
        J = np.ones(self.space.weights.shape)
        if material.family != "linear-elastic":
            shapes = self.space.shapes
            smallest(self.phases, lambda e: float(kernels.volume_ratios(e, shapes, x, J)))
        return J

    def constant_derivative(self, material: Material, x: Array, name: str) -> Array:
        """dR/dconstant at fixed unknowns, shape (n,), K(nu) included; tangents are kept."""
        without_pressure = x.copy()
        without_pressure[self.space.n_displacement :] = 0.0
        uneven = self._unevenness(material, material.mu0_gradient()[name])
        self._elements(without_pressure, Energy(*law_rate(material, name), 0.0, 0.0, uneven))
        out = self.gathered()
        out[self.space.n_displacement :] = 0.0
        bulk_rate = material.bulk_gradient()[name]
        return out + bulk_rate * self._bulk_derivative(material, x) if bulk_rate else out

    def _unevenness(self, material: Material, mu: float) -> float:
        """Resistance to uneven volume where ``mu`` is the shear modulus, or its rate.

        None at small strain, which has no limit points.
        """
        return 0.0 if material.family == "linear-elastic" else self.evenness * mu

    def _bulk_derivative(self, material: Material, x: Array) -> Array:
        """dR/dK at fixed unknowns: p/K^2 N in the mixed form, (J - 1) dJ/dF pointwise."""
        zero = without_shear(material)

        def residual(bulk: float, compliance: float) -> Array:
            self._elements(x, Energy(*zero, bulk, compliance, 0.0))
            return self.gathered()

        if self.space.pressure_shape.shape[2] == 0:
            return residual(1.0, 0.0)
        plain, share = residual(0.0, 0.0), self.pointwise
        out = (plain - residual(0.0, 1.0)) / ((1 - share) * material.bulk**2)
        return out + share * (residual(1.0, 0.0) - plain) if share else out

    def _elements(self, x: Array, energy: Energy, into: Tangent | None = None) -> float:
        shapes, sums = self.space.shapes, _NOWHERE if into is None else into.sums

        def loop(elements: Elements) -> float:
            found = kernels.assemble(
                elements, shapes, energy, x, self.residuals, into is not None, sums
            )
            return float(found)

        return smallest(self.phases, loop)
