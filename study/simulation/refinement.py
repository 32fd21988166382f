"""Refinement: the loop, the series of a problem, and what a series says of every quantity.

A series says which computations are due and takes what they gave, until it has enough; the loop
does what is due of all series at once. A problem asks for one mesh after the other, as long as
its accuracy and its budget want; the cells of a study know all their meshes from the start (see
:mod:`study.harness.runner.study_refinement`).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from study.execution.local import free_memory_MB
from study.external.forward_model import ForwardCell
from study.ground.arrays import Array, gathered
from study.ground.canonical import Keyed, plain
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError, nearest
from study.mechanics.forward.closed_form import height_and_area
from study.mechanics.forward.formal_order import FormalOrder, element_size_mm, formal_order
from study.mechanics.setup.geometry import Enclosed, Flat
from study.mechanics.setup.setup import Problem, Setup
from study.simulation.cell import CellProblem, case_id
from study.simulation.problem_file import Converge
from study.simulation.response import even_places, work
from study.simulation.solve_task import Solver, SolveResult, SolveTask, solutions
from study.statistics.analysis.work_precision import (
    CostPoint,
    CostToAccuracy,
    cost_to_accuracy,
    reference_value,
)
from study.statistics.convergence.grid_convergence import (
    CAUTIOUS,
    ConvergenceResult,
    assumed_order,
    grid_convergence,
)

#: seed of the other mesh of a surface, whose difference tells how far a choice of meshes moves it
OTHER_MESH = 1

#: an order needs as many meshes, and no series gets longer than this
FEWEST = 3
MOST = 10

#: part of the free memory that a solution may take, and what is free where no system says it
MEMORY_SHARE = 0.7
USUAL_MB = 4096.0

#: exponents of time in the unknowns where only one mesh is known (numerics.md)
_TIME_EXPONENT = {"axisymmetric": 1.2, "3d": 1.95}
_MEMORY_EXPONENT = 1.35


@dataclass(frozen=True)
class MeshLevel(Keyed):
    """One mesh of a series: what was predicted and what came out."""

    mesh_size_mm: float
    result: SolveResult
    #: What it was predicted to take; None where nothing was known yet.
    predicted_seconds: float | None = None
    predicted_MB: float | None = None  # noqa: N815
    predicted_unknowns: int | None = None

    KEYS = (
        "mesh_size=mesh_size_mm status=result.status message=result.message "
        "elements=result.elements unknowns=result.dofs seconds=result.seconds "
        "memory_MB=result.memory_MB predicted_seconds predicted_MB predicted_unknowns"
    )


@dataclass(frozen=True)
class Budget:
    """When a series must stop: seconds from ``began``, and memory."""

    seconds: float | None = None
    memory_MB: float | None = None
    began: float = field(default_factory=time.monotonic)

    def refuses(self, seconds: float | None, memory: float | None) -> str:
        """Why a solution of this predicted cost is not begun; empty if it may."""
        left = None if self.seconds is None else self.seconds - (time.monotonic() - self.began)
        if left is not None and (seconds or 0.0) > left:
            return f"the next mesh would take {seconds or 0:.3g} s of {max(left, 0):.3g} s left"
        limit = self.memory_MB or MEMORY_SHARE * (free_memory_MB() or USUAL_MB)
        if memory is not None and memory > limit:
            return f"the next mesh would take {memory:.0f} MB of {limit:.0f} MB"
        return ""


# What a series says of its quantities.

Values = Mapping[str, tuple[Sequence[float], str]]

#: relative error of a force at the solver's tolerance
SOLVER_TOLERANCE = 1e-7

#: a value of this part of the largest of its kind is nothing to be settled
_NOTHING = 1e-9


def judged(
    sizes: Sequence[float],
    values: Values,
    formal: float | None,
    tolerance: float = SOLVER_TOLERANCE,
) -> dict[str, ConvergenceResult]:
    """Judge every quantity of a series of at least three meshes."""
    return {
        name: grid_convergence(
            sizes, numbers, formal_order=formal, qoi=name, unit=unit,
            tolerance=tolerance * max(abs(v) for v in numbers),
        )
        for name, (numbers, unit) in values.items()
    }  # fmt: skip


def within(results: Mapping[str, ConvergenceResult], accuracy: float) -> dict[str, bool]:
    """Whether the uncertainty of each quantity is at most a fraction of its value."""
    return {
        name: r.u_num is not None and r.u_num <= accuracy * abs(r.value[0]) + _NOTHING
        for name, r in results.items()
    }


def size_needed(result: ConvergenceResult, accuracy: float) -> float | None:
    """Mesh size whose uncertainty would be the wanted fraction of the value, by the order used."""
    if result.order_used is None or not result.u_num or result.extrapolated in (None, 0.0):
        return None
    allowed = accuracy * abs(result.extrapolated)
    return float(result.mesh_size[0] * (allowed / result.u_num) ** (1 / result.order_used))


@dataclass
class RefinementSeries:
    """Refinement of one problem, coarse to fine."""

    problem: CellProblem
    #: Ratio, number of meshes, wanted accuracy.
    spec: Converge
    #: What the elements promise, and what limits it.
    formal: FormalOrder
    budget: Budget = field(default_factory=Budget)
    #: Levels of the factors, where the problem is a cell.
    levels_of: Mapping[str, str] = field(default_factory=dict)
    levels: list[MeshLevel] = field(default_factory=list)
    stopped: str = ""

    @cached_property
    def first_mm(self) -> float:
        """Element size of the problem, the coarsest of the series."""
        return element_size_mm(self.problem.at())

    @property
    def good(self) -> list[MeshLevel]:
        """Meshes with an answer."""
        return [level for level in self.levels if level.result.converged]

    @property
    def next_mm(self) -> float | None:
        """Size of the next mesh; None where the series has ended (``stopped`` says why)."""
        self.stopped = self.stopped or self._end()
        return None if self.stopped else float(self.first_mm / self.spec.ratio ** len(self.levels))

    def _end(self) -> str:
        """Why no further mesh is solved; empty while one is wanted."""
        count, needed = len(self.levels), max(FEWEST, self.spec.levels)
        if count >= needed and len(self.good) >= FEWEST:
            if self.spec.tolerance is None:
                return f"{count} meshes were asked for"
            settled, needed_mm = self._outlook(self.spec.tolerance)
            if settled:
                return "every quantity has the wanted accuracy"
            if hopeless := self._hopeless(needed_mm):
                return hopeless
        if count >= MOST or (count >= needed + 2 and len(self.good) < FEWEST):
            return f"{count} meshes are enough"
        seconds, memory, _ = self.predicted()
        return self.budget.refuses(seconds, memory) if count else ""

    def _outlook(self, accuracy: float) -> tuple[bool, float | None]:
        """Whether every quantity has the wanted accuracy, and the mesh size that it takes."""
        meshes, _ = usable(self.levels)
        if len(meshes) < FEWEST:
            return False, None
        results = judged_meshes(meshes, self.problem.setup, self.formal.order)
        needed = [size_needed(result, accuracy) for result in results.values()]
        sizes = [size for size in needed if size is not None]
        return all(within(results, accuracy).values()), min(sizes, default=None)

    def _hopeless(self, needed_mm: float | None) -> str:
        """Why the mesh that would be fine enough is out of reach; empty if it may be."""
        last = self.good[-1]
        if needed_mm is None or needed_mm >= last.mesh_size_mm:
            return ""
        space = self.problem.model.space
        power = (2 if space == "axisymmetric" else 3) * _TIME_EXPONENT[space]
        seconds = last.result.seconds * (last.mesh_size_mm / needed_mm) ** power
        if not self.budget.refuses(seconds, None):
            return ""
        return (
            f"the wanted accuracy needs a mesh size of about {needed_mm:.2g} mm and "
            f"{seconds:.2g} s, which the budget does not have"
        )

    def predicted(self) -> tuple[float | None, float | None, int | None]:
        """Seconds, memory in MB and unknowns of the next mesh, from what those so far took."""
        solved = [level.result for level in self.good if level.result.dofs > 0]
        if not solved:
            return None, None, None
        last, space = solved[-1], self.problem.model.space
        growth = self.spec.ratio ** (2 if space == "axisymmetric" else 3)
        time_exponent = _TIME_EXPONENT[space]
        if len(solved) > 1 and solved[-2].dofs < last.dofs:
            before, growth = solved[-2], last.dofs / solved[-2].dofs
            if before.seconds >= 0.02 and last.seconds > before.seconds:  # small times say nothing
                followed = math.log(last.seconds / before.seconds) / math.log(growth)
                time_exponent = min(max(followed, 1.0), 3.0)
        growth_MB = max(last.memory_MB - last.base_MB, 1.0)
        memory = last.base_MB + growth_MB * growth**_MEMORY_EXPONENT
        return last.seconds * growth**time_exponent, memory, round(last.dofs * growth)


def refine(
    series: Sequence[RefinementSeries],
    solve: Solver,
    progress: Callable[[str], None] = lambda _: None,
) -> None:
    """Solve the next mesh of every series, all of one round together, until all have ended."""
    while due := [(member, mm) for member in series if (mm := member.next_mm) is not None]:
        predicted = [member.predicted() for member, _ in due]
        foretold = [seconds for seconds, *_ in predicted if seconds is not None]
        sizes = ", ".join(dict.fromkeys(f"{mm:.3g}" for _, mm in due[:4]))
        cost = f", about {sum(foretold):.2g} s of computing" if foretold else ""
        several = "s" if len(due) > 1 else ""
        progress(f"mesh size {sizes} mm: {len(due)} solution{several}{cost}")
        results = solutions(solve, [SolveTask.of(member.problem, mm) for member, mm in due])
        for (member, mm), result, cost_of in zip(due, results, predicted, strict=True):
            member.levels.append(MeshLevel(mm, result, *cost_of))


# Single numbers of a curve whose convergence is judged: peak force, root mean square, work.


def curve_rms(curve: Curve) -> float:
    """Root mean square of the force over the displacement, N: it stands for the whole curve."""
    return float(np.sqrt(np.mean(curve.force_at(even_places(curve))[1:] ** 2)))


#: quantities of a curve that a series can watch, with their units
QUANTITIES: Mapping[str, tuple[Callable[[Curve], float], str]] = {
    "peak_force": (lambda curve: float(curve.force_N[-1]), "N"),
    "curve_rms": (curve_rms, "N"),
    "work": (work, "N mm"),
}


def quantity(name: str) -> tuple[Callable[[Curve], float], str]:
    """Look up function and unit of a quantity of a single problem."""
    if name not in QUANTITIES:
        rule = f"{name!r} needs measured curves"
        raise InputError(Fault("converge.qoi", rule, nearest(name, QUANTITIES)))
    return QUANTITIES[name]


# Meshes of a series that can be judged, and the sizes by which they are.


def usable(levels: Sequence[MeshLevel]) -> tuple[list[MeshLevel], list[str]]:
    """Meshes with an answer and with elements of their own, and what is wrong with the others."""
    meshes: list[MeshLevel] = []
    warnings = [
        f"the mesh of {level.mesh_size_mm:.4g} mm gave no answer: {level.result.message}"
        for level in levels
        if not level.result.converged
    ]
    for level in levels:
        if not level.result.converged:
            continue
        count = level.result.elements
        same = [mesh for mesh in meshes if mesh.result.elements == count > 0]
        if same:
            warnings.append(
                f"the meshes of {same[0].mesh_size_mm:.4g} mm and {level.mesh_size_mm:.4g} mm "
                f"have the same {count} elements: the coarser is left out; a larger "
                "ratio or a smaller mesh_size would refine"
            )
            meshes.remove(same[0])
        meshes.append(level)
    return meshes, warnings


def judged_meshes(
    levels: Sequence[MeshLevel],
    setup: Setup,
    formal: float | None,
    tolerance: float = SOLVER_TOLERANCE,
) -> dict[str, ConvergenceResult]:
    """Judge every quantity of the curves of solved meshes by sizes scaled to the finest one's."""
    sizes, elements = zip(*((m.mesh_size_mm, m.result.elements) for m in levels), strict=True)
    values = {
        name: ([function(level.result.curve) for level in levels], unit)
        for name, (function, unit) in QUANTITIES.items()
    }
    return judged(series_sizes(sizes, elements, setup), values, formal, tolerance)


