"""What a study will do and has done; cells that are added to it."""

from __future__ import annotations

import datetime
import json
import math
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from threadpoolctl import threadpool_limits

from study import api
from study.api.comparison import run_changes
from study.api.fitting_surfaces import (
    at_levels,
    coded_settings,
    difference_of,
    labels_of,
    ranges_of,
    runs_at,
)
from study.api.folders import (
    RESULTS,
    design_root,
    finished_manifest,
    load_design,
    results_folder,
)
from study.ground.arrays import Array
from study.ground.canonical import Keyed
from study.ground.declaration import Bad, values_of
from study.ground.errors import Fault, InputError, MissingDataError, StudyError
from study.harness.design.generators import d_optimal, efficiency
from study.harness.design.layout_kinds import share_of, words_of
from study.harness.design.load import dump, loads
from study.harness.design.overview import Overview, overview
from study.harness.design.spec import Design
from study.harness.design.study_file import Sequential
from study.harness.external.command import common_digest
from study.harness.record.document import AdaptiveStep
from study.harness.record.record import write_csv
from study.harness.record.store import Store, Survey
from study.harness.runner.batch import missing, open_fits
from study.harness.runner.expansion import expand, relabeled
from study.harness.runner.fit_problem import externals
from study.harness.runner.provenance import code_version
from study.harness.runner.study_refinement import in_blocks, own_series, refinement_work, upcoming
from study.harness.runner.tasks import Costs, default_jobs, program_calls
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
    import pandas as pd

    from study.harness.record.record import Record
    from study.harness.record.store import Store
    from study.harness.runner.batch import Progress
    from study.harness.runner.job import Work


# Seconds that a study still needs: its refinements, its controls, and what was noted.

#: seconds between two notes for other shells: nobody reads them faster
NOTED_S = 0.2


def noted_progress(
    store: Store, progress: Callable[[Progress], None] | None
) -> Callable[[Progress], None]:
    """Progress that is also left beside the lock, for other shells."""
    noted = -math.inf

    def note(state: Progress) -> None:
        nonlocal noted
        now = time.monotonic()
        if now - noted > NOTED_S or state.done == state.total:
            noted = now
            store.note(
                {
                    "done": state.done,
                    "total": state.total,
                    "counted": state.counted,
                    "failed": state.failed,
                    "label": state.label[:80],
                    "seconds_left": round(state.seconds_left, 1),
                    "at": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
                }
            )
        if progress is not None:
            progress(state)

    return note


def seconds_left(runner: Mapping[str, Any] | None) -> float | None:
    """Seconds that a runner still needs, from what it noted; None where it noted nothing."""
    runner_document = runner or {}
    try:
        noted_at = datetime.datetime.fromisoformat(str(runner_document["at"]))
        left = float(runner_document["seconds_left"])
        since = (datetime.datetime.now(datetime.UTC) - noted_at).total_seconds()
    except (KeyError, TypeError, ValueError):
        return None
    return max(0.0, left - max(0.0, since))


@dataclass(frozen=True)
class Plan(Keyed):
    """A design before it runs."""

    KEYS = (
        "study=design.name cases=counts predicted_seconds report verdicts warnings blocks fits "
        "controls memory_MB program_calls commands commands_digest=digest design=overview.to_json"
    )
    #: what a study that has run has besides
    report, verdicts = None, ()

    design: Design
    #: Matrix, exclusions, what each factor can tell.
    overview: Overview
    #: Empty without blocks, or where the data cannot be read.
    blocks: tuple[str, ...]
    total: int
    done: int
    failed: int
    missing: int
    fits: int
    #: Wall time of what is missing; None where the data are not there yet.
    predicted_seconds: float | None
    #: Predicted peak of all workers together.
    memory_MB: float | None  # noqa: N815
    jobs: int
    warnings: tuple[str, ...]
    #: Solutions still to be made besides the cases: the same cylinder in both spaces.
    controls: int = 0
    #: Calls of other programs, those of gradients by differences included.
    program_calls: int = 0
    commands: tuple[str, ...] = ()
    #: Name of all of it, which ``study run --allow-digest`` takes.
    digest: str = ""
    #: Wall time if the whole budget of an adaptive design is spent; None for any other design.
    most_seconds: float | None = None

    @property
    def calls_function(self) -> bool:
        """Whether a Python function predicts, which only Python can give."""
        forwards = (one.cell.problem.forward for one in self.design.treatments)
        return any(one is not None and one.model == "python" for one in forwards)

    @property
    def counts(self) -> dict[str, int]:
        """Cases: all, and those that are done, failed and missing."""
        return {
            "total": self.total,
            "done": self.done,
            "failed": self.failed,
            "missing": self.missing,
        }

    def keyed(self) -> dict[str, object]:
        """Give what stands under every key; of an adaptive design also how it goes on."""
        rule = self.design.scheme.sequential
        if rule is None:
            return super().keyed()
        adaptive = {k: v for k, v in values_of(rule).items() if k not in ("kind", "added")}
        return super().keyed() | {"adaptive": {**adaptive, "most_seconds": self.most_seconds}}


