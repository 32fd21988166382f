"""Run a study, report it, verify its report: everything from stored records."""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from study.api.assemble import Study, report_data
from study.api.comparison import compare
from study.api.opened_study import count_cases, opened
from study.api.opened_study import load as load_study
from study.api.predicting import Permission
from study.execution.local import Executor, Worker, check_limit, uncollected
from study.external.command import Function, PythonFunction, check_allowed
from study.ground.errors import (
    Fault,
    InputError,
    RefusedError,
    StoppedError,
    StudyError,
    WriteError,
)
from study.ground.files import own_folder
from study.harness.design.load import (
    REPORTS,
    RESULTS,
    demo_design,
    design_root,
    finished_manifest,
    load_design,
    loads,
    results_folder,
)
from study.harness.design.spec import Design
from study.harness.runner.adaptive_cells import continued, run_adaptive
from study.harness.runner.batch import (
    WARN,
    Progress,
    Work,
    check_choice,
    check_stale,
    expand,
    in_phase,
    manifest_of,
    mixed_meshes,
    noted_progress,
    run_batch,
)
from study.harness.runner.record_analysis import effects_by_depth
from study.harness.runner.study_refinement import compare_spaces, validate
from study.harness.runner.study_refinement import refine as refine_study
from study.record.record import are_imported
from study.record.store import Store, is_same
from study.reporting.figures.axes import load_libraries
from study.reporting.output import write as provenance
from study.reporting.output.page import DETAILS
from study.reporting.output.write import Difference, Verification, checked_formats, main_file, write
from study.simulation.job import Allowed, externals, placed_files
from study.simulation.provenance import versions
from study.simulation.tasks import Engine, computing_on, default_jobs, memory_of, processes
from study.simulation.virtual_specimens import usual_generator, write_virtual

#: cases from which on a second process draws a part of the figures
MANY_CASES = 200


@dataclass
class _Clock:
    parts: dict[str, float] = field(default_factory=dict)
    last: float = field(default_factory=time.monotonic)
    #: What was run.
    work: Work | None = None

    def mark(self, name: str) -> None:
        now = time.monotonic()
        self.parts[name] = self.parts.get(name, 0.0) + now - self.last
        self.last = now


def run(
    design: Design | Mapping[str, object] | str | Path,
    *,
    data: str | Path | None = None,
    jobs: int | None = None,
    results: str | Path = RESULTS,
    reports: str | Path | None = REPORTS,
    overrides: Sequence[str] = (),
    progress: Callable[[Progress], None] | None = None,
    timeout_s: float | None = None,
    refine: bool = True,
    formats: Sequence[str] = (),
    allow_commands: bool | str = False,
    forward: Function | None = None,
    version: str = "",
    stale: str = WARN,
    memory: str | None = None,
    engine: Engine | None = None,
    confirm: bool = False,
) -> Study:
    """Compute what is missing of a study, then analyze and report it.

    Running again resumes: nothing that is finished is computed twice.

    Parameters
    ----------
    design : Design, mapping, str or Path
        The study, its file, or the tables of one: the keys of the file, with texts that have a
        unit or numbers in mm, N, MPa and deg.
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
    stale : {"warn", "refuse", "rerun"}
        What becomes of results that other versions of the libraries made: they are used and it is
        said, nothing is computed, or they are computed again. ``"refuse"`` also stops for results
        of another design, other data or other code, which are computed again otherwise.
    memory : str, optional
        Memory that computations may take together, such as ``"20 GB"``, by their prediction; by
        default what the machine has free. One that needs more runs alone.
    engine : str, Path, distributed.Client or Executor, optional
        Where to compute instead of processes of this machine: the address or the scheduler file
        of a Dask cluster, a client of one, or an executor. Results do not depend on it.
    confirm : bool
        Whether the extremes of factors that are numbers are run where these are said to matter:
        the claim waits for them.

    Returns
    -------
    Study
        Records, analyses, numerical uncertainty and the report; ``to_frame()``, ``plot()``, and
        verdicts in a notebook.

    Raises
    ------
    InputError
        For a faulty design or faulty data; nothing is written then.
    RefusedError
        If the design runs programs that nobody allowed, or that are not there; if results are
        stale and that is to be refused; if versions of the cluster's workers differ from those of
        this machine.
    SchedulerLostError
        If the scheduler is lost in the middle; what is finished is kept.
    """
    clock = _Clock()
    check_limit(timeout_s)
    check_choice(stale)
    room = None if memory is None else memory_of(memory)
    loaded = load_design(design, overrides)
    function = None if forward is None else PythonFunction.of(forward, version)
    allowed = Allowed(allow_commands, function)
    if reports is not None:
        checked_formats(formats or loaded.report.format)
    root = design_root(loaded, data)
    warnings: list[str] = []
    store = Store(own_folder(Path(results), loaded.name), warn=warnings.append)
    with uncollected():
        if loaded.scheme.sequential is not None:
            loaded = continued(loaded, store)
        work = expand(loaded, root, allowed)
    check_allowed(externals(job.case.problem for job in work.jobs), allow_commands)
    clock.mark("reading")
    # one executor for cells and refined cases alike, so that all of them fit into the memory
    executor = processes(jobs, timeout_s, room)
    if engine is not None:
        read = {Path(f.path) for job in work.jobs for f in placed_files(job.case.cell)}
        executor = computing_on(engine, jobs, timeout_s, sorted(read))
    with store.lock():
        present = store.read_manifest()
        if present is not None and are_imported(present["notes"]):
            rule = "holds runs that were imported, which a run of a design would replace"
            raise InputError(Fault(str(store.path), rule, "give the design another [study] name"))
        warnings += check_stale(work, store, stale)
        store.begin_run(manifest_of(work))
        with _records_written():
            work, computed = _compute(
                work, store, clock, executor, noted_progress(store, progress), refine,
                lambda design: expand(design, root, allowed),
            )  # fmt: skip
            _finish(store, work, clock.parts, computed)
            clock.work = work
            warnings += mixed_meshes(work, store)
    if confirm:
        of_runs = in_phase(progress or (lambda _: None), "confirming runs")
        warnings += _confirmed(store, Permission(data, allowed, of_runs))
        clock.mark("confirming runs")
    with _records_written():
        return report(
            store.path, reports=reports, formats=formats, extra_warnings=warnings, began=clock
        )


