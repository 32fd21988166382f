"""Keys and values of the JSON documents that are kept on disk.

A document is a plain dictionary, as JSON gives it back; these classes say what stands in it, so
that a reader's mistake is found before it runs. Forces are in N, lengths in mm, constants of a
fit in MPa and those of a record in kPa (exponents plain).
"""

from __future__ import annotations

from typing import NamedTuple, NotRequired, Required, TypedDict

from study.errors import StoreError


class Quantity(TypedDict):
    """A number with its unit; None where it could not be had."""

    value: float | None
    unit: str


class ResponseDocument(Quantity):
    """A response; ``u_steps`` is what half the load steps would change in it."""

    u_steps: NotRequired[float]


class ParameterDocument(Quantity):
    """A constant with its standard error and 95 % interval, where a single fit gives them."""

    standard_error: NotRequired[float | None]
    ci95: NotRequired[list[float] | None]


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
    error_mm: float
    error_by_axis_mm: list[float]
    error_by_layer_mm: dict[str, float]
    motion: dict[str, list[float]]


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
    ci95: dict[str, list[float | None] | None]
    correlation: list[list[float | None]] | None
    condition: float | None
    rss: float | None
    r_squared: float | None
    aicc: float | None
    n: int
    identifiable: bool
    reason: str
    stable: bool
    usable: bool
    stability: str
    evaluations: int
    newton_iterations: int
    solves: int
    seconds: float
    mu0: float
    resampling: list[ResamplingDocument]


class ScoreDocument(TypedDict):
    """One scored curve of a case: which it is, what was fitted, and its own responses."""

    score: str
    fit: str
    role: str
    scatter_N: list[float] | None
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
    timings: dict[str, float]
    finished: bool


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