def series_sizes(
    sizes: Sequence[float], elements: Sequence[int], setup: Setup, *, anchor: int = -1
) -> list[float]:
    """Sizes by which a series is judged: by its elements, or those at a sharp edge."""
    pressed = setup.test.indenter
    is_sharp = isinstance(pressed, Flat) and not pressed.edge_radius_mm
    # all error comes from a sharp edge, where the size at the edge is that of the mesh
    at_edge = is_sharp and setup.model.space == "axisymmetric"
    if at_edge or min(elements) <= 0 or len(set(elements)) < len(elements):
        return list(sizes)
    # h = (V / N)^(1/d) of N elements, scaled to one of them (Celik et al. 2008)
    power = 1 / (3 if setup.model.space == "3d" else 2)
    return [sizes[anchor] * (elements[anchor] / n) ** power for n in elements]


# Errors of mesh, load steps and solver tolerance side by side, for a surface also of the choice
# between equally good meshes.

#: How many load steps replace one.
STEPS = (1, 2, 4)

#: How much looser than usual the solver is.
LOOSER = (1.0, 10.0, 100.0)

#: The algebraic error should be this much smaller than that of the mesh.
ALGEBRAIC = 100.0


@dataclass(frozen=True)
class ErrorSource:
    """What one source of error does to a quantity."""

    #: ``"mesh"``, ``"another mesh"``, ``"load steps"`` or ``"solver tolerance"``.
    source: str
    #: What it moves, and its unit.
    quantity: str
    unit: str
    #: Mesh size, seed, number of steps or factor on the tolerance, finest first, and the values.
    setting: tuple[float, ...]
    value: tuple[float, ...]
    #: Uncertainty of the quantity, in its unit.
    u: float | None
    relative: float | None


