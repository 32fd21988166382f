"""Recorded rows of measured tests: found, parsed and told apart, before any rule touches them.

Columns hold displacement and force, or measures of strain and stress.
"""

from __future__ import annotations

import glob
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath

import numpy as np

from study.ground.arrays import Array, gathered
from study.ground.declaration import Bad, Faults, relative_path
from study.ground.errors import Fault, InputError, MissingDataError
from study.ground.files import read_bytes, table_text
from study.ground.tabular import MAX_FAULTS, MAX_ROWS, CsvTable, label_fault, parse_csv
from study.ground.units import parse
from study.mechanics.measurement.measurement_section import SECOND, Columns, MeasurementSpec
from study.mechanics.measurement.written_units import (
    DIMENSIONS,
    contradicts,
    shows_unit,
    sizes_above,
    units_above,
    word_of_unit,
    written_unit,
)


def read_table(
    path: Path, layout: MeasurementSpec, required: Sequence[str], source: str
) -> CsvTable:
    """Read a measured file; see :func:`study.ground.tabular.read_csv`."""
    raw = read_bytes(path, source)
    text, encoding = table_text(
        raw, source, encoding=layout.encoding, sheet=layout.sheet, decimal=layout.decimal
    )
    plain, at, mark = layout.plain_text(text)
    table = parse_csv(
        plain, required=required, numbers=() if layout.thousands == "," else None,
        decimal=layout.decimal, source=source, numbered=at, delimiter=mark,
    )  # fmt: skip
    above = text.splitlines()[: at[0] - 1 if at else 0]
    table = replace(table, thousands=layout.thousands, units_above=units_above(above),
                    sizes_above=sizes_above(above))  # fmt: skip
    return table.without_units(required, layout.unit_row).of_file(raw, encoding)


# -------------------------------------------------------------------------------------------------
# Columns of a measured test: displacement and force, or measures of strain and stress.
#
# A curve is force over displacement. What was recorded as stretch, strain or stress becomes that
# of a gauge section of known length and area: displacement is the elongation (or offset) in the
# sense of the test, force is nominal stress times the reference area. True stress becomes nominal
# at constant volume, sigma / l, as rubber and soft tissue are evaluated (Treloar 1975, ch. 5).

#: stretch beyond that of rubber and tough gels
LARGEST_STRETCH = 20.0
#: stretch at which no recording of a specimen begins
_AT_REST = 5.0

#: share of the largest deformation that rows on the other side of zero have at most in a test of
#: one side
_ONE_SIDED = 0.1

#: modes of loading in which a column has a meaning; all where it is not listed
_MODES: Mapping[str, tuple[str, ...]] = {
    "stretch": ("uniaxial", "equibiaxial", "planar", "confined", "volumetric"),
    "true_strain": ("uniaxial", "equibiaxial", "planar", "confined", "volumetric"),
    "volume_ratio": ("confined", "volumetric"),
    "true_stress": ("uniaxial", "equibiaxial", "planar", "confined", "simple-shear"),
    "pressure": ("volumetric",),
    "stretch_1": ("biaxial",),
    "stress_1": ("biaxial",),
}

_TO_STRETCH: Mapping[str, Callable[[Array], Array]] = {
    "stretch": lambda value: value,
    "stretch_1": lambda value: value,
    "strain": lambda value: 1 + value,
    "true_strain": np.exp,
}


@dataclass(frozen=True)
class Gauge:
    """What turns stretch and stress into displacement and force."""

    #: Of the specimen before the test.
    area_mm2: float
    length_mm: float
    mode: str
    #: Elongation per displacement: -1 where the test shortens.
    sense: float
    #: Whether the specimen deforms the same everywhere, so that it has one stretch.
    is_homogeneous: bool
    #: Power of the displacement from contact with which the force begins.
    onset_power: float = 1.0


