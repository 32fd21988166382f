"""Pages of instruments: trackers, scans, force laws, sensors: answer, figures, tables."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study.ground.units import times
from study.laboratory.haptics.haptic_export import ConstantRange, ForceLaw
from study.laboratory.registration.iterative_closest_point import Registration
from study.laboratory.sensors.requirement import MULTIPLES, SensorRequirement, percent, size
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
    sentence,
    share,
    significant,
)
from study.reporting.figures import axes as style
from study.reporting.figures.axes import Plot
from study.reporting.output.write import answer_blocks, write_answer
from study.statistics.analysis.analysis_result import AnalysisResult

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure as Canvas


def scan_answers(deviation: ShapeDeviation) -> Iterator[str]:
    """Say in a few sentences what was found."""
    s, registration = deviation.statistics, deviation.registration
    yield (
        f"The scan lies {quantity(s.mean_absolute, 'mm')} from the simulated surface on average "
        f"(RMS {quantity(s.rms, 'mm')}, 95 % within {quantity(s.absolute_p95, 'mm')}, at worst "
        f"{quantity(s.largest, 'mm')}), with its sign {quantity(s.mean, 'mm')}: positive where "
        "the real body is the larger one."
    )
    yield (
        f"{count(s.points, 'point')} of {deviation.scan} show {share(deviation.seen)} of the "
        f"surface; {count(deviation.outliers, 'isolated point')} left out."
    )
    if s.largest_set_aside is not None:
        yield (
            f"{count(s.set_aside, 'point')} without weight in the registration, up to "
            f"{quantity(s.largest_set_aside, 'mm')} away, set aside in these figures: look at them "
            "in the picture, for a part that is missing or dented is among them too."
        )
    if registration is not None:
        yield from _registration(registration, deviation.registration_uncertainty or 0.0)
    if deviation.markers is not None:
        yield from _markers(deviation.markers)


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


def tracker_answers(accuracy: TrackerAccuracy) -> Iterator[str]:
    """Say in a few sentences what was found."""
    if accuracy.distance is not None:
        yield from _tracker_distance(accuracy.distance, accuracy.alpha)
    if accuracy.displacement is not None:
        yield from _tracker_displacement(accuracy.displacement, accuracy.alpha)
    if accuracy.reference is not None:
        yield from _reference(accuracy.reference)
    yield f"{count(accuracy.samples, 'sample')} of {count(accuracy.markers, 'marker')}."


def _tracker_distance(distance: DistanceResult, alpha: float) -> Iterator[str]:
    compared = distance.comparison
    effects = compared.effects if isinstance(compared, AnalysisResult) else ()
    for effect in effects[:1]:
        text = f"Stages differ by up to {quantity(effect.range, 'mm')} ({p_phrase(effect.p)})"
        yield f"{text}; verdict: {effect.verdict}. {sentence(distance.comparison_note)}"
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
    if not effects:
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
    less = times(ratio, 2) if np.isfinite(ratio) else "far"
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
    axes = list(zip("xyz", arm.arm_mm, arm.uncertainty_mm, strict=True))
    sizes = (f"{significant(a)} \N{PLUS-MINUS SIGN} {significant(u, 2)}" for _, a, u in axes)
    text = (
        f"The lever arm between marker and reference point ({', '.join(sizes)} mm along the "
        "body's axes, one standard uncertainty) takes the residual from "
        f"{quantity(reference.fit.rms, 'mm')} to {quantity(arm.rms_mm, 'mm')} RMS "
        f"({p_phrase(arm.p)}), and the error of poses left out "
        f"from {quantity(reference.left_out_rms_mm, 'mm')} to "
        f"{quantity(arm.left_out_rms_mm, 'mm')}; "
        f"the body turned by {significant(arm.turned_deg, 2)} deg RMS."
    )
    if untold := [axis for axis, a, u in axes if abs(a) < 2 * u]:
        text += f" The body turned too little to tell the arm along {', '.join(untold)}."
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


# A force law, and what sensors must be.


def write_force_law(
    law: ForceLaw, question: str, out_dir: str | Path, warnings: tuple[str, ...] = ()
) -> Path:
    """Write the page of a force law."""
    plots: dict[str, Plot] = {
        "force-law": (
            "Force, stiffness, sensitivity",
            lambda: law_points(law),
            lambda frame: draw_law(frame, law.displacement_mm),
            "Force, its slope, and how a tenth of each constant changes the force; dots are the "
            "knots, dashes the continuations that no simulation says.",
        ),
        "force-law-deviation": (
            "Distance from the simulation",
            lambda: deviation_points(law),
            draw_deviation,
            "At points between the knots that were solved and kept out; the band is the error "
            f"bound of {law.held_out.bound_N:.2g} N."
            + " What the calibration leaves open comes on top."
            * (law.covariance is not None),
        ),
    }
    blocks = answer_blocks(law.sentences(), plots, [constants(law)], warnings)
    return write_answer("force law", law.name, question, blocks, out_dir)


def constants(law: ForceLaw) -> Table:
    """Constants of the table, their range and what first order leaves out there."""

    def shown(of: ConstantRange, *values: float) -> str:
        factor, unit = (1e3, " kPa") if of.unit else (1.0, "")
        return " to ".join(significant(factor * value, 4) for value in values) + unit

    return Table.of(
        "Constants",
        law.ranges,
        {
            "constant": lambda of: of.name,
            "of the table": lambda of: shown(of, law.constants[of.name]),
            "range that was solved": lambda of: shown(of, of.low, of.high),
            "largest deviation": lambda of: (
                MISSING if math.isnan(of.largest_N) else f"{significant(of.largest_N)} N"
            ),
        },
        note="One constant is moved at a time, to both ends of its range.",
        raw=lambda of: {
            "constant": of.name, "value": law.constants[of.name], "low": of.low, "high": of.high,
            "unit": of.unit,
            "largest_N": None if math.isnan(of.largest_N) else of.largest_N,
        },
    )  # fmt: skip


def write_requirement(sensors: SensorRequirement, out_dir: str | Path) -> Path:
    """Write the page of sensor requirements."""
    tables = [errors(sensors), quantities(sensors)]
    if any(simulation.scatters for simulation in sensors.simulations):
        tables.append(simulations(sensors))
    limit = 100 * sensors.accuracy
    plots: dict[str, Plot] = {
        "requirement-map": (
            "Position against force accuracy",
            lambda: map_points(sensors),
            lambda frame: draw_map(frame, limit),
            f"Expanded uncertainty (k = {sensors.coverage:g}) with all errors of a sensor so many "
            f"times as large as given; in the green region it is {limit:g} % or less. To first "
            "order.",
        ),
        "requirement-parts": (
            "What each error adds",
            lambda: part_points(sensors),
            draw_parts,
            "Standard uncertainty by each error alone; their squares add up.",
        ),
    }
    blocks = answer_blocks(sensors.sentences(), plots, tables, warnings(sensors))
    question = sensors.question or "How accurate must the sensors be?"
    kind = "sensor requirements"
    return write_answer(kind, sensors.name, question, blocks, out_dir, stem="requirement")


def warnings(sensors: SensorRequirement) -> list[str]:
    """Say where the answer, which is of first order, must not be trusted."""
    return [clean(note) for note in sensors.notes] + [
        f"At {simulation.multiple:g} \N{MULTIPLICATION SIGN} the given errors first order does not "
        "hold: take scatter and shift of the simulated tests there, not the map."
        for simulation in sensors.simulations
        if not simulation.is_linear
    ]


def errors(sensors: SensorRequirement) -> Table:
    """Every error: as given, and as large as it may be."""
    limit = percent(sensors.accuracy)
    note = (
        f"For {limit} (k = {sensors.coverage:g}) of every constant: alone, with all other errors "
        "zero; beside the others as given (none: they are too large already)."
    )
    every = [(s, *sensors.allowed(k)) for k, s in enumerate(sensors.propagation.sources)]
    return Table.of(
        "Errors",
        every,
        {
            "sensor": lambda of: of[0].sensor,
            "error": lambda of: of[0].name,
            "given": lambda of: size(of[0], of[0].given),
            "allowed alone": lambda of: size(of[0], of[1]),
            "allowed beside the others": lambda of: size(of[0], of[2]),
        },
        left=2,
        note=note,
        raw=lambda of: {
            "sensor": of[0].sensor, "error": of[0].name, "unit": of[0].unit or "1",
            "given": of[0].given, "allowed_alone": of[1], "allowed_beside": of[2],
        },
    )  # fmt: skip


def quantities(sensors: SensorRequirement) -> Table:
    """Constants and predicted force with their uncertainties."""
    rows, raw = [], []
    for item in sensors.quantities:
        factor, unit = (1e3, "kPa") if item.unit == "MPa" else (1.0, item.unit)
        value = f"{significant(factor * item.value, 4)} {unit}".strip()
        rows.append(
            (item.name, value, percent(item.relative), percent(sensors.coverage * item.relative))
        )
        raw.append({
            "quantity": item.name, "value": factor * item.value, "unit": unit,
            "relative_standard_uncertainty": item.relative,
        })  # fmt: skip
    columns = ("quantity", "value", "standard uncertainty", f"expanded (k = {sensors.coverage:g})")
    return Table("Quantities", columns, tuple(rows), 1, raw=tuple(raw))


def simulations(sensors: SensorRequirement) -> Table:
    """Scatter in simulated tests beside that of first order."""
    return Table.of(
        "Simulated tests",
        [(run, s) for run in sensors.simulations for s in run.scatters],
        {
            "multiple": lambda of: f"{of[0].multiple:g}",
            "quantity": lambda of: of[1].name,
            "scatter over first order": lambda of: f"{of[1].ratio:.3f}",
            "\N{PLUS-MINUS SIGN} (95 %)": lambda of: f"{2 * of[1].ratio_error:.3f}",
            "shift of the mean": lambda of: f"{of[1].bias:+.2f}".replace("-", "\N{MINUS SIGN}"),
            "verdict": lambda of: f"first order {'holds' if of[1].is_linear else 'fails'}",
        },
        left=2,
        tail=1,
        note="Shift in standard deviations.",
        raw=lambda of: {
            "multiple": of[0].multiple, "samples": of[0].samples, "failed": of[0].failed,
            **vars(of[1]),
        },
    )  # fmt: skip


#: Points of the drawn line.
POINTS = 241
#: How far the continuations are drawn, over the tested range.
BEYOND = 0.12
#: Gradients are drawn as the change of the force by this share of each constant.
SHARE = 0.1


def law_points(law: ForceLaw) -> pd.DataFrame:
    """Force, stiffness and changes by the constants, a row for each displacement."""
    import pandas as pd

    end = law.force.end_mm
    d = np.unique(np.r_[np.linspace(-BEYOND * end, (1 + BEYOND) * end, POINTS), 0.0, end])
    columns = {
        "displacement_mm": d,
        "force_N": law.force_at(d),
        "stiffness_N_per_mm": law.stiffness_at(d),
        "tested": law.is_tested(d),
    }
    for name, value in law.constants.items():
        columns[f"change_by_{name}_N"] = SHARE * abs(value) * law.gradients[name].at(d)
    return pd.DataFrame(columns)


def draw_law(frame: pd.DataFrame, knots_mm: np.ndarray) -> Canvas:
    """Draw force and stiffness with their knots; continuations are dashed.

    Shapes: knots_mm (n,).
    """
    figure = style.canvas(3.2)
    axes = figure.subplots(1, 3)
    d = frame["displacement_mm"].to_numpy(float)
    tested = frame["tested"].to_numpy(bool)
    columns = ("force_N", "stiffness_N_per_mm")
    for ax, column, label in zip(axes, columns, ("force (N)", "stiffness (N/mm)"), strict=False):
        y = frame[column].to_numpy(float)
        ax.plot(d[tested], y[tested], color=style.color_of(0))
        for outside in (d <= 0, d >= d[tested].max()):
            ax.plot(d[outside], y[outside], color=style.MUTED, linestyle=(0, (3, 2)))
        ax.plot(knots_mm, np.interp(knots_mm, d, y), "o", color=style.INK, markersize=2.5)
        ax.set_ylabel(label)
    for k, name in enumerate(c for c in frame.columns if c.startswith("change_by_")):
        label = name.removeprefix("change_by_").removesuffix("_N")
        y = frame[name].to_numpy(float)
        axes[2].plot(d[tested], y[tested], color=style.color_of(k + 1), label=label)
    axes[2].set_ylabel(f"change by {100 * SHARE:g} % of a constant (N)")
    axes[2].legend(loc="upper left")
    for ax in axes:
        ax.axhline(0, color=style.RULE, linewidth=0.6, zorder=0)
        ax.set_xlabel("displacement (mm)")
    return figure


def deviation_points(law: ForceLaw) -> pd.DataFrame:
    """One row for each point that was kept out of the law."""
    import pandas as pd

    held = law.held_out
    return pd.DataFrame(
        {
            "displacement_mm": held.displacement_mm,
            "simulated_N": held.force_N,
            "deviation_N": held.deviation_N,
            "error_bound_N": held.bound_N,
        }
    )


def draw_deviation(frame: pd.DataFrame) -> Canvas:
    """Draw the law less the simulation at the points kept out, within the error bound."""
    figure, ax = style.one_panel(2.2)
    d, off = frame["displacement_mm"].to_numpy(float), frame["deviation_N"].to_numpy(float)
    bound = float(frame["error_bound_N"].max())
    ax.axhspan(-bound, bound, color=style.BAND)
    ax.axhline(0, color=style.RULE, linewidth=0.6)
    ax.vlines(d, 0, off, color=style.color_of(0), linewidth=1.0)
    ax.plot(d, off, "o", color=style.color_of(0), markersize=3.5)
    ax.set_xlabel("displacement (mm)")
    ax.set_ylabel("law less simulation (N)")
    return figure


#: Lines of equal uncertainty, percent.
LEVELS = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)


def map_points(sensors: SensorRequirement) -> pd.DataFrame:
    """Largest uncertainty of a constant and that of the force, a row for each pair of multiples."""
    import pandas as pd

    position, force = (axis.ravel() for axis in np.meshgrid(MULTIPLES, MULTIPLES))
    predicted = sensors.coverage * sensors.propagation.force.at_multiples(position, force)
    return pd.DataFrame(
        {
            "position_multiple": position,
            "force_multiple": force,
            "constants_percent": 100 * sensors.worst_at(position, force),
            "predicted_force_percent": 100 * predicted,
        }
    )


def draw_map(frame: pd.DataFrame, wanted_percent: float) -> Canvas:
    """Draw lines of equal uncertainty over the errors of both sensors, for constants and force."""
    figure = style.canvas(4.0)
    axes = figure.subplots(1, 2, sharey=True)
    n = MULTIPLES.size
    x, y = (frame[c].to_numpy(float).reshape(n, n) for c in ("position_multiple", "force_multiple"))
    panels = (("constants_percent", "worst constant"), ("predicted_force_percent", "force"))
    for ax, (column, title) in zip(axes, panels, strict=True):
        z = frame[column].to_numpy(float).reshape(n, n)
        # before the lines: their labels are placed where they are seen
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.contourf(x, y, z, [0, wanted_percent], colors=[style.color_of(2)], alpha=0.15)
        other = [level for level in LEVELS if abs(level / wanted_percent - 1) > 0.01]
        levels = [level for level in other if z.min() < level < z.max()]
        lines = ax.contour(x, y, z, levels, colors=[style.MUTED], linewidths=0.8)
        ax.clabel(lines, fmt=lambda level: f"{level:g} %", fontsize=7.5)
        limit = ax.contour(x, y, z, [wanted_percent], colors=[style.color_of(2)], linewidths=2.0)
        ax.clabel(limit, fmt=lambda level: f"{level:g} %", fontsize=7.5)
        ax.plot([1], [1], "o", color=style.INK, markersize=5)
        style.note(ax, "as given", (1, 1), (6, 5))
        style.log_ticks(ax)
        ax.set_title(title)
        ax.set_xlabel("position errors, multiple of those given")
    axes[0].set_ylabel("force errors, multiple of those given")
    return figure


def part_points(sensors: SensorRequirement) -> pd.DataFrame:
    """Relative standard uncertainty of every quantity by every error."""
    import pandas as pd

    return pd.DataFrame(
        [
            {
                "quantity": quantity_of.name,
                "error": f"{s.sensor}: {s.name}",
                "percent": 100 * float(part),
            }
            for quantity_of in sensors.quantities
            for s, part in zip(sensors.propagation.sources, quantity_of.parts, strict=True)
        ]
    )


def draw_parts(frame: pd.DataFrame) -> Canvas:
    """Draw a group of bars for each error, a bar for each quantity."""
    import seaborn as sns

    bars, names = len(frame), list(dict.fromkeys(frame["quantity"]))
    figure, ax = style.one_panel(0.8 + 0.22 * bars * (1 + 0.6 / len(names)))
    colors = [style.color_of(k) for k in range(len(names))]
    sns.barplot(frame, x="percent", y="error", hue="quantity", palette=colors, saturation=1, ax=ax)
    ax.set(xlabel="standard uncertainty, percent of the value", ylabel="")
    ax.legend(loc="lower right")
    return figure
