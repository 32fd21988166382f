"""Read measured force-displacement tests: find, parse, check and condition them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study.arrays import Array
from study.errors import Fault, InputError, MissingDataError, nearest
from study.measurement.conditioning import SIGNS, ZERO_RULES, Conditioned, Rules, condition
from study.measurement.data_root import locate, locate_pattern
from study.measurement.measured_test import Measurements, SingleTest
from study.measurement.plain_text import Layout, read_table
from study.measurement.quantities import KINEMATIC, KINETIC, Gauge, displacement_and_force
from study.tabular import MAX_FAULTS, MAX_ROWS, CsvTable, label_fault
from study.units import parse

if TYPE_CHECKING:
    from study.measurement.section import Columns, MeasurementSpec

MAX_TRAVEL_MM = 1e5
MAX_FORCE_N = 1e8
_UNIT_SUFFIX = re.compile(r".*?[_ \[(/]+([A-Za-z\u00b5\u03bc]{1,6})[\])]?$")


def read_measurements(
    spec: MeasurementSpec,
    root: Path,
    height_mm: float | None = None,
    displacement_mm: float | None = None,
    gauge: Gauge | None = None,
) -> Measurements:
    """Read, check and condition all tests that a specification names.

    Parameters
    ----------
    spec : MeasurementSpec
        Table ``[measurements]`` of a design or calibration.
    root : Path
        Data root; nothing outside it is read.
    height_mm : float, optional
        Height of the specimen in mm; needed for a range in percent.
    displacement_mm : float, optional
        Test displacement in mm, the end of the range where the specification has none.
    gauge : Gauge, optional
        Specimen and loading; needed where strain or stress was recorded.

    Raises
    ------
    InputError
        With all faults of the data found, by file, line and column.
    """
    root = Path(root)
    rules = _rules(spec, height_mm, displacement_mm)
    tables = _tables(spec, root)
    named = tuple(tables[0][1])
    groups = _group_names(spec, named)
    notes = [note for table, _ in tables for note in table.notes]
    tests: list[SingleTest] = []
    faults: list[Fault] = []
    done: list[Conditioned] = []
    for table, labels in tables:
        for where, keys, *recorded in _split(table, labels, groups, spec):
            try:
                d, f = displacement_and_force(
                    spec.columns.kinematic, recorded[0], spec.columns.kinetic, recorded[1],
                    gauge, where,
                )  # fmt: skip
                result = condition(d, f, rules, where)
            except InputError as error:
                faults.extend(error.faults)
                continue
            done.append(result)
            own = tuple(f"{where}: {n} {what}" for what, n in result.counts.items())
            tests.append(SingleTest(keys, result.force_N, own))
    _check_distinct(tests, faults)
    if faults:
        raise InputError(_capped(faults))
    notes += _summary(done, rules)
    found = Measurements(
        tuple(tests),
        _common_grid(done, rules),
        getattr(spec, "block", None),
        tuple(spec.average or ()),
        spec.fit,
        spec.score,
        bool(spec.swap),
        tuple(notes),
        {table.source: table.sha256 for table, _ in tables},
    )
    _check_selections(found)
    return found


def _common_grid(done: Sequence[Conditioned], rules: Rules) -> Array:
    """Displacements of all tests: rows as measured must be the same ones in each."""
    if not rules.is_raw:
        return rules.grid()
    first = done[0].displacement_mm
    for one in done[1:]:
        if one.displacement_mm.shape != first.shape or not np.allclose(one.displacement_mm, first):
            rule = "raw rows lie at other displacements in every test of these measurements"
            mend = "write a number of points, or a [[tests]] table for each test"
            raise InputError(Fault("measurements.points", rule, mend))
    return first


def _rules(spec: MeasurementSpec, height_mm: float | None, displacement_mm: float | None) -> Rules:
    sign, zero = spec.sign or "positive", spec.zero or "none"
    points = 0 if spec.points == "raw" else int(spec.points or 200)
    faults = []
    if sign not in SIGNS:
        faults.append(Fault("measurements.sign", f"unknown value {sign!r}", nearest(sign, SIGNS)))
    if zero not in ZERO_RULES:
        faults.append(
            Fault("measurements.zero", f"unknown rule {zero!r}", nearest(zero, ZERO_RULES))
        )
    if points < 2 and spec.points != "raw":
        faults.append(Fault("measurements.points", f"must be at least 2, got {points}"))
    low, high = _range(spec, height_mm, displacement_mm, points)
    if not 0 <= low < high:
        faults.append(
            Fault("measurements.range", f"must rise from 0 or more, got {low:.4g} to {high:.4g} mm")
        )
    if faults:
        raise InputError(faults)
    return Rules(low, high, points, sign, zero, spec.toe, height_mm)


def _range(
    spec: MeasurementSpec, height_mm: float | None, displacement_mm: float | None, points: int
) -> tuple[float, float]:
    if spec.range is None and spec.points == "raw":
        return 0.0, np.inf if displacement_mm is None else displacement_mm
    if spec.range is None:
        if displacement_mm is None:
            raise InputError(
                Fault(
                    "measurements.range",
                    "is missing, and no test.displacement stands for it",
                    'for example range = ["1 %", "20 %"]',
                )
            )
        return displacement_mm / max(points, 2), displacement_mm
    if spec.range.kind == "percent" and height_mm is None:
        raise InputError(
            Fault(
                "measurements.range",
                "in percent needs the height of the specimen",
                "give specimen.height, or the range in mm",
            )
        )
    low, high = spec.range.in_mm(height_mm)
    return float(low), float(high)


def _tables(spec: MeasurementSpec, root: Path) -> list[tuple[CsvTable, dict[str, str]]]:
    """Parse the files; each comes with the group labels that its name carries."""
    citation = spec.citation or ""
    if spec.file:
        found: list[tuple[str, dict[str, str]]] = [(spec.file, {})]
    else:
        found = locate_pattern(spec.files or "", root, citation=citation)
    columns, layout = spec.columns, Layout(spec.skip_lines, spec.comment, spec.delimiter)
    required = [columns.column(columns.kinematic), columns.column(columns.kinetic)]
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
        raise InputError(_capped(faults))
    return tables


def _declared(spec: MeasurementSpec) -> list[str]:
    """Name the grouping columns of the specification, each once."""
    names = [spec.block] if spec.block else []
    names += [*(spec.average or ()), *(spec.fit or {}), *(spec.score or {})]
    return list(dict.fromkeys(names))


def _group_names(spec: MeasurementSpec, named: Sequence[str]) -> list[str]:
    return list(dict.fromkeys([*_declared(spec), *named]))


def _split(
    table: CsvTable, labels: Mapping[str, str], groups: Sequence[str], spec: MeasurementSpec
) -> Iterable[tuple[str, dict[str, str], Array, Array]]:
    """Rows of each test of a table: name for messages, labels, displacement, force."""
    d = _quantity(table, spec, spec.columns.kinematic, MAX_TRAVEL_MM)
    f = _quantity(table, spec, spec.columns.kinetic, MAX_FORCE_N)
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
        _check_one_test(table, members, d, where, groups, spec.columns)
        yield where, ordered, d[members], f[members]


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
    used = {*groups, columns.column(columns.kinematic), columns.column(columns.kinetic)}
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
    dimension = {**KINEMATIC, **KINETIC}[what]
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


def _check_distinct(tests: Sequence[SingleTest], faults: list[Fault]) -> None:
    seen = Counter(tuple(test.groups.items()) for test in tests)
    faults.extend(
        Fault(
            "measurements",
            f"{n} files hold the same test: {dict(key)}",
            "give each its own name in braces in `files`, or name what differs",
        )
        for key, n in seen.items()
        if n > 1
    )


def _check_selections(found: Measurements) -> None:
    """Find a block without its fit or score tests now, not in the middle of a run."""
    faults: list[Fault] = []
    for block in found.blocks or (None,):
        for where in (found.fit, found.score):
            if where is None:
                continue
            try:
                found.curve(block, **where)
            except InputError as error:
                faults.extend(error.faults)
    if faults:
        raise InputError(_capped(list(dict.fromkeys(faults))))


def _summary(done: Sequence[Conditioned], rules: Rules) -> list[str]:
    """Report what the rules did over all tests, counted."""
    total: Counter[str] = Counter()
    tests: Counter[str] = Counter()
    for result in done:
        total.update(result.counts)
        tests.update(result.counts.keys())
    notes = [f"{total[w]} {w} (in {tests[w]} of {len(done)} tests)" for w in total]
    if rules.zero != "none":
        zero = [result.zero_N for result in done]
        notes.append(
            f"load cell zero ({rules.zero}) subtracted: {min(zero):.4g} to {max(zero):.4g} N"
        )
    if rules.toe_N is not None:
        toe = [result.toe_mm for result in done]
        notes.append(
            f"contact at {rules.toe_N:.4g} N: displacement shifted by {min(toe):.4g} to "
            f"{max(toe):.4g} mm"
        )
    rows = sorted({result.rows for result in done})
    several = f"{rows[0]} to {rows[-1]}" if len(rows) > 1 else str(rows[0])
    notes.append(
        f"{len(done)} tests of {several} rows"
        + _within(rules)
        + ", "
        + ("as they were measured" if rules.is_raw else f"resampled at {rules.points} points")
    )
    return notes


def _within(rules: Rules) -> str:
    if np.isinf(rules.high_mm):
        return ""
    return f" in the range {rules.low_mm:.4g} to {rules.high_mm:.4g} mm"


def _capped(faults: Sequence[Fault]) -> list[Fault]:
    if len(faults) <= MAX_FAULTS:
        return list(faults)
    return [
        *faults[:MAX_FAULTS],
        Fault("measurements", f"{len(faults) - MAX_FAULTS} more faults like these"),
    ]