def displacement_and_force(recording: Recording, gauge: Gauge | None) -> tuple[Array, Array]:
    """Displacements and forces of a test, mm and N, both of shape (rows,)."""
    kinematic, kinetic = recording.quantities
    deformed, resisted, where = recording.kinematic, recording.kinetic, recording.where
    if gauge is not None and gauge.mode == "biaxial" and kinematic not in SECOND:
        rule = "a biaxial test has a stretch and a stress in each of two directions"
        mend = "name columns stretch_1, stretch_2, stress_1 and stress_2"
        raise InputError(Fault(where, rule, mend))
    if kinematic == "displacement" and kinetic == "force":
        return deformed, resisted
    section = _checked(recording, gauge)
    if section.mode == "simple-shear":
        shear = deformed / section.length_mm if kinematic == "displacement" else deformed
        force = resisted if kinetic == "force" else section.area_mm2 * resisted
        turned = np.where(shear < 0, -1.0, 1.0)
        if recording.time_s is not None or (turned > 0).all():
            return shear * section.length_mm, force
        order = np.argsort(np.abs(shear), kind="stable")
        return np.abs(shear)[order] * section.length_mm, (turned * force)[order]
    deformed = _lengthening(deformed, kinematic, section)
    if kinematic == "displacement":
        stretch = np.asarray(1 + section.sense * deformed / section.length_mm)
    elif kinematic != "volume_ratio":
        stretch = np.asarray(_TO_STRETCH[kinematic](deformed))
    else:
        stretch = deformed if section.mode == "confined" else np.asarray(np.cbrt(deformed))
    percent = f'if {kinematic} is in per cent, write units = {{ {kinematic} = "%" }}'
    if not (stretch > 0).all():
        rule = f"{kinematic} of {deformed[np.argmin(stretch)]:g} leaves nothing of the specimen"
        raise InputError(Fault(where, rule, f"check the column and measurements.units: {percent}"))
    least = float(stretch.min()) if kinematic.startswith("stretch") else 1.0
    if stretch.max() > LARGEST_STRETCH and (least == 1.0 or least > _AT_REST):
        rule = (
            f"{kinematic} up to {deformed[np.argmax(stretch)]:g} means a stretch of "
            f"{stretch.max():.4g}, which no soft material bears ({LARGEST_STRETCH:g} at most)"
        )
        raise InputError(Fault(where, rule, percent))
    elongation = section.sense * (stretch - 1) * section.length_mm
    displacement = deformed if kinematic == "displacement" else elongation
    return displacement, _force(kinetic, resisted, stretch, section)


def _lengthening(deformed: Array, kinematic: str, gauge: Gauge) -> Array:
    """Deformation with the sign that its quantity has in this test, however it was recorded.

    Strain counts lengthening, displacement the way of the test. A shortening that is recorded as a
    positive strain, or as a negative displacement, is turned; rows on both sides of zero are not.
    """
    way = 1.0 if kinematic == "displacement" else gauge.sense
    turns = kinematic == "displacement" or (way < 0 and "strain" in kinematic)
    least, most = sorted((abs(float(deformed.min())), abs(float(deformed.max()))))
    against = abs(float((way * deformed).min())) == most
    return -deformed if turns and against and least <= _ONE_SIDED * most else deformed


def _checked(recording: Recording, gauge: Gauge | None) -> Gauge:
    if gauge is None or not gauge.is_homogeneous:
        pair = " and ".join(recording.quantities)
        rule = f"{pair} are those of a specimen that deforms the same everywhere"
        mend = "give displacement and force, or a test without bonded faces"
        raise InputError(Fault(recording.where, rule, mend))
    for column in recording.quantities:
        modes = _MODES.get(column, (gauge.mode,))
        if gauge.mode not in modes:
            rule = f"a column {column} has no meaning in {gauge.mode} loading"
            raise InputError(Fault(recording.where, rule, f"it belongs to {', '.join(modes)}"))
    return gauge


def _force(kinetic: str, values: Array, stretch: Array, gauge: Gauge) -> Array:
    if kinetic == "force":
        return values
    if kinetic == "pressure":  # on faces whose area shrinks with l^2
        return np.asarray(gauge.area_mm2 * values * stretch**2)
    if kinetic == "true_stress" and gauge.mode != "confined":
        return np.asarray(gauge.area_mm2 * values / stretch)
    return np.asarray(gauge.area_mm2 * values)


# -------------------------------------------------------------------------------------------------
# Find measurement files below the data root, and never outside it.

MAX_FILES = 10_000
_FIELD = re.compile(r"\{([^{}]*)\}")


def check_relative(name: str, where: str = "measurements.file") -> None:
    """Refuse a path that is absolute, climbs with ``..`` or holds a NUL."""
    try:
        relative_path(name)
    except Bad as bad:
        raise InputError(Fault(where, bad.rule, bad.mend)) from None


