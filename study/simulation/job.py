"""The jobs of a study: what a case or a fit needs, found on this machine, as values of one name.

Programs, functions and files are found and allowed; a fit has a problem without its data, and its
result; measurements, cases and fits become values that know what they need. Cases share a fit when
everything that decides it is the same: the calibrated problem, the measured curve, the method and
the code. A closed-form fit knows nothing of the modelling space or the elements, so sixteen cells
may share four of them.
"""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, cast

import numpy as np

from study.external import command
from study.external.answers import NoAnswer, PredictedCurve
from study.external.command import External, PythonFunction, steps_of
from study.external.forward_model import (
    ForwardCell,
    ForwardFiles,
    ForwardModel,
    PlacedFile,
    target_and_source,
)
from study.ground.arrays import Array
from study.ground.canonical import Json, digest, plain
from study.ground.curve import Curve
from study.ground.declaration import document_of, table_of
from study.ground.errors import Fault, InputError, MissingDataError, nearest
from study.ground.files import UnreadableError, read_existing, sha256_of
from study.mechanics.calibration.fit import Fit
from study.mechanics.calibration.levenberg_marquardt import Status
from study.mechanics.calibration.residual_function import EvaluationFailed, MeasuredCurve
from study.mechanics.forward.finite_element import Anchor
from study.mechanics.forward.formal_order import FormalOrder as FormalOrder
from study.mechanics.forward.formal_order import element_size_mm, formal_order
from study.mechanics.material.homogeneous import MODES, sheared_stretches
from study.mechanics.material.material import ENERGIES, Material, is_dimensionless
from study.mechanics.material.stability import StabilityResult, ellipticity_end, stability
from study.mechanics.measurement.conditioning import is_caution
from study.mechanics.measurement.marker_states import read_markers
from study.mechanics.measurement.measured_test import MeasuredTest, Measurements, Selection, checked
from study.mechanics.measurement.measurement_section import MeasurementSpec
from study.mechanics.measurement.reading import read_measurements
from study.mechanics.measurement.recording import (
    Recordings,
    check_relative,
    locate,
    locate_pattern,
    read_recordings,
)
from study.mechanics.setup.calibration_table import NOTHING as calibration_NOTHING
from study.mechanics.setup.geometry import Block, Enclosed, Surface
from study.mechanics.setup.material_section import MaterialSection
from study.mechanics.setup.setup import Model, Problem, Setup
from study.mechanics.setup.test_kind import Test
from study.record.record import (
    WITH_CONSTANTS,
    FitDocument,
    MeshDocument,
    Record,
    ResponseDocument,
    SolverDocument,
)
from study.simulation.cell import Case, Cell, CellProblem, Config, case_id, tested
from study.simulation.provenance import code_version, versions

if TYPE_CHECKING:
    from study.mechanics.solver.solution import Solution


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


# What became of a fit: constants with all that is known of them, or why there are none.


def status_of(fit: Fit) -> str:
    """How a fit ended, in the words of every verb."""
    if fit.status in (Status.at_edge, Status.at_kink):
        return fit.status.name.replace("_", "-")
    return "converged" if fit.converged else "not-converged"


@dataclass(frozen=True)
class FitResult:
    """Outcome of a fit, as the store keeps it and cases read it."""

    #: ``"converged"``, ``"at-edge"``, ``"at-kink"``, or the reason why there are no constants.
    status: str
    #: What is known of it; of a fit without constants its message alone.
    fit: FitDocument
    #: Last solution of an inverse fit of one test: the curve of the final constants.
    prediction: PredictedCurve | None = None
    #: What the fit took that gave the start.
    start_seconds: float = 0.0

    @property
    def converged(self) -> bool:
        """Whether it found constants, if without standard errors."""
        return self.status in WITH_CONSTANTS

    @property
    def usable(self) -> bool:
        """Whether its constants are stable over the range of the test."""
        return self.converged and self.fit.get("usable", True)

    @property
    def message(self) -> str:
        """How it ended."""
        return self.fit.get("message", "")

    @property
    def constants(self) -> dict[str, float]:
        """Constants in MPa, exponents plain; none where it did not converge."""
        return self.fit.get("values", {})

    @property
    def seconds(self) -> float:
        """What it took, the fit before it left out."""
        return self.fit.get("seconds", 0.0)

    def to_json(self) -> dict[str, object]:
        """Plain data with all keys side by side."""
        predicted = {} if self.prediction is None else self.prediction.to_json()
        plain = {"status": self.status, "start_seconds": self.start_seconds}
        return {**plain, **self.fit, **predicted}

    @classmethod
    def from_json(cls, document: Mapping[str, object]) -> FitResult:
        """Inverse of :meth:`to_json`; a task that had no answer has a status and a message."""
        fields_read = {k: v for k, v in document.items() if k in FitDocument.__annotations__}
        return cls(
            str(document["status"]),
            cast(FitDocument, fields_read),
            PredictedCurve.from_json(document) if "curve" in document else None,
            cast(float, document.get("start_seconds", 0.0)),
        )


