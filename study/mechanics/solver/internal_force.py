"""Internal forces of the elements: residual, tangent and what they owe to each constant.

The only place that knows which compiled loop a material needs; the system of equations
sees vectors of unknowns and the sum of the tangents.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from study.ground.arrays import Array, Elements, Flags, Unknowns
from study.ground.compilation import smallest
from study.mechanics.contact.contact import ContactPoints
from study.mechanics.element import assembly
from study.mechanics.element.assembly import ElementEnergy, Sums, stored_energy
from study.mechanics.element.function_space import (
    Discretization,
    Pattern,
    Slabs,
    slabs,
    symmetric_product,
)
from study.mechanics.material.energy import Law, PointLaw
from study.mechanics.material.material import Material

#: bound of the local bulk modulus over the shear modulus. A coarse cone 2 mm deep is 0.5 % too
#: stiff with none, 0.9 % with this one, 1.1 % with 10; neo-Hookean under a flat end goes on to its
#: radius with 5 and 10, not (in 420 s, kappa 1000 mu0) with 3
LOCAL_BULK = 5.0

#: kappa over the shear modulus, of linear simplices, whose bubbles collapse without it
EVENNESS = 20.0

#: kappa over the shear modulus, of quadratic tetrahedra: a softening energy under a cone stops at
#: 3.2 to 3.4 mm of 4 with 100 (local bulk bounds of 0 to 3 mu0) and gets there with 500 and 1000;
#: with any of them a neo-Hookean one has the same force at 2 mm within 0.01 %
EVENNESS_OF_SOLIDS = 500.0

#: rounding of a stress over the shear modulus; that of nodal forces was 0.8 to 1.3 times what one
#: unit in the last place of 1 makes of them
_ROUNDED = 4 * float(np.finfo(float).eps)

#: stands for a volume measure that is not positive, where that means nothing
_SMALLEST = 1e-6

#: where no tangent is asked for
_NOWHERE = Sums(np.zeros((0, 0), np.int32), np.zeros(0), np.zeros(0, np.int32), np.zeros((0, 0)))


class StoredEnergy(NamedTuple):
    """Energy of the elements, N mm."""

    material: float
    #: Of the resistance to uneven volume, which is none of the material's.
    stabilization: float
    #: Potential energy of the weight, less what the specimen had of all kinds when it had sagged
    #: and was not yet touched: the work of the test begins there.
    raised: float = 0.0

    @property
    def total(self) -> float:
        """What the work of the test goes into."""
        return self.material + self.stabilization + self.raised


class BulkSplit(NamedTuple):
    """Parts of a bulk modulus: the local one in MPa, and the pressures' 1 / K in 1/MPa."""

    local: float
    compliance: float


def split_bulk(bulk: float, bound: float) -> BulkSplit:
    """Local bulk modulus K_l = K B / (K + B) at each point, K - K_l through the pressures.

    The energy of volume is K_l / 2 (J - 1)^2 + p (J - 1) - p^2 / (2 (K - K_l)): in the
    continuum K / 2 (J - 1)^2 whatever K_l is. K_l is below K, and below the bound B however
    large K becomes: a local modulus that grows with K asks every quadrature point to keep its
    volume, which is more than a quadratic element can do, and locks it. For K infinite it is
    the penalty of an augmented Lagrangian, which vanishes where J = 1.

    Units: bulk, bound MPa.
    """
    if not np.isfinite(bulk):
        return BulkSplit(bound, 0.0)
    return BulkSplit(bulk * bound / (bulk + bound), (1 + bound / bulk) / bulk)


def split_bulk_rate(bulk: float, bound: float, bulk_rate: float, bound_rate: float) -> BulkSplit:
    """Rates of :func:`split_bulk` where K and B have rates.

    Units: bulk_rate, bound_rate MPa.
    """
    if not np.isfinite(bulk):
        return BulkSplit(bound_rate, 0.0)
    ratio = bound / bulk
    local = (bound_rate + ratio**2 * bulk_rate) / (1 + ratio) ** 2
    return BulkSplit(local, (bound_rate - (1 + 2 * ratio) * bulk_rate) / bulk**2)


def _element_energy(law: Law, bulk: BulkSplit, evenness: float) -> ElementEnergy:
    # a plain number: the kernels would be compiled once more for an enumeration
    return ElementEnergy(int(law.kind), law.constants, bulk.local, bulk.compliance, evenness)


