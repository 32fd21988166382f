"""Eight-chain energy in five terms: W = mu sum C_k / lambda_m^(2k-2) (I1^k - 3^k).

Arruda and Boyce (1993) have the inverse Langevin function; this is the series that Abaqus and
FEBio publish for it (Abaqus Theory Guide, 4.6.1), with C = 1/2, 1/20, 11/1050, 19/7000 and
519/673750. The series has no limit at lambda_m, which the inverse Langevin function has; it is
what published constants were fitted with.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.polynomial import polynomial

from study.arrays import Array
from study.material.compressibility import Compressibility
from study.material.convention import Converted, abaqus_logarithmic, febio_hyperelastic
from study.material.energies.polynomial import TableEnergy
from study.material.energy import Constant, Constants, DeclaredConstants

#: C_k of the series
SERIES = np.array([1 / 2, 1 / 20, 11 / 1050, 19 / 7000, 519 / 673750])

#: rows k: coefficients of I1^k - 3^k by powers of I1 - 3, all of them positive
POWERS = np.zeros((5, 6))
for _k in range(1, 6):
    POWERS[_k - 1, 1 : _k + 1] = polynomial.polypow([3.0, 1.0], _k)[1:]

#: locking stretch that a fit starts from: beyond what most rubbers are tested to
STARTING_STRETCH = 5.0


class ArrudaBoyce(DeclaredConstants, TableEnergy):
    """Modulus mu and locking stretch lambda_m; mu0 is larger than mu."""

    name = "arruda-boyce"
    shear_modulus_formula = "mu (1 + 3/(5 lambda_m^2) + 99/(175 lambda_m^4) + ...)"
    declared = (Constant("mu", 0.0, np.inf), Constant("lambda_m", 1.0, 1e3, True))

    def table(self, constants: Constants) -> Array:
        """Expand the powers of I1 about 3."""
        weights = SERIES * constants["lambda_m"] ** (-2.0 * np.arange(5))
        return np.asarray(constants["mu"] * weights @ POWERS)[:, None]

    def table_rate(self, constants: Constants, name: str) -> Array:
        """Differentiate each power of lambda_m."""
        if name == "mu":
            return self.table({**constants, "mu": 1.0})
        stretch, powers = constants["lambda_m"], -2.0 * np.arange(5)
        weights = SERIES * powers * stretch ** (powers - 1)
        return np.asarray(constants["mu"] * weights @ POWERS)[:, None]

    def always_elliptic(self, constants: Constants) -> bool:
        """Every term is convex and rises."""
        return constants["mu"] > 0

    def starting_values(self, names: Collection[str], shear_modulus: float) -> dict[str, float]:
        """Chains that are far from their end."""
        unit = {"mu": 1.0, "lambda_m": STARTING_STRETCH}
        scale = 2 * float(self.table(unit)[1, 0])
        return unit | {"mu": shear_modulus / scale}

    def abaqus(self, constants: Constants, compressibility: Compressibility) -> Converted:
        """Abaqus has the same series, with another volumetric term."""
        bulk = compressibility.bulk(self.initial_shear_modulus(constants, compressibility))
        return abaqus_logarithmic("arruda-boyce", constants, bulk)

    def febio(self, constants: Constants, compressibility: Compressibility) -> Converted:
        """N, the number of links of a chain, is lambda_m^2."""
        bulk = compressibility.bulk(self.initial_shear_modulus(constants, compressibility))
        values = {"mu": constants["mu"], "N": constants["lambda_m"] ** 2}
        return febio_hyperelastic("Arruda-Boyce", values, bulk)
