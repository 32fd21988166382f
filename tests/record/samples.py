"""Small records and specifications that the tests of this room share."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from study.curve import Curve
from study.record import Record


@dataclass(frozen=True)
class Range:
    """Stands for the design's range."""

    kind: str = "mm"
    low: float = 0.0
    high: float = 4.0

    def in_mm(self, height_mm: float | None) -> tuple[float, float]:
        scale = (height_mm or 0.0) / 100 if self.kind == "percent" else 1.0
        return self.low * scale, self.high * scale


@dataclass(frozen=True)
class Spec:
    """Stands for the design's measurement specification."""

    file: str | None = "a.csv"
    files: str | None = None
    columns: dict[str, str] = field(default_factory=lambda: {"displacement": "d", "force": "f"})
    units: dict[str, str] = field(default_factory=lambda: {"displacement": "mm", "force": "N"})
    block: str | None = None
    average: tuple[str, ...] = ()
    range: Range | None = Range()
    points: int = 5
    fit: dict[str, Any] | None = None
    score: dict[str, Any] | None = None
    swap: bool = False
    zero: str = "none"
    toe: float | None = None
    sign: str = "positive"
    decimal: str = "."
    citation: str = ""


def record(case_id: str = "a1", **changes: Any) -> Record:
    values: dict[str, Any] = {
        "case_id": case_id,
        "study": "demo",
        "levels": {"material": "neo-hookean", "space": "3d"},
        "block": "B1",
        "responses": {"error": {"value": 1.25, "unit": "%"}},
        "parameters": {"C10": {"value": 5.0, "unit": "kPa", "ci95": (4.9, 5.1)}},
        "curves": {"measured:B1": Curve(np.array([1.0, 2.0]), np.array([0.1, 1 / 3]))},
        "timings": {"total": 0.5},
        "mesh": {"dofs": 120},
        "input_hash": "h-" + case_id,
    }
    return Record(**{**values, **changes})
