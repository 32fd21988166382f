"""Energies of chains that end: W has a pole where e (I1 - 3) = 1.

``dW/dI1 = A1 s + A2 s^2 + A3 s^3`` with ``s = 1 / (1 - e (I1 - 3))`` holds these energies and their
derivatives by their constants, so that one compiled law serves them all. A state beyond the pole
has no stress: closed forms answer NaN, and a load step of finite elements is halved.
"""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from study.arrays import Array
from study.material.compressibility import Compressibility
from study.material.energies.invariant import Curvatures, InvariantEnergy, Slopes
from study.material.energy import Constants, Law, PointLaw


class FiniteExtensibilityEnergy(InvariantEnergy):
    """Energy with such a pole."""

    @abstractmethod
    def poles(self, constants: Constants) -> Array:
        """Return e (plain) and A1, A2, A3 (MPa) of W, shape (4,)."""

    @abstractmethod
    def pole_rates(self, constants: Constants, name: str) -> Array:
        """Return e and A1, A2, A3 of the derivative of W by a constant, shape (4,)."""

    def value(self, constants: Constants, a: Array, b: Array) -> Array:
        """Integrate the slope."""
        e, first, second, third = self.poles(constants)
        s = _inverse_gap(e, a)
        logarithm = -np.log1p(np.where(np.isnan(s), np.nan, -e * a)) / e
        return np.asarray(first * logarithm + second * a * s + third * 0.5 * a * (2 - e * a) * s**2)

    def slopes(self, constants: Constants, a: Array, b: Array) -> Slopes:
        """Of W."""
        return _slopes(self.poles(constants), a)

    def curvatures(self, constants: Constants, a: Array, b: Array) -> Curvatures:
        """ds/da = e s^2."""
        e, first, second, third = self.poles(constants)
        s = _inverse_gap(e, a)
        return Curvatures(e * s**2 * (first + 2 * second * s + 3 * third * s**2))

    def slope_gradients(self, constants: Constants, a: Array, b: Array) -> dict[str, Slopes]:
        """Of the derivatives."""
        return {n: _slopes(self.pole_rates(constants, n), a) for n in constants}

    def law(self, constants: Constants, compressibility: Compressibility) -> Law:
        """Hand over e, A1, A2, A3 in one column."""
        return Law(PointLaw.FINITE_EXTENSIBILITY, self.poles(constants)[:, None])

    def law_rate(self, constants: Constants, compressibility: Compressibility, name: str) -> Law:
        """Hand over those of the derivative."""
        return Law(PointLaw.FINITE_EXTENSIBILITY, self.pole_rates(constants, name)[:, None])


def _slopes(poles: Array, a: Array) -> Slopes:
    e, first, second, third = poles
    s = _inverse_gap(e, a)
    return Slopes(s * (first + s * (second + s * third)))


def _inverse_gap(e: float, a: Array) -> Array:
    """1 / (1 - e a); NaN at the pole and beyond."""
    gap = 1 - e * np.asarray(a, float)
    return np.where(gap > 0, 1 / np.where(gap > 0, gap, 1.0), np.nan)
