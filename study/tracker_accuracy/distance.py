"""Distance between two markers on one rigid body: what changes in it is the tracker's error.

Samples of one visit follow each other within milliseconds and share most of their errors, so a
visit counts as one observation: stages are compared against the scatter between visits.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from study.analysis.anova import analyze
from study.analysis.request import AnalysisRequest, Blocking, ResponseScale, Threshold
from study.analysis.result import AnalysisResult
from study.arrays import Array
from study.errors import Fault, InputError
from study.registration.sphere import Sphere, fit_sphere
from study.tabular import read_csv
from study.tracker_accuracy.recording import (
    Recording,
    Visit,
    coordinates,
    correlation_time,
    passes,
)
from study.tracker_accuracy.section import DistanceTable
from study.units import unit_factor

#: A distance this far from its standard is in another unit, not wrong by an error.
UNIT_RATIO = 5.0

#: Fewest visits, or blocks of samples, over which a drift is judged.
FEWEST_FOR_DRIFT = 6

#: Blocks into which a recording without visits is cut for its drift.
DRIFT_BLOCKS = 20


@dataclass(frozen=True)
class StageDistance:
    """Distance over one stage.

    Parameters
    ----------
    stage : str
        Stage of the motion.
    visits, samples : int
        How often it was visited, and samples in all.
    independent : float
        Samples that are worth as many independent ones within visits (autocorrelation).
    mean_mm, sd_mm : float
        Mean over the visits, and standard deviation of the samples within visits.
    between_mm : float or None
        Standard deviation between visits; None for a single visit.
    interval_mm : tuple of float or None
        Of the mean, from the scatter between visits; None for a single visit, which cannot
        tell how well the next one would repeat it.
    lowest_mm, highest_mm : float
        Extreme samples.
    """

    stage: str
    visits: int
    samples: int
    independent: float
    mean_mm: float
    sd_mm: float
    between_mm: float | None
    interval_mm: tuple[float, float] | None
    lowest_mm: float
    highest_mm: float


@dataclass(frozen=True)
class Drift:
    """Change of the distance over time, stages apart.

    Parameters
    ----------
    slope : float
        Per hour, or per thousand samples where there is no time.
    interval : tuple of float
        Of the slope, at the level 1 - alpha.
    p : float
        Of the test that there is none.
    unit : str
        Of the slope.
    observations : int
        Visits, or blocks of samples longer than their correlation, that are the observations.
    """

    slope: float
    interval: tuple[float, float]
    p: float
    unit: str
    observations: int


@dataclass(frozen=True)
class Standard:
    """Known distance that the tracker should find.

    Parameters
    ----------
    distance_mm, uncertainty_mm : float
        Value and standard uncertainty.
    spheres : tuple of Sphere
        Spheres from whose centers it comes; empty where it was given.
    """

    distance_mm: float
    uncertainty_mm: float
    spheres: tuple[Sphere, ...] = ()


@dataclass(frozen=True)
class DistanceResult:
    """Distance of two markers, stage by stage, beside what it should be.

    Parameters
    ----------
    markers : tuple of two str
        The markers.
    samples_mm : ndarray, shape (n,)
        Distance in every sample.
    sample_stage : tuple of str
        Stage of every sample.
    stages : tuple of StageDistance
        In the order of the recording.
    comparison : AnalysisResult or None
        Analysis of variance of the visit means; None where it cannot be made.
    comparison_note : str
        Why there is none, or what the error term is.
    drift : Drift or None
        None where there are too few visits or independent samples.
    standard : Standard or None
        The gold standard.
    bias_mm : float or None
        Mean over the visits less the standard.
    bias_interval_mm : tuple of float or None
        Scatter between visits (or stages visited once) and standard together.
    """

    markers: tuple[str, str]
    samples_mm: Array
    sample_stage: tuple[str, ...]
    stages: tuple[StageDistance, ...]
    comparison: AnalysisResult | None
    comparison_note: str
    drift: Drift | None
    standard: Standard | None
    bias_mm: float | None
    bias_interval_mm: tuple[float, float] | None


def analyze_distance(
    declared: DistanceTable, recording: Recording, root: Path, alpha: float
) -> DistanceResult:
    """Judge the distance between two markers.

    Parameters
    ----------
    declared : DistanceTable
        The markers and their standard.
    recording : Recording
        What the tracker wrote.
    root : Path
        Data root, for scans of spheres.
    alpha : float
        Size of tests.

    Returns
    -------
    DistanceResult

    Raises
    ------
    InputError
        For a distance that shows another unit than its standard.
    """
    first, second = (recording.positions[m] for m in declared.markers)
    samples = np.linalg.norm(first - second, axis=1)
    standard = _standard(declared, root)
    if standard is not None:
        _check_unit(float(np.median(samples)), standard)
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
    variance = sum(float(along @ one.covariance[:3, :3] @ along) for one in spheres)
    return Standard(distance, float(np.hypot(np.sqrt(variance), declared.uncertainty)), (*spheres,))


def _check_unit(seen: float, standard: Standard) -> None:
    ratio = seen / standard.distance_mm
    if not 1 / UNIT_RATIO < ratio < UNIT_RATIO:
        rule = f"the markers are {seen:.4g} mm apart, the standard says {standard.distance_mm:.4g}"
        mend = 'is [recording] unit right? A factor near 1000 means "m" instead of "mm"'
        raise InputError(Fault("recording.unit", rule, mend))


def _stage(recording: Recording, samples: Array, stage: str, alpha: float) -> StageDistance:
    from scipy.stats import t

    parts = [samples[visit.rows] for visit in recording.visits_of(stage)]
    means = np.array([part.mean() for part in parts])
    own = np.concatenate(parts)
    away = np.concatenate([part - part.mean() for part in parts])
    freedom = max(len(own) - len(parts), 1)
    between, interval = None, None
    if len(parts) > 1:
        between = float(means.std(ddof=1))
        half = float(t.ppf(1 - alpha / 2, len(parts) - 1)) * between / np.sqrt(len(parts))
        interval = (float(means.mean()) - half, float(means.mean()) + half)
    return StageDistance(
        stage=stage,
        visits=len(parts),
        samples=len(own),
        independent=sum(len(part) / correlation_time(part) for part in parts),
        mean_mm=float(means.mean()),
        sd_mm=float(np.sqrt((away**2).sum() / freedom)),
        between_mm=between,
        interval_mm=interval,
        lowest_mm=float(own.min()),
        highest_mm=float(own.max()),
    )


def _compared(
    recording: Recording, means: Array, practical: float | None, alpha: float
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
    if number is not None:
        table["pass"] = [f"pass {k + 1}" for k in number]
        request = AnalysisRequest(
            "distance", ("stage",), Blocking(("pass",)), scale=scale, alpha=alpha
        )
        return analyze(table, request), (
            f"every one of {int(number.max()) + 1} passes visits every stage: stages are compared "
            "within passes, against how their differences vary from pass to pass"
        )
    request = AnalysisRequest("distance", ("stage",), scale=scale, alpha=alpha)
    return analyze(table, request), "stages are compared against the scatter between visits"


def _drift(recording: Recording, samples: Array, means: Array, alpha: float) -> Drift | None:
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
    known = np.unique(stages.astype(str))
    freedom = len(visits) - len(known) - 1
    if len(visits) < FEWEST_FOR_DRIFT or freedom < 3:
        return None
    x, y = when.copy(), means.copy()
    for stage in known:
        x[stages == stage] -= x[stages == stage].mean()
        y[stages == stage] -= y[stages == stage].mean()
    return None if not x.any() else _slope(x, y, freedom, (unit, alpha))


def _slope(x: Array, y: Array, freedom: int, said: tuple[str, float]) -> Drift:
    from scipy.stats import t

    unit, alpha = said
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
    recording: Recording, means: Array, standard: Standard | None, alpha: float
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
    own = float(units.std(ddof=1)) / np.sqrt(len(units))
    total = float(np.hypot(own, standard.uncertainty_mm))
    # Welch-Satterthwaite: the standard's own uncertainty counts as known
    freedom = (len(units) - 1) * (total / own) ** 4 if own > 0 else 1e6
    half = float(t.ppf(1 - alpha / 2, min(freedom, 1e6))) * total
    return bias, (bias - half, bias + half)
