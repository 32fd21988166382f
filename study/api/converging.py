"""``study converge DESIGN``: every cell refined, reusing what its study has solved."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Self, cast

from study.api.opened_study import load as load_study
from study.execution.local import Executor
from study.external.forward_model import ForwardCell
from study.ground.canonical import digest, plain
from study.ground.errors import Fault, InputError
from study.ground.files import own_folder
from study.harness.design.load import RESULTS, design_root, file_kind, load, loaded_problem
from study.harness.runner import study_refinement
from study.harness.runner.batch import Progress as RunProgress
from study.harness.runner.batch import computed, expand
from study.harness.runner.study_refinement import refine_cases, refine_within, stored_convergence
from study.mechanics.forward.formal_order import FormalOrder
from study.mechanics.setup.setup import Tables
from study.record.store import Store
from study.reporting.figures.axes import shown
from study.reporting.output.convergence_page import series_blocks, write_convergence
from study.reporting.output.page import Shown
from study.simulation import refinement
from study.simulation.cell import folder_name, tested
from study.simulation.job import data_root, folders, located
from study.simulation.problem_file import LoadedProblem
from study.simulation.solve_task import Solver, by_workers, in_process, kept, store_of
from study.simulation.tasks import default_jobs, processes
from study.statistics.convergence.grid_convergence import ConvergenceResult, judged_numbers

if TYPE_CHECKING:
    import pandas as pd

    from study.harness.design.spec import Design
    from study.reporting.content.blocks import Block, Document
    from study.reporting.figures.axes import Drawing


# What ``study converge`` found of a problem, or of the cells of a design.


class SeriesDocument(Shown, dict[str, object]):
    """Document of ``study converge``, a dictionary that can be shown."""

    def to_frame(self) -> pd.DataFrame:
        """Return the meshes of all series, one row each."""
        from study.reporting.figures.convergence_figures import value_points

        return value_points(cast("Sequence[Document]", self.get("cells", [self])))

    def plot(self) -> Drawing:
        """Draw value against mesh size, a panel a series, with the limit at zero."""
        from study.reporting.figures.convergence_figures import MESH_SIZE, draw_values

        frame = self.to_frame()
        title = "value against mesh size"
        return shown(lambda: draw_values(MESH_SIZE, [], frame), "convergence", title)

    def blocks(self) -> Iterator[Block]:
        """Every series with its verdict, as ``study converge`` prints them."""
        return series_blocks(self)

    def paged(
        self,
        name: str,
        question: str,
        reports: Path | None,
        cells: Sequence[refinement.SeriesJudgement],
        problems: Sequence[ForwardCell],
    ) -> Self:
        """Write the page where a folder is given, and name it."""
        if reports is not None:
            pictures, window = refinement.meshes(cells, problems)
            folder = reports / folder_name(name, "problem")
            page = write_convergence(name, question, self, folder, pictures, window)
            self["report"] = str(page)
        return self


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
    places = folders(design.source, data_root(design.source))
    problems = [located(tested(t.cell.problem), places) for t in design.treatments]
    solver = solve or kept(by_workers(processes(jobs)), store_of(results, design.name))
    levels = (dict(treatment.levels) for treatment in design.treatments)
    cells, judged = refinement.refined_and_judged(
        list(zip(problems, levels, strict=True)), spec, solver, progress, memory_MB=memory_MB
    )
    fronts = refinement.cost_fronts(cells, judged, spec.tolerance or USUAL_ACCURACY)
    document = SeriesDocument(cells=[cell.to_json() for cell in judged], fronts=plain(fronts))
    return document.paged(design.name, design.question, reports, judged, problems)


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
    document = SeriesDocument(cells=[cell.to_json() for cell in judged], left_out=left_out)
    return document.paged(design.name, design.question, reports, judged, problems)


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
        return judged_numbers(sizes, values, formal_order, tolerance)
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
    if design.identification.measurements is None:
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
    _, judged = refinement.refined_and_judged(
        [(cell, {})], spec, solve or kept(in_process, store_of(results, name)), progress,
        memory_MB=memory_MB, tolerance=tolerance or None,
        formal=None if formal_order is None else FormalOrder(formal_order, "as given"),
    )  # fmt: skip
    return SeriesDocument(judged[0].to_json()).paged(name, "", reports, judged, [cell])
