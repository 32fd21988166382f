"""Cells that a run adds to its design, kept in the design that it stores, until it says enough."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from study.ground.arrays import Array
from study.ground.canonical import digest
from study.ground.declaration import table_of
from study.ground.errors import Fault, InputError, RefusedError, StudyError
from study.ground.files import ID
from study.harness.design.layouts import share_of
from study.harness.design.load import dump, loads
from study.harness.design.spec import Design, ResponseSpec, Sequential, levels_at
from study.harness.runner.batch import Progress, Work, expand, relabeled, run_batch
from study.harness.runner.record_analysis import (
    at_levels,
    coded_settings,
    labels_of,
    makers_of_runs,
    runs_of_records,
)
from study.harness.runner.study_refinement import COSTS
from study.record.record import AdaptiveStep, ConfirmedRow, Record, are_imported, is_same_run
from study.record.store import Store
from study.simulation.job import Allowed
from study.simulation.provenance import code_version
from study.simulation.tasks import processes
from study.statistics.surfaces.emulator import (
    REFERENCES,
    BlockedEmulator,
    Emulator,
    Unsure,
    candidates,
    fit_own,
    next_run,
)
from study.statistics.surfaces.quadratic import QuadraticSurface
from study.statistics.surfaces.surface_fitting import difference_of, models_at
from study.statistics.surfaces.surface_optimum import Model


def continued(design: Design, store: Store) -> Design:
    """Design with the cells that an earlier run of it has added."""
    manifest = store.read_unfinished() or store.read_manifest()
    if manifest is None or code_of(manifest) != code_version():
        return design
    try:
        design_then = loads(manifest["design"], manifest["source"])
    except InputError:
        return design
    same = dump(with_added(design_then, ())) == dump(with_added(design, ()))
    return with_added(design, added(design_then)) if same else design


def added(design: Design) -> list[list[float]]:
    """Cells that were added, as they stand in the design."""
    rule = design.scheme.sequential
    return [] if rule is None else [list(cell) for cell in rule.added]


def with_added(design: Design, cells: Sequence[Sequence[float]]) -> Design:
    """Copy of a design with other cells added to its Latin hypercube."""
    table = {k: v for k, v in table_of(design.config, "design").items() if k != "added"}
    shares = {"added": [list(cell) for cell in cells]} if cells else {}
    text = dump(replace(design, config={**design.config, "design": {**table, **shares}}))
    return replace(loads(text, design.source), text=design.text)


#: name of the list of what was known at every step
HISTORY = "adaptive"
#: exponent of the misfit where a verdict is sought, which the largest misfit decides
_SEARCHING = 2.0
#: emulators of the responses at one combination of the other levels, and names of open responses
_Fitted = tuple[dict[str, Emulator | BlockedEmulator], list[str]]


def run_adaptive(
    work: Work,
    store: Store,
    computed: int,
    compute: Callable[[Work], int],
    expanded: Callable[[Design], Work],
    note: Callable[[Work], None],
) -> tuple[Work, int]:
    """Compute the cells that are added to those of a design, until it says enough."""
    size = len(work.design.treatments)
    history_rows = store.read_rows(HISTORY, AdaptiveStep)
    history: list[object] = [row for row in history_rows if row["cells"] < size]
    while True:
        # digits of an emulator must not depend on the threads of the machine
        with threadpool_limits(1):
            records = relabeled(store.records(work.input_hashes), work.design, work.cases)
            chosen, step = next_cells(work.design, records)
        history.append(step)
        with store.lock():
            store.write_json(HISTORY, history)
        if not chosen:
            return work, computed
        work = expanded(with_added(work.design, [*added(work.design), *chosen]))
        note(work)
        computed += compute(work)


def next_cells(design: Design, records: Sequence[Record]) -> tuple[list[list[float]], AdaptiveStep]:
    """Choose the cells that make the emulators of a design surest."""
    rule = design.scheme.sequential
    if rule is None:
        raise ValueError("the design is not adaptive")
    # in the order of a report, whose digits depend on it
    ordered = sorted(records, key=lambda record: record.case_id)
    places, runs = labels_of(design), [r for r in ordered if not is_same_run(r.extra)]
    fitted: list[_Fitted] = [({}, []) for _ in places]
    step: AdaptiveStep = {"cells": len(design.treatments), "q2": {}, "open": [], "stopped": ""}
    ranges, lowest = tuple(design.ranges.values()), dict[str, float]()
    for response in design.responses:
        if response.name in COSTS:  # nobody learns what a run costs
            continue
        for labels, (emulators, still), (q2, is_good) in zip(
            places, fitted, _judged(design, rule, response, runs), strict=True
        ):
            if q2 is not None:
                lowest[response.name] = min(lowest.get(response.name, 1.0), q2)
            if not is_good:
                still.append(response.name)
                with suppress(StudyError):  # where none can be fitted runs are needed most
                    here = at_levels(runs, labels)
                    answered = [r for r in here if r.value(response.name) is not None]
                    emulators[response.name] = fit_own(
                        runs_of_records(response.name, answered, None, ranges)
                    )
    step["q2"] = {**lowest}
    step["open"] = list(dict.fromkeys(name for _, names in fitted for name in names))
    free = min(rule.batch, rule.budget - step["cells"])
    step["stopped"] = _end(rule, step, free, any(record.converged for record in records))
    return ([] if step["stopped"] else _chosen(design, rule, places, fitted, free)), step


def _end(rule: Sequential, step: AdaptiveStep, free: int, answered: bool) -> str:
    """Say why no cell is added; nothing where some are."""
    if not answered:
        return "no cell has an answer"
    if not step["open"]:
        goal = f"the Q2 of every response is at least {rule.q2:g}"
        return goal if rule.until == "q2" else "every factor has a verdict"
    return "" if free > 0 else f"the budget of {rule.budget} cells is spent"


def _judged(
    design: Design, rule: Sequential, response: ResponseSpec, records: Sequence[Record]
) -> Iterator[tuple[float | None, bool]]:
    """Q2 of the surface that the report shows at every combination of levels, if it is enough."""
    makers, _, _ = makers_of_runs(design, response.name, records)
    sizes = [len(labels) for labels in design.lists.values()]
    for runs, model in zip(*models_at(sizes, design.analysis.surface, makers), strict=True):
        values = np.zeros(0) if isinstance(runs, StudyError) else runs.response
        if values.size and np.ptp(values) <= 1e-12 * float(np.abs(values).max()):
            yield None, True  # the same in every run: known
        elif isinstance(runs, StudyError) or isinstance(model, StudyError):
            yield None, False
        else:
            practical = difference_of(response.practical, runs)
            q2 = float(model.q2)
            yield q2 if math.isfinite(q2) else None, _is_known(model, practical, rule)


def _is_known(model: Model, practical: float | None, rule: Sequential) -> bool:
    """Whether a response is known as well as the design asks for."""
    if rule.until == "q2" or practical is None:
        return bool(model.q2 >= rule.q2)
    if not isinstance(model, QuadraticSurface) and model.gate != "given":
        return False
    ranges = model.ranges(practical) or ()
    return bool(ranges) and all(reach.verdict != "cannot tell" for reach in ranges)


def _chosen(
    design: Design,
    rule: Sequential,
    places: Sequence[Mapping[str, str]],
    fitted: Sequence[_Fitted],
    count: int,
) -> list[list[float]]:
    """Choose cells one after the other, each as if those before it had been run."""
    from scipy.stats import qmc

    size, ranges = len(design.ranges), tuple(design.ranges.values())
    power = 1.0 if rule.until == "q2" else _SEARCHING
    unsure = [
        [Unsure(model.process, power) for name in names if name in models
         for model in models[name].each]
        for models, names in fitted
    ]  # fmt: skip
    # cells of each combination in the unit box, those without an answer too
    cells = [[cell.levels for cell in at_levels(design.treatments, labels)] for labels in places]
    run_points = [0.5 * (coded_settings(ranges, some) + 1.0) for some in cells]
    points = [candidates(size, rule.seed + n) for n in range(len(places))]
    at = qmc.Sobol(size, seed=rule.seed + len(places)).random_base2(REFERENCES)
    # where nothing could be fitted comes first: it needs runs most
    blind = [n for n, (_, names) in enumerate(fitted) if names and not unsure[n]]
    undecided = blind or [n for n, (_, names) in enumerate(fitted) if names]
    chosen = []
    for turn in range(count):
        nexts = [(n, *next_run(unsure[n], points[n], at, run_points[n])) for n in undecided]
        if blind:
            nexts = [nexts[turn % len(nexts)]]
        n, best, _ = max(nexts, key=lambda item: item[2])
        run_points[n] = np.vstack([run_points[n], points[n][best]])
        chosen.append(_cell(design, places[n], points[n][best]))
    return chosen


def _cell(design: Design, labels: Mapping[str, str], point: Array) -> list[float]:
    """Shares of all factors of a cell, in their order."""
    left = iter(point.tolist())
    return [
        share_of(factor.labels.index(labels[factor.name]), len(factor.labels))
        if factor.name in labels
        else float(next(left))
        for factor in design.factors
    ]


# Runs of the true model at settings that a surface has named; they join the study's surfaces.

#: name of the list of these runs in a results folder
CONFIRMED = "confirmed"


def joined(design: Design, store: Store, manifest: Mapping[str, object]) -> tuple[Record, ...]:
    """Find the runs that joined a study's surfaces: those of this design and this code."""
    rows = store.read_rows(CONFIRMED, ConfirmedRow)
    rows_of_study = [row for row in rows if row["of"] == _identity(manifest)]
    stored = store.records(
        {row["case"]: row["input"] for row in rows_of_study if ID.fullmatch(row["case"])}
    )
    names = {factor.name for factor in design.factors}
    return tuple(
        record
        for record in stored
        if names == record.levels.keys()
        and all(record.levels[name] in labels for name, labels in design.lists.items())
    )


