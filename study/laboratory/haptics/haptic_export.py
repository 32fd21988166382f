"""A force law, or a surface over ranges, as JSON, CSV, a Python module and a C header."""

from __future__ import annotations

import json
import math
import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from numpy.typing import ArrayLike

import study
from study.ground.arrays import Array, Flags
from study.ground.canonical import Keyed
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError
from study.ground.tabular import csv_text
from study.mechanics.forward.finite_element import at_steps
from study.mechanics.material.material import is_dimensionless
from study.mechanics.setup.setup import Problem

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline

    from study.mechanics.solver.solution import Solution


SCHEMA = 1
#: Columns of a comment.
WIDTH = 90


def stem_of(name: str) -> str:
    """Name of a law as an identifier of Python and C, which is also that of its files.

    Examples
    --------
    >>> stem_of("flat-indentation"), stem_of("2 mm")
    ('flat_indentation_force_law', 'law_2_mm_force_law')
    """
    plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "a"
    return f"{'law_' if plain[0].isdigit() else ''}{plain}_force_law"


def _range(constant: ConstantRange) -> str:
    factor, unit = (1e3, " kPa") if constant.unit else (1.0, "")
    ends = f"{constant.name} from {factor * constant.low:.4g} to {factor * constant.high:.4g}{unit}"
    if math.isnan(constant.largest_N):
        return f"With {ends} alone the simulation does not reach the end: use no such constants."
    return f"With {ends} alone it is within {constant.largest_N:.2g} N, to first order."


def files(law: ForceLaw, folder: Path) -> dict[Path, str]:
    """Text of every file of a law, by its path in a folder; nothing is written."""
    stem = stem_of(law.name)
    text = json.dumps(law.to_json(), indent=2, allow_nan=False) + "\n"
    gradients = [f"dF_d{name}" for name in law.gradients]
    header = ["displacement_mm", "force_N", "stiffness_N_per_mm", *gradients]
    columns = [law.displacement_mm, law.force.values, law.force.slopes]
    columns += [table.values for table in law.gradients.values()]
    rows = (list(map(_number, row)) for row in zip(*columns, strict=True))
    texts = {"json": text, "csv": csv_text(header, rows)}
    texts |= {  # a Python module without imports, a C header without includes
        suffix: rendered(
            f"force_law.{suffix}.j2", law=law, name=law.name, stem=stem, sentences=law.sentences()
        )
        for suffix in ("py", "h")
    }
    return {folder / f"{stem}.{suffix}": content for suffix, content in texts.items()}


