"""Tables as written -> the problems of a cell or of a calibration, with every fault."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import cast

from study.external.forward_model import ForwardModel, Refinement
from study.external.parameters import ParameterProblem, parameters_from, stands_alone
from study.ground.declaration import shown, table_of, values_of, written_keys
from study.ground.diagnostics import (
    Faults,
    Kind,
    Table,
    all_about,
    is_about,
    is_known,
    noted,
    read_table,
    read_variant,
    with_values,
)
from study.ground.errors import InputError, nearest
from study.ground.units import INTERNAL
from study.mechanics.material.material import is_constant_key
from study.mechanics.measurement.measurement_section import (
    KINEMATIC,
    KINETIC,
    SECOND,
    MarkerSpec,
    MeasurementSpec,
    groups_of,
)
from study.mechanics.setup.calibration_table import (
    ANALYTIC_KEYS,
    Bounds,
    Calibration,
    Fitting,
    bounds_of,
)
from study.mechanics.setup.geometry import INDENTERS, SPECIMENS, Specimen
from study.mechanics.setup.setup import Model
from study.mechanics.setup.test_kind import TEST_KINDS, Test
from study.simulation import plausibility
from study.simulation.cell import Cell, CellProblem
from study.simulation.material_table import material_from
from study.simulation.problem_file import (
    CalibratedTest,
    CalibrationDesign,
    CalibrationFile,
    Converge,
    Role,
    default_name,
    nuisance_from,
    of_test,
)

#: key of a table, rule and mend
Broken = Iterator[tuple[str, str, str]]


def _sound(
    kind: type[Kind],
    table: object,
    path: str,
    faults: Faults,
    check: Callable[[Table, Kind], Broken],
) -> Kind | None:
    """Read a table and check its keys against one another; None where a fault was found."""
    before = faults.mentions
    section = read_table(kind, table, path, faults)
    for key, rule, mend in check(table, section) if isinstance(table, Mapping) else ():
        faults.add(f"{path}.{key}", rule, mend)
    return None if faults.mentions > before else section


def measurements_from(
    table: object, faults: Faults, path: str = "measurements"
) -> MeasurementSpec | None:
    """Read where measured curves are; None where a fault was found."""
    return _sound(MeasurementSpec, table, path, faults, _measurements_broken)


def _measurements_broken(table: Table, _: MeasurementSpec) -> Broken:
    yield from _columns_broken(table)
    if {"time", *SECOND} & set(columns := table_of(table, "columns")):
        yield from _course_broken(table, columns)
    given = [key for key in ("file", "files") if key in table]
    if len(given) != 1:
        rule = "stands beside file" if given else "is missing"
        yield "file" if not given else "files", rule, "give one of file and files"
    for key, other in (("fit", "score"), ("score", "fit")):
        if key in table and other not in table:
            yield other, f"is missing beside {key}", "give both, or neither"
    if table.get("swap") is True and "fit" not in table:
        yield "swap", "needs fit and score", "say which rows change places"
    block, files = table.get("block"), table.get("files")
    if isinstance(block, str) and isinstance(files, str) and block not in groups_of(files):
        rule = f"{block!r} is no group of the file names {shown(files)}"
        yield "block", rule, f"write {{{block}}} where its label stands"


def _columns_broken(table: Table) -> Broken:
    """One column says how far, one how hard, and each has its unit."""
    columns, units = table.get("columns"), table.get("units")
    no_row = table.get("unit_row") is not True
    if "units" not in table and no_row:
        yield "units", "is missing", 'for example units = { displacement = "mm", force = "N" }'
    if not isinstance(columns, Mapping):
        return
    for quantities, usual in ((KINEMATIC, "displacement"), (KINETIC, "force")):
        given = [key for key in quantities if key in columns]
        if not given:
            yield f"columns.{usual}", "is missing", "displacement and force"
        if len(given) > 1:
            rule = f"stands beside {given[0]}"
            yield f"columns.{given[1]}", rule, f"give one of {', '.join(quantities)}"
        needed = given[0] if given else usual
        if isinstance(units, Mapping) and needed not in units and no_row:
            unit = {**INTERNAL, "pressure": "kPa"}[quantities[needed]]
            yield f"units.{needed}", "is missing", f'for example {needed} = "{unit}"'
    biaxial = (*SECOND, *SECOND.values())
    first = next((key for key in biaxial if key in columns), None)
    for key in biaxial if first else ():
        if key not in columns:
            yield f"columns.{key}", f"is missing beside {first}", "a biaxial test has all four"
    if isinstance(units, Mapping) and "time" in columns and "time" not in units:
        yield "units.time", "is missing", 'for example time = "s"'


def _course_broken(table: Table, columns: Table) -> Broken:
    """Keep rules that take rows out, or move them, from tests whose course in time matters."""
    what = "a column of time" if "time" in columns else "two directions"
    rule = f"has no meaning for a test with {what}, whose rows all count"
    if table.get("points", "raw") != "raw":
        yield "points", rule, 'write points = "raw"'
    for key in ("range", "toe"):
        if key in table:
            yield key, rule, "leave it out"
    if table.get("zero") == "fit" or ("zero" in table and "time" not in columns):
        yield "zero", rule, 'write zero = "first"'


def _markers_broken(table: Table, markers: MarkerSpec) -> Broken:
    if markers.fit and "layer" not in table and set(table) <= set(written_keys(MarkerSpec)):
        yield "layer", "is missing beside fit", "name the column of the layers"


# Specimen, test and discretization of a cell, with the defaults that other tables decide.


def loading_from(table: object, faults: Faults, path: str = "test") -> Test:
    """Read how the specimen is loaded; the measured range may give the displacement later."""
    section = read_table(Test, table, path, faults)
    written: Table = table if isinstance(table, Mapping) else {}
    kind, where = TEST_KINDS.get(section.kind), f"{path}.indenter"
    base = section.base
    if "base" not in written:
        base = section.interface if kind is None else kind.usual_base(section.interface)
    indenter = None
    if kind is not None and kind.takes_indenter:
        if "indenter" in written:
            indenter = read_variant(INDENTERS, "shape", written["indenter"], where, faults)
        else:
            faults.add(where, "is missing", f"{{ shape = ... }} with {'|'.join(INDENTERS)}")
    return with_values(section, base=base, indenter=indenter)


def model_from(
    table: object, faults: Faults, shape: str, ratio: float, path: str = "model"
) -> Model:
    """Read the discretization."""
    section = read_table(Model, table, path, faults)
    written: Table = table if isinstance(table, Mapping) else {}
    if "mesh" in written and "mesh_size" in written:
        faults.add(f"{path}.mesh_size", "stands beside mesh", "give one of the two")
    usual = "axisymmetric" if shape == "cylinder" else "3d"
    space = section.space if "space" in written else usual
    return with_values(section, space=space, mesh_ratio=ratio)


def forward_from(table: object, faults: Faults, path: str = "forward") -> ForwardModel | None:
    """Read what predicts the curves; None for the built-in finite elements."""
    if table is None:
        return None
    section = read_table(ForwardModel, table, path, faults)
    if section.model is None or section.model == "fem":
        return None
    missing = None if section.argv is None else section.fault(path)
    if missing is not None:
        faults.add(missing.where, missing.rule, missing.mend)
    return section


# A cell, and a calibration, of such tables.

TABLES = ("specimen", "test", "material", "model", "measurements", "markers", "forward")


def resolve(tables: Table, written: Table, converge: Converge, faults: Faults) -> Cell:
    """Resolve a cell: sections in internal units, the displacement filled from the range.

    ``written`` are the tables of the file, whose parameters say the units of those of the cell.
    """
    if stands_alone(tables):
        return Cell(_of_parameters(tables, written, converge, faults), "none")
    ratio = converge.ratio
    problem = resolve_problem(tables, faults, ratio)
    if "parameters" in tables:
        first = written.get("parameters")
        values, units = parameters_from(tables["parameters"], first, faults)
        problem = replace(problem, parameters=values, units=units)
    calibration = calibration_from(tables, bool(problem.material.constants), faults)
    other = None
    if calibration.problem is not None:
        replaced = {k: v for k, v in values_of(calibration.problem).items() if v is not None}
        places = {k: f"calibration.problem.{k}" for k in replaced}
        other = resolve_problem({**tables, **replaced}, faults, ratio, places)
    cell = Cell(problem, calibration.method or "auto", calibration.leave_out, other)
    if calibration.method is not None:
        _check_method(cell, problem, other or problem, faults)
    return cell


def _of_parameters(
    tables: Table, written: Table, converge: Converge, faults: Faults
) -> ParameterProblem:
    """Resolve a cell of parameters alone, which a program or a function predicts."""
    first = written.get("parameters", tables.get("parameters"))
    values, units = parameters_from(tables.get("parameters", {}), first, faults)
    forward = forward_from(tables.get("forward", {"model": "python"}), faults)
    if forward is None or not forward.is_external:
        if all_about(faults, "parameters"):
            rule = "predicts nothing of parameters alone"
            faults.add("forward.model", rule, 'write model = "command" or model = "python"')
        forward = ForwardModel(model="python")
    for name in ("measurements", "markers", "calibration"):
        if name in tables:
            mend = "leave it out, or describe [specimen], [test], [material] and [model]"
            faults.add(name, "has no meaning for parameters alone, without a material", mend)
    name = (converge.key or "").partition(".")[2]
    size = values.get(name)
    if name and (not isinstance(size, float) or size <= 0):
        rule = f"must be a positive number in every cell, parameters.{name} is {shown(size)}"
        mend = "name the mesh size, step or tolerance of your solver"
        if name not in values:
            rule, mend = f"[parameters] does not have {name!r}", nearest(name, values)
        faults.add("converge.key", rule, mend)
    refinement = Refinement(name, converge.formal_order) if name else None
    return ParameterProblem(parameters=values, units=units, forward=forward, refinement=refinement)


def resolve_problem(
    tables: Table,
    faults: Faults,
    ratio: float = 1.5,
    places: Mapping[str, str] | None = None,
    *,
    all_rows: bool = False,
) -> CellProblem:
    """Resolve specimen, test, material, model and measurements.

    With ``all_rows`` measured rows count as they are, unless a number of points is written.
    """
    at = {name: name for name in TABLES} | dict(places or {})
    shaped = tables.get("specimen", {})
    specimen: Specimen = read_variant(SPECIMENS, "shape", shaped, at["specimen"], faults)
    written = tables.get("test", {})
    if specimen.shape == "homogeneous" and isinstance(written, Mapping):
        written = {"interface": "frictionless", **written}  # nothing holds a gauge section
    test = loading_from(written, faults, at["test"])
    material = material_from(tables.get("material", {}), faults, at["material"])
    model = model_from(tables.get("model", {}), faults, specimen.shape, ratio, at["model"])
    spec = None
    if "measurements" in tables:
        spec = measurements_from(tables["measurements"], faults, at["measurements"])
        chosen = "points" in table_of(tables, "measurements")
        if spec is not None and (all_rows or specimen.shape == "homogeneous") and not chosen:
            spec = replace(spec, points="raw")  # every row of a test of material counts
    forward = forward_from(tables.get("forward"), faults, at["forward"])
    marked, markers = tables.get("markers"), None
    if marked is not None:
        markers = _sound(MarkerSpec, marked, at["markers"], faults, _markers_broken)
    problem = CellProblem(
        specimen, test, material, model, measurements=spec, forward=forward, markers=markers
    )
    problem = _with_displacement(problem, tables, faults, at)
    plausibility.check(problem, faults, at)
    return problem


def _with_displacement(
    problem: CellProblem, tables: Table, faults: Faults, at: Mapping[str, str]
) -> CellProblem:
    """Take the end of the range for a displacement left out; both given must agree."""
    where = f"{at['test']}.displacement"
    given, high = problem.test.displacement_mm, _range_end(problem, faults, at)
    if problem.markers is not None:
        high = problem.markers.deepest_mm
    if given is None:
        _check_displacement(problem, tables, high, where, faults)
        return replace(problem, test=with_values(problem.test, displacement_mm=high))
    if high is not None and abs(high - given) > 1e-9 * high:
        source = (
            "the deepest of markers.states is" if problem.markers else "measurements.range ends at"
        )
        rule = f"{given:g} mm, but {source} {high:g} mm"
        faults.add(where, rule, "make them agree, or leave the displacement out")
    return problem


def _check_displacement(
    problem: CellProblem, tables: Table, high: float | None, where: str, faults: Faults
) -> None:
    """Note a displacement that nothing gives, unless what would give it is faulty itself."""
    spec, measured = problem.measurements, "measurements" in tables
    written = "displacement" in table_of(tables, "test")
    unread = measured and (
        spec is None
        or spec.range is not None
        or spec.points == "raw"
        or spec.columns.time is not None
        or spec.columns.is_biaxial
    )
    # markers say it, or are faulty themselves
    if high is None and not written and not unread and "markers" not in tables:
        mend = 'write displacement = "5 mm"' + (", or measurements.range" if measured else "")
        faults.add(where, "is missing", mend)


def _range_end(problem: CellProblem, faults: Faults, at: Mapping[str, str]) -> float | None:
    spec, height = problem.measurements, problem.height_mm
    if spec is None or spec.range is None:
        return None
    if spec.range.kind == "percent" and height is None and problem.specimen.shape != "surface":
        return None  # the height itself is faulty, and reported
    try:
        return spec.range.in_mm(height)[1]
    except InputError as error:
        fault = error.faults[0]
        faults.add(f"{at['measurements']}.range", fault.rule, fault.mend)
        return None


def calibration_from(tables: Table, given: bool, faults: Faults) -> Calibration:
    """Read ``[calibration]``; the method is ``auto`` unless the constants are given."""
    section = read_table(Calibration, tables.get("calibration", {}), "calibration", faults)
    if "method" in table_of(tables, "calibration"):
        return section
    return with_values(section, method="none" if given else "auto")


@dataclass(frozen=True)
class Identification:
    """What a design itself says of measured curves and of constants, before a level is laid."""

    measurements: MeasurementSpec | None = None
    calibration: Calibration = Calibration()


def identification_from(tables: Table) -> Identification:
    """Read the tables of a design; what is faulty in them is told of its cells."""
    given = any(map(is_constant_key, table_of(tables, "material")))
    measured, faults = tables.get("measurements"), Faults()
    return Identification(
        measurements_from(measured, faults) if measured else None,
        calibration_from(tables, given, faults),
    )


def _check_method(cell: Cell, problem: CellProblem, fitted: CellProblem, faults: Faults) -> None:
    material, test = problem.material, fitted.test
    if cell.method == "none":
        if not material.constants and material.model:
            mend = "give them, or let [calibration] find them"
            faults.add("material", "has no constants, and calibration.method is none", mend)
        if any(term.share is None or term.range_s for term in material.relaxation):
            rule = "has shares or times to be found, and calibration.method is none"
            faults.add("material.relaxation", rule, "give them, or let [calibration] find them")
        plausibility.check_stability(problem, faults)
        return
    if fitted.measurements is None:
        if not any("measurements" in f.where for f in faults):
            mend = "add [measurements], or give the constants"
            faults.add("measurements", "is missing: there is nothing to calibrate with", mend)
        return
    readable = is_known(test.kind, test.interface)
    if cell.method == "analytic" and readable and not fitted.is_homogeneous:
        rule = "analytic needs compression of a cylinder or block with both faces frictionless"
        faults.add("calibration.method", rule, 'write method = "auto" or "inverse-fem"')


def resolve_calibration(
    file: CalibrationFile, tables: Table, faults: Faults, source: str, *_: str
) -> CalibrationDesign:
    """Resolve a calibration: its tests in internal units, and the bounds of its constants."""
    name, problems = file.study.name or default_name(source), []
    for i, test in enumerate(file.tests):  # its own tables replace those of the file
        keys = ("test", "measurements", "specimen", "model")
        given = {key: value for key in keys if (value := getattr(test, key)) is not None}
        places = {key: f"tests[{i}].{key}" for key in given}
        every = {"test": {}, **tables, **given}
        problems.append(resolve_problem(every, faults, places=places, all_rows=True))
    if all_about(faults, "calibration") and not any(test.role == "fit" for test in file.tests):
        faults.add("tests", "has no test with role fit", 'write role = "fit" in one of them')
    is_read = bool(problems) and not any(is_about(fault, "material") for fault in faults)
    names = problems[0].calibrated_names if is_read else None
    bounds = _bounds(file.calibration, names, faults)
    shared = nuisance_from(file.nuisance, "nuisance", faults)
    nuisances = [
        nuisance_from(test.nuisance, f"tests[{i}].nuisance", faults)
        for i, test in enumerate(file.tests)
    ]
    if faults:
        return CalibrationDesign(name, ())
    tests = tuple(
        CalibratedTest(
            problem, spec, cast("Role", test.role), test.weight, of_test(shared, nuisance)
        )
        for test, problem, nuisance in zip(file.tests, problems, nuisances, strict=True)
        if (spec := problem.measurements) is not None  # it must stand in the file
    )
    return CalibrationDesign(name, tests, file.calibration, bounds)


def _bounds(fitting: Fitting, names: tuple[str, ...] | None, faults: Faults) -> Bounds:
    """Bounds of the constants; keys that the closed form of indentations has alone are noted."""
    for key in ANALYTIC_KEYS:
        if fitting.method != "analytic" and getattr(fitting, key) != getattr(Fitting(), key):
            mend = 'write method = "analytic", or leave it out'
            faults.add(f"calibration.{key}", "is of the closed form of indentations", mend)
    if fitting.bounds is None:
        return {}
    return noted(bounds_of(names), fitting.bounds, "calibration.bounds", faults) or {}


@dataclass(frozen=True)
class LoadedProblem:
    """What a file of one forward simulation holds."""

    problem: CellProblem
    #: How its mesh is refined.
    converge: Converge = Converge()
