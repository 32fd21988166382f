"""Read measured force-displacement tests: find, parse, check and condition them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study.ground.arrays import Array
from study.ground.declaration import Faults
from study.ground.errors import Fault, InputError
from study.mechanics.measurement.conditioning import (
    MIN_ROWS,
    OFFSET,
    PERCENT,
    SIZE_ABOVE,
    Rules,
    condition,
    condition_course,
    placed,
)
from study.mechanics.measurement.measured_test import Measurements, SingleTest
from study.mechanics.measurement.phases import RowCount
from study.mechanics.measurement.recording import (
    Gauge,
    Recording,
    Recordings,
    capped,
    displacement_and_force,
    read_recordings,
)

if TYPE_CHECKING:
    from study.mechanics.measurement.measurement_section import MeasurementSpec


#: stretch from which a strain may be one in per cent
_UNUSUAL = 8.0
#: notes on single tests that are shown
_MOST_NOTES = 6


def read_measurements(
    spec: MeasurementSpec,
    root: Path,
    height_mm: float | None = None,
    displacement_mm: float | None = None,
    gauge: Gauge | None = None,
    recordings: Recordings | None = None,
    *,
    own_rows: bool = False,
    zero_within_mm: float | None = None,
) -> Measurements:
    """Read, check and condition all tests that a specification names.

    With ``own_rows``, raw rows of each test may lie at other displacements; within
    ``zero_within_mm`` of the recorded zero it is fitted where displacement counts from.
    """
    both_ways = gauge is not None and gauge.is_homogeneous
    rules = rules_of(spec, height_mm, displacement_mm, both_ways=both_ways)
    rules = usual = replace(
        rules,
        # closed forms of indentation find contact themselves, and come another way
        judges_slack=gauge is not None and zero_within_mm is None,
        onset_power=1.0 if gauge is None else gauge.onset_power,
        zero_within_mm=zero_within_mm or 0.0,
        is_signed=both_ways and (spec.range is None or rules.low_mm < 0),
    )
    recorded = recordings or read_recordings(spec, Path(root))
    test_notes: list[str] = []
    if spec.range is None and not rules.is_raw:
        rules = _begun(rules, recorded, gauge)
    tests: list[SingleTest] = []
    faults = Faults()
    for recording in recorded.tests:
        with faults.gathered():
            test, did = specimens(recording, rules, gauge)
            test_notes += did
            tests.append(test)
    mend = "give each its own name in braces in `files`, or name what differs"
    faults.extend(
        Fault("measurements", f"{n} files hold the same test: {dict(key)}", mend)
        for key, n in Counter(tuple(test.groups.items()) for test in tests).items()
        if n > 1
    )
    if faults:
        raise InputError(capped(faults))
    sizes = _sizes_apart(recorded, gauge)
    notes = [*recorded.notes, *sizes, *first_notes(test_notes), *_summary(tests, rules)]
    if rules != usual:
        notes.append(f"the range begins at {rules.low_mm:.4g} mm, where the last test begins")
    own_rows = own_rows and rules.is_raw
    # of rows of their own, no grid is common
    displacement, time = _common_grid(tests[:1] if own_rows else tests, rules)
    measurements = Measurements(
        tuple(tests), displacement, spec, tuple(notes), recorded.files, time, own_rows
    )
    # a block without its fit or score tests is refused now, not in the middle of a run
    sides = [where for where in (spec.fit, spec.score) if where is not None]
    for block, where in product(measurements.blocks or (None,), sides):
        with faults.gathered():
            measurements.curve(block, **where)
    if faults:
        raise InputError(capped(faults))
    return measurements


#: relative difference of a size from which the file speaks of another specimen than the design
_OTHER_SIZE = 0.02


def _sizes_apart(recorded: Recordings, gauge: Gauge | None) -> list[str]:
    """Say where lines above the rows give the specimen another area or length than the design."""
    if gauge is None or gauge.mode != "uniaxial":
        return []
    notes = []
    for file, sizes in recorded.sizes.items():
        across = sizes.get("diameter", 2 * sizes.get("radius", math.nan))
        rectangle = sizes.get("width", math.nan) * sizes.get("thickness", math.nan)
        # of a pressed block the thickness may be its height, and a length one of its sides
        area, length = sizes.get("area", math.nan), math.nan
        if gauge.sense > 0:
            area, length = sizes.get("area", rectangle), sizes.get("length", math.nan)
        written = (
            ("area", "mm^2", area, gauge.area_mm2),
            ("area", "mm^2", math.pi / 4 * across**2, gauge.area_mm2),
            ("height", "mm", sizes.get("height", math.nan), gauge.length_mm),
            ("length", "mm", length, gauge.length_mm),
        )
        notes += [
            f"{file}: {SIZE_ABOVE} {name} {in_file:.4g} {unit}, [specimen] has {declared:.4g} "
            f"{unit}: constants are in proportion to the one that is meant"
            for name, unit, in_file, declared in written
            if abs(in_file / declared - 1) > _OTHER_SIZE
        ]
    return notes


def first_notes(notes: Sequence[str]) -> list[str]:
    """Shorten notes of many tests, and say by how many."""
    more = len(notes) - _MOST_NOTES
    return [*notes[:_MOST_NOTES], *([f"{more} more notes like these"] if more > 0 else [])]


def specimens(
    recording: Recording, rules: Rules, gauge: Gauge | None = None
) -> tuple[SingleTest, list[str]]:
    """Make the test of a specimen from a recording; say where its zero and branch were taken."""
    kinematic, branch = rules.spec.columns.kinematic, rules.spec.branch
    if gauge is not None and gauge.mode == "simple-shear" and recording.time_s is None:
        recording = _folded(recording)
    moved, notes, contact_error = _in_place(recording, rules)
    d, f = displacement_and_force(moved, gauge)
    is_course = recording.time_s is not None
    kind, conditioned = ("course", condition_course) if is_course else ("curve", condition)
    if d.size < MIN_ROWS:
        rule = f"has {d.size} rows, a {kind} needs at least {MIN_ROWS}"
        raise InputError(Fault(recording.where, rule))
    test = conditioned(d, f, rules, recording)
    test = replace(test, contact_error_mm=max(contact_error, test.contact_error_mm))
    longest = 1.0
    if gauge is not None and gauge.mode != "simple-shear":
        longest = 1 + float((gauge.sense * d).max()) / gauge.length_mm
    if "strain" in kinematic and longest > _UNUSUAL:
        notes.append(
            f"{recording.where}: a stretch of {longest:.4g} is unusual: {kinematic}, "
            f'{PERCENT} Then write units = {{ {kinematic} = "%" }}'
        )
    specimen = test.specimen
    chosen = [p for p in specimen.phases if specimen.fate[p.rows].min() == 0]
    if not is_course and (branch != "auto" or len(specimen.phases) > 1):
        lines = recording.lines
        words = " and ".join(
            f"{p.words} (lines {lines[p.first]} to {lines[p.last]})" for p in chosen[:3]
        )
        how = "" if branch == "auto" else f", branch = {branch}"
        notes.append(f"{recording.where}: {words}{how}")
    return test, notes


def _folded(recording: Recording) -> Recording:
    """Rows of a shear to both sides in the order of its amount, in which they are one test."""
    if (recording.kinematic >= 0).all():
        return recording
    order = np.argsort(np.abs(recording.kinematic), kind="stable")
    lines = tuple(recording.lines[k] for k in order)
    far, hard = recording.kinematic[order], recording.kinetic[order]
    return replace(recording, kinematic=far, kinetic=hard, lines=lines)


def _in_place(recording: Recording, rules: Rules) -> tuple[Recording, list[str], float]:
    """Put a recording into the coordinate of the specimen; what was done, error of its contact."""
    spec = rules.spec
    if spec.columns.kinematic != "displacement":
        if spec.displacement_zero is not None or spec.direction != "auto":
            rule = f"belongs to a column of displacement, not of {spec.columns.kinematic}"
            raise InputError(Fault("measurements.displacement_zero", rule, "leave it out"))
        return recording, [], 0.0
    moved, did, error = placed(recording.kinematic, recording.kinetic, rules, recording.where)
    return replace(recording, kinematic=moved), [did] if did else [], error


def _begun(rules: Rules, recorded: Recordings, gauge: Gauge | None) -> Rules:
    """Begin a range that nobody asked for where the last of the tests begins.

    The unloaded origin bridges one step of the grid, no more.
    """
    begins = [rules.low_mm]
    for recording in recorded.tests:
        with suppress(InputError):  # said where its rows become a curve
            moved = displacement_and_force(_in_place(recording, rules)[0], gauge)[0]
            begins.append(float(np.abs(moved).min()))
    spacing = (rules.high_mm - rules.low_mm) / max(int(rules.spec.points) - 1, 1)
    late = max(begins) > rules.low_mm + spacing and rules.spec.toe is None
    return replace(rules, low_mm=max(begins)) if late and max(begins) < rules.high_mm else rules


def _common_grid(done: Sequence[SingleTest], rules: Rules) -> tuple[Array, Array | None]:
    """Displacements and times of all tests: rows as measured must be the same ones in each."""
    if not rules.is_raw:
        return rules.grid(), None
    first = done[0].recorded
    for test in done[1:]:
        rows = test.recorded
        same = rows.displacement_mm.shape == first.displacement_mm.shape
        if not same or not np.allclose(rows.places, first.places):
            what = "displacements" if first.time_s is None else "times"
            rule = f"raw rows lie at other {what} in every test of these measurements"
            mend = "write a number of points, or a [[tests]] table for each test"
            raise InputError(Fault("measurements.points", rule, mend))
        same_mm = 1e-6 * float(np.abs(first.displacement_mm).max())
        if not np.allclose(rows.displacement_mm, first.displacement_mm, atol=same_mm):
            rule = "the displacements at these times are others in every test of a block"
            mend = "write a [[tests]] table for each test: every course has an answer of its own"
            raise InputError(Fault("measurements.average", rule, mend))
    return done[0].displacement_mm, first.time_s


def rules_of(
    spec: MeasurementSpec,
    height_mm: float | None,
    displacement_mm: float | None,
    *,
    both_ways: bool = False,
) -> Rules:
    """How rows become the curve of a specimen, as a table says.

    A range may begin below 0 where the specimen deforms the same everywhere (``both_ways``).
    """
    if spec.range is not None:
        low, high = spec.range.in_mm(height_mm)
    elif spec.points == "raw":
        low, high = 0.0, np.inf if displacement_mm is None else displacement_mm
    elif displacement_mm is not None:
        low, high = displacement_mm / max(spec.points, 2), displacement_mm
    else:
        rule = "is missing, and no test.displacement stands for it"
        mend = 'for example range = ["1 %", "20 %"]'
        raise InputError(Fault("measurements.range", rule, mend))
    if not low < high or (low < 0 and not both_ways):
        rule = f"must rise from 0 or more, got {low:.4g} to {high:.4g} mm"
        mend = "rows below 0 belong to a specimen that deforms the same everywhere"
        raise InputError(Fault("measurements.range", rule, mend))
    return Rules(spec, low, high, height_mm)


def _summary(done: Sequence[SingleTest], rules: Rules) -> list[str]:
    """Report what the rules did over all tests, counted."""
    total = sum((result.counts for result in done), Counter[str]())
    tests = Counter(what for result in done for what in result.counts)
    notes = [f"{total[w]} {w} (in {tests[w]} of {len(done)} tests)" for w in total]
    if rules.spec.zero != "none":
        zero = [result.zero_N for result in done]
        notes.append(
            f"load cell zero ({rules.spec.zero}) subtracted: {min(zero):.4g} to {max(zero):.4g} N"
        )
    offsets = [result.offset for result in done if result.offset is not None]
    if offsets:
        worst = max(offsets, key=abs)
        notes.append(
            f"{OFFSET} {len(offsets)} of {len(done)} tests begin with up to {100 * worst:.2g} % of "
            'their largest force: write zero = "first" or "fit" to subtract it, or toe; where the '
            "specimen was preloaded before displacement was set to 0, displacement_zero with the "
            'way that it had gone, such as "-0.5 mm"'
        )
    if rules.spec.toe is not None:
        toe = [result.toe_mm for result in done]
        notes.append(
            f"contact at {rules.spec.toe:.4g} N: displacement shifted by {min(toe):.4g} to "
            f"{max(toe):.4g} mm"
        )
    notes.append(RowCount.sum_of(result.specimen.count for result in done).sentence)
    rows = sorted({result.rows for result in done})
    several = f"{rows[0]} to {rows[-1]}" if len(rows) > 1 else str(rows[0])
    within = f" in the range {rules.low_mm:.4g} to {rules.high_mm:.4g} mm"
    within = "" if np.isinf(rules.high_mm) else within
    how = "as they were measured" if rules.is_raw else f"resampled at {rules.spec.points} points"
    tests_of = "test of" if len(done) == 1 else "tests of"
    return [*notes, f"{len(done)} {tests_of} {several} rows{within}, {how}"]
