"""Isotropic exponential energy of soft tissue: W = mu / (2 b) (exp(b (I1 - 3)) - 1).

Fung's law (1967) in the isotropic form of Demiray (1972, J. Biomech. 5, 309-311), which Humphrey
and Yin (1987) write with c = mu / (2 b).
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from study.material.energies.exponential import Exponential, ExponentialEnergy
from study.material.energy import Constant, Constants, DeclaredConstants

#: stiffening that a fit starts from: W is nearly neo-Hookean at moderate strain
STARTING_STIFFENING = 0.1


class Fung(DeclaredConstants, ExponentialEnergy):
    """Initial shear modulus mu and stiffening b; neo-Hookean as b goes to zero."""

    name = "fung"
    shear_modulus_formula = "mu"
    declared = (Constant("mu", 0.0, np.inf), Constant("b", 1e-6, 1e4, True))

    def coefficients(self, constants: Constants) -> Exponential:
        """Return mu / (2 b) of the exponential function."""
        mu, b = constants["mu"], constants["b"]
        return Exponential(0.5 * mu / b, 0.0, b)

    def coefficient_rates(self, constants: Constants, name: str) -> Exponential:
        """Differentiate mu / (2 b) exp(b a)."""
        mu, b = constants["mu"], constants["b"]
        if name == "mu":
            return Exponential(0.5 / b, 0.0, b)
        return Exponential(-0.5 * mu / b**2, 0.5 * mu / b, b)

    def always_elliptic(self, constants: Constants) -> bool:
        """Whether it is a convex function of the stretches."""
        return constants["mu"] > 0 and constants["b"] > 0

    def starting_values(self, names: Collection[str], shear_modulus: float) -> dict[str, float]:
        """Little stiffening."""
        return {"mu": shear_modulus, "b": STARTING_STIFFENING}