def plan(
    design: Design | str | Path,
    *,
    data: str | Path | None = None,
    results: str | Path = RESULTS,
    overrides: Sequence[str] = (),
    jobs: int | None = None,
) -> Plan:
    """Say what a design computes, what is done already and what the rest will cost.

    Data that are not there yet do not stop a plan: it then counts cells, not cases, and no time.
    """
    loaded = load_design(design, overrides)
    loaded = continued(loaded, Store(Path(results) / loaded.name, warn=lambda _: None))
    described = overview(loaded)
    warnings = list(described.warnings)
    workers = jobs or default_jobs()
    root = design_root(loaded, data)
    try:
        work = expand(loaded, root)
    except MissingDataError as error:
        warnings.append(f"no blocks and no time, for the measurements are missing: {error}")
        total = len(described.matrix)
        return Plan(
            loaded, described, (), total, 0, 0, total, 0, None, None, workers, tuple(warnings)
        )
    study_plan = _counted(work, described, Store(Path(results) / loaded.name, warn=warnings.append),
                     workers, warnings)  # fmt: skip
    return replace(
        study_plan, most_seconds=_most_seconds(work, study_plan.predicted_seconds, workers)
    )


def _most_seconds(work: Work, predicted: float | None, workers: int) -> float | None:
    """Wall time with all cells that an adaptive design may add, each like those that it has."""
    rule = work.design.scheme.sequential
    if rule is None or predicted is None:
        return None
    seconds = Costs().total_seconds(work.fits.values(), work.jobs, workers)
    more = rule.budget - len(work.design.treatments)
    return predicted + seconds * more / len(work.design.treatments)


def _counted(
    work: Work, described: Overview, store: Store, workers: int, warnings: list[str]
) -> Plan:
    warnings += [*work.cautions, *_idle_replicates(work)]
    survey = store.survey(work.input_hashes)
    todo = missing(work, store)
    fits = open_fits(todo, store)
    costs = Costs()
    plain = work.plain()
    # cells of the spaces' control that have no solution yet
    hashes = {job.case.case_id: job.input_hash for job in in_blocks(plain)}
    controls = upcoming(plain, store.by_case(hashes), store)
    seconds = costs.total_seconds(fits, todo, workers)
    if not own_series(plain):  # else the cells themselves are a series of meshes
        finer = missing(refinement_work(plain), store)
        seconds += Costs().total_seconds(open_fits(finer, store), finer, workers)
    each = Costs()
    solved = [each.solve_seconds(job.case.tested, job.depth_mm) for job in controls]
    seconds += max(sum(solved) / workers, max(solved, default=0.0))  # the longest takes its time
    found_models = externals(job.case.problem for job in work.jobs)
    commands = [program for program in found_models if program.section.model == "command"]
    memory = workers * max(
        (costs.memory_MB(job.case.problem) for job in [*todo, *controls]), default=0.0
    )
    return Plan(
        work.design, described, work.blocks, len(work.jobs), len(survey.done),
        len(survey.statuses), len(todo), len(fits), seconds, memory, workers, tuple(warnings),
        len(controls), program_calls(fits, todo),
        tuple(line for program in commands for line in program.lines()), common_digest(commands),
    )  # fmt: skip


def _idle_replicates(work: Work) -> list[str]:
    """Say that blocks come before replicates as an error term, where that was not changed."""
    design = work.design
    is_asked = design.replicates.noise or design.replicates.mesh_seeds
    if not is_asked or len(work.blocks) < 2 or design.analysis.error == "replicates":
        return []
    return [
        f"the {len(work.blocks)} blocks are the better error term (E1) and decide; for that of "
        'the replicates write [analysis] error = "replicates", or leave them out'
    ]


def status(
    path: str | Path, *, results: str | Path = RESULTS, judged: bool = False
) -> dict[str, Any]:
    """Progress of a study, from any shell: the document of ``study status --json``.

    With ``judged`` a study that is finished and does not run gives its verdicts, which takes as
    long as opening it.

    ``running`` holds pid, host, since and the last progress, or None; the predicted seconds are
    those that are left. Counted are the cases of the last finished run; ``unfinished`` says how
    far a later one is, of an edited design, and what was edited.
    """
    folder = results_folder(path, results)
    warnings: list[str] = []
    store = Store(folder, warn=warnings.append)
    manifest = finished_manifest(store)
    survey, later = store.survey(manifest["cases"]), store.read_unfinished()
    running = store.running()
    verdicts: list[dict[str, object]] = []
    if judged and running is None and later is None and not survey.missing:
        with suppress(StudyError):  # what keeps a study from being opened is no progress of it
            verdicts = api.load(folder, results).verdicts
    return {
        "study": manifest["name"],
        "cases": _counts(survey),
        "predicted_seconds": seconds_left(running),
        "report": None,
        "verdicts": verdicts,
        "warnings": warnings,
        "failures": dict(Counter(survey.statuses.values())),
        "running": running,
        "timings": manifest.get("timings", {}),
        "finished": bool(manifest.get("finished", not survey.missing)),
        "unfinished": None
        if later is None
        else {
            "cases": _counts(Store(store.path).survey(later["cases"])),
            "changed": [change.sentence for change in run_changes(manifest, later)],
        },
    }


