"""The file of a calibration: its tests, what moves the constants and is none of them, and bounds.

Values are in mm, N, MPa and deg; every fault is noted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, Literal, cast

from study.ground import units
from study.ground.declaration import (
    DERIVED,
    AsWritten,
    Bad,
    Faults,
    Reads,
    Rows,
    Schema,
    Table,
    all_about,
    as_written,
    choice,
    entries,
    is_about,
    noted,
    number,
    read_table,
    section,
    shown,
    values_of,
    with_values,
    written_keys,
)
from study.ground.errors import nearest
from study.mechanics.measurement.measurement_section import MeasurementSpec
from study.mechanics.setup.calibration_table import ANALYTIC_KEYS, Bounds, Fitting, bounds_of
from study.mechanics.setup.material_section import MaterialSection
from study.simulation.cell import CellProblem
from study.simulation.problem_file import StudyTable, default_name, dimension_of, resolve_problem

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
    dimension = dimension_of(name) if table in _TABLES else None
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


def _weight(value: object) -> str | float:
    words = choice("scatter", "equal", "relative")
    return words(value) if isinstance(value, str) else number(0, 1e12)(value)


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
