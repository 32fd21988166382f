"""Foam of Ogden and Hill, whose volume change is part of every term.

``W = sum 2 mu_i / alpha_i^2 (l1^a + l2^a + l3^a - 3 + (J^(-a b) - 1) / b)`` with a = alpha_i and
b = nu / (1 - 2 nu) (Ogden 1972, Proc. R. Soc. A 328, 567; Hill 1978, Adv. Appl. Mech. 18, 1;
Storakers 1986, J. Mech. Phys. Solids 34, 125). One Poisson's ratio for all terms: it is that of
logarithmic strains at every stretch in uniaxial stress, l2 = l1^(-nu).
"""

from __future__ import annotations

import numpy as np

from study.arrays import Array
from study.errors import Fault, InputError
from study.material.compressibility import Compressibility
from study.material.convention import Converted
from study.material.energies.ogden import OgdenSeries, ogden_terms
from study.material.energy import CompressibleEnergy, Constants, Law


class OgdenHill(OgdenSeries, CompressibleEnergy):
    """Any number of terms, moduli with sum mu0."""

    name = "ogden-hill"

    def initial_shear_modulus(
        self, constants: Constants, compressibility: Compressibility
    ) -> float:
        """Sum of the moduli."""
        return float(ogden_terms(constants)[0].sum())

    def law(self, constants: Constants, compressibility: Compressibility) -> Law:
        """Refuse: the mixed form needs an energy that splits."""
        raise _no_elements()

    def law_rate(self, constants: Constants, compressibility: Compressibility, name: str) -> Law:
        """Refuse, as :meth:`law`."""
        raise _no_elements()

    def kirchhoff(
        self, constants: Constants, compressibility: Compressibility, stretch: Array
    ) -> Array:
        """Sum of 2 mu / alpha (l^alpha - J^(-alpha b))."""
        log, b = np.log(stretch), _volume_exponent(compressibility)
        volume = log.sum(0)
        return np.asarray(
            sum(
                2 * mu / alpha * (np.expm1(alpha * log) - np.expm1(-alpha * b * volume))
                for mu, alpha in zip(*ogden_terms(constants), strict=True)
            )
        )

    def kirchhoff_slope(
        self,
        constants: Constants,
        compressibility: Compressibility,
        stretch: Array,
        direction: Array,
    ) -> Array:
        """Sum of 2 mu (l^alpha v + b J^(-alpha b) sum v)."""
        log, b, v = np.log(stretch), _volume_exponent(compressibility), direction[:, None]
        volume = log.sum(0)
        return np.asarray(
            sum(
                2 * mu * (np.exp(alpha * log) * v + b * np.exp(-alpha * b * volume) * v.sum())
                for mu, alpha in zip(*ogden_terms(constants), strict=True)
            )
        )

    def kirchhoff_gradient(
        self, constants: Constants, compressibility: Compressibility, stretch: Array
    ) -> dict[str, Array]:
        """Differentiate by each modulus and each exponent."""
        log, b = np.log(stretch), _volume_exponent(compressibility)
        volume, gradient = log.sum(0), {}
        for k, (mu, alpha) in enumerate(zip(*ogden_terms(constants), strict=True), start=1):
            power = np.expm1(alpha * log) - np.expm1(-alpha * b * volume)
            by_exponent = np.exp(alpha * log) * log
            by_exponent = by_exponent + b * volume * np.exp(-alpha * b * volume)
            gradient[f"mu{k}"] = 2 / alpha * power
            gradient[f"alpha{k}"] = 2 * mu / alpha * (by_exponent - power / alpha)
        return gradient

    def energy_density(
        self, constants: Constants, compressibility: Compressibility, stretch: Array
    ) -> Array:
        """W, with ln J in place of its volume term where Poisson's ratio is zero."""
        log, b = np.log(stretch), _volume_exponent(compressibility)
        volume = log.sum(0)
        total = np.zeros_like(volume)
        for mu, alpha in zip(*ogden_terms(constants), strict=True):
            swelling = -alpha * volume if b == 0 else np.expm1(-alpha * b * volume) / b
            total = total + 2 * mu / alpha**2 * (np.expm1(alpha * log).sum(0) + swelling)
        return np.asarray(total)

    def abaqus(self, constants: Constants, compressibility: Compressibility) -> Converted:
        """Abaqus has the same form, with a Poisson's ratio for every term."""
        terms = len(constants) // 2
        own = {f"nu{k}": _poisson_ratio(compressibility) for k in range(1, terms + 1)}
        return Converted("abaqus", f"*Hyperfoam, n={terms}", {**constants, **own})


def _poisson_ratio(compressibility: Compressibility) -> float:
    if compressibility.poisson_ratio is None:
        raise InputError(OgdenHill().without_poisson_ratio())
    return compressibility.poisson_ratio


def _volume_exponent(compressibility: Compressibility) -> float:
    nu = _poisson_ratio(compressibility)
    return nu / (1 - 2 * nu)


def _no_elements() -> InputError:
    rule = f"{OgdenHill.name} has no isochoric part that finite elements could take for itself"
    mend = 'write specimen.shape = "homogeneous", or another energy'
    return InputError(Fault("material.model", rule, mend))
