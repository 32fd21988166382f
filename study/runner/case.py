"""One case: constants, prediction, score -> Record. Expected failure is a status, never raised."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from study.curve import Curve
from study.errors import InputError
from study.forward import closed_form, finite_element
from study.forward.finite_element import Anchors
from study.record.record import STATUSES, Record
from study.runner import response
from study.runner.fitting import fit_task
from study.runner.provenance import versions
from study.runner.response import constants_only
from study.setup.material_section import MaterialSection
from study.setup.setup import Setup

Config = Mapping[str, Any]

#: of this worker, which runs one case after the other
_ANCHORS = Anchors()


@dataclass
class _Prediction:
    curve: Curve
    seconds: float = 0.0
    mesh: dict[str, Any] = field(default_factory=dict)
    solver: dict[str, Any] = field(default_factory=dict)


class _Stopped(Exception):
    """A part of the case has no answer; carries the status of the record."""

    def __init__(self, status: str, message: str) -> None:
        super().__init__(message)
        self.status = status if status in STATUSES else "failed"


def perform(task: Mapping[str, Any]) -> dict[str, Any]:
    """Execute one case; the result holds the sealed text of its record."""
    began = time.perf_counter()
    try:
        record = _executed(task)
    except _Stopped as stop:
        seconds = {"total": time.perf_counter() - began}
        record = blank(task, stop.status, str(stop), timings=seconds)
    except InputError as error:
        record = blank(task, "failed", str(error))
    return {"status": record.status, "message": record.message, "record": record.to_json()}


def blank(
    task: Mapping[str, Any],
    status: str,
    message: str,
    *,
    timings: Mapping[str, float] | None = None,
    extra: Mapping[str, Any] | None = None,
) -> Record:
    """Record of a case without an answer: every response is missing."""
    return Record(
        case_id=task["case_id"],
        study=task["study"],
        levels=task["levels"],
        block=task["block"],
        status=status,
        message=message,
        responses={n: {"value": None, "unit": unit} for n, unit in task["responses"].items()},
        timings=dict(timings or {}),
        versions=versions(),
        input_hash=task["input_hash"],
        extra={**task.get("extra", {}), **dict(extra or {})},
    )


def _executed(task: Mapping[str, Any]) -> Record:
    config, directions = task["config"], task["directions"]
    for direction in directions:
        _check_fit(direction)
    if constants_only(task.get("extra", {})):
        return _refitted(task)
    anchor = task.get("anchor")
    predictions = [_predict(config, direction, anchor) for direction in directions]
    scores = [
        response.score(p.curve, Curve.from_dict(d["measured"]))
        | response.constants_in_kPa(_constants(config, d))
        for p, d in zip(predictions, directions, strict=True)
    ]
    record = blank(task, "converged", "")
    seconds = _seconds(predictions, directions)
    means = response.averaged(scores)
    means["seconds"] = {"value": seconds["total"], "unit": "s"}
    steps = _step_uncertainty(predictions, directions)
    wanted = {
        n: {**means.get(n, {"value": None, "unit": u}), **steps.get(n, {})}
        for n, u in task["responses"].items()
    }
    return replace(
        record,
        responses=wanted,
        parameters=_parameters(config, directions),
        fit=_fit_summary(directions),
        curves=_curves(predictions, directions),
        timings=seconds,
        mesh=predictions[-1].mesh,
        solver=_solver(predictions),
        extra={**record.extra, "directions": _direction_facts(directions, scores)},
    )


def _step_uncertainty(
    predictions: Sequence[_Prediction], directions: Sequence[Mapping[str, Any]]
) -> dict[str, dict[str, float]]:
    """Return ``u_steps`` of every response: the mean over the directions, as its value is."""
    each = [
        response.step_uncertainty(p.curve, Curve.from_dict(d["measured"]))
        for p, d in zip(predictions, directions, strict=True)
    ]
    return {name: {"u_steps": float(np.mean([u[name] for u in each]))} for name in each[0]}


def _solver(predictions: Sequence[_Prediction]) -> dict[str, Any]:
    """Facts of the last direction's solver, with the worst energy balance of all directions."""
    found = dict(predictions[-1].solver)
    for name in ("energy_mismatch", "stabilization_share"):
        shares = [p.solver[name] for p in predictions if name in p.solver]
        found |= {name: max(shares)} if shares else {}
    snaps = [place for p in predictions for place in p.solver.get("snaps_mm", ())]
    return found | ({"snaps_mm": sorted(set(snaps))} if "snaps_mm" in found else {})


def _refitted(task: Mapping[str, Any]) -> Record:
    """Record of a fit to resampled noise: its constants, and no prediction."""
    config, directions = task["config"], task["directions"]
    means = response.averaged(
        [response.constants_in_kPa(_constants(config, d)) for d in directions]
    )
    seconds = _seconds([], directions)
    wanted = {n: means.get(n, {"value": None, "unit": u}) for n, u in task["responses"].items()}
    return replace(
        blank(task, "converged", ""),
        responses=wanted,
        parameters=_parameters(config, directions),
        fit=_fit_summary(directions),
        timings=seconds,
    )


def _check_fit(direction: Mapping[str, Any]) -> None:
    fit = direction["fit"]
    if fit is None:
        return
    if fit.get("status") != "converged":
        where = f"calibration on {direction['fit_label'] or 'the measured curve'}"
        raise _Stopped(str(fit.get("status", "failed")), f"{where}: {fit.get('message', '')}")
    if not fit.get("usable", True):
        raise _Stopped("unstable", f"the fitted constants are unstable: {fit.get('stability')}")


