"""What a refinement series says of every quantity: what ``study converge`` answers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from study.ground.arrays import Array
from study.ground.canonical import plain
from study.harness.design.cell import CellProblem, case_id
from study.harness.design.forward_model import ForwardCell
from study.harness.design.study_file import Converge
from study.harness.runner.refinement import (
    FEWEST,
    OTHER_MESH,
    QUANTITIES,
    SOLVER_TOLERANCE,
    Budget,
    FormalOrder,
    MeshLevel,
    RefinementSeries,
    formal_order,
    judged_meshes,
    quantity,
    refine,
    size_needed,
    usable,
    within,
)
from study.harness.runner.solve_task import Solver, SolveResult, SolveTask, solutions
from study.mechanics.forward.closed_form import height_and_area
from study.mechanics.setup.geometry import Enclosed
from study.mechanics.setup.setup import Problem
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


def one_table(
    quantities: Mapping[str, ConvergenceResult], others: Sequence[ErrorSource]
) -> tuple[ErrorSource, ...]:
    """Set the sources of error of every quantity side by side."""
    table: list[ErrorSource] = []
    for name, result in quantities.items():
        u, value = result.u_num, result.value[0]
        relative = None if u is None or not value else u / abs(value)
        mesh = ErrorSource("mesh", name, result.unit, result.mesh_size, result.value, u, relative)
        table += [mesh, *(row for row in others if row.quantity == name)]
    return tuple(table)


def remarks(table: Sequence[ErrorSource]) -> list[str]:
    """Say where another error is too large beside that of the mesh."""
    sentences = []
    meshes = {row.quantity: row.relative for row in table if row.source == "mesh"}
    for row in table:
        mesh, relative = meshes.get(row.quantity), row.relative
        if row.source == "mesh" or mesh is None or relative is None:
            continue
        if row.source == "solver tolerance" and relative * ALGEBRAIC > max(mesh, 1e-9):
            sentences.append(
                f"{row.quantity}: the solver's tolerance moves it by {relative:.1g} of its value, "
                f"more than a hundredth of the mesh's {mesh:.1g}"
            )
        if row.source == "another mesh" and relative > mesh:
            sentences.append(
                f"{row.quantity}: another mesh of the problem's own size bounds its error there by "
                f"{relative:.1g} of its value, the series of meshes at its finest by {mesh:.1g}"
            )
        if row.source == "load steps" and relative > mesh:
            sentences.append(
                f"{row.quantity}: the load steps are off by {relative:.1g} of its value, more than "
                f"the mesh ({mesh:.1g}): raise test.steps before refining"
            )
    return sentences


@dataclass(frozen=True)
class GivenMesh:
    """Value and uncertainty of the main quantity on the problem's own mesh."""

    mesh_size: float
    value: float
    u_num: float | None


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
    #: The mesh as it was asked for.
    given: GivenMesh | None = None
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
            "given_mesh": None if self.given is None else vars(self.given),
            "mesh_size_needed": self.mesh_size_needed,
            "formal_reason": self.formal_reason,
            "levels": dict(self.levels),
            **(of_problem if self.meshes else {"block": self.block}),
        }


def judge(series: RefinementSeries, tolerance: float | None = None) -> SeriesJudgement:
    """Judge the series of a problem."""
    (function, unit), formal = quantity(series.spec.qoi), series.formal
    meshes, warnings = usable(series.levels)
    facts = SeriesJudgement(
        inconclusive(
            series.spec.qoi,
            unit,
            [level.mesh_size_mm for level in meshes],
            [function(level.result.curve) for level in meshes],
            formal_order=formal.order,
        ),
        {},
        formal.why,
        levels=series.levels_of,
        meshes=tuple(reversed(series.levels)),
        stopped=series.stopped,
    )
    if len(meshes) < FEWEST:
        if len(meshes) == FEWEST - 1:
            pair = judged_meshes(meshes, series.setup, assumed_order(formal.order))
            of_two = pair[series.spec.qoi]
            verdict = f"{facts.main.verdict}; {of_two.verdict}"
            facts = replace(facts, main=replace(of_two, verdict=verdict))
        return facts.warned(*warnings)
    fraction, coarsest = SOLVER_TOLERANCE, meshes[0]
    if tolerance and (main := function(meshes[-1].result.curve)):
        fraction = tolerance / abs(main)
    results = judged_meshes(meshes, series.setup, formal.order, fraction)
    judgement = combined(facts, series.spec.qoi, results, series.spec.tolerance, warnings)
    given = given_mesh(judgement.main)
    return replace(judgement, given=replace(given, mesh_size=coarsest.mesh_size_mm))


