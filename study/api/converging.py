"""``study converge DESIGN``: every cell refined, reusing what its study has solved."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from study.api.folders import RESULTS, data_root, design_root, problem_tables
from study.api.opened_study import open_study
from study.api.uncertainty import uncertainties
from study.ground.arrays import Array
from study.ground.canonical import digest
from study.ground.errors import Fault, InputError
from study.harness.design.cell import case_id
from study.harness.design.load import file_kind, load
from study.harness.design.study_file import Converge
from study.harness.execution.task import Executor
from study.harness.record.folder import own_folder
from study.harness.record.record import Record
from study.harness.record.store import Store
from study.harness.runner import provenance, refinement, study_refinement
from study.harness.runner.batch import Progress as RunProgress
from study.harness.runner.batch import computing
from study.harness.runner.case_series import CaseSeries, stored_convergence
from study.harness.runner.cost import Costs
from study.harness.runner.expansion import expand
from study.harness.runner.job import CaseJob, fits_of
from study.harness.runner.judgement import SeriesJudgement, judge, series_of, with_sources
from study.harness.runner.refinement import (
    QUANTITIES,
    Budget,
    FormalOrder,
    RefinementSeries,
    formal_order,
    refine,
    solving,
)
from study.harness.runner.refinement import formal_order as promised
from study.harness.runner.solve_task import SolveTask, by_workers, in_process, kept, slug, store_of
from study.harness.runner.tasks import default_jobs
from study.mechanics.forward.closed_form import height_and_area
from study.mechanics.setup.setup import Setup, Tables, problem_of
from study.reporting.figures.axes import shown
from study.reporting.figures.convergence_figures import draw_values, value_points
from study.reporting.output.convergence_page import write_convergence
from study.reporting.output.notebook import Shown
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
    from study.reporting.figures.axes import Drawing
    from study.reporting.figures.convergence_figures import Document
    from study.statistics.convergence.grid_convergence import ConvergenceResult


# What ``study converge`` found of a problem, or of the cells of a design.


@dataclass(frozen=True)
class FrontPoint:
    """Error and cost of one mesh of one cell; the error is a share of the reference."""

    cell: str
    mesh_size: float
    unknowns: int
    seconds: float
    memory_MB: float  # noqa: N815
    value: float
    error: float


@dataclass(frozen=True)
class RankedCell:
    """Seconds and mesh size with which a cell reaches the accuracy; None where it does not."""

    cell: str
    seconds: float | None
    mesh_size: float | None
    how: str


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
    ranking: tuple[RankedCell, ...]
    answer: str


@dataclass(frozen=True)
class ProblemConvergence:
    """Series of one problem, and its page where one was asked for."""

    judgement: SeriesJudgement
    report: Path | None = None

    @property
    def cells(self) -> tuple[SeriesJudgement, ...]:
        """The one series."""
        return (self.judgement,)

    def to_json(self) -> dict[str, object]:
        """Document of ``study converge PROBLEM --json``."""
        return self.judgement.to_json() | _page(self.report)


@dataclass(frozen=True)
class DesignConvergence:
    """Series of the cells of a design."""

    cells: tuple[SeriesJudgement, ...]
    #: What an accuracy costs, for cells without measurements.
    fronts: tuple[CostFront, ...] | None = None
    #: Cells of a study that the time budget did not allow.
    left_out: tuple[CaseJob, ...] | None = None
    report: Path | None = None

    def to_json(self) -> dict[str, object]:
        """Document of ``study converge DESIGN --json``."""
        document: dict[str, object] = {"cells": [cell.to_json() for cell in self.cells]}
        if self.fronts is not None:
            document["fronts"] = [asdict(front) for front in self.fronts]
        if self.left_out is not None:
            document["left_out"] = [
                {"levels": dict(job.case.levels), "verdict": "left out: the time budget"}
                for job in self.left_out
            ]
        return document | _page(self.report)


def _page(report: Path | None) -> dict[str, object]:
    return {} if report is None else {"report": str(report)}


# The page of a convergence study, with pictures of its meshes.

#: cells whose coarsest and finest mesh are shown
SHOWN = 4

#: plane elements by their number of vertices
_SHAPES = {3: "triangles", 4: "quadrilaterals"}


def write_page(
    name: str,
    question: str,
    convergence: ProblemConvergence | DesignConvergence,
    tables: Sequence[Tables],
    reports: Path,
) -> Path:
    """Write the page of what was found; a picture that cannot be made costs nothing else."""
    pictures, window = meshes(convergence.cells, tables)
    folder = reports / slug(name)
    return write_convergence(name, question, convergence.to_json(), folder, pictures, window)


def meshes(
    cells: Sequence[SeriesJudgement], tables: Sequence[Tables]
) -> tuple[list[tuple[str, Array, NDArray[np.int64]]], Array | None]:
    """Coarsest and finest plane mesh of cells with different meshes, and the window to see.

    Shapes: returns (n, 2), mm; returns (2, 2).
    """
    drawn: dict[str, tuple[str, Array, NDArray[np.int64]]] = {}
    window = None
    for cell, its_tables in zip(cells, tables, strict=True):
        sizes = [level.mesh_size_mm for level in cell.meshes if level.result.converged]
        if Setup.of(its_tables).model.space == "3d" or not sizes or len(drawn) >= 2 * SHOWN:
            continue
        for size in (sizes[-1], sizes[0]):
            key, picture = _picture(its_tables, size)
            drawn.setdefault(key, picture)
        window = near(its_tables) if window is None else window
    return list(drawn.values()), window


def _picture(tables: Tables, size: float) -> tuple[str, tuple[str, Array, NDArray[np.int64]]]:
    from study.mechanics.mesh.mesher import build_mesh

    mesh = build_mesh(problem_of(SolveTask.of(tables, size).tables).setup)
    label = f"{_SHAPES[mesh.cells.shape[1]]}, {size:.3g} mm, {len(mesh.cells)} elements"
    return mesh.digest(), (label, np.asarray(mesh.points), np.asarray(mesh.cells))


def near(tables: Tables) -> Array:
    """Corner of the section that matters: under an indenter, or where plate and side meet.

    Shapes: returns (2, 2), mm.
    """
    made = problem_of(tables)
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
        ongoing = [
            ongoing[i] for i, sum_so_far in zip(order, spent, strict=True) if sum_so_far <= left
        ]
        steps = [case_series.jobs[level] for case_series in ongoing]
        for refined, step, answer in zip(
            ongoing, steps, compute(steps) if steps else (), strict=True
        ):
            refined.add(step, answer)
    return ongoing


def _price(case_series: CaseSeries, level: int, predicted: Mapping[str, float]) -> float:
    """Worker seconds of a cell's next mesh, its calibrations too."""
    names = [job.case.case_id for job in case_series.jobs]
    last = case_series.records.get(names[level - 1]) if level else None
    taken = None if last is None else last.timings.get("total")
    if taken is None:
        return predicted[names[level]]
    return taken * predicted[names[level]] / predicted[names[level - 1]]


