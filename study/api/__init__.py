"""The verbs as Python functions: the only place that joins runner, analysis and reporting.

Names are loaded on first use, so that each verb imports what it needs and no more.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

from study.ground.errors import names_in_bounds

#: names by their modules
_NAMES = {
    "harness.design.load": "load_design",
    "harness.design.overview": "augment",
    "api.study": "run demo report verify",
    "api.planning": "plan run_sheet status power",
    "api.comparison": "explain diff",
    "api.serving": "serve",
    "api.opened_study": "load import_runs",
    "api.analyzing": "analyze contrasts",
    "api.predicting": "fit_surface fit_surfaces predict",
    "api.optimizing": "optimize invert",
    "statistics.analysis.anova": "anova",
    "statistics.analysis.mixed_model": "mixed_model",
    "statistics.analysis.normality": "ryan_joiner",
    "statistics.analysis.equal_variance": "bartlett",
    "statistics.convergence.grid_convergence": "grid_convergence",
    "api.solving": "solve",
    "api.calibrating": "calibrate choose_energy indentation_modulus compare_tests inspect virtual",
    "api.converging": "converge",
    "api.haptics": "export export_surface require tracking shape",
}
_HOME = {name: f"study.{home}" for home, names in _NAMES.items() for name in names.split()}
__all__ = list(_HOME)  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'study.api' has no attribute {name!r}")
    function: Callable[..., object] = getattr(importlib.import_module(_HOME[name]), name)
    # a verb refuses a name of a file that is too long; one object for one function
    return globals().setdefault(name, names_in_bounds()(function))
