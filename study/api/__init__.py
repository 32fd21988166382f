"""The verbs as Python functions: the only place that joins runner, analysis and reporting.

Names are loaded on first use, so that each verb imports what it needs and no more.
"""

from __future__ import annotations

import importlib
from typing import Any

#: module of every name
_HOME = {
    "load_design": "study.api.folders",
    "run": "study.api.study",
    "demo": "study.api.study",
    "import_runs": "study.api.importing",
    "plan": "study.api.planning",
    "augment": "study.api.planning",
    "power": "study.api.contrast_power",
    "run_sheet": "study.api.planning",
    "status": "study.api.planning",
    "why": "study.api.comparison",
    "explain": "study.api.comparison",
    "report": "study.api.study",
    "serve": "study.api.serving",
    "load": "study.api.opened_study",
    "diff": "study.api.comparison",
    "verify": "study.api.study",
    "analyze": "study.api.analyzing",
    "fit_surface": "study.api.fitting_surfaces",
    "fit_surfaces": "study.api.fitting_surfaces",
    "predict": "study.api.predicting",
    "optimize": "study.api.optimizing",
    "invert": "study.api.optimizing",
    "contrasts": "study.api.contrast_power",
    "anova": "study.statistics.analysis.anova",
    "mixed_model": "study.statistics.analysis.mixed_model",
    "ryan_joiner": "study.statistics.analysis.normality",
    "bartlett": "study.statistics.analysis.equal_variance",
    "grid_convergence": "study.statistics.convergence.grid_convergence",
    "solve": "study.api.solving",
    "calibrate": "study.api.calibrating",
    "choose_energy": "study.api.calibrating",
    "indentation_modulus": "study.api.calibrating",
    "compare_tests": "study.api.calibrating",
    "inspect": "study.api.calibrating",
    "converge": "study.api.converging",
    "virtual": "study.api.calibrating",
    "export": "study.api.haptics",
    "export_surface": "study.api.haptics",
    "require": "study.api.haptics",
    "tracking": "study.api.haptics",
    "shape": "study.api.haptics",
}
__all__ = list(_HOME)  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'study.api' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)
