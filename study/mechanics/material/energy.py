"""What an energy has to say: its constants, its stresses, and what other rooms ask of it.

Strain energies are per unit reference volume, of isochoric invariants or principal stretches
(Holzapfel 2000, eqs. 6.79-6.119; Ogden 1972). Every hyperelastic one has the volumetric part
U = K/2 (J - 1)^2 besides. One class is one energy, without numbers: those of a
:class:`study.mechanics.material.material.Material` are handed to its methods.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, ClassVar, NamedTuple

import numpy as np

from study.ground.arrays import Array
from study.ground.declaration import Bad, Reads, flag, number, quantity, section
from study.ground.errors import Fault

# How a material resists a change of volume, U = K/2 (J - 1)^2.


def _poisson_ratio(value: object) -> float:
    if value == 0.5 and not isinstance(value, bool):
        raise Bad("must be below 0.5, got 0.5", "write incompressible = true")
    return number(-1.0, 0.5)(value)


@section
class Compressibility:
    """How a material resists a change of volume; one of the three."""

    #: Initial one; K then follows the initial shear modulus.
    poisson_ratio: Annotated[float | None, Reads(_poisson_ratio, "number")] = None
    bulk_modulus_MPa: Annotated[float | None, Reads(quantity("pressure"), "pressure")] = None
    incompressible: Annotated[bool, Reads(flag)] = False

    @property
    def bulk_over_shear(self) -> float:
        """K / mu0 at a given Poisson's ratio; infinite without one."""
        nu = self.poisson_ratio
        return math.inf if nu is None else 2 * (1 + nu) / (3 * (1 - 2 * nu))

    def bulk(self, shear_modulus: float) -> float:
        """K in MPa where the initial shear modulus is ``shear_modulus``; may be infinite."""
        if self.incompressible:
            return math.inf
        if self.bulk_modulus_MPa is not None:
            return self.bulk_modulus_MPa
        return self.bulk_over_shear * shear_modulus

    def faults(self) -> list[Fault]:
        """Return what is wrong: not one of the three, or out of range."""
        bulk, nu = self.bulk_modulus_MPa, self.poisson_ratio
        given = (bulk is not None) + (nu is not None) + bool(self.incompressible)
        if given != 1:
            rule = "give exactly one of bulk_modulus, poisson_ratio and incompressible = true"
            return [Fault("material", f"{rule}; got {given}")]
        if bulk is not None and not (math.isfinite(bulk) and bulk > 0):
            return [Fault("material.bulk_modulus", f"must be positive and finite, got {bulk}")]
        if nu is not None and not -1 < nu < 0.5:
            rule = f"must be above -1 and below 0.5, got {nu}"
            mend = "use incompressible = true for 0.5" if nu == 0.5 else ""
            return [Fault("material.poisson_ratio", rule, mend)]
        return []


def poisson_from_bulk(mu0: float, bulk_modulus: float) -> float:
    """Poisson's ratio from the initial shear modulus and K (infinite K gives 0.5).

    Units: mu0 MPa; bulk_modulus MPa.
    """
    ratio = mu0 / bulk_modulus
    return (3 - 2 * ratio) / (2 * (3 + ratio))


#: Constants by name, MPa; exponents and limits plain.
Constants = Mapping[str, float]

Bounds = tuple[float, float]
FREE: Bounds = (-math.inf, math.inf)
POSITIVE: Bounds = (0.0, math.inf)


class PointLaw(IntEnum):
    """Compiled laws of :mod:`study.mechanics.element.point_law`.

    From ``POLYNOMIAL`` on they are functions of the isochoric invariants, and differ in nothing
    but the derivatives of W by these. A law of the first invariant alone has constants with one
    column, all others with more.
    """

    SMALL_STRAIN = 0
    OGDEN = 1
    OGDEN_BY_EXPONENT = 2
    EXTENDED_TUBE = 3
    POLYNOMIAL = 4
    EXPONENTIAL = 5
    FINITE_EXTENSIBILITY = 6
    VAN_DER_WAALS = 7
    VAN_DER_WAALS_BY_MIXTURE = 8


class Law(NamedTuple):
    """What the compiled loop is told of an energy: its law, and constants as that takes them."""

    kind: PointLaw
    #: shape (n, k)
    constants: Array


