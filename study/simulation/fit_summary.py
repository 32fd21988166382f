"""What became of a fit: constants with all that is known of them, or why there are none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, cast

import numpy as np

from study.external.answers import NoAnswer, PredictedCurve
from study.external.command import External, steps_of
from study.external.forward_model import ForwardCell
from study.ground.arrays import Array
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError
from study.mechanics.calibration.fit import Fit
from study.mechanics.calibration.levenberg_marquardt import Status
from study.mechanics.calibration.residual_function import EvaluationFailed
from study.mechanics.material.homogeneous import MODES, sheared_stretches
from study.mechanics.material.material import Material
from study.mechanics.material.stability import StabilityResult, ellipticity_end, stability
from study.mechanics.setup.setup import Setup
from study.record.document import WITH_CONSTANTS, FitDocument, MeshDocument, SolverDocument
from study.simulation.cell import CellProblem
from study.simulation.fit_problem import solved_by

if TYPE_CHECKING:
    from study.mechanics.solver.solution import Solution

FitStatus = Literal["converged", "at-edge", "at-kink", "not-converged"]


def status_of(fit: Fit) -> FitStatus:
    """How a fit ended, in the words of every verb."""
    if fit.status is Status.at_edge:
        return "at-edge"
    if fit.status is Status.at_kink:
        return "at-kink"
    return "converged" if fit.converged else "not-converged"


@dataclass(frozen=True)
class FitResult:
    """Outcome of a fit, as the store keeps it and cases read it."""

    #: ``"converged"``, ``"at-edge"``, ``"at-kink"``, or the reason why there are no constants.
    status: str
    #: What is known of it; of a fit without constants its message alone.
    fit: FitDocument
    #: Last solution of an inverse fit of one test: the curve of the final constants.
    prediction: PredictedCurve | None = None
    #: What the fit took that gave the start.
    start_seconds: float = 0.0

    @classmethod
    def without_answer(cls, status: str, message: str) -> FitResult:
        """Outcome of a fit that could not be begun."""
        return cls(status, {"message": message})

    @property
    def converged(self) -> bool:
        """Whether it found constants, if without standard errors."""
        return self.status in WITH_CONSTANTS

    @property
    def usable(self) -> bool:
        """Whether its constants are stable over the range of the test."""
        return self.converged and self.fit.get("usable", True)

    @property
    def message(self) -> str:
        """How it ended."""
        return self.fit.get("message", "")

    @property
    def constants(self) -> dict[str, float]:
        """Constants in MPa, exponents plain; none where it did not converge."""
        return self.fit.get("values", {})

    @property
    def seconds(self) -> float:
        """What it took, the fit before it left out."""
        return self.fit.get("seconds", 0.0)

    def to_json(self) -> dict[str, object]:
        """Plain data with all keys side by side."""
        predicted = {} if self.prediction is None else self.prediction.to_json()
        plain = {"status": self.status, "start_seconds": self.start_seconds}
        return {**plain, **self.fit, **predicted}

    @classmethod
    def from_json(cls, document: Mapping[str, object]) -> FitResult:
        """Inverse of :meth:`to_json`; a task that had no answer has a status and a message."""
        fields_read = {k: v for k, v in document.items() if k in FitDocument.__annotations__}
        return cls(
            str(document["status"]),
            cast(FitDocument, fields_read),
            PredictedCurve.from_json(document) if "curve" in document else None,
            cast(float, document.get("start_seconds", 0.0)),
        )


def described(fit: Fit, problem: CellProblem, measured: Sequence[Curve]) -> FitDocument:
    """Describe a fit."""
    names = fit.names
    document: FitDocument = {
        "message": fit.message,
        "names": list(names),  # JSON sorts keys; the matrices need their order
        "values": fit.constants(),
        "standard_error": {n: _finite(v) for n, v in zip(names, fit.standard_error, strict=True)},
        "ci95": {n: _row(pair) for n, pair in zip(names, fit.ci95, strict=True)},
        "correlation": [_row(row) for row in fit.correlation],
        "condition": _finite(fit.condition),
        "rss": _finite(fit.rss),
        "r_squared": _finite(fit.r_squared),
        "aicc": _finite(fit.aicc),
        "n": int(fit.n),
        "identifiable": bool(fit.identifiable) and fit.converged,
        "reason": str(fit.reason),
        "evaluations": int(fit.evaluations),
    }
    if fit.status.usable:
        document.update(_stability(problem, fit.constants(), measured))
    return document


def _stability(
    problem: CellProblem, constants: Mapping[str, float], measured: Sequence[Curve]
) -> FitDocument:
    """Mu0 and whether the material is stable over the range that was measured."""
    material = problem.material.material(constants)
    if material.mu0 <= 0:
        raise InputError(Fault("fit", f"ended at a shear modulus of {material.mu0:g} MPa"))
    judged = stability_over(
        material, [(problem.setup, curve.displacement_mm) for curve in measured]
    )
    # only uniaxial failure inside the range makes the answer itself meaningless; the other
    # modes are a warning about using the constants elsewhere
    return {
        "mu0": float(material.mu0),
        "stable": bool(judged.stable),
        "stability": str(judged.sentence),
        "usable": "uniaxial" not in judged.limits,
    }


def judged_where_simulated(fit: FitDocument, problem: CellProblem, depth_mm: float) -> FitDocument:
    """Fit with what makes it unstable or not elliptic in the simulated test, beyond its data."""
    if not fit.get("stable", False):
        return fit
    material = problem.material.material(fit["values"])
    judged = stability_over(material, [(problem.setup, np.array([depth_mm]))])
    if judged.stable:
        return fit
    beyond = f"over its data: {fit['stability']}; in the simulated test: {judged.sentence}"
    return {**fit, "stable": False, "stability": beyond}


def stability_over(material: Material, tests: Sequence[tuple[Setup, Array]]) -> StabilityResult:
    """Drucker's criterion over the stretches of tests, each in its loading, and in the others.

    A loading that no test holds is judged over the stretches of all of them. Ellipticity is judged
    in the loadings that they hold.
    """
    held: dict[str, tuple[float, float]] = {}
    for setup, places in tests:
        height, kind = setup.height_mm, setup.kind
        mode = "planar" if kind.shears else kind.mode
        if height is None or mode not in MODES or kind.takes_indenter:
            continue
        share = kind.sense * np.array([0.0, places.min(), places.max()]) / height
        ends = sheared_stretches(share, setup.test.prestretch or 1.0) if kind.shears else 1 + share
        low, high = float(np.min(ends)), float(np.max(ends))
        if low <= 0:
            continue
        before = held.get(mode, (1.0, 1.0))
        held[mode] = (min(low, before[0]), max(high, before[1]))
    if not held:
        return stability(material)
    judged = stability(material, np.array(list(held.values())), held)
    lost = [
        f"in {name} loading at stretch {end:.4g}"
        for name, ends in held.items()
        if (end := ellipticity_end(material, MODES[name], *ends)) is not None
    ]
    if not lost:
        return judged
    sentence = f"{judged.sentence}; not elliptic {', '.join(lost)}"
    return replace(judged, stable=False, sentence=sentence)


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _row(values: Array) -> list[float | None]:
    return [_finite(value) for value in values]


# Constants found through a program or a function, with gradients it has or differences.

#: evaluations of a fit beside those of its gradients: measured on neo-Hookean to third order
#: (4 to 12); the plan says the cost of this many
USUAL_EVALUATIONS = 8


class InverseExternal:
    """Curves of an external forward model at the measured displacements, for the optimizer."""

    def __init__(
        self, problem: CellProblem, measured: Sequence[Curve], names: Sequence[str]
    ) -> None:
        self._external, self._problem, self._names = external_of(problem), problem, names
        self._grids = [curve.displacement_mm for curve in measured]
        self._points = np.unique(np.concatenate(self._grids))
        self._last: tuple[bytes, PredictedCurve] | None = None
        self._curves: list[Curve] = []
        #: solutions so far
        self.solves = 0

    def __call__(self, values: Array) -> list[Curve]:
        """Predict the forces at the measured displacements; the last constants not once more."""
        key = values.tobytes()
        if self._last is not None and self._last[0] == key:
            return self._curves
        solved = self._solved(values)
        curve = solved.curve
        gradient = {
            name: curve.force_gradient[name]
            if name in curve.force_gradient
            else self._difference(values, i, curve.force_N)
            for i, name in enumerate(self._names)
        }
        self._curves = [self._at(curve, gradient, grid) for grid in self._grids]
        self._last = key, solved
        return self._curves

    def _solved(self, values: Array) -> PredictedCurve:
        constants = dict(zip(self._names, values.tolist(), strict=True))
        self.solves += 1
        try:
            problem = self._problem.at(constants, float(self._points[-1]))
            return solved_by(self._external, problem, self._points, self._problem.own_tables())
        except (InputError, NoAnswer) as error:
            raise EvaluationFailed(str(error)) from error

    def _difference(self, values: Array, i: int, force: Array) -> Array:
        """Forward difference; a step back where the program has no answer ahead."""
        step = float(steps_of(values)[i])
        for signed in (step, -step):
            moved = values.copy()
            moved[i] += signed
            try:
                ahead = self._solved(moved).curve.force_N
            except EvaluationFailed:
                continue
            return np.asarray((ahead - force) / (moved[i] - values[i]))
        raise EvaluationFailed(f"the program has no answer beside these constants ({i + 1})")

    def _at(self, curve: Curve, gradient: Mapping[str, Array], grid: Array) -> Curve:
        here = np.searchsorted(self._points, grid)
        return Curve(grid, curve.force_N[here],
                     force_gradient={k: v[here] for k, v in gradient.items()})  # fmt: skip

    def predicted(self, values: Array) -> PredictedCurve:
        """Curve at the final constants; solved again where the last one was another."""
        key = np.asarray(values).tobytes()
        solved = self._last[1] if self._last and self._last[0] == key else self._solved(values)
        return replace(solved, curve=solved.curve.without_gradients())


def prediction_of(solution: Solution, seconds: float = 0.0) -> PredictedCurve:
    """Prediction of a solution, without the gradients that nobody reads from the store."""
    touching = solution.equilibria.contact
    mesh: MeshDocument = {
        "dofs": int(solution.dofs),
        "elements": int(solution.elements),
        "hash": str(solution.mesh_hash),
        "mesh_size_mm": float(solution.mesh_size_mm),
    }
    solver: SolverDocument = {
        "name": str(solution.solver),
        "min_j": float(solution.min_j),
        "energy_mismatch": float(solution.energy.largest_mismatch),
        "stabilization_share": float(solution.energy.stabilization_share),
        "snaps_mm": [float(jump_mm) for jump_mm in solution.energy.jumps_mm],
        "penetration_mm": max((contact.penetration_mm for contact in touching), default=0.0),
        "gap_mm": max((contact.gap_mm for contact in touching), default=0.0),
    }
    return PredictedCurve(solution.curve.without_gradients(), mesh, solver, seconds)


def external_of(problem: ForwardCell) -> External:
    """Forward model of a problem that is not ours, which it must name."""
    external = External.of(problem)
    if external is None:
        raise ValueError("this problem names no external forward model")
    return external


def external_curve(
    cell: CellProblem, constants: Mapping[str, float] | None, displacement_mm: Array
) -> PredictedCurve:
    """Curve of a case by its external forward model; constants MPa; displacement_mm (n,)."""
    problem = cell.at(constants, float(displacement_mm[-1]))
    prediction = solved_by(external_of(cell), problem, displacement_mm, cell.own_tables())
    mesh, curve = prediction.mesh, prediction.curve.without_gradients()
    if mesh and problem.model.mesh_size_mm is not None:
        mesh = {**mesh, "mesh_size_mm": problem.model.mesh_size_mm}
    return replace(prediction, curve=curve.with_tangents(), mesh=mesh)
