"""Refinement series of one problem, and those stored with a study."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from study.curve import Curve
from study.errors import Fault, InputError, nearest
from study.runner import build, fits

if TYPE_CHECKING:
    from study.analysis import ConvergenceResult
    from study.runner.refine import Numerical

#: quantities of a curve that a series can watch, with their units; the root mean square of
#: the force stands for the whole curve
QUANTITIES: Mapping[str, tuple[Callable[[Curve], float], str]] = {
    "peak_force": (lambda curve: float(curve.force_N[-1]), "N"),
    "work": (lambda curve: curve.work_N_mm(), "N mm"),
    "curve_rms": (lambda curve: float(np.sqrt(np.mean(curve.force_N**2))), "N"),
}
#: relative error of a force at the solver's tolerance
SOLVER_TOLERANCE = 1e-7


def problem_series(
    config: Mapping[str, Any],
    formal_order: float | None = None,
    tolerance: float = 0.0,
    progress: Callable[[str], None] | None = None,
) -> ConvergenceResult:
    """Solve a problem on finer and finer meshes and judge the series.

    Parameters
    ----------
    config : mapping
        Of :func:`study.design.load_problem`; its ``converge`` says ratio, number of meshes
        and the quantity.
    tolerance : float
        Algebraic error of the quantity; by default that of the solver.

    Raises
    ------
    InputError
        If a mesh gives no answer, or the quantity is not one of a single problem.
    """
    from study.analysis import grid_convergence
    from study.forward.mesh import mesh_size

    spec = config["converge"]
    if spec.qoi not in QUANTITIES:
        rule = f"{spec.qoi!r} needs measured curves"
        raise InputError(Fault("converge.qoi", rule, nearest(spec.qoi, QUANTITIES)))
    quantity, unit = QUANTITIES[spec.qoi]
    first = float(mesh_size(build.problem(config)))
    sizes = [first / spec.ratio**level for level in range(max(3, spec.levels))]
    values = []
    for size in sizes:
        if progress is not None:
            progress(f"mesh size {size:.4g} mm")
        values.append(quantity(_solved(config, size)))
    floor = tolerance or SOLVER_TOLERANCE * max(abs(v) for v in values)
    return grid_convergence(
        sizes, values, formal_order=formal_order, tolerance=floor, qoi=spec.qoi, unit=unit
    )


def _solved(config: Mapping[str, Any], size: float) -> Curve:
    model = {**config["model"], "mesh": None, "mesh_size_mm": size}
    solution = fits.solve(build.problem({**config, "model": model}), gradients=False)
    if solution.status != "converged":
        rule = f"the mesh of {size:.4g} mm gave no answer: {solution.message}"
        raise InputError(Fault("converge", rule, "start from another mesh size"))
    curve: Curve = solution.curve
    return curve


def stored_convergence(rows: Sequence[Numerical]) -> list[dict[str, Any]]:
    """Judge every stored series of a study.

    Returns
    -------
    list of dict
        The keys of a convergence document, with ``levels`` and ``note``; a series of two
        meshes has no order and says so.
    """
    from study.analysis import grid_convergence

    found = []
    for row in rows:
        cell: dict[str, Any] = {"levels": dict(row.levels), "note": row.note}
        if len(row.series) >= 3:
            judged = grid_convergence(
                row.mesh_size, row.series, formal_order=row.formal_order, qoi=row.response,
                unit=row.unit,
            )  # fmt: skip
            cell |= judged.to_json() | {"formal_reason": row.formal_reason}
        else:
            cell |= {
                "qoi": row.response, "unit": row.unit,
                "mesh_size": list(row.mesh_size)[::-1], "value": list(row.series)[::-1],
                "behaviour": "inconclusive", "observed_order": None, "formal_order": None,
                "extrapolated": None, "gci_fine": None, "factor_of_safety": None,
                "u_num": row.u_num, "asymptotic_ratio": None,
                "verdict": f"{len(row.series)} meshes have no order; u_num is that of the study",
            }  # fmt: skip
        found.append(cell)
    return found
