"""One case: constants, prediction, score -> Record. Expected failure is a status, never raised."""

from __future__ import annotations

import base64
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study.external.answers import NoAnswer, PredictedCurve
from study.external.command import External
from study.ground.arrays import Array, Flags
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError, RefusedError, nearest
from study.mechanics.forward import closed_form
from study.mechanics.forward.finite_element import Anchors, load_compiled, solve
from study.mechanics.measurement.marker_states import MarkerStates, read_markers
from study.mechanics.measurement.measurement_section import MarkerSpec
from study.mechanics.setup.geometry import Block
from study.mechanics.setup.setup import Problem
from study.record.record import (
    STATUSES,
    CurveKey,
    FitDocument,
    MarkerDocument,
    ParameterDocument,
    PlateFitDocument,
    Record,
    ResponseDocument,
    SolverDocument,
)
from study.simulation import response
from study.simulation.cell import CellProblem
from study.simulation.job import (
    CONSTANTS,
    CaseJob,
    ScorePair,
    external_curve,
    external_of,
    judged_where_simulated,
    prediction_of,
)
from study.simulation.response import simulated_at

if TYPE_CHECKING:
    from study.mechanics.solver.finite_element_solution import MovedPlate
    from study.mechanics.solver.solution import Solution

# The motion of a plate that markers inside a specimen tell, and what they are off.

#: names of the components of a motion, and their units
COMPONENTS = {
    "down": "mm",
    "x": "mm",
    "y": "mm",
    "tilt_x": "deg",
    "tilt_y": "deg",
    "twist": "deg",
    "spread": "%",
}

#: in units of the components: mm, rad and plain numbers become what is printed
_SHOWN = np.array([1.0, 1.0, 1.0, np.degrees(1), np.degrees(1), np.degrees(1), 100.0])

#: how many components a plate has, by what it is taken to do
_FREE = {"nominal": 0, "rigid": 6, "slipping": 7}

#: change of the motion, over the size of the specimen, at which it has settled
_SETTLED = 1e-6
_MOST_STEPS = 15


def rms(errors: Array) -> float:
    """Root mean square length of vectors; errors (n, 3), mm."""
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def plate_fits(
    spec: MarkerSpec, markers: MarkerStates, label: str, problem: Problem, solution: Solution
) -> list[PlateFitDocument]:
    """Compare a simulated block with markers, by what its plate is taken to do."""
    fitter = _Fitter(markers, label, problem, solution)
    every = np.ones(len(markers.rest), dtype=bool)
    fits = [fitter.fitted(plate, "all", every, every) for plate in _FREE]
    if spec.fit:
        chosen = markers.within(spec.fit)
        fits.append(fitter.fitted(spec.plate, f"layers {', '.join(spec.fit)}", chosen, ~chosen))
    return fits


