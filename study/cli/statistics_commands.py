"""The verbs about statistics: analyze, optimize, invert, power."""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from study import api
from study.cli import output
from study.cli.output import Text, argument, option
from study.cli.study_commands import (
    RESULTS,
    Commands,
    Data,
    Design,
    Json,
    Results,
    Set,
    Study,
    settings,
)
from study.ground.errors import Fault, InputError
from study.ground.units import listed
from study.reporting.content.blocks import Block, Sentence, Table
from study.reporting.content.text import TIMES, interval, p_value, ratio_digits, significant
from study.reporting.output.terminal import say

if TYPE_CHECKING:
    from study.api.analyzing import MixedOptions
    from study.api.planning import ContrastDetection, Power
    from study.api.predicting import Permission
    from study.statistics.analysis.analysis_request import AnovaOptions
    from study.statistics.analysis.analysis_result import AnalysisResult
    from study.statistics.analysis.anova_table import Comparison
    from study.statistics.analysis.comparisons import SummaryAnalysis
    from study.statistics.analysis.power import PlannedVerdicts
    from study.statistics.surfaces.surface_fitting import Surface as SurfaceKind


#: Flags as they were given; what was not given is None or empty.
Flags = Mapping[str, str | None]

Decimal = Annotated[str, "Decimal mark of a CSV: . or ,"]
Numeric = Annotated[str, "Columns of numeric factors: time,temp or 'time=80..90,temp log'."]
Surface = Annotated[str, "With --numeric: auto, quadratic, emulator, none."]


def analyze(
    source: Annotated[
        Path, argument("Results of a study, or any tidy CSV.", output.studies_and_tables)
    ],
    formula: Annotated[
        Text,
        typer.Argument(
            metavar="FORMULA", help="'len ~ supp * dose': response, factors and model in one."
        ),
    ] = None,
    response: Annotated[Text, "Column of the response."] = None,
    factors: Annotated[str, "Columns of the factors, with commas."] = "",
    block: Annotated[Text, "Column of the blocks; two with a comma that cross."] = None,
    unit: Annotated[Text, "Column of the unit (specimen) that rows are repeats on."] = None,
    whole_plot: Annotated[Text, "Factors that are set once for a whole plot of a block."] = None,
    replicates: Annotated[Text, "What repeats of a cell are: runs, mesh-seeds, noise."] = None,
    copies: Annotated[Text, "Rows that repeat others in every digit: refuse, independent."] = None,
    error: Annotated[
        Text, "auto, pooled, own, or reml: a mixed model, also for incomplete blocks."
    ] = None,
    welch: Annotated[bool, "A variance of its own for each cell: Welch, Games and Howell."] = False,
    kind: Annotated[Text, option("Sums of squares: I, II, III.", "--type")] = None,
    model: Annotated[
        Text, "full, the highest order of interaction, or terms with commas: A,B,A:B."
    ] = None,
    practical: Annotated[Text, "Smallest difference that matters: '5 % of mean'."] = None,
    transform: Annotated[Text, "none or log."] = None,
    alpha: Annotated[float | None, "Size of the tests; intervals have the level 1 - alpha."] = None,
    decimal: Decimal = ".",
    sheet: Annotated[str, "Sheet of a workbook that has several."] = "",
    reference: Annotated[Text, "Level that the others are compared with (Dunnett)."] = None,
    report: Annotated[Path | None, "Write the page, its figures and CSV here."] = None,
    formats: Annotated[
        str, option("With --report: html, pdf, tex, csv, with commas.", "--format")
    ] = "",
    numeric: Numeric = "",
    surface: Surface = "auto",
    random: Annotated[str, "With --error reml: factors whose effect differs between blocks."] = "",
    covariates: Annotated[str, "Columns of numbers that the response follows."] = "",
    contrast: Annotated[
        list[str] | None,
        "A difference of your own: 'model=stiff - model=soft'; repeatable.",
    ] = None,
    summary: Annotated[
        str, "Columns of mean, standard deviation and number: each row is a group."
    ] = "",
    results: Results = RESULTS,
    as_json: Json = False,
) -> None:
    """Analyze a study's results, or any CSV with one row a run."""
    if welch and error:
        raise InputError(Fault("--welch", f"is an error of its own, beside --error {error}"))
    error = "welch" if welch else error

    _check_report(source, report, formats)
    if formula is not None:
        if response or factors or model:
            given = "--response, --factors and --model"
            raise InputError(Fault("formula", f"says what {given} say", "leave those out"))
        from study.statistics.analysis.linear_model import read_formula

        parsed = read_formula(formula)
        response, factors, model = parsed.response, ",".join(parsed.factors), ",".join(parsed.model)
        block = block or ",".join(parsed.blocks)
        whole_plot = whole_plot or ",".join(parsed.whole_plot)
        transform = transform or parsed.transform
    flags = {
        "--response": response, "--factors": factors, "--block": block, "--unit": unit,
        "--whole-plot": whole_plot, "--replicates": replicates, "--copies": copies,
        "--error": error, "--type": kind, "--model": model, "--practical": practical,
        "--transform": transform,
        "--alpha": None if alpha is None else repr(alpha), "--reference": reference,
        "--decimal": None if decimal == "." else decimal,
        "--sheet": sheet or None,
        "--report": None if report is None else str(report),
        "--format": formats, "--random": random, "--covariates": covariates,
        "--contrast": "; ".join(contrast or ()),
    }  # fmt: skip
    if sheet and (summary or numeric or error == "reml"):
        rule = "is read with an analysis of variance of labeled factors alone"
        raise InputError(Fault("--sheet", rule, "save the sheet as CSV"))
    if summary:
        refuse_useless(
            flags | {"--numeric": numeric}, _OF_MOMENTS, "groups of which only moments are known"
        )
        from study.api.analyzing import analyze_summary

        groups = analyze_summary(
            source, listed(flags["--factors"]), listed(summary), practical=flags["--practical"],
            alpha=0.05 if alpha is None else alpha, decimal=flags["--decimal"] or ".",
        )  # fmt: skip
        output.show(groups, as_json, _summaries(groups))
        return
    if numeric and surface != "none":
        _show_surfaces(source, listed(numeric), surface, flags, as_json)
        return
    if error == "reml" or (flags["--covariates"] and not (error or flags["--block"])):
        _show_mixed(source, flags, alpha, contrast or (), results, as_json)
        return
    if faults := [
        Fault(flag, "belongs to a mixed model", "add --error reml")
        for flag in ("--random", "--covariates")
        if flags[flag]
    ]:
        raise InputError(faults)
    options = _options(flags, alpha)
    analysis = api.analyze(
        source, response, [*listed(factors), *listed(numeric)], results=results, decimal=decimal,
        sheet=sheet, **options,
    )  # fmt: skip
    if contrast:
        analysis = replace(analysis, contrasts=api.contrasts(analysis, contrast))
    _show(analysis, source, flags, report, as_json)


