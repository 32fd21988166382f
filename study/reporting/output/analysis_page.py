"""The page of one analysis of a table: what a study's report shows of a response, and more.

Beside the verdicts it has what a user of Minitab looks for: the table with its error and total,
coefficients, all pairs of levels, four residual plots in one, unusual observations.
"""

from __future__ import annotations

import platform
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pandas as pd

from study import __version__ as package_version
from study.ground.errors import Fault, InputError
from study.ground.files import sha256_of
from study.ground.units import is_known, unit_of_column
from study.reporting.content import analysis_content, methods, tables
from study.reporting.content.blocks import (
    Block,
    Blocks,
    Definition,
    Definitions,
    Figures,
    Folded,
    Heading,
    Sentence,
    titled,
)
from study.reporting.content.effect_words import normality_phrase
from study.reporting.content.report_facts import Facts, facts
from study.reporting.content.text import clean, count, listing, sentence, slug
from study.reporting.figures.axes import Plot, figures_of
from study.reporting.output import study_page, write
from study.reporting.output.page import Pages, replace_file
from study.reporting.results.study_result import ReportData, ResponseAnalysis
from study.statistics.analysis.analysis_result import AnalysisResult
from study.statistics.analysis.comparisons import Comparisons
from study.statistics.analysis.post_hoc import (
    coefficient_table,
    diagnosed_rows,
    pairwise,
    unusual_observations,
)
from study.statistics.surfaces.surface_factors import Runs
from study.statistics.surfaces.surface_fitting import SEE_SURFACE
from study.statistics.surfaces.surface_result import FittedSurface

#: Cells beyond which their spreads, and rows beyond which their values, are not drawn one by one.
MOST_CELLS = 60
MOST_ROWS_DRAWN = 2000
#: Blocks that are listed.
MOST_BLOCKS = 20
#: A factor and its levels compared with one of them.
Reference = tuple[str, "Comparisons"]


def prepare(
    analysis: AnalysisResult,
    data: ReportData,
    stem: str,
    rows: pd.DataFrame | None,
    reference: Reference | None = None,
) -> Pages:
    """Compute every sentence, table and figure of both pages.

    ``rows`` have fit, residuals, leverage and Cook's distance.
    """
    from study.reporting.figures import study_figures

    (item,) = facts(data)
    figures = _figures(analysis, data, item, rows)
    blocks: list[Block | None] = [
        *_data(analysis, data, item),
        *study_page.error_terms(data, (item,)),
    ]
    if analysis.anova.rows:
        pairs = analysis_content.pairwise(pairwise(analysis), item, data)
        against = reference and analysis_content.against_reference(*reference, data)
        blocks += [
            *_variance(analysis, data, item),
            *_means(data, item, figures),
            Heading("Comparisons", 2, "pairs") if pairs or against else None,
            pairs,
            *titled(against),
            *_residuals(analysis, data, item, figures),
            Heading("Assumptions", 2, "assumptions"),
            analysis_content.checks(analysis),
            figures.get("spread"),
        ]
    warnings = [sentence(clean(text)) for text in dict.fromkeys((*data.warnings, *analysis.notes))]
    shown, name = (study_figures.overview(data, (item,)), None), item.title
    return study_page.two_pages(data, (item,), stem, name, shown, blocks, warnings, rows="rows.csv")


def _data(analysis: AnalysisResult, data: ReportData, item: Facts) -> Iterator[Block]:
    log = ", analyzed on the log: effects are ratios" if analysis.request.scale.is_log else ""
    cells = len(analysis.cell_means)
    yield Heading("Data", 2, "data")
    yield Definitions([
        Definition("Response", [Sentence(log, item.title)]),
        *study_page.blocks_of(data, MOST_BLOCKS),
        Definition("Rows", [Sentence(f"{len(data.table):,} analyzed, in {cells:,} cells")]),
        *([Definition("File", [Sentence(data.citation)])] if data.citation else []),
    ])  # fmt: skip
    yield analysis_content.factor_information(data)


