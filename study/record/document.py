"""Keys and values of the JSON documents that are kept on disk.

A document is a plain dictionary, as JSON gives it back; these classes say what stands in it, so
that a reader's mistake is found before it runs, and a damaged file when it is read
(:mod:`study.record.document`). A number that may be NaN or infinite is None there. Forces
are in N, lengths in mm, constants of a fit in MPa and those of a record in kPa (exponents plain).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Annotated, NamedTuple, NotRequired, Required, cast

import numpy as np
from pydantic import AllowInfNan, Field, TypeAdapter, ValidationError
from typing_extensions import TypedDict

from study.ground.arrays import Array
from study.ground.curve import Curve
from study.ground.errors import StoreError

#: what a number or a list must keep besides its type; a larger whole number overflows where it
#: meets a float
Number = Annotated[float, AllowInfNan(False)]
Whole = Annotated[int, Field(ge=-(2**63), le=2**63)]
Positive = Annotated[int, Field(ge=1, le=2**63)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Pair = Annotated[list[Number | None], Field(min_length=2, max_length=2)]
Interval = Annotated[list[Number], Field(min_length=2, max_length=2)]
Numbers = Annotated[list[Number], Field(min_length=1)]


class Quantity(TypedDict):
    """A number with its unit; None where it could not be had."""

    value: Number | None
    unit: str


class ResponseDocument(Quantity):
    """A response; ``u_steps`` is what half the load steps would change in it."""

    u_steps: NotRequired[NotNegative | None]


class ParameterDocument(Quantity):
    """A constant with its standard error and 95 % interval, where a single fit gives them."""

    standard_error: NotRequired[Number | None]
    ci95: NotRequired[Interval | None]


class MeshDocument(TypedDict, total=False):
    """The mesh of a solution."""

    dofs: Whole
    elements: Whole
    hash: str
    mesh_size_mm: Number


class StepDocument(TypedDict):
    """One command of a solution: its words, return code and last output."""

    argv: list[str]
    code: Whole | None
    output: str


class ProgramDocument(TypedDict):
    """What another program said of itself, and which commands ran, by name and content."""

    version: str
    digest: str
    steps: list[StepDocument]


class SolverDocument(TypedDict, total=False):
    """How a solution was found, and its energy balance; ``program`` where it is another one."""

    name: str
    min_j: Number
    energy_mismatch: Number
    stabilization_share: Number
    snaps_mm: list[Number]
    penetration_mm: Number
    gap_mm: Number
    program: ProgramDocument


class PlateFitDocument(TypedDict):
    """Markers under one motion of a plate.

    ``motion`` gives value and standard error of every component: mm, deg and percent.
    """

    plate: str
    fitted: str
    markers: Whole
    error_mm: Number | None
    error_by_axis_mm: list[Number | None]
    error_by_layer_mm: dict[str, Number | None]
    motion: dict[str, Pair]


class MarkerDocument(TypedDict):
    """Markers inside a specimen in one state; the floor is what no smooth field undercuts."""

    state: str
    floor_mm: Number | None
    fits: list[PlateFitDocument]


class ResamplingDocument(TypedDict):
    """Block length and lag-1 correlation of the residuals that a bootstrap drew from."""

    block: Whole
    lag1: Number


class FitDocument(TypedDict, total=False):
    """One fit of a record; constants in MPa, exponents plain.

    A fit to resampled residuals has no intervals, and one in closed form no simulations.
    """

    key: str
    method: str
    message: str
    names: list[str]
    values: dict[str, Number]
    standard_error: dict[str, Number | None]
    ci95: dict[str, Pair | None]
    correlation: list[list[Number | None]] | None
    condition: Number | None
    rss: NotNegative | None
    r_squared: Number | None
    aicc: Number | None
    n: Positive
    identifiable: bool
    reason: str
    #: Where the model does not describe the rows, or hardly: the verdict, and why.
    verdict: str
    misfit: str
    stable: bool
    usable: bool
    stability: str
    evaluations: Whole
    newton_iterations: Whole
    solves: Whole
    #: Name of the solution that the last search began with: a process solves equal ones once.
    first_solution: str
    seconds: NotNegative
    mu0: Number
    resampling: list[ResamplingDocument]


#: ends of a fit that has constants
WITH_CONSTANTS = frozenset({"converged", "at-edge", "at-kink"})


class ScoreDocument(TypedDict):
    """One scored curve of a case: which it is, what was fitted, and its own responses."""

    score: str
    fit: str
    role: str
    scatter_N: list[Number | None] | None
    responses: dict[str, Quantity]


#: says in a note of a study that its runs were read from a table
MADE_ELSEWHERE = "made elsewhere"


def are_imported(notes: Sequence[str]) -> bool:
    """Whether the runs of a study with these notes were read from a table."""
    return any(MADE_ELSEWHERE in note for note in notes)


class ManifestDocument(TypedDict, total=False):
    """What a study is: its design as text, its cases, its data, and how long it took.

    ``cases`` maps case ids to input hashes, ``unit`` names what a block of runs from elsewhere is,
    ``files`` maps names of measured files to their sha256,
    ``truths`` those of virtual specimens to how they were made; ``finished`` is False until a run
    came to its end.
    """

    name: Required[str]
    design: Required[str]
    text: Required[str]
    source: Required[str]
    cases: Required[dict[str, str]]
    blocks: Required[list[str]]
    unit: str
    notes: Required[list[str]]
    files: dict[str, str]
    virtual: Required[bool]
    truths: dict[str, object]
    versions: dict[str, str]
    timings: dict[str, NotNegative]
    finished: bool


class ExtraDocument(TypedDict, total=False):
    """What a record holds besides its fields, as far as anybody reads it back.

    ``mesh_seed`` to ``input`` say why it was computed besides the cells of the design.
    """

    directions: list[ScoreDocument]
    markers: list[MarkerDocument]
    retries: list[RetryDocument]
    mesh_seed: Whole
    noise_seed: Whole
    replicate: Whole
    rendered: dict[str, str]
    purpose: str
    of: str
    level: Whole
    input: str
    traceback: str
    not_finite: dict[str, str]


class RetryDocument(TypedDict):
    """One more attempt at a case: what failed, what was changed, and by how much."""

    cause: str
    message: str
    change: str
    what: str


class RecordDocument(TypedDict):
    """A record; its curves are read by ``Curve``, which checks their numbers."""

    case_id: str
    study: str
    levels: dict[str, str]
    block: str | None
    status: str
    message: str
    responses: dict[str, ResponseDocument]
    parameters: dict[str, ParameterDocument]
    fit: dict[str, FitDocument] | None
    curves: dict[str, dict[str, object]]
    timings: dict[str, NotNegative | None]
    mesh: MeshDocument
    solver: SolverDocument
    versions: dict[str, str]
    input_hash: str
    extra: ExtraDocument


class StoredFitDocument(FitDocument, total=False):
    """A fit as cases share it: how it ended, and its last solution where that is a prediction."""

    status: Required[str]
    start_seconds: NotNegative
    curve: dict[str, object]
    mesh: MeshDocument
    solver: SolverDocument
    named_values: dict[str, Number]


class SolutionDocument(TypedDict, total=False):
    """A solution of a refinement series; of one without an answer status and message alone."""

    status: Required[str]
    message: str
    curve: dict[str, object]
    elements: Whole
    dofs: Whole
    mesh_hash: str
    seconds: NotNegative
    memory_MB: Number
    base_MB: Number


class NumericalRow(TypedDict):
    """Numerical uncertainty of one response in one refined cell."""

    levels: dict[str, str]
    response: str
    value: Number | None
    u_num: Number | None
    unit: str
    behaviour: str
    note: str
    mesh_size: NotRequired[list[Annotated[Number, Field(gt=0.0)]]]
    series: NotRequired[list[Number]]
    formal_order: NotRequired[Number | None]
    formal_reason: NotRequired[str]


class NumericalCells(TypedDict):
    """What ``study converge`` found, and the cases that it is of."""

    of: str
    rows: list[NumericalRow]


class SpaceRow(TypedDict):
    """One cylinder in both spaces; None where one of them could not be solved."""

    levels: dict[str, str]
    unknowns: Annotated[list[Whole], Field(min_length=2, max_length=2)]
    depth_mm: Number
    at_end: Number | None
    largest: Number | None
    message: str


class ValidationRow(TypedDict):
    """One case beside its measurement: E and each part of its uncertainty along the curve."""

    case_id: str
    levels: dict[str, str]
    block: str | None
    label: str
    role: str
    displacement_mm: Numbers
    simulated_N: Numbers
    measured_N: Numbers
    error_N: Numbers
    u_num_N: Numbers
    u_input_N: Numbers
    u_data_N: Numbers
    u_val_N: Numbers
    unknown: NotRequired[list[str]]
    outside: Number
    verdict: str


class AdaptiveStep(TypedDict):
    """What was known with so many cells: Q2 by response, what was not known, why it ended."""

    cells: Whole
    q2: dict[str, Number | None]
    open: list[str]
    stopped: str


class ConfirmedRow(TypedDict):
    """A run at a setting that a surface named: its record, and design and code that it is of."""

    case: str
    input: str
    of: str


class CurveKey(NamedTuple):
    """Name of a curve of a record: ``measured`` or ``predicted``, and which one."""

    role: str
    label: str

    def __str__(self) -> str:
        return f"{self.role}:{self.label}"

    @classmethod
    def of(cls, text: str) -> CurveKey:
        """Read the name back."""
        role, colon, label = text.partition(":")
        if not colon:
            raise StoreError(f"the curve {text!r} is neither measured nor predicted")
        return cls(role, label)


# Keys, types and finite numbers of a document that was read, compiled once for each class: a
# right checksum does not say that a study wrote it.

#: what a record must know of each of its fits
_NEEDED = ("key", "values", "identifiable")


def fault_of(content: object, kind: type) -> str:
    """Say where a content is not such a document; empty if it is one."""
    try:
        _adapter(kind).validate_python(content, strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        key = ".".join(map(str, first["loc"]))
        if first["type"] == "missing":
            return f"it has no {key}"
        _, _, expectation = first["msg"].partition("Input should ")
        whose = f"its {key}" if key else "its content"
        return f"{whose} should {expectation}" if expectation else f"{whose} has another length"
    return ""


def fault_of_fits(fits: Mapping[str, FitDocument], needed: Sequence[str] = _NEEDED) -> str:
    """Say which fit cannot be shown; empty if each can."""
    for name, fit in fits.items():
        lost = [key for key in needed if key not in fit]
        if lost:
            return f"its fit {name!r} has no {lost[0]}"
        size, rows = len(fit.get("names", ())), fit.get("correlation") or []
        if bool(rows) and [len(row) for row in rows] != [size] * size:
            return f"its fit {name!r} has correlations of other constants than its own"
    return ""


def fault_of_curves(
    curves: Mapping[CurveKey, Curve], directions: Sequence[ScoreDocument] = ()
) -> str:
    """Say which curve of a record cannot be read off, or is not there; empty if each can."""
    for key, curve in curves.items():
        if not _is_readable(curve):
            return f"its curve {key} has columns of unequal length, or gaps"
    for key, curve in curves.items():
        measured = curves.get(CurveKey("measured", key.label))
        if key.role != "predicted" or measured is None:
            continue
        # known at every measured place; see :meth:`Curve.force_at`
        there, reach = measured.displacement_mm, curve.displacement_mm
        if curve.time_s is not None:
            near = 1e-6 * float(np.abs(reach).max())
            reaches = there.shape == reach.shape and np.allclose(there, reach, rtol=0, atol=near)
        else:
            reaches = there.min() >= -1e-12 and there.max() <= reach[-1] * (1 + 1e-9) + 1e-12
        if not reaches:
            return f"its curve {key} ends before the measured one"
    lost = [row for row in directions if CurveKey("predicted", row["score"]) not in curves]
    return f"it has no curve predicted:{lost[0]['score']}" if lost else ""


def fault_of_series(rows: list[NumericalRow]) -> str:
    """Say which refined cell has not one value a mesh; empty if each has."""
    for number, row in enumerate(rows):
        if len(row.get("series", ())) != len(row.get("mesh_size", ())):
            return f"its {number}.series has another length than its mesh_size"
    return ""


def fault_of_comparisons(rows: list[ValidationRow]) -> str:
    """Say which comparison has columns of unequal length; empty if none has."""
    for number, row in enumerate(rows):
        columns: Mapping[str, object] = row
        if len({len(cast("list[float]", columns[name])) for name in _ALONG}) > 1:
            return f"its {number} has columns of unequal length"
    return ""


#: columns of a comparison along a curve
_ALONG = frozenset(name for name in ValidationRow.__annotations__ if name.endswith(("_N", "_mm")))


def _is_readable(curve: Curve) -> bool:
    """Whether each row has every number of it; forces may be unknown, places not."""
    columns = (curve.force_N, curve.stiffness_N_per_mm, curve.work_Nmm, curve.time_s)
    shape = curve.displacement_mm.shape
    alike = len(shape) == 1 and all(column is None or column.shape == shape for column in columns)
    if not alike or not shape[0] or not _is_finite(curve.displacement_mm):
        return False
    if curve.time_s is not None and not _is_finite(curve.time_s):
        return False
    return _is_finite(curve.force_N) or not bool(np.isinf(curve.force_N).any())


def _is_finite(values: Array) -> bool:
    """Whether every number is finite, which the ends tell sooner than every number does."""
    return math.isfinite(values.max()) and math.isfinite(values.min())


@cache
def _adapter(kind: type) -> TypeAdapter[object]:
    return TypeAdapter(kind)
