"""Answers of a stranger's program: a curve, named values, numbers of a log, each with its unit.

``problem.json`` holds the resolved problem of one solution in mm, N and MPa. The program writes
``curve.csv`` (``displacement_mm``, ``force_N``, and ``dforce_C10`` in N per MPa for a constant
whose gradient it knows) and, if it likes, ``facts.json`` (``dofs``, ``elements``).
"""

from __future__ import annotations

import contextlib
import csv
import functools
import io
import json
import math
import os
import re
import resource
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import BrokenExecutor, Future
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, cast

import numpy as np

from study.execution.local import Process, ProcessPool
from study.external.forward_model import NUMBER, NUMBER_PATTERN, CurveFile, ValueFile
from study.ground import units
from study.ground.arrays import Array
from study.ground.curve import Curve, spline_from_origin
from study.ground.errors import Fault, InputError, UnitError, nearest
from study.ground.files import UnreadableError, named_once, parse_json, read_regular
from study.record.record import MarkerDocument, MeshDocument, ProgramDocument, SolverDocument

if TYPE_CHECKING:
    from jinja2 import Environment, Template


# Input files, rendered by Jinja2 in a sandbox over the resolved case.

#: characters of a rendered file, and of a text that a template repeats
MOST_RENDERED = 20_000_000
_MOST_REPEATED = 100_000
#: seconds of this process that a template or the patterns of a log take, and bytes that they add
_MOST_SECONDS = 5.0
_MOST_MEMORY = 500_000_000
_NEAR = "\t"
#: what a call with limits gives
Given = TypeVar("Given")


@functools.cache
def _helper() -> ProcessPool:
    """Process whose main thread does for the other threads of this one what has limits."""
    return Process(dict).open()


def _within_limits(call: Callable[..., Given], *arguments: object) -> Given:
    """Make a call that a text of a stranger decides on, with limits of its time and memory.

    Signals reach only the main thread of a process: the thread of a command or a worker. Other
    threads, such as Dask's or a notebook's widgets', have the call made by a helper process.
    """
    if threading.current_thread() is threading.main_thread():
        return _limited(_MOST_SECONDS, call, *arguments)
    try:
        future: Future[Given] = _helper().submit(_limited, _MOST_SECONDS, call, *arguments)
        return future.result()
    except BrokenExecutor as error:
        _helper.cache_clear()
        raise MemoryError("the process that computed it has died") from error


def _limited(seconds: float, call: Callable[..., Given], *arguments: object) -> Given:
    """Make a call in the main thread with limits of its own time and memory."""

    def stop(*_: object) -> None:
        raise TimeoutError(f"takes more than {seconds:g} s of computing")

    pages = 0
    with contextlib.suppress(OSError):  # Linux alone tells
        pages = int((read_regular("/proc/self/statm") or b"0").split()[0])
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    most = pages * resource.getpagesize() + _MOST_MEMORY
    if pages and (soft == resource.RLIM_INFINITY or most < soft):
        resource.setrlimit(resource.RLIMIT_AS, (most, hard))
    handler = signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, seconds)
    try:
        return call(*arguments)
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, handler)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


class Names:
    """A table as templates see it: its keys alone, whatever words they are."""

    __slots__ = ("_table", "_title")

    def __init__(self, title: str, table: Mapping[str, object]) -> None:
        self._title, self._table = title, table

    def __getitem__(self, key: object) -> object:
        """Value of a key; a table within it likewise."""
        value = self._table[str(key)]
        return Names(f"{self._title}.{key}", value) if isinstance(value, Mapping) else value

    def __contains__(self, key: object) -> bool:
        return key in self._table

    def __iter__(self) -> Iterator[str]:
        return iter(self._table)

    def __len__(self) -> int:
        return len(self._table)


@functools.cache
def _sandbox() -> Environment:
    """Sandbox that names what is unknown, and whose products stay small."""
    # loaded where a template is: most studies have none
    from jinja2 import StrictUndefined
    from jinja2.exceptions import SecurityError
    from jinja2.sandbox import ImmutableSandboxedEnvironment
    from jinja2.utils import missing

    class Unknown(StrictUndefined):
        """A name that is not there, and what is near to it."""

        __slots__ = ()

        @property
        def _undefined_message(self) -> str:
            name, owner = str(self._undefined_name), self._undefined_obj
            if isinstance(owner, Names):
                near = nearest(name, owner)
                return f"unknown name {owner._title}.{name}{_NEAR}{near}"
            return f"unknown name {name}" if owner is missing else super()._undefined_message

    class Sandbox(ImmutableSandboxedEnvironment):
        """Sandbox that does not repeat texts and lists without end."""

        intercepted_binops = frozenset(["*", "**"])

        def call_binop(self, context: object, operator: str, left: object, right: object) -> object:
            """Multiply and raise numbers."""
            sizes = [len(side) for side in (left, right) if isinstance(side, str | list | tuple)]
            counts = [side for side in (left, right) if isinstance(side, int | float)]
            large = operator == "**" and any(abs(count) > 1000 for count in counts)
            if large or (sizes and counts and max(sizes) * max(counts) > _MOST_REPEATED):
                raise SecurityError("makes a text or a number of more than 100,000 digits")
            return self.binop_table[operator](left, right)

    return Sandbox(undefined=Unknown, keep_trailing_newline=True, autoescape=False)


