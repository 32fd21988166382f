"""The gates are alive: a breach is planted into a small copy of the house, and each one sees it.

A gate that nobody has seen fail may check nothing. The copy has the rooms of the project
with empty modules, and the project's own pyproject.toml.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
ROOMS = (
    "runner",
    "reporting",
    "forward",
    "calibration",
    "analysis",
    "record",
    "design",
    "material",
)
MODULES = ("__init__", "cli", "api", "curve", "units", "errors")


@pytest.fixture
def house(tmp_path: Path) -> Path:
    """Copy of the project with every room and no content."""
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    package = tmp_path / "study"
    package.mkdir()
    (tmp_path / "tests").mkdir()
    for module in MODULES:
        (package / f"{module}.py").write_text('"""Nothing yet."""\n')
    for room in ROOMS:
        (package / room).mkdir()
        (package / room / "__init__.py").write_text('"""Nothing yet."""\n')
    return tmp_path


def gate(house: Path, *command: str) -> subprocess.CompletedProcess[str]:
    """Run a gate in the copy, with the tools of this environment."""
    tool = Path(sys.executable).parent / command[0]
    environment = {**os.environ, "PYTHONPATH": str(house), "NO_COLOR": "1"}
    return subprocess.run(
        [str(tool), *command[1:]],
        cwd=house,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


STYLE = ("ruff", "check", "--no-cache", ".")
FORMAT = ("ruff", "format", "--no-cache", "--check", ".")
TYPES = ("mypy", "study")
LAYERS = ("lint-imports", "--no-cache")
TESTS = ("python", "-m", "pytest", "-q", "-p", "no:cacheprovider")


@pytest.mark.parametrize("command", [STYLE, FORMAT, TYPES, LAYERS], ids=lambda c: " ".join(c[:2]))
def test_a_gate_lets_the_clean_house_pass(house: Path, command: tuple[str, ...]) -> None:
    run = gate(house, *command)
    assert run.returncode == 0, run.stdout + run.stderr


@pytest.mark.parametrize(
    ("code", "rule"),
    [
        ("import os\n", "F401"),
        ("def area(radius):\n    return radius\n", "D103"),
        ("import numpy as np\n\nnp.random.seed(1)\n", "NPY002"),
        ("x = 1  # " + 100 * "-" + "\n", "E501"),
    ],
)
def test_style_sees(house: Path, code: str, rule: str) -> None:
    (house / "study" / "breach.py").write_text('"""A breach."""\n\n' + code)
    run = gate(house, *STYLE)
    assert run.returncode == 1
    assert rule in run.stdout


def test_format_sees_single_quotes(house: Path) -> None:
    (house / "study" / "breach.py").write_text("name = 'cone'\n")
    run = gate(house, *FORMAT)
    assert run.returncode == 1
    assert "breach.py" in run.stdout


def test_types_sees_a_missing_and_a_wrong_type(house: Path) -> None:
    (house / "study" / "breach.py").write_text(
        "def area(radius):\n    return radius\n\n\nwidth: float = 'wide'\n"
    )
    run = gate(house, *TYPES)
    assert run.returncode == 1
    assert "[no-untyped-def]" in run.stdout
    assert "[assignment]" in run.stdout


# Module that breaks the rule, the import it makes, and the contract that must say so.
BREACHES = [
    ("errors", "study.units", "Each layer imports only those below it"),
    ("design/a", "study.record", "Each layer imports only those below it"),
    ("forward/a", "study.analysis", "Each layer imports only those below it"),
    ("runner/a", "study.reporting", "Each layer imports only those below it"),
    ("material/a", "study.curve", "Each layer imports only those below it"),
    ("api", "study.cli", "Each layer imports only those below it"),
    ("utils", "study.errors", "Each layer imports only those below it"),
    ("forward/a", "pandas", "forward and calibration know nothing of experiments"),
    ("calibration/a", "study.record", "forward and calibration know nothing of experiments"),
    ("calibration/a", "study.design", "forward and calibration know nothing of experiments"),
    ("reporting/a", "study.forward", "reporting computes nothing"),
    ("reporting/a", "study.calibration", "reporting computes nothing"),
    ("runner/a", "gmsh", "gmsh, meshio and scikit-fem only in forward"),
    ("record/a", "meshio", "gmsh, meshio and scikit-fem only in forward"),
    ("calibration/a", "skfem.helpers", "gmsh, meshio and scikit-fem only in forward"),
    ("cli", "matplotlib.pyplot", "matplotlib and seaborn only in reporting"),
    ("analysis/a", "seaborn", "matplotlib and seaborn only in reporting"),
    ("reporting/a", "statsmodels.api", "statsmodels only in analysis"),
]


@pytest.mark.parametrize(("module", "imported", "contract"), BREACHES)
def test_layers_sees(house: Path, module: str, imported: str, contract: str) -> None:
    # Inside a function, because that is where an import of a heavy package stands.
    (house / "study" / f"{module}.py").write_text(f"def late():\n    import {imported}\n")
    run = gate(house, *LAYERS)
    assert run.returncode == 1
    assert f"{contract} BROKEN" in run.stdout, run.stdout + run.stderr


def test_layers_lets_each_room_use_what_is_its_own(house: Path) -> None:
    own = {"forward": ("gmsh", "skfem"), "reporting": ("seaborn",), "analysis": ("statsmodels",)}
    for room, packages in own.items():
        lines = "".join(f"import {package}\n" for package in packages)
        (house / "study" / room / "__init__.py").write_text(lines)
    run = gate(house, *LAYERS)
    assert run.returncode == 0, run.stdout + run.stderr


def test_a_warning_fails_a_test(house: Path) -> None:
    (house / "tests" / "test_breach.py").write_text(
        "import warnings\n\n\ndef test_warns():\n    warnings.warn('careful', stacklevel=1)\n"
    )
    run = gate(house, *TESTS, "tests")
    assert run.returncode == 1
    assert "UserWarning: careful" in run.stdout


def test_doctests_of_the_package_are_run(house: Path) -> None:
    (house / "study" / "breach.py").write_text('"""A breach.\n\n>>> 1 + 1\n3\n"""\n')
    run = gate(house, *TESTS, "study")
    assert run.returncode == 1
    assert "study.breach" in run.stdout


def test_slow_tests_are_left_out_unless_asked_for(house: Path) -> None:
    (house / "tests" / "test_breach.py").write_text(
        "import pytest\n\n\n@pytest.mark.slow\n@pytest.mark.verify\n"
        "def test_long():\n    raise RuntimeError\n\n\ndef test_short():\n    pass\n"
    )
    assert gate(house, *TESTS, "tests").returncode == 0
    assert gate(house, *TESTS, "-m", "verify", "tests").returncode == 1


@pytest.mark.parametrize("broken", [None, "test", "lint", "format-check", "types", "layers"])
def test_ci_names_the_gate_that_failed(tmp_path: Path, broken: str | None) -> None:
    (tmp_path / ".ci").mkdir()
    shutil.copy(ROOT / ".ci" / "run", tmp_path / ".ci")
    tools = tmp_path / "bin"
    tools.mkdir()
    make = tools / "make"
    make.write_text(
        f'#!/bin/sh\nfor last; do :; done\necho "ran $last"\n[ "$last" != "{broken}" ]\n'
    )
    make.chmod(0o755)
    run = subprocess.run(
        [str(tmp_path / ".ci" / "run")],
        env={"PATH": f"{tools}:{os.environ['PATH']}"},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    # The others still run: one look at the log tells everything that is wrong.
    for name in ("test", "lint", "format-check", "types", "layers", "doctests"):
        assert f"ran {name}\n" in run.stdout
    assert run.returncode == (0 if broken is None else 1)
    assert run.stderr.strip() == ("" if broken is None else f"failed: {broken}")
