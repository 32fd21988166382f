"""The kinds of task of a study, each with the function that does it in a worker."""

from __future__ import annotations

import contextlib
import importlib
import os
import platform
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any, cast

import numpy as np

from study.ground.errors import Fault, InputError, UnitError
from study.ground.memory import free_memory_MB
from study.ground.units import parse
from study.harness.design.cell import CellProblem
from study.harness.execution.cluster import Client, Cluster
from study.harness.execution.local import Loky
from study.harness.execution.task import Document, Executor, Perform, Task
from study.harness.runner import case, fit_task, solve_task
from study.harness.runner.job import CaseTask
from study.harness.runner.provenance import versions
from study.mechanics.forward import closed_form, finite_element

#: where a study is computed: an executor, or the scheduler of a Dask cluster by its address, its
#: scheduler file or a client of it
Engine = Executor | Client | str | Path

#: a task that only asks whether a worker answers
PING = "ping"
#: what does a task, by its class
KINDS: dict[type, Perform] = {
    CaseTask: case.perform,
    fit_task.FitTask: fit_task.perform,
    solve_task.SolveTask: solve_task.perform,
    str: lambda task: {"status": "converged"},
}


def perform(task: object) -> Document:
    """Do one task in a worker."""
    return KINDS[type(task)](task)


def processes(
    jobs: int | None = None,
    timeout_s: float | None = None,
    memory_MB: float | None = None,  # noqa: N803
) -> Executor:
    """Start processes of this machine, which know every kind of task."""
    return Loky(perform, jobs or default_jobs(), timeout_s, memory_MB or free_memory_MB())


def memory_of(text: str) -> float:
    """Read an amount of memory in MB.

    Examples
    --------
    >>> memory_of("20 GB")
    20000.0
    """
    try:
        amount_MB = parse(text, "memory")
    except UnitError as error:
        raise InputError([replace(fault, where="memory") for fault in error.faults]) from error
    if amount_MB <= 0:
        raise InputError(Fault("memory", f"must be more than zero, got {text!r}"))
    return amount_MB


def computing_on(
    engine: Engine,
    jobs: int | None = None,
    timeout_s: float | None = None,
    files: Sequence[Path] = (),
) -> Executor:
    """Find the executor that an engine means."""
    # a client of Dask has a ``run`` too, which is another one
    if isinstance(engine, str | os.PathLike) or hasattr(engine, "nthreads"):
        scheduler = cast("str | Path | Client", engine)
        return Cluster(perform, scheduler, versions, jobs, timeout_s, files).reached()
    return engine


def limit_of(place: Executor) -> float | None:
    """Wall-clock limit of one task of an executor in seconds; None where there is none."""
    return place.limit_s if isinstance(place, Loky | Cluster) else None


def adapted(place: Executor, longer: float = 1.0, alone: bool = False) -> Executor:
    """Copy an executor with a longer limit, or with one task at a time."""
    if not isinstance(place, Loky | Cluster):
        return place
    limit = None if place.limit_s is None else longer * place.limit_s
    longest = replace(place, limit_s=limit)
    return replace(longest, jobs=1) if alone else longest


def default_jobs() -> int:
    """One worker for each core that this process may use."""
    with contextlib.suppress(AttributeError):
        return max(1, len(os.sched_getaffinity(0)))
    return os.cpu_count() or 1


# Is the installation able to do the work? Every part is tried, not looked up.

_NEEDED = ("numpy", "scipy", "pandas", "numba", "skfem", "meshio", "matplotlib", "statsmodels")
_SYSTEM_LIBRARIES = (
    "apt-get install libglu1-mesa libgl1 libopengl0 libxcursor1 libxft2 libxinerama1 "
    "libxrender1 libxfixes3 libxext6 libfontconfig1 libgomp1"
)


def examine() -> dict[str, Any]:
    """Try every part of the installation."""
    tries: dict[str, Callable[[], tuple[str, str]]] = {
        "python": lambda: (
            "pass" if sys.version_info >= (3, 11) else "fail",
            platform.python_version(),
        ),
        **{name: partial(_imported, name) for name in (*_NEEDED, "gmsh")},
        "pypardiso": _pardiso,
        "a solved compression": _solve,
        "a worker process": _worker,
    }
    checks = []
    for name, attempt in tries.items():
        try:
            outcome, finding = attempt()
        except Exception as error:  # noqa: BLE001 - whatever fails is the finding
            outcome, finding = "fail", f"{type(error).__name__}: {error}"
            if name == "gmsh" and isinstance(error, OSError):
                finding = f"{error}; a system library is missing: {_SYSTEM_LIBRARIES}"
        checks.append({"name": name, "outcome": outcome, "finding": finding})
    return {"ok": all(c["outcome"] != "fail" for c in checks), "checks": checks}


def _imported(name: str) -> tuple[str, str]:
    importlib.import_module(name)
    return "pass", metadata.version({"skfem": "scikit-fem"}.get(name, name))


def _pardiso() -> tuple[str, str]:
    try:
        return "pass", metadata.version("pypardiso")
    except metadata.PackageNotFoundError:
        slow = "not installed: 3D runs about 20 times slower on SuperLU"
        return "caution", f"{slow} (pip install 'study[fast]')"


def _solve() -> tuple[str, str]:
    """Compress a cylinder and compare with the closed form."""
    config = {
        "specimen": {"shape": "cylinder", "radius_mm": 10.0, "height_mm": 10.0},
        "test": {"kind": "compression", "interface": "frictionless", "displacement_mm": 1.0,
                 "steps": 2},
        "material": {"model": "neo-hookean", "constants": {"C10": 0.01}, "poisson_ratio": 0.499},
        "model": {"space": "axisymmetric", "mesh_size_mm": 5.0},
    }  # fmt: skip
    problem = CellProblem.of(config).at()
    solution = finite_element.solve(problem)
    exact = closed_form.compression(problem.specimen, problem.material, np.array([1.0]))
    error = abs(solution.curve.force_N[-1] / exact.force_N[0] - 1)
    finding = f"force within {error:.1e} of the closed form, by {solution.solver}"
    return ("pass" if error < 1e-6 else "fail"), finding


def _worker() -> tuple[str, str]:
    (outcome,) = processes(1, 60.0).run([Task(PING, lambda _: PING)])
    good = outcome.result["status"] == "converged"
    return ("pass" if good else "fail"), f"answered in {outcome.seconds:.1f} s"
