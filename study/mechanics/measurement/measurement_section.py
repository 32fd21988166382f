"""The table ``[measurements]``: where measured curves are and how rows become curves."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Annotated, Literal

from study.ground import units
from study.ground.declaration import (
    Bad,
    Field,
    Force,
    Read,
    Reads,
    choice,
    flag,
    integer,
    name,
    names,
    relative_path,
    section,
    shown,
    text,
    unit_of_length,
    word,
)
from study.ground.errors import Fault, InputError, UnitError
from study.ground.files import ENCODINGS

#: what may part the cells of a file, by its name in a study file; found out where it is not said
DELIMITERS: Mapping[str, str | None] = {
    "comma": ",",
    "semicolon": ";",
    "tab": "\t",
    "space": None,
}


#: columns that say how far the specimen was deformed, and their dimension
KINEMATIC: Mapping[str, str] = {
    "displacement": "length",
    "stretch": "ratio",
    "strain": "ratio",
    "true_strain": "ratio",
    "volume_ratio": "ratio",
    "stretch_1": "ratio",
}

#: columns that say how it resisted
KINETIC: Mapping[str, str] = {
    "force": "force",
    "stress": "pressure",
    "true_stress": "pressure",
    "pressure": "pressure",
    "stress_1": "pressure",
}

#: second direction of a biaxial test, by its first
SECOND: Mapping[str, str] = {"stretch_1": "stretch_2", "stress_1": "stress_2"}

MAX_POINTS = 100_000
MAX_SKIPPED = 1000
_FIELD = re.compile(r"\{([^{}]*)\}")

#: ends of the names of measured files: texts are read as CSV
ENDINGS = (".csv", ".txt", ".tsv", ".tab", ".dat", ".asc", ".rpt", ".xlsx")

#: label of a row, or several
Labels = str | tuple[str, ...]


@dataclass(frozen=True)
class Range:
    """Range of displacement: percent of the specimen's height, or mm."""

    #: What ``low`` and ``high`` count.
    kind: Literal["percent", "mm"]
    #: Ends of the range, low < high; low is below 0 for a test that was loaded both ways.
    low: float
    high: float

    def in_mm(self, height_mm: float | None = None) -> tuple[float, float]:
        """Both ends in mm."""
        if self.kind == "mm":
            return self.low, self.high
        if height_mm is None:
            rule = "in percent needs a specimen with a height"
            raise InputError(Fault("measurements.range", rule, 'give it in mm: ["0.3 mm", "6 mm"]'))
        return self.low * height_mm / 100, self.high * height_mm / 100


def _table_path(value: object) -> str:
    path = relative_path(value)
    if not path.lower().removesuffix(".gz").endswith(ENDINGS):
        raise Bad(f"must end in {', '.join(ENDINGS)}, or one of these and .gz, got {shown(path)}")
    return path


def csv_path(value: object) -> str:
    """Read the path of a table."""
    path = _table_path(value)
    if "{" in path or "}" in path:
        raise Bad(f"is one file, got a pattern {shown(value)}", "write files = ...")
    return path


def csv_pattern(value: object) -> str:
    """Read a pattern such as ``"indentation-{specimen}.csv"``."""
    pattern = _table_path(value)
    groups = _FIELD.findall(pattern)
    odd = "{" in _FIELD.sub("", pattern) or "}" in _FIELD.sub("", pattern)
    if odd or not groups or any(not re.fullmatch(r"[A-Za-z]\w{0,79}", g, re.A) for g in groups):
        raise Bad(f"needs groups such as {{specimen}}, got {shown(value)}", "or write file = ...")
    if len(set(groups)) < len(groups):
        raise Bad(f"names a group twice, got {shown(value)}")
    return pattern


def read_range(value: object) -> Range:
    """Read ``["1 %", "20 %"]`` or ``["0.3 mm", "6 mm"]``."""
    mend = 'write, for example, ["1 %", "20 %"] or ["0.3 mm", "6 mm"]'
    if not isinstance(value, list) or len(value) != 2:
        raise Bad(f"must be two values, got {shown(value)}", mend)
    ends = [v for v in value if isinstance(v, str)]
    if len(ends) < len(value):
        raise Bad(f"needs units, got {shown(value)}", mend)
    percent = [v.rstrip().endswith("%") for v in ends]
    if percent[0] != percent[1]:
        raise Bad(f"mixes percent and length, got {shown(value)}", mend)
    try:
        low, high = (
            units.parse_percent(v) if percent[0] else units.parse(v, "length") for v in ends
        )
    except UnitError as error:
        raise Bad(error.faults[0].rule, mend) from error
    if not low < high or high <= 0:
        raise Bad(f"must rise from 0 or more, got {shown(value)}", mend)
    if percent[0] and max(high, -low) >= 100:
        raise Bad(f"must stay below 100 % of the height, got {shown(value)}", mend)
    return Range("percent" if percent[0] else "mm", low, high)


