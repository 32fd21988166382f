"""Profile likelihood: an interval that does not trust the parabola."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.calibration.covariance import student_t
from study.calibration.fit import Fit, Predict, residual_function
from study.calibration.function import Function
from study.calibration.levenberg_marquardt import levenberg_marquardt
from study.calibration.measured_curve import MeasuredCurve
from study.errors import RefusedError


@dataclass(frozen=True)
class Profile:
    """Smallest sum of squares for given values of one constant.

    Parameters
    ----------
    name : str
        The constant.
    values, rss : ndarray, shape (m,)
        Values tried, in order, and the sum of squares with the other constants refitted, that
        of pseudo-observations included.
    interval : tuple of float
        Where rss = rss_min (1 + t^2 / (n - p)), t times the inflation by serial correlation;
        infinite on a side that never gets there.
    """

    name: str
    values: Array
    rss: Array
    interval: tuple[float, float]


def profile(
    predict: Predict,
    measured: Sequence[MeasuredCurve],
    result: Fit,
    name: str,
    *,
    bounds: Sequence[tuple[float, float]] | None = None,
) -> Profile:
    """Profile-likelihood interval at 95 % of one constant (Bates and Watts 1988, sec. 6.1).

    Parameters
    ----------
    predict, measured, bounds
        As for :func:`study.calibration.fit`.
    result : Fit
        The converged fit.
    name : str
        Which constant.

    Raises
    ------
    RefusedError
        If the fit did not converge or has no standard error for this constant.
    """
    index = result.names.index(name)
    error = float(result.standard_error[index])
    if not result.converged or not error > 0:
        raise RefusedError(f"no profile of {name}: the fit has no standard error for it")
    function = residual_function(predict, measured, result.names, result.priors)
    inflation = 1.0 if result.serial is None else float(result.serial.inflation[index])
    freedom, least = result.degrees_of_freedom, result.penalized_rss
    limit = least * (1 + (inflation * student_t(freedom)) ** 2 / freedom)
    tried: dict[float, float] = {float(result.values[index]): least}
    sides = []
    for sign in (-1.0, 1.0):
        rss_at = _profiled(function, result, index, bounds, tried)
        sides.append(_crossing(rss_at, float(result.values[index]), sign * error, limit))
    order = sorted(tried)
    rss = np.array([tried[v] for v in order])
    return Profile(name, np.array(order), rss, (sides[0], sides[1]))


def _profiled(
    function: Function,
    result: Fit,
    index: int,
    bounds: Sequence[tuple[float, float]] | None,
    tried: dict[float, float],
) -> Callable[[float], float]:
    """Sum of squares at a fixed value, the others refitted from the last point of this side."""
    others = np.arange(result.values.size) != index
    last = result.values[others].copy()
    kept = None if bounds is None else [b for i, b in enumerate(bounds) if i != index]

    def full(value: float, rest: Array) -> Array:
        x = result.values.copy()
        x[index], x[others] = value, rest
        return x

    def rss_at(value: float) -> float:
        nonlocal last
        if not np.any(others):
            residual = function(full(value, last))[0]
            tried[value] = float(residual @ residual)
            return tried[value]

        def inner(rest: Array) -> tuple[Array, Array]:
            residual, jacobian = function(full(value, rest))
            return residual, jacobian[:, others]

        found = levenberg_marquardt(inner, last, bounds=kept, max_evaluations=100, gtol=1e-7)
        if found.converged:
            last = found.x
        tried[value] = 2 * found.cost if found.converged else np.inf
        return tried[value]

    return rss_at


def _crossing(rss_at: Callable[[float], float], best: float, step: float, limit: float) -> float:
    """Value on one side where the profile meets the limit: outward steps, then bisection."""
    inner, outer = best, best + step
    for _ in range(12):
        if rss_at(outer) >= limit:
            break
        inner, outer = outer, best + 2 * (outer - best)
    else:
        return float(np.copysign(np.inf, step))
    while abs(outer - inner) > 1e-3 * abs(step):
        middle = 0.5 * (inner + outer)
        inner, outer = (inner, middle) if rss_at(middle) >= limit else (middle, outer)
    return 0.5 * (inner + outer)
