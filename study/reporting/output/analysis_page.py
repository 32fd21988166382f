"""The page of one analysis of a table: what a study's report shows of a response, and more.

Beside the verdicts it has what a user of Minitab looks for: the table with its error and total,
coefficients, all pairs of levels, four residual plots in one, unusual observations.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from study.reporting.content import analysis_content, methods, sentences, tables, verdicts
from study.reporting.content.blocks import Figure, Table
from study.reporting.content.effect_words import size
from study.reporting.content.front_page import in_few
from study.reporting.content.numbers import p_phrase
from study.reporting.content.report_facts import Facts, facts
from study.reporting.content.text import clean, count, listing, sentence, term_name
from study.reporting.figures import registry, residual_figures
from study.reporting.figures.registry import Plot, made, slug
from study.reporting.output import page, write
from study.reporting.output.page import _environment, data_folder, replace_file
from study.reporting.output.write import document as latex_document

if TYPE_CHECKING:
    import pandas as pd

    from study.reporting.results.study_result import ReportData
    from study.statistics.analysis.analysis_result import AnalysisResult
    from study.statistics.analysis.comparisons import Comparisons
    from study.statistics.analysis.post_hoc import (
        CoefficientTable,
        PairwiseDifference,
        UnusualObservations,
    )


#: Cells beyond which their spreads, and rows beyond which their values, are not drawn one by one.
MOST_CELLS = 60
MOST_ROWS_DRAWN = 2000


@dataclass(frozen=True)
class AnalysisReport:
    """One analysis of a table and everything that its page shows."""

    found: AnalysisResult
    #: Name, factors, rows and the one response.
    data: ReportData
    coefficients: CoefficientTable
    #: All pairs of levels of every factor.
    pairs: tuple[PairwiseDifference, ...]
    #: Rows that the fit describes badly or leans on.
    unusual: UnusualObservations | None
    #: Every row with fit, residuals, leverage and Cook's distance.
    rows: pd.DataFrame | None
    #: A factor whose levels are compared with one of them.
    reference: tuple[str, Comparisons] | None = None


def prepare(report: AnalysisReport) -> page.Contents:
    """Compute every sentence, table and figure of the page."""
    (item,) = facts(report.data)
    figures = _figures(report, item)
    section = page.Section(
        facts=item,
        anchor="effects",
        verdicts=tuple(
            verdicts.verdict(e, item, report.data.labels)
            for e in item.terms
            if e.is_main or e.strength == "matters"
        ),
        contrasts=None,  # among the tables of the page
        anova=tables.anova(item, report.data) if item.rows else None,
        strata=None,
        figures=figures,
        assumptions=None,  # among the tables of the page
        cheaper="",
    )
    overview = registry.overview(report.data, (item,))
    return page.Contents(report.data, (item,), (section,), overview, _tables(report, item))


def _tables(report: AnalysisReport, item: Facts) -> dict[str, Table]:
    analysis, data = report.found, report.data
    shown: dict[str, Table | None] = {
        "verdicts": tables.verdicts((item,), data),
        "factors": analysis_content.factor_information(data),
    }
    if analysis.anova.rows:
        shown |= {
            "anova": analysis_content.analysis_of_variance(analysis),
            "summary": analysis_content.model_summary(analysis),
            "coefficients": analysis_content.coefficients(report.coefficients, item),
            "means": analysis_content.means(item, data),
            "simple": analysis_content.simple_effects(item, data),
            "contrasts": analysis_content.contrasts(item),
            "pairs": analysis_content.pairwise(report.pairs, item, data),
            "checks": analysis_content.checks(analysis),
            "unusual": analysis_content.unusual(report.unusual),
            "robustness": analysis_content.robustness(analysis, data),
        }
    if report.reference is not None:
        shown["reference"] = analysis_content.against_reference(*report.reference, data)
    return {name: table for name, table in shown.items() if table is not None}


def _figures(report: AnalysisReport, item: Facts) -> dict[str, Figure]:
    """Figures of a study's response, with Minitab's residual plots for the study's."""
    data = report.data
    without = {"residuals"}
    if len(data.table) > MOST_ROWS_DRAWN or len(report.found.data.cell_means) > MOST_CELLS:
        without |= {"cells"}
    if len(report.found.data.cell_means) > MOST_CELLS:
        without |= {"spread"}
    drawn = registry.of_response(data, item, without)
    if report.rows is None or not item.terms:
        return drawn
    points = residual_figures.residual_points(report.rows)
    limit = None if report.unusual is None else report.unusual.cook_limit
    plots: dict[str, Plot] = {
        "four-in-one": (
            "Residual plots",
            lambda: points,
            lambda frame: residual_figures.draw_residuals(frame, item, data, ordered=True),
            lambda frame: residual_figures.four_in_one_caption(frame, item, data.alpha),
        ),
        "against-factors": (
            "Residuals versus factors",
            lambda: points[[*data.factors, "residual"]],
            lambda frame: residual_figures.draw_against_factors(frame, item, data),
            residual_figures.against_factors_caption,
        ),
        "influence": (
            "Influence",
            lambda: points[["row", "leverage", "cook", "standardized", "press"]],
            lambda _: residual_figures.draw_influence(points, data, limit),
            lambda _: residual_figures.influence_caption(points, limit),
        ),
    }
    return drawn | made(plots, slug(item.name), item.title)


