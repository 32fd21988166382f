"""``study --help`` and ``import study`` load nothing that costs time."""

from __future__ import annotations

import subprocess
import sys

import pytest

# Each of these takes from a tenth of a second to seconds; a clock would make the test
# depend on the machine, so it counts modules instead.
HEAVY = (
    "numba",
    "gmsh",
    "skfem",
    "meshio",
    "statsmodels",
    "scipy.stats",
    "scipy.sparse",
    "pandas",
    "matplotlib",
    "seaborn",
    "pypardiso",
    "dask",
)


@pytest.mark.parametrize("module", ["study", "study.cli"])
def test_import_is_light(module: str) -> None:
    code = f"import sys, {module}; print(*sorted(set({HEAVY!r}) & set(sys.modules)))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stdout.split() == []