class _Fitter:
    """Fits to one state; each begins where the last one ended."""

    def __init__(
        self, markers: MarkerStates, label: str, problem: Problem, solution: Solution
    ) -> None:
        from study.mechanics.element.function_space import interpolation
        from study.mechanics.solver.finite_element_solution import PrescribedMotion

        self.motion = plate = PrescribedMotion(problem, solution)
        self.interpolated = interpolation(plate.system.mesh, problem.model, markers.rest)
        self.measured, self.layers = markers.moved[label], markers.layers
        self.size_mm, self.at = plate.system.mesh.height_mm, plate.start

    def fitted(self, plate: str, name: str, chosen: Flags, scored: Flags) -> PlateFitDocument:
        """Fit the motion to some markers and judge it on others."""
        free = _FREE[plate]
        if not free:
            return self._document(plate, "none", self.motion.start, np.zeros(7), scored)
        length = np.array([1.0, 1.0, 1.0, *[self.size_mm / 2] * 4])[:free]
        for _ in range(_MOST_STEPS):
            slope = self._slope(self.at, free, chosen)
            left = self._errors(self.at)[chosen].ravel()
            step, _, rank, _ = np.linalg.lstsq(slope * (1 / length), left, rcond=1e-10)
            if rank < slope.shape[1]:
                rule = (
                    "the markers that are fitted do not tell every component of the plate's motion"
                )
                raise InputError(Fault("markers.fit", rule, "fit more layers, or another plate"))
            change = step / length
            moved = self.at.motion.copy()
            moved[:free] += change
            if free < 7:
                moved[6] = self.motion.start.motion[6]
            self.at = self.motion.at(moved, self.at)
            if np.abs(change * length).max() < _SETTLED * self.size_mm:
                break
        else:
            rule = f"the motion of the {plate} plate has not settled in {_MOST_STEPS} steps"
            mend = "see whether the markers belong to this test and to this displacement"
            raise RefusedError(str(Fault("markers", rule, mend)))
        spread, errors = np.zeros(7), self._errors(self.at)[chosen]
        spread[:free] = _standard_errors(self._slope(self.at, free, chosen), errors)
        return self._document(plate, name, self.at, spread, scored)

    def _document(
        self, plate: str, fitted: str, at: MovedPlate, spread: Array, scored: Flags
    ) -> PlateFitDocument:
        """Errors of the markers that are judged under one motion, for a record and a report."""
        # spread, shape (7,): standard errors, which treat the coordinates of one marker together
        errors = self._errors(at)[scored]
        shown = zip(COMPONENTS, at.motion * _SHOWN, spread * _SHOWN, strict=True)
        layer_of = np.array(self.layers or [""] * len(scored))[scored]
        names = dict.fromkeys(layer_of.tolist()) if self.layers else {}
        return {
            "plate": plate,
            "fitted": fitted,
            "markers": len(errors),
            "error_mm": rms(errors),
            "error_by_axis_mm": [float(v) for v in np.sqrt((errors**2).mean(axis=0))],
            "error_by_layer_mm": {str(k): rms(errors[layer_of == k]) for k in names},
            "motion": {name: [float(value), float(error)] for name, value, error in shown},
        }

    def _errors(self, at: MovedPlate) -> Array:
        return np.asarray(self.measured - self.interpolated(at.displacement))

    def _slope(self, at: MovedPlate, free: int, chosen: Flags) -> Array:
        """Differentiate the displacements of markers, shape (3 n, free)."""
        each = [self.interpolated(at.rates[:, :, k]) for k in range(free)]
        return np.stack(each, axis=-1)[chosen].reshape(-1, free)


def _standard_errors(slope: Array, errors: Array) -> Array:
    """Errors of a fit, robust to unequal coordinates of a marker (Liang and Zeger 1986, eq. 11)."""
    inverse = np.linalg.inv(slope.T @ slope)
    scores = np.einsum("nik,ni->nk", slope.reshape(len(errors), 3, -1), errors)
    share = len(errors) / max(len(errors) - slope.shape[1] / 3, 1.0)
    return np.asarray(np.sqrt(np.diag(inverse @ (share * scores.T @ scores) @ inverse)))


# A specimen with markers inside: its prediction, and what the markers say of it.


def predicted_markers(
    cell: CellProblem, constants: Mapping[str, float] | None, label: str, depth_mm: float
) -> PredictedCurve:
    """Predict a state of a marked specimen and compare all markers; constants MPa."""
    from study.mechanics.solver.finite_element_solution import NoEquilibrium

    began, problem = time.perf_counter(), cell.loaded(displacement_mm=depth_mm).at(constants)
    spec, file = cell.markers, cell.marker_file
    if spec is None or file is None:
        raise ValueError("this problem has no markers whose file was found")
    if not isinstance(problem.specimen, Block):
        raise InputError(Fault("specimen.shape", "markers lie in a block", 'write "block"'))
    markers = read_markers(spec, Path(file.path), problem.specimen)
    load_compiled(problem)
    solution = solve(problem, gradients=False)
    if solution.status != "converged":
        raise NoAnswer(solution.status, solution.message)
    try:
        fits = plate_fits(spec, markers, label, problem, solution)
    except NoEquilibrium as error:
        raise NoAnswer("not-converged", str(error)) from error
    document: MarkerDocument = {
        "state": label,
        "floor_mm": markers.localization_floor(label),
        "fits": fits,
    }
    predicted = prediction_of(solution, time.perf_counter() - began)
    return replace(predicted, markers=document)