def other_sources(
    problem: CellProblem, size_mm: float, solve: Solver
) -> tuple[list[ErrorSource], list[str]]:
    """Errors of every source for every quantity, and which solutions failed."""
    steps = [(float(problem.test.steps * k), SolveTask.of(problem, size_mm, more_steps=k))
             for k in reversed(STEPS)]  # fmt: skip
    looser = [(k, SolveTask.of(problem, size_mm, looser=k)) for k in LOOSER]
    sources = [
        ("load steps", steps, "{:g} load steps"),
        ("solver tolerance", looser, "a tolerance {:g} times the usual"),
    ]
    if isinstance(problem.specimen, Enclosed):
        other = SolveTask.of(problem.on_mesh(mesh_seed=OTHER_MESH), size_mm)
        two = [(0.0, SolveTask.of(problem, size_mm)), (float(OTHER_MESH), other)]
        sources.insert(0, ("another mesh", two, "the mesh of this size with seed {:g}"))
    results = iter(solutions(solve, [task for _, tasks, _ in sources for _, task in tasks]))
    rows, warnings = [], []
    for name, tasks, text in sources:
        pairs = [(k, next(results)) for k, _ in tasks]
        good = [(k, result) for k, result in pairs if result.converged]
        warnings += [
            f"{text.format(k)} gave no answer: {result.message}"
            for k, result in pairs
            if not result.converged
        ]
        rows += [_source(name, quantity, good) for quantity in QUANTITIES if len(good) > 1]
    return rows, warnings