def described(fit: Fit, problem: CellProblem, measured: Sequence[Curve]) -> FitDocument:
    """Describe a fit."""
    names = fit.names
    document: FitDocument = {
        "message": fit.message,
        "names": list(names),  # JSON sorts keys; the matrices need their order
        "values": fit.constants(),
        "standard_error": {n: _finite(v) for n, v in zip(names, fit.standard_error, strict=True)},
        "ci95": {n: _row(pair) for n, pair in zip(names, fit.ci95, strict=True)},
        "correlation": [_row(row) for row in fit.correlation],
        "condition": _finite(fit.condition),
        "rss": _finite(fit.rss),
        "r_squared": _finite(fit.r_squared),
        "aicc": _finite(fit.aicc),
        "n": int(fit.n),
        "identifiable": bool(fit.identifiable) and fit.converged,
        "reason": str(fit.reason),
        "evaluations": int(fit.evaluations),
    }
    if fit.status.usable:
        document.update(_stability(problem, fit.constants(), measured))
    return document


def _stability(
    problem: CellProblem, constants: Mapping[str, float], measured: Sequence[Curve]
) -> FitDocument:
    """Mu0 and whether the material is stable over the range that was measured."""
    material = problem.material.material(constants)
    if material.mu0 <= 0:
        raise InputError(Fault("fit", f"ended at a shear modulus of {material.mu0:g} MPa"))
    judged = stability_over(
        material, [(problem.setup, curve.displacement_mm) for curve in measured]
    )
    # only uniaxial failure inside the range makes the answer itself meaningless; the other
    # modes are a warning about using the constants elsewhere
    return {
        "mu0": float(material.mu0),
        "stable": bool(judged.stable),
        "stability": str(judged.sentence),
        "usable": "uniaxial" not in judged.limits,
    }


def judged_where_simulated(fit: FitDocument, problem: CellProblem, depth_mm: float) -> FitDocument:
    """Fit with what makes it unstable or not elliptic in the simulated test, beyond its data."""
    if not fit.get("stable", False):
        return fit
    material = problem.material.material(fit["values"])
    judged = stability_over(material, [(problem.setup, np.array([depth_mm]))])
    if judged.stable:
        return fit
    beyond = f"over its data: {fit['stability']}; in the simulated test: {judged.sentence}"
    return {**fit, "stable": False, "stability": beyond}


def stability_over(material: Material, tests: Sequence[tuple[Setup, Array]]) -> StabilityResult:
    """Drucker's criterion over the stretches of tests, each in its loading, and in the others.

    A loading that no test holds is judged over the stretches of all of them. Ellipticity is judged
    in the loadings that they hold.
    """
    held: dict[str, tuple[float, float]] = {}
    for setup, places in tests:
        height, kind = setup.height_mm, setup.kind
        mode = "planar" if kind.shears else kind.mode
        if height is None or mode not in MODES or kind.takes_indenter:
            continue
        share = kind.sense * np.array([0.0, places.min(), places.max()]) / height
        ends = sheared_stretches(share, setup.test.prestretch or 1.0) if kind.shears else 1 + share
        low, high = float(np.min(ends)), float(np.max(ends))
        if low <= 0:
            continue
        before = held.get(mode, (1.0, 1.0))
        held[mode] = (min(low, before[0]), max(high, before[1]))
    if not held:
        return stability(material)
    judged = stability(material, np.array(list(held.values())), held)
    lost = [
        f"in {name} loading at stretch {end:.4g}"
        for name, ends in held.items()
        if (end := ellipticity_end(material, MODES[name], *ends)) is not None
    ]
    if not lost:
        return judged
    sentence = f"{judged.sentence}; not elliptic {', '.join(lost)}"
    return replace(judged, stable=False, sentence=sentence)


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _row(values: Array) -> list[float | None]:
    return [_finite(value) for value in values]


