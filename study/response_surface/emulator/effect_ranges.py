"""How far a factor moves the response, in the response's unit, and whether that matters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from study.arrays import Array

#: settings of the other factors, and steps along the factor
SETTINGS = 256
STEPS = 11

#: part of the settings that the range is claimed for
SHARE = 0.95

#: bound of a range: this many times the largest leave-one-out error
ERRORS = 2.0

#: added to a range before it is called small, as a part of the response's range: larger than
#: every miss of the bound on the borehole function
MISS = 0.02

Verdict = Literal["matters", "no practical difference", "cannot tell"]


@dataclass(frozen=True)
class EffectRange:
    """Range of the response along one factor.

    Parameters
    ----------
    value : float
        Range, in the response's unit, that 95 % of the settings of the others stay below.
    bound : float
        Half width around it: twice the largest leave-one-out error, and numerical uncertainty.
    verdict : {"matters", "no practical difference", "cannot tell"}
        At 95 % of the settings.
    confirm : array, shape (2, k)
        Coded settings of the two predicted extremes: run both before the claim is made.
    """

    value: float
    bound: float
    verdict: Verdict
    confirm: Array

    @property
    def claims(self) -> bool:
        """Whether the factor is said to matter, which two runs are to confirm."""
        return self.verdict == "matters"


def effect_range(
    mean: Callable[[Array], Array], k: int, j: int, bound: float, small: Small
) -> EffectRange:
    """Range along factor j.

    Parameters
    ----------
    mean : callable
        Predictions, shape (m,), at points of shape (m, k) in the unit box.
    k, j : int
        Number of factors, and which one moves.
    bound : float
        Half width around a range, in the response's unit.
    small : Small
        What is too small to matter.
    """
    from scipy.stats import qmc

    others = qmc.Sobol(k, seed=j).random(SETTINGS)
    steps = np.linspace(0.0, 1.0, STEPS)
    points = np.repeat(others[:, None, :], STEPS, axis=1)
    points[:, :, j] = steps
    values = mean(points.reshape(-1, k)).reshape(SETTINGS, STEPS)
    ranges = np.ptp(values, axis=1)
    value = float(np.quantile(ranges, SHARE))
    at = int(np.abs(ranges - value).argmin())
    ends = points[at, [int(values[at].argmin()), int(values[at].argmax())]]
    return EffectRange(value, bound, small.verdict(value, bound), 2.0 * ends - 1.0)


@dataclass(frozen=True)
class Small:
    """What is too small to matter.

    Parameters
    ----------
    practical : float or None
        Smallest difference that matters, in the response's unit; None if nobody has said.
    response_range : float
        Largest minus smallest response that was run, in the same unit.
    """

    practical: float | None
    response_range: float

    def verdict(self, value: float, bound: float) -> Verdict:
        """Judge a range with its bound."""
        if self.practical is None:
            return "cannot tell"
        if value - bound > self.practical:
            return "matters"
        if value + bound + MISS * self.response_range < self.practical:
            return "no practical difference"
        return "cannot tell"