def _show(
    analysis: AnalysisResult, source: Path, flags: Flags, report: Path | None, as_json: bool
) -> None:
    """Print an analysis, with what was asked for besides: a reference, a page."""
    from study.reporting.output import analysis_page
    from study.statistics.analysis.post_hoc import against_reference

    given = {flag: value for flag, value in flags.items() if value and flag != "--contrast"}
    named = tuple(contrast.name for contrast in analysis.contrasts)
    origin = analysis_page.AnalysisSource(source if source.is_file() else None, given, named)
    reference, page = flags["--reference"], None
    compared = None if reference is None else against_reference(analysis, reference)
    if report is not None:
        formats = tuple(listed(flags["--format"])) or ("html",)
        page = analysis_page.write_page(
            analysis, report, source=origin, compared=compared, formats=formats
        )
    if as_json:
        output.warn(analysis.notes)
        further: dict[str, object] = {} if page is None else {"report": str(page)}
        if compared is not None:
            factor, pairs = compared
            further["reference"] = {
                "factor": factor, "method": pairs.method, "alpha": pairs.alpha,
                "scale": pairs.effect, "pairs": pairs.pairs,
            }  # fmt: skip
        output.print_json(analysis.to_json() | further)
        return
    data = analysis_page.analysis_data(analysis, origin)
    from study.reporting.content import analysis_content

    say(analysis_content.analysis_blocks(analysis, data))
    printed = analysis_content.unit_sentences(analysis)
    output.warn([message for message in analysis.notes if message not in printed])
    if compared is not None:
        say([analysis_content.against_reference(*compared, data)])
    if page is not None:
        print(f"\nreport: {page}")
    is_open = all(e.verdict == "cannot tell" for e in analysis.effects if e.is_main)
    if flags["--practical"] is None and is_open:
        hint = "--practical 0.5 or --practical '5 % of mean'"
        output.warn([f"no smallest difference that matters is given, so no verdict: {hint}"])