#: times that extremes are run: a run that joins a surface moves them
_CONFIRMING = 3


def _confirmed(store: Store, may: Permission) -> list[str]:
    """Run the extremes that verdicts over numbers rest on; say which of these runs failed."""
    failed: dict[str, str] = {}
    for _ in range(_CONFIRMING):
        unconfirmed, count = load_study(store.path), 0
        for surface in unconfirmed.surfaces:
            for settings in surface.unconfirmed:
                at: dict[str, float | str] = {**settings, **surface.labels}
                number = {k: f"{v:.4g}" for k, v in settings.items()}
                where = ", ".join(f"{k} {v}" for k, v in {**number, **surface.labels}.items())
                lost = [r.message for r in may.confirm(unconfirmed, at) if not r.converged]
                count += where not in failed
                if lost:
                    failed[where] = lost[0]
        if not count:
            break
    why = "a confirming run failed, so what it would confirm stays open"
    return [f"{why}: {where}: {message}" for where, message in failed.items()]


@contextmanager
def _records_written() -> Iterator[None]:
    """Context in which a file that cannot be written stops a run that has written others."""
    try:
        yield
    except WriteError as error:
        raise error if isinstance(error, StoppedError) else StoppedError(str(error)) from error


def _compute(
    work: Work,
    store: Store,
    clock: _Clock,
    executor: Executor,
    progress: Callable[[Progress], None],
    refine: bool,
    expanded: Callable[[Design], Work],
) -> tuple[Work, int]:
    """Cases, then what says how far they can be trusted."""
    computed = run_batch(work, store, executor, progress)
    if work.design.scheme.sequential is not None:
        work, computed = run_adaptive(
            work, store, computed,
            lambda part: run_batch(part, store, executor, progress), expanded,
            lambda part: store.begin_run(manifest_of(part)),
        )  # fmt: skip
    plain = work.plain()
    clock.mark("simulation" if work.design.is_alone else "calibration and simulation")
    if not refine:
        return work, computed
    if all(job.case.problem.is_homogeneous for job in plain.jobs):  # no mesh and no step matters
        with store.lock():
            store.write_rows("numerical", [])
    else:
        refine_study(plain, store, executor, in_phase(progress, "finer meshes"))
        compare_spaces(plain, store, executor, in_phase(progress, "control"))
    clock.mark("mesh refinement")
    if work.design.uncertainty and work.design.is_measured:
        validate(plain, store, executor, in_phase(progress, "uncertain inputs"))
        clock.mark("uncertain inputs")
    return work, computed


