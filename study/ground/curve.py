"""Force-displacement curves, measured or predicted: one type, so a residual is a subtraction."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from study.ground.arrays import Array

#: error in an interval over that of cubic and quartic at a point next to it that is left out, over
#: how far the first interval is from straight, and over the force of a single point. A smooth cubic
#: is off by a sixteenth of the first in half the interval, contact that closes point by point by
#: more. Chosen by curves of 1 to 8 load steps: cones, spheres, punches, three materials
_BY_CUBIC = 0.125
_BY_QUARTIC = 0.75
_BENT = 0.04
_ALONE = 0.055
#: share of what force and slopes do not agree by that counts as a jump of the force in an interval,
#: beyond some times what intervals beside it tell of a smooth curve: a snap that loses less energy
#: than interpolation may miss is seen by nothing else
_JUMP = 0.5
_SMOOTH = 8.0

#: fields with a number a row, those that every curve has first
_ROWS = ("displacement_mm", "force_N", "stiffness_N_per_mm", "work_Nmm", "time_s")


@dataclass(frozen=True)
class Curve:
    """Force against displacement of a whole specimen."""

    #: shape (n,); displacement of the plate or indenter, positive into the specimen, increasing. Of
    #: a specimen that was loaded both ways through zero it begins below zero.
    displacement_mm: Array
    #: shape (n,); force on the whole specimen, positive when it resists.
    force_N: Array
    #: shape (n,); tangent dF/dd; with it the curve is interpolated by cubic Hermite polynomials.
    stiffness_N_per_mm: Array | None = None
    #: shape (n,); dF/dtheta for each material constant, in N per MPa (N for a plain exponent).
    force_gradient: Mapping[str, Array] = field(default_factory=dict)
    #: shape (n,); work done from the unloaded state; with it each interval's polynomial is one of
    #: fourth degree that does just this work.
    work_Nmm: Array | None = None
    #: shape (n,); increasing times of the rows of a test whose course matters. Displacements may
    #: then stand still and go back, so that the force is known at the rows themselves and nowhere
    #: between.
    time_s: Array | None = None
    #: Whether the work is that of the force: not where a plate also moves sideways.
    is_conjugate: bool = True
    #: shape (n,) each; further quantities of a simulation by the names of their responses.
    quantities: Mapping[str, Array] = field(default_factory=dict)
    #: Rows that a measured curve was interpolated from, those of every repeat; none where its
    #: points are the rows.
    recorded: tuple[Curve, ...] = ()

    @property
    def places(self) -> Array:
        """Where the rows stand in order: times in s of a course, else displacements in mm."""
        return self.displacement_mm if self.time_s is None else self.time_s

    @cached_property
    def name(self) -> str:
        """Hash of the rows, made of the bytes of their numbers: the same on every machine."""
        rows = [self.displacement_mm, self.force_N]
        rows += [] if self.time_s is None else [self.time_s]
        table = np.ascontiguousarray(np.stack(rows), dtype="<f8")
        return hashlib.sha256(repr(table.shape).encode() + table.tobytes()).hexdigest()

    def __len__(self) -> int:
        return int(self.displacement_mm.size)

    def force_at(self, displacement_mm: ArrayLike) -> Array:
        """Force in N at given displacements; an unloaded origin (0, 0) is part of the curve."""
        d = np.asarray(displacement_mm, dtype=float)
        if self.time_s is not None:
            self._check_rows(d)
            return self.force_N
        if np.array_equal(d, self.displacement_mm):  # every curve passes through its points
            return self.force_N
        knots, force, slope = self._with_origin()
        low, high = min(float(knots[0]), 0.0), float(knots[-1])
        slack = 1e-12 + 1e-9 * max(high, -low)
        if d.size and (d.min() < low - (slack if low < 0 else 1e-12) or d.max() > high + slack):
            raise ValueError(
                f"the curve ends at {high:.6g} mm, asked for {d.min():.6g} to {d.max():.6g} mm"
            )
        if slope is None:
            return np.asarray(np.interp(d, knots, force))
        from scipy.interpolate import CubicHermiteSpline

        places = np.clip(d, low, high)
        return np.asarray(CubicHermiteSpline(knots, force, slope)(places)) + self._bulge(places)

    def stiffness_at(self, displacement_mm: ArrayLike) -> Array:
        """Tangent dF/dd in N/mm at given displacements: the slope of :meth:`force_at`."""
        from scipy.interpolate import CubicHermiteSpline

        d = np.asarray(displacement_mm, dtype=float)
        knots, force, slope = self._with_origin()
        if slope is None:
            raise ValueError("the curve has forces alone, and no tangents")
        self.force_at(d)  # refuses what lies beyond the end
        places = np.clip(d, 0, knots[-1])
        cubic = CubicHermiteSpline(knots, force, slope).derivative()(places)
        k = np.clip(np.searchsorted(knots, places, side="right") - 1, 0, knots.size - 2)
        width = np.diff(knots)[k]
        t = (places - knots[k]) / width
        bulge = 60.0 * self._missed_mean()[k] * t * (1.0 - t) * (1.0 - 2.0 * t) / width
        return np.asarray(cubic + bulge)

    def times(self, factor: float, *, without: Collection[str] = ()) -> Curve:
        """Multiply force, tangent, work and all quantities but those named; gradients go."""
        slope, work = self.stiffness_N_per_mm, self.work_Nmm
        return replace(
            self,
            force_N=factor * self.force_N,
            stiffness_N_per_mm=None if slope is None else factor * slope,
            force_gradient={},
            work_Nmm=None if work is None else factor * work,
            quantities={
                name: values if name in without else factor * values
                for name, values in self.quantities.items()
            },
        )

    def interpolation_error_N(self) -> Array:  # noqa: N802
        """Estimate how far the force between neighboring points is off. Shapes: returns (n,).

        The mean force that the cubic lacks of the work, where the force begins at least a share of
        how far the curve is from straight there; and shares of what cubic and quartic between its
        neighbors are off at a point next to the interval, for a mean that vanishes says nothing of
        a curve that winds about it.
        """
        off = np.abs(self._missed_mean())
        x, f, k = self._with_origin()
        if k is None or self.work_Nmm is None or not (self.is_conjugate and off.size):
            return off
        if len(self) == off.size:
            bent = _BENT * abs(float(k[1] * x[1] - f[1]))
            alone = _ALONE * abs(float(f[1])) if len(self) == 1 else 0.0
            # The work of the first interval gives the slope at the origin, so that nothing is left
            # over to tell how good its cubic is; what that mends in a parabola from there does.
            parabola = hermite_work(x[:2], f[:2], np.array([2 * f[1] / x[1] - k[1], k[1]]))
            mended = abs(float(self.work_Nmm[0] - parabola[0])) / float(x[1])
            off[0] = max(off[0], mended, bent, alone)
        h = x[2:] - x[:-2]
        t = (x[1:-1] - x[:-2]) / h
        cubic = (f[:-2] * (1 + 2 * t) + h * k[:-2] * t) * (1 - t) ** 2 - f[1:-1]
        cubic += (f[2:] * (3 - 2 * t) - h * k[2:] * (1 - t)) * t**2
        work = np.diff(np.r_[0.0, self.work_Nmm][-x.size :])
        pairs = h / 2 * (f[2:] + f[:-2]) + h**2 / 12 * (k[:-2] - k[2:])
        quartic = cubic + 30 * (work[1:] + work[:-1] - pairs) / h * (t * (1 - t)) ** 2
        near = np.r_[0.0, _BY_CUBIC * np.abs(cubic) + _BY_QUARTIC * np.abs(quartic), 0.0]
        return np.asarray(off + np.maximum(near[:-1], near[1:]) + _JUMP * _jumps(x, f, k))

    def relative_interpolation_error(self) -> float:
        """Estimated error of the interpolation over the force, both root mean square."""
        size = self._mean_square_force()
        return float(np.sqrt(self._square_errors().sum() / size)) if size > 0 else 0.0

    def coarse_intervals(self, error: float) -> list[float]:
        """Middles of the intervals, the worst first, without which ``error`` would be kept."""
        squares = self._square_errors()
        order = np.argsort(-squares, kind="stable")
        left = squares.sum() - np.cumsum(squares[order])
        allowed = error**2 * self._mean_square_force()
        if squares.sum() <= allowed:
            return []
        # an interval in halves keeps a part of its error: half of the tolerance is left for that
        worst = order[: int(np.argmax(left <= 0.5 * allowed)) + 1]
        knots = self._with_origin()[0]
        return [float(0.5 * (knots[k] + knots[k + 1])) for k in worst]

    def _square_errors(self) -> Array:
        """Integral of the squared error of every interval, N^2 mm."""
        return np.asarray(self.interpolation_error_N() ** 2 * np.diff(self._with_origin()[0]))

    def _mean_square_force(self) -> float:
        """Integral of the squared force, linear between the points, N^2 mm."""
        knots, force, _ = self._with_origin()
        a, b = force[:-1], force[1:]
        return float((np.diff(knots) * (a * a + a * b + b * b) / 3).sum())

    def with_tangents(self) -> Curve:
        """Return the curve with tangents and work of a cubic spline through its points and origin.

        For forces that another program computed without tangents. The error between points is of
        fourth order in their distance, that of chords of second order. Unchanged where tangents are
        known, where the force is one over time, and with fewer than three points.
        """
        from scipy.interpolate import CubicSpline

        if self.stiffness_N_per_mm is not None or self.time_s is not None or len(self) < 3:
            return self
        knots, force, _ = self._with_origin()
        spline, d = CubicSpline(knots, force), self.displacement_mm
        slope, work = spline.derivative()(d), spline.antiderivative()(d)
        return replace(self, stiffness_N_per_mm=np.asarray(slope), work_Nmm=np.asarray(work))

    def every_other_point(self) -> Curve:
        """Return the curve of half as many load steps, the last one kept."""
        return self.at_points(np.arange(len(self))[::-2][::-1])

    def at_points(self, indices: NDArray[np.int64]) -> Curve:
        """Return the curve of some of its points, given by their places."""
        rows = {key: v[indices] for key in _ROWS if (v := getattr(self, key)) is not None}
        slopes = {name: slope[indices] for name, slope in self.force_gradient.items()}
        quantities = {name: values[indices] for name, values in self.quantities.items()}
        return replace(self, **rows, force_gradient=slopes, quantities=quantities, recorded=())

    def without_gradients(self) -> Curve:
        """Return the curve without its derivatives by the constants."""
        return replace(self, force_gradient={})

    def gradient_at(self, name: str, displacement_mm: ArrayLike) -> Array:
        """dF/dtheta at given displacements (cubic spline through the solved steps)."""
        return self.gradients_at((name,), displacement_mm)[:, 0]

    def gradients_at(self, names: Sequence[str], displacement_mm: ArrayLike) -> Array:
        """dF/dtheta of several constants at given displacements, shape (n, p): one spline."""
        d = np.asarray(displacement_mm, dtype=float)
        if self.time_s is not None:
            self._check_rows(d)
            return self._gradients(names)
        if np.array_equal(d, self.displacement_mm):  # the spline passes through its points
            return self._gradients(names)
        return self.splined(self._gradients(names), d)

    def smooth_at(self, names: Sequence[str], displacement_mm: ArrayLike) -> tuple[Array, Array]:
        """Force and dF/dtheta, without the corners of chords between few points."""
        # Shapes: displacement_mm (n,); returns (n,); returns (n, p).
        d = np.asarray(displacement_mm, dtype=float)
        is_course = self.time_s is not None
        if self.stiffness_N_per_mm is not None or is_course or len(self) < 3:
            return self.force_at(d), self.gradients_at(names, d)
        values = self.splined(np.column_stack([self.force_N, self._gradients(names)]), d)
        return values[:, 0], values[:, 1:]

    def _gradients(self, names: Sequence[str]) -> Array:
        """DF/dtheta at the points, shape (len, p)."""
        if not names:
            return np.empty((len(self), 0))
        return np.stack([self.force_gradient[name] for name in names], axis=1)

    def splined(self, values: Array, d: Array) -> Array:
        """Columns of values at the points, zero at the unloaded origin, at other places in mm."""
        if not values.size:
            return np.empty((d.size, values.shape[1]))
        knots = self.displacement_mm
        return spline_from_origin(knots, values, np.clip(d, min(float(knots[0]), 0.0), knots[-1]))

    def as_dict(self) -> dict[str, Any]:
        """Plain lists, for JSON, of what the curve has; the recorded rows stay out."""
        out: dict[str, Any] = {
            key: values.tolist() for key in _ROWS if (values := getattr(self, key)) is not None
        }
        if not self.is_conjugate:
            out["is_conjugate"] = False
        for key in ("quantities", "force_gradient"):
            if named := getattr(self, key):
                out[key] = {name: values.tolist() for name, values in named.items()}
        return out

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Curve:
        """Inverse of :meth:`as_dict`."""
        rows = {key: np.asarray(data[key], float) for key in _ROWS if data.get(key) is not None}
        slopes, quantities = (
            {name: np.asarray(values, float) for name, values in data.get(key, {}).items()}
            for key in ("force_gradient", "quantities")
        )
        return replace(
            cls(rows["displacement_mm"], rows["force_N"]),
            **rows,
            force_gradient=slopes,
            quantities=quantities,
            is_conjugate=bool(data.get("is_conjugate", True)),
            recorded=(),
        )

    def _check_rows(self, d: Array) -> None:
        """Refuse places that are not the rows of this course."""
        displacement = self.displacement_mm
        span = float(np.abs(displacement).max(initial=0.0))
        if d.shape != displacement.shape or not np.allclose(
            d, displacement, rtol=0, atol=1e-6 * span
        ):
            raise ValueError("a course in time has forces at its own rows alone")

    def _with_origin(self) -> tuple[Array, Array, Array | None]:
        d, f, s = self.displacement_mm, self.force_N, self.stiffness_N_per_mm
        if not len(self) or d[0] <= 0:
            return d, f, s
        if s is None:
            return np.r_[0.0, d], np.r_[0.0, f], None
        return np.r_[0.0, d], np.r_[0.0, f], np.r_[self.slope_at_origin(), s]

    def slope_at_origin(self) -> float:
        """dF/dd with which the first interval's cubic does its work."""
        # Where the work is not known, the one that makes it a parabola.
        d, f = float(self.displacement_mm[0]), float(self.force_N[0])
        slope = 0.0 if self.stiffness_N_per_mm is None else float(self.stiffness_N_per_mm[0])
        if self.work_Nmm is None or not self.is_conjugate:
            return 2 * f / d - slope
        return slope + 12 * (float(self.work_Nmm[0]) - f * d / 2) / d**2

    def _missed_mean(self) -> Array:
        """Mean force that each interval's cubic lacks of the known work, N."""
        knots, force, slope = self._with_origin()
        if slope is None or self.work_Nmm is None or not self.is_conjugate:
            return np.zeros(max(knots.size - 1, 0))
        work = self.work_Nmm if knots.size == len(self) else np.r_[0.0, self.work_Nmm]
        return (np.diff(work) - hermite_work(knots, force, slope)) / np.diff(knots)

    def _bulge(self, places: Array) -> Array:
        """Return what the fourth degree adds: 30 m t^2 (1 - t)^2, whose mean is m."""
        knots = self._with_origin()[0]
        missed = self._missed_mean()
        if not missed.any():
            return np.zeros(places.shape)
        k = np.clip(np.searchsorted(knots, places, side="right") - 1, 0, missed.size - 1)
        t = (places - knots[k]) / np.diff(knots)[k]
        return np.asarray(30.0 * missed[k] * (t * (1.0 - t)) ** 2)


