"""Run a study, open a finished one, report it: everything from stored records."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from study.api.places import REPORTS, RESULTS, data_root, results_folder
from study.design import Design, dump, load, loads
from study.errors import InputError, RefusedError, StudyError
from study.record import SORTED, Record, Store, is_repeat, table

if TYPE_CHECKING:
    import pandas as pd

    from study.reporting.data import ResponseAnalysis
    from study.reporting.data_beside import Beside
    from study.runner.batch import Progress, Summary
    from study.runner.expand import Work
    from study.runner.refine import Numerical

load_design = load


@dataclass(frozen=True)
class StudyResult:
    """A study with everything that its records tell.

    Parameters
    ----------
    design : Design
        As it was run.
    records : tuple of Record
        One a case, in the order of the design; cases not computed yet are absent.
    total : int
        Number of cases of the design.
    analyses : tuple of ResponseAnalysis
        One for every response of the design.
    numerical : tuple of Numerical
        Numerical uncertainty of every response for every discretization.
    manifest : mapping
        What else is stored of the run: blocks, notes, timings, versions.
    report : Path or None
        The report, once written.
    validation : tuple of mapping
        E and u_val of every case along its curve, where inputs are uncertain.
    spaces : tuple of mapping
        How far 3D and axisymmetric space differ on a cylinder.
    beside : Beside, optional
        Which of its conclusions hold in another study too.
    """

    design: Design
    folder: Path
    records: tuple[Record, ...]
    total: int
    analyses: tuple[ResponseAnalysis, ...]
    numerical: tuple[Numerical, ...]
    manifest: Mapping[str, Any]
    warnings: tuple[str, ...] = ()
    report: Path | None = None
    predicted_seconds: float = 0.0
    validation: tuple[Mapping[str, Any], ...] = ()
    spaces: tuple[Mapping[str, Any], ...] = ()
    beside: Beside | None = None

    @property
    def table(self) -> pd.DataFrame:
        """One tidy row a case, failed ones included."""
        return table(list(self.records))

    @property
    def plain(self) -> tuple[Record, ...]:
        """Records without replicates: one mesh a cell, the curve as measured."""
        return tuple(record for record in self.records if not is_repeat(record.extra))

    @property
    def failed(self) -> int:
        """Number of cases without an answer."""
        return sum(not record.converged for record in self.records)

    @property
    def verdicts(self) -> list[dict[str, Any]]:
        """One verdict for every response and term."""
        results = [a.result for a in self.analyses if a.result is not None]
        return [row for result in results for row in result.verdicts()]

    def to_json(self) -> dict[str, Any]:
        """Document of ``study run --json``."""
        done = len(self.records) - self.failed
        found = {
            "study": self.design.name,
            "cases": {
                "total": self.total,
                "done": done,
                "failed": self.failed,
                "missing": self.total - len(self.records),
            },
            "predicted_seconds": self.predicted_seconds,
            "report": None if self.report is None else str(self.report),
            "verdicts": self.verdicts,
            "warnings": list(self.warnings),
        }
        if self.beside is not None:
            from study.api.compare import document

            found["beside"] = document(self.beside)
        return found


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
    reports : Path, optional
        Where the report goes; None writes none.
    refine : bool
        Whether the mesh is refined under one block, for the numerical uncertainty.

    Raises
    ------
    InputError
        For a faulty design or faulty data; nothing is written then.
    """
    from study.runner.expand import expand

    clock = _Clock()
    loaded = design if isinstance(design, Design) else load(design, overrides)
    work = expand(loaded, data_root(loaded.source, data))
    clock.mark("reading")
    warnings: list[str] = []
    store = Store(results / loaded.name, warn=warnings.append)
    with store.lock():
        _write_manifest(store, work, {}, None)
        summary = _compute(work, store, clock, jobs, progress, timeout_s, refine)
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
) -> Summary:
    """Cases, then what says how far they can be trusted; every part knows what comes after it."""
    from study.api import credibility, remaining
    from study.runner.batch import default_jobs, run_batch

    workers, plain = jobs or default_jobs(), work.plain()
    finer = remaining.refinement_seconds(work, store, workers) if refine else 0.0
    spaces = remaining.control_seconds(remaining.controls(work, store) if refine else (), workers)
    noted = remaining.noted(store, progress, finer + spaces)
    summary = run_batch(work, store, jobs=jobs, progress=noted, timeout_s=timeout_s)
    clock.mark("calibration and simulation")
    if not refine:
        return summary
    noted = remaining.noted(store, progress, spaces)
    credibility.refine(plain, store, jobs, noted, timeout_s)
    credibility.compare_spaces(plain, store, jobs, remaining.noted(store, progress, 0.0))
    clock.mark("mesh refinement")
    if work.design.uncertainty:
        from study.api.validation import validate

        validate(plain, store, jobs, progress, timeout_s)
        clock.mark("uncertain inputs")
    return summary


