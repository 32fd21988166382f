"""One curve by itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

from study.curve import Curve
from study.reporting.figure.axes import plain_ticks
from study.reporting.figure.style import RULE, WIDTH_IN, canvas, color_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas


def draw_curve(curve: Curve) -> Canvas:
    """Draw force against displacement from the unloaded origin, load steps as points.

    Parameters
    ----------
    curve : Curve
        Of at least one step.
    """
    import numpy as np

    figure = canvas(0.6 * WIDTH_IN, 3.2)
    ax = figure.subplots()
    places = np.linspace(0.0, curve.displacement_mm[-1], 200)
    ax.plot(places, curve.force_at(places), color=color_of(0))
    ax.plot(curve.displacement_mm, curve.force_N, "o", color=color_of(0), markersize=3)
    ax.grid(axis="y", color=RULE, linewidth=0.4)
    ax.set_xlabel("displacement (mm)")
    ax.set_ylabel("force (N)")
    plain_ticks(ax, "x")
    plain_ticks(ax, "y")
    return figure
