"""A problem, a calibration or a case for a device or another program; a body beside its scan."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study.api.comparison import explain
from study.api.predicting import opened, surfaces_of
from study.api.solving import solve
from study.ground.errors import Fault, InputError, nearest
from study.ground.files import UnreadableError, read_json, write_atomic
from study.harness.design import load
from study.harness.design.load import (
    REPORTS,
    RESULTS,
    finished_manifest,
    loaded_problem,
    results_folder,
)
from study.harness.design.spec import Design
from study.harness.runner.batch import cases_by_id
from study.laboratory.haptics import haptic_export
from study.laboratory.sensors.force_model import load_requirement
from study.laboratory.sensors.requirement import SensorRequirement, sensor_requirement
from study.laboratory.shape import shape_deviation
from study.laboratory.shape.boundary import DeformedMesh, SimulatedBody, body_of_mesh, read_body
from study.laboratory.tracker.tracker_error import TrackerAccuracy, judge_tracker
from study.laboratory.tracker.tracker_recording import load_tracking
from study.mechanics.material import input_file
from study.mechanics.material.material import Material, is_dimensionless
from study.mechanics.material.stability import check, stability
from study.record.record import Record
from study.record.store import Store
from study.reporting.content.text import THIN, duration, slug
from study.reporting.output import laboratory_pages as pages
from study.simulation.cell import CellProblem, tested
from study.simulation.job import data_root, folders, located
from study.simulation.problem_file import default_name
from study.simulation.tasks import Costs, default_jobs
from study.statistics.analysis.analysis_result import AnalysisResult
from study.statistics.analysis.anova import anova
from study.statistics.surfaces.surface_function import surface_functions

if TYPE_CHECKING:
    import pandas as pd

    from study.api.assemble import Study
    from study.ground.arrays import Array

# A material as the input of another program: ``study export --as abaqus`` and ``--as febio``.

#: what writes a material, and the ending of its file, by the name of the program
PROGRAMS: Mapping[str, tuple[Callable[[Material, str], str], str]] = {
    "abaqus": (input_file.abaqus_text, ".inp"),
    "febio": (input_file.febio_text, ".feb"),
}


@dataclass(frozen=True)
class Export:
    """What was written for a device or another program, and what must be known of it."""

    #: Document of ``study export --json``.
    document: Mapping[str, object]
    sentences: tuple[str, ...]
    #: JSON, CSV, Python module, C header and report page of a law; the input file of a material.
    paths: tuple[Path, ...]
    #: Such as a tolerance that is not met.
    warnings: tuple[str, ...]
    #: The law, where one was made.
    law: haptic_export.ForceLaw | None = None


def _exported(
    content: Mapping[str, object],
    lines: Sequence[str],
    paths: Sequence[Path],
    warnings: Sequence[str],
    law: haptic_export.ForceLaw | None = None,
) -> Export:
    """Make the result of an export whose files are told apart by their endings."""
    by_ending = {path.suffix.removeprefix("."): str(path) for path in paths}
    whole = {**content, "files": by_ending, "warnings": list(warnings)}
    return Export(whole, tuple(lines), tuple(paths), tuple(warnings), law)


def export_material(title: str, material: Material, program: str, folder: Path) -> Export:
    """Write a material for another program: its keyword, units, Drucker's criterion."""
    name = input_file.material_name(title)
    check(material, None)
    write, ending = PROGRAMS[program]
    text, converted = write(material, name), input_file.convert(material, program)
    judged = stability(material)
    warnings = () if judged.stable else (f"{judged.sentence}: Abaqus warns of it, FEBio does not",)
    path = folder / f"{name}{ending}"
    write_atomic(path, text.encode())
    notes = input_file.remarks(material, converted)
    content = {
        "name": name,
        "program": converted.convention,
        "keyword": converted.keyword,
        "constants": dict(converted.constants),
        "text": text,
        "remarks": list(notes),
    }
    return _exported(content, (f"{name}: {converted.keyword}", *notes), (path,), warnings)


# What a verb about one simulation is given: a problem file, a calibration, a case of a study.

#: Half ranges of calibrated constants over their standard errors.
STANDARD_ERRORS = 2.0
#: Largest half range over the constant itself.
LARGEST_SHARE = 0.5


