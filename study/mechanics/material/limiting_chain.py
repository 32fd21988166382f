"""Gent's energy: W = -mu Jm / 2 ln(1 - (I1 - 3) / Jm) (Gent 1996, Rubber Chem. Technol. 69, 59)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import polynomial

from study.ground.arrays import Array
from study.mechanics.material.energy import Constant, Constants, DeclaredConstants, Law, PointLaw
from study.mechanics.material.polynomial import (
    Curvatures,
    Form,
    InvariantEnergy,
    PolynomialTable,
    Slopes,
)

# Energies of chains that end: W has a pole where e (I1 - 3) = 1. ``dW/dI1 = A1 s + A2 s^2 + A3
# s^3`` with ``s = 1 / (1 - e (I1 - 3))`` serves them all; a state beyond the pole has no stress
# (NaN).


@dataclass(frozen=True)
class Pole(Form):
    """Energy with such a pole, or its derivative by a constant."""

    #: Plain.
    e: float
    #: A1, A2 and A3, MPa.
    first: float
    second: float = 0.0
    third: float = 0.0

    def slopes(self, a: Array, b: Array) -> Slopes:
        """By the first invariant alone."""
        s = self._inverse_gap(a)
        return Slopes(s * (self.first + s * (self.second + s * self.third)))

    def curvatures(self, a: Array, b: Array) -> Curvatures:
        """ds/da = e s^2."""
        s = self._inverse_gap(a)
        by_s = self.first + 2 * self.second * s + 3 * self.third * s**2
        return Curvatures(self.e * s**2 * by_s)

    def law(self) -> Law:
        """Hand over e, A1, A2, A3 in one column."""
        column = np.array([[self.e], [self.first], [self.second], [self.third]])
        return Law(PointLaw.FINITE_EXTENSIBILITY, column)

    def _inverse_gap(self, a: Array) -> Array:
        """1 / (1 - e a); NaN at the pole and beyond."""
        gap = 1 - self.e * np.asarray(a, float)
        return np.where(gap > 0, 1 / np.where(gap > 0, gap, 1.0), np.nan)


class Gent(DeclaredConstants, InvariantEnergy):
    """Initial shear modulus mu and limit Jm of I1 - 3; neo-Hookean where Jm is large."""

    name = "gent"
    shear_modulus_formula = "mu"
    # a fit starts from natural rubber, which tears before a uniaxial stretch of 10
    declared = (Constant("mu", 0.0, np.inf), Constant("Jm", 1e-4, 1e7, True, start=100.0))
    is_convex = True

    def form(self, constants: Constants) -> Pole:
        """dW/dI1 = mu / 2 Jm / (Jm - I1 + 3)."""
        return Pole(1 / constants["Jm"], constants["mu"] / 2)

    def form_rate(self, constants: Constants, name: str) -> Pole:
        """By Jm it is -mu / 2 a e^2 s^2, and a e s = s - 1."""
        e = 1 / constants["Jm"]
        if name == "mu":
            return Pole(e, 0.5)
        half = constants["mu"] * e / 2
        return Pole(e, half, -half)


# Eight-chain energy of Arruda and Boyce (1993) in five terms: W = mu sum C_k / lambda_m^(2k-2)
# (I1^k - 3^k), C = 1/2, 1/20, 11/1050, 19/7000, 519/673750 (Abaqus Theory Guide, 4.6.1). The
# series has no limit at lambda_m; published constants were fitted with it.

#: C_k of the series
SERIES = np.array([1 / 2, 1 / 20, 11 / 1050, 19 / 7000, 519 / 673750])
#: rows k: coefficients of I1^k - 3^k by powers of I1 - 3, all of them positive
POWERS = np.zeros((5, 6))
for _k in range(1, 6):
    POWERS[_k - 1, 1 : _k + 1] = polynomial.polypow([3.0, 1.0], _k)[1:]


class ArrudaBoyce(DeclaredConstants, InvariantEnergy):
    """Modulus mu and locking stretch lambda_m; mu0 is larger than mu."""

    name = "arruda-boyce"
    shear_modulus_formula = "mu (1 + 3/(5 lambda_m^2) + 99/(175 lambda_m^4) + ...)"
    # a fit starts beyond the stretch that most rubbers are tested to
    declared = (Constant("mu", 0.0, np.inf), Constant("lambda_m", 1.0, 1e3, True, start=5.0))
    is_convex = True

    def form(self, constants: Constants) -> PolynomialTable:
        """Expand the powers of I1 about 3."""
        weights = SERIES * constants["lambda_m"] ** (-2.0 * np.arange(5))
        return PolynomialTable(np.asarray(constants["mu"] * weights @ POWERS)[:, None])

    def form_rate(self, constants: Constants, name: str) -> PolynomialTable:
        """Differentiate each power of lambda_m."""
        if name == "mu":
            return self.form({**constants, "mu": 1.0})
        stretch, powers = constants["lambda_m"], -2.0 * np.arange(5)
        weights = SERIES * powers * stretch ** (powers - 1)
        return PolynomialTable(np.asarray(constants["mu"] * weights @ POWERS)[:, None])


# Kilian's van der Waals energy in the form of Abaqus (Theory Guide, 4.6.1).
#     W = mu (-(lambda_m^2 - 3) (ln(1 - eta) + eta) - 2/3 a ((I - 3) / 2)^(3/2)),
#     I = (1 - beta) I1 + beta I2,    eta = sqrt((I - 3) / (lambda_m^2 - 3))

# Kilian, Enderle and Unseld (1986, Colloid Polym. Sci. 264, 866-876). A state beyond eta = 1, a
# stretch of chains beyond lambda_m, has no stress.

#: mixed invariant less 3 below which its root is that of rounding
_REST = 1e-30

_ROOT_HALF = np.sqrt(0.5)


@dataclass(frozen=True)
class Chains(Form):
    """dW/dI = p / (1 - eta) + q eta / (1 - eta)^2 + s sqrt(I - 3)."""

    #: lambda_m^2 - 3, and the mixture; plain.
    room: float
    beta: float
    #: MPa.
    p: float
    q: float = 0.0
    s: float = 0.0

    def slope(self, a: Array, b: Array) -> Array:
        """dW/dI in MPa."""
        x, eta = self._state(a, b)
        return np.asarray(self.p / (1 - eta) + self.q * eta / (1 - eta) ** 2 + self.s * np.sqrt(x))

    def curvature(self, a: Array, b: Array) -> Array:
        """d2W/dI2 in MPa, where q is zero, as it is of W; 0 at rest, where it is not finite."""
        x, eta = self._state(a, b)
        moved = x > _REST
        root = np.sqrt(np.where(moved, x, 1.0))
        chains = self.p / (np.sqrt(self.room) * (1 - eta) ** 2)
        return np.where(moved, 0.5 * (chains + self.s) / root, 0.0)

    def slopes(self, a: Array, b: Array) -> Slopes:
        """By the mixture of both."""
        slope = self.slope(a, b)
        return Slopes((1 - self.beta) * slope, self.beta * slope)

    def curvatures(self, a: Array, b: Array) -> Curvatures:
        """By the mixture of both."""
        curvature, first, second = self.curvature(a, b), 1 - self.beta, self.beta
        return Curvatures(first**2 * curvature, first * second * curvature, second**2 * curvature)

    def law(self) -> Law:
        """Room and mixture, p and q, s."""
        table = [[self.room, self.beta], [self.p, self.q], [self.s, 0.0]]
        return Law(PointLaw.VAN_DER_WAALS, np.array(table))

    def _state(self, a: Array, b: Array) -> tuple[Array, Array]:
        """Mixed invariant less 3, and eta, NaN from 1 on."""
        # rounding may leave it a little below zero at rest
        mixed = (1 - self.beta) * np.asarray(a, float) + self.beta * np.asarray(b, float)
        x = np.maximum(mixed, 0.0)
        eta = np.sqrt(x / self.room)
        return x, np.where(eta < 1, eta, np.nan)


class MixtureRate(Chains):
    """Derivative of W by the mixture, which turns both of its slopes."""

    def slopes(self, a: Array, b: Array) -> Slopes:
        """Differentiate the mixture, and the invariant in it."""
        slope, turned = self.slope(a, b), self.curvature(a, b) * (b - a)
        return Slopes((1 - self.beta) * turned - slope, self.beta * turned + slope)

    def law(self) -> Law:
        """Coefficients of W, of another law."""
        return Law(PointLaw.VAN_DER_WAALS_BY_MIXTURE, super().law().constants)


class VanDerWaals(DeclaredConstants, InvariantEnergy):
    """Initial shear modulus mu, locking stretch lambda_m, interaction a, mixture beta."""

    name = "van-der-waals"
    shear_modulus_formula = "mu"
    declared = (
        Constant("mu", 0.0, np.inf),
        # sqrt(3) is a solid that cannot be stretched at all; a fit starts where I1 may reach 100,
        # with little interaction and from the first invariant alone
        Constant("lambda_m", 1.7321, 1e3, True, start=10.0),
        Constant("a", -10.0, 10.0, True, start=0.1),
        Constant("beta", 0.0, 1.0, True, start=0.0),
    )

    def form(self, constants: Constants) -> Chains:
        """dW/dI = mu / 2 (1 / (1 - eta) - a sqrt((I - 3) / 2))."""
        half, room = 0.5 * constants["mu"], constants["lambda_m"] ** 2 - 3
        return Chains(room, constants["beta"], half, s=-half * constants["a"] * _ROOT_HALF)

    def form_rate(self, constants: Constants, name: str) -> Chains:
        """Of the same form, but for beta, which also turns the mixture."""
        whole, half = self.form(constants), 0.5 * constants["mu"]
        if name == "mu":
            return self.form({**constants, "mu": 1.0})
        if name == "lambda_m":
            return replace(whole, p=0.0, q=-half * constants["lambda_m"] / whole.room, s=0.0)
        if name == "a":
            return replace(whole, p=0.0, s=-half * _ROOT_HALF)
        return MixtureRate(whole.room, whole.beta, whole.p, whole.q, whole.s)