def _counts(survey: Survey) -> dict[str, int]:
    """Cases of a study: all, and those that are done, failed and missing."""
    counts = {
        "done": len(survey.done), "failed": len(survey.statuses), "missing": len(survey.missing),
    }  # fmt: skip
    return {"total": sum(counts.values()), **counts}


# A run sheet for physical trials: every specimen under every condition, in random order.
#
# Order is drawn anew for each specimen, so that drift of the machine, the room or the operator is
# spread over the conditions instead of being taken for one of them (randomized complete blocks;
# Fisher 1935, The Design of Experiments).

#: tables whose keys choose a simulation: nothing changes in the laboratory
SIMULATED = ("model", "material", "forward", "calibration", "measurements")


def run_sheet(
    design: Design | str | Path, specimens: int, *, path: str | Path | None = None
) -> pd.DataFrame:
    """Draw the order of physical trials: each specimen once under every physical condition.

    One row a trial: ``run`` (from 1, in the order of work), ``specimen``, the factors, and empty
    columns for what is written down. A file that exists is not overwritten.
    """
    import pandas as pd

    loaded = load_design(design)
    if specimens < 1:
        raise InputError(Fault("specimens", f"must be at least 1, got {specimens}"))
    physical = [
        factor.name
        for factor in loaded.factors
        if any(key.partition(".")[0] not in SIMULATED for key in factor.keys)
    ]
    if not physical:
        rule = "no factor changes anything in the laboratory, so there is nothing to randomize"
        raise InputError(
            Fault("factors", rule, "a run sheet is for factors such as test.interface")
        )
    levels = [
        {name: treatment.levels[name] for name in physical} for treatment in loaded.treatments
    ]
    conditions = list({tuple(condition.items()): condition for condition in levels}.values())
    random = np.random.default_rng(loaded.seed)
    rows = [
        {"specimen": k + 1, **conditions[i]}
        for k in range(specimens)
        for i in random.permutation(len(conditions))
    ]
    sheet = pd.DataFrame(rows)
    sheet.insert(0, "run", range(1, len(rows) + 1))
    sheet = sheet.assign(date="", file="", remarks="")
    if path is not None:
        if Path(path).exists():
            raise InputError(Fault(str(path), "exists; a sheet that is in use is not overwritten"))
        write_csv(sheet, Path(path))
    return sheet


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


#: emulators of the responses at one combination of the other levels, and names of open responses
_Fitted = tuple[dict[str, Emulator | BlockedEmulator], list[str]]


def run_adaptive(
    work: Work,
    store: Store,
    compute: Callable[[Work], int],
    expanded: Callable[[Design], Work],
    note: Callable[[Work], None],
) -> tuple[Work, int]:
    """Compute the cells of a design, and those that are added to it, until it says enough."""
    computed = compute(work)
    if work.design.scheme.sequential is None:
        return work, computed
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
            return work, computed
        work = expanded(with_added(work.design, [*added(work.design), *chosen]))
        note(work)
        computed += compute(work)


def next_cells(design: Design, records: Sequence[Record]) -> tuple[list[list[float]], AdaptiveStep]:
    """Choose the cells that make the emulators of a design surest."""
    rule = design.scheme.sequential
    if rule is None:
        raise ValueError("the design is not adaptive")
    places = labels_of(design)
    fitted = [_fit(design, rule, labels, records) for labels in places]
    size = len(design.treatments)
    errors: dict[str, float] = {}
    for models, _ in fitted:
        for name, model in models.items():
            errors[name] = min(errors.get(name, 1.0), float(model.q2))
    unknown = list(dict.fromkeys(name for _, names in fitted for name in names))
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
    return models, still


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
        [Unsure(model.process, power) for name in names if name in models
         for model in models[name].each]
        for models, names in fitted
    ]  # fmt: skip
    # cells of each combination in the unit box, those without an answer too
    cells = [[cell.levels for cell in at_levels(design.treatments, labels)] for labels in places]
    made = [0.5 * (coded_settings(ranges_of(design), some) + 1.0) for some in cells]
    points = [candidates(len(ranges), rule.seed + n) for n in range(len(places))]
    at = qmc.Sobol(len(ranges), seed=rule.seed + len(places)).random_base2(REFERENCES)
    # where nothing could be fitted comes first: it needs runs most
    blind = [n for n, (_, names) in enumerate(fitted) if names and not unsure[n]]
    undecided = blind or [n for n, (_, names) in enumerate(fitted) if names]
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
_SAMPLED = ("central-composite", "box-behnken", "latin-hypercube", "sobol", "morris", "adaptive")


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
