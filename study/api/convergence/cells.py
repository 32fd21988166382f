"""``study converge DESIGN``: every cell refined, reusing what its study has solved."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from study.analysis.convergence.work_precision import CostPoint, cost_to_accuracy, reference_value
from study.api.convergence.page import write_page
from study.api.folders import data_root
from study.canonical import digest
from study.design.cases import case_id, treatments
from study.design.load import load
from study.execution.task import Executor
from study.record.store import Store
from study.runner import provenance
from study.runner.batch import default_jobs, run_batch
from study.runner.cost import Costs
from study.runner.expansion import expand
from study.runner.numerical import curve_quantities, judgement, study_refinement
from study.runner.numerical.curve_quantities import QUANTITIES
from study.runner.numerical.formal_order import formal_order
from study.runner.numerical.input_uncertainty import with_sources
from study.runner.numerical.judgement import documents
from study.runner.numerical.refinement import budget_of, refine, series_of
from study.runner.numerical.refinement_store import kept_by_workers, store_of
from study.setup.setup import problem_of

if TYPE_CHECKING:
    from study.design.spec import Design
    from study.runner.job import CaseJob, Work
    from study.runner.numerical.refinement import Series, Solver

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
) -> dict[str, Any]:
    """Refine every cell of a design: whole cases where it has measurements, else problems."""
    design = load(source, overrides)
    workers = jobs or default_jobs()
    if design.measurements is None:
        return problem_cells(
            design, workers, results, progress, reports=reports, memory_MB=memory_MB
        )
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
) -> dict[str, Any]:
    """Series of every cell of a design without measurements, and what each accuracy costs."""
    spec = design.converge
    curve_quantities.quantity(spec.qoi)
    places = provenance.folders(design.source, data_root(design.source))
    cells = [
        series_of(provenance.located(t.config, places), spec, levels_of=dict(t.levels))
        for t in treatments(design)
    ]
    formal = {id(one): formal_order(problem_of(one.config)) for one in cells}
    solver = solve or kept_by_workers(jobs, store_of(results, design.name))
    budget = budget_of(spec.budget_s, memory_MB)
    refine(
        cells,
        solver,
        budget,
        lambda one: judgement.outlook(one, formal[id(one)].order),
        progress,
    )
    documents = [judgement.document(one, formal[id(one)]) for one in cells]
    progress("load steps and solver tolerance")
    documents = [
        with_sources(made, one, solver) if made["quantities"] else made
        for made, one in zip(documents, cells, strict=True)
    ]
    found = {"cells": documents}
    found |= cost_front(cells, documents, spec.tolerance or USUAL_ACCURACY)
    return _with_page(found, design, [one.config for one in cells], reports)


def _with_page(
    found: dict[str, Any],
    design: Design,
    configs: Sequence[Mapping[str, Any]],
    reports: Path | None,
) -> dict[str, Any]:
    if reports is None:
        return found

    page = write_page(design.name, design.question, found, configs, reports)
    return found | {"report": str(page)}


def cost_front(
    cells: Sequence[Series], documents: Sequence[Mapping[str, Any]], accuracy: float
) -> dict[str, Any]:
    """Error against seconds of every mesh, and which cell reaches the accuracy first.

    The reference is the limit with the smallest uncertainty among the cells that differ in
    nothing but their discretization.
    """
    groups: dict[str, list[int]] = {}
    for k, one in enumerate(cells):
        groups.setdefault(_physics(one.config), []).append(k)
    fronts = []
    for members in groups.values():
        value, u = reference_value(
            [(documents[k]["extrapolated"], documents[k]["u_num"]) for k in members]
        )
        if not value:
            continue
        points = {_label(cells[k], k): _points(cells[k], documents[k], value) for k in members}
        ranked = cost_to_accuracy(
            {name: [CostPoint(p["mesh_size"], p["error"], p["seconds"]) for p in row]
             for name, row in points.items()},
            accuracy,
        )  # fmt: skip
        fronts.append(
            {
                "reference": value,
                "reference_u": u,
                "accuracy": accuracy,
                "points": [{"cell": name, **p} for name, row in points.items() for p in row],
                "ranking": [
                    {"cell": r.name, "seconds": r.seconds, "mesh_size": r.mesh_size, "how": r.how}
                    for r in ranked
                ],
                "answer": _answer(ranked, accuracy, u, value),
            }
        )
    return {"fronts": fronts}


def _physics(config: Mapping[str, Any]) -> str:
    return case_id({k: config.get(k) for k in ("specimen", "test", "material")})


def _label(one: Series, number: int) -> str:
    return " / ".join(one.levels_of.values()) or f"cell {number + 1}"


def _points(one: Series, made: Mapping[str, Any], reference: float) -> list[dict[str, Any]]:
    function = QUANTITIES[made["qoi"]][0]
    return [
        {
            "mesh_size": level.mesh_size_mm,
            "unknowns": level.dofs,
            "seconds": level.seconds,
            "memory_MB": level.memory_MB,
            "value": function(level.curve),
            "error": abs(function(level.curve) - reference) / abs(reference),
        }
        for level in one.good
    ]


def _answer(ranked: Sequence[Any], accuracy: float, u: float | None, value: float) -> str:
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
) -> dict[str, Any]:
    """Refine every cell of a study in its first block: its calibration, its score, its curve."""
    from dataclasses import asdict, replace

    whole = expand(design, data)
    work = whole.plain()
    bases, left_out = affordable(work, study_refinement.every_cell(work), jobs)
    store = Store(results / design.name)
    finer = study_refinement.refinement_work(work, bases)
    progress(f"{len(bases)} cells, {len(finer.jobs)} refined cases besides")
    for part in (replace(work, jobs=tuple(bases)), finer):
        if part.jobs:
            run_batch(part, store, jobs=jobs, executor=executor, progress=_said(progress))
    hashes = {**work.input_hashes, **finer.input_hashes}
    records = store.by_case(hashes)
    names = [response.name for response in design.responses]
    rows = study_refinement.numerical(work, finer, records, names, bases) if bases else []
    stored = {"of": digest(whole.input_hashes), "rows": [asdict(row) for row in rows]}
    with store.lock():
        store.write_json("numerical-cells", stored)
    found = documents(work, bases, finer, records)
    skipped = [
        {"levels": dict(job.case.levels), "verdict": "left out: the time budget"}
        for job in left_out
    ]
    made = {"cells": found, "left_out": skipped}
    return _with_page(made, design, [base.case.config for base in bases], reports)


def _said(progress: Progress) -> Callable[[Any], None]:
    return lambda state: progress(f"{state.done}/{state.total}: {state.label}")


def affordable(
    work: Work, bases: Sequence[CaseJob], jobs: int
) -> tuple[list[CaseJob], list[CaseJob]]:
    """Cells whose refinement fits into the time budget, cheapest first, and the others."""
    seconds = work.design.converge.budget_s
    if seconds is None:
        return list(bases), []
    costs, left = Costs(), seconds * jobs
    price = {}
    for base in bases:
        finer = study_refinement.refinement_work(work, [base])
        price[base.case.case_id] = costs.total_seconds(finer.fits.values(), finer.jobs, 1)
    kept = []
    for base in sorted(bases, key=lambda job: price[job.case.case_id]):
        left -= price[base.case.case_id]
        if left < 0:
            break
        kept.append(base.case.case_id)
    return (
        [b for b in bases if b.case.case_id in kept],
        [b for b in bases if b.case.case_id not in kept],
    )