def _source(source: str, name: str, good: Sequence[tuple[float, SolveResult]]) -> ErrorSource:
    function, unit = QUANTITIES[name]
    values = tuple(function(result.curve) for _, result in good)
    settings, reference = tuple(k for k, _ in good), values[0]
    # steps: what the problem's own number of them is off by; tolerance: what ten times it costs
    if source == "load steps":  # the changes of a halved step form a series
        u = abs(values[-1] - values[0])
        if len(values) > 2:
            of_steps = grid_convergence([1.0, 2.0, 4.0], values, tolerance=1e-8 * abs(values[0]))
            u = max(u, of_steps.bound_of(values[-1]) or 0.0)
    else:
        u = abs(values[1] - reference)
    if source == "another mesh":
        u *= CAUTIOUS  # of two values, as of the coarser of two meshes
    relative = u / abs(reference) if reference else None
    return ErrorSource(source, name, unit, settings, values, u, relative)


#: by source of error: factor on its error before it is compared with the error of the mesh, and
#: the remark where it is the larger one
_REMARKS = {
    "solver tolerance": (
        ALGEBRAIC,
        "the solver's tolerance moves it by {:.1g} of its value, more than a hundredth of the "
        "mesh's {:.1g}",
    ),
    "another mesh": (
        1.0,
        "another mesh of the problem's own size bounds its error there by {:.1g} of its value, "
        "the series of meshes at its finest by {:.1g}",
    ),
    "load steps": (
        1.0,
        "the load steps are off by {:.1g} of its value, more than the mesh ({:.1g}): raise "
        "test.steps before refining",
    ),
}