@functools.lru_cache(maxsize=256)
def _template(text: str) -> Template:
    return _sandbox().from_string(text)


def rendered(text: str, context: Mapping[str, object], source: str) -> str:
    """Text of a template over a case; an unknown name is an :class:`InputError` with its line."""
    try:
        text_or_fault = _within_limits(_rendered, text, context, source)
    except (TimeoutError, MemoryError) as error:
        text_or_fault = _fault(error, source)
    if isinstance(text_or_fault, Fault):
        raise InputError(text_or_fault)
    return text_or_fault


def _fault(error: BaseException, source: str) -> Fault:
    """Fault of a template that could not be rendered to its end."""
    rule = f"cannot be rendered: {type(error).__name__}: {str(error)[:200] or 'no memory'}"
    return Fault(f"{source}:{_line(error)}", rule, "see what the template does there")


def _rendered(text: str, context: Mapping[str, object], source: str) -> str | Fault:
    """Text of a template, or what is wrong with it and where."""
    from jinja2.exceptions import SecurityError, TemplateError, TemplateSyntaxError, UndefinedError

    names = {k: Names(k, v) if isinstance(v, Mapping) else v for k, v in context.items()}
    size, parts = 0, []
    try:
        for part in _template(text).generate(**names):
            size += len(part)
            if size > MOST_RENDERED:
                raise SecurityError(f"renders more than {MOST_RENDERED / 1e6:g} MB")
            parts.append(part)
    except TemplateSyntaxError as error:
        rule = f"is no template: {error.message}"
        return Fault(f"{source}:{error.lineno}", rule, "mend the braces there")
    except UndefinedError as error:
        rule, _, near = str(error).partition(_NEAR)
        top = rule.removeprefix("unknown name ")
        mend = near or (nearest(top, context) if top != rule else "")
        return Fault(f"{source}:{_line(error)}", rule, mend)
    except (
        TemplateError, ArithmeticError, TypeError, ValueError, LookupError, TimeoutError,
        MemoryError, RecursionError,
    ) as error:  # fmt: skip
        if "no loader" in str(error):  # of include, import and extends
            rule = "takes in another file, which no template may: what runs is what was allowed"
            return Fault(f"{source}:{_line(error)}", rule, "write its text into this template")
        return _fault(error, source)
    return "".join(parts)


def _line(error: BaseException) -> int:
    """Line of a template in which an error arose."""
    trace, line = error.__traceback__, 1
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == "<template>":
            line = trace.tb_lineno
        trace = trace.tb_next
    return line


#: bytes of a file that is read, and characters of a line of it
MOST_BYTES = 20_000_000
_LINE = 2000
#: columns of a table, of which each cell takes memory
_MOST_COLUMNS = 10_000
#: magnitude that no number of an answer has
LARGEST = 1e30


class NoAnswer(Exception):
    """A part of a case has no answer; carries the status of the record."""

    #: characters of the reason
    REASON = 1000

    def __init__(self, status: str, message: str) -> None:
        # half of a character, which no file can hold, may stand in what a function raises
        message = message.encode(errors="replace").decode()
        cut = f"{message[: self.REASON]}..."
        super().__init__(message if len(message) <= self.REASON else cut)
        self.status = status
        #: What ran, and the zip of its folder where that is kept.
        self.program: ProgramDocument | None = None
        self.folder = b""


# Answers: a curve, named values of JSON or CSV, numbers of a log; each in the unit asked for.


def read_text(folder: Path, name: str) -> str:
    """Text of a file that a program left; a link, a pipe or a device is none."""
    try:
        data = read_regular(folder / name, MOST_BYTES, follow=False)
    except UnreadableError as error:
        rule = f"the program wrote no {name}: what stands there {error.rule}"
        raise NoAnswer("failed", rule) from error
    if data is None:
        raise NoAnswer("failed", f"the program wrote no {name}")
    return data.decode("utf-8-sig", errors="replace")


