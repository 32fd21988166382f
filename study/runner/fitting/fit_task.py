"""Calibration of one material on one block, as a worker does it.

A fit goes to a worker complete in itself: its problem (:mod:`study.runner.fitting.fit_problem`),
its measured curves, and the fit that gives its start values.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from study.arrays import Array
from study.calibration.function import EvaluationFailed
from study.calibration.influence import with_serial_correlation
from study.calibration.measured_curve import MeasuredCurve
from study.curve import Curve
from study.errors import InputError
from study.execution.task import Received
from study.forward import closed_form, finite_element
from study.material.registry import ENERGIES
from study.runner.fitting.external_fit import InverseExternal
from study.runner.fitting.fit_problem import FitProblem
from study.runner.fitting.fit_summary import FitResult, described, status_of
from study.runner.fitting.solution import Predicted
from study.runner.fitting.staged_fit import Part, Predict, staged_fit
from study.setup.material_section import MaterialSection
from study.setup.setup import Problem, Setup, Tables, problem_of

if TYPE_CHECKING:  # it loads compiled kernels
    from study.fem.solver.solution import Solution

#: smallest load step over the largest: constants that need less are next to having no answer,
#: and an optimizer that asks there should hear so soon
_CUTBACKS = 0.12


@dataclass(frozen=True)
class FitTask:
    """A fit as it goes to a worker, complete in itself.

    Parameters
    ----------
    problem : FitProblem
        What is fitted.
    measured : tuple of Curve
        The averaged curves that it is fitted to.
    start : FitResult or None
        Outcome of the fit of :func:`start_problem`, or of the fit whose residuals are resampled.
    noise : tuple of int or None
        Seed and number of a fit to resampled residuals.
    """

    problem: FitProblem
    measured: tuple[Curve, ...]
    start: FitResult | None = None
    noise: tuple[int, int] | None = None

    @property
    def kind(self) -> str:
        """Name of what a worker does with it."""
        return "fit" if self.noise is None else "noise"

    def to_json(self) -> dict[str, object]:
        """Plain data for a worker."""
        return {
            "kind": self.kind,
            "method": self.problem.method,
            "tables": dict(self.problem.tables),
            "measured": [curve.as_dict(recorded=True) for curve in self.measured],
            "start": None if self.start is None else self.start.to_json(),
            "noise": self.noise,
        }

    @classmethod
    def from_json(cls, task: Received) -> FitTask:
        """Inverse of :meth:`to_json`."""
        return cls(
            FitProblem(task["method"], task["tables"], False),
            tuple(Curve.from_dict(curve) for curve in task["measured"]),
            None if task["start"] is None else FitResult.from_json(task["start"]),
            None if task["noise"] is None else (task["noise"][0], task["noise"][1]),
        )


def perform(document: Received) -> dict[str, object]:
    """Fit the constants of one material to measured curves: a task for a worker.

    Parameters
    ----------
    document : mapping
        Of :meth:`FitTask.to_json`.

    Returns
    -------
    dict
        Of :meth:`FitResult.to_json`.
    """
    return fitted(FitTask.from_json(document)).to_json()


def fitted(task: FitTask) -> FitResult:
    """Fit the constants of one material to measured curves.

    Parameters
    ----------
    task : FitTask
        Its ``start``, where there is one, gives the start values.

    Returns
    -------
    FitResult
        With the status of ``start`` and no constants where that fit found none.
    """
    began = time.perf_counter()
    start = task.start
    if start is not None and not start.converged:  # it cannot be fitted alone
        why = f"the fit that starts it did not converge: {start.message}"
        return FitResult.without_answer(start.status, why)
    parts = parts_of(task)
    names, first = start_values(
        parts[0].tables, task.measured, None if start is None else start.constants
    )
    done = staged_fit(parts, names, first, model)
    fitted_curves = [one for part in parts for one in part.measured]
    found = described(
        with_serial_correlation(done.fit, fitted_curves),
        parts[0].tables,
        task.measured[:1] if len(parts) > 1 else task.measured,
    )
    asked = task.problem.method
    found.update({"message": done.message, "evaluations": done.evaluations, "method": asked})
    predict, predicted = done.models[0], None
    if isinstance(predict, InverseFem) and task.problem.method == "inverse-fem":
        predicted = predict.predicted(done.fit.values)
        found.update({"newton_iterations": predict.newton_iterations, "solves": predict.solves})
    if isinstance(predict, InverseExternal):
        predicted = predict.predicted(done.fit.values) if done.fit.status.usable else None
        found["solves"] = predict.solves
    found["seconds"] = time.perf_counter() - began
    return FitResult(status_of(done.fit), found, predicted, 0.0 if start is None else start.seconds)


def parts_of(task: FitTask) -> list[Part]:
    """Parts of a fit, each with the measured curves that belong to it.

    Parameters
    ----------
    task : FitTask
        Of one test, which all curves belong to, or of several, each with one curve in their order.
    """
    tests = task.problem.tests
    data = [
        MeasuredCurve(f"measured {k}", curve, recordings=curve.recorded)
        for k, curve in enumerate(task.measured)
    ]
    if len(tests) == 1:
        return [Part(*tests[0], tuple(data))]
    return [Part(*test, (one,)) for test, one in zip(tests, data, strict=True)]


def start_values(
    tables: Tables, measured: Sequence[Curve], neo_hookean: Mapping[str, float] | None
) -> tuple[tuple[str, ...], Array]:
    """Names of the constants and where the fit starts.

    Higher constants start at zero: those of the closed form soften so much that a bonded
    specimen cannot be solved with them.

    Parameters
    ----------
    tables : mapping
        Of the fitted test; constants of its ``material`` are the start where there are any.
    measured : sequence of Curve
        The first one gives ``C10`` where nothing else does; may be empty otherwise.
    neo_hookean : mapping of str to float or None
        Constants of a simpler fit in MPa, with ``C10``; None to take ``C10`` from the closed form.

    Returns
    -------
    names : tuple of str
        Those of the energy, then shares and times of the relaxation that are fitted.
    start : ndarray, shape (p,)
        In MPa; exponents and shares plain, times in s.
    """
    known = MaterialSection.of(tables)
    names, fading = known.calibrated_names, known.starts_of_relaxation()
    if known.constants:
        return names, np.array([float({**known.constants, **fading}[n]) for n in names])
    if neo_hookean is None:
        first = measured[0]
        neo_hookean = closed_form.neo_hookean_start(tables, first.displacement_mm, first.force_N)
    energy, shear_modulus = ENERGIES[known.model], 2 * float(neo_hookean["C10"])
    own = [name for name in names if name not in fading]
    values = {**neo_hookean, **energy.starting_values(own, shear_modulus), **fading}
    return names, np.array([values.get(n, 0.0) for n in names])


def model(method: str, tables: Tables, measured: Sequence[Curve], names: Sequence[str]) -> Predict:
    """Model of one test, for the optimizer.

    Parameters
    ----------
    method : {"closed-form", "inverse-fem", "external"}
        How the test is predicted.
    tables : mapping
        Of the fitted test; constants of its material are replaced.
    measured : sequence of Curve
        Predicted at their displacements (mm), in a closed form also at their times (s).
    names : sequence of str
        Constants, in the order in which the optimizer varies them.

    Returns
    -------
    callable
        Constants (p,) in MPa (exponents plain) -> one curve for every measured one, with its
        gradient by all names; raises :class:`EvaluationFailed` where there is no answer.
    """
    if method == "external":
        return InverseExternal(tables, measured, names)
    make = closed_form_model if method == "closed-form" else InverseFem
    return make(tables, measured, names)


def closed_form_model(tables: Tables, measured: Sequence[Curve], names: Sequence[str]) -> Predict:
    """Model of a homogeneous test, for the optimizer.

    Parameters
    ----------
    tables, measured, names
        As for :func:`model`.

    Returns
    -------
    callable
        As for :func:`model`.
    """
    setup, section = Setup.of(tables), MaterialSection.of(tables)

    def predict(values: Array) -> list[Curve]:
        constants = dict(zip(names, values.tolist(), strict=True))
        try:
            material = section.material(constants)
        except InputError as error:
            raise EvaluationFailed(str(error)) from error
        curves = [closed_form.at_rows(setup, material, curve) for curve in measured]
        if not all(np.all(np.isfinite(curve.force_N)) for curve in curves):
            raise EvaluationFailed("the material has no equilibrium state at these constants")
        return curves

    return predict


class InverseFem:
    """Forward solutions with gradients; each starts from the one before it in the same fit.

    Between the solved steps the first curve is interpolated with its tangent (Hermite), and
    what later curves add to it by a spline that is linear in the solved forces. The gradient
    of the forces at the measured points is then the exact gradient of what is compared;
    otherwise the optimizer would chase the difference of two interpolations.
    """

    def __init__(self, tables: Tables, measured: Sequence[Curve], names: Sequence[str]) -> None:
        self._tables, self._names = tables, names
        self._grids = [curve.displacement_mm for curve in measured]
        self._depth = max(float(grid.max()) for grid in self._grids)
        self._base: Curve | None = None
        self._last: Solution | None = None
        #: simulations so far, and iterations of Newton's method in them
        self.solves = 0
        self.newton_iterations = 0
        #: solved curve at every set of constants
        self.curves: dict[bytes, Curve] = {}

    def __call__(self, values: Array) -> list[Curve]:
        """Predict the forces at the measured displacements for constants in MPa."""
        curve = self._solved(values)
        self.curves[values.tobytes()] = curve.without_gradients()
        if self._base is None:
            self._base = curve
        return [self._at(curve, grid) for grid in self._grids]

    def _solved(self, values: Array) -> Curve:
        constants = dict(zip(self._names, values.tolist(), strict=True))
        try:
            problem = problem_of(self._tables, constants, self._depth)
            solution = self._simulated(problem, self._last)
            if solution.status == "not-converged" and self._last is not None:
                # the way from the solution before was too long: that says nothing of the constants
                solution = self._simulated(problem, None)
        except InputError as error:
            raise EvaluationFailed(str(error)) from error
        if solution.status != "converged":
            raise EvaluationFailed(f"{solution.status}: {solution.message}")
        self._last = solution
        return solution.curve

    def _simulated(self, problem: Problem, warm: Solution | None) -> Solution:
        solution = finite_element.solve(problem, gradients=True, warm=warm, cutbacks=_CUTBACKS)
        self.solves += 1
        self.newton_iterations += int(sum(solution.newton_iterations))
        return solution

    def _at(self, curve: Curve, grid: Array) -> Curve:
        """Interpolate force and gradient at measured points, each consistent with the other."""
        base = curve if self._base is None else self._base
        here = curve.displacement_mm
        added = _spline(here, curve.force_N - base.force_at(here), grid)
        gradient = {
            n: _spline(curve.displacement_mm, curve.force_gradient[n], grid) for n in self._names
        }
        return Curve(grid, base.force_at(grid) + added, force_gradient=gradient)

    def predicted(self, values: Array) -> Predicted | None:
        """Curve at the final constants, with mesh and solver of the last solution."""
        if self._last is None:
            return None
        return replace(Predicted.of(self._last), curve=self.curves[np.asarray(values).tobytes()])


def _spline(knots: Array, values: Array, at: Array) -> Array:
    """Cubic spline from the unloaded origin through the solved steps; linear in ``values``."""
    from scipy.interpolate import CubicSpline

    x, y = (knots, values) if knots[0] <= 0 else (np.r_[0.0, knots], np.r_[0.0, values])
    if x.size < 3:
        return np.asarray(np.interp(at, x, y))
    return np.asarray(CubicSpline(x, y)(at))
