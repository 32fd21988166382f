"""A straight line between two measured quantities: errors in both, their variance ratio known.

Deming 1943; standard errors by the jackknife (Linnet 1993), which needs no normal errors and
sees a scatter that grows along the line.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.errors import Fault, InputError

#: Fewest points of a line whose scatter is to be told.
FEWEST_POINTS = 4


@dataclass(frozen=True)
class Line:
    """Line ``y = offset + scale x`` with its uncertainty.

    Parameters
    ----------
    scale, offset : float
        Slope, and value at x = 0 in the unit of y.
    scale_uncertainty, offset_uncertainty : float
        Standard errors.
    scale_interval, offset_interval : tuple of float
        Intervals at the level 1 - alpha, by Student's t with n - 2 degrees of freedom.
    residual_sd : float
        Standard deviation of y about the line, in the unit of y.
    points : int
        Number of points.
    """

    scale: float
    offset: float
    scale_uncertainty: float
    offset_uncertainty: float
    scale_interval: tuple[float, float]
    offset_interval: tuple[float, float]
    residual_sd: float
    points: int


def deming_line(
    x: Array, y: Array, variance_ratio: float, alpha: float = 0.05, where: str = "regression"
) -> Line:
    """Line between two quantities that both have errors.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
        Pairs.
    variance_ratio : float
        Variance of the errors of y over that of x; infinite where x is exact (least squares).
    alpha : float
        Size of the intervals' complement.
    where : str
        Name of the regression in messages.

    Returns
    -------
    Line

    Raises
    ------
    InputError
        For fewer than four pairs, an x that does not vary, or varies in one pair alone, or a y
        that no line follows.
    """
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
    return Line(
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