def remarks(table: Sequence[ErrorSource]) -> list[str]:
    """Say where another error is too large beside that of the mesh."""
    sentences = []
    meshes = {row.quantity: row.relative for row in table if row.source == "mesh"}
    for row in table:
        mesh, relative = meshes.get(row.quantity), row.relative
        if row.source not in _REMARKS or mesh is None or relative is None:
            continue
        factor, text = _REMARKS[row.source]
        if relative * factor > (max(mesh, 1e-9) if row.source == "solver tolerance" else mesh):
            sentences.append(f"{row.quantity}: {text.format(relative, mesh)}")
    return sentences


@dataclass(frozen=True)
class SeriesJudgement:
    """What a refinement series says of every quantity."""

    main: ConvergenceResult
    #: Of every quantity; empty where there are no three meshes.
    quantities: Mapping[str, ConvergenceResult]
    #: What limits the order that the elements promise.
    formal_reason: str
    #: Wanted uncertainty over the value; None where none was asked, or no order is known.
    accuracy: float | None = None
    #: Levels of the factors and block, where the series is that of a cell.
    levels: Mapping[str, str] = field(default_factory=dict)
    #: Size, value and uncertainty of the main quantity on the mesh as it was asked for.
    given: Mapping[str, float | None] | None = None
    #: Every mesh of a problem, the finest first, and why no further one was solved.
    meshes: tuple[MeshLevel, ...] = ()
    stopped: str = ""
    #: Errors of mesh, load steps and solver side by side.
    sources: tuple[ErrorSource, ...] = ()
    block: str | None = None

    @property
    def settled(self) -> bool:
        """Whether every quantity has the wanted accuracy, or none diverges where none is asked."""
        return bool(self.quantities) and not self.unsettled

    @property
    def unsettled(self) -> list[str]:
        """Quantities without the wanted accuracy; those that diverge where none is asked."""
        if self.accuracy is None:
            return [n for n, r in self.quantities.items() if r.behaviour == "divergent"]
        good = within(self.quantities, self.accuracy)
        return [name for name, ok in good.items() if not ok]

    @property
    def mesh_size_needed(self) -> float | None:
        """Mesh size that would have the wanted accuracy, in mm."""
        return None if self.accuracy is None else size_needed(self.main, self.accuracy)

    def warned(self, *sentences: str) -> SeriesJudgement:
        """Copy with further warnings, each once."""
        warnings = tuple(dict.fromkeys([*self.main.warnings, *sentences]))
        return replace(self, main=replace(self.main, warnings=warnings))

    def noted(self) -> SeriesJudgement:
        """Copy that says which quantities have not the wanted accuracy, each warning once."""
        if self.accuracy is None or not self.unsettled:
            return self.warned()
        return self.warned(f"not within {100 * self.accuracy:g} %: {', '.join(self.unsettled)}")

    def to_json(self) -> dict[str, object]:
        """Document of ``study converge``: the keys of the main quantity, and all others."""
        of_problem = {
            "meshes": [level.to_json() for level in self.meshes],
            "stopped": self.stopped,
            "sources": [dict(plain(source)) for source in self.sources],
        }
        if not self.quantities:
            del of_problem["sources"]
        return {
            **self.main.to_json(),
            "quantities": {name: result.to_json() for name, result in self.quantities.items()},
            "accuracy": self.accuracy,
            "settled": self.settled,
            "given_mesh": self.given,
            "mesh_size_needed": self.mesh_size_needed,
            "formal_reason": self.formal_reason,
            "levels": dict(self.levels),
            **(of_problem if self.meshes else {"block": self.block}),
        }