def curve_of(curve_file: CurveFile, folder: Path) -> Curve:
    """Curve of a file, in mm and N."""
    header, rows = table_rows(read_text(folder, curve_file.file), curve_file.file)
    columns = []
    for role, into in (("displacement", "mm"), ("force", "N")):
        column, unit = getattr(curve_file.columns, role), getattr(curve_file.units, role)
        values = column_of(header, rows, column, curve_file.file)
        columns.append(values * converted(1.0, unit, into, f"{role} of {curve_file.file}"))
    return checked_curve(columns[0], columns[1], curve_file.file)


def checked_curve(displacement_mm: Array, force_N: Array, what: str) -> Curve:  # noqa: N803
    """Curve of two columns, shape (n,), that are finite and rise."""
    check_columns({"displacement": displacement_mm, "force": force_N}, "displacement", what)
    if displacement_mm[0] == 0:  # the unloaded state is no step
        displacement_mm, force_N = displacement_mm[1:], force_N[1:]
    if displacement_mm.size == 0:
        raise NoAnswer("failed", f"{what} holds no point beyond the unloaded state")
    try:
        return Curve(displacement_mm, force_N).with_tangents()
    except (ValueError, ArithmeticError) as error:
        raise NoAnswer("failed", f"{what} is no curve: {error}") from error


def check_columns(columns: Mapping[str, Array], displacement: str, what: str) -> None:
    """Check that every number of some columns, shape (n,), is one, and that one column rises."""
    for values in columns.values():
        if not np.all(np.isfinite(values)):
            raise NoAnswer("not-converged", f"{what} holds a number that is not finite")
        if np.abs(values).max(initial=0.0) > LARGEST:
            raise NoAnswer("failed", f"{what} holds a number beyond {LARGEST:g}")
    d = columns[displacement]
    if d.size == 0 or d[0] < 0 or np.any(np.diff(d) <= 0):
        raise NoAnswer("failed", f"the displacement of {what} does not rise from 0 on")


def table_rows(text: str, name: str) -> tuple[list[str], list[list[str]]]:
    """Header and rows of a table; the header is empty where the first row is one of numbers."""
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if not lines:
        raise NoAnswer("failed", f"{name} is empty")
    if len(lines) > 1_000_000:
        raise NoAnswer("failed", f"{name} has more than a million rows")
    delimiter = next((mark for mark in ",;\t" if mark in lines[0]), None)
    if delimiter is not None and lines[0].count(delimiter) >= _MOST_COLUMNS:
        raise NoAnswer("failed", f"{name} has more than {_MOST_COLUMNS} columns")
    try:
        split = [line.split() for line in lines] if delimiter is None else [
            [cell.strip() for cell in row]
            for row in csv.reader(io.StringIO("\n".join(lines)), delimiter=delimiter)
        ]  # fmt: skip
    except csv.Error as error:
        raise NoAnswer("failed", f"{name}: {error}") from error
    try:
        list(map(float, split[0]))
    except ValueError:
        return split[0], split[1:]
    return [], split


def column_of(header: list[str], rows: list[list[str]], column: str | int, name: str) -> Array:
    """Numbers of a column of a table, by its name or its number from 1 on, shape (n,)."""
    if isinstance(column, str):
        if header.count(column) != 1:
            columns = ", ".join(header[:20]) or "numbers alone, without a header"
            raise NoAnswer("failed", f"{name} needs one column {column!r}, it has {columns}")
        index = header.index(column)
    else:
        index = column - 1
    values = []
    for number, row in enumerate(rows, 2 if header else 1):
        if index >= len(row):
            raise NoAnswer("failed", f"{name}:{number}: has {len(row)} columns, not {index + 1}")
        values.append(_number(row[index], f"{name}:{number}"))
    return np.array(values, dtype=float)


def _number(value: object, where: str) -> float:
    """Finite number of an answer."""
    text = value.strip().replace("D", "E").replace("d", "e") if isinstance(value, str) else value
    try:
        if isinstance(text, bool) or not isinstance(text, str | int | float):
            raise ValueError  # noqa: TRY301
        number = float(text)
    except OverflowError:  # a whole number of more than 308 digits
        raise NoAnswer("failed", f"{where}: is beyond {LARGEST:g}") from None
    except ValueError:
        shown = json.dumps(value, default=str)[:60]
        raise NoAnswer("failed", f"{where}: is no number: {shown}") from None
    if not math.isfinite(number):
        raise NoAnswer("not-converged", f"{where}: is {number}, not a finite number")
    if abs(number) > LARGEST:
        raise NoAnswer("failed", f"{where}: is {number:g}, beyond {LARGEST:g}")
    return number


