"""The kinds of task of a study: what does each in a worker, and what it is predicted to take."""

from __future__ import annotations

import contextlib
import importlib
import os
import platform
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any, cast

from study.execution.cluster import Client, Cluster
from study.execution.local import Document, Executor, Loky, Perform, Task, free_memory_MB
from study.external.command import External
from study.external.forward_model import FUNCTION_SECONDS, ForwardCell
from study.ground.canonical import digest
from study.ground.errors import Fault, InputError
from study.ground.units import naming, parse
from study.simulation import case, fit_task, solve_task
from study.simulation.cell import CellProblem
from study.simulation.job import USUAL_EVALUATIONS, CaseJob, FitJob, FitPart
from study.simulation.provenance import versions

#: where a study is computed: an executor, or the scheduler of a Dask cluster by its address, its
#: scheduler file or a client of it
Engine = Executor | Client | str | Path

#: a task that only asks whether a worker answers
PING = "ping"
#: what does a task, by its class
KINDS: dict[type, Perform] = {
    CaseJob: case.perform,
    FitJob: fit_task.perform,
    solve_task.SolveTask: solve_task.perform,
    str: lambda task: {"status": "converged"},
}


def perform(task: object) -> Document:
    """Do one task in a worker."""
    return KINDS[type(task)](task)


def processes(
    jobs: int | None = None,
    timeout_s: float | None = None,
    memory_MB: float | None = None,  # noqa: N803
) -> Executor:
    """Start processes of this machine, which know every kind of task."""
    return Loky(perform, jobs or default_jobs(), timeout_s, memory_MB or free_memory_MB())


def memory_of(text: str) -> float:
    """Read an amount of memory such as ``"20 GB"``, in MB."""
    with naming("memory"):
        amount_MB = parse(text, "memory")
    if amount_MB <= 0:
        raise InputError(Fault("memory", f"must be more than zero, got {text!r}"))
    return amount_MB


def computing_on(
    engine: Engine,
    jobs: int | None = None,
    timeout_s: float | None = None,
    files: Sequence[Path] = (),
) -> Executor:
    """Find the executor that an engine means."""
    # a client of Dask has a ``run`` too, which is another one
    if isinstance(engine, str | os.PathLike) or hasattr(engine, "nthreads"):
        scheduler = cast("str | Path | Client", engine)
        return Cluster(perform, scheduler, versions, jobs, timeout_s, files).reached()
    return engine


def limit_of(executor: Executor) -> float | None:
    """Wall-clock limit of one task of an executor in seconds; None where there is none."""
    return executor.limit_s if isinstance(executor, Loky | Cluster) else None


def adapted(executor: Executor, longer: float = 1.0, alone: bool = False) -> Executor:
    """Copy an executor with a longer limit, or with one task at a time."""
    if not isinstance(executor, Loky | Cluster):
        return executor
    limit = None if executor.limit_s is None else longer * executor.limit_s
    longest = replace(executor, limit_s=limit)
    return replace(longest, jobs=1) if alone else longest


def default_jobs() -> int:
    """One worker for each core that this process may use."""
    with contextlib.suppress(AttributeError):
        return max(1, len(os.sched_getaffinity(0)))
    return os.cpu_count() or 1


# Is the installation able to do the work? Every part is tried, not looked up.

_NEEDED = ("numpy", "scipy", "pandas", "numba", "skfem", "meshio", "matplotlib", "statsmodels")
_SYSTEM_LIBRARIES = (
    "apt-get install libglu1-mesa libgl1 libopengl0 libxcursor1 libxft2 libxinerama1 "
    "libxrender1 libxfixes3 libxext6 libfontconfig1 libgomp1"
)


