"""Design of experiments and honest statistics for simulations of soft materials."""

from study.ground.working_folder import keep_out

keep_out()  # before anything else is imported

import importlib  # noqa: E402
from typing import Any  # noqa: E402

__version__ = "0.1.0"

#: public names, each loaded on first use, so that ``import study`` stays fast
_PUBLIC = (
    "load_design", "run", "load", "solve", "calibrate", "indentation_modulus", "inspect",
    "analyze", "converge", "report", "fit_surface", "fit_surfaces", "predict", "optimize",
    "invert", "contrasts", "power", "export", "export_surface", "require", "anova",
    "mixed_model", "ryan_joiner", "bartlett", "grid_convergence", "tracking", "shape",
)  # fmt: skip
__all__ = [*_PUBLIC, "__version__"]  # noqa: PLE0604


def __getattr__(name: str) -> Any:
    """Load a public function."""
    if name not in _PUBLIC:
        raise AttributeError(f"module 'study' has no attribute {name!r}")
    # kept, so that it is looked for once
    return globals().setdefault(name, getattr(importlib.import_module("study.api"), name))


def __dir__() -> list[str]:
    """List the public names, those not loaded yet included."""
    return sorted(__all__)
