"""What every test shares: one thread a process, and the place of the shared measurements."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from hypothesis import settings

# Before any test imports numpy: pytest-xdist already uses the cores, and threads inside
# a worker would make times and the last digits of sums depend on the machine.
for _variable in (
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "NUMBA_NUM_THREADS",
):
    os.environ.setdefault(_variable, "1")

# A process that imports the package takes 3.1 s where it compiles every module, and 1.0 s where an
# earlier one left them; tests start hundreds.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# The same examples every time, and no deadline: the first call of a kernel compiles it.
settings.register_profile("study", deadline=None, derandomize=True)
settings.load_profile("study")

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the shared measurements: ``STUDY_DATA`` if set, else ``../shared/data``."""
    folder = Path(os.environ.get("STUDY_DATA") or ROOT.parent / "shared" / "data").resolve()
    if not folder.is_dir():
        pytest.skip(f"shared measurement folder not found: {folder} (set STUDY_DATA)")
    return folder