def rows(value: object) -> dict[str, Labels]:
    """Read a choice of rows: column -> label, or labels."""
    if not isinstance(value, Mapping) or not value:
        raise Bad(f"must be a table, got {shown(value)}", 'for example { specimen = "A" }')
    chosen: dict[str, Labels] = {}
    for column, labels in value.items():
        if labels == []:
            raise Bad("chooses no label at all")
        chosen[name(column)] = (
            tuple(map(_label, labels)) if isinstance(labels, list) else _label(labels)
        )
    return chosen


def _label(value: object) -> str:
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if isinstance(value, bool) or not isinstance(value, (str, int, float)):
        raise Bad(f"must be a label, got {shown(value)}")
    return text(str(value))


def _unit(dimension: str) -> Read:
    def read(value: object) -> str:
        unit = text(value)
        units.unit_factor(unit, dimension)
        return unit

    return read


def groups_of(pattern: str) -> list[str]:
    """Names of the groups in a pattern such as ``"indentation-{specimen}.csv"``."""
    return _FIELD.findall(pattern)


Column = Annotated[str | None, Reads(name)]


@section
class Columns:
    """Columns of a measured file: how far, and how hard, the specimen was deformed.

    The pair is displacement and force, or measures of strain and stress
    (:mod:`study.mechanics.measurement.recording`). A third one may say when.
    """

    displacement: Column = None
    force: Column = None
    stretch: Column = None
    strain: Column = None
    true_strain: Column = None
    volume_ratio: Column = None
    stress: Column = None
    true_stress: Column = None
    pressure: Column = None
    stretch_1: Column = None
    stretch_2: Column = None
    stress_1: Column = None
    stress_2: Column = None
    time: Column = None

    def named(self, quantities: Iterable[str]) -> list[str]:
        """Those of some quantities that have a column."""
        return [quantity for quantity in quantities if getattr(self, quantity) is not None]

    @property
    def kinematic(self) -> str:
        """Quantity that says how far the specimen was deformed."""
        return next(iter(self.named(KINEMATIC)), "displacement")

    @property
    def kinetic(self) -> str:
        """Quantity that says how it resisted."""
        return next(iter(self.named(KINETIC)), "force")

    @property
    def is_biaxial(self) -> bool:
        """Whether there are stretches and stresses in two directions."""
        return self.kinematic in SECOND

    def column(self, quantity: str) -> str:
        """Name of the column of a quantity that has one."""
        return str(getattr(self, quantity))


_RATIO = Annotated[str | None, Reads(_unit("ratio"))]
_STRESS = Annotated[str | None, Reads(_unit("pressure"))]


@section
class Units:
    """Units of the columns of a measured file; "1" or "%" for ratios."""

    displacement: Annotated[str | None, Reads(_unit("length"))] = None
    force: Annotated[str | None, Reads(_unit("force"))] = None
    stretch: _RATIO = None
    strain: _RATIO = None
    true_strain: _RATIO = None
    volume_ratio: _RATIO = None
    stress: _STRESS = None
    true_stress: _STRESS = None
    pressure: _STRESS = None
    stretch_1: _RATIO = None
    stretch_2: _RATIO = None
    stress_1: _STRESS = None
    stress_2: _STRESS = None
    time: Annotated[str | None, Reads(_unit("time"))] = None

    def unit(self, quantity: str) -> str:
        """Return the unit of the column of a quantity that has one."""
        return str(getattr(self, quantity))


def _points(value: object) -> int | Literal["raw"]:
    if value == "raw":
        return "raw"
    return integer(2, MAX_POINTS)(value)


def _displacement_zero(value: object) -> str | float:
    """Read ``"first row"``, ``"contact"`` or a length such as ``"3.2 mm"``."""
    if value in ("first row", "contact"):
        return str(value)
    try:
        return units.parse(value, "length")
    except UnitError as error:
        mend = 'write "first row", "contact" or a length such as "3.2 mm"'
        raise Bad(error.faults[0].rule, mend) from error


def _branch(value: object) -> str | int:
    if isinstance(value, int) and not isinstance(value, bool):
        return integer(1, MAX_POINTS)(value)
    return choice("auto", "loading", "unloading", "all")(value)


def _mark(value: object) -> str:
    mark = text(value)
    if len(mark) > 3 or mark.strip() != mark:
        raise Bad(f"must be 1 to 3 characters, got {shown(value)}", 'for example comment = "#"')
    return mark


#: keys that stay out of documents where they say what is usual
_USUAL = (
    "skip_lines", "comment", "delimiter", "header", "displacement_zero", "direction", "branch",
    "cycle", "unit_row", "thousands", "encoding", "sheet",
)  # fmt: skip


