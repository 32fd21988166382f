"""Records: the JSON documents that are kept on disk, one finished case, and its sealed text.

A document is a plain dictionary, as JSON gives it back; its class says what stands in it, so that
a reader's mistake is found before it runs, and a damaged file when it is read. Forces are in N,
lengths in mm, constants of a fit in MPa and those of a record in kPa (exponents plain).

A record is stored as JSON with a sha256 over its canonical content, so that a truncated or
altered file is found, never used. JSON has no NaN: a number that is not finite is stored as
null, and ``extra["not_finite"]`` says where it stood and what it was.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, NotRequired, Required, cast

import numpy as np
from pydantic import AllowInfNan, Field, TypeAdapter, ValidationError
from typing_extensions import TypedDict

from study.ground.arrays import Array
from study.ground.canonical import json_text, plain
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError, NewerSchemaError, StoreError, nearest
from study.ground.files import parse_json, write_atomic
from study.ground.tabular import is_formula

if TYPE_CHECKING:
    from pandas import DataFrame, Series


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


# One finished case: the only thing that crosses the disk.

SCHEMA = 1
#: where a record keeps the text that it was read from
_READ = "_read"
#: status of a case that has an answer
CONVERGED = "converged"
STATUSES = (
    CONVERGED,
    "not-converged",
    "mesh-failed",
    "unstable",
    "lost-contact",
    "out-of-memory",
    "timeout",
    "crashed",
    "failed",
)


@dataclass(frozen=True, eq=False)
class Record:
    """Result of one case, or the reason why there is none; equal when its JSON is."""

    case_id: str
    study: str
    levels: Mapping[str, str] = field(default_factory=dict)
    block: str | None = None
    status: str = "converged"
    message: str = ""
    responses: Mapping[str, ResponseDocument] = field(default_factory=dict)
    #: Constants averaged over the fits, by name.
    parameters: Mapping[str, ParameterDocument] = field(default_factory=dict)
    #: Every fit by the label of what was fitted; None where constants were given.
    fit: Mapping[str, FitDocument] | None = None
    curves: Mapping[CurveKey, Curve] = field(default_factory=dict)
    #: Seconds of each part; ``"total"`` is shown in tables.
    timings: Mapping[str, float] = field(default_factory=dict)
    mesh: MeshDocument = field(default_factory=MeshDocument)
    solver: SolverDocument = field(default_factory=SolverDocument)
    #: Versions of everything that may move a digit.
    versions: Mapping[str, str] = field(default_factory=dict)
    #: Hash of everything that decides the answer: case, data, configuration, code version.
    input_hash: str = ""
    #: Anything else that JSON can hold.
    extra: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.status not in STATUSES:
            raise ValueError(f"unknown status {self.status!r}; {nearest(self.status, STATUSES)}")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Record) and self.to_json() == other.to_json()

    def __hash__(self) -> int:
        return hash((self.case_id, self.study))

    @property
    def converged(self) -> bool:
        """Whether the case has an answer."""
        return self.status == CONVERGED

    def response(self, name: str) -> float:
        """Value of a response; NaN where it is missing or the case has no answer."""
        value = self.value(name) if self.converged else None
        return math.nan if value is None else value

    def value(self, name: str) -> float | None:
        """Look up the value of a response, whatever the status; None where there is none."""
        response = self.responses.get(name)
        value = None if response is None else response["value"]
        return None if value is None else float(value)

    @property
    def fits(self) -> tuple[FitDocument, ...]:
        """Every fit of the case."""
        return tuple((self.fit or {}).values())

    @property
    def scores(self) -> tuple[ScoreDocument, ...]:
        """Every scored curve of the case; empty without an answer, or for a refit."""
        written = self.extra.get("directions", ()) if self.converged else ()
        return tuple(cast("Sequence[ScoreDocument]", written))

    @property
    def markers(self) -> tuple[MarkerDocument, ...]:
        """What markers inside the specimen say; empty where it has none."""
        written = self.extra.get("markers", ()) if self.converged else ()
        return tuple(cast("Sequence[MarkerDocument]", written))

    @property
    def retries(self) -> tuple[RetryDocument, ...]:
        """Every attempt before this one; empty where the design's own setting gave it."""
        return tuple(cast("Sequence[RetryDocument]", self.extra.get("retries", ())))

    def pair(self, label: str) -> tuple[Curve, Curve] | None:
        """Measured and predicted curve of a label; None unless both are kept."""
        measured = self.curves.get(CurveKey("measured", label))
        predicted = self.curves.get(CurveKey("predicted", label))
        return None if measured is None or predicted is None else (measured, predicted)

    def first_pair(self) -> tuple[Curve, Curve] | None:
        """Measured and predicted curve of the first direction; None without a prediction."""
        labels = (key.label for key in self.curves if key.role == "predicted")
        return next((pair for label in labels if (pair := self.pair(label)) is not None), None)

    def first_prediction(self) -> Curve | None:
        """Predicted curve of the first direction; None without a prediction."""
        predicted = (curve for key, curve in self.curves.items() if key.role == "predicted")
        return next(predicted, None)

    def to_json(self) -> str:
        """Text of the record with its checksum; never holds a bare NaN."""
        # Of a record that was read it is the text itself, where this version wrote it.
        text = self.__dict__.get(_READ)
        if text is not None:
            return str(text)
        lost: dict[str, str] = {}
        content: dict[str, object] = {
            f.name: plain(getattr(self, f.name), f.name, lost)
            for f in fields(self)
            if f.name not in ("curves", "extra")
        }
        content["curves"] = {
            str(key): plain(curve.as_dict(), f"curves.{key}", lost)
            for key, curve in self.curves.items()
        }
        extra = plain(self.extra, "extra", lost)
        if lost:
            before = cast("Mapping[str, str]", extra.get("not_finite", {}))
            extra["not_finite"] = plain({**before, **lost})
        return seal(content | {"extra": extra})

    @classmethod
    def from_json(cls, text: str | bytes, source: str = "record") -> Record:
        """Read a record back."""
        content = unseal(text, source)
        fault = fault_of(content, RecordDocument)
        fields_read = cast("dict[str, Any]", content)
        if not fault and set(fields_read) != set(RecordDocument.__annotations__):
            fault = "its fields are others"
        if fault:
            raise StoreError(f"{source}: is no record of a case, {fault}")
        try:
            written = fields_read.pop("curves")
            curves = {CurveKey.of(key): Curve.from_dict(curve) for key, curve in written.items()}
            record = cls(**fields_read, curves=curves)
        except (TypeError, ValueError, LookupError, ArithmeticError, StoreError) as error:
            raise StoreError(f"{source}: is not a valid record ({error})") from error
        fault = fault_of_fits(record.fit or {}) or fault_of_curves(curves, record.scores)
        if fault:
            raise StoreError(f"{source}: is no record of a case, {fault}")
        if isinstance(text, str) and _SEALED.fullmatch(text.encode()):
            record.__dict__[_READ] = text  # a worker's, on its way to the disk
        return record