def _identity(manifest: Mapping[str, object]) -> str:
    return digest([manifest["design"], code_of(manifest)])


def code_of(manifest: Mapping[str, object]) -> str:
    """Version of this program that a run was made with."""
    versions = manifest.get("versions")
    return str(versions.get("study")) if isinstance(versions, Mapping) else ""


def single_cell_design(design: Design, settings: Mapping[str, float | str]) -> Design:
    """Make a design of one cell, by numbers in its ranges and labels of the others."""
    factors = []
    for factor in design.factors:
        setting, span = settings[factor.name], factor.span
        levels = tuple(level for level in factor.levels if level.label == setting)
        if span is not None:
            share = 0.5 * (float(span.coded(np.array(float(setting)))) + 1.0)
            levels = levels_at(span, [min(max(share, 0.0), 1.0)])
        factors.append(replace(factor, levels=levels))
    scheme = replace(design.scheme, rows=((0,) * len(factors),), sequential=None)
    return replace(design, factors=tuple(factors), exclusions=(), scheme=scheme)


def confirm(  # noqa: PLR0913  # a study, a setting, and what its run may use
    design: Design,
    folder: Path,
    manifest: Mapping[str, Any],
    settings: Mapping[str, float | str],
    root: Path,
    allowed: Allowed,
    progress: Callable[[Progress], None],
) -> tuple[Record, ...]:
    """Run the true model at a setting, and let the run join the study's surfaces."""
    if code_of(manifest) != code_version():
        rule = "was computed by another version of this program: a new run does not belong to it"
        raise RefusedError(str(Fault(design.name, rule, "run the study again first")))
    if are_imported(manifest["notes"]):
        rule = "its runs were made elsewhere, so that no model is here for a confirming run"
        mend = (
            "ask without the run (--no-confirm, confirming=False), make one at the setting that\n"
            "    is recommended, and import the table again with it"
        )
        raise RefusedError(str(Fault(design.name, rule, mend)))
    single = single_cell_design(design, settings)
    forward = single.treatments[0].cell.problem.forward
    if forward is not None and forward.model == "python" and allowed.function is None:
        rule = "is computed by a Python function, which is not at hand for a confirming run"
        mend = (
            "ask without the run (confirming=False, --no-confirm), and call the function at the\n"
            "    setting that is recommended"
        )
        raise RefusedError(str(Fault(design.name, rule, mend)))
    work = expand(single, root, allowed)
    store = Store(folder)
    run_batch(work, store, processes(1), progress)
    stored = store.records(work.input_hashes)
    in_study = {*manifest["cases"]}
    rows_before = store.read_rows(CONFIRMED, ConfirmedRow)
    rows = [row for row in rows_before if row["case"] not in work.input_hashes]
    rows += [{"case": record.case_id, "input": work.input_hashes[record.case_id],
              "of": _identity(manifest)}
             for record in stored if record.case_id not in in_study]  # fmt: skip
    with store.lock():
        store.write_json(CONFIRMED, rows)
    return tuple(stored)
