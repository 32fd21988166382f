"""Calibration of one material on one block: what enters it, its name, and doing it.

Cases share a fit when everything that decides it is the same: the calibrated problem, the
measured curve, the method and the code. A closed-form fit knows nothing of the modelling
space or the elements, so sixteen cells may share four of them.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from study.arrays import Array
from study.calibration.fit import MeasuredCurve
from study.calibration.iteration import EvaluationFailed
from study.canonical import digest
from study.curve import Curve
from study.errors import Fault, InputError
from study.forward import closed_form, finite_element
from study.material.registry import ENERGIES
from study.runner.fitting.fit_summary import described
from study.runner.fitting.staged_fit import Part, Predict, staged_fit
from study.runner.provenance import code_version
from study.setup.material_section import MaterialSection
from study.setup.setup import Setup, problem_of, specimen_of

Config = Mapping[str, Any]
METHODS = ("auto", "analytic", "inverse-fem", "none")

#: smallest load step over the largest: constants that need less are next to having no answer,
#: and an optimizer that asks there should hear so soon
_CUTBACKS = 0.12

#: sections of a configuration that a calibration problem of its own may replace
_REPLACEABLE = ("specimen", "test")


@dataclass(frozen=True)
class FitProblem:
    """A calibration without its data.

    Parameters
    ----------
    method : str
        ``"closed-form"``, ``"inverse-fem"``, ``"together"`` (several tests) or ``"none"``.
    config : mapping
        The sections that enter, and nothing else; for several tests ``material`` and
        ``tests``, each with its own ``method``.
    shares_scored_problem : bool
        Whether the calibrated test is also the one that is scored.
    """

    method: str
    config: Config
    shares_scored_problem: bool


def fit_problem(config: Config) -> FitProblem:
    """Calibration of a resolved configuration.

    Raises
    ------
    InputError
        If ``method = "analytic"`` is asked of a test that has no closed form.
    """
    section = config.get("calibration") or {}
    own = section.get("problem") or {}
    scored = {k: config[k] for k in ("specimen", "test", "material", "model") if k in config}
    merged = scored | {k: own[k] for k in _REPLACEABLE if own.get(k)}
    shared = merged == scored
    merged["material"] = _written(merged["material"])
    method = _method(section.get("method") or "auto", merged)
    if method == "closed-form":
        merged.pop("model", None)
        merged["test"] = {"kind": "compression", "interface": "frictionless"}
    return FitProblem(method, merged, shared)


def together(config: Config, tests: Sequence[Config]) -> FitProblem:
    """One fit to several tests, with the material and model of a configuration."""
    asked = {"method": (config.get("calibration") or {}).get("method") or "auto"}
    parts = []
    for test in tests:
        found = fit_problem({**config, **test, "calibration": asked})
        sections = {k: v for k, v in found.config.items() if k != "material"}
        parts.append({"method": found.method, **sections})
    return FitProblem("together", {"material": _written(config["material"]), "tests": parts}, False)


def _parts_of(problem: FitProblem) -> list[tuple[str, Config]]:
    """List method and configuration of every test of a fit."""
    if problem.method != "together":
        return [(problem.method, problem.config)]
    shared = {"material": problem.config["material"]}
    return [(test["method"], {**shared, **test}) for test in problem.config["tests"]]


def _written(material: Config) -> dict[str, Any]:
    """Material without keys that say nothing, so that equal materials have equal names."""
    return {k: v for k, v in material.items() if v not in (None, {}, False)}


def _method(asked: str, config: Config) -> str:
    if asked == "none":
        return "none"
    homogeneous = Setup.of(config).is_homogeneous
    if asked == "analytic" and not homogeneous:
        rule = "method = 'analytic' needs compression with both faces frictionless"
        raise InputError(Fault("calibration.method", rule, "use 'auto' or 'inverse-fem'"))
    if asked == "inverse-fem":
        return "inverse-fem"
    return "closed-form" if homogeneous else "inverse-fem"


def fit_key(problem: FitProblem, measured: Sequence[Curve]) -> str:
    """Name of a fit: a hash of the problem, the data and the code.

    Parameters
    ----------
    measured : sequence of Curve
        The averaged curves that are fitted.
    """
    data = [[c.displacement_mm.tolist(), c.force_N.tolist()] for c in measured]
    return digest([problem.method, problem.config, data, code_version()], 32)


def start_problem(problem: FitProblem) -> FitProblem | None:
    """Fit of the same test whose constants start this one: neo-Hookean, or one order lower.

    A third-order polynomial that starts from the neo-Hookean constant alone walks into
    constants that soften without end. None where there is nothing to wait for: the fit is
    neo-Hookean or linear itself, has a closed form, or its start is given. Start values are
    thus a function of the case alone.
    """
    section = problem.config["material"]
    simulated = any(method == "inverse-fem" for method, _ in _parts_of(problem))
    if not simulated or section.get("constants"):
        return None
    simpler = ENERGIES[section["model"]].simpler(int(section.get("order") or 1))
    if simpler is None:
        return None
    kept = {k: v for k, v in section.items() if k not in ("order", "constants")}
    model, order = simpler
    material = _written({**kept, "model": model} | ({} if order is None else {"order": order}))
    return FitProblem(
        problem.method, {**problem.config, "material": material}, problem.shares_scored_problem
    )


def payload(
    problem: FitProblem, measured: Sequence[Curve], start: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Task for a worker: plain JSON, complete in itself.

    Parameters
    ----------
    start : mapping, optional
        Result of the fit of :func:`start_problem`.
    """
    return {
        "kind": "fit",
        "method": problem.method,
        "config": dict(problem.config),
        "measured": [curve.as_dict() for curve in measured],
        "start": None if start is None else dict(start),
    }


