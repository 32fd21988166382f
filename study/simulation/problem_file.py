"""Files of one problem and of one calibration: tables with fixed keys, and what they resolve to.

Values are in mm, N, MPa and deg. Tables that cells of a design may vary are read where a cell is
resolved; every fault is noted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal, cast

from study.external.forward_model import (
    ForwardModel,
    ParameterProblem,
    Refinement,
    parameter_key,
    parameters_from,
    stands_alone,
)
from study.ground import units
from study.ground.declaration import (
    DERIVED,
    AsWritten,
    Bad,
    Duration,
    Faults,
    Kind,
    Length,
    Reads,
    Rows,
    Schema,
    Table,
    all_about,
    as_written,
    choice,
    entries,
    integer,
    is_about,
    is_known,
    noted,
    number,
    read_table,
    read_variant,
    section,
    shown,
    slug,
    table_of,
    text,
    texts,
    values_of,
    with_values,
    written_keys,
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
from study.mechanics.setup.material_section import MaterialSection
from study.mechanics.setup.setup import MESH_LEVELS, Model
from study.mechanics.setup.test_kind import TEST_KINDS, Test
from study.simulation import overlay, plausibility
from study.simulation.cell import Cell, CellProblem, folder_name
from study.simulation.overlay import material_from
from study.simulation.response import RESPONSES

# The table ``[nuisance]`` of a calibration file: what moves the constants and is none of them.

OFFSET = "displacement_offset"
ZERO = "force_zero"
FRICTION = "friction"
#: dimension of the parameters that are no input of the simulation, and whether every curve has
#: its own unless the file says otherwise
_OWN = {OFFSET: ("length", "curve"), ZERO: ("force", "curve"), FRICTION: ("number", "all")}
#: tables whose numbers may be uncertain
_TABLES = ("specimen", "test.indenter", "material")

_EXAMPLE = '{ uncertainty = "0.1 mm" }'


@section
class NuisanceInput:
    """One entry of ``[nuisance]``: a nuisance parameter of one test, in internal units."""

    #: Standard uncertainty before the fit, or a share of the value; None where nothing is known.
    uncertainty: Annotated[float | None, as_written()] = None
    #: What is expected; None for an input of the simulation, which has its value elsewhere.
    value: Annotated[float | None, as_written()] = None
    #: Whether the tests may move it: by default offset, zero and friction are fitted and inputs
    #: propagated.
    treat: Annotated[str | None, Reads(choice("fitted", "propagated"))] = None
    #: What has a value of its own: every curve, every test, or none.
    each: Annotated[str, Reads(choice("curve", "test", "all"))] = None  # type: ignore[assignment]
    #: Whether the uncertainty is a share of the value.
    relative: Annotated[bool, DERIVED] = False

    @property
    def reach(self) -> float:
        """Distance from zero within which the parameter lies, by three standard uncertainties."""
        if self.uncertainty is None:
            return math.inf
        value = abs(self.value or 0.0)
        return value + 3 * self.uncertainty * (value if self.relative else 1.0)


def nuisance_from(table: object, path: str, faults: Faults) -> dict[str, NuisanceInput]:
    """Read the declarations of nuisance parameters, by key."""
    inputs: dict[str, NuisanceInput] = {}
    for key, raw in _flat(entries(table, path, faults)).items():
        where = f"{path}.{key}"
        measured = noted(_dimension, key, where, faults)
        written = raw if isinstance(raw, Mapping) else {"uncertainty": raw}
        read = read_table(NuisanceInput, written, where, faults)
        if measured is None:
            continue
        given = None
        if read.uncertainty is not None:
            reader = partial(_uncertainty, measured, key)
            given = noted(reader, read.uncertainty, f"{where}.uncertainty", faults)
        uncertainty, relative = given or (None, False)
        value = _value(key, read.value, measured, where, faults)
        usual, each = ("fitted", _OWN[key][1]) if key in _OWN else ("propagated", "all")
        treat = read.treat or usual
        if read.uncertainty is None and treat == "propagated":
            rule = "is propagated, which needs an uncertainty"
            faults.add(where, rule, f'write {_EXAMPLE}, or treat = "fitted"')
        inputs[key] = with_values(
            read, uncertainty=uncertainty, value=value, treat=treat, each=read.each or each,
            relative=relative,
        )  # fmt: skip
    return inputs


def of_test(
    shared: Mapping[str, NuisanceInput], of_one_test: Mapping[str, NuisanceInput]
) -> dict[str, NuisanceInput]:
    """Nuisance parameters of one test: its own, and those of the file that it does not replace."""
    # What all tests share is common to the tests that take it from the file; a test's own parameter
    # is at most common to its curves.
    within = {
        key: replace(entry, each="curve" if entry.each == "curve" else "test")
        for key, entry in of_one_test.items()
    }
    return {**shared, **within}


def _flat(table: Mapping[str, object]) -> dict[str, object]:
    """Keys as they are dotted in the file: TOML nests ``specimen.height`` without quotes."""
    out: dict[str, object] = {}
    keys = set(written_keys(NuisanceInput))
    for key, value in table.items():
        if isinstance(value, Mapping) and value and not keys & set(value):
            out |= {f"{key}.{inner}": value_inside for inner, value_inside in _flat(value).items()}
        else:
            out[key] = value
    return out


def _dimension(key: object) -> str:
    name = str(key)
    if name in _OWN:
        return _OWN[name][0]
    table = name.rpartition(".")[0]
    dimension = overlay.dimension(name) if table in _TABLES else None
    is_input = table != "material" or name.endswith((".poisson_ratio", ".bulk_modulus"))
    if dimension is None or not is_input:
        usual = (*_OWN, "specimen.height", "specimen.radius", "specimen.area",
                 "specimen.length", "material.poisson_ratio", "material.bulk_modulus")  # fmt: skip
        raise Bad("is no nuisance parameter", nearest(name[:80], usual))
    return dimension


def _uncertainty(dimension: str, key: str, value: object) -> tuple[float, bool]:
    """Read a standard uncertainty: its value, and whether it is a share of the value."""
    share = isinstance(value, str) and value.strip().endswith("%")
    if dimension == "number" and not share:
        return number(0.0)(value), False
    size = units.parse(value, "ratio" if share else dimension)
    if size <= 0:
        raise Bad(f"must be above 0, got {shown(value)}")
    if share and key in (OFFSET, ZERO):
        raise Bad(f"cannot be a share, got {shown(value)}", 'for example "0.02 N" or "0.1 mm"')
    return size, share


def _value(key: str, raw: object, dimension: str, where: str, faults: Faults) -> float | None:
    if key not in _OWN:
        if raw is not None:
            rule = "stands beside the input itself"
            faults.add(f"{where}.value", rule, f"leave it out, and change {key}")
        return None
    if key == FRICTION:
        mend = "0 as frictionless plates, 1 as bonded ones"
        if raw is not None:
            return noted(number(0, 1, closed=True, mend=mend), raw, f"{where}.value", faults)
        faults.add(f"{where}.value", "is missing", mend)
        return None
    read = partial(units.parse, dimension=dimension)
    return 0.0 if raw is None else noted(read, raw, f"{where}.value", faults)


Role = Literal["fit", "held-out"]


@dataclass(frozen=True)
class CalibratedTest:
    """One of the ``[[tests]]`` of a calibration."""

    problem: CellProblem
    measurements: MeasurementSpec
    #: Whether its curves enter the fit, or are only predicted.
    role: Role = "fit"
    #: Factor on its residuals; ``"equal"``, or one over the noise of its rows, of one size
    #: (``"scatter"``) or as it grows with the force (``"relative"``).
    weight: float | str = "equal"
    #: What is not known exactly of it, by key.
    nuisance: Mapping[str, NuisanceInput] = field(default_factory=dict)

    @property
    def file(self) -> str:
        """Its measured file, or the pattern of its files."""
        return str(self.measurements.file or self.measurements.files)


@dataclass(frozen=True)
class CalibrationDesign:
    """One material that is fitted to measured tests."""

    #: Of the calibration: that of its folder of results.
    name: str
    #: In the order of the file; all have the same material.
    tests: tuple[CalibratedTest, ...]
    #: How the constants are to be found.
    fitting: Fitting = field(default_factory=Fitting)
    #: Least and largest value of a constant, MPa, exponents plain.
    bounds: Bounds = field(default_factory=dict)

    @property
    def material(self) -> MaterialSection:
        """Energy of all tests, and the constants to start from where the file gives them."""
        return self.tests[0].problem.material

    @property
    def document(self) -> dict[str, object]:
        """How the constants are to be found, as plain values for a hash."""
        return {**values_of(self.fitting), "bounds": dict(self.bounds)}

    def bounds_of(self, names: Sequence[str]) -> list[tuple[float, float]]:
        """Bounds of the file; else those beyond which an energy is not defined, MPa."""
        return [self.bounds.get(name) or self.material.bounds(name) for name in names]

    def pooled(self) -> CalibrationDesign:
        """Copy that fits one set of constants to all specimens together, and nothing else."""
        return replace(self, fitting=with_values(self.fitting, specimens="pooled", leave_out=None))


MAX_TESTS = 1000
QUANTITIES = ("peak_force", "work", "curve_rms", *RESPONSES)
FORMATS = ("html", "pdf", "tex", "csv")


def _assumed(value: object) -> tuple[str, ...]:
    keys = texts("keys", "test.interface")(value)
    for key in keys:
        if key not in overlay.TABLES and not overlay.may_vary(key):
            raise Bad(f"names no input: {shown(key)}", overlay.suggestion(key))
    return keys


_refined_key = partial(parameter_key, 'key = "parameters.h"; [model] is refined without a key')


def _share(value: object) -> float:
    """Read a share: a plain number, or percent."""
    if not isinstance(value, str):
        return number(0, 1, mend='for example "1 %"')(value)
    percent = units.parse_percent(value)
    if 0 < percent < 100:
        return percent / 100
    raise Bad(f"must be between 0 % and 100 %, got {shown(value)}")


def _formats(value: object) -> tuple[str, ...]:
    """Read one format or several."""
    items = value if isinstance(value, list) else [value]
    return tuple(dict.fromkeys(choice(*FORMATS)(item) for item in items)) or ("html",)


def _weight(value: object) -> str | float:
    words = choice("scatter", "equal", "relative")
    return words(value) if isinstance(value, str) else number(0, 1e12)(value)


@section
class StudyTable:
    """Name, question, seed and what is assumed; the name is by default that of the file."""

    #: Of its folder of results.
    name: Annotated[str, Reads(slug)] = ""
    #: What it is to answer; the report begins with it.
    question: Annotated[str, Reads(text)] = ""
    #: Of every random draw.
    seed: Annotated[int, Reads(integer(0, 2**32 - 1))] = 2011
    #: Inputs that nobody measured, by key.
    assumed: Annotated[tuple[str, ...], Reads(_assumed)] = ()


def default_name(source: str) -> str:
    """Name of a study that has none: that of its file."""
    stem = Path(source).stem if "\0" not in source else ""
    return folder_name(stem, "study")


@section
class Converge:
    """Mesh refinement: ratio, meshes, watched quantity, tolerance (a fraction), time budget."""

    ratio: Annotated[float, Reads(number(1, 10))] = 1.5
    levels: Annotated[int, Reads(integer(2, 10))] = 3
    qoi: Annotated[str, Reads(choice(*QUANTITIES))] = "peak_force"
    tolerance: Annotated[float | None, Reads(_share)] = None
    budget_s: Duration | None = None
    #: Mesh size, step or tolerance of a stranger's solver, and the order that it promises in it.
    key: Annotated[str | None, Reads(_refined_key)] = None
    formal_order: Annotated[float | None, Reads(number(0, 20))] = None


@section
class Report:
    """Formats of the report."""

    format: Annotated[tuple[str, ...], Reads(_formats)] = ("html",)


# ``[virtual]``: how carefully the true curve of virtual specimens is solved.


@section
class Virtual:
    """Discretization of the reference curve that virtual specimens follow."""

    #: Load steps of the curve; between them it is interpolated with its tangent.
    steps: Annotated[int, Reads(integer(1, 1000))] = 12
    #: Of its elements.
    element_order: Annotated[str, Reads(choice("quadratic", "linear"))] = "quadratic"
    #: Named mesh; without one, and without a size, one step finer than the finest of the design.
    mesh: Annotated[str | None, Reads(choice(*MESH_LEVELS))] = None
    #: Element size, instead of a named mesh.
    mesh_size_mm: Length | None = None

    @property
    def chooses_mesh(self) -> bool:
        """Whether the mesh is given here."""
        return self.mesh is not None or self.mesh_size_mm is not None


@section
class TestTable:
    """One of the ``[[tests]]`` of a calibration file, with tables of its own."""

    __test__ = False  # not a pytest class

    test: Annotated[object, as_written("write test = { ... }")]
    measurements: Annotated[object, as_written("write measurements = { ... }")]
    role: Annotated[str, Reads(choice("fit", "held-out"))] = "fit"
    weight: Annotated[str | float, Reads(_weight)] = "equal"
    specimen: AsWritten = None
    model: AsWritten = None
    nuisance: AsWritten = None


_Tests = Annotated[
    tuple[TestTable, ...], Rows(1, MAX_TESTS, "write [[tests]]", f"must be 1 to {MAX_TESTS} tables")
]


@section
class ProblemFile:
    """A file for one forward simulation."""

    schema: Schema
    study: StudyTable = StudyTable()
    specimen: AsWritten = None
    test: AsWritten = None
    material: AsWritten = None
    model: AsWritten = None
    converge: Converge = Converge()
    report: Report = Report()
    uncertainty: AsWritten = None


@section
class CalibrationFile:
    """A file for the constants of one material."""

    schema: Schema
    study: StudyTable = StudyTable()
    specimen: AsWritten = None
    material: AsWritten = None
    model: AsWritten = None
    tests: _Tests = ()
    calibration: Fitting = Fitting()
    nuisance: AsWritten = None


# Tables as written -> the problems of a cell or of a calibration.


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
