"""Errors that are not the mesh's: load steps and solver tolerance, each studied by itself.

On the coarsest mesh of a series, where they cost least: neither depends much on the mesh. One
table sets them beside the error of the mesh, which must not be confused with them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from study.curve import Curve
from study.runner.refine_judge import ALGEBRAIC, QUANTITIES
from study.runner.refine_series import Solver
from study.runner.refine_solve import solve_task

#: how many load steps replace one, and how much looser than usual the solver is
STEPS, LOOSER = (1, 2, 4), (1.0, 10.0, 100.0)


def source_tasks(config: Mapping[str, Any], size_mm: float) -> list[dict[str, Any]]:
    """Solutions that the two studies need, the usual one first."""
    usual = [solve_task(config, size_mm)]
    usual += [solve_task(config, size_mm, more_steps=k) for k in STEPS[1:]]
    return usual + [solve_task(config, size_mm, looser=k) for k in LOOSER[1:]]


def other_sources(
    config: Mapping[str, Any], size_mm: float, solve: Solver
) -> tuple[list[dict[str, Any]], list[str]]:
    """Rows of load steps and tolerance for every quantity, and what failed.

    Returns
    -------
    rows : list of dict
        ``source``, ``quantity``, ``unit``, ``setting`` (finest first), ``value``, ``u`` (in the
        unit) and ``relative``.
    said : list of str
        Solutions without an answer.
    """
    results = solve(source_tasks(config, size_mm))
    count = int(config["test"].get("steps") or 10)
    steps = [(float(count * k), r) for k, r in zip(STEPS, results, strict=False)]
    looser = [(k, r) for k, r in zip(LOOSER, [results[0], *results[len(STEPS) :]], strict=True)]
    rows, said = [], []
    for name, pairs, text in (
        ("load steps", steps[::-1], "{:g} load steps"),
        ("solver tolerance", looser, "a tolerance {:g} times the usual"),
    ):
        good = [(k, r) for k, r in pairs if r["status"] == "converged"]
        said += [
            f"{text.format(k)} gave no answer: {r.get('message', '')}"
            for k, r in pairs
            if r["status"] != "converged"
        ]
        rows += [_row(name, quantity, good) for quantity in QUANTITIES if len(good) > 1]
    return rows, said


def _row(source: str, name: str, good: Sequence[tuple[float, Mapping[str, Any]]]) -> dict[str, Any]:
    function, unit = QUANTITIES[name]
    values = [function(Curve.from_dict(r["curve"])) for _, r in good]
    settings = [k for k, _ in good]
    # steps: what the problem's own number of them is off by; tolerance: what ten times it costs
    own = values[-1] if source == "load steps" else values[1]
    reference = values[0]
    u = _error_of(values) if source == "load steps" else abs(own - reference)
    return {
        "source": source, "quantity": name, "unit": unit, "setting": settings, "value": values,
        "u": u, "relative": u / abs(reference) if reference else None,
    }  # fmt: skip


def _error_of(values: Sequence[float]) -> float:
    """Uncertainty of the last (coarsest) value: the changes of a halved step form a series."""
    from study.analysis import grid_convergence

    change = abs(values[-1] - values[0])
    if len(values) < 3:
        return change
    found = grid_convergence([1.0, 2.0, 4.0], values, tolerance=1e-8 * abs(values[0]))
    if found.extrapolated is None or found.factor_of_safety is None:
        return change
    return max(change, found.factor_of_safety * abs(values[-1] - found.extrapolated))


def one_table(
    document: Mapping[str, Any], rows: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Set the three sources of error of every quantity side by side."""
    table = []
    for name, result in document["quantities"].items():
        value = result["value"][0]
        mesh = {
            "source": "mesh", "quantity": name, "unit": result["unit"],
            "setting": result["mesh_size"], "value": result["value"], "u": result["u_num"],
            "relative": None if result["u_num"] is None or not value
            else result["u_num"] / abs(value),
        }  # fmt: skip
        table += [mesh, *(dict(row) for row in rows if row["quantity"] == name)]
    return table


def remarks(table: Sequence[Mapping[str, Any]]) -> list[str]:
    """Say where another error is too large beside that of the mesh."""
    found = []
    meshes = {row["quantity"]: row["relative"] for row in table if row["source"] == "mesh"}
    for row in table:
        mesh, own = meshes.get(row["quantity"]), row["relative"]
        if row["source"] == "mesh" or mesh is None or own is None:
            continue
        if row["source"] == "solver tolerance" and own * ALGEBRAIC > max(mesh, 1e-9):
            found.append(
                f"{row['quantity']}: the solver's tolerance moves it by {own:.1g} of its value, "
                f"more than a hundredth of the mesh's {mesh:.1g}"
            )
        if row["source"] == "load steps" and own > mesh:
            found.append(
                f"{row['quantity']}: the load steps are off by {own:.1g} of its value, more than "
                f"the mesh ({mesh:.1g}): raise test.steps before refining"
            )
    return found
