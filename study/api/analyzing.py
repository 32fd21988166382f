"""The verb analyze: a study, a table or a file in, an analysis out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict, Unpack

from study import api
from study.ground.errors import Fault, InputError
from study.ground.tabular import NUMBER, TYPED_COMMA, is_table, names_of, read_csv, read_tidy_csv
from study.ground.units import unit_of_column
from study.reporting.content.analysis_content import analysis_blocks
from study.reporting.content.report_facts import facts
from study.reporting.output.analysis_page import analysis_data, write_page
from study.reporting.output.page import Shown
from study.statistics.analysis.analysis_request import (
    AnovaOptions,
    Practical,
    alpha_faults,
    on_scale,
    threshold,
)
from study.statistics.analysis.analysis_result import AnalysisResult
from study.statistics.analysis.anova import anova
from study.statistics.analysis.anova_table import Contrast
from study.statistics.analysis.comparisons import GroupMoments, SummaryAnalysis
from study.statistics.analysis.linear_model import Formula, Model, read_formula
from study.statistics.analysis.mixed_model import MixedModel, mixed_model, random_terms
from study.statistics.analysis.post_hoc import named_contrasts

if TYPE_CHECKING:
    import pandas as pd

    from study.reporting.content.blocks import Block
    from study.reporting.figures.axes import Drawing


# An analysis as a notebook shows it: a frame, a table in HTML, a figure, a page.


@dataclass(frozen=True, repr=False)
class TableAnalysis(Shown, AnalysisResult):
    """What :func:`study.analyze` returns: an :class:`AnalysisResult` that can be shown."""

    def to_frame(self) -> pd.DataFrame:
        """Table of the analysis of variance, one row a term; what does not apply is missing."""
        return self.anova.to_frame()

    def blocks(self) -> Iterator[Block | None]:
        """Error term, table, effects and assumptions, as ``study analyze`` prints them."""
        return analysis_blocks(self, analysis_data(self))

    def plot(self) -> Drawing:
        """Draw the largest difference of every term with its interval against what matters."""
        from study.reporting.figures.effect_figures import shown_effect_sizes

        data = analysis_data(self)
        (item,) = facts(data)
        return shown_effect_sizes(item, data.labels)

    def report(self, out_dir: str | Path, formats: Sequence[str] = ("html",)) -> Path:
        """Write the page of the analysis, as ``study analyze CSV --report`` does."""
        return write_page(self, out_dir, formats=formats)


#: levels from which labels that are numbers are remarked upon: two say no more as numbers
FEWEST_NUMBERS = 3


def number_levels(frame: pd.DataFrame, columns: Sequence[str]) -> list[str]:
    """Name columns of labels that look like numbers: they are never taken as such."""
    labels = {name: set(map(str, frame[name].unique())) for name in columns}
    numbers = [
        name
        for name, its_labels in labels.items()
        if len(its_labels) >= FEWEST_NUMBERS and all(map(NUMBER.fullmatch, its_labels))
    ]
    text = f"the levels of {', '.join(map(repr, numbers))} are numbers, and are taken as labels: "
    text += f"--numeric {','.join(numbers)} asks for a surface over them"
    return [text] if numbers else []


def analyze(
    source: str | Path | pd.DataFrame,
    response: str | None = None,
    factors: Sequence[str] = (),
    *,
    results: str | Path = Path("results"),
    decimal: str = ".",
    sheet: str = "",
    **options: Unpack[AnovaOptions],
) -> TableAnalysis:
    """Analyze one response of a finished study, of a CSV file or of a table.

    Parameters
    ----------
    source : str, Path or DataFrame
        Results folder or design of a study, a tidy CSV (one row a run), or a table.
    response : str, optional
        Column of the response, or a formula: ``"len ~ supp * dose"``, ``"log(y) ~ a + b +
        Error(block)"``; a study's first response by default.
    factors : sequence of str
        Columns of the factors; all factors of a study by default.
    results : Path
        Folder of the results, where ``source`` is the name of a study.
    decimal : {".", ","}
        Decimal mark of a CSV.
    sheet : str
        Sheet of a workbook that has several.
    **options : optional
        As for :func:`study.anova`: ``block``, ``unit``, ``whole_plot``, ``replicates``,
        ``type``, ``model``, ``error``, ``practical``, ``transform``, ``alpha``, ``seed``.

    Returns
    -------
    Analysis
        Error term, table, effects with intervals and verdicts, assumptions; ``to_frame()``,
        ``plot()``, ``report(DIR)``, and a table in a notebook.

    Raises
    ------
    InputError
        If there is nothing to analyze, or a column does not exist.
    RefusedError
        If the answer would be meaningless.
    """
    if response is not None and "~" in response:
        parsed = read_formula(response)
        response, factors = parsed.response, factors or parsed.factors
        options = {**asked_of(parsed), **options}
    if isinstance(source, (str, Path)) and not is_table(source):
        # what is not said is taken from the design
        of_records = api.load(source, results).analyzed(response, factors, options)
        return TableAnalysis.of(of_records)
    faults = []
    if response is None:
        faults.append(Fault("--response", "is missing", "name the column of the response"))
    if not factors:
        mend = "name the columns: --factors for labels, --numeric for numbers"
        faults.append(Fault("--factors", "is missing", mend))
    if faults:
        raise InputError(faults)
    columns, blocks, unit = list(factors), options.get("block"), options.get("unit")
    if isinstance(source, (str, Path)):
        source = read_tidy_csv(
            Path(source), str(response), columns, blocks, unit, decimal, sheet=sheet
        )
    analysis = anova(source, str(response), columns, **options)
    return TableAnalysis.of(analysis.warn(*number_levels(source, factors)))


def analyze_summary(
    source: Path,
    factors: Sequence[str],
    columns: Sequence[str],
    *,
    practical: str | float | None = None,
    alpha: float = 0.05,
    decimal: str = ".",
) -> SummaryAnalysis:
    """Compare groups by mean, standard deviation and number: one row of a CSV each."""
    if len(columns) != 3 or not factors:
        rule = f"needs --factors and three columns, got {', '.join(columns) or 'none'}"
        raise InputError(Fault("--summary", rule, "name mean, standard deviation and number"))
    if faults := alpha_faults(alpha):
        raise InputError(faults)
    table = read_csv(
        source, required=[*factors, *columns], numbers=columns, decimal=decimal,
        declared_by=TYPED_COMMA,
    )  # fmt: skip
    mean, sd, n = (table.numbers(name) for name in columns)
    labels = list(zip(*(table.text(name) for name in factors), strict=True))
    faults = [
        Fault(table.cell_name(i, columns[k]), rule)
        for i in range(len(labels))
        for k, ok, rule in (
            (1, sd[i] > 0, "a standard deviation is positive"),
            (2, n[i] >= 2 and float(n[i]).is_integer(), "a number of rows is two or more"),
        )
        if not ok
    ]
    if len(set(labels)) < len(labels) or len(labels) < 2:
        faults.append(Fault(str(source), "needs two groups or more, each on one row"))
    if faults:
        raise InputError(faults)
    limit = threshold(practical, unit_of_column(columns[0]))
    groups = GroupMoments(tuple(" ".join(row) for row in labels), n, mean, sd**2)
    return SummaryAnalysis(
        groups, groups.one_way(equal=True), groups.one_way(equal=False),
        groups.pairs(alpha, equal=True), groups.pairs(alpha, equal=False),
        on_scale(limit, float(n @ mean / n.sum())),
    )  # fmt: skip


def asked_of(formula: Formula) -> AnovaOptions:
    """Options that a formula says."""
    full = formula.model == ("full",)
    options: AnovaOptions = {"model": "full" if full else [list(term) for term in formula.terms]}
    if formula.blocks:
        options["block"] = list(formula.blocks) if len(formula.blocks) > 1 else formula.blocks[0]
    if formula.whole_plot:
        options["whole_plot"] = list(formula.whole_plot)
    if formula.transform != "none":
        options["transform"] = formula.transform
    return options


# A mixed model of a study, a table or a file: blocks and other columns as random factors.


class MixedOptions(TypedDict, total=False):
    """Keywords of :func:`study.mixed_model`, where they are described."""

    block: str | Sequence[str] | None
    random: Sequence[str]
    covariates: Sequence[str]
    model: Model
    practical: Practical
    contrasts: Sequence[str]
    copies: str
    alpha: float


def fit_mixed_model(
    source: str | Path,
    response: str | None,
    factors: Sequence[str],
    options: MixedOptions,
    *,
    results: str | Path = Path("results"),
    decimal: str = ".",
) -> MixedModel:
    """Fit a mixed model by REML to one response of a study or of a CSV with one row a run.

    A study lends its first response, its factors and its specimens as blocks where none are named.
    """
    path = Path(source)
    if is_table(source):
        if response is None:
            raise InputError(Fault("--response", "is missing", "name the column of the response"))
        blocks = names_of(options.get("block"))
        terms = random_terms(factors, blocks, options.get("random", ()))
        random = [n for n in dict.fromkeys(n for t in terms for n in t) if n not in factors]
        labels = (factors, random) if factors else (random[:1], random[1:])
        table = read_tidy_csv(path, response, *labels, None, decimal, options.get("covariates", ()))
        return mixed_model(table, response, factors, **options)
    study = api.load(source, results)
    if options.get("covariates"):
        rule = "a study has factors alone"
        raise InputError(Fault("--covariates", rule, "give a CSV with that column"))
    if len(study.manifest["blocks"]) < 3:
        rule = "a mixed model needs three blocks or more"
        raise InputError(Fault("measurements.block", rule, "add specimens, or leave out reml"))
    model = study.design.analysis.model
    declared = model if isinstance(model, str | int) else list(model)
    # cells of records that agree are one computation, no rows that were typed twice
    defaults: MixedOptions = {"block": "block", "model": declared, "copies": "independent"}
    options = {**defaults, **options}
    chosen = next((r for r in study.design.responses if r.name == response), None)
    chosen = study.design.responses[0] if response is None else chosen
    if chosen is not None:
        given = options.get("practical")
        limit = chosen.practical if given is None else threshold(given, chosen.unit)
        options["practical"] = limit
    names = list(factors) or [f.name for f in study.design.factors if len(f.levels) > 1]
    named = str(response) if chosen is None else chosen.name
    return mixed_model(study.table, named, names, **options)


# Differences of two settings that an analyst names, of a finished analysis.


def contrasts(found: AnalysisResult, asked: str | Sequence[str]) -> tuple[Contrast, ...]:
    """Estimate differences of sets of cells that the analyst names.

    Parameters
    ----------
    found : AnalysisResult
        Of :func:`analyze` or :func:`study.anova`.
    asked : str or sequence of str
        Such as ``"material=stiff, range=60 % - material=soft, range=60 %"``; a factor that a
        side leaves out is averaged over.

    Returns
    -------
    tuple of Contrast
        Difference, its interval alone and with all others together, p, Holm's p, U, verdict.

    Raises
    ------
    InputError
        For a factor or level that does not exist, or a setting without a row.
    """
    asked = [asked] if isinstance(asked, str) else list(asked)
    estimated, faults = named_contrasts(found, asked)
    if faults:
        raise InputError(faults)
    return estimated