@section
class MeasurementSpec:
    """Where measured curves are and how their rows become curves."""

    #: Column and unit of displacement and force.
    columns: Columns = Field(
        description='for example columns = { displacement = "displacement_mm", force = "force_N" }'
    )
    units: Units = Units()
    #: One long table, or a pattern such as ``"indentation-{specimen}.csv"``; exactly one.
    file: Annotated[str | None, Reads(csv_path)] = None
    files: Annotated[str | None, Reads(csv_pattern)] = None
    #: Column of the unit that was replicated.
    block: Annotated[str | None, Reads(name)] = None
    #: Columns whose rows are repeats, nested in a specimen.
    average: Annotated[tuple[str, ...], Reads(names)] = ()
    #: Displacements that are used.
    range: Annotated[Range | None, Reads(read_range)] = None
    #: Number of displacements, even over the range; raw: the rows as they were measured.
    points: Annotated[int | Literal["raw"], Reads(_points)] = 200
    #: Which rows give constants, which give responses.
    fit: Annotated[dict[str, Labels] | None, Reads(rows)] = None
    score: Annotated[dict[str, Labels] | None, Reads(rows)] = None
    #: Whether fit and score also change places.
    swap: Annotated[bool, Reads(flag)] = False
    #: Rule of the load cell's zero.
    zero: Annotated[str, Reads(choice("none", "first", "fit"))] = "none"
    #: Force in N at which contact counts as made.
    toe: Force | None = None
    #: Sign of a force that resists.
    sign: Annotated[str, Reads(choice("positive", "negative"))] = "positive"
    #: Recorded displacement of the unloaded specimen in contact: a row, or a value in mm.
    displacement_zero: Annotated[str | float | None, Reads(_displacement_zero)] = None
    #: Whether the recorded displacement rises or falls as the specimen is loaded.
    direction: Annotated[str, Reads(choice("auto", "rising", "falling"))] = "auto"
    #: Rows of a test that was also unloaded that count: a branch, a cycle, or all.
    branch: Annotated[str | int, Reads(_branch)] = "auto"
    #: Branch of a cycle that is given by its number.
    cycle: Annotated[str, Reads(choice("loading", "unloading"))] = "loading"
    decimal: Annotated[str, Reads(choice(".", ","))] = "."
    #: Printed in the report.
    citation: Annotated[str, Reads(text)] = ""
    #: Lines before the header, comment mark, and what parts the cells of a file that is no plain
    #: CSV.
    skip_lines: Annotated[int, Reads(integer(0, MAX_SKIPPED))] = 0
    comment: Annotated[str, Reads(_mark)] = ""
    delimiter: Annotated[str, Reads(choice("", *DELIMITERS))] = ""
    #: Whether a line names the columns; without one columns are named by their number.
    header: Annotated[bool, Reads(flag)] = True
    #: Whether the line below the names holds units, which count where none are declared; found in
    #: the file where this is left out.
    unit_row: Annotated[bool | None, Reads(flag)] = None
    #: Mark between groups of three digits, where the file does not show it.
    thousands: Annotated[str, Reads(choice("", ",", ".", "'", " "))] = ""
    #: How the characters of the file are written, where it is not found rightly.
    encoding: Annotated[str, Reads(choice("", *ENCODINGS))] = ""
    #: Sheet of a workbook that has several.
    sheet: Annotated[str, Reads(text)] = ""

    def plain_text(self, text: str) -> tuple[str, list[int], str]:
        """Text with a header line, where its lines stand, and its delimiter if that is known."""
        lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
        at = [
            k
            for k, line in enumerate(lines, 1)
            if k > self.skip_lines and not (self.comment and line.lstrip().startswith(self.comment))
        ]
        if self.header:  # of an export that was appended to another one it stands again
            names = next((k for k in at if lines[k - 1].strip()), 0)
            heads = {lines[k - 1].strip() for k in (names, names + bool(self.unit_row)) if k}
            at = [k for k in at if k <= names + 1 or lines[k - 1].strip() not in heads]
        lines = [lines[k - 1] for k in at]
        first = next((line for line in lines if line.strip()), "")
        delimiter = self.delimiter
        if not self.header:
            marks = (";" if self.decimal == "," else ",", ";", "\t")
            named = (name for name, sign in DELIMITERS.items() if sign in marks and sign in first)
            delimiter = delimiter or next(named, "space")
        mark = "\t" if delimiter == "space" else DELIMITERS[delimiter] or "" if delimiter else ""
        if delimiter == "space":
            lines = ["\t".join(line.split()) for line in lines]
        if not self.header:
            widest = max((line.count(mark) + 1 for line in lines), default=0)
            lines.insert(0, mark.join(str(k + 1) for k in range(widest)))
            at.insert(0, at[0] if at else 1)
        return "\n".join(lines), at, mark

    def as_dict(self) -> dict[str, object]:
        """Plain values, for JSON; what a file of displacement and force does not say stays out."""
        values = asdict(self)
        for key in ("columns", "units"):
            values[key] = {k: v for k, v in values[key].items() if v is not None}
        usual = {f.name: f.default for f in fields(self)}
        return {k: v for k, v in values.items() if k not in _USUAL or v != usual[k]}


