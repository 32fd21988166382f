"""A straight line between two measured quantities: errors in both, their variance ratio known.

Deming 1943; standard errors by the jackknife (Linnet 1993), which needs no normal errors and
sees a scatter that grows along the line.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.ground.arrays import Array
from study.ground.errors import Fault, InputError

# Agreement of two methods of measurement: bias and limits (Bland and Altman 1986), with exact
# intervals by the noncentral t distribution (Carkeet 2015).

#: Fewest differences whose limits have an interval.
FEWEST = 3
#: Normal quantile of the limits: 95 % of the differences lie between them.
LIMIT = 1.959963984540054


@dataclass(frozen=True)
class MethodAgreement:
    """Differences of two methods."""

    bias: float
    #: Its interval at the level 1 - alpha.
    bias_interval: tuple[float, float]
    sd: float
    #: Limits of agreement: bias less and plus 1.96 standard deviations.
    lower: float
    upper: float
    lower_interval: tuple[float, float]
    upper_interval: tuple[float, float]
    #: Slope of the differences over the means: 0 where the bias is the same everywhere.
    trend: float
    #: Of the test that it is 0; nan where the means do not vary.
    trend_p: float
    #: Number of differences, each of its own specimen, pose or stop.
    points: int


def limits_of_agreement(
    first: Array, second: Array, alpha: float = 0.05, where: str = "agreement"
) -> MethodAgreement:
    """Bias and limits of agreement of ``first - second``. Shapes: first, second (n,)."""
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
    return MethodAgreement(
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


#: Fewest points of a line whose scatter is to be told.
FEWEST_POINTS = 4


@dataclass(frozen=True)
class DemingLine:
    """Line ``y = offset + scale x`` with its uncertainty."""

    #: Slope, and value at x = 0 in the unit of y.
    scale: float
    offset: float
    scale_uncertainty: float
    offset_uncertainty: float
    #: Intervals at the level 1 - alpha, by Student's t with n - 2 degrees of freedom.
    scale_interval: tuple[float, float]
    offset_interval: tuple[float, float]
    #: Standard deviation of y about the line, in the unit of y.
    residual_sd: float
    points: int


def deming_line(
    x: Array, y: Array, variance_ratio: float, alpha: float = 0.05, where: str = "regression"
) -> DemingLine:
    """Line between two quantities that both have errors. Shapes: x, y (n,)."""
    from scipy.stats import t

    n = len(x)
    values, counts = np.unique(x, return_counts=True)
    if n < FEWEST_POINTS or values.size < 2:
        rule = f"a line needs {FEWEST_POINTS} pairs at different places, got {n}"
        raise InputError(Fault(where, rule, "measure at more positions"))
    if values.size == 2 and counts.min() == 1:
        rule = f"{n - 1} of {n} pairs are at one place: the scale rests on the other one alone"
        raise InputError(Fault(where, rule, "measure at more positions"))
    offset, scale = _line(x, y, variance_ratio)
    left_out = np.array([_line(np.delete(x, k), np.delete(y, k), variance_ratio) for k in range(n)])
    if not np.isfinite(left_out).all() or not np.isfinite(scale):
        rule = "y does not go with x, with all pairs or without one of them: no line is fixed"
        raise InputError(Fault(where, rule, "compare the columns of both quantities"))
    pseudo = n * np.array([offset, scale]) - (n - 1) * left_out
    errors = pseudo.std(axis=0, ddof=1) / np.sqrt(n)
    half = float(t.ppf(1 - alpha / 2, n - 2)) * errors
    residual = y - offset - scale * x
    return DemingLine(
        scale=scale,
        offset=offset,
        scale_uncertainty=float(errors[1]),
        offset_uncertainty=float(errors[0]),
        scale_interval=(scale - float(half[1]), scale + float(half[1])),
        offset_interval=(offset - float(half[0]), offset + float(half[0])),
        residual_sd=float(np.sqrt((residual**2).sum() / (n - 2))),
        points=n,
    )


def _line(x: Array, y: Array, ratio: float) -> tuple[float, float]:
    """Offset and scale, NaN where every line is as good."""
    dx, dy = x - x.mean(), y - y.mean()
    xx, xy, yy = float(dx @ dx), float(dx @ dy), float(dy @ dy)
    if np.isinf(ratio):
        scale = xy / xx if xx else float("nan")
    else:
        lead = yy - ratio * xx
        root = float(np.hypot(lead, 2 * np.sqrt(ratio) * xy))
        # the same root in the form that cancels nothing
        above, below = (lead + root, 2 * xy) if lead > 0 else (2 * ratio * xy, root - lead)
        scale = above / below if below else float("nan")
    return float(y.mean() - scale * x.mean()), float(scale)