# A surface over numeric factors.

#: flags of `study analyze` that a surface has a use for
_OF_SURFACES = frozenset({
    "--response", "--factors", "--block", "--practical", "--decimal", "--report", "--format",
})  # fmt: skip


def _show_surfaces(
    source: Path,
    numeric: Sequence[str],
    surface: str,
    flags: Mapping[str, str | None],
    as_json: bool,
) -> None:
    """Fit a surface and print it."""
    from study.reporting.content import surface_content
    from study.reporting.output.analysis_page import AnalysisSource, check_taken, surface_data
    from study.reporting.output.write import write

    if source.is_dir() or source.suffix == ".toml":
        raise InputError(Fault("--numeric", "reads a table, one row a run", "name a CSV"))
    if not flags["--response"]:
        rule, mend = "is missing", "name the column of the response"
        raise InputError(Fault("--response", rule, mend))
    refuse_useless(flags, _OF_SURFACES, "a surface over numeric factors")
    every = api.fit_surfaces(
        source,
        flags["--response"],
        numeric,
        listed(flags["--factors"]),
        surface=cast("SurfaceKind", surface),
        block=flags["--block"],
        practical=flags["--practical"],
        decimal=flags["--decimal"] or ".",
        announce=lambda text: output.warn([text]),
    )
    carried = [fitted.surface for fitted in every if fitted.surface is not None]
    notes = dict.fromkeys(note for surface_found in carried for note in surface_found.notes)
    refused = [(fitted.labels, fitted.refused) for fitted in every if fitted.surface is None]
    at = [f"{', '.join(f'{n} = {v}' for n, v in at.items())}: {why}" for at, why in refused]
    output.warn([*notes, *at])
    given = {flag: value for flag, value in flags.items() if value}
    given |= {"--numeric": ",".join(numeric), "--surface": surface}
    data = surface_data(every, AnalysisSource(source, given))
    page = None
    if (folder := flags["--report"]) is not None:
        check_taken(list(data.factors))
        page = write(data, folder, listed(flags["--format"]) or ["html"])
    if as_json:
        surfaces_document = {"surfaces": [fitted.to_json() for fitted in every]}
        document = surfaces_document if flags["--factors"] else carried[0].to_json()
        output.print_json(document if page is None else document | {"report": str(page)})
        return
    for fitted in data.surfaces:
        say(surface_content.surface_blocks(fitted, data))
    if page is not None:
        print(f"\nreport: {page}")


def refuse_useless(flags: Mapping[str, str | None], used: Container[str], of: str) -> None:
    """Refuse flags that were given and that an analysis of some kind has no use for."""
    rule, always_95 = f"has no meaning for {of}", "intervals are 95 %: leave it out"
    useless = [flag for flag, value in flags.items() if value and flag not in used]
    if useless:
        raise InputError(
            [Fault(f, rule, always_95 if f == "--alpha" else "leave it out") for f in useless]
        )


# A mixed model: blocks and other columns as random factors.

#: flags that a mixed model has a use for
_OF_MIXED = frozenset({
    "--response", "--factors", "--block", "--error", "--model", "--alpha", "--decimal", "--random",
    "--covariates", "--practical", "--contrast", "--copies",
})  # fmt: skip


def _show_mixed(
    source: Path, flags: Flags, alpha: float | None, contrasts: Sequence[str], results: Path,
    as_json: bool,
) -> None:  # fmt: skip
    """Fit a mixed model and print it."""
    from study.api.analyzing import fit_mixed_model
    from study.reporting.content import analysis_content

    refuse_useless(flags, _OF_MIXED, "a mixed model")
    options = cast("MixedOptions", _given({
        "contrasts": contrasts, "alpha": alpha, "model": _model(flags["--model"]),
        "random": listed(flags["--random"]), "covariates": listed(flags["--covariates"]),
        "block": listed(flags["--block"]), "practical": flags["--practical"],
        "copies": flags["--copies"],
    }))  # fmt: skip
    model = fit_mixed_model(
        source, flags["--response"], listed(flags["--factors"]), options, results=results,
        decimal=flags["--decimal"] or ".",
    )  # fmt: skip
    output.warn(model.notes)
    alpha = options.get("alpha", 0.05)
    document = {"method": "REML", "alpha": alpha, **vars(model)}
    response = flags["--response"] or ""
    output.show(document, as_json, analysis_content.mixed_blocks(model, response, alpha))


