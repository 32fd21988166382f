"""The page of a force law: what it is worth, its figures, its constants."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from study.haptics.export import sentences
from study.haptics.force_law import ForceLaw
from study.material.registry import is_dimensionless
from study.reporting.content.table import Table
from study.reporting.figure.haptics import force_law
from study.reporting.figure.registry import Figure, make
from study.reporting.numbers import MISSING, significant
from study.reporting.output.answer_page import AnswerPage, write_answer
from study.reporting.text import clean


def write_force_law(
    law: ForceLaw, question: str, out_dir: str | Path, warnings: tuple[str, ...] = ()
) -> Path:
    """Write the page of a force law.

    Parameters
    ----------
    law : ForceLaw
        With its error bound and ranges.
    question : str
        What it answers.
    out_dir : str or Path
        Made where it is missing.
    warnings : tuple of str
        Above all a tolerance that is not met.

    Returns
    -------
    Path
        The page.
    """
    answer = [clean(line) for line in sentences(law)]
    page = AnswerPage(
        "force law", "force-law", law.name, question, answer, figures(law), [constants(law)],
        [clean(line) for line in warnings],
    )  # fmt: skip
    return write_answer(page, out_dir)


def figures(law: ForceLaw) -> list[Figure]:
    """Force, stiffness and gradients; deviations from the simulation.

    Parameters
    ----------
    law : ForceLaw
        With its error bound.
    """
    points, deviations = force_law.law_points(law), force_law.deviation_points(law)
    uncertain = law.covariance is not None
    caption = (
        "Force, its slope, and how a tenth of each constant changes the force; dots are the "
        "knots, dashes the continuations that no simulation says."
    )
    return [
        make(
            "force-law",
            "Force, stiffness, sensitivity",
            lambda: (points, lambda: force_law.draw_law(points, law.displacement_mm), caption),
        ),
        make(
            "force-law-deviation",
            "Distance from the simulation",
            lambda: (
                deviations,
                lambda: force_law.draw_deviation(deviations),
                f"At points between the knots that were solved and kept out; the band is the "
                f"error bound of {law.held_out.largest_N:.2g} N."
                + (" What the calibration leaves open comes on top." if uncertain else ""),
            ),
        ),
    ]


def constants(law: ForceLaw) -> Table:
    """Constants of the table, their range and what first order leaves out there.

    Parameters
    ----------
    law : ForceLaw
        With its ranges.

    Returns
    -------
    Table
        Moduli in kPa, in MPa in the unrounded rows.
    """
    rows, raw = [], []
    for one in law.ranges:
        factor, unit = (1.0, "") if is_dimensionless(one.name) else (1e3, " kPa")
        value = law.constants[one.name]
        rows.append((
            one.name, f"{significant(factor * value, 4)}{unit}",
            f"{significant(factor * one.low, 4)} to {significant(factor * one.high, 4)}{unit}",
            MISSING if math.isnan(one.largest_N) else f"{significant(one.largest_N)} N",
        ))  # fmt: skip
        row: Mapping[str, object] = {
            "constant": one.name, "value": value, "low": one.low, "high": one.high,
            "unit": "" if is_dimensionless(one.name) else "MPa",
            "largest_N": None if math.isnan(one.largest_N) else one.largest_N,
        }  # fmt: skip
        raw.append(row)
    columns = ("constant", "of the table", "range that was solved", "largest deviation")
    note = "One constant is moved at a time, to both ends of its range."
    return Table("Constants", columns, tuple(rows), 1, raw=tuple(raw), note=note)
