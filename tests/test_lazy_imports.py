"""``study --help`` and ``import study`` load nothing that costs time."""

import subprocess
import sys

import pytest

# Each of these takes from a tenth of a second to seconds; a clock would make the test
# depend on the machine, so it counts modules instead.
HEAVY = (
    "numpy numba gmsh skfem meshio statsmodels scipy pandas matplotlib seaborn pypardiso dask "
    "distributed filelock"
)


@pytest.mark.parametrize("module", ["study", "study.cli"])
def test_import_is_light(module):
    code = f"import sys, {module}; print(*sorted(set({HEAVY.split()!r}) & set(sys.modules)))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stdout.split() == []


#: all distributions of scipy take 0.6 s of every verb; the rest is loaded where it is called
LATE = ("scipy.stats", "scipy.optimize", "scipy.spatial", "statsmodels", "matplotlib", "gmsh")


def test_verbs_that_need_no_distribution_load_none():
    code = f"""
import sys
from study.cli.app import run
for words in ("status nothing", "plan designs/demo.toml", "analyze validation/nothing.csv"):
    run(words.split())
    print()
    print("loaded after", words, *sorted(set({LATE!r}) & set(sys.modules)))
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert [line for line in run.stdout.splitlines() if line.startswith("loaded")] == [
        "loaded after status nothing",
        "loaded after plan designs/demo.toml",
        "loaded after analyze validation/nothing.csv",
    ]
