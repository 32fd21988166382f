"""``study converge``: of plain numbers, of a problem, or of every cell of a design."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from study.analysis.convergence.grid_convergence import grid_convergence
from study.api.convergence.cells import design_series
from study.api.convergence.notebook import SeriesDocument
from study.api.convergence.page import write_page
from study.api.convergence.result import ProblemConvergence
from study.api.folders import RESULTS, design_root, problem_tables
from study.api.opened_study import open_study
from study.design.load import file_kind, load
from study.design.study_file import Converge
from study.errors import Fault, InputError
from study.runner.numerical import curve_quantities
from study.runner.numerical.case_series import stored_convergence
from study.runner.numerical.formal_order import FormalOrder
from study.runner.numerical.formal_order import formal_order as promised
from study.runner.numerical.judgement import judge, series_of, with_sources
from study.runner.numerical.refinement import budget_of, refine, solving
from study.runner.numerical.solver import in_process, kept, store_of
from study.setup.setup import Tables, problem_of

if TYPE_CHECKING:
    from study.analysis.convergence.grid_convergence import ConvergenceResult
    from study.runner.numerical.solve_task import Solver

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
        one = problem(
            source, overrides, formal_order, tolerance, results=results, reports=reports,
            progress=say, memory_MB=memory_MB,
        )  # fmt: skip
        return SeriesDocument(one.to_json())

    root = design_root(load(source, overrides), data)
    every = design_series(
        source, overrides, root, jobs=jobs, results=results, reports=reports,
        progress=say, memory_MB=memory_MB,
    )  # fmt: skip
    return SeriesDocument(every.to_json())


def stored(source: str | Path, results: Path = RESULTS) -> dict[str, object]:
    """Judge the series that a finished study keeps.

    Parameters
    ----------
    source : str or Path
        Results folder, design file or name of the study.
    results : Path
        Folder of all results, where ``source`` is a name or a design file.

    Returns
    -------
    dict
        ``cells``, one judged series for each cell and response: ``study converge --json``.

    Raises
    ------
    InputError
        If there are none.
    """
    study = open_study(source, results)
    found = stored_convergence(study.numerical)
    if not found:
        rule = "no refinement is stored of this study"
        mend = (
            "run it without --no-refine; between frictionless plates the deformation is the same "
            "everywhere and no mesh matters: `study converge DESIGN` shows that"
        )
        raise InputError(Fault(str(source), rule, mend))
    return {"cells": found}


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
    """Refine one problem until its meshes are enough, and study the other errors beside.

    Parameters
    ----------
    source : str, Path or mapping
        Problem file, or its tables as :func:`study.solve` takes them.
    overrides : sequence of str
        ``key=value`` each, laid over the file before it is validated.
    formal_order : float, optional
        Order that the elements promise; that of the problem by default.
    tolerance : float
        Algebraic error of the quantity, in its unit; 0 for that of the solver.
    results : Path
        Where solutions are kept, in a folder of the file's name (``problem`` for tables).
    reports : Path, optional
        Where a page with figures goes; None writes none.
    progress : callable
        Called with a sentence before every round of solutions.
    memory_MB : float, optional
        Memory that one solution may take; by default 70 % of what is free.
    solve : callable, optional
        Solves tasks instead of this process; nothing is then kept.
    """
    tables = problem_tables(source, overrides)
    name = "problem" if isinstance(source, Mapping) else Path(source).stem
    spec = tables.get("converge")
    spec = spec if isinstance(spec, Converge) else Converge()  # tables of the program have none
    curve_quantities.quantity(spec.qoi)
    formal = promised(problem_of(tables))
    if formal_order is not None:
        formal = FormalOrder(formal_order, "as given")
    solver = solve or kept(in_process, store_of(results, name))
    series = series_of(tables, spec, formal, budget_of(spec.budget_s, memory_MB))
    refine([series], solving(solver, progress))
    found = judge(series, formal, tolerance or None)
    if found.quantities:
        progress("load steps and solver tolerance")
        found = with_sources(found, series, solver)
    made = ProblemConvergence(found)
    if reports is None:
        return made
    return replace(made, report=write_page(name, "", made, [tables], reports))
