"""Time of one call of an exported force law: in numpy, in plain Python, in C.

The law is that of a rounded punch on a cylinder with two constants; displacements are random, so
that no branch is predicted and no interval is kept.
"""

from __future__ import annotations

import importlib.util
import math
import shutil
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import study

#: What is asked, in microseconds a call.
ASKED_US = {"numpy, 1000 points": 2.0, "Python": 20.0, "C": 0.2}
PROBLEM = """
schema = 1
[specimen]
shape = "cylinder"
radius = "25 mm"
height = "30 mm"
[test]
kind = "indentation"
interface = "frictionless"
displacement = "4 mm"
steps = 10
indenter = { shape = "flat", radius = "5 mm", edge_radius = "1 mm" }
[material]
model = "reduced-polynomial"
C10 = "5 kPa"
C20 = "1 kPa"
poisson_ratio = 0.4995
[model]
mesh = "coarse"
"""
PROGRAM = r"""
#include <stdio.h>
#include <time.h>
#include "punch_force_law.h"
#define PLACES 4096
#define ROUNDS 2000
int main(void)
{
    static double places[PLACES];
    const double other[2] = { 0.0052, 0.0009 };
    double sum = 0.0;
    unsigned long seed = 1;
    clock_t began;
    int i, k;
    for (i = 0; i < PLACES; ++i) {
        seed = (seed * 1103515245UL + 12345UL) % 2147483648UL;
        places[i] = 4.0 * (double)seed / 2147483648.0;
    }
    began = clock();
    for (k = 0; k < ROUNDS; ++k)
        for (i = 0; i < PLACES; ++i)
            sum += punch_force_law_force_with(places[i], other);
    printf("%.17g\n", (double)(clock() - began) / CLOCKS_PER_SEC / PLACES / ROUNDS);
    return sum > 0.0 ? 0 : 1;
}
"""


def main() -> None:
    """Print a row for every form."""
    print("\na call of an exported force law with other constants, median of 7")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "punch.toml").write_text(PROBLEM)
        law = study.export(folder / "punch.toml", out=folder).law
        places = np.random.default_rng(1).uniform(0, 4, 1000)
        other = {"C10": 0.0052, "C20": 0.0009}
        found = {
            "numpy, 1000 points": median(lambda: law.force_at(places, other)) / places.size,
            "Python": in_python(folder / "punch_force_law.py", places, other),
            "C": in_c(folder),
        }
    for form, seconds in found.items():
        asked = ASKED_US[form]
        if math.isnan(seconds):
            print(f"{form:<20}no gcc")
            continue
        met = "met" if 1e6 * seconds <= asked else "MISSED"
        print(f"{form:<20}{1e6 * seconds:8.4f} us, asked at most {asked:g}: {met}")


def median(call: Callable[[], object], repeats: int = 7, rounds: int = 200) -> float:
    """Seconds of one call."""
    call()
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        for _ in range(rounds):
            call()
        seconds.append((time.perf_counter() - began) / rounds)
    return statistics.median(seconds)


def in_python(path: Path, places: np.ndarray, other: dict[str, float]) -> float:
    """Seconds of one call of the generated module, one displacement at a time."""
    spec = importlib.util.spec_from_file_location("punch_force_law", path)
    if spec is None or spec.loader is None:
        raise RuntimeError(f"{path} cannot be imported")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    single = places.tolist()

    def call() -> None:
        for place in single:
            module.force(place, **other)

    return median(call, rounds=5) / len(single)


def in_c(folder: Path) -> float:
    """Seconds of one call of the header, compiled with -O2; NaN where there is no gcc."""
    if shutil.which("gcc") is None:
        return math.nan
    (folder / "main.c").write_text(PROGRAM)
    made = folder / "main"
    subprocess.run(["gcc", "-std=c99", "-O2", str(folder / "main.c"), "-o", str(made)], check=True)
    runs = [subprocess.run([made], capture_output=True, text=True, check=True) for _ in range(7)]
    return statistics.median(float(run.stdout) for run in runs)


if __name__ == "__main__":
    main()
