"""Agreement of two methods of measurement: bias and limits of agreement.

Bland and Altman 1986; intervals of the limits are exact, by the noncentral t distribution that
a normal quantile's estimate follows (Carkeet 2015), not the symmetric ones of 1986.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.errors import Fault, InputError

#: Fewest differences whose limits have an interval.
FEWEST = 3

#: Normal quantile of the limits: 95 % of the differences lie between them.
LIMIT = 1.959963984540054


@dataclass(frozen=True)
class Agreement:
    """Differences of two methods.

    Parameters
    ----------
    bias : float
        Mean difference.
    bias_interval : tuple of float
        Its interval at the level 1 - alpha.
    sd : float
        Standard deviation of the differences.
    lower, upper : float
        Limits of agreement: bias less and plus 1.96 standard deviations.
    lower_interval, upper_interval : tuple of float
        Their intervals.
    trend : float
        Slope of the differences over the means: 0 where the bias is the same everywhere.
    trend_p : float
        Of the test that it is 0; nan where the means do not vary.
    points : int
        Number of differences, each of its own specimen, pose or stop.
    """

    bias: float
    bias_interval: tuple[float, float]
    sd: float
    lower: float
    upper: float
    lower_interval: tuple[float, float]
    upper_interval: tuple[float, float]
    trend: float
    trend_p: float
    points: int


def limits_of_agreement(
    first: Array, second: Array, alpha: float = 0.05, where: str = "agreement"
) -> Agreement:
    """Bias and limits of agreement of ``first - second``.

    Parameters
    ----------
    first, second : ndarray, shape (n,)
        Both methods on the same n independent items.
    alpha : float
        Size of the intervals' complement.
    where : str
        Name of the comparison in messages.

    Returns
    -------
    Agreement

    Raises
    ------
    InputError
        For fewer than three items.
    """
    from scipy.stats import linregress, nct, t

    n = len(first)
    if n < FEWEST:
        rule = f"limits of agreement need {FEWEST} items, got {n}"
        raise InputError(Fault(where, rule, "measure at more positions"))
    difference = first - second
    bias, sd = float(difference.mean()), float(difference.std(ddof=1))
    half = float(t.ppf(1 - alpha / 2, n - 1)) * sd / np.sqrt(n)
    shift = LIMIT * np.sqrt(n)
    ends = nct.ppf([alpha / 2, 1 - alpha / 2], n - 1, shift) * sd / np.sqrt(n)
    mean = (first + second) / 2
    varies = bool(np.ptp(mean) > 0) and sd > 0
    slope = linregress(mean, difference) if varies else None
    return Agreement(
        bias=bias,
        bias_interval=(bias - half, bias + half),
        sd=sd,
        lower=bias - LIMIT * sd,
        upper=bias + LIMIT * sd,
        lower_interval=(bias - float(ends[1]), bias - float(ends[0])),
        upper_interval=(bias + float(ends[0]), bias + float(ends[1])),
        trend=float(slope.slope) if slope else 0.0,
        trend_p=float(slope.pvalue) if slope else float("nan"),
        points=n,
    )
