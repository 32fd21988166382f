"""A material with numbers: an energy, its constants and its compressibility."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from study.arrays import Array
from study.errors import Fault, InputError, nearest
from study.material.compressibility import Compressibility
from study.material.energy import CompressibleEnergy, Energy, IsochoricEnergy, Law
from study.material.registry import energy_named
from study.material.relaxation import RelaxationTerm, faults, long_term_share


@dataclass(frozen=True)
class Material:
    """One material; exactly one of the three ways to give its compressibility.

    Parameters
    ----------
    model : str
        Name of the energy (see :data:`study.material.registry.MODELS`).
    constants : mapping of str to float
        Constants in MPa (exponents plain), put in the energy's own order.
    bulk_modulus : float, optional
        K in MPa, of U = K/2 (J - 1)^2.
    poisson_ratio : float, optional
        Initial Poisson's ratio; K then follows mu0 whenever the constants change.
    incompressible : bool
        K is infinite.
    relaxation : tuple of RelaxationTerm
        How the isochoric stress fades; the constants are then those of a load that comes at once.

    Raises
    ------
    InputError
        If a constant is unknown, missing or not finite, or the compressibility is not given
        exactly once and in its range. Values that merely make an unstable material are let
        through, because a fit may pass over them: see :func:`study.material.stability.check`.
    """

    model: str
    constants: Mapping[str, float]
    bulk_modulus: float | None = None
    poisson_ratio: float | None = None
    incompressible: bool = False
    relaxation: tuple[RelaxationTerm, ...] = ()

    def __post_init__(self) -> None:
        found = [*_constant_faults(self.energy, self.constants), *self.compressibility.faults()]
        found += faults(self.relaxation)
        energy = self.energy
        if isinstance(energy, CompressibleEnergy) and self.poisson_ratio is None:
            found.append(energy.without_poisson_ratio())
        if found:
            raise InputError(found)
        names = self.energy.ordered(self.constants)
        object.__setattr__(self, "constants", {n: float(self.constants[n]) for n in names})

    @property
    def energy(self) -> Energy:
        """The energy, without numbers."""
        return energy_named(self.model)

    @property
    def isochoric(self) -> IsochoricEnergy:
        """The energy of a hyperelastic material.

        Raises
        ------
        TypeError
            If the material is one of small strain.
        """
        energy = self.energy
        if not isinstance(energy, IsochoricEnergy):
            raise TypeError(f"{self.model} has no energy of isochoric principal stretches")
        return energy

    @property
    def compressible(self) -> CompressibleEnergy | None:
        """The energy, if its volume change belongs to all of it."""
        energy = self.energy
        return energy if isinstance(energy, CompressibleEnergy) else None

    @property
    def small_strain(self) -> bool:
        """Whether the stress is linear in the displacement gradient."""
        return self.energy.small_strain

    @property
    def compressibility(self) -> Compressibility:
        """How it resists a change of volume."""
        return Compressibility(self.bulk_modulus, self.poisson_ratio, self.incompressible)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the constants, in order."""
        return tuple(self.constants)

    @property
    def values(self) -> Array:
        """Constants as an array, shape (p,), in the order of :attr:`names`."""
        return np.array(list(self.constants.values()))

    @property
    def mu0(self) -> float:
        """Initial shear modulus in MPa: 2 (C10 + C01), sum mu_i, or E / 2(1 + nu)."""
        return self.energy.initial_shear_modulus(self.constants, self.compressibility)

    @property
    def long_term_mu(self) -> float:
        """Shear modulus at small strain after all relaxation, MPa."""
        return self.mu0 * long_term_share(self.relaxation)

    def mu0_gradient(self) -> dict[str, float]:
        """Differentiate mu0 with respect to every constant."""
        return self.energy.initial_shear_modulus_gradient(self.constants, self.compressibility)

    @property
    def bulk(self) -> float:
        """Bulk modulus K in MPa; infinite if incompressible."""
        return self.compressibility.bulk(self.mu0)

    def bulk_gradient(self) -> dict[str, float]:
        """dK/dconstant: zero unless K follows mu0 at a given Poisson's ratio."""
        if self.poisson_ratio is None:
            return dict.fromkeys(self.constants, 0.0)
        ratio = self.compressibility.bulk_over_shear
        return {n: ratio * g for n, g in self.mu0_gradient().items()}

    def law(self) -> Law:
        """Return the compiled law of the isochoric stress."""
        return self.energy.law(self.constants, self.compressibility)

    def law_rate(self, name: str) -> Law:
        """Return the law whose stress is the derivative of the isochoric stress by a constant."""
        return self.energy.law_rate(self.constants, self.compressibility, name)

    def with_constants(self, constants: Mapping[str, float] | ArrayLike) -> Material:
        """Return the same material with other constants: a mapping, or values in order."""
        if isinstance(constants, Mapping):
            return replace(self, constants={**self.constants, **constants})
        values = np.asarray(constants, dtype=float)
        if values.shape != (len(self.names),):
            raise InputError(f"{self.model} takes {len(self.names)} constants, got {values.size}")
        return replace(self, constants=dict(zip(self.names, values.tolist(), strict=True)))


def _constant_faults(energy: Energy, constants: Mapping[str, float]) -> list[Fault]:
    faults = []
    for name, value in constants.items():
        if not energy.has_constant(name):
            valid = nearest(name, energy.constant_names(2 if energy.has_order else 1))
            faults.append(Fault(f"material.{name}", f"is no constant of {energy.name}", valid))
        elif not math.isfinite(value):
            faults.append(Fault(f"material.{name}", f"must be finite, got {value}"))
    if faults:
        return faults
    if not energy.sparse:
        # of the highest term present, and all below
        needed = energy.constant_names(max(1, energy.order_of(constants)))
        rule = f"{energy.name} needs it: got {', '.join(constants) or 'none'}"
        faults = [Fault(f"material.{n}", rule) for n in needed if n not in constants]
    if not faults and not constants:
        faults.append(Fault("material", f"{energy.name} needs at least one constant"))
    return faults
