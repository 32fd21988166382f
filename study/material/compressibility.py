"""How a material resists a change of volume, U = K/2 (J - 1)^2."""

from __future__ import annotations

import math
from dataclasses import dataclass

from study.errors import Fault


@dataclass(frozen=True)
class Compressibility:
    """Exactly one of the three ways to give a bulk modulus.

    Parameters
    ----------
    bulk_modulus : float, optional
        K in MPa.
    poisson_ratio : float, optional
        Initial Poisson's ratio; K then follows the initial shear modulus.
    incompressible : bool
        K is infinite.
    """

    bulk_modulus: float | None = None
    poisson_ratio: float | None = None
    incompressible: bool = False

    @property
    def bulk_over_shear(self) -> float:
        """K / mu0 at a given Poisson's ratio; infinite without one."""
        nu = self.poisson_ratio
        return math.inf if nu is None else 2 * (1 + nu) / (3 * (1 - 2 * nu))

    def bulk(self, shear_modulus: float) -> float:
        """K in MPa where the initial shear modulus is ``shear_modulus``; may be infinite."""
        if self.incompressible:
            return math.inf
        if self.bulk_modulus is not None:
            return self.bulk_modulus
        return self.bulk_over_shear * shear_modulus

    def faults(self) -> list[Fault]:
        """Return what is wrong: not one of the three, or out of range."""
        bulk, nu = self.bulk_modulus, self.poisson_ratio
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


def bulk_from_poisson(mu0: float, poisson_ratio: float) -> float:
    """K in MPa from the initial shear modulus and Poisson's ratio.

    Parameters
    ----------
    mu0 : float
        Initial shear modulus, MPa.
    poisson_ratio : float
        Initial one, above -1 and below 0.5.
    """
    return 2 * mu0 * (1 + poisson_ratio) / (3 * (1 - 2 * poisson_ratio))


def poisson_from_bulk(mu0: float, bulk_modulus: float) -> float:
    """Poisson's ratio from the initial shear modulus and K (infinite K gives 0.5).

    Parameters
    ----------
    mu0 : float
        Initial shear modulus, MPa.
    bulk_modulus : float
        K in MPa.
    """
    ratio = mu0 / bulk_modulus
    return (3 - 2 * ratio) / (2 * (3 + ratio))
