"""Machine code on disk: found by a second process, never older than its sources."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import study.compilation
from study.compilation import cache_folder

CALLEE = """
from compiled import kernel
@kernel()
def answer():
    return {answer}
"""
CALLER = """
from compiled import kernel
from callee import answer
@kernel()
def ask():
    return 1 * answer()
print(ask(), ask.stats.cache_hits.get((), 0))
"""
SIGNATURES = """
import sys
import numpy as np
from compiled import kernel
@kernel()
def total(x):
    return x.sum() + 1.0
print(total(np.ones((1,) * int(sys.argv[1]))), sum(total.stats.cache_hits.values()))
"""
#: the elements' forces and stiffness in an uneven state
DIGITS = """
import hashlib
import numpy as np
from tests.fem.homogeneous import system_of
from tests.fem.problems import MOONEY
from study.fem.element.assembly import assemble
system = system_of(MOONEY, element_order="quadratic")
x = system.start().x + 1e-3 * np.sin(np.arange(system.space.n))
system.internal.evaluate(MOONEY, x, system.tangent)
print(hashlib.sha256(system.data.tobytes()).hexdigest())
print(sum(assemble.stats.cache_hits.values()))
"""


def ask(folder: Path) -> tuple[int, int]:
    """Result, and whether it came from the cache."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache")}
    run = subprocess.run(
        [sys.executable, "caller.py"], cwd=folder, env=environment, capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    result, hits = run.stdout.split()
    return int(result), int(hits)


def test_a_change_in_another_file_is_seen(tmp_path: Path) -> None:
    """Numba alone would go on with the old answer: only the callee's file is new."""
    source = Path(study.compilation.__file__)
    shutil.copy(source, tmp_path / "compiled.py")
    (tmp_path / "caller.py").write_text(CALLER)
    (tmp_path / "callee.py").write_text(CALLEE.format(answer=41))
    assert ask(tmp_path) == (41, 0)
    assert ask(tmp_path) == (41, 1)
    (tmp_path / "callee.py").write_text(CALLEE.format(answer=42))
    assert ask(tmp_path) == (42, 0)


def together(folder: Path, dimensions: str) -> list[str]:
    """Whether each of several processes at once found its signature on disk."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache")}
    started = [
        subprocess.Popen(
            [sys.executable, "total.py", dimension], cwd=folder, env=environment,
            stdout=subprocess.PIPE, text=True,
        )
        for dimension in dimensions
    ]  # fmt: skip
    found = [process.communicate()[0].split() for process in started]
    assert all(float(result) == 2.0 for result, _ in found)
    return [hits for _, hits in found]


def test_of_processes_at_once_one_compiles(tmp_path: Path) -> None:
    """The others wait, and no process loses the entry of another in a kernel's index."""
    shutil.copy(study.compilation.__file__, tmp_path / "compiled.py")
    (tmp_path / "total.py").write_text(SIGNATURES)
    assert sorted(together(tmp_path, "1123")) == ["0", "0", "0", "1"]
    assert together(tmp_path, "123") == ["1", "1", "1"]


def test_a_folder_that_cannot_be_locked_is_used_without(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setattr(study.compilation, "cache_folder", lambda: str(tmp_path / "file"))
    lock_file = study.compilation._lock_file.__wrapped__
    monkeypatch.setattr(study.compilation, "_lock_file", lock_file)
    with study.compilation.only_process("work"):
        assert lock_file() is None


def test_the_folder_is_named_after_the_kernels() -> None:
    assert Path(cache_folder()).name.startswith("kernels-")


def digits(cache: Path) -> tuple[str, int]:
    """Hash of the elements' stiffness, and how many kernels came from the cache."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    run = subprocess.run(
        [sys.executable, "-c", DIGITS], cwd=Path(__file__).parents[2], env=environment,
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    found, hits = run.stdout.split()
    return found, int(hits)


@pytest.mark.slow
@pytest.mark.verify
def test_the_process_that_compiles_gets_the_same_digits(tmp_path: Path) -> None:
    """A study stopped in its first minute and resumed holds cases of both processes."""
    compiled, none = digits(tmp_path)
    found, hits = digits(tmp_path)
    assert (none, hits) == (0, 1)
    assert found == compiled
