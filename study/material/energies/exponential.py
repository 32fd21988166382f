"""Energies that grow exponentially with the first invariant.

``W = (p + q a) exp(k a) - p + d b`` with a = I1 - 3 and b = I2 - 3 holds these energies and their
derivatives by their constants, so that one compiled law serves them all.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import NamedTuple

import numpy as np

from study.arrays import Array
from study.material.compressibility import Compressibility
from study.material.energies.invariant import Curvatures, InvariantEnergy, Slopes
from study.material.energy import Constants, Law, PointLaw

#: k a beyond which a state has no stress: e^500 is near the largest number there is
LARGEST_EXPONENT = 500.0


class Exponential(NamedTuple):
    """Coefficients of an exponential energy, or of its derivative by a constant.

    Parameters
    ----------
    p, q : float
        Of the exponential function and of a times it, MPa.
    k : float
        Of the exponent.
    d : float
        Of the second invariant, MPa.
    """

    p: float
    q: float
    k: float
    d: float = 0.0

    def growth(self, a: Array) -> Array:
        """exp(k a); NaN beyond :data:`LARGEST_EXPONENT`."""
        exponent = self.k * np.asarray(a, float)
        within = exponent < LARGEST_EXPONENT
        return np.where(within, np.exp(np.where(within, exponent, 0.0)), np.nan)

    def slopes(self, a: Array) -> Slopes:
        """By I1 and I2."""
        return Slopes((self.q + self.k * (self.p + self.q * a)) * self.growth(a), self.d)


class ExponentialEnergy(InvariantEnergy):
    """Energy of this form."""

    #: Whether the second invariant enters.
    has_second_invariant = False

    @abstractmethod
    def coefficients(self, constants: Constants) -> Exponential:
        """Those of W; q is zero."""

    @abstractmethod
    def coefficient_rates(self, constants: Constants, name: str) -> Exponential:
        """Those of the derivative of W by a constant."""

    def value(self, constants: Constants, a: Array, b: Array) -> Array:
        """Written with exp(k a) - 1, which keeps its digits at small strain."""
        c = self.coefficients(constants)
        return np.asarray(c.p * np.expm1(c.k * a) + c.d * b)

    def slopes(self, constants: Constants, a: Array, b: Array) -> Slopes:
        """Of W."""
        return self.coefficients(constants).slopes(a)

    def curvatures(self, constants: Constants, a: Array, b: Array) -> Curvatures:
        """By the first invariant alone."""
        c = self.coefficients(constants)
        return Curvatures(c.k**2 * c.p * c.growth(a))

    def slope_gradients(self, constants: Constants, a: Array, b: Array) -> dict[str, Slopes]:
        """Of the derivatives."""
        return {n: self.coefficient_rates(constants, n).slopes(a) for n in constants}

    def law(self, constants: Constants, compressibility: Compressibility) -> Law:
        """Hand over p, q, k, and d in a second column where it enters."""
        return self._law(self.coefficients(constants))

    def law_rate(self, constants: Constants, compressibility: Compressibility, name: str) -> Law:
        """Hand over those of the derivative."""
        return self._law(self.coefficient_rates(constants, name))

    def _law(self, c: Exponential) -> Law:
        table = np.array([[c.p, c.d], [c.q, 0.0], [c.k, 0.0]])
        columns = 2 if self.has_second_invariant else 1
        return Law(PointLaw.EXPONENTIAL, np.ascontiguousarray(table[:, :columns]))
