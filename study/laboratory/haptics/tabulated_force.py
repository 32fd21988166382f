"""A force law: the force of a simulated test as a smooth function of displacement and constants."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from study.ground.arrays import Array

# Slopes of a monotone cubic Hermite interpolant (Fritsch and Carlson 1980, SIAM J. Numer. Anal.
# 17, 238-246).

#: Slopes up to this multiple of that of the chord make a monotone cubic, whatever the other one is
#: below it (Fritsch and Carlson 1980, section 4).
STEEPEST = 3.0


def monotone_slopes(knots: Array, values: Array, slopes: Array) -> Array:
    """Slopes limited only in intervals where the interpolant would leave its monotone data.

    Data count as monotone in an interval where the slopes at both its ends have the sign of the
    chord: there the simulation rises, or falls, all the way as far as anybody knows.

    Shapes: knots, values, slopes (n,); returns (n,).

    Examples
    --------
    >>> d = np.array([0.0, 1.0, 2.0])
    >>> monotone_slopes(d, d**2, 2 * d)
    array([0., 2., 4.])
    >>> monotone_slopes(d, np.array([0.0, 1.0, 1.1]), np.array([1.0, 4.0, 0.1]))
    array([1. , 0.3, 0.1])
    """
    limited = slopes.astype(float)
    chords = np.diff(values) / np.diff(knots)
    sign = np.sign(chords)
    rising = np.asarray((sign * limited[:-1] >= 0) & (sign * limited[1:] >= 0))
    # an interval that is limited may take its neighbor's slope away; each is limited once at most
    for _ in range(chords.size):
        outside = np.flatnonzero(rising & ~is_monotone(chords, limited))
        if not outside.size:
            break
        for k in outside:
            chord = chords[k]
            limited[k : k + 2] = np.asarray(
                np.sign(chord) * np.minimum(np.abs(limited[k : k + 2]), STEEPEST * abs(chord))
            )
    return limited


def is_monotone(chords: Array, slopes: Array) -> NDArray[np.bool_]:
    """Whether the cubic of every interval is monotone."""
    # Shapes: chords (n - 1,); slopes (n,); returns (n - 1,).
    flat = chords == 0
    safe = np.where(flat, 1.0, chords)
    a, b = slopes[:-1] / safe, slopes[1:] / safe
    sums = a + b - 2
    # the minimum of the derivative inside the interval, where it has one
    lowest = a - (2 * a + b - 3) ** 2 / (3 * np.where(sums > 0, sums, 1.0))
    inside = (sums <= 0) | (2 * a + b <= 3) | (a + 2 * b <= 3) | (lowest >= 0)
    still = (slopes[:-1] == 0) & (slopes[1:] == 0)
    return np.asarray(np.where(flat, still, (a >= 0) & (b >= 0) & inside))


@dataclass(frozen=True)
class TabulatedFunction:
    """A function tabulated at evenly spaced displacements from 0, with its slopes.

    Between two of them it is the cubic with their values and slopes, so that it is smooth (C1).
    Below 0 it is zero, beyond the last one it goes on straight.
    """

    step_mm: float
    #: shape (n + 1,); the function and its derivative by the displacement.
    values: Array
    slopes: Array

    @property
    def end_mm(self) -> float:
        """Last displacement."""
        return self.step_mm * (self.values.size - 1)

    @cached_property
    def coefficients(self) -> Array:
        """Coefficients by the share t of an interval, 1, t, t^2, t^3; shape (n, 4)."""
        first, last = self.values[:-1], self.values[1:]
        start, end = self.step_mm * self.slopes[:-1], self.step_mm * self.slopes[1:]
        rise = last - first
        return np.stack([first, start, 3 * rise - 2 * start - end, start + end - 2 * rise], axis=1)

    def at(self, displacement_mm: ArrayLike) -> Array:
        """Values at displacements of any shape."""
        d = np.asarray(displacement_mm, dtype=float)
        k, t, beyond = self._place(d)
        c = self.coefficients[k]
        inside = c[..., 0] + t * (c[..., 1] + t * (c[..., 2] + t * c[..., 3]))
        return np.asarray(np.where(d < 0, 0.0, inside + self.slopes[-1] * beyond))

    def slope_at(self, displacement_mm: ArrayLike) -> Array:
        """Differentiate by the displacement, per mm."""
        d = np.asarray(displacement_mm, dtype=float)
        k, t, _ = self._place(d)
        c = self.coefficients[k]
        inside = (c[..., 1] + t * (2 * c[..., 2] + 3 * t * c[..., 3])) / self.step_mm
        return np.asarray(np.where(d < 0, 0.0, inside))

    def _place(self, d: Array) -> tuple[NDArray[np.int64], Array, Array]:
        """Interval of every displacement, its share of that interval, and how far it is beyond."""
        within = np.clip(d, 0.0, self.end_mm)
        steps = within / self.step_mm
        k = np.minimum(steps.astype(np.int64), self.values.size - 2)
        return k, steps - k, np.maximum(d - self.end_mm, 0.0)


#: Error bound over the largest deviation that is seen: contact that closes point by point makes no
#: smooth function. Of six laws of punches, spheres and cones the largest deviation on a path of
#: four times as many points was .9 to 1.2 times the largest that is seen here
BEYOND_SEEN = 1.5


@dataclass(frozen=True)
class HeldOut:
    """Points of a path that are kept out of the table made of it, three in each interval."""

    #: shape (n,); as the finite elements find them.
    displacement_mm: Array
    force_N: Array
    #: shape (n,); force of the law less that of the finite elements.
    deviation_N: Array
    #: Largest deviation from the interpolated path, between its points too.
    largest_between_N: float

    @property
    def bound_N(self) -> float:  # noqa: N802
        """Bound of the deviation, between these points too."""
        seen = float(np.abs(self.deviation_N).max())
        return BEYOND_SEEN * max(seen, self.largest_between_N)

    @property
    def worst_mm(self) -> float:
        """Displacement of the largest deviation at a point."""
        return float(self.displacement_mm[int(np.argmax(np.abs(self.deviation_N)))])


@dataclass(frozen=True)
class ConstantRange:
    """What first order leaves out where one constant is not that of the table."""

    name: str
    #: Its values that were solved, MPa (exponents plain).
    low: float
    high: float
    #: Largest deviation of the law from the finite elements there; NaN where they have no answer.
    largest_N: float


@dataclass(frozen=True)
class ForceLaw:
    """Force as a function of displacement, and to first order of the constants."""

    name: str
    #: N over mm, monotone where the simulation is.
    force: TabulatedFunction
    #: dF/dconstant, N per MPa (N for a plain exponent).
    gradients: Mapping[str, TabulatedFunction]
    #: Those of the table, MPa (exponents plain).
    constants: Mapping[str, float]
    #: Knots at which the slope is smaller than that of the simulation.
    limited: tuple[int, ...]
    held_out: HeldOut
    #: How far the constants may move.
    ranges: tuple[ConstantRange, ...] = ()
    #: shape (p, p); of the constants in their order, where they were calibrated, MPa^2.
    covariance: Array | None = field(default=None, repr=False)

    @property
    def displacement_mm(self) -> Array:
        """Knots, shape (n + 1,)."""
        return np.asarray(self.force.step_mm * np.arange(self.force.values.size), float)

    @property
    def relative_error(self) -> float:
        """Error bound over the largest force of the table."""
        return self.held_out.bound_N / float(np.abs(self.force.values).max())

    @property
    def is_monotone(self) -> bool:
        """Whether the force never falls as the displacement grows."""
        chords = np.diff(self.force.values) / self.force.step_mm
        return bool(np.all(chords >= 0) and np.all(is_monotone(chords, self.force.slopes)))

    def force_at(
        self, displacement_mm: ArrayLike, constants: Mapping[str, float] | None = None
    ) -> Array:
        """Force in N, of the shape of the displacements. Units: constants MPa."""
        force = self.force.at(displacement_mm)
        for name, value in (constants or {}).items():
            change = value - self.constants[name]
            force = force + change * self.gradients[name].at(displacement_mm)
        return np.asarray(force)

    def stiffness_at(self, displacement_mm: ArrayLike) -> Array:
        """dF/dd in N/mm, of the shape of the displacements."""
        return self.force.slope_at(displacement_mm)

    def is_tested(self, displacement_mm: ArrayLike) -> NDArray[np.bool_]:
        """Whether displacements lie in the simulated range; outside, the law only continues."""
        d = np.asarray(displacement_mm, dtype=float)
        return np.asarray((d >= 0) & (d <= self.force.end_mm))

    def standard_uncertainty_at(self, displacement_mm: ArrayLike) -> Array | None:
        """Return the standard uncertainty in N that a calibration leaves; None without one."""
        if self.covariance is None:
            return None
        rows = [self.gradients[name].at(displacement_mm) for name in self.constants]
        gradient = np.stack(rows, axis=-1)
        square = np.einsum("...i,ij,...j->...", gradient, self.covariance, gradient)
        return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def force_table(step_mm: float, force_N: Array, stiffness_N_per_mm: Array) -> TabulatedFunction:  # noqa: N803
    """Tabulate a force, its slopes limited where it would not be monotone."""
    # Shapes: force_N, stiffness_N_per_mm (n + 1,).
    # at first touch it is an estimate from the work, which must not pull
    limit = max if force_N[1] >= 0 else min
    slopes = np.r_[limit(float(stiffness_N_per_mm[0]), 0.0), stiffness_N_per_mm[1:]]
    knots = np.asarray(step_mm * np.arange(force_N.size), float)
    return TabulatedFunction(step_mm, force_N, monotone_slopes(knots, force_N, slopes))


def gradient_table(step_mm: float, gradient: Array) -> TabulatedFunction:
    """Tabulate a derivative by a constant; its slopes are those of the spline through it."""
    # Shapes: gradient (n + 1,).
    from scipy.interpolate import CubicSpline

    knots = step_mm * np.arange(gradient.size)
    if gradient.size < 4:  # as many as a cubic has coefficients
        return TabulatedFunction(step_mm, gradient, np.gradient(gradient, knots))
    return TabulatedFunction(step_mm, gradient, np.asarray(CubicSpline(knots, gradient)(knots, 1)))
