"""Pages of a force law and of what sensors must be: answer, figures, tables."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study.laboratory.haptics.haptic_export import ConstantRange, ForceLaw
from study.laboratory.sensors.requirement import MULTIPLES, SensorRequirement, percent, size
from study.reporting.content.blocks import Table
from study.reporting.content.text import MISSING, clean, significant
from study.reporting.figures import axes as style
from study.reporting.output.write import answer_blocks, write_answer

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure as Canvas


def write_force_law(
    law: ForceLaw, question: str, out_dir: str | Path, warnings: tuple[str, ...] = ()
) -> Path:
    """Write the page of a force law."""
    plots: dict[str, style.Plot] = {
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
    plots: dict[str, style.Plot] = {
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
