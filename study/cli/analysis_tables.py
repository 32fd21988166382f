"""Tables of an analysis as the terminal shows them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from study.cli import output
from study.reporting.content.numbers import ratio_digits
from study.reporting.content.verdicts import told
from study.statistics.analysis.equal_variance import LeveneResult
from study.statistics.analysis.simple_effects import REFUSALS

if TYPE_CHECKING:
    from study.api.analyzing import SummaryAnalysis
    from study.statistics.analysis.analysis_result import AnalysisResult
    from study.statistics.analysis.anova_table import Effect, NestedUnits, Row
    from study.statistics.analysis.comparisons import Comparisons


def print_analysis(found: AnalysisResult) -> None:
    """Print what was found: error term, table, effects, assumptions, warnings."""
    term = found.error_term
    print(f"error term {term.source}: {term.question}")
    print(f"  because: {term.reason}\n")
    if found.anova.rows:
        _print_factors(found)
        output.table(
            _anova(found),
            f"Analysis of Variance: {found.request.response}, type {found.anova.type}",
        )
        print()
        _print_summary(found)
        shares = {row.term: row.share for row in found.anova.rows}
        print_effects(found.effects, shares, found.request.alpha)
        _print_checks(found)
        _print_robustness(found)
        _print_bounds(found)
        _print_power(found)
    said: tuple[str, ...] = ()
    if found.data.nested is not None:
        said = _print_nested(found.data.nested, found.request.alpha)
    output.warn([message for message in found.notes if message not in said])


def _print_factors(found: AnalysisResult) -> None:
    rows = [["Factor", "Levels", "Values"]]
    rows += [
        [e.term, str(len(e.levels)), ", ".join(e.levels)]
        for e in found.effects
        if e.term in found.request.factors
    ]
    output.table(rows, "Factor Information")
    print()


def _anova(found: AnalysisResult) -> list[list[str]]:
    """Source, DF, Adj SS, Adj MS, F, P; epsilon and the corrected p where there are any."""
    how = "Seq" if found.anova.type == "I" else "Adj"
    corrected = any(row.p_gg is not None for row in found.anova.rows)
    strata = len({row.error for row in found.anova.rows if row.error}) > 1
    head = ["Source", "DF", f"{how} SS", f"{how} MS", "F-Value", "P-Value"]
    head += ["Epsilon", "P (G-G)"] if corrected else []
    head += ["Tested against"] if strata else []
    rows = [head]
    for row in found.anova.rows:
        line = _anova_line(row)
        line += [_number(row.epsilon_gg, 3), _p(row.p_gg)] if corrected else []
        line += [row.error or ""] if strata else []
        rows.append(line)
    if found.anova.ss_total is not None:
        blanks = [""] * (len(head) - 3)
        rows.append(["Total", f"{found.anova.df_total}", _number(found.anova.ss_total), *blanks])
    return rows


def _anova_line(row: Row) -> list[str]:
    name = "Error" if row.term == "residual" else row.term
    f = "" if row.f is None else f"{row.f:.2f}" if row.f < 1e4 else f"{row.f:.4g}"
    return [name, f"{row.df:g}", _number(row.ss), _number(row.ms), f, _p(row.p)]


def _number(value: float | None, digits: int = 5) -> str:
    return "" if value is None else f"{value:.{digits}g}"


def _p(p: float | None) -> str:
    if p is None:
        return ""
    return "< 0.001" if p < 0.001 else f"{p:.3f}"


def _print_summary(found: AnalysisResult) -> None:
    s = found.variation.summary
    if s is None:
        return
    shares = [s.r_sq, s.r_sq_adj, s.r_sq_pred]
    percent = ["*" if x is None else f"{100 * x:.2f}%" for x in shares]
    head = ["S", "R-sq", "R-sq(adj)", "R-sq(pred)"]
    output.table([head, [_number(s.s), *percent]], "Model Summary")
    print()


def print_effects(
    effects: Sequence[Effect], share: Mapping[str, float | None], alpha: float
) -> None:
    """Print means, largest differences with their verdicts, and simple effects."""
    ends = f"{100 * (1 - alpha):.4g} % interval"
    means = [["Term", "Level", "Mean", ends, "Grouping"]]
    for e in effects:
        for i, (level, mean) in enumerate(zip(e.levels, e.mean, strict=True)):
            ci = None if e.mean_ci95 is None else e.mean_ci95[i]
            if e.is_main:
                letters = e.letters[i] if e.letters else ""
                means.append([e.term, level, _number(mean), _interval(ci), letters])
    output.table(means, "Means")
    print("(levels that share a letter are not told apart)\n")
    what = "ratio" if any(e.is_ratio for e in effects) else "difference"
    rows = [["Term", f"largest {what}", ends, "share", "p", "Holm's p", "verdict"]]
    rows += [
        [e.term, _number(e.range, 4), _interval(e.ci95), _number(share.get(e.term), 3),
         _p(e.p), _p(e.p_holm), told(e)]
        for e in effects
    ]  # fmt: skip
    output.table(rows, "Effects")
    for e in effects:
        # without a threshold nothing can be told, which is said once for all
        if e.is_main and e.verdict in REFUSALS and e.practical is not None:
            print(f"{e.term}: {e.verdict} ({e.why})")
    print()
    _print_simple(effects, what, ends)


def _print_simple(effects: Sequence[Effect], what: str, ends: str) -> None:
    """Print of every factor that interacts the largest simple effect, and the one that decides."""
    rows = [["Factor", "levels", "at", what, ends, "verdict there"]]
    for effect in effects:
        for one in dict.fromkeys((effect.largest_simple, effect.deciding_simple)):
            if one is None or not one.at:
                continue
            at = ", ".join(f"{name} {level}" for name, level in one.at)
            number = _number(one.difference, 4)
            sign = "/" if effect.is_ratio else "-"
            rows.append([effect.term, f"{one.first} {sign} {one.second}", at, number,
                         _interval(one.ci), one.verdict])  # fmt: skip
    if len(rows) > 1:
        output.table(rows, "Largest simple effects, and those that decide a verdict")
        print()


def _interval(ci: Sequence[float] | None) -> str:
    return "" if ci is None else f"{ci[0]:.4g} to {ci[1]:.4g}"


def _print_checks(found: AnalysisResult) -> None:
    rows = [["Check", "statistic", "p", "p simulated"]]
    rj = found.assumptions.normality
    if rj is not None and rj.applicable:
        rows.append(["Ryan-Joiner", _number(rj.rj, 4), str(rj.p_minitab), _p(rj.p_exact)])
    for test in (found.assumptions.anderson_darling, found.assumptions.shapiro_wilk):
        if test is not None and test.p is not None:
            rows.append([test.name, _number(test.statistic, 4), _p(test.p), ""])
    for one in found.assumptions.spread.values():
        if one.applicable:
            label = f"Levene ({one.center})" if isinstance(one, LeveneResult) else "Bartlett"
            rows.append([label, _number(one.statistic, 4), _p(one.p), _p(one.p_monte_carlo)])
    if found.assumptions.fligner is not None:
        statistic, p = found.assumptions.fligner
        rows.append(["Fligner-Killeen", _number(statistic, 4), _p(p), ""])
    tukey = found.assumptions.non_additivity
    if tukey is not None and tukey.p is not None:
        rows.append(["Tukey's non-additivity", _number(tukey.f, 4), _p(tukey.p), ""])
    for term, sphere in found.assumptions.sphericity.items():
        if sphere.p is not None:
            rows.append([f"Mauchly's sphericity, {term}", _number(sphere.w, 4), _p(sphere.p), ""])
    if len(rows) > 1:
        output.table(rows, "Assumptions")
    _print_outliers(found)


def _print_outliers(found: AnalysisResult) -> None:
    """Print contrasts beyond Lenth's margins, and rows that the fit leans on."""
    if found.variation.lenth is not None:
        lenth = found.variation.lenth
        print(
            f"Lenth: pseudo standard error {_number(lenth.pse, 4)}, margin of error "
            f"{_number(lenth.me, 4)}, simultaneous {_number(lenth.sme, 4)}; beyond it: "
            f"{', '.join(lenth.active) or 'none'}"
        )
    leant_on = found.assumptions.influence
    if leant_on is not None and leant_on.rows:
        listed = ", ".join(str(i) for i in leant_on.rows[:10])
        print(f"rows the fit leans on (Cook's distance > {leant_on.limit:.2g}): {listed}")


