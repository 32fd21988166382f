"""The verbs as Python functions: the only place that joins runner, analysis and reporting.

Names are loaded on first use, so that each verb imports what it needs and no more.
"""

from __future__ import annotations

import importlib
from typing import Any

#: module of every name, and what it is called there if not the same
_HOME = {
    "load_design": "study.api.study",
    "run": "study.api.study",
    "demo": "study.api.study",
    "plan": "study.api.planning.plan",
    "augment": "study.api.planning.augment",
    "power": "study.api.planning.detection",
    "run_sheet": "study.api.planning.run_sheet",
    "status": "study.api.planning.plan",
    "why": "study.api.planning.why",
    "explain": "study.api.planning.why",
    "report": "study.api.study",
    "serve": "study.api.server.serve",
    "open_study": "study.api.opened_study",
    "diff": "study.api.comparison.compare",
    "verify": "study.api.verification",
    "analyze": "study.api.statistics.analysis",
    "fit_surface": "study.api.statistics.surface.level_surfaces",
    "fit_surfaces": "study.api.statistics.surface.level_surfaces",
    "predict": "study.api.statistics.prediction",
    "optimize": "study.api.planning.optimum",
    "invert": "study.api.planning.inversion",
    "contrasts": "study.api.statistics.contrast",
    "anova": "study.analysis.anova",
    "mixed_model": "study.analysis.error.mixed_model",
    "ryan_joiner": "study.analysis.assumption.normality",
    "bartlett": "study.analysis.assumption.variance",
    "grid_convergence": "study.analysis.convergence.grid_convergence",
    "solve": "study.api.single.solve",
    "calibrate": "study.api.single.calibrate",
    "choose_energy": "study.api.single.calibrate",
    "indentation_modulus": "study.api.single.indentation",
    "compare_tests": "study.api.single.calibrate",
    "converge": "study.api.convergence.problem",
    "virtual": "study.api.single.virtual",
    "export": "study.api.haptics.export",
    "export_surface": "study.api.haptics.surface",
    "require": "study.api.haptics.require",
    "tracking": "study.api.accuracy.tracking",
    "shape": "study.api.accuracy.shape",
}
__all__ = list(_HOME)  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'study.api' has no attribute {name!r}")
    module, _, known_as = _HOME[name].partition(":")
    return getattr(importlib.import_module(module), known_as or name)
