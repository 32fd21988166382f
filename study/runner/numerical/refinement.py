"""Refinement: the loop, and the series of a problem.

A series says which computations are due and takes what they gave, until it has enough; the loop
does what is due of all series at once. A problem asks for one mesh after the other, as long as
its accuracy and its budget want; the cells of a study know all their meshes from the start (see
:mod:`study.runner.numerical.case_series`).
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Protocol, TypeVar

from study.curve import Curve
from study.runner.numerical.solve_task import Solver, SolveResult, SolveTask, solutions
from study.setup.setup import Setup, Tables

if TYPE_CHECKING:
    from study.design.study_file import Converge


#: a computation, and what it gave
Step = TypeVar("Step")
Found_contra = TypeVar("Found_contra", contravariant=True)
Found = TypeVar("Found")


class Refinable(Protocol[Step, Found_contra]):
    """A series of computations on finer and finer meshes."""

    def due(self) -> Sequence[Step]:
        """List what is to be computed next; empty where the series has ended."""
        ...

    def add(self, step: Step, found: Found_contra) -> None:
        """Take what a computation gave."""
        ...


def refine(
    series: Sequence[Refinable[Step, Found]], compute: Callable[[Sequence[Step]], Sequence[Found]]
) -> None:
    """Compute what is due of every series, all series of one round together, until none is.

    Parameters
    ----------
    series : sequence of Refinable
        They take what is computed.
    compute : callable
        What some computations give, in their order.
    """
    while due := [(one, step) for one in series for step in one.due()]:
        found = compute([step for _, step in due])
        for (one, step), result in zip(due, found, strict=True):
            one.add(step, result)


#: an order needs as many meshes, and no series gets longer than this
FEWEST = 3
MOST = 10

#: part of the free memory that a solution may take
MEMORY_SHARE = 0.7

#: exponents of time in the unknowns where only one mesh is known (numerics.md)
_TIME_EXPONENT = {"axisymmetric": 1.2, "3d": 1.95}
_MEMORY_EXPONENT = 1.35


@dataclass(frozen=True)
class Predictions:
    """What a solution was predicted to take; None where nothing was known yet."""

    seconds: float | None = None
    memory_MB: float | None = None  # noqa: N815
    unknowns: int | None = None


@dataclass(frozen=True)
class PlannedMesh:
    """A mesh that is due: its solution, and what that is predicted to take."""

    mesh_size_mm: float
    task: SolveTask
    predicted: Predictions


@dataclass(frozen=True)
class Level:
    """One mesh of a series: what was predicted and what came out."""

    mesh_size_mm: float
    result: SolveResult
    predicted: Predictions = field(default_factory=Predictions)

    @property
    def converged(self) -> bool:
        """Whether it has an answer."""
        return self.result.converged

    @property
    def curve(self) -> Curve:
        """Predicted curve, as far as it came."""
        return self.result.curve

    @property
    def elements(self) -> int:
        """Elements of the mesh."""
        return self.result.elements

    def to_json(self) -> dict[str, object]:
        """Everything but the curve."""
        return {
            "mesh_size": self.mesh_size_mm,
            "status": self.result.status,
            "message": self.result.message,
            "elements": self.result.elements,
            "unknowns": self.result.dofs,
            "seconds": self.result.seconds,
            "memory_MB": self.result.memory_MB,
            "predicted_seconds": self.predicted.seconds,
            "predicted_MB": self.predicted.memory_MB,
            "predicted_unknowns": self.predicted.unknowns,
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
    tables : mapping
        Document of the problem.
    spec : Converge
        Ratio, number of meshes, wanted accuracy.
    first_mm : float
        Element size of the problem, the coarsest of the series.
    budget : Budget
        When it must stop.
    outlook : callable
        What its meshes so far say.
    levels_of : mapping of str to str
        Levels of the factors, where the problem is a cell.
    """

    tables: Tables
    spec: Converge
    first_mm: float
    budget: Budget
    outlook: Callable[[Sequence[Level]], Outlook]
    levels_of: Mapping[str, str] = field(default_factory=dict)
    levels: list[Level] = field(default_factory=list)
    stopped: str = ""

    @cached_property
    def setup(self) -> Setup:
        """Problem that is refined."""
        return Setup.of(self.tables)

    @property
    def good(self) -> list[Level]:
        """Meshes with an answer."""
        return [level for level in self.levels if level.converged]

    def due(self) -> list[PlannedMesh]:
        """List the next mesh; none where the series has ended (``stopped`` says why)."""
        self.stopped = self.stopped or self._end()
        if self.stopped:
            return []
        size = float(self.first_mm / self.spec.ratio ** len(self.levels))
        return [PlannedMesh(size, SolveTask.of(self.tables, size), self.predicted())]

    def add(self, step: PlannedMesh, found: SolveResult) -> None:
        """Take a solution."""
        self.levels.append(Level(step.mesh_size_mm, found, step.predicted))

    def _end(self) -> str:
        """Why no further mesh is solved; empty while one is wanted."""
        count, wanted = len(self.levels), max(FEWEST, self.spec.levels)
        if count >= wanted and len(self.good) >= FEWEST:
            if self.spec.tolerance is None:
                return f"{count} meshes were asked for"
            seen = self.outlook(self.levels)
            if seen.settled:
                return "every quantity has the wanted accuracy"
            if hopeless := self._hopeless(seen.size_needed_mm):
                return hopeless
        if count >= MOST or (count >= wanted + 2 and len(self.good) < FEWEST):
            return f"{count} meshes are enough"
        next_one = self.predicted()
        return self.budget.refuses(next_one.seconds, next_one.memory_MB) if count else ""

    def _hopeless(self, needed_mm: float | None) -> str:
        """Why the mesh that would be fine enough is out of reach; empty if it may be."""
        last = self.good[-1]
        if needed_mm is None or needed_mm >= last.mesh_size_mm:
            return ""
        space = self.setup.model.space
        power = (2 if space == "axisymmetric" else 3) * _TIME_EXPONENT[space]
        seconds = last.result.seconds * (last.mesh_size_mm / needed_mm) ** power
        if not self.budget.refuses(seconds, None):
            return ""
        return (
            f"the wanted accuracy needs a mesh size of about {needed_mm:.2g} mm and "
            f"{seconds:.2g} s, which the budget does not have"
        )

    def predicted(self) -> Predictions:
        """Cost of the next mesh, from what the meshes so far took."""
        known = [level.result for level in self.good if level.result.dofs > 0]
        if not known:
            return Predictions()
        last, space = known[-1], self.setup.model.space
        growth = self.spec.ratio ** (2 if space == "axisymmetric" else 3)
        time_exponent = _TIME_EXPONENT[space]
        if len(known) > 1 and known[-2].dofs < last.dofs:
            growth = last.dofs / known[-2].dofs
            time_exponent = _exponent(known[-2], last, time_exponent)
        own = max(last.memory_MB - last.base_MB, 1.0)
        memory = last.base_MB + own * growth**_MEMORY_EXPONENT
        return Predictions(last.seconds * growth**time_exponent, memory, round(last.dofs * growth))


