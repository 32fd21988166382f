"""CalculiX: a displacement element, as it has no mixed one for solids.

C3D10 (quadratic tetrahedron, 4 points) and CAX6 with full integration lock at K/mu = 1000,
so that the force is some percent high: the row shows how long the run takes, and by how much
the force differs.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.exchange import Answer, NoAnswerError, NotInstalledError, Task, midpoints

if shutil.which("ccx") is None:
    raise NotInstalledError


def lines(name: str, numbers: np.ndarray) -> Iterator[str]:
    """Give a node set, counted from 1."""
    yield f"*NSET, NSET={name}"
    for row in np.array_split(numbers + 1, max(1, len(numbers) // 8)):
        yield ", ".join(map(str, row)) + ","


def deck(task: Task) -> Iterator[str]:
    """Input deck."""
    points, cells = midpoints(task.points, task.cells)
    kind = "CAX6" if task.axisymmetric else "C3D10"
    yield "*NODE, NSET=NALL"
    for number, point in enumerate(points, 1):
        yield f"{number}, " + ", ".join(f"{x:.15g}" for x in point)
    yield f"*ELEMENT, TYPE={kind}, ELSET=EALL"
    for number, cell in enumerate(cells + 1, 1):
        yield f"{number}, " + ", ".join(map(str, cell))
    yield from conditions(task, points)
    yield "*MATERIAL, NAME=GEL\n*HYPERELASTIC, NEO HOOKE"
    yield f"{task.c10!r}, {2 / task.bulk!r}"
    yield "*SOLID SECTION, ELSET=EALL, MATERIAL=GEL"
    yield from load(task)


def conditions(task: Task, points: np.ndarray) -> Iterator[str]:
    """Give the sets of nodes and what holds them."""
    dim = points.shape[1]
    planes = {"MIDDLE": (dim - 1, task.middle_mm), "PLATE": (dim - 1, task.top_mm)}
    planes |= {f"PLANE{axis + 1}": (axis, 0.0) for axis in range(dim - 1)}
    for name, (axis, at) in planes.items():
        yield from lines(name, np.flatnonzero(np.abs(points[:, axis] - at) < 1e-9))
    yield "*BOUNDARY"
    yield f"MIDDLE, {dim}, {dim}"
    for axis in range(1, dim):
        yield f"PLANE{axis}, {axis}, {axis}\nPLATE, {axis}, {axis}"


def load(task: Task) -> Iterator[str]:
    """Equal steps without cutting, the residual over the mean force as small as elsewhere."""
    dim = task.points.shape[1]
    yield "*STEP, NLGEOM, INC=1000"
    yield f"*STATIC, DIRECT\n{1 / task.steps!r}, 1."
    yield "*CONTROLS, PARAMETERS=FIELD"
    yield f"{task.tolerance!r}, 1., , , {task.tolerance!r}, 1e-12, 1e-6"
    yield f"*BOUNDARY\nPLATE, {dim}, {dim}, {task.plate_mm(task.steps)!r}"
    yield "*NODE PRINT, NSET=PLATE, TOTALS=ONLY, FREQUENCY=1\nRF\n*END STEP"


def run(folder: Path) -> tuple[str, dict[str, Any]]:
    """Return what the program printed, and what it took."""
    began = time.perf_counter()
    with (folder / "log").open("w") as log:
        child = subprocess.Popen(["ccx", "-i", "deck"], cwd=folder, stdout=log, stderr=log)
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    seconds = time.perf_counter() - began
    said = (folder / "log").read_text(errors="replace")
    if child.returncode or "*ERROR" in said:
        last = (said.strip().splitlines() or ["it said nothing"])[-1].strip()
        # with equal steps it ends at the first one that it would have to cut
        stopped = "divergence" in said or "best solution and residuals" in said
        raise NoAnswerError("diverged" if stopped else last)
    took = {"seconds": seconds, "cpu_s": usage.ru_utime + usage.ru_stime}
    return said, took | {"peak_MB": usage.ru_maxrss / 1024}


def solve(task: Task) -> Answer:
    """Write the deck (not timed), run the program, read the force."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "deck.inp").write_text("\n".join(deck(task)) + "\n", encoding="utf-8")
        said, took = run(folder)
        table = (folder / "deck.dat").read_text(encoding="utf-8")
    forces = re.findall(r"total force.*?\n\s*\n\s*(.+)", table)
    if len(forces) < task.steps:
        raise NoAnswerError(f"stopped after {len(forces)} of {task.steps} steps")
    # CalculiX makes a wedge of 2 degrees of an axisymmetric element
    sectors = 180.0 if task.axisymmetric else task.scale
    axial = -float(forces[-1].split()[task.points.shape[1] - 1])
    unknowns = int((re.findall(r"number of equations\s+(\d+)", said) or [0])[0])
    iterations = len(re.findall(r"^ iteration\s+\d+", said, flags=re.MULTILINE))
    return Answer(sectors * axial, iterations, unknowns, "SPOOLES", **took)