def judge(series: RefinementSeries, tolerance: float | None = None) -> SeriesJudgement:
    """Judge the series of a problem."""
    spec, formal, setup = series.spec, series.formal, series.problem.setup
    function, unit = quantity(spec.qoi)
    meshes, warnings = usable(series.levels)
    values = [function(level.result.curve) for level in meshes]
    results: Mapping[str, ConvergenceResult] = {}
    given, accuracy = None, None
    if len(meshes) >= FEWEST:
        fraction = tolerance / abs(values[-1]) if tolerance and values[-1] else SOLVER_TOLERANCE
        results = judged_meshes(meshes, setup, formal.order, fraction)
        main, accuracy = results[spec.qoi], spec.tolerance
        given = {**given_mesh(main), "mesh_size": meshes[0].mesh_size_mm}
        main = replace(main, warnings=(*warnings, *main.warnings))
    else:
        sizes = [level.mesh_size_mm for level in meshes]
        main = inconclusive(spec.qoi, unit, sizes, values, formal_order=formal.order)
        if len(meshes) == FEWEST - 1:
            pair = judged_meshes(meshes, setup, assumed_order(formal.order))[spec.qoi]
            main = replace(pair, verdict=f"{main.verdict}; {pair.verdict}")
        main = replace(main, warnings=(*main.warnings, *warnings))
    return SeriesJudgement(
        main, results, formal.why, accuracy, series.levels_of, given,
        tuple(reversed(series.levels)), series.stopped,
    ).noted()  # fmt: skip


def with_sources(
    judgement: SeriesJudgement, series: RefinementSeries, solve: Solver
) -> SeriesJudgement:
    """Add errors of steps, solver and choice of a mesh to those of the problem's own mesh."""
    rows, warnings = other_sources(series.problem, series.good[0].mesh_size_mm, solve)
    table: list[ErrorSource] = []
    for name, result in judgement.quantities.items():  # all sources of a quantity side by side
        u, value = result.u_num, result.value[0]
        relative = None if u is None or not value else u / abs(value)
        mesh = ErrorSource("mesh", name, result.unit, result.mesh_size, result.value, u, relative)
        table += [mesh, *(row for row in rows if row.quantity == name)]
    given, key = judgement.given, ("another mesh", judgement.main.qoi)
    other = next((row.u for row in rows if (row.source, row.quantity) == key), None)
    u = None if given is None else given["u_num"]
    if given is not None and u is not None and other is not None:
        given = {**given, "u_num": math.hypot(u, other)}
    judgement = replace(judgement, sources=tuple(table), given=given)
    return judgement.warned(*warnings, *remarks(table))