# Constants found through a program or a function, with gradients it has or differences.

#: evaluations of a fit beside those of its gradients: measured on neo-Hookean to third order
#: (4 to 12); the plan says the cost of this many
USUAL_EVALUATIONS = 8


class InverseExternal:
    """Curves of an external forward model at the measured displacements, for the optimizer."""

    def __init__(
        self, problem: CellProblem, measured: Sequence[Curve], names: Sequence[str]
    ) -> None:
        self._external, self._problem, self._names = external_of(problem), problem, names
        self._grids = [curve.displacement_mm for curve in measured]
        self._points = np.unique(np.concatenate(self._grids))
        self._last: tuple[bytes, PredictedCurve] | None = None
        self._curves: list[Curve] = []
        #: solutions so far
        self.solves = 0

    def __call__(self, values: Array) -> list[Curve]:
        """Predict the forces at the measured displacements; the last constants not once more."""
        key = values.tobytes()
        if self._last is not None and self._last[0] == key:
            return self._curves
        solved = self._solved(values)
        curve = solved.curve
        gradient = {
            name: curve.force_gradient[name]
            if name in curve.force_gradient
            else self._difference(values, i, curve.force_N)
            for i, name in enumerate(self._names)
        }
        self._curves = [self._at(curve, gradient, grid) for grid in self._grids]
        self._last = key, solved
        return self._curves

    def _solved(self, values: Array) -> PredictedCurve:
        constants = dict(zip(self._names, values.tolist(), strict=True))
        self.solves += 1
        try:
            problem = self._problem.at(constants, float(self._points[-1]))
            return solved_by(self._external, problem, self._points, self._problem.own_tables())
        except (InputError, NoAnswer) as error:
            raise EvaluationFailed(str(error)) from error

    def _difference(self, values: Array, i: int, force: Array) -> Array:
        """Forward difference; a step back where the program has no answer ahead."""
        step = float(steps_of(values)[i])
        for signed in (step, -step):
            moved = values.copy()
            moved[i] += signed
            try:
                ahead = self._solved(moved).curve.force_N
            except EvaluationFailed:
                continue
            return np.asarray((ahead - force) / (moved[i] - values[i]))
        raise EvaluationFailed(f"the program has no answer beside these constants ({i + 1})")

    def _at(self, curve: Curve, gradient: Mapping[str, Array], grid: Array) -> Curve:
        here = np.searchsorted(self._points, grid)
        return Curve(grid, curve.force_N[here],
                     force_gradient={k: v[here] for k, v in gradient.items()})  # fmt: skip

    def predicted(self, values: Array) -> PredictedCurve:
        """Curve at the final constants; solved again where the last one was another."""
        key = np.asarray(values).tobytes()
        solved = self._last[1] if self._last and self._last[0] == key else self._solved(values)
        return replace(solved, curve=solved.curve.without_gradients())


def prediction_of(solution: Solution, seconds: float = 0.0) -> PredictedCurve:
    """Prediction of a solution, without the gradients that nobody reads from the store."""
    touching = solution.equilibria.contact
    mesh: MeshDocument = {
        "dofs": int(solution.dofs),
        "elements": int(solution.elements),
        "hash": str(solution.mesh_hash),
        "mesh_size_mm": float(solution.mesh_size_mm),
    }
    solver: SolverDocument = {
        "name": str(solution.solver),
        "min_j": float(solution.min_j),
        "energy_mismatch": float(solution.energy.largest_mismatch),
        "stabilization_share": float(solution.energy.stabilization_share),
        "snaps_mm": [float(jump_mm) for jump_mm in solution.energy.jumps_mm],
        "penetration_mm": max((contact.penetration_mm for contact in touching), default=0.0),
        "gap_mm": max((contact.gap_mm for contact in touching), default=0.0),
    }
    return PredictedCurve(solution.curve.without_gradients(), mesh, solver, seconds)


