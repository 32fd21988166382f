"""Predictions of one cell for several specimens: a cold solution serves them all.

The specimens of a cell differ in their constants alone. The first specimen's problem is
solved cold, with gradients; every other one starts from its load steps, moved along their
sensitivities, and needs a few iterations where a cold start needs dozens. Steps between the
requested ones are added by each curve for itself, as by a cold solution. The anchor is a
function of the cell and not of what was computed before, so that a resumed study gives
the same digits.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from study.mechanics.forward import closed_form
from study.mechanics.setup.setup import Problem
from study.mechanics.setup.test_kind import StepSettings

if TYPE_CHECKING:
    from study.mechanics.solver.newton import Options
    from study.mechanics.solver.solution import Solution


@dataclass(frozen=True)
class Prediction:
    """A forward solution and what it would have cost alone, in seconds."""

    solution: Solution
    cold_seconds: float


@dataclass(frozen=True)
class Anchor:
    """Solution that the specimens of a cell start from."""

    group: str
    #: Those of its first specimen, MPa; None where the configuration gives them.
    constants: Mapping[str, float] | None = None


#: makes the problem of a cell with given constants, MPa
ProblemAt = Callable[[Mapping[str, float] | None], Problem]


class Anchors:
    """The anchor of the cell that this worker is busy with; one at a time is kept."""

    def __init__(self) -> None:
        self._group = ""
        self._solution: Solution | None = None
        self._seconds = 0.0

    def predict(
        self, problem_at: ProblemAt, constants: Mapping[str, float] | None, anchor: Anchor | None
    ) -> Prediction:
        """Solve for one specimen, from the anchor of its cell where there is one.

        Units: constants MPa.
        """
        problem = problem_at(constants)
        if anchor is None:
            return _cold(problem, gradients=False)
        self._prepare(problem_at, anchor)
        if self._solution is None:
            return _cold(problem, gradients=False)
        if constants == anchor.constants:
            return Prediction(self._solution, self._seconds)
        from study.mechanics.solver.newton import Options

        apart = Options(same_points=False)
        solution = solve(problem, gradients=False, warm=self._solution, options=apart)
        if solution.status != "converged":
            return _cold(problem, gradients=False)
        return Prediction(solution, self._seconds)

    def _prepare(self, problem_at: ProblemAt, anchor: Anchor) -> None:
        if anchor.group == self._group:
            return
        self._solution = None  # its memory goes before the next one comes
        prediction = _cold(problem_at(anchor.constants), gradients=True)
        self._group, self._seconds = anchor.group, prediction.cold_seconds
        self._solution = prediction.solution if prediction.solution.status == "converged" else None


def _cold(problem: Problem, *, gradients: bool) -> Prediction:
    load_compiled(problem)
    began = time.perf_counter()
    solution = solve(problem, gradients=gradients)
    return Prediction(solution, time.perf_counter() - began)


#: spaces, laws and tests whose compiled loops this process has used already
_LOADED: set[tuple[str, ...]] = set()


def load_compiled(problem: Problem) -> None:
    """Solve a small relative of a problem, once for each kind."""
    # The compiled loops are then in memory, so that the time of the problem itself is its own.
    if problem.setup.has_no_elements:
        return
    key = (problem.model.space, problem.material.law().kind.name, problem.test.kind)
    if key in _LOADED:
        return
    _LOADED.add(key)
    test = replace(problem.test, steps=1, displacement_mm=problem.test.depth_mm / 50)
    model = replace(problem.model, mesh="coarse", mesh_size_mm=None)
    solve(replace(problem, test=test, model=model), gradients=False)


def solve(
    problem: Problem,
    *,
    gradients: bool = True,
    warm: Solution | None = None,
    cutbacks: float | None = None,
    options: Options | None = None,
) -> Solution:
    """Forward solution, in closed form of a gauge section; the solver is loaded on first use."""
    from study.mechanics.solver.newton import Options

    options = options or Options()
    if cutbacks is not None:
        options = replace(options, steps=StepSettings(smallest=cutbacks), snaps=False)
    options = replace(options, curve_error=CURVE_ERROR)
    return at_steps(problem, gradients=gradients, warm=warm, options=options)


def at_steps(
    problem: Problem,
    *,
    gradients: bool = True,
    warm: Solution | None = None,
    options: Options | None = None,
    progress: Callable[[float], None] | None = None,
) -> Solution:
    """Forward solution at the load steps of the problem, however far apart they are."""
    # In closed form of a gauge section, else by elements.
    if problem.setup.has_no_elements:
        return closed_form.solution(problem)
    from study.mechanics.solver.finite_element_solution import solve as by_elements

    return by_elements(problem, gradients=gradients, warm=warm, options=options, progress=progress)


#: Share of the force, root mean square, by which the interpolation between load steps may be off by
#: its bound, which is about five times the true error (docs/load-steps.md). Measured on needles,
#: punches and spheres with a bound of half this, a relative RMS error of 3 % moves by 0.001
#: percentage points where the load steps are halved, one of 0.1 % by 0.02.
CURVE_ERROR = 1e-3
