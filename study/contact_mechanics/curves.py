"""Measured indentations, each on its own rows: many curves share no grid."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from study.arrays import Array
from study.errors import Fault, InputError
from study.measurement.conditioning import Rules, condition
from study.measurement.recording import read_recordings
from study.measurement.section import MeasurementSpec


@dataclass(frozen=True)
class RecordedCurve:
    """One curve as it was measured.

    Parameters
    ----------
    label : str
        File and labels, for messages.
    groups : mapping of str to str
        Label of every grouping column.
    displacement_mm, force_N : ndarray, shape (n,)
        Rows, rising in displacement; empty where the curve is of no use.
    fault : str
        Why it is of no use.
    """

    label: str
    groups: Mapping[str, str]
    displacement_mm: Array
    force_N: Array
    fault: str = ""


def read_curves(
    spec: MeasurementSpec, root: Path, height_mm: float | None, displacement_mm: float | None
) -> tuple[tuple[RecordedCurve, ...], tuple[str, ...]]:
    """Read all curves of a specification, and notes of what was done to the files.

    Parameters
    ----------
    spec : MeasurementSpec
        Table ``[measurements]``.
    root : Path
        Data root.
    height_mm : float, optional
        Height of the specimen, for a range in percent.
    displacement_mm : float, optional
        Last displacement that is used, where there is no range.

    Raises
    ------
    InputError
        If a file is malformed, strain or stress was recorded, or no curve is of any use.
    """
    columns = (spec.columns.kinematic, spec.columns.kinetic)
    if columns != ("displacement", "force"):
        rule = f"an indentation needs displacement and force, got {' and '.join(columns)}"
        mend = 'columns = { displacement = "...", force = "..." }'
        raise InputError(Fault("measurements.columns", rule, mend))
    low, high = 0.0, np.inf if displacement_mm is None else displacement_mm
    if spec.range is not None:
        low, high = spec.range.in_mm(height_mm)
    rules = Rules(
        low, high, 0, spec.sign or "positive", spec.zero or "none", spec.toe, height_mm
    )  # fmt: skip
    recorded = read_recordings(spec, root)
    found: list[RecordedCurve] = []
    faults: list[Fault] = []
    for one in recorded.tests:
        try:
            kept = condition(one.kinematic, one.kinetic, rules, one.where)
        except InputError as error:
            faults += error.faults
            nothing = np.empty(0)
            found.append(RecordedCurve(one.where, one.groups, nothing, nothing, str(error)))
            continue
        found.append(RecordedCurve(one.where, one.groups, kept.displacement_mm, kept.force_N))
    if all(one.fault for one in found):
        raise InputError(faults)
    return tuple(found), recorded.notes
