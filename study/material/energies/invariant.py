"""What energies W(I1, I2) of the isochoric invariants have in common.

Each of them says W, its slopes and curvatures by ``a = I1 - 3`` and ``b = I2 - 3``, and how the
slopes go with every constant; principal stresses follow by the chain rule (Holzapfel 2000,
eqs. 6.32 and 6.52).
"""

from __future__ import annotations

from abc import abstractmethod
from typing import NamedTuple

import numpy as np

from study.arrays import Array
from study.material.compressibility import Compressibility
from study.material.energy import Constants, IsochoricEnergy


class Slopes(NamedTuple):
    """First derivatives of W, or of its derivative by a constant.

    Parameters
    ----------
    by_a, by_b : ndarray or float
        By I1 and I2, MPa.
    """

    by_a: Array | float
    by_b: Array | float = 0.0


class Curvatures(NamedTuple):
    """Second derivatives of W.

    Parameters
    ----------
    aa, ab, bb : ndarray or float
        By I1 twice, by both, by I2 twice, MPa.
    """

    aa: Array | float
    ab: Array | float = 0.0
    bb: Array | float = 0.0


class Invariants(NamedTuple):
    """Squares of isochoric stretches and their invariants.

    Parameters
    ----------
    squares : ndarray, shape (3, ...)
        bar_i^2.
    i1, a, b : ndarray, shape (...)
        I1, I1 - 3 and I2 - 3.
    """

    squares: Array
    i1: Array
    a: Array
    b: Array

    @classmethod
    def of(cls, bar: Array) -> Invariants:
        """Of isochoric principal stretches, shape (3, ...)."""
        b = bar**2
        i1 = np.add.reduce(b)
        i2 = b[0] * b[1] + b[1] * b[2] + b[2] * b[0]
        return cls(b, i1, i1 - 3, i2 - 3)


class InvariantEnergy(IsochoricEnergy):
    """Energy of the isochoric invariants; NaN beyond a limit of the stretch, where it has one."""

    @abstractmethod
    def value(self, constants: Constants, a: Array, b: Array) -> Array:
        """W in MPa at a = I1 - 3 and b = I2 - 3."""

    @abstractmethod
    def slopes(self, constants: Constants, a: Array, b: Array) -> Slopes:
        """First derivatives of W."""

    @abstractmethod
    def curvatures(self, constants: Constants, a: Array, b: Array) -> Curvatures:
        """Second derivatives of W."""

    @abstractmethod
    def slope_gradients(self, constants: Constants, a: Array, b: Array) -> dict[str, Slopes]:
        """Differentiate the slopes by every constant."""

    def principal_stress(self, constants: Constants, bar: Array) -> Array:
        """2 b_i (W_1 + W_2 (I1 - b_i)) with b_i = bar_i^2."""
        at = Invariants.of(bar)
        return _stress(at, self.slopes(constants, at.a, at.b))

    def principal_stress_slope(self, constants: Constants, bar: Array, direction: Array) -> Array:
        """Differentiate by the chain rule through both invariants."""
        at = Invariants.of(bar)
        slopes = self.slopes(constants, at.a, at.b)
        return _stress_slope(at, slopes, self.curvatures(constants, at.a, at.b), direction)

    def stress_and_slope(
        self, constants: Constants, bar: Array, direction: Array
    ) -> tuple[Array, Array]:
        """Both from the same invariants and slopes of W."""
        at = Invariants.of(bar)
        slopes = self.slopes(constants, at.a, at.b)
        curvatures = self.curvatures(constants, at.a, at.b)
        return _stress(at, slopes), _stress_slope(at, slopes, curvatures, direction)

    def principal_stress_gradient(self, constants: Constants, bar: Array) -> dict[str, Array]:
        """Stress of each derivative of W."""
        at = Invariants.of(bar)
        rates = self.slope_gradients(constants, at.a, at.b)
        return {name: _stress(at, rates[name]) for name in constants}

    def energy_density(self, constants: Constants, bar: Array) -> Array:
        """W itself."""
        at = Invariants.of(bar)
        return np.asarray(self.value(constants, at.a, at.b))

    def initial_shear_modulus(
        self, constants: Constants, compressibility: Compressibility
    ) -> float:
        """2 (W_1 + W_2) at rest."""
        rest = np.zeros(1)
        return _shear(self.slopes(constants, rest, rest))

    def initial_shear_modulus_gradient(
        self, constants: Constants, compressibility: Compressibility
    ) -> dict[str, float]:
        """Differentiate 2 (W_1 + W_2) at rest."""
        rest = np.zeros(1)
        rates = self.slope_gradients(constants, rest, rest)
        return {name: _shear(rates[name]) for name in constants}


def _stress(at: Invariants, slopes: Slopes) -> Array:
    w1, w2 = slopes
    if _vanish(w2):
        return np.asarray(2 * at.squares * w1)
    return np.asarray(2 * at.squares * (w1 + w2 * (at.i1 - at.squares)))


def _stress_slope(
    at: Invariants, slopes: Slopes, curvatures: Curvatures, direction: Array
) -> Array:
    """Differentiate the stress along one direction or several, shape (..., 3, n)."""
    b = at.squares
    (w1, w2), (w11, w12, w22) = slopes, curvatures
    db = 2 * b * direction[..., None]
    di1 = np.add.reduce(db, axis=-2, keepdims=True)
    if _vanish(w2, w12, w22):
        return np.asarray(2 * db * w1 + 2 * b * (w11 * di1))
    rest = at.i1 - b
    di2 = np.add.reduce(rest * db, axis=-2, keepdims=True)
    dw1, dw2 = w11 * di1 + w12 * di2, w12 * di1 + w22 * di2
    return np.asarray(2 * db * (w1 + w2 * rest) + 2 * b * (dw1 + dw2 * rest + w2 * (di1 - db)))


def _vanish(*derivatives: Array | float) -> bool:
    """Whether derivatives are zero everywhere by the form of W, said by plain zeros."""
    return all(isinstance(one, float) and one == 0.0 for one in derivatives)


def _shear(slopes: Slopes) -> float:
    return float(2 * (np.ravel(slopes.by_a)[0] + np.ravel(slopes.by_b)[0]))