class Energy(ABC):
    """One energy; ``constants`` of a method are complete and in MPa."""

    #: What a study file says.
    name: ClassVar[str]
    #: Whether stress is linear in the displacement gradient and contact belongs to the
    #: reference state.
    small_strain: ClassVar[bool] = False
    #: Whether it is an isochoric part and K/2 (J - 1)^2, which finite elements need.
    splits: ClassVar[bool] = True
    #: Whether the number of terms is the user's choice.
    has_order: ClassVar[bool] = False
    #: Whether constants may be left out (they are then zero).
    sparse: ClassVar[bool] = False
    #: Keys of a study file that hold a list, one entry a term; empty where each constant has
    #: a key of its own.
    list_keys: ClassVar[tuple[str, ...]] = ()
    #: The initial shear modulus in words, for a message.
    shear_modulus_formula: ClassVar[str]

    @abstractmethod
    def constant_names(self, order: int = 1) -> tuple[str, ...]:
        """Names of the constants of ``order`` terms, in order."""

    @abstractmethod
    def bounds(self, constant: str) -> Bounds:
        """Range of a constant within which a fit looks, MPa or plain."""

    def initial_shear_modulus(
        self, constants: Constants, compressibility: Compressibility
    ) -> float:
        """Return mu0 in MPa: a sum over the constants, where W is linear in its moduli."""
        gradient = self.initial_shear_modulus_gradient(constants, compressibility)
        return float(sum(w * constants[n] for n, w in gradient.items()))

    @abstractmethod
    def initial_shear_modulus_gradient(
        self, constants: Constants, compressibility: Compressibility
    ) -> dict[str, float]:
        """Differentiate mu0 with respect to every constant."""

    @abstractmethod
    def law(self, constants: Constants, compressibility: Compressibility) -> Law:
        """Return the compiled law of the isochoric stress."""

    @abstractmethod
    def law_rate(self, constants: Constants, compressibility: Compressibility, name: str) -> Law:
        """Return the law whose stress is the derivative of the isochoric stress by a constant."""

    def has_constant(self, name: str) -> bool:
        """Whether a constant of this name exists at some order."""
        return name in self.constant_names()

    def has_key(self, key: str) -> bool:
        """Whether a study file may write this key for a constant."""
        return key in self.list_keys if self.list_keys else self.has_constant(key)

    def is_dimensionless(self, constant: str) -> bool:
        """Whether a constant is a plain number, such as an exponent, and no modulus."""
        return False

    def order_of(self, names: Collection[str]) -> int:
        """Count the terms that constants of these names belong to; 0 if there are none."""
        return 1 if names else 0

    def ordered(self, names: Collection[str]) -> tuple[str, ...]:
        """Return the same names in the order of the energy."""
        return tuple(n for n in self.constant_names(max(1, self.order_of(names))) if n in names)

    def forbidden(self, constants: Constants) -> dict[str, str]:
        """Return the rule that each constant breaks by itself, by the name of the constant."""
        return {}

    def simpler(self, order: int) -> tuple[str, int | None] | None:
        """Energy and order that are fitted first, for a start; None where none is needed."""
        return "neo-hookean", None

    @abstractmethod
    def starting_values(self, names: Collection[str], shear_modulus: float) -> dict[str, float]:
        """Return constants with the given mu0 (MPa) from which a fit starts, those not zero."""

    def looks(self, names: Collection[str]) -> list[dict[str, float]]:  # noqa: ARG002
        """Plain numbers beside which a fit of ``names`` may have another minimum, moduli left out.

        By default none.
        """
        return []

    def scattered(self, start: Constants, rng: np.random.Generator) -> dict[str, float]:
        """Draw a start beside the usual one: plain numbers times or over up to 3, moduli kept."""
        factors = np.exp(rng.uniform(-np.log(3), np.log(3), len(start)))
        return {
            name: value * float(factor) if self.is_dimensionless(name) else value
            for (name, value), factor in zip(start.items(), factors, strict=True)
        }


