"""The table ``[calibration]`` of a calibration file: who shares constants, bounds, leave-out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from study import units
from study.design.diagnostics import Faults, noted, read_table
from study.design.spec import Config
from study.design.study_file import Fitting
from study.errors import nearest
from study.material.registry import is_dimensionless
from study.setup.quantity import shown
from study.setup.section import Bad, values_of


def read_fitting(table: Any, names: Sequence[str], faults: Faults) -> Config:
    """Read how a calibration file wants its constants found.

    Parameters
    ----------
    table : mapping or None
        ``[calibration]`` as written.
    names : sequence of str
        Constants that are fitted.
    faults : Faults
        Where faults go.

    Returns
    -------
    dict
        ``specimens`` (``"pooled"``: all share their constants, or ``"each"``: every specimen
        also for itself), ``leave_out`` (``"specimen"``, ``"test"`` or None) and ``bounds``
        (name -> (low, high) in MPa, exponents plain).
    """
    found = values_of(read_table(Fitting, {} if table is None else table, "calibration", faults))
    bounds = {} if found["bounds"] is None else found["bounds"]
    read = partial(_bounds, names=names)
    return {**found, "bounds": noted(read, bounds, "calibration.bounds", faults)}


def _bounds(value: Any, names: Sequence[str]) -> dict[str, tuple[float, float]]:
    if not isinstance(value, Mapping):
        raise Bad(f"must be a table, got {shown(value)}", 'C10 = ["1 kPa", "20 kPa"]')
    found = {}
    for name, pair in value.items():
        if name not in names:
            raise Bad(f"{shown(name)} is no constant of this fit", nearest(str(name)[:80], names))
        if not isinstance(pair, list) or len(pair) != 2:
            raise Bad(f"{name} must be two values, got {shown(pair)}", '["1 kPa", "20 kPa"]')
        low, high = (_value(name, v) for v in pair)
        if not low < high:
            raise Bad(f"{name} must rise, got {shown(pair)}")
        found[name] = (low, high)
    return found


def _value(name: str, value: Any) -> float:
    if not is_dimensionless(name):
        return units.parse(value, "pressure")
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise Bad(f"{name} is a plain number, got {shown(value)}")
    return float(value)
