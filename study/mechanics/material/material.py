"""A material with numbers: an energy, its constants and its compressibility."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from study.ground.arrays import Array
from study.ground.errors import Fault, InputError, nearest
from study.mechanics.material.energy import (
    Compressibility,
    CompressibleEnergy,
    Energy,
    IsochoricEnergy,
    Law,
)
from study.mechanics.material.exponential import Fung, VerondaWestmann
from study.mechanics.material.limiting_chain import ArrudaBoyce, Gent, VanDerWaals
from study.mechanics.material.linear_elastic import LinearElastic
from study.mechanics.material.ogden import ExtendedTube, Ogden, OgdenHill
from study.mechanics.material.polynomial import (
    MooneyRivlin,
    NeoHookean,
    Polynomial,
    ReducedPolynomial,
    Yeoh,
)
from study.mechanics.material.relaxation import (
    RelaxationTerm,
    faults,
    is_of_relaxation,
    long_term_share,
)

# Every energy by the name that a study file says.

ENERGIES: dict[str, Energy] = {
    energy.name: energy
    for energy in (
        LinearElastic(),
        NeoHookean(),
        MooneyRivlin(),
        ReducedPolynomial(),
        Polynomial(),
        Ogden(),
        Yeoh(),
        ArrudaBoyce(),
        Gent(),
        ExtendedTube(),
        VanDerWaals(),
        VerondaWestmann(),
        Fung(),
        OgdenHill(),
    )
}
MODELS: tuple[str, ...] = tuple(ENERGIES)


def energy_named(model: str) -> Energy:
    """Find an energy by its name."""
    if model not in ENERGIES:
        raise InputError(Fault("material.model", f"no energy {model!r}", nearest(model, MODELS)))
    return ENERGIES[model]


def constant_names(model: str, order: int | None = None) -> tuple[str, ...]:
    """Names of an energy's constants, in order."""
    energy = energy_named(model)
    terms = 1 if order is None else order
    if isinstance(terms, bool) or int(terms) != terms or not 1 <= terms <= 9:
        raise InputError(
            Fault("material.order", f"must be a whole number from 1 to 9, got {order!r}")
        )
    if not energy.has_order and order not in (None, 1):
        raise InputError(Fault("material.order", f"{model} has no order, got {order!r}"))
    return energy.constant_names(int(terms))


def is_constant(name: str) -> bool:
    """Whether any energy, or a relaxation, has a constant of this name."""
    is_declared = any(energy.has_constant(name) for energy in ENERGIES.values())
    return is_declared or is_of_relaxation(name)


def is_constant_key(key: str) -> bool:
    """Whether a study file may write this key for a constant of any energy."""
    return any(energy.has_key(key) for energy in ENERGIES.values())


@functools.cache
def is_dimensionless(name: str) -> bool:
    """Whether a constant, or its key in a study file, is a plain number in an energy that has it.

    A share or time of relaxation counts as one too: neither is a modulus.
    """
    if is_of_relaxation(name):
        return True
    having = (e for e in ENERGIES.values() if e.has_constant(name) or e.has_key(name))
    return any(energy.is_dimensionless(name) for energy in having)


def unit_shown(name: str) -> str:
    """Return the unit in which people are told a constant: kPa, s, or none of a plain number."""
    if is_of_relaxation(name):
        return "s" if name.startswith("time") else ""
    return "" if is_dimensionless(name) else "kPa"


@dataclass(frozen=True)
class Material:
    """One material; exactly one of the three ways to give its compressibility."""

    #: Name of the energy (see :data:`study.mechanics.material.material.MODELS`).
    model: str
    #: Constants in MPa (exponents plain), put in the energy's own order.
    constants: Mapping[str, float]
    #: K in MPa, of U = K/2 (J - 1)^2.
    bulk_modulus: float | None = None
    #: Initial Poisson's ratio; K then follows mu0 whenever the constants change.
    poisson_ratio: float | None = None
    incompressible: bool = False
    #: How the isochoric stress fades; the constants are then those of a load that comes at once.
    relaxation: tuple[RelaxationTerm, ...] = ()

    def __post_init__(self) -> None:
        wrong = [*_constant_faults(self.energy, self.constants), *self.compressibility.faults()]
        wrong += faults(self.relaxation)
        energy = self.energy
        if isinstance(energy, CompressibleEnergy) and self.poisson_ratio is None:
            wrong.append(energy.without_poisson_ratio())
        if wrong:
            raise InputError(wrong)
        names = self.energy.ordered(self.constants)
        object.__setattr__(self, "constants", {n: float(self.constants[n]) for n in names})

    @property
    def energy(self) -> Energy:
        """The energy, without numbers."""
        return energy_named(self.model)

    @property
    def isochoric(self) -> IsochoricEnergy:
        """The energy of a hyperelastic material."""
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
        return Compressibility(self.poisson_ratio, self.bulk_modulus, self.incompressible)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the constants, in order."""
        return tuple(self.constants)

    @property
    def values(self) -> Array:
        """Constants as an array, shape (p,), in the order of :attr:`names`."""
        return np.array(list(self.constants.values()))

    @functools.cached_property
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
