"""Figure of a calibration: every measured curve with its fit or prediction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from study.arrays import Array
from study.reporting.figure.style import INK, RULE, WIDTH_IN, canvas, color_of, render
from study.reporting.text import clean

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

_COLUMNS = 3
_MOST = 12


@dataclass(frozen=True)
class FitPanel:
    """One measured curve of a calibration.

    Parameters
    ----------
    title : str
        File and specimen.
    fitted : bool
        False for a curve that was only predicted.
    places, measured_N : ndarray, shape (n,)
        The curve: force over displacement in mm, or over time in s.
    predicted_N, scatter_N : ndarray or None
        Prediction and standard deviation of the repeats, where there are any.
    over_time : bool
        Whether it is a course in time.
    """

    title: str
    fitted: bool
    places: Array
    measured_N: Array
    predicted_N: Array | None
    scatter_N: Array | None
    over_time: bool = False


def fit_figure(panels: Sequence[FitPanel], title: str) -> str:
    """Return the figure as SVG, the same bytes for the same data.

    Parameters
    ----------
    panels : sequence of FitPanel
        Every curve of the calibration; the first 12 are drawn.
    title : str
        Above the panels, and accessible name of the figure.
    """
    return render(lambda: draw_fit(panels, title), "calibration", title)


def draw_fit(panels: Sequence[FitPanel], title: str) -> Canvas:
    """Draw the first curves with their fits, and residuals below each.

    Parameters
    ----------
    panels : sequence of FitPanel
        Every curve; the first 12 are drawn.
    title : str
        Above the panels; it also says how many curves there are where not all are drawn.
    """
    return _draw(panels[:_MOST], title, len(panels))


def _draw(panels: Sequence[FitPanel], title: str, total: int) -> Canvas:
    columns = min(_COLUMNS, len(panels))
    rows = -(-len(panels) // columns)
    figure = canvas(WIDTH_IN if columns > 1 else 0.6 * WIDTH_IN, 0.5 + 3.0 * rows)
    axes = figure.subplots(2 * rows, columns, squeeze=False, height_ratios=[2.4, 1.0] * rows)
    for place in range(rows * columns):
        r, c = divmod(place, columns)
        force, residual = axes[2 * r][c], axes[2 * r + 1][c]
        if place >= len(panels):
            force.set_axis_off()
            residual.set_axis_off()
            continue
        _fit_panel(force, residual, panels[place])
        if c == 0:
            force.set_ylabel("force (N)")
            residual.set_ylabel("fit - meas. (N)")
    figure.supxlabel(_axis(panels), fontsize=8.5)
    more = f" (the first {len(panels)} of {total} curves)" if total > len(panels) else ""
    figure.suptitle(clean(title, 120) + more, fontsize=9)
    return figure


def _axis(panels: Sequence[FitPanel]) -> str:
    """Label of the common axis."""
    kinds = {panel.over_time for panel in panels}
    if len(kinds) > 1:
        return "displacement (mm), or time (s) of a course"
    return "time (s)" if kinds == {True} else "displacement (mm)"


def _fit_panel(force: Axes, residual: Axes, panel: FitPanel) -> None:
    d, thin = panel.places, slice(None, None, max(1, panel.places.size // 60))
    if panel.scatter_N is not None:
        s = panel.scatter_N
        low, high = panel.measured_N - s, panel.measured_N + s
        force.fill_between(d, low, high, color="#c4cad1", linewidth=0)
        residual.fill_between(d, -s, s, color="#e3e7eb", linewidth=0, label="sd of repeats")
    force.plot(d[thin], panel.measured_N[thin], "o", color=INK, markersize=1.9, label="measured")
    residual.axhline(0, color=INK, linewidth=0.6)
    if panel.predicted_N is not None:
        color = color_of(0 if panel.fitted else 1)
        label = "fit" if panel.fitted else "prediction (held out)"
        force.plot(d, panel.predicted_N, label=label, color=color, linewidth=1.1)
        residual.plot(d, panel.predicted_N - panel.measured_N, color=color, linewidth=1.1)
    force.set_title(clean(panel.title, 44), fontsize=7.5)
    force.tick_params(labelbottom=False)
    force.legend(loc="upper left", fontsize=7)
    for ax in (force, residual):
        ax.grid(axis="y", color=RULE, linewidth=0.4)