@dataclass
class Internal:
    """Element residuals on one discretization, overwritten by each evaluation."""

    space: Discretization
    #: Elements that may be worked on at once, see :mod:`study.mechanics.element.function_space`.
    phases: tuple[Slabs, ...]
    #: shape (n_elements, m); of the last evaluation.
    residuals: Array
    #: Largest local bulk modulus over the shear modulus, see :func:`split_bulk`; 0 for none.
    local_bulk: float = 0.0
    #: Resistance to uneven volume within an element over the shear modulus, see
    #: :mod:`study.mechanics.element.assembly`.
    evenness: float = 0.0
    #: The last material, and what the compiled loops are told of it.
    last_energy: tuple[Material, ElementEnergy] | None = None

    @classmethod
    def on(cls, space: Discretization, local_bulk: float = 0.0, evenness: float = 0.0) -> Internal:
        """Take the memory for a discretization."""
        return cls(space, slabs(space), np.full(space.dofs.shape, 0.0), local_bulk, evenness)

    @cached_property
    def rounding_mm2(self) -> float:
        """Norm of the nodal forces of a stress of :data:`_ROUNDED` everywhere, mm^2 (N per MPa).

        F is 1 + du/dX, so that stresses over the shear modulus have this error at any small strain.
        """
        space = self.space
        shares = np.einsum("eqad,eq->ead", np.abs(space.gradients), space.weights)
        of_nodes = np.zeros((len(space.nodes), space.dim))
        np.add.at(of_nodes, space.element_nodes, shares)
        return _ROUNDED * float(np.linalg.norm(of_nodes))

    def evaluate(self, material: Material, x: Array, into: Tangent | None = None) -> float:
        """Residuals at unknowns ``x``, shape (n,), and tangents where asked; return the smallest J.

        Where it is not positive nothing else is valid. For small strain it is the smallest
        1 + tr(eps), kept above zero: a linear body cannot be inverted.
        """
        energy = self._energy(material)
        if into is not None:
            into.data[:] = 0.0
        min_j = self._elements(x, energy, into)
        return max(min_j, _SMALLEST) if material.small_strain else min_j

    def stored(self, material: Material, x: Array) -> StoredEnergy:
        """Energy that all elements store at unknowns ``x``, shape (n,)."""
        shapes, energy = self.space.shapes, self._energy(material)
        out = np.zeros((self.space.n_elements, 2))
        smallest(self.phases, lambda e: float(stored_energy(e, shapes, energy, x, out)))
        return StoredEnergy(*(float(part) for part in out.sum(axis=0)))

    def _energy(self, material: Material) -> ElementEnergy:
        """Return what the compiled loops are told of a material."""
        if self.last_energy is None or self.last_energy[0] is not material:
            uneven = self._unevenness(material, material.mu0)
            energy = _element_energy(material.law(), self.split(material), uneven)
            self.last_energy = material, energy
        return self.last_energy[1]

    def split(self, material: Material) -> BulkSplit:
        """Bulk modulus at every quadrature point, and compliance of the pressures."""
        K = material.bulk
        if not self._mixed:
            return BulkSplit(K if np.isfinite(K) else 0.0, 0.0)
        return split_bulk(K, self.local_bulk * material.mu0)

    @property
    def _mixed(self) -> bool:
        """Whether there are pressure unknowns."""
        return bool(self.space.pressure_shape.shape[2] > 0)

    def gathered(self) -> Array:
        """Sum of the element residuals, shape (n,)."""
        out = np.empty(self.space.n)
        assembly.gathered(self.space.dofs, self.residuals, out)
        return out

    def volume_ratios(self, material: Material, x: Array) -> Array:
        """J at every quadrature point, shape (n_elements, n_quadrature); 1 for small strain.

        It shows elements about to be inverted. A linear body has no such elements.
        """
        J = np.ones(self.space.weights.shape)
        if not material.small_strain:
            shapes = self.space.shapes
            smallest(self.phases, lambda e: float(assembly.volume_ratios(e, shapes, x, J)))
        return J

    def uneven_volume(self, material: Material, x: Array) -> tuple[float, float]:
        """Volume ratio that pressures do not explain, J - 1 - p / K, and its energy, N mm.

        The first is the root mean square, the second the integral of its square times the shear
        modulus. Both vanish in the limit of small elements: within one that is too large for the
        deformation only its mean is held. Nothing without pressures, nor at small strain.
        """
        if material.small_strain or not self._mixed:
            return 0.0, 0.0
        explained = self.split(material).compliance * self.space.pressures(x)
        square = (self.volume_ratios(material, x) - 1 - explained) ** 2
        mean = float(np.average(square, weights=self.space.weights))
        return math.sqrt(mean), material.mu0 * mean * float(self.space.weights.sum())

    def constant_derivative(self, material: Material, x: Array, name: str) -> Array:
        """dR/dconstant at fixed unknowns, shape (n,), K(nu) included; tangents are kept."""
        without_pressure = x.copy()
        without_pressure[self.space.n_displacement :] = 0.0
        uneven = self._unevenness(material, material.mu0_gradient()[name])
        energy = _element_energy(material.law_rate(name), BulkSplit(0.0, 0.0), uneven)
        self._elements(without_pressure, energy)
        out = self.gathered()
        out[self.space.n_displacement :] = 0.0
        return out + self._volume_derivative(material, x, name)

    def _unevenness(self, material: Material, mu: float) -> float:
        """Resistance to uneven volume where ``mu`` is the shear modulus, or its rate.

        None at small strain, which has no limit points.
        """
        return 0.0 if material.small_strain else self.evenness * mu

    def _volume_derivative(self, material: Material, x: Array, name: str) -> Array:
        """Part of dR/dconstant that stems from the bulk modulus and its split, shape (n,).

        Residuals are linear in the local bulk modulus and in the compliance.
        """
        rate = BulkSplit(material.bulk_gradient()[name], 0.0)
        if self._mixed:
            c, shear_rate = self.local_bulk, material.mu0_gradient()[name]
            rate = split_bulk_rate(material.bulk, c * material.mu0, rate.local, c * shear_rate)
        out = np.zeros(self.space.n)
        if not any(rate):
            return out

        # a law without isochoric stress whose constants have the material's shape: a function of
        # the invariants becomes the polynomial, for some divide by a limit of their stretches
        kind, constants = material.law()
        kind = PointLaw.POLYNOMIAL if kind >= PointLaw.POLYNOMIAL else kind
        zero = Law(kind, np.zeros_like(constants))

        def residual(local: float, compliance: float) -> Array:
            self._elements(x, _element_energy(zero, BulkSplit(local, compliance), 0.0))
            return self.gathered()

        plain = residual(0.0, 0.0)
        if rate.local:
            out += rate.local * (residual(1.0, 0.0) - plain)
        if rate.compliance:
            out += rate.compliance * (residual(0.0, 1.0) - plain)
        return out

    def _elements(self, x: Array, energy: ElementEnergy, into: Tangent | None = None) -> float:
        shapes, sums = self.space.shapes, _NOWHERE if into is None else into.sums

        def loop(elements: Elements) -> float:
            assembled = assembly.assemble(
                elements, shapes, energy, x, self.residuals, into is not None, sums
            )
            return float(assembled)

        return smallest(self.phases, loop)


