"""Run tests as other processors and installations would, and say which of them end otherwise.

    python scripts/other_processors.py [--setting NAME[+NAME...] ...] [--workers N] [TEST ...]

Settings joined by + hold together in one run. What does not pass there is run once more as this
machine is: ``make test`` says that the others pass here. Numbers may differ between processors in
their last digits alone; a test that passes on one and fails on another stands on rounding, or on
the choice that a mesher makes of it.
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

#: variables of each setting
SETTINGS: dict[str, dict[str, str]] = {
    "openblas-haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "openblas-skylakex": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "openblas-prescott": {"OPENBLAS_CORETYPE": "Prescott"},
    "mkl-compatible": {"MKL_CBWR": "COMPATIBLE"},
    "superlu": {"PYTHONPATH": str(FOLDER / "without-pardiso")},
    "numba-generic": {"NUMBA_CPU_NAME": "generic"},
}

#: name of a run with none of them
USUAL = "usual"

ONE_THREAD = {
    f"{library}_NUM_THREADS": "1" for library in ("OMP", "MKL", "OPENBLAS", "NUMBA")
}  # fmt: skip

#: how a test may end, by the element that its case has in pytest's XML
_ENDS = {"failure": "failed", "error": "error", "skipped": "skipped"}


def environment(setting: str) -> dict[str, str]:
    """Variables of a run in settings joined by +, or as usual; what it needs on disk is made."""
    hidden = FOLDER / "without-pardiso" / "sitecustomize.py"
    hidden.parent.mkdir(parents=True, exist_ok=True)
    hidden.write_text(WITHOUT_PARDISO, encoding="utf-8")
    surroundings = {**os.environ, **ONE_THREAD}
    for name in [] if setting == USUAL else setting.split("+"):
        surroundings |= SETTINGS[name]
        if name.startswith("numba"):
            surroundings["XDG_CACHE_HOME"] = str(FOLDER / name)
    return surroundings


def settings_of(text: str) -> str:
    """Check settings joined by +, each of them known and of a library of its own."""
    names = text.split("+")
    if not {*names} <= {*SETTINGS}:
        raise argparse.ArgumentTypeError(f"settings are {', '.join(SETTINGS)}, joined by +")
    variables = [variable for name in names for variable in SETTINGS[name]]
    if len({*variables}) < len(variables):
        raise argparse.ArgumentTypeError(f"two of {text} set the same variable")
    return text


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


def selectors(names: Sequence[str]) -> list[str]:
    """Arguments with which pytest runs these tests again: ``file::class::test``."""
    chosen = []
    for name in names:
        place, test = name.split("::", 1)
        parts = place.split(".")
        length = next(
            n for n in range(len(parts), -1, -1)
            if n == 0 or (ROOT / f"{'/'.join(parts[:n])}.py").is_file()
        )  # fmt: skip
        if length:
            chosen.append("::".join([f"{'/'.join(parts[:length])}.py", *parts[length:], test]))
    return chosen


def run(setting: str, tests: Sequence[str], workers: int, durations: int = 0) -> dict[str, str]:
    """Run tests in a setting; without a report of pytest the script ends."""
    report = FOLDER / f"{setting}.xml"
    report.unlink(missing_ok=True)
    command = [sys.executable, "-m", "pytest", "-q", f"--junitxml={report}"]
    command += ["-n", str(workers), "--dist", "loadfile"] if workers > 1 else []
    command += [f"--durations={durations}"] if durations else []
    began, surroundings = time.monotonic(), environment(setting)
    done = subprocess.run(
        [*command, *tests], cwd=ROOT, env=surroundings, capture_output=True, text=True, check=False
    )
    if not report.is_file():
        raise SystemExit(f"{setting}: pytest wrote no report\n{done.stdout}{done.stderr}")
    (FOLDER / f"{setting}.txt").write_text(done.stdout, encoding="utf-8")
    ends = outcomes(report.read_text(encoding="utf-8"))
    count = ", ".join(f"{list(ends.values()).count(end)} {end}" for end in sorted({*ends.values()}))
    print(f"{setting}: {count} in {time.monotonic() - began:.0f} s", flush=True)
    return ends


def main() -> int:
    """Run the tests in every setting and print those that differ; 1 where one fails."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("tests", nargs="*", default=["tests"], help="files or folders of tests")
    parser.add_argument("--setting", action="append", type=settings_of, metavar="NAME[+NAME...]")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--durations", type=int, default=0, help="slowest tests in the text kept")
    asked = parser.parse_args()
    failed = 0
    for setting in asked.setting or SETTINGS:
        ends = run(setting, asked.tests, asked.workers, asked.durations)
        bad = {name: end for name, end in ends.items() if end in ("failed", "error")}
        failed += len(bad)
        again = selectors(list(bad))
        usual = run(USUAL, again, asked.workers) if again else {}
        for name, here, there in differences(usual, bad):
            print(f"    {name}: {here} on this machine, {there} with {setting}", flush=True)
        for name in bad.keys() & usual.keys():
            if usual[name] == bad[name]:
                print(f"    {name}: {bad[name]} on this machine, too", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
