"""Gent's energy: W = -mu Jm / 2 ln(1 - (I1 - 3) / Jm) (Gent 1996, Rubber Chem. Technol. 69, 59)."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from study.arrays import Array
from study.material.compressibility import Compressibility
from study.material.convention import Converted, febio_hyperelastic
from study.material.energies.finite_extensibility import FiniteExtensibilityEnergy
from study.material.energy import Constant, Constants, DeclaredConstants

#: Jm that a fit starts from: of natural rubber, which tears before a uniaxial stretch of 10
STARTING_LIMIT = 100.0


class Gent(DeclaredConstants, FiniteExtensibilityEnergy):
    """Initial shear modulus mu and limit Jm of I1 - 3; neo-Hookean where Jm is large."""

    name = "gent"
    shear_modulus_formula = "mu"
    declared = (Constant("mu", 0.0, np.inf), Constant("Jm", 1e-4, 1e7, True))

    def poles(self, constants: Constants) -> Array:
        """dW/dI1 = mu / 2 Jm / (Jm - I1 + 3)."""
        return np.array([1 / constants["Jm"], constants["mu"] / 2, 0.0, 0.0])

    def pole_rates(self, constants: Constants, name: str) -> Array:
        """By Jm it is -mu / 2 a e^2 s^2, and a e s = s - 1."""
        e = 1 / constants["Jm"]
        if name == "mu":
            return np.array([e, 0.5, 0.0, 0.0])
        half = constants["mu"] * e / 2
        return np.array([e, half, -half, 0.0])

    def always_elliptic(self, constants: Constants) -> bool:
        """Whether it is a convex function of the stretches, as far as it reaches."""
        return constants["mu"] > 0 and constants["Jm"] > 0

    def starting_values(self, names: Collection[str], shear_modulus: float) -> dict[str, float]:
        """Chains that are far from their end."""
        return {"mu": shear_modulus, "Jm": STARTING_LIMIT}

    def febio(self, constants: Constants, compressibility: Compressibility) -> Converted:
        """FEBio has the same form, with G for mu; Abaqus has none."""
        values = {"G": constants["mu"], "Jm": constants["Jm"]}
        return febio_hyperelastic("Gent", values, compressibility.bulk(constants["mu"]))