def _exponent(before: SolveResult, last: SolveResult, usual: float) -> float:
    """Power of the unknowns that the time followed; small times say nothing."""
    if before.seconds < 0.02 or last.seconds <= before.seconds:
        return usual
    found = math.log(last.seconds / before.seconds) / math.log(last.dofs / before.dofs)
    return min(max(found, 1.0), 3.0)


def budget_of(seconds: float | None, memory_MB: float | None) -> Budget:  # noqa: N803
    """Budget of a command, from now on.

    Parameters
    ----------
    seconds : float or None
        Wall time of all meshes together; None for no limit.
    memory_MB : float or None
        Memory that one solution may take; None for 70 % of what is free now.
    """
    return Budget(seconds) if memory_MB is None else Budget(seconds, memory_MB)


def free_MB() -> float:  # noqa: N802
    """Memory that is free on this machine, in MB."""
    try:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**20
    except (ValueError, OSError):
        return 4096.0


def solving(
    solve: Solver, progress: Callable[[str], None] = lambda _: None
) -> Callable[[Sequence[PlannedMesh]], list[SolveResult]]:
    """Make the computation of the meshes of problems, for :func:`refine`.

    Parameters
    ----------
    solve : callable
        Solves a list of tasks.
    progress : callable
        Told of every round.
    """

    def compute(planned: Sequence[PlannedMesh]) -> list[SolveResult]:
        progress(_announced(planned))
        return solutions(solve, [mesh.task for mesh in planned])

    return compute


def _announced(planned: Sequence[PlannedMesh]) -> str:
    known = [m.predicted.seconds for m in planned if m.predicted.seconds is not None]
    sizes = ", ".join(dict.fromkeys(f"{mesh.mesh_size_mm:.3g}" for mesh in planned[:4]))
    cost = f", about {sum(known):.2g} s of computing" if known else ""
    several = "s" if len(planned) > 1 else ""
    return f"mesh size {sizes} mm: {len(planned)} solution{several}{cost}"