# -------------------------------------------------------------------------------------------------
# The table ``[markers]``: marked points inside a specimen, at rest and in the states of a test.

#: what a plate is taken to do: as it was said to move, any rigid motion, and slip besides
PLATES = ("nominal", "rigid", "slipping")

#: Coordinates of a point: names of three columns.
Axes = tuple[str, str, str]

_STATE = 'for example "5 %" = { columns = ["x1", "y1", "z1"], displacement = "4 mm" }'


@dataclass(frozen=True)
class MarkedState:
    """Where markers were in one state of the test."""

    label: str
    #: With the coordinates x, y and z.
    columns: Axes
    displacement_mm: float


def three_columns(value: object) -> Axes:
    """Read the names of three columns."""
    values = names(value)
    if not isinstance(value, list) or len(values) != 3:
        mend = 'for example ["x0", "y0", "z0"]'
        raise Bad(f"must be the columns of x, y and z, got {shown(value)}", mend)
    return (values[0], values[1], values[2])


def _states(value: object) -> tuple[MarkedState, ...]:
    """Read every state of the test, by its label."""
    if not isinstance(value, Mapping) or not value:
        raise Bad(f"must be a table of states, got {shown(value)}", _STATE)
    return tuple(_state(name(label), table) for label, table in value.items())


def _state(label: str, table: object) -> MarkedState:
    if not isinstance(table, Mapping) or set(table) != {"columns", "displacement"}:
        raise Bad(f"state {label!r} must have columns and displacement, got {shown(table)}", _STATE)
    try:
        moved = units.parse(table["displacement"], "length")
    except UnitError as error:
        raise Bad(f"state {label!r}: {error.faults[0].rule}", error.faults[0].mend) from error
    if not moved > 0:
        raise Bad(f"state {label!r}: its displacement must be above 0", _STATE)
    return MarkedState(label, three_columns(table["columns"]), moved)


def _layers(value: object) -> tuple[str, ...]:
    """Read labels of layers, which may be numbers."""
    items = value if isinstance(value, list) else [value]
    if not items or not all(type(label) in (str, int) for label in items):
        raise Bad(f"must be labels of layers, got {shown(value)}", "for example fit = [1, 7]")
    return tuple(dict.fromkeys(str(label).strip() for label in items))


@section
class MarkerSpec:
    """Markers inside a specimen: where their places are, and how a plate is fitted to them."""

    #: Table with one row a marker.
    file: Annotated[str, Reads(csv_path, mend='for example file = "markers.csv"')]
    #: Columns of x, y and z in the unloaded specimen.
    rest: Annotated[Axes, Reads(three_columns, mend='for example rest = ["x0", "y0", "z0"]')]
    #: Every state of the test: the same markers, measured again.
    states: Annotated[tuple[MarkedState, ...], Reads(_states, mend=_STATE)]
    unit: Annotated[str, Reads(unit_of_length)] = "mm"
    #: Axis of the file that points up, from the base to the plate that moves.
    axis: Annotated[str, word("z", "-z", "x", "-x", "y", "-y")] = "z"
    layer: Annotated[str | None, Reads(name)] = None
    #: Layers that alone tell how the plate moved, where the others are to be predicted.
    fit: Annotated[tuple[str, ...], Reads(_layers)] = ()
    #: What the responses take the plate to do.
    plate: Annotated[Literal["nominal", "rigid", "slipping"], word(*PLATES)] = "slipping"
    skip_lines: Annotated[int, Reads(integer(0, MAX_SKIPPED))] = 0
    decimal: Annotated[str, Reads(choice(".", ","))] = "."
    citation: Annotated[str, Reads(text)] = ""

    @property
    def layout(self) -> MeasurementSpec:
        """How the file differs from plain CSV."""
        return MeasurementSpec(Columns(), skip_lines=self.skip_lines, decimal=self.decimal)

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the states."""
        return tuple(state.label for state in self.states)

    @property
    def deepest_mm(self) -> float:
        """Largest motion of the plate that was said."""
        return max(state.displacement_mm for state in self.states)

    def state(self, label: str) -> MarkedState:
        """State of a label, which must be one of :attr:`labels`."""
        return self.states[self.labels.index(label)]

    def as_dict(self) -> dict[str, object]:
        """Plain values, for JSON and for the names of cases."""
        return {**asdict(self), "states": [asdict(state) for state in self.states]}
