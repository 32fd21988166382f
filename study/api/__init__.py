"""The verbs as Python functions: the only place that joins runner, analysis and reporting.

Names are loaded on first use, so that each verb imports what it needs and no more.
"""

from __future__ import annotations

import importlib
from typing import Any

_HOME = {
    "load_design": "study.api.studies",
    "run": "study.api.studies",
    "demo": "study.api.studies",
    "plan": "study.api.planning",
    "status": "study.api.planning",
    "why": "study.api.planning",
    "report": "study.api.studies",
    "open_study": "study.api.studies",
    "diff": "study.api.compare",
    "analyze": "study.api.statistics",
    "anova": "study.api.statistics",
    "ryan_joiner": "study.api.statistics",
    "bartlett": "study.api.statistics",
    "grid_convergence": "study.api.statistics",
    "solve": "study.api.single",
    "calibrate": "study.api.calibration",
    "choose_energy": "study.api.calibration",
    "converge": "study.api.convergence",
    "virtual": "study.api.single",
}
__all__ = list(_HOME)  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'study.api' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)
