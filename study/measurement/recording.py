"""Recorded rows of measured tests: found, parsed and told apart, before any rule touches them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study.arrays import Array
from study.errors import Fault, InputError, MissingDataError
from study.measurement.data_root import locate, locate_pattern
from study.measurement.plain_text import read_table
from study.measurement.quantities import KINEMATIC, KINETIC
from study.tabular import MAX_FAULTS, MAX_ROWS, CsvTable, label_fault
from study.units import parse

if TYPE_CHECKING:
    from study.measurement.section import Columns, MeasurementSpec

MAX_TRAVEL_MM = 1e5
MAX_FORCE_N = 1e8
MAX_TIME_S = 1e10
_UNIT_SUFFIX = re.compile(r".*?[_ \[(/]+([A-Za-z\u00b5\u03bc]{1,6})[\])]?$")


@dataclass(frozen=True)
class Recording:
    """Rows of one test as they were recorded.

    Parameters
    ----------
    where : str
        File and labels, for messages.
    groups : mapping of str to str
        Label of every grouping column.
    kinematic, kinetic : ndarray, shape (n,)
        How far and how hard: mm, N or MPa, or plain.
    time_s : ndarray, shape (n,), optional
        When, increasing; None where the file does not say.
    """

    where: str
    groups: Mapping[str, str]
    kinematic: Array
    kinetic: Array
    time_s: Array | None = None


@dataclass(frozen=True)
class Recordings:
    """All tests of some files.

    Parameters
    ----------
    tests : tuple of Recording
        In the order of the files.
    notes : tuple of str
        What the reader changed or skipped, counted.
    files : mapping of str to str
        Name of each file and its sha256.
    """

    tests: tuple[Recording, ...]
    notes: tuple[str, ...]
    files: Mapping[str, str]


def read_recordings(spec: MeasurementSpec, root: Path) -> Recordings:
    """Read the files of a specification; its rules (range, points, zero, sign) are not asked for.

    Parameters
    ----------
    spec : MeasurementSpec
        Which files, columns, rows and groups.
    root : Path
        Data root.

    Raises
    ------
    InputError
        With the faults of the files, by line and column.
    """
    tables = _tables(spec, root)
    groups = _group_names(spec, tuple(tables[0][1]))
    return Recordings(
        tuple(one for table, labels in tables for one in _split(table, labels, groups, spec)),
        tuple(note for table, _ in tables for note in table.notes),
        {table.source: table.sha256 for table, _ in tables},
    )


def _tables(spec: MeasurementSpec, root: Path) -> list[tuple[CsvTable, dict[str, str]]]:
    """Parse the files; each comes with the group labels that its name carries."""
    citation = spec.citation or ""
    if spec.file:
        found: list[tuple[str, dict[str, str]]] = [(spec.file, {})]
    else:
        found = locate_pattern(spec.files or "", root, citation=citation)
    columns, layout = spec.columns, spec.layout
    required = [columns.column(one) for one in _recorded(columns)]
    if spec.file:
        required += [n for n in _declared(spec) if n not in required]
    tables: list[tuple[CsvTable, dict[str, str]]] = []
    faults: list[Fault] = []
    rows = 0
    for name, labels in found:
        try:
            path = locate(name, root, citation=citation)
            table = read_table(path, layout, required, spec.decimal or ".", name)
        except MissingDataError:
            raise
        except InputError as error:
            faults.extend(error.faults)
            continue
        rows += len(table.lines)
        if rows > MAX_ROWS:
            raise InputError(Fault("measurements.files", f"hold more than {MAX_ROWS} rows in all"))
        tables.append((table, labels))
    if faults:
        raise InputError(capped(faults))
    return tables


def _recorded(columns: Columns) -> list[str]:
    """Quantities that have a column."""
    return [columns.kinematic, columns.kinetic, *columns.named(["time"])]


def _declared(spec: MeasurementSpec) -> list[str]:
    """Name the grouping columns of the specification, each once."""
    names = [spec.block] if spec.block else []
    names += [*(spec.average or ()), *(spec.fit or {}), *(spec.score or {})]
    return list(dict.fromkeys(names))


def _group_names(spec: MeasurementSpec, named: Sequence[str]) -> list[str]:
    return list(dict.fromkeys([*_declared(spec), *named]))


def _split(
    table: CsvTable, labels: Mapping[str, str], groups: Sequence[str], spec: MeasurementSpec
) -> Iterable[Recording]:
    """Rows of each test of a table."""
    d = _quantity(table, spec, spec.columns.kinematic, MAX_TRAVEL_MM)
    f = _quantity(table, spec, spec.columns.kinetic, MAX_FORCE_N)
    has_time = spec.columns.time is not None
    time = _quantity(table, spec, "time", MAX_TIME_S) if has_time else None
    inside = [name for name in groups if name not in labels]
    for name, label in labels.items():
        if rule := label_fault(label):
            raise InputError(Fault(f"{table.source}: name of the file", f"{name}: {rule}"))
    clash = [name for name in labels if name in table.columns]
    if clash:
        raise InputError(
            Fault(
                table.source,
                f"{clash[0]!r} is both a column and part of the file's name",
                "rename one of them in the pattern of `files`",
            )
        )
    keys = list(zip(*(table.text(name) for name in inside), strict=True)) or [()] * d.size
    _check_labels(table, inside, keys)
    rows: dict[tuple[str, ...], list[int]] = {}
    for k, key in enumerate(keys):
        rows.setdefault(key, []).append(k)
    for key, members in rows.items():
        found = {**dict(zip(inside, key, strict=True)), **labels}
        ordered = {name: found[name] for name in groups}
        words = ", ".join(f"{n} = {v}" for n, v in ordered.items())
        where = f"{table.source}: {words}" if words else table.source
        if time is None:
            _check_one_test(table, members, d, where, groups, spec.columns)
        else:
            _check_time(table, members, time, where)
        when = None if time is None else time[members]
        yield Recording(where, ordered, d[members], f[members], when)


def _check_time(table: CsvTable, members: Sequence[int], time: Array, where: str) -> None:
    """Refuse times that do not increase: several tests in one, or rows out of order."""
    back = np.flatnonzero(np.diff(time[list(members)]) <= 0)
    if back.size:
        line = table.lines[members[int(back[0]) + 1]]
        raise InputError(
            Fault(
                f"{table.source}:{line}",
                f"time does not increase from row to row ({where})",
                "name the column that tells the tests apart in `average` or `block`, or keep one "
                "of the rows of equal time",
            )
        )


def _check_labels(table: CsvTable, names: Sequence[str], keys: Sequence[tuple[str, ...]]) -> None:
    for key in dict.fromkeys(keys):
        for name, label in zip(names, key, strict=True):
            rule = label_fault(label)
            if rule:
                line = table.lines[keys.index(key)]
                raise InputError(
                    Fault(
                        f"{table.source}:{line}: column {name!r}",
                        rule,
                        "every row needs the label of its test, in plain characters",
                    )
                )


def _check_one_test(
    table: CsvTable,
    members: Sequence[int],
    d: Array,
    where: str,
    groups: Sequence[str],
    columns: Columns,
) -> None:
    """Refuse rows in which the travel starts again: they are several tests, not one."""
    own = d[list(members)]
    jumps = np.flatnonzero(np.abs(np.diff(own)) > 0.5 * np.ptp(own))
    back = [int(j) for j in jumps if abs(own[j + 1]) < abs(own[j])]
    if not back or own.size < 5:
        return
    k, after = members[back[0]], members[back[0] + 1]
    used = {*groups, *(columns.column(one) for one in _recorded(columns))}
    changing = [n for n, c in table.columns.items() if n not in used and c[k] != c[after]]
    steady = [n for n in changing if len({table.columns[n][m] for m in members}) <= len(back) + 1]
    hint = f"; column {steady[0]!r} changes there" if steady else ""
    raise InputError(
        Fault(
            f"{table.source}:{table.lines[after]}",
            f"the displacement starts again: several tests in one ({where}){hint}",
            "name the column that tells them apart in `average` (repeats on one specimen) or "
            "in `block`, `fit` and `score`",
        )
    )


def _quantity(table: CsvTable, spec: MeasurementSpec, what: str, limit: float) -> Array:
    """Column in mm, N or MPa, or plain, refused where it is beyond any test."""
    factor, column = _factor(table, spec, what), spec.columns.column(what)
    values = table.numbers(column)
    beyond = np.flatnonzero(np.abs(values) > limit / factor)
    if beyond.size:
        k = int(beyond[0])
        raise InputError(
            Fault(
                f"{table.source}:{table.lines[k]}: column {column!r}",
                f"{values[k]:.6g} {spec.units.unit(what)} is beyond any test of a specimen",
                "check the cell and measurements.units",
            )
        )
    return values * factor


def _factor(table: CsvTable, spec: MeasurementSpec, what: str) -> float:
    """Factor from the declared unit of a column to mm, N or MPa."""
    column, unit = spec.columns.column(what), spec.units.unit(what)
    dimension = "time" if what == "time" else {**KINEMATIC, **KINETIC}[what]
    factor = parse(f"1 {unit}", dimension)
    suffix = _UNIT_SUFFIX.fullmatch(column)
    if suffix:
        try:
            named = parse(f"1 {suffix[1]}", dimension)
        except InputError:
            return factor  # the last word of the name is no unit of this dimension
        if not np.isclose(named, factor, rtol=1e-9):
            raise InputError(
                Fault(
                    f"{table.source}: column {column!r}",
                    f"its name says {suffix[1]}, but {unit} is declared in measurements.units",
                    "declare the unit that the file is in",
                )
            )
    return factor


def capped(faults: Sequence[Fault]) -> list[Fault]:
    """Shorten a long list of faults, and say by how many.

    Parameters
    ----------
    faults : sequence of Fault
        All that were found; the first :data:`MAX_FAULTS` are kept.
    """
    if len(faults) <= MAX_FAULTS:
        return list(faults)
    return [
        *faults[:MAX_FAULTS],
        Fault("measurements", f"{len(faults) - MAX_FAULTS} more faults like these"),
    ]