def external_of(problem: ForwardCell) -> External:
    """Forward model of a problem that is not ours, which it must name."""
    external = External.of(problem)
    if external is None:
        raise ValueError("this problem names no external forward model")
    return external


def external_curve(
    cell: CellProblem, constants: Mapping[str, float] | None, displacement_mm: Array
) -> PredictedCurve:
    """Curve of a case by its external forward model; constants MPa; displacement_mm (n,)."""
    problem = cell.at(constants, float(displacement_mm[-1]))
    prediction = solved_by(external_of(cell), problem, displacement_mm, cell.own_tables())
    mesh, curve = prediction.mesh, prediction.curve.without_gradients()
    if mesh and problem.model.mesh_size_mm is not None:
        mesh = {**mesh, "mesh_size_mm": problem.model.mesh_size_mm}
    return replace(prediction, curve=curve.with_tangents(), mesh=mesh)


# A case as it goes to a worker: what is known of its record, its problem, its fits.

#: role of a direction that gives the constants of a specimen where its score is held out
CONSTANTS = "constants"

#: Where the predicted curve of a case comes from: the last solution of its fit, a closed form,
#: a solution of its own, or one by another program.
Forward = Literal["fit", "closed-form", "simulation", "external"]


@dataclass(frozen=True)
class Origin:
    """Why a case is computed besides the cells of the design; its record says so."""

    #: Number among the cases that repeat a cell on other meshes, with resampled residuals, or with
    #: other seeds of a stochastic simulation.
    mesh_seed: int | None = None
    noise_seed: int | None = None
    replicate: int | None = None
    #: What it serves beside the study's own answer.
    purpose: Literal["refinement", "input"] | None = None
    #: Id of the case that it is compared with.
    of: str | None = None
    #: How often the mesh was refined.
    level: int | None = None
    #: Key of the input that was moved.
    input: str | None = None

    @property
    def predicts(self) -> bool:
        """Whether its curve is wanted: a fit to resampled residuals has constants alone."""
        return not self.noise_seed

    def to_json(self) -> dict[str, object]:
        """Plain data without what does not apply."""
        return {name: value for name, value in vars(self).items() if value is not None}


#: ends in the name of the file that says how virtual measurements were made
TRUTH_SUFFIX = ".virtual.json"


class DataCache:
    """Measured tests of a study."""

    def __init__(self, root: Path, tests: Sequence[ForwardCell] = ()) -> None:
        self.root, self.tests = root, tests
        self._read: dict[str, Measurements] = {}
        self._recorded: dict[str, Recordings] = {}
        # what was asked for already, by the problems themselves, which are kept so that their
        # identity stays their own
        self._asked: dict[int, tuple[ForwardCell, Measurements]] = {}

    def calibrated(self, cell: Cell) -> Measurements | None:
        """Measurements that only the calibration uses."""
        other = cell.fitted_elsewhere
        if other is None or other.measurements == cell.problem.measurements:
            return None
        return self.scored(other)

    def notes(self) -> tuple[str, ...]:
        """Count what every rule did to the data, each once."""
        return tuple(dict.fromkeys(n for measured in self._read.values() for n in measured.notes))

    def cautions(self) -> tuple[str, ...]:
        """List what was done to the data that may not be what it seems."""
        return tuple(note for note in self.notes() if is_caution(note))

    def files(self) -> dict[str, str]:
        """Name of each file read and its sha256."""
        return {name: sha for data in self._read.values() for name, sha in data.files.items()}

    def scored(self, problem: ForwardCell) -> Measurements | None:
        """Measurements that a case is scored on."""
        spec = problem.measurements
        if spec is None or not isinstance(problem, CellProblem):
            return None
        if id(problem) not in self._asked:  # one problem for all blocks of a cell
            height, depth, gauge = problem.height_mm, problem.depth_mm, problem.gauge
            key = digest([spec.as_dict(), height, depth, None if gauge is None else asdict(gauge)])
            if key not in self._read:
                rows = self._recordings(spec)
                measurements = read_measurements(spec, self.root, height, depth, gauge, rows)
                self._read[key] = checked(measurements, problem.setup)
            self._asked[id(problem)] = problem, self._read[key]
        return self._asked[id(problem)][1]

    def _recordings(self, spec: MeasurementSpec) -> Recordings:
        """Rows of the files, read once for all ranges that are cut out of them."""
        rules = ("range", "points", "sign", "zero", "toe", "displacement_zero", "direction",
                 "branch", "cycle")  # fmt: skip
        key = digest({k: v for k, v in spec.as_dict().items() if k not in rules})
        if key not in self._recorded:
            self._recorded[key] = read_recordings(spec, self.root)
        return self._recorded[key]