def locate(name: str, root: Path, *, citation: str = "", where: str = "measurements.file") -> Path:
    """Absolute path of one file below the data root."""
    check_relative(name, where)
    path = root / name
    try:
        resolved = path.resolve()
        inside = resolved.is_relative_to(root.resolve())
        is_there = inside and resolved.is_file()
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(Fault(where, f"{name!r} cannot be used: {error}")) from error
    if not inside:
        rule = f"{name!r} leads outside the data root {str(root)!r} through a link"
        mend = "copy the file there, or name its folder with --data DIR"
        raise InputError(Fault(where, rule, mend))
    if not is_there:
        raise MissingDataError(_missing(f"no file {name!r}", root, citation, where))
    return resolved


def locate_pattern(
    pattern: str, root: Path, *, citation: str = ""
) -> list[tuple[str, dict[str, str]]]:
    """Files below the data root that match a pattern such as ``"compression-{specimen}.csv"``."""
    where = "measurements.files"
    check_relative(pattern, where)
    pieces = list(enumerate(_FIELD.split(str(PurePosixPath(pattern)))))
    files = root.glob("".join("*" if k % 2 else glob.escape(piece) for k, piece in pieces))
    # each label takes as little as it can
    parts = "".join(f"(?P<{p}>[^/]+?)" if k % 2 else re.escape(p) for k, p in pieces)
    names = sorted(file.relative_to(root).as_posix() for file in files if not file.is_dir())
    matches = [(name, match) for name in names if (match := re.fullmatch(parts, name))]
    if not matches:
        raise MissingDataError(_missing(f"no file matches {pattern!r}", root, citation, where))
    if len(matches) > MAX_FILES:
        raise InputError(Fault(where, f"{len(matches)} files match, at most {MAX_FILES} are read"))
    return [(name, match.groupdict()) for name, match in matches]


def _missing(what: str, root: Path, citation: str, where: str) -> Fault:
    mend = "point to the folder that holds it with --data DIR"
    if citation:
        mend += f"; the data come from: {citation}"
    elif where.startswith("measurements"):
        mend += ", or let 'study virtual measurements --help' make curves of virtual specimens"
    state = "" if root.is_dir() else " (there is no such folder)"
    return Fault(where, f"{what} below {str(root)!r}{state}", mend)


#: rows of a test that jumps ahead by more than half of its travel in one step
_FEW_ROWS = 3
MAX_TRAVEL_MM = 1e5
MAX_FORCE_N = 1e8
MAX_TIME_S = 1e10


@dataclass(frozen=True)
class Recording:
    """Rows of one test as they were recorded."""

    where: str
    groups: Mapping[str, str]
    #: shape (n,); how far and how hard: mm, N or MPa, or plain.
    kinematic: Array
    kinetic: Array
    #: shape (n,); when, increasing; None where the file does not say.
    time_s: Array | None = None
    #: Line of the file on which each row stands.
    lines: tuple[int, ...] = ()
    #: What the columns hold.
    quantities: tuple[str, str] = ("displacement", "force")
    #: 2 where the rows of a second direction follow those of the first.
    directions: int = 1


@dataclass(frozen=True)
class Recordings:
    """All tests of some files."""

    #: In the order of the files.
    tests: tuple[Recording, ...]
    #: What the reader changed or skipped, counted.
    notes: tuple[str, ...]
    #: Name of each file and its sha256.
    files: Mapping[str, str]
    #: Sizes of the specimen by file, as lines above its rows say, mm and mm^2.
    sizes: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


def read_recordings(spec: MeasurementSpec, root: Path) -> Recordings:
    """Read the files of a specification; range, points, zero and sign are not applied."""
    tables = _tables(spec, root)
    groups = list(dict.fromkeys([*_declared(spec), *tables[0][1]]))
    return Recordings(
        tuple(
            recording
            for table, labels in tables
            for recording in _split(table, labels, groups, spec)
        ),
        tuple(note for table, _ in tables for note in table.notes),
        {table.source: table.sha256 for table, _ in tables},
        {table.source: table.sizes_above for table, _ in tables if table.sizes_above},
    )


