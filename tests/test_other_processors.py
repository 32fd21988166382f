"""The script that runs tests as other processors would: what it reads, compares and hides."""

import argparse
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

VARIABLES = ["OPENBLAS_CORETYPE", "NUMBA_CPU_NAME", "PYTHONPATH", "MKL_CBWR"]

REPORT = """<?xml version="1.0"?><testsuites><testsuite>
<testcase classname="tests.a" name="test_x"/>
<testcase classname="tests.a" name="test_y"><failure message="1 != 2"/></testcase>
<testcase classname="tests.a" name="test_z"><skipped/></testcase>
</testsuite></testsuites>"""


def test_tests_that_end_otherwise_are_listed():
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


def test_every_setting_reaches_what_it_is_about(tmp_path, monkeypatch):
    for variable in VARIABLES:  # the test stands where the sweep itself runs it
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(script, "FOLDER", tmp_path)
    settings = {**script.SETTINGS, "superlu": {"PYTHONPATH": str(tmp_path / "without-pardiso")}}
    monkeypatch.setattr(script, "SETTINGS", settings)

    def printed(setting, code):
        command = [sys.executable, "-c", code]
        surroundings = script.environment(setting)
        done = subprocess.run(
            command, env=surroundings, cwd=ROOT, capture_output=True, text=True, check=True
        )
        return done.stdout.strip()

    code = "import importlib.util as u; print(u.find_spec('pypardiso') is None)"
    assert printed("superlu", code) == "True"
    code = (
        "import numba; from study.ground.compilation import private_folder as f; "
        "c = numba.config; print(c.CPU_NAME, repr(c.CPU_FEATURES), f())"
    )
    folder = tmp_path / "numba-generic" / "study"
    assert printed("numba-generic", code) == f"generic '' {folder}"
    code = "import numpy; from threadpoolctl import threadpool_info as t; print(t())"
    assert "'architecture': 'Haswell'" in printed("openblas-haswell", code)
    code = f"import os; print(*[os.environ.get(v) for v in {VARIABLES}])"
    together = printed("openblas-prescott+numba-generic+superlu", code)
    assert together == f"Prescott generic {tmp_path / 'without-pardiso'} None"
    assert printed(script.USUAL, f"{code[:-1]}[:2])") == "None None"


def test_settings_of_one_library_are_not_joined():
    assert script.settings_of("superlu+mkl-compatible") == "superlu+mkl-compatible"
    with pytest.raises(argparse.ArgumentTypeError, match="the same variable"):
        script.settings_of("openblas-haswell+openblas-prescott")
    with pytest.raises(argparse.ArgumentTypeError, match="joined by"):
        script.settings_of("openblas-haswell+atlas")


def test_what_fails_is_selected_for_the_usual_run():
    name = "tests.test_other_processors::test_what_fails_is_selected_for_the_usual_run"
    here = "tests/test_other_processors.py"
    assert script.selectors([name, f"{name}[a::b]", "tests.test_units.TestX::test_y"]) == [
        name.replace("tests.test_other_processors", here),
        f"{name}[a::b]".replace("tests.test_other_processors", here),
        "tests/test_units.py::TestX::test_y",
    ]
    assert script.selectors(["no.such.place::test"]) == []
