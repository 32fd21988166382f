"""What a study will do, and what it has done."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from study.api.comparison.design_changes import run_changes
from study.api.folders import RESULTS, design_root, finished_manifest, results_folder
from study.api.planning.remaining_time import (
    control_seconds,
    controls_of,
    refinement_seconds,
    seconds_left,
)
from study.api.planning.sequential_design import continued
from study.design.load import load
from study.design.overview import Overview, overview
from study.design.spec import Design
from study.errors import MissingDataError
from study.forward.external import common_digest
from study.record.document import ManifestDocument
from study.record.store import Store
from study.record.survey import Survey
from study.runner.batch import missing, open_fits
from study.runner.cost import Costs, program_calls
from study.runner.expansion import expand
from study.runner.fitting.external_model import externals
from study.runner.tasks import default_jobs

if TYPE_CHECKING:
    from study.runner.job import Work


@dataclass(frozen=True)
class Plan:
    """A design before it runs.

    Parameters
    ----------
    design : Design
    overview : Overview
        Matrix, exclusions, what each factor can tell.
    blocks : tuple of str
        Empty without blocks, or where the data cannot be read.
    total, done, failed, missing : int
        Cases.
    fits : int
        Calibrations still to be made.
    predicted_seconds : float or None
        Wall time of what is missing; None where the data are not there yet.
    memory_MB : float or None
        Predicted peak of all workers together.
    controls : int
        Solutions still to be made besides the cases: the same cylinder in both spaces.
    program_calls : int
        Calls of other programs, those of gradients by differences included.
    commands : tuple of str
        What they run.
    digest : str
        Name of all of it, which ``study run --allow-digest`` takes.
    most_seconds : float or None
        Wall time if the whole budget of an adaptive design is spent; None for any other design.
    """

    design: Design
    overview: Overview
    blocks: tuple[str, ...]
    total: int
    done: int
    failed: int
    missing: int
    fits: int
    predicted_seconds: float | None
    memory_MB: float | None  # noqa: N815
    jobs: int
    warnings: tuple[str, ...]
    controls: int = 0
    program_calls: int = 0
    commands: tuple[str, ...] = ()
    digest: str = ""
    most_seconds: float | None = None

    @property
    def counts(self) -> dict[str, int]:
        """Cases: all, and those that are done, failed and missing."""
        return {
            "total": self.total,
            "done": self.done,
            "failed": self.failed,
            "missing": self.missing,
        }

    def to_json(self) -> dict[str, object]:
        """Document of ``study plan --json``."""
        return {
            "study": self.design.name,
            "cases": self.counts,
            "predicted_seconds": self.predicted_seconds,
            "report": None,
            "verdicts": [],
            "warnings": list(self.warnings),
            "blocks": list(self.blocks),
            "fits": self.fits,
            "controls": self.controls,
            "memory_MB": self.memory_MB,
            "program_calls": self.program_calls,
            "commands": list(self.commands),
            "commands_digest": self.digest,
            "design": self.overview.to_json(),
            **self._adaptive(),
        }

    def _adaptive(self) -> dict[str, object]:
        """How cells are added, where they are."""
        rule = self.design.scheme.sequential
        return (
            {} if rule is None else {"adaptive": asdict(rule) | {"most_seconds": self.most_seconds}}
        )


def plan(
    design: Design | str | Path,
    *,
    data: str | Path | None = None,
    results: str | Path = RESULTS,
    overrides: Sequence[str] = (),
    jobs: int | None = None,
) -> Plan:
    """Say what a design computes, what is done already and what the rest will cost.

    Data that are not there yet do not stop a plan: it then counts cells, not cases.

    Parameters
    ----------
    design : Design, str or Path
        The study, or its file.
    data : str or Path, optional
        Folder of the measurements.
    results : str or Path
        Folder of all results; what the study's own holds is not computed again.
    overrides : sequence of str
        ``key=value`` each, laid over the file before it is validated; not used for a Design.
    jobs : int, optional
        Workers by which the wall time is predicted; one a core by default.

    Returns
    -------
    Plan
        Cells, cases, predicted time in s and memory in MB; no time where measurements are missing.

    Raises
    ------
    InputError
        For a faulty design or faulty data.
    """
    loaded = design if isinstance(design, Design) else load(design, overrides)
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
    found = _counted(work, described, Store(Path(results) / loaded.name, warn=warnings.append),
                     workers, warnings)  # fmt: skip
    return replace(found, most_seconds=_most_seconds(work, found.predicted_seconds, workers))


def _most_seconds(work: Work, predicted: float | None, workers: int) -> float | None:
    """Wall time with all cells that an adaptive design may add, each like those that it has."""
    rule = work.design.scheme.sequential
    if rule is None or predicted is None:
        return None
    own = Costs().total_seconds(work.fits.values(), work.jobs, workers)
    more = rule.budget - len(work.design.treatments)
    return predicted + own * more / len(work.design.treatments)


def _counted(
    work: Work, described: Overview, store: Store, workers: int, warnings: list[str]
) -> Plan:
    warnings += [*work.cautions, *_idle_replicates(work)]
    found = store.survey(work.input_hashes)
    todo = missing(work, store)
    fits = open_fits(todo, store)
    costs = Costs()
    controls = controls_of(work, store)
    seconds = costs.total_seconds(fits, todo, workers)
    seconds += refinement_seconds(work, store, workers)
    seconds += control_seconds(controls, workers)
    found_models = externals(job.case.config for job in work.jobs)
    commands = [one for one in found_models if one.section.model == "command"]
    memory = workers * max(
        (costs.memory_MB(job.case.config) for job in [*todo, *controls]), default=0.0
    )
    return Plan(
        work.design, described, work.blocks, len(work.jobs), len(found.done),
        len(found.failed), len(todo), len(fits), seconds, memory, workers, tuple(warnings),
        len(controls), program_calls(fits, todo),
        tuple(line for one in commands for line in one.lines()), common_digest(commands),
    )  # fmt: skip


def _idle_replicates(work: Work) -> list[str]:
    """Say that blocks come before replicates as an error term, where that was not changed."""
    design = work.design
    asked = design.replicates.noise or design.replicates.mesh_seeds
    if not asked or len(work.blocks) < 2 or design.analysis.error == "replicates":
        return []
    return [
        f"the {len(work.blocks)} blocks are the better error term (E1) and decide; for that of "
        'the replicates write [analysis] error = "replicates", or leave them out'
    ]


def status(path: str | Path, *, results: str | Path = RESULTS) -> dict[str, Any]:
    """Progress of a study, from any shell.

    Parameters
    ----------
    path : str or Path
        Results folder, design file or name of the study.
    results : str or Path
        Folder of all results, where ``path`` is a name or a design file.

    Returns
    -------
    dict
        The document of ``study status --json``, with ``running`` (pid, host, since, and what its
        progress line said last) or None; the predicted seconds are those that are left. Counted
        are the cases of the last finished run; ``unfinished`` says how far a later one is, of an
        edited design, and what was edited.
    """
    folder = results_folder(path, results)
    warnings: list[str] = []
    store = Store(folder, warn=warnings.append)
    manifest = finished_manifest(store)
    found, later = store.survey(manifest["cases"]), store.read_unfinished()
    running = store.running()
    return {
        "study": manifest["name"],
        "cases": _counts(found),
        "predicted_seconds": seconds_left(running),
        "report": None,
        "verdicts": [],
        "warnings": warnings,
        "failures": dict(Counter(found.statuses.values())),
        "running": running,
        "timings": manifest.get("timings", {}),
        "finished": bool(manifest.get("finished", not found.missing)),
        "unfinished": None if later is None else _unfinished(store, manifest, later),
    }


def _counts(found: Survey) -> dict[str, int]:
    """Cases of a study: all, and those that are done, failed and missing."""
    counts = {
        "done": len(found.done), "failed": len(found.failed), "missing": len(found.missing),
    }  # fmt: skip
    return {"total": sum(counts.values()), **counts}


def _unfinished(
    store: Store, manifest: ManifestDocument, later: ManifestDocument
) -> dict[str, object]:
    """Describe a run of an edited design that is not finished, and what was edited."""
    quiet = Store(store.path)
    changed = [one.sentence for one in run_changes(manifest, later)]
    return {"cases": _counts(quiet.survey(later["cases"])), "changed": changed}
