"""Verbs about whole studies: demo, plan, run, status, report, diff, why."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from study import api
from study.cli import output
from study.cli.output import SWITCH, Text, argument, option
from study.ground.errors import Fault, InputError
from study.ground.units import listed
from study.reporting.content.blocks import Block, Document, Sentence, Table, Verbatim
from study.reporting.content.text import case_counts, count, general
from study.reporting.output.terminal import say

if TYPE_CHECKING:
    from study.api.comparison import CaseState
    from study.api.opened_study import Study as OpenedStudy
    from study.api.planning import Plan
    from study.harness.design.overview import Augmentation, CellOverview, Overview


Json = Annotated[bool, option("One JSON document on stdout.", "--json")]
Data = Annotated[Path | None, "Folder that measurement files are relative to."]
Set = Annotated[list[str] | None, option("Override a key: model.mesh_size='2 mm'.", "-s", "--set")]
Design = Annotated[Path, argument("Design file.", output.designs)]
Study = Annotated[Path, argument("Results folder, design file or study name.", output.studies)]
Jobs = Annotated[int | None, option("Workers; one a core.", "--jobs", "-j", min=1)]
Results = Annotated[Path, "Where results are kept."]
Reports = Annotated[Path, "Where reports are written."]
Commands = Annotated[bool, "Let the study run the programs it names.", SWITCH]
#: levels of a factor beyond which a plan lists the ends only
MANY = 6
#: rows of a matrix that are looked at on a terminal; of a longer one the first stand for the rest
ROWS = 100
FIRST_ROWS = 20
RESULTS = Path("results")
REPORTS = Path("reports")


def settings(texts: Sequence[str]) -> dict[str, str]:
    """Read ``thickness=3 mm,C10=5 kPa``; the option may be repeated."""
    settings_typed: dict[str, str] = {}
    for part in (part for text in texts for part in text.split(",")):
        name, equals, value = (piece.strip(" \"'") for piece in part.partition("="))
        if not equals or not name or not value or name in settings_typed:
            rule = f"cannot read {part.strip()!r}"
            raise InputError(Fault("--at", rule, "write thickness='3 mm',C10='5 kPa', each once"))
        settings_typed[name] = value
    return settings_typed


def demo(
    jobs: Jobs = None, results: Results = RESULTS, reports: Reports = REPORTS, as_json: Json = False
) -> None:
    """Run a complete small study on built-in virtual specimens."""
    with output.progress_line() as progress:
        study = api.demo(results=results, reports=reports, jobs=jobs, progress=progress)
    _finish(study, as_json, _folders(results, reports))


def plan(
    design: Design,
    data: Data = None,
    jobs: Jobs = None,
    settings: Set = None,
    results: Results = RESULTS,
    run_sheet: Annotated[Path | None, "CSV to write: physical trials in random order."] = None,
    specimens: Annotated[int, option("Specimens of the run sheet, measured once each.", min=1)] = 6,
    augment: Annotated[
        int | None, option("Name so many further cells of a fraction.", min=1)
    ] = None,
    terms: Annotated[str, "With --augment: order of interaction, or terms with commas."] = "2",
    as_json: Json = False,
) -> None:
    """Print the matrix before running: cases, exclusions, cost, what factors can tell."""
    from study.harness.design.load import load

    if run_sheet is not None:
        sheet = api.run_sheet(design, specimens, path=run_sheet)
        typer.echo(f"{len(sheet)} trials in random order: {run_sheet}", err=True)
    further = None
    if augment is not None:
        chosen_terms = int(terms) if terms.isdigit() else listed(terms)
        further = api.augment(load(design, settings or ()), augment, terms=chosen_terms)
    planned = api.plan(design, data=data, results=results, overrides=settings or (), jobs=jobs)
    typed = {"--data": data, "--jobs": jobs, "-s": settings, **_folders(results, REPORTS)}
    after = output.after_plan(planned, design, typed)
    if as_json:
        output.warn(planned.warnings)
        added = {} if further is None else {"augment": further.to_json()}
        output.print_json(planned.to_json() | added | {"next": after[1]})
        return
    say(_plan(planned))
    output.warn(planned.warnings)
    if further is not None:
        say(_further(further))
    output.next_step(*after)


def _overview(overview: Overview) -> Iterator[Block]:
    yield Verbatim(f"{overview.design.name}: {overview.design.question}\n")
    columns: dict[str, Callable[[CellOverview], str]] = {
        "cell": lambda row: row.label,
        "computation": lambda row: str(row.group),
    }
    title = f"{len(overview.matrix)} cells, {overview.distinct} distinct computations"
    if overview.design.is_alone:  # a title is wrapped to a narrow table
        yield Verbatim(title)
        title = ""
    else:
        columns["calibration"] = lambda row: (
            "-" if row.calibration is None else str(row.calibration)
        )
    more = len(overview.matrix) - FIRST_ROWS if len(overview.matrix) > ROWS else 0
    shown = overview.matrix[:FIRST_ROWS] if more else overview.matrix
    yield Table.of(title, shown, columns)
    if more:
        yield Verbatim(f"and {more:,} more cells: --json lists all of them")
    if overview.distinct < len(overview.matrix):
        yield Verbatim("cells with the same number of a computation must agree: they are controls")
    yield from (Verbatim(f"excluded: {cell.label}: {why}") for cell, why in overview.excluded)
    yield Verbatim("")
    if (scheme := overview.design.scheme).summary:  # what the choice of cells can and cannot tell
        yield Verbatim(scheme.summary)
        if scheme.defining_relation:
            yield Verbatim(f"defining relation: {scheme.defining_relation}")
        yield from (Verbatim(f"  {sentence}") for sentence in scheme.aliases)
        yield Verbatim("")
    for factor in overview.factors:
        levels = factor.levels
        if len(levels) > MANY:
            levels = (levels[0], f"{len(levels) - 2} more", levels[-1])
        yield Verbatim(f"{factor.name} ({', '.join(levels)}): {factor.note or 'varies'}")


def _plan(planned: Plan) -> Iterator[Block]:
    """Cells, costs and what is left to be done."""
    yield from _overview(planned.overview)
    yield Verbatim("")
    if planned.blocks:
        yield Verbatim(f"{len(planned.blocks)} blocks: {', '.join(planned.blocks)}")
    if planned.overview.replicates is not None:
        yield Verbatim(f"replicates: {planned.overview.replicates.sentence}")
    cells = len(planned.overview.matrix)
    if len(planned.blocks) > 1 and cells * len(planned.blocks) == planned.cases["total"]:
        yield Verbatim(
            f"{cells} cells in {len(planned.blocks)} blocks: a case is a cell in a block"
        )
    yield Verbatim(case_counts(planned.cases))
    if planned.cases["missing"] and planned.fits:
        calibrations = count(planned.fits, "calibration")
        yield Verbatim(f"{calibrations} to be made; each is shared by all cells that can")
    if planned.controls:
        solutions = count(planned.controls, "solution")
        yield Verbatim(f"{solutions} to be made of one cylinder in both spaces, a control")
    if planned.commands:
        calls = count(planned.program_calls, "call")
        yield Verbatim(f"{calls} of other programs, gradients by differences included:")
        yield from (Verbatim(f"  {line}") for line in planned.commands)
        yield Verbatim(f"  to allow exactly these: study run --allow-digest {planned.digest}")
    if planned.predicted_seconds is not None:
        time = output.seconds(planned.predicted_seconds)
        workers, memory = count(planned.jobs, "worker"), f"{planned.memory_MB:.0f} MB of memory"
        yield Verbatim(f"predicted: {time} of computing on {workers}, {memory}")
    if planned.most_seconds is not None:
        yield Verbatim(f"with all cells that may be added: {output.seconds(planned.most_seconds)}")


def _further(augmentation: Augmentation) -> Iterator[Block]:
    """Further cells, what they gain, and the table that runs them."""
    names = tuple(augmentation.cells[0])
    rows = tuple(tuple(cell[name] for name in names) for cell in augmentation.cells)
    yield Table("Further cells", names, rows)
    gain = f"{100 * augmentation.before:.0f} % before, {100 * augmentation.after:.0f} % after"
    yield Sentence(
        f"Told apart with them: {', '.join(augmentation.terms)}. Precision, of that of an "
        f"orthogonal design of as many cells: {gain}. Put this in place of [design] (what is "
        "computed stays):"
    )
    yield Verbatim(f"\n{augmentation.table()}")


def run(
    design: Design,
    data: Data = None,
    jobs: Jobs = None,
    settings: Set = None,
    results: Results = RESULTS,
    reports: Reports = REPORTS,
    timeout: Annotated[float | None, "Seconds after which one computation is stopped."] = None,
    refine: Annotated[
        bool, "Refine the mesh under one block for the numerical uncertainty."
    ] = True,
    allow_commands: Commands = False,
    allow_digest: Annotated[str, "Let it run these alone: the digest that study plan prints."] = "",
    stale: Annotated[str, "Results of other libraries: warn, refuse, or rerun them."] = "warn",
    memory: Annotated[Text, "Memory that may be in use at once: '20 GB'."] = None,
    scheduler: Annotated[
        str, "Compute on a Dask cluster: its address, or its scheduler file."
    ] = "",
    confirm: Annotated[
        bool, "Run the extremes that confirm verdicts over numbers.", SWITCH
    ] = False,
    as_json: Json = False,
) -> None:
    """Compute what is missing, then analyze and report; run it again to resume."""
    with output.progress_line() as progress:
        study = api.run(
            design, data=data, jobs=jobs, results=results, reports=reports,
            overrides=settings or (), progress=progress, timeout_s=timeout, refine=refine,
            allow_commands=allow_commands or allow_digest, stale=stale, memory=memory,
            engine=scheduler or None, confirm=confirm,
        )  # fmt: skip
    _finish(study, as_json, _folders(results, reports))


def import_(
    file: Annotated[Path, argument("CSV or workbook, one row a run.")],
    responses: Annotated[str, "Columns of the responses: peak=N,work."],
    factors: Annotated[str, "Columns of the factors, with commas."] = "",
    numeric: Annotated[
        str, "Columns of factors that are numbers over a range: speed,temp log."
    ] = "",
    failed: Annotated[Text, "Column that says which runs have no answer, and why."] = None,
    block: Annotated[Text, "Column of the unit that was replicated."] = None,
    name: Annotated[Text, "Name of the study; that of the file."] = None,
    decimal: Annotated[str, "Mark of decimals."] = ".",
    practical: Annotated[str, "Smallest difference that matters: peak=1 N,work=5 % of mean."] = "",
    results: Results = RESULTS,
    reports: Reports = REPORTS,
    as_json: Json = False,
) -> None:
    """Make a study of runs that were made elsewhere, and report it."""
    imported = api.import_runs(
        file, factors, responses, failed=failed, block=block, name=name, decimal=decimal,
        practical=practical, results=results, numeric=numeric,
    )  # fmt: skip
    _finish(api.report(imported.folder, reports=reports), as_json, _folders(results, reports))


#: a word of Python, so that the function cannot bear the name of its verb
import_.__name__ = "import"


def status(
    path: Study,
    results: Results = RESULTS,
    as_json: Json = False,
) -> None:
    """Print the progress of a study, from another shell too."""
    state = api.status(path, results=results, judged=as_json)
    output.show(state, as_json, _status(state), state["warnings"])


def _status(state: Document) -> Iterator[Block]:
    yield Verbatim(f"{state['study']}: {case_counts(state['cases'])}")
    for name, number in sorted(state["failures"].items()):
        yield Verbatim(f"  {number} {name}")
    if (later := state["unfinished"]) is not None:
        cases = case_counts(later["cases"])
        yield Verbatim(f"  that is its last finished run; a later one has {cases}")
        yield from (Verbatim(f"    {change}") for change in later["changed"])
    if (runner := state["running"]) is None:
        yield Verbatim("not running")
        if state["cases"]["missing"]:
            yield Verbatim("`study run` with the design computes what is missing")
        return
    who = ", ".join(f"{name} {runner[name]}" for name in ("pid", "host", "since") if name in runner)
    seconds, counted = state["predicted_seconds"], runner.get("counted", "at work")
    left = "" if seconds is None else f", {output.seconds(seconds)} left"
    yield Verbatim(f"running: {counted}{left} ({who})")


def report(
    path: Study,
    formats: Annotated[
        str, option("html, pdf, tex, csv: one or several with commas.", "--format")
    ] = "",
    beside: Annotated[Path | None, "Another study: say which conclusions hold in both."] = None,
    results: Results = RESULTS,
    reports: Reports = REPORTS,
    as_json: Json = False,
) -> None:
    """Write the report again from stored records, in seconds."""
    written_study = api.report(
        path, reports=reports, results=results, formats=listed(formats), beside=beside
    )
    _finish(written_study, as_json, _folders(written_study.folder.parent, reports))


def diff(
    first: Study,
    second: Annotated[
        Path, argument("The study to compare it with, named likewise.", output.studies)
    ],
    results: Results = RESULTS,
    as_json: Json = False,
) -> None:
    """Compare two studies: what was changed, and which conclusions hold under both."""
    from study.reporting.content.comparison_content import beside_blocks

    comparison = api.diff(first, second, results=results)
    shown = replace(comparison.beside, warnings=())  # they are on stderr
    output.show(comparison, as_json, beside_blocks(shown), comparison.warnings)


def why(
    case: Annotated[str, argument("Case id, or its beginning.", output.cases)],
    study: Annotated[
        Path | None, "Study to look in; all by default. A design file counts as it is now."
    ] = None,
    data: Data = None,
    results: Results = RESULTS,
    as_json: Json = False,
) -> None:
    """Explain the state of a case, and what changed since it was computed."""
    state = api.explain(case, study=study, results=results, data=data)
    facts = {"use": state.use, "changes": state.changes, "libraries": state.libraries}
    whole = json.loads(state.record.to_json())["content"] | {"state": facts}
    output.show(whole, as_json, _case(state))


def _case(state: CaseState) -> Iterator[Block]:
    record = state.record
    yield Verbatim(f"case {record.case_id} of {record.study}: {record.status}")
    yield Verbatim(f"  {state.use}")
    yield from (Verbatim(f"    {change.sentence}") for change in (*state.changes, *state.libraries))
    if record.message:
        yield Verbatim(f"  {record.message}")
    for note in record.retries:
        yield Verbatim(f"  after {note['cause']}: {note['what']} ({note['message']})")
    yield from (Verbatim(f"  {name} = {level}") for name, level in record.levels.items())
    if record.block is not None:
        yield Verbatim(f"  block = {record.block}")
    yield Table.of(
        "",
        record.responses.items(),
        {
            "response": lambda of: of[0],
            "value": lambda of: general(of[1]["value"]),
            "unit": lambda of: of[1]["unit"],
        },
    )
    for specimen, fit in (record.fit or {}).items():
        ended = fit.get("message", "how it ended is not known")
        yield Verbatim(f"calibration on {specimen}: {ended}; {fit.get('reason') or 'identifiable'}")
        if "misfit" in fit:
            yield Verbatim(f"  {fit['misfit']}")
        if "stability" in fit:  # a fit to resampled residuals is not judged
            yield Verbatim(f"  {fit['stability']}")
    if "traceback" in record.extra:
        yield Verbatim(str(record.extra["traceback"]))


def predict(
    path: Study,
    at: Annotated[list[str], "Setting of every factor: thickness='3 mm',C10='5 kPa'."],
    response: Annotated[Text, "One response; all by default."] = None,
    results: Results = RESULTS,
    as_json: Json = False,
) -> None:
    """Predict responses at settings that were not run, inside those that were."""
    from study.reporting.content.surface_content import prediction_blocks

    predictions = api.predict(path, settings(at), response=response, results=results)
    document = {"predictions": [prediction.to_json() for prediction in predictions]}
    notes = [note for prediction in predictions for note in prediction.notes]
    output.show(document, as_json, prediction_blocks(predictions), notes)


def _folders(results: Path, reports: Path) -> output.Options:
    """Folders that were named, to be named again."""
    return {
        "--results": None if results == RESULTS else results,
        "--reports": None if reports == REPORTS else reports,
    }


def _finish(study: OpenedStudy, as_json: bool, typed: output.Options) -> None:
    """Print verdicts and report; exit 1 if cases failed or a report could not be written."""
    after = output.after_run(study, typed)
    document = study.to_json() | {"next": after[1]}
    output.show(document, as_json, study.blocks(), study.warnings)
    if not as_json:
        output.next_step(*after)
    if study.failed or study.report is None:
        raise typer.Exit(1)


# The verb ``verify``: every number of a report once more.


def verify(
    path: Annotated[Path, argument("Page or folder of a report, or study name.", output.studies)],
    resolve: Annotated[
        int, option("Cases to be solved again from nothing, drawn at random.", min=0)
    ] = 0,
    seed: Annotated[int, option("Of the draw.", min=0)] = 1,
    data: Data = None,
    results: Results = RESULTS,
    reports: Reports = REPORTS,
    allow_commands: Annotated[bool, "Let --resolve run programs.", SWITCH] = False,
    tolerance: Annotated[
        float | None,
        option(
            "Relative difference to pass over: by default none, and 1e-9 where the report was "
            "written on another kind of processor or with other libraries.",
            min=0.0,
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Compute every number of a report again from its records; exit 1 if one differs."""
    verification = api.verify(
        path, results=results, reports=reports, resolve=resolve, seed=seed, data=data,
        allow_commands=allow_commands, tolerance=tolerance,
    )  # fmt: skip
    output.show(verification, as_json, verification.blocks())
    raise typer.Exit(0 if verification.agrees else 1)
