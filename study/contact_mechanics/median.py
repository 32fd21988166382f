"""Median over the units of a test, with an interval that assumes no distribution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import bdtr, stdtrit

#: level of every interval
LEVEL = 0.95

#: units from which order statistics hold the median in 95 %: 1 - 2 / 2^6
_MEDIAN_FROM = 6


@dataclass(frozen=True)
class MedianEstimate:
    """Middle of the moduli of independent units.

    Parameters
    ----------
    value_MPa : float
        Median.
    interval_MPa : tuple of float, optional
        Interval of at least 95 %.
    kind : str
        What the interval is of.
    units : int
        How many there are.
    quartiles_MPa : tuple of float
        First and third quartile: the scatter between units.
    """

    value_MPa: float
    interval_MPa: tuple[float, float] | None
    kind: str
    units: int
    quartiles_MPa: tuple[float, float]


def median_estimate(
    moduli_MPa: Sequence[float], alone: tuple[float, float] | None = None
) -> MedianEstimate:
    """Median with its interval: by order statistics from six units on, Student's t below.

    Parameters
    ----------
    moduli_MPa : sequence of float
        One modulus for each unit; at least one.
    alone : tuple of float, optional
        Interval of a single curve, which is all there is where it is the only one.

    Examples
    --------
    The least and the largest of six hold the median in 1 - 2/64 = 96.9 %:

    >>> median_estimate([3.0, 1.0, 2.0, 6.0, 4.0, 5.0]).interval_MPa
    (1.0, 6.0)
    """
    values = np.sort(np.asarray(moduli_MPa, dtype=float))
    n = values.size
    low, middle, high = (float(v) for v in np.quantile(values, [0.25, 0.5, 0.75]))
    interval: tuple[float, float] | None = alone
    kind = "of the only curve: it knows nothing of the scatter between curves"
    if n >= _MEDIAN_FROM:
        # the k-th smallest lies above the median with the chance that fewer than k lie below
        k = int(np.count_nonzero(bdtr(np.arange(n // 2), n, 0.5) <= (1 - LEVEL) / 2))
        interval, kind = (float(values[k - 1]), float(values[n - k])), "of the median"
    elif n > 1:
        half = stdtrit(n - 1, (1 + LEVEL) / 2) * values.std(ddof=1) / np.sqrt(n)
        mean = float(values.mean())
        interval, kind = (mean - float(half), mean + float(half)), "of the mean, by Student's t"
    return MedianEstimate(middle, interval, kind, n, (low, high))
