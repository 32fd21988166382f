"""The page of sensor requirements: answer, map, parts, what each error may be, Monte Carlo."""

from __future__ import annotations

from pathlib import Path

from study.reporting.content.table import Table
from study.reporting.figure.haptics import requirement
from study.reporting.figure.registry import Figure, make
from study.reporting.numbers import significant
from study.reporting.output.answer_page import AnswerPage, write_answer
from study.reporting.text import clean
from study.sensors.requirement import SensorRequirement, percent, sentences, size


def write_requirement(found: SensorRequirement, out_dir: str | Path) -> Path:
    """Write the page of sensor requirements.

    Parameters
    ----------
    found : SensorRequirement
        With its Monte Carlo simulations, if any.
    out_dir : str or Path
        Made where it is missing.

    Returns
    -------
    Path
        The page.
    """
    tables = [errors(found), quantities(found)]
    if any(one.scatters for one in found.simulations):
        tables.append(simulations(found))
    page = AnswerPage(
        "sensor requirements", "requirement", found.name,
        found.question or "How accurate must the sensors be?",
        [clean(line) for line in sentences(found)], figures(found), tables, warnings(found),
    )  # fmt: skip
    return write_answer(page, out_dir)


def warnings(found: SensorRequirement) -> list[str]:
    """Say where the answer, which is of first order, must not be trusted.

    Parameters
    ----------
    found : SensorRequirement
        Its notes, and its simulations where first order does not hold.

    Returns
    -------
    list of str
        May be empty.
    """
    return [clean(note) for note in found.notes] + [
        f"At {one.multiple:g} times the given errors first order does not hold: take scatter and "
        "shift of the simulated tests there, not the map."
        for one in found.simulations
        if not one.is_linear
    ]


def figures(found: SensorRequirement) -> list[Figure]:
    """Map of accuracies, and parts of the uncertainty.

    Parameters
    ----------
    found : SensorRequirement
        Propagated to first order.
    """
    plane, parts = requirement.map_points(found), requirement.part_points(found)
    wanted = 100 * found.accuracy
    caption = (
        f"Expanded uncertainty (k = {found.coverage:g}) with all errors of a sensor so many times "
        f"as large as given; in the green region it is {wanted:g} % or less. To first order."
    )
    return [
        make(
            "requirement-map",
            "Position against force accuracy",
            lambda: (plane, lambda: requirement.draw_map(plane, wanted), caption),
        ),
        make(
            "requirement-parts",
            "What each error adds",
            lambda: (
                parts,
                lambda: requirement.draw_parts(parts),
                "Standard uncertainty by each error alone; their squares add up.",
            ),
        ),
    ]


def errors(found: SensorRequirement) -> Table:
    """Every error: as given, and as large as it may be.

    Parameters
    ----------
    found : SensorRequirement
        Standard uncertainties of its sources: mm, N, or a share of the value.
    """
    rows, raw = [], []
    for k, source in enumerate(found.propagation.sources):
        alone, beside = found.allowed(k)
        rows.append((
            source.sensor, source.name, size(source, source.given), size(source, alone),
            size(source, beside),
        ))  # fmt: skip
        raw.append({
            "sensor": source.sensor, "error": source.name, "unit": source.unit or "1",
            "given": source.given, "allowed_alone": alone, "allowed_beside": beside,
        })  # fmt: skip
    wanted = percent(found.accuracy)
    columns = ("sensor", "error", "given", "allowed alone", "allowed beside the others")
    note = (
        f"For {wanted} (k = {found.coverage:g}) of every constant: alone, with all other errors "
        "zero; beside the others as given (none: they are too large already)."
    )
    return Table("Errors", columns, tuple(rows), 2, raw=tuple(raw), note=note)


def quantities(found: SensorRequirement) -> Table:
    """Constants and predicted force with their uncertainties.

    Parameters
    ----------
    found : SensorRequirement
        Moduli are in MPa there and in kPa in the table.
    """
    rows, raw = [], []
    for one in found.quantities:
        factor, unit = (1e3, "kPa") if one.unit == "MPa" else (1.0, one.unit)
        value = f"{significant(factor * one.value, 4)} {unit}".strip()
        rows.append(
            (one.name, value, percent(one.relative), percent(found.coverage * one.relative))
        )
        raw.append({
            "quantity": one.name, "value": factor * one.value, "unit": unit,
            "relative_standard_uncertainty": one.relative,
        })  # fmt: skip
    columns = ("quantity", "value", "standard uncertainty", f"expanded (k = {found.coverage:g})")
    return Table("Quantities", columns, tuple(rows), 1, raw=tuple(raw))


def simulations(found: SensorRequirement) -> Table:
    """Scatter in simulated tests beside that of first order.

    Parameters
    ----------
    found : SensorRequirement
        With simulated tests; one whose fits have no answer is passed over.
    """
    rows, raw = [], []
    for one in found.simulations:
        for s in one.scatters:
            rows.append((
                f"{one.multiple:g}", s.name, f"{s.ratio:.3f}", f"{s.ratio_error:.3f}",
                f"{s.bias:+.2f}", "first order holds" if s.is_linear else "first order fails",
            ))  # fmt: skip
            raw.append({"multiple": one.multiple, "samples": one.samples, "failed": one.failed,
                        **vars(s)})  # fmt: skip
    columns = ("multiple", "quantity", "scatter over first order", "its error", "shift", "verdict")
    note = "The shift of the mean is in standard deviations."
    return Table("Simulated tests", columns, tuple(rows), 2, 1, raw=tuple(raw), note=note)
