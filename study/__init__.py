"""Design of experiments and honest statistics for simulations of soft materials."""

from study.ground.working_folder import keep_out

keep_out()  # before anything else is imported

import importlib  # noqa: E402
from typing import Any  # noqa: E402

__version__ = "0.1.0"

_LAZY = {
    "load_design": "study.api",
    "run": "study.api",
    "load": "study.api",
    "solve": "study.api",
    "calibrate": "study.api",
    "indentation_modulus": "study.api",
    "inspect": "study.api",
    "analyze": "study.api",
    "converge": "study.api",
    "report": "study.api",
    "fit_surface": "study.api",
    "fit_surfaces": "study.api",
    "predict": "study.api",
    "optimize": "study.api",
    "invert": "study.api",
    "contrasts": "study.api",
    "power": "study.api",
    "export": "study.api",
    "export_surface": "study.api",
    "require": "study.api",
    "anova": "study.api",
    "mixed_model": "study.api",
    "ryan_joiner": "study.api",
    "bartlett": "study.api",
    "grid_convergence": "study.api",
    "tracking": "study.api",
    "shape": "study.api",
}
__all__ = [*_LAZY, "__version__"]  # noqa: PLE0604


def __getattr__(name: str) -> Any:
    """Load a public function on first use, so that ``import study`` stays fast."""
    if name not in _LAZY:
        raise AttributeError(f"module 'study' has no attribute {name!r}")
    return getattr(importlib.import_module(_LAZY[name]), name)


def __dir__() -> list[str]:
    """List the public names, those not loaded yet included."""
    return sorted(__all__)
