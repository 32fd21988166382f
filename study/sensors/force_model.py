"""Force of a test at any displacement and constants, with its derivatives by both."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from study.arrays import Array
from study.calibration.function import EvaluationFailed
from study.curve import Curve
from study.errors import Fault, InputError
from study.forward import finite_element
from study.forward.closed_form import height_and_area
from study.material.homogeneous import response
from study.setup.section import with_table
from study.setup.setup import Problem, Tables, is_homogeneous, problem_of

if TYPE_CHECKING:  # it loads compiled kernels
    from study.fem.solver.solution import Solution

#: Half the distance of two places whose forces give the stiffness, over the depth: the curve is a
#: polynomial between its steps, of which this leaves 1e-8.
DIFFERENCE = 1e-4
#: Smallest load step over the largest: constants that need less are next to having no answer, and a
#: fit that asks there should hear so soon.
CUTBACKS = 0.12


@dataclass(frozen=True)
class ForceAt:
    """Force at some displacements.

    Parameters
    ----------
    force_N : ndarray, shape (n,)
        On the whole specimen.
    stiffness_N_per_mm : ndarray, shape (n,)
        dF/dd.
    jacobian : ndarray, shape (n, p)
        dF/dconstant, N per MPa (N for a plain exponent).
    """

    force_N: Array
    stiffness_N_per_mm: Array
    jacobian: Array


class ForceModel(Protocol):
    """Force of one test; zero before touch, that is at negative displacements.

    Parameters
    ----------
    problem : Problem
        With the assumed constants.
    notes : tuple of str
        What is known of its force once it has been asked for.
    """

    problem: Problem
    notes: tuple[str, ...]

    def __call__(self, values: Array, displacement_mm: Array) -> ForceAt:
        """Force for constants in MPa (exponents plain); raises where there is no answer."""
        ...


def force_model(tables: Tables, farthest_mm: float) -> ForceModel:
    """Model of a test: closed form where its deformation is homogeneous, else finite elements.

    Parameters
    ----------
    tables : mapping
        Resolved tables of the problem.
    farthest_mm : float
        Largest displacement that will be asked for.
    """
    problem = problem_of(with_table(tables, "test", displacement_mm=farthest_mm))
    if problem.material.relaxation:
        rule = "is not known to sensors: their rows have positions and forces, and no times"
        raise InputError(Fault("material.relaxation", rule, "leave it out"))
    if is_homogeneous(problem.test, problem.specimen.shape):
        return ClosedForm(problem)
    return Simulated(problem)


class ClosedForm:
    """Compression between frictionless plates."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.notes: tuple[str, ...] = ()

    def __call__(self, values: Array, displacement_mm: Array) -> ForceAt:
        """Force of the homogeneous deformation."""
        material = self.problem.material.with_constants(values)
        height, area = height_and_area(self.problem.specimen)
        sense = self.problem.setup.kind.sense
        touches = displacement_mm >= 0
        state = response(
            material, "uniaxial", 1 + sense * np.where(touches, displacement_mm, 0.0) / height
        )
        jacobian = np.stack([sense * area * state.gradient[n] for n in material.names], axis=1)
        if not np.isfinite(state.stress).all():
            raise EvaluationFailed("the material has no equilibrium state at these constants")
        return ForceAt(
            np.where(touches, sense * area * state.stress, 0.0),
            np.where(touches, area / height * state.slope, 0.0),
            np.where(touches[:, None], jacobian, 0.0),
        )


class Simulated:
    """Finite elements: every set of constants is solved from the solution of the assumed ones.

    The force is then a function of the constants, whatever was solved before: contact remembers
    where a solution came from, and a fit that is led there by another finds no lower point.

    Between the steps the first solution is interpolated with its slopes and work; what others
    add to it by a spline that is linear in the solved forces. Gradient and force then belong to
    one function of the constants.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.notes: tuple[str, ...] = ()
        self._names = problem.material.names
        self._first: Curve | None = None
        self._anchor: Solution | None = None
        self._known: dict[bytes, Curve] = {}

    def __call__(self, values: Array, displacement_mm: Array) -> ForceAt:
        """Force between the steps of the solution at these constants."""
        first = self._base()
        curve = self._solved(values)
        knots = curve.displacement_mm
        d = np.clip(displacement_mm, 0.0, knots[-1])
        touches = displacement_mm >= 0
        more = curve.force_N - first.force_at(knots)

        def force(at: Array) -> Array:
            return np.asarray(first.force_at(at) + _spline(knots, more, at))

        near = DIFFERENCE * float(knots[-1])
        below, above = np.maximum(d - near, 0.0), np.minimum(d + near, knots[-1])
        columns = [_spline(knots, curve.force_gradient[n], d) for n in self._names]
        return ForceAt(
            np.where(touches, force(d), 0.0),
            np.where(touches, (force(above) - force(below)) / (above - below), 0.0),
            np.where(touches[:, None], np.stack(columns, axis=1), 0.0),
        )

    def _base(self) -> Curve:
        if self._first is None:
            self._first = self._solved(self.problem.material.values)
        return self._first

    def _solved(self, values: Array) -> Curve:
        key = values.tobytes()
        if key not in self._known:
            self._known[key] = self._simulated(values)
        return self._known[key]

    def _simulated(self, values: Array) -> Curve:
        try:
            problem = replace(self.problem, material=self.problem.material.with_constants(values))
            # where the assumed material snaps, its neighbors do, and must be allowed to
            cutbacks = None if self._anchor is None or self.notes else CUTBACKS
            solution = finite_element.solve(problem, warm=self._anchor, cutbacks=cutbacks)
        except InputError as error:
            raise EvaluationFailed(str(error)) from error
        if not solution.converged:
            raise EvaluationFailed(f"{solution.status}: {solution.message}")
        if self._anchor is None:
            self._anchor, self.notes = solution, _notes(solution)
        return solution.curve


def _notes(solution: Solution) -> tuple[str, ...]:
    """Say where the force is no smooth function of the constants."""
    if not solution.energy.jumps_mm:
        return ()
    places = ", ".join(f"{place:.3g}" for place in sorted(solution.energy.jumps_mm))
    return (
        f"past {places} mm the surface snaps to another equilibrium: there the force is no smooth "
        "function of the constants; press less deep, or refine the mesh",
    )


def _spline(knots: Array, values: Array, at: Array) -> Array:
    """Cubic spline from the unloaded origin; linear in the values."""
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(np.r_[0.0, knots], np.r_[0.0, values])(at))