def given_mesh(result: ConvergenceResult) -> Mapping[str, float | None]:
    """Value and uncertainty on the problem's own mesh, the coarsest of its series."""
    value = result.value[-1]
    return {"mesh_size": result.mesh_size[-1], "value": value, "u_num": result.bound_of(value)}


def inconclusive(
    qoi: str,
    unit: str,
    sizes: Sequence[float],
    values: Sequence[float],
    *,
    formal_order: float | None = None,
    u_num: float | None = None,
    verdict: str = "",
) -> ConvergenceResult:
    """Make the result of a series, coarse to fine, with too few meshes for an order."""
    usual = f"an order needs three meshes with an answer, there are {len(values)}"
    return ConvergenceResult(
        qoi, unit, tuple(reversed(sizes)), tuple(reversed(values)), "inconclusive",
        formal_order=formal_order, u_num=u_num, verdict=verdict or usual,
    )  # fmt: skip


# What each mesh costs, of cells that differ in nothing but their discretization.


@dataclass(frozen=True)
class FrontPoint(CostPoint):
    """Error and cost of one mesh of one cell; the error is a share of the reference."""

    cell: str
    unknowns: int
    memory_MB: float  # noqa: N815
    value: float


@dataclass(frozen=True)
class CostFront:
    """Cells that differ in nothing but their discretization: error against cost."""

    #: The limit with the smallest uncertainty among the cells, and that uncertainty.
    reference: float
    reference_u: float | None
    #: Wanted error, as a share of the reference.
    accuracy: float
    points: tuple[FrontPoint, ...]
    #: Which cell reaches the accuracy, the cheapest first.
    ranking: tuple[CostToAccuracy, ...]
    answer: str


def refined_and_judged(
    problems: Sequence[tuple[CellProblem, Mapping[str, str]]],
    spec: Converge,
    solver: Solver,
    progress: Callable[[str], None],
    *,
    memory_MB: float | None = None,  # noqa: N803
    formal: FormalOrder | None = None,
    tolerance: float | None = None,
) -> tuple[list[RefinementSeries], list[SeriesJudgement]]:
    """Refine problems, each with its levels, and study their other errors besides."""
    quantity(spec.qoi)
    budget = Budget(spec.budget_s, memory_MB)
    cells = [
        RefinementSeries(cell, spec, formal or formal_order(cell.at()), budget, levels)
        for cell, levels in problems
    ]
    refine(cells, solver, progress)
    judged = [judge(cell, tolerance) for cell in cells]
    if any(judgement.quantities for judgement in judged):
        progress("load steps and solver tolerance")
    return cells, [
        with_sources(judgement, cell, solver) if judgement.quantities else judgement
        for judgement, cell in zip(judged, cells, strict=True)
    ]


#: tables that say which cells are one test, on whatever mesh
_PHYSICS = ("specimen", "test", "material")


def cost_fronts(
    cells: Sequence[RefinementSeries], judged: Sequence[SeriesJudgement], accuracy: float
) -> list[CostFront]:
    """Error against seconds of every mesh, and which cell reaches the accuracy first."""
    documents = [cell.problem.document() for cell in cells]
    tests = [case_id({k: v for k, v in doc.items() if k in _PHYSICS}) for doc in documents]
    groups = gathered((test, k) for k, test in enumerate(tests))
    names = [" / ".join(cell.levels_of.values()) or f"cell {k + 1}" for k, cell in enumerate(cells)]
    fronts = [
        _front([(names[k], cells[k], judged[k]) for k in members], accuracy)
        for members in groups.values()
    ]
    return [front for front in fronts if front is not None]