#: a file as :func:`seal` writes it
_SEALED = re.compile(
    rb'\{"schema":%d,"checksum":"(?P<checksum>[0-9a-f]{64})","content":(?P<content>.*)\}\s*'
    % SCHEMA,
    re.DOTALL,
)


def seal(content: object) -> str:
    """JSON text of a content with schema and checksum."""
    text = json_text(content)
    checksum = hashlib.sha256(text.encode()).hexdigest()
    return f'{{"schema":{SCHEMA},"checksum":"{checksum}","content":{text}}}\n'


def unseal(text: str | bytes, source: str) -> object:
    """Content of a sealed text, as JSON gives it."""
    data = text.encode() if isinstance(text, str) else text
    as_written = _SEALED.fullmatch(data)
    if as_written is not None:
        content = as_written["content"]
        if hashlib.sha256(content).hexdigest() == as_written["checksum"].decode():
            return parse_json(content, source)  # byte for byte what was sealed
    whole = parse_json(data, source)
    schema = whole.get("schema") if isinstance(whole, dict) else None
    if isinstance(schema, int) and schema > SCHEMA:
        raise NewerSchemaError(
            f"{source}: was written by a newer study (schema {schema}, this version reads "
            f"{SCHEMA}); it is left as it is. Update this one with pip install --upgrade, or "
            "name another folder with --results"
        )
    if not isinstance(whole, dict) or set(whole) != {"schema", "checksum", "content"}:
        raise StoreError(f"{source}: is not a sealed file of this program")
    if whole["schema"] != SCHEMA:
        raise StoreError(f"{source}: has schema {whole['schema']!r}, this version reads {SCHEMA}")
    try:
        checksum = hashlib.sha256(json_text(whole["content"]).encode()).hexdigest()
    except (ValueError, RecursionError) as error:
        raise StoreError(f"{source}: holds what no record can hold ({error})") from error
    if checksum != whole["checksum"]:
        raise StoreError(f"{source}: is damaged, its checksum does not fit its content")
    return whole["content"]


# The tidy table of a study: one row per case, failed cases included.

