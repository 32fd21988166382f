"""One coarse curve of conical indentation with gradients, and what a second process compiles.

Run in two processes, one after the other: what the first one compiled the second one loads.
One thread each, as a worker of a study has.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from typing import Any

from benchmarks.launch import ROOT, environment

ASKED_S = 0.5
#: under the tip; about 3000 unknowns
SIZE_MM = 0.22


def measure() -> dict[str, Any]:
    """Seconds of the first and of later runs, and how many kernels had to be compiled."""
    from study.mechanics.material.material import Material
    from study.mechanics.setup.geometry import Cone, Cylinder
    from study.mechanics.setup.setup import Model, Problem
    from study.mechanics.setup.test_kind import Test
    from study.mechanics.solver.finite_element_solution import solve

    test = Test("indentation", 3.0, "frictionless", "bonded", steps=10, indenter=Cone(30.0, 1.0))
    gel = Material("neo-hookean", {"C10": 5e-3}, bulk_modulus=10.0)
    model = Model("axisymmetric", "quadratic", mesh_size_mm=SIZE_MM)
    problem = Problem(Cylinder(25.0, 50.0), test, gel, model)
    seconds = []
    for _ in range(4):
        began = time.perf_counter()
        found = solve(problem)
        seconds.append(time.perf_counter() - began)
        if found.status != "converged":
            raise RuntimeError(found.message)
    return {
        "unknowns": found.dofs,
        "first_s": seconds[0],
        "seconds": statistics.median(seconds[1:]),
        "iterations": sum(found.newton_iterations),
        "compiled": compiled(),
    }


def compiled() -> int:
    """Kernels of this process that were not found on disk."""
    found = 0
    for name, module in list(sys.modules.items()):
        if name.startswith("study."):
            for thing in vars(module).values():
                found += sum(getattr(getattr(thing, "stats", None), "cache_misses", {}).values())
    return found


def rows() -> list[dict[str, Any]]:
    """One row for each of the two processes."""
    command = [sys.executable, "-m", "benchmarks.indentation"]
    out = []
    for which in ("first process", "second process"):
        ran = subprocess.run(
            command, cwd=ROOT, env=environment(1), capture_output=True, text=True,
            check=True, timeout=600,
        )  # fmt: skip
        found = json.loads(ran.stdout)
        note = f"{which}: first curve {found.pop('first_s'):.2f} s, compiled "
        note += f"{found.pop('compiled')} kernels"
        out.append({"case": "indentation-3k", "code": "study", **found, "note": note})
    return out


if __name__ == "__main__":
    print(json.dumps(measure()))
