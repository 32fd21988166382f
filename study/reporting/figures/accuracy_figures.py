"""Figures of a scanned surface: histogram of deviations, and the body colored by them."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.figure import Figure as Canvas

from study.ground.arrays import Array
from study.laboratory.shape.shape_deviation import ShapeDeviation
from study.laboratory.tracker.tracker_error import (
    DisplacementResult,
    DistanceResult,
    ReferenceResult,
)
from study.reporting.figures import axes as style

#: Points that the CSV beside the page and the figures hold at most.
MOST_POINTS = 50_000

#: Hexagons across a view: 40 show a dent of a fortieth of the body, fewer where points are few.
FEWEST_HEXAGONS = 8
MOST_HEXAGONS = 40

#: Points that a hexagon holds on average.
POINTS_IN_HEXAGON = 4

#: Steps of color: from 50 on the color bar would be a bitmap, which the page does not load.
COLORS = 31

#: Percentile of the sizes at which the colors end, so that one stray point fades no picture.
LAST_COLOR = 98

#: Views: name, axis of sight, its sign, axes to the right and up.
VIEWS = (
    ("from +x", 0, 1, 1, 2),
    ("from +y", 1, 1, 0, 2),
    ("from above", 2, 1, 0, 1),
    ("from -x", 0, -1, 1, 2),
    ("from -y", 1, -1, 0, 2),
    ("from below", 2, -1, 0, 1),
)


def deviation_points(deviation: ShapeDeviation) -> pd.DataFrame:
    """Tabulate registered points with their normals and signed distances, mm."""
    n = len(deviation.distances)
    shown = np.linspace(0, n - 1, min(n, MOST_POINTS)).astype(int)
    frame = pd.DataFrame(deviation.points[shown], columns=["x_mm", "y_mm", "z_mm"])
    frame[["normal_x", "normal_y", "normal_z"]] = deviation.normals[shown]
    frame["deviation_mm"] = deviation.distances[shown]
    return frame


def draw_histogram(frame: pd.DataFrame) -> Canvas:
    """Draw the histogram of signed distances, with mean and middle 90 %."""
    import seaborn as sns

    figure, ax = style.one_panel(2.8)
    sns.histplot(
        frame, x="deviation_mm", bins=60, color=style.color_of(0), alpha=0.8, edgecolor="white",
        linewidth=0.3, ax=ax,
    )  # fmt: skip
    ax.axvline(frame["deviation_mm"].mean(), color=style.INK, linewidth=1.2)
    for value in np.percentile(frame["deviation_mm"], [5, 95]):
        ax.axvline(value, color=style.MUTED, linewidth=1.0, linestyle="--")
    ax.set(xlabel="deviation (mm): scan outside the simulation +", ylabel="points")
    return figure


def draw_views(frame: pd.DataFrame) -> Canvas:
    """Draw the body from six sides, colored by the mean deviation of every hexagon."""
    colors = colormaps["RdBu_r"].resampled(COLORS)
    figure = style.canvas(6.4)
    panels = figure.subplots(2, 3).ravel()
    places = frame[["x_mm", "y_mm", "z_mm"]].to_numpy()
    normals = frame[["normal_x", "normal_y", "normal_z"]].to_numpy()
    deviation = frame["deviation_mm"].to_numpy()
    end = max(float(np.percentile(np.abs(deviation), LAST_COLOR)), 1e-300)
    drawn = None
    for ax, (title, sight, sign, right, up) in zip(panels, VIEWS, strict=True):
        facing = sign * normals[:, sight] > 0
        ax.set(title=title, aspect="equal", adjustable="datalim")
        ax.set_axis_off()
        if not facing.any():
            ax.text(0.5, 0.5, "not scanned", transform=ax.transAxes, ha="center", color=style.MUTED)
            continue
        drawn = ax.hexbin(
            places[facing, right], places[facing, up], deviation[facing],
            gridsize=_hexagons(places[facing][:, [right, up]]),
            cmap=colors, vmin=-end, vmax=end, linewidths=0.1, edgecolors="face",
        )  # fmt: skip
        if sign * (1 if sight != 1 else -1) < 0:
            ax.invert_xaxis()  # seen from the other side, right is left
    if drawn is not None:
        figure.colorbar(drawn, ax=list(panels), label="deviation (mm)", shrink=0.6)
    return figure


def _hexagons(places: Array) -> tuple[int, int]:
    """Count the regular hexagons to the right and up that hold a few points each."""
    wide, high = np.maximum(np.ptp(places, axis=0), 1e-300)
    across = np.sqrt(len(places) / POINTS_IN_HEXAGON * wide / high)
    count = int(np.clip(across, FEWEST_HEXAGONS, MOST_HEXAGONS))
    # a view of a line has no width, and no more of them than points
    return count, int(np.clip(count * high / wide / np.sqrt(3), 2, max(len(places), 2)))


# Figures of a tracker: distances by stage, differences from the stage, errors by pose.

#: Classes of a histogram: thirty show the shape of a thousand samples and more.
CLASSES = 30

#: Stages that have a panel; the table has them all.
MOST_STAGES = 12

#: Length of the longest arrow of a residual over the extent of the poses.
LONGEST_ARROW = 0.15


def distance_points(distance: DistanceResult) -> pd.DataFrame:
    """Histogram of the distances of every stage: classes in mm, counts."""
    edges = np.histogram_bin_edges(distance.samples_mm, CLASSES)
    stages = np.array(distance.sample_stage, dtype=object)
    parts = []
    for stage in dict.fromkeys(distance.sample_stage):
        counts, _ = np.histogram(distance.samples_mm[stages == stage], edges)
        parts.append(
            pd.DataFrame(
                {"stage": stage, "low_mm": edges[:-1], "high_mm": edges[1:], "samples": counts}
            )
        )
    return pd.concat(parts, ignore_index=True)


def draw_distances(frame: pd.DataFrame, distance: DistanceResult) -> Canvas:
    """Draw a histogram a stage on one axis, with mean and standard."""
    import seaborn as sns

    stages = list(dict.fromkeys(frame["stage"]))[:MOST_STAGES]
    figure = style.canvas(0.6 + 1.0 * len(stages))
    axes = np.atleast_1d(figure.subplots(len(stages), 1, sharex=True))
    edges = [*frame["low_mm"].unique(), frame["high_mm"].max()]
    means = {stage.stage: stage.mean_mm for stage in distance.stages}
    for k, (ax, stage) in enumerate(zip(axes, stages, strict=True)):
        rows = frame[frame["stage"] == stage]
        middles = (rows["low_mm"] + rows["high_mm"]) / 2
        sns.histplot(
            x=middles, weights=rows["samples"], bins=edges, color=style.color_of(k), alpha=0.8,
            edgecolor="white", linewidth=0.4, ax=ax,
        )  # fmt: skip
        ax.axvline(means[stage], color=style.INK, linewidth=1.0)
        if distance.standard is not None:
            ax.axvline(
                distance.standard.distance_mm, color=style.MUTED, linewidth=1.0, linestyle="--"
            )
        ax.set(title=style.wrap(stage, 60), xlabel="", ylabel="samples")
    axes[-1].set_xlabel("distance between the markers (mm)")
    return figure


def displacement_points(displacement: DisplacementResult) -> pd.DataFrame:
    """Commanded and measured displacement of every stop, their mean and difference, mm."""
    return pd.DataFrame({
        "commanded_mm": displacement.commanded_mm,
        "measured_mm": displacement.measured_mm,
        "mean_mm": (displacement.commanded_mm + displacement.measured_mm) / 2,
        "difference_mm": displacement.measured_mm - displacement.commanded_mm,
    })  # fmt: skip


def draw_displacement(frame: pd.DataFrame, displacement: DisplacementResult) -> Canvas:
    """Draw measured on commanded displacement, and their differences with limits of agreement."""
    import seaborn as sns

    figure = style.canvas(3.4)
    line, limits = figure.subplots(1, 2)
    sns.scatterplot(
        frame, x="commanded_mm", y="measured_mm", s=16, color=style.color_of(0), ax=line
    )
    ends = np.array([0.0, frame["commanded_mm"].max()])
    ends[0] = min(0.0, frame["commanded_mm"].min())
    line.plot(
        ends,
        displacement.line.offset + displacement.line.scale * ends,
        color=style.MUTED,
        linewidth=1.0,
    )
    line.set(xlabel="commanded (mm)", ylabel="measured (mm)", title="regression")
    agreement = displacement.agreement
    for low, high in (agreement.lower_interval, agreement.upper_interval):
        limits.axhspan(low, high, color=style.BAND, linewidth=0)
    for value, dashes in ((agreement.bias, "-"), (agreement.lower, "--"), (agreement.upper, "--")):
        limits.axhline(value, color=style.MUTED, linewidth=1.0, linestyle=dashes)
    sns.scatterplot(frame, x="mean_mm", y="difference_mm", s=16, color=style.color_of(0), ax=limits)
    limits.set(xlabel="mean of both (mm)", ylabel="measured - commanded (mm)", title="agreement")
    return figure


def reference_points(reference: ReferenceResult) -> pd.DataFrame:
    """Every pose in the reference's frame with its residual and errors, mm."""
    placed = reference.fit.motion(reference.positions_mm)
    columns = {"pose": list(reference.poses)}
    frame = pd.DataFrame(columns)
    for k, axis in enumerate("xyz"):
        frame[f"{axis}_mm"] = placed[:, k]
        frame[f"residual_{axis}_mm"] = reference.fit.residuals[:, k]
    frame["residual_mm"] = np.linalg.norm(reference.fit.residuals, axis=1)
    frame["left_out_mm"] = reference.left_out_mm
    frame["expected_mm"] = reference.target_error_mm
    return frame