def converted(value: float, unit: str, into: str, where: str) -> float:
    """Convert a number to the unit that the study file names."""
    try:
        return units.converted(value, unit, into)
    except UnitError as error:
        rule = f"{where}: {error.faults[0].rule}"
        raise NoAnswer("failed", f"{rule}; the study file asks for {into or 'no unit'}") from error


def values_of_files(value_file: ValueFile | None, folder: Path, output: str) -> dict[str, float]:
    """Every named value that a program left in its file or said in its output."""
    if value_file is None:
        return {}
    tables: Mapping[str, object] = {}
    if value_file.file and any(not pattern for _, _, pattern, *_ in value_file.names):
        try:
            tables = _table(read_text(folder, value_file.file), value_file.file)
        except UnreadableError as error:
            raise NoAnswer("failed", str(error)) from error
    values = {}
    for name, unit, pattern, file, written in value_file.names:
        if pattern:
            source = file or (value_file.file if not tables else "")
            text, source = (read_text(folder, source) if source else output), source or "output"
            values[name] = converted(_logged(text, pattern, source, name), written, unit, source)
        elif name not in tables:
            mend = nearest(name, list(tables)[:50])
            raise NoAnswer("failed", f"{value_file.file} has no value {name!r} ({mend})")
        else:
            values[name] = quantity_in(tables[name], unit, f"{name} of {value_file.file}")
    return values


def quantity_in(value: object, unit: str, where: str) -> float:
    """Read a plain number, ``"12 kPa"`` or ``{"value": 12, "unit": "kPa"}`` in a unit."""
    if isinstance(value, Mapping):
        number = _number(value.get("value"), where)
        return converted(number, str(value.get("unit", unit)), unit, where)
    if isinstance(value, str):
        try:
            float(value)  # beyond the largest number, or none, as it may be
        except ValueError:
            with contextlib.suppress(UnitError):  # no quantity, and no number either
                number, written = units.split(value)
                return _number(converted(number, written, unit, where), where)
    return _number(value, where)


def _table(text: str, name: str) -> Mapping[str, object]:
    """Names and values of a JSON object, or of a CSV of one row, or of rows of names."""
    if name.lower().endswith(".json"):
        content = parse_json(text, name, each_once=True)
        if not isinstance(content, dict):
            raise NoAnswer("failed", f"{name} must be an object of names and values")
        return content
    header, rows = table_rows(text, name)
    if [cell.lower() for cell in header[:2]] == ["name", "value"]:
        pairs: list[tuple[str, object]] = [
            (row[0], {"value": row[1], "unit": row[2]} if any(row[2:3]) else row[1])
            for row in rows
            if len(row) > 1
        ]
    elif len(rows) != 1 or len(rows[0]) != len(header):
        rule = f"has {len(rows)} rows below {len(header)} names, of which there may be one"
        raise NoAnswer("failed", f"{name}: {rule}; or write name,value in every row")
    else:
        pairs = list(zip(header, rows[0], strict=True))
    return named_once(pairs, name)


def _last_in(text: str, pattern: str) -> str | None:
    expression, last = re.compile(pattern), None
    for line in text.splitlines():
        for match in expression.finditer(line[:_LINE]):
            last = match[1]
    return last


def _logged(text: str, pattern: str, source: str, name: str) -> float:
    """Last number that a pattern has in a log."""
    try:
        last = _within_limits(_last_in, text, pattern)
    except TimeoutError as error:
        rule = f"{source}: looking for {name} with {pattern[:80]!r} {error}"
        raise NoAnswer("failed", f"{rule}: write it without a repeat within a repeat") from None
    if last is None:
        shown = pattern.replace(NUMBER_PATTERN, NUMBER)[:80]
        raise NoAnswer("failed", f"{source} has no {name}: nothing fits {shown!r}")
    return _number(last, f"{name} of {source}")


# Files between this package and another program: the problem in JSON, the curve in CSV.


PROBLEM_FILE = "problem.json"
CASE_FILE = "case.json"
CURVE_FILE = "curve.csv"
FACTS_FILE = "facts.json"
DISPLACEMENT = "displacement_mm"
FORCE = "force_N"
GRADIENT = "dforce_"
#: unknowns and elements that no mesh has, beyond which a double is not exact
MOST_ELEMENTS = 2**53
#: share of the displacement asked for that a curve may end before: digits of a text file
_SHORT = 1e-6