def _finish(store: Store, work: Work, timings: Mapping[str, float], computed: int) -> None:
    """Publish this run to all readers; one without a new result keeps stored times and versions."""
    meta, manifest = manifest_of(work), store.read_manifest()
    if manifest is not None and is_same(manifest, meta):
        spent = dict(manifest.get("timings", {}))
        if not computed:
            meta |= {"timings": spent, "versions": manifest.get("versions", meta["versions"])}
            store.finish_run(meta)
            return
        # a resumed run adds to what the interrupted one took
        timings = {k: spent.get(k, 0.0) + v for k, v in timings.items()}
    store.finish_run(meta | {"timings": dict(timings)})


def report(
    path: str | Path | Study,
    *,
    reports: str | Path | None = REPORTS,
    results: str | Path = RESULTS,
    formats: Sequence[str] = (),
    beside: str | Path | None = None,
    extra_warnings: Sequence[str] = (),
    began: _Clock | None = None,
) -> Study:
    """Analyze the stored records of a study and write its report.

    A figure or page that cannot be made never costs the numbers: the failure is a warning.

    Parameters
    ----------
    path : str, Path or Study
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
        Clock and design of the run that the report ends.

    Returns
    -------
    Study
        The study with its report.

    Raises
    ------
    InputError
        If one of the studies has no results, or they have nothing in common.
    """
    if formats:
        checked_formats(formats)
    clock = began or _Clock()
    before = path if isinstance(path, Study) else results_folder(path, results)
    many = reports is not None and count_cases(before) >= MANY_CASES
    drawing = many and default_jobs() > 1
    with Worker(load_libraries) if drawing else nullcontext() as worker:
        with uncollected():
            study = before if isinstance(before, Study) else opened(before, clock.work)
        if beside is not None:
            study = replace(study, beside=compare(study, load_study(beside, results)))
        study = replace(study, warnings=tuple(dict.fromkeys([*extra_warnings, *study.warnings])))
        clock.mark("statistics")
        if reports is None:
            return study
        formats_asked = tuple(formats) or study.design.report.format
        timings = dict(study.manifest.get("timings", {}))
        if began is not None:
            timings["statistics"] = clock.parts["statistics"]
        try:
            folder = own_folder(Path(reports), study.design.name)
            written = _written(study, timings, folder, formats_asked, worker, extra_warnings)
        except (InputError, RefusedError):
            raise
        except Exception as error:  # noqa: BLE001 - drawing must never cost the numbers (F38)
            kind = "" if isinstance(error, StudyError) else f"{type(error).__name__}: "
            message = f"the report could not be written: {kind}{error}"
            return replace(study, warnings=(*study.warnings, message))
    return replace(study, report=written)


def _written(
    study: Study,
    timings: Mapping[str, float],
    folder: Path,
    formats: Sequence[str],
    worker: Worker | None,
    of_run: Sequence[str] = (),
) -> Path:
    """Write a report and name its main file; one that would be the same again stays as it is."""
    name, formats_checked = study.design.name, checked_formats(formats)
    made_from = provenance.made_of(study.folder, [*formats_checked, *study.warnings], versions())
    # of a second study beside it nothing is known here: such a report is made every time
    if study.beside is None and provenance.is_kept(folder, name, made_from):
        return main_file(folder, name, formats_checked)
    provenance.forget(folder, name)
    depths = effects_by_depth(study.design, study.records, study.numerical)
    data = replace(report_data(study), timings=timings, depths=depths)
    written = write(data, folder, formats_checked, worker)
    if study.beside is None:
        provenance.keep(folder, name, made_from, of_run)
    return written


