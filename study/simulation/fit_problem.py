"""A calibration without its data (what enters it, its name, what starts it), and what became of it.

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
from typing import TYPE_CHECKING, cast

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
from study.mechanics.material.homogeneous import MODES, sheared_stretches
from study.mechanics.material.material import ENERGIES, Material, is_dimensionless
from study.mechanics.material.stability import StabilityResult, ellipticity_end, stability
from study.mechanics.measurement.marker_states import read_markers
from study.mechanics.measurement.measurement_section import MeasurementSpec
from study.mechanics.measurement.recording import check_relative, locate, locate_pattern
from study.mechanics.setup.geometry import Block, Enclosed, Surface
from study.mechanics.setup.material_section import MaterialSection
from study.mechanics.setup.setup import Model, Problem, Setup
from study.mechanics.setup.test_kind import Test
from study.record.record import WITH_CONSTANTS, FitDocument, MeshDocument, SolverDocument
from study.simulation.cell import Cell, CellProblem, tested
from study.simulation.provenance import code_version

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