@dataclass(frozen=True)
class PredictedCurve:
    """A prediction, and how it was found: by our solver, a program or a function."""

    #: Forces at the displacements that were asked for; of parameters alone as they are given,
    #: without a point where none is.
    curve: Curve = field(default_factory=lambda: Curve(np.zeros(0), np.zeros(0)))
    #: How it was found; a closed form has no mesh.
    mesh: MeshDocument = field(default_factory=MeshDocument)
    solver: SolverDocument = field(default_factory=SolverDocument)
    #: What it cost beside the fit that gave the constants.
    seconds: float = 0.0
    #: What markers inside the specimen say of it.
    markers: MarkerDocument | None = None
    #: Further numbers of another program, in the units of the study file.
    values: Mapping[str, float] = field(default_factory=dict)
    #: Zip of its folder, where that is kept.
    folder: bytes = b""
    #: Files that were rendered for it.
    rendered: Mapping[str, str] = field(default_factory=dict)

    def to_json(self) -> dict[str, object]:
        """Plain data, for the store and for workers."""
        values = {"named_values": dict(self.values)} if self.values else {}
        return {"curve": self.curve.as_dict(), "mesh": self.mesh, "solver": self.solver, **values}

    @classmethod
    def from_json(cls, document: Mapping[str, object]) -> PredictedCurve:
        """Inverse of :meth:`to_json`."""
        return cls(
            Curve.from_dict(cast("Mapping[str, object]", document["curve"])),
            cast(MeshDocument, document.get("mesh", {})),
            cast(SolverDocument, document["solver"]),
            values=cast("Mapping[str, float]", document.get("named_values", {})),
        )


def curve_answered(folder: Path, displacement_mm: Array, reaches: bool = True) -> PredictedCurve:
    """Read the curve that a program wrote. Shapes: displacement_mm (n,)."""
    header, rows = table_rows(read_text(folder, CURVE_FILE), CURVE_FILE)
    names = (DISPLACEMENT, FORCE, *(name for name in header if name.startswith(GRADIENT)))
    columns = {name: column_of(header, rows, name, CURVE_FILE) for name in names}
    facts = _facts(read_text(folder, FACTS_FILE)) if os.path.lexists(folder / FACTS_FILE) else {}
    predicted = at_points(columns, displacement_mm, reaches)
    if not any(facts.values()):
        return predicted
    mesh: MeshDocument = {"dofs": facts.get("dofs", 0), "elements": facts.get("elements", 0)}
    return replace(predicted, mesh=mesh)


def at_points(
    columns: Mapping[str, Array], displacement_mm: Array, reaches: bool = True
) -> PredictedCurve:
    """Curve of some columns at the displacements asked for."""
    # Shapes: columns (m,), MPa; displacement_mm (n,).
    if not reaches and columns[DISPLACEMENT].size:
        inside = displacement_mm <= columns[DISPLACEMENT][-1] * (1 + _SHORT)
        displacement_mm = displacement_mm[inside] if inside.any() else displacement_mm
    check_columns(columns, DISPLACEMENT, "the curve")
    reached, force, end_mm = columns[DISPLACEMENT], columns[FORCE], float(displacement_mm[-1])
    if reached[-1] < end_mm * (1 - _SHORT):
        raise NoAnswer("not-converged", f"the curve ends at {reached[-1]:g} mm of {end_mm:g} mm")
    gradients = {k.removeprefix(GRADIENT): v for k, v in columns.items() if k.startswith(GRADIENT)}
    try:
        with np.errstate(all="ignore"):
            places = np.minimum(displacement_mm, reached[-1])
            gradient = {k: spline_from_origin(reached, v, places) for k, v in gradients.items()}
            forces = spline_from_origin(reached, force, places)
        return PredictedCurve(Curve(displacement_mm, forces, force_gradient=gradient))
    except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
        raise NoAnswer("failed", f"no spline goes through the curve: {error}") from error


def _facts(text: str) -> dict[str, int]:
    try:
        facts = parse_json(text, FACTS_FILE)
    except UnreadableError as error:
        raise NoAnswer("failed", str(error)) from error
    if not isinstance(facts, dict):
        raise NoAnswer("failed", f"{FACTS_FILE} must be an object")
    counts = {name: facts[name] for name in ("dofs", "elements") if facts.get(name) is not None}
    for name, count in counts.items():
        is_number = isinstance(count, int | float) and not isinstance(count, bool)
        if not is_number or not 0 <= count <= MOST_ELEMENTS or count != int(count):
            rule = f"must be a whole number that is not negative, got {str(count)[:80]}"
            raise NoAnswer("failed", f"{FACTS_FILE}: {name} {rule}")
    return {name: int(count) for name, count in counts.items()}
