"""What meshes and load steps do to the constants: a bound beside the statistical interval.

An interval knows the scatter of the rows. A mesh that is too coarse moves all constants of a
simulated test, and no further row shows it. The fit is made again on meshes beside its own and
with twice the load steps, and each constant is judged as a response is: by the order of its
convergence (Roache 1994; Celik et al. 2008, ASME J. Fluids Eng. 130, 078001) and, where it has
none, by thrice its range (Eca and Hoekstra 2014, J. Comput. Phys. 262, 104).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study.ground.arrays import Array
from study.ground.errors import InputError
from study.mechanics.calibration.covariance import scaled_inverse
from study.mechanics.calibration.identifiability import fitted_rows
from study.mechanics.calibration.residual_function import EvaluationFailed
from study.mechanics.forward.formal_order import formal_order
from study.mechanics.setup.setup import MESH_LEVELS
from study.simulation.calibration.calibration_file import CalibrationDesign
from study.simulation.calibration.measured_tests import in_order, parts_of, read_tests
from study.simulation.fit_task import (
    FitPart,
    InverseFem,
    Predict,
    Progress,
    StagedSearch,
    models_of,
    single_stage,
)
from study.simulation.response import in_shown_units
from study.statistics.convergence.grid_convergence import grid_convergence, series_bounds

if TYPE_CHECKING:
    from study.mechanics.calibration.fit import Fit


#: of the element sizes of neighboring meshes, which is that of the named ones
_RATIO = 1.5
#: how many load steps replace one
_MORE_STEPS = 2
#: change of a constant over its value below which it is rounding of the search
_SEARCH = 1e-6


@dataclass(frozen=True)
class ConstantBound:
    """Constants on several meshes, and how far discretization may move them."""

    names: tuple[str, ...]
    #: shape (p,); bounds of the error by the mesh and by the load steps of the fit; NaN where a fit
    #: failed.
    mesh: Array
    steps: Array
    #: Element sizes over that of the fit, from coarse to fine; empty without elements.
    sizes: tuple[float, ...] = ()
    #: Constants on every mesh, each shape (p,), MPa (exponents plain).
    values: Sequence[Array] = ()
    #: Which fit gave no constants; else empty.
    failure: str = ""
    #: Whether the bounds follow from one coarser mesh and the sensitivities, without another fit.
    is_estimate: bool = False

    @property
    def u(self) -> Array:
        """Bound of both, shape (p,): errors may point the same way."""
        return np.asarray(self.mesh + self.steps)

    @property
    def sentence(self) -> str:
        """How the bounds were had."""
        if self.failure:
            return f"no bound of the numerical error: {self.failure}"
        if not self.sizes:
            return "no numerical error: every test has a closed form"
        if self.is_estimate:
            return (
                f"numerics: from one mesh of {_RATIO:g} times the element size and twice the load "
                "steps, through the sensitivities: "
                "the order is assumed, the factor of safety 3; the intervals hold it; --numerics "
                "fits on more meshes"
            )
        sizes = ", ".join(f"{size:.3g}" for size in self.sizes)
        return (
            f"numerics: from fits on meshes of {sizes} times the element size, and with twice "
            "the load steps; the intervals hold it"
        )

    def as_dict(self) -> dict[str, object]:
        """Bounds and constants of every mesh: kPa, exponents plain."""
        return {
            "sentence": self.sentence,
            "u": in_shown_units(self.names, self.u),
            "mesh": in_shown_units(self.names, self.mesh),
            "steps": in_shown_units(self.names, self.steps),
            "sizes": list(self.sizes),
            "values": [in_shown_units(self.names, value) for value in self.values],
        }


def numerical_bound(
    config: CalibrationDesign, root: Path, first_fit: Fit, progress: Progress | None = None
) -> ConstantBound:
    """Fit again on other meshes and with more load steps, and judge every constant."""
    # Nuisance parameters stay at what is expected of them in all of these fits.
    names, start = first_fit.names, first_fit.values
    bounds = config.bounds_of(names)
    parts = parts_of(config.tests, in_order(read_tests(config.tests, root, config.fitting.loss)[0]))
    zero = np.zeros(len(names))
    simulated = [part for part in parts if part.method == "inverse-fem"]
    if not simulated:
        return ConstantBound(names, zero, zero)
    model = simulated[0].problem.model
    base, levels = (0, (1, 0, -1)) if model.mesh_size_mm is not None else (model.level, (2, 1, 0))
    # from coarse to fine, and the own mesh again with more steps
    parts_by_fit = [[_on_level(part, step) for part in parts] for step in levels]
    parts_by_fit.append([_with_more_steps(part) for part in parts])
    search = StagedSearch(names, bounds, progress)
    solutions = []
    for number, changed_parts in enumerate(parts_by_fit):
        stage = f"numerical bound, fit {number + 1} of {len(parts_by_fit)}"
        done = single_stage(stage, changed_parts, start, search).fit
        if not done.converged:
            why = f"{stage}, gave no constants ({done.message})"
            return ConstantBound(names, zero + np.nan, zero + np.nan, failure=why)
        solutions.append(done.values)
    *series, stepped = solutions
    values, sizes = np.array(series), tuple(_RATIO ** float(step - base) for step in levels)
    orders = [_order(part, names, start) for part in simulated]
    order = min((part_order for part_order in orders if part_order is not None), default=None)
    mesh = np.array([_u(sizes, column, levels.index(base), order) for column in values.T])
    # forces between the load steps follow from where a search began, too; with nuisance
    # parameters the constants of the fit are not those of the same question
    again = values[levels.index(base)]
    reference = start if first_fit.joint is None else again
    steps = np.maximum(np.abs(stepped - reference), np.abs(again - reference))
    return ConstantBound(names, mesh, steps, sizes, series)


def estimated_bound(
    fit: Fit, parts: Sequence[FitPart], models: Sequence[Predict]
) -> ConstantBound | None:
    """Bound the numerical error from one coarser mesh; None where every test has a closed form.

    A force that is wrong by e moves the estimates by -(J'J)^-1 J'e, as an error of a row does. The
    load steps of the fit were chosen at the constants that its search began with: meshes are
    compared on steps chosen at its own, and how far the two differ is an error of the steps.
    """
    names, constants = fit.names, fit.values
    simulated = [model if isinstance(model, InverseFem) else None for model in models]
    if all(model is None for model in simulated) or not fit.curves:
        return None
    errors: list[tuple[Array, Array, Array]] = []  # by the mesh, and twice by the load steps
    try:
        for part, model in zip(parts, simulated, strict=True):
            if model is None:
                zeros = np.zeros(sum(len(curve.curve) for curve in part.measured))
                errors.append((zeros, zeros, zeros))
                continue
            here, size = _force(model, part, constants), model.mesh_size_mm or 0.0
            order = _order(part, names, constants)
            coarse = replace(part, problem=part.problem.on_mesh(mesh_size_mm=_RATIO * size))
            chosen_here, coarser, finer = (
                _force(models_of([other], names)[0], part, constants)
                for other in (part, coarse, _with_more_steps(part))
            )
            pair = np.stack([chosen_here, coarser], axis=-1)
            by_mesh = np.copysign(
                series_bounds((1.0, _RATIO), pair, order).u, coarser - chosen_here
            )
            errors.append((by_mesh, chosen_here - here, finer - here))
    except (EvaluationFailed, InputError) as error:
        why = f"a coarser mesh, or more load steps, has no answer ({error})"
        nothing = np.full(len(names), np.nan)
        return ConstantBound(names, nothing, nothing, failure=why, is_estimate=True)
    measured = [curve for part in parts for curve in part.measured]
    jacobian, weights, _ = fitted_rows(fit, measured)
    inverse, _ = scaled_inverse(weights[:, None] * jacobian)
    used = np.concatenate([m.weights > 0 for m in measured])
    by_force = inverse @ (weights[:, None] ** 2 * jacobian).T
    mesh, again, stepped = (
        np.abs(by_force @ np.concatenate(e)[used]) for e in zip(*errors, strict=True)
    )
    steps, sizes = np.maximum(again, stepped), (_RATIO, 1.0)
    return ConstantBound(names, mesh, steps, sizes, [constants], is_estimate=True)


def _force(model: Predict, part: FitPart, constants: Array) -> Array:
    """Let a model predict the measured points of a part, one curve after the other, N."""
    return np.concatenate(
        [
            curve.force_at(measured.displacement_mm)
            for curve, measured in zip(model(constants), part.curves, strict=True)
        ]
    )


def with_numerical(fit: Fit, bound: ConstantBound) -> Fit:
    """Fit whose 95 % intervals hold the numerical error beside the scatter of the rows."""
    if not np.isfinite(bound.u).all():
        return fit
    half = np.hypot(0.5 * (fit.ci95[:, 1] - fit.ci95[:, 0]), bound.u)
    return replace(fit, ci95=np.stack([fit.values - half, fit.values + half], axis=1))


def _on_level(part: FitPart, level: int) -> FitPart:
    """Put a part on a mesh; a given size is multiplied, a name is replaced."""
    if part.method != "inverse-fem":
        return part
    size = part.problem.model.mesh_size_mm
    if size is not None:
        changes: dict[str, object] = {"mesh_size_mm": size * _RATIO**level}
    else:
        changes = {"mesh": MESH_LEVELS[len(MESH_LEVELS) - 1 - level]}
    return replace(part, problem=part.problem.on_mesh(**changes))


def _with_more_steps(part: FitPart) -> FitPart:
    steps = _MORE_STEPS * part.problem.test.steps
    return replace(part, problem=part.problem.loaded(steps=steps))


def _order(part: FitPart, names: tuple[str, ...], values: Array) -> float | None:
    """Order that the elements promise for the force of a test, and so for its constants."""
    depth = max(float(curve.curve.displacement_mm.max()) for curve in part.measured)
    constants = dict(zip(names, values.tolist(), strict=True))
    return formal_order(part.problem.at(constants, depth)).order


def _u(sizes: Sequence[float], values: Array, level: int, order: float | None) -> float:
    """Half-width of one constant on one of the meshes."""
    noise = _SEARCH * float(np.abs(values).max())
    result = grid_convergence(sizes, values, formal_order=order, tolerance=noise)
    return float(result.bound_of(float(values[level])) or noise)