class IsochoricEnergy(Energy):
    """Energy of isochoric principal stretches ``bar``, with product 1.

    The deviator of ``s_i = bar_i dW/dbar_i`` is the principal isochoric Kirchhoff stress
    (Holzapfel 2000, eqs. 6.82 and 6.103). Everything is differentiated with respect to
    logarithmic stretches, where the derivative of s is symmetric.
    """

    #: Whether it is a convex function of the stretches, as far as it reaches, where all constants
    #: are positive.
    is_convex: ClassVar[bool] = False

    @abstractmethod
    def principal_stress(self, constants: Constants, bar: Array) -> Array:
        """Return s_i in MPa, up to a common constant that the deviator drops.

        Parameters
        ----------
        constants : mapping of str to float
            In MPa, exponents plain.
        bar : ndarray, shape (3, ...)
            Isochoric principal stretches.

        Returns
        -------
        ndarray, shape (3, ...)
        """

    @abstractmethod
    def principal_stress_slope(self, constants: Constants, bar: Array, direction: Array) -> Array:
        """Differentiate :meth:`principal_stress` along a direction of ``ln bar``, or along several.

        Parameters
        ----------
        constants : mapping of str to float
            In MPa, exponents plain.
        bar : ndarray, shape (3, n)
            Isochoric principal stretches.
        direction : ndarray, shape (3,) or (k, 3)
            Rates of ``ln bar``.

        Returns
        -------
        ndarray, shape (3, n) or (k, 3, n)
        """

    def stress_and_slope(
        self, constants: Constants, bar: Array, direction: Array
    ) -> tuple[Array, Array]:
        """Both of them at once, for energies that need the same invariants for both."""
        stress = self.principal_stress(constants, bar)
        return stress, self.principal_stress_slope(constants, bar, direction)

    @abstractmethod
    def principal_stress_gradient(self, constants: Constants, bar: Array) -> dict[str, Array]:
        """Differentiate :meth:`principal_stress` by every constant, each shape (3, ...)."""

    def always_elliptic(self, constants: Constants) -> bool:
        """Whether it is known to be strongly elliptic at every stretch; False says nothing."""
        return self.is_convex and all(value > 0 for value in constants.values())

    def always_stable(self, constants: Constants) -> bool:
        """Whether Drucker's criterion is known to hold at every stretch; False says nothing."""
        return False


class CompressibleEnergy(Energy):
    """Energy of principal stretches whose volume change belongs to all of it.

    Stresses are principal Kirchhoff stresses tau_i = dW/dln l_i in MPa, derivatives those by
    logarithmic stretches.
    """

    splits = False

    @abstractmethod
    def kirchhoff(
        self, constants: Constants, compressibility: Compressibility, stretch: Array
    ) -> Array:
        """Return tau_i at principal stretches, both of shape (3, ...)."""

    @abstractmethod
    def kirchhoff_slope(
        self,
        constants: Constants,
        compressibility: Compressibility,
        stretch: Array,
        direction: Array,
    ) -> Array:
        """Differentiate tau_i along a direction (3,) of ln l; stretches of shape (3, n)."""

    @abstractmethod
    def kirchhoff_gradient(
        self, constants: Constants, compressibility: Compressibility, stretch: Array
    ) -> dict[str, Array]:
        """Differentiate tau_i by every constant, each of shape (3, ...)."""

    def without_poisson_ratio(self) -> Fault:
        """Return the fault of a material whose compressibility is given another way."""
        rule = f"is missing: {self.name} changes its volume by it in every term"
        return Fault("material.poisson_ratio", rule, "write poisson_ratio = 0.1, and nothing else")


@dataclass(frozen=True)
class Constant:
    """Declaration of a constant of an energy that has no order.

    Parameters
    ----------
    name : str
        As a study file says it.
    low, high : float
        Closed range within which the energy is defined and a fit looks, MPa or plain.
    is_dimensionless : bool
        Whether it is a plain number and no modulus.
    start : float
        Where a fit begins; of moduli only their ratios matter.
    """

    name: str
    low: float
    high: float
    is_dimensionless: bool = False
    start: float = 1.0


class DeclaredConstants(Energy):
    """Energy with a fixed list of constants, each declared with its range."""

    declared: ClassVar[tuple[Constant, ...]]

    def constant_names(self, order: int = 1) -> tuple[str, ...]:
        """Return the declared ones."""
        return tuple(constant.name for constant in self.declared)

    def bounds(self, constant: str) -> Bounds:
        """Return the declared range."""
        declared = self._named(constant)
        return declared.low, declared.high

    def is_dimensionless(self, constant: str) -> bool:
        """Whether it is declared so."""
        return any(item.name == constant and item.is_dimensionless for item in self.declared)

    def forbidden(self, constants: Constants) -> dict[str, str]:
        """Constants outside their range, where the energy is not defined or not its own."""
        broken = {}
        for name, value in constants.items():
            declared = self._named(name)
            if not declared.low <= value <= declared.high:
                unit = "" if declared.is_dimensionless else " MPa"
                rule = f"{self.name} takes {name} from {declared.low:g} to {declared.high:g}{unit}"
                broken[name] = f"{rule}, got {value:g}"
        return broken

    def starting_values(self, names: Collection[str], shear_modulus: float) -> dict[str, float]:
        """Return the declared starts, all moduli multiplied to the shear modulus."""
        unit = {constant.name: constant.start for constant in self.declared}
        scale = shear_modulus / self.initial_shear_modulus(unit, Compressibility())
        return {n: v if self.is_dimensionless(n) else scale * v for n, v in unit.items()}

    def _named(self, constant: str) -> Constant:
        return next(item for item in self.declared if item.name == constant)
