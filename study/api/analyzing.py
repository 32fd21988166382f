"""The verb analyze: a study, a table or a file in, an analysis out."""

from __future__ import annotations

import platform
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict, Unpack

import numpy as np

import study
from study import api
from study.api.folders import is_table
from study.ground.arrays import Array
from study.ground.bounded_file import sha256_of
from study.ground.canonical import Keyed
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError, StudyError, nearest
from study.ground.tabular import NUMBER, TYPED_COMMA, names_of, read_csv, read_tidy_csv
from study.harness.design.study_file import SCORED, ResponseSpec
from study.harness.runner.expansion import held_out
from study.harness.runner.record_analysis import analyze_records, effects_of_records
from study.harness.runner.response import CURVE_RESPONSES
from study.reporting.content.analysis_content import analysis_blocks
from study.reporting.content.report_facts import facts
from study.reporting.output.analysis_page import write_analysis
from study.reporting.output.page import Shown
from study.reporting.results.study_result import (
    FITTED_CURVE,
    OTHER_SPECIMEN,
    OTHER_TEST,
    DepthEffect,
    ReportData,
    ResponseAnalysis,
)
from study.statistics.analysis.analysis_request import alpha_faults, threshold
from study.statistics.analysis.analysis_result import AnalysisResult
from study.statistics.analysis.anova import anova
from study.statistics.analysis.comparisons import (
    Comparisons,
    FamilyTest,
    GroupMoments,
    holm_family,
)
from study.statistics.analysis.linear_model import Formula, read_formula
from study.statistics.analysis.mixed_model import MixedModel, mixed_model, random_terms
from study.statistics.analysis.post_hoc import dunnett, dunnett_of_model, dunnett_over_groups
from study.statistics.analysis.simple_effects import CANNOT_TELL, claim

if TYPE_CHECKING:
    import pandas as pd

    from study.harness.design.spec import Design
    from study.harness.design.study_file import Analysis as analysis_Analysis
    from study.harness.record.record import Record
    from study.reporting.content.blocks import Block
    from study.reporting.figures.axes import Drawing
    from study.reporting.results.study_result import StudyResult
    from study.statistics.analysis.analysis_request import AnovaOptions, Practical
    from study.statistics.analysis.linear_model import Model


# Levels of a factor compared with one of them.


def against_reference(analysis: AnalysisResult, level: str) -> tuple[str, Comparisons]:
    """Compare all levels of a factor with one of them (Dunnett 1955)."""
    named, _, level_name = level.rpartition("=")
    levels = {e.term: e.levels for e in analysis.effects if e.term in analysis.request.factors}
    holding = [
        f for f, its_levels in levels.items() if level_name in its_levels and named in ("", f)
    ]
    if len(holding) != 1:
        every = [name for its_levels in levels.values() for name in its_levels]
        rule = "is a level of several factors" if holding else "is no level of a factor"
        mend = f"write {holding[0]}={level_name}" if holding else nearest(level_name, every)
        raise InputError(Fault("--reference", f"{level_name!r} {rule}", mend))
    factor = holding[0]
    effect, row = analysis.effect(factor), analysis.anova.row(factor)
    alpha, seed = analysis.request.alpha, analysis.request.seed
    if row.error == "residual" and row.df_error and effect.pairs:
        return factor, dunnett_of_model(effect, level_name, row.df_error, alpha, seed)
    compared = _of_rows(analysis, factor, level_name)
    return factor, compared.as_ratios() if analysis.request.scale.is_log else compared


