"""Is the installation able to do the work? Every part is tried, not looked up."""

from __future__ import annotations

import importlib
import platform
import sys
from collections.abc import Callable
from importlib import metadata
from typing import Any

from study.execution.task import Task
from study.forward import closed_form, finite_element
from study.runner.tasks import processes
from study.setup.material_section import MaterialSection
from study.setup.setup import problem_of, specimen_of

_NEEDED = ("numpy", "scipy", "pandas", "numba", "skfem", "meshio", "matplotlib", "statsmodels")
_SYSTEM_LIBRARIES = (
    "apt-get install libglu1-mesa libgl1 libopengl0 libxcursor1 libxft2 libxinerama1 "
    "libxrender1 libxfixes3 libxext6 libfontconfig1 libgomp1"
)


def examine() -> dict[str, Any]:
    """Try every part of the installation.

    Returns
    -------
    dict
        ``ok`` and ``checks``: ``name``, ``outcome`` (pass, caution, fail), ``finding``.
    """
    tries: list[tuple[str, Callable[[], tuple[str, str]]]] = [
        ("python", _python),
        *((name, _importer(name)) for name in _NEEDED),
        ("gmsh", _gmsh),
        ("pypardiso", _pardiso),
        ("a solved compression", _solve),
        ("a worker process", _worker),
    ]
    checks = []
    for name, attempt in tries:
        try:
            outcome, finding = attempt()
        except Exception as error:  # noqa: BLE001 - whatever fails is the finding
            outcome, finding = "fail", f"{type(error).__name__}: {error}"
        checks.append({"name": name, "outcome": outcome, "finding": finding})
    return {"ok": all(c["outcome"] != "fail" for c in checks), "checks": checks}


def _python() -> tuple[str, str]:
    return ("pass" if sys.version_info >= (3, 11) else "fail"), platform.python_version()


def _importer(name: str) -> Callable[[], tuple[str, str]]:
    def attempt() -> tuple[str, str]:
        importlib.import_module(name)
        package = {"skfem": "scikit-fem"}.get(name, name)
        return "pass", metadata.version(package)

    return attempt


def _gmsh() -> tuple[str, str]:
    try:
        importlib.import_module("gmsh")
    except OSError as error:
        return "fail", f"{error}; a system library is missing: {_SYSTEM_LIBRARIES}"
    return "pass", metadata.version("gmsh")


def _pardiso() -> tuple[str, str]:
    try:
        return "pass", metadata.version("pypardiso")
    except metadata.PackageNotFoundError:
        slow = "not installed: 3D runs about 20 times slower on SuperLU"
        return "caution", f"{slow} (pip install 'study[fast]')"


def _solve() -> tuple[str, str]:
    """Compress a cylinder and compare with the closed form."""
    import numpy as np

    config = {
        "specimen": {"shape": "cylinder", "radius_mm": 10.0, "height_mm": 10.0},
        "test": {"kind": "compression", "interface": "frictionless", "displacement_mm": 1.0,
                 "steps": 2},
        "material": {"model": "neo-hookean", "constants": {"C10": 0.01}, "poisson_ratio": 0.499},
        "model": {"space": "axisymmetric", "mesh_size_mm": 5.0},
    }  # fmt: skip
    solution = finite_element.solve(problem_of(config))
    exact = closed_form.compression(
        specimen_of(config["specimen"]),
        MaterialSection.of(config).material(),
        np.array([1.0]),
    )
    error = abs(solution.curve.force_N[-1] / exact.force_N[0] - 1)
    finding = f"force within {error:.1e} of the closed form, by {solution.solver}"
    return ("pass" if error < 1e-6 else "fail"), finding


def _worker() -> tuple[str, str]:
    (outcome,) = processes(1, 60.0).run([Task("ping", lambda _: {"kind": "ping"})])
    good = outcome.result["status"] == "converged"
    return ("pass" if good else "fail"), f"answered in {outcome.seconds:.1f} s"
