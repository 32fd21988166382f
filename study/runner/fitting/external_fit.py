"""Constants found through a program or a function, with gradients it has or differences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from study.arrays import Array
from study.calibration.function import EvaluationFailed
from study.curve import Curve
from study.errors import InputError
from study.forward.exchange import NoAnswer
from study.forward.external import External, Solved, steps_of
from study.record.document import MeshDocument, SolverDocument
from study.runner.fitting.solution import Predicted
from study.setup.setup import Tables, problem_of

#: evaluations of a fit beside those of its gradients: measured on neo-Hookean to third order
#: (4 to 12); the plan says the cost of this many
USUAL_EVALUATIONS = 8


class InverseExternal:
    """Curves of an external forward model for the optimizer.

    The program is asked for the forces at the measured displacements themselves.
    """

    def __init__(self, tables: Tables, measured: Sequence[Curve], names: Sequence[str]) -> None:
        external = External.of(tables)
        if external is None:
            raise ValueError("these tables name no external forward model")
        self._external, self._tables, self._names = external, tables, names
        self._grids = [curve.displacement_mm for curve in measured]
        self._points = np.unique(np.concatenate(self._grids))
        self._last: tuple[bytes, Solved] | None = None
        #: solutions so far
        self.solves = 0

    def __call__(self, values: Array) -> list[Curve]:
        """Predict the forces at the measured displacements for constants in MPa."""
        solved = self._solved(values)
        self._last = (values.tobytes(), solved)
        curve = solved.answer.curve
        gradient = {
            name: curve.force_gradient[name]
            if name in solved.answer.gradients
            else self._difference(values, i, curve.force_N)
            for i, name in enumerate(self._names)
        }
        return [self._at(curve, gradient, grid) for grid in self._grids]

    def _solved(self, values: Array) -> Solved:
        constants = dict(zip(self._names, values.tolist(), strict=True))
        self.solves += 1
        try:
            problem = problem_of(self._tables, constants, float(self._points[-1]))
            return self._external.solve(problem, self._points)
        except (InputError, NoAnswer) as error:
            raise EvaluationFailed(str(error)) from error

    def _difference(self, values: Array, i: int, force: Array) -> Array:
        """Forward difference; a step back where the program has no answer ahead."""
        step = float(steps_of(values)[i])
        for signed in (step, -step):
            moved = values.copy()
            moved[i] += signed
            try:
                ahead = self._solved(moved).answer.curve.force_N
            except EvaluationFailed:
                continue
            return np.asarray((ahead - force) / (moved[i] - values[i]))
        raise EvaluationFailed(f"the program has no answer beside these constants ({i + 1})")

    def _at(self, curve: Curve, gradient: Mapping[str, Array], grid: Array) -> Curve:
        here = np.searchsorted(self._points, grid)
        return Curve(grid, curve.force_N[here],
                     force_gradient={k: v[here] for k, v in gradient.items()})  # fmt: skip

    def predicted(self, values: Array) -> Predicted:
        """Curve at the final constants; solved again where the last one was another."""
        key = np.asarray(values).tobytes()
        solved = self._last[1] if self._last and self._last[0] == key else self._solved(values)
        return predicted_of(solved, self._external)


def predicted_of(solved: Solved, external: External) -> Predicted:
    """Prediction of an external forward model, for the record.

    Parameters
    ----------
    solved : Solved
        Its answer; gradients by the constants are left out.
    external : External
        The model that answered; names the solver where the program does not say its version.
    """
    answer = solved.answer
    solver: SolverDocument = {"name": _name(solved, external)}
    if solved.program is not None:
        solver["program"] = solved.program
    mesh: MeshDocument = {}
    if answer.dofs or answer.elements:
        mesh = {"dofs": answer.dofs, "elements": answer.elements}
    return Predicted(answer.curve.without_gradients(), mesh, solver, solved.seconds)


def _name(solved: Solved, external: External) -> str:
    if external.function is not None:
        return f"Python function, version {external.function.version}"
    said = "" if solved.program is None else solved.program["version"]
    return said or external.section.argv[0][0]


def external_curve(
    tables: Tables, constants: Mapping[str, float] | None, displacement_mm: Array
) -> Predicted:
    """Curve of a case by its external forward model.

    Parameters
    ----------
    tables : mapping
        Resolved tables of the case, with ``forward``.
    constants : mapping of str to float, optional
        In MPa (exponents plain); None where the tables give them.
    displacement_mm : ndarray, shape (n,)
        Where the force is wanted, in mm, rising.

    Returns
    -------
    Predicted
        With tangents of a spline where the answer has none.

    Raises
    ------
    NoAnswer
        If it gives none.
    ValueError
        If the tables name no external forward model.
    """
    external = External.of(tables)
    if external is None:
        raise ValueError("these tables name no external forward model")
    problem = problem_of(tables, constants, float(displacement_mm[-1]))
    found = predicted_of(external.solve(problem, displacement_mm), external)
    mesh = found.mesh
    if mesh and problem.model.mesh_size_mm is not None:
        mesh = {**mesh, "mesh_size_mm": problem.model.mesh_size_mm}
    return replace(found, curve=found.curve.with_tangents(), mesh=mesh)
