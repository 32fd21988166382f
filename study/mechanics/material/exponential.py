"""Energies that grow exponentially with the first invariant.

``W = (p + q a) exp(k a) - p + d b`` with a = I1 - 3 and b = I2 - 3 holds these energies and their
derivatives by their constants, so that one compiled law serves them all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.ground.arrays import Array
from study.mechanics.material.energy import Constant, Constants, DeclaredConstants, Law, PointLaw
from study.mechanics.material.polynomial import Curvatures, Form, InvariantEnergy, Slopes

#: k a beyond which a state has no stress: e^500 is near the largest number there is
LARGEST_EXPONENT = 500.0
#: stiffening that a fit starts from: W is nearly neo-Hookean at moderate strain
STARTING_STIFFENING = 0.1


@dataclass(frozen=True)
class Exponential(Form):
    """Exponential energy, or its derivative by a constant."""

    #: Of the exponential function and of a times it, MPa.
    p: float
    q: float
    k: float
    #: Of the second invariant, MPa; None where that does not enter.
    d: float | None = None

    def growth(self, a: Array) -> Array:
        """exp(k a); NaN beyond :data:`LARGEST_EXPONENT`."""
        exponent = self.k * np.asarray(a, float)
        within = exponent < LARGEST_EXPONENT
        return np.where(within, np.exp(np.where(within, exponent, 0.0)), np.nan)

    def slopes(self, a: Array, b: Array) -> Slopes:
        """By I1 and I2."""
        by_a = (self.q + self.k * (self.p + self.q * a)) * self.growth(a)
        return Slopes(by_a, self.d or 0.0)

    def curvatures(self, a: Array, b: Array) -> Curvatures:
        """By the first invariant alone, where q is zero, as it is of W."""
        return Curvatures(self.k**2 * self.p * self.growth(a))

    def law(self) -> Law:
        """Hand over p, q, k, and d in a second column where it enters."""
        column = np.array([[self.p], [self.q], [self.k]])
        if self.d is not None:
            column = np.hstack([column, [[self.d], [0.0], [0.0]]])
        return Law(PointLaw.EXPONENTIAL, column)


# Isotropic exponential energy of soft tissue: W = mu / (2 b) (exp(b (I1 - 3)) - 1), Fung's law
# (1967) by Demiray (1972, J. Biomech. 5, 309-311); c = mu / (2 b) in Humphrey and Yin (1987).


class Fung(DeclaredConstants, InvariantEnergy):
    """Initial shear modulus mu and stiffening b; neo-Hookean as b goes to zero."""

    name = "fung"
    shear_modulus_formula = "mu"
    declared = (Constant("mu", 0.0, np.inf), Constant("b", 1e-6, 1e4, True, STARTING_STIFFENING))
    is_convex = True

    def form(self, constants: Constants) -> Exponential:
        """Return mu / (2 b) of the exponential function."""
        mu, b = constants["mu"], constants["b"]
        return Exponential(0.5 * mu / b, 0.0, b)

    def form_rate(self, constants: Constants, name: str) -> Exponential:
        """Differentiate mu / (2 b) exp(b a)."""
        mu, b = constants["mu"], constants["b"]
        if name == "mu":
            return Exponential(0.5 / b, 0.0, b)
        return Exponential(-0.5 * mu / b**2, 0.5 * mu / b, b)


# Energy of skin: W = C1 (exp(C2 (I1 - 3)) - 1) - C1 C2 / 2 (I2 - 3), Veronda and Westmann (1970,
# J. Biomech. 3, 111-124) without their volumetric term, as in FEBio (User Manual, 4.1.2).


class VerondaWestmann(DeclaredConstants, InvariantEnergy):
    """Modulus C1 and stiffening C2; mu0 = C1 C2.

    At small strain W falls with I2, so that it may be unstable in equibiaxial tension where C2
    is small: stability says from where on.
    """

    name = "veronda-westmann"
    shear_modulus_formula = "C1 C2"
    declared = (Constant("C1", 0.0, np.inf), Constant("C2", 1e-6, 1e4, True, STARTING_STIFFENING))

    def form(self, constants: Constants) -> Exponential:
        """C1 of the exponential function, -C1 C2 / 2 of the second invariant."""
        c1, c2 = constants["C1"], constants["C2"]
        return Exponential(c1, 0.0, c2, -0.5 * c1 * c2)

    def form_rate(self, constants: Constants, name: str) -> Exponential:
        """Differentiate W by each."""
        c1, c2 = constants["C1"], constants["C2"]
        if name == "C1":
            return Exponential(1.0, 0.0, c2, -0.5 * c2)
        return Exponential(0.0, c1, c2, -0.5 * c1)