@dataclass(frozen=True)
class _Source:
    """A problem from whatever holds it, and what is known of its constants.

    Its material is exported without a displacement, which the problem of a force law needs.
    """

    #: Of the file, the calibration, or the study and its case.
    name: str
    problem: CellProblem
    #: Constants that were fitted and their standard errors, MPa (exponents plain); none where the
    #: problem states its own.
    values: Mapping[str, float] = field(default_factory=dict)
    errors: Mapping[str, float] = field(default_factory=dict)
    correlation: Array | None = None

    @property
    def material(self) -> Material:
        """Material with the constants."""
        return self.problem.material.material(self.values or None)

    def of_law(self) -> haptic_export.ForceLawSource:
        """Problem of a force law: constants are not moved so far that the material is another."""
        half_ranges = {
            name: min(STANDARD_ERRORS * error, LARGEST_SHARE * abs(self.values[name]))
            for name, error in self.errors.items()
            if np.isfinite(error) and error > 0
        }
        covariance = None
        if self.correlation is not None and np.isfinite(self.correlation).all():
            size = np.array(list(self.errors.values()))
            covariance = np.outer(size, size) * self.correlation
        problem = self.problem.at(self.values or None)
        return haptic_export.ForceLawSource(self.name, problem, half_ranges, covariance)


def _written(path: Path, overrides: Sequence[str]) -> _Source:
    """Problem of a file."""
    kind = load.file_kind(path)
    if kind == "calibration":
        rule = "is a calibration that has not been made"
        mend = f"run `study calibrate {path}` and export its calibration.json"
        raise InputError(Fault(str(path), rule, mend))
    if kind == "design":
        mend = "run it and name one: study export results/NAME --case ID"
        raise InputError(Fault(str(path), "is a design of many cases", mend))
    return _Source(default_name(str(path)), loaded_problem(path, overrides).problem)


def _calibrated(path: Path, number: int) -> _Source:
    """Test of a calibration that converged, with the constants and their correlation."""
    mend = "name the calibration.json that `study calibrate` wrote"
    try:
        contents = read_json(path)
    except UnreadableError as error:
        raise InputError(Fault(str(path), error.rule, mend)) from None
    needed = {"status", "name", "parameters", "correlation", "tests"}
    if not isinstance(contents, Mapping) or not needed <= set(contents):
        raise InputError(Fault(str(path), "is no document of a calibration", mend))
    if contents["status"] != "converged":
        rule = f"ended as {contents['status']}: its constants are no result"
        raise InputError(Fault(str(path), rule, "see its message"))
    name, tests = str(contents["name"]), contents["tests"]
    if not 1 <= number <= len(tests):
        rule = f"there is no test {number} in {path}, which has {len(tests)}"
        raise InputError(Fault("--test", rule, f"1 to {len(tests)}"))
    return _Source(
        f"{name}-test-{number}" if len(tests) > 1 else name, CellProblem.of(tests[number - 1]),
        *_constants(contents["parameters"]),
        # null, where a correlation is not known, becomes NaN
        np.array(contents["correlation"], dtype=float),
    )  # fmt: skip


def _recorded(path: Path, case: str) -> _Source:
    """Case of a study that was run, with the constants of its fit."""
    folder = results_folder(path)
    if not case:
        mend = "name one of its cases: --case ID (see `study why`)"
        raise InputError(Fault(str(path), "is a study of many cases", mend))
    record = explain(case, study=folder).record
    manifest = finished_manifest(Store(folder))
    if not record.converged:
        rule = f"the case ended as {record.status}: {record.message}"
        raise InputError(Fault(f"--case {case}", rule, "name one that has an answer"))
    design = load.loads(manifest["design"], manifest["source"])
    cell = _problem_of(record, design, manifest["blocks"])
    values, errors = _constants({n: p for n, p in record.parameters.items() if n != "mu0"})
    cell = located(cell, folders(design.source, folder))
    return _Source(f"{design.name}-{record.case_id[:8]}", cell, values, errors)


def _problem_of(record: Record, design: Design, blocks: Sequence[str]) -> CellProblem:
    """Problem of the cell that a case is of, or repeats on another mesh."""
    case = cases_by_id(design, blocks).get(record.case_id)
    if case is not None:
        return case.tested
    for treatment in design.treatments:
        if treatment.levels == record.levels:
            return tested(treatment.cell.problem)
    mend = "name another of its cases (see `study why`)"
    raise InputError(Fault(f"--case {record.case_id}", "is of no cell of the design", mend))


