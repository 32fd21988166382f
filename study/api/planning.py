"""What a study will do and has done, and what a number of specimens can show."""

from __future__ import annotations

import datetime
import math
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
from study.ground.errors import Fault, InputError, MissingDataError, StudyError, nearest
from study.harness.design.load import (
    RESULTS,
    design_root,
    finished_manifest,
    load_design,
    results_folder,
)
from study.harness.design.overview import Overview, overview
from study.harness.design.spec import Design, ResponseSpec
from study.harness.runner.adaptive_cells import continued
from study.harness.runner.batch import Work, expand, missing, open_fits
from study.harness.runner.study_refinement import (
    in_blocks,
    input_work,
    own_series,
    refinement_work,
    upcoming,
)
from study.record.record import write_csv
from study.record.store import Store
from study.simulation.job import externals
from study.simulation.tasks import Costs, default_jobs, program_calls
from study.statistics.analysis.analysis_request import on_scale, threshold
from study.statistics.analysis.analysis_result import AnalysisResult
from study.statistics.analysis.power import PlannedVerdicts, fewest_blocks, planned_verdicts

if TYPE_CHECKING:
    import pandas as pd


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


# What a number of specimens can show, before they are tested: probability of a claim, and cost.

#: Numbers of specimens that are compared.
COUNTS = (1, 2, 3, 4, 5, 6, 8, 10, 15, 20)
#: Scatter between specimens over the difference that matters, where nothing is known of it.
ASSUMED = (0.1, 0.3, 1.0)


@dataclass(frozen=True)
class ContrastDetection:
    """What specimens can show of one response."""

    #: Of the response and of its differences.
    response: str
    unit: str
    #: Whether differences are ratios; ``practical``, ``sd`` and ``u`` are then logarithms.
    ratio: bool
    practical: float
    #: Standard deviation over specimens of a difference between two cells.
    sd: float
    source: str
    #: Bound of the numerical error that is reckoned with.
    u: float
    #: One for each number of specimens.
    rows: tuple[PlannedVerdicts, ...]
    #: Fewest specimens for a probability of the right claim.
    enough: tuple[tuple[float, int | None], ...]


@dataclass(frozen=True)
class Power:
    """What a design can detect, response by response, and what could not be said."""

    study: str
    blocks: int
    detections: tuple[ContrastDetection, ...]
    warnings: tuple[str, ...]


def power(
    design: Design | str | Path,
    *,
    sd: float | Mapping[str, float] | None = None,
    data: str | Path | None = None,
    results: str | Path = RESULTS,
    overrides: Sequence[str] = (),
    counts: Sequence[int] = COUNTS,
) -> Power:
    """Say what numbers of specimens can detect, and at which cost.

    Parameters
    ----------
    design : Design, str or Path
        The study.
    sd : float or mapping of str to float, optional
        Standard deviation over specimens of a difference between two cells, in the unit of the
        response, for all responses or by their names. By default that of the study's own results;
        without them three are assumed.
    data : str or Path, optional
        Folder that measurement files are relative to.
    results : Path
        Folder of the results, which give the scatter where the study has run.
    overrides : sequence of str
        Keys of the design with other values.
    counts : sequence of int
        Numbers of specimens to compare.

    Returns
    -------
    Power
        For every response and scatter, the probability of each verdict and the cost.

    Raises
    ------
    InputError
        For a faulty design, or a design none of whose responses says what matters.
    """
    loaded = load_design(design, overrides)
    names = [response.name for response in loaded.responses]
    scatter = {} if sd is None else sd if isinstance(sd, Mapping) else dict.fromkeys(names, sd)
    for name, value in scatter.items():
        if name not in names:
            raise InputError(Fault("--sd", f"{name!r} is no response", nearest(name, names)))
        if not (math.isfinite(value) and value > 0):
            raise InputError(Fault("--sd", f"must be a positive number, got {value!r}"))
    warnings: list[str] = []
    blocks, seconds = _planned(loaded, design_root(loaded, data), warnings)
    detections: list[ContrastDetection] = []
    for response in loaded.responses:
        if response.practical is None:
            warnings.append(f"{response.name}: nothing says which difference matters")
            continue
        spread = scatter.get(response.name)
        detections += _detections(loaded, response, spread, results, seconds, counts, warnings)
    if not detections and all(r.practical is None for r in loaded.responses):
        mend = 'write, for example, practical = "2 pp" in its [[response]]'
        raise InputError(Fault("response", "none says which difference matters", mend))
    return Power(loaded.name, blocks, tuple(detections), tuple(warnings))


