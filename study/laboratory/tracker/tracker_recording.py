"""What a tracker wrote, positions of its markers over time; virtual recordings of one."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Annotated, TypeVar

import numpy as np

from study.ground import declaration
from study.ground.arrays import Array, Ints
from study.ground.declaration import (
    Bad,
    Faults,
    Length,
    LengthOrZero,
    Reads,
    Schema,
    choice,
    number,
    read_table,
    section,
    shown,
    text,
    unit_of_length,
)
from study.ground.declaration import name as label
from study.ground.errors import Fault, InputError, nearest
from study.ground.files import write_atomic
from study.ground.tabular import MISSING, CsvTable, csv_text, read_csv
from study.ground.units import unit_factor
from study.laboratory.registration.rigid import check_places
from study.mechanics.measurement.measurement_section import Axes, csv_path, three_columns
from study.mechanics.measurement.written_units import contradicts, word_of_unit

# The file of a tracker study: its tables are classes, and a class's fields are the keys.


def markers_of(value: object) -> dict[str, Axes]:
    """Read markers: a name and three columns each."""
    if not isinstance(value, Mapping) or not value:
        raise Bad(f"must be a table, got {shown(value)}", 'for example { tip = ["x", "y", "z"] }')
    return {label(key): three_columns(columns) for key, columns in value.items()}


T = TypeVar("T")


def two(what: str, read: Callable[[object], T], mend: str) -> Callable[[object], tuple[T, T]]:
    """Make the reader of two different things of one kind."""

    def read_two(value: object) -> tuple[T, T]:
        if not isinstance(value, list) or len(value) != 2 or value[0] == value[1]:
            raise Bad(f"must be {what}, got {shown(value)}", mend)
        return read(value[0]), read(value[1])

    return read_two


_MARKERS = two("two markers", label, 'for example ["tip", "tail"]')
_FILES = two("two files", csv_path, 'for example ["a.csv", "b.csv"]')
_POINTS = two("the columns of two points", three_columns, 'for example [["x1", "y1", "z1"], ...]')


@section
class RecordingTable:
    """``[recording]``: what the tracker wrote, one row a sample."""

    file: Annotated[str, Reads(csv_path, mend='for example file = "samples.csv"')]
    #: Columns of the coordinates of every marker.
    markers: Annotated[
        dict[str, Axes], Reads(markers_of, mend='for example markers = { tip = ["x", "y", "z"] }')
    ]
    unit: Annotated[str, Reads(unit_of_length, mend='for example unit = "mm"')]
    #: Column of the time stamps, in s.
    time: Annotated[str | None, Reads(label)] = None
    #: Column that says in which stage of the motion, or at which pose, a sample was taken.
    stage: Annotated[str | None, Reads(label)] = None
    decimal: Annotated[str, Reads(choice(".", ","))] = "."


@section
class DistanceTable:
    """``[distance]``: two markers on one rigid body, and how far apart they are known to be."""

    markers: Annotated[tuple[str, str], Reads(_MARKERS, mend='for example ["tip", "tail"]')]
    #: Known distance, mm.
    reference: Length | None = None
    #: Standard uncertainty of the known distance, mm.
    uncertainty: LengthOrZero = 0.0
    #: Instead: CSV files of points scanned on the spheres of both markers.
    spheres: Annotated[tuple[str, str] | None, Reads(_FILES)] = None
    columns: Annotated[Axes, Reads(three_columns)] = ("x", "y", "z")
    unit: Annotated[str, Reads(unit_of_length)] = "mm"
    #: Smallest difference of distances that matters, mm.
    practical: Length | None = None


@section
class DisplacementTable:
    """``[displacement]``: a marker on a stage that was told where to go."""

    marker: Annotated[str, Reads(label, mend="name a marker of [recording]")]
    #: Column of the commanded position along the axis.
    commanded: Annotated[str, Reads(label, mend="name the column of the commanded position")]
    unit: Annotated[str, Reads(unit_of_length)] = "mm"
    #: Standard uncertainty of a commanded position, mm; 0 for an exact stage.
    uncertainty: LengthOrZero = 0.0


@section
class ReferenceTable:
    """``[reference]``: a better instrument that measured the same poses in its own frame."""

    #: CSV with one row a pose.
    file: Annotated[str, Reads(csv_path, mend='for example file = "laser.csv"')]
    marker: Annotated[str, Reads(label, mend="name a marker of [recording]")]
    #: Column of the pose; its labels pair with those of the recording.
    stage: Annotated[str, Reads(label, mend="name the column of the pose")]
    #: Columns of the reference's point on the body.
    position: Annotated[Axes, Reads(three_columns, mend='for example position = ["x", "y", "z"]')]
    #: Columns of two more points on the body, beside the first one: they show how it is turned, so
    #: that the lever arm between marker and reference point can be estimated.
    axes: Annotated[tuple[Axes, Axes] | None, Reads(_POINTS)] = None
    unit: Annotated[str, Reads(unit_of_length)] = "mm"


@section
class TrackingTable:
    """``[tracking]``: what the study is called."""

    #: Of the report; that of the file where it is left out.
    name: Annotated[str, Reads(label)] = ""
    #: Printed above the answer.
    question: Annotated[str, Reads(text)] = ""
    #: Size of tests; intervals have the level 1 - alpha.
    alpha: Annotated[float, Reads(number(0, 0.5))] = 0.05


@section
class TrackingFile:
    """A file of ``study tracking``: at least one of the last three is there."""

    schema: Schema
    recording: RecordingTable
    tracking: TrackingTable = TrackingTable()
    distance: DistanceTable | None = None
    displacement: DisplacementTable | None = None
    reference: ReferenceTable | None = None


def load_tracking(path: str | Path) -> TrackingFile:
    """Read a file of ``study tracking``."""
    source = str(path)
    needed = "a tracker study (TOML, which names the table in [recording])"
    tables = declaration.parse_toml(declaration.read_text(path, needed), source)
    faults = Faults()
    file = read_table(TrackingFile, tables, "", faults)
    if not faults:
        faults.extend(_across(file))
    faults.refuse(source)
    return file


def is_tracking(path: str | Path) -> bool:
    """Whether a file is one of ``study tracking``: it has a table ``[recording]``."""
    return "recording" in declaration.parse_toml(declaration.read_text(path), str(path))


def _across(tracking_file: TrackingFile) -> Sequence[Fault]:
    """Faults between tables."""
    faults = Faults()
    distance, moved = tracking_file.distance, tracking_file.displacement
    reference, there = tracking_file.reference, tracking_file.recording.markers
    needed = {
        "distance.markers": distance.markers if distance else (),
        "displacement.marker": (moved.marker,) if moved else (),
        "reference.marker": (reference.marker,) if reference else (),
    }
    for where, markers in needed.items():
        for marker in markers:
            if marker not in there:
                faults.add(where, f"no marker {marker!r} in [recording]", nearest(marker, there))
    if not (distance or moved or reference):
        mend = "write [distance], [displacement] or [reference]"
        faults.add("tracking", "nothing says what to compare the tracker with", mend)
    if reference and tracking_file.recording.stage is None:
        mend = 'write stage = "COLUMN" in [recording]'
        faults.add("recording.stage", "is missing: poses pair by it", mend)
    if distance and distance.reference and distance.spheres:
        faults.add("distance", "has a reference and spheres", "keep the one that is the standard")
    return faults


#: Name of the only stage of a recording without a column of stages.
WHOLE = "all"
#: Way of two markers to each other's place over that to their own, from which they are exchanged.
_EXCHANGED = 0.2
#: Rows that repeat a place to the last digit from which that is said.
_REPEATED = 5
#: Samples that a visit needs for its scatter and correlation.
FEWEST_SAMPLES = 4


@dataclass(frozen=True)
class Visit:
    """Samples in a row at one stage: they go together, and only their mean is independent."""

    stage: str
    #: First sample, and the one after the last.
    begin: int
    end: int

    @property
    def rows(self) -> slice:
        """Samples of the visit."""
        return slice(self.begin, self.end)


@dataclass(frozen=True)
class TrackerRecording:
    """Positions of markers, sample by sample."""

    #: shape (n, 3); of every marker, mm.
    positions: dict[str, Array]
    #: shape (n,); time stamps.
    time_s: Array | None
    #: In the order of the recording.
    visits: tuple[Visit, ...]
    table: CsvTable

    @property
    def stages(self) -> tuple[str, ...]:
        """Stages in the order of their first visit."""
        return tuple(dict.fromkeys(visit.stage for visit in self.visits))

    def visits_of(self, stage: str) -> tuple[Visit, ...]:
        """Return the visits to a stage."""
        return tuple(visit for visit in self.visits if visit.stage == stage)


def read_recording(declared: RecordingTable, root: Path) -> TrackerRecording:
    """Read what a tracker wrote."""
    columns = [c for axes in declared.markers.values() for c in axes]
    for column in columns:
        check_unit(column, declared.unit, "length", "recording.unit")
    if declared.time:
        check_unit(declared.time, "s", "time", "recording.time")
    columns += [c for c in (declared.time, declared.stage) if c]
    table = read_csv(
        root / declared.file, required=columns, decimal=declared.decimal, source=declared.file
    )
    labels = table.text(declared.stage) if declared.stage else (WHOLE,) * len(table.lines)
    table, visits = _seen(table, visits_to(labels), declared.markers)
    factor = unit_factor(declared.unit, "length")
    positions = {m: factor * coordinates(table, at) for m, at in declared.markers.items()}
    for marker, points in positions.items():
        check_places(points, f"{declared.file}: marker {marker}")
        _check_lost(points, f"{declared.file}: marker {marker}")
    _check_exchanged(positions, table)
    time = None if declared.time is None else table.numbers(declared.time)
    if time is not None:
        back = np.flatnonzero(np.diff(time) <= 0)
        if back.size:
            first = int(back[0]) + 1
            word = "goes backwards" if time[first] < time[first - 1] else "stands still"
            more = f" (and at {back.size - 1} more rows)" if back.size > 1 else ""
            rule = f"the time {word}: {time[first]:g} s after {time[first - 1]:g} s{more}"
            mend = "sort the rows by time; was the clock set, or were two recordings joined?"
            raise InputError(Fault(f"{table.source}:{table.lines[first]}", rule, mend))
    notes = [note for marker, points in positions.items() if (note := _repeats(marker, points))]
    table = replace(table, notes=(*table.notes, *notes))
    return TrackerRecording(positions, time, visits, table)


def _seen(
    table: CsvTable, visits: Sequence[Visit], markers: Mapping[str, Axes]
) -> tuple[CsvTable, tuple[Visit, ...]]:
    """Rows in which every marker has a place, and the visits among them; the others are counted."""
    notes, lost = list[str](), np.zeros(len(table.lines), dtype=bool)
    for marker, columns in markers.items():
        cells = np.array([[cell.lower() in MISSING for cell in table.text(c)] for c in columns])
        count = int(cells.any(axis=0).sum())
        lost |= cells.any(axis=0)
        if count:
            rows = f"{count} of {lost.size} rows have no place of it and are left out"
            notes.append(f"marker {marker}: {rows}")
    if lost.all():
        rule, mend = "no row has a place of every marker", "name the columns that hold places"
        raise InputError(Fault(f"{table.source}: recording.markers", rule, mend))
    before = np.concatenate([[0], np.cumsum(~lost)]).tolist()
    seen = [replace(v, begin=before[v.begin], end=before[v.end]) for v in visits]
    with_rows = tuple(visit for visit in seen if visit.end > visit.begin)
    if len(with_rows) < len(seen):
        notes.append(f"{len(seen) - len(with_rows)} of {len(seen)} visits have no row left")
    table = table.rows(np.flatnonzero(~lost).tolist()) if lost.any() else table
    return replace(table, notes=(*table.notes, *notes)), with_rows


def check_unit(column: str, declared: str, dimension: str, where: str) -> None:
    """Refuse a column whose name says another unit than it is read in."""
    _, word, is_marked = word_of_unit(column)
    is_unit = is_marked or len(word) > 1  # "x_m" may be the x of a marker m
    if is_unit and contradicts(word, declared, dimension, is_sure=is_marked):
        rule = f"the name of the column {column!r} says {word}, and it is read in {declared}"
        mend = "write its numbers in s" if dimension == "time" else f'write unit = "{word}"'
        raise InputError(Fault(where, rule, f"{mend}, or rename the column"))


def _check_lost(points: Array, where: str) -> None:
    """Refuse rows that all hold one place far from the others: what is written for a lost marker.

    Shapes: points (n, 3), mm.
    """
    places, counts = np.unique(points, axis=0, return_counts=True)
    for point in (np.zeros(3), places[int(np.argmax(counts))]):
        is_there = (points == point).all(axis=1)
        others = points[~is_there]
        is_written = is_there.sum() > 1 or (is_there.any() and not point.any())
        if not is_written or len(others) < 2:
            continue
        extent = float(np.linalg.norm(np.ptp(others, axis=0)))
        if extent > 0 and np.linalg.norm(others - point, axis=1).min() > extent:
            listed = ", ".join(f"{v:g}" for v in point)
            rule = (
                f"{int(is_there.sum())} of {len(points)} rows stand at {listed} mm, far from all "
            )
            mend = "delete these rows"
            raise InputError(Fault(where, f"{rule}others: the tracker had lost the marker", mend))


def _check_exchanged(positions: Mapping[str, Array], table: CsvTable) -> None:
    """Refuse markers that each go to where the other one was, from one row to the next."""
    for (first, a), (second, b) in combinations(positions.items(), 2):
        alone = sum(np.linalg.norm(np.diff(places, axis=0), axis=1) for places in (a, b))
        crossed = np.linalg.norm(a[1:] - b[:-1], axis=1) + np.linalg.norm(b[1:] - a[:-1], axis=1)
        rows = np.flatnonzero(crossed < _EXCHANGED * alone) + 1
        if rows.size:
            rule = f"the markers {first} and {second} change places, at {rows.size} rows in all"
            mend = "exchange their columns in the rows between, or delete these"
            raise InputError(Fault(f"{table.source}:{table.lines[int(rows[0])]}", rule, mend))


def _repeats(marker: str, points: Array) -> str:
    """Say that a place repeats to the last digit where other rows scatter; else nothing."""
    repeated = int(np.count_nonzero((points[1:] == points[:-1]).all(axis=1)))
    if not _REPEATED <= repeated < len(points) / 2:
        return ""
    return (
        f"marker {marker}: {repeated} of {len(points)} rows repeat the place of the row before to "
        "the last digit: the tracker had lost it there, or measures less often than it writes"
    )


def coordinates(table: CsvTable, columns: Axes) -> Array:
    """Coordinates in three columns of a table. Shapes: returns (n, 3)."""
    return np.column_stack([table.numbers(column) for column in columns])


def visits_to(labels: Sequence[str]) -> tuple[Visit, ...]:
    """Find runs of equal labels.

    Examples
    --------
    >>> [(v.stage, v.begin, v.end) for v in visits_to(["a", "a", "b", "a"])]
    [('a', 0, 2), ('b', 2, 3), ('a', 3, 4)]
    """
    marks = np.array(labels, dtype=object)
    ends = [*(np.flatnonzero(marks[1:] != marks[:-1]) + 1).tolist(), len(labels)]
    begins = [0, *ends[:-1]]
    return tuple(Visit(labels[a], a, b) for a, b in zip(begins, ends, strict=True))


def passes(visits: Sequence[Visit]) -> Ints | None:
    """Pass of the motion that every visit belongs to.

    A pass visits every stage once. Comparing stages within passes takes a drift out.

    Shapes: returns (visits,).
    """
    stages = list(dict.fromkeys(visit.stage for visit in visits))
    count, left = divmod(len(visits), len(stages))
    if left or count < 2 or len(stages) < 2:
        return None
    for k in range(count):
        part = visits[k * len(stages) : (k + 1) * len(stages)]
        if {visit.stage for visit in part} != set(stages):
            return None
    return np.arange(len(visits)) // len(stages)


def correlation_time(series: Array) -> float:
    """Count the samples that go for one independent one: the autocorrelation time, at least 1.

    Sokal 1997: the sum 1 + 2 sum rho_k is cut at the first lag beyond five times itself, so
    that the noise of far lags does not add up. The mean of n samples then has the variance of
    n over this many independent ones.

    Shapes: series (n,).
    """
    n = len(series)
    away = series - series.mean()
    variance = float(away @ away) / n
    if variance == 0 or n < FEWEST_SAMPLES:
        return 1.0
    spectrum = np.abs(np.fft.rfft(away, 2 * n)) ** 2
    rho = np.fft.irfft(spectrum)[:n] / n / variance
    total = 1 + 2 * np.cumsum(rho[1:])
    beyond = np.arange(1, n) >= 5 * total
    where = int(beyond.argmax()) if beyond.any() else n - 2
    return float(min(max(total[where], 1.0), n))


# Virtual recordings of a tracker whose errors are known, for trying a file of ``study tracking``.
#
# The generator, in full. Two markers on a needle, as far apart as their standard says (80 mm
# where spheres tell it), ride on a stage that goes from home by stops of 10 mm to 50 mm, holds,
# goes back by the same stops, and is home again: four stages of the motion, six times over. Each
# stop errs along the axis, each visit to a stage errs in the distance, each sample has noise that
# goes together with that of the sample before; the stage is followed with a scale, and the
# distance is wrong by a bias while the needle retracts. All errors are normal, and
# ``.virtual.json`` beside the recording tells their sizes.


#: stages of the motion with the stops of each, mm
STAGES = (
    ("home", (0.0,)),
    ("advance", (10.0, 20.0, 30.0, 40.0)),
    ("hold", (50.0,)),
    ("retract", (40.0, 30.0, 20.0, 10.0)),
)
#: stage in which the distance is wrong
BIASED = "retract"
#: distance of the markers where no number says it, mm
_APART_MM = 80.0
#: radius of scanned spheres, mm
_RADIUS_MM = 6.0
_SCANNED = 400
#: their noise, mm
_SCAN_SD_MM = 0.02
#: part of a sphere's height that the scanner sees
_SEEN = 0.4
#: direction of the needle and place of its tip at home, mm
_AXIS = np.array([2.0, -1.0, 2.0]) / 3
_HOME_MM = np.array([300.0, -20.0, 900.0])


@dataclass(frozen=True)
class Errors:
    """Errors that are put in."""

    seed: int = 2011
    #: How often the motion is made, and samples at each stop.
    passes: int = 6
    samples: int = 40
    interval_s: float = 0.05
    scale: float = 1.003
    #: Standard deviations: of a stop along the axis, of the distance in a visit to a stage, and of
    #: a coordinate in a sample.
    stop_sd_mm: float = 0.03
    visit_sd_mm: float = 0.02
    sample_sd_mm: float = 0.05
    #: Of the noise of a sample with that of the sample before.
    correlation: float = 0.8
    #: Of the distance while the needle retracts.
    bias_mm: float = 0.15


@dataclass(frozen=True)
class TrackerSample:
    """One row of a recording: time, stage, commanded position and places of markers, mm."""

    time_s: float
    stage: str
    commanded_mm: float
    places_mm: Array


def write_recording(declared: TrackingFile, out: Path, errors: Errors | None = None) -> list[Path]:
    """Write the recording, and the scans of spheres, that a tracking file reads."""
    if declared.reference is not None:
        mend = "leave [reference] out, and give [distance] or [displacement]"
        raise InputError(Fault("reference", "virtual recordings have no reference", mend))
    errors = errors or Errors()
    distance, recording = declared.distance, declared.recording
    apart = (distance.reference if distance else None) or _APART_MM
    samples = list(recorded(errors, len(recording.markers), apart))
    texts = {recording.file: _recording(declared, recording, samples)}
    texts[f"{recording.file}.virtual.json"] = json.dumps(
        {"errors": asdict(errors), "distance_mm": apart, "biased_stage": BIASED}, indent=2
    )
    if distance is not None and distance.spheres is not None:
        random = np.random.default_rng([errors.seed, 1])
        factor = unit_factor(distance.unit, "length")
        for file, along in zip(distance.spheres, (0.0, apart), strict=True):
            center = _HOME_MM + along * _AXIS
            z = 1 - 2 * _SEEN * random.random(_SCANNED)
            turn = 2 * np.pi * random.random(_SCANNED)
            flat = np.sqrt(1 - z**2)
            normals = np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])
            radii = _RADIUS_MM + _SCAN_SD_MM * random.standard_normal((_SCANNED, 1))
            cloud = np.asarray(center + radii * normals) / factor
            texts[file] = csv_text(distance.columns, [[f"{v:.6g}" for v in row] for row in cloud])
    for name, content in texts.items():
        write_atomic(out / name, content.encode())
    return [out / name for name in texts]


def recorded(errors: Errors, markers: int, apart_mm: float) -> Iterator[TrackerSample]:
    """Give samples in their order.

    Shapes: returns (markers, 3).

    Examples
    --------
    >>> rows = list(recorded(Errors(passes=2, samples=3), 2, 80.0))
    >>> len(rows), rows[0].stage, rows[-1].commanded_mm
    (60, 'home', 10.0)
    """
    random = np.random.default_rng(errors.seed)
    noise, time = np.zeros((markers, 3)), 0.0
    fresh = errors.sample_sd_mm * np.sqrt(1 - errors.correlation**2)
    for _ in range(errors.passes):
        for stage, stops in STAGES:
            wrong = errors.visit_sd_mm * random.standard_normal()
            wrong += errors.bias_mm if stage == BIASED else 0.0
            for commanded in stops:
                along = errors.scale * commanded + errors.stop_sd_mm * random.standard_normal()
                spots = along + np.arange(markers) * (apart_mm + wrong)
                for _ in range(errors.samples):
                    noise = errors.correlation * noise + fresh * random.standard_normal(noise.shape)
                    yield TrackerSample(
                        time, stage, commanded, _HOME_MM + spots[:, None] * _AXIS + noise
                    )
                    time += errors.interval_s


def _recording(
    declared: TrackingFile, recording: RecordingTable, samples: Sequence[TrackerSample]
) -> str:
    """CSV of the recording, with the columns that the file names."""
    moved, mark = declared.displacement, recording.decimal
    columns = [name for name in (recording.time, recording.stage) if name]
    columns += [moved.commanded] if moved else []
    columns += [column for triple in recording.markers.values() for column in triple]
    factor = unit_factor(recording.unit, "length")
    per_mm = unit_factor(moved.unit, "length") if moved else 1.0
    rows = []
    for sample in samples:
        row = [f"{sample.time_s:.3f}"] if recording.time else []
        row += [sample.stage] if recording.stage else []
        row += [f"{sample.commanded_mm / per_mm:g}"] if moved else []
        row += [f"{v / factor:.7g}" for v in sample.places_mm.ravel()]
        rows.append([v.replace(".", mark) for v in row])
    return csv_text(columns, rows, ";" if mark == "," else ",")