def answer(report: AnalysisReport, item: Facts) -> tuple[str, ...]:
    """Answer first: verdicts where a smallest difference that matters was given, else tests."""
    if not item.terms:
        return tuple(sentence(clean(note)) for note in item.warnings) or ("Nothing to analyze.",)
    if any(effect.practical is not None for effect in item.effects):
        return sentences.answer(report.data, (item,))
    return tuple(text for text in (_tested(report, item), _NO_VERDICT) if text)


_NO_VERDICT = (
    "No smallest difference that matters was given, so no factor has a verdict: a small p says "
    "that an effect is there, not that it is large enough to care. Give one with --practical."
)


def _tested(report: AnalysisReport, item: Facts) -> str:
    """Which terms differ by Holm's p, and which are not shown to."""
    tested = [e for e in item.terms if e.p_holm is not None]
    if not tested:
        return "There is no error term, so nothing is tested."
    names = {e.term: term_name(e.term, report.data.labels) for e in tested}
    shown = [
        f"{clean(names[e.term])} ({size(e, item)}, {p_phrase(e.p_holm)})"
        for e in tested
        if _below(e.p_holm, item)
    ]
    rest = [clean(names[e.term]) for e in tested if not _below(e.p_holm, item)]
    parts = []
    if shown:
        parts.append(f"an effect is shown of {listing(shown)}")
    if rest:
        parts.append(f"none is shown of {listing(rest, 'or')}")
    adjusted = f"at {item.alpha:g}, adjusted by Holm for {count(len(tested), 'term')}"
    return sentence(f"for {clean(item.title)}, {'; '.join(parts)} ({adjusted})")


def _below(p: float | None, item: Facts) -> bool:
    return p is not None and p < item.alpha


def pages(report: AnalysisReport, contents: page.Contents) -> tuple[str, str]:
    """Return the HTML of the first page and of the second."""
    (item,) = contents.found
    data = contents.data
    stem = _stem(report)
    lines = answer(report, item)
    first = page.front_page(contents, item.title, stem, in_few(lines), "rows.csv")
    second = page.filled(
        "analysis.html.j2",
        c=contents,
        s=contents.sections[0],
        data=data,
        first=page.page_names(stem)[0],
        found=report.found,
        answer=lines,
        no_coefficients=report.coefficients.reason,
        error_terms=sentences.error_terms(data, contents.found),
        verdict_groups=page._groups(contents.tables["verdicts"]),
        methods=_methods(contents),
        what_if=verdicts.WHAT_IF,
        glossary=methods.TERMS,
        warnings=_warnings(report),
        own_interactions=any(row.p_gg is not None for row in report.found.anova.rows),
        provenance=page._provenance(data),
    )
    return first, second


