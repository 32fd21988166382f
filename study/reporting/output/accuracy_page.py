"""Pages of accuracy: a tracker against its references, a surface against a scan."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from study.laboratory.registration.iterative_closest_point import Registration
from study.laboratory.shape.shape_deviation import MarkerDeviation, ShapeDeviation
from study.laboratory.tracker.tracker_error import (
    DisplacementResult,
    DistanceResult,
    LeverArm,
    ReferenceResult,
    TrackerAccuracy,
)
from study.reporting.content.blocks import Table
from study.reporting.content.text import (
    MISSING,
    clean,
    count,
    interval,
    level,
    p_phrase,
    quantity,
    share,
    significant,
)
from study.reporting.figures.axes import Plot
from study.reporting.output.write import answer_blocks, write_answer
from study.statistics.analysis.analysis_result import AnalysisResult


def scan_answers(deviation: ShapeDeviation) -> list[str]:
    """Say in a few sentences what was found."""
    s = deviation.statistics
    lines = [
        f"The scan lies {quantity(s.mean_absolute, 'mm')} from the simulated surface on average "
        f"(RMS {quantity(s.rms, 'mm')}, 95 % within {quantity(s.absolute_p95, 'mm')}, at worst "
        f"{quantity(s.largest, 'mm')}), with its sign {quantity(s.mean, 'mm')}: positive where "
        "the real body is the larger one.",
        f"{count(s.points, 'point')} of {deviation.scan} show {share(deviation.seen)} of the "
        f"surface; {count(deviation.outliers, 'isolated point')} left out.",
    ]
    if s.largest_set_aside is not None:
        lines.append(
            f"{count(s.set_aside, 'point')} without weight in the registration, up to "
            f"{quantity(s.largest_set_aside, 'mm')} away, set aside in these figures: look at them "
            "in the picture, for a part that is missing or dented is among them too."
        )
    if deviation.registration is not None:
        lines += _registration(deviation.registration, deviation.registration_uncertainty or 0.0)
    if deviation.markers is not None:
        lines += _markers(deviation.markers)
    return lines


def _registration(registration: Registration, added: float) -> Iterator[str]:
    scanned = registration.motion.inverse(registration.center[None])
    shift = float(np.linalg.norm((registration.motion(scanned) - scanned)[0]))
    yield (
        f"Registered by closest points: moved by {quantity(shift, 'mm')} and turned by "
        f"{significant(registration.motion.angle_deg)} deg; residual "
        f"{quantity(registration.rms_mm, 'mm')} RMS, {registration.rejected:,} of "
        f"{registration.used:,} points without weight. The registration is known to "
        f"{quantity(added, 'mm', 2)} (one standard uncertainty, RMS over the points)."
    )
    if registration.sliding:
        listed = "; ".join(str(motion) for motion in registration.sliding)
        yield f"The shape does not fix: {listed}. The scan was not moved along it."
    else:
        yield "The shape fixes all six motions."


def _markers(markers: MarkerDeviation) -> Iterator[str]:
    what = "their simulated places" if markers.paired else "the simulated surface"
    sizes = markers.sizes
    text = (
        f"{count(len(sizes), 'marker')} are {quantity(markers.mean, 'mm')} from {what} on average, "
        f"{quantity(markers.rms, 'mm')} RMS, {quantity(float(sizes.max()), 'mm')} at worst"
    )
    if markers.moved is not None:
        inside = np.isfinite(markers.errors).all(axis=1)
        moved = float(np.sqrt((markers.moved[inside] ** 2).mean()))
        text += f"; they moved by {quantity(moved, 'mm')} RMS"
    yield f"{text}."
    if markers.outside:
        yield f"{count(markers.outside, 'marker')} outside the simulated body had no place in it."


def scan_tables(deviation: ShapeDeviation) -> list[Table]:
    """Statistics of the deviation, and markers."""
    s = deviation.statistics
    values = {
        "mean": s.mean, "mean of sizes": s.mean_absolute, "RMS": s.rms, "SD": s.sd,
        "largest": s.largest, "95 % of sizes": s.absolute_p95,
        **({} if s.largest_set_aside is None else {"largest set aside": s.largest_set_aside}),
        **{f"percentile {name[1:]}": value for name, value in s.percentiles.items()},
    }  # fmt: skip
    rows = tuple((name, significant(value)) for name, value in values.items())
    raw = tuple({"statistic": name, "mm": value} for name, value in values.items())
    tables = [Table("Deviation of the scan", ("statistic", "mm"), rows, raw=raw)]
    if deviation.markers is not None:
        tables.append(_marker_table(deviation.markers))
    return tables


def _marker_table(markers: MarkerDeviation) -> Table:
    sizes = [(*error, float(np.linalg.norm(error))) for error in markers.errors.tolist()]
    every = list(zip(markers.names, sizes, strict=True))
    rows = tuple((clean(name), *map(significant, numbers)) for name, numbers in every)
    names = ("x_mm", "y_mm", "z_mm", "size_mm")
    raw = tuple({"marker": n, **dict(zip(names, numbers, strict=True))} for n, numbers in every)
    columns = ("marker", "x (mm)", "y (mm)", "z (mm)", "size (mm)")
    return Table("Measured less simulated place of markers", columns, rows, raw=raw)


def tracker_answers(accuracy: TrackerAccuracy) -> list[str]:
    """Say in a few sentences what was found."""
    lines = [f"{count(accuracy.samples, 'sample')} of {count(accuracy.markers, 'marker')}."]
    if accuracy.distance is not None:
        lines += _tracker_distance(accuracy.distance, accuracy.alpha)
    if accuracy.displacement is not None:
        lines += _tracker_displacement(accuracy.displacement, accuracy.alpha)
    if accuracy.reference is not None:
        lines += _reference(accuracy.reference)
    return lines


def _tracker_distance(distance: DistanceResult, alpha: float) -> Iterator[str]:
    names = " and ".join(distance.markers)
    if distance.standard is not None and distance.bias_mm is not None:
        text = (
            f"The distance of {names} is {quantity(distance.bias_mm, 'mm')} from its standard of "
            f"{quantity(distance.standard.distance_mm, 'mm', 6)} "
            f"(standard uncertainty {quantity(distance.standard.uncertainty_mm, 'mm', 2)})"
        )
        if distance.bias_interval_mm is None:
            yield f"{text}; one visit does not tell how well that repeats."
        else:
            low, high = distance.bias_interval_mm
            clear = "more than chance explains" if low > 0 or high < 0 else "within chance"
            ends = f"{level(alpha)} interval {interval(low, high, 'mm')}"
            yield f"{text}, {ends}: {clear}."
    if isinstance(distance.comparison, AnalysisResult) and distance.comparison.effects:
        effect = distance.comparison.effects[0]
        text = f"Stages differ by up to {quantity(effect.range, 'mm')} ({p_phrase(effect.p)})"
        yield f"{text}: {effect.verdict}; {distance.comparison_note}."
    else:
        yield f"Stages are not compared: {distance.comparison_note}."
    if distance.drift is not None:
        ends = interval(*distance.drift.interval, distance.drift.unit)
        yield (
            f"Drift {quantity(distance.drift.slope, distance.drift.unit)} ({ends}; "
            f"{p_phrase(distance.drift.p)}, {distance.drift.observations} observations)."
        )


def _tracker_displacement(displacement: DisplacementResult, alpha: float) -> Iterator[str]:
    line, pair = displacement.line, displacement.agreement
    yield (
        f"Measured is {significant(line.scale, 6)} times commanded displacement "
        f"({level(alpha)} interval {line.scale_interval[0]:.6g} to {line.scale_interval[1]:.6g}), "
        f"with an offset of {quantity(line.offset, 'mm')} "
        f"({interval(*line.offset_interval, 'mm')}); errors in both are in the line."
    )
    yield (
        f"The stops lie {quantity(displacement.straightness_rms_mm, 'mm')} RMS off a straight "
        f"line, {quantity(displacement.straightness_max_mm, 'mm')} at worst."
    )
    yield (
        f"95 % of differences lie between {quantity(pair.lower, 'mm')} and "
        f"{quantity(pair.upper, 'mm')} (limits of agreement, {count(pair.points, 'stop')}); the "
        f"difference {'grows' if pair.trend_p < alpha else 'does not grow'} with the displacement "
        f"({p_phrase(pair.trend_p)})."
    )


def _reference(reference: ReferenceResult) -> Iterator[str]:
    fit = reference.fit
    yield (
        f"Registered to the reference over {count(len(reference.poses), 'pose')}, the tracker is "
        f"off by {quantity(fit.rms, 'mm')} RMS; a pose that took no part, by "
        f"{quantity(reference.left_out_rms_mm, 'mm')}. Localizing one pose errs by "
        f"{quantity(fit.localization_error, 'mm')}, and registration adds "
        f"{quantity(float(reference.target_error_mm.min()), 'mm')} to "
        f"{quantity(float(reference.target_error_mm.max()), 'mm')} at the poses."
    )
    still = ", ".join(significant(v, 2) for v in reference.scatter_mm)
    ratio = fit.rms / float(np.linalg.norm(reference.scatter_mm))
    less = f"{ratio:.2g} times" if np.isfinite(ratio) else "far"
    yield (
        f"At rest samples scatter by {still} mm along the tracker's axes: "
        f"{less} less than the poses are off, so more samples a pose would help little."
    )
    yield (
        f"Distances between poses, which need no registration, err by "
        f"{quantity(reference.distance_error_mean_mm, 'mm')} on average and scatter by "
        f"{quantity(reference.distance_error_sd_mm, 'mm')}; best scale {fit.scale:.5f}."
    )
    if reference.lever_arm is not None:
        yield _lever_arm(reference.lever_arm, reference)


def _lever_arm(arm: LeverArm, reference: ReferenceResult) -> str:
    parts = ", ".join(
        f"{significant(a)} \N{PLUS-MINUS SIGN} {significant(u, 2)}"
        for a, u in zip(arm.arm_mm, arm.uncertainty_mm, strict=True)
    )
    text = (
        f"The lever arm between marker and reference point ({parts} mm along the body's axes, one "
        f"standard uncertainty) takes the residual from {quantity(reference.fit.rms, 'mm')} to "
        f"{quantity(arm.rms_mm, 'mm')} RMS ({p_phrase(arm.p)}), and the error of poses left out "
        f"from {quantity(reference.left_out_rms_mm, 'mm')} to "
        f"{quantity(arm.left_out_rms_mm, 'mm')}; "
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


def _stages(distance: DistanceResult, alpha: float) -> Table:
    return Table.of(
        "Distance by stage",
        distance.stages,
        {
            "stage": lambda stage: clean(stage.stage),
            "visits": lambda stage: str(stage.visits),
            "samples": lambda stage: f"{stage.samples:,}",
            "independent": lambda stage: f"{stage.independent:.0f}",
            "mean (mm)": lambda stage: significant(stage.mean_mm, 6),
            "SD within (mm)": lambda stage: significant(stage.sd_mm),
            "SD between visits (mm)": lambda stage: significant(stage.between_mm),
            f"{level(alpha)} interval of the mean": lambda stage: (
                MISSING if stage.interval_mm is None else interval(*stage.interval_mm, "", 6)
            ),
        },
        raw=lambda stage: {
            **{name: value for name, value in vars(stage).items() if name != "interval_mm"},
            **dict(zip(("interval_low_mm", "interval_high_mm"),
                       stage.interval_mm or (math.nan, math.nan), strict=True)),
        },
    )  # fmt: skip


def _stops(displacement: DisplacementResult) -> Table:
    return Table.of(
        "Displacement by stop",
        zip(displacement.commanded_mm.tolist(), displacement.measured_mm.tolist(), strict=True),
        {
            "commanded (mm)": lambda pair: f"{pair[0]:.6g}",
            "measured (mm)": lambda pair: f"{pair[1]:.6g}",
            "difference (mm)": lambda pair: significant(pair[1] - pair[0]),
        },
        left=0,
        raw=lambda pair: {"commanded_mm": pair[0], "measured_mm": pair[1]},
    )


def _tracker_poses(reference: ReferenceResult) -> Table:
    columns = ("pose", "x", "y", "z", "residual (mm)", "left out (mm)", "expected TRE (mm)")
    rows, raw = [], []
    for k, pose in enumerate(reference.poses):
        off = reference.fit.residuals[k]
        size = float(np.linalg.norm(off))
        errors = (float(reference.left_out_mm[k]), float(reference.target_error_mm[k]))
        numbers = [*off.tolist(), size, *errors]
        rows.append((clean(pose), *(significant(value) for value in numbers)))
        raw.append({"pose": pose, "residual_mm": size, "left_out_mm": errors[0],
                    "expected_mm": errors[1]})  # fmt: skip
    return Table("Residuals by pose", columns, tuple(rows), raw=tuple(raw))


def write_tracker(accuracy: TrackerAccuracy, out_dir: str | Path) -> Path:
    """Write the page of a tracker: stages, stops and poses."""
    from study.reporting.figures import accuracy_figures

    plots: dict[str, Plot] = {}
    tables = []
    if (distance := accuracy.distance) is not None:
        tables.append(_stages(distance, accuracy.alpha))
        dashed = " Dashed: the standard." if distance.standard else ""
        plots["tracker-distance"] = (
            "Distance by stage",
            lambda: accuracy_figures.distance_points(distance),
            lambda frame: accuracy_figures.draw_distances(frame, distance),
            "Histograms of all samples, a panel a stage. Line: mean over visits." + dashed,
        )
    if (displacement := accuracy.displacement) is not None:
        tables.append(_stops(displacement))
        plots["tracker-displacement"] = (
            "Measured and commanded displacement",
            lambda: accuracy_figures.displacement_points(displacement),
            lambda frame: accuracy_figures.draw_displacement(frame, displacement),
            "Left: every stop and the line with errors in both. Right: differences against means, "
            "bias and limits of agreement (dashed) with their intervals.",
        )
    if (reference := accuracy.reference) is not None:
        tables.append(_tracker_poses(reference))
        plots["tracker-reference"] = (
            "Errors against the reference",
            lambda: accuracy_figures.reference_points(reference),
            accuracy_figures.draw_reference,
            "Left: residuals of the registration over the workspace. Right: what is left at every "
            "pose, and the error of a pose predicted from all others.",
        )
    blocks = answer_blocks(tracker_answers(accuracy), plots, tables, accuracy.notes)
    name, question, document = accuracy.name, accuracy.question, accuracy.to_json()
    return write_answer("tracker accuracy", name, question, blocks, out_dir, document=document)


def write_shape(deviation: ShapeDeviation, out_dir: str | Path) -> Path:
    """Write the page of a scanned surface."""
    from study.reporting.figures import accuracy_figures

    frame = accuracy_figures.deviation_points(deviation)
    plots: dict[str, Plot] = {
        "shape-histogram": (
            "Deviations",
            lambda: frame,
            accuracy_figures.draw_histogram,
            "Signed distances of scanned points. Line: mean; dashed: 5 % and 95 %.",
        ),
        "shape-views": (
            "Deviation over the body",
            lambda: frame,
            accuracy_figures.draw_views,
            "Mean deviation of the points in every hexagon that face the viewer.",
        ),
    }
    warnings = (f"simulated part: {deviation.symmetry}", *deviation.notes)
    blocks = answer_blocks(scan_answers(deviation), plots, scan_tables(deviation), warnings)
    question = f"How far is the simulated surface from {deviation.scan}?"
    name, document = deviation.name, deviation.to_json()
    return write_answer("shape deviation", name, question, blocks, out_dir, document=document)
