"""The study file: every table with fixed keys, declared once; values in mm, N, MPa and deg.

The declarations of a problem's tables stand in ``setup``, those of measured files in
:mod:`study.mechanics.measurement`, and of the kinds of ``[design]`` in :mod:`study.harness.design`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Annotated, Literal

from study.ground import units
from study.ground.contrast import Threshold
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
    reason,
    section,
    shown,
    slug,
    text,
    texts,
)
from study.ground.diagnostics import flatten
from study.ground.errors import nearest
from study.harness.design import overlay
from study.harness.design.forward_section import value_unit
from study.harness.design.parameters import Constraint, is_parameter
from study.mechanics.material.material import is_constant, unit_shown
from study.mechanics.setup.calibration_table import Fitting
from study.mechanics.setup.setup import MESH_LEVELS

# Responses of a predicted curve alone, by their names in a study file.

#: responses of a predicted curve alone, with their units; those at a displacement name it, too
SIMULATED = {
    "peak_force": "N",
    "work": "N mm",
    "force_at": "N",
    "stiffness_at": "N/mm",
    "peak_contact_pressure": "kPa",
    "contact_area": "mm^2",
    "side_force": "N",
    "moment": "N mm",
    "base_force": "N",
    "base_side_force": "N",
    "base_moment": "N mm",
    "dofs": "",
}

AT_DISPLACEMENT = ("force_at", "stiffness_at")


def simulated_at(name: str) -> tuple[str, float | None]:
    """Split the name of a response at a displacement into the response and the place in mm."""
    for start in AT_DISPLACEMENT:
        displacement = name.removeprefix(f"{start}_").removesuffix("_mm")
        if name == f"{start}_{displacement}_mm":
            return start, float(displacement)
    return name, None


def is_simulated(name: str) -> bool:
    """Whether a response is one of the predicted curve alone."""
    return simulated_at(name)[0] in SIMULATED


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


SCHEMA = 1
MAX_RESPONSES = 50
MAX_EXCLUSIONS = 4096
MAX_TESTS = 1000
#: cells of a design that draws them
MAX_RUNS = 1024
#: terms that may be declared primary before the run
MOST_PRIMARY = 3
#: responses that compare with measured curves
SCORED = ("relative_rms_force_error", "rms_force_error", "peak_force_error", "work_error")
#: responses that compare with the displacements of markers inside a specimen
MARKED = ("marker_error", "predicted_marker_error")
#: unit of every other response; constants are reported in kPa, exponents plain
RESPONSES = {
    "relative_rms_force_error": "%",
    "rms_force_error": "N",
    "peak_force_error": "N",
    "work_error": "%",
    **dict.fromkeys(MARKED, "mm"),
    "mu0": "kPa",
    "seconds": "s",
}
QUANTITIES = ("peak_force", "work", "curve_rms", *RESPONSES)
FORMATS = ("html", "pdf", "tex", "csv")
#: what a factor is: decided by the analyst; a part of the question, answered at each level; a
#: fact that nobody measured, never recommended
ROLES = ("choice", "condition", "unknown")
RESPONSES_MEND = '[[response]] with name = "relative_rms_force_error"'
#: least and most meshes of a cell (below five their scatter is not known well enough), and
#: resamples of a fit (the scatter of 20 is known to 16 %, of 200 to 5 %)
SEEDS = (5, 1000)
MOST_SEEDS = 10_000
RESAMPLES = (20, 10_000)
#: what may be changed of a case that has no answer
SMALLER_STEPS = "smaller-steps"
FINER_MESH = "finer-mesh"
LONGER_LIMIT = "longer-limit"
MORE_MEMORY = "more-memory"
#: causes of which something can be tried, and what may help
REMEDIES = {
    "not-converged": (SMALLER_STEPS, FINER_MESH),
    "unstable": (SMALLER_STEPS, FINER_MESH),
    "mesh-failed": (FINER_MESH,),
    "timeout": (LONGER_LIMIT,),
    "out-of-memory": (MORE_MEMORY,),
    "crashed": (MORE_MEMORY,),
}


def response_unit(name: str) -> str | None:
    """Find the unit of a response: "" for a plain number, None if there is no such response."""
    if name in RESPONSES:
        return RESPONSES[name]
    if is_simulated(name):
        return SIMULATED[simulated_at(name)[0]]
    if not is_constant(name):
        return None
    return unit_shown(name)


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


def _response_name(value: object) -> str:
    """Read a name; whether there is such a response is asked where the forward model is known."""
    if not isinstance(value, str) or not value.replace("-", "_").isidentifier():
        valid = (*RESPONSES, *SIMULATED, "or a constant such as C10")
        raise Bad(f"unknown response {shown(value)}", nearest(str(value)[:80], valid))
    return value


def _parameter_key(example: str, value: object) -> str:
    """Read a dotted key of ``[parameters]``."""
    if not isinstance(value, str) or not is_parameter(value):
        raise Bad(f"must be a key of [parameters], got {shown(value)}", f"for example {example}")
    return value


_refined_key = partial(_parameter_key, 'key = "parameters.h"; [model] is refined without a key')
_seed_key = partial(_parameter_key, 'key = "parameters.seed"')


def _share(value: object) -> float:
    """Read a share: a plain number, or percent."""
    if not isinstance(value, str):
        return number(0, 1, mend='for example "1 %"')(value)
    percent = units.parse_percent(value)
    if 0 < percent < 100:
        return percent / 100
    raise Bad(f"must be between 0 % and 100 %, got {shown(value)}")


def _count(low: int, high: int, why: str, value: object) -> int:
    """Read a number of repeats; below ``low`` the reason is told."""
    count = integer(0, high)(value)
    if count < low:
        raise Bad(f"must be at least {low}, got {shown(value)}: with fewer {why}")
    return count


_seeds = partial(_count, *SEEDS, "the scatter of the mesh is not known")
_resamples = partial(_count, *RESAMPLES, "the scatter of the fits is not known")


def _formats(value: object) -> tuple[str, ...]:
    """Read one format or several."""
    items = value if isinstance(value, list) else [value]
    return tuple(dict.fromkeys(choice(*FORMATS)(item) for item in items)) or ("html",)


def _primary(value: object) -> tuple[str, ...]:
    """Read the terms that were declared before the run; three at most, or they are no choice."""
    terms = texts("terms", "material")(value)
    if len(terms) > MOST_PRIMARY:
        raise Bad(f"has {len(terms)} terms, at most {MOST_PRIMARY} are a choice before the run")
    return terms


def _roles(value: object) -> tuple[tuple[str, str], ...]:
    """Read the role of every factor that has one."""
    if not isinstance(value, Mapping):
        mend = 'for example { plates = "unknown", range = "condition" }'
        raise Bad(f"must be a table of factors, got {shown(value)}", mend)
    return tuple((name, choice(*ROLES)(role)) for name, role in flatten(value).items())


def _retry(value: object) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Read what is tried of every cause."""
    if not isinstance(value, Mapping):
        mend = f'for example {{ not-converged = ["{SMALLER_STEPS}", "{FINER_MESH}"] }}'
        raise Bad(f"must be a table of causes, got {shown(value)}", mend)
    read_causes = []
    for cause, remedies in value.items():
        read = choice(*REMEDIES[choice(*REMEDIES)(cause)])
        changes = remedies if isinstance(remedies, list) else [remedies]
        read_causes.append((cause, tuple(dict.fromkeys(map(read, changes)))))
    return tuple(read_causes)


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
class Replicates:
    """What is computed several times for an error term; at most one of the two."""

    mesh_seeds: Annotated[int, Reads(_seeds)] = 0
    noise: Annotated[int, Reads(_resamples)] = 0
    #: Parameter that is the seed of a stochastic simulation, and how many a cell has.
    key: Annotated[str | None, Reads(_seed_key)] = None
    n: Annotated[int, Reads(integer(2, MOST_SEEDS))] = 2


