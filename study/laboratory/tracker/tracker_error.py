"""A tracker against commanded displacements, a known distance and a better instrument.

A stop is one observation: the mean of its samples. The commanded position has an uncertainty
of its own, so the line is fitted with errors in both quantities.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study.ground.arrays import Array
from study.ground.canonical import Keyed
from study.ground.errors import Fault, InputError, settled
from study.ground.tabular import CsvTable, read_csv
from study.ground.units import times, unit_factor
from study.laboratory.registration.rigid import (
    FEWEST_POINTS,
    DemingLine,
    FittedSphere,
    MethodAgreement,
    PairedFit,
    RigidMotion,
    deming_line,
    fit_pairs,
    fit_sphere,
    limits_of_agreement,
    on_a_line,
    rotation_of,
    student_interval,
    target_registration_error,
)
from study.laboratory.tracker.tracker_recording import (
    DisplacementTable,
    DistanceTable,
    ReferenceTable,
    TrackerRecording,
    TrackingFile,
    Visit,
    check_unit,
    coordinates,
    correlation_time,
    passes,
    read_recording,
    visits_to,
)

if TYPE_CHECKING:
    import pandas as pd

#: A scale, or a distance over its standard, this far from 1 is another unit, not an error.
UNIT_RATIO = 5.0


@dataclass(frozen=True)
class DisplacementResult:
    """How a tracker follows a stage."""

    marker: str
    #: shape (n_stops,); displacements from home along the axis, home left out.
    commanded_mm: Array
    measured_mm: Array
    #: Regression of measured on commanded displacement: scale and offset (mm).
    line: DemingLine
    #: Distances of the stops from the straight line through them.
    straightness_rms_mm: float
    straightness_max_mm: float
    #: Measured less commanded displacement, mm.
    agreement: MethodAgreement
    #: Standard deviation of stops at the same position; None where none repeats.
    repeatability_mm: float | None
    #: Standard uncertainty of the home position, which every displacement shares: it is in the
    #: interval of the offset.
    home_uncertainty_mm: float
    #: shape (3,); direction of the motion in the tracker's frame.
    axis: Array
    stops: int


def analyze_displacement(
    declared: DisplacementTable, recording: TrackerRecording, alpha: float
) -> DisplacementResult:
    """Judge how a tracker follows a commanded displacement."""
    check_unit(declared.commanded, declared.unit, "length", "displacement.unit")
    commanded = unit_factor(declared.unit, "length") * recording.table.numbers(declared.commanded)
    labels = recording.table.text(declared.commanded)
    stops = [
        Visit(label.stage, visit.begin + label.begin, visit.begin + label.end)
        for visit in recording.visits
        for label in visits_to(labels[visit.rows])
    ]
    places = np.array([recording.positions[declared.marker][s.rows].mean(axis=0) for s in stops])
    commanded_mm = np.array([commanded[stop.begin] for stop in stops])
    axis, along, off = _straight(places, commanded_mm)
    # pooled standard deviation of stops at the same position
    groups = [along[commanded_mm == value] for value in np.unique(commanded_mm)]
    freedom = sum(len(group) - 1 for group in groups)
    squares = sum(((g - g.mean()) ** 2).sum() for g in groups)
    repeat = float(np.sqrt(squares / freedom)) if freedom else None
    at_home = commanded_mm == commanded_mm[0]
    measured = (along - along[at_home].mean())[~at_home]
    steps = (commanded_mm - commanded_mm[0])[~at_home]
    line = deming_line(steps, measured, _ratio(declared, repeat, steps, measured), alpha,
                       "displacement")  # fmt: skip
    if not 1 / UNIT_RATIO < line.scale < UNIT_RATIO:
        rule = f"measured is {times(line.scale, 4)} commanded displacement: another unit"
        mend = "compare [recording] unit and [displacement] unit"
        raise InputError(Fault("displacement.unit", rule, mend))
    spread = line.residual_sd if repeat is None else repeat
    home = float(spread / np.sqrt(at_home.sum()))
    total = float(np.hypot(line.offset_uncertainty, home))
    interval = student_interval(line.offset, total, line.points - 2, alpha)
    return DisplacementResult(
        marker=declared.marker,
        commanded_mm=steps,
        measured_mm=measured,
        line=replace(line, offset_uncertainty=total, offset_interval=interval),
        straightness_rms_mm=float(np.sqrt((off**2).mean())),
        straightness_max_mm=float(off.max()),
        agreement=limits_of_agreement(measured, steps, alpha, "displacement"),
        repeatability_mm=repeat,
        home_uncertainty_mm=home,
        axis=axis,
        stops=len(stops),
    )


def _straight(places: Array, commanded_mm: Array) -> tuple[Array, Array, Array]:
    """Axis of the straight line through stops, places along it, and distances from it, mm."""
    if (count := np.unique(commanded_mm).size) < 3:
        rule = f"there are {count} commanded positions, a line needs 3 or more"
        raise InputError(Fault("displacement.commanded", rule, "stop at more positions"))
    away = places - places.mean(axis=0)
    axis = np.linalg.svd(away, full_matrices=False)[2][0]
    along = away @ axis
    if along @ (commanded_mm - commanded_mm.mean()) < 0:
        axis, along = -axis, -along
    return axis, along, np.linalg.norm(away - np.outer(along, axis), axis=1)


def _ratio(
    declared: DisplacementTable, repeat: float | None, steps: Array, measured: Array
) -> float:
    """Variance of a measured over that of a commanded position; infinite for an exact stage."""
    if declared.uncertainty == 0:
        return float("inf")
    if repeat is None:
        # the scatter about a first line holds both errors, each a part of it
        total = deming_line(steps, measured, float("inf"), where="displacement").residual_sd ** 2
        variance = max(total - declared.uncertainty**2, 0.1 * total)
        return float(variance / declared.uncertainty**2)
    return max(repeat**2, 1e-12 * declared.uncertainty**2) / declared.uncertainty**2


# Distance between two markers on one rigid body: what changes in it is the tracker's error. A
# visit counts as one observation, for its samples share most of their errors.

#: Fewest visits, or blocks of samples, over which a drift is judged.
FEWEST_FOR_DRIFT = 6
#: Blocks into which a recording without visits is cut for its drift.
DRIFT_BLOCKS = 20


@dataclass(frozen=True)
class StageDistance:
    """Distance over one stage."""

    stage: str
    #: How often it was visited, and samples in all.
    visits: int
    samples: int
    #: Samples that are worth as many independent ones within visits (autocorrelation).
    independent: float
    #: Mean over the visits, and standard deviation of the samples within visits.
    mean_mm: float
    sd_mm: float
    #: Standard deviation between visits; None for a single visit.
    between_mm: float | None
    #: Of the mean, from the scatter between visits; None for a single visit, which cannot tell how
    #: well the next one would repeat it.
    interval_mm: tuple[float, float] | None
    lowest_mm: float
    highest_mm: float


@dataclass(frozen=True)
class Drift:
    """Change of the distance over time, stages apart."""

    #: Per hour, or per thousand samples where there is no time.
    slope: float
    #: Of the slope, at the level 1 - alpha.
    interval: tuple[float, float]
    #: Of the test that there is none.
    p: float
    unit: str
    #: Visits, or blocks of samples longer than their correlation, that are the observations.
    observations: int


@dataclass(frozen=True)
class Standard:
    """Known distance that the tracker should find."""

    distance_mm: float
    uncertainty_mm: float
    #: Spheres from whose centers it comes; empty where it was given.
    spheres: tuple[FittedSphere, ...] = ()


#: makes an analysis of variance, with the stage as factor, of a table of the means of visits
#: (``stage``, ``distance`` in mm, ``pass`` where there are passes), the smallest difference that
#: matters in mm, and alpha
Compare = Callable[["pd.DataFrame", float | None, float], Keyed]


@dataclass(frozen=True)
class DistanceResult(Keyed):
    """Distance of two markers, stage by stage, beside what it should be."""

    KEYS = (
        "markers stages comparison=comparison.to_json comparison_note drift standard bias_mm "
        "bias_interval_mm"
    )

    markers: tuple[str, str]
    #: shape (n,); distance in every sample.
    samples_mm: Array
    sample_stage: tuple[str, ...]
    #: In the order of the recording.
    stages: tuple[StageDistance, ...]
    #: Analysis of variance of the visit means; None where it cannot be made.
    comparison: Keyed | None
    #: Why there is none, or what the error term is.
    comparison_note: str
    #: None where there are too few visits or independent samples.
    drift: Drift | None
    standard: Standard | None
    #: Mean over the visits less the standard.
    bias_mm: float | None
    #: Scatter between visits (or stages visited once) and standard together.
    bias_interval_mm: tuple[float, float] | None


def analyze_distance(
    declared: DistanceTable,
    recording: TrackerRecording,
    root: Path,
    alpha: float,
    compare: Compare,
) -> DistanceResult:
    """Judge the distance between two markers."""
    first, second = (recording.positions[m] for m in declared.markers)
    samples = np.linalg.norm(first - second, axis=1)
    standard = _standard(declared, root)
    if standard is not None:
        seen = float(np.median(samples))
        if not 1 / UNIT_RATIO < seen / standard.distance_mm < UNIT_RATIO:
            rule = f"the markers are {seen:.4g} mm apart, the standard says "
            mend = 'is [recording] unit right? A factor near 1000 means "m" instead of "mm"'
            raise InputError(Fault("recording.unit", f"{rule}{standard.distance_mm:.4g}", mend))
    means = np.array([samples[visit.rows].mean() for visit in recording.visits])
    table, note = _visit_means(recording, means)
    comparison = None if table is None else compare(table, declared.practical, alpha)
    bias, interval = _bias(recording, means, standard, alpha)
    return DistanceResult(
        markers=declared.markers,
        samples_mm=samples,
        sample_stage=tuple(v.stage for v in recording.visits for _ in range(v.begin, v.end)),
        stages=tuple(_stage(recording, samples, s, alpha) for s in recording.stages),
        comparison=comparison,
        comparison_note=note,
        drift=_drift(recording, samples, means, alpha),
        standard=standard,
        bias_mm=bias,
        bias_interval_mm=interval,
    )


def _standard(declared: DistanceTable, root: Path) -> Standard | None:
    if declared.reference is not None:
        return Standard(declared.reference, declared.uncertainty)
    if declared.spheres is None:
        return None
    for column in declared.columns:
        check_unit(column, declared.unit, "length", "distance.unit")
    factor = unit_factor(declared.unit, "length")
    spheres = []
    for file in declared.spheres:
        table = read_csv(root / file, required=declared.columns, source=file)
        spheres.append(fit_sphere(factor * coordinates(table, declared.columns), file))
    apart = spheres[0].center - spheres[1].center
    distance = float(np.linalg.norm(apart))
    along = apart / distance
    variance = sum(float(along @ sphere.covariance[:3, :3] @ along) for sphere in spheres)
    return Standard(distance, float(np.hypot(np.sqrt(variance), declared.uncertainty)), (*spheres,))


def _stage(recording: TrackerRecording, samples: Array, stage: str, alpha: float) -> StageDistance:
    parts = [samples[visit.rows] for visit in recording.visits_of(stage)]
    means = np.array([part.mean() for part in parts])
    distances = np.concatenate(parts)
    away = np.concatenate([part - part.mean() for part in parts])
    freedom = max(len(distances) - len(parts), 1)
    between, interval = None, None
    if len(parts) > 1:
        between = float(means.std(ddof=1))
        error = between / np.sqrt(len(parts))
        interval = student_interval(float(means.mean()), error, len(parts) - 1, alpha)
    return StageDistance(
        stage=stage,
        visits=len(parts),
        samples=len(distances),
        independent=sum(len(part) / correlation_time(part) for part in parts),
        mean_mm=float(means.mean()),
        sd_mm=float(np.sqrt((away**2).sum() / freedom)),
        between_mm=between,
        interval_mm=interval,
        lowest_mm=float(distances.min()),
        highest_mm=float(distances.max()),
    )


def _visit_means(recording: TrackerRecording, means: Array) -> tuple[pd.DataFrame | None, str]:
    """Table of the visit means by stage and pass; None where nothing can be compared, and why."""
    import pandas as pd

    if len(recording.stages) < 2:
        return None, "there is one stage: nothing to compare"
    if min(len(recording.visits_of(stage)) for stage in recording.stages) < 2:
        once = [s for s in recording.stages if len(recording.visits_of(s)) < 2]
        return None, (
            f"{len(once)} of {len(recording.stages)} stages were visited once: samples of one "
            "visit are copies of each other, so nothing tells a stage from a visit; "
            "repeat the motion"
        )
    table = pd.DataFrame({"stage": [v.stage for v in recording.visits], "distance": means})
    number = passes(recording.visits)
    if number is None:
        return table, "stages are compared against the scatter between visits"
    table["pass"] = [f"pass {k + 1}" for k in number]
    return table, (
        f"stages are compared within each of {int(number.max()) + 1} passes; the error is "
        "their pass-to-pass variation"
    )


def _drift(recording: TrackerRecording, samples: Array, means: Array, alpha: float) -> Drift | None:
    """Slope over time of visit means less their stage's mean, or of blocks of one visit."""
    time = np.arange(len(samples)) / 1000 if recording.time_s is None else recording.time_s / 3600
    unit = "mm per 1000 samples" if recording.time_s is None else "mm/h"
    if len(recording.visits) == 1:
        visits = _blocks(recording.visits[0], samples)
        means = np.array([samples[visit.rows].mean() for visit in visits])
    else:
        visits = recording.visits
    stages = np.array([visit.stage for visit in visits], dtype=object)
    when = np.array([time[visit.rows].mean() for visit in visits])
    levels = np.unique(stages.astype(str))
    freedom = len(visits) - len(levels) - 1
    if len(visits) < FEWEST_FOR_DRIFT or freedom < 3:
        return None
    x, y = when.copy(), means.copy()
    for stage in levels:
        x[stages == stage] -= x[stages == stage].mean()
        y[stages == stage] -= y[stages == stage].mean()
    if not x.any():
        return None
    from scipy.stats import t

    slope = float(x @ y / (x @ x))
    error = float(np.sqrt(((y - slope * x) ** 2).sum() / freedom / (x @ x)))
    p = float(2 * t.sf(abs(slope) / error, freedom)) if error > 0 else float(slope == 0)
    return Drift(slope, student_interval(slope, error, freedom, alpha), p, unit, len(x))