def _variance(analysis: AnalysisResult, data: ReportData, item: Facts) -> Blocks:
    title = f"Analysis of variance, type {analysis.anova.type}"
    yield Heading(title, 2, "anova", short="Analysis of variance")
    yield tables.anova(item, data, "anova")
    yield analysis_content.model_summary(analysis)
    yield Folded(tables.SIZES, (tables.sizes(item, data),))
    fitted = coefficient_table(analysis)
    if isinstance(fitted, str):
        yield Heading("Coefficients")
        yield Sentence(f"No table of coefficients: {fitted}.")
    else:
        yield from titled(analysis_content.coefficients(fitted, item))
    yield from titled(analysis_content.robustness(analysis, data))


def _means(data: ReportData, item: Facts, figures: Figures) -> Blocks:
    yield Heading("Means and effects", 2, "means")
    yield analysis_content.open_effects(item, data)
    yield from study_page.drawn(figures, "contrasts", "means", "interactions")
    yield from titled(analysis_content.means(item, data))
    yield from titled(analysis_content.simple_effects(item, data))
    yield from titled(analysis_content.contrasts(item), analysis_content.ASKED)
    yield figures.get("cells")


def _residuals(analysis: AnalysisResult, data: ReportData, item: Facts, figures: Figures) -> Blocks:
    yield Heading("Residuals", 2, "residuals")
    shown = list(study_page.drawn(figures, "four-in-one", "influence"))
    if shown and any(row.p_gg is not None for row in item.rows):
        source = f"Residuals of cells and {clean(data.block)} added."
        elsewhere = (
            " No p of this page rests on them: each effect is tested against its own interaction "
            "with the blocks."
        )
        yield Sentence(source if item.is_mixed else source + elsewhere)
    yield from shown
    if not shown:
        yield Sentence("Nothing is left over by the model, so there are no residuals to look at.")
    table = analysis_content.unusual(unusual_observations(analysis))
    yield from titled(table)
    if table is None and "influence" in figures:
        yield Sentence(
            "No row has a standardized residual beyond 2, a high leverage or a Cook's distance "
            "that moves the fit."
        )


def _figures(
    analysis: AnalysisResult, data: ReportData, item: Facts, rows: pd.DataFrame | None
) -> Figures:
    """Figures of a study's response, with Minitab's residual plots for the study's."""
    from study.reporting.figures import residual_figures, study_figures

    without = {"residuals"}
    if len(data.table) > MOST_ROWS_DRAWN or len(analysis.cell_means) > MOST_CELLS:
        without |= {"cells"}
    if len(analysis.cell_means) > MOST_CELLS:
        without |= {"spread"}
    drawn = study_figures.of_response(data, item, without)
    if rows is None or not item.terms:
        return drawn
    points = residual_figures.residual_points(rows)
    influence = analysis.assumptions.influence
    limit = None if influence is None else influence.limit
    plots: dict[str, Plot] = {
        "four-in-one": (
            "Residual plots",
            lambda: points,
            lambda frame: residual_figures.draw_residuals(item, data, frame, ordered=True),
            lambda frame: sentence(
                f"{count(len(frame), 'residual')}; {normality_phrase(item, data.alpha)}. The order "
                "is that of the rows in the file: the run order only if they were written down as "
                "they were run. A level whose residuals scatter more has the larger variance"
                f"{residual_figures.drawn_words(frame)}"
            ),
        ),
        "influence": (
            "Influence",
            lambda: points[["row", "leverage", "cook", "standardized", "press"]],
            lambda _: residual_figures.draw_influence(points, data, limit),
            lambda _: residual_figures.influence_caption(points, limit),
        ),
    }
    return drawn | figures_of(plots, slug(item.name), item.title)


#: tables that LaTeX has
_IN_LATEX = ("verdicts", "anova", "Coefficients", "Means", "pairwise comparisons")