@dataclass
class Tangent:
    """Tangent of a discretization, overwritten by each assembly."""

    #: Free unknowns, and where packed entries go.
    pattern: Pattern
    #: shape (n_elements, m); unknowns of each element.
    dofs: Unknowns
    #: shape (n_kept,); elements with constrained unknowns.
    edge: Unknowns
    #: Entries of the pattern, and what is kept of those elements.
    sums: Sums
    #: Entries of the elements alone, where contact has added its own to the others.
    elastic: Array = field(default_factory=lambda: np.zeros(0))
    #: State that it was assembled at, drag apart; None before the first.
    state: object = None

    @classmethod
    def of(cls, pattern: Pattern, dofs: Unknowns) -> Tangent:
        """Take the memory for the elements' unknowns ``dofs``."""
        # filled, since zeros alone are memory that is only promised until it is written to
        data = np.full(pattern.indices.size, 0.0)
        edge = np.flatnonzero((pattern.number[dofs] < 0).any(axis=1)).astype(np.int32)
        slots = np.full(len(dofs), -1, dtype=np.int32)
        slots[edge] = np.arange(edge.size, dtype=np.int32)
        values = np.full((edge.size, pattern.positions.shape[1]), 0.0)
        return cls(pattern, dofs, edge, Sums(pattern.positions, data, slots, values))

    @property
    def data(self) -> Array:
        """Entries of the pattern, shape (n_entries,); contact adds its own to them."""
        return self.sums.data

    def product(self, v: Array, data: Array | None = None) -> Array:
        """Tangent times ``v``, shape (n,), constrained rows and columns included."""
        out, entries = self.constrained_product(v), self.data if data is None else data
        free, pattern = self.pattern.free, self.pattern
        out[free] += symmetric_product(pattern.indptr, pattern.indices, entries, v[free])
        return out

    def constrained_product(self, v: Array) -> Array:
        """Product with the entries of constrained rows and columns alone, shape (n,)."""
        out = np.zeros(v.size)
        assembly.constrained_product(
            self.edge, self.dofs, self.pattern.positions, self.sums.packed, v, out
        )
        return out


@dataclass
class ContactBlocks:
    """Tangents of contact points: small blocks among the entries of the elements."""

    points: ContactPoints
    #: shape (n_points, m); unknowns of each point.
    dofs: Unknowns
    #: shape (n_points, m (m + 1) / 2); entry of the pattern of each packed one; negative where a
    #: constrained unknown takes part.
    positions: Unknowns
    #: shape (n_points, m (m + 1) / 2); upper triangles.
    packed: Array
    _inside: Flags
    _edge: Unknowns

    @classmethod
    def of(
        cls, contact: Iterable[ContactPoints], dim: int, pattern: Pattern
    ) -> tuple[ContactBlocks, ...]:
        """Take the memory for each set of contact points."""
        blocks = []
        for points in contact:
            dofs = points.dofs(dim)
            positions = pattern.locate(dofs)
            inside = positions >= 0
            edge = np.flatnonzero(~inside.all(axis=1)).astype(np.int32)
            packed = np.zeros(positions.shape)
            each = dofs.astype(np.int32), positions, packed, inside, edge
            blocks.append(cls(points, *each))
        return tuple(blocks)

    def fill(self, packed: Array, data: Array) -> None:
        """Add blocks to the entries of a pattern."""
        self.packed[:] = packed
        np.add.at(data, self.positions[self._inside], packed[self._inside])

    def add_constrained(self, v: Array, out: Array) -> None:
        """Add the product with the entries of constrained rows and columns alone."""
        values = self.packed[self._edge]
        assembly.constrained_product(self._edge, self.dofs, self.positions, values, v, out)