def _stem(report: AnalysisReport) -> str:
    """Begin of the names of the files of a report."""
    return slug(f"{report.data.name} {report.found.request.response}")


def _warnings(report: AnalysisReport) -> tuple[str, ...]:
    texts = (*report.data.warnings, *report.found.notes)
    return tuple(sentence(clean(text)) for text in dict.fromkeys(texts))


def _methods(contents: page.Contents) -> str:
    """Methods of a table: those of a study but what only simulations have."""
    data, (item,) = contents.data, contents.found
    parts = [methods._design(data), methods._measurements(data), methods._statistics(item, data)]
    parts += [methods.residual_tests((item,), data), methods._software(data)]
    return " ".join(part for part in parts if part)


def write_analysis(
    report: AnalysisReport, out_dir: str | Path, formats: Sequence[str] = ("html",)
) -> Path:
    """Write the page of an analysis into a folder and return its main file.

    The pages are ``<table>-<response>.html`` and ``<table>-<response>-details.html``; beside them
    ``<table>-<response>-data/`` holds the CSV of every table and figure, every figure as SVG,
    ``rows.csv`` (every row with fit, residual, leverage) and ``numbers.json``, the document of
    ``study analyze --json``.
    """
    chosen = write.checked_formats(formats)
    folder = Path(out_dir)
    stem = _stem(report)
    contents = prepare(report)
    files = data_folder(folder, stem)
    _write_data(report, contents, files)
    html, latex = folder / f"{stem}.html", folder / f"{stem}.tex"
    write.write_pages(folder, stem, pages(report, contents), chosen)
    if "tex" in chosen:
        shown = [(name, t) for name, t in contents.tables.items() if name in _IN_LATEX]
        captions = [(t.name.capitalize(), t) for _, t in shown]
        replace_file(latex, latex_document(captions, _methods(contents)))
    return {"html": html, "pdf": html, "tex": latex, "csv": files / "rows.csv"}[chosen[0]]


_IN_LATEX = ("verdicts", "anova", "coefficients", "means", "pairs", "reference")


def _write_data(report: AnalysisReport, contents: page.Contents, files: Path) -> None:
    numbers = report.found.to_json()
    text = json.dumps(numbers, indent=1, allow_nan=False)
    replace_file(files / "numbers.json", text + "\n")
    rows = report.found.data.residuals if report.rows is None else report.rows
    replace_file(files / "rows.csv", write.of_frame(rows))
    sizes = [contents.sections[0].anova] if contents.sections[0].anova is not None else []
    write.write_tables(files, (*contents.tables.values(), *sizes))
    write.write_figures(files, contents.all_figures)


# The page of a verb about one thing: answer, figures, tables, warnings, data beside it.


@dataclass(frozen=True)
class AnswerPage:
    """What a page of one answer shows."""

    #: What it is about, for example ``mesh convergence``.
    kind: str
    stem: str
    #: Of what was asked; as the user wrote them.
    name: str
    question: str
    answer: Sequence[str]
    figures: Sequence[Figure]
    tables: Sequence[Table]
    warnings: Sequence[str] = ()
    #: What ``--json`` prints, where it is written beside the page.
    document: Mapping[str, object] | None = None


def write_answer(page: AnswerPage, out_dir: str | Path) -> Path:
    """Write a page, and the CSV of its figures and tables in a folder beside it."""
    folder = Path(out_dir)
    stem = f"{slug(page.name)}-{page.stem}"
    files = data_folder(folder, stem)
    write.write_figures(files, page.figures, drawn=False)
    write.write_tables(files, page.tables)
    if page.document is not None:
        numbers = json.dumps(page.document, indent=1, allow_nan=False)
        replace_file(files / "numbers.json", numbers + "\n")
    text = _environment().get_template("answer.html.j2").render(
        kind=page.kind, name=clean(page.name), question=clean(page.question), answer=page.answer,
        figures=page.figures, tables=page.tables, warnings=[clean(line) for line in page.warnings],
    )  # fmt: skip
    replace_file(folder / f"{stem}.html", clean(text))
    return folder / f"{stem}.html"