def write_page(
    analysis: AnalysisResult,
    out_dir: str | Path,
    *,
    source: AnalysisSource | None = None,
    compared: Reference | None = None,
    formats: Sequence[str] = ("html",),
) -> Path:
    """Write the page of an analysis and its numbers into a folder; return its main file."""
    check_taken(analysis.request.factors)
    data, chosen = analysis_data(analysis, source), write.checked_formats(formats)
    folder, rows = Path(out_dir), diagnosed_rows(analysis)
    stem = slug(f"{data.name} {analysis.request.response}")
    pages = prepare(analysis, data, stem, rows, compared)
    files = write.write_pages(folder, stem, pages, chosen)
    write.write_numbers(files, analysis.to_json())
    rows = analysis.residuals if rows is None else rows
    replace_file(files / "rows.csv", write.of_frame(rows))
    html, latex = folder / f"{stem}.html", folder / f"{stem}.tex"
    if "tex" in chosen:
        shown = [pages.tables[name] for name in _IN_LATEX if name in pages.tables]
        if compared is not None:
            shown.append(analysis_content.against_reference(*compared, data))
        methods_text = methods.paragraph(data, facts(data))
        captioned = [(t.name.capitalize(), t) for t in shown]
        replace_file(latex, write.document(captioned, methods_text, stem))
    return {"html": html, "pdf": html, "tex": latex, "csv": files / "rows.csv"}[chosen[0]]


#: Names that the rows of an analysis have for themselves.
TAKEN = frozenset(
    ("row", "cell", "representative", "response", "block", "fitted", "residual", "leverage", "cook",
     "standardized", "press", "score", "case_id", "status", "seconds", "mean", "n", "y", "factor",
     "level", "other", "other_level", "place", "number")
)  # fmt: skip
_PACKAGES = ("numpy", "scipy", "pandas", "statsmodels")


