"""What a loaded file holds: frozen values, made by :mod:`study.design.load` alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Literal

from study.errors import Fault, InputError

#: plain validated sections with mm, N, MPa and deg inside
Config = dict[str, Any]


@dataclass(frozen=True)
class Range:
    """Range of displacement: percent of the specimen's height, or mm.

    Parameters
    ----------
    kind : {"percent", "mm"}
        What ``low`` and ``high`` count.
    low, high : float
        Ends of the range, 0 <= low < high.
    """

    kind: Literal["percent", "mm"]
    low: float
    high: float

    def in_mm(self, height_mm: float | None = None) -> tuple[float, float]:
        """Both ends in mm.

        Parameters
        ----------
        height_mm : float, optional
            Height of the specimen; needed for a range in percent.

        Raises
        ------
        InputError
            If the range is in percent and the specimen has no height.

        Examples
        --------
        >>> Range("percent", 1.0, 20.0).in_mm(30.0)
        (0.3, 6.0)
        """
        if self.kind == "mm":
            return self.low, self.high
        if height_mm is None:
            rule = "in percent needs a specimen with a height"
            raise InputError(Fault("measurements.range", rule, 'give it in mm: ["0.3 mm", "6 mm"]'))
        return self.low * height_mm / 100, self.high * height_mm / 100


@dataclass(frozen=True)
class MeasurementSpec:
    """Where measured curves are and how their rows become curves.

    Parameters
    ----------
    file, files : str, optional
        One long table, or a pattern such as ``"indentation-{specimen}.csv"``; exactly one.
    columns, units : mapping of str to str
        Column and unit of ``displacement`` and ``force``.
    block : str, optional
        Column of the unit that was replicated.
    average : tuple of str
        Columns whose rows are repeats, nested in a specimen.
    range : Range, optional
        Displacements that are used.
    points : int
        Number of displacements, even over the range.
    fit, score : mapping of str to str or tuple of str, optional
        Which rows give constants, which give responses.
    swap : bool
        Whether fit and score also change places.
    zero, sign, decimal : str
        Rule of the load cell's zero, sign of a resisting force, decimal mark of the file.
    toe : float, optional
        Force in N at which contact counts as made.
    citation : str
        Printed in the report.
    """

    file: str | None = None
    files: str | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    block: str | None = None
    average: tuple[str, ...] = ()
    range: Range | None = None
    points: int = 200
    fit: Mapping[str, Any] | None = None
    score: Mapping[str, Any] | None = None
    swap: bool = False
    zero: str = "none"
    toe: float | None = None
    sign: str = "positive"
    decimal: str = "."
    citation: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> MeasurementSpec:
        """Inverse of :meth:`as_dict`, also after a way through JSON."""
        known = {f.name for f in fields(cls)}
        values = {k: v for k, v in data.items() if k in known}
        values["average"] = tuple(values.get("average") or ())
        if values.get("range") is not None:
            values["range"] = Range(**values["range"])
        for key in ("fit", "score"):
            if values.get(key) is not None:
                values[key] = {
                    k: tuple(v) if isinstance(v, list) else v for k, v in values[key].items()
                }
        return cls(**values)


@dataclass(frozen=True)
class CalibrationSpec:
    """How constants are found.

    Parameters
    ----------
    method : {"auto", "analytic", "inverse-fem", "none"}
        Closed form where the calibration test is homogeneous and inverse FEM elsewhere, ...
    problem : mapping, optional
        Tables of ``[calibration.problem]`` as written, which replace the design's own.
    leave_out : {"specimen", "test"}, optional
        What a cross-validation leaves out.
    """

    method: str
    problem: Mapping[str, Any] | None = None
    leave_out: str | None = None


@dataclass(frozen=True)
class Level:
    """One level of a factor: its label and the dotted keys that it lays over the file."""

    label: str
    settings: Mapping[str, Any]


@dataclass(frozen=True)
class Span:
    """Numeric range of a factor: ends in ``unit``, which may be empty."""

    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Factor:
    """A factor and its levels; the name is a dotted key or a preset set.

    A factor written as a range has a ``span``; its levels are those that the design needs.
    """

    name: str
    levels: tuple[Level, ...]
    span: Span | None = None

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the levels, in order."""
        return tuple(level.label for level in self.levels)


@dataclass(frozen=True)
class Scheme:
    """Which combinations of levels are run.

    Parameters
    ----------
    kind : str
        Name of the design.
    rows : tuple of tuple of int, optional
        Index of the level of every factor, one tuple a cell; None for the full factorial.
    summary : str
        The design in a sentence.
    aliases : tuple of str
        What it cannot tell apart, in words.
    resolution : int, optional
        Verified by brute force; None where nothing is aliased or the word has no meaning.
    defining_relation : str
        Such as ``"I = A:B:C"``.
    """

    kind: str = "full"
    rows: tuple[tuple[int, ...], ...] | None = None
    summary: str = ""
    aliases: tuple[str, ...] = ()
    resolution: int | None = None
    defining_relation: str = ""


