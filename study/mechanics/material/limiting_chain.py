"""Gent's energy: W = -mu Jm / 2 ln(1 - (I1 - 3) / Jm) (Gent 1996, Rubber Chem. Technol. 69, 59)."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.polynomial import polynomial

from study.ground.arrays import Array
from study.mechanics.material.energy import (
    Compressibility,
    Constant,
    Constants,
    DeclaredConstants,
    Law,
    PointLaw,
)
from study.mechanics.material.polynomial import (
    Curvatures,
    Form,
    FormEnergy,
    InvariantEnergy,
    Slopes,
    Table,
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


#: Jm that a fit starts from: of natural rubber, which tears before a uniaxial stretch of 10
STARTING_LIMIT = 100.0


class Gent(DeclaredConstants, FormEnergy):
    """Initial shear modulus mu and limit Jm of I1 - 3; neo-Hookean where Jm is large."""

    name = "gent"
    shear_modulus_formula = "mu"
    declared = (Constant("mu", 0.0, np.inf), Constant("Jm", 1e-4, 1e7, True))

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

    def always_elliptic(self, constants: Constants) -> bool:
        """Whether it is a convex function of the stretches, as far as it reaches."""
        return constants["mu"] > 0 and constants["Jm"] > 0

    def starting_values(self, names: Collection[str], shear_modulus: float) -> dict[str, float]:
        """Chains that are far from their end."""
        return {"mu": shear_modulus, "Jm": STARTING_LIMIT}


# Eight-chain energy of Arruda and Boyce (1993) in five terms: W = mu sum C_k / lambda_m^(2k-2)
# (I1^k - 3^k), C = 1/2, 1/20, 11/1050, 19/7000, 519/673750 (Abaqus Theory Guide, 4.6.1). The
# series has no limit at lambda_m; published constants were fitted with it.

#: C_k of the series
SERIES = np.array([1 / 2, 1 / 20, 11 / 1050, 19 / 7000, 519 / 673750])
#: rows k: coefficients of I1^k - 3^k by powers of I1 - 3, all of them positive
POWERS = np.zeros((5, 6))
for _k in range(1, 6):
    POWERS[_k - 1, 1 : _k + 1] = polynomial.polypow([3.0, 1.0], _k)[1:]

#: locking stretch that a fit starts from: beyond what most rubbers are tested to
STARTING_STRETCH = 5.0


class ArrudaBoyce(DeclaredConstants, FormEnergy):
    """Modulus mu and locking stretch lambda_m; mu0 is larger than mu."""

    name = "arruda-boyce"
    shear_modulus_formula = "mu (1 + 3/(5 lambda_m^2) + 99/(175 lambda_m^4) + ...)"
    declared = (Constant("mu", 0.0, np.inf), Constant("lambda_m", 1.0, 1e3, True))

    def form(self, constants: Constants) -> Table:
        """Expand the powers of I1 about 3."""
        weights = SERIES * constants["lambda_m"] ** (-2.0 * np.arange(5))
        return Table(np.asarray(constants["mu"] * weights @ POWERS)[:, None])

    def form_rate(self, constants: Constants, name: str) -> Table:
        """Differentiate each power of lambda_m."""
        if name == "mu":
            return self.form({**constants, "mu": 1.0})
        stretch, powers = constants["lambda_m"], -2.0 * np.arange(5)
        weights = SERIES * powers * stretch ** (powers - 1)
        return Table(np.asarray(constants["mu"] * weights @ POWERS)[:, None])

    def always_elliptic(self, constants: Constants) -> bool:
        """Every term is convex and rises."""
        return constants["mu"] > 0

    def starting_values(self, names: Collection[str], shear_modulus: float) -> dict[str, float]:
        """Chains that are far from their end."""
        unit = {"mu": 1.0, "lambda_m": STARTING_STRETCH}
        scale = 2 * float(self.form(unit).coefficients[1, 0])
        return unit | {"mu": shear_modulus / scale}


# Kilian's van der Waals energy in the form of Abaqus (Theory Guide, 4.6.1).
#     W = mu (-(lambda_m^2 - 3) (ln(1 - eta) + eta) - 2/3 a ((I - 3) / 2)^(3/2)),
#     I = (1 - beta) I1 + beta I2,    eta = sqrt((I - 3) / (lambda_m^2 - 3))

# Kilian, Enderle and Unseld (1986, Colloid Polym. Sci. 264, 866-876). A state beyond eta = 1, a
# stretch of chains beyond lambda_m, has no stress.

#: starts of a fit: I1 may reach 100, little interaction, the first invariant alone
STARTING_LOCKING_STRETCH = 10.0
STARTING_INTERACTION = 0.1
#: mixed invariant less 3 below which its root is that of rounding
_REST = 1e-30

_ROOT_HALF = np.sqrt(0.5)


class VanDerWaals(DeclaredConstants, InvariantEnergy):
    """Initial shear modulus mu, locking stretch lambda_m, interaction a, mixture beta."""

    name = "van-der-waals"
    shear_modulus_formula = "mu"
    declared = (
        Constant("mu", 0.0, np.inf),
        # sqrt(3) is a solid that cannot be stretched at all
        Constant("lambda_m", 1.7321, 1e3, True),
        Constant("a", -10.0, 10.0, True),
        Constant("beta", 0.0, 1.0, True),
    )

    def slopes(self, constants: Constants, a: Array, b: Array) -> Slopes:
        """dW/dI = mu / 2 (1 / (1 - eta) - a sqrt((I - 3) / 2))."""
        return _mixed(_State.of(constants, a, b).slope(constants), constants["beta"])

    def curvatures(self, constants: Constants, a: Array, b: Array) -> Curvatures:
        """d2W/dI2, not finite at rest, where it meets the square of a strain."""
        curvature, beta = _State.of(constants, a, b).curvature(constants), constants["beta"]
        return Curvatures(
            (1 - beta) ** 2 * curvature, (1 - beta) * beta * curvature, beta**2 * curvature
        )

    def slope_gradients(self, constants: Constants, a: Array, b: Array) -> dict[str, Slopes]:
        """By each constant; beta also turns the mixture."""
        at, beta, half = _State.of(constants, a, b), constants["beta"], 0.5 * constants["mu"]
        slope, turned = at.slope(constants), at.curvature(constants) * (b - a)
        crowding = -half * constants["lambda_m"] / at.room * at.eta / (1 - at.eta) ** 2
        return {
            "mu": _mixed(at.slope({**constants, "mu": 1.0}), beta),
            "lambda_m": _mixed(crowding, beta),
            "a": _mixed(-half * np.sqrt(0.5 * at.x), beta),
            "beta": Slopes((1 - beta) * turned - slope, beta * turned + slope),
        }

    def law(self, constants: Constants, compressibility: Compressibility) -> Law:
        """P / (1 - eta) + Q eta / (1 - eta)^2 + S sqrt(I - 3) is dW/dI."""
        mu = constants["mu"]
        return _law(constants, 0.5 * mu, 0.0, -0.5 * mu * constants["a"] * _ROOT_HALF)

    def law_rate(self, constants: Constants, compressibility: Compressibility, name: str) -> Law:
        """Of the same form, but for beta."""
        mu, room = constants["mu"], constants["lambda_m"] ** 2 - 3
        if name == "mu":
            return self.law({**constants, "mu": 1.0}, compressibility)
        if name == "lambda_m":
            return _law(constants, 0.0, -0.5 * mu * constants["lambda_m"] / room, 0.0)
        if name == "a":
            return _law(constants, 0.0, 0.0, -0.5 * mu * _ROOT_HALF)
        kind = PointLaw.VAN_DER_WAALS_BY_MIXTURE
        return Law(kind, self.law(constants, compressibility).constants)

    def starting_values(self, names: Collection[str], shear_modulus: float) -> dict[str, float]:
        """Chains that are far from their end, and hardly interact."""
        return {
            "mu": shear_modulus, "lambda_m": STARTING_LOCKING_STRETCH,
            "a": STARTING_INTERACTION, "beta": 0.0,
        }  # fmt: skip


class _State(NamedTuple):
    """Mixed invariant less 3, room lambda_m^2 - 3 for it, and eta, NaN from 1 on."""

    x: Array
    room: float
    eta: Array

    @classmethod
    def of(cls, constants: Constants, a: Array, b: Array) -> _State:
        beta, room = constants["beta"], constants["lambda_m"] ** 2 - 3
        # rounding may leave it a little below zero at rest
        x = np.maximum((1 - beta) * np.asarray(a, float) + beta * np.asarray(b, float), 0.0)
        eta = np.sqrt(x / room)
        return cls(x, room, np.where(eta < 1, eta, np.nan))

    def slope(self, constants: Constants) -> Array:
        """dW/dI in MPa."""
        attraction = constants["a"] * np.sqrt(0.5 * self.x)
        return np.asarray(0.5 * constants["mu"] * (1 / (1 - self.eta) - attraction))

    def curvature(self, constants: Constants) -> Array:
        """d2W/dI2 in MPa; 0 at rest."""
        moved = self.x > _REST
        root = np.sqrt(np.where(moved, self.x, 1.0))
        chains = 0.5 / (np.sqrt(self.room) * root * (1 - self.eta) ** 2)
        attraction = 0.25 * constants["a"] / (_ROOT_HALF * root)
        return np.where(moved, 0.5 * constants["mu"] * (chains - attraction), 0.0)


def _mixed(slope: Array, beta: float) -> Slopes:
    return Slopes((1 - beta) * slope, beta * slope)


def _law(constants: Constants, p: float, q: float, s: float) -> Law:
    room = constants["lambda_m"] ** 2 - 3
    return Law(PointLaw.VAN_DER_WAALS, np.array([[room, constants["beta"]], [p, q], [s, 0.0]]))
