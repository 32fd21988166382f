"""Pages of accuracy: a tracker against its references, a surface against a scan."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study.laboratory.registration.iterative_closest_point import Registration
from study.laboratory.shape.shape_deviation import MarkerDeviation, ShapeDeviation
from study.laboratory.tracker.tracker_error import (
    DisplacementResult,
    DistanceResult,
    StageDistance,
    TrackerAccuracy,
)
from study.laboratory.tracker.tracker_reference import LeverArm, ReferenceResult
from study.reporting.content.content_table import Table
from study.reporting.content.numbers import (
    MISSING,
    interval,
    level,
    p_phrase,
    quantity,
    share,
    significant,
)
from study.reporting.content.text import clean, count
from study.reporting.figures import accuracy_figures
from study.reporting.figures.registry import Drawn, Figure, make, slug
from study.reporting.output import write
from study.reporting.output.page import _environment, data_folder, replace_file

if TYPE_CHECKING:
    import pandas as pd


# What a report says of a scanned surface: its answers in sentences, and its tables.


def scan_answers(found: ShapeDeviation) -> list[str]:
    """Say in a few sentences what was found.

    Units: found mm.
    """
    s = found.statistics
    lines = [
        f"The scan lies {quantity(s.mean_absolute, 'mm')} from the simulated surface on average "
        f"(RMS {quantity(s.rms, 'mm')}, 95 % within {quantity(s.absolute_p95, 'mm')}, at worst "
        f"{quantity(s.largest, 'mm')}), with its sign {quantity(s.mean, 'mm')}: positive where "
        "the real body is the larger one.",
        f"{count(s.points, 'point')} of {found.scan} show {share(found.seen)} of the surface; "
        f"{count(found.outliers, 'isolated point')} left out.",
    ]
    if s.largest_set_aside is not None:
        lines.append(
            f"{count(s.set_aside, 'point')} without weight in the registration, up to "
            f"{quantity(s.largest_set_aside, 'mm')} away, set aside in these figures: look at them "
            "in the picture, for a part that is missing or dented is among them too."
        )
    if found.registration is not None:
        lines += _registration(found.registration, found.registration_uncertainty or 0.0)
    if found.markers is not None:
        lines += _markers(found.markers)
    return [clean(line) for line in lines]


def _registration(found: Registration, added: float) -> Iterator[str]:
    shift = float(np.linalg.norm(found.motion(found.motion.inverse(found.center[None]))[0]
                                 - found.motion.inverse(found.center[None])[0]))  # fmt: skip
    yield (
        f"Registered by closest points: moved by {quantity(shift, 'mm')} and turned by "
        f"{significant(found.motion.angle_deg)} deg; residual {quantity(found.rms_mm, 'mm')} RMS, "
        f"{found.rejected:,} of {found.used:,} points without weight. The registration is known "
        f"to {quantity(added, 'mm', 2)} (one standard uncertainty, RMS over the points)."
    )
    if found.sliding:
        listed = "; ".join(str(one) for one in found.sliding)
        yield f"The shape does not fix: {listed}. The scan was not moved along it."
    else:
        yield "The shape fixes all six motions."


def _markers(found: MarkerDeviation) -> Iterator[str]:
    what = "their simulated places" if found.paired else "the simulated surface"
    sizes = found.sizes
    text = (
        f"{count(len(sizes), 'marker')} are {quantity(found.mean, 'mm')} from {what} on average, "
        f"{quantity(found.rms, 'mm')} RMS, {quantity(float(sizes.max()), 'mm')} at worst"
    )
    if found.moved is not None:
        inside = np.isfinite(found.errors).all(axis=1)
        moved = float(np.sqrt((found.moved[inside] ** 2).mean()))
        text += f"; they moved by {quantity(moved, 'mm')} RMS"
    yield f"{text}."
    if found.outside:
        yield f"{count(found.outside, 'marker')} outside the simulated body had no place in it."


def scan_tables(found: ShapeDeviation) -> list[Table]:
    """Statistics of the deviation, and markers.

    Units: found mm.
    """
    s = found.statistics
    values = {
        "mean": s.mean, "mean of sizes": s.mean_absolute, "RMS": s.rms, "SD": s.sd,
        "largest": s.largest, "95 % of sizes": s.absolute_p95,
        **({} if s.largest_set_aside is None else {"largest set aside": s.largest_set_aside}),
        **{f"percentile {name[1:]}": value for name, value in s.percentiles.items()},
    }  # fmt: skip
    rows = tuple((name, significant(value)) for name, value in values.items())
    raw = tuple({"statistic": name, "mm": value} for name, value in values.items())
    made = [Table("Deviation of the scan", ("statistic", "mm"), rows, raw=raw)]
    if found.markers is not None:
        made.append(_marker_table(found.markers))
    return made


def _marker_table(found: MarkerDeviation) -> Table:
    rows, raw = [], []
    for name, error in zip(found.names, found.errors.tolist(), strict=True):
        size = float(np.linalg.norm(error))
        rows.append((clean(name), *(significant(value) for value in (*error, size))))
        raw.append({"marker": name, "x_mm": error[0], "y_mm": error[1], "z_mm": error[2],
                    "size_mm": size})  # fmt: skip
    columns = ("marker", "x (mm)", "y (mm)", "z (mm)", "size (mm)")
    return Table("Measured less simulated place of markers", columns, tuple(rows), raw=tuple(raw))


# What a report says of a tracker: its answers in sentences, and its tables.


def tracker_answers(found: TrackerAccuracy) -> list[str]:
    """Say in a few sentences what was found.

    Units: found mm.
    """
    lines = [f"{count(found.samples, 'sample')} of {count(found.markers, 'marker')}."]
    if found.distance is not None:
        lines += _tracker_distance(found.distance, found.alpha)
    if found.displacement is not None:
        lines += _tracker_displacement(found.displacement, found.alpha)
    if found.reference is not None:
        lines += _reference(found.reference)
    return [clean(line) for line in lines]


def _tracker_distance(found: DistanceResult, alpha: float) -> Iterator[str]:
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


def _tracker_displacement(found: DisplacementResult, alpha: float) -> Iterator[str]:
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


def tracker_tables(found: TrackerAccuracy) -> list[Table]:
    """Stages, stops and poses.

    Units: found mm.
    """
    made = []
    if found.distance is not None:
        made.append(_stages(found.distance, found.alpha))
    if found.displacement is not None:
        made.append(_stops(found.displacement))
    if found.reference is not None:
        made.append(_tracker_poses(found.reference))
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


def _tracker_poses(found: ReferenceResult) -> Table:
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


@dataclass(frozen=True)
class AccuracyPage:
    """A page before it is drawn."""

    #: Kind of the page, its title, what was asked.
    kicker: str
    name: str
    question: str
    answer: Sequence[str]
    figures: Sequence[Figure]
    tables: Sequence[Table]
    warnings: Sequence[str]
    #: What ``--json`` prints; written beside the page.
    document: Mapping[str, object]


def write_accuracy(page: AccuracyPage, out_dir: str | Path) -> Path:
    """Write a page, with the data of its figures and tables beside it."""
    folder, stem = Path(out_dir), f"{slug(page.name)}-{slug(page.kicker)}"
    beside = data_folder(folder, stem)
    for figure in page.figures:
        if figure.data is not None:
            replace_file(beside / f"figure-{figure.name}.csv", write.of_frame(figure.data))
    for table in page.tables:
        replace_file(beside / f"table-{slug(table.name)}.csv", write.of_records(table.raw))
    numbers = json.dumps(page.document, indent=1, allow_nan=False)
    replace_file(beside / "numbers.json", numbers + "\n")
    text = _environment().get_template("accuracy.html.j2").render(
        kicker=page.kicker, name=clean(page.name), question=clean(page.question),
        answer=page.answer, figures=page.figures, tables=page.tables,
        warnings=[clean(line) for line in page.warnings],
    )  # fmt: skip
    replace_file(folder / f"{stem}.html", clean(text))
    return folder / f"{stem}.html"


def tracker_page(found: TrackerAccuracy) -> AccuracyPage:
    """Page of a tracker.

    Units: found mm.
    """
    figures = []
    if (distance := found.distance) is not None:
        figures.append(
            make("tracker-distance", "Distance by stage", lambda: _page_distance(distance))
        )
    if (displacement := found.displacement) is not None:
        figures.append(
            make(
                "tracker-displacement",
                "Measured and commanded displacement",
                lambda: _page_displacement(displacement),
            )
        )
    if (reference := found.reference) is not None:
        figures.append(
            make(
                "tracker-reference", "Errors against the reference", lambda: _page_poses(reference)
            )
        )
    return AccuracyPage(
        kicker="Tracker accuracy",
        name=found.name,
        question=found.question,
        answer=tracker_answers(found),
        figures=figures,
        tables=tracker_tables(found),
        warnings=found.notes,
        document=found.to_json(),
    )


def _page_distance(found: DistanceResult) -> Drawn:
    frame = accuracy_figures.distance_points(found)
    dashed = " Dashed: the standard." if found.standard else ""
    caption = f"Histograms of all samples, a panel a stage. Line: mean over visits.{dashed}"
    return frame, lambda: accuracy_figures.draw_distances(frame, found), caption


def _page_displacement(found: DisplacementResult) -> Drawn:
    frame = accuracy_figures.displacement_points(found)
    caption = (
        "Left: every stop and the line with errors in both. Right: differences against means, "
        "bias and limits of agreement (dashed) with their intervals."
    )
    return frame, lambda: accuracy_figures.draw_displacement(frame, found), caption


def _page_poses(found: ReferenceResult) -> Drawn:
    frame = accuracy_figures.reference_points(found)
    caption = (
        "Left: residuals of the registration over the workspace. Right: what is left at every "
        "pose, and the error of a pose predicted from all others."
    )
    return frame, lambda: accuracy_figures.draw_reference(frame, found), caption


def shape_page(found: ShapeDeviation) -> AccuracyPage:
    """Page of a scanned surface.

    Units: found mm.
    """
    frame = accuracy_figures.deviation_points(found)
    return AccuracyPage(
        kicker="Shape deviation",
        name=found.name,
        question=f"How far is the simulated surface from {found.scan}?",
        answer=scan_answers(found),
        figures=[
            make("shape-histogram", "Deviations", lambda: _histogram(frame)),
            make("shape-views", "Deviation over the body", lambda: _views(frame)),
        ],
        tables=scan_tables(found),
        warnings=(f"simulated part: {found.symmetry}", *found.notes),
        document=found.to_json(),
    )


def _histogram(frame: pd.DataFrame) -> Drawn:
    caption = "Signed distances of scanned points. Line: mean; dashed: 5 % and 95 %."
    return frame, lambda: accuracy_figures.draw_histogram(frame), caption


def _views(frame: pd.DataFrame) -> Drawn:
    caption = "Mean deviation of the points in every hexagon that face the viewer."
    return frame, lambda: accuracy_figures.draw_views(frame), caption
