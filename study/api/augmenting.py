"""Cells that are added to a study while it runs, where its emulators are least sure."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from study.api.fitting_surfaces import (
    at_levels,
    coded_settings,
    difference_of,
    labels_of,
    ranges_of,
    runs_at,
)
from study.api.folders import load_design
from study.ground.arrays import Array
from study.ground.canonical import Keyed
from study.ground.errors import Fault, InputError, StudyError
from study.harness.design.generators import d_optimal, efficiency
from study.harness.design.layout_kinds import share_of, words_of
from study.harness.design.load import dump, loads
from study.harness.design.spec import Design
from study.harness.design.study_file import Sequential
from study.harness.record.document import AdaptiveStep
from study.harness.runner.expansion import relabeled
from study.harness.runner.provenance import code_version
from study.mechanics.setup.declaration import Bad
from study.statistics.surfaces.emulator import (
    REFERENCES,
    BlockedEmulator,
    Emulator,
    Unsure,
    candidates,
    fit_own,
    next_run,
)
from study.statistics.surfaces.surface_result import analysis_of

if TYPE_CHECKING:
    from study.harness.record.record import Record
    from study.harness.record.store import Store
    from study.harness.runner.batch import Summary
    from study.harness.runner.job import Work


# Cells that a run has added to its design, kept in the design that it stores.


def continued(design: Design, store: Store) -> Design:
    """Design with the cells that an earlier run of it has added."""
    if design.scheme.sequential is None:
        return design
    manifest = store.read_unfinished() or store.read_manifest()
    if manifest is None or manifest.get("versions", {}).get("study") != code_version():
        return design
    try:
        design_then = loads(manifest["design"], manifest["source"])
    except InputError:
        return design
    same = dump(with_added(design_then, ())) == dump(with_added(design, ()))
    return with_added(design, added(design_then)) if same else design


def _table(design: Design) -> Mapping[str, object]:
    written = design.config["design"]
    return written if isinstance(written, Mapping) else {}


def added(design: Design) -> list[list[float]]:
    """Cells that were added, as they stand in the design."""
    cells = _table(design).get("added", ())
    return [list(cell) for cell in cells] if isinstance(cells, list | tuple) else []


def with_added(design: Design, cells: Sequence[Sequence[float]]) -> Design:
    """Copy of a design with other cells added to its Latin hypercube."""
    table = {key: value for key, value in _table(design).items() if key != "added"}
    if cells:
        table["added"] = [list(cell) for cell in cells]
    text = dump(replace(design, config={**design.config, "design": table}))
    return replace(loads(text, design.source), text=design.text)


#: name of the list of what was known at every step
HISTORY = "adaptive"

#: responses that say what a run costs: nobody learns them
_COSTS = ("seconds", "dofs")

#: exponent of the misfit where a verdict is sought, which the largest misfit decides
_SEARCHING = 2.0


@dataclass(frozen=True)
class _Fitted:
    """Emulators of the responses at one combination of the other levels."""

    responses: Mapping[str, Emulator | BlockedEmulator]
    open: tuple[str, ...]


def run_adaptive(
    work: Work,
    store: Store,
    compute: Callable[[Work], Summary],
    expanded: Callable[[Design], Work],
    note: Callable[[Work], None],
) -> tuple[Work, Summary]:
    """Compute the cells of a design, and those that are added to it, until it says enough."""
    summary = compute(work)
    if work.design.scheme.sequential is None:
        return work, summary
    size = len(work.design.treatments)
    history_rows = store.read_rows(HISTORY, AdaptiveStep)
    history: list[object] = [row for row in history_rows if row["cells"] < size]
    while True:
        # digits of an emulator must not depend on the threads of the machine
        with threadpool_limits(1):
            cases = {job.case.case_id: job.case for job in work.jobs}
            records = relabeled(store.records(work.input_hashes), work.design, cases)
            chosen, step = next_cells(work.design, records)
        history.append(step)
        with store.lock():
            store.write_json(HISTORY, history)
        if not chosen:
            return work, summary
        work = expanded(with_added(work.design, [*added(work.design), *chosen]))
        note(work)
        more = compute(work)
        summary = replace(
            more,
            computed=summary.computed + more.computed,
            failed=summary.failed + more.failed,
            already=summary.already,
            fits=summary.fits + more.fits,
            seconds=summary.seconds + more.seconds,
        )


def next_cells(design: Design, records: Sequence[Record]) -> tuple[list[list[float]], AdaptiveStep]:
    """Choose the cells that make the emulators of a design surest."""
    rule = design.scheme.sequential
    if rule is None:
        raise ValueError("the design is not adaptive")
    places = labels_of(design)
    fitted = [_fit(design, rule, labels, records) for labels in places]
    size = len(design.treatments)
    errors: dict[str, float] = {}
    for surface_fit in fitted:
        for name, model in surface_fit.responses.items():
            errors[name] = min(errors.get(name, 1.0), float(model.q2))
    unknown = list(dict.fromkeys(name for place in fitted for name in place.open))
    step: AdaptiveStep = {"cells": size, "q2": {**errors}, "open": unknown, "stopped": ""}
    free = min(rule.batch, rule.budget - size)
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


def _fit(
    design: Design, rule: Sequential, labels: Mapping[str, str], records: Sequence[Record]
) -> _Fitted:
    """Fit every response at one combination of levels, and say which is not known well enough."""
    models: dict[str, Emulator | BlockedEmulator] = {}
    still = []
    for response in design.responses:
        if response.name in _COSTS:
            continue
        try:
            runs = runs_at(design, response.name, labels, records)
            if np.ptp(runs.response) <= 1e-12 * float(np.abs(runs.response).max()):
                continue  # the same in every run: known
            model = models[response.name] = fit_own(runs)
            practical = difference_of(response.practical, runs.response)
            is_good = _is_known(model, practical, rule)
        except StudyError:  # without a surface it is not known
            is_good = False
        if not is_good:
            still.append(response.name)
    return _Fitted(models, tuple(still))


def _is_known(model: Emulator | BlockedEmulator, practical: float | None, rule: Sequential) -> bool:
    """Whether a response is known as well as the design asks for."""
    if rule.until == "q2" or practical is None:
        return bool(model.q2 >= rule.q2)
    sensitivity = analysis_of(model, practical).sensitivity
    verdicts = [None if item.range is None else item.range.verdict for item in sensitivity]
    return bool(verdicts) and all(v not in (None, "cannot tell") for v in verdicts)


def _chosen(
    design: Design,
    rule: Sequential,
    places: Sequence[Mapping[str, str]],
    fitted: Sequence[_Fitted],
    count: int,
) -> list[list[float]]:
    """Choose cells one after the other, each as if those before it had been run."""
    from scipy.stats import qmc

    ranges = [factor for factor in design.factors if factor.span is not None]
    power = 1.0 if rule.until == "q2" else _SEARCHING
    unsure = [
        [Unsure(model.process, power) for name in place.open if name in place.responses
         for model in place.responses[name].each]
        for place in fitted
    ]  # fmt: skip
    # cells of each combination in the unit box, those without an answer too
    cells = [[cell.levels for cell in at_levels(design.treatments, labels)] for labels in places]
    made = [0.5 * (coded_settings(design, ranges_of(design), some) + 1.0) for some in cells]
    points = [candidates(len(ranges), rule.seed + n) for n in range(len(places))]
    at = qmc.Sobol(len(ranges), seed=rule.seed + len(places)).random_base2(REFERENCES)
    # where nothing could be fitted comes first: it needs runs most
    blind = [n for n, place in enumerate(fitted) if place.open and not unsure[n]]
    undecided = blind or [n for n in range(len(places)) if fitted[n].open]
    chosen = []
    for turn in range(count):
        nexts = [(n, *next_run(unsure[n], points[n], at, made[n])) for n in undecided]
        if blind:
            nexts = [nexts[turn % len(nexts)]]
        n, best, _ = max(nexts, key=lambda item: item[2])
        made[n] = np.vstack([made[n], points[n][best]])
        chosen.append(_cell(design, places[n], points[n][best]))
    return chosen


def _cell(design: Design, labels: Mapping[str, str], point: Array) -> list[float]:
    """Shares of all factors of a cell, in their order."""
    left = iter(point.tolist())
    return [
        share_of(factor.labels.index(labels[factor.name]), len(factor.labels))
        if factor.span is None
        else float(next(left))
        for factor in design.factors
    ]


# Further cells for a fraction that leaves a doubt: those that tell more terms apart.

#: kinds of a design whose factors are samples of ranges, not levels
_SAMPLED = ("central-composite", "box-behnken", "latin-hypercube", "sobol", "adaptive")


@dataclass(frozen=True)
class Augmentation(Keyed):
    """Cells to be run besides those of a design."""

    KEYS = "cells terms efficiency design=table"

    #: Level of every factor, by its label.
    cells: tuple[Mapping[str, str], ...]
    own: tuple[Mapping[str, str], ...]
    #: What all cells together tell apart.
    terms: tuple[str, ...]
    #: D-efficiency for these terms, 0 where some of them are one another.
    before: float
    after: float

    @property
    def efficiency(self) -> dict[str, float]:
        """D-efficiency without and with the further cells."""
        return {"before": self.before, "after": self.after}

    def table(self) -> str:
        """Write the table ``[design]`` with all cells: records of those that are done are kept."""

        def key(name: str) -> str:
            bare = name.replace("_", "").replace("-", "").isalnum()
            return name if bare else json.dumps(name)

        lines = [
            "    { " + ", ".join(f"{key(k)} = {json.dumps(v)}" for k, v in cell.items()) + " },"
            for cell in (*self.own, *self.cells)
        ]
        return "\n".join(["[design]", 'kind = "listed"', "treatments = [", *lines, "]"])


def augment(
    design: Design | str | Path, cells: int, *, terms: int | Sequence[str] = 2
) -> Augmentation:
    """Choose further cells of a fraction by D-optimality, for terms such as ``"a:b"`` or an order.

    A design that runs every combination or samples ranges has none, and is refused.
    """
    loaded = load_design(design)
    rows = loaded.scheme.rows
    factors = loaded.factors
    sizes = [len(factor.levels) for factor in factors]
    every = math.prod(sizes)
    if rows is None or loaded.scheme.kind == "full":
        rule = "runs every combination: there is no further cell"
        raise InputError(Fault("design", rule, "add a level or a factor"))
    if loaded.scheme.kind in _SAMPLED:
        rule = f"a {loaded.scheme.kind} design samples ranges"
        raise InputError(Fault("design.kind", rule, "ask it for more runs"))
    names = [factor.name for factor in factors]
    try:
        words = words_of(names, terms if isinstance(terms, int) else list(terms))
    except Bad as error:
        raise InputError(Fault("terms", error.rule, error.mend)) from None
    unknowns = 1 + sum(math.prod(sizes[k] - 1 for k in word) for word in words)
    least = max(1, unknowns - len(rows))
    if not least <= cells <= every - len(rows):
        rule = f"{cells} further cells, of which there are {every - len(rows)}"
        mend = (
            f"{least} to {every - len(rows)}: {len(rows)} cells run, {unknowns} numbers are asked"
        )
        raise InputError(Fault("augment", rule, mend))
    chosen_cells = d_optimal(sizes, words, cells, loaded.seed, rows)
    return Augmentation(
        tuple(_labels(names, loaded, row) for row in chosen_cells),
        tuple(_labels(names, loaded, row) for row in rows),
        tuple(":".join(names[k] for k in word) for word in words),
        efficiency(rows, sizes, words),
        efficiency((*rows, *chosen_cells), sizes, words),
    )


def _labels(names: Sequence[str], design: Design, row: Sequence[int]) -> dict[str, str]:
    labels = (factor.labels[k] for factor, k in zip(design.factors, row, strict=True))
    return dict(zip(names, labels, strict=True))
