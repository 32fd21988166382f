"""What a report says of a tracker: its answers in sentences, and its tables."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from study.reporting.content.table import Table
from study.reporting.numbers import MISSING, interval, level, p_phrase, quantity, significant
from study.reporting.text import clean, count
from study.tracker_accuracy.displacement import DisplacementResult
from study.tracker_accuracy.distance import DistanceResult, StageDistance
from study.tracker_accuracy.reference import LeverArm, ReferenceResult
from study.tracker_accuracy.result import TrackerAccuracy


def answers(found: TrackerAccuracy) -> list[str]:
    """Say in a few sentences what was found.

    Parameters
    ----------
    found : TrackerAccuracy
        Lengths in mm. What is None among distance, displacement and reference has no sentence.

    Returns
    -------
    list of str
        Plain text, the number of samples first.
    """
    lines = [f"{count(found.samples, 'sample')} of {count(found.markers, 'marker')}."]
    if found.distance is not None:
        lines += _distance(found.distance, found.alpha)
    if found.displacement is not None:
        lines += _displacement(found.displacement, found.alpha)
    if found.reference is not None:
        lines += _reference(found.reference)
    return [clean(line) for line in lines]


def _distance(found: DistanceResult, alpha: float) -> Iterator[str]:
    names = " and ".join(found.markers)
    if found.standard is not None and found.bias_mm is not None:
        text = f"The distance of {names} is {quantity(found.bias_mm, 'mm')} from its standard of "
        text += f"{quantity(found.standard.distance_mm, 'mm', 6)} "
        text += f"(standard uncertainty {quantity(found.standard.uncertainty_mm, 'mm', 2)})"
        if found.bias_interval_mm is None:
            yield f"{text}; one visit does not tell how well that repeats."
        else:
            low, high = found.bias_interval_mm
            clear = "more than chance explains" if low > 0 or high < 0 else "within chance"
            ends = f"{level(alpha)} interval {interval(low, high, 'mm')}"
            yield f"{text}, {ends}: {clear}."
    if found.comparison is not None and found.comparison.effects:
        effect = found.comparison.effects[0]
        text = f"Stages differ by up to {quantity(effect.range, 'mm')} ({p_phrase(effect.p)})"
        yield f"{text}: {effect.verdict}; {found.comparison_note}."
    else:
        yield f"Stages are not compared: {found.comparison_note}."
    if found.drift is not None:
        ends = interval(*found.drift.interval, found.drift.unit)
        yield (
            f"Drift {quantity(found.drift.slope, found.drift.unit)} ({ends}; "
            f"{p_phrase(found.drift.p)}, {found.drift.observations} observations)."
        )


def _displacement(found: DisplacementResult, alpha: float) -> Iterator[str]:
    line, pair = found.line, found.agreement
    yield (
        f"Measured is {significant(line.scale, 6)} times commanded displacement "
        f"({level(alpha)} interval {line.scale_interval[0]:.6g} to {line.scale_interval[1]:.6g}), "
        f"with an offset of {quantity(line.offset, 'mm')} "
        f"({interval(*line.offset_interval, 'mm')}); errors in both are in the line."
    )
    yield (
        f"The stops lie {quantity(found.straightness_rms_mm, 'mm')} RMS off a straight line, "
        f"{quantity(found.straightness_max_mm, 'mm')} at worst."
    )
    yield (
        f"95 % of differences lie between {quantity(pair.lower, 'mm')} and "
        f"{quantity(pair.upper, 'mm')} (limits of agreement, {count(pair.points, 'stop')}); the "
        f"difference {'grows' if pair.trend_p < alpha else 'does not grow'} with the displacement "
        f"({p_phrase(pair.trend_p)})."
    )


def _reference(found: ReferenceResult) -> Iterator[str]:
    fit = found.fit
    yield (
        f"Registered to the reference over {count(len(found.poses), 'pose')}, the tracker is off "
        f"by {quantity(fit.rms, 'mm')} RMS; a pose that took no part, by "
        f"{quantity(found.left_out_rms_mm, 'mm')}. Localizing one pose errs by "
        f"{quantity(fit.localization_error, 'mm')}, and registration adds "
        f"{quantity(float(found.target_error_mm.min()), 'mm')} to "
        f"{quantity(float(found.target_error_mm.max()), 'mm')} at the poses."
    )
    still = ", ".join(significant(v, 2) for v in found.scatter_mm)
    yield (
        f"At rest samples scatter by {still} mm along the tracker's axes: "
        f"{_times(fit.rms / float(np.linalg.norm(found.scatter_mm)))} less than the poses are off, "
        "so more samples a pose would help little."
    )
    yield (
        f"Distances between poses, which need no registration, err by "
        f"{quantity(found.distance_error_mean_mm, 'mm')} on average and scatter by "
        f"{quantity(found.distance_error_sd_mm, 'mm')}; best scale {fit.scale:.5f}."
    )
    if found.lever_arm is not None:
        yield _lever_arm(found.lever_arm, found)


def _times(ratio: float) -> str:
    return f"{ratio:.2g} times" if np.isfinite(ratio) else "far"


def _lever_arm(arm: LeverArm, found: ReferenceResult) -> str:
    """Say what the arm between marker and reference point does to the figures."""
    parts = ", ".join(
        f"{significant(a)} \N{PLUS-MINUS SIGN} {significant(u, 2)}"
        for a, u in zip(arm.arm_mm, arm.uncertainty_mm, strict=True)
    )
    text = (
        f"The lever arm between marker and reference point ({parts} mm along the body's axes, one "
        f"standard uncertainty) takes the residual from {quantity(found.fit.rms, 'mm')} to "
        f"{quantity(arm.rms_mm, 'mm')} RMS ({p_phrase(arm.p)}), and the error of poses left out "
        f"from {quantity(found.left_out_rms_mm, 'mm')} to {quantity(arm.left_out_rms_mm, 'mm')}; "
        f"the body turned by {significant(arm.turned_deg, 2)} deg RMS."
    )
    open_axes = [
        axis
        for axis, a, u in zip("xyz", arm.arm_mm, arm.uncertainty_mm, strict=True)
        if abs(a) < 2 * u
    ]
    if open_axes:
        text += f" The body turned too little to tell the arm along {', '.join(open_axes)}."
    return text


def tables(found: TrackerAccuracy) -> list[Table]:
    """Stages, stops and poses.

    Parameters
    ----------
    found : TrackerAccuracy
        Lengths in mm.

    Returns
    -------
    list of Table
        One for each of distance, displacement and reference that is not None, in this order.
    """
    made = []
    if found.distance is not None:
        made.append(_stages(found.distance, found.alpha))
    if found.displacement is not None:
        made.append(_stops(found.displacement))
    if found.reference is not None:
        made.append(_poses(found.reference))
    return made


def _stages(found: DistanceResult, alpha: float) -> Table:
    columns = ("stage", "visits", "samples", "independent", "mean (mm)", "SD within (mm)",
               "SD between visits (mm)", f"{level(alpha)} interval of the mean")  # fmt: skip
    return Table(
        "Distance by stage",
        columns,
        tuple(_stage(one) for one in found.stages),
        raw=tuple(vars(one) for one in found.stages),
    )


def _stage(one: StageDistance) -> tuple[str, ...]:
    ends = MISSING if one.interval_mm is None else interval(*one.interval_mm, "", 6)
    return (
        clean(one.stage), str(one.visits), f"{one.samples:,}", f"{one.independent:.0f}",
        significant(one.mean_mm, 6), significant(one.sd_mm), significant(one.between_mm), ends,
    )  # fmt: skip


def _stops(found: DisplacementResult) -> Table:
    pairs = list(zip(found.commanded_mm.tolist(), found.measured_mm.tolist(), strict=True))
    rows = tuple((f"{c:.6g}", f"{m:.6g}", significant(m - c)) for c, m in pairs)
    raw = tuple({"commanded_mm": c, "measured_mm": m} for c, m in pairs)
    columns = ("commanded (mm)", "measured (mm)", "difference (mm)")
    return Table("Displacement by stop", columns, rows, 0, raw=raw)


def _poses(found: ReferenceResult) -> Table:
    columns = ("pose", "x", "y", "z", "residual (mm)", "left out (mm)", "expected TRE (mm)")
    rows, raw = [], []
    for k, pose in enumerate(found.poses):
        off = found.fit.residuals[k]
        size = float(np.linalg.norm(off))
        errors = (float(found.left_out_mm[k]), float(found.target_error_mm[k]))
        numbers = [*off.tolist(), size, *errors]
        rows.append((clean(pose), *(significant(value) for value in numbers)))
        raw.append({"pose": pose, "residual_mm": size, "left_out_mm": errors[0],
                    "expected_mm": errors[1]})  # fmt: skip
    return Table("Residuals by pose", columns, tuple(rows), raw=tuple(raw))
