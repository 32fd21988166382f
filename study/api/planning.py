"""What a study will do and has done; cells that are added to it."""

from __future__ import annotations

import datetime
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from study import api
from study.api.comparison import run_changes
from study.external.command import common_digest
from study.ground.canonical import Keyed
from study.ground.declaration import values_of
from study.ground.errors import Fault, InputError, MissingDataError, StudyError
from study.harness.design.load import (
    RESULTS,
    design_root,
    finished_manifest,
    load_design,
    results_folder,
)
from study.harness.design.overview import Augmentation, Overview, further_cells, overview
from study.harness.design.spec import Design
from study.harness.runner.adaptive_cells import continued
from study.harness.runner.batch import missing, open_fits
from study.harness.runner.expansion import expand
from study.harness.runner.study_refinement import (
    in_blocks,
    input_work,
    own_series,
    refinement_work,
    upcoming,
)
from study.record.record import write_csv
from study.record.store import Store
from study.simulation.fit_problem import externals
from study.simulation.tasks import Costs, default_jobs, program_calls

if TYPE_CHECKING:
    import pandas as pd

    from study.harness.runner.expansion import Work
    from study.record.store import Store


# Seconds that a study still needs: its refinements, its controls, and what was noted.


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
        "study=design.name cases predicted_seconds report verdicts warnings blocks fits "
        "controls memory_MB program_calls commands commands_digest=digest design=overview.to_json"
    )
    #: what a study that has run has besides
    report, verdicts = None, ()

    design: Design
    #: Matrix, exclusions, what each factor can tell.
    overview: Overview
    #: Empty without blocks, or where the data cannot be read.
    blocks: tuple[str, ...]
    #: All, and those that are done, failed and missing.
    cases: Mapping[str, int]
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
        forwards = (treatment.cell.problem.forward for treatment in self.design.treatments)
        return any(treatment is not None and treatment.model == "python" for treatment in forwards)

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
    if loaded.scheme.sequential is not None:
        loaded = continued(loaded, Store(Path(results) / loaded.name, warn=lambda _: None))
    described = overview(loaded)
    warnings = list(described.warnings)
    if not loaded.responses:
        warnings.append(
            "no [[response]]: `study run` will have nothing to analyze; `study converge` tells how "
            "the mesh counts"
        )
    workers = jobs or default_jobs()
    root = design_root(loaded, data)
    try:
        work = expand(loaded, root)
    except MissingDataError as error:
        warnings.append(f"no blocks and no time, for the measurements are missing: {error}")
        total = len(described.matrix)
        cases = {"total": total, "done": 0, "failed": 0, "missing": total}
        return Plan(loaded, described, (), cases, 0, None, None, workers, tuple(warnings))
    store = Store(Path(results) / loaded.name, warn=warnings.append)
    return _counted(work, described, store, workers, warnings)


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
    # none where the cells themselves are a series of meshes
    refining = replace(plain, jobs=()) if own_series(plain) else refinement_work(plain)
    finer = missing(refining, store)
    if work.design.uncertainty and work.design.is_measured:
        finer += missing(input_work(plain), store)
    seconds += Costs().total_seconds(open_fits(finer, store), finer, workers)
    each = Costs()
    solved = [each.solve_seconds(job.case.tested, job.depth_mm) for job in controls]
    seconds += max(sum(solved) / workers, max(solved, default=0.0))  # the longest takes its time
    most, rule = None, work.design.scheme.sequential
    if rule is not None:  # all cells that may be added are like those that it has
        whole = Costs().total_seconds(work.fits.values(), work.jobs, workers)
        whole += Costs().total_seconds(refining.fits.values(), refining.jobs, workers)
        most = seconds + whole * (rule.budget / len(work.design.treatments) - 1)
    found_models = externals(job.case.problem for job in work.jobs)
    commands = [program for program in found_models if program.section.model == "command"]
    memory = workers * max(
        (costs.memory_MB(job.case.problem) for job in [*todo, *controls]), default=0.0
    )
    return Plan(
        work.design, described, work.blocks, survey.counts | {"missing": len(todo)}, len(fits),
        seconds, memory, workers, tuple(warnings),
        len(controls), program_calls(fits, todo) + program_calls(open_fits(finer, store), finer),
        tuple(line for program in commands for line in program.lines()), common_digest(commands),
        most,
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
        "cases": survey.counts,
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
            "cases": Store(store.path).survey(later["cases"]).counts,
            "changed": [change.sentence for change in run_changes(manifest, later)],
        },
    }


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


def augment(
    design: Design | str | Path, cells: int, *, terms: int | Sequence[str] = 2
) -> Augmentation:
    """Choose further cells of a fraction by D-optimality, for terms such as ``"a:b"`` or an order.

    A design that runs every combination or samples ranges has none, and is refused.
    """
    return further_cells(load_design(design), cells, terms)