CellProgress = Callable[[str], None]

#: relative error of a force where the design asks for no accuracy
USUAL_ACCURACY = 0.01


def design_series(
    source: str | Path,
    overrides: Sequence[str],
    data: Path,
    *,
    jobs: int | None,
    results: Path,
    progress: CellProgress,
    reports: Path | None = None,
    memory_MB: float | None = None,  # noqa: N803
) -> DesignConvergence:
    """Refine every cell of a design: whole cases where it has measurements, else problems."""
    design = load(source, overrides)
    workers = jobs or default_jobs()
    if design.measurements is None:
        return problem_cells(
            design, workers, results, progress, reports=reports, memory_MB=memory_MB
        )
    if memory_MB is not None:
        rule = "is not taken where a design has measurements: its cases run as a study's do"
        raise InputError(Fault("--memory", rule, "leave it out, or use fewer --jobs"))
    return measured_cells(design, data, workers, results, progress, reports=reports)


def problem_cells(
    design: Design,
    jobs: int,
    results: Path,
    progress: CellProgress,
    *,
    reports: Path | None = None,
    memory_MB: float | None = None,  # noqa: N803
    solve: Solver | None = None,
) -> DesignConvergence:
    """Judge every cell of a design without measurements, and what each accuracy costs."""
    spec = design.converge
    refinement.quantity(spec.qoi)
    places = provenance.folders(design.source, data_root(design.source))
    budget = Budget(spec.budget_s, memory_MB)
    tables = [provenance.located(t.config, places) for t in design.treatments]
    formal = [formal_order(problem_of(cell_tables)) for cell_tables in tables]
    cells = [
        series_of(cell, spec, order, budget, dict(treatment.levels))
        for cell, order, treatment in zip(tables, formal, design.treatments, strict=True)
    ]
    solver = solve or kept(by_workers(jobs), store_of(results, design.name))
    refine(cells, solving(solver, progress))
    judged = [judge(cell, order) for cell, order in zip(cells, formal, strict=True)]
    progress("load steps and solver tolerance")
    judged = [
        with_sources(judgement, cell, solver) if judgement.quantities else judgement
        for judgement, cell in zip(judged, cells, strict=True)
    ]
    fronts = cost_fronts(cells, judged, spec.tolerance or USUAL_ACCURACY)
    convergence = DesignConvergence(tuple(judged), tuple(fronts))
    return _with_page(convergence, design, tables, reports)