def _front(
    members: Sequence[tuple[str, RefinementSeries, SeriesJudgement]], accuracy: float
) -> CostFront | None:
    value, u = reference_value(
        [(judgement.main.extrapolated, judgement.main.u_num) for *_, judgement in members]
    )
    if not value:
        return None
    points = {
        name: [
            FrontPoint(
                level.mesh_size_mm, abs(number - value) / abs(value), level.result.seconds,
                name, level.result.dofs, level.result.memory_MB, number,
            )
            for level in series.good
            for number in (QUANTITIES[judgement.main.qoi][0](level.result.curve),)
        ]
        for name, series, judgement in members
    }  # fmt: skip
    ranked = cost_to_accuracy(points, accuracy)
    every = tuple(point for row in points.values() for point in row)
    return CostFront(value, u, accuracy, every, tuple(ranked), _answer(ranked, accuracy, u, value))


def _answer(
    ranked: Sequence[CostToAccuracy], accuracy: float, u: float | None, value: float
) -> str:
    reached = [r for r in ranked if r.seconds is not None]
    if not reached:
        return f"no cell gets within {100 * accuracy:g} %"
    best = reached[0]
    text = (
        f"{best.cell} gives {100 * accuracy:g} % error for the least time: {best.seconds:.2g} s "
        f"at a mesh size of {best.mesh_size:.2g} mm"
    )
    if best.how == "extrapolated":
        text += ", extrapolated beyond its finest mesh"
    if best.how == "coarsest mesh":
        text += ", its coarsest mesh"
    if len(reached) > 1:
        text += f"; next {reached[1].cell} with {reached[1].seconds:.2g} s"
    if u is not None and u > accuracy * abs(value) / 3:
        text += f"; the reference itself is only known to {100 * u / abs(value):.2g} %"
    return text


# Pictures of the meshes of a convergence study.

#: cells whose coarsest and finest mesh are shown
SHOWN = 4
#: plane elements by their number of vertices
_SHAPES = {3: "triangles", 4: "quadrilaterals"}


def meshes(
    cells: Sequence[SeriesJudgement], problems: Sequence[ForwardCell]
) -> tuple[list[tuple[str, Array, NDArray[np.int64]]], Array | None]:
    """Coarsest and finest plane mesh (n, 2) of cells, and the window (2, 2) to see, mm."""
    from study.mechanics.mesh.mesher import build_mesh

    drawn: dict[str, tuple[str, Array, NDArray[np.int64]]] = {}
    window = None
    for cell, problem in zip(cells, problems, strict=True):
        sizes = [level.mesh_size_mm for level in cell.meshes if level.result.converged]
        if not isinstance(problem, CellProblem) or problem.model.space == "3d":
            continue
        if not sizes or len(drawn) >= 2 * SHOWN:
            continue
        for size in (sizes[-1], sizes[0]):
            mesh = build_mesh(SolveTask.of(problem, size).problem.at().setup)
            elements = f"{size:.3g} mm, {len(mesh.cells)} elements"
            label = f"{_SHAPES[mesh.cells.shape[1]]}, {elements}"
            picture = label, np.asarray(mesh.points), np.asarray(mesh.cells)
            drawn.setdefault(mesh.digest(), picture)
        window = near(problem.at()) if window is None else window
    return list(drawn.values()), window


def near(problem: Problem) -> Array:
    """Corner that matters, (2, 2), mm: under an indenter, or where plate and side meet."""
    height, area = height_and_area(problem.specimen)
    radius = float(np.sqrt(area / np.pi))
    if problem.test.indenter is not None:
        reach = min(max(3 * problem.test.depth_mm, 0.1 * radius), radius, height)
        return np.array([[0.0, height - reach], [reach, height]])
    reach = 0.4 * min(radius, height / 2)
    return np.array([[radius - reach, height - reach], [radius, height]])
