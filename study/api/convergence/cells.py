"""``study converge DESIGN``: every cell refined, reusing what its study has solved."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

from study.analysis.convergence.work_precision import (
    CostPoint,
    CostToAccuracy,
    cost_to_accuracy,
    reference_value,
)
from study.api.convergence.page import write_page
from study.api.convergence.result import CostFront, DesignConvergence, FrontPoint, RankedCell
from study.api.convergence.time_budget import refine_within
from study.api.folders import data_root
from study.api.uncertainty.credibility import uncertainties
from study.canonical import digest
from study.design.load import load
from study.design.sections.content import case_id
from study.errors import Fault, InputError
from study.execution.task import Executor
from study.record.folder import own_folder
from study.record.store import Store
from study.runner import provenance
from study.runner.batch import Progress as RunProgress
from study.runner.batch import computing
from study.runner.expansion import expand
from study.runner.numerical import curve_quantities, study_refinement
from study.runner.numerical.curve_quantities import QUANTITIES
from study.runner.numerical.formal_order import formal_order
from study.runner.numerical.judgement import SeriesJudgement, judge, series_of, with_sources
from study.runner.numerical.refinement import Series, budget_of, refine, solving
from study.runner.numerical.solver import by_workers, kept, store_of
from study.runner.tasks import default_jobs
from study.setup.setup import Tables, problem_of

if TYPE_CHECKING:
    from study.design.spec import Design
    from study.runner.numerical.solve_task import Solver

Progress = Callable[[str], None]

#: relative error of a force where the design asks for no accuracy
USUAL_ACCURACY = 0.01


def design_series(
    source: str | Path,
    overrides: Sequence[str],
    data: Path,
    *,
    jobs: int | None,
    results: Path,
    progress: Progress,
    reports: Path | None = None,
    memory_MB: float | None = None,  # noqa: N803
) -> DesignConvergence:
    """Refine every cell of a design: whole cases where it has measurements, else problems.

    Parameters
    ----------
    source : str or Path
        Design file.
    overrides : sequence of str
        ``key=value`` each, laid over the file before it is validated.
    data : Path
        Folder of the measurements.
    jobs : int or None
        Worker processes; None for one a core.
    results : Path
        Where solutions and records are kept, in a folder of the study's name.
    progress : callable
        Called with a sentence before every round of solutions, or after every case.
    reports : Path, optional
        Where a page with figures goes; None writes none.
    memory_MB : float, optional
        Memory that one solution may take; by default 70 % of what is free.

    Raises
    ------
    InputError
        For a limit of memory where the design has measurements.
    """
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
    progress: Progress,
    *,
    reports: Path | None = None,
    memory_MB: float | None = None,  # noqa: N803
    solve: Solver | None = None,
) -> DesignConvergence:
    """Judge every cell of a design without measurements, and what each accuracy costs.

    Parameters
    ----------
    design : Design
        Its table ``converge`` says quantity, accuracy and time budget.
    jobs : int
        Worker processes.
    results : Path
        Where solutions are kept, in a folder of the study's name.
    progress : callable
        Called with a sentence before every round of solutions.
    reports : Path, optional
        Where a page with figures goes; None writes none.
    memory_MB : float, optional
        Memory that one solution may take; by default 70 % of what is free.
    solve : callable, optional
        Solves tasks instead of ``jobs`` processes of this machine; nothing is then kept.
    """
    spec = design.converge
    curve_quantities.quantity(spec.qoi)
    places = provenance.folders(design.source, data_root(design.source))
    budget = budget_of(spec.budget_s, memory_MB)
    tables = [provenance.located(t.config, places) for t in design.treatments]
    formal = [formal_order(problem_of(one)) for one in tables]
    cells = [
        series_of(one, spec, order, budget, dict(treatment.levels))
        for one, order, treatment in zip(tables, formal, design.treatments, strict=True)
    ]
    solver = solve or kept(by_workers(jobs), store_of(results, design.name))
    refine(cells, solving(solver, progress))
    judged = [judge(one, order) for one, order in zip(cells, formal, strict=True)]
    progress("load steps and solver tolerance")
    judged = [
        with_sources(found, one, solver) if found.quantities else found
        for found, one in zip(judged, cells, strict=True)
    ]
    fronts = cost_fronts(cells, judged, spec.tolerance or USUAL_ACCURACY)
    found = DesignConvergence(tuple(judged), tuple(fronts))
    return _with_page(found, design, tables, reports)


def _with_page(
    found: DesignConvergence, design: Design, tables: Sequence[Tables], reports: Path | None
) -> DesignConvergence:
    if reports is None:
        return found
    page = write_page(design.name, design.question, found, tables, reports)
    return replace(found, report=page)


def cost_fronts(
    cells: Sequence[Series], judged: Sequence[SeriesJudgement], accuracy: float
) -> list[CostFront]:
    """Error against seconds of every mesh, and which cell reaches the accuracy first.

    Parameters
    ----------
    cells : sequence of Series
        Refined cells.
    judged : sequence of SeriesJudgement
        What is said of each.
    accuracy : float
        Wanted relative error.
    """
    groups: dict[str, list[int]] = {}
    for k, one in enumerate(cells):
        groups.setdefault(_physics(one.tables), []).append(k)
    fronts = [
        _front([(_label(cells[k], k), cells[k], judged[k]) for k in members], accuracy)
        for members in groups.values()
    ]
    return [front for front in fronts if front is not None]


def _front(
    members: Sequence[tuple[str, Series, SeriesJudgement]], accuracy: float
) -> CostFront | None:
    value, u = reference_value(
        [(found.main.extrapolated, found.main.u_num) for *_, found in members]
    )
    if not value:
        return None
    points = {name: _points(name, one, found, value) for name, one, found in members}
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


def _physics(tables: Tables) -> str:
    return case_id({k: tables.get(k) for k in ("specimen", "test", "material")})


def _label(one: Series, number: int) -> str:
    return " / ".join(one.levels_of.values()) or f"cell {number + 1}"


def _points(name: str, one: Series, found: SeriesJudgement, reference: float) -> list[FrontPoint]:
    function = QUANTITIES[found.main.qoi][0]
    return [
        FrontPoint(
            name, level.mesh_size_mm, level.result.dofs, level.result.seconds,
            level.result.memory_MB, value, abs(value - reference) / abs(reference),
        )
        for level in one.good
        for value in (function(level.curve),)
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
    progress: Progress,
    *,
    reports: Path | None = None,
    executor: Executor | None = None,
) -> DesignConvergence:
    """Refine every cell of a study in its first block: its calibration, its score, its curve.

    Parameters
    ----------
    design : Design
        With measurements.
    data : Path
        Folder of the measurements.
    jobs : int
        Worker processes.
    results : Path
        Where records are kept, in a folder of the study's name; what it holds is computed no more.
    progress : callable
        Called with a sentence once before, and after every computation.
    reports : Path, optional
        Where a page with figures goes; None writes none.
    executor : Executor, optional
        Where cases are computed; by default ``jobs`` processes of this machine.

    Returns
    -------
    DesignConvergence
        ``left_out`` holds the cells for which the time budget of the design was too short.
    """
    whole = expand(design, data)
    work = whole.plain()
    store, seconds = Store(own_folder(results, design.name)), design.converge.budget_s
    every = study_refinement.every_series(work, study_refinement.every_cell(work), {})
    finer = sum(len(one.jobs) - 1 for one in every)
    limit = "" if seconds is None else f", as many as {seconds:g} s allow"
    progress(f"{len(every)} cells, {finer} refined cases besides{limit}")
    compute = computing(work, store, jobs=jobs, executor=executor, progress=_said(progress))
    if seconds is None:
        refine(every, compute)
    else:
        refine_within(seconds, jobs, every, compute)
    series = [one for one in every if len(one.records) > 1]
    rows = [asdict(row) for row in uncertainties(work, series)]
    with store.lock():
        store.write_json("numerical-cells", {"of": digest(whole.input_hashes), "rows": rows})
    judged = [one.judge(design.converge, work.responses) for one in series]
    found = DesignConvergence(
        tuple(judged), left_out=tuple(one.base for one in every if one not in series)
    )
    return _with_page(found, design, [one.base.case.config for one in series], reports)


def _said(progress: Progress) -> Callable[[RunProgress], None]:
    return lambda state: progress(f"{state.done}/{state.total}: {state.label}")