def perform(task: Mapping[str, Any]) -> dict[str, Any]:
    """Fit the constants of one material to measured curves.

    Returns
    -------
    dict
        ``status`` is ``"converged"`` or the reason why not; constants in MPa.
    """
    began = time.perf_counter()
    start = task["start"]
    if start is not None and start.get("status") != "converged":  # it cannot be fitted alone
        why = f"the fit that starts it did not converge: {start.get('message', '')}"
        return {"status": str(start.get("status", "failed")), "message": why}
    measured, parts = parts_of(task)
    config = parts[0].config
    names, first = start_values(config, measured, (start or {}).get("values"))
    done = staged_fit(parts, names, first, model)
    result = described(done.fit, config, names, measured[:1] if len(parts) > 1 else measured)
    predict = done.models[0]
    if isinstance(predict, InverseFem) and task["method"] == "inverse-fem":
        result |= predict.provenance(done.fit.values)
    result |= {"message": done.message, "evaluations": done.evaluations}
    result["method"] = task["method"]
    result["seconds"] = time.perf_counter() - began
    result["start_seconds"] = float((start or {}).get("seconds", 0.0))
    return result


def parts_of(task: Mapping[str, Any]) -> tuple[list[Curve], list[Part]]:
    """Measured curves of a task, and the parts of its fit that they belong to."""
    measured = [Curve.from_dict(c) for c in task["measured"]]
    tests = _parts_of(FitProblem(task["method"], task["config"], False))
    data = [MeasuredCurve(f"measured {k}", curve) for k, curve in enumerate(measured)]
    if len(tests) == 1:
        return measured, [Part(*tests[0], tuple(data))]
    return measured, [Part(*test, (one,)) for test, one in zip(tests, data, strict=True)]


def start_values(
    config: Config, measured: Sequence[Curve], neo_hookean: Mapping[str, float] | None
) -> tuple[tuple[str, ...], Array]:
    """Names of the constants and where the fit starts, in MPa.

    Higher constants start at zero: those of the closed form soften so much that a bonded
    specimen cannot be solved with them.
    """
    section = config["material"]
    names = MaterialSection.of(section).calibrated_names
    given = section.get("constants")
    if given:
        return names, np.array([float(given[n]) for n in names])
    if neo_hookean is None:
        first = measured[0]
        neo_hookean = closed_form.neo_hookean_start(config, first.displacement_mm, first.force_N)
    energy, shear_modulus = ENERGIES[section["model"]], 2 * float(neo_hookean["C10"])
    values = {**neo_hookean, **energy.starting_values(names, shear_modulus)}
    return names, np.array([values.get(n, 0.0) for n in names])


