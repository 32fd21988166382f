"""Files of one problem and of one calibration: their tables with fixed keys, declared once.

Values are in mm, N, MPa and deg. Tables that cells of a design may vary are read where a cell is
resolved.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

from study.external.parameters import parameter_key
from study.ground import units
from study.ground.declaration import (
    DERIVED,
    AsWritten,
    Bad,
    Duration,
    Length,
    Reads,
    Rows,
    Schema,
    as_written,
    choice,
    integer,
    number,
    section,
    shown,
    slug,
    text,
    texts,
    values_of,
    written_keys,
)
from study.ground.diagnostics import Faults, entries, noted, read_table, with_values
from study.ground.errors import nearest
from study.mechanics.measurement.measurement_section import MeasurementSpec
from study.mechanics.setup.calibration_table import Bounds, Fitting
from study.mechanics.setup.material_section import MaterialSection
from study.mechanics.setup.setup import MESH_LEVELS
from study.simulation import overlay
from study.simulation.cell import CellProblem
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
    return re.sub(r"[^A-Za-z0-9_-]+", "-", stem).strip("-")[:80] or "study"


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