def _of_rows(analysis: AnalysisResult, factor: str, reference: str) -> Comparisons:
    """Compare levels by their rows, or by their means in each block, on the analyzed scale."""
    alpha, seed = analysis.request.alpha, analysis.request.seed
    rows = analysis.data.residuals
    if analysis.request.scale.is_log:
        rows = rows.assign(response=np.log(rows["response"]))
    if analysis.data.block is not None:
        means = rows.pivot_table("response", "block", factor, sort=False).dropna()
        if len(means) < 2:
            rule = "two blocks at least need a value at every level"
            raise InputError(Fault("blocks", rule, "leave incomplete levels out"))
        values = {str(name): means[name].to_numpy() / len(means) for name in means.columns}
        blocks = [np.arange(len(means))]
        return dunnett_over_groups(values, reference, blocks, "Dunnett over blocks", alpha, seed)
    if analysis.request.error != "welch":
        of_levels: dict[str, list[Array]] = {}
        for (name, _), replicates in rows.groupby([factor, "cell"], sort=False)["response"]:
            of_levels.setdefault(str(name), []).append(replicates.to_numpy())
        return dunnett(of_levels, reference, alpha, seed)
    cells = [np.asarray(at) for at in rows.groupby("cell", sort=False).indices.values()]
    level, y = rows[factor].astype(str).to_numpy(), rows["response"].to_numpy()
    share = np.zeros(len(rows))
    for cell in cells:  # a level is the mean of the means of its cells
        share[cell] = 1 / cell.size / sum(level[other[0]] == level[cell[0]] for other in cells)
    values = {name: (y - y[0]) * share * (level == name) for name in dict.fromkeys(level)}
    return dunnett_over_groups(values, reference, cells, "Dunnett by Welch", alpha, seed)


# Write the page of one analysis: of a CSV, a table, or a study's records.

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

    def digest(self) -> str | None:
        """Sha256 of the file."""
        return None if self.path is None else sha256_of(self.path)

    def commands(self) -> tuple[str, ...]:
        """Lines that check the file and make the analysis again; none for a table in memory."""
        if self.path is None:
            return ()
        check = f"{self.digest()}  {self.path}"
        given = [word for flag, value in self.flags.items() if value for word in (flag, value)]
        words = [word for text in self.contrasts for word in ("--contrast", text)]
        again = ["study", "analyze", str(self.path), *given, *words]
        return (f"echo {shlex.quote(check)} | sha256sum --check", shlex.join(again))


def write_page(
    analysis: AnalysisResult,
    out_dir: str | Path,
    *,
    source: AnalysisSource | None = None,
    compared: tuple[str, Comparisons] | None = None,
    formats: Sequence[str] = ("html",),
) -> Path:
    """Write the page of an analysis, with the CSV of its tables and figures beside it."""
    check_taken(analysis.request.factors)
    data = report_data(analysis, source or AnalysisSource())
    return write_analysis(analysis, data, out_dir, formats, compared)


def check_taken(factors: Sequence[str]) -> None:
    """Refuse factors with a name that the rows of a report have for themselves."""
    taken = [name for name in factors if name in TAKEN]
    if taken:
        rule = "is a name that the report needs for a column of its own"
        mend = "rename the column, say to the quantity that it holds"
        raise InputError([Fault(f"column {name!r}", rule, mend) for name in taken])


def report_data(analysis: AnalysisResult, source: AnalysisSource) -> ReportData:
    """Gather what a report shows of one analysis: levels, rows, provenance."""
    request, limit = analysis.request, analysis.request.scale.practical
    rows, block = analysis.data.residuals, analysis.data.block
    of_response = ResponseAnalysis(
        request.response,
        "",
        analysis,
        practical=None if limit is None else limit.value,
        relative=bool(limit and limit.relative),
        transform=request.scale.transform,
        title=request.response,
    )
    data = data_of_table(
        source,
        of_response,
        f"What does {request.response} depend on: {', '.join(request.factors)}?",
        _levels(analysis),
        _report_table(analysis),
        len(analysis.data.cell_means),
    )
    blocks = () if block is None else tuple(rows["block"].astype(str).unique())
    return replace(data, block=block or "", blocks=blocks, seed=request.seed, alpha=request.alpha)


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
        responses=(response,),
        citation="" if source.path is None else source.path.name,
        provenance=provenance(source),
        commands=source.commands(),
        scheme=f"a table of {len(table):,} rows was analyzed",
        cells=cells,
        labels={name: name for name in (response.name, *factors)},
        is_table=True,
    )