@dataclass(frozen=True)
class FitJob:
    """One fit: its problem, its data, and the fit that gives its start values."""

    problem: FitProblem
    #: The averaged curves that it is fitted to.
    measured: tuple[Curve, ...]
    #: Outcome of the fit that starts it, or whose residuals are resampled, once that is done.
    begun: FitResult | None = None
    #: Seed and number of a fit to the resampled residuals of its start.
    noise: tuple[int, int] | None = None
    start: FitJob | None = None
    label: str = ""
    key: str = ""
    #: Fits to the specimens of a block, which begin with one solution and stay with one worker;
    #: empty in closed form, and of resampled residuals, which may be too many for one.
    group: str = ""

    @property
    def needs(self) -> tuple[str, ...]:
        """Key of the fit that it waits for."""
        return () if self.start is None else (self.start.key,)

    def sent(self, outcomes: Mapping[str, FitResult]) -> FitJob:
        """Copy for a worker, complete in itself."""
        return replace(self, start=None, begun=next(iter(outcomes.values()), None))

    def resampled(self, seed: int, number: int) -> FitJob:
        """Make the fit to resampled residuals of this one."""
        key = digest([self.key, "noise", seed, number], 32)
        return replace(self, key=key, start=self, noise=(seed, number), group="")

    @property
    def chain(self) -> tuple[FitJob, ...]:
        """The fits before this one, the first one first, and itself."""
        return (self,) if self.start is None else (*self.start.chain, self)


@dataclass(frozen=True)
class ScorePair:
    """What is fitted and what is scored; with ``swap`` a case has two, each other's reverse."""

    #: Which of the block's curves is scored, for example ``"B"``.
    label: str
    #: The scored curve; None in a study of simulations alone.
    measured: Curve | None
    #: The fit that gives the constants; None where they are given.
    fit: FitJob | None
    #: ``"score"``, ``"fit"`` where the scored curve is the fitted one, or ``"constants"`` where
    #: nothing is scored: the fit to the specimen's own curve, whose score is held out.
    role: str = "score"
    fit_label: str = ""
    #: Standard deviation of the averaged repeats at each point.
    scatter_N: tuple[float, ...] | None = None  # noqa: N815
    #: Displacement of the test where nothing was measured.
    pressed_mm: float = 0.0

    @property
    def fit_key(self) -> str | None:
        """Name of the fit that gives the constants."""
        return None if self.fit is None else self.fit.key

    @property
    def depth_mm(self) -> float:
        """How far the curve is predicted: to the largest measured displacement."""
        if self.measured is None:
            return self.pressed_mm
        return float(self.measured.displacement_mm.max())

    @property
    def identity(self) -> list[object]:
        """Plain values that decide what the prediction is compared with."""
        against = self.measured
        if against is None:
            return [self.label, self.pressed_mm]
        return [self.label, self.fit_label, self.fit_key, against.name]


