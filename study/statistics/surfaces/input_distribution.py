"""Distribution of an uncertain input, cut off at the ends of the range that is run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from study.ground.arrays import Array

#: what each kind of distribution is told by, in the order of its numbers
PARAMETERS: Mapping[str, tuple[str, ...]] = {
    "normal": ("mean", "sd"),
    "uniform": ("low", "high"),
    "triangular": ("low", "mode", "high"),
    "lognormal": ("median", "factor"),
}
DISTRIBUTION_KEYS = (
    "distribution",
    *dict.fromkeys(k for names in PARAMETERS.values() for k in names),
)


@dataclass(frozen=True)
class InputDistribution:
    """Distribution of an uncertain input, cut off at the ends of the range that is run."""

    #: The family.
    kind: str
    #: Its numbers in the order of `PARAMETERS`, in the unit of the range; the factor of a lognormal
    #: distribution is exp(sd of the logarithm).
    numbers: tuple[float, ...]
    low: float
    high: float

    def _frozen(self) -> Any:
        """Distribution of scipy with these numbers."""
        from scipy import stats

        if self.kind == "normal":
            return stats.norm(*self.numbers)
        if self.kind == "lognormal":
            median, factor = self.numbers
            return stats.lognorm(math.log(factor), scale=median)
        width = self.numbers[-1] - self.numbers[0]
        if self.kind == "uniform":
            return stats.uniform(self.numbers[0], width)
        low, mode, _ = self.numbers
        return stats.triang((mode - low) / width, low, width)

    @property
    def outside(self) -> float:
        """Probability that is cut off."""
        distribution = self._frozen()
        return float(distribution.cdf(self.low) + distribution.sf(self.high))

    def quantile(self, shares: Array) -> Array:
        """Values, in the unit of the range, below which such shares of the distribution lie."""
        distribution = self._frozen()
        first, last = distribution.cdf([self.low, self.high])
        quantiles = distribution.ppf(first + shares * (last - first))
        return np.asarray(np.clip(quantiles, self.low, self.high))

    def halved(self) -> InputDistribution:
        """Give the distribution with half the spread, about the same middle."""
        a, b = self.numbers[0], self.numbers[1]
        if self.kind == "normal":
            numbers: tuple[float, ...] = (a, 0.5 * b)
        elif self.kind == "lognormal":
            numbers = (a, math.sqrt(b))
        elif self.kind == "uniform":
            numbers = (0.75 * a + 0.25 * b, 0.25 * a + 0.75 * b)
        else:
            middle = sum(self.numbers) / 3
            numbers = tuple(0.5 * (value + middle) for value in self.numbers)
        return InputDistribution(self.kind, numbers, self.low, self.high)

    def words(self, unit: str) -> str:
        """Say what it is, such as ``normal, mean 7 kPa, sd 0.5 kPa``."""
        named = zip(PARAMETERS[self.kind], self.numbers, strict=True)
        parts = [f"{name} {v:.4g}" + ("" if name == "factor" or not unit else f" {unit}")
                for name, v in named]  # fmt: skip
        return ", ".join([self.kind, *parts])
