"""A calibration without its data: which tables enter it, its name, and what starts it.

Cases share a fit when everything that decides it is the same: the calibrated problem, the
measured curve, the method and the code. A closed-form fit knows nothing of the modelling
space or the elements, so sixteen cells may share four of them.
"""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from study.external import command
from study.external.answers import PredictedCurve
from study.external.command import External, PythonFunction
from study.external.forward_model import (
    ForwardCell,
    ForwardFiles,
    ForwardModel,
    PlacedFile,
    target_and_source,
)
from study.ground.arrays import Array
from study.ground.bounded_file import UnreadableError, read_existing, sha256_of
from study.ground.canonical import Json, digest, plain
from study.ground.curve import Curve
from study.ground.declaration import document_of, table_of
from study.ground.errors import Fault, InputError, MissingDataError, nearest
from study.mechanics.calibration.residual_function import MeasuredCurve
from study.mechanics.material.material import ENERGIES, is_dimensionless
from study.mechanics.measurement.marker_states import read_markers
from study.mechanics.measurement.measurement_section import MeasurementSpec
from study.mechanics.measurement.recording import check_relative, locate, locate_pattern
from study.mechanics.setup.geometry import Block, Enclosed, Surface
from study.mechanics.setup.material_section import MaterialSection
from study.mechanics.setup.setup import Model, Problem
from study.mechanics.setup.test_kind import Test
from study.simulation.cell import Cell, CellProblem, tested
from study.simulation.provenance import code_version

# Programs and functions of a study: found, named, allowed, and asked for curves.

_WHERE = "forward.files"

#: bytes of a file that goes along with a case
MAX_BYTES = 2_000_000


@dataclass(frozen=True)
class Allowed:
    """What a run may use besides this package."""

    #: Whether commands may run; a text allows those whose digest begins with it.
    commands: bool | str = False
    #: What ``model = "python"`` stands for.
    function: PythonFunction | None = None


NOTHING = Allowed()


def placed_model(
    places: Sequence[Path], function: PythonFunction | None, section: ForwardModel
) -> ForwardModel:
    """Copy of a forward model that is not ours with what it is on this machine.

    Nothing is run: a program is known by the content of its file.
    """
    files = ForwardFiles()
    if section.model != "python":
        words = [argv[0] for argv in section.argv]
        # a program that should say its version and is missing says none, which is no fault
        words += filter(command.path_of, section.version[:1])
        programs = {word: command.path_of(word) for word in words}
        sources = map(target_and_source, section.files)
        files = ForwardFiles(
            tuple((word, _sha_of(path) if path else "") for word, path in programs.items()),
            tuple((target, _text(source, places)) for target, source in sources),
        )
    elif function is not None:
        files = ForwardFiles(function=function.text, function_version=function.version)
    return replace(section, installed=files)


def check_templates(problem: ForwardCell, case_id: str) -> None:
    """Render the templates of a case before anything runs, constants to be fitted as 1 MPa."""
    external = External.of(problem)
    if external is None or not external.section.rendered:
        return
    if not isinstance(problem, CellProblem):
        external.rendered({"case_id": case_id, **problem.own_tables()})
        return
    depth = problem.depth_mm or 1.0
    document = request(problem.with_placeholder(depth), np.array([depth]))
    section = problem.material
    names = dict.fromkeys(section.calibrated_names, 1.0) | dict(section.constants)
    material = {**table_of(document, "material"), "constants_MPa": names}
    context = _context_of({**document, "material": material, **problem.own_tables()})
    external.rendered({"case_id": case_id, **context})