def spline_from_origin(knots: Array, values: Array, at: Array) -> Array:
    """Cubic spline from the unloaded origin through some steps; linear in ``values``."""
    # Shapes: knots (m,); values (m,) or (m, p); at (n,); returns (n,) or (n, p).
    from scipy.interpolate import CubicSpline

    if knots[0] > 0:
        knots, values = np.r_[0.0, knots], np.concatenate([np.zeros_like(values[:1]), values])
    if knots.size < 3:
        return np.apply_along_axis(lambda column: np.interp(at, knots, column), 0, values)
    return np.asarray(CubicSpline(knots, values)(at))


def _jumps(knots: Array, force: Array, slope: Array) -> Array:
    """Change of the force that the slopes at both ends do not explain, N, shape (n - 1,).

    Of a smooth curve it grows with the third power of the interval, by a factor that intervals
    beside it share; what is beyond that is taken for a jump. The slope at the origin is made of
    the work, so that the first interval tells nothing.
    """
    h = np.diff(knots)
    missed = np.abs(h * (slope[:-1] + slope[1:]) / 2 - np.diff(force))
    if missed.size < 3:
        return np.zeros(missed.shape)
    if knots[0] == 0.0:
        missed[0] = 0.0
    cubic = missed / h**3
    neighbors = np.maximum(np.r_[cubic[1], cubic[:-1]], np.r_[cubic[1:], cubic[-2]])
    return np.asarray(np.maximum(missed - _SMOOTH * neighbors * h**3, 0.0))


def hermite_work(knots: Array, force: Array, slope: Array) -> Array:
    """Work (n - 1,), N mm, of cubic Hermite intervals: knots mm, force N, slope N/mm, all (n,).

    Examples
    --------
    >>> d = np.array([0.0, 2.0])
    >>> hermite_work(d, d**3, 3 * d**2)
    array([4.])
    """
    h = np.diff(knots)
    return np.asarray(h / 2 * (force[1:] + force[:-1]) + h**2 / 12 * (slope[:-1] - slope[1:]))