def _constants(
    parameters: Mapping[str, Mapping[str, object]],
) -> tuple[dict[str, float], dict[str, float]]:
    """Values and standard errors in MPa (exponents plain) of parameters in kPa; NaN for null."""

    def numbers(key: str) -> dict[str, float]:
        values = {name: parameter.get(key) for name, parameter in parameters.items()}
        return {
            name: float("nan") if v is None else float(str(v)) * (is_dimensionless(name) or 1e-3)
            for name, v in values.items()
        }

    return numbers("value"), numbers("standard_error")


#: What a result can be exported as.
FORMS = ("force-law", "emulator", *PROGRAMS)


def export(
    source: str | Path,
    *,
    form: str = "force-law",
    case: str = "",
    test: int = 1,
    overrides: Sequence[str] = (),
    tolerance: float = haptic_export.TOLERANCE,
    out: str | Path = REPORTS,
    progress: Callable[[str], None] | None = None,
) -> Export:
    """Turn a simulated test into a function, or its material into input of another program.

    Parameters
    ----------
    source : str or Path
        Problem file, ``calibration.json`` of a calibration, or the results of a study.
    form : {"force-law", "abaqus", "febio"}
        What it becomes: a function of displacement and constants, or lines of an input file.
    case : str
        Case of a study, by the beginning of its id.
    test : int
        Number of the test of a calibration, from 1.
    overrides : sequence of str
        ``key=value`` each, laid over a problem file.
    tolerance : float
        Wanted error bound over the largest force.
    out : str or Path
        Folder of the files; made where it is missing.
    progress : callable, optional
        Gets a sentence after every solution.

    Returns
    -------
    Export
        What was written, with the law where one was made.

    Raises
    ------
    InputError
        For a faulty source, a simulation that does not reach its end, or a program that has no
        such energy; nothing is written.
    """
    if form not in FORMS:
        raise InputError(Fault("--as", f"no form {form!r}", nearest(form, FORMS)))
    if form == "emulator":
        rule = "is a function of the ranges of a study, not of one test"
        raise InputError(Fault("--as", rule, "use study.export_surface"))
    if not 0 < tolerance < 1:
        rule = f"must be a share between 0 and 1, got {tolerance:g}"
        raise InputError(Fault("--tolerance", rule, "for example 0.002"))
    path = Path(source)
    if path.suffix == ".json":
        read = _calibrated(path, test)
    elif path.suffix == ".toml" and path.is_file() and not case:
        read = _written(path, overrides)
    else:
        read = _recorded(path, case)
    if form in PROGRAMS:
        return export_material(read.name, read.material, form, Path(out))
    check(read.material, None)
    law = haptic_export.solved_force_law(read.of_law(), tolerance, progress)
    warnings = []
    if law.relative_error > tolerance:
        warnings.append(
            f"the error bound is {100 * law.relative_error:.2g} % of the largest force, not "
            f"{100 * tolerance:.2g} %: a finer mesh bends the curve less where contact begins"
        )
    folder = Path(out)
    texts = haptic_export.files(law, folder)
    for path, text in texts.items():
        write_atomic(path, text.encode())
    question = "How does the force follow from displacement and constants?"
    page = pages.write_force_law(law, question, folder, tuple(warnings))
    return _exported(law.to_json(), law.sentences(), (*texts, page), warnings, law)


# What the sensors of a test must be for constants as accurate as wanted.


#: solutions that a simulated test takes: its own, and those of the fit to it
SOLUTIONS_A_TEST = 6