def request(problem: Problem, displacement_mm: Array) -> dict[str, Json]:
    """Document of a problem, complete in itself. Shapes: displacement_mm (n,)."""
    material, test = problem.material, problem.test
    bulk = material.bulk
    indenter = None if test.indenter is None else plain(document_of(test.indenter))
    size_mm = None  # that our own mesh would have
    if not problem.setup.has_no_elements:
        from study.mechanics.mesh.mesher import mesh_size

        size_mm = float(mesh_size(problem.setup))
    return {
        "schema": 1,
        "specimen": plain(document_of(problem.specimen)),
        "test": {
            "kind": test.kind,
            "interface": test.interface,
            "base": test.base,
            "displacement_mm": float(displacement_mm[-1]),
            "steps": test.steps,
            "indenter": indenter,
        },
        "material": {
            "model": material.model,
            "constants_MPa": {k: float(v) for k, v in material.constants.items()},
            "mu0_MPa": material.mu0,
            "bulk_modulus_MPa": bulk if math.isfinite(bulk) else None,
        },
        "model": {**plain(document_of(problem.model)), "mesh_size_mm": size_mm},
        "displacement_mm": [float(d) for d in displacement_mm],
    }


def _context_of(request: Mapping[str, object]) -> dict[str, object]:
    """Names of a template: those of a request, with every constant under its own name."""
    material = table_of(request, "material")
    constants = table_of(material, "constants_MPa")
    named = {k if is_dimensionless(k) else f"{k}_MPa": v for k, v in constants.items()}
    others = {k: v for k, v in material.items() if k != "constants_MPa"}
    return {**request, "material": {**others, **named}}


def solved_by(
    external: External, problem: Problem, displacement_mm: Array, tables: Mapping[str, object]
) -> PredictedCurve:
    """Curve of a problem, shape (n,), by a program or function, which gets further tables too."""
    document = {**request(problem, displacement_mm), **tables}

    def context() -> dict[str, object]:
        return {"case_id": digest(document), **_context_of(document)}

    return external.solve(document, displacement_mm, context)


_sha_of = functools.cache(sha256_of)


def _text(name: str, places: Sequence[Path]) -> str:
    for folder in places:
        try:
            path = locate(name, folder, where=_WHERE)
            break
        except InputError:
            continue
    else:
        looked = " or ".join(repr(str(folder)) for folder in places)
        mend = "put it beside the design, and name it relative to that"
        raise InputError(Fault(_WHERE, f"there is no file {name!r} below {looked}", mend))
    try:
        text = read_existing(path, MAX_BYTES).decode("utf-8")
    except UnreadableError as error:
        mend = "name the program's own data by a path instead"
        raise InputError(Fault(_WHERE, f"{name!r} {error.rule}", mend)) from error
    except UnicodeDecodeError as error:
        raise InputError(Fault(_WHERE, f"{name!r} is no text in UTF-8")) from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


# Files of surfaces, markers and measurements: found and checked.

_SURFACE = "specimen.file"

#: depth of a test over the height where the measurements have to give it
_USUAL_DEPTH = 0.1


def folders(source: str | Path, root: Path) -> tuple[Path, ...]:
    """Where a surface may be: the data root first, as measurements; then beside the design."""
    home = [Path(source).resolve().parent] if Path(source).is_file() else []
    return tuple(dict.fromkeys(folder.resolve() for folder in (root, *home)))


def located(problem: CellProblem, places: Sequence[Path]) -> CellProblem:
    """Copy a problem with its surface found, and checked; another specimen has no file."""
    if not isinstance(problem.specimen, Surface):
        return problem
    from study.mechanics.solver.finite_element_solution import check

    placed = replace(problem, surface_file=_surface_file(problem.specimen, places))
    # Refuse what cannot be meshed or held, with placeholders for what a fit will find.
    depth = placed.depth_mm or _USUAL_DEPTH * (placed.height_mm or 1.0)
    check(placed.with_placeholder(depth, C10_MPa=0.005))
    return placed


def _surface_file(surface: Surface, places: Sequence[Path]) -> PlacedFile:
    from study.mechanics.surface.closed_surface import height_of

    path = find(surface.file, places)
    height = height_of(replace(surface, file=str(path)))
    return PlacedFile(str(path), sha256_of(path), height)


def located_cell(cell: Cell, places: Sequence[Path]) -> Cell:
    """Copy a cell with its surfaces and the file of its markers found."""
    other = cell.fitted_elsewhere
    if isinstance(other, CellProblem) and isinstance(other.specimen, Surface):
        other = replace(other, surface_file=_surface_file(other.specimen, places))
    problem = cell.problem
    if isinstance(problem, CellProblem):
        problem = _with_markers(located(problem, places), places)
    return replace(cell, problem=problem, fitted_elsewhere=other)


