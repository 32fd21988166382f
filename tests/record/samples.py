"""Small records and specifications that the tests of this room share."""

from __future__ import annotations

from typing import Any

import numpy as np

from study.curve import Curve
from study.measurement.section import MeasurementSpec, Range
from study.record.document import CurveKey
from study.record.record import Record


def Spec(**changes: Any) -> MeasurementSpec:
    """One file ``a.csv`` with columns d (mm) and f (N), 5 points from 0 to 4 mm."""
    values: dict[str, Any] = {
        "file": "a.csv",
        "columns": {"displacement": "d", "force": "f"},
        "units": {"displacement": "mm", "force": "N"},
        "range": Range("mm", 0.0, 4.0),
        "points": 5,
    }
    return MeasurementSpec(**{**values, **changes})


def record(case_id: str = "a1", **changes: Any) -> Record:
    values: dict[str, Any] = {
        "case_id": case_id,
        "study": "demo",
        "levels": {"material": "neo-hookean", "space": "3d"},
        "block": "B1",
        "responses": {"error": {"value": 1.25, "unit": "%"}},
        "parameters": {"C10": {"value": 5.0, "unit": "kPa", "ci95": (4.9, 5.1)}},
        "curves": {CurveKey("measured", "B1"): Curve(np.array([1.0, 2.0]), np.array([0.1, 1 / 3]))},
        "timings": {"total": 0.5},
        "mesh": {"dofs": 120},
        "input_hash": "h-" + case_id,
    }
    return Record(**{**values, **changes})
