"""What the tests know of the constants, in the units of the curves that were measured.

Constants of different order, or a modulus and an exponent, cannot be compared as numbers. What
can be compared is what they do to the measured curve: every column of the Jacobian is taken in
lengths of itself, so that a constant counts in the unit of the force. Singular vectors of these
columns are the combinations that the tests know best and least (Raue et al. 2009, Bioinformatics
25, 1923; Gutenkunst et al. 2007, PLoS Comput. Biol. 3, e189), whatever units the constants have.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from study.ground.arrays import Array
from study.ground.errors import RefusedError
from study.mechanics.calibration.covariance import AS_GOOD_AS_ZERO, student_t
from study.mechanics.calibration.fit import Fit, Predict, ResidualFunction
from study.mechanics.calibration.levenberg_marquardt import levenberg_marquardt
from study.mechanics.calibration.residual_function import Bounds, Function, MeasuredCurve
from study.mechanics.material.material import is_dimensionless

#: relative standard error up to which a combination counts as known
KNOWN = 0.1
#: share of the largest part below which a constant is no part of a combination
_PART = 0.03
#: share of the largest part from which a constant may be the first of a combination
_FIRST = 0.9


@dataclass(frozen=True)
class Direction:
    """A combination of constants, the first with the coefficient 1."""

    #: Coefficient of every constant that takes part; MPa over the unit of the constant, relative to
    #: the first.
    combination: Mapping[str, float]
    #: Of the combination, in the unit of the first constant (MPa, exponents plain).
    value: float
    standard_error: float

    @property
    def relative(self) -> float:
        """Standard error over the value."""
        return self.standard_error / abs(self.value) if self.value else float("inf")

    @property
    def is_known(self) -> bool:
        """Whether the tests determine it."""
        return self.relative <= KNOWN

    @property
    def words(self) -> str:
        """The combination as a formula, moduli in kPa."""
        first, *others = self.combination
        parts = [first]
        for name in others:
            factor = self.combination[name]
            unit = ""
            if is_dimensionless(name) != is_dimensionless(first):
                factor *= 1e-3 if is_dimensionless(first) else 1e3
                unit = " / kPa x" if is_dimensionless(first) else " kPa x"
            size = f"{abs(factor):.3g}"
            shown = name if size == "1" and not unit else f"{size}{unit} {name}"
            parts.append(f"{'-' if factor < 0 else '+'} {shown}")
        return " ".join(parts)


@dataclass(frozen=True)
class ConstantEffect:
    """What one constant does to the curves."""

    name: str
    #: Largest change of a force by leaving it out (taking it as zero), the others kept.
    alone_N: float  # noqa: N815
    #: The same with the others fitted again, by linear estimate.
    refitted_N: float  # noqa: N815
    #: Whether its interval excludes zero, or changes no force by more than 1 % of the largest.
    is_known: bool


@dataclass(frozen=True)
class Identifiability:
    """What the tests know of the constants."""

    #: Standard deviation of the residuals of the fitted points.
    noise_N: float  # noqa: N815
    #: From the stiffest to the sloppiest.
    directions: tuple[Direction, ...]
    constants: tuple[ConstantEffect, ...]

    @property
    def sentence(self) -> str:
        """Say in words what is known, and what is not."""
        open_ones = [constant for constant in self.constants if not constant.is_known]
        # as many combinations as remain: the sloppy ones say of no constant more than its interval
        stiff = self.directions[: max(len(self.constants) - len(open_ones), 1)]
        determined = [direction for direction in stiff if direction.is_known]
        sentences = [f"{d.words} is known to {100 * d.relative:.2g} %" for d in determined]
        noise = f"the noise is {self.noise_N:.2g} N"
        sentences += [
            f"{constant.name} alone is not: without it, the others fitted again, the curve changes "
            f"by at most {constant.refitted_N:.2g} N, where {noise}"
            for constant in open_ones
        ]
        return "; ".join(sentences)


def identify(fit: Fit, measured: Sequence[MeasuredCurve]) -> Identifiability | None:
    """Stiff and sloppy combinations of the constants of a fit, and what each constant does."""
    if not np.isfinite(fit.covariance).all() or not fit.curves:
        return None
    slopes, weights, left = fitted_rows(fit, measured)
    jacobian = weights[:, None] * slopes
    norms = np.linalg.norm(jacobian, axis=0)
    freedom = left.size - norms.size
    if freedom <= 0 or not np.all(norms > 0):
        return None
    noise = float(np.sqrt(left @ left / freedom))
    right = np.linalg.svd(jacobian / norms, full_matrices=False)[2]
    directions = tuple(_direction(fit, row, norms) for row in right)
    force = max(float(np.abs(test.curve.force_N).max()) for test in measured)
    half = 0.5 * (fit.ci95[:, 1] - fit.ci95[:, 0])
    constants = tuple(
        _effect(fit, k, slopes, jacobian, weights, half, force) for k in range(norms.size)
    )
    return Identifiability(noise, directions, constants)


def fitted_rows(fit: Fit, measured: Sequence[MeasuredCurve]) -> tuple[Array, Array, Array]:
    """Slopes of the forces, weights and residuals of the fitted points."""
    # Shapes: returns (n, p), MPa; returns (n,), N.
    slopes, weights, left = [], [], []
    for test, curve in zip(measured, fit.curves, strict=True):
        used = test.weights > 0
        d = test.curve.displacement_mm[used]
        slopes.append(curve.gradients_at(fit.names, d))
        weights.append(test.weights[used])
        left.append(curve.force_at(d) - test.curve.force_N[used])
    return np.concatenate(slopes), np.concatenate(weights), np.concatenate(left)


def _direction(fit: Fit, row: Array, norms: Array) -> Direction:
    size = np.abs(row)
    first = int(np.argmax(size >= _FIRST * size.max()))
    coefficients = row * norms / (row[first] * norms[first])
    named = [k for k in np.argsort(np.arange(size.size) != first, kind="stable")
            if size[k] >= _PART * size.max()]  # fmt: skip
    whole = np.where(np.isin(np.arange(size.size), named), coefficients, 0.0)
    return Direction(
        {fit.names[k]: float(coefficients[k]) for k in named},
        float(whole @ fit.values),
        float(np.sqrt(whole @ fit.covariance @ whole)),
    )


def _effect(
    fit: Fit, k: int, slopes: Array, jacobian: Array, weights: Array, half: Array, force: float
) -> ConstantEffect:
    value, column = abs(float(fit.values[k])), jacobian[:, k]
    others = np.delete(jacobian, k, axis=1)
    others = others / np.linalg.norm(others, axis=0)
    column_alone = column - others @ np.linalg.lstsq(others, column, rcond=None)[0]
    largest = float(np.abs(slopes[:, k]).max())
    is_known = float(half[k]) <= max(value, AS_GOOD_AS_ZERO * force / largest)
    return ConstantEffect(
        fit.names[k],
        value * largest,
        value * float(np.abs(column_alone / weights).max()),
        bool(is_known),
    )


# Profile likelihood: an interval that does not trust the parabola.


@dataclass(frozen=True)
class LikelihoodProfile:
    """Smallest sum of squares for given values of one constant."""

    name: str
    #: shape (m,); values tried, in order, and the sum of squares with the other constants refitted,
    #: that of pseudo-observations included.
    values: Array
    rss: Array
    #: Where rss = rss_min (1 + t^2 / (n - p)), t times the inflation by serial correlation;
    #: infinite on a side that never gets there, the bound of the constant where it ends below, and
    #: NaN where the other constants could not be refitted before it got there.
    interval: tuple[float, float]


def profile(
    predict: Predict,
    measured: Sequence[MeasuredCurve],
    result: Fit,
    name: str,
    *,
    bounds: Bounds = None,
) -> LikelihoodProfile:
    """Profile-likelihood interval at 95 % of one constant (Bates and Watts 1988, sec. 6.1)."""
    index = result.names.index(name)
    error = float(result.standard_error[index])
    if not result.converged or not error > 0:
        raise RefusedError(f"no profile of {name}: the fit has no standard error for it")
    function = ResidualFunction(predict, measured, result.names, result.priors)
    inflation = 1.0 if result.serial is None else float(result.serial.inflation[index])
    freedom, least = result.degrees_of_freedom, result.penalized_rss
    limit = least * (1 + (inflation * student_t(freedom)) ** 2 / freedom)
    tried: dict[float, float] = {float(result.values[index]): least}
    sides = []
    for sign in (-1.0, 1.0):
        rss_at = _profiled(function, result, index, bounds, tried)
        end = sign * np.inf if bounds is None else bounds[index][int(sign > 0)]
        sides.append(_crossing(rss_at, float(result.values[index]), sign * error, limit, end))
    order = sorted(tried)
    rss = np.array([tried[v] for v in order])
    return LikelihoodProfile(name, np.array(order), rss, (sides[0], sides[1]))


def _profiled(
    function: Function, result: Fit, index: int, bounds: Bounds, tried: dict[float, float]
) -> Callable[[float], float]:
    """Sum of squares at a fixed value, the others refitted from the last point of this side."""
    others = np.arange(result.values.size) != index
    last = result.values[others].copy()
    remaining = None if bounds is None else [b for i, b in enumerate(bounds) if i != index]

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

        result = levenberg_marquardt(inner, last, bounds=remaining, max_evaluations=100, gtol=1e-7)
        if result.converged:
            last = result.x
        tried[value] = 2 * result.cost if result.converged else np.inf
        return tried[value]

    return rss_at


def _crossing(
    rss_at: Callable[[float], float], best: float, step: float, limit: float, end: float
) -> float:
    """Value on one side where the profile meets the limit: outward steps, then bisection.

    ``end`` is the bound of the constant on that side, which is given where the profile lies below
    the limit up to it. A place without an answer is not one where the profile has met the limit.
    """
    nearer = max if step < 0 else min
    inner, outer = best, nearer(best + step, end)
    for _ in range(12):
        least = rss_at(outer)
        if least >= limit:
            break
        if outer == end:
            return end
        inner, outer = outer, nearer(best + 2 * (outer - best), end)
    else:
        return float(np.copysign(np.inf, step))
    while abs(outer - inner) > 1e-3 * abs(step):
        middle = 0.5 * (inner + outer)
        if (there := rss_at(middle)) >= limit:
            outer, least = middle, there
        else:
            inner = middle
    if np.isfinite(least):
        return 0.5 * (inner + outer)
    return end if outer == end else np.nan