def _with_markers(problem: CellProblem, places: Sequence[Path]) -> CellProblem:
    spec, missing = problem.markers, list[Fault]()
    if spec is None:
        return problem
    for folder in places:
        try:
            path = locate(spec.file, folder, citation=spec.citation, where="markers.file")
        except MissingDataError as error:
            missing += error.faults
            continue
        if isinstance(problem.specimen, Block):  # what is wrong with it is told before a run
            read_markers(spec, path, problem.specimen)
        return replace(problem, marker_file=PlacedFile(str(path), sha256_of(path)))
    raise MissingDataError(missing[:1])


def find(name: str, places: Sequence[Path]) -> Path:
    """Path of a surface file in or below one of some folders."""
    check_relative(name, _SURFACE)
    for folder in places:
        with contextlib.suppress(MissingDataError):
            return locate(name, folder, where=_SURFACE)
    looked = " or ".join(repr(str(folder)) for folder in places)
    files = (path for folder in places for path in (folder / Path(name).parent).glob("*"))
    names = sorted(p.name for p in files if p.suffix.lower() in (".stl", ".ply", ".obj"))
    mend = nearest(Path(name).name, names[:20]) if names else "name its folder with --data DIR"
    raise InputError(Fault(_SURFACE, f"there is no file {name!r} below {looked}", mend))


def surface_notes(cells: Iterable[Cell]) -> tuple[str, ...]:
    """List what was mended in the surfaces of some cells, each once."""
    notes = dict[str, None]()
    for cell in cells:
        if isinstance(cell.problem, CellProblem) and isinstance(cell.problem.specimen, Surface):
            from study.mechanics.surface.closed_surface import body

            specimen = cell.problem.setup.specimen
            notes |= dict.fromkeys(body(specimen).notes if isinstance(specimen, Enclosed) else ())
    return tuple(notes)


def placed_files(cell: Cell) -> list[PlacedFile]:
    """Files of surfaces and markers that a cell uses, as they were found."""
    problems = [p for p in (cell.problem, cell.fitted_elsewhere) if isinstance(p, CellProblem)]
    files = (file for p in problems for file in (p.surface_file, p.marker_file))
    return [file for file in files if file is not None]


def data_root(
    source: str | Path, data: str | Path | None = None, named: Iterable[MeasurementSpec] = ()
) -> Path:
    """Folder that measurement files are relative to.

    Without a folder that the user named it is the first of three that holds the files:
    ``measurements/`` beside the design's folder, ``measurements/`` beside the design, the
    design's folder. Where none holds them it is the first that exists.
    """
    if data is not None:
        folder = Path(data)
        if not folder.is_dir():
            mend = "name the folder that holds the measurement files"
            raise InputError(Fault("--data", f"there is no folder {str(folder)!r}", mend))
        return folder
    home = Path(source).resolve().parent
    usual = [home.parent / "measurements", home / "measurements", home]
    there = [folder for folder in usual if folder.is_dir()]
    files = list(named)
    complete = [folder for folder in there if files and _holds(folder, files)]
    return next(iter([*complete, *there]), home)


def _holds(folder: Path, files: Iterable[MeasurementSpec]) -> bool:
    try:
        for spec in files:
            if spec.file is not None:
                locate(spec.file, folder)
            elif spec.files is not None:
                locate_pattern(spec.files, folder)
    except InputError:
        return False
    return True


def externals(problems: Iterable[ForwardCell]) -> list[External]:
    """Forward models of some problems that are not ours, each once."""
    models = (External.of(problem) for problem in problems)
    return list({model.digest: model for model in models if model is not None}.values())


def identity(problem: ForwardCell) -> list[str]:
    """Name of the external forward model of a case; empty where there is none."""
    return [model.digest for model in externals([problem])]