def draw_reference(frame: pd.DataFrame) -> Canvas:
    """Draw residuals over the workspace, and errors pose by pose."""
    import seaborn as sns

    figure = style.canvas(3.6)
    where, errors = figure.subplots(1, 2)
    spread = {axis: float(np.ptp(frame[f"{axis}_mm"])) for axis in "xyz"}
    first, second = sorted(sorted(spread, key=lambda a: -spread[a])[:2])
    longest = float(np.hypot(frame[f"residual_{first}_mm"], frame[f"residual_{second}_mm"]).max())
    factor = LONGEST_ARROW * max(spread.values()) / max(longest, 1e-300)
    where.quiver(
        frame[f"{first}_mm"], frame[f"{second}_mm"],
        factor * frame[f"residual_{first}_mm"], factor * frame[f"residual_{second}_mm"],
        angles="xy", scale_units="xy", scale=1, color=style.color_of(1), width=0.004,
    )  # fmt: skip
    where.plot(
        frame[f"{first}_mm"], frame[f"{second}_mm"], "o", markersize=3, color=style.color_of(0)
    )
    where.set(
        xlabel=f"{first} (mm)", ylabel=f"{second} (mm)", title=f"residuals, {factor:.3g} times",
        aspect="equal", adjustable="datalim",
    )  # fmt: skip
    long = frame.melt("pose", ["residual_mm", "left_out_mm"], "kind", "error")
    long["kind"] = long["kind"].map(
        {"residual_mm": "left by the registration", "left_out_mm": "predicted from the others"}
    )
    sns.pointplot(
        long, x="pose", y="error", hue="kind", palette=[style.color_of(0), style.color_of(1)],
        linestyle="none", errorbar=None, markersize=4, dodge=0.2, ax=errors,
    )  # fmt: skip
    errors.set(xlabel="pose", ylabel="error (mm)", title="errors by pose")
    errors.set_ylim(bottom=0)
    errors.legend(title="")
    return figure
