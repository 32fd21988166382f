"""Seconds of whole studies: planned, run, resumed and reported, beyond imports.

``python -m benchmarks.studies`` makes its own measurements: nine specimens of two halves and five
repeats, on which four materials are fitted over fourteen ranges (504 cases in closed form, 1,008
calibrations). ``--cases 10000`` instead computes cases that do nothing, which leaves what is
around the solver; ``--workers 40`` so many equal cases with finite elements, by one process and by
two.
Processor seconds, those of workers included, hardly depend on what else the machine does;
those on the clock do.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from study.api.planning import plan, status
from study.api.study import report, run
from study.execution.local import Loky
from study.harness.design.load import load_design
from study.harness.runner.batch import expand, manifest_of, run_batch
from study.mechanics.forward.closed_form import homogeneous
from study.mechanics.material.material import Material
from study.mechanics.setup.geometry import Cylinder
from study.record.store import Store
from study.simulation.job import CaseJob
from study.simulation.tasks import processes

RANGES = (10, 12, 14, 16, 18, 20, 25, 30, 35, 40, 45, 50, 55, 60)
SPECIMENS, HALVES, REPEATS, ROWS = 9, "AB", 5, 120
RADIUS_MM, HEIGHT_MM = 25.0, 30.0
PARTS = ("plan", "run", "resume", "report", "resume and report")

RANGE_STUDY = """schema = 1
[study]
name = "ranges"
question = "Over which range does the energy matter?"
assumed = ["test.interface"]
[specimen]
shape = "cylinder"
radius = "25 mm"
height = "30 mm"
[test]
kind = "compression"
interface = "frictionless"
[material]
poisson_ratio = 0.4995
[presets.material.neo-hookean]
model = "neo-hookean"
[presets.material.mooney-rivlin]
model = "mooney-rivlin"
[presets.material.reduced-polynomial-2]
model = "reduced-polynomial"
order = 2
[presets.material.reduced-polynomial-3]
model = "reduced-polynomial"
order = 3
{ranges}
[model]
space = "axisymmetric"
element_order = "linear"
mesh = "coarse"
[measurements]
file = "measured.csv"
columns = {{ displacement = "d_mm", force = "f_N" }}
units = {{ displacement = "mm", force = "N" }}
block = "phantom"
average = ["repeat"]
fit = {{ half = "A" }}
score = {{ half = "B" }}
swap = true
[calibration]
method = "analytic"
[factors]
material = ["neo-hookean", "mooney-rivlin", "reduced-polynomial-2", "reduced-polynomial-3"]
range = [{names}]
[[response]]
name = "relative_rms_force_error"
practical = "0.5 pp"
[[response]]
name = "mu0"
transform = "log"
practical = "10 % of mean"
[analysis]
model = "full"
roles = {{ range = "condition" }}
"""

IDLE_STUDY = """schema = 1
[study]
name = "idle"
question = "What does a case cost that does nothing?"
assumed = ["test.interface"]
[specimen]
shape = "cylinder"
radius = "25 mm"
height = "30 mm"
[test]
kind = "compression"
interface = "frictionless"
displacement = "3 mm"
steps = 2
[material]
model = "neo-hookean"
poisson_ratio = 0.4995
[forward]
model = "closed-form"
[measurements]
file = "measured.csv"
columns = {{ displacement = "d_mm", force = "f_N" }}
units = {{ displacement = "mm", force = "N" }}
block = "phantom"
average = ["half", "repeat"]
[calibration]
method = "none"
[factors]
"material.C10" = [{constants}]
"specimen.height" = [{heights}]
[[response]]
name = "relative_rms_force_error"
"""


EQUAL_STUDY = """schema = 1
[study]
name = "equal"
question = "How much faster are two workers?"
assumed = ["test.interface"]
[specimen]
shape = "cylinder"
radius = "25 mm"
height = "30 mm"
[test]
kind = "compression"
interface = "bonded"
displacement = "3 mm"
steps = 4
[material]
model = "neo-hookean"
poisson_ratio = 0.4995
[model]
mesh_size = "0.4 mm"
[calibration]
method = "none"
[factors]
"material.C10" = [{constants}]
[[response]]
name = "peak_force"
"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure each part in a process of its own and print its seconds."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.studies", description=__doc__)
    parser.add_argument("--jobs", type=int, default=2, help="workers")
    parser.add_argument("--cases", type=int, default=0, help="so many cases that do nothing")
    parser.add_argument("--workers", type=int, default=0, help="so many equal finite-element cases")
    parser.add_argument("--folder", type=Path, help="where to work; a temporary one by default")
    parser.add_argument("--part", help=argparse.SUPPRESS)
    chosen = parser.parse_args(arguments)
    if chosen.part:
        print(json.dumps(measured(chosen.part, chosen.folder, chosen.jobs, chosen.cases)))
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder = chosen.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        if chosen.workers:
            compare_workers(folder, chosen.workers)
            return
        write_study(folder, chosen.cases)
        print(f"{'part':20}{'processor s':>12}{'clock s':>10}{'owner MB':>10}")
        for part in ("plan", "run", "resume", "status") if chosen.cases else PARTS:
            found = alone(part, folder, chosen.jobs, chosen.cases)
            print(f"{part:20}{found['cpu']:12.2f}{found['clock']:10.2f}{found['MB']:10.0f}")