def _added(value: object) -> tuple[tuple[float, ...], ...]:
    """Read cells that a run has added, as shares of every range."""
    if not isinstance(value, list):
        raise Bad(f"must be a list of cells, got {shown(value)}", "leave it to `study run`")
    share = number(0.0, 1.0, closed=True)
    return tuple(tuple(share(x) for x in (c if isinstance(c, list) else [c])) for c in value)


_Cells = Annotated[int, Reads(integer(2, MAX_RUNS), mend="say how many, for example 32")]


@section
class Sequential:
    """How cells are added to a design while it runs."""

    #: Cells of the Latin hypercube that it begins with, equally many at every combination of the
    #: factors that are no ranges.
    start: _Cells
    #: Most cells in all.
    budget: _Cells
    kind: Literal["adaptive"] = "adaptive"
    #: Cells added at a time; it decides the result, the number of workers does not.
    batch: Annotated[int, Reads(integer(1, 100))] = 4
    #: What ends it before the budget does: every response has this Q2, or every factor a verdict.
    until: Annotated[str, Reads(choice("q2", "verdict"))] = "q2"
    #: Leave-one-out Q2 that is enough.
    q2: Annotated[float, Reads(number(0.5, 1.0))] = 0.95
    #: Of the draw; that of ``[study]`` by default.
    seed: Annotated[int, Reads(integer(0, 2**32 - 1))] = None  # type: ignore[assignment]
    #: Cells that a run has added: the share of every factor's range, in the order of the factors.
    added: Annotated[tuple[tuple[float, ...], ...], Reads(_added)] = ()


