"""Ogden's energy: W = sum 2 mu_i / alpha_i^2 (l1^alpha_i + l2^alpha_i + l3^alpha_i - 3)."""

from __future__ import annotations

import re
from collections.abc import Collection
from itertools import combinations

import numpy as np

from study.ground.arrays import Array
from study.ground.errors import Fault, InputError
from study.mechanics.material.energy import (
    FREE,
    Bounds,
    Compressibility,
    CompressibleEnergy,
    Constant,
    Constants,
    DeclaredConstants,
    Energy,
    IsochoricEnergy,
    Law,
    PointLaw,
)
from study.mechanics.material.limiting_chain import Pole
from study.mechanics.material.polynomial import InvariantEnergy

#: Bounds of an exponent: beyond, powers of a stretch of 0.5 only overfit.
EXPONENT: Bounds = (-30.0, 30.0)
#: Sizes of exponents, of either sign, from which minima are looked for: of one term, of several.
LOOKS = (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 7.5, 9.0, 11.0, 14.0, 18.0, 24.0)
FEW_LOOKS = (1.5, 3.0, 6.0, 11.0, 18.0)
#: Exponents a fit starts from. They alternate: equal ones would make the terms
#: indistinguishable.
STARTING_EXPONENTS = (2.0, -2.0, 4.0, -4.0, 6.0, -6.0)


class OgdenSeries(Energy):
    """Constants of an energy in terms, each with a modulus and an exponent."""

    has_order = True
    list_keys = ("mu", "alpha")
    shear_modulus_formula = "sum of mu"

    def constant_names(self, order: int = 1) -> tuple[str, ...]:
        """mu1, alpha1, mu2, ..."""
        return tuple(f"{kind}{i}" for i in range(1, order + 1) for kind in ("mu", "alpha"))

    def has_constant(self, name: str) -> bool:
        """Mu or alpha with the number of a term."""
        return re.fullmatch(r"(mu|alpha)[1-9]\d*", name) is not None

    def order_of(self, names: Collection[str]) -> int:
        """Return the largest number of a term."""
        return max((int(name.lstrip("mualph")) for name in names), default=0)

    def bounds(self, constant: str) -> Bounds:
        """Exponents within :data:`EXPONENT`, moduli of any sign."""
        return EXPONENT if constant.startswith("alpha") else FREE

    def is_dimensionless(self, constant: str) -> bool:
        """Exponents are plain numbers."""
        return constant.startswith("alpha")

    def forbidden(self, constants: Constants) -> dict[str, str]:
        """Exponents of zero, which are limits that other codes do not have."""
        rule = "an Ogden exponent must not be zero"
        return {n: rule for n, c in constants.items() if n.startswith("alpha") and c == 0}

    def initial_shear_modulus_gradient(
        self, constants: Constants, compressibility: Compressibility
    ) -> dict[str, float]:
        """Return 1 for each modulus, 0 for each exponent."""
        return {n: 1.0 if n.startswith("mu") else 0.0 for n in constants}

    def starting_values(self, names: Collection[str], shear_modulus: float) -> dict[str, float]:
        """Equal moduli and alternating exponents."""
        terms = self.order_of(names)
        values = {f"mu{k}": shear_modulus / terms for k in range(1, terms + 1)}
        exponents = STARTING_EXPONENTS
        return values | {
            f"alpha{k}": exponents[(k - 1) % len(exponents)] for k in range(1, terms + 1)
        }

    def looks(self, names: Collection[str]) -> list[dict[str, float]]:
        """Exponents of either sign: a sum of squares has minima on both sides of zero.

        The largest belongs to the first term, as at the usual start.
        """
        terms = self.order_of(names)
        sizes = LOOKS if terms == 1 else FEW_LOOKS
        signed = sorted((*sizes, *(-size for size in sizes)))
        return [
            {f"alpha{k}": alpha for k, alpha in enumerate(reversed(chosen), 1)}
            for chosen in combinations(signed, terms)
        ]

    def scattered(self, start: Constants, rng: np.random.Generator) -> dict[str, float]:
        """Draw exponents of either sign in turn, of 1 to 4 in the first pair and 4 to 10 in others.

        Terms that begin alike merge, and the fit is then one of fewer terms.
        """
        drawn = dict(start)
        for k in range(self.order_of(tuple(start))):
            size = rng.uniform(1, 4) if k < 2 else rng.uniform(4, 10)
            drawn[f"alpha{k + 1}"] = float(size if k % 2 == 0 else -size)
        return drawn


