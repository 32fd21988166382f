"""The verb shape: deviation of a simulated body from a scan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from study.api.folders import data_root
from study.api.solving import solve
from study.ground.errors import Fault, InputError
from study.harness.design.load import default_name
from study.laboratory.shape.boundary import DeformedMesh, SimulatedBody, body_of_mesh, read_body
from study.laboratory.shape.scan import read_markers, read_scan
from study.laboratory.shape.shape_deviation import ShapeDeviation, ShapeOptions, judge_shape
from study.laboratory.tracker.tracker_error import TrackerAccuracy, judge_tracker
from study.laboratory.tracker.tracker_recording import load_tracking
from study.reporting.figures.registry import slug
from study.reporting.output.accuracy_page import shape_page, tracker_page, write_accuracy


def shape(
    simulation: str | Path,
    scan: str | Path,
    *,
    markers: str | Path | None = None,
    unit: str = "mm",
    surface_unit: str = "mm",
    options: ShapeOptions | None = None,
    overrides: Sequence[str] = (),
    reports: str | Path | None = None,
) -> ShapeDeviation:
    """Compare a simulated, deformed body with a scan of the real one.

    Parameters
    ----------
    simulation : str or Path
        Problem file, which is solved; VTU file of ``study solve --vtu``; or the deformed surface
        as STL, PLY or OBJ.
    scan : str or Path
        Cloud or surface: PLY, STL or OBJ, or CSV with columns x, y, z.
    markers : str or Path, optional
        CSV of marked points in the frame of the scan: x, y, z, and x0, y0, z0 at rest.
    unit : str
        Unit of scan and markers.
    surface_unit : str
        Unit of a simulated surface file.
    options : Options, optional
        Whether to register, and to compare a scan of another state.
    overrides : sequence of str
        ``key=value`` each, laid over a problem file.
    reports : Path, optional
        Where the page is written; nothing is written without.

    Returns
    -------
    ShapeDeviation
        What was found; ``to_json()`` gives plain values.

    Raises
    ------
    InputError
        For faulty files, another unit, a mirrored scan, or a simulation that did not converge.
    RefusedError
        For a scan that another state of the body fits far better.
    """
    for path, where in ((simulation, "simulation"), (scan, "--scan"), (markers, "--markers")):
        if path is not None and not Path(path).is_file():
            raise InputError(Fault(where, f"there is no file {str(path)!r}", "check the path"))
    body = _body(Path(simulation), surface_unit, overrides)
    cloud = read_scan(Path(scan), unit, body.deformed.size)
    marked = None if markers is None else read_markers(Path(markers), unit)
    name = default_name(str(simulation))
    deviation = judge_shape(name, body, cloud, marked, options or ShapeOptions())
    if reports is None:
        return deviation
    return replace(
        deviation, report=str(write_accuracy(shape_page(deviation), Path(reports) / slug(name)))
    )


def _body(path: Path, surface_unit: str, overrides: Sequence[str]) -> SimulatedBody:
    """Body of a problem, which is solved, or of a file."""
    from study.mechanics.solver.finite_element_solution import fields

    if path.suffix.lower() != ".toml":
        return read_body(path, surface_unit)
    solution = solve(path, overrides=overrides, gradients=False)
    if solution.status != "converged":
        rule = f"the simulation ended early: {solution.message}"
        mend = "a scan belongs to the whole displacement: change steps, mesh or displacement"
        raise InputError(Fault(str(path), rule, mend))
    solved = fields(solution)
    return body_of_mesh(DeformedMesh(solved.points, solved.displacement, solved.kind, solved.cells))


# The verb tracking: accuracy of a tracker.


def tracking(
    source: str | Path, *, data: str | Path | None = None, reports: str | Path | None = None
) -> TrackerAccuracy:
    """Judge a tracker: fixed distances, commanded displacements, a better instrument.

    Parameters
    ----------
    source : str or Path
        TOML file with ``[recording]`` and at least one of ``[distance]``, ``[displacement]``
        and ``[reference]``.
    data : str or Path, optional
        Folder that measured files are relative to; by default ``measurements`` beside the
        folder of the file, or that folder.
    reports : Path, optional
        Where the page is written; nothing is written without.

    Returns
    -------
    TrackerAccuracy
        What was found; ``to_json()`` gives plain values.

    Raises
    ------
    InputError
        For a faulty file or faulty data, with everything that is wrong.
    """
    declared = load_tracking(source)
    accuracy = judge_tracker(declared, data_root(source, data), default_name(str(source)))
    if reports is None:
        return accuracy
    page = write_accuracy(tracker_page(accuracy), Path(reports) / slug(accuracy.name))
    return replace(accuracy, report=str(page))
