"""Solve a test in steps fine enough for its force law, with points kept out to judge it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from study.arrays import Array
from study.curve import Curve
from study.errors import Fault, InputError
from study.forward.finite_element import at_steps
from study.haptics.force_law import (
    ConstantRange,
    ForceLaw,
    HeldOut,
    force_table,
    gradient_table,
)
from study.setup.setup import Problem

if TYPE_CHECKING:  # it loads compiled kernels
    from study.fem.solver.solution import Solution

#: Fewest intervals of a table: a spline through its gradients needs that many.
FEWEST_INTERVALS = 4
#: Most intervals of a table. Each doubling divides the error of a smooth force by 16; where 320
#: do not reach the tolerance, contact on the mesh is what bends the curve.
MOST_INTERVALS = 320
#: Error bound over the largest force. Hands tell forces apart by 5 to 10 % (Jones 1989).
TOLERANCE = 2e-3
#: Share of each constant by which it is moved to see what first order leaves out.
CONSTANT_SHARE = 0.1

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Wanted:
    """What a force law has to keep.

    Parameters
    ----------
    tolerance : float
        Error bound over the largest force.
    half_ranges : mapping of str to float
        How far each constant is moved, MPa (exponents plain); a tenth of it by default.
    covariance : ndarray, shape (p, p), optional
        Of calibrated constants, MPa^2.
    """

    tolerance: float = TOLERANCE
    half_ranges: Mapping[str, float] | None = None
    covariance: Array | None = None


def solved_force_law(
    name: str, problem: Problem, wanted: Wanted, progress: Progress | None = None
) -> ForceLaw:
    """Force law of a problem, with intervals halved until its error bound is met.

    Parameters
    ----------
    name : str
        Of the law.
    problem : Problem
        With its constants and its displacement; the steps of its test are the first intervals.
    wanted : Wanted
        Tolerance and ranges.
    progress : callable, optional
        Gets a sentence after every solution.

    Returns
    -------
    ForceLaw
        The first whose bound is met, or that of the most intervals.

    Raises
    ------
    InputError
        If the simulation does not reach the displacement.
    """
    say = progress or (lambda text: None)
    intervals = max(problem.test.steps, FEWEST_INTERVALS)
    while True:
        solution = _solved(problem, 2 * intervals)
        law = tabulated(name, problem, _with_origin(solution.curve))
        say(f"{intervals} intervals: {100 * law.relative_error:.2g} % of the largest force")
        if law.relative_error <= wanted.tolerance or 2 * intervals > MOST_INTERVALS:
            break
        intervals *= 2
    law = replace(law, covariance=wanted.covariance)
    return replace(law, ranges=tuple(_ranges(law, problem, solution, wanted, say)))


def tabulated(name: str, problem: Problem, curve: Curve) -> ForceLaw:
    """Tabulate every other point of a curve that begins at the origin; judge by the others.

    Parameters
    ----------
    name : str
        Of the law.
    problem : Problem
        Its constants are those of the table.
    curve : Curve
        At evenly spaced displacements from 0, an even number of intervals of them, with
        stiffness and gradients.

    Returns
    -------
    ForceLaw
        Without ranges of its constants.
    """
    slopes = curve.stiffness_N_per_mm
    if slopes is None:
        raise ValueError("a force law needs the stiffness of its curve")
    kept, between = slice(0, None, 2), slice(1, None, 2)
    step = float(curve.displacement_mm[2])
    force = force_table(step, curve.force_N[kept], slopes[kept])
    gradients = {
        name: gradient_table(step, values[kept]) for name, values in curve.force_gradient.items()
    }
    middles = curve.displacement_mm[between]
    there = curve.force_N[between]
    moved = np.flatnonzero(force.slopes[1:] != slopes[kept][1:]) + 1
    return ForceLaw(
        name=name,
        force=force,
        gradients=gradients,
        constants=dict(problem.material.constants),
        limited=tuple(int(k) for k in moved),
        held_out=HeldOut(middles, there, force.at(middles) - there),
    )


def _solved(problem: Problem, steps: int, warm: Solution | None = None) -> Solution:
    """Solution in even steps.

    Raises
    ------
    InputError
        If it does not reach the end, or its force is one over time.
    """
    asked = replace(problem, test=replace(problem.test, steps=steps))
    if asked.test.hold_s is not None or asked.test.cycles is not None:
        rule = "makes a force over time, and a law is one over displacement"
        raise InputError(Fault("test", rule, "leave hold and cycles out"))
    solution = at_steps(asked, warm=warm)
    if not solution.converged:
        rule = f"the simulation ends too early ({solution.status}): {solution.message}"
        mend = "press less deep: a law ends where the simulation does"
        raise InputError(Fault("test.displacement", rule, mend))
    return solution


def _with_origin(curve: Curve) -> Curve:
    """Begin a curve at the unloaded state, with the slope that its work implies."""
    # the law's first interval ends at the second point, whose work is known best
    first = curve.at_points(np.arange(1, len(curve), 2)).slope_at_origin()
    slopes = curve.stiffness_N_per_mm
    return Curve(
        np.r_[0.0, curve.displacement_mm],
        np.r_[0.0, curve.force_N],
        None if slopes is None else np.r_[first, slopes],
        {name: np.r_[0.0, values] for name, values in curve.force_gradient.items()},
    )


def _ranges(
    law: ForceLaw, problem: Problem, solution: Solution, wanted: Wanted, say: Progress
) -> list[ConstantRange]:
    """Move every constant alone to both ends of its range, and solve there."""
    found = []
    for name, value in law.constants.items():
        half = (wanted.half_ranges or {}).get(name, CONSTANT_SHARE * abs(value))
        ends = (value - half, value + half)
        # NaN, where one end has no answer, stays NaN
        off = float(np.max([_deviation(law, problem, solution, {name: end}) for end in ends]))
        found.append(ConstantRange(name, *ends, off))
        say(f"{name} from {ends[0]:.4g} to {ends[1]:.4g}: {off:.2g} N from first order")
    return found


def _deviation(
    law: ForceLaw, problem: Problem, solution: Solution, constants: Mapping[str, float]
) -> float:
    """Largest deviation in N at other constants; NaN where the simulation has no answer."""
    moved = replace(problem, material=problem.material.with_constants(constants))
    try:
        found = _solved(moved, len(solution.curve), solution).curve
    except InputError:
        return float("nan")
    return float(np.abs(law.force_at(found.displacement_mm, constants) - found.force_N).max())
