"""Random forward problems against finer references, to find answers that are wrong in silence.

    python -m validation.sweep --count 60 --seed 2011 --budget 1500 [--file sweep.jsonl] [--jobs 2]

Every problem (see ``sweep_problems.py``) is solved on its own mesh, on finer ones of its own
series, as a study refines its cases, and as a finer reference; a second reference judges the
first where the answer is far off. A *silent miss* is a problem that

* converged, and whose message says nothing else;
* is more than 5 % off the reference at some load step (of those with a tenth of the largest
  force or more), and
* whose numerical uncertainty U of the force there, with what two references differ by, does
  not cover that.

Outcomes are added to the file as they come: running again continues. ``--show K`` prints the
lines of Python that solve problem K. Exit code 0, 1 if there is a silent miss, 2 for bad input.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

if not __package__:  # run as a script: the folder above holds this one
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from study.ground.errors import InputError
from study.mechanics.setup.geometry import Cylinder
from study.mechanics.setup.setup import Problem
from study.mechanics.solver.solution_cost import expected_unknowns
from validation.apart import Apart
from validation.sweep_problems import drawn, references, sized

Array = NDArray[np.float64]
Found = dict[str, Any]
Ask = Callable[[Problem], Found]

#: error that matters, and force over the largest below which it does not
FAR, FIRST_TOUCH = 0.05, 0.1
#: an error that is none: the solver's own tolerance, with a margin
NOTHING_OFF = 1e-6
#: ratio and number of the meshes of a series, and unknowns from which on there is no third one
RATIO, MESHES, THIRD_UNKNOWNS = 1.5, 3, 2.5e4
#: what the message of a run is that has nothing to report
NOTHING = "every step converged"
SILENT = "silent miss"


# One problem


def solution(problem: Problem) -> Found:
    """Solve a problem, in a process of its own; the curve and what the run says of itself."""
    from study.mechanics.solver.finite_element_solution import solve

    began = time.perf_counter()
    found = solve(problem, gradients=False)
    return {
        "status": found.status,
        "message": found.message,
        "displacement_mm": found.curve.displacement_mm.tolist(),
        "force_N": found.curve.force_N.tolist(),
        "dofs": found.dofs,
        "elements": found.elements,
        "mesh_size_mm": found.mesh_size_mm,
        "seconds": time.perf_counter() - began,
    }


def asked(process: Apart, limit_s: float) -> Ask:
    """Solver that gives a solution up after so many seconds."""

    def ask(problem: Problem) -> Found:
        began = time.perf_counter()
        answer = process.ask(solution, (problem,), limit_s)
        if answer.ok:
            return dict(answer.value)
        seconds = time.perf_counter() - began
        return {
            "status": answer.status, "message": answer.message, "displacement_mm": [],
            "force_N": [], "dofs": 0, "elements": 0, "mesh_size_mm": 0.0, "seconds": seconds,
        }  # fmt: skip

    return ask


def outcome(problem: Problem, ask: Ask) -> Found:
    """Everything about one problem: its own answer, its reference, its uncertainty, a verdict."""
    began = time.perf_counter()
    own = ask(problem)
    found: Found = {"own": own, "label": label(problem)}
    if own["force_N"]:
        reference, others = _reference(problem, own, ask)
        found |= {"reference": reference} | _errors(own, reference["found"])
        found |= _claimed(problem, own, ask)
        if found.get("worst") is not None and found["worst"] > FAR and others:
            second = ask(others[0])
            found["second"] = {"problem": repr(others[0]), "found": second}
            found["references_differ"] = _errors(second, reference["found"])
    found["verdict"] = verdict(found)
    return found | {"seconds": time.perf_counter() - began}


def _reference(problem: Problem, own: Found, ask: Ask) -> tuple[Found, list[Problem]]:
    """Solution of the first reference that goes as far as the problem, and what is left.

    Where none does, it is the one that goes farthest.
    """
    tried: list[Found] = []
    candidates = references(problem)
    for number, one in enumerate(candidates):
        tried.append({"problem": repr(one), "found": ask(one)})
        if len(tried[-1]["found"]["force_N"]) >= len(own["force_N"]):
            return tried[-1], candidates[number + 1 :]
    return max(tried, key=lambda each: len(each["found"]["force_N"])), []


def _errors(own: Found, reference: Found) -> Found:
    """Relative errors of the force at the common load steps, but those of the first touch."""
    count = min(len(own["force_N"]), len(reference["force_N"]))
    mine, right = np.array(own["force_N"][:count]), np.array(reference["force_N"][:count])
    if not count:
        return {"errors": [], "last": None, "worst": None}
    kept = np.abs(right) >= FIRST_TOUCH * np.abs(right).max()
    errors = np.where(kept, np.abs(mine - right) / np.where(kept, np.abs(right), 1.0), 0.0)
    return {"errors": errors.tolist(), "last": float(errors[-1]), "worst": float(errors.max())}


def _claimed(problem: Problem, own: Found, ask: Ask) -> Found:
    """Numerical uncertainty of the force at every load step, over that force.

    As a study claims it for its own mesh: from two finer meshes, or one where the second would
    be dear.
    """
    from study.mechanics.mesh.mesher import mesh_size

    series, size = [own], mesh_size(problem.setup)
    for level in range(1, MESHES):
        if (
            level > 1
            and expected_unknowns(sized(problem, size / RATIO**level).setup) > THIRD_UNKNOWNS
        ):
            break
        finer = ask(sized(problem, size / RATIO**level))
        if finer["status"] != "converged":
            break
        series.append(finer)
    sizes = _sizes(problem, series)
    count = min(len(each["force_N"]) for each in series)
    forces = np.array([each["force_N"][:count] for each in series])
    claims = [_uncertainty(problem, forces[:, k].tolist(), sizes) for k in range(count)]
    relative = [
        None if u is None else u / abs(own["force_N"][k]) for k, (_, u) in enumerate(claims)
    ]
    return {"meshes": len(series), "behaviour": claims[-1][0], "claimed": relative}


def _sizes(problem: Problem, series: Sequence[Found]) -> list[float]:
    """Sizes by which a study judges a series."""
    from study.simulation.refinement import series_sizes

    return series_sizes(
        [each["mesh_size_mm"] for each in series], [each["elements"] for each in series],
        problem.setup,
        anchor=0,
    )  # fmt: skip


def _uncertainty(
    problem: Problem, values: Sequence[float], sizes: Sequence[float]
) -> tuple[str, float | None]:
    """Behaviour of a series and uncertainty on its coarsest mesh; it rests on the public GCI."""
    from study.harness.runner.study_refinement import CaseSeries
    from study.mechanics.forward.formal_order import formal_order

    if len(values) < 2:
        return "one mesh", None
    return CaseSeries((), RATIO).half_width(values, sizes, formal_order(problem).order)


def verdict(found: Mapping[str, Any]) -> str:
    """One word or two about an outcome."""
    own = found["own"]
    if own["status"] != "converged":
        return str(own["status"])
    if found["worst"] is None:
        return "no reference"
    if found["worst"] <= FAR:
        return "right"
    if own["message"] != NOTHING:
        return "off, said"
    differ = (found.get("references_differ") or {}).get("worst")
    if differ is not None and differ > FAR:
        return "references differ"
    return "off, covered" if _covered(found) else SILENT


def _covered(found: Mapping[str, Any]) -> bool:
    """Whether U covers every error that matters, each at its own step."""
    return all(ok for error, ok in _steps(found) if error > FAR)


def _steps(found: Mapping[str, Any]) -> Iterator[tuple[float, bool]]:
    """Error at every step, and whether U covers it, with what two references differ by there."""
    claims, slack = found["claimed"], (found.get("references_differ") or {}).get("errors", [])
    for k, error in enumerate(found["errors"]):
        claim = claims[k] if k < len(claims) else None
        doubt = slack[k] if k < len(slack) else 0.0
        yield error, claim is not None and error <= claim + doubt


def label(problem: Problem) -> str:
    """Problem in a few words."""
    model, test = problem.model, problem.test
    specimen: Any = problem.specimen
    half = specimen.radius_mm if isinstance(specimen, Cylinder) else _half_width(specimen)
    pressed = test.indenter
    what = type(pressed).__name__.lower() if pressed else test.kind
    if getattr(pressed, "edge_radius_mm", 0.0):
        what = "rounded"
    body = type(specimen).__name__.lower()
    deep = test.displacement_mm / specimen.height_mm
    return (
        f"{'2d' if model.space == 'axisymmetric' else '3d'} {model.element_order[:4]} "
        f"{model.element_shape} | {body} R/H {half / specimen.height_mm:.2g} | {what} "
        f"{deep:.2g} H {test.interface[:6]} | {problem.material.model} "
        f"nu {problem.material.poisson_ratio:.4g}"
    )


def _half_width(specimen: Any) -> float:
    return float(specimen.width_mm / 2)


# All problems


class Sweep:
    """Outcomes of one seed, kept in a file."""

    def __init__(self, seed: int, path: Path) -> None:
        self.seed, self.path = seed, path
        self.done: dict[int, Found] = {}
        self._lock = threading.Lock()
        if path.is_file():
            self._read()

    def _read(self) -> None:
        for number, text in enumerate(self.path.read_text("utf-8").splitlines(), start=1):
            try:
                row = json.loads(text)
                known = row["seed"], row["number"], row["problem"]
            except (ValueError, KeyError, TypeError):
                raise InputError(f"{self.path}, line {number}: is no outcome of a sweep") from None
            if known[0] != self.seed or known[2] != repr(drawn(self.seed, known[1])):
                rule = f"{self.path}, line {number}: belongs to another seed or other problems"
                raise InputError(f"{rule}; name another --file")
            self.done[known[1]] = row | {"verdict": verdict(row)}

    def run(
        self, count: int, *, jobs: int, budget_s: float, limit_s: float, say: Callable[[str], None]
    ) -> None:
        """Compute what is missing of the first ``count`` problems, within a time."""
        end = time.monotonic() + budget_s
        todo = [k for k in range(count) if k not in self.done]
        every = [todo[k::jobs] for k in range(jobs)]
        with ThreadPoolExecutor(jobs) as pool:
            list(pool.map(lambda part: self._some(part, end, limit_s, say), every))

    def _some(
        self, numbers: Sequence[int], end: float, limit_s: float, say: Callable[[str], None]
    ) -> None:
        with Apart() as process:
            for number in numbers:
                if time.monotonic() >= end:
                    return
                problem = drawn(self.seed, number)
                row = {"seed": self.seed, "number": number, "problem": repr(problem)}
                row |= outcome(problem, asked(process, limit_s))
                self._keep(number, row)
                say(line(row))

    def _keep(self, number: int, row: Found) -> None:
        with self._lock:
            self.done[number] = row
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")


def line(row: Mapping[str, Any]) -> str:
    """One row of the table."""
    own = row["own"]
    claims = [c for c in row.get("claimed", ()) if c is not None]
    said = own["message"] if own["message"] != NOTHING else ""
    return (
        f"{row['number']:>3}  {row['label']:<88}  {own['dofs']:>6}  {_percent(row.get('last'))}  "
        f"{_percent(row.get('worst'))}  {_percent(max(claims, default=None))}  "
        f"{row.get('behaviour', ''):<12.12}  {row['verdict']:<17}  {row['seconds']:>5.0f}  {said}"
    ).rstrip()


def _percent(value: float | None) -> str:
    return f"{'-':>7}" if value is None or not math.isfinite(value) else f"{100 * value:>7.2f}"


def shown(rows: Sequence[Mapping[str, Any]], count: int) -> Iterator[str]:
    """Lines of the printed table and the count of each verdict."""
    yield (
        f"  #  {'problem':<88}  {'dofs':>6}  {'last %':>7}  {'worst %':>7}  {'U %':>7}  "
        f"{'series':<12}  {'verdict':<17}  {'s':>5}  said"
    )
    yield from map(line, rows)
    verdicts = Counter(row["verdict"] for row in rows)
    yield f"{len(rows)} of {count} problems: " + ", ".join(
        f"{number} {name}" for name, number in verdicts.most_common()
    )
    right = [row["worst"] for row in rows if row.get("worst") is not None]
    if right:
        yield f"largest error over the load steps: median {100 * float(np.median(right)):.2g} %"
    steps = [one for row in rows if row["own"]["status"] == "converged" and "claimed" in row
             for one in _steps(row) if one[0] > NOTHING_OFF]  # fmt: skip
    if steps:
        yield f"U covers the error at {sum(ok for _, ok in steps)} of {len(steps)} load steps"
    yield f"silent misses: {verdicts[SILENT]}"


def reproduction(seed: int, number: int) -> str:
    """Lines of Python that solve a problem and its first reference."""
    problem = drawn(seed, number)
    return (
        "from study.mechanics.solver.finite_element_solution import solve\n"
        "from study.mechanics.material.material import Material\n"
        "from study.mechanics.setup.geometry import Block, Cone, Cylinder, Flat, Sphere\n"
        "from study.mechanics.setup.setup import Model, Problem\n"
        "from study.mechanics.setup.test_kind import Test\n\n"
        f"problem = {problem!r}\n"
        f"reference = {references(problem)[0]!r}\n"
        "for one in (problem, reference):\n"
        "    found = solve(one, gradients=False)\n"
        "    print(found.status, found.message, found.dofs, found.curve.force_N)\n"
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").split("\n")[0],
        epilog="Exit codes: 0 no silent miss, 1 at least one, 2 bad input.",
    )
    parser.add_argument("--count", type=int, default=60, help="problems (60)")
    parser.add_argument("--seed", type=int, default=2011, help="of the problems (2011)")
    parser.add_argument("--budget", type=float, default=3600.0, help="seconds (3600)")
    parser.add_argument("--limit", type=float, default=120.0, help="seconds a solution (120)")
    parser.add_argument("--jobs", type=int, choices=(1, 2), default=1, help="processes (1)")
    parser.add_argument("--file", type=Path, default=Path("sweep.jsonl"), help="of the outcomes")
    parser.add_argument("--show", type=int, metavar="K", help="print problem K as Python, and end")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; 0 without a silent miss, 1 with one, 2 for bad input."""
    given = _parser().parse_args(arguments)
    if given.show is not None:
        print(reproduction(given.seed, given.show), end="")
        return 0
    if given.count < 1 or given.seed < 0 or not given.file.parent.is_dir():
        print("needs --count >= 1, --seed >= 0 and a --file in a folder", file=sys.stderr)
        return 2
    try:
        sweep = Sweep(given.seed, given.file)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    sweep.run(
        given.count, jobs=given.jobs, budget_s=given.budget, limit_s=given.limit,
        say=lambda text: print(text, file=sys.stderr, flush=True),
    )  # fmt: skip
    rows = [sweep.done[k] for k in sorted(sweep.done) if k < given.count]
    for text in shown(rows, given.count):
        print(text)
    return 1 if any(row["verdict"] == SILENT for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
