"""One simulation: a problem becomes a curve."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from study.api.folders import problem_tables
from study.api.single.notebook import SolvedProblem
from study.design import plausibility
from study.design.load import load_problem
from study.forward.finite_element import at_steps
from study.material.stability import check
from study.record.record import plain
from study.setup.material_section import MaterialSection
from study.setup.setup import Problem, Setup, Tables, problem_of

if TYPE_CHECKING:
    from study.fem.solver.solution import Solution


def solve(
    problem: Problem | Tables | str | Path,
    *,
    overrides: Sequence[str] = (),
    gradients: bool = True,
    progress: Callable[[float], None] | None = None,
) -> SolvedProblem:
    """Simulate one test.

    Parameters
    ----------
    problem : Problem, mapping, str or Path
        A problem, its file, or the tables of one: the keys of the file, with texts that have a
        unit or numbers in mm, N, MPa and deg. Resolved tables (``radius_mm``) are taken too.
    overrides : sequence of str
        ``key=value`` each, laid over the file before it is validated.
    gradients : bool
        Whether dF/d(constant) is computed too.
    progress : callable, optional
        Called with the fraction that is done.

    Returns
    -------
    Solution
        Curve in mm and N, with gradients, energy balance, mesh and status; ``to_frame()``,
        ``plot()``, and a table in a notebook.

    Raises
    ------
    InputError
        For a faulty problem, or constants that make an unstable material.

    Examples
    --------
    Between frictionless plates the deformation is the same everywhere: with lambda = 0.9 and
    W = C10 (I1 - 3) the force is 2 C10 (1/lambda^2 - lambda) pi R^2.

    >>> import study
    >>> found = study.solve({
    ...     "specimen": {"shape": "cylinder", "radius": 10, "height": "1 cm"},
    ...     "test": {"kind": "compression", "interface": "frictionless",
    ...              "displacement": "1 mm", "steps": 2},
    ...     "material": {"model": "neo-hookean", "C10": "10 kPa", "incompressible": True},
    ...     "model": {"mesh_size": 5},
    ... })
    >>> found.status
    'converged'
    >>> [round(float(force), 4) for force in found.curve.force_N]
    [0.993, 2.1022]
    """
    made = _problem(problem, overrides)
    return SolvedProblem.of(at_steps(made, gradients=gradients, progress=progress))


def cautions(problem: str | Path, overrides: Sequence[str] = ()) -> tuple[str, ...]:
    """Sentences about moduli and sizes in a file that no soft material or specimen has.

    Parameters
    ----------
    problem : str or Path
        Problem file.
    overrides : sequence of str
        ``key=value`` each, laid over the file before it is validated.

    Raises
    ------
    InputError
        For a faulty problem.
    """
    tables = load_problem(problem, overrides)
    return plausibility.cautions(Setup.of(tables), MaterialSection.of(tables))


def _problem(problem: Problem | Tables | str | Path, overrides: Sequence[str]) -> Problem:
    if not isinstance(problem, Problem):
        problem = problem_of(problem_tables(problem, overrides))
    _judge(problem)
    return problem


def _judge(problem: Problem) -> None:
    """Refuse constants that are unstable on the way, before anything is meshed."""
    import numpy as np

    height = float(getattr(problem.specimen, "height_mm", 0.0))
    depth = problem.test.depth_mm
    compressed = problem.setup.kind.compresses and depth < height
    check(problem.material, np.linspace(1 - depth / height, 1, 41) if compressed else None)


def solution_json(solution: Solution) -> dict[str, object]:
    """Document of ``study solve --json``.

    Parameters
    ----------
    solution : Solution
        Converged or not.

    Returns
    -------
    dict
        Plain data without the mesh and its fields; a number that is not finite is None.
    """
    curve, warm = solution.curve, solution.warm
    content = {
        "status": solution.status,
        "message": solution.message,
        **curve.as_dict(),
        "force_gradient": {k: v.tolist() for k, v in curve.force_gradient.items()},
        "parameters": {} if warm is None else dict(warm.values),
        "dofs": solution.dofs,
        "elements": solution.elements,
        "newton_iterations": list(solution.newton_iterations),
        "seconds": dict(solution.seconds),
        "solver": solution.solver,
        "reached_mm": solution.reached_mm,
        "min_j": solution.min_j,
        "base_reaction_N": solution.base_reaction_N.tolist(),
        "energy": {
            "stored_Nmm": solution.energy.stored_Nmm.tolist(),
            "stabilization_Nmm": solution.energy.stabilization_Nmm.tolist(),
            "mismatch": solution.energy.mismatch.tolist(),
            "snaps_mm": list(solution.energy.jumps_mm),
        },
        "mesh_hash": solution.mesh_hash,
        "mesh_size_mm": solution.mesh_size_mm,
    }
    return {key: plain(value, f"solution.{key}", {}) for key, value in content.items()}
