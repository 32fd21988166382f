"""The verb analyze: the table that a user of Minitab recognizes, and what it rests on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from study.cli import next_command, output
from study.cli.studies import RESULTS, Data, Json, Results, Study
from study.cli.tables import mixed_effects, surface_tables
from study.cli.tables.surface_tables import names
from study.errors import Fault, InputError

if TYPE_CHECKING:
    from study.analysis.effects.comparisons import Comparisons
    from study.analysis.request import AnovaOptions
    from study.analysis.result import AnalysisResult
    from study.api.statistics.confirmation import Permission
    from study.api.statistics.mixed_effects import MixedOptions
    from study.api.statistics.surface.response_surface import Surface as SurfaceKind

#: Flags as they were given; what was not given is None or empty.
Flags = Mapping[str, str | None]

Column = Annotated[str | None, typer.Option(help="Column of the response.")]
Columns = Annotated[str, typer.Option(help="Columns of the factors, with commas.")]
Blocks = Annotated[
    str | None, typer.Option(help="Column of the blocks; two with a comma that cross.")
]
Unit = Annotated[
    str | None, typer.Option(help="Column of the unit (specimen) that rows are repeats on.")
]
WholePlot = Annotated[
    str | None, typer.Option(help="Factors that are set once for a whole plot of a block.")
]
Replicates = Annotated[
    str | None, typer.Option(help="What repeats of a cell are: runs, mesh-seeds, noise.")
]
Copies = Annotated[
    str | None, typer.Option(help="Rows that repeat others in every digit: refuse, independent.")
]
Error = Annotated[
    str | None,
    typer.Option(help="auto, pooled, own, or reml: a mixed model, also for incomplete blocks."),
]
Random = Annotated[
    str, typer.Option(help="With --error reml: factors whose effect differs between blocks.")
]
Covariates = Annotated[
    str, typer.Option(help="With --error reml: columns of numbers that the response follows.")
]
ContrastsAsked = Annotated[
    list[str] | None,
    typer.Option(
        "--contrast", help="A difference of your own: 'model=stiff - model=soft'; repeatable."
    ),
]
Kind = Annotated[str | None, typer.Option("--type", help="Sums of squares: I, II, III.")]
Model = Annotated[
    str | None,
    typer.Option(help="full, the highest order of interaction, or terms with commas: A,B,A:B."),
]
Practical = Annotated[
    str | None, typer.Option(help="Smallest difference that matters: '5 % of mean'.")
]
Transform = Annotated[str | None, typer.Option(help="none or log.")]
Alpha = Annotated[
    float | None, typer.Option(help="Size of the tests; intervals have the level 1 - alpha.")
]
Decimal = Annotated[str, typer.Option(help="Decimal mark of a CSV: . or ,")]
Reference = Annotated[
    str | None, typer.Option(help="Level that the others are compared with (Dunnett).")
]
ReportFolder = Annotated[
    Path | None, typer.Option("--report", help="Write the page, its figures and CSV here.")
]
Formats = Annotated[
    str, typer.Option("--format", help="With --report: html, pdf, tex, csv, with commas.")
]
Numeric = Annotated[
    str, typer.Option(help="Columns of numeric factors: time,temp or 'time=80..90,temp log'.")
]
Surface = Annotated[str, typer.Option(help="With --numeric: auto, quadratic, emulator, none.")]


Source = Annotated[
    Path,
    typer.Argument(
        help="Results of a study, or any tidy CSV.", autocompletion=next_command.studies_and_tables
    ),
]


def analyze(
    source: Source,
    response: Column = None,
    factors: Columns = "",
    block: Blocks = None,
    unit: Unit = None,
    whole_plot: WholePlot = None,
    replicates: Replicates = None,
    copies: Copies = None,
    error: Error = None,
    kind: Kind = None,
    model: Model = None,
    practical: Practical = None,
    transform: Transform = None,
    alpha: Alpha = None,
    decimal: Decimal = ".",
    reference: Reference = None,
    report: ReportFolder = None,
    formats: Formats = "",
    numeric: Numeric = "",
    surface: Surface = "auto",
    random: Random = "",
    covariates: Covariates = "",
    contrast: ContrastsAsked = None,
    results: Results = RESULTS,
    as_json: Json = False,
) -> None:
    """Analyze a study's results, or any CSV with one row a run."""
    from study import api

    _check_report(source, report, formats)
    flags = {
        "--response": response, "--factors": factors, "--block": block, "--unit": unit,
        "--whole-plot": whole_plot, "--replicates": replicates, "--copies": copies,
        "--error": error, "--type": kind, "--model": model, "--practical": practical,
        "--transform": transform,
        "--alpha": None if alpha is None else repr(alpha), "--reference": reference,
        "--decimal": None if decimal == "." else decimal,
        "--report": None if report is None else str(report),
        "--format": formats, "--random": random, "--covariates": covariates,
        "--contrast": "; ".join(contrast or ()),
    }  # fmt: skip
    if numeric and surface != "none":
        surface_tables.show(source, names(numeric), surface, flags, as_json)
        return
    if error == "reml":
        mixed: MixedOptions = {"contrasts": contrast or ()}
        if alpha is not None:
            mixed["alpha"] = alpha
        if (terms := _model(flags["--model"])) is not None:
            mixed["model"] = terms
        mixed_effects.show(source, flags, mixed, results, as_json)
        return
    mixed_effects.check_none(flags)
    found = api.analyze(
        source, response, [*names(factors), *names(numeric)], results=results, decimal=decimal,
        **_options(flags, alpha),
    )  # fmt: skip
    if contrast:
        found = replace(found, contrasts=api.contrasts(found, contrast))
    page = None if report is None else _write_page(found, source, report, flags)
    _show(found, _Beside(_compared(found, reference), page), as_json)
    if not as_json and all(e.verdict == "cannot tell" for e in found.effects if e.is_main):
        _hint_practical(practical)