@dataclass(frozen=True)
class CaseJob:
    """One case and the fits that it needs."""

    case: Case
    directions: tuple[ScorePair, ...]
    #: Name of everything that decides the record.
    input_hash: str
    #: Where the predicted curves come from.
    forward: Forward = "simulation"
    #: Why it is computed besides the cells of the design.
    origin: Origin = field(default_factory=Origin)
    #: Cell whose cases share a solution to start from; empty where none is shared.
    group: str = ""
    #: The fit that gives the constants of that solution (see ``finite_element``).
    anchor: FitJob | None = None

    #: Name of the study, and unit of every response that the record holds.
    study: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    #: Outcomes of its fits by their keys, once they are done.
    outcomes: Mapping[str, FitResult] = field(default_factory=dict)

    def sent(self, outcomes: Mapping[str, FitResult]) -> CaseJob:
        """Copy for a worker, complete in itself: it needs of each fit its name and outcome."""

        def bare(fit: FitJob | None) -> FitJob | None:
            return fit and replace(fit, measured=(), start=None)

        pairs = tuple(replace(pair, fit=bare(pair.fit)) for pair in self.directions)
        return replace(self, directions=pairs, anchor=bare(self.anchor), outcomes=outcomes)

    @property
    def scored(self) -> tuple[ScorePair, ...]:
        """Directions whose curves are predicted and scored."""
        return tuple(pair for pair in self.directions if pair.role != CONSTANTS)

    @property
    def identified(self) -> tuple[ScorePair, ...]:
        """Directions that give the constants: the specimen's own where its score is held out."""
        apart = tuple(pair for pair in self.directions if pair.role == CONSTANTS)
        return apart or self.directions

    @property
    def depth_mm(self) -> float:
        """Largest measured displacement of its directions."""
        return max(pair.depth_mm for pair in self.directions)

    @property
    def fits(self) -> tuple[FitJob, ...]:
        """The fits that it waits for, each once."""
        every = (self.anchor, *(pair.fit for pair in self.directions))
        return tuple({fit.key: fit for fit in every if fit is not None}.values())

    @property
    def needs(self) -> tuple[str, ...]:
        """Keys of these fits."""
        return tuple(fit.key for fit in self.fits)

    @property
    def mesh_size_mm(self) -> float:
        """Element size, named or given."""
        return element_size_mm(self._in_mind)

    @property
    def size(self) -> float:
        """Element size in mm, or the value of the parameter that refines a stranger's solver."""
        refinement = self.case.problem.refinement
        return self.mesh_size_mm if refinement is None else refinement.size(self.case.problem)

    @property
    def promised(self) -> FormalOrder:
        """Order that its elements promise, or what is said of a stranger's solver."""
        refinement = self.case.problem.refinement
        if refinement is None:
            return formal_order(self._in_mind)
        if refinement.formal_order is None:
            return FormalOrder(None, "give [converge] formal_order if the solver promises one")
        given = f"as [converge] says of parameters.{refinement.name}"
        return FormalOrder(refinement.formal_order, given)

    @property
    def _in_mind(self) -> Problem:
        """Problem whose constants are not known yet."""
        return self.case.tested.with_placeholder(self.depth_mm if self.directions else 1.0)

    def outcome(self, pair: ScorePair) -> FitResult | None:
        """Outcome of the fit of a direction; None where the constants are given."""
        return None if pair.fit is None else self.outcomes[pair.fit.key]

    @property
    def shared(self) -> Anchor | None:
        """Name of the shared solution and its constants; None where they could not be fitted."""
        if not self.group or self.anchor is None:
            return Anchor(self.group) if self.group else None
        fit = self.outcomes[self.anchor.key]
        return Anchor(self.group, fit.constants) if fit.usable else None

    def record(
        self,
        status: str,
        message: str = "",
        responses: Mapping[str, ResponseDocument] = MappingProxyType({}),
        extra: Mapping[str, object] = MappingProxyType({}),
        seconds: Mapping[str, float] = MappingProxyType({}),
    ) -> Record:
        """Record of the case: of its responses those that are given, the others missing."""
        case = self.case
        lacking: dict[str, ResponseDocument] = {
            name: {"value": None, "unit": unit} for name, unit in self.units.items()
        }
        return Record(
            case.case_id, self.study, case.levels, case.block, status, message,
            {name: responses.get(name, none) for name, none in lacking.items()},
            timings=seconds, versions=versions(), input_hash=self.input_hash,
            extra={**self.origin.to_json(), **extra},
        )  # fmt: skip


