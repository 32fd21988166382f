"""Measured against commanded displacement of a marker on a linear stage.

A stop is one observation: the mean of its samples. The commanded position has an uncertainty
of its own, so the line is fitted with errors in both quantities.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from study.ground.arrays import Array
from study.ground.canonical import Keyed
from study.ground.errors import Fault, InputError
from study.ground.tabular import read_csv
from study.ground.units import unit_factor
from study.laboratory.registration.deming import (
    DemingLine,
    MethodAgreement,
    deming_line,
    limits_of_agreement,
)
from study.laboratory.registration.rigid import FittedSphere, fit_sphere
from study.laboratory.tracker.tracker_recording import (
    DisplacementTable,
    DistanceTable,
    TrackerRecording,
    TrackingFile,
    Visit,
    coordinates,
    correlation_time,
    passes,
    read_recording,
    visits_to,
)
from study.laboratory.tracker.tracker_reference import ReferenceResult, analyze_reference
from study.statistics.analysis.analysis_request import (
    AnalysisRequest,
    Blocking,
    ResponseScale,
    Threshold,
)
from study.statistics.analysis.analysis_result import AnalysisResult
from study.statistics.analysis.anova import analyze

#: A scale this far from 1 is another unit, not an error of a tracker.
DISPLACEMENT_UNIT_RATIO = 5.0


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
    if not 1 / DISPLACEMENT_UNIT_RATIO < line.scale < DISPLACEMENT_UNIT_RATIO:
        rule = f"measured is {line.scale:.4g} times commanded displacement: another unit"
        mend = "compare [recording] unit and [displacement] unit"
        raise InputError(Fault("displacement.unit", rule, mend))
    spread = line.residual_sd if repeat is None else repeat
    home = float(spread / np.sqrt(at_home.sum()))
    line_uncertainty = line.offset_uncertainty
    total = float(np.hypot(line_uncertainty, home))
    half = (line.offset_interval[1] - line.offset) * (
        total / line_uncertainty if line_uncertainty > 0 else 1.0
    )
    interval = (line.offset - half, line.offset + half)
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
    if np.unique(commanded_mm).size < 3:
        rule = (
            f"there are {np.unique(commanded_mm).size} commanded positions, a line needs 3 or more"
        )
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

#: A distance this far from its standard is in another unit, not wrong by an error.
UNIT_RATIO = 5.0
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
    comparison: AnalysisResult | None
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
    declared: DistanceTable, recording: TrackerRecording, root: Path, alpha: float
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
    comparison, note = _compared(recording, means, declared.practical, alpha)
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
    from scipy.stats import t

    parts = [samples[visit.rows] for visit in recording.visits_of(stage)]
    means = np.array([part.mean() for part in parts])
    distances = np.concatenate(parts)
    away = np.concatenate([part - part.mean() for part in parts])
    freedom = max(len(distances) - len(parts), 1)
    between, interval = None, None
    if len(parts) > 1:
        between = float(means.std(ddof=1))
        half = float(t.ppf(1 - alpha / 2, len(parts) - 1)) * between / np.sqrt(len(parts))
        interval = (float(means.mean()) - half, float(means.mean()) + half)
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


def _compared(
    recording: TrackerRecording, means: Array, practical: float | None, alpha: float
) -> tuple[AnalysisResult | None, str]:
    """Analysis of variance of the visit means with the stage as factor."""
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
    scale = ResponseScale(practical=None if practical is None else Threshold(practical))
    number = passes(recording.visits)
    request = AnalysisRequest("distance", ("stage",), scale=scale, alpha=alpha)
    if number is None:
        return analyze(table, request), "stages are compared against the scatter between visits"
    table["pass"] = [f"pass {k + 1}" for k in number]
    return analyze(table, replace(request, layout=Blocking(("pass",)))), (
        f"stages are compared within each of {int(number.max()) + 1} passes; the error is "
        "their pass-to-pass variation"
    )


def _drift(recording: TrackerRecording, samples: Array, means: Array, alpha: float) -> Drift | None:
    """Slope over time of visit means less their stage's mean, or of blocks of one visit."""
    place = np.arange(len(samples)) / 1000 if recording.time_s is None else recording.time_s / 3600
    unit = "mm per 1000 samples" if recording.time_s is None else "mm/h"
    if len(recording.visits) == 1:
        visits = _blocks(recording.visits[0], samples)
        means = np.array([samples[visit.rows].mean() for visit in visits])
    else:
        visits = recording.visits
    stages = np.array([visit.stage for visit in visits], dtype=object)
    when = np.array([place[visit.rows].mean() for visit in visits])
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
    half = float(t.ppf(1 - alpha / 2, freedom)) * error
    p = float(2 * t.sf(abs(slope) / error, freedom)) if error > 0 else float(slope == 0)
    return Drift(slope, (slope - half, slope + half), p, unit, len(x))


def _blocks(visit: Visit, samples: Array) -> tuple[Visit, ...]:
    """Blocks of a visit that are each five correlation times long, at most twenty."""
    n = visit.end - visit.begin
    longest = 5 * correlation_time(samples[visit.rows])
    count = int(min(DRIFT_BLOCKS, n // max(longest, 1)))
    if count < FEWEST_FOR_DRIFT:
        return (visit,)
    ends = np.linspace(visit.begin, visit.end, count + 1).astype(int)
    return tuple(
        Visit(visit.stage, int(a), int(b)) for a, b in zip(ends[:-1], ends[1:], strict=True)
    )


def _bias(
    recording: TrackerRecording, means: Array, standard: Standard | None, alpha: float
) -> tuple[float | None, tuple[float, float] | None]:
    """Compare the mean over visits with the standard; give the interval that visits tell."""
    from scipy.stats import t

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
    half = float(t.ppf(1 - alpha / 2, min(freedom, 1e6))) * total
    return bias, (bias - half, bias + half)


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


def judge_tracker(declared: TrackingFile, root: Path, name: str) -> TrackerAccuracy:
    """Compare a tracker with everything its file names."""
    alpha = declared.tracking.alpha
    recording = read_recording(declared.recording, root)
    distance = displacement = reference = None
    if declared.distance is not None:
        distance = analyze_distance(declared.distance, recording, root, alpha)
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