@dataclass(frozen=True)
class AnalysisSource:
    """Where the rows of an analysis come from, and how it was asked for."""

    #: The CSV; None for a table in memory.
    path: Path | None = None
    #: What the command line was given: ``{"--response": "life"}``.
    flags: Mapping[str, str] = field(default_factory=dict)
    #: Differences that were asked for by name.
    contrasts: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name of the table."""
        return "table" if self.path is None else self.path.name.split(".")[0] or "table"

    def commands(self) -> tuple[str, ...]:
        """Lines that check the file and make the analysis again; none for a table in memory."""
        if self.path is None:
            return ()
        check = f"{sha256_of(self.path)}  {self.path}"
        given = [word for flag, value in self.flags.items() if value for word in (flag, value)]
        words = [word for text in self.contrasts for word in ("--contrast", text)]
        again = ["study", "analyze", str(self.path), *given, *words]
        return (f"echo {shlex.quote(check)} | sha256sum --check", shlex.join(again))

    @property
    def provenance(self) -> dict[str, str]:
        """Versions, and the hash of the file."""
        out = {"version of study": package_version, "version of python": platform.python_version()}
        for package in _PACKAGES:
            with suppress(PackageNotFoundError):
                out[f"version of {package}"] = version(package)
        if self.path is not None:
            out[f"sha256 of {self.path.name}"] = sha256_of(self.path)
        return out


def check_taken(factors: Sequence[str]) -> None:
    """Refuse factors with a name that the rows of a report have for themselves."""
    taken = [name for name in factors if name in TAKEN]
    if taken:
        rule = "is a name that the report needs for a column of its own"
        mend = "rename the column, say to the quantity that it holds"
        raise InputError([Fault(f"column {name!r}", rule, mend) for name in taken])


def analysis_data(analysis: AnalysisResult, source: AnalysisSource | None = None) -> ReportData:
    """Gather what a report shows of one analysis: levels, rows, provenance."""
    request, limit = analysis.request, analysis.request.scale.practical
    rows, block = analysis.residuals, analysis.data.block
    levels = {e.term: e.levels for e in analysis.effects if e.is_main}
    texts = {n: rows[n].astype(str) for n in (*request.factors, "block") if n in rows}
    table = rows[["row"]].rename(columns={"row": "case_id"}).assign(**texts, status="converged")
    title, unit = _named(request.response)
    of_response = ResponseAnalysis(
        request.response,
        unit,
        analysis,
        practical=None if limit is None else limit.value,
        relative=bool(limit and limit.relative),
        transform=request.scale.transform,
        title=title,
    )
    data = data_of_table(
        source or AnalysisSource(),
        of_response,
        f"How does {request.response} depend on {listing(list(request.factors))}?",
        {n: levels.get(n) or tuple(rows[n].astype(str).unique()) for n in request.factors},
        table.assign(**{request.response: rows["response"]}),
        len(analysis.cell_means),
    )
    blocks = () if block is None else tuple(rows["block"].astype(str).unique())
    return replace(data, block=block or "", blocks=blocks, seed=request.seed, alpha=request.alpha)


def _named(column: str) -> tuple[str, str]:
    """Name of a response, and its unit where that ends the name in brackets."""
    unit = unit_of_column(column)
    if unit == "1" or not is_known(unit) or not (title := column.rpartition(unit)[0][:-1].strip()):
        return column, ""
    return title, unit


def data_of_table(
    source: AnalysisSource,
    response: ResponseAnalysis,
    question: str,
    factors: Mapping[str, tuple[str, ...]],
    table: pd.DataFrame,
    cells: int,
) -> ReportData:
    """Gather what a report shows of a table, whatever was asked of it."""
    return ReportData(
        name=source.name,
        question=question,
        factors=factors,
        table=table,
        analyses=(response,),
        citation="" if source.path is None else source.path.name,
        provenance=source.provenance,
        commands=source.commands(),
        scheme=f"a table of {len(table):,} rows was analyzed",
        cells=cells,
        labels={response.name: response.title, **{name: name for name in factors}},
        is_table=True,
    )


def surface_data(fits: Sequence[FittedSurface], source: AnalysisSource) -> ReportData:
    """Gather what a report shows of the surfaces of one response of a table."""
    good = [(fitted.surface.runs, fitted.labels) for fitted in fits if fitted.surface is not None]
    table = pd.concat([_settings_of(runs, labels) for runs, labels in good], ignore_index=True)
    table.insert(0, "case_id", [str(n + 1) for n in range(len(table))])
    runs, names = good[0][0], [*fits[0].labels, *good[0][0].names]
    title, unit = _named(runs.name)
    data = data_of_table(
        source,
        ResponseAnalysis(
            runs.name, unit, None, practical=fits[0].practical, title=title, refused=SEE_SURFACE
        ),
        f"How does {runs.name} depend on {listing(names)}?",
        {name: tuple(table[name].unique()) for name in names},
        table,
        sum(len(distinct_runs.distinct()[0]) for distinct_runs, _ in good),
    )
    return replace(
        data,
        block="block" if runs.blocks else "",
        blocks=tuple(table["block"].unique()) if runs.blocks else (),
        surfaces=tuple(replace(fitted, unit=unit) for fitted in fits),
        ranges={f.name: f"{f.low:g} to {f.high:g}" for f in runs.factors},
    )


def _settings_of(runs: Runs, labels: Mapping[str, str]) -> pd.DataFrame:
    settings = {
        factor.name: [f"{factor.setting(float(x)):.6g}" for x in column]
        for factor, column in zip(runs.factors, runs.coded.T, strict=True)
    }
    frame = pd.DataFrame({**{n: [at] * runs.response.size for n, at in labels.items()}, **settings})
    if runs.blocks:
        frame["block"] = list(runs.blocks)
    return frame.assign(status="converged", **{runs.name: runs.response})
