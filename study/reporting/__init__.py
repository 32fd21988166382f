"""Reports: sentences, tables and figures from records and their analysis; computes nothing else."""

from __future__ import annotations

import importlib
from typing import Any

_LAZY = {
    "Check": "data",
    "CurvePair": "data",
    "Failure": "data",
    "FittedConstant": "data",
    "NumericalRow": "data",
    "ReportData": "data",
    "ResponseAnalysis": "data",
    "build": "page",
    "write": "output",
}
__all__ = list(_LAZY)  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    """Load a name on first use: importing the package costs nothing."""
    if name not in _LAZY:
        raise AttributeError(f"module 'study.reporting' has no attribute {name!r}")
    return getattr(importlib.import_module(f"study.reporting.{_LAZY[name]}"), name)
