"""Figures of a scanned surface: histogram of deviations, and the body colored by them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from study.arrays import Array
from study.reporting.figure.axes import plain_ticks
from study.reporting.figure.style import INK, MUTED, WIDTH_IN, canvas, color_of
from study.shape_validation.deviation import ShapeDeviation

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure as Canvas

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


def deviation_points(found: ShapeDeviation) -> pd.DataFrame:
    """Tabulate registered points with their normals and signed distances, mm.

    Parameters
    ----------
    found : ShapeDeviation
        Where it has more than ``MOST_POINTS`` points, as many are picked at equal steps.

    Returns
    -------
    DataFrame
        ``x_mm``, ``y_mm``, ``z_mm``, the unit normal ``normal_x``, ``normal_y``, ``normal_z``, and
        ``deviation_mm``, positive where the scan lies outside the simulated surface.
    """
    import pandas as pd

    n = len(found.distances)
    kept = np.linspace(0, n - 1, min(n, MOST_POINTS)).astype(int)
    frame = pd.DataFrame(found.points[kept], columns=["x_mm", "y_mm", "z_mm"])
    frame[["normal_x", "normal_y", "normal_z"]] = found.normals[kept]
    frame["deviation_mm"] = found.distances[kept]
    return frame


def draw_histogram(frame: pd.DataFrame) -> Canvas:
    """Draw the histogram of signed distances, with mean and middle 90 %.

    Parameters
    ----------
    frame : DataFrame
        Of :func:`deviation_points`; only ``deviation_mm`` is read.
    """
    import seaborn as sns

    figure = canvas(WIDTH_IN, 2.8)
    ax = figure.subplots()
    sns.histplot(
        frame, x="deviation_mm", bins=60, color=color_of(0), alpha=0.8, edgecolor="white",
        linewidth=0.3, ax=ax,
    )  # fmt: skip
    ax.axvline(frame["deviation_mm"].mean(), color=INK, linewidth=1.2)
    for value in np.percentile(frame["deviation_mm"], [5, 95]):
        ax.axvline(value, color=MUTED, linewidth=1.0, linestyle="--")
    ax.set(xlabel="deviation (mm): scan outside the simulation +", ylabel="points")
    plain_ticks(ax, "x")
    return figure


def draw_views(frame: pd.DataFrame) -> Canvas:
    """Draw the body from six sides, colored by the mean deviation of every hexagon.

    Parameters
    ----------
    frame : DataFrame
        Of :func:`deviation_points`. A view has the points whose normals face it; a view without
        any says so.
    """
    from matplotlib import colormaps

    colors = colormaps["RdBu_r"].resampled(COLORS)
    figure = canvas(WIDTH_IN, 6.4)
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
            ax.text(0.5, 0.5, "not scanned", transform=ax.transAxes, ha="center", color=MUTED)
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
    return count, max(int(count * high / wide / np.sqrt(3)), 2)
