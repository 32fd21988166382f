"""A forward model: its table ``[forward]``, and the interface that every one has.

A cell of a design holds one such object, made of the tables of its file. The built-in mechanics
(:class:`study.simulation.cell.CellProblem`) is one; a program or a function of parameters alone
(:class:`study.external.parameters.ParameterProblem`) is another. Whoever expands, prices,
refines or reports a case asks the object, and needs to know none of its tables.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Annotated, Literal, Self

from study.ground import units
from study.ground.declaration import (
    DERIVED,
    Bad,
    Duration,
    Reads,
    document_of,
    flag,
    measured,
    name,
    relative_path,
    section,
    shown,
    text,
    word,
)
from study.ground.errors import Fault

if TYPE_CHECKING:
    from study.mechanics.measurement.measurement_section import MarkerSpec, MeasurementSpec

# The table ``[forward]``: which program predicts, from which files, and how its answer is read.

Kind = Literal["fem", "closed-form", "command", "python"]
#: what a table may hold: a chain of programs is short, and adapters are small
MAX_STEPS = 20
MAX_WORDS = 200
MAX_FILES = 50
MAX_VALUES = 200
MAX_PATTERN = 200
#: seconds of one solution by a program that does not say them, and of a Python function
USUAL_SECONDS = 1.0
FUNCTION_SECONDS = 1e-3
#: a file whose name ends so is rendered; every other one is copied
TEMPLATE = ".j2"
#: where a number stands in the pattern of a value that is looked for in a log
NUMBER = "(number)"
NUMBER_PATTERN = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?)"
#: what stands in a table of cases under a name of its own
TAKEN = ("case_id", "block", "status", "seconds", "dofs", "replicate", "mesh_seed", "noise_seed")


def _argv(value: object) -> tuple[tuple[str, ...], ...]:
    """Read one command, or several that run one after the other; each is a list of words."""
    mend = 'for example argv = [["ccx", "-i", "model"]]'
    if not isinstance(value, list) or not value:
        raise Bad(f"must be a list of words, or of such lists, got {shown(value)}", mend)
    steps = [value] if all(isinstance(word, str) for word in value) else value
    if len(steps) > MAX_STEPS:
        raise Bad(f"has {len(steps)} commands, the limit is {MAX_STEPS}")
    return tuple(_words(step, mend) for step in steps)


def _words(value: object, mend: str) -> tuple[str, ...]:
    if not isinstance(value, list) or not value or not all(isinstance(word, str) for word in value):
        raise Bad(f"a command must be a list of words, got {shown(value)}", mend)
    if len(value) > MAX_WORDS:
        raise Bad(f"a command has {len(value)} words, the limit is {MAX_WORDS}")
    words = tuple(text(word) for word in value)
    if not words[0]:
        raise Bad("a command has no program", mend)
    return words


_version = partial(_words, mend='for example version = ["ccx", "-v"]')


def file_name(value: object) -> str:
    """Read the name of a file in the folder of a case."""
    path = relative_path(value)
    if "/" in path or "\\" in path:
        rule = f"must be a file of the folder of the case, got {shown(value)}"
        raise Bad(rule, "write its name without a folder")
    return name(path)


def _files(value: object) -> tuple[str | tuple[str, str], ...]:
    """Read files that are copied, or names in the folder of a case with the file of each."""
    files: list[str | tuple[str, str]]
    if isinstance(value, Mapping):
        files = [(file_name(target), relative_path(source)) for target, source in value.items()]
    elif isinstance(value, list):
        files = list(dict.fromkeys(relative_path(item) for item in value))
    else:
        mend = 'write files = { "model.inp" = "templates/model.inp.j2" }, or ["model.inp"] to copy'
        raise Bad(f"must be a table of names and files, or a list, got {shown(value)}", mend)
    if len(files) > MAX_FILES:
        raise Bad(f"lists {len(files)} files, the limit is {MAX_FILES}")
    targets = [target for target, _ in map(target_and_source, files)]
    if reserved := sorted({*targets} & {"problem.json", "case.json"}):
        rule = f"holds {reserved[0]}, which this package writes into the folder of every case"
        raise Bad(rule, "give that file another name")
    if len(set(targets)) < len(targets):
        raise Bad("names two files alike, which would lie on one another", "rename one of them")
    return tuple(files)


def target_and_source(file: str | tuple[str, str]) -> tuple[str, str]:
    """Name of a file in the folder of a case, and its path beside the design."""
    if isinstance(file, str):
        return file.replace("\\", "/").rpartition("/")[2], file
    return file[0], file[1]


def _column(value: object) -> str | int:
    """Read the name of a column, or its number from 1 on."""
    if isinstance(value, int) and not isinstance(value, bool):
        if not 1 <= value <= 1000:
            raise Bad(f"must be the number of a column from 1 on, got {value}")
        return value
    return name(value)


def value_unit(value: object) -> str:
    """Read a unit; ``""`` and ``"1"`` are those of a plain number."""
    if not isinstance(value, str):
        raise Bad(f"must be the text of a unit, got {shown(value)}", 'for example "kPa"')
    plain = " ".join(value.split())
    if plain in ("", "1"):
        return ""
    if plain != "%" and not units.is_known(plain):
        raise Bad(f"is an unknown unit: {shown(value)}", 'write "1" for a plain number')
    return plain


@section
class CurveColumns:
    """Columns of a curve, by name or by number."""

    displacement: Annotated[str | int, Reads(_column, mend='displacement = "u"')]
    force: Annotated[str | int, Reads(_column, mend='force = "f"')]


@section
class CurveUnits:
    """Units of the columns of a curve."""

    displacement: Annotated[str, Reads(value_unit)] = "mm"
    force: Annotated[str, Reads(value_unit)] = "N"


@section
class CurveFile:
    """The file of a curve, its columns and units."""

    file: Annotated[str, Reads(file_name, mend='file = "curve.csv"')]
    columns: CurveColumns
    units: CurveUnits = CurveUnits()


#: name of a value, its unit, and the pattern, file and unit of a value of a log ("" for none)
Sources = tuple[tuple[str, str, str, str, str], ...]


def _sources(value: object) -> Sources:
    """Read the values that a program leaves: ``peak = "kPa"``, or where they stand in a log."""
    mend = 'for example { peak = "kPa", Fz = { log = "Fz = (number) N" } }'
    if not isinstance(value, Mapping) or not value:
        raise Bad(f"must be a table of names and units, got {shown(value)}", mend)
    if len(value) > MAX_VALUES:
        raise Bad(f"has {len(value)} names, the limit is {MAX_VALUES}")
    sources = []
    for key, item in value.items():
        if not str(key).replace("-", "_").isidentifier() or key in TAKEN:
            rule = f"has the name {shown(key)}, which cannot be a response"
            raise Bad(rule, "a name has letters, digits, - and _ and begins with a letter")
        if not isinstance(item, Mapping):
            sources.append((str(key), value_unit(item), "", "", ""))
            continue
        if unknown := [k for k in item if k not in ("log", "unit", "file")]:
            raise Bad(f"{key} has the unknown key {shown(unknown[0])}", "log, unit, file")
        pattern, unit = pattern_of(item.get("log"))
        given = value_unit(item["unit"]) if "unit" in item else unit
        file = file_name(item["file"]) if "file" in item else ""
        sources.append((str(key), given, pattern, file, unit or given))
    return tuple(sources)


def pattern_of(value: object) -> tuple[str, str]:
    """Regular expression of a pattern with ``(number)``, and the unit that follows it.

    Examples
    --------
    >>> pattern, unit = pattern_of("Fz = (number) kN")
    >>> re.search(pattern, "last Fz = -1.5E+01 kN")[1], unit
    ('-1.5E+01', 'kN')
    """
    mend = f'for example log = "Fz = {NUMBER} N"'
    if not isinstance(value, str) or value.count(NUMBER) != 1:
        raise Bad(f"log must be a text with {NUMBER} once, got {shown(value)}", mend)
    if len(value) > MAX_PATTERN:
        raise Bad(f"log has {len(value)} characters, the limit is {MAX_PATTERN}", mend)
    pattern = value.replace(NUMBER, NUMBER_PATTERN)
    try:
        groups = re.compile(pattern).groups
    except (re.error, OverflowError, RecursionError) as error:
        raise Bad(f"log is no regular expression ({error}): {shown(value)}", mend) from None
    if groups != 1:
        raise Bad("log has brackets besides those of the number", r"write (?: ) or \( instead")
    after = re.match(r"\s*\[?([A-Za-z%][\w*/^%]*)", value.partition(NUMBER)[2])
    unit = after[1] if after is not None and units.is_known(after[1]) else ""
    return pattern, unit


@section
class ValueFile:
    """Named numbers that a program leaves, each a response, and the file that they stand in."""

    names: Annotated[Sources, Reads(_sources, mend='names = { peak = "kPa" }')]
    file: Annotated[str, Reads(file_name)] = ""

    @property
    def units(self) -> dict[str, str]:
        """Unit of every value."""
        return {key: unit for key, unit, *_ in self.names or ()}  # none where the table is faulty


@dataclass(frozen=True)
class ForwardFiles:
    """What a forward model was found to be on this machine: name and content of what it runs."""

    #: sha256 of every program; empty where it is missing.
    programs: tuple[tuple[str, str], ...] = ()
    #: Text of every file that goes along.
    contents: tuple[tuple[str, str], ...] = ()
    #: Function of ``model = "python"`` as text, and its version; empty until one is given.
    function: str = ""
    function_version: str = ""

    def document(self, model: Kind) -> dict[str, object]:
        """Plain values of what a kind of forward model has."""
        if model == "command":
            return {"programs": dict(self.programs), "contents": dict(self.contents)}
        named = {"function": self.function, "function_version": self.function_version}
        return {**named} if self.function else {}


@section
class ForwardModel:
    """What predicts a curve, values, or both."""

    #: The built-in finite elements, the closed form of
    #: a homogeneous test, programs, or a function given to :func:`study.run`.
    model: Annotated[Kind, word("fem", "closed-form", "command", "python")] = "fem"
    #: Commands, run one after the other in a folder of the case; never by a shell.
    argv: Annotated[tuple[tuple[str, ...], ...], Reads(_argv)] = ()
    #: Files beside the design that are copied into that folder, or with a name there; those that
    #: end in ``.j2`` are rendered.
    files: Annotated[tuple[str | tuple[str, str], ...], Reads(_files)] = ()
    #: Command whose first line of output is kept in every record.
    version: Annotated[tuple[str, ...], Reads(_version)] = ()
    #: Text that the output of one command must hold, and text that none may hold.
    success: Annotated[str, Reads(text)] = ""
    failure: Annotated[str, Reads(text)] = ""
    #: What installs the program, for the message where it is missing.
    install: Annotated[str, Reads(text)] = ""
    timeout_s: Duration | None = None
    #: What one solution takes, for the plan.
    seconds_s: Duration = USUAL_SECONDS
    #: Where the curve stands, if not in ``curve.csv`` with the names of this package.
    curve: CurveFile | None = None
    #: Further numbers that it leaves.
    values: ValueFile | None = None
    #: Whether a curve shorter than the test is a failure.
    reaches: Annotated[bool, Reads(flag)] = True
    #: What one solution takes at most, for what runs at once.
    memory_MB: Annotated[float, measured("memory")] | None = None
    #: Whose folders are kept beside the records.
    keep: Annotated[Literal["all", "failed", "none"], word("all", "failed", "none")] = "none"
    #: What it is on this machine; None where nobody has looked.
    installed: Annotated[ForwardFiles | None, DERIVED] = None

    @property
    def is_external(self) -> bool:
        """Whether something else than this package predicts."""
        return self.model in ("command", "python")

    @property
    def price_s(self) -> float:
        """Seconds of one solution for the plan; a Python function that says none is quick."""
        is_quick = self.model == "python" and self.seconds_s == USUAL_SECONDS
        return FUNCTION_SECONDS if is_quick else self.seconds_s

    @property
    def rendered(self) -> list[str]:
        """Names, in the folder of a case, of the files that are made of a template."""
        named = (file for file in self.files if not isinstance(file, str))
        return sorted(target for target, source in named if source.endswith(TEMPLATE))

    @property
    def units(self) -> dict[str, str]:
        """Unit of every named value."""
        return {} if self.values is None else self.values.units

    def document(self) -> dict[str, object]:
        """Plain values; keys that decide no number, and those left out that came later, are not."""
        return dict(self._document)

    @cached_property
    def _document(self) -> dict[str, object]:
        document = document_of(self, ("curve", "values", "reaches"))
        for key in ("memory_MB", "keep", "installed"):
            del document[key]
        if self.installed is None:
            return document
        written = {key: value for key, value in document.items() if value is not None}
        return written | self.installed.document(self.model)

    def fault(self, where: str) -> Fault | None:
        """Say what is missing for its kind, or stands in the way of its answer."""
        if self.model == "command" and not self.argv:
            mend = 'write argv = [["PROGRAM", "ARGUMENT"]]'
            return Fault(f"{where}.argv", "is missing: model = 'command' runs a program", mend)
        given = {target for target, _ in map(target_and_source, self.files or ())}
        read = {"" if self.curve is None else self.curve.file}
        if self.values is not None:
            names = self.values.names or ()
            read |= {self.values.file, *(file for *_, file, _ in names)}
            if self.model == "command" and not self.values.file:
                bare = [key for key, _, pattern, *_ in names if not pattern]
                if bare:
                    rule = f"is missing: nothing says where {bare[0]} stands"
                    mend = 'write file = "out.json", or a pattern of the log'
                    return Fault(f"{where}.values.file", rule, mend)
        if both := sorted((given & read) - {""}):
            rule = f"holds {both[0]}, which is also read: a program that writes nothing would leave"
            mend = "give the file that goes along another name"
            return Fault(f"{where}.files", f"{rule} it as the answer", mend)
        return None


# The interface: what is asked of a forward model, and what a refinement of it is.

#: value of a parameter: a number in the unit of its key, a text or a flag
Value = float | str | bool


@dataclass(frozen=True)
class Refinement:
    """The parameter that is the mesh size, step or tolerance of a stranger's solver."""

    #: Of the table ``[parameters]``.
    name: str
    #: Order in it that the solver promises; None where nobody says.
    formal_order: float | None = None

    def size(self, problem: ForwardCell) -> float:
        """Value of the parameter in a problem, in its own unit."""
        return float(problem.parameters[self.name])