def marker_responses(cell: CellProblem, document: MarkerDocument) -> dict[str, ResponseDocument]:
    """Errors of the markers, with the plate that the study asks for, mm."""
    plate = None if cell.markers is None else cell.markers.plate
    # of all markers first; then, where layers are named, of those outside them
    errors = [fit["error_mm"] for fit in document["fits"] if fit["plate"] == plate]
    return {
        "marker_error": {"value": errors[0], "unit": "mm"},
        "predicted_marker_error": {"value": errors[1] if len(errors) > 1 else None, "unit": "mm"},
    }


# One cache per worker process. A worker runs its cases one at a time, so no lock is needed.
_ANCHORS = Anchors()


def perform(job: CaseJob) -> dict[str, object]:
    """Execute one case: a task for a worker; what has no answer is a status of its record."""
    began, folder = time.perf_counter(), b""
    try:
        for direction in job.directions:
            fit = job.outcome(direction)
            if fit is not None and not fit.converged:
                where = f"calibration on {direction.fit_label or 'the measured curve'}"
                raise NoAnswer(fit.status, f"{where}: {fit.message}")
            if fit is not None and not fit.usable:
                stability = fit.fit.get("stability")
                raise NoAnswer("unstable", f"the fitted constants are unstable: {stability}")
        if not isinstance(job.case.problem, CellProblem):
            record, folder = _of_parameters(job)
        elif job.origin.predicts:
            record, folder = _predicted(job)
        else:  # a fit to resampled noise: its constants, and no prediction
            record = _fitted(job, {}, _seconds(job, []), {})
    except NoAnswer as error:
        status = error.status if error.status in STATUSES else "failed"
        record = job.record(status, str(error), seconds={"total": time.perf_counter() - began})
        if error.program is not None:
            record, folder = replace(record, solver={"program": error.program}), error.folder
    except InputError as error:
        record = job.record("failed", str(error))
    extra = {"folder": base64.b64encode(folder).decode("ascii")} if folder else {}
    return {
        "status": record.status, "message": record.message, "record": record.to_json(), **extra
    }  # fmt: skip


#: characters of a rendered file that a record keeps
_RENDERED = 64_000


def _of_parameters(job: CaseJob) -> tuple[Record, bytes]:
    """Record of a case of parameters alone, and the zip of its folder where that is kept."""
    problem = job.case.problem
    named = {"case_id": job.case.case_id, **problem.own_tables()}
    answer = external_of(problem).answer(named, job.units)
    values, curve = {**answer.values, "seconds": answer.seconds}, answer.curve
    responses: dict[str, ResponseDocument] = {}
    for name, unit in job.units.items():
        value = values.get(name)
        if value is None and len(curve) and response.of_prediction([name]):
            displacement_mm, end = simulated_at(name)[1], float(curve.displacement_mm[-1])
            if displacement_mm is not None and displacement_mm > end * (1 + 1e-9):
                raise NoAnswer("not-converged", f"the curve ends at {end:g} mm, {name} is beyond")
            value = response.simulated(name, curve)
        if value is None:
            mend = nearest(name, answer.values) if answer.values else "it gives a curve alone"
            raise NoAnswer("failed", f"there is no {name} among the answers ({mend})")
        responses[name] = {"value": float(value), "unit": unit}
    seconds = {"predict": answer.seconds, "total": answer.seconds}
    record = job.record("converged", "", responses, _rendered(answer.rendered), seconds)
    curves = {CurveKey("predicted", "all"): curve} if len(curve) else {}
    return replace(record, curves=curves, solver=answer.solver), answer.folder


def _rendered(files: Mapping[str, str]) -> dict[str, object]:
    return {"rendered": {k: text[:_RENDERED] for k, text in files.items()}} if files else {}


def _fitted(
    job: CaseJob,
    predicted: Mapping[str, ResponseDocument],
    seconds: Mapping[str, float],
    extra: Mapping[str, object],
) -> Record:
    constants = response.averaged([_constants(job, pair) for pair in job.identified])
    record = job.record("converged", "", {**constants, **predicted}, extra, seconds)
    return replace(record, parameters=_parameters(job, constants), fit=_fits(job))