def _planned(design: Design, root: Path, warnings: list[str]) -> tuple[int, float | None]:
    """Blocks of the measurements, and seconds of one case on all workers."""
    try:
        work = expand(design, root)
    except MissingDataError as error:
        warnings.append(f"no cost, for the measurements are missing: {error}")
        return 0, None
    costs = Costs()
    seconds = costs.total_seconds(list(work.fits.values()), work.jobs, default_jobs())
    return max(len(work.blocks), 1), seconds / max(len(work.jobs), 1)


def _detections(
    design: Design,
    response: ResponseSpec,
    sd: float | None,
    results: str | Path,
    seconds: float | None,
    counts: Sequence[int],
    warnings: list[str],
) -> list[ContrastDetection]:
    known_scatter = _known(design, response, results)
    practical = _practical(response, known_scatter)
    if practical is None:
        warnings.append(
            f"{response.name}: its practical difference is a share of a mean that no result gives "
            "yet; run the design once, or state it in the unit of the response"
        )
        return []
    u = 0.0 if known_scatter is None else known_scatter[1]
    choices = [(share * practical, f"assumed: {share:g} of what matters") for share in ASSUMED]
    if sd:
        choices = [(sd, "as given")]
    elif known_scatter is not None:
        choices = [(known_scatter[0], "of the results")]
    cells = len(design.treatments)
    powers = (0.8, 0.9)
    return [
        ContrastDetection(
            response.name,
            "pp" if response.unit == "%" else response.unit,
            response.transform == "log",
            practical,
            spread,
            source,
            u,
            planned_verdicts(counts, spread, practical, u=u, cells=cells, seconds=seconds),
            tuple(zip(powers, fewest_blocks(spread, practical, u=u, powers=powers), strict=True)),
        )
        for spread, source in choices
        if spread
    ]


def _practical(response: ResponseSpec, scatter: tuple[float, float, float] | None) -> float | None:
    limit = threshold(response.practical)
    # without a mean a share is known on the logarithm alone, and a difference off it alone
    if limit is None or (scatter is None and limit.relative != (response.transform == "log")):
        return None
    return on_scale(limit, 1.0 if scatter is None else scatter[2], response.transform)


def _known(
    design: Design, response: ResponseSpec, results: str | Path
) -> tuple[float, float, float] | None:
    """Scatter of a difference over specimens, numerical bound and mean, from stored results."""
    folder = Path(results) / design.name
    if not folder.is_dir():
        return None
    try:
        analysis: AnalysisResult = api.analyze(str(folder), response.name)
    except StudyError:
        return None
    spread = _scatter(analysis)
    if spread is None or analysis.grand_mean is None:
        return None
    u = max((e.u_num for e in analysis.effects if e.u_num is not None), default=0.0)
    log = analysis.request.scale.transform == "log"
    return spread, u / analysis.grand_mean if log else u, analysis.grand_mean


def _scatter(analysis: AnalysisResult) -> float | None:
    """Largest standard deviation over blocks of a simple effect, on the working scale."""
    from scipy.special import stdtrit

    if analysis.error_term.source != "E1":
        return None
    blocks = analysis.residuals["block"].nunique()
    t = float(stdtrit(blocks - 1, 1 - analysis.request.alpha / 2))
    change = math.log if analysis.request.scale.transform == "log" else float
    halves = [
        (change(e.ci[1]) - change(e.ci[0])) / 2
        for effect in analysis.effects
        for e in effect.simple_effects
        if e.ci is not None
    ]
    return max(halves) * math.sqrt(blocks) / t if halves else None