def model(method: str, config: Config, measured: Sequence[Curve], names: Sequence[str]) -> Predict:
    """Model of one test, for the optimizer."""
    make = closed_form_model if method == "closed-form" else InverseFem
    return make(config, measured, names)


def closed_form_model(config: Config, measured: Sequence[Curve], names: Sequence[str]) -> Predict:
    """Model of compression between frictionless plates, for the optimizer."""
    specimen, section = specimen_of(config["specimen"]), MaterialSection.of(config["material"])

    def predict(values: Array) -> list[Curve]:
        constants = dict(zip(names, values.tolist(), strict=True))
        try:
            material = section.material(constants)
        except InputError as error:
            raise EvaluationFailed(str(error)) from error
        curves = [
            closed_form.compression(specimen, material, curve.displacement_mm) for curve in measured
        ]
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

    def __init__(self, config: Config, measured: Sequence[Curve], names: Sequence[str]) -> None:
        self._config, self._names = config, names
        self._grids = [curve.displacement_mm for curve in measured]
        self._depth = max(float(grid.max()) for grid in self._grids)
        self._base: Curve | None = None
        self._last: Any = None
        self._newton = 0
        #: simulations so far
        self.solves = 0
        #: solved curve at every set of constants
        self.curves: dict[bytes, Curve] = {}

    def __call__(self, values: Array) -> list[Curve]:
        """Predict the forces at the measured displacements for constants in MPa."""
        curve = self._solved(values)
        self.curves[values.tobytes()] = finite_element.without_gradients(curve)
        if self._base is None:
            self._base = curve
        return [self._at(curve, grid) for grid in self._grids]

    def _solved(self, values: Array) -> Curve:
        constants = dict(zip(self._names, values.tolist(), strict=True))
        try:
            problem = problem_of(self._config, constants, self._depth)
            solution = self._simulated(problem, self._last)
            if solution.status == "not-converged" and self._last is not None:
                # the way from the solution before was too long: that says nothing of the constants
                solution = self._simulated(problem, None)
        except InputError as error:
            raise EvaluationFailed(str(error)) from error
        if solution.status != "converged":
            raise EvaluationFailed(f"{solution.status}: {solution.message}")
        self._last = solution
        return cast(Curve, solution.curve)

    def _simulated(self, problem: Any, warm: Any) -> Any:
        solution = finite_element.solve(problem, gradients=True, warm=warm, cutbacks=_CUTBACKS)
        self.solves += 1
        self._newton += int(sum(solution.newton_iterations))
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

    def provenance(self, values: Array) -> dict[str, Any]:
        """Curve at the final constants, mesh, solver and effort, for the record."""
        if self._last is None:
            return {}
        return {
            "curve": self.curves[np.asarray(values).tobytes()].as_dict(),
            "mesh": finite_element.mesh_facts(self._last),
            "solver": solver_facts(self._last),
            "newton_iterations": self._newton,
            "solves": self.solves,
        }


def _spline(knots: Array, values: Array, at: Array) -> Array:
    """Cubic spline from the unloaded origin through the solved steps; linear in ``values``."""
    from scipy.interpolate import CubicSpline

    x, y = (knots, values) if knots[0] <= 0 else (np.r_[0.0, knots], np.r_[0.0, values])
    if x.size < 3:
        return np.asarray(np.interp(at, x, y))
    return np.asarray(CubicSpline(x, y)(at))


def solver_facts(solution: Any) -> dict[str, Any]:
    """Describe how a solution was found, and its energy balance, for the record."""
    return {
        "name": str(solution.solver),
        "min_j": float(solution.min_j),
        "energy_mismatch": float(solution.energy.largest_mismatch),
        "stabilization_share": float(solution.energy.stabilization_share),
        "snaps_mm": [float(place) for place in solution.energy.jumps_mm],
    }