def _with_page(
    convergence: DesignConvergence, design: Design, tables: Sequence[Tables], reports: Path | None
) -> DesignConvergence:
    if reports is None:
        return convergence
    page = write_page(design.name, design.question, convergence, tables, reports)
    return replace(convergence, report=page)


def cost_fronts(
    cells: Sequence[RefinementSeries], judged: Sequence[SeriesJudgement], accuracy: float
) -> list[CostFront]:
    """Error against seconds of every mesh, and which cell reaches the accuracy first."""
    groups: dict[str, list[int]] = {}
    for k, cell in enumerate(cells):
        groups.setdefault(
            case_id({k: cell.tables.get(k) for k in ("specimen", "test", "material")}), []
        ).append(k)
    fronts = [
        _front([(_label(cells[k], k), cells[k], judged[k]) for k in members], accuracy)
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
    ranked = cost_to_accuracy(
        {
            name: [CostPoint(p.mesh_size, p.error, p.seconds) for p in row]
            for name, row in points.items()
        },
        accuracy,
    )
    return CostFront(
        value,
        u,
        accuracy,
        tuple(point for row in points.values() for point in row),
        tuple(RankedCell(r.name, r.seconds, r.mesh_size, r.how) for r in ranked),
        _answer(ranked, accuracy, u, value),
    )


def _label(series: RefinementSeries, number: int) -> str:
    return " / ".join(series.levels_of.values()) or f"cell {number + 1}"


def _points(
    name: str, series: RefinementSeries, judgement: SeriesJudgement, reference: float
) -> list[FrontPoint]:
    function = QUANTITIES[judgement.main.qoi][0]
    return [
        FrontPoint(
            name, level.mesh_size_mm, level.result.dofs, level.result.seconds,
            level.result.memory_MB, value, abs(value - reference) / abs(reference),
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
        f"{best.name} gives {100 * accuracy:g} % error for the least time: {best.seconds:.2g} s "
        f"at a mesh size of {best.mesh_size:.2g} mm"
    )
    if best.how == "extrapolated":
        text += ", extrapolated beyond its finest mesh"
    if best.how == "coarsest mesh":
        text += ", its coarsest mesh"
    if len(reached) > 1:
        text += f"; next {reached[1].name} with {reached[1].seconds:.2g} s"
    if u is not None and u > accuracy * abs(value) / 3:
        text += f"; the reference itself is only known to {100 * u / abs(value):.2g} %"
    return text


def measured_cells(
    design: Design,
    data: Path,
    jobs: int,
    results: Path,
    progress: CellProgress,
    *,
    reports: Path | None = None,
    executor: Executor | None = None,
) -> DesignConvergence:
    """Refine every cell of a study in its first block: its calibration, its score, its curve."""
    whole = expand(design, data)
    work = whole.plain()
    store, seconds = Store(own_folder(results, design.name)), design.converge.budget_s
    every = study_refinement.every_series(work, study_refinement.every_cell(work), {})
    finer = sum(len(case_series.jobs) - 1 for case_series in every)
    limit = "" if seconds is None else f", as many as {seconds:g} s allow"
    progress(f"{len(every)} cells, {finer} refined cases besides{limit}")
    compute = computing(work, store, jobs=jobs, executor=executor, progress=_said(progress))
    if seconds is None:
        refine(every, compute)
    else:
        refine_within(seconds, jobs, every, compute)
    series = [case_series for case_series in every if len(case_series.records) > 1]
    rows = [asdict(row) for row in uncertainties(work, series)]
    with store.lock():
        store.write_json("numerical-cells", {"of": digest(whole.input_hashes), "rows": rows})
    judged = [case_series.judge(design.converge, work.responses) for case_series in series]
    convergence = DesignConvergence(
        tuple(judged),
        left_out=tuple(case_series.base for case_series in every if case_series not in series),
    )
    return _with_page(
        convergence, design, [case_series.base.case.config for case_series in series], reports
    )


def _said(progress: CellProgress) -> Callable[[RunProgress], None]:
    return lambda state: progress(f"{state.done}/{state.total}: {state.label}")


# Refinement series as a notebook shows them: a frame, a table in HTML, a figure.


class SeriesDocument(Shown, dict[str, object]):
    """Document of ``study converge``, a dictionary that can be shown."""

    digits: ClassVar[int] = 6

    @property
    def _cells(self) -> Sequence[Document]:
        return cast("Sequence[Document]", self.get("cells", [self]))

    def to_frame(self) -> pd.DataFrame:
        """Return the meshes of all series, one row each."""
        return value_points(self._cells)

    def plot(self) -> Drawing:
        """Draw value against mesh size, a panel a series, with the limit at zero."""
        frame = self.to_frame()
        return shown(lambda: draw_values(frame), "convergence", "value against mesh size")

    def tables(self) -> Sequence[pd.DataFrame]:
        """Meshes and values."""
        names = ["cell", "mesh_size", "value", "unit", "observed_order", "extrapolated", "u_num"]
        return (self.to_frame()[names],)


# ``study converge``: of plain numbers, of a problem, or of every cell of a design.

Progress = Callable[[str], None]


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
        convergence = problem(
            source, overrides, formal_order, tolerance, results=results, reports=reports,
            progress=say, memory_MB=memory_MB,
        )  # fmt: skip
        return SeriesDocument(convergence.to_json())

    design = load(source, overrides)
    if design.is_alone:  # its series are those of its run, which alone may start a program
        return SeriesDocument(stored(source, results))
    root = design_root(design, data)
    every = design_series(
        source, overrides, root, jobs=jobs, results=results, reports=reports,
        progress=say, memory_MB=memory_MB,
    )  # fmt: skip
    return SeriesDocument(every.to_json())


def stored(source: str | Path, results: Path = RESULTS) -> dict[str, object]:
    """Judge the series that a finished study keeps."""
    study = open_study(source, results)
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


def problem(
    source: str | Path | Tables,
    overrides: Sequence[str] = (),
    formal_order: float | None = None,
    tolerance: float = 0.0,
    *,
    results: Path = RESULTS,
    reports: Path | None = None,
    progress: Progress = lambda _: None,
    memory_MB: float | None = None,  # noqa: N803
    solve: Solver | None = None,
) -> ProblemConvergence:
    """Refine one problem until its meshes are enough, and study the other errors beside."""
    tables = problem_tables(source, overrides)
    name = "problem" if isinstance(source, Mapping) else Path(source).stem
    spec = tables.get("converge")
    spec = spec if isinstance(spec, Converge) else Converge()  # tables of the program have none
    refinement.quantity(spec.qoi)
    formal = promised(problem_of(tables))
    if formal_order is not None:
        formal = FormalOrder(formal_order, "as given")
    solver = solve or kept(in_process, store_of(results, name))
    series = series_of(tables, spec, formal, Budget(spec.budget_s, memory_MB))
    refine([series], solving(solver, progress))
    judgement = judge(series, formal, tolerance or None)
    if judgement.quantities:
        progress("load steps and solver tolerance")
        judgement = with_sources(judgement, series, solver)
    made = ProblemConvergence(judgement)
    if reports is None:
        return made
    return replace(made, report=write_page(name, "", made, [tables], reports))
