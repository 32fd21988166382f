"""One simulation, virtual measurements."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from study.api.folders import data_root
from study.design.load import load, load_calibration, load_problem, loads, template
from study.errors import Fault, InputError
from study.forward import closed_form
from study.material.stability import check
from study.record.atomic_files import write_atomic
from study.record.record import plain
from study.reporting.figure.curves import FitPanel, fit_figure
from study.reporting.figure.meshes import picture
from study.runner import provenance
from study.runner.calibration.calibrate import calibrate as run_calibration
from study.runner.calibration.model_selection import choose
from study.runner.virtual.gauge_section import write_tests
from study.runner.virtual.specimens import usual_generator, write_virtual
from study.setup.setup import Problem, ResolvedTables, problem_of

if TYPE_CHECKING:
    from study.fem.solver.solution import Solution
    from study.runner.calibration.model_selection import EnergyChoice
    from study.runner.calibration.result import CalibrationResult
    from study.runner.fitting.staged_fit import Step
    from study.setup.setup import Problem


def solve(
    problem: Problem | ResolvedTables | str | Path,
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
    overrides : sequence of str
        ``key=value`` each, laid over the file before it is validated.
    gradients : bool
        Whether dF/d(constant) is computed too.
    progress : callable, optional
        Called with the fraction that is done.

    Returns
    -------
    Solution
        Curve in mm and N, with gradients, energy balance, mesh and status.

    Raises
    ------
    InputError
        For a faulty problem, or constants that make an unstable material.
    """
    from study.fem.solver.solve import solve as forward_solve

    made = _problem(problem, overrides)
    if made.setup.has_no_elements:
        return closed_form.solution(made)
    return forward_solve(made, gradients=gradients, progress=progress)


def _problem(problem: Problem | ResolvedTables | str | Path, overrides: Sequence[str]) -> Problem:
    if not isinstance(problem, Problem):
        config = problem
        if not isinstance(config, Mapping):
            places = provenance.folders(config, data_root(config))
            config = provenance.located(load_problem(config, overrides), places)
        problem = problem_of(config)
    _judge(problem)
    return problem


def _judge(problem: Problem) -> None:
    """Refuse constants that are unstable on the way, before anything is meshed."""
    import numpy as np

    height = float(getattr(problem.specimen, "height_mm", 0.0))
    depth = problem.test.depth_mm
    compressed = problem.test.kind == "compression" and depth < height
    check(problem.material, np.linspace(1 - depth / height, 1, 41) if compressed else None)


def solution_json(solution: Solution) -> dict[str, object]:
    """Document of ``study solve --json``."""
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
    from study.fem.fields import write_vtu as write

    write(solution, path)


def write_picture(solution: Solution, path: str | Path) -> None:
    """Draw the mesh of a solution before and after its deformation.

    Raises
    ------
    InputError
        If there is nothing to draw, or the file cannot be written.
    """
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

    if source is None:
        text = resources.files("study.runner").joinpath("demo.toml").read_text(encoding="utf-8")
        design = loads(text, "demo.toml", overrides)
    else:
        design = load(source, overrides)
    return write_virtual(
        design, Path(out), usual_generator(design, truth_name=truth, blocks=blocks)
    )


def new_file(file: str | Path, *, calibration: bool = False) -> list[Path]:
    """Write a commented file to start from.

    Parameters
    ----------
    file : str or Path
        Its name; nothing is overwritten.
    calibration : bool
        Whether it is a calibration, with virtual measurements in ``tests-of-material/`` beside
        it, instead of a design.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    FileExistsError
        If one of the files exists.
    """
    path = Path(file)
    with path.open("x", encoding="utf-8") as stream:
        stream.write(template("calibration" if calibration else "template"))
    return [path, *(write_tests(path.parent / "tests-of-material") if calibration else ())]


def calibrate(
    source: str | Path,
    *,
    data: str | Path | None = None,
    overrides: Sequence[str] = (),
    results: Path | None = None,
    progress: Callable[[Step], None] | None = None,
    profiles: bool = False,
) -> CalibrationResult:
    """Find material constants from one or several measured tests.

    Parameters
    ----------
    source : str or Path
        Calibration file.
    data : str or Path, optional
        Folder of the measurements.
    overrides : sequence of str
        ``key=value`` each, laid over the file before it is validated.
    results : Path, optional
        Where accepted iterations are kept while it runs (an interrupted calibration goes on
        from there), and the document and the figure in the end; nothing is written without.
    progress : callable, optional
        Gets every accepted iteration.
    profiles : bool
        Whether profile-likelihood intervals are computed.

    Returns
    -------
    CalibrationResult
        Constants with intervals, stability, residuals and how the search ended.

    Raises
    ------
    InputError
        For a faulty file or faulty data.
    """
    config = load_calibration(source, overrides)
    config = provenance.located(config, provenance.folders(source, data_root(source, data)))
    folder = None if results is None else results / config["name"]
    found = run_calibration(
        config, data_root(source, data), progress=progress, profiles=profiles, folder=folder
    )
    if folder is not None:
        save_calibration(found, folder)
    return found


def choose_energy(
    source: str | Path,
    *,
    data: str | Path | None = None,
    overrides: Sequence[str] = (),
    progress: Callable[[Step], None] | None = None,
) -> EnergyChoice:
    """Fit every energy to the tests of a calibration and weigh them by AICc.

    Raises
    ------
    InputError
        For a faulty file or faulty data.
    """
    config = load_calibration(source, overrides)
    return choose(config, data_root(source, data), progress=progress)


def save_calibration(found: CalibrationResult, folder: Path) -> tuple[Path, Path]:
    """Write the document and the figure of a calibration; returns both paths."""
    folder.mkdir(parents=True, exist_ok=True)
    document, figure = folder / "calibration.json", folder / "calibration.svg"
    text = json.dumps(found.to_json(), indent=2, allow_nan=False)
    write_atomic(document, text.encode())
    write_atomic(figure, calibration_figure(found).encode())
    return document, figure


def calibration_figure(found: CalibrationResult) -> str:
    """Every measured curve with its fit, as SVG."""
    panels = [
        FitPanel(
            curve.file if curve.specimen is None else f"{curve.file}, {curve.specimen}",
            curve.role == "fit",
            curve.measured.curve.displacement_mm,
            curve.measured.curve.force_N,
            None
            if curve.predicted is None
            else curve.predicted.force_at(curve.measured.curve.displacement_mm),
            curve.measured.scatter_N,
        )
        for curve in found.curves
    ]
    return fit_figure(panels, f"{found.name}: {found.model}, {found.status}")