def examine() -> dict[str, Any]:
    """Try every part of the installation."""
    tries: dict[str, Callable[[], tuple[str, str]]] = {
        "python": lambda: ("pass", platform.python_version()),
        **{name: partial(_imported, name) for name in (*_NEEDED, "gmsh")},
        "pypardiso": _pardiso,
        "a solved compression": solve_task.known_compression,
        "a worker process": _worker,
    }
    checks = []
    for name, attempt in tries.items():
        try:
            outcome, finding = attempt()
        except Exception as error:  # noqa: BLE001 - whatever fails is the finding
            outcome, finding = "fail", f"{type(error).__name__}: {error}"
            if name == "gmsh" and isinstance(error, OSError):
                finding = f"{error}; a system library is missing: {_SYSTEM_LIBRARIES}"
        checks.append({"name": name, "outcome": outcome, "finding": finding})
    return {"ok": all(c["outcome"] != "fail" for c in checks), "checks": checks}


def _imported(name: str) -> tuple[str, str]:
    importlib.import_module(name)
    return "pass", metadata.version({"skfem": "scikit-fem"}.get(name, name))


def _pardiso() -> tuple[str, str]:
    try:
        return "pass", metadata.version("pypardiso")
    except metadata.PackageNotFoundError:
        slow = "not installed: 3D runs about 20 times slower on SuperLU"
        return "caution", f"{slow} (pip install 'study[fast]')"


def _worker() -> tuple[str, str]:
    (outcome,) = processes(1, 60.0).run([Task(PING, lambda _: PING)])
    good = outcome.result["status"] == "converged"
    return ("pass" if good else "fail"), f"answered in {outcome.seconds:.1f} s"


# Predicted seconds and memory of a run, before anything is solved.

#: what any computation takes besides solving: hashing, scoring, writing
_OVERHEAD_S = 0.02

#: seconds in which meshes are made to count their unknowns, for one table of costs
_PATIENCE_S = 2.0

#: forward solutions of a fit in units of a cold one; the later ones start from the one before
_SOLVES_LINEAR = 1.5
_SOLVES_FIRST = 2.0
_SOLVES_MORE = 0.7

#: a prediction that starts from the solution of its cell, in units of a cold one: where forces
#: scale with the one constant, between plates, and under an indenter, where contact is found anew
_SCALED = 0.1
_FROM_ANCHOR = 0.25
_FROM_ANCHOR_INDENTED = 0.6


