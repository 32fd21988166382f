"""Keys and values of the JSON documents that are kept on disk.

A document is a plain dictionary, as JSON gives it back; these classes say what stands in it, so
that a reader's mistake is found before it runs, and a damaged file when it is read
(:mod:`study.record.document_checks`). A number that may be NaN or infinite is None there. Forces
are in N, lengths in mm, constants of a fit in MPa and those of a record in kPa (exponents plain).
"""

from __future__ import annotations

from typing import Annotated, NamedTuple, NotRequired, Required, TypedDict

from study.errors import StoreError

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
    purpose: str
    of: str
    level: int
    input: str
    fields: str
    traceback: str
    not_finite: dict[str, str]


class RetryDocument(TypedDict):
    """One more attempt at a case: what failed, what was changed, and by how much."""

    cause: str
    message: str
    change: str
    what: str


class RecordDocument(TypedDict):
    """A record; its curves are read by :class:`study.curve.Curve`, which checks their numbers."""

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
    """Name of a curve of a record: ``measured`` or ``predicted``, and which one.

    Examples
    --------
    >>> str(CurveKey("measured", "B")), CurveKey.of("predicted:A+B")
    ('measured:B', CurveKey(role='predicted', label='A+B'))
    """

    role: str
    label: str

    def __str__(self) -> str:
        return f"{self.role}:{self.label}"

    @classmethod
    def of(cls, text: str) -> CurveKey:
        """Read the name back.

        Raises
        ------
        StoreError
            If it names no role.
        """
        role, colon, label = text.partition(":")
        if not colon:
            raise StoreError(f"the curve {text!r} is neither measured nor predicted")
        return cls(role, label)