def fits_of(jobs: Iterable[CaseJob]) -> dict[str, FitJob]:
    """Every fit that some cases need, by its key, with those that give start values first."""
    by_key: dict[str, FitJob] = {}
    for job in jobs:
        for fit in job.fits:
            for link in fit.chain:
                by_key.setdefault(link.key, link)
    starts = {fit.start.key for fit in by_key.values() if fit.start is not None}
    return dict(sorted(by_key.items(), key=lambda item: item[0] not in starts))


def repeated(case: Case, way: Sequence[object], cell: Cell | None = None) -> Case:
    """Copy a case that repeats it in some way; its name is made of the case's and of the way."""
    return replace(case, cell=cell or case.cell, case_id=case_id([case.case_id, *way]))


def varied(case: Case, cell: Cell, purpose: str, named: Config | None = None) -> Case:
    """Copy a case with another cell; its name is made of its document and of the purpose."""
    document = named or cell.document()
    name = case_id({**document, "block": case.block, "purpose": purpose})
    return replace(case, cell=cell, case_id=name)


# Cross-validation: which curve a score is held out from, and the fit that did not see it.
#
# A model with more constants fits the curve that it was fitted to at least as well, whatever the
# truth. Under a truth of two constants a model of five is the better one in 100 % of simulated
# studies that score the curve fitted, and in 11 % of those that score other specimens. A study
# that would score the curve fitted is therefore cross-validated over its blocks (Stone 1974, J. R.
# Stat. Soc. B 36, 111).

#: fewest blocks of which one is held out: of two, one specimen would stand for all others
FEWEST_BLOCKS = 3


def held_out(
    leave_out: str | None,
    fit: Selection | None,
    score: Selection | None,
    blocks: int,
    *,
    other_test: bool,
) -> str | None:
    """Say what is left out of the fit that a curve is scored with."""
    if leave_out is not None:
        return None if leave_out == calibration_NOTHING else leave_out
    sees_the_scored = not other_test and dict(fit or {}) == dict(score or fit or {})
    return "specimen" if sees_the_scored and blocks >= FEWEST_BLOCKS else None


def _without_specimen(
    case: Case, problem: FitProblem, scored: Measurements, data: DataCache
) -> list[ScorePair]:
    """Every scored curve of a specimen, with the fit to all other specimens."""
    calibrated = data.calibrated(case.cell)
    fitted = scored if calibrated is None else calibrated
    others = [block for block in fitted.blocks if block != case.block]
    if not others or case.block is None:
        rule = "leaves one specimen out, but the measurements have fewer than two blocks"
        mend = "name the column of the specimens in measurements.block"
        raise InputError(Fault("calibration.leave_out", rule, mend))
    pairs = []
    for fit_where, score_where in scored.sides:
        where = fit_where if calibrated is None else calibrated.spec.fit
        curves = [_test(fitted, block, where).curve for block in others]
        test = _test(scored, case.block, score_where)
        pairs.append(_pair(case, problem, test, score_where, curves, f"all but {case.block}"))
    return pairs


def _without_test(case: Case, scored: Measurements, data: DataCache) -> ScorePair:
    """Scored curve of a test, with the fit to all other tests of the study."""
    name = case.problem.test_name
    others = [tested(test) for test in data.tests if test.test_name != name]
    if not others:
        rule = "leaves one test out, but the design has only one"
        mend = "make the tests a factor: presets with test and measurements"
        raise InputError(Fault("calibration.leave_out", rule, mend))
    curves = []
    for other in others:
        measured = data.scored(other)
        if measured is None:
            raise InputError(Fault("measurements", "are missing for one of the tests"))
        curves.append(_test(measured, case.block, measured.spec.fit).curve)
    where = scored.spec.score or scored.spec.fit
    test = _test(scored, case.block, where)
    return _pair(case, together(case.cell, others), test, where, curves, "all other tests")


