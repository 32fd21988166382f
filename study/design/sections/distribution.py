"""Distribution of an uncertain input, cut off at the ends of the range that is run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from study.arrays import Array

#: what each kind of distribution is told by, in the order of its numbers
PARAMETERS: Mapping[str, tuple[str, ...]] = {
    "normal": ("mean", "sd"),
    "uniform": ("low", "high"),
    "triangular": ("low", "mode", "high"),
    "lognormal": ("median", "factor"),
}

#: all keys of a distribution
DISTRIBUTION_KEYS = ("distribution", *dict.fromkeys(k for own in PARAMETERS.values() for k in own))


@dataclass(frozen=True)
class InputDistribution:
    """Distribution of an uncertain input, cut off at the ends of the range that is run.

    Parameters
    ----------
    kind : {"normal", "uniform", "triangular", "lognormal"}
        The family.
    numbers : tuple of float
        Its numbers in the order of `PARAMETERS`, in the unit of the range; the factor of a
        lognormal distribution is exp(sd of the logarithm).
    low, high : float
        Ends of the range.
    """

    kind: str
    numbers: tuple[float, ...]
    low: float
    high: float

    def below(self, value: float) -> float:
        """Probability of less than a value, before anything is cut off."""
        a, b = self.numbers[0], self.numbers[1]
        if self.kind == "normal":
            return NormalDist(a, b).cdf(value)
        if self.kind == "lognormal":
            return NormalDist(math.log(a), math.log(b)).cdf(math.log(value)) if value > 0 else 0.0
        if self.kind == "uniform":
            return min(max((value - a) / (b - a), 0.0), 1.0)
        return _below_triangle(value, *self.numbers)

    @property
    def outside(self) -> float:
        """Probability that is cut off."""
        return self.below(self.low) + 1.0 - self.below(self.high)

    def quantile(self, shares: Array) -> Array:
        """Values, in the unit of the range, below which such shares of the distribution lie."""
        from scipy import special

        first, last = self.below(self.low), self.below(self.high)
        p = first + shares * (last - first)
        a, b = self.numbers[0], self.numbers[1]
        if self.kind == "normal":
            found = a + b * special.ndtri(p)
        elif self.kind == "lognormal":
            found = a * np.exp(math.log(b) * special.ndtri(p))
        elif self.kind == "uniform":
            found = a + p * (b - a)
        else:
            found = _triangle(p, *self.numbers)
        return np.asarray(np.clip(found, self.low, self.high))

    def halved(self) -> InputDistribution:
        """Give the distribution with half the spread, about the same middle."""
        a, b = self.numbers[0], self.numbers[1]
        if self.kind == "normal":
            own: tuple[float, ...] = (a, 0.5 * b)
        elif self.kind == "lognormal":
            own = (a, math.sqrt(b))
        elif self.kind == "uniform":
            own = (0.75 * a + 0.25 * b, 0.25 * a + 0.75 * b)
        else:
            middle = sum(self.numbers) / 3
            own = tuple(0.5 * (value + middle) for value in self.numbers)
        return InputDistribution(self.kind, own, self.low, self.high)

    def words(self, unit: str) -> str:
        """Say what it is, such as ``normal, mean 7 kPa, sd 0.5 kPa``."""
        told = zip(PARAMETERS[self.kind], self.numbers, strict=True)
        said = [f"{name} {v:.4g}" + ("" if name == "factor" or not unit else f" {unit}")
                for name, v in told]  # fmt: skip
        return ", ".join([self.kind, *said])


def _below_triangle(x: float, low: float, mode: float, high: float) -> float:
    if x <= low:
        return 0.0
    if x >= high:
        return 1.0
    if x <= mode:
        return (x - low) ** 2 / ((high - low) * (mode - low))
    return 1.0 - (high - x) ** 2 / ((high - low) * (high - mode))


def _triangle(p: Array, low: float, mode: float, high: float) -> Array:
    rising = low + np.sqrt(p * (high - low) * (mode - low))
    falling = high - np.sqrt((1.0 - p) * (high - low) * (high - mode))
    return np.asarray(np.where(p < (mode - low) / (high - low), rising, falling))
