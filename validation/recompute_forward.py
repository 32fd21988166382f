"""One record again: a cold forward solution, a spline through its forces, and the scores."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from study.simulation.response import simulated_at
from validation.recompute_records import Direction, Job

Array = NDArray[np.float64]

#: load steps here over those of the record
MORE_STEPS = 4


def recomputed(job: Job) -> dict[str, Any]:
    """Responses of a record from forward solutions made here.

    Returns
    -------
    dict
        ``responses`` of every direction, ``monotone`` (the same with the other interpolation),
        ``steps`` (largest difference of force at the record's own steps, % of the largest) and
        ``same_mesh``.
    """
    spline, monotone, at_steps, meshes = [], [], 0.0, set()
    for one in job.directions:
        recorded = np.array(one.predicted)
        dense, mesh = solved(job, one, float(np.array(one.measured or one.predicted)[0].max()))
        meshes.add(mesh)
        spline.append(_responses(one, dense, monotone=False))
        monotone.append(_responses(one, dense, monotone=True))
        gap = np.abs(between(dense, recorded[0]) - recorded[1]).max()
        at_steps = max(at_steps, 100 * float(gap / np.abs(recorded[1]).max()))
    return {
        "responses": spline,
        "monotone": monotone,
        "steps": at_steps,
        "same_mesh": job.closed_form or meshes == {job.mesh_hash},
    }


def solved(job: Job, one: Direction, depth_mm: float) -> tuple[Array, str]:
    """Displacements and forces of a cold solution with more load steps, shape (2, n).

    Raises
    ------
    RuntimeError
        If it has no answer.
    """
    from study.mechanics.forward.closed_form import height_and_area
    from study.mechanics.setup.test_kind import StepSettings
    from study.mechanics.solver.finite_element_solution import solve
    from study.mechanics.solver.newton import Options
    from study.simulation.cell import CellProblem

    problem = CellProblem.of(job.config).at(one.constants, depth_mm)
    if job.closed_form:
        problem = _on_two_elements(problem, height_and_area(problem.specimen)[1])
    test = replace(problem.test, steps=MORE_STEPS * problem.test.steps)
    usual = StepSettings()  # what sticks takes smaller steps than those that are asked for
    steps = replace(usual, sticking=usual.sticking / MORE_STEPS)
    found = solve(replace(problem, test=test), gradients=True, options=Options(steps=steps))
    if found.status != "converged":
        raise RuntimeError(f"{found.status}: {found.message}")
    return np.array([found.curve.displacement_mm, found.curve.force_N]), found.mesh_hash


def _on_two_elements(problem: Any, area_mm2: float) -> Any:
    """Cylinder of the same cross-section on a coarse mesh: homogeneous, so any mesh is exact."""
    from study.mechanics.setup.geometry import Cylinder
    from study.mechanics.setup.setup import Model

    height = problem.specimen.height_mm
    cylinder = Cylinder(math.sqrt(area_mm2 / math.pi), height)
    return replace(problem, specimen=cylinder, model=Model(mesh_size_mm=height / 2))


def between(curve: Array, at: Array, *, monotone: bool = False) -> Array:
    """Interpolate forces between the solved steps and the unloaded origin by a cubic.

    Examples
    --------
    >>> curve = np.array([[1.0, 2.0, 3.0], [1.0, 8.0, 27.0]])
    >>> between(curve, np.array([0.5, 2.5])).round(9).tolist()
    [0.125, 15.625]
    """
    piecewise = _interpolated(curve, monotone)
    return np.asarray(piecewise(np.clip(at, 0.0, piecewise.x[-1])), dtype=float)


def _interpolated(curve: Array, monotone: bool) -> Any:
    """Piecewise cubic through the forces and the unloaded origin."""
    from scipy.interpolate import CubicSpline, PchipInterpolator

    knots, force = curve
    if knots[0] > 0:
        knots, force = np.r_[0.0, knots], np.r_[0.0, force]
    return (PchipInterpolator if monotone else CubicSpline)(knots, force)


def _responses(one: Direction, dense: Array, *, monotone: bool) -> dict[str, float]:
    """Responses of a solution that is denser than the record's."""
    found = {}
    if one.measured is not None:
        measured = np.array(one.measured)
        found = scores(between(dense, measured[0], monotone=monotone), measured)
    piecewise = _interpolated(dense, monotone)
    return found | {
        name: of_the_simulation(name, piecewise) for name in one.responses if name not in found
    }


def of_the_simulation(name: str, piecewise: Any) -> float:
    """Value of a response of the simulation alone; ``force_at_2.5_mm`` is one at 2.5 mm.

    Examples
    --------
    >>> from scipy.interpolate import CubicSpline
    >>> d = np.linspace(0, 3, 4)
    >>> names = ("peak_force", "force_at_2.5_mm", "work")
    >>> [round(of_the_simulation(name, CubicSpline(d, d**3)), 9) for name in names]
    [27.0, 15.625, 20.25]
    """
    kind, place = simulated_at(name)
    if kind == "peak_force":
        return float(piecewise(piecewise.x).max())
    if kind == "work":
        return float(piecewise.integrate(0.0, piecewise.x[-1]))
    return float(piecewise(place))


def scores(force: Array, measured: Array) -> dict[str, float]:
    """Responses of predicted forces at the measured displacements.

    Examples
    --------
    >>> found = scores(np.array([3.3, 4.4]), np.array([[1.0, 2.0], [3.0, 4.0]]))
    >>> [round(value, 9) for value in found.values()]
    [10.0, 0.353553391, 0.4, 10.0]
    """
    d, known = measured
    gap = force - known
    widths = np.diff(d)
    work = widths @ (known[1:] + known[:-1])
    return {
        "relative_rms_force_error": 100 * math.sqrt(float(gap @ gap) / float(known @ known)),
        "rms_force_error": math.sqrt(float(gap @ gap) / gap.size),
        "peak_force_error": abs(float(force.max()) - float(known.max())),
        "work_error": 100 * abs(float(widths @ (gap[1:] + gap[:-1])) / float(work)),
    }


def averaged(found: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Mean of each response over the directions."""
    return {name: math.fsum(one[name] for one in found) / len(found) for name in found[0]}
