"""Refinement series: which mesh comes next, what it will cost, and when there are enough."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from study.canonical import digest
from study.curve import Curve
from study.forward import finite_element
from study.forward.finite_element import load_compiled
from study.runner.provenance import code_version
from study.setup.setup import problem_of

if TYPE_CHECKING:
    from study.design.study_file import Converge


def budget_of(seconds: float | None, memory_MB: float | None) -> Budget:  # noqa: N803
    """Budget of a command, from now on."""
    return Budget(seconds) if memory_MB is None else Budget(seconds, memory_MB)


#: an order needs as many meshes, and no series gets longer than this
FEWEST = 3
MOST = 10

#: part of the free memory that a solution may take
MEMORY_SHARE = 0.7

#: exponents of time in the unknowns where only one mesh is known (numerics.md)
_TIME_EXPONENT = {"axisymmetric": 1.2, "3d": 1.95}
_MEMORY_EXPONENT = 1.35
Solver = Callable[[Sequence[Mapping[str, Any]]], list[dict[str, Any]]]


@dataclass(frozen=True)
class Level:
    """One mesh of a series: what was predicted and what came out."""

    mesh_size_mm: float
    status: str
    message: str
    curve: Curve
    elements: int
    dofs: int
    seconds: float
    memory_MB: float
    base_MB: float = 0.0
    predicted_seconds: float | None = None
    predicted_MB: float | None = None
    predicted_unknowns: int | None = None

    @property
    def converged(self) -> bool:
        """Whether it has an answer."""
        return self.status == "converged"

    def to_json(self) -> dict[str, Any]:
        """Everything but the curve."""
        return {
            "mesh_size": self.mesh_size_mm,
            "status": self.status,
            "message": self.message,
            "elements": self.elements,
            "unknowns": self.dofs,
            "seconds": self.seconds,
            "memory_MB": self.memory_MB,
            "predicted_seconds": self.predicted_seconds,
            "predicted_MB": self.predicted_MB,
            "predicted_unknowns": self.predicted_unknowns,
        }


@dataclass(frozen=True)
class Budget:
    """When a series must stop: seconds from ``began``, and memory."""

    seconds: float | None = None
    memory_MB: float = field(default_factory=lambda: MEMORY_SHARE * free_MB())
    began: float = field(default_factory=time.monotonic)

    def refuses(self, seconds: float | None, memory: float | None) -> str:
        """Why a solution of this predicted cost is not begun; empty if it may."""
        left = None if self.seconds is None else self.seconds - (time.monotonic() - self.began)
        if left is not None and (seconds or 0.0) > left:
            return f"the next mesh would take {seconds or 0:.3g} s of {max(left, 0):.3g} s left"
        if memory is not None and memory > self.memory_MB:
            return f"the next mesh would take {memory:.0f} MB of {self.memory_MB:.0f} MB"
        return ""


@dataclass(frozen=True)
class Outlook:
    """What the meshes so far say: whether they are enough, else the size that would be."""

    settled: bool
    size_needed_mm: float | None = None


@dataclass
class Series:
    """Refinement of one problem, coarse to fine.

    Parameters
    ----------
    config : mapping
        Resolved problem.
    spec : Converge
        Ratio, number of meshes, wanted accuracy.
    first_mm : float
        Element size of the problem, the coarsest of the series.
    levels_of : mapping of str to str
        Levels of the factors, where the problem is a cell.
    """

    config: Mapping[str, Any]
    spec: Converge
    first_mm: float
    levels_of: Mapping[str, str] = field(default_factory=dict)
    levels: list[Level] = field(default_factory=list)
    stopped: str = ""

    @property
    def good(self) -> list[Level]:
        """Meshes with an answer."""
        return [level for level in self.levels if level.converged]

    def advance(self, budget: Budget, outlook: Callable[[Series], Outlook]) -> float | None:
        """Size of the next mesh, or None where the series has ended (``stopped`` says why)."""
        if not self.stopped:
            self.stopped = self._end(budget, outlook)
        return None if self.stopped else float(self.first_mm / self.spec.ratio ** len(self.levels))

    def _end(self, budget: Budget, outlook: Callable[[Series], Outlook]) -> str:
        """Why no further mesh is solved; empty while one is wanted."""
        count, wanted = len(self.levels), max(FEWEST, self.spec.levels)
        if count >= wanted and len(self.good) >= FEWEST:
            if self.spec.tolerance is None:
                return f"{count} meshes were asked for"
            seen = outlook(self)
            if seen.settled:
                return "every quantity has the wanted accuracy"
            if hopeless := self._hopeless(budget, seen.size_needed_mm):
                return hopeless
        if count >= MOST or (count >= wanted + 2 and len(self.good) < FEWEST):
            return f"{count} meshes are enough"
        seconds, memory, _ = self.predicted()
        return budget.refuses(seconds, memory) if count else ""

    def _hopeless(self, budget: Budget, needed_mm: float | None) -> str:
        """Why the mesh that would be fine enough is out of reach; empty if it may be."""
        last = self.good[-1]
        if needed_mm is None or needed_mm >= last.mesh_size_mm:
            return ""
        space = self.config["model"].get("space", "axisymmetric")
        power = (2 if space == "axisymmetric" else 3) * _TIME_EXPONENT[space]
        seconds = last.seconds * (last.mesh_size_mm / needed_mm) ** power
        if not budget.refuses(seconds, None):
            return ""
        return (
            f"the wanted accuracy needs a mesh size of about {needed_mm:.2g} mm and "
            f"{seconds:.2g} s, which the budget does not have"
        )

    def predicted(self) -> tuple[float | None, float | None, int | None]:
        """Seconds, MB and unknowns of the next mesh, from what the meshes so far took."""
        known = [level for level in self.good if level.dofs > 0]
        if not known:
            return None, None, None
        last, space = known[-1], self.config["model"].get("space", "axisymmetric")
        growth = self.spec.ratio ** (2 if space == "axisymmetric" else 3)
        time_exponent = _TIME_EXPONENT[space]
        if len(known) > 1 and known[-2].dofs < last.dofs:
            growth = last.dofs / known[-2].dofs
            time_exponent = _exponent(known[-2], last, time_exponent)
        own = max(last.memory_MB - last.base_MB, 1.0)
        memory = last.base_MB + own * growth**_MEMORY_EXPONENT
        return last.seconds * growth**time_exponent, memory, round(last.dofs * growth)

    def add(self, size_mm: float, result: Mapping[str, Any]) -> None:
        """Take the result of a solution."""
        seconds, memory, unknowns = self.predicted()
        curve = result.get("curve") or {"displacement_mm": [], "force_N": []}
        self.levels.append(
            Level(
                size_mm,
                str(result["status"]),
                str(result.get("message", "")),
                Curve.from_dict(curve),
                int(result.get("elements", 0)),
                int(result.get("dofs", 0)),
                float(result.get("seconds", 0.0)),
                float(result.get("memory_MB", 0.0)),
                float(result.get("base_MB", 0.0)),
                seconds,
                memory,
                unknowns,
            )
        )


def _exponent(before: Level, last: Level, usual: float) -> float:
    """Power of the unknowns that the time followed; small times say nothing."""
    import math

    if before.seconds < 0.02 or last.seconds <= before.seconds:
        return usual
    found = math.log(last.seconds / before.seconds) / math.log(last.dofs / before.dofs)
    return min(max(found, 1.0), 3.0)


def free_MB() -> float:  # noqa: N802
    """Memory that is free on this machine, in MB."""
    try:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**20
    except (ValueError, OSError):
        return 4096.0


def refine(
    series: Sequence[Series],
    solve: Solver,
    budget: Budget,
    outlook: Callable[[Series], Outlook],
    progress: Callable[[str], None] = lambda _: None,
) -> None:
    """Solve mesh after mesh of every series, all series of one round together.

    Parameters
    ----------
    solve : callable
        Results of a list of tasks, in its order.
    outlook : callable
        Whether a series has the wanted accuracy, and which mesh would.
    progress : callable
        Told of every round.
    """
    while True:
        due = [(one, size) for one in series if (size := one.advance(budget, outlook)) is not None]
        if not due:
            return
        progress(_round(due))
        results = solve([solve_task(one.config, size) for one, size in due])
        for (one, size), result in zip(due, results, strict=True):
            one.add(size, result)


def _round(due: Sequence[tuple[Series, float]]) -> str:
    seconds = [one.predicted()[0] for one, _ in due]
    known = [s for s in seconds if s is not None]
    sizes = ", ".join(dict.fromkeys(f"{size:.3g}" for _, size in due[:4]))
    cost = f", about {sum(known):.2g} s of computing" if known else ""
    return f"mesh size {sizes} mm: {len(due)} solution{'s' if len(due) > 1 else ''}{cost}"


def series_of(config: Mapping[str, Any], spec: Converge, **options: Any) -> Series:
    """Series of a problem from its own mesh size."""
    from study.fem.mesh.mesher import mesh_size

    return Series(config, spec, float(mesh_size(problem_of(config).setup)), **options)


__all__ = ["Budget", "Level", "Series", "refine", "series_of", "task_key"]
Config = Mapping[str, Any]
_SECTIONS = ("specimen", "test", "material", "model")


def solve_task(
    config: Config, size_mm: float, *, more_steps: int = 1, looser: float = 1.0
) -> dict[str, Any]:
    """Task of one solution, complete in itself.

    Parameters
    ----------
    config : mapping
        Resolved sections of a problem.
    size_mm : float
        Element size.
    more_steps : int
        How many load steps replace one of the problem.
    looser : float
        How much the solver's tolerance is multiplied by.
    """
    sections = {k: config[k] for k in _SECTIONS if k in config}
    sections["model"] = {**sections["model"], "mesh": None, "mesh_size_mm": size_mm}
    steps = int(sections["test"].get("steps") or 10) * more_steps
    sections["test"] = {**sections["test"], "steps": steps}
    return {"kind": "solve", "config": sections, "looser": looser}


def task_key(task: Mapping[str, Any]) -> str:
    """Name of a solution: a hash of the problem and of the code."""
    return digest([task["config"], task["looser"], code_version()], 32)


def perform(task: Mapping[str, Any]) -> dict[str, Any]:
    """Solve; what did not converge is a status.

    Returns
    -------
    dict
        ``status``, ``message``, ``curve``, ``elements``, ``dofs``, ``mesh_hash``,
        ``seconds`` (of the solution, compilation excluded), ``memory_MB`` (peak) and
        ``base_MB`` (before).
    """
    problem = problem_of(task["config"])
    load_compiled(problem)
    reset_peak()
    before = peak_MB()
    options = _options(float(task["looser"]))
    solution = finite_element.solve(problem, gradients=False, **options)
    return {
        "status": str(solution.status),
        "message": str(solution.message),
        "curve": solution.curve.as_dict(),
        "elements": int(solution.elements),
        "dofs": int(solution.dofs),
        "mesh_hash": str(solution.mesh_hash),
        "seconds": float(getattr(solution, "seconds", {}).get("total", 0.0)),
        "memory_MB": peak_MB(),
        "base_MB": before,
    }


def _options(looser: float) -> dict[str, Any]:
    if looser == 1.0:
        return {}
    from study.fem.solver.options import Options

    plain = Options()
    newton = replace(plain.newton, tolerance=plain.newton.tolerance * looser)
    return {"options": replace(plain, newton=newton)}


def reset_peak() -> None:
    """Forget the peak memory of what this process did before; only Linux can."""
    with contextlib.suppress(OSError), open("/proc/self/clear_refs", "w") as stream:
        stream.write("5")


def peak_MB() -> float:  # noqa: N802
    """Peak memory of this process in MB since :func:`reset_peak`."""
    with contextlib.suppress(OSError), open("/proc/self/status") as stream:
        for line in stream:
            if line.startswith("VmHWM:"):
                return float(line.split()[1]) / 1024
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
