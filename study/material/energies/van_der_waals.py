"""Kilian's van der Waals energy in the form of Abaqus (Theory Guide, 4.6.1).

    W = mu (-(lambda_m^2 - 3) (ln(1 - eta) + eta) - 2/3 a ((I - 3) / 2)^(3/2)),
    I = (1 - beta) I1 + beta I2,    eta = sqrt((I - 3) / (lambda_m^2 - 3))

Kilian, Enderle and Unseld (1986, Colloid Polym. Sci. 264, 866-876). A state beyond eta = 1, a
stretch of chains beyond lambda_m, has no stress.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from study.arrays import Array
from study.material.compressibility import Compressibility
from study.material.convention import Converted, abaqus_logarithmic
from study.material.energies.invariant import Curvatures, InvariantEnergy, Slopes
from study.material.energy import Constant, Constants, DeclaredConstants, Law, PointLaw

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

    def value(self, constants: Constants, a: Array, b: Array) -> Array:
        """W, with ln(1 - eta) + eta negative."""
        at = _State.of(constants, a, b)
        chains = -at.room * (np.log1p(-at.eta) + at.eta)
        return np.asarray(constants["mu"] * (chains - 2 / 3 * constants["a"] * (0.5 * at.x) ** 1.5))

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

    def abaqus(self, constants: Constants, compressibility: Compressibility) -> Converted:
        """Abaqus has the same form, with another volumetric term; FEBio has none."""
        bulk = compressibility.bulk(constants["mu"])
        return abaqus_logarithmic("van der waals", constants, bulk)


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
