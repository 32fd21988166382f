"""Figures of a force law: force over displacement, and its distance from the simulation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from study.haptics.force_law import ForceLaw
from study.reporting.figure.style import BAND, INK, MUTED, RULE, WIDTH_IN, canvas, color_of

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
    """Force, stiffness and changes by the constants, a row for each displacement.

    Parameters
    ----------
    law : ForceLaw
        Drawn from 12 % of its tested range below 0 to 12 % beyond the end.

    Returns
    -------
    DataFrame
        ``displacement_mm``, ``force_N``, ``stiffness_N_per_mm``, ``tested`` (bool), and for every
        constant ``change_by_<name>_N``, the change of the force when it grows by 10 %.
    """
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

    Parameters
    ----------
    frame : DataFrame
        By :func:`law_points`.
    knots_mm : ndarray, shape (n,)
        Displacements of the knots.
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
    """One row for each point that was kept out of the law.

    Parameters
    ----------
    law : ForceLaw
        With its error bound.

    Returns
    -------
    DataFrame
        ``displacement_mm``, ``simulated_N``, ``deviation_N`` (law less simulation).
    """
    import pandas as pd

    held = law.held_out
    return pd.DataFrame(
        {
            "displacement_mm": held.displacement_mm,
            "simulated_N": held.force_N,
            "deviation_N": held.deviation_N,
        }
    )


def draw_deviation(frame: pd.DataFrame) -> Canvas:
    """Draw the law less the simulation at the points kept out, within the error bound.

    Parameters
    ----------
    frame : DataFrame
        By :func:`deviation_points`.
    """
    figure = canvas(WIDTH_IN, 2.2)
    ax = figure.subplots()
    d, off = frame["displacement_mm"].to_numpy(float), frame["deviation_N"].to_numpy(float)
    bound = float(np.abs(off).max())
    ax.axhspan(-bound, bound, color=BAND)
    ax.axhline(0, color=RULE, linewidth=0.6)
    ax.vlines(d, 0, off, color=color_of(0), linewidth=1.0)
    ax.plot(d, off, "o", color=color_of(0), markersize=3.5)
    ax.set_xlabel("displacement (mm)")
    ax.set_ylabel("law less simulation (N)")
    return figure
