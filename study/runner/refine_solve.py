"""One forward solution of a series: its curve, its size and its cost, in plain values."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from study.runner import build, fits
from study.runner.compiled import load_compiled
from study.runner.identity import code_version, digest

Config = Mapping[str, Any]

_SECTIONS = ("specimen", "test", "material", "model")


def solve_task(
    config: Config, size_mm: float, *, more_steps: int = 1, looser: float = 1.0
) -> dict[str, Any]:
    """Task of one solution, complete in itself.

    Parameters
    ----------
    config : mapping
        Resolved sections of a problem.
    size_mm : float
        Element size.
    more_steps : int
        How many load steps replace one of the problem.
    looser : float
        How much the solver's tolerance is multiplied by.
    """
    sections = {k: config[k] for k in _SECTIONS if k in config}
    sections["model"] = {**sections["model"], "mesh": None, "mesh_size_mm": size_mm}
    steps = int(sections["test"].get("steps") or 10) * more_steps
    sections["test"] = {**sections["test"], "steps": steps}
    return {"kind": "solve", "config": sections, "looser": looser}


def task_key(task: Mapping[str, Any]) -> str:
    """Name of a solution: a hash of the problem and of the code."""
    return digest([task["config"], task["looser"], code_version()], 32)


def perform(task: Mapping[str, Any]) -> dict[str, Any]:
    """Solve; what did not converge is a status.

    Returns
    -------
    dict
        ``status``, ``message``, ``curve``, ``elements``, ``dofs``, ``mesh_hash``,
        ``seconds`` (of the solution, compilation excluded), ``memory_MB`` (peak) and
        ``base_MB`` (before).
    """
    problem = build.problem(task["config"])
    load_compiled(problem)
    reset_peak()
    before = peak_MB()
    options = _options(float(task["looser"]))
    solution = fits.solve(problem, gradients=False, **options)
    return {
        "status": str(solution.status),
        "message": str(solution.message),
        "curve": solution.curve.as_dict(),
        "elements": int(solution.elements),
        "dofs": int(solution.dofs),
        "mesh_hash": str(solution.mesh_hash),
        "seconds": float(getattr(solution, "seconds", {}).get("total", 0.0)),
        "memory_MB": peak_MB(),
        "base_MB": before,
    }


def _options(looser: float) -> dict[str, Any]:
    if looser == 1.0:
        return {}
    from study.forward.solve import Options

    plain = Options()
    newton = replace(plain.newton, tolerance=plain.newton.tolerance * looser)
    return {"options": replace(plain, newton=newton)}


def reset_peak() -> None:
    """Forget the peak memory of what this process did before; only Linux can."""
    with contextlib.suppress(OSError), open("/proc/self/clear_refs", "w") as stream:
        stream.write("5")


def peak_MB() -> float:  # noqa: N802
    """Peak memory of this process in MB since :func:`reset_peak`."""
    with contextlib.suppress(OSError), open("/proc/self/status") as stream:
        for line in stream:
            if line.startswith("VmHWM:"):
                return float(line.split()[1]) / 1024
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
