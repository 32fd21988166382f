"""Small records and specifications that the tests of this room share."""

from typing import cast

import numpy as np

from study.ground.curve import Curve
from study.mechanics.measurement.measurement_section import MeasurementSpec, Range
from study.record.record import CurveKey, ManifestDocument, Record

#: cases of a small study
CASES = ("a1", "b2", "c3")
#: a fit that several cases share, and what refinement says of one response
FIT = {
    "status": "converged",
    "names": ["C10"],
    "values": {"C10": 1 / 3},
    "message": "a minimum",
}
NUMERICAL = {
    "levels": {"space": "3d"},
    "response": "error",
    "value": 1.25,
    "u_num": None,
    "unit": "%",
    "behaviour": "two meshes",
    "note": "",
}


def Spec(**changes):
    """One file ``a.csv`` with columns d (mm) and f (N), 5 points from 0 to 4 mm."""
    values = {
        "file": "a.csv",
        "columns": {"displacement": "d", "force": "f"},
        "units": {"displacement": "mm", "force": "N"},
        "range": Range("mm", 0.0, 4.0),
        "points": 5,
    }
    return MeasurementSpec(**{**values, **changes})


def record(case_id="a1", **changes):
    values = {
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


def manifest(**changes):
    """Say what a study of no case is."""
    whole = {
        "name": "demo",
        "design": "",
        "text": "",
        "source": "demo.toml",
        "cases": {},
        "blocks": [],
        "notes": [],
        "virtual": False,
    }
    return cast(ManifestDocument, {**whole, **changes})