def require(
    source: str | Path,
    *,
    overrides: Sequence[str] = (),
    jobs: int | None = None,
    out: str | Path = REPORTS,
    progress: Callable[[str], None] | None = None,
) -> SensorRequirement:
    """Say how uncertain sensors make constants and force, and what they must be.

    Parameters
    ----------
    source : str or Path
        A problem with its assumed constants, and tables ``[position]``, ``[force]``,
        ``[requirement]`` and ``[predict]``.
    overrides : sequence of str
        ``key=value`` each, laid over the file before it is validated.
    jobs : int, optional
        Workers of the Monte Carlo simulation; one a core by default.
    out : str or Path
        Folder of the page; made where it is missing.
    progress : callable, optional
        Gets a sentence after every part of the simulation.

    Returns
    -------
    SensorRequirement
        The numbers, and the page that was written.

    Raises
    ------
    InputError
        For a faulty file; nothing is written.
    RefusedError
        If the test does not determine the constants.
    """
    file = load_requirement(source, load.problem_of, overrides)
    places = folders(source, data_root(source))
    fitted, predicted = (located(p, places) for p in (file.fitted, file.predicted))
    file = replace(file, fitted=fitted, predicted=predicted)
    workers = jobs or default_jobs()
    tests = file.requirement.samples * len(file.requirement.multiples)
    if progress is not None and tests:
        seconds = tests * SOLUTIONS_A_TEST * Costs().solve_seconds(fitted) / workers
        time = duration(seconds).replace(THIN, " ")
        progress(f"{tests} simulated tests on {workers} workers, predicted to take {time}")
    sensors = sensor_requirement(file, workers, progress)
    page = pages.write_requirement(sensors, out)
    return replace(sensors, report=str(page), warnings=tuple(pages.warnings(sensors)))


# The surfaces of a study as functions that need no package.


def export_surface(
    path: str | Path | Study,
    *,
    response: str | None = None,
    out: str | Path = REPORTS,
    results: Path = RESULTS,
) -> Export:
    """Write the surfaces of a study as JSON and as Python modules that import nothing.

    Parameters
    ----------
    path : str, Path or Study
        Results folder, design file, name of the study, or the study itself.
    response : str, optional
        One response alone.
    out : str or Path
        Folder of the files; made where it is missing.
    results : Path
        Folder of the results, where ``path`` is a name.

    Returns
    -------
    Export
        The functions, each with its error bound, and the files that were written.

    Raises
    ------
    InputError
        If the study has no surface, or not that response; nothing is written.
    """
    study = opened(path, results)
    chosen = surfaces_of(study, response)
    if all(fitted.surface is None for fitted in chosen):
        rule = "has no surface that could be a function"
        raise InputError(Fault(study.design.name, rule, chosen[0].refused))
    functions = surface_functions(study.design.name, study.surfaces, response)
    folder = Path(out)
    texts: dict[Path, str] = {}
    for function in functions:
        texts |= haptic_export.surface_files(function, function.name, function.sentences(), folder)
    for file, text in texts.items():
        write_atomic(file, text.encode())
    missing = tuple(
        f"{surface.response}: {surface.refused}" for surface in chosen if surface.surface is None
    )
    paths = {"files": [str(file) for file in texts], "warnings": list(missing)}
    content = {"functions": [function.to_json() for function in functions], **paths}
    lines = tuple(sentence for function in functions for sentence in function.sentences())
    return Export(content, lines, tuple(texts), missing)


# Deviation of a simulated body from a scan, and accuracy of a tracker.


def shape(
    simulation: str | Path,
    scan: str | Path,
    *,
    markers: str | Path | None = None,
    unit: str = "mm",
    surface_unit: str = "mm",
    options: shape_deviation.ShapeOptions | None = None,
    overrides: Sequence[str] = (),
    reports: str | Path | None = None,
) -> shape_deviation.ShapeDeviation:
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
    cloud = shape_deviation.read_scan(Path(scan), unit, body.deformed.size)
    marked = None if markers is None else shape_deviation.read_markers(Path(markers), unit)
    name = default_name(str(simulation))
    deviation = shape_deviation.judge_shape(
        name, body, cloud, marked, options or shape_deviation.ShapeOptions()
    )
    if reports is None:
        return deviation
    return replace(deviation, report=str(pages.write_shape(deviation, Path(reports) / slug(name))))


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
    root, name = data_root(source, data), default_name(str(source))
    accuracy = judge_tracker(declared, root, name, _compared_stages)
    if reports is None:
        return accuracy
    page = pages.write_tracker(accuracy, Path(reports) / slug(accuracy.name))
    return replace(accuracy, report=str(page))


def _compared_stages(table: pd.DataFrame, practical: float | None, alpha: float) -> AnalysisResult:
    """Compare the means of visits between stages, within passes where there are any."""
    block = "pass" if "pass" in table else None
    return anova(table, "distance", ["stage"], block=block, practical=practical, alpha=alpha)