def _write_manifest(
    store: Store, work: Work, timings: Mapping[str, float], summary: Summary | None
) -> None:
    from study.api.changes import read_truths
    from study.runner.identity import versions

    known = store.read_manifest() or {}
    spent = dict(known.get("timings", {}))
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


def open_study(path: str | Path, results: Path = RESULTS) -> StudyResult:
    """Open the stored records of a study and analyze them.

    Raises
    ------
    InputError
        If there are none.
    """
    from study.api.convergence_cells import stored_cells
    from study.runner.refine import Numerical

    folder = results_folder(path, results)
    warnings: list[str] = []
    store = Store(folder, warn=warnings.append)
    manifest = store.read_manifest()
    if manifest is None:
        raise InputError(f"{folder}: its manifest is damaged; run the design again")
    design = loads(manifest["design"], manifest["source"])
    records = tuple(store.records(manifest["cases"]))
    rows = [*(store.read_json("numerical") or []), *stored_cells(store, manifest["cases"])]
    numerical = tuple(Numerical(**row) for row in rows)
    missing = len(manifest["cases"]) - len(records)
    warnings += [note for note in manifest["notes"] if SORTED in note]
    if missing:
        warnings.append(f"{missing} of {len(manifest['cases'])} cases are not computed yet")
    analyses = _analyses(design, records, numerical)
    warnings += [f"{a.name}: {a.refused}" for a in analyses if a.refused]
    return StudyResult(
        design, folder, records, len(manifest["cases"]), analyses, numerical, manifest,
        tuple(dict.fromkeys(warnings)), validation=tuple(store.read_json("validation") or ()),
        spaces=tuple(store.read_json("spaces") or ()),
    )  # fmt: skip


def _analyses(
    design: Design, records: Sequence[Record], numerical: Sequence[Numerical]
) -> tuple[ResponseAnalysis, ...]:
    """Analyze every response of a design; a refusal is kept as its reason."""
    from study.analysis import threshold
    from study.api.statistics import analyze_records
    from study.reporting.data import ResponseAnalysis

    found = []
    for response in design.responses:
        limit = threshold(response.practical)
        result, refused = None, ""
        try:
            result = analyze_records(design, records, response, numerical)
        except StudyError as error:
            refused = str(error)
        better = "lower" if response.name.endswith("_error") or response.name == "seconds" else ""
        found.append(
            ResponseAnalysis(
                response.name,
                response.unit,
                result,
                None if limit is None else limit.value,
                limit is not None and limit.relative,
                response.transform,
                None if result is None else result.u_num,
                better,
                refused=refused,
            )
        )
    return tuple(found)


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
    formats : sequence of str
        Formats instead of those of the design.
    beside : str or Path, optional
        Another finished study; the report says which conclusions hold in both.

    Raises
    ------
    InputError
        If one of the studies has no results, or they have nothing in common.
    """
    from dataclasses import replace

    study = path if isinstance(path, StudyResult) else open_study(path, results)
    if beside is not None:
        from study.api.compare import compare

        study = replace(study, beside=compare(study, open_study(beside, results)))
    study = replace(study, warnings=tuple(dict.fromkeys([*extra_warnings, *study.warnings])))
    if began is not None:
        began.mark("statistics")
    if reports is None:
        return study
    from study.api.assemble import report_data
    from study.reporting import write

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

    from study.runner.virtual import write_virtual

    text = resources.files("study.runner").joinpath("demo.toml").read_text(encoding="utf-8")
    design = loads(text, "demo.toml")
    folder = results / design.name / "measurements"
    spec = design.measurements
    if spec is None or spec.file is None:
        raise RuntimeError("the embedded design names no measurement file")
    if not (folder / spec.file).is_file():
        write_virtual(design, folder)
    return run(design, data=folder, jobs=jobs, results=results, reports=reports, progress=progress)