class Ogden(OgdenSeries, IsochoricEnergy):
    """Ogden's energy of any number of terms, moduli with sum mu0."""

    name = "ogden"

    def law(self, constants: Constants, compressibility: Compressibility) -> Law:
        """Rows (mu, alpha)."""
        return Law(PointLaw.OGDEN, np.column_stack(ogden_terms(constants)))

    def law_rate(self, constants: Constants, compressibility: Compressibility, name: str) -> Law:
        """One term, of unit modulus or differentiated by its exponent."""
        term = self.order_of([name])
        mu, alpha = constants[f"mu{term}"], constants[f"alpha{term}"]
        if name.startswith("mu"):
            return Law(PointLaw.OGDEN, np.array([[1.0, alpha]]))
        return Law(PointLaw.OGDEN_BY_EXPONENT, np.array([[mu, alpha]]))

    def principal_stress(self, constants: Constants, bar: Array) -> Array:
        """Sum of 2 mu / alpha (bar^alpha - 1), with its limit at alpha = 0."""
        mu, alpha = ogden_terms(constants)
        log = np.log(bar)
        return np.asarray(2 * log * np.tensordot(mu, _phi(np.multiply.outer(alpha, log)), 1))

    def principal_stress_slope(self, constants: Constants, bar: Array, direction: Array) -> Array:
        """Sum of 2 mu bar^alpha times the direction."""
        mu, alpha = ogden_terms(constants)
        powers = np.exp(np.multiply.outer(alpha, np.log(bar)))
        return np.asarray(2 * np.tensordot(mu, powers, 1) * direction[..., None])

    def principal_stress_gradient(self, constants: Constants, bar: Array) -> dict[str, Array]:
        """Differentiate by each modulus and each exponent."""
        mu, alpha = ogden_terms(constants)
        log = np.log(bar)
        z = np.multiply.outer(alpha, log)
        by_modulus = 2 * log * _phi(z)
        # slope of (e^z - 1) / z, with its limit 1/2 at zero
        small = np.abs(z) < 0.5
        far = np.where(small, 1.0, z)
        series = np.polynomial.polynomial.polyval(np.where(small, z, 0.0), _SLOPE_SERIES)
        slope = np.where(small, series, (np.exp(far) * (far - 1) + 1) / far**2)
        gradient: dict[str, Array] = {}
        for i in range(mu.size):
            gradient[f"mu{i + 1}"] = by_modulus[i]
            gradient[f"alpha{i + 1}"] = 2 * mu[i] * log**2 * slope[i]
        return gradient

    def always_stable(self, constants: Constants) -> bool:
        """Positive moduli: by logarithmic stretches the second derivatives are 2 mu l^alpha."""
        mu, _ = ogden_terms(constants)
        return bool((mu > 0).all())

    def always_elliptic(self, constants: Constants) -> bool:
        """Positive moduli and exponents of one and more, of either sign (Ball 1977)."""
        mu, alpha = ogden_terms(constants)
        return bool((mu > 0).all() and (np.abs(alpha) >= 1).all())


def ogden_terms(constants: Constants) -> tuple[Array, Array]:
    """Moduli mu_i (MPa) and exponents alpha_i, each shape (n,), of constants in order."""
    values = np.array(list(constants.values()))
    return values[0::2].copy(), values[1::2].copy()


def _phi(z: Array) -> Array:
    """(e^z - 1) / z, with its limit 1 at zero."""
    return np.divide(np.expm1(z), z, out=np.ones_like(z), where=z != 0)


#: coefficients 1 / (k! (k + 2)) of the power series of the slope of (e^z - 1) / z: 15 reach
#: rounding below 0.5, where the formula would lose digits to cancellation
_SLOPE_SERIES = 1 / (np.cumprod([1.0, *range(1, 15)]) * np.arange(2, 17))


# Foam of Ogden and Hill: ``W = sum 2 mu_i / alpha_i^2 (l1^a + l2^a + l3^a - 3 + (J^(-a b) - 1) /
# b)`` with a = alpha_i, b = nu / (1 - 2 nu) (Ogden 1972, Proc. R. Soc. A 328, 567; Hill 1978,
# Adv. Appl. Mech. 18, 1; Storakers 1986, J. Mech. Phys. Solids 34, 125). In uniaxial stress l2 =
# l1^(-nu).