class Costs:
    """Cost of computations; each distinct forward problem is estimated once.

    The first case of a cell that is asked for bears the cost of the cell's cold solution. Meshes
    are made to count their unknowns while that takes a moment in all, in the order asked for; by
    no clock, so that what is refined is the same on every machine.
    """

    def __init__(self) -> None:
        self._patience_s = _PATIENCE_S
        self._known: dict[str, tuple[float, float]] = {}
        self._anchored: set[str] = set()

    def _test_seconds(self, test: FitPart, names: Sequence[str]) -> float:
        """Seconds that one test of a fit takes: nothing where it has a closed form."""
        external = External.of(test.problem)
        if test.method == "external" and external is not None:
            return _evaluations(names) * external.section.price_s
        if test.method != "inverse-fem":
            return 0.0
        # of the only constant, a modulus by its unit, forces are in proportion
        solves = _SOLVES_LINEAR if len(names) == 1 else _SOLVES_FIRST + _SOLVES_MORE * len(names)
        return solves * self.solve_seconds(test.problem)

    def case_seconds(self, job: CaseJob) -> float:
        """Seconds of one case without its fits."""
        problem = job.case.problem
        external = External.of(problem)
        if external is not None and job.origin.predicts and job.forward == "external":
            is_tested = isinstance(problem, CellProblem)
            quick = external.section.model == "python" and not is_tested
            overhead = FUNCTION_SECONDS if quick else _OVERHEAD_S
            return overhead + len(job.scored) * external.section.price_s
        if not job.origin.predicts or job.forward != "simulation":
            return _OVERHEAD_S
        solve_s = self.solve_seconds(job.case.tested, job.depth_mm)
        solves = float(len(job.scored))
        if job.group:
            # weight stays what it is where a modulus doubles, so that nothing scales
            tested = job.case.tested
            kind, is_heavy = tested.setup.kind, bool(tested.setup.test.weight_N_mm3)
            share = _FROM_ANCHOR_INDENTED if kind.takes_indenter else _FROM_ANCHOR
            if len(tested.calibrated_names) == 1 and not is_heavy:
                share = _SCALED
            solves = share * solves + (job.group not in self._anchored)
            self._anchored.add(job.group)
        return _OVERHEAD_S + solves * solve_s

    def seconds(self, job: FitJob | CaseJob) -> float:
        """Seconds of a fit, or of a case without its fits."""
        if isinstance(job, CaseJob):
            return self.case_seconds(job)
        names = job.problem.material.calibrated_names
        return _OVERHEAD_S + sum(self._test_seconds(test, names) for test in job.problem.tests)

    def MB(self, job: FitJob | CaseJob) -> float:  # noqa: N802
        """Peak memory of a fit or a case; none worth counting without a simulation of its own."""
        if isinstance(job, FitJob):
            simulated = (t.problem for t in job.problem.tests if t.method == "inverse-fem")
            return max(map(self.memory_MB, simulated), default=0.0)
        problem = job.case.problem
        if job.forward == "external":
            return (None if problem.forward is None else problem.forward.memory_MB) or 0.0
        is_solved = job.forward == "simulation" and job.origin.predicts
        return self.memory_MB(problem) if is_solved else 0.0

    def total_seconds(self, fits: Iterable[FitJob], cases: Iterable[CaseJob], jobs: int) -> float:
        """Wall time on a number of workers."""
        return (sum(map(self.seconds, fits)) + sum(map(self.seconds, cases))) / jobs

    def solve_seconds(self, problem: CellProblem, depth_mm: float | None = None) -> float:
        """Seconds of one forward solution."""
        return self._estimate(problem, depth_mm)[0]

    def memory_MB(self, problem: ForwardCell) -> float:  # noqa: N802
        """Peak memory of one worker at this problem."""
        stated = None if problem.forward is None else problem.forward.memory_MB
        if stated or not isinstance(problem, CellProblem):
            return stated or 0.0
        return self._estimate(problem, None)[1]

    def _estimate(self, problem: CellProblem, depth_mm: float | None) -> tuple[float, float]:
        document = problem.document()  # of all that differ in their material alone
        key = digest([{k: document[k] for k in ("specimen", "test", "model")}])
        if key not in self._known:
            self._known[key] = self._estimated(problem, depth_mm)
        return self._known[key]

    def _estimated(self, cell: CellProblem, depth_mm: float | None) -> tuple[float, float]:
        """Seconds and memory of a solution; counting its unknowns takes patience."""
        from study.mechanics.solver.solution_cost import estimate

        depth = depth_mm or 0.2 * (cell.height_mm or 1.0)
        try:
            problem = cell.with_placeholder(depth, C10_MPa=0.005)
            estimated = estimate(problem.setup, patience_s=self._patience_s)
        except (InputError, ValueError, RuntimeError):
            return 1.0, 0.0  # an estimate must never stop a plan; the case will say what is wrong
        self._patience_s -= estimated.counting_s
        return float(estimated.seconds), float(estimated.memory_MB)


def _evaluations(names: Sequence[str]) -> int:
    """Count the calls for one test: each evaluation, and one more for every constant."""
    return USUAL_EVALUATIONS * (1 + len(names))


def program_calls(fits: Iterable[FitJob], cases: Iterable[CaseJob]) -> int:
    """Count the calls of other programs in cases, and in fits as if these wrote no gradients."""
    external_cases = (job for job in cases if job.forward == "external" and job.origin.predicts)
    predicted = sum(len(job.scored) for job in external_cases)
    return predicted + sum(
        _evaluations(fit.problem.material.calibrated_names)
        for fit in fits
        for test in fit.problem.tests
        if test.method == "external"
    )
