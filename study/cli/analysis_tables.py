"""An analysis as the terminal shows it: the tables of its page, and what a page draws instead."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from study.cli import output
from study.reporting.content import analysis_content, tables
from study.reporting.content.numbers import MISSING, interval, p_value, ratio_digits, significant
from study.reporting.content.report_facts import Facts, facts
from study.statistics.analysis.simple_effects import REFUSALS

if TYPE_CHECKING:
    from study.api.analyzing import SummaryAnalysis
    from study.reporting.results.study_result import ReportData
    from study.statistics.analysis.analysis_result import AnalysisResult
    from study.statistics.analysis.anova_table import NestedUnits


def print_analysis(analysis: AnalysisResult, data: ReportData) -> None:
    """Print error term, table, effects, assumptions, warnings."""
    (item,) = facts(data)
    term = analysis.error_term
    print(f"error term {term.source}: {term.question}")
    print(f"  because: {term.reason}\n")
    if analysis.anova.rows:
        title = f"Analysis of Variance: {analysis.request.response}, type {analysis.anova.type}"
        output.content(analysis_content.analysis_of_variance(analysis), title)
        output.content(analysis_content.model_summary(analysis), "Model Summary")
        print_effects(item, data)
        output.content(analysis_content.checks(analysis), "Assumptions")
        _print_further_checks(analysis)
        output.content(analysis_content.robustness(analysis, data))
        rows = [["Term", "lowest", "highest", "p from", "p to", "verdicts", "holds"]]
        for b in analysis.data.bounds:
            p = (MISSING, MISSING) if b.p is None else (p_value(b.p[0]), p_value(b.p[1]))
            holds = "yes" if b.holds else "no"
            ends = significant(b.low, 4), significant(b.high, 4)
            rows.append([b.term, *ends, *p, ", ".join(b.verdicts), holds])
        output.table(rows, "Largest differences, whatever the missing responses are")
        _print_power(analysis)
    in_sentences: tuple[str, ...] = ()
    if analysis.data.nested is not None:
        in_sentences = _print_nested(analysis.data.nested, analysis.request.alpha)
    output.warn([message for message in analysis.notes if message not in in_sentences])


def print_effects(item: Facts, data: ReportData) -> None:
    """Print means, largest differences with their verdicts, and simple effects."""
    output.content(analysis_content.means(item, data), "Means")
    output.content(tables.verdicts((item,), data), "Effects")
    for e in item.effects:
        # without a threshold nothing can be told, which is said once for all
        if e.verdict in REFUSALS and e.practical is not None:
            print(f"{e.term}: {e.verdict} ({e.why})")
    # of every factor that interacts the largest simple effect, and that which decides its verdict
    telling = [(e, dict.fromkeys((e.largest_simple, e.deciding_simple))) for e in item.terms]
    terms = tuple(replace(e, simple_effects=tuple(filter(None, few))) for e, few in telling)
    largest = analysis_content.simple_effects(replace(item, terms=terms), data)
    output.content(largest, "Largest simple effects, and those that decide a verdict")


def _print_further_checks(analysis: AnalysisResult) -> None:
    """Print what a page draws: contrasts beyond Lenth's margins, rows that the fit leans on."""
    lenth, checks = analysis.variation.lenth, analysis.assumptions
    if lenth is not None:
        print(
            f"Lenth: pseudo standard error {significant(lenth.pse, 4)}, margin of error "
            f"{significant(lenth.me, 4)}, simultaneous {significant(lenth.sme, 4)}; beyond it: "
            f"{', '.join(lenth.active) or 'none'}"
        )
    if checks.fligner is not None:
        statistic, p = checks.fligner
        print(f"Fligner-Killeen: {significant(statistic, 4)}, p = {p_value(p)}")
    if checks.influence is not None and checks.influence.rows:
        listed = ", ".join(str(i) for i in checks.influence.rows[:10])
        limit = checks.influence.limit
        print(f"rows the fit leans on (Cook's distance > {limit:.2g}): {listed}")
    if checks.box_cox is not None:
        low, high = checks.box_cox.ci95
        print(f"Box-Cox exponent {checks.box_cox.exponent:.2f} (95 % {low:.2f} to {high:.2f})")


def _print_power(analysis: AnalysisResult) -> None:
    if not analysis.detection.power:
        return
    digits = ratio_digits if analysis.request.scale.is_log else lambda _: 3
    counts = [str(row.n) for row in next(iter(analysis.detection.power.values()))]
    rows = [["Term", *counts]]
    rows += [
        [t, *(significant(r.detectable, digits(r.detectable)) for r in of_term)]
        for t, of_term in analysis.detection.power.items()
    ]
    unit = analysis.data.block or "replicates a cell"
    output.table(rows, f"Detectable (power 80 %), by {unit}")


def _print_nested(nested: NestedUnits, alpha: float) -> tuple[str, ...]:
    """Print the analysis by units beside that by rows; return the sentences already printed."""
    from study.statistics.analysis.strata import sentences

    rows = [["Term", f"F ({nested.unit} as the replicate)", "p", "F (every row)", "p"]]
    for t in nested.terms:
        by_unit = f"F({t.df[0]:g}, {t.df[1]:g}) = {t.f:.4g}"
        by_row = f"F({t.naive_df[0]:g}, {t.naive_df[1]:g}) = {t.naive_f:.4g}"
        rows.append([t.term, by_unit, p_value(t.p), by_row, p_value(t.naive_p)])
    output.table(rows, f"What {nested.rows} 'independent' rows would have claimed")
    every = tuple(sentences(nested, alpha))
    for sentence in every[:2]:
        print(f"{sentence}.")
    return every


def print_summaries(groups: SummaryAnalysis) -> None:
    """Print the comparison of groups of which only moments are known."""
    rows = [["Test", "F", "DF", "DF of error", "p"]]
    for name, (f, df, rest, p) in (("one variance", groups.anova), ("Welch", groups.welch)):
        rows.append([name, f"{f:.2f}", f"{df:g}", f"{rest:.4g}", p_value(p)])
    output.table(rows, "Are the means equal?")
    ends = f"{100 * (1 - groups.tukey.alpha):.4g} % interval"
    head = ["Groups", "difference", ends, "p", "Games and Howell", "p"]
    rows = [head if groups.practical is None else [*head, "verdict"]]
    both = zip(groups.tukey.pairs, groups.games_howell.pairs, groups.verdicts, strict=True)
    for pooled, unequal, verdict in both:
        line = [f"{pooled.first} - {pooled.second}", significant(pooled.difference, 5)]
        for pair in (pooled, unequal):
            line += [interval(pair.lower, pair.upper, digits=4), p_value(pair.p)]
        rows.append(line if verdict is None else [*line, verdict])
    output.table(rows, "All pairs (Tukey and Kramer; variances of their own: Games and Howell)")
