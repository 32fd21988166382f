"""``study converge DESIGN``: every cell refined, reusing what its study has solved."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Self, cast

import numpy as np
from numpy.typing import NDArray

from study.api.folders import RESULTS, data_root, design_root, loaded_problem
from study.api.opened_study import load as load_study
from study.ground.arrays import Array
from study.ground.canonical import digest, plain
from study.ground.errors import Fault, InputError
from study.harness.design.cell import CellProblem, case_id, tested
from study.harness.design.forward_model import ForwardCell
from study.harness.design.load import file_kind, load
from study.harness.design.spec import LoadedProblem
from study.harness.design.study_file import Converge
from study.harness.execution.task import Executor
from study.harness.record.folder import own_folder
from study.harness.record.record import Record
from study.harness.record.store import Store
from study.harness.runner import provenance, refinement, study_refinement
from study.harness.runner.batch import Progress as RunProgress
from study.harness.runner.batch import computed
from study.harness.runner.case_series import CaseSeries, refine_cases, stored_convergence
from study.harness.runner.expansion import expand
from study.harness.runner.job import CaseJob, fits_of
from study.harness.runner.refinement import (
    QUANTITIES,
    Budget,
    RefinementSeries,
    SeriesJudgement,
    judge,
    refine,
    with_sources,
)
from study.harness.runner.solve_task import SolveTask, by_workers, in_process, kept, slug, store_of
from study.harness.runner.tasks import Costs, default_jobs, processes
from study.mechanics.forward.closed_form import height_and_area
from study.mechanics.forward.formal_order import FormalOrder
from study.mechanics.forward.formal_order import formal_order as promised
from study.mechanics.setup.setup import Problem, Tables
from study.reporting.figures.axes import shown
from study.reporting.output.convergence_page import series_blocks, write_convergence
from study.reporting.output.page import Shown
from study.statistics.analysis.work_precision import (
    CostPoint,
    CostToAccuracy,
    cost_to_accuracy,
    reference_value,
)
from study.statistics.convergence.grid_convergence import grid_convergence

if TYPE_CHECKING:
    import pandas as pd

    from study.harness.design.spec import Design
    from study.harness.runner.solve_task import Solver
    from study.reporting.content.blocks import Block, Document
    from study.reporting.figures.axes import Drawing
    from study.statistics.convergence.grid_convergence import ConvergenceResult


# What ``study converge`` found of a problem, or of the cells of a design.


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


class SeriesDocument(Shown, dict[str, object]):
    """Document of ``study converge``, a dictionary that can be shown."""

    def to_frame(self) -> pd.DataFrame:
        """Return the meshes of all series, one row each."""
        from study.reporting.figures.convergence_figures import value_points

        return value_points(cast("Sequence[Document]", self.get("cells", [self])))

    def plot(self) -> Drawing:
        """Draw value against mesh size, a panel a series, with the limit at zero."""
        from study.reporting.figures.convergence_figures import draw_values

        frame = self.to_frame()
        return shown(lambda: draw_values(frame), "convergence", "value against mesh size")

    def blocks(self) -> Iterator[Block]:
        """Every series with its verdict, as ``study converge`` prints them."""
        return series_blocks(self)

    def paged(
        self,
        name: str,
        question: str,
        reports: Path | None,
        cells: Sequence[SeriesJudgement],
        problems: Sequence[ForwardCell],
    ) -> Self:
        """Write the page where a folder is given, and name it."""
        if reports is not None:
            pictures, window = meshes(cells, problems)
            folder = reports / slug(name)
            page = write_convergence(name, question, self, folder, pictures, window)
            self["report"] = str(page)
        return self


# The page of a convergence study, with pictures of its meshes.

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


# Refinement of a study's cells within a time budget, mesh by mesh, cheapest cells first.
#
# Before the first mesh a cost is a prediction, which may be off by several times; from then on a
# cell costs what its last mesh took, times the predicted ratio of the two.

Compute = Callable[[Sequence[CaseJob]], Sequence[Record | None]]


def refine_within(
    seconds: float, workers: int, series: Sequence[CaseSeries], compute: Compute
) -> list[CaseSeries]:
    """Refine cells as far as a time budget allows."""
    until, costs, ongoing = time.monotonic() + seconds, Costs(), list(series)
    predicted = {
        job.case.case_id: costs.total_seconds(fits_of([job]).values(), [job], 1)
        for case_series in series
        for job in case_series.jobs
    }
    for level in range(max((len(case_series.jobs) for case_series in series), default=0)):
        left = (until - time.monotonic()) * workers
        prices = [_price(case_series, level, predicted) for case_series in ongoing]
        order = sorted(range(len(ongoing)), key=lambda i: prices[i])
        spent = accumulate(prices[i] for i in order)
        ongoing = [ongoing[i] for i, total in zip(order, spent, strict=True) if total <= left]
        steps = [case_series.jobs[level] for case_series in ongoing]
        for refined, step, answer in zip(
            ongoing, steps, compute(steps) if steps else (), strict=True
        ):
            refined.records[step.case.case_id] = answer
    return ongoing


def _price(case_series: CaseSeries, level: int, predicted: Mapping[str, float]) -> float:
    """Worker seconds of a cell's next mesh, its calibrations too."""
    names = [job.case.case_id for job in case_series.jobs]
    last = case_series.records.get(names[level - 1]) if level else None
    taken = None if last is None else last.timings.get("total")
    if taken is None:
        return predicted[names[level]]
    return taken * predicted[names[level]] / predicted[names[level - 1]]