FIXED = ("case_id", "block", "status", "seconds", "dofs")
#: columns that number the replicates of a cell, and the number of the case that they repeat
REPLICATES = {"mesh_seed": 1, "noise_seed": 0, "replicate": 1}


def is_repeat(extra: Mapping[str, object]) -> bool:
    """Whether a case repeats another one for an error term."""
    return any(replicate(extra, name) != first for name, first in REPLICATES.items())


def is_same_run(extra: Mapping[str, object]) -> bool:
    """Whether a case is a run that counts already, on another mesh or with drawn noise."""
    # a replicate of a stochastic simulation is a run of its own, as the first one is
    return is_repeat({name: number for name, number in extra.items() if name != "replicate"})


def replicate(extra: Mapping[str, object], name: str) -> int:
    """Read the number that a case has among its repeats."""
    number = extra.get(name)
    return number if isinstance(number, int) and number else REPLICATES[name]


def table(records: Sequence[Record]) -> DataFrame:
    """Tidy table of records, in the order given."""
    import pandas as pd

    factors = list(records[0].levels) if records else []
    seen: set[str] = set()
    for record in records:
        if set(record.levels) != set(factors):
            raise StoreError(
                f"case {record.case_id}: its factors are {sorted(record.levels)}, those of the "
                f"first record {sorted(factors)}; records of different studies are not mixed"
            )
        if record.case_id in seen:
            raise StoreError(f"case {record.case_id} stands twice among the records")
        seen.add(record.case_id)
    units = _units(records)
    numbered = [n for n in REPLICATES if any(n in r.extra for r in records)]
    clash = [n for n in factors if n in FIXED or n in units or n in numbered]
    if clash:
        raise StoreError(f"factor {clash[0]!r} has the name of another column; rename it")
    columns: dict[str, list[object]] = {
        "case_id": [r.case_id for r in records],
        "block": [r.block for r in records],
        **{name: [r.levels[name] for r in records] for name in factors},
        **{n: [replicate(r.extra, n) for r in records] for n in numbered},
        "status": [r.status for r in records],
    }
    numbers = {name: [r.response(name) for r in records] for name in units}
    numbers.setdefault("seconds", [_number(r.timings.get("total")) for r in records])
    numbers.setdefault("dofs", [_number(r.mesh.get("dofs")) for r in records])
    frame = pd.DataFrame(
        {name: pd.Series(values, dtype=object) for name, values in columns.items()}
        | {name: pd.Series(values, dtype=float) for name, values in numbers.items()}
    )
    frame.attrs["units"] = units
    return frame


def cell_names(frame: DataFrame, factors: Sequence[str]) -> Series[str]:
    """Name the cell of every row: its levels joined by ``:``."""
    import pandas as pd

    columns = [frame[name].astype(str) for name in factors]
    joined = [":".join(levels) for levels in zip(*columns, strict=True)]
    return pd.Series(joined, index=frame.index, dtype=str)


def answered_often(
    table_known: DataFrame, factors: Sequence[str], block: str, blocks: int
) -> Series[bool]:
    """Tell which rows belong to a cell with an answer in more than half of so many blocks."""
    cell = cell_names(table_known, factors)
    return 2 * table_known[block].groupby(cell).transform("nunique") > blocks


def write_csv(frame: DataFrame, path: Path) -> None:
    """Write a table as CSV, whole or not at all."""
    texts = [("header", str(name)) for name in frame.columns]
    for name in frame.columns:
        values = dict.fromkeys(v for v in frame[name].tolist() if isinstance(v, str))
        texts += [(f"column {name}", value) for value in values]
    faults = [
        Fault(
            f"{path.name}: {where}",
            f"a spreadsheet would run {text[:40]!r} as a formula",
            "rename it so that it does not begin with = + - @ or a control character",
        )
        for where, text in texts
        if is_formula(text)
    ]
    if faults:
        raise InputError(list(dict.fromkeys(faults))[:20])
    text = frame.to_csv(index=False, lineterminator="\n")
    try:
        data = text.encode()
    except UnicodeEncodeError as error:
        raise InputError(Fault(path.name, f"a name is not valid text ({error.reason})")) from error
    write_atomic(path, data)


def _units(records: Sequence[Record]) -> dict[str, str]:
    units: dict[str, str] = {}
    for record in records:
        for name, response in record.responses.items():
            unit = str(response.get("unit", ""))
            if units.setdefault(name, unit) != unit:
                raise StoreError(
                    f"case {record.case_id}: {name} is in {unit!r}, elsewhere in {units[name]!r}"
                )
    return units


def _number(value: object) -> float:
    return float(value) if isinstance(value, (int, float)) else float("nan")