def _levels(analysis: AnalysisResult) -> dict[str, tuple[str, ...]]:
    levels = {e.term: e.levels for e in analysis.effects if e.is_main}
    rows = analysis.data.residuals
    return {
        name: levels.get(name) or tuple(rows[name].astype(str).unique())
        for name in analysis.request.factors
    }


def _report_table(analysis: AnalysisResult) -> pd.DataFrame:
    """Rows as a report wants them: levels, block, status, the response under its own name."""
    rows = analysis.data.residuals
    columns = {name: rows[name].astype(str) for name in analysis.request.factors}
    if "block" in rows:
        columns["block"] = rows["block"].astype(str)
    frame = rows[["row"]].assign(**columns, status="converged")
    frame = frame.rename(columns={"row": "case_id"})
    frame[analysis.request.response] = rows["response"]
    return frame


def provenance(source: AnalysisSource) -> dict[str, str]:
    """List versions, and the hash of the file."""
    out = {"version of study": study.__version__, "version of python": platform.python_version()}
    for package in _PACKAGES:
        try:
            out[f"version of {package}"] = version(package)
        except PackageNotFoundError:
            continue
    if source.path is not None:
        out[f"sha256 of {source.path.name}"] = str(source.digest())
    return out


# An analysis as a notebook shows it: a frame, a table in HTML, a figure, a page.


@dataclass(frozen=True, repr=False)
class TableAnalysis(Shown, AnalysisResult):
    """What :func:`study.analyze` returns: an :class:`AnalysisResult` that can be shown."""

    def to_frame(self) -> pd.DataFrame:
        """Table of the analysis of variance, one row a term; what does not apply is missing."""
        return self.anova.to_frame()

    def blocks(self) -> Iterator[Block | None]:
        """Error term, table, effects and assumptions, as ``study analyze`` prints them."""
        return analysis_blocks(self, report_data(self, AnalysisSource()))

    def plot(self) -> Drawing:
        """Draw the largest difference of every term with its interval against what matters."""
        from study.reporting.figures.effect_figures import shown_effect_sizes

        data = report_data(self, AnalysisSource())
        (item,) = facts(data)
        return shown_effect_sizes(item, data.labels)

    def report(self, out_dir: str | Path, formats: Sequence[str] = ("html",)) -> Path:
        """Write the page of the analysis, as ``study analyze CSV --report`` does."""
        return write_page(self, out_dir, formats=formats)


#: levels from which labels that are numbers are remarked upon: two say no more as numbers
FEWEST_NUMBERS = 3


def number_levels(frame: pd.DataFrame, columns: Sequence[str]) -> list[str]:
    """Sentences about columns of labels that look like numbers: they are never taken as such."""
    labels = {name: set(map(str, frame[name].unique())) for name in columns}
    return [
        f"the levels of {name!r} are numbers, and are taken as labels: --numeric {name} asks for "
        "a surface over them"
        for name, its_labels in labels.items()
        if len(its_labels) >= FEWEST_NUMBERS
        and all(NUMBER.fullmatch(label) for label in its_labels)
    ]


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
        asked = read_formula(response)
        response, factors = asked.response, factors or asked.factors
        options = {**asked_of(asked), **options}
    if isinstance(source, (str, Path)) and not is_table(source):
        # what is not said is taken from the design
        study = api.load(source, results)
        by_name = {r.name: r for r in study.design.responses}
        name = response or next(iter(by_name))
        if not study.records:
            raise InputError(f"{study.folder}: no case is computed yet")
        names = list(study.records[0].responses)
        if name not in names:
            raise InputError(Fault("--response", f"there is no {name!r}", nearest(name, names)))
        of_records = analyze_records(
            study.design, study.records, by_name.get(name) or ResponseSpec(name, unit=""),
            study.numerical, factors, options,
        )  # fmt: skip
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
    made = anova(source, str(response), columns, **options)
    return TableAnalysis.of(made.noted(*number_levels(source, factors)))