@dataclass(frozen=True)
class _Beside:
    """What was asked for beside the table: a reference, a page."""

    compared: tuple[str, Comparisons] | None
    page: Path | None

    def to_json(self) -> dict[str, object]:
        found: dict[str, object] = {}
        if self.compared is not None:
            from study.cli.tables import analysis_tables

            found["reference"] = analysis_tables.reference_json(*self.compared)
        return found if self.page is None else found | {"report": str(self.page)}


def _show(found: AnalysisResult, beside: _Beside, as_json: bool) -> None:
    from study.cli.tables import analysis_tables

    if as_json:
        output.warn(found.notes)
        output.print_json(found.to_json() | beside.to_json())
        return
    analysis_tables.print_analysis(found)
    if found.contrasts:
        from study.cli.tables import report_tables

        print()
        output.table(report_tables.contrast_rows(found), "Differences that were asked for")
        print()
    if beside.compared is not None:
        analysis_tables.print_reference(*beside.compared)
    if beside.page is not None:
        print(f"\nreport: {beside.page}")


def _options(flags: Flags, alpha: float | None) -> AnovaOptions:
    """Options of the analysis that were given on the command line."""
    blocks = names(flags["--block"])
    options: AnovaOptions = {"block": blocks if len(blocks) > 1 else next(iter(blocks), None)}
    if unit := flags["--unit"]:
        options["unit"] = unit
    if plots := names(flags["--whole-plot"]):
        options["whole_plot"] = plots
    if replicates := flags["--replicates"]:
        options["replicates"] = replicates
    if copies := flags["--copies"]:
        options["copies"] = copies
    if error := flags["--error"]:
        options["error"] = error
    if kind := flags["--type"]:
        options["type"] = kind
    if (model := _model(flags["--model"])) is not None:
        options["model"] = model
    if practical := flags["--practical"]:
        options["practical"] = practical
    if transform := flags["--transform"]:
        options["transform"] = transform
    if alpha is not None:
        options["alpha"] = alpha
    return options


def _compared(found: AnalysisResult, reference: str | None) -> tuple[str, Comparisons] | None:
    if reference is None:
        return None
    from study.api.statistics.comparisons import against_reference

    return against_reference(found, reference)


def _check_report(source: Path, report: Path | None, formats: str) -> None:
    """Refuse, before anything is computed, a page that could not be written."""
    if report is None and formats:
        raise InputError(
            Fault("--format", "asks for a page that is not written", "add --report DIR")
        )
    if report is not None and not source.is_file():
        rule = "writes the page of a table, and this is no file"
        raise InputError(Fault("--report", rule, "the page of a study: study report STUDY"))
    if report is not None and formats:
        from study.reporting.output.write import checked_formats

        checked_formats(names(formats))
    if report is not None and report.exists() and not report.is_dir():
        raise InputError(Fault("--report", f"{report} is a file", "name a folder"))