def rendered(template: str, **content: object) -> str:
    """Text of a template of this package; it says what made it."""
    environment = Environment(
        loader=PackageLoader("study.laboratory.haptics"),
        undefined=StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["number"] = _number
    environment.filters["folded"] = lambda line, mark: f"\n{mark}".join(textwrap.wrap(line, WIDTH))
    environment.filters["numbers"] = lambda values: ", ".join(map(_number, values))
    made_by = f"Made by study {study.__version__}."
    return environment.get_template(template).render(made_by=made_by, **content)


def _number(value: float) -> str:
    """Shortest decimals that are read as the same float, in Python and in C."""
    return repr(float(value))


# Solve a test in steps fine enough for its force law, with points kept out to judge it.

#: Fewest intervals of a table: a spline through its gradients needs that many.
FEWEST_INTERVALS = 4
#: Most intervals of a table. Each doubling divides the error of a smooth force by 16; where 320
#: do not reach the tolerance, contact on the mesh is what bends the curve.
MOST_INTERVALS = 320
#: Points of a path for each interval of the table: all but one are kept out of it.
PARTS = 4
#: Error bound over the largest force. Hands tell forces apart by 5 to 10 % (Jones 1989).
TOLERANCE = 2e-3
#: Share of each constant by which it is moved to see what first order leaves out.
CONSTANT_SHARE = 0.1

Progress = Callable[[str], None]


@dataclass(frozen=True)
class ForceLawSource:
    """A problem, and what is known of its constants."""

    #: Of the file, the calibration, or the study and its case.
    name: str
    problem: Problem
    #: How far each constant is moved, MPa (exponents plain): two standard errors of calibrated
    #: ones; a tenth of those that are left out.
    half_ranges: Mapping[str, float] = field(default_factory=dict)
    #: shape (p, p); of calibrated constants, MPa^2.
    covariance: Array | None = None


def solved_force_law(
    source: ForceLawSource, tolerance: float = TOLERANCE, progress: Progress | None = None
) -> ForceLaw:
    """Force law of a problem, with intervals halved until its error bound is met."""
    say, name, problem = progress or (lambda text: None), source.name, source.problem
    intervals = max(problem.test.steps, FEWEST_INTERVALS)
    while True:
        solution = _solved(problem, PARTS * intervals)
        law = tabulated(name, problem, solution.curve)
        say(f"{intervals} intervals: {100 * law.relative_error:.2g} % of the largest force")
        if law.relative_error <= tolerance or 2 * intervals > MOST_INTERVALS:
            break
        intervals *= 2
    law = replace(law, covariance=source.covariance)
    return replace(law, ranges=tuple(_ranges(law, solution, source, say)))


def tabulated(name: str, problem: Problem, path: Curve) -> ForceLaw:
    """Tabulate every fourth point of a path in even steps; judge by the others, and between them.

    Between its points the path is its own interpolation, with the work that it does and without.
    """
    curve = _with_origin(path)
    if curve.stiffness_N_per_mm is None:
        raise ValueError("a force law needs the stiffness of its curve")
    knots = np.arange(0, len(curve), PARTS)
    others = np.setdiff1d(np.arange(len(curve)), knots)
    d, force_N, slopes = curve.displacement_mm, curve.force_N, curve.stiffness_N_per_mm[knots]
    step_mm = float(d[PARTS])
    force = force_table(step_mm, force_N[knots], slopes)
    gradients = {n: gradient_table(step_mm, v[knots]) for n, v in curve.force_gradient.items()}
    between = np.linspace(0.0, float(d[-1]), PARTS * len(path) + 1)
    missed = [force.at(between) - sampled.force_at(between) for sampled in (path, curve)]
    return ForceLaw(
        name=name,
        force=force,
        gradients=gradients,
        constants=dict(problem.material.constants),
        limited=tuple(int(k) for k in np.flatnonzero(force.slopes[1:] != slopes[1:]) + 1),
        held_out=HeldOut(
            d[others], force_N[others], force.at(d[others]) - force_N[others],
            float(np.abs(missed).max()),
        ),
    )  # fmt: skip


def _solved(problem: Problem, steps: int, warm: Solution | None = None) -> Solution:
    """Solution in even steps."""
    asked_problem = replace(problem, test=replace(problem.test, steps=steps))
    if asked_problem.test.hold_s is not None or asked_problem.test.cycles is not None:
        rule = "makes a force over time, and a law is one over displacement"
        raise InputError(Fault("test", rule, "leave hold and cycles out"))
    solution = at_steps(asked_problem, warm=warm)
    if not solution.converged:
        rule = f"the simulation ends too early ({solution.status}): {solution.message}"
        mend = "press less deep: a law ends where the simulation does"
        raise InputError(Fault("test.displacement", rule, mend))
    return solution


def _with_origin(curve: Curve) -> Curve:
    """Begin a curve at the unloaded state, with the slope that its work implies."""
    # the law's first interval ends at the fourth point, whose work is known best
    first = curve.at_points(np.arange(PARTS - 1, len(curve), PARTS)).slope_at_origin()
    slopes = curve.stiffness_N_per_mm
    return Curve(
        np.r_[0.0, curve.displacement_mm],
        np.r_[0.0, curve.force_N],
        None if slopes is None else np.r_[first, slopes],
        {name: np.r_[0.0, values] for name, values in curve.force_gradient.items()},
    )


def _ranges(
    law: ForceLaw, solution: Solution, source: ForceLawSource, say: Progress
) -> list[ConstantRange]:
    """Move every constant alone to both ends of its range, and solve there."""
    ranges = []
    for name, value in law.constants.items():
        half = source.half_ranges.get(name, CONSTANT_SHARE * abs(value))
        ends = (value - half, value + half)
        missed = [_deviation(law, source.problem, solution, {name: end}) for end in ends]
        off = float(np.max(missed))  # NaN, where one end has no answer, stays NaN
        ranges.append(ConstantRange(name, *ends, off))
        say(f"{name} from {ends[0]:.4g} to {ends[1]:.4g}: {off:.2g} N from first order")
    return ranges


def _deviation(
    law: ForceLaw, problem: Problem, solution: Solution, constants: Mapping[str, float]
) -> float:
    """Largest deviation in N at other constants; NaN where the simulation has no answer."""
    moved = replace(problem, material=problem.material.with_constants(constants))
    try:
        curve = _solved(moved, len(solution.curve), solution).curve
    except InputError:
        return float("nan")
    return float(np.abs(law.force_at(curve.displacement_mm, constants) - curve.force_N).max())


# Slopes of a monotone cubic Hermite interpolant (Fritsch and Carlson 1980, SIAM J. Numer. Anal.
# 17, 238-246).

#: A cubic is monotone where the slopes at both of its ends are at most this multiple of the
#: chord's slope (Fritsch and Carlson 1980, section 4).
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


def is_monotone(chords: Array, slopes: Array) -> Flags:
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
class TabulatedFunction(Keyed):
    """A function tabulated at evenly spaced displacements from 0, with its slopes.

    Between two of them it is the cubic with their values and slopes, so that it is smooth (C1).
    Below 0 it is zero, beyond the last one it goes on straight.
    """

    KEYS = "value=values slope_per_mm=slopes"

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
        inside = self._spline(np.clip(d, 0.0, self.end_mm))
        beyond = self.slopes[-1] * np.maximum(d - self.end_mm, 0.0)
        return np.asarray(np.where(d < 0, 0.0, inside + beyond))

    def slope_at(self, displacement_mm: ArrayLike) -> Array:
        """Differentiate by the displacement, per mm."""
        d = np.asarray(displacement_mm, dtype=float)
        return np.asarray(np.where(d < 0, 0.0, self._spline(np.clip(d, 0.0, self.end_mm), 1)))

    @cached_property
    def _spline(self) -> CubicHermiteSpline:
        from scipy.interpolate import CubicHermiteSpline

        knots = self.step_mm * np.arange(self.values.size)
        return CubicHermiteSpline(knots, self.values, self.slopes)


#: Error bound over the largest deviation that is seen: contact that closes point by point makes no
#: smooth function. Of six laws of punches, spheres and cones the largest deviation on a path of
#: four times as many points was .9 to 1.2 times the largest that is seen here
BEYOND_SEEN = 1.5


@dataclass(frozen=True)
class HeldOut(Keyed):
    """Points of a path that are kept out of the table made of it, three in each interval."""

    KEYS = "displacement_mm force_N deviation_N"

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

    @property
    def unit(self) -> str:
        """``"MPa"``; empty for an exponent."""
        return "" if is_dimensionless(self.name) else "MPa"


@dataclass(frozen=True)
class ForceLaw(Keyed):
    """Force as a function of displacement, and to first order of the constants."""

    KEYS = (
        "schema kind name displacement_mm force_N=force.values stiffness_N_per_mm=force.slopes "
        "constants_MPa=constants force_gradient=gradients tested_mm continuation "
        "monotone=is_monotone limited_mm error_bound held_out constant_ranges=ranges "
        "standard_uncertainty_N sentences version"
    )
    schema, kind, version = SCHEMA, "force-law", study.__version__
    continuation: ClassVar[Mapping[str, object]] = {
        "below": "zero",
        "above": "linear",
        "simulated": False,
    }

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
    def tested_mm(self) -> tuple[float, float]:
        """Displacements that were simulated."""
        return 0.0, self.force.end_mm

    @property
    def limited_mm(self) -> list[float]:
        """Displacements at which the slope is smaller than that of the simulation."""
        return [float(self.displacement_mm[k]) for k in self.limited]

    @property
    def error_bound(self) -> dict[str, float]:
        """Bound of the error, over the largest force too, with the points that tell it."""
        held = self.held_out
        return {"force_N": held.bound_N, "relative": self.relative_error, "at_mm": held.worst_mm,
                "points": held.force_N.size}  # fmt: skip

    @property
    def standard_uncertainty_N(self) -> Array | None:  # noqa: N802
        """Standard uncertainty at every knot that a calibration leaves; None without one."""
        if self.covariance is None:
            return None
        rows = [self.gradients[name].at(self.displacement_mm) for name in self.constants]
        gradient = np.stack(rows, axis=-1)
        square = np.einsum("...i,ij,...j->...", gradient, self.covariance, gradient)
        uncertainty = np.sqrt(np.maximum(square, 0.0))
        return uncertainty if np.isfinite(uncertainty).all() else None

    @property
    def relative_error(self) -> float:
        """Error bound over the largest force of the table."""
        return self.held_out.bound_N / float(np.abs(self.force.values).max())

    @property
    def is_monotone(self) -> bool:
        """Whether the force never falls as the displacement grows."""
        chords = np.diff(self.force.values) / self.force.step_mm
        return bool(np.all(chords >= 0) and np.all(is_monotone(chords, self.force.slopes)))

    def sentences(self) -> list[str]:
        """Say where a law holds, how near it is, and what it does elsewhere."""
        held, end = self.held_out, self.force.end_mm
        largest = f"{held.bound_N:.2g} N ({100 * self.relative_error:.2g} % of the largest force)"
        lines = [
            f"Tested from 0 to {end:g} mm: within {largest} of the simulation on "
            f"{held.force_N.size} points solved between its {self.force.values.size} knots.",
            f"Below 0 mm it is zero and beyond {end:g} mm it goes on straight; no simulation says "
            "so, and is_tested tells where that is.",
            f"Its slope is continuous but at first touch, where it begins with "
            f"{self.force.slopes[0]:.4g} N/mm.",
        ]
        if self.limited:
            places = ", ".join(f"{self.displacement_mm[k]:.4g}" for k in self.limited)
            lines += [f"It rises where the simulation does: its slope is limited at {places} mm."]
        elif self.is_monotone:
            lines += ["It never falls, with the slopes of the simulation."]
        else:
            lines += ["The simulated force falls somewhere, and so does the law."]
        return lines + [_range(constant) for constant in self.ranges]

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

    def is_tested(self, displacement_mm: ArrayLike) -> Flags:
        """Whether displacements lie in the simulated range; outside, the law only continues."""
        d = np.asarray(displacement_mm, dtype=float)
        return np.asarray((d >= 0) & (d <= self.force.end_mm))


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


# A surface over ranges as a function that needs no package: JSON and a Python module.


def surface_files(
    function: Keyed, stem: str, sentences: Sequence[str], folder: Path
) -> dict[Path, str]:
    """Text of the files of a surface that is plain numbers, by their path in a folder."""
    text = json.dumps(function.to_json(), indent=1, allow_nan=False) + "\n"
    module = rendered("surface.py.j2", f=function, said=sentences)  # imports nothing but math
    return {folder / f"{stem}.json": text, folder / f"{stem}.py": module}