def _blocks(visit: Visit, samples: Array) -> tuple[Visit, ...]:
    """Blocks of a visit that are each five correlation times long, at most twenty."""
    n = visit.end - visit.begin
    longest = 5 * correlation_time(samples[visit.rows])
    count = int(min(DRIFT_BLOCKS, n // max(longest, 1)))
    if count < FEWEST_FOR_DRIFT:
        return (visit,)
    ends = np.linspace(visit.begin, visit.end, count + 1).astype(int)
    return tuple(Visit(visit.stage, int(a), int(b)) for a, b in pairwise(ends))


def _bias(
    recording: TrackerRecording, means: Array, standard: Standard | None, alpha: float
) -> tuple[float | None, tuple[float, float] | None]:
    """Compare the mean over visits with the standard; give the interval that visits tell."""
    if standard is None:
        return None, None
    number = passes(recording.visits)
    # independent observations: passes where there are any, else visits
    units = means if number is None else np.array(
        [means[number == k].mean() for k in range(int(number.max()) + 1)]
    )  # fmt: skip
    bias = float(units.mean()) - standard.distance_mm
    if len(units) < 2:
        return bias, None
    standard_error = float(units.std(ddof=1)) / np.sqrt(len(units))
    total = float(np.hypot(standard_error, standard.uncertainty_mm))
    # Welch-Satterthwaite: the standard's own uncertainty counts as known
    freedom = (len(units) - 1) * (total / standard_error) ** 4 if standard_error > 0 else 1e6
    return bias, student_interval(bias, total, min(freedom, 1e6), alpha)


# What ``study tracking`` says.


@dataclass(frozen=True)
class TrackerAccuracy(Keyed):
    """Accuracy of a tracker; lengths in mm."""

    KEYS = "name samples markers alpha distance displacement reference notes report"

    name: str
    question: str
    samples: int
    markers: int
    #: Size of tests; intervals have the level 1 - alpha.
    alpha: float
    distance: DistanceResult | None
    displacement: DisplacementResult | None
    reference: ReferenceResult | None
    notes: tuple[str, ...] = ()
    report: str | None = None


def judge_tracker(
    declared: TrackingFile, root: Path, name: str, compare: Compare
) -> TrackerAccuracy:
    """Compare a tracker with everything its file names."""
    alpha = declared.tracking.alpha
    recording = read_recording(declared.recording, root)
    distance = displacement = reference = None
    if declared.distance is not None:
        distance = analyze_distance(declared.distance, recording, root, alpha, compare)
    if declared.displacement is not None:
        displacement = analyze_displacement(declared.displacement, recording, alpha)
    if declared.reference is not None:
        reference = analyze_reference(declared.reference, recording, root)
    return TrackerAccuracy(
        name=declared.tracking.name or name,
        question=declared.tracking.question,
        samples=len(recording.table.lines),
        markers=len(recording.positions),
        alpha=alpha,
        distance=distance,
        displacement=displacement,
        reference=reference,
        notes=recording.table.notes,
    )


# A tracker against a better instrument: rigid registration of poses, and errors of targets.
#
# The reference sees another point of the body than the tracker does. While the body is not turned
# the arm between both points is absorbed by the registration; what it turns by adds to the
# residual, unless further reference points on the body show how it is turned.


#: Scale between both sets beyond which one is in another unit.
FRAME_UNIT_RATIO = 2.0
#: Residual over the extent of the poses beyond which they do not pair. Trackers err by less
#: than 1 % of their workspace; poses paired in the wrong order by tens of percent.
UNPAIRED_SHARE = 0.02
#: Poses that nine parameters (motion and arm) need to leave something over.
FEWEST_FOR_ARM = 5


@dataclass(frozen=True)
class LeverArm:
    """Arm from the reference point to the marker, in the frame of the body."""

    #: shape (3,); along the body's x, y and z, and standard uncertainties.
    arm_mm: Array
    uncertainty_mm: Array
    #: Residual with the arm, RMS of distances.
    rms_mm: float
    #: RMS error of poses predicted from all others, with the arm.
    left_out_rms_mm: float
    #: Of the F test that the arm explains nothing.
    p: float
    #: RMS rotation of the body from its mean over the poses: what makes the arm visible.
    turned_deg: float


@dataclass(frozen=True)
class ReferenceResult(Keyed):
    """A tracker's poses registered to those of a reference."""

    KEYS = (
        "marker poses positions_mm scatter_mm target_error_mm left_out_mm distance_error_mean_mm "
        "distance_error_sd_mm lever_arm registration=fit.motion residuals_mm=fit.residuals "
        "fiducial_registration_error_mm=fit.rms localization_error_mm=fit.localization_error "
        "scale=fit.scale left_out_rms_mm"
    )

    marker: str
    #: Labels, in the order of the recording.
    poses: tuple[str, ...]
    #: Motion from the tracker's to the reference's frame, and its residuals.
    fit: PairedFit
    #: shape (n, 3); mean positions of the marker in the tracker's frame.
    positions_mm: Array
    #: shape (3,); standard deviation of samples within a pose, along the tracker's axes.
    scatter_mm: Array
    #: shape (n,); registration error expected at every pose (Fitzpatrick).
    target_error_mm: Array
    #: shape (n,); error of every pose predicted by a registration of all others.
    left_out_mm: Array
    #: Tracker's less reference's distance over all pairs of poses: needs no registration.
    distance_error_mean_mm: float
    distance_error_sd_mm: float
    #: None where the reference shows no axes, or for fewer than five poses.
    lever_arm: LeverArm | None

    @property
    def left_out_rms_mm(self) -> float:
        """RMS error of poses that did not take part in their registration."""
        return float(np.sqrt((self.left_out_mm**2).mean()))


def analyze_reference(
    declared: ReferenceTable, recording: TrackerRecording, root: Path
) -> ReferenceResult:
    """Judge a tracker by a reference that measured the same poses."""
    columns = [declared.stage, *declared.position, *(c for t in declared.axes or () for c in t)]
    table = read_csv(root / declared.file, required=columns, source=declared.file)
    for column in columns[1:]:
        check_unit(column, declared.unit, "length", "reference.unit")
    poses, rows = _paired(declared, recording, table)
    factor = unit_factor(declared.unit, "length")
    fixed = factor * coordinates(table, declared.position)[rows]
    samples = recording.positions[declared.marker]
    parts = [
        np.concatenate([samples[visit.rows] for visit in recording.visits_of(p)]) for p in poses
    ]
    moving = np.array([part.mean(axis=0) for part in parts])
    fit = fit_pairs(moving, fixed, "reference")
    ratio = _extent(fixed) / _extent(moving)
    if not 1 / FRAME_UNIT_RATIO < ratio < FRAME_UNIT_RATIO:
        rule = f"the reference's poses are {times(ratio, 4)} as far apart as the tracker's"
        mend = 'one unit is wrong: a factor near 1000 means "m" where "mm" is written'
        raise InputError(Fault("reference.unit", rule, mend))
    if fit.is_mirrored and fit.rms > UNPAIRED_SHARE * _extent(fixed):
        rule = f"the tracker's frame is mirrored: RMS {fit.rms:.3g} mm, {fit.mirrored_rms:.3g} mm "
        rule += "with one axis flipped"
        mend = "exchange or negate one column: one of both frames is left-handed"
        raise InputError(Fault("recording.markers", rule, mend))
    turned = None
    if declared.axes is not None:
        further = [factor * coordinates(table, axis)[rows] for axis in declared.axes]
        bodies = zip(poses, fixed, *further, strict=True)
        if lines := [pose for pose, *points in bodies if on_a_line(np.array(points))]:
            rule = f"the three points on the body lie on a line at: {', '.join(lines[:5])}"
            mend = "name other columns in [reference] axes: two points off the line through the "
            raise InputError(Fault(f"{declared.file}: axes", rule, f"{mend}first"))
        second = further[1]
        x = further[0] - fixed
        x /= np.linalg.norm(x, axis=1, keepdims=True)
        y = second - fixed
        y -= (x * y).sum(axis=1, keepdims=True) * x
        y /= np.linalg.norm(y, axis=1, keepdims=True)
        turned = np.stack([x, y, np.cross(x, y)], axis=-1)
    away = np.concatenate([part - part.mean(axis=0) for part in parts])
    from scipy.spatial.distance import pdist

    errors = np.asarray(pdist(moving) - pdist(fixed))
    lever_arm = _lever_arm(moving, fixed, turned, fit)
    left = fit.rms if lever_arm is None else min(fit.rms, lever_arm.rms_mm)
    if left > UNPAIRED_SHARE * _extent(fixed):
        rule = f"after registration {left:.3g} mm RMS are left over {_extent(fixed):.4g} mm of "
        where, rule = f"{declared.file}: {declared.stage}", f"{rule}extent: the poses do not pair"
        raise InputError(Fault(where, rule, "check the order of the poses in both files"))
    targets = target_registration_error(moving, moving, fit.localization_error)
    return ReferenceResult(
        marker=declared.marker,
        poses=poses,
        fit=fit,
        positions_mm=moving,
        scatter_mm=np.sqrt((away**2).sum(axis=0) / max(len(away) - len(parts), 1)),
        target_error_mm=targets,
        left_out_mm=_left_out(moving, fixed),
        distance_error_mean_mm=float(errors.mean()),
        distance_error_sd_mm=float(errors.std(ddof=1)),
        lever_arm=lever_arm,
    )


def _paired(
    declared: ReferenceTable, recording: TrackerRecording, table: CsvTable
) -> tuple[tuple[str, ...], list[int]]:
    """Poses of both, and the row of each in the reference's table."""
    labels, poses = table.text(declared.stage), recording.stages
    faults = []
    twice = sorted({label for label in labels if labels.count(label) > 1})
    if twice:
        rule = f"poses with several rows: {', '.join(twice[:5])}"
        faults.append(Fault(f"{declared.file}: {declared.stage}", rule, "give one row a pose"))
    for where, missing in (
        (declared.file, [pose for pose in poses if pose not in labels]),
        (recording.table.source, [label for label in labels if label not in poses]),
    ):
        if missing:
            rule = f"poses do not pair: {', '.join(dict.fromkeys(missing[:5]))} "
            rule += f"{'is' if len(missing) == 1 else 'are'} missing here"
            mend = "give the same labels in both files, and drop poses that one has not"
            faults.append(Fault(where, rule, mend))
    if len(poses) < FEWEST_POINTS:
        rule = f"{len(poses)} poses are too few for a registration"
        faults.append(Fault("reference", rule, f"measure {FEWEST_POINTS + 1} or more"))
    if faults:
        raise InputError(faults)
    return poses, [labels.index(pose) for pose in poses]


def _extent(points: Array) -> float:
    """RMS distance of points from their center, mm."""
    return float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))


