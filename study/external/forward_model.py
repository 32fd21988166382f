"""A forward model: its tables ``[forward]`` and ``[parameters]``, and the interface of every one.

A cell of a design holds one such object, made of the tables of its file. The built-in mechanics
(:class:`study.simulation.cell.CellProblem`) is one; a program or a function of parameters alone
(:class:`ParameterProblem`) is another. Whoever expands, prices, refines or reports a case asks the
object, and needs to know none of its tables.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from typing import TYPE_CHECKING, Annotated, Literal, Self

from study.ground import units
from study.ground.declaration import (
    DERIVED,
    MAX_NAME,
    Bad,
    Duration,
    Faults,
    Reads,
    Table,
    document_of,
    flag,
    measured,
    name,
    noted,
    quoted,
    reason,
    relative_path,
    section,
    shown,
    table_of,
    text,
    word,
)
from study.ground.errors import Fault, UnitError, nearest

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


# The table ``[parameters]``: names of the user's own, and what a program or function needs.
#
# A value is a number with or without a unit, a text or a flag. A number is kept in the unit of its
# first mention, and every level of a factor is converted to that.


MOST_PARAMETERS = 1000
#: words that a range or a distribution of a factor has for itself
RESERVED = (
    "low", "high", "scale", "levels", "distribution", "mean", "sd", "median", "factor", "mode",
)  # fmt: skip
#: tables of the built-in mechanics: where one of them is written, a cell is one of its problems
MECHANICAL = ("specimen", "test", "material", "model")


def stands_alone(tables: Table) -> bool:
    """Whether a file describes parameters alone, for a program or function of somebody else."""
    if any(name in tables for name in MECHANICAL):
        return False
    model = table_of(tables, "forward").get("model")
    return "parameters" in tables or model in ("command", "python")


def parameter_name(name: object) -> str:
    """Read the name of a parameter, which is also one in templates and constraints."""
    if not isinstance(name, str):
        raise Bad(f"must be a name, got {shown(name)}")
    if len(name) > MAX_NAME or not name.replace("-", "_").isidentifier():
        rule = f"has letters, digits, - and _ alone and begins with a letter, got {shown(name)}"
        raise Bad(f"a parameter's name {rule}", "for example viscosity or mesh_size")
    if name in RESERVED or name.startswith("_"):
        mend = f"call it, for example, {name.strip('_')}_value"
        raise Bad(f"{name!r} is a word of the study file and no name of a parameter", mend)
    return name


def parameter_key(example: str, value: object) -> str:
    """Read a dotted key of ``[parameters]``."""
    if not isinstance(value, str) or not is_parameter(value):
        raise Bad(f"must be a key of [parameters], got {shown(value)}", f"for example {example}")
    return value


def is_parameter(key: str) -> bool:
    """Whether a dotted key is one of ``[parameters]``."""
    table, _, name = key.partition(".")
    with suppress(Bad):
        return table == "parameters" and bool(parameter_name(name))
    return False


def number_and_unit(raw: object) -> tuple[float, str]:
    """Read a plain number, or a number with a unit, which stays as written."""
    if isinstance(raw, int | float) and not isinstance(raw, bool):
        if not math.isfinite(raw) or abs(raw) > 1e300:
            raise Bad(f"must be a finite number, got {shown(raw)}")
        return float(raw), ""
    try:
        number, unit = units.split(str(raw))
    except UnitError as error:
        raise Bad(error.faults[0].rule, 'write 12.5, or "3 Pa s"') from error
    if not units.is_known(unit) and unit not in ("1", "%"):
        mend = "write a unit such as kg, N/m or Pa s; a text must not begin with a number"
        raise Bad(f"has the unknown unit {unit!r}, got {shown(raw)}", mend)
    return number, "" if unit == "1" else unit


def number_in(raw: object, unit: str) -> float:
    """Read the number of a value in some unit; raises :class:`Bad` where the two do not fit."""
    number, written = number_and_unit(raw)
    try:
        return units.converted(number, written, unit)
    except UnitError as error:
        raise Bad(f"{shown(raw)} {error.faults[0].rule}", error.faults[0].mend) from error


def _read(raw: object) -> tuple[Value, str]:
    """Value of a key, and the unit of a number."""
    if isinstance(raw, bool):
        return raw, ""
    if isinstance(raw, int | float):
        return number_and_unit(raw)
    if not isinstance(raw, str):
        mend = 'write a number, "3 Pa s", a text, true or false'
        raise Bad(f"must be a number, a text or a flag, got {shown(raw)}", mend)
    return _text(raw)


#: words of models that begin with a number: 2D, 4-node, 3x3, 1st (2D is not two debye)
_WORD_WITH_NUMBER = re.compile(r"\d+(?:D|st|nd|rd|th|[x-]\S.*)")


@lru_cache(maxsize=4096)
def _text(raw: str) -> tuple[Value, str]:
    """Value of a text, and the unit of a number: levels come again in many cells."""
    plain = text(raw)
    if _WORD_WITH_NUMBER.fullmatch(plain):
        return plain, ""
    if plain[:1].isdigit() or plain[:2].lstrip("+-.")[:1].isdigit():
        return number_and_unit(plain)
    return plain, ""


def parameters_from(
    table: object, first: object, faults: Faults
) -> tuple[dict[str, Value], dict[str, str]]:
    """Values of a cell and their units; ``first`` is the table of the file, whose units count."""
    if not isinstance(table, Mapping):
        faults.add("parameters", f"must be a table, got {shown(table)}", "write [parameters]")
        return {}, {}
    if len(table) > MOST_PARAMETERS:
        rule = f"has {len(table)} parameters, the limit is {MOST_PARAMETERS}"
        faults.add("parameters", rule)
        return {}, {}
    usual = first if isinstance(first, Mapping) else {}
    read_all: dict[str, tuple[Value, str]] = {}
    for key, raw in table.items():
        where = f"parameters.{quoted(key)}"
        if noted(parameter_name, key, where, faults) is None:
            continue
        read = noted(_read, raw, where, faults)
        if read is not None and key in usual and usual[key] is not raw:
            with suppress(Bad):  # of the file's own value it is told where that stands
                read = noted(partial(_like, read, _read(usual[key])), raw, where, faults)
        if read is not None:
            read_all[key] = read
    values = {key: value for key, (value, _) in read_all.items()}
    return values, {key: unit for key, (_, unit) in read_all.items() if unit}


def overridden(name: str, raw: object, table: Table) -> object:
    """Value of ``-s parameters.name=..`` as the file would write it: its kind, in its unit.

    Programs get numbers without their unit, so that ``"12 cm"`` over ``"100 mm"`` is 120.
    """
    if name not in table:
        raise Bad("is no parameter of the file", nearest(name, table))
    try:
        first = _read(table[name])
    except Bad:  # told where that stands
        return raw
    read = _read(raw)
    value, unit = _like(read, first, raw)
    return raw if read[1] == unit else f"{value!r} {unit}"


def _like(read: tuple[Value, str], usual: tuple[Value, str], raw: object) -> tuple[Value, str]:
    """Value in the unit of the file's own one, of whose kind it must be."""
    (value, unit), (first, into) = read, usual
    if type(value) is not type(first):
        kinds = {float: "a number", str: "a text", bool: "a flag"}
        rule = f"is {kinds[type(value)]} here and {kinds[type(first)]} in [parameters]"
        mend = "write true or false" if isinstance(first, bool) else "make all its levels one kind"
        raise Bad(f"{rule}, got {shown(raw)}", mend)
    if isinstance(value, float):
        return units.converted(value, unit, into), into
    return value, unit