def score_pairs(
    case: Case, problem: FitProblem, data: DataCache, with_scores: bool, with_constants: bool
) -> list[ScorePair]:
    """Say what is fitted and what is scored in a case."""
    if not isinstance(case.problem, CellProblem):
        return [ScorePair("all", None, None)]
    cell, scored = case.cell, data.scored(case.problem)
    if scored is None:
        return [_simulated(case, problem)]
    kind = None  # a study of constants alone fits each curve by itself
    if problem.method != "none" and (cell.leave_out is not None or with_scores):
        other = cell.fitted_elsewhere is not None
        kind = held_out(
            cell.leave_out, scored.spec.fit, scored.spec.score, len(scored.blocks), other_test=other
        )
    if kind is None:
        return _fitted_pairs(case, problem, scored, data)
    if kind != "specimen":
        return [_without_test(case, scored, data)]
    pairs = _without_specimen(case, problem, scored, data)
    if with_constants:
        # those of all other specimens would differ less between specimens than these do
        alone = _fitted_pairs(case, problem, scored, data)[0]
        pairs.append(replace(alone, role=CONSTANTS, fit_label=f"{case.block} alone"))
    return pairs


def _simulated(case: Case, problem: FitProblem) -> ScorePair:
    """Prediction that nothing was measured beside."""
    depth, marked = case.problem.depth_mm, case.problem.markers
    if marked is not None and case.block is not None:  # each state is a block
        depth = marked.state(case.block).displacement_mm
    if problem.method != "none" or depth is None:
        rule = "there is none to fit the constants to, nor to say how far the test goes"
        mend = "add it, or give [material] its constants and [test] its displacement"
        raise InputError(Fault("measurements", rule, mend))
    return ScorePair("all", None, None, pressed_mm=float(depth))


def _fitted_pairs(
    case: Case, problem: FitProblem, scored: Measurements, data: DataCache
) -> list[ScorePair]:
    """Pairs whose constants are given, or come from the curves that the study file selects."""
    given, other = problem.method == "none", data.calibrated(case.cell)
    if given or other is not None:
        curves = [] if given or other is None else [_test(other, case.block, other.spec.fit).curve]
        return [_pair(case, problem, scored.pairs(case.block)[0][1], scored.spec.score, curves)]
    out = []  # with ``swap`` fit and score also change places
    pairs = zip(scored.pairs(case.block), scored.sides, strict=True)
    for (fitted, test), (fit_where, score_where) in pairs:
        role, label = "fit" if fit_where == score_where else "score", _label(fit_where)
        out.append(_pair(case, problem, test, score_where, [fitted.curve], label, role))
    return out


def _test(measured: Measurements, block: str | None, where: Selection | None) -> MeasuredTest:
    """Test of a block; the only one where the measurements have none."""
    return measured.curve(None if measured.spec.block is None else block, **dict(where or {}))


def _pair(
    case: Case,
    problem: FitProblem,
    test: MeasuredTest,
    where: Selection | None,
    curves: Sequence[Curve],
    fit_label: str = "all",
    role: str = "score",
) -> ScorePair:
    """Score of a test, with the fit to some curves; without them its constants are given."""
    fit = fit_job(problem, tuple(curves), case.label) if curves else None
    scatter = None if test.scatter_N is None else tuple(test.scatter_N.tolist())
    return ScorePair(_label(where), test.curve, fit, role, fit_label, scatter)


def _label(where: Selection | None) -> str:
    if not where:
        return "all"
    groups = [[v] if isinstance(v, (str, float, int)) else v for v in where.values()]
    return " ".join("+".join(map(str, group)) for group in groups)


def fit_job(problem: FitProblem, measured: tuple[Curve, ...], label: str) -> FitJob:
    """Make a fit and those that give its start values."""
    before = start_problem(problem)
    start = None if before is None else fit_job(before, measured, label)
    key = fit_key(problem, measured)
    simulated = any(test.method == "inverse-fem" for test in problem.tests)
    group = digest([label, [test.name for test in problem.tests]], 32) if simulated else ""
    return FitJob(problem, measured, start=start, label=label, key=key, group=group)