def _tables(spec: MeasurementSpec, root: Path) -> list[tuple[CsvTable, dict[str, str]]]:
    """Parse the files; each comes with the group labels that its name carries."""
    citation = spec.citation or ""
    located: list[tuple[str, dict[str, str]]] = [(spec.file or "", {})]
    if not spec.file:
        located = locate_pattern(spec.files or "", root, citation=citation)
    required = [spec.columns.column(quantity) for quantity in _recorded(spec.columns)]
    if spec.file:
        required += [n for n in _declared(spec) if n not in required]
    tables: list[tuple[CsvTable, dict[str, str]]] = []
    faults, rows = Faults(), 0
    for name, labels in located:
        with faults.gathered():
            table = read_table(locate(name, root, citation=citation), spec, required, name)
            tables.append((table, labels))
            rows += len(table.lines)
        if rows > MAX_ROWS:
            raise InputError(Fault("measurements.files", f"hold more than {MAX_ROWS} rows in all"))
    if faults:
        raise InputError(capped(faults))
    return tables


def _recorded(columns: Columns) -> list[str]:
    """Quantities that have a column."""
    second = list(SECOND.values()) if columns.is_biaxial else []
    return [columns.kinematic, columns.kinetic, *columns.named([*second, "time"])]


def _declared(spec: MeasurementSpec) -> list[str]:
    """Name the grouping columns of the specification, each once."""
    block = [spec.block] if spec.block else []
    return list(dict.fromkeys([*block, *spec.average, *(spec.fit or {}), *(spec.score or {})]))


def _split(
    table: CsvTable, labels: Mapping[str, str], groups: Sequence[str], spec: MeasurementSpec
) -> Iterable[Recording]:
    """Rows of each test of a table."""
    held = (spec.columns.kinematic, spec.columns.kinetic)
    limits = dict(zip(held, (MAX_TRAVEL_MM, MAX_FORCE_N), strict=True))
    if spec.columns.time is not None:
        limits["time"] = MAX_TIME_S
    if spec.columns.is_biaxial:
        limits |= {second: limits[first] for first, second in SECOND.items()}
    read: dict[str, Array] = {}
    faults = Faults()
    for what, limit in limits.items():
        with faults.gathered():
            read[what] = _quantity(table, spec, what, limit)
    faults.refuse()
    time = read.get("time")
    inside = [name for name in groups if name not in labels]
    keys = list(zip(*(table.text(name) for name in inside), strict=True))
    keys = keys or [()] * len(table.lines)
    _check_labels(table, labels, inside, keys)
    for key, members in gathered((key, k) for k, key in enumerate(keys)).items():
        labels_of_test = {**dict(zip(inside, key, strict=True)), **labels}
        ordered = {name: labels_of_test[name] for name in groups}
        words = ", ".join(f"{n} = {v}" for n, v in ordered.items())
        where = f"{table.source}: {words}" if words else table.source
        lines = tuple(table.lines[k] for k in members)
        far, hard = (read[quantity][members] for quantity in held)
        when = None if time is None else time[members]
        if spec.columns.is_biaxial:
            second = (read[SECOND[quantity]][members] for quantity in held)
            far, hard = map(np.concatenate, zip((far, hard), second, strict=True))
            row = np.arange(far.size, dtype=float)
            yield Recording(where, ordered, far, hard, row, lines * 2, held, 2)
            continue
        if when is None:
            _check_one_test(table, members, far, where, groups, spec.columns)
        else:
            _check_time(table, members, when, where)
        yield Recording(where, ordered, far, hard, when, lines, held)


def _check_time(table: CsvTable, members: Sequence[int], time: Array, where: str) -> None:
    """Refuse times that do not increase: several tests in one, or rows out of order."""
    back = np.flatnonzero(np.diff(time) <= 0)
    if back.size:
        line = table.lines[members[int(back[0]) + 1]]
        rule = f"time does not increase from row to row ({where})"
        mend = (
            "name the column that tells the tests apart in `average` or `block`, or keep one "
            "of the rows of equal time"
        )
        raise InputError(Fault(f"{table.source}:{line}", rule, mend))


def _check_labels(
    table: CsvTable,
    labels: Mapping[str, str],
    names: Sequence[str],
    keys: Sequence[tuple[str, ...]],
) -> None:
    """Refuse labels that cannot be one, and those of a file's name that are also a column."""
    for name, label in labels.items():
        if rule := label_fault(label):
            raise InputError(Fault(f"{table.source}: name of the file", f"{name}: {rule}"))
        if name in table.columns:
            rule = f"{name!r} is both a column and part of the file's name"
            mend = "rename one of them in the pattern of `files`"
            raise InputError(Fault(table.source, rule, mend))
    for key in dict.fromkeys(keys):
        for name, label in zip(names, key, strict=True):
            if rule := label_fault(label):
                where = f"{table.source}:{table.lines[keys.index(key)]}: column {name!r}"
                mend = "every row needs the label of its test, in plain characters"
                raise InputError(Fault(where, rule, mend))