def demo(
    *,
    results: str | Path = RESULTS,
    reports: str | Path | None = REPORTS,
    jobs: int | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Study:
    """Run the embedded study on virtual specimens, from generated data to the report."""
    design = demo_design()
    folder = Path(results) / design.name / "measurements"
    spec = design.identification.measurements
    if spec is None or spec.file is None:
        raise RuntimeError("the embedded design names no measurement file")
    if not (folder / spec.file).is_file():
        write_virtual(design, folder, usual_generator(design, truth_name="humphrey"))
    return run(design, data=folder, jobs=jobs, results=results, reports=reports, progress=progress)


# ``study verify REPORT``: every number of a report once more, from the records alone.
#
# The report is written again into a folder of its own and compared with the one that stands: page,
# tables, figures and their data, number by number. The records are checked against their own sums,
# and a sample of cases can be solved again from nothing.


#: relative difference of numbers that another processor or other libraries have added up
OTHER_ARITHMETIC = 1e-9

#: relative difference of a response that was solved again: the tolerance of fit and solver
SOLVED_AGAIN = 1e-5


def verify(
    path: str | Path,
    *,
    results: str | Path = RESULTS,
    reports: str | Path = REPORTS,
    resolve: int = 0,
    seed: int = 1,
    data: str | Path | None = None,
    allow_commands: bool | str = False,
    tolerance: float | None = None,
) -> Verification:
    """Compute every number of a report again from its records; ``resolve`` cases from nothing.

    The tolerance is the relative difference of numbers that is passed over: by default none where
    the report was written with the libraries and on the kind of processor of this machine, else
    1e-9, for sums of the same numbers differ in their last digits there.
    """
    page = _page(Path(path), Path(reports))
    folder = results_folder(page.parent.name, results)
    if tolerance is None:
        then = provenance.noted(page.parent, page.stem).get("arithmetic")
        tolerance = 0.0 if then == provenance.arithmetic() else OTHER_ARITHMETIC
    verification = Verification(tolerance=tolerance)
    _check_records(folder, verification)
    _compare_report(page, folder, verification)
    if resolve > 0:
        _solve_again(folder, verification, resolve, seed, data, Allowed(allow_commands))
    return verification


def _page(path: Path, reports: Path) -> Path:
    """Page of a report, named by itself, by its folder, or by the study."""
    if os.path.isfile(path):  # of what may not be read nothing is known
        return path.with_stem(path.stem.removesuffix(DETAILS)).resolve()
    for folder in (path, reports / path.name):
        written = sorted(folder.glob("*.html")) if os.path.isdir(folder) else []
        pages = [p for p in written if not p.stem.endswith(DETAILS)]
        if len(pages) == 1:
            return pages[0].resolve()
    mend = "name a folder such as reports/NAME, or write the report: study report NAME"
    raise InputError(Fault(str(path), "there is no page of a report there", mend))


def _check_records(folder: Path, verification: Verification) -> None:
    """Compare every record with its own sum, and with the case that it was written for."""
    warnings: list[str] = []
    store = Store(folder, warn=warnings.append)
    manifest = finished_manifest(store)
    for case_id, input_hash in manifest["cases"].items():
        verification.records += 1
        record = store.read(case_id)
        differs = None
        if record is None:
            differs = Difference(f"record {case_id}", "damaged or missing", "whole")
        elif record.input_hash != input_hash:
            differs = Difference(f"record {case_id}: input", record.input_hash, input_hash)
        verification.differences += [differs] if differs else []


def _compare_report(page: Path, folder: Path, verification: Verification) -> None:
    with tempfile.TemporaryDirectory(prefix="study-verify-") as temporary:
        formats = ["html", *(["tex"] if list(page.parent.glob("*.tex")) else [])]
        of_run = provenance.noted(page.parent, page.stem).get("warnings")
        again = report(
            load_study(folder, tell_unfinished=False), reports=Path(temporary), formats=formats,
            extra_warnings=[*map(str, of_run)] if isinstance(of_run, list) else (),
        )  # fmt: skip
        if again.report is None:
            raise InputError(f"{folder}: {'; '.join(again.warnings)}")
        provenance.compare_reports(page.parent, again.report.parent, verification)


def _solve_again(
    folder: Path,
    verification: Verification,
    count: int,
    seed: int,
    data: str | Path | None,
    allowed: Allowed,
) -> None:
    """Solve a sample of the cases in an empty store and compare their responses."""
    store = Store(folder)
    manifest = finished_manifest(store)
    design = loads(manifest["design"], manifest["source"])
    work = expand(design, design_root(design, data), allowed)
    stored = store.by_case(manifest["cases"])
    solved = [job for job in work.jobs if (r := stored.get(job.case.case_id)) and r.converged]
    size = min(count, len(solved))
    drawn = sorted(np.random.default_rng(seed).choice(len(solved), size, replace=False).tolist())
    part = replace(work, jobs=tuple(solved[k] for k in drawn))
    with tempfile.TemporaryDirectory(prefix="study-verify-") as temporary:
        again = Store(Path(temporary))
        run_batch(part, again, processes(1))
        fresh = again.by_case(part.input_hashes)
    for job in part.jobs:
        verification.solved += 1
        old = stored[job.case.case_id]
        new = fresh.get(job.case.case_id)
        for name in old.responses:
            first, second = old.value(name), None if new is None else new.value(name)
            if name == "seconds" or first == second:
                continue
            if first is None or second is None or not math.isclose(
                first, second, rel_tol=SOLVED_AGAIN, abs_tol=1e-9
            ):  # fmt: skip
                where = f"case {old.case_id} solved again: {name}"
                verification.differences.append(Difference(where, str(first), str(second)))