#: flags that groups of which only moments are known have a use for; a format has a default
_OF_MOMENTS = {"--factors", "--practical", "--alpha", "--decimal", "--format"}


def _summaries(groups: SummaryAnalysis) -> Iterator[Block]:
    """Give tests of equal means, and all pairs with one variance and with one for each group."""
    yield Table.of(
        "Are the means equal?",
        (("one variance", groups.anova), ("Welch", groups.welch)),
        {
            "Test": lambda of: of[0],
            "F": lambda of: f"{of[1]['f']:.2f}",
            "DF": lambda of: f"{of[1]['df']:g}",
            "DF of error": lambda of: f"{of[1]['df_error']:.4g}",
            "p": lambda of: p_value(of[1]["p"]),
        },
    )
    ends = f"{100 * (1 - groups.tukey.alpha):.4g} % interval"
    columns: dict[str, Callable[[tuple[Comparison, Comparison, str | None]], str]] = {
        "Groups": lambda of: f"{of[0].first} - {of[0].second}",
        "difference": lambda of: significant(of[0].difference, 5),
        ends: lambda of: interval(of[0].lower, of[0].upper, digits=4),
        "p": lambda of: p_value(of[0].p),
        "Games and Howell": lambda of: interval(of[1].lower, of[1].upper, digits=4),
        "p (Games and Howell)": lambda of: p_value(of[1].p),
    }
    if groups.practical is not None:
        columns["verdict"] = lambda of: of[2] or ""
    every = zip(groups.tukey.pairs, groups.games_howell.pairs, groups.verdicts, strict=True)
    title = "All pairs (Tukey and Kramer; variances of their own: Games and Howell)"
    yield Table.of(title, every, columns)


def _options(flags: Flags, alpha: float | None) -> AnovaOptions:
    """Options of the analysis that were given on the command line."""
    blocks = listed(flags["--block"])
    given = _given({
        "unit": flags["--unit"], "whole_plot": listed(flags["--whole-plot"]),
        "replicates": flags["--replicates"], "copies": flags["--copies"],
        "error": flags["--error"], "type": flags["--type"], "model": _model(flags["--model"]),
        "practical": flags["--practical"], "transform": flags["--transform"], "alpha": alpha,
    })  # fmt: skip
    given["block"] = blocks if len(blocks) > 1 else next(iter(blocks), None)
    return cast("AnovaOptions", given)


def _given(options: Mapping[str, object]) -> dict[str, object]:
    """Options that were given on the command line."""
    return {name: value for name, value in options.items() if value not in (None, "", [])}


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

        checked_formats(listed(formats))
    if report is not None and report.exists() and not report.is_dir():
        raise InputError(Fault("--report", f"{report} is a file", "name a folder"))


At = Annotated[list[str] | None, "Settings that are held: thickness='3 mm',plates=bonded."]
Confirm = Annotated[bool, "Run the true model there; the run joins the study's surfaces."]


