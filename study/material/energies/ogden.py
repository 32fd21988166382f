"""Ogden's energy: W = sum 2 mu_i / alpha_i^2 (l1^alpha_i + l2^alpha_i + l3^alpha_i - 3)."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection

import numpy as np

from study.arrays import Array
from study.errors import Fault, InputError
from study.material.compressibility import Compressibility
from study.material.convention import Converted, abaqus_hyperelastic, febio_hyperelastic
from study.material.energy import (
    FREE,
    Bounds,
    Constants,
    Energy,
    IsochoricEnergy,
    Law,
    PointLaw,
)

#: Bounds of an exponent: beyond, powers of a stretch of 0.5 only overfit.
EXPONENT: Bounds = (-30.0, 30.0)

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
        log = np.log(bar)
        terms = zip(*ogden_terms(constants), strict=True)
        return np.asarray(sum(2 * mu * log * _phi(alpha * log) for mu, alpha in terms))

    def principal_stress_slope(self, constants: Constants, bar: Array, direction: Array) -> Array:
        """Sum of 2 mu bar^alpha times the direction."""
        v = direction[..., None]
        terms = zip(*ogden_terms(constants), strict=True)
        return np.asarray(sum(2 * mu * bar**alpha * v for mu, alpha in terms))

    def principal_stress_gradient(self, constants: Constants, bar: Array) -> dict[str, Array]:
        """Differentiate by each modulus and each exponent."""
        log = np.log(bar)
        gradient: dict[str, Array] = {}
        for i, (mu, alpha) in enumerate(zip(*ogden_terms(constants), strict=True), start=1):
            z = alpha * log
            gradient[f"mu{i}"] = 2 * log * _phi(z)
            gradient[f"alpha{i}"] = 2 * mu * log**2 * _phi_slope(z)
        return gradient

    def energy_density(self, constants: Constants, bar: Array) -> Array:
        """Sum (l^a - 3) / a^2 with sum(ln l) = 0: quadratic in ln l, and finite at a = 0."""
        log = np.log(bar)
        terms = zip(*ogden_terms(constants), strict=True)
        return np.asarray(sum(2 * mu * (log**2 * _phi2(alpha * log)).sum(0) for mu, alpha in terms))

    def always_stable(self, constants: Constants) -> bool:
        """Positive moduli: by logarithmic stretches the second derivatives are 2 mu l^alpha."""
        mu, _ = ogden_terms(constants)
        return bool((mu > 0).all())

    def always_elliptic(self, constants: Constants) -> bool:
        """Positive moduli and exponents of one and more, of either sign (Ball 1977)."""
        mu, alpha = ogden_terms(constants)
        return bool((mu > 0).all() and (np.abs(alpha) >= 1).all())

    def abaqus(self, constants: Constants, compressibility: Compressibility) -> Converted:
        """Abaqus has the same form."""
        bulk = compressibility.bulk(self.initial_shear_modulus(constants, compressibility))
        return abaqus_hyperelastic(f"ogden, n={len(constants) // 2}", constants, bulk)

    def febio(self, constants: Constants, compressibility: Compressibility) -> Converted:
        """W = sum c_i / m_i^2 (...), so c_i = 2 mu_i."""
        mu, alpha = ogden_terms(constants)
        terms = {f"c{i}": 2 * float(m) for i, m in enumerate(mu, 1)}
        terms |= {f"m{i}": float(a) for i, a in enumerate(alpha, 1)}
        bulk = compressibility.bulk(self.initial_shear_modulus(constants, compressibility))
        return febio_hyperelastic("Ogden", terms, bulk)

    def ogden_classical(self, constants: Constants) -> Converted:
        """W = sum m_p / a_p (...), so m_p = 2 mu_p / alpha_p."""
        mu, alpha = ogden_terms(constants)
        if not alpha.all():
            rule = "the classical form needs exponents that are not 0"
            raise InputError(Fault("convention", rule))
        values: dict[str, float] = {}
        for i, (m, a) in enumerate(zip(mu, alpha, strict=True), 1):
            values |= {f"m{i}": 2 * float(m / a), f"alpha{i}": float(a)}
        return Converted("ogden-classical", "Ogden (1972)", values)


def ogden_terms(constants: Constants) -> tuple[Array, Array]:
    """Moduli mu_i (MPa) and exponents alpha_i, each shape (n,), of constants in order.

    Parameters
    ----------
    constants : mapping of str to float
        mu1, alpha1, mu2, alpha2, ...: their order counts, not their names.
    """
    values = np.array(list(constants.values()))
    return values[0::2].copy(), values[1::2].copy()


def _phi(z: Array) -> Array:
    """(e^z - 1) / z, with its limit 1 at zero."""
    return _series_or(z, lambda k: 1.0 / (k + 1), lambda w: np.expm1(w) / w)


def _phi2(z: Array) -> Array:
    """(e^z - 1 - z) / z^2, with its limit 1/2 at zero."""
    return _series_or(z, lambda k: 1.0 / ((k + 1) * (k + 2)), lambda w: (np.expm1(w) - w) / w**2)


def _phi_slope(z: Array) -> Array:
    """Differentiate :func:`_phi`, with its limit 1/2 at zero."""
    return _series_or(z, lambda k: 1.0 / (k + 2), lambda w: (np.exp(w) * (w - 1) + 1) / w**2)


def _series_or(
    z: Array, weight: Callable[[int], float], formula: Callable[[Array], Array]
) -> Array:
    """Power series sum weight(k) z^k / k! where |z| < 0.5, the formula elsewhere.

    Below 0.5 the formulas lose digits to cancellation; 18 terms reach rounding there.
    """
    z = np.asarray(z, dtype=float)
    small = np.abs(z) < 0.5
    near, total, power = np.where(small, z, 0.0), np.zeros_like(z), np.ones_like(z)
    for k in range(18):
        total = total + weight(k) * power
        power = power * near / (k + 1)
    far = formula(np.where(small, 1.0, z))
    return np.where(small, total, far)
