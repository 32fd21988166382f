"""Files of one problem and of one calibration: their tables with fixed keys, declared once.

Values are in mm, N, MPa and deg. Tables that cells of a design may vary are read where a cell is
resolved.
"""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path
from typing import Annotated

from study.external.parameters import parameter_key
from study.ground import units
from study.ground.declaration import (
    AsWritten,
    Bad,
    Duration,
    Length,
    Reads,
    Rows,
    as_written,
    choice,
    integer,
    number,
    section,
    shown,
    slug,
    text,
    texts,
)
from study.mechanics.setup.calibration_table import Fitting
from study.mechanics.setup.setup import MESH_LEVELS
from study.simulation import overlay
from study.simulation.response import RESPONSES

SCHEMA = 1
MAX_TESTS = 1000
QUANTITIES = ("peak_force", "work", "curve_rms", *RESPONSES)
FORMATS = ("html", "pdf", "tex", "csv")


def _schema(value: object) -> int:
    if isinstance(value, bool) or value != SCHEMA:
        raise Bad(f"must be {SCHEMA}, got {shown(value)}", "this version reads schema 1 only")
    return SCHEMA


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


_Schema = Annotated[int, Reads(_schema, mend=f"write schema = {SCHEMA} on the first line")]
_Tests = Annotated[
    tuple[TestTable, ...], Rows(1, MAX_TESTS, "write [[tests]]", f"must be 1 to {MAX_TESTS} tables")
]


@section
class ProblemFile:
    """A file for one forward simulation."""

    schema: _Schema
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

    schema: _Schema
    study: StudyTable = StudyTable()
    specimen: AsWritten = None
    material: AsWritten = None
    model: AsWritten = None
    tests: _Tests = ()
    calibration: Fitting = Fitting()
    nuisance: AsWritten = None