def with_sources(
    judgement: SeriesJudgement, series: RefinementSeries, solve: Solver
) -> SeriesJudgement:
    """Add errors of steps, solver and choice of a mesh to those of the problem's own mesh."""
    rows, warnings = other_sources(series.problem, series.good[0].mesh_size_mm, solve)
    table = one_table(judgement.quantities, rows)
    given, key = judgement.given, ("another mesh", judgement.main.qoi)
    other = next((row.u for row in rows if (row.source, row.quantity) == key), None)
    if given is not None and given.u_num is not None and other is not None:
        given = replace(given, u_num=math.hypot(given.u_num, other))
    judgement = replace(judgement, sources=table, given=given)
    return judgement.warned(*warnings, *remarks(table))


def combined(
    facts: SeriesJudgement,
    qoi: str,
    results: Mapping[str, ConvergenceResult],
    accuracy: float | None,
    warnings: Sequence[str],
) -> SeriesJudgement:
    """Judgement of several judged quantities, all of which must settle."""
    main = results[qoi]
    judgement = replace(
        facts,
        main=replace(main, warnings=(*warnings, *main.warnings)),
        quantities=results,
        accuracy=accuracy,
        given=given_mesh(main),
    )
    if accuracy is None or not judgement.unsettled:
        return judgement.warned()
    return judgement.warned(f"not within {100 * accuracy:g} %: {', '.join(judgement.unsettled)}")


def given_mesh(result: ConvergenceResult) -> GivenMesh:
    """Value and uncertainty on the problem's own mesh, the coarsest of its series."""
    value = result.value[-1]
    return GivenMesh(result.mesh_size[-1], value, result.bound_of(value))


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
        qoi=qoi,
        unit=unit,
        mesh_size=tuple(reversed(sizes)),
        value=tuple(reversed(values)),
        behaviour="inconclusive",
        observed_order=None,
        formal_order=formal_order,
        extrapolated=None,
        gci_fine=None,
        factor_of_safety=None,
        u_num=u_num,
        asymptotic_ratio=None,
        verdict=verdict or usual,
    )


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
    groups: dict[str, list[int]] = {}
    for k, cell in enumerate(cells):
        physics = {name: v for name, v in cell.problem.document().items() if name in _PHYSICS}
        groups.setdefault(case_id(physics), []).append(k)
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
    points = {name: _points(name, cell, judgement, value) for name, cell, judgement in members}
    ranked = cost_to_accuracy(points, accuracy)
    every = tuple(point for row in points.values() for point in row)
    answer = _answer(ranked, accuracy, u, value)
    return CostFront(value, u, accuracy, every, tuple(ranked), answer)


def _points(
    name: str, series: RefinementSeries, judgement: SeriesJudgement, reference: float
) -> list[FrontPoint]:
    function = QUANTITIES[judgement.main.qoi][0]
    return [
        FrontPoint(
            level.mesh_size_mm, abs(value - reference) / abs(reference), level.result.seconds,
            name, level.result.dofs, level.result.memory_MB, value,
        )
        for level in series.good
        for value in (function(level.result.curve),)
    ]  # fmt: skip


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


def near(made: Problem) -> Array:
    """Corner that matters, (2, 2), mm: under an indenter, or where plate and side meet."""
    height, area = height_and_area(made.specimen)
    radius = float(np.sqrt(area / np.pi))
    if made.test.indenter is not None:
        reach = min(max(3 * made.test.depth_mm, 0.1 * radius), radius, height)
        return np.array([[0.0, height - reach], [reach, height]])
    reach = 0.4 * min(radius, height / 2)
    return np.array([[radius - reach, height - reach], [radius, height]])
