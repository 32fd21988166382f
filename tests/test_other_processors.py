"""The script that runs tests as other processors would: what it reads, compares and hides."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SPEC = importlib.util.spec_from_file_location(
    "other_processors", ROOT / "scripts" / "other_processors.py"
)
assert SPEC is not None
assert SPEC.loader is not None
script = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(script)

REPORT = """<?xml version="1.0"?><testsuites><testsuite>
<testcase classname="tests.a" name="test_x"/>
<testcase classname="tests.a" name="test_y"><failure message="1 != 2"/></testcase>
<testcase classname="tests.a" name="test_z"><skipped/></testcase>
</testsuite></testsuites>"""


def test_tests_that_end_otherwise_are_listed() -> None:
    ends = script.outcomes(REPORT)
    assert ends == {
        "tests.a::test_x": "passed", "tests.a::test_y": "failed", "tests.a::test_z": "skipped",
    }  # fmt: skip
    other = {**ends, "tests.a::test_y": "passed"}
    del other["tests.a::test_z"]
    assert script.differences(ends, other) == [
        ("tests.a::test_y", "failed", "passed"), ("tests.a::test_z", "skipped", "not run"),
    ]  # fmt: skip
    assert script.differences(ends, ends) == []


def test_every_setting_reaches_what_it_is_about(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(script, "FOLDER", tmp_path)
    settings = {**script.SETTINGS, "superlu": {"PYTHONPATH": str(tmp_path / "without-pardiso")}}
    monkeypatch.setattr(script, "SETTINGS", settings)

    def printed(setting: str, code: str) -> str:
        command = [sys.executable, "-c", code]
        surroundings = script.environment(setting)
        done = subprocess.run(
            command, env=surroundings, cwd=ROOT, capture_output=True, text=True, check=True
        )
        return done.stdout.strip()

    code = "import importlib.util as u; print(u.find_spec('pypardiso') is None)"
    assert printed("superlu", code) == "True"
    code = "import numba; c = numba.config; print(c.CPU_NAME, repr(c.CPU_FEATURES))"
    assert printed("numba-generic", code) == "generic ''"
    code = "import numpy; from threadpoolctl import threadpool_info as t; print(t())"
    assert "'architecture': 'Haswell'" in printed("openblas-haswell", code)