def _print_robustness(found: AnalysisResult) -> None:
    table = found.assumptions.robustness
    if table is None or not table.p:
        return
    methods = list(next(iter(table.p.values())))
    rows = [["Term", *methods, "below alpha in"]]
    for term, p in table.p.items():
        verdict = table.agreement[term].split(" in ", 1)[-1]
        rows.append([term, *(_p(p[m]) or "n/a" for m in methods), verdict])
    print()
    output.table(rows, "p in the defensible analyses")
    power = found.assumptions.box_cox
    if power is not None:
        low, high = power.ci95
        print(f"Box-Cox exponent {power.exponent:.2f} (95 % {low:.2f} to {high:.2f})")


def _print_bounds(found: AnalysisResult) -> None:
    if not found.data.bounds:
        return
    rows = [["Term", "lowest", "highest", "p from", "p to", "verdicts", "holds"]]
    for b in found.data.bounds:
        p = ("", "") if b.p is None else (_p(b.p[0]), _p(b.p[1]))
        holds = "yes" if b.holds else "no"
        verdicts = ", ".join(b.verdicts)
        rows.append([b.term, _number(b.low, 4), _number(b.high, 4), *p, verdicts, holds])
    print()
    output.table(rows, "Largest differences, whatever the missing responses are")


def _print_power(found: AnalysisResult) -> None:
    if not found.detection.power:
        return
    digits = ratio_digits if found.request.scale.is_log else lambda _: 3
    counts = [str(row.n) for row in next(iter(found.detection.power.values()))]
    unit = found.data.block or "replicates a cell"
    rows = [["Term", *counts]]
    rows += [
        [t, *(_number(r.detectable, digits(r.detectable)) for r in of_term)]
        for t, of_term in found.detection.power.items()
    ]
    print()
    output.table(rows, f"Detectable (power 80 %), by {unit}")