def compare_workers(folder: Path, cases: int) -> None:
    """Compute equal cases with one worker and with two; kernels are compiled before."""
    design = folder / "equal.toml"
    seconds = {}
    for jobs, count in ((1, 2), (1, cases), (2, cases)):
        constants = ", ".join(f'"{10 + k / 1000:.6g} kPa"' for k in range(count))
        design.write_text(EQUAL_STUDY.format(constants=constants))
        work = expand(load_design(design), folder)
        began = time.monotonic()
        run_batch(work, Store(folder / f"equal-{jobs}-{count}"), processes(jobs))
        seconds[jobs] = time.monotonic() - began
    print(f"{cases} equal cases: one worker {seconds[1]:.1f} s, two {seconds[2]:.1f} s")
    print(f"ratio {seconds[1] / seconds[2]:.2f} (asked: 1.8, on a machine with two idle cores)")


def alone(part: str, folder: Path, jobs: int, cases: int) -> dict[str, float]:
    """Measure a part in a process of its own, so that nothing is left from the one before."""
    command = [
        sys.executable, "-m", "benchmarks.studies", "--part", part, "--folder", str(folder),
        "--jobs", str(jobs), "--cases", str(cases),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def write_study(folder: Path, cases: int) -> None:
    """Write the design, and the measurements that it needs."""
    if cases:
        side = round((cases / SPECIMENS) ** 0.5)
        constants = ", ".join(f'"{10 + k / 10:.4g} kPa"' for k in range(side))
        heights = ", ".join(f'"{30 + k / 10:.4g} mm"' for k in range(side))
        (folder / "idle.toml").write_text(IDLE_STUDY.format(constants=constants, heights=heights))
        write_measurements(folder / "measured.csv")
        return
    presets = [f'[presets.range."{k} %"]\nmeasurements.range = ["1 %", "{k} %"]' for k in RANGES]
    names = ", ".join(f'"{k} %"' for k in RANGES)
    text = RANGE_STUDY.format(ranges="\n".join(presets), names=names)
    (folder / "ranges.toml").write_text(text)
    write_measurements(folder / "measured.csv")


def write_measurements(path: Path) -> None:
    """Write tests of silicones of several stiffnesses, with a load cell's noise and drift."""
    random = np.random.default_rng(24)
    rows = ["phantom,half,repeat,d_mm,f_N"]
    for specimen in range(SPECIMENS):
        for half in HALVES:
            c10 = 0.006 * (1 + 0.4 * specimen) * (1 + 0.02 * random.standard_normal())
            constants = {"C10": c10, "C20": 0.03 * c10, "C30": 0.002 * c10}
            material = Material("yeoh", constants, poisson_ratio=0.4995)
            d = np.linspace(0.0, 0.62 * HEIGHT_MM, ROWS)
            force = homogeneous(Cylinder(RADIUS_MM, HEIGHT_MM), material, d).force_N
            for repeat in range(REPEATS):
                drift = np.cumsum(random.standard_normal(ROWS)) * 2e-4 * force.max()
                seen = force * (1 + 0.01 * random.standard_normal()) + drift
                rows += [
                    f"P{specimen},{half},{repeat},{a:.5f},{b:.5f}"
                    for a, b in zip(d, seen, strict=True)
                ]
    path.write_text("\n".join(rows) + "\n")


def measured(part: str, folder: Path, jobs: int, cases: int) -> dict[str, float]:
    """Do a part in this process; seconds of the processor, of workers too, and on the clock."""
    parts = idle_parts(folder, jobs) if cases else range_parts(folder, jobs)
    # imported here, as it would be by the command line; what draws, too
    import matplotlib.backends.backend_svg  # noqa: F401
    import seaborn  # noqa: F401
    import statsmodels.api  # noqa: F401

    import study.mechanics.solver.solution
    import study.reporting.output.write  # noqa: F401

    began, spent = time.monotonic(), processor_seconds()
    parts[part]()
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {
        "cpu": processor_seconds() - spent, "clock": time.monotonic() - began, "MB": memory,
    }  # fmt: skip


def range_parts(folder: Path, jobs: int) -> dict[str, Callable[[], object]]:
    """Parts of the range study."""
    design, results, reports = folder / "ranges.toml", folder / "results", folder / "reports"

    def again(where: Path | None) -> object:
        return run(design, data=folder, results=results, reports=where, jobs=jobs)

    return {
        "plan": lambda: plan(design, data=folder, results=results),
        "run": lambda: again(None),
        "resume": lambda: again(None),
        "report": lambda: report(results / "ranges", reports=reports),
        "resume and report": lambda: again(reports),
    }


def idle_parts(folder: Path, jobs: int) -> dict[str, Callable[[], object]]:
    """Parts of a study whose cases do nothing."""
    design, results = folder / "idle.toml", folder / "results"

    def compute() -> None:
        work = expand(load_design(design), folder)
        store = Store(results / "idle")
        with store.lock():
            store.write_manifest({**manifest_of(work), "finished": True})
            run_batch(work, store, Loky(do_nothing, jobs))

    return {
        "plan": lambda: plan(design, data=folder, results=results),
        "run": compute,
        "resume": compute,
        "status": lambda: status(results / "idle"),
    }


def do_nothing(task: CaseJob) -> dict[str, object]:
    """Answer a case without solving it: a task for a worker."""
    record = task.record("converged", "")
    return {"status": record.status, "message": "", "record": record.to_json()}


def processor_seconds() -> float:
    """Seconds of the processor that this process and its finished children took."""
    used = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return sum(sum(resource.getrusage(who)[:2]) for who in used)


if __name__ == "__main__":
    main()