class OgdenHill(OgdenSeries, CompressibleEnergy):
    """Any number of terms, moduli with sum mu0."""

    name = "ogden-hill"

    def law(self, constants: Constants, compressibility: Compressibility) -> Law:
        """Refuse: the mixed form needs an energy that splits."""
        rule = f"{self.name} has no isochoric part that finite elements could take for itself"
        mend = 'write specimen.shape = "homogeneous", or another energy'
        raise InputError(Fault("material.model", rule, mend))

    def law_rate(self, constants: Constants, compressibility: Compressibility, name: str) -> Law:
        """Refuse, too."""
        return self.law(constants, compressibility)

    def kirchhoff(
        self, constants: Constants, compressibility: Compressibility, stretch: Array
    ) -> Array:
        """Sum of 2 mu / alpha (l^alpha - J^(-alpha b))."""
        (mu, alpha), log = ogden_terms(constants), np.log(stretch)
        powers = np.expm1(np.multiply.outer(alpha, log))
        b = _volume_exponent(compressibility)
        volume = np.expm1(np.multiply.outer(-alpha * b, log.sum(0)))
        return np.asarray(np.tensordot(2 * mu / alpha, powers - volume[:, None], 1))

    def kirchhoff_slope(
        self,
        constants: Constants,
        compressibility: Compressibility,
        stretch: Array,
        direction: Array,
    ) -> Array:
        """Sum of 2 mu (l^alpha v + b J^(-alpha b) sum v)."""
        (mu, alpha), log = ogden_terms(constants), np.log(stretch)
        powers = np.exp(np.multiply.outer(alpha, log)) * direction[:, None]
        b = _volume_exponent(compressibility)
        volume = b * np.exp(np.multiply.outer(-alpha * b, log.sum(0))) * direction.sum()
        return np.asarray(np.tensordot(2 * mu, powers + volume[:, None], 1))

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


def _volume_exponent(compressibility: Compressibility) -> float:
    nu = compressibility.poisson_ratio
    if nu is None:
        raise InputError(OgdenHill().without_poisson_ratio())
    return nu / (1 - 2 * nu)


# Extended tube energy of Kaliske and Heinrich (1999, Rubber Chem. Technol. 72, 602-632).
#     W = Gc / 2 ((1 - delta^2) D / (1 - delta^2 D) + ln(1 - delta^2 D))
#         + 2 Ge / beta^2 (l1^-beta + l2^-beta + l3^-beta - 3),    D = I1 - 3
# Crosslinks that end at I1 - 3 = 1 / delta^2, and entanglements, which are a term of Ogden's with
# the exponent -beta. mu0 = Gc (1 - 2 delta^2) + Ge.

_ENTANGLEMENT = Ogden()


class ExtendedTube(DeclaredConstants, InvariantEnergy):
    """Moduli Gc and Ge, exponent beta of entanglements, inextensibility delta of crosslinks."""

    name = "extended-tube"
    shear_modulus_formula = "Gc (1 - 2 delta^2) + Ge"
    declared = (
        Constant("Gc", 0.0, np.inf),
        Constant("Ge", 0.0, np.inf),
        Constant("beta", 1e-6, 10.0, True, start=0.5),
        Constant("delta", 1e-4, 0.7, True, start=0.05),
    )

    def form(self, constants: Constants) -> Pole:
        """dW/dI1 = Gc / 2 ((1 - e) s^2 - e s) with e = delta^2."""
        half, e = constants["Gc"] / 2, constants["delta"] ** 2
        return Pole(e, -half * e, half * (1 - e))

    def form_rate(self, constants: Constants, name: str) -> Pole:
        """By delta with ds/de = (s^2 - s) / e."""
        delta = constants["delta"]
        e = delta**2
        if name == "Gc":
            return Pole(e, -e / 2, (1 - e) / 2)
        if name == "delta":
            third = 2 * constants["Gc"] * (1 - e) / delta
            return Pole(e, 0.0, -third - 2 * constants["Gc"] * delta, third)
        return Pole(e, 0.0)

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
        tubes = [[constants["Ge"]], [-constants["beta"]]]
        return Law(PointLaw.EXTENDED_TUBE, np.vstack([self.form(constants).law().constants, tubes]))

    def law_rate(self, constants: Constants, compressibility: Compressibility, name: str) -> Law:
        """Of crosslinks or of entanglements: no constant belongs to both."""
        ge, beta = constants["Ge"], constants["beta"]
        if name == "Ge":
            return Law(PointLaw.OGDEN, np.array([[1.0, -beta]]))
        if name == "beta":
            return Law(PointLaw.OGDEN_BY_EXPONENT, np.array([[-ge, -beta]]))
        return super().law_rate(constants, compressibility, name)

    def starting_values(self, names: Collection[str], shear_modulus: float) -> dict[str, float]:
        """Half of the modulus from crosslinks, which are far from their end at 1 / delta^2."""
        start = super().starting_values(names, shear_modulus)
        crosslinks = 0.5 * shear_modulus / (1 - 2 * start["delta"] ** 2)
        return start | {"Gc": crosslinks, "Ge": 0.5 * shear_modulus}


def _term(constants: Constants) -> dict[str, float]:
    """Constants of Ogden's term."""
    return {"mu1": constants["Ge"], "alpha1": -constants["beta"]}
