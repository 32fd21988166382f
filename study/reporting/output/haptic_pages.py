"""The page of a force law: what it is worth, its figures, its constants."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from study.laboratory.haptics.haptic_export import sentences
from study.laboratory.haptics.tabulated_force import ForceLaw
from study.laboratory.sensors.requirement import SensorRequirement, percent, size
from study.laboratory.sensors.requirement import sentences as requirement_sentences
from study.mechanics.material.material import is_dimensionless
from study.reporting.content.content_table import Table
from study.reporting.content.numbers import MISSING, significant
from study.reporting.content.text import clean
from study.reporting.figures import haptic_figures
from study.reporting.figures.registry import Figure, make
from study.reporting.output.analysis_page import AnswerPage, write_answer


def write_force_law(
    law: ForceLaw, question: str, out_dir: str | Path, warnings: tuple[str, ...] = ()
) -> Path:
    """Write the page of a force law."""
    answer = [clean(line) for line in sentences(law)]
    page = AnswerPage(
        "force law", "force-law", law.name, question, answer, force_law_figures(law),
        [constants(law)],
        [clean(line) for line in warnings],
    )  # fmt: skip
    return write_answer(page, out_dir)


def force_law_figures(law: ForceLaw) -> list[Figure]:
    """Force, stiffness and gradients; deviations from the simulation."""
    points, deviations = haptic_figures.law_points(law), haptic_figures.deviation_points(law)
    uncertain = law.covariance is not None
    caption = (
        "Force, its slope, and how a tenth of each constant changes the force; dots are the "
        "knots, dashes the continuations that no simulation says."
    )
    return [
        make(
            "force-law",
            "Force, stiffness, sensitivity",
            lambda: (points, lambda: haptic_figures.draw_law(points, law.displacement_mm), caption),
        ),
        make(
            "force-law-deviation",
            "Distance from the simulation",
            lambda: (
                deviations,
                lambda: haptic_figures.draw_deviation(deviations),
                f"At points between the knots that were solved and kept out; the band is the "
                f"error bound of {law.held_out.bound_N:.2g} N."
                + (" What the calibration leaves open comes on top." if uncertain else ""),
            ),
        ),
    ]


def constants(law: ForceLaw) -> Table:
    """Constants of the table, their range and what first order leaves out there.

    Units: returns kPa, MPa.
    """
    rows, raw = [], []
    for constant in law.ranges:
        factor, unit = (1.0, "") if is_dimensionless(constant.name) else (1e3, " kPa")
        value = law.constants[constant.name]
        rows.append((
            constant.name, f"{significant(factor * value, 4)}{unit}",
            f"{significant(factor * constant.low, 4)} to "
            f"{significant(factor * constant.high, 4)}{unit}",
            MISSING if math.isnan(constant.largest_N) else f"{significant(constant.largest_N)} N",
        ))  # fmt: skip
        row: Mapping[str, object] = {
            "constant": constant.name, "value": value, "low": constant.low, "high": constant.high,
            "unit": "" if is_dimensionless(constant.name) else "MPa",
            "largest_N": None if math.isnan(constant.largest_N) else constant.largest_N,
        }  # fmt: skip
        raw.append(row)
    columns = ("constant", "of the table", "range that was solved", "largest deviation")
    note = "One constant is moved at a time, to both ends of its range."
    return Table("Constants", columns, tuple(rows), 1, raw=tuple(raw), note=note)


# The page of sensor requirements: answer, map, parts, what each error may be, Monte Carlo.


def write_requirement(sensors: SensorRequirement, out_dir: str | Path) -> Path:
    """Write the page of sensor requirements."""
    tables = [errors(sensors), quantities(sensors)]
    if any(simulation.scatters for simulation in sensors.simulations):
        tables.append(simulations(sensors))
    page = AnswerPage(
        "sensor requirements", "requirement", sensors.name,
        sensors.question or "How accurate must the sensors be?",
        [clean(line) for line in requirement_sentences(sensors)],
        requirement_figures(sensors), tables, warnings(sensors),
    )  # fmt: skip
    return write_answer(page, out_dir)


def warnings(sensors: SensorRequirement) -> list[str]:
    """Say where the answer, which is of first order, must not be trusted."""
    return [clean(note) for note in sensors.notes] + [
        f"At {simulation.multiple:g} times the given errors first order does not hold: take "
        "scatter and shift of the simulated tests there, not the map."
        for simulation in sensors.simulations
        if not simulation.is_linear
    ]


def requirement_figures(sensors: SensorRequirement) -> list[Figure]:
    """Map of accuracies, and parts of the uncertainty."""
    plane, parts = haptic_figures.map_points(sensors), haptic_figures.part_points(sensors)
    percent_wanted = 100 * sensors.accuracy
    caption = (
        f"Expanded uncertainty (k = {sensors.coverage:g}) with all errors of a sensor so many "
        "times "
        f"as large as given; in the green region it is {percent_wanted:g} % or less. To first "
        "order."
    )
    return [
        make(
            "requirement-map",
            "Position against force accuracy",
            lambda: (plane, lambda: haptic_figures.draw_map(plane, percent_wanted), caption),
        ),
        make(
            "requirement-parts",
            "What each error adds",
            lambda: (
                parts,
                lambda: haptic_figures.draw_parts(parts),
                "Standard uncertainty by each error alone; their squares add up.",
            ),
        ),
    ]


def errors(sensors: SensorRequirement) -> Table:
    """Every error: as given, and as large as it may be."""
    rows, raw = [], []
    for k, source in enumerate(sensors.propagation.sources):
        alone, jointly = sensors.allowed(k)
        rows.append((
            source.sensor, source.name, size(source, source.given), size(source, alone),
            size(source, jointly),
        ))  # fmt: skip
        raw.append({
            "sensor": source.sensor, "error": source.name, "unit": source.unit or "1",
            "given": source.given, "allowed_alone": alone, "allowed_beside": jointly,
        })  # fmt: skip
    limit = percent(sensors.accuracy)
    columns = ("sensor", "error", "given", "allowed alone", "allowed beside the others")
    note = (
        f"For {limit} (k = {sensors.coverage:g}) of every constant: alone, with all other errors "
        "zero; beside the others as given (none: they are too large already)."
    )
    return Table("Errors", columns, tuple(rows), 2, raw=tuple(raw), note=note)


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
    rows, raw = [], []
    for run in sensors.simulations:
        for s in run.scatters:
            rows.append((
                f"{run.multiple:g}", s.name, f"{s.ratio:.3f}", f"{s.ratio_error:.3f}",
                f"{s.bias:+.2f}", "first order holds" if s.is_linear else "first order fails",
            ))  # fmt: skip
            raw.append({"multiple": run.multiple, "samples": run.samples, "failed": run.failed,
                        **vars(s)})  # fmt: skip
    columns = ("multiple", "quantity", "scatter over first order", "its error", "shift", "verdict")
    note = "The shift of the mean is in standard deviations."
    return Table("Simulated tests", columns, tuple(rows), 2, 1, raw=tuple(raw), note=note)