def _predict(
    config: Config, direction: Mapping[str, Any], anchor: Mapping[str, Any] | None
) -> _Prediction:
    """Predicted curve of the scored test with the constants of the fit."""
    fit, measured = direction["fit"], Curve.from_dict(direction["measured"])
    problem = fit_task.fit_problem(config)
    if fit is not None and "curve" in fit and problem.shares_scored_problem:
        # the last solution of the fit is the prediction: same geometry, same constants
        return _Prediction(
            Curve.from_dict(fit["curve"]), 0.0, dict(fit.get("mesh", {})), dict(fit["solver"])
        )
    constants = None if fit is None else fit["values"]
    depth = float(measured.displacement_mm.max())
    asked = (config.get("calibration") or {}).get("method") or "auto"
    setup = Setup.of(config)
    if asked == "analytic" and setup.is_homogeneous:
        material = MaterialSection.of(config["material"]).material(constants)
        curve = closed_form.compression(setup.specimen, material, measured.displacement_mm)
        if not np.all(np.isfinite(curve.force_N)):
            raise _Stopped("unstable", "the material has no equilibrium state in this range")
        return _Prediction(
            Curve(curve.displacement_mm, curve.force_N), solver={"name": "closed form"}
        )
    predicted = _ANCHORS.predict(config, constants, depth, anchor)
    solution = predicted.solution
    if solution.status != "converged":
        raise _Stopped(solution.status, f"{solution.message} (reached {solution.reached_mm:g} mm)")
    curve = solution.curve
    return _Prediction(
        curve.without_gradients(),
        predicted.cold_seconds,
        finite_element.mesh_facts(solution),
        fit_task.solver_facts(solution),
    )


def _constants(config: Config, direction: Mapping[str, Any]) -> dict[str, Any]:
    if direction["fit"] is not None:
        return dict(direction["fit"])
    material = MaterialSection.of(config["material"]).material()
    return {"values": dict(material.constants), "mu0": material.mu0}


def _seconds(
    predictions: Sequence[_Prediction], directions: Sequence[Mapping[str, Any]]
) -> dict[str, float]:
    """Add up what this cell would cost alone: its fits (shared or not) and its predictions."""
    found = [d["fit"] for d in directions if d["fit"] is not None]
    fitted = sum(float(f.get("seconds", 0.0)) + float(f.get("start_seconds", 0.0)) for f in found)
    predicted = sum(p.seconds for p in predictions)
    return {"fit": fitted, "predict": predicted, "total": fitted + predicted}


def _parameters(config: Config, directions: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Each constant averaged over the directions, with the error of that average."""
    values = [response.constants_in_kPa(_constants(config, d)) for d in directions]
    means = response.averaged(values)
    for name, entry in means.items():
        errors = [(d["fit"] or {}).get("standard_error", {}).get(name) for d in directions]
        scale = 1.0 if response.is_plain(name) else 1000.0
        known = [scale * float(e) for e in errors if e is not None]
        complete = bool(known) and len(known) == len(directions)
        entry["standard_error"] = (
            float(np.sqrt(np.sum(np.square(known))) / len(known)) if complete else None
        )
        # the interval of one fit; that of an average of two specimens is the blocks' business
        pair = (directions[0]["fit"] or {}).get("ci95", {}).get(name)
        single = len(directions) == 1 and pair and None not in pair
        entry["ci95"] = [scale * float(v) for v in pair] if single else None
    return means


def _fit_summary(directions: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Describe each fit, by the label of its specimen."""
    keep = (
        "method", "message", "names", "values", "standard_error", "ci95", "correlation",
        "condition", "rss", "r_squared", "aicc", "n", "identifiable", "reason", "stable",
        "usable", "stability",
        "evaluations", "newton_iterations", "solves", "seconds", "mu0", "resampling",
    )  # fmt: skip
    found: dict[str, Any] = {}
    for d in directions:
        if d["fit"] is None:
            continue
        name = d["fit_label"] or "all"
        if name in found and found[name]["key"] != d["fit_key"]:
            # with one specimen left out, both directions fit "all but" it, to other curves
            name = f"{name}, to score {d['label']}"
        found[name] = {"key": d["fit_key"], **{k: d["fit"][k] for k in keep if k in d["fit"]}}
    return found or None


def _curves(
    predictions: Sequence[_Prediction], directions: Sequence[Mapping[str, Any]]
) -> dict[str, Curve]:
    out: dict[str, Curve] = {}
    for p, d in zip(predictions, directions, strict=True):
        out[f"measured:{d['label']}"] = Curve.from_dict(d["measured"])
        out[f"predicted:{d['label']}"] = p.curve
    return out


def _direction_facts(
    directions: Sequence[Mapping[str, Any]],
    scores: Sequence[Mapping[str, tuple[float, str]]],
) -> list[dict[str, Any]]:
    return [
        {
            "score": d["label"],
            "fit": d["fit_label"],
            "role": d["role"],
            "scatter_N": d["scatter_N"],
            "responses": {n: {"value": v, "unit": u} for n, (v, u) in s.items()},
        }
        for d, s in zip(directions, scores, strict=True)
    ]
