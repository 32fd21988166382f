"""Energy of skin: W = C1 (exp(C2 (I1 - 3)) - 1) - C1 C2 / 2 (I2 - 3).

Veronda and Westmann (1970, J. Biomech. 3, 111-124), without their volumetric term; the form of
FEBio's material of that name (User Manual, 4.1.2).
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from study.material.compressibility import Compressibility
from study.material.convention import Converted, febio_hyperelastic
from study.material.energies.exponential import Exponential, ExponentialEnergy
from study.material.energy import Constant, Constants, DeclaredConstants

#: stiffening that a fit starts from
STARTING_STIFFENING = 0.1


class VerondaWestmann(DeclaredConstants, ExponentialEnergy):
    """Modulus C1 and stiffening C2; mu0 = C1 C2.

    At small strain W falls with I2, so that it may be unstable in equibiaxial tension where C2
    is small: stability says from where on.
    """

    name = "veronda-westmann"
    shear_modulus_formula = "C1 C2"
    has_second_invariant = True
    declared = (Constant("C1", 0.0, np.inf), Constant("C2", 1e-6, 1e4, True))

    def coefficients(self, constants: Constants) -> Exponential:
        """C1 of the exponential function, -C1 C2 / 2 of the second invariant."""
        c1, c2 = constants["C1"], constants["C2"]
        return Exponential(c1, 0.0, c2, -0.5 * c1 * c2)

    def coefficient_rates(self, constants: Constants, name: str) -> Exponential:
        """Differentiate W by each."""
        c1, c2 = constants["C1"], constants["C2"]
        if name == "C1":
            return Exponential(1.0, 0.0, c2, -0.5 * c2)
        return Exponential(0.0, c1, c2, -0.5 * c1)

    def starting_values(self, names: Collection[str], shear_modulus: float) -> dict[str, float]:
        """Little stiffening."""
        return {"C1": shear_modulus / STARTING_STIFFENING, "C2": STARTING_STIFFENING}

    def febio(self, constants: Constants, compressibility: Compressibility) -> Converted:
        """FEBio has the same form."""
        bulk = compressibility.bulk(self.initial_shear_modulus(constants, compressibility))
        values = {"c1": constants["C1"], "c2": constants["C2"]}
        return febio_hyperelastic("Veronda-Westmann", values, bulk)
