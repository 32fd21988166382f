"""Figures of a force law: force over displacement, and its distance from the simulation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from study.laboratory.haptics.tabulated_force import ForceLaw
from study.laboratory.sensors.requirement import MULTIPLES, SensorRequirement
from study.reporting.figures.axes import (
    BAND,
    INK,
    MUTED,
    RULE,
    WIDTH_IN,
    canvas,
    color_of,
    log_ticks,
    plain_ticks,
)

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure as Canvas


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
    figure = canvas(WIDTH_IN, 3.2)
    axes = figure.subplots(1, 3)
    d = frame["displacement_mm"].to_numpy(float)
    tested = frame["tested"].to_numpy(bool)
    columns = ("force_N", "stiffness_N_per_mm")
    for ax, column, label in zip(axes, columns, ("force (N)", "stiffness (N/mm)"), strict=False):
        y = frame[column].to_numpy(float)
        ax.plot(d[tested], y[tested], color=color_of(0))
        for outside in (d <= 0, d >= d[tested].max()):
            ax.plot(d[outside], y[outside], color=MUTED, linestyle=(0, (3, 2)))
        ax.plot(knots_mm, np.interp(knots_mm, d, y), "o", color=INK, markersize=2.5)
        ax.set_ylabel(label)
    for k, name in enumerate(c for c in frame.columns if c.startswith("change_by_")):
        label = name.removeprefix("change_by_").removesuffix("_N")
        y = frame[name].to_numpy(float)
        axes[2].plot(d[tested], y[tested], color=color_of(k + 1), label=label)
    axes[2].set_ylabel(f"change by {100 * SHARE:g} % of a constant (N)")
    axes[2].legend(loc="upper left")
    for ax in axes:
        ax.axhline(0, color=RULE, linewidth=0.6, zorder=0)
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
    figure = canvas(WIDTH_IN, 2.2)
    ax = figure.subplots()
    d, off = frame["displacement_mm"].to_numpy(float), frame["deviation_N"].to_numpy(float)
    bound = float(frame["error_bound_N"].max())
    ax.axhspan(-bound, bound, color=BAND)
    ax.axhline(0, color=RULE, linewidth=0.6)
    ax.vlines(d, 0, off, color=color_of(0), linewidth=1.0)
    ax.plot(d, off, "o", color=color_of(0), markersize=3.5)
    ax.set_xlabel("displacement (mm)")
    ax.set_ylabel("law less simulation (N)")
    return figure


# Figures of sensor requirements: a map of accuracies, and the parts of the variance.

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
    figure = canvas(WIDTH_IN, 4.0)
    axes = figure.subplots(1, 2, sharey=True)
    n = MULTIPLES.size
    x, y = (frame[c].to_numpy(float).reshape(n, n) for c in ("position_multiple", "force_multiple"))
    panels = (("constants_percent", "worst constant"), ("predicted_force_percent", "force"))
    for ax, (column, title) in zip(axes, panels, strict=True):
        z = frame[column].to_numpy(float).reshape(n, n)
        # before the lines: their labels are placed where they are seen
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.contourf(x, y, z, [0, wanted_percent], colors=[color_of(2)], alpha=0.15)
        other = [level for level in LEVELS if abs(level / wanted_percent - 1) > 0.01]
        levels = [level for level in other if z.min() < level < z.max()]
        lines = ax.contour(x, y, z, levels, colors=[MUTED], linewidths=0.8)
        ax.clabel(lines, fmt=lambda level: f"{level:g} %", fontsize=7.5)
        limit = ax.contour(x, y, z, [wanted_percent], colors=[color_of(2)], linewidths=2.0)
        ax.clabel(limit, fmt=lambda level: f"{level:g} %", fontsize=7.5)
        ax.plot([1], [1], "o", color=INK, markersize=5)
        ax.annotate("as given", (1, 1), xytext=(6, 5), textcoords="offset points", fontsize=7.5)
        log_ticks(ax, "x")
        log_ticks(ax, "y")
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
    errors, names = list(dict.fromkeys(frame["error"])), list(dict.fromkeys(frame["quantity"]))
    figure = canvas(WIDTH_IN, 0.8 + 0.22 * len(errors) * (len(names) + 0.6))
    ax = figure.subplots()
    height = 0.8 / len(names)
    for k, name in enumerate(names):
        part = frame[frame["quantity"] == name].set_index("error")["percent"]
        places = np.arange(len(errors)) + (k - (len(names) - 1) / 2) * height
        ax.barh(places, [part[e] for e in errors], height, color=color_of(k), label=name)
    ax.set_yticks(range(len(errors)), errors)
    ax.invert_yaxis()
    ax.set_xlabel("standard uncertainty, percent of the value")
    ax.legend(loc="lower right")
    plain_ticks(ax, "x")
    return figure
