"""Cells that are added to a study while it runs, where its emulators are least sure."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypedDict

import numpy as np
from threadpoolctl import threadpool_limits

from study.analysis.request import threshold
from study.api.planning.sequential_design import added, with_added
from study.api.statistics.surface.response_surface import fit_runs
from study.api.statistics.surface.study_surface import runs_at
from study.arrays import Array
from study.design.factors import settings_of
from study.design.layout.adaptive import share_of
from study.design.spec import Design
from study.design.study_file import Sequential
from study.errors import RefusedError, StudyError
from study.record.document import AdaptiveStep
from study.response_surface.emulator.active_learning import (
    REFERENCES,
    Unsure,
    candidates,
    next_run,
)
from study.response_surface.emulator.blocked import BlockedEmulator, fit_blocks
from study.response_surface.emulator.emulator import Emulator, fit_emulator
from study.response_surface.emulator.gaussian_process import GaussianProcess
from study.response_surface.factors import NumericFactor, Runs
from study.runner.expansion import relabeled

if TYPE_CHECKING:
    from study.record.record import Record
    from study.record.store import Store
    from study.runner.batch import Summary
    from study.runner.job import Work

#: name of the list of what was known at every step
HISTORY = "adaptive"

#: responses that say what a run costs: nobody learns them
_COSTS = ("seconds", "dofs")

#: exponent of the misfit where a verdict is sought, which the largest misfit decides
_SEARCHING = 2.0


class Step(TypedDict):
    """What was known with so many cells: Q2 by response, what was not known, why it ended."""

    cells: int
    q2: dict[str, float]
    open: list[str]
    stopped: str


@dataclass(frozen=True)
class _Fitted:
    """Emulators of the responses at one combination of the other levels."""

    responses: Mapping[str, Emulator | BlockedEmulator]
    refused: Mapping[str, str]
    open: tuple[str, ...]


def run_adaptive(
    work: Work,
    store: Store,
    compute: Callable[[Work], Summary],
    expanded: Callable[[Design], Work],
    note: Callable[[Work], None],
) -> tuple[Work, Summary]:
    """Compute the cells of a design, and those that are added to it, until it says enough.

    Parameters
    ----------
    work : Work
        Cells that are known so far.
    store : Store
        Where records are.
    compute : callable
        Computes what is missing of some work.
    expanded : callable
        Lists the computations of a design.
    note : callable
        Stores what a study consists of, before its new cells are computed.

    Returns
    -------
    Work, Summary
        All cells, and what was computed.
    """
    summary = compute(work)
    if work.design.scheme.sequential is None:
        return work, summary
    size = len(work.design.treatments)
    kept = store.read_rows(HISTORY, AdaptiveStep)
    history: list[object] = [row for row in kept if row["cells"] < size]
    while True:
        # digits of an emulator must not depend on the threads of the machine
        with threadpool_limits(1):
            known = {job.case.case_id: job.case for job in work.jobs}
            records = relabeled(store.records(work.input_hashes), work.design, known)
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


def next_cells(design: Design, records: Sequence[Record]) -> tuple[list[list[float]], Step]:
    """Choose the cells that make the emulators of a design surest.

    Parameters
    ----------
    design : Design
        An adaptive one.
    records : sequence of Record
        Of the cells that were computed.

    Returns
    -------
    list of list of float
        Shares of the ranges of the cells to be added; none where enough is known.
    dict
        How many cells there are, Q2 of every response, and why it ends, if it does.
    """
    rule = design.scheme.sequential
    if rule is None:
        raise ValueError("the design is not adaptive")
    places = _places(design)
    fitted = [_fit(design, rule, labels, records) for labels in places]
    size = len(design.treatments)
    step: Step = {"cells": size, "q2": _quality(fitted), "open": _open(fitted), "stopped": ""}
    free = min(rule.batch, rule.budget - size)
    step["stopped"] = _end(rule, step, free, any(record.converged for record in records))
    return ([] if step["stopped"] else _chosen(design, rule, places, fitted, free)), step


def _end(rule: Sequential, step: Step, free: int, answered: bool) -> str:
    """Say why no cell is added; nothing where some are."""
    if not answered:
        return "no cell has an answer"
    if not step["open"]:
        goal = f"the Q2 of every response is at least {rule.q2:g}"
        return goal if rule.until == "q2" else "every factor has a verdict"
    return "" if free > 0 else f"the budget of {rule.budget} cells is spent"


def _places(design: Design) -> list[dict[str, str]]:
    """List the combinations of the levels of the factors that are no ranges."""
    others = [factor for factor in design.factors if factor.span is None]
    every = itertools.product(*(factor.labels for factor in others))
    return [dict(zip([f.name for f in others], labels, strict=True)) for labels in every]


def _fit(
    design: Design, rule: Sequential, labels: Mapping[str, str], records: Sequence[Record]
) -> _Fitted:
    """Fit every response at one combination of levels, and say which is not known well enough."""
    found: dict[str, Emulator | BlockedEmulator] = {}
    refused: dict[str, str] = {}
    still = []
    for response in design.responses:
        if response.name in _COSTS:
            continue
        try:
            if not _answers(response.name, labels, records):
                raise RefusedError("no cell has an answer")
            runs = runs_at(design, response.name, labels, records)
            if np.ptp(runs.response) <= 1e-12 * float(np.abs(runs.response).max()):
                continue  # the same in every run: known
            model = fit_blocks(runs) if len(set(runs.blocks)) > 1 else fit_emulator(runs)
            found[response.name] = model
            known = _is_known(design, response.name, runs, model, rule)
        except StudyError as error:
            refused[response.name] = str(error)
            known = False
        if not known:
            still.append(response.name)
    return _Fitted(found, refused, tuple(still))


def _answers(response: str, labels: Mapping[str, str], records: Sequence[Record]) -> bool:
    here = [r for r in records if all(r.levels[name] == label for name, label in labels.items())]
    return any(record.value(response) is not None for record in here)


def _is_known(
    design: Design,
    response: str,
    runs: Runs,
    model: Emulator | BlockedEmulator,
    rule: Sequential,
) -> bool:
    """Whether a response is known as well as the design asks for."""
    if rule.until == "q2":
        return bool(model.q2 >= rule.q2)
    asked = next(one.practical for one in design.responses if one.name == response)
    limit = threshold(asked)
    if limit is None:
        return bool(model.q2 >= rule.q2)
    practical = limit.on_scale(float(runs.response.mean()), "none")
    told = fit_runs(runs, "emulator", practical).sensitivity
    verdicts = [None if one.range is None else one.range.verdict for one in told]
    return bool(verdicts) and all(v not in (None, "cannot tell") for v in verdicts)


def _quality(fitted: Sequence[_Fitted]) -> dict[str, float]:
    """Smallest Q2 of each response."""
    found: dict[str, float] = {}
    for one in fitted:
        for name, model in one.responses.items():
            found[name] = min(found.get(name, 1.0), float(model.q2))
    return found


def _open(fitted: Sequence[_Fitted]) -> list[str]:
    return list(dict.fromkeys(name for one in fitted for name in one.open))


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
        [Unsure(p, power) for name in one.open if name in one.responses
         for p in _processes(one.responses[name])]
        for one in fitted
    ]  # fmt: skip
    made = [_made(design, labels) for labels in places]
    points = [candidates(len(ranges), rule.seed + n) for n in range(len(places))]
    at = qmc.Sobol(len(ranges), seed=rule.seed + len(places)).random_base2(REFERENCES)
    # where nothing could be fitted comes first: it needs runs most
    blind = [n for n, one in enumerate(fitted) if one.open and not unsure[n]]
    asked = blind or [n for n in range(len(places)) if fitted[n].open]
    chosen = []
    for turn in range(count):
        told = [(n, *next_run(unsure[n], points[n], at, made[n])) for n in asked]
        if blind:
            told = [told[turn % len(told)]]
        n, best, _ = max(told, key=lambda one: one[2])
        made[n] = np.vstack([made[n], points[n][best]])
        chosen.append(_cell(design, places[n], points[n][best]))
    return chosen


def _processes(model: Emulator | BlockedEmulator) -> list[GaussianProcess]:
    each = model.each if isinstance(model, BlockedEmulator) else (model,)
    return [one.process for one in each]


def _made(design: Design, labels: Mapping[str, str]) -> Array:
    """Cells of one combination of levels, in the unit box, those without an answer too."""
    columns = []
    own = [one.levels for one in design.treatments
           if all(one.levels[name] == label for name, label in labels.items())]  # fmt: skip
    for factor in design.factors:
        span = factor.span
        if span is None:
            continue
        known = settings_of(factor)
        settings = np.array([known[levels[factor.name]] for levels in own])
        numeric = NumericFactor(factor.name, span.low, span.high, span.log)
        columns.append(0.5 * (numeric.coded(settings) + 1.0))
    return np.column_stack(columns)


def _cell(design: Design, labels: Mapping[str, str], point: Array) -> list[float]:
    """Shares of all factors of a cell, in their order."""
    left = iter(point.tolist())
    return [
        share_of(factor.labels.index(labels[factor.name]), len(factor.labels))
        if factor.span is None
        else float(next(left))
        for factor in design.factors
    ]