@dataclass(frozen=True)
class PlacedFile:
    """A file that a case reads, as it was found on this machine."""

    path: str
    sha256: str
    #: Of the body that a surface encloses; other files have none.
    height_mm: float | None = None

    def document(self) -> dict[str, object]:
        """Plain values; the path names nothing, the sha256 does."""
        return {key: value for key, value in vars(self).items() if value is not None}


@dataclass(frozen=True, kw_only=True)
class ForwardCell(ABC):
    """What a cell computes, whatever computes it; a class of its own says what differs."""

    #: Program or function that predicts; None for the built-in model.
    forward: ForwardModel | None = None
    #: Values of the table ``[parameters]``, and the units of those that have one.
    parameters: Mapping[str, Value] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    #: Where measured curves are, and markers inside a specimen.
    measurements: MeasurementSpec | None = None
    markers: MarkerSpec | None = None
    #: File of the markers; None where nobody has looked for it.
    marker_file: PlacedFile | None = None
    #: The parameter that refines it; None where its mesh does, or nothing.
    refinement: Refinement | None = None

    @property
    def has_closed_form(self) -> bool:
        """Whether a closed form is its answer."""
        return False

    @property
    def calibrated_names(self) -> tuple[str, ...]:
        """Names of the constants that a fit may find; also responses."""
        return ()

    @property
    def test_name(self) -> str:
        """Name of its specimen, test and measurements, whatever the steps; "" without a test."""
        return ""

    @property
    def depth_mm(self) -> float | None:
        """How far its test goes; None where that is open, or there is no test."""
        return None

    @property
    def height_mm(self) -> float | None:
        """Height of its specimen; None where it has none, or nobody knows it."""
        return None

    @property
    def is_meshed_freely(self) -> bool:
        """Whether a generator chooses its mesh among many of one size."""
        return False

    @property
    def is_homogeneous(self) -> bool:
        """Whether its answer has no numerical error that a refinement would show."""
        return self.refinement is None

    @property
    @abstractmethod
    def discretization(self) -> str:
        """Name of what its numerical error depends on: cells that share it share an order."""

    @abstractmethod
    def document(self) -> dict[str, object]:
        """Plain values in internal units: what is hashed, and read back from a disk."""

    def own_tables(self) -> dict[str, object]:
        """Tables of the user's own that go to a program: parameters and their units.

        A whole number has no decimals, in a template as in a function.
        """
        whole = {
            name: int(value)
            for name, value in self.parameters.items()
            if isinstance(value, float) and value.is_integer() and abs(value) < 2**53
        }
        return {"parameters": {**self.parameters, **whole}, "units": dict(self.units)}

    def with_parameter(self, name: str, value: Value) -> Self:
        """Copy with another value of one parameter."""
        return replace(self, parameters={**self.parameters, name: value})

    def value_at(self, key: str) -> float | None:
        """Return the number under a dotted key of the file, in internal units; None without one."""
        table, _, name = key.partition(".")
        value = self.parameters.get(name) if table == "parameters" else None
        return float(value) if type(value) in (int, float) else None  # type: ignore[arg-type]

    def with_value(self, key: str, value: float) -> Self:
        """Copy with another number under a dotted key that has one."""
        return self.with_parameter(key.partition(".")[2], value)

    def physical(self) -> dict[str, object]:
        """Part of the document that can change an answer: of a stranger's program all of it."""
        return self.document()
