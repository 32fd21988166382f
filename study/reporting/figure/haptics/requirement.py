"""Figures of sensor requirements: a map of accuracies, and the parts of the variance."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from study.reporting.figure.axes import log_ticks, plain_ticks
from study.reporting.figure.style import INK, MUTED, WIDTH_IN, canvas, color_of
from study.sensors.requirement import MULTIPLES, SensorRequirement

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure as Canvas

#: Lines of equal uncertainty, percent.
LEVELS = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)


def map_points(found: SensorRequirement) -> pd.DataFrame:
    """Largest uncertainty of a constant and that of the force, a row for each pair of multiples.

    Parameters
    ----------
    found : SensorRequirement
        Propagated to first order.

    Returns
    -------
    DataFrame
        ``position_multiple`` and ``force_multiple`` of the given errors; ``constants_percent`` and
        ``predicted_force_percent``, expanded uncertainties over the value in percent.
    """
    import pandas as pd

    position, force = (axis.ravel() for axis in np.meshgrid(MULTIPLES, MULTIPLES))
    predicted = found.coverage * found.propagation.force.at_multiples(position, force)
    return pd.DataFrame(
        {
            "position_multiple": position,
            "force_multiple": force,
            "constants_percent": 100 * found.worst_at(position, force),
            "predicted_force_percent": 100 * predicted,
        }
    )


def draw_map(frame: pd.DataFrame, wanted_percent: float) -> Canvas:
    """Draw lines of equal uncertainty over the errors of both sensors, for constants and force.

    Parameters
    ----------
    frame : DataFrame
        By :func:`map_points`.
    wanted_percent : float
        Wanted expanded uncertainty over the value, percent; where it is met is shaded.
    """
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
        wanted = ax.contour(x, y, z, [wanted_percent], colors=[color_of(2)], linewidths=2.0)
        ax.clabel(wanted, fmt=lambda level: f"{level:g} %", fontsize=7.5)
        ax.plot([1], [1], "o", color=INK, markersize=5)
        ax.annotate("as given", (1, 1), xytext=(6, 5), textcoords="offset points", fontsize=7.5)
        log_ticks(ax, "x")
        log_ticks(ax, "y")
        ax.set_title(title)
        ax.set_xlabel("position errors, multiple of those given")
    axes[0].set_ylabel("force errors, multiple of those given")
    return figure


def part_points(found: SensorRequirement) -> pd.DataFrame:
    """Relative standard uncertainty of every quantity by every error.

    Parameters
    ----------
    found : SensorRequirement
        Propagated to first order.

    Returns
    -------
    DataFrame
        ``quantity``, ``error`` (sensor and name), ``percent`` of the value.
    """
    import pandas as pd

    return pd.DataFrame(
        [
            {"quantity": one.name, "error": f"{s.sensor}: {s.name}", "percent": 100 * float(part)}
            for one in found.quantities
            for s, part in zip(found.propagation.sources, one.parts, strict=True)
        ]
    )


def draw_parts(frame: pd.DataFrame) -> Canvas:
    """Draw a group of bars for each error, a bar for each quantity.

    Parameters
    ----------
    frame : DataFrame
        By :func:`part_points`.
    """
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