def _predicted(job: CaseJob) -> tuple[Record, bytes]:
    """Record of a case whose curves are predicted and scored, and the zip of its folder."""
    pairs = [(direction, _predict(job, direction)) for direction in job.scored]
    predictions = [prediction for _, prediction in pairs]
    last = predictions[-1]
    scores = [
        response.score(prediction.curve, direction.measured, job.units)
        for direction, prediction in pairs
    ]
    seconds = _seconds(job, predictions)
    means = response.averaged(scores)
    means["seconds"] = {"value": seconds["total"], "unit": "s"}
    marked = [prediction.markers for prediction in predictions if prediction.markers is not None]
    for document in marked:
        means |= marker_responses(job.case.tested, document)
    means["dofs"] = {"value": last.mesh.get("dofs"), "unit": ""}
    for name in predictions[0].values:
        every = [prediction.values[name] for prediction in predictions if name in prediction.values]
        means[name] = {"value": float(np.mean(every)), "unit": job.units.get(name, "")}
    for name, u in _step_uncertainty(job, pairs).items():
        means[name] = {**means[name], "u_steps": u}
    curves: dict[CurveKey, Curve] = {}
    for direction, prediction in pairs:
        if direction.measured is not None:
            curves[CurveKey("measured", direction.label)] = direction.measured
        curves[CurveKey("predicted", direction.label)] = prediction.curve
    directions = [
        {
            "score": direction.label,
            "fit": direction.fit_label,
            "role": direction.role,
            "scatter_N": None if direction.scatter_N is None else list(direction.scatter_N),
            "responses": responses | _constants(job, direction),
        }
        for (direction, _), responses in zip(pairs, scores, strict=True)
    ]
    extra = {"directions": directions, **({"markers": marked} if marked else {})}
    record = _fitted(job, means, seconds, {**extra, **_rendered(last.rendered)})
    return replace(record, curves=curves, mesh=last.mesh, solver=_solver(predictions)), last.folder


def _constants(job: CaseJob, pair: ScorePair) -> dict[str, ResponseDocument]:
    """Constants of a direction, fitted or given, in the units in which they are shown."""
    fit = job.outcome(pair)
    if fit is not None:
        return response.constants_of(fit.constants, fit.fit.get("mu0"))
    material = job.case.tested.material.material()
    return response.constants_of(material.constants, material.mu0)


def _predict(job: CaseJob, direction: ScorePair) -> PredictedCurve:
    fit = job.outcome(direction)
    if job.forward == "fit" and fit is not None and fit.prediction is not None:
        # the last solution of the fit is the prediction: same geometry, same constants
        return fit.prediction
    constants = None if fit is None else fit.constants
    if job.case.tested.markers is not None:
        block = str(job.case.block)
        return predicted_markers(job.case.tested, constants, block, direction.depth_mm)
    if job.forward == "closed-form":
        return _closed_form(job, constants, direction)
    if job.forward == "external" or External.of(job.case.tested) is not None:
        measured, steps = direction.measured, job.case.tested.test.steps
        even = direction.depth_mm * np.arange(1, steps + 1) / steps
        at = even if measured is None else measured.displacement_mm
        return external_curve(job.case.tested, constants, at)
    problem_at = partial(job.case.tested.at, depth_mm=direction.depth_mm)
    anchored = _ANCHORS.predict(problem_at, constants, job.shared)
    solution = anchored.solution
    if solution.status != "converged":
        raise NoAnswer(solution.status, f"{solution.message} (reached {solution.reached_mm:g} mm)")
    return prediction_of(solution, anchored.cold_seconds)


#: fewest steps of a curve in closed form beside which nothing was measured: interpolation between
#: them is off by less than a millionth
_STEPS = 50