@dataclass(frozen=True)
class Exclusion:
    """Cells left out: every factor named takes one of its labels."""

    when: Mapping[str, tuple[str, ...]]
    why: str

    def matches(self, levels: Mapping[str, str]) -> bool:
        """Whether a treatment is left out."""
        return all(levels[name] in labels for name, labels in self.when.items())


@dataclass(frozen=True)
class Practical:
    """Smallest difference that matters: in ``unit``, or in percent of the mean."""

    value: float
    unit: str
    relative: bool


@dataclass(frozen=True)
class Response:
    """One scalar answer of a case, with its own analysis."""

    name: str
    unit: str
    practical: Practical | None = None
    transform: str = "none"


@dataclass(frozen=True)
class AnalysisSpec:
    """How the table is analyzed; ``model`` is "full", an order of interaction, or terms "A:B"."""

    model: str | int | tuple[str, ...] = "full"
    type: str = "II"
    error: str = "auto"
    alpha: float = 0.05


@dataclass(frozen=True)
class ConvergeSpec:
    """Mesh refinement: ratio, meshes, watched quantity, tolerance (a fraction), time budget."""

    ratio: float = 1.5
    levels: int = 3
    qoi: str = "peak_force"
    tolerance: float | None = None
    budget_s: float | None = None


@dataclass(frozen=True)
class Replicates:
    """What is computed several times for an error term; at most one of the two.

    Parameters
    ----------
    mesh_seeds : int
        Meshes of every cell that differ by a seed only (error source E3); 0 for the one mesh.
    noise : int
        Refits of every fit to its measured curve with resampled residuals (E2); 0 for none.
    """

    mesh_seeds: int = 0
    noise: int = 0


@dataclass(frozen=True)
class ReportSpec:
    """Formats of the report."""

    format: tuple[str, ...] = ("html",)


@dataclass(frozen=True)
class Expected:
    """What was expected of a response before the study ran.

    Parameters
    ----------
    kind : {"matters", "larger", "interact", "best", "close"}
        A factor matters, has a larger effect than another one, two interact, a cell (mean over
        all other factors) is the best, two cells differ by less than what matters.
    factors : tuple of str
        One or two factors.
    cells : tuple of mapping
        One or two cells: labels by factor.
    response, source : str
        What it is said of, and who said it.
    """

    kind: str
    factors: tuple[str, ...]
    cells: tuple[Mapping[str, str], ...]
    response: str
    source: str = ""


@dataclass(frozen=True)
class Design:
    """A validated study.

    Parameters
    ----------
    name, question : str
        Of the study.
    config : dict
        The file's tables as written (strings with their units), overrides applied, dotted
        keys of ``[factors]`` and ``[uncertainty]`` joined; :func:`study.design.dump` writes it.
    factors, exclusions, responses : tuple
        What varies, what is left out, what is answered.
    seed : int
        Of every random draw of the study.
    assumed : tuple of str
        Inputs that nobody measured.
    measurements, calibration, analysis, converge, report
        The tables of these names.
    uncertainty : mapping of str to float
        Standard uncertainty of inputs, in internal units, by dotted key.
    scheme : Scheme
        Which combinations of the levels are run.
    expected : tuple of Expected
        What the study's owner expected before it ran.
    replicates : Replicates
        What is computed several times, for an error term.
    source : str
        The file it was read from; no part of the study's identity.
    text : str
        The file's text, for the report; no part of the study's identity.
    """

    name: str
    question: str
    config: Config
    factors: tuple[Factor, ...]
    exclusions: tuple[Exclusion, ...]
    responses: tuple[Response, ...]
    seed: int
    assumed: tuple[str, ...]
    measurements: MeasurementSpec | None
    calibration: CalibrationSpec
    analysis: AnalysisSpec
    converge: ConvergeSpec
    uncertainty: Mapping[str, float]
    report: ReportSpec
    scheme: Scheme = field(default_factory=Scheme)
    replicates: Replicates = field(default_factory=Replicates)
    expected: tuple[Expected, ...] = ()
    source: str = field(default="<string>", compare=False)
    text: str = field(default="", compare=False, repr=False)


@dataclass(frozen=True)
class Treatment:
    """One cell of the design: a label for every factor and the resolved configuration."""

    levels: Mapping[str, str]
    config: Config

    @property
    def label(self) -> str:
        """Labels of the levels, such as ``"neo-hookean / bonded / 3d / linear"``."""
        return " / ".join(self.levels.values())


@dataclass(frozen=True)
class Case:
    """One treatment in one block; ``case_id`` is a hash of what decides its numbers."""

    levels: Mapping[str, str]
    block: str | None
    config: Config
    case_id: str

    @property
    def treatment(self) -> Treatment:
        """The cell of the design."""
        return Treatment(self.levels, self.config)

    @property
    def label(self) -> str:
        """Labels of the levels, and the block."""
        return self.treatment.label + (f" / {self.block}" if self.block is not None else "")