@dataclass(frozen=True)
class FitPart:
    """One test of a fit: how its curve is predicted, and the curves measured in it."""

    #: ``"closed-form"``, ``"inverse-fem"`` or ``"external"``.
    method: str
    #: What enters, and nothing else: equal fits have equal names.
    problem: CellProblem
    #: Of one or several specimens of equal size.
    measured: tuple[MeasuredCurve, ...] = ()
    #: The wanted problem, where this is a cheaper one.
    exact: CellProblem | None = None

    @property
    def curves(self) -> list[Curve]:
        """Measured rows of its curves."""
        return [each.curve for each in self.measured]

    @cached_property
    def name(self) -> list[object]:
        """Content of its name; a forward model that is not ours has a short one."""
        document = self.problem.document()
        return [self.method, {**document, "forward": identity(self.problem)}]


@dataclass(frozen=True)
class FitProblem:
    """A calibration without its data."""

    #: That of its test, ``"together"`` of several, or ``"none"``.
    method: str
    tests: tuple[FitPart, ...] = ()
    #: Whether the calibrated test is also the scored test.
    shares_scored_problem: bool = False

    @property
    def material(self) -> MaterialSection:
        """Energy that is fitted; with constants where the file gives those to start from."""
        return self.tests[0].problem.material


def fit_problem(cell: Cell) -> FitProblem:
    """Calibration of a cell; of parameters alone there is none."""
    scored, other = cell.problem, cell.fitted_elsewhere
    if cell.method == "none" or not isinstance(scored, CellProblem):
        return FitProblem("none")
    fitted = scored
    if isinstance(other, CellProblem):
        fitted = replace(
            scored, specimen=other.specimen, test=other.test, surface_file=other.surface_file
        )
    test = fitted_test(cell.method, fitted)
    return FitProblem(test.method, (test,), fitted == scored)


def fitted_test(test_name: str, problem: CellProblem) -> FitPart:
    """Test of a fit by the method that a file asks for, with what enters it alone."""
    method = _method(test_name, problem)
    if method == "closed-form":  # its mesh, depth, steps and base do not enter
        test = problem.test
        speed = test.speed_mm_per_s if problem.material.relaxation else None
        entering = Test(test.kind, speed_mm_per_s=speed, prestretch=test.prestretch)
        problem = replace(problem, test=entering, model=Model(), forward=None)
    alone = problem.alone()
    if method == "external":  # its program may read what the user gives besides
        alone = replace(alone, parameters=problem.parameters, units=problem.units)
    return FitPart(method, alone)


def together(cell: Cell, tests: Sequence[CellProblem]) -> FitProblem:
    """One fit to several tests, with the material and model of a case."""
    shared = tested(cell.problem)
    problems = [
        replace(shared, specimen=t.specimen, test=t.test, surface_file=t.surface_file)
        for t in tests
    ]
    return FitProblem("together", tuple(fitted_test(cell.method, each) for each in problems))


def _method(method: str, problem: CellProblem) -> str:
    if External.of(problem) is not None and method != "analytic":
        return "external"
    homogeneous = problem.is_homogeneous
    if method == "analytic" and not homogeneous:
        rule = "method = 'analytic' needs compression with both faces frictionless"
        raise InputError(Fault("calibration.method", rule, "use 'auto' or 'inverse-fem'"))
    if method == "inverse-fem" and not problem.setup.has_no_elements:
        return "inverse-fem"
    return "closed-form" if homogeneous else "inverse-fem"


def fit_key(problem: FitProblem, measured: Sequence[Curve]) -> str:
    """Name of a fit: a hash of the problem, the data and the code."""
    data = [curve.name for curve in measured]
    return digest([problem.method, [t.name for t in problem.tests], data, code_version()], 32)


def start_problem(problem: FitProblem) -> FitProblem | None:
    """Fit of the same test whose constants start this one: neo-Hookean, or one order lower.

    A third-order polynomial that starts from the neo-Hookean constant alone walks into
    constants that soften without end. Start values are thus a function of the case alone.
    """
    section = problem.material
    simulated = any(test.method == "inverse-fem" for test in problem.tests)
    if not simulated or section.constants:
        return None
    simpler = ENERGIES[section.model].simpler(section.order or 1)
    if simpler is None:
        return None
    model, order = simpler
    material = replace(section, model=model, order=order)
    tests = (replace(t, problem=replace(t.problem, material=material)) for t in problem.tests)
    return replace(problem, tests=tuple(tests))