def _left_out(moving: Array, fixed: Array) -> Array:
    """Error of every pose that a registration of the others predicts, mm."""
    if len(moving) <= FEWEST_POINTS:
        return np.full(len(moving), np.nan)
    errors = []
    for k in range(len(moving)):
        motion = fit_pairs(np.delete(moving, k, 0), np.delete(fixed, k, 0), "reference").motion
        errors.append(np.linalg.norm(motion(moving[k : k + 1])[0] - fixed[k]))
    return np.array(errors)


def _lever_arm(
    moving: Array, fixed: Array, turned: Array | None, fit: PairedFit
) -> LeverArm | None:
    """Estimate the arm with the registration, and judge by left-out poses what it is worth."""
    from scipy.spatial.transform import Rotation
    from scipy.stats import f as f_distribution

    n = len(moving)
    if turned is None or n < FEWEST_FOR_ARM:
        return None
    motion, arm, covariance, squares = _with_arm(moving, fixed, turned, fit.motion)
    freedom = 3 * n - 9
    plain = float((fit.residuals**2).sum())
    ratio = (plain - squares) / 3 / (squares / freedom) if squares > 0 else np.inf
    errors = []
    for k in range(n):
        others = np.arange(n) != k
        poses = moving[others], fixed[others], turned[others]
        arm_without, own_arm, _, _ = _with_arm(*poses, motion)
        errors.append(arm_without(moving[k : k + 1])[0] - fixed[k] - turned[k] @ own_arm)
    rotations = Rotation.from_matrix(turned)
    angles = (rotations.mean().inv() * rotations).magnitude()
    return LeverArm(
        arm_mm=arm,
        uncertainty_mm=np.sqrt(np.diag(covariance)),
        rms_mm=float(np.sqrt(squares / n)),
        left_out_rms_mm=float(np.sqrt((np.array(errors) ** 2).sum(axis=1).mean())),
        p=float(f_distribution.sf(ratio, 3, freedom)),
        turned_deg=float(np.degrees(np.sqrt(np.mean(np.square(angles))))),
    )


def _with_arm(
    moving: Array, fixed: Array, turned: Array, start: RigidMotion
) -> tuple[RigidMotion, Array, Array, float]:
    """Motion and arm with the least squares, covariance of the arm, and the sum of squares."""
    from scipy.optimize import least_squares

    center = moving.mean(axis=0)

    def motion_of(values: Array) -> RigidMotion:
        rotation = start.rotation @ rotation_of(values[:3])
        return RigidMotion(rotation, start(center[None])[0] - rotation @ center + values[3:6])

    def residuals(values: Array) -> Array:
        seen = fixed + np.einsum("nij,j->ni", turned, values[6:])
        return np.asarray((seen - motion_of(values)(moving)).ravel())

    solution = least_squares(residuals, np.zeros(9), x_scale="jac", xtol=1e-12, ftol=1e-14)
    settled(solution, "position of the reference")
    squares = float((solution.fun**2).sum())
    freedom = max(solution.fun.size - 9, 1)
    inverse = np.linalg.pinv(solution.jac.T @ solution.jac, rcond=1e-14)[6:, 6:]
    covariance = inverse * squares / freedom
    return motion_of(solution.x), np.asarray(solution.x[6:]), covariance, squares
