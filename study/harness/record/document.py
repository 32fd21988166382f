"""Keys and values of the JSON documents that are kept on disk.

A document is a plain dictionary, as JSON gives it back; these classes say what stands in it, so
that a reader's mistake is found before it runs, and a damaged file when it is read
(:mod:`study.harness.record.document`). A number that may be NaN or infinite is None there. Forces
are in N, lengths in mm, constants of a fit in MPa and those of a record in kPa (exponents plain).
"""

from __future__ import annotations

import math
import types
from collections.abc import Mapping, Sequence
from functools import cache
from typing import (
    Annotated,
    NamedTuple,
    NotRequired,
    Required,
    TypedDict,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

import numpy as np
from pydantic_core import SchemaValidator, ValidationError, core_schema
from pydantic_core.core_schema import CoreSchema

from study.ground.arrays import Array
from study.ground.curve import Curve
from study.ground.errors import StoreError

#: what a number or a list must keep besides its type
Positive = Annotated[int, ("ge", 1)]
NotNegative = Annotated[float, ("ge", 0.0)]
Pair = Annotated[list[float | None], ("min_length", 2), ("max_length", 2)]
Interval = Annotated[list[float], ("min_length", 2), ("max_length", 2)]
Numbers = Annotated[list[float], ("min_length", 1)]


class Quantity(TypedDict):
    """A number with its unit; None where it could not be had."""

    value: float | None
    unit: str


class ResponseDocument(Quantity):
    """A response; ``u_steps`` is what half the load steps would change in it."""

    u_steps: NotRequired[NotNegative | None]


class ParameterDocument(Quantity):
    """A constant with its standard error and 95 % interval, where a single fit gives them."""

    standard_error: NotRequired[float | None]
    ci95: NotRequired[Interval | None]


class MeshDocument(TypedDict, total=False):
    """The mesh of a solution."""

    dofs: int
    elements: int
    hash: str
    mesh_size_mm: float


class StepDocument(TypedDict):
    """One command of a solution: its words, return code and last output."""

    argv: list[str]
    code: int | None
    output: str


class ProgramDocument(TypedDict):
    """What another program said of itself, and which commands ran, by name and content."""

    version: str
    digest: str
    steps: list[StepDocument]


class SolverDocument(TypedDict, total=False):
    """How a solution was found, and its energy balance; ``program`` where it is another one."""

    name: str
    min_j: float
    energy_mismatch: float
    stabilization_share: float
    snaps_mm: list[float]
    penetration_mm: float
    gap_mm: float
    program: ProgramDocument


class PlateFitDocument(TypedDict):
    """Markers under one motion of a plate.

    ``motion`` gives value and standard error of every component: mm, deg and percent.
    """

    plate: str
    fitted: str
    markers: int
    error_mm: float | None
    error_by_axis_mm: list[float | None]
    error_by_layer_mm: dict[str, float | None]
    motion: dict[str, Pair]


class MarkerDocument(TypedDict):
    """Markers inside a specimen in one state; the floor is what no smooth field undercuts."""

    state: str
    floor_mm: float | None
    fits: list[PlateFitDocument]


class ResamplingDocument(TypedDict):
    """Block length and lag-1 correlation of the residuals that a bootstrap drew from."""

    block: int
    lag1: float


class FitDocument(TypedDict, total=False):
    """One fit of a record; constants in MPa, exponents plain.

    A fit to resampled residuals has no intervals, and one in closed form no simulations.
    """

    key: str
    method: str
    message: str
    names: list[str]
    values: dict[str, float]
    standard_error: dict[str, float | None]
    ci95: dict[str, Pair | None]
    correlation: list[list[float | None]] | None
    condition: float | None
    rss: NotNegative | None
    r_squared: float | None
    aicc: float | None
    n: Positive
    identifiable: bool
    reason: str
    #: Where the model does not describe the rows, or hardly: the verdict, and why.
    verdict: str
    misfit: str
    stable: bool
    usable: bool
    stability: str
    evaluations: int
    newton_iterations: int
    solves: int
    seconds: NotNegative
    mu0: float
    resampling: list[ResamplingDocument]


class ScoreDocument(TypedDict):
    """One scored curve of a case: which it is, what was fitted, and its own responses."""

    score: str
    fit: str
    role: str
    scatter_N: list[float | None] | None
    responses: dict[str, Quantity]


class ManifestDocument(TypedDict, total=False):
    """What a study is: its design as text, its cases, its data, and how long it took.

    ``cases`` maps case ids to input hashes, ``files`` names of measured files to their sha256,
    ``truths`` those of virtual specimens to how they were made; ``finished`` is False until a run
    came to its end.
    """

    name: Required[str]
    design: Required[str]
    text: Required[str]
    source: Required[str]
    cases: Required[dict[str, str]]
    blocks: Required[list[str]]
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
    mesh_seed: int
    noise_seed: int
    replicate: int
    rendered: dict[str, str]
    purpose: str
    of: str
    level: int
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
    named_values: dict[str, float]


class SolutionDocument(TypedDict, total=False):
    """A solution of a refinement series; of one without an answer status and message alone."""

    status: Required[str]
    message: str
    curve: dict[str, object]
    elements: int
    dofs: int
    mesh_hash: str
    seconds: NotNegative
    memory_MB: float
    base_MB: float


class NumericalRow(TypedDict):
    """Numerical uncertainty of one response in one refined cell."""

    levels: dict[str, str]
    response: str
    value: float | None
    u_num: float | None
    unit: str
    behaviour: str
    note: str
    mesh_size: NotRequired[list[Annotated[float, ("gt", 0.0)]]]
    series: NotRequired[list[float]]
    formal_order: NotRequired[float | None]
    formal_reason: NotRequired[str]


class NumericalCells(TypedDict):
    """What ``study converge`` found, and the cases that it is of."""

    of: str
    rows: list[NumericalRow]


class SpaceRow(TypedDict):
    """One cylinder in both spaces; None where one of them could not be solved."""

    levels: dict[str, str]
    unknowns: Annotated[list[int], ("min_length", 2), ("max_length", 2)]
    depth_mm: float
    at_end: float | None
    largest: float | None
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
    outside: float
    verdict: str


class AdaptiveStep(TypedDict):
    """What was known with so many cells: Q2 by response, what was not known, why it ended."""

    cells: int
    q2: dict[str, float | None]
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
#: whole numbers of a document; a larger one overflows where it meets a float
_LARGEST = 2**63


def fault_of(content: object, kind: type) -> str:
    """Say where a content is not such a document; empty if it is one."""
    try:
        _validator(kind).validate_python(content)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        place = ".".join(map(str, first["loc"]))
        if first["type"] == "missing":
            return f"it has no {place}"
        _, _, expectation = first["msg"].partition("Input should ")
        whose = f"its {place}" if place else "its content"
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
def _validator(kind: type) -> SchemaValidator:
    return SchemaValidator(_schema(kind))


_PLAIN: Mapping[object, CoreSchema] = {
    str: core_schema.str_schema(strict=True),
    bool: core_schema.bool_schema(strict=True),
    int: core_schema.int_schema(strict=True, ge=-_LARGEST, le=_LARGEST),
    float: core_schema.float_schema(strict=True, allow_inf_nan=False),
    object: core_schema.any_schema(),
}


def _schema(hint: object) -> CoreSchema:
    """Compile a type as the documents use them."""
    if is_typeddict(hint):
        return _table(cast(type, hint))
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return cast(CoreSchema, {**_schema(inner[0]), **dict(inner[1:])})
    if origin in (Union, types.UnionType):
        (inner_hint,) = (kind for kind in inner if kind is not types.NoneType)
        return core_schema.nullable_schema(_schema(inner_hint))
    if origin is dict:
        return core_schema.dict_schema(_PLAIN[str], _schema(inner[1]), strict=True)
    if origin is list:
        return core_schema.list_schema(_schema(inner[0]), strict=True)
    return _PLAIN[hint]


def _table(kind: type) -> CoreSchema:
    """Compile a dictionary with known keys; what else it holds is nobody's business."""
    fields = {}
    by_class: frozenset[str] = kind.__dict__["__required_keys__"]
    for name, hint in get_type_hints(kind, include_extras=True).items():
        # in annotations that are kept as text the class itself does not see these two
        qualifier = get_origin(hint) if get_origin(hint) in (Required, NotRequired) else None
        required = qualifier is Required if qualifier else name in by_class
        inner = get_args(hint)[0] if qualifier else hint
        fields[name] = core_schema.typed_dict_field(_schema(inner), required=required)
    return core_schema.typed_dict_schema(fields, strict=True, extra_behavior="ignore")
