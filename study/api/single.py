"""One simulation, virtual measurements."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from study.api.places import data_root
from study.errors import Fault, InputError

if TYPE_CHECKING:
    from study.forward.problem import Problem
    from study.forward.solution import Solution


def solve(
    problem: Problem | Mapping[str, Any] | str | Path,
    *,
    overrides: Sequence[str] = (),
    gradients: bool = True,
    progress: Callable[[float], None] | None = None,
) -> Solution:
    """Simulate one test.

    Parameters
    ----------
    problem : Problem, mapping, str or Path
        A problem, its resolved configuration, or its file.
    progress : callable, optional
        Called with the fraction that is done.

    Raises
    ------
    InputError
        For a faulty problem, or constants that make an unstable material.
    """
    from study.forward.solve import solve as forward_solve

    return forward_solve(_problem(problem, overrides), gradients=gradients, progress=progress)


def _problem(
    problem: Problem | Mapping[str, Any] | str | Path, overrides: Sequence[str]
) -> Problem:
    from study.design import load_problem
    from study.forward.problem import Problem
    from study.runner import build, surfaces

    if not isinstance(problem, Problem):
        config = problem
        if not isinstance(config, Mapping):
            places = surfaces.folders(config, data_root(config))
            config = surfaces.located(load_problem(config, overrides), places)
        problem = build.problem(config)
    _judge(problem)
    return problem


def _judge(problem: Problem) -> None:
    """Refuse constants that are unstable on the way, before anything is meshed."""
    import numpy as np

    from study.material import check

    height = float(getattr(problem.specimen, "height_mm", 0.0))
    depth = problem.test.displacement_mm
    compressed = problem.test.kind == "compression" and depth < height
    check(problem.material, np.linspace(1 - depth / height, 1, 41) if compressed else None)


def solution_json(solution: Solution) -> dict[str, Any]:
    """Document of ``study solve --json``."""
    from study.record.record import plain

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
    made: dict[str, Any] = plain(content, "solution", {})
    return made


def writable(*paths: Path | None) -> None:
    """Refuse files that could not be written, before anything is computed.

    Raises
    ------
    InputError
        For a folder that does not exist, or a folder in place of a file.
    """
    faults = []
    for path in paths:
        if path is not None and not path.parent.is_dir():
            faults.append(Fault(str(path), f"there is no folder {path.parent}", "make it first"))
        elif path is not None and path.is_dir():
            faults.append(Fault(str(path), "is a folder", "name a file"))
    if faults:
        raise InputError(faults)


def write_vtu(solution: Solution, path: str | Path) -> None:
    """Write displacement, J and stress of the last converged step for ParaView.

    Raises
    ------
    InputError
        If no step converged, or the file cannot be written.
    """
    from study.forward.fields import write_vtu as write

    write(solution, path)


def write_picture(solution: Solution, path: str | Path) -> None:
    """Draw the mesh of a solution before and after its deformation.

    Raises
    ------
    InputError
        If there is nothing to draw, or the file cannot be written.
    """
    from study.reporting.figures_mesh import picture

    try:
        svg, _ = picture(solution.points, solution.cells, solution.displacement)
        Path(path).write_text(svg + "\n", encoding="utf-8")
    except ValueError as error:
        raise InputError(Fault(str(path), f"no picture: {error}")) from None
    except OSError as error:
        raise InputError(Fault(str(path), f"cannot be written ({error.strerror})")) from None


def virtual(
    out: str | Path,
    source: str | Path | None = None,
    *,
    overrides: Sequence[str] = (),
    truth: str = "yeoh",
    blocks: int | None = None,
) -> list[Path]:
    """Write virtual measurements for a design; the demo's by default.

    Parameters
    ----------
    out : str or Path
        Data root: the files get the names that the design gives them below it.
    source : str or Path, optional
        The design.
    truth : str
        Material behind the specimens: ``yeoh``, ``ogden`` or ``humphrey``.
    blocks : int, optional
        Number of specimens (or batches); 6 by default.
    """
    from importlib import resources

    from study.design import load, loads
    from study.runner.virtual import usual_generator, write_virtual

    if source is None:
        text = resources.files("study.runner").joinpath("demo.toml").read_text(encoding="utf-8")
        design = loads(text, "demo.toml", overrides)
    else:
        design = load(source, overrides)
    return write_virtual(
        design, Path(out), usual_generator(design, truth_name=truth, blocks=blocks)
    )