def _closed_form(
    job: CaseJob, constants: Mapping[str, float] | None, direction: ScorePair
) -> PredictedCurve:
    """Curve at the measured displacements, or at the load steps."""
    problem, measured = job.case.tested.at(constants, direction.depth_mm), direction.measured
    if measured is None:
        test = replace(problem.test, steps=max(problem.test.steps, _STEPS))
        solution = closed_form.solution(replace(problem, test=test))
        if solution.status != "converged":
            raise NoAnswer(solution.status, solution.message)
        return PredictedCurve(solution.curve.without_gradients(), solver={"name": solution.solver})
    setup, material = problem.setup, problem.material
    if measured.time_s is None and response.of_prediction(job.units):
        curve = closed_form.between_rows(setup, material, measured.displacement_mm)
    else:
        curve = closed_form.at_rows(setup, material, measured)
    if not np.all(np.isfinite(curve.force_N)):
        raise NoAnswer("unstable", "the material has no equilibrium state in this range")
    return PredictedCurve(curve.without_gradients(), solver={"name": "closed form"})


def _step_uncertainty(
    job: CaseJob, pairs: Sequence[tuple[ScorePair, PredictedCurve]]
) -> dict[str, float]:
    """Return what half the load steps change in every response, as a mean over directions."""
    is_splined = External.of(job.case.problem) is not None
    each = [
        response.step_uncertainty(p.curve, direction.measured, job.units, is_splined=is_splined)
        for direction, p in pairs
    ]
    # of one direction fewer points may have been measured, too few to leave half of them out
    names = [name for name in each[0] if all(name in u for u in each)]
    return {name: float(np.mean([u[name] for u in each])) for name in names}


def _solver(predictions: Sequence[PredictedCurve]) -> SolverDocument:
    """Facts of the last direction's solver, with the worst energy balance of all directions."""
    every = [prediction.solver for prediction in predictions]
    facts: SolverDocument = {**every[-1]}
    if "snaps_mm" in facts:  # of our own solver
        facts["energy_mismatch"] = max(each.get("energy_mismatch", 0.0) for each in every)
        facts["stabilization_share"] = max(each.get("stabilization_share", 0.0) for each in every)
        facts["snaps_mm"] = sorted({snap for each in every for snap in each.get("snaps_mm", ())})
    return facts


def _seconds(job: CaseJob, predictions: Sequence[PredictedCurve]) -> dict[str, float]:
    """Add up what this cell would cost alone: its fits (shared or not) and its predictions."""
    fits = [fit for pair in job.directions if (fit := job.outcome(pair)) is not None]
    fitted = sum(fit.seconds + fit.start_seconds for fit in fits)
    predicted = sum(prediction.seconds for prediction in predictions)
    return {"fit": fitted, "predict": predicted, "total": fitted + predicted}


def _parameters(
    job: CaseJob, constants: Mapping[str, ResponseDocument]
) -> dict[str, ParameterDocument]:
    """Each averaged constant with the error of that average."""
    outcomes = [job.outcome(pair) for pair in job.identified]
    fits = [FitDocument() if fit is None else fit.fit for fit in outcomes]
    parameters: dict[str, ParameterDocument] = {}
    for name, mean in constants.items():
        scale = response.scale_of(name)
        errors = [fit.get("standard_error", {}).get(name) for fit in fits]
        errors_shown = [scale * float(error) for error in errors if error is not None]
        # None unless all fits know theirs
        complete = bool(errors_shown) and len(errors_shown) == len(fits)
        error = np.sqrt(np.sum(np.square(errors_shown))) / len(fits) if complete else None
        # the interval of one fit; that of an average of two specimens is the blocks' business
        pair = fits[0].get("ci95", {}).get(name) if len(fits) == 1 else None
        ends = [scale * float(end) for end in pair or () if end is not None]
        parameters[name] = {
            "value": mean["value"],
            "unit": mean["unit"],
            "standard_error": None if error is None else float(error),
            "ci95": ends if len(ends) == 2 else None,
        }
    return parameters


def _fits(job: CaseJob) -> dict[str, FitDocument] | None:
    described: dict[str, FitDocument] = {}
    for direction in job.directions:
        fit, key = job.outcome(direction), direction.fit_key
        if fit is None or key is None:
            continue
        name = direction.fit_label or "all"
        if name in described and described[name]["key"] != key:
            # with one specimen left out, both directions fit "all but" it, to other curves
            name = f"{name}, to score {direction.label}"
        document = fit.fit
        if direction.role != CONSTANTS:
            document = judged_where_simulated(document, job.case.tested, direction.depth_mm)
        described[name] = {**document, "key": key}
    return described or None
