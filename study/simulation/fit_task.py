"""Calibration of one material on one block, as a worker does it."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from study.external.answers import PredictedCurve
from study.ground.arrays import Array
from study.ground.canonical import digest
from study.ground.curve import Curve, spline_from_origin
from study.ground.errors import InputError
from study.mechanics.calibration.fit import Fit
from study.mechanics.calibration.fit_influence import with_serial_correlation
from study.mechanics.calibration.lack_of_fit import adequacy
from study.mechanics.calibration.residual_function import EvaluationFailed, MeasuredCurve
from study.mechanics.forward import closed_form, finite_element
from study.mechanics.material.material import ENERGIES, is_dimensionless
from study.mechanics.setup.material_section import MaterialSection
from study.record.record import FitDocument
from study.simulation.cell import CellProblem
from study.simulation.job import (
    FitJob,
    FitResult,
    InverseExternal,
    described,
    prediction_of,
    status_of,
)
from study.simulation.staged_fit import (
    FitPart,
    Predict,
    Staged,
    StagedSearch,
    least_minimum,
    named_open,
    scales_with_moduli,
    single_stage,
    staged_fit,
)

if TYPE_CHECKING:
    from study.mechanics.solver.solution import Solution


#: smallest load step over the largest: constants that need less are next to having no answer,
#: and an optimizer that asks there should hear so soon
_CUTBACKS = 0.12

#: share of the force that a curve which is moved along its gradients may be off: a tenth of the
#: tolerance of the solver
_NEAR = 1e-9
#: what the estimate of it is multiplied by, for constants that move in another direction
_SAFETY = 10.0


def perform(job: FitJob) -> dict[str, object]:
    """Fit the constants of one material, to resampled curves where it has a seed: for a worker."""
    return (fitted if job.noise is None else refitted)(job).to_json()


def fitted(job: FitJob) -> FitResult:
    """Fit the constants of one material to measured curves."""
    began = time.perf_counter()
    start = job.begun
    if start is not None and not start.converged:  # it cannot be fitted alone
        why = f"the fit that starts it did not converge: {start.message}"
        return FitResult(start.status, {"message": why})
    parts = parts_of(job)
    names, first = start_values(
        parts[0].problem, job.measured, None if start is None else start.constants
    )
    search = StagedSearch(names, fitted_model)

    def fit_from(values: Array) -> Staged:
        return staged_fit(parts, values, search)

    done, rivals = least_minimum([fit_from(first)], parts, first, search, fit_from)
    fitted_curves = [curve for part in parts for curve in part.measured]
    fit = named_open(with_serial_correlation(done.fit, fitted_curves), rivals)
    several = len(parts) > 1
    facts = described(fit, parts[0].problem, job.measured[:1] if several else job.measured)
    if fit.status.usable:
        # curves of one test are specimens or repeats: what they differ by is noise
        judged = adequacy(fit, fitted_curves, tests=() if several else [0] * len(fitted_curves))
        if judged.reasons:
            facts.update({"verdict": judged.verdict, "misfit": judged.sentence})
    method = job.problem.method
    facts.update({"message": done.message, "evaluations": done.evaluations, "method": method})
    predict, predicted = done.models[0], None
    if isinstance(predict, InverseFem) and method == "inverse-fem":
        predicted = predict.predicted(done.fit.values)
        facts.update({"newton_iterations": predict.newton_iterations, "solves": predict.solves})
        facts["first_solution"] = predict.first_solution
    if isinstance(predict, InverseExternal):
        predicted = predict.predicted(done.fit.values) if done.fit.status.usable else None
        facts["solves"] = predict.solves
    facts["seconds"] = time.perf_counter() - began
    return FitResult(status_of(done.fit), facts, predicted, 0.0 if start is None else start.seconds)


def parts_of(job: FitJob) -> list[FitPart]:
    """Parts of a fit, each with the measured curves that belong to it."""
    data = tuple(MeasuredCurve(f"curve {k}", c) for k, c in enumerate(job.measured, 1))
    tests = job.problem.tests
    groups = [data] if len(tests) == 1 else [(curve,) for curve in data]
    return [replace(test, measured=group) for test, group in zip(tests, groups, strict=True)]


def start_values(
    problem: CellProblem, measured: Sequence[Curve], neo_hookean: Mapping[str, float] | None
) -> tuple[tuple[str, ...], Array]:
    """Names of the constants and where the fit starts.

    Higher constants start at zero: those of the closed form soften so much that a bonded
    specimen cannot be solved with them.

    Shapes: neo_hookean MPa; returns (p,), MPa, s.
    """
    section = problem.material
    names, fading = section.calibrated_names, section.starts_of_relaxation()
    if section.constants:
        return names, np.array([float({**section.constants, **fading}[n]) for n in names])
    if neo_hookean is None:
        first = measured[0]
        neo_hookean = closed_form.neo_hookean_start(
            problem.setup, section.compressibility, first.displacement_mm, first.force_N
        )
    energy, shear_modulus = ENERGIES[section.model], 2 * float(neo_hookean["C10"])
    elastic = [name for name in names if name not in fading]
    values = {**neo_hookean, **energy.starting_values(elastic, shear_modulus), **fading}
    return names, np.array([values.get(n, 0.0) for n in names])


def fitted_model(
    method: str, problem: CellProblem, measured: Sequence[Curve], names: Sequence[str]
) -> Predict:
    """Model of one test, for the optimizer."""
    if method == "external":
        return InverseExternal(problem, measured, names)
    if method == "closed-form":
        return closed_form_model(problem, measured, names)
    return InverseFem(problem, measured, names)


def models_of(parts: Sequence[FitPart], names: Sequence[str]) -> list[Predict]:
    """Models of the parts of a fit."""
    return [fitted_model(part.method, part.problem, part.curves, names) for part in parts]


def closed_form_model(
    problem: CellProblem, measured: Sequence[Curve], names: Sequence[str]
) -> Predict:
    """Model of a homogeneous test, for the optimizer."""
    setup, section = problem.setup, problem.material

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


#: initial shear modulus, MPa, at which constants are solved that all stresses scale with: that of a
#: soft solid, whose tangents keep their pivots in single precision where those of 1 MPa do not
_SOLVED_MPa = 0.01

#: digits of the constants of a solution that searches share: those that a division leaves
_DIGITS = 12

#: solutions that a process holds, and unknowns of those from which others can be solved
_MOST_SOLUTIONS = 256
_MOST_UNKNOWNS = 50_000

#: solutions that searches began with, by the name of their problem
_first_solutions: dict[str, Solution] = {}


def _make_room() -> None:
    """Forget what takes most memory before the next solution comes: the load steps of the oldest.

    What they began with can be solved once more, to the same digit.
    """
    whole = [key for key, solution in _first_solutions.items() if solution.warm is not None]
    unknowns = sum(_first_solutions[key].dofs for key in whole)
    for key in whole:
        if unknowns <= _MOST_UNKNOWNS:
            break
        unknowns -= _first_solutions[key].dofs
        _first_solutions[key] = replace(_first_solutions[key], warm=None)
    while len(_first_solutions) >= _MOST_SOLUTIONS:
        del _first_solutions[next(iter(_first_solutions))]


class InverseFem:
    """Forward solutions with gradients; each starts from the one before it in the same fit.

    Where all stresses scale with the moduli, constants are solved at one shear modulus, and the
    curve is multiplied: specimens that differ in their stiffness alone share their solutions, and
    those of one constant are solved once. Equal solutions that searches begin with are found once
    in a process, whatever curves of whichever specimens are fitted.

    Constants so near those of the last solution that its gradients tell the forces within the
    tolerance of the solver are not solved again: what gradients missed on the way to that solution
    grows with the square of the way.

    Between the solved steps the first curve is interpolated with its tangent (Hermite), multiplied
    to the shear modulus asked for, and what later curves add to it by a spline that is linear in
    the solved forces. The gradient of the forces at the measured points is then the exact gradient
    of what is compared; otherwise the optimizer would chase the difference of two interpolations.
    """

    def __init__(
        self, problem: CellProblem, measured: Sequence[Curve], names: Sequence[str]
    ) -> None:
        self._problem, self._names = problem, names
        self._scales = scales_with_moduli(problem, names)
        self._moduli = np.array([not is_dimensionless(name) for name in names])
        self._grids = [curve.displacement_mm for curve in measured]
        self._depth = max(float(grid.max()) for grid in self._grids)
        self._base = Curve(np.zeros(0), np.zeros(0))
        self._last: Solution | None = None
        #: constants of the last solution (p,), and what gradients missed on the way to it over
        #: the square of the way: both as shares of the force
        self._solved_at = np.zeros(len(names))
        self._bend = math.inf
        #: simulations so far, and iterations of Newton's method in them
        self.solves = 0
        self.newton_iterations = 0
        #: name of the solution that the search began with, which other fits may share
        self.first_solution = ""
        #: solved curve at every set of constants
        self.curves: dict[bytes, Curve] = {}

    def __call__(self, values: Array) -> list[Curve]:
        """Predict the forces at the measured displacements for constants in MPa."""
        curve = self._solved(values)
        self.curves[values.tobytes()] = curve.without_gradients()
        return [self._at(values, curve, grid) for grid in self._grids]

    def _factor(self, values: Array) -> tuple[float, dict[str, float]]:
        """Shear modulus over that of the solutions, and its derivatives by the constants, 1/MPa."""
        if not self._scales:
            return 1.0, dict.fromkeys(self._names, 0.0)
        try:
            material = self._problem.material.material(self._constants(values))
        except InputError as error:
            raise EvaluationFailed(str(error)) from error
        if not material.mu0 > 0:
            rule = f"the initial shear modulus must be above 0, got {material.mu0:.6g} MPa"
            raise EvaluationFailed(rule)
        gradient = material.mu0_gradient()
        return material.mu0 / _SOLVED_MPa, {n: gradient[n] / _SOLVED_MPa for n in self._names}

    def _constants(self, values: Array) -> dict[str, float]:
        return dict(zip(self._names, values.tolist(), strict=True))

    def _solved(self, values: Array) -> Curve:
        """Curve at constants in MPa, with its gradients."""
        factor, _ = self._factor(values)
        solved = self._solved_at_one_modulus(np.where(self._moduli, values / factor, values))
        if not self._base.displacement_mm.size:
            self._base = solved
        gradient = {
            name: solved.force_gradient[name] * (1.0 if is_modulus else factor)
            for name, is_modulus in zip(self._names, self._moduli, strict=True)
        }
        return replace(solved.times(factor, without=["contact_area"]), force_gradient=gradient)

    def _solved_at_one_modulus(self, values: Array) -> Curve:
        if self._last is None:
            self._last, self._solved_at = self._first(values), values.copy()
        near, way = self._moved(self._last, values)
        missed = way * min(1.0, self._bend * way) if way else 0.0
        if _SAFETY * missed <= _NEAR:
            return near
        solution = self._simulated(values, self._last)
        if solution.status == "not-converged":
            # the way from the solution before was too long: that says nothing of the constants
            solution = self._simulated(values, None)
        self._bend, curve = math.inf, _converged(solution).curve
        if np.array_equal(near.displacement_mm, curve.displacement_mm):
            missed_N = np.linalg.norm(near.force_N - curve.force_N)
            self._bend = float(missed_N / np.linalg.norm(curve.force_N)) / way**2
        self._last, self._solved_at = solution, values.copy()
        return curve

    def _moved(self, solution: Solution, values: Array) -> tuple[Curve, float]:
        """Curve of a solution moved along its gradients to other constants, and how far that is.

        The way is the change of the force by each constant, as a share of the force.
        """
        curve, change = solution.curve, values - self._solved_at
        by_constant = np.array([curve.force_gradient[n] for n in self._names]) * change[:, None]
        way = float(np.linalg.norm(by_constant) / np.linalg.norm(curve.force_N))
        here, force = curve.displacement_mm, by_constant.sum(axis=0)
        tangent, work = curve.stiffness_N_per_mm, curve.work_Nmm
        from scipy.interpolate import CubicSpline

        spline = CubicSpline(np.r_[0.0, here], np.r_[0.0, force])
        moved = replace(
            curve,
            force_N=curve.force_N + force,
            stiffness_N_per_mm=None if tangent is None else tangent + spline.derivative()(here),
            work_Nmm=None if work is None else work + spline.antiderivative()(here),
        )
        return moved, way

    def _first(self, values: Array) -> Solution:
        """Solution that a search begins with: equal ones are found once, one after the other.

        All fits to resampled residuals of a curve begin at its constants, and all fits of a cell
        whose higher constants begin at zero begin at one ratio.
        """
        rounded = np.array([float(f"{value:.{_DIGITS}g}") for value in values])
        material = replace(self._problem.material, constants=self._constants(rounded))
        document = replace(self._problem.alone(), material=material).document()
        key = self.first_solution = digest([document, self._depth], 32)
        is_last = self._scales and len(self._names) == 1  # of one modulus all others are known
        solution = _first_solutions.get(key)
        if solution is None or (solution.warm is None and not is_last):
            _make_room()
            solution = self._simulated(rounded, None, gradients=not is_last)
            if is_last and solution.status == "converged":
                slope = {self._names[0]: solution.curve.force_N / rounded[0]}
                curve = replace(solution.curve, force_gradient=slope)
                solution = replace(solution, curve=curve, warm=None)
            _first_solutions[key] = solution
        else:
            self._count(solution)
        return _converged(solution)

    def _simulated(
        self, values: Array, warm: Solution | None, *, gradients: bool = True
    ) -> Solution:
        try:
            problem = self._problem.at(self._constants(values), self._depth)
            solution = finite_element.solve(
                problem, gradients=gradients, warm=warm, cutbacks=_CUTBACKS
            )
        except InputError as error:
            raise EvaluationFailed(str(error)) from error
        self._count(solution)
        return solution

    def _count(self, solution: Solution) -> None:
        self.solves += 1
        self.newton_iterations += int(sum(solution.newton_iterations))

    def _at(self, values: Array, curve: Curve, grid: Array) -> Curve:
        """Interpolate force and gradient at measured points, each consistent with the other."""
        (factor, rates), here = self._factor(values), curve.displacement_mm
        base_here, base = self._base.force_at(here), self._base.force_at(grid)
        added = spline_from_origin(here, curve.force_N - factor * base_here, grid)
        gradient = {
            n: rates[n] * base
            + spline_from_origin(here, curve.force_gradient[n] - rates[n] * base_here, grid)
            for n in self._names
        }
        return Curve(grid, factor * base + added, force_gradient=gradient)

    @property
    def mesh_size_mm(self) -> float | None:
        """Element size of the last solution; None where there is none."""
        return None if self._last is None else float(self._last.mesh_size_mm)

    def predicted(self, values: Array) -> PredictedCurve | None:
        """Curve at the final constants, with mesh and solver of the last solution."""
        if self._last is None:
            return None
        return replace(prediction_of(self._last), curve=self.curves[np.asarray(values).tobytes()])


def _converged(solution: Solution) -> Solution:
    """Solution that has an answer."""
    if solution.status != "converged":
        raise EvaluationFailed(f"{solution.status}: {solution.message}")
    return solution


# -------------------------------------------------------------------------------------------------
# What the noise of a measured curve does to its constants: fits to resampled residuals.
#
# The residuals of a fit are laid around its curve again, in blocks where neighbors are
# correlated, and the constants are fitted to that curve, starting from the fit (Efron and
# Tibshirani 1993, chapter 9; blocks on a circle: Politis and Romano 1992). Draws depend on the
# study's seed and the measured curve alone: cells that are fitted to one curve, with blocks of
# one length, see its noise at the same places, so that effects are compared under one noise.

#: points below which residuals say nothing of their correlation
_FEWEST = 8

#: correlation of neighbors beyond this many standard errors is believed
_BELIEVED = 2.0


@dataclass(frozen=True)
class Residuals:
    """What a fit left of a measured curve, ready to be drawn from."""

    #: shape (n,); force of the fit, and its residuals, centered and scaled for the constants
    #: fitted.
    predicted_N: Array  # noqa: N815
    noise_N: Array  # noqa: N815
    lag1: float
    block: int


def residuals_of(measured: Curve, predicted_N: Array, share: float) -> Residuals:  # noqa: N803
    """Residuals of a fit with their block length; predicted_N (n,)."""
    left = measured.force_N - predicted_N
    left = left - left.mean()
    power = float(left @ left)
    lag1 = float(left[1:] @ left[:-1]) / power if power > 0 else 0.0
    return Residuals(predicted_N, math.sqrt(share) * left, lag1, block_length(lag1, left.size))


def block_length(lag1: float, n: int) -> int:
    """Length of the blocks that serves the variance of a mean best; 1 without correlation.

    Politis and White (2004, Econometric Reviews 23, 53), eq. 6 for circular blocks, with the
    autocovariances of a first-order autoregression, and their upper bound.

    Examples
    --------
    >>> block_length(0.0, 200), block_length(0.5, 200), block_length(0.9, 200)
    (1, 8, 30)
    """
    if n < _FEWEST or lag1 <= _BELIEVED / math.sqrt(n):
        return 1
    rho = min(lag1, 0.999)
    best = math.cbrt(6 * rho**2 / (1 - rho**2) ** 2 * n)
    return max(1, min(round(best), math.ceil(min(3 * math.sqrt(n), n / 3))))


def resampled(residuals: Residuals, random: np.random.Generator) -> Array:
    """Force of the fit with its residuals drawn anew, N, shape (n,)."""
    n, block = residuals.noise_N.size, residuals.block
    starts = random.integers(0, n, math.ceil(n / block))
    drawn = ((starts[:, None] + np.arange(block)) % n).ravel()[:n]
    return np.asarray(residuals.predicted_N + residuals.noise_N[drawn])


def refitted(job: FitJob) -> FitResult:
    """Fit the constants again to resampled curves."""
    began = time.perf_counter()
    if job.begun is None or job.noise is None:
        raise ValueError("a refit needs a fit, a seed and a number")
    base, measured = job.begun, job.measured
    if not base.converged:
        why = f"the fit to the measured curve did not converge: {base.message}"
        return FitResult(base.status, {"message": why})
    names = tuple(base.fit["names"])
    start = np.array([base.constants[name] for name in names])
    models = models_of(parts_of(job), names)
    predicted = [curve for model in models for curve in model(start)]
    points = sum(len(curve) for curve in measured)
    share = points / max(1, points - len(names))
    residuals = [
        residuals_of(curve, model_curve.force_at(curve.displacement_mm), share)
        for curve, model_curve in zip(measured, predicted, strict=True)
    ]
    drawn = (_drawn(*each, *job.noise) for each in zip(measured, residuals, strict=True))
    again = parts_of(replace(job, measured=tuple(drawn)))
    queue = iter(models)
    done = single_stage("resampled", again, start, StagedSearch(names, lambda *_: next(queue)))
    document = _described(done.fit, again[0].problem.material, residuals)
    document.update({"method": job.problem.method, "seconds": time.perf_counter() - began})
    return FitResult(status_of(done.fit), document)


def _described(fit: Fit, section: MaterialSection, residuals: Sequence[Residuals]) -> FitDocument:
    """Describe a refit; unstable constants stay, for they are part of the scatter."""
    constants = fit.constants()
    return {
        "message": fit.message,
        "names": list(fit.names),
        "values": constants,
        "mu0": float(section.material(constants).mu0),
        "identifiable": fit.converged,
        "reason": "" if fit.converged else fit.status.sentence,
        "evaluations": int(fit.evaluations),
        "resampling": [{"block": residual.block, "lag1": residual.lag1} for residual in residuals],
    }


def _drawn(measured: Curve, residuals: Residuals, seed: int, number: int) -> Curve:
    """One resample of one measured curve: numbers are the same for every cell fitted to it."""
    d = measured.displacement_mm
    name = digest([d.tolist(), measured.force_N.tolist()], 16)
    random = np.random.default_rng([seed, int(name, 16), number])
    return Curve(d, resampled(residuals, random), recorded=measured.recorded)