@section
class Execution:
    """What is tried of a case without an answer, by its cause; the report lists such cases."""

    retry: Annotated[tuple[tuple[str, tuple[str, ...]], ...], Reads(_retry)] = ()


@section
class Report:
    """Formats of the report."""

    format: Annotated[tuple[str, ...], Reads(_formats)] = ("html",)


#: Terms of an analysis: all, those up to an order, or those listed, ``"A"`` or ``"A:B"``.
Terms = str | int | tuple[str, ...]


@section
class Analysis:
    """How the table of cases is analyzed; ``model`` is by default what the design can tell."""

    model: Annotated[Terms, as_written()] = None  # type: ignore[assignment]
    #: Of the sums of squares.
    type: Annotated[str, Reads(choice("I", "II", "III"))] = "II"
    #: What effects are compared with.
    error: Annotated[str, Reads(choice("auto", "pooled", "own", "replicates"))] = "auto"
    alpha: Annotated[float, Reads(number(0, 1))] = 0.05
    #: What a factor is to the question (:data:`ROLES`).
    roles: Annotated[tuple[tuple[str, str], ...], Reads(_roles)] = ()
    #: Tests that Holm's adjustment takes together: of one response, or of all.
    family: Annotated[str, Reads(choice("response", "study"))] = "response"
    #: Terms declared before the run, which then are the family; all terms where it is empty.
    primary: Annotated[tuple[str, ...], Reads(_primary)] = ()
    #: What is fitted over the factors that are ranges.
    surface: Annotated[str, Reads(choice("auto", "quadratic", "emulator", "none"))] = "auto"
    #: Differences of two settings that every response is asked for.
    contrasts: Annotated[tuple[str, ...], Reads(texts("contrasts", "stiff - soft"))] = ()


@section
class ResponseSpec:
    """One ``[[response]]``: ``practical`` in its unit, a force or stiffness at ``displacement``."""

    name: Annotated[str, Reads(_response_name, mend="for example relative_rms_force_error")]
    displacement: Length | None = None
    #: Smallest difference that matters, in its unit or as a share: "0.05 N", "2 pp", "5 % of mean".
    practical: Annotated[Threshold | None, as_written()] = None
    #: Scale on which it is analyzed.
    transform: Annotated[str, Reads(choice("none", "log"))] = "none"
    #: Of a value that a Python function returns, or a program that says none.
    unit: Annotated[str, Reads(value_unit)] = None  # type: ignore[assignment]


@section
class Exclusion:
    """One ``[[exclude]]``: labels of levels by factor, and why their cells are left out."""

    why: Annotated[str, Reads(reason, mend='say why: why = "..."')]
    when: Annotated[Mapping[str, tuple[str, ...]], as_written('when = { material = "ogden-1" }')]

    def matches(self, levels: Mapping[str, str]) -> bool:
        """Whether a cell is left out: every factor named takes one of its labels."""
        return all(levels[name] in labels for name, labels in self.when.items())


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
_Responses = Annotated[tuple[ResponseSpec, ...], Rows(1, MAX_RESPONSES, RESPONSES_MEND)]
_Exclusions = Annotated[tuple[Exclusion, ...], Rows(0, MAX_EXCLUSIONS, "write [[exclude]]")]
_Constraints = Annotated[tuple[Constraint, ...], Rows(0, MAX_EXCLUSIONS, "write [[constraint]]")]
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
class DesignFile(ProblemFile):
    """A file of a study. Tables that cells may vary are read for each of them."""

    presets: AsWritten = None
    factors: AsWritten = None
    design: AsWritten = None
    exclude: _Exclusions = ()
    measurements: AsWritten = None
    markers: AsWritten = None
    calibration: AsWritten = None
    forward: AsWritten = None
    parameters: AsWritten = None
    constraint: _Constraints = ()
    response: _Responses = ()
    analysis: Analysis = Analysis()
    replicates: Replicates = Replicates()
    execution: Execution = Execution()
    expected: AsWritten = None
    virtual: Virtual | None = None


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