def _print_nested(nested: NestedUnits, alpha: float) -> tuple[str, ...]:
    """Print the honest analysis beside the naive one; return the sentences already said."""
    from study.statistics.analysis.strata import sentences

    rows = [["Term", f"F ({nested.unit} as the replicate)", "p", "F (every row)", "p"]]
    for t in nested.terms:
        honest = f"F({t.df[0]:g}, {t.df[1]:g}) = {t.f:.4g}"
        naive = f"F({t.naive_df[0]:g}, {t.naive_df[1]:g}) = {t.naive_f:.4g}"
        rows.append([t.term, honest, _p(t.p), naive, _p(t.naive_p)])
    print()
    output.table(rows, f"What {nested.rows} 'independent' rows would have claimed")
    said = tuple(sentences(nested, alpha))
    for sentence in said[:2]:
        print(f"{sentence}.")
    return said


def reference_json(factor: str, found: Comparisons) -> dict[str, object]:
    """Comparisons with a reference as ``--json`` shows them."""
    pairs = [asdict(pair) for pair in found.pairs]
    return {
        "factor": factor, "method": found.method, "alpha": found.alpha, "scale": found.effect,
        "pairs": pairs,
    }  # fmt: skip


def print_reference(factor: str, found: Comparisons) -> None:
    """Print the differences from a reference level."""
    ends = f"{100 * (1 - found.alpha):.4g} % interval"
    rows = [["Level", found.effect, ends, "adjusted p"]]
    rows += [
        [pair.first, _number(pair.difference, 4), _interval((pair.lower, pair.upper)), _p(pair.p)]
        for pair in found.pairs
    ]
    output.table(rows, f"{factor} against {found.pairs[0].second} ({found.method})")
    print()


def print_summaries(found: SummaryAnalysis) -> None:
    """Print the comparison of groups of which only moments are known."""
    rows = [["Test", "F-Value", "DF", "DF of error", "P-Value"]]
    for name, (f, df, rest, p) in (("one variance", found.anova), ("Welch", found.welch)):
        rows.append([name, f"{f:.2f}", f"{df:g}", f"{rest:.4g}", _p(p)])
    output.table(rows, "Are the means equal?")
    print()
    ends = f"{100 * (1 - found.tukey.alpha):.4g} % interval"
    head = ["Groups", "difference", ends, "p", "Games and Howell", "p"]
    rows = [head if found.practical is None else [*head, "verdict"]]
    both = zip(found.tukey.pairs, found.games_howell.pairs, found.verdicts, strict=True)
    for pooled, own, verdict in both:
        line = [f"{pooled.first} - {pooled.second}", _number(pooled.difference)]
        for pair in (pooled, own):
            line += [_interval((pair.lower, pair.upper)), _p(pair.p)]
        rows.append(line if verdict is None else [*line, verdict])
    output.table(rows, "All pairs (Tukey and Kramer; variances of their own: Games and Howell)")