def _write_page(found: AnalysisResult, source: Path, report: Path, flags: Flags) -> Path:
    from study.api.statistics.table_report import Source, write_page

    given = {flag: value for flag, value in flags.items() if value and flag != "--contrast"}
    at = Source(source, given, tuple(one.name for one in found.contrasts))
    wanted = tuple(names(flags["--format"])) or ("html",)
    return write_page(found, report, source=at, reference=flags["--reference"], formats=wanted)


At = Annotated[
    str, typer.Option("--at", help="Settings that are held: thickness='3 mm',plates=bonded.")
]
Confirm = Annotated[
    bool, typer.Option(help="Run the true model there; the run joins the study's surfaces.")
]
Commands = Annotated[
    bool, typer.Option("--allow-commands", help="Let the study run the programs it names.")
]


def optimize(
    path: Annotated[
        Path,
        typer.Argument(
            help="Results folder, design file, study name; or a tidy CSV.",
            autocompletion=next_command.studies_and_tables,
        ),
    ],
    minimize: Annotated[str | None, typer.Option(help="Response that is to be small.")] = None,
    maximize: Annotated[str | None, typer.Option(help="Response that is to be large.")] = None,
    subject_to: Annotated[
        list[str] | None,
        typer.Option(help="Limit of another response: 'stiffness >= 0.3 N/mm'; repeatable."),
    ] = None,
    at: At = "",
    numeric: Numeric = "",
    surface: Surface = "auto",
    decimal: Decimal = ".",
    confirm: Confirm = True,
    data: Data = None,
    allow_commands: Commands = False,
    results: Results = RESULTS,
    as_json: Json = False,
) -> None:
    """Find the best setting among choices, within limits, and confirm it by a run."""
    from study import api
    from study.cli.tables import optimum_tables

    found = api.optimize(
        path, minimize=minimize, maximize=maximize, subject_to=subject_to or (),
        at=surface_tables.settings(at) if at else {}, numeric=names(numeric),
        surface=cast("SurfaceKind", surface), decimal=decimal, results=results,
        confirming=confirm, permission=_permission(data, allow_commands),
    )  # fmt: skip
    output.warn([note for one in found for note in one.notes])
    if as_json:
        output.print_json({"recommendations": [one.to_json() for one in found]})
    else:
        optimum_tables.print_recommendations(found)
    if any(one.confirmed is not None and not one.confirmed.predicted for one in found):
        raise typer.Exit(1)


def invert(
    path: Study,
    to: Annotated[Path, typer.Option(help="CSV of the measured curve, one row a point.")],
    at: At = "",
    columns: Annotated[
        str, typer.Option(help="Columns of displacement and force.")
    ] = "displacement_mm,force_N",
    units: Annotated[str, typer.Option(help="Their units.")] = "mm,N",
    within: Annotated[
        str | None, typer.Option(help="What an agreeing curve may miss, rms: '2 %'.")
    ] = None,
    decimal: Decimal = ".",
    confirm: Confirm = True,
    data: Data = None,
    allow_commands: Commands = False,
    results: Results = RESULTS,
    as_json: Json = False,
) -> None:
    """Find all inputs of a study whose curve agrees with a measured one."""
    from study import api
    from study.cli.tables import optimum_tables

    found = api.invert(
        path, to, at=surface_tables.settings(at) if at else {}, columns=names(columns),
        in_units=names(units), within=within, decimal=decimal, results=results,
        confirming=confirm, permission=_permission(data, allow_commands),
    )  # fmt: skip
    output.warn(found.notes)
    if as_json:
        output.print_json(found.to_json())
    else:
        optimum_tables.print_inverted(found)
    if found.best_run is not None and not found.best_run.agrees:
        raise typer.Exit(1)


def _permission(data: Path | None, allow_commands: bool) -> Permission:
    """Say what confirming runs may use."""
    from study.api.statistics.confirmation import Permission
    from study.runner.fitting.external_model import Allowed

    return Permission(data, Allowed(allow_commands))


VERBS: tuple[Callable[..., None], ...] = (analyze, optimize, invert)


def _hint_practical(practical: str | None) -> None:
    """Say what verdicts lack: without a smallest difference that matters nobody can tell."""
    if practical is None:
        hint = "--practical 0.5 or --practical '5 % of mean'"
        output.warn([f"no smallest difference that matters is given, so no verdict: {hint}"])


def _model(text: str | None) -> str | int | list[str] | None:
    """Read a model as it is written on the command line."""
    if text is None or text == "full":
        return text
    if text.isdigit():
        return int(text)
    return names(text)