@dataclass(frozen=True, kw_only=True)
class ParameterProblem(ForwardCell):
    """Parameters alone, for a program or a function: no specimen, test, material or mesh."""

    forward: ForwardModel

    @property
    def discretization(self) -> str:
        """All cells of one forward model share an order in one parameter."""
        return "" if self.refinement is None else f"{self.forward.model} {self.refinement.name}"

    def document(self) -> dict[str, object]:
        """Plain values: parameters with their units, and what predicts."""
        units_of = {"units": dict(self.units)} if self.units else {}
        document = {"parameters": dict(self.parameters), **units_of}
        return {**document, "forward": self.forward.document()}


def check_names(config: Table, keys: Sequence[tuple[str, str]], faults: Faults) -> None:
    """Check that parameters that factors and presets set stand in ``[parameters]``, if it is there.

    ``keys`` are dotted keys with the place where each is written.
    """
    table = table_of(config, "parameters")
    for key, where in keys if table else ():
        if is_parameter(key) and key.partition(".")[2] not in table:
            near = nearest(key.partition(".")[2], list(table))
            mend = f"{near}; or give it a value in [parameters]"
            faults.add(where, f"sets {key}, which [parameters] does not have", mend)


# Constraints between parameters: read by their structure, never evaluated as code.

_OPERATORS: Mapping[type, Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
_COMPARISONS: Mapping[type, Callable[[float, float], bool]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
#: sides and operations that a constraint may have
_MOST_NODES = 60


@section
class Constraint:
    """One ``[[constraint]]``: an inequality of parameters, and why cells that break it go."""

    rule: Annotated[str, Reads(text, mend='rule = "inner < 0.9 * outer"')]
    why: Annotated[str, Reads(reason, mend='say why: why = "..."')]

    def holds(self, values: Mapping[str, Value]) -> bool:
        """Whether it holds of some values, each in its own unit."""
        if any(name not in values for name in self.names):
            return True  # a value that could not be read is told where it stands
        compared = _comparison(self.rule)
        sides = [_number(side, values) for side in (compared.left, *compared.comparators)]
        pairs = zip(sides, compared.ops, sides[1:], strict=False)
        return all(_COMPARISONS[type(op)](left, right) for left, op, right in pairs)

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that it compares."""
        identifiers = (n.id for n in ast.walk(_comparison(self.rule)) if isinstance(n, ast.Name))
        return tuple(dict.fromkeys(identifiers))


def _comparison(rule: str) -> ast.Compare:
    """Structure of a constraint."""
    mend = "for example inner < 0.9 * outer"
    try:
        tree = ast.parse(rule.strip(), mode="eval").body
        nodes = list(ast.walk(tree))
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise Bad(f"is no inequality: {shown(rule)}", mend) from None
    if not isinstance(tree, ast.Compare) or len(nodes) > _MOST_NODES:
        raise Bad(f"is no inequality of parameters: {shown(rule)}", mend)
    allowed = (ast.Compare, ast.BinOp, ast.UnaryOp, ast.USub, ast.Name, ast.Load, ast.Constant)
    for node in nodes:
        if not isinstance(node, (*allowed, *_OPERATORS, *_COMPARISONS)) or (
            isinstance(node, ast.Constant)
            and (type(node.value) not in (int, float) or not node.value < 1e300)  # type: ignore[operator]
        ):
            raise Bad(f"may have numbers, names, + - * / and < <= > >= alone: {shown(rule)}", mend)
    return tree


def _number(node: ast.expr, values: Mapping[str, Value]) -> float:
    if isinstance(node, ast.Constant):
        return float(node.value)  # type: ignore[arg-type]
    if isinstance(node, ast.Name):
        value = values[node.id]
        if isinstance(value, str):
            raise Bad(f"compares {node.id}, which is a text: {shown(value)}", "compare numbers")
        return float(value)
    if isinstance(node, ast.UnaryOp):
        return -_number(node.operand, values)
    if not isinstance(node, ast.BinOp):
        raise TypeError(f"a constraint has no {type(node).__name__}")
    right = _number(node.right, values)
    if isinstance(node.op, ast.Div) and right == 0:
        raise Bad("divides by a parameter that is 0", "multiply instead")
    return _OPERATORS[type(node.op)](_number(node.left, values), right)


def checked(config: Table, limit: Constraint) -> Constraint:
    """Give back a constraint whose names are parameters of the file, with units that agree."""
    named = table_of(config, "parameters")
    for key in limit.names:
        if key not in named:
            raise Bad(f"names {key!r}, which [parameters] does not have", nearest(key, named))
    compared = _comparison(limit.rule)
    written = {n: number_and_unit(named[n])[1] for n in limit.names if type(named[n]) is not bool}
    sides = [compared.left, *compared.comparators]
    plain = [written.get(side.id) for side in sides if isinstance(side, ast.Name)]
    if len(plain) == len(sides) and len(set(plain)) > 1:
        mend = "write all of them in one unit in [parameters]"
        raise Bad(f"compares numbers in {' and '.join(map(repr, plain))}", mend)
    return limit
