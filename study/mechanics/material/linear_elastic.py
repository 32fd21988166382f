"""Linear elasticity, small strain on purpose: W = mu e:e + (K/2 - mu/3) (tr e)^2."""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np

from study.mechanics.material.energy import (
    POSITIVE,
    Bounds,
    Compressibility,
    Constants,
    Energy,
    Law,
    PointLaw,
)

MODULUS = "youngs_modulus"


class LinearElastic(Energy):
    """Hooke's law with Young's modulus."""

    name = "linear-elastic"
    small_strain = True
    shear_modulus_formula = "E / (2 (1 + nu))"

    def constant_names(self, order: int = 1) -> tuple[str, ...]:
        """Young's modulus alone."""
        return (MODULUS,)

    def bounds(self, constant: str) -> Bounds:
        """Young's modulus is positive."""
        return POSITIVE

    def initial_shear_modulus(
        self, constants: Constants, compressibility: Compressibility
    ) -> float:
        """E / (2 (1 + nu)), or 3 K E / (9 K - E)."""
        modulus, bulk, nu = (
            constants[MODULUS],
            compressibility.bulk_modulus_MPa,
            compressibility.poisson_ratio,
        )
        if bulk is not None:
            rest = 9 * bulk - modulus  # zero where nu = -1
            return 3 * bulk * modulus / rest if rest else math.inf
        return modulus / (2 * (1 + (0.5 if nu is None else nu)))

    def initial_shear_modulus_gradient(
        self, constants: Constants, compressibility: Compressibility
    ) -> dict[str, float]:
        """Differentiate mu0 by E; K or nu is held, whichever was given."""
        ratio = self.initial_shear_modulus(constants, compressibility) / constants[MODULUS]
        # at given K, 1/mu = 3/E - 1/(3K)
        return {MODULUS: ratio if compressibility.bulk_modulus_MPa is None else 3 * ratio**2}

    def law(self, constants: Constants, compressibility: Compressibility) -> Law:
        """Shear modulus."""
        mu = self.initial_shear_modulus(constants, compressibility)
        return Law(PointLaw.SMALL_STRAIN, np.array([[mu]]))

    def law_rate(self, constants: Constants, compressibility: Compressibility, name: str) -> Law:
        """Rate of the shear modulus, which the stress is in proportion to."""
        rate = self.initial_shear_modulus_gradient(constants, compressibility)[name]
        return Law(PointLaw.SMALL_STRAIN, np.array([[rate]]))

    def simpler(self, order: int) -> tuple[str, int | None] | None:
        """None: forces are in proportion to the modulus."""
        return None

    def starting_values(self, names: Collection[str], shear_modulus: float) -> dict[str, float]:
        """E = 3 mu0, as if the volume were kept."""
        return {MODULUS: 3 * shear_modulus}