@dataclass(frozen=True)
class SummaryAnalysis(Keyed):
    """Groups of which mean, standard deviation and number of rows are known, compared."""

    KEYS = (
        "groups anova welch tukey_kramer=tukey.pairs games_howell=games_howell.pairs practical "
        "verdicts"
    )

    groups: GroupMoments
    #: Keys f, df, df_error and p: with one variance, and with one for each group (Welch).
    anova: Mapping[str, float]
    welch: Mapping[str, float]
    tukey: Comparisons
    games_howell: Comparisons
    practical: float | None = None

    @property
    def verdicts(self) -> list[str | None]:
        """Verdict of each pair: a claim where both intervals make it."""
        if self.practical is None:
            return [None] * len(self.tukey.pairs)
        found: list[str | None] = []
        for pooled, own in zip(self.tukey.pairs, self.games_howell.pairs, strict=True):
            claims = {claim(one.lower, one.upper, self.practical) for one in (pooled, own)}
            found.append(claims.pop() or CANNOT_TELL if len(claims) == 1 else CANNOT_TELL)
        return found


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
        Fault(table.place(i, columns[k]), rule)
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
    limit = threshold(practical)
    groups = GroupMoments(tuple(" ".join(row) for row in labels), n, mean, sd**2)
    anova, welch = (
        dict(zip(("f", "df", "df_error", "p"), test, strict=True))
        for test in (groups.one_way(), groups.welch())
    )
    return SummaryAnalysis(
        groups, anova, welch, groups.pairs(alpha, equal=True),
        groups.pairs(alpha, equal=False),
        None if limit is None else limit.on_scale(float(n @ mean / n.sum()), "none"),
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


# The same analysis over less of the test, to see whether the answer depends on its depth.
#
# Every case keeps its measured and its predicted curve, so that a response over the first part
# of the range costs no simulation. The constants are those of the whole study. Verdicts are held
# against numerical uncertainty as the study's own are: where meshes are a factor it is followed
# at each depth, elsewhere it is that of the whole test.

#: shares of the displacement that are looked at; the last one is the study itself
SHARES = (0.25, 0.5, 0.75, 1.0)

#: measured points that a response needs at least
_FEWEST = 5


def effects_by_depth(study: StudyResult) -> tuple[DepthEffect, ...]:
    """Largest difference of every main effect over the first part of the test."""
    of_curves = [r for r in study.design.responses if r.name in CURVE_RESPONSES]
    reached = [
        measured.displacement_mm
        for record in study.records
        if record.converged
        for _, measured in _pairs(record)
    ]
    ends = [float(places[-1]) for places in reached]
    # without a displacement that every curve reaches, to 2 %, there is nothing to compare
    if not of_curves or not ends or max(ends) > 1.02 * min(ends):
        return ()
    depth = min(ends)
    shares = [
        s
        for s in SHARES
        if min(int((at <= s * depth * (1 + 1e-9)).sum()) for at in reached) >= _FEWEST
    ]
    if len(shares) < 2:
        return ()
    return tuple(
        row
        for share in shares
        for response in of_curves
        for row in _effects(study, response, share * depth)
    )


def _pairs(record: Record) -> Iterator[tuple[Curve, Curve]]:
    for fact in record.scores:
        if (pair := record.pair(fact["score"])) is not None:
            measured, predicted = pair
            yield predicted, measured


def _effects(study: StudyResult, response: ResponseSpec, depth_mm: float) -> Iterator[DepthEffect]:
    records = [_rescored(record, response.name, depth_mm) for record in study.records]
    try:
        effects = effects_of_records(study.design, records, response, study.numerical)
    except StudyError:
        return  # the study's own analysis says why
    for e in effects:
        if e.is_main and e.range is not None:
            yield DepthEffect(
                response.name, e.term, depth_mm, e.range, e.low, e.high, e.practical, e.verdict,
                e.highest,
            )  # fmt: skip


def _rescored(record: Record, name: str, depth_mm: float) -> Record:
    """Record whose response covers the first part of its curves only."""
    if not record.converged:
        return record
    values = []
    for predicted, measured in _pairs(record):
        inside = measured.displacement_mm <= depth_mm * (1 + 1e-9)
        part = Curve(measured.displacement_mm[inside], measured.force_N[inside])
        values.append(CURVE_RESPONSES[name](predicted, part))
    if not values:
        return record
    entry = record.responses[name].copy()
    entry["value"] = sum(values) / len(values)
    return replace(record, responses={**record.responses, name: entry})


# Tests that are adjusted together: those of a response, those declared, those of a whole study.


def adjusted(
    analyses: Sequence[ResponseAnalysis], spec: analysis_Analysis
) -> tuple[ResponseAnalysis, ...]:
    """Adjust p by Holm's method over the family that a design declares."""
    if spec.family == "response" and not spec.primary:
        return tuple(analyses)
    raw = {
        a.name: {effect.term: effect.p for effect in a.result.effects}
        for a in analyses
        if a.result is not None
    }
    if spec.family == "study":
        tests = list(holm_family(raw, spec.primary))
    else:
        tests = [t for name, p in raw.items() for t in holm_family({name: p}, spec.primary)]
    return tuple(_with(a, [t for t in tests if t.response == a.name], spec) for a in analyses)


def _with(
    analysis: ResponseAnalysis, tests: Sequence[FamilyTest], spec: analysis_Analysis
) -> ResponseAnalysis:
    if analysis.result is None:
        return analysis
    p = {test.term: test.p_holm for test in tests}
    effects = tuple(replace(e, p_holm=p[e.term]) for e in analysis.result.effects)
    which = f"the primary terms {', '.join(spec.primary)}" if spec.primary else "all terms"
    where = "all responses together" if spec.family == "study" else "this response"
    count = max((test.family for test in tests), default=0)
    note = f"p (Holm) is adjusted for {count} tests: {which} of {where}"
    return replace(analysis, result=replace(analysis.result, effects=effects).noted(note))


# A mixed model of a study, a table or a file: blocks and other columns as random factors.


class MixedOptions(TypedDict, total=False):
    """Keywords of :func:`study.mixed_model`, where they are described."""

    block: str | Sequence[str] | None
    random: Sequence[str]
    covariates: Sequence[str]
    model: Model
    practical: Practical
    contrasts: Sequence[str]
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
    defaults: MixedOptions = {"block": "block", "model": model if isinstance(model, str | int) else
                              list(model)}  # fmt: skip
    options = {**defaults, **options}
    chosen = next((r for r in study.design.responses if r.name == response), None)
    chosen = study.design.responses[0] if response is None else chosen
    if chosen is not None:
        options.setdefault("practical", chosen.practical)
    names = list(factors) or [f.name for f in study.design.factors if len(f.levels) > 1]
    named = str(response) if chosen is None else chosen.name
    return mixed_model(study.table, named, names, **options)


# What a response was scored on: the curve that was fitted, or one that the fit never saw.

#: words in the name of a column that tell specimens apart
_SPECIMENS = ("specimen", "sample", "phantom", "subject", "animal", "donor", "batch")


def scored_on(design: Design, response: str, blocks: int) -> tuple[str, bool]:
    """Say what a response was scored on, and whether fits to all others predict each specimen."""
    fitted, measured = design.calibration, design.measurements
    if response not in SCORED or measured is None or fitted.method == "none":
        return "", False
    other = fitted.problem is not None
    kind = held_out(fitted.leave_out, measured.fit, measured.score, blocks, other_test=other)
    if kind is not None:
        return OTHER_SPECIMEN if kind == "specimen" else OTHER_TEST, kind == "specimen"
    if other:
        return OTHER_TEST, False
    fit, score = dict(measured.fit or {}), dict(measured.score or measured.fit or {})
    if fit == score:
        return FITTED_CURVE, False
    changed = [name for name in {**fit, **score} if fit.get(name) != score.get(name)]
    apart = any(word in name.lower() for name in changed for word in _SPECIMENS)
    return OTHER_SPECIMEN if apart else OTHER_TEST, False
