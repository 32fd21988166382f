"""Start one code on one task in a process of its own, so that no crash ends the rest."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.peers import NAMES

ROOT = Path(__file__).resolve().parents[1]
_THREAD_VARIABLES = (
    "OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS",
)  # fmt: skip


def interpreter(code: str, chosen: dict[str, str]) -> str:
    """Python that a code runs in: ``--python``, the environment, or the usual one."""
    variable = f"BENCH_PYTHON_{code.upper().replace('-', '_')}"
    return chosen.get(code) or os.environ.get(variable) or NAMES[code].python or sys.executable


def environment(threads: int, processes: int = 1) -> dict[str, str]:
    """As many threads in all, whatever the code's library; its processes share them."""
    each = str(max(1, threads // processes))
    return os.environ | dict.fromkeys(_THREAD_VARIABLES, each) | {"PYTHONPATH": str(ROOT)}


def run(
    code: str,
    folder: Path,
    *,
    python: dict[str, str],
    repeats: int,
    limit_s: float,
    threads: int,
    processes: int = 1,
) -> dict[str, Any]:
    """Return what the child wrote, or ``{"problem": why}``."""
    program = interpreter(code, python)
    if shutil.which(program) is None:
        return {"problem": "not installed"}
    with tempfile.TemporaryDirectory() as name:
        result = Path(name) / "result.json"
        arguments = ["-m", "benchmarks.child", code, str(folder), str(result)]
        command = [program, *arguments, "--repeats", str(repeats)]
        shared = processes if NAMES[code].parallel else 1
        variables = environment(threads, shared)
        if shared > 1:
            command = ["mpirun", "-n", str(shared), *command]
            # in a container there may be no other user
            variables |= {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
        problem = waited(command, variables, limit_s)
        if result.exists():
            found: dict[str, Any] = json.loads(result.read_text(encoding="utf-8"))
            return found
    return {"problem": problem}


def waited(command: list[str], variables: dict[str, str], limit_s: float) -> str:
    """Run to the end or to the limit; say what went wrong."""
    with tempfile.TemporaryFile("w+") as said:
        child = subprocess.Popen(
            command, cwd=ROOT, env=variables, stdout=said, stderr=said, start_new_session=True
        )
        try:
            child.wait(limit_s)
        except subprocess.TimeoutExpired:
            return f"stopped after {limit_s:.0f} s"
        finally:
            # what the code started itself goes with it
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGKILL)
            child.wait()
        said.seek(0)
        lines = said.read().strip().splitlines()
    return f"crashed ({child.returncode}): {lines[-1] if lines else 'it said nothing'}"