Progress = Callable[[str], None]

#: relative error of a force where the design asks for no accuracy
USUAL_ACCURACY = 0.01


def problem_cells(
    design: Design,
    jobs: int,
    results: Path,
    progress: Progress,
    *,
    reports: Path | None = None,
    memory_MB: float | None = None,  # noqa: N803
    solve: Solver | None = None,
) -> SeriesDocument:
    """Judge every cell of a design without measurements, and what each accuracy costs."""
    spec = design.converge
    places = provenance.folders(design.source, data_root(design.source))
    problems = [provenance.located(tested(t.cell.problem), places) for t in design.treatments]
    labels = [dict(treatment.levels) for treatment in design.treatments]
    solver = solve or kept(by_workers(processes(jobs)), store_of(results, design.name))
    formal = [promised(one.at()) for one in problems]
    budget = Budget(spec.budget_s, memory_MB)
    cells, judged = _judged(problems, spec, formal, labels, budget, solver, progress)
    fronts = cost_fronts(cells, judged, spec.tolerance or USUAL_ACCURACY)
    found = SeriesDocument(cells=[one.to_json() for one in judged], fronts=plain(fronts))
    return found.paged(design.name, design.question, reports, judged, problems)


def _judged(
    problems: Sequence[CellProblem],
    spec: Converge,
    formal: Sequence[FormalOrder],
    labels: Sequence[Mapping[str, str]],
    budget: Budget,
    solver: Solver,
    progress: Progress,
    tolerance: float | None = None,
) -> tuple[list[RefinementSeries], list[SeriesJudgement]]:
    """Refine problems until their meshes are enough, and study their other errors besides."""
    refinement.quantity(spec.qoi)
    cells = [
        RefinementSeries(cell, spec, order, budget, its_labels)
        for cell, order, its_labels in zip(problems, formal, labels, strict=True)
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


def measured_cells(
    design: Design,
    data: Path,
    jobs: int,
    results: Path,
    progress: Progress,
    *,
    reports: Path | None = None,
    executor: Executor | None = None,
) -> SeriesDocument:
    """Refine every cell of a study in its first block: its calibration, its score, its curve."""
    whole = expand(design, data)
    work = whole.plain()
    store, seconds = Store(own_folder(results, design.name)), design.converge.budget_s
    every = study_refinement.every_series(work)
    finer = sum(len(case_series.jobs) - 1 for case_series in every)
    limit = "" if seconds is None else f", as many as {seconds:g} s allow"
    progress(f"{len(every)} cells, {finer} refined cases besides{limit}")

    def say(state: RunProgress) -> None:
        progress(f"{state.done}/{state.total}: {state.label}")

    compute = partial(computed, work, store, executor or processes(jobs), say)
    if seconds is None:
        refine_cases(every, compute)
    else:
        refine_within(seconds, jobs, every, compute)
    series = [case_series for case_series in every if len(case_series.records) > 1]
    rows = [asdict(row) for row in study_refinement.uncertainties(work, series)]
    with store.lock():
        store.write_json("numerical-cells", {"of": digest(whole.input_hashes), "rows": rows})
    judged = [case_series.judge(design.converge, work.responses) for case_series in series]
    left_out = [
        {"levels": dict(case_series.base.case.levels), "verdict": "left out: the time budget"}
        for case_series in every
        if case_series not in series
    ]
    problems = [case_series.base.case.problem for case_series in series]
    found = SeriesDocument(cells=[one.to_json() for one in judged], left_out=left_out)
    return found.paged(design.name, design.question, reports, judged, problems)


def converge(
    source: str | Path | Tables | None = None,
    *,
    values: Sequence[float] = (),
    sizes: Sequence[float] = (),
    formal_order: float | None = None,
    tolerance: float = 0.0,
    overrides: Sequence[str] = (),
    data: str | Path | None = None,
    jobs: int | None = None,
    memory_MB: float | None = None,  # noqa: N803
    results: str | Path = RESULTS,
    reports: str | Path | None = None,
    progress: Progress | None = None,
) -> ConvergenceResult | SeriesDocument:
    """Judge a refinement series: of plain numbers, of a problem, or of a study.

    Solutions are kept under ``results``: running again continues where it stopped.

    Parameters
    ----------
    source : str, Path or mapping, optional
        Problem file or its tables as :func:`study.solve` takes them, design (every cell is refined;
        cases that its study has solved are reused), or results folder (its stored series are
        judged).
    values, sizes : sequence of float
        Values and mesh sizes, where no source is given.
    formal_order : float, optional
        Order that the elements promise; that of the problem by default.
    tolerance : float
        Algebraic error of a value, in its unit; that of the solver by default.
    overrides : sequence of str
        ``key=value`` each, laid over the file before it is validated.
    data : str or Path, optional
        Folder of the measurements.
    jobs : int, optional
        Workers for the cells of a design.
    memory_MB : float, optional
        Memory that one solution may take; most of what is free by default.
    results : Path
        Where solutions are kept.
    reports : Path, optional
        Where a page with figures goes; the document names it as ``report``.
    progress : callable, optional
        Called with a sentence before every round of solutions.

    Returns
    -------
    ConvergenceResult
        Of plain numbers. A problem gives a dictionary with the same keys and more, a design
        ``{"cells": [...]}``; both with ``to_frame()``, ``plot()``, and a table in a notebook.

    Raises
    ------
    InputError
        If there is nothing to judge.
    """
    say = progress or (lambda _: None)
    results, reports = Path(results), None if reports is None else Path(reports)
    if source is None:
        if not len(values) or not len(sizes):
            mend = "give a file, or --values and --sizes"
            raise InputError(Fault("converge", "needs something to judge", mend))
        return grid_convergence(sizes, values, formal_order=formal_order, tolerance=tolerance)
    if len(values) or len(sizes):
        raise InputError(Fault("converge", "takes a file or numbers, not both"))
    if not isinstance(source, Mapping) and not Path(source).is_file():
        return SeriesDocument(stored(source, results))
    if isinstance(source, Mapping) or file_kind(source) != "design":
        name = "problem" if isinstance(source, Mapping) else Path(source).stem
        loaded = loaded_problem(source, overrides)
        return refined(
            loaded, name, formal_order, tolerance, results=results, reports=reports,
            progress=say, memory_MB=memory_MB,
        )  # fmt: skip
    design = load(source, overrides)
    if design.is_alone:  # its series are those of its run, which alone may start a program
        return SeriesDocument(stored(source, results))
    workers = jobs or default_jobs()
    if design.measurements is None:
        return problem_cells(design, workers, results, say, reports=reports, memory_MB=memory_MB)
    if memory_MB is not None:
        rule = "is not taken where a design has measurements: its cases run as a study's do"
        raise InputError(Fault("--memory", rule, "leave it out, or use fewer --jobs"))
    return measured_cells(design, design_root(design, data), workers, results, say, reports=reports)


def stored(source: str | Path, results: Path = RESULTS) -> dict[str, object]:
    """Judge the series that a finished study keeps."""
    study = load_study(source, results)
    cells = stored_convergence(study.numerical)
    if not cells:
        rule = "no refinement is stored of this study"
        mend = (
            'name what refines a program of your own: [converge] key = "parameters.h"; '
            "run it without --no-refine; between frictionless plates the deformation is the same "
            "everywhere and no mesh matters: `study converge DESIGN` shows that"
        )
        raise InputError(Fault(str(source), rule, mend))
    return {"cells": cells}


def refined(
    loaded: LoadedProblem,
    name: str,
    formal_order: float | None = None,
    tolerance: float = 0.0,
    *,
    results: Path = RESULTS,
    reports: Path | None = None,
    progress: Progress = lambda _: None,
    memory_MB: float | None = None,  # noqa: N803
    solve: Solver | None = None,
) -> SeriesDocument:
    """Refine one problem until its meshes are enough, and study the other errors besides."""
    spec, cell = loaded.converge, loaded.problem
    formal = promised(cell.at())
    if formal_order is not None:
        formal = FormalOrder(formal_order, "as given")
    solver = solve or kept(in_process, store_of(results, name))
    budget = Budget(spec.budget_s, memory_MB)
    _, judged = _judged([cell], spec, [formal], [{}], budget, solver, progress, tolerance or None)
    return SeriesDocument(judged[0].to_json()).paged(name, "", reports, judged, [cell])
