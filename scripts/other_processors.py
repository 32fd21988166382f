"""Run tests as other processors and installations would, and say which of them end otherwise.

    python scripts/other_processors.py [--setting NAME ...] [--workers N] [TEST ...]

Numbers may differ between processors in their last digits alone; a test that passes on one and
fails on another stands on rounding, or on the choice that a mesher makes of it.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

#: results of each setting
FOLDER = ROOT / ".venv" / "other-processors"

#: hides PARDISO in every process of a run: a module that is None is not found
WITHOUT_PARDISO = 'import sys\n\nsys.modules["pypardiso"] = None\n'

#: variables of each setting; the first is this machine as it is
SETTINGS: dict[str, dict[str, str]] = {
    "usual": {},
    "openblas-haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "openblas-skylakex": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "openblas-prescott": {"OPENBLAS_CORETYPE": "Prescott"},
    "mkl-compatible": {"MKL_CBWR": "COMPATIBLE"},
    "superlu": {"PYTHONPATH": str(FOLDER / "without-pardiso")},
    "numba-generic": {"NUMBA_CPU_NAME": "generic"},
}

ONE_THREAD = {
    f"{library}_NUM_THREADS": "1" for library in ("OMP", "MKL", "OPENBLAS", "NUMBA")
}  # fmt: skip

#: how a test may end, by the element that its case has in pytest's XML
_ENDS = {"failure": "failed", "error": "error", "skipped": "skipped"}


def environment(setting: str) -> dict[str, str]:
    """Variables of a run; what it needs on disk is made."""
    hidden = FOLDER / "without-pardiso" / "sitecustomize.py"
    hidden.parent.mkdir(parents=True, exist_ok=True)
    hidden.write_text(WITHOUT_PARDISO, encoding="utf-8")
    # kernels of another processor do not mix with these: numba keeps them by its name
    return {**os.environ, **ONE_THREAD, **SETTINGS[setting]}


def outcomes(report: str) -> dict[str, str]:
    """How every test of one of pytest's XML reports ended, by its name."""
    found = {}
    for case in ElementTree.fromstring(report).iter("testcase"):
        ends = [_ENDS[part.tag] for part in case if part.tag in _ENDS]
        found[f"{case.get('classname')}::{case.get('name')}"] = ends[0] if ends else "passed"
    return found


def differences(usual: Mapping[str, str], other: Mapping[str, str]) -> list[tuple[str, str, str]]:
    """List the tests that end in two ways: their names, the usual way and the other."""
    missing = "not run"
    return [
        (name, usual.get(name, missing), other.get(name, missing))
        for name in sorted({*usual, *other})
        if usual.get(name) != other.get(name)
    ]


def run(setting: str, tests: Sequence[str], workers: int) -> dict[str, str]:
    """Run tests in a setting; without a report of pytest the script ends."""
    report = FOLDER / f"{setting}.xml"
    report.unlink(missing_ok=True)
    command = [sys.executable, "-m", "pytest", "-q", f"--junitxml={report}"]
    command += ["-n", str(workers), "--dist", "loadfile"] if workers > 1 else []
    began, surroundings = time.monotonic(), environment(setting)
    done = subprocess.run(
        [*command, *tests], cwd=ROOT, env=surroundings, capture_output=True, text=True, check=False
    )
    if not report.is_file():
        raise SystemExit(f"{setting}: pytest wrote no report\n{done.stdout}{done.stderr}")
    ends = outcomes(report.read_text(encoding="utf-8"))
    count = ", ".join(f"{list(ends.values()).count(end)} {end}" for end in sorted({*ends.values()}))
    print(f"{setting}: {count} in {time.monotonic() - began:.0f} s", flush=True)
    return ends


def main() -> int:
    """Run the tests in every setting and print those that differ; 1 where one fails or differs."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("tests", nargs="*", default=["tests"], help="files or folders of tests")
    parser.add_argument("--setting", action="append", choices=list(SETTINGS)[1:])
    parser.add_argument("--workers", type=int, default=1)
    asked = parser.parse_args()
    usual = run("usual", asked.tests, asked.workers)
    bad = [name for name, end in usual.items() if end in ("failed", "error")]
    for name in bad:
        print(f"    {name}: {usual[name]}")
    for setting in asked.setting or list(SETTINGS)[1:]:
        for name, here, there in differences(usual, run(setting, asked.tests, asked.workers)):
            print(f"    {name}: {here} on this machine, {there} with {setting}")
            bad.append(name)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
