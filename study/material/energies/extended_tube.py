"""Extended tube energy of Kaliske and Heinrich (1999, Rubber Chem. Technol. 72, 602-632).

    W = Gc / 2 ((1 - delta^2) D / (1 - delta^2 D) + ln(1 - delta^2 D))
        + 2 Ge / beta^2 (l1^-beta + l2^-beta + l3^-beta - 3),    D = I1 - 3

Crosslinks that end at I1 - 3 = 1 / delta^2, and entanglements, which are a term of Ogden's with
the exponent -beta. mu0 = Gc (1 - 2 delta^2) + Ge.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from study.arrays import Array
from study.material.compressibility import Compressibility
from study.material.energies.finite_extensibility import FiniteExtensibilityEnergy
from study.material.energies.ogden import Ogden
from study.material.energy import (
    Constant,
    Constants,
    DeclaredConstants,
    IsochoricEnergy,
    Law,
    PointLaw,
)

_ENTANGLEMENT = Ogden()

#: exponent and inextensibility that a fit starts from: 1 / delta^2 = 400
STARTING_EXPONENT = 0.5
STARTING_INEXTENSIBILITY = 0.05


class ExtendedTube(DeclaredConstants, FiniteExtensibilityEnergy):
    """Moduli Gc and Ge, exponent beta of entanglements, inextensibility delta of crosslinks."""

    name = "extended-tube"
    shear_modulus_formula = "Gc (1 - 2 delta^2) + Ge"
    declared = (
        Constant("Gc", 0.0, np.inf),
        Constant("Ge", 0.0, np.inf),
        Constant("beta", 1e-6, 10.0, True),
        Constant("delta", 1e-4, 0.7, True),
    )

    def poles(self, constants: Constants) -> Array:
        """dW/dI1 = Gc / 2 ((1 - e) s^2 - e s) with e = delta^2."""
        half, e = constants["Gc"] / 2, constants["delta"] ** 2
        return np.array([e, -half * e, half * (1 - e), 0.0])

    def pole_rates(self, constants: Constants, name: str) -> Array:
        """By delta with ds/de = (s^2 - s) / e."""
        delta = constants["delta"]
        e = delta**2
        if name == "Gc":
            return np.array([e, -e / 2, (1 - e) / 2, 0.0])
        if name == "delta":
            third = 2 * constants["Gc"] * (1 - e) / delta
            return np.array([e, 0.0, -third - 2 * constants["Gc"] * delta, third])
        return np.array([e, 0.0, 0.0, 0.0])

    def principal_stress(self, constants: Constants, bar: Array) -> Array:
        """Of crosslinks and entanglements."""
        crosslinks = super().principal_stress(constants, bar)
        return crosslinks + _ENTANGLEMENT.principal_stress(_term(constants), bar)

    def principal_stress_slope(self, constants: Constants, bar: Array, direction: Array) -> Array:
        """Of both."""
        crosslinks = super().principal_stress_slope(constants, bar, direction)
        tubes = _ENTANGLEMENT.principal_stress_slope(_term(constants), bar, direction)
        return crosslinks + tubes

    #: one after the other: only crosslinks go by the invariants
    stress_and_slope = IsochoricEnergy.stress_and_slope

    def principal_stress_gradient(self, constants: Constants, bar: Array) -> dict[str, Array]:
        """Of both; the exponent is -beta."""
        crosslinks = super().principal_stress_gradient(constants, bar)
        tubes = _ENTANGLEMENT.principal_stress_gradient(_term(constants), bar)
        return crosslinks | {"Ge": tubes["mu1"], "beta": -tubes["alpha1"]}

    def energy_density(self, constants: Constants, bar: Array) -> Array:
        """Of both."""
        crosslinks = super().energy_density(constants, bar)
        return crosslinks + _ENTANGLEMENT.energy_density(_term(constants), bar)

    def initial_shear_modulus(
        self, constants: Constants, compressibility: Compressibility
    ) -> float:
        """Gc (1 - 2 delta^2) + Ge."""
        return super().initial_shear_modulus(constants, compressibility) + constants["Ge"]

    def initial_shear_modulus_gradient(
        self, constants: Constants, compressibility: Compressibility
    ) -> dict[str, float]:
        """1 for Ge; that of crosslinks for all others."""
        crosslinks = super().initial_shear_modulus_gradient(constants, compressibility)
        return crosslinks | {"Ge": 1.0}

    def law(self, constants: Constants, compressibility: Compressibility) -> Law:
        """One column: e, A1, A2, A3 of the crosslinks, then Ge and -beta."""
        tubes = [constants["Ge"], -constants["beta"]]
        column = np.append(self.poles(constants), tubes)[:, None]
        return Law(PointLaw.EXTENDED_TUBE, np.ascontiguousarray(column))

    def law_rate(self, constants: Constants, compressibility: Compressibility, name: str) -> Law:
        """Of crosslinks or of entanglements: no constant belongs to both."""
        ge, beta = constants["Ge"], constants["beta"]
        if name == "Ge":
            return Law(PointLaw.OGDEN, np.array([[1.0, -beta]]))
        if name == "beta":
            return Law(PointLaw.OGDEN_BY_EXPONENT, np.array([[-ge, -beta]]))
        return super().law_rate(constants, compressibility, name)

    def starting_values(self, names: Collection[str], shear_modulus: float) -> dict[str, float]:
        """Half of the modulus from crosslinks, which are far from their end."""
        delta = STARTING_INEXTENSIBILITY
        crosslinks = 0.5 * shear_modulus / (1 - 2 * delta**2)
        return {
            "Gc": crosslinks, "Ge": 0.5 * shear_modulus, "beta": STARTING_EXPONENT, "delta": delta
        }  # fmt: skip


def _term(constants: Constants) -> dict[str, float]:
    """Constants of Ogden's term."""
    return {"mu1": constants["Ge"], "alpha1": -constants["beta"]}
