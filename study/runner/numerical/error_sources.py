"""Errors of mesh, load steps and solver tolerance side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from study.analysis.convergence.grid_convergence import ConvergenceResult, grid_convergence
from study.runner.numerical.curve_quantities import QUANTITIES
from study.runner.numerical.solve_task import Solver, SolveResult, SolveTask, solutions
from study.setup.setup import Setup, Tables

#: How many load steps replace one.
STEPS = (1, 2, 4)

#: How much looser than usual the solver is.
LOOSER = (1.0, 10.0, 100.0)

#: The algebraic error should be this much smaller than that of the mesh.
ALGEBRAIC = 100.0


@dataclass(frozen=True)
class ErrorSource:
    """What one source of error does to a quantity.

    Parameters
    ----------
    source, quantity, unit : str
        ``"mesh"``, ``"load steps"`` or ``"solver tolerance"``; what it moves, and its unit.
    setting, value : tuple of float
        Mesh size, number of steps or factor on the tolerance, finest first, and the values.
    u : float or None
        Uncertainty of the quantity, in its unit.
    relative : float or None
        The same over the value.
    """

    source: str
    quantity: str
    unit: str
    setting: tuple[float, ...]
    value: tuple[float, ...]
    u: float | None
    relative: float | None


def source_tasks(tables: Tables, size_mm: float) -> list[SolveTask]:
    """Solutions that the studies of steps and tolerance need, the usual one first.

    Parameters
    ----------
    tables : mapping
        Document of the problem, with all its constants.
    size_mm : float
        Element size of all of them.

    Returns
    -------
    list of SolveTask
        By :data:`STEPS`, then by :data:`LOOSER` without its first.
    """
    usual = [SolveTask.of(tables, size_mm)]
    usual += [SolveTask.of(tables, size_mm, more_steps=k) for k in STEPS[1:]]
    return usual + [SolveTask.of(tables, size_mm, looser=k) for k in LOOSER[1:]]


def other_sources(
    tables: Tables, size_mm: float, solve: Solver
) -> tuple[list[ErrorSource], list[str]]:
    """Errors of load steps and tolerance for every quantity, and which solutions failed.

    Parameters
    ----------
    tables : mapping
        Document of the problem, with all its constants.
    size_mm : float
        Element size of all solutions.
    solve : Solver
        Solves the tasks of :func:`source_tasks`.

    Returns
    -------
    list of ErrorSource
        A source with fewer than two solutions has no rows.
    list of str
        A sentence for each solution that failed.
    """
    results = solutions(solve, source_tasks(tables, size_mm))
    count = Setup.of(tables).test.steps
    steps = [(float(count * k), r) for k, r in zip(STEPS, results, strict=False)]
    looser = list(zip(LOOSER, [results[0], *results[len(STEPS) :]], strict=True))
    rows, said = [], []
    for name, pairs, text in (
        ("load steps", steps[::-1], "{:g} load steps"),
        ("solver tolerance", looser, "a tolerance {:g} times the usual"),
    ):
        good = [(k, result) for k, result in pairs if result.converged]
        said += [
            f"{text.format(k)} gave no answer: {result.message}"
            for k, result in pairs
            if not result.converged
        ]
        rows += [_source(name, quantity, good) for quantity in QUANTITIES if len(good) > 1]
    return rows, said


def _source(source: str, name: str, good: Sequence[tuple[float, SolveResult]]) -> ErrorSource:
    function, unit = QUANTITIES[name]
    values = tuple(function(result.curve) for _, result in good)
    settings, reference = tuple(k for k, _ in good), values[0]
    # steps: what the problem's own number of them is off by; tolerance: what ten times it costs
    u = _error_of(values) if source == "load steps" else abs(values[1] - reference)
    relative = u / abs(reference) if reference else None
    return ErrorSource(source, name, unit, settings, values, u, relative)


def _error_of(values: Sequence[float]) -> float:
    """Uncertainty of the last (coarsest) value: the changes of a halved step form a series."""
    change = abs(values[-1] - values[0])
    if len(values) < 3:
        return change
    found = grid_convergence([1.0, 2.0, 4.0], values, tolerance=1e-8 * abs(values[0]))
    if found.extrapolated is None or found.factor_of_safety is None:
        return change
    return max(change, found.factor_of_safety * abs(values[-1] - found.extrapolated))


def one_table(
    quantities: Mapping[str, ConvergenceResult], others: Sequence[ErrorSource]
) -> tuple[ErrorSource, ...]:
    """Set the three sources of error of every quantity side by side.

    Parameters
    ----------
    quantities : mapping of str to ConvergenceResult
        What the refinement of the mesh says of each quantity, by its name.
    others : sequence of ErrorSource
        Of load steps and solver tolerance, in any order.

    Returns
    -------
    tuple of ErrorSource
        By quantity, the mesh first.
    """
    table: list[ErrorSource] = []
    for name, found in quantities.items():
        u, value = found.u_num, found.value[0]
        relative = None if u is None or not value else u / abs(value)
        mesh = ErrorSource("mesh", name, found.unit, found.mesh_size, found.value, u, relative)
        table += [mesh, *(row for row in others if row.quantity == name)]
    return tuple(table)


def remarks(table: Sequence[ErrorSource]) -> list[str]:
    """Say where another error is too large beside that of the mesh.

    Parameters
    ----------
    table : sequence of ErrorSource
        Of :func:`one_table`; a row counts where its relative error and that of its mesh are known.

    Returns
    -------
    list of str
        A sentence for each error that is too large.
    """
    found = []
    meshes = {row.quantity: row.relative for row in table if row.source == "mesh"}
    for row in table:
        mesh, own = meshes.get(row.quantity), row.relative
        if row.source == "mesh" or mesh is None or own is None:
            continue
        if row.source == "solver tolerance" and own * ALGEBRAIC > max(mesh, 1e-9):
            found.append(
                f"{row.quantity}: the solver's tolerance moves it by {own:.1g} of its value, "
                f"more than a hundredth of the mesh's {mesh:.1g}"
            )
        if row.source == "load steps" and own > mesh:
            found.append(
                f"{row.quantity}: the load steps are off by {own:.1g} of its value, more than "
                f"the mesh ({mesh:.1g}): raise test.steps before refining"
            )
    return found