def optimize(
    path: Annotated[
        Path,
        argument(
            "Results folder, design file, study name; or a tidy CSV.", output.studies_and_tables
        ),
    ],
    minimize: Annotated[Text, "Response that is to be small."] = None,
    maximize: Annotated[Text, "Response that is to be large."] = None,
    subject_to: Annotated[
        list[str] | None, "Limit of another response: 'stiffness >= 0.3 N/mm'; repeatable."
    ] = None,
    at: At = None,
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
    from study.reporting.content import surface_content

    recommendations = api.optimize(
        path, minimize=minimize, maximize=maximize, subject_to=subject_to or (),
        at=settings(at or ()), numeric=listed(numeric),
        surface=cast("SurfaceKind", surface), decimal=decimal, results=results,
        confirming=confirm, permission=_permission(data, allow_commands),
    )  # fmt: skip
    notes = [note for recommended in recommendations for note in recommended.notes]
    document = {"recommendations": [recommended.to_json() for recommended in recommendations]}
    output.show(document, as_json, surface_content.recommendation_blocks(recommendations), notes)
    confirmed = [recommended.confirmed for recommended in recommendations]
    if any(run is not None and not run.predicted for run in confirmed):
        raise typer.Exit(1)


def invert(
    path: Study,
    to: Annotated[Path, "CSV of the measured curve, one row a point."],
    at: At = None,
    columns: Annotated[str, "Columns of displacement and force."] = "displacement_mm,force_N",
    units: Annotated[str, "Their units."] = "mm,N",
    within: Annotated[Text, "What an agreeing curve may miss, rms: '2 %'."] = None,
    decimal: Decimal = ".",
    confirm: Confirm = True,
    data: Data = None,
    allow_commands: Commands = False,
    results: Results = RESULTS,
    as_json: Json = False,
) -> None:
    """Find all inputs of a study whose curve agrees with a measured one."""
    from study.reporting.content import surface_content

    answer = api.invert(
        path, to, at=settings(at or ()), columns=listed(columns),
        in_units=listed(units), within=within, decimal=decimal, results=results,
        confirming=confirm, permission=_permission(data, allow_commands),
    )  # fmt: skip
    output.show(answer, as_json, surface_content.inversion_blocks(answer), answer.notes)
    if answer.best_run is not None and not answer.best_run.agrees:
        raise typer.Exit(1)


def _permission(data: Path | None, allow_commands: bool) -> Permission:
    """Say what confirming runs may use."""
    from study.api.predicting import Permission
    from study.simulation.job import Allowed

    return Permission(data, Allowed(allow_commands))


def _model(text: str | None) -> str | int | list[str] | None:
    """Read a model as it is written on the command line."""
    if text is None or text == "full":
        return text
    if text.isdigit():
        return int(text)
    return listed(text)


# The verb that plans the number of specimens.


def power(
    design: Design,
    sd: Annotated[
        Text,
        "Scatter of a difference between specimens: 0.4, or by response peak=0.1,mu0=0.02.",
    ] = None,
    data: Data = None,
    settings: Set = None,
    results: Results = RESULTS,
    as_json: Json = False,
) -> None:
    """Say how many specimens a claim needs, and what they cost."""
    scatter = None if sd is None else _scatter(sd)
    answer = api.power(design, sd=scatter, data=data, results=results, overrides=settings or ())
    output.show(answer, as_json, _power(answer), answer.warnings)


def _scatter(text: str) -> float | dict[str, float]:
    """Read the value of ``--sd``: a number, or a number for each response named."""
    try:
        if "=" not in text:
            return float(text)
        pairs = (item.partition("=") for item in listed(text))
        return {name.strip(): float(value) for name, _, value in pairs}
    except ValueError:
        rule = f"must be a number in the unit of the response, or one by response, got {text!r}"
        raise InputError(Fault("--sd", rule, "write 0.4 or peak=0.1,mu0=0.02")) from None


def _power(answer: Power) -> Iterator[Block]:
    for detection in answer.detections:
        matters, sd = _size(detection.practical, detection), _size(detection.sd, detection)
        numerics = f"; numerics {_size(detection.u, detection)}" if detection.u else ""
        yield Sentence(
            f"{detection.response}: {matters} matters; between specimens a difference scatters by "
            f"{sd} ({detection.source}){numerics}"
        )
        columns: dict[str, Callable[[PlannedVerdicts], str]] = {
            "specimens": lambda row: (
                f"{row.blocks}{' (measured)' if row.blocks == answer.blocks else ''}"
            ),
            "shows that none matters": lambda row: (
                f"{100 * row.equal.no_practical_difference:.0f} %"
            ),
            "shows that one matters": lambda row: f"{100 * row.double.matters:.0f} %",
            "cases": lambda row: str(row.cases),
        }
        if any(row.seconds is not None for row in detection.rows):
            columns["time"] = lambda row: output.seconds(row.seconds or 0.0)
        yield Table.of("", detection.rows, columns)
        enough = [
            f"{100 * share:.0f} %: {'no number up to 200' if n is None else f'{n} specimens'}"
            for share, n in detection.enough
        ]
        yield Sentence(
            "Right in both cases (no difference, and one twice as large as matters) with "
            f"{', '.join(enough)}"
        )


def _size(value: float, detection: ContrastDetection) -> str:
    """Return a difference with its unit, or a ratio."""
    return (
        f"{TIMES} {significant(math.exp(value), ratio_digits(math.exp(value)))}"
        if detection.ratio
        else f"{value:.3g} {detection.unit}".rstrip()
    )