def _check_one_test(
    table: CsvTable,
    members: Sequence[int],
    travel: Array,
    where: str,
    groups: Sequence[str],
    columns: Columns,
) -> None:
    """Refuse rows in which the travel starts again: they are several tests, not one."""
    jumps = np.flatnonzero(np.abs(np.diff(travel)) > 0.5 * np.ptp(travel))
    back = [int(j) for j in jumps if abs(travel[j + 1]) < abs(travel[j])]
    # a single row, or rows that also jump ahead, are out of order
    lengths = np.diff([-1, *back, travel.size - 1])
    is_mixed = 2 * (len(jumps) - len(back)) >= len(back) and lengths.mean() > _FEW_ROWS
    is_single = len(back) == 1 and lengths.min() == 1
    if not back or travel.size < 5 or is_mixed or is_single:
        return
    k, after = members[back[0]], members[back[0] + 1]
    used = {*groups, *(columns.column(quantity) for quantity in _recorded(columns))}
    changing = [n for n, c in table.columns.items() if n not in used and c[k] != c[after]]
    steady = [n for n in changing if len({table.columns[n][m] for m in members}) <= len(back) + 1]
    hint = f"; column {steady[0]!r} changes there" if steady else ""
    rule = f"the displacement starts again: several tests in one ({where}){hint}"
    mend = (
        "name the column that tells them apart in `average` (repeats on one specimen) or "
        "in `block`, `fit` and `score`"
    )
    raise InputError(Fault(f"{table.source}:{table.lines[after]}", rule, mend))


def _quantity(table: CsvTable, spec: MeasurementSpec, what: str, limit: float) -> Array:
    """Column in mm, N or MPa, or plain, refused where it is beyond any test."""
    factor, column = _factor(table, spec, what), spec.columns.column(what)
    values = table.numbers(column)
    beyond = np.flatnonzero(np.abs(values) > limit / factor)
    if beyond.size:
        k = int(beyond[0])
        rule = f"{values[k]:.6g} {spec.units.unit(what)} is beyond any test of a specimen"
        where = f"{table.source}:{table.lines[k]}: column {column!r}"
        raise InputError(Fault(where, rule, "check the cell and measurements.units"))
    return values * factor


def _factor(table: CsvTable, spec: MeasurementSpec, what: str) -> float:
    """Factor from the declared unit of a column to mm, N or MPa."""
    column = spec.columns.column(what)
    first = next((quantity for quantity, second in SECOND.items() if second == what), what)
    dimension = DIMENSIONS[what]
    _, named, is_marked = word_of_unit(column)
    row, above = table.units.get(column, ""), table.units_above.get(dimension, "")
    in_file = written_unit(row) or written_unit(above)
    of_file = in_file[0] if in_file else None
    unit: str | None = getattr(spec.units, what) or of_file or getattr(spec.units, first)
    if unit is None:
        mend = f'write units = {{ {what} = "..." }}'
        raise InputError(Fault(f"{table.source}: column {column!r}", "has no unit", mend))
    places = (
        ("its name", named, is_marked),
        ("the row of units", row, True),
        ("a line above the names", above, False),
    )
    # the first place counts that shows a unit; what is declared wins where a row of units is, too
    who, word, is_sure = next((read for read in places if shows_unit(read[1])), ("", "", False))
    if not spec.unit_row and contradicts(word, unit, dimension, is_sure=is_sure):
        rule = f"{who} says {word}, but {unit} is declared in measurements.units"
        mend = "declare the unit that the file is in"
        raise InputError(Fault(f"{table.source}: column {column!r}", rule, mend))
    return parse(f"1 {unit}", dimension)


def capped(faults: Sequence[Fault]) -> list[Fault]:
    """Shorten a long list of faults, and say by how many."""
    if len(faults) <= MAX_FAULTS:
        return list(faults)
    more = Fault("measurements", f"{len(faults) - MAX_FAULTS} more faults like these")
    return [*faults[:MAX_FAULTS], more]
