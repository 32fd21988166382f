"""Compare an inverse-FEM fit with scipy's least_squares and finite differences, same model.

Both fit the same noise-free 20-point curve of bonded compression from the same start, three
times off, with the same tolerances; both solve with the same mesh and warm starts. Imports
and the first compilation are left out.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from study.ground.curve import Curve
from study.mechanics.calibration.fit import fit
from study.mechanics.calibration.residual_function import EvaluationFailed, MeasuredCurve
from study.mechanics.forward import finite_element
from study.simulation import fit_task
from study.simulation.cell import CellProblem
from study.simulation.fit_task import TOLERANCES

Array = NDArray[np.float64]
ENERGIES: tuple[tuple[str, int | None, dict[str, float]], ...] = (
    ("neo-hookean", None, {"C10": 6e-3}),
    ("reduced-polynomial", 2, {"C10": 6.4e-3, "C20": -0.44e-3}),
    ("reduced-polynomial", 3, {"C10": 6.4e-3, "C20": -0.8e-3, "C30": 0.6e-3}),
)


def config(model: str, order: int | None, mesh: str) -> dict[str, Any]:
    """Bonded compression of a gel cylinder to 20 % in 20 steps."""
    return {
        "specimen": {"shape": "cylinder", "radius_mm": 25.0, "height_mm": 30.0},
        "test": {"kind": "compression", "interface": "bonded", "displacement_mm": 6.0, "steps": 20},
        "material": {"model": model, "order": order, "constants": {}, "poisson_ratio": 0.4995},
        "model": {"space": "axisymmetric", "element_order": "quadratic", "mesh": mesh},
    }


def ours(setting: dict[str, Any], measured: Curve, start: Array) -> tuple[float, int, Array]:
    """Seconds, simulations and constants of our fit."""
    names = CellProblem.of(setting).material.calibrated_names
    began = time.perf_counter()
    model = fit_task.InverseFem(CellProblem.of(setting), [measured], names)
    data = [MeasuredCurve("virtual", measured)]
    found = fit(model, data, names, start, **TOLERANCES["inverse-fem"])
    if not found.converged:
        raise RuntimeError(found.message)
    return time.perf_counter() - began, model.solves, found.values


def scipys(setting: dict[str, Any], measured: Curve, start: Array) -> tuple[float, int, Array]:
    """Compute the same with scipy's trust-region reflective method and 2-point differences.

    The relative step is the square root of the solver's own tolerance: smaller ones
    differentiate its noise.
    """
    names = CellProblem.of(setting).material.calibrated_names
    began = time.perf_counter()
    last: Any = None
    solves = 0

    def residual(values: Array) -> Array:
        nonlocal last, solves
        solves += 1
        constants = dict(zip(names, values.tolist(), strict=True))
        try:
            solution = finite_element.solve(
                CellProblem.of(setting).at(constants), gradients=False, warm=last
            )
        except EvaluationFailed:
            return np.full(len(measured), 1e3)
        if solution.status != "converged":
            return np.full(len(measured), 1e3)
        last = solution
        return np.asarray(solution.curve.force_N - measured.force_N)

    scale = np.abs(start)
    found = least_squares(
        residual, start, jac="2-point", x_scale=scale, diff_step=1e-4, xtol=1e-7, ftol=1e-9,
        gtol=1e-12, method="trf",
    )  # fmt: skip
    return time.perf_counter() - began, solves, found.x


def compare(mesh: str) -> None:
    """Print a row for every energy on one mesh."""
    for model, order, true in ENERGIES:
        setting = config(model, order, mesh)
        began = time.perf_counter()
        solution = finite_element.solve(CellProblem.of(setting).at(true), gradients=False)
        forward = time.perf_counter() - began
        measured = Curve(solution.curve.displacement_mm, solution.curve.force_N)
        exact = np.array(list(true.values()))
        start = exact * np.array([3.0, 1 / 3, 3.0])[: exact.size]
        mine = min((ours(setting, measured, start) for _ in range(3)), key=lambda run: run[0])
        theirs = scipys(setting, measured, start)
        errors = [np.max(np.abs(run[2] - exact)) / np.max(exact) for run in (mine, theirs)]
        print(
            f"{mesh:>8}{solution.dofs:>9}{len(exact):>10}{mine[0]:>9.2f}{mine[1]:>8}"
            f"{errors[0]:>10.0e}{theirs[0]:>10.2f}{theirs[1]:>8}{errors[1]:>10.0e}"
            f"{theirs[0] / mine[0]:>7.1f}{theirs[1] / mine[1]:>8.1f}"
            f"{mine[0] / mine[1] / forward:>10.2f}"
        )


def main() -> None:
    """Print the tables."""
    print(
        "\nfit of bonded compression, 20 points, constants 3, 1/3 and 3 times off (ours: best of 3)"
    )
    print("iteration: seconds of one iteration over those of one simulation without gradient")
    print(
        f"{'mesh':>8}{'unknowns':>9}{'constants':>10}{'study s':>9}{'solves':>8}{'error':>10}"
        f"{'scipy s':>10}{'solves':>8}{'error':>10}{'ratio':>7}{'solves':>8}"
        f"{'iteration':>10}"
    )
    finite_element.solve(
        CellProblem.of(config(*ENERGIES[0][:2], "coarse")).at(ENERGIES[0][2])
    )  # compiles
    for mesh in ("coarse", "medium", "fine"):
        compare(mesh)


if __name__ == "__main__":
    main()
