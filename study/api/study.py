"""Run a study, open a finished one, report it: everything from stored records."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from study.api.assemble import report_data
from study.api.comparison.compare import compare
from study.api.comparison.design_changes import read_truths
from study.api.folders import REPORTS, RESULTS, data_root
from study.api.opened_study import open_study
from study.api.planning.adaptive import continued, run_adaptive
from study.api.planning.remaining_time import (
    control_seconds,
    controls_of,
    refinement_seconds,
    with_time_left,
)
from study.api.uncertainty import credibility
from study.api.uncertainty.validation import validate
from study.design.load import dump, load, loads
from study.design.spec import Design
from study.errors import InputError, RefusedError
from study.execution.task import check_limit
from study.forward.external import check_allowed
from study.forward.python_function import Function, PythonFunction
from study.record.store import Store
from study.reporting.output.write import checked_formats, write
from study.runner.batch import default_jobs, run_batch
from study.runner.expansion import expand
from study.runner.fitting.external_model import Allowed, externals
from study.runner.provenance import versions
from study.runner.virtual.specimens import write_virtual
from study.study_result.study_result import StudyResult

if TYPE_CHECKING:
    from study.runner.batch import Progress, Summary
    from study.runner.job import Work

load_design = load


@dataclass
class _Clock:
    parts: dict[str, float] = field(default_factory=dict)
    last: float = field(default_factory=time.monotonic)

    def mark(self, name: str) -> None:
        now = time.monotonic()
        self.parts[name] = self.parts.get(name, 0.0) + now - self.last
        self.last = now


def run(
    design: Design | str | Path,
    *,
    data: str | Path | None = None,
    jobs: int | None = None,
    results: Path = RESULTS,
    reports: Path | None = REPORTS,
    overrides: Sequence[str] = (),
    progress: Callable[[Progress], None] | None = None,
    timeout_s: float | None = None,
    refine: bool = True,
    formats: Sequence[str] = (),
    allow_commands: bool | str = False,
    forward: Function | None = None,
    version: str = "",
) -> StudyResult:
    """Compute what is missing of a study, then analyze and report it.

    Running again resumes: nothing that is finished is computed twice.

    Parameters
    ----------
    design : Design, str or Path
        The study, or its file.
    data : str or Path, optional
        Folder of the measurements.
    jobs : int, optional
        Workers; one a core by default. Results do not depend on it.
    results : Path
        Where records go, in a folder of the study's name.
    reports : Path, optional
        Where the report goes; None writes none.
    overrides : sequence of str
        ``key=value`` each, laid over the file before it is validated.
    progress : callable, optional
        Called after every computation.
    timeout_s : float, optional
        Wall-clock limit of one computation in seconds.
    refine : bool
        Whether the mesh is refined under one block, for the numerical uncertainty.
    formats : sequence of str
        Formats of the report instead of those of the design.
    allow_commands : bool or str
        Whether programs that the design names may run; a text allows those whose digest, as
        ``study plan`` prints it, begins with it.
    forward : callable, optional
        What ``forward.model = "python"`` stands for; to give it is to allow it.
    version : str
        Identity of that function, part of the key of every result.

    Returns
    -------
    StudyResult
        Records, analyses, numerical uncertainty and the report.

    Raises
    ------
    InputError
        For a faulty design or faulty data; nothing is written then.
    RefusedError
        If the design runs programs that nobody allowed, or that are not there.
    """
    clock = _Clock()
    check_limit(timeout_s)
    loaded = design if isinstance(design, Design) else load(design, overrides)
    function = None if forward is None else PythonFunction.of(forward, version)
    allowed = Allowed(allow_commands, function)
    if reports is not None:
        checked_formats(formats or loaded.report.format)
    root = data_root(loaded.source, data)
    warnings: list[str] = []
    store = Store(results / loaded.name, warn=warnings.append)
    work = expand(continued(loaded, store), root, allowed)
    check_allowed(externals(job.case.config for job in work.jobs), allow_commands)
    clock.mark("reading")
    with store.lock():
        _write_manifest(store, work, {}, None)
        work, summary = _compute(
            work, store, clock, jobs, progress, timeout_s, refine,
            lambda design: expand(design, root, allowed),
        )  # fmt: skip
        _write_manifest(store, work, clock.parts, summary)
    return report(
        store.path, reports=reports, formats=formats, extra_warnings=warnings, began=clock
    )


def _compute(
    work: Work,
    store: Store,
    clock: _Clock,
    jobs: int | None,
    progress: Callable[[Progress], None] | None,
    timeout_s: float | None,
    refine: bool,
    expanded: Callable[[Design], Work],
) -> tuple[Work, Summary]:
    """Cases, then what says how far they can be trusted; every part knows what comes after it."""
    workers = jobs or default_jobs()
    finer = refinement_seconds(work, store, workers) if refine else 0.0
    spaces = control_seconds(controls_of(work, store) if refine else (), workers)
    noted = with_time_left(store, progress, finer + spaces)
    work, summary = run_adaptive(
        work,
        store,
        lambda part: run_batch(part, store, jobs=jobs, progress=noted, timeout_s=timeout_s),
        expanded,
        lambda part: _write_manifest(store, part, {}, None),
    )
    plain = work.plain()
    clock.mark("calibration and simulation")
    if not refine:
        return work, summary
    noted = with_time_left(store, progress, spaces)
    credibility.refine(plain, store, jobs, noted, timeout_s)
    credibility.compare_spaces(plain, store, jobs, with_time_left(store, progress, 0.0))
    clock.mark("mesh refinement")
    if work.design.uncertainty and work.design.is_measured:
        validate(plain, store, jobs, progress, timeout_s)
        clock.mark("uncertain inputs")
    return work, summary


def _write_manifest(
    store: Store, work: Work, timings: Mapping[str, float], summary: Summary | None
) -> None:
    known = store.read_manifest()
    spent = dict(known.get("timings", {})) if known is not None else {}
    if summary is not None and summary.computed:
        # a resumed run adds to what the interrupted one took
        spent = {k: spent.get(k, 0.0) + v for k, v in timings.items()}
    with store.lock():
        store.write_manifest(
            {
                "name": work.design.name,
                "design": dump(work.design),
                "text": work.design.text,
                "source": Path(work.design.source).name,
                "cases": work.input_hashes,
                "blocks": list(work.blocks),
                "notes": list(work.notes),
                "files": dict(work.files),
                "virtual": work.virtual,
                "truths": read_truths(work.data.root, work.files),
                "versions": versions(),
                "timings": spent,
            }
        )


def report(
    path: str | Path | StudyResult,
    *,
    reports: Path | None = REPORTS,
    results: Path = RESULTS,
    formats: Sequence[str] = (),
    beside: str | Path | None = None,
    extra_warnings: Sequence[str] = (),
    began: _Clock | None = None,
) -> StudyResult:
    """Analyze the stored records of a study and write its report.

    A figure or page that cannot be made never costs the numbers: the failure is a warning.

    Parameters
    ----------
    path : str, Path or StudyResult
        Results folder, design file, name of the study, or the study itself.
    reports : Path, optional
        Where the report goes; None writes none.
    results : Path
        Folder of the results, where ``path`` is a name.
    formats : sequence of str
        Formats instead of those of the design.
    beside : str or Path, optional
        Another finished study; the report says which conclusions hold in both.
    extra_warnings : sequence of str
        Warnings to be printed with those of the study.
    began : optional
        Clock of the run that the report ends.

    Returns
    -------
    StudyResult
        The study with its report.

    Raises
    ------
    InputError
        If one of the studies has no results, or they have nothing in common.
    """
    if formats:
        checked_formats(formats)
    study = path if isinstance(path, StudyResult) else open_study(path, results)
    if beside is not None:
        study = replace(study, beside=compare(study, open_study(beside, results)))
    study = replace(study, warnings=tuple(dict.fromkeys([*extra_warnings, *study.warnings])))
    if began is not None:
        began.mark("statistics")
    if reports is None:
        return study

    wanted = tuple(formats) or study.design.report.format
    try:
        timings = dict(study.manifest.get("timings", {}))
        if began is not None:
            timings["statistics"] = began.parts.get("statistics", 0.0)
        written = write(report_data(study, timings), reports / study.design.name, wanted)
    except (InputError, RefusedError):
        raise
    except Exception as error:  # noqa: BLE001 - drawing must never cost the numbers (F38)
        message = f"the report could not be written: {type(error).__name__}: {error}"
        return replace(study, warnings=(*study.warnings, message))
    return replace(study, report=written)


def demo(
    *,
    results: Path = RESULTS,
    reports: Path | None = REPORTS,
    jobs: int | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> StudyResult:
    """Run the embedded study on virtual specimens, from generated data to the report."""
    from importlib import resources

    text = resources.files("study.runner").joinpath("demo.toml").read_text(encoding="utf-8")
    design = loads(text, "demo.toml")
    folder = results / design.name / "measurements"
    spec = design.measurements
    if spec is None or spec.file is None:
        raise RuntimeError("the embedded design names no measurement file")
    if not (folder / spec.file).is_file():
        write_virtual(design, folder)
    return run(design, data=folder, jobs=jobs, results=results, reports=reports, progress=progress)
