"""Tables of an analysis as the terminal shows them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from study.cli import output
from study.reporting.content.numbers import ratio_digits
from study.reporting.content.verdicts import told
from study.statistics.analysis.simple_effects import REFUSALS

if TYPE_CHECKING:
    from study.statistics.analysis.analysis_result import AnalysisResult
    from study.statistics.analysis.anova_table import Effect, NestedUnits, Row
    from study.statistics.analysis.comparisons import Comparisons


def print_analysis(analysis: AnalysisResult) -> None:
    """Print what was found: error term, table, effects, assumptions, warnings."""
    term = analysis.error_term
    print(f"error term {term.source}: {term.question}")
    print(f"  because: {term.reason}\n")
    if analysis.anova.rows:
        _print_factors(analysis)
        output.table(
            _anova(analysis),
            f"Analysis of Variance: {analysis.request.response}, type {analysis.anova.type}",
        )
        print()
        _print_summary(analysis)
        shares = {row.term: row.share for row in analysis.anova.rows}
        print_effects(analysis.effects, shares, analysis.request.alpha)
        _print_checks(analysis)
        _print_robustness(analysis)
        _print_bounds(analysis)
        _print_power(analysis)
    sentences_shown: tuple[str, ...] = ()
    if analysis.data.nested is not None:
        sentences_shown = _print_nested(analysis.data.nested, analysis.request.alpha)
    output.warn([message for message in analysis.notes if message not in sentences_shown])


def _print_factors(analysis: AnalysisResult) -> None:
    rows = [["Factor", "Levels", "Values"]]
    rows += [
        [e.term, str(len(e.levels)), ", ".join(e.levels)]
        for e in analysis.effects
        if e.term in analysis.request.factors
    ]
    output.table(rows, "Factor Information")
    print()


def _anova(analysis: AnalysisResult) -> list[list[str]]:
    """Source, DF, Adj SS, Adj MS, F, P; epsilon and the corrected p where there are any."""
    how = "Seq" if analysis.anova.type == "I" else "Adj"
    corrected = any(row.p_gg is not None for row in analysis.anova.rows)
    strata = len({row.error for row in analysis.anova.rows if row.error}) > 1
    head = ["Source", "DF", f"{how} SS", f"{how} MS", "F-Value", "P-Value"]
    head += ["Epsilon", "P (G-G)"] if corrected else []
    head += ["Tested against"] if strata else []
    rows = [head]
    for row in analysis.anova.rows:
        line = _anova_line(row)
        line += [_number(row.epsilon_gg, 3), _p(row.p_gg)] if corrected else []
        line += [row.error or ""] if strata else []
        rows.append(line)
    if analysis.anova.ss_total is not None:
        blanks = [""] * (len(head) - 3)
        rows.append(
            ["Total", f"{analysis.anova.df_total}", _number(analysis.anova.ss_total), *blanks]
        )
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


def _print_summary(analysis: AnalysisResult) -> None:
    s = analysis.variation.summary
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
        for simple in dict.fromkeys((effect.largest_simple, effect.deciding_simple)):
            if simple is None or not simple.at:
                continue
            at = ", ".join(f"{name} {level}" for name, level in simple.at)
            number = _number(simple.difference, 4)
            sign = "/" if effect.is_ratio else "-"
            rows.append([effect.term, f"{simple.first} {sign} {simple.second}", at, number,
                         _interval(simple.ci), simple.verdict])  # fmt: skip
    if len(rows) > 1:
        output.table(rows, "Largest simple effects, and those that decide a verdict")
        print()


def _interval(ci: Sequence[float] | None) -> str:
    return "" if ci is None else f"{ci[0]:.4g} to {ci[1]:.4g}"


def _print_checks(analysis: AnalysisResult) -> None:
    rows = [["Check", "statistic", "p", "p simulated"]]
    rj = analysis.assumptions.normality
    if rj is not None and rj.applicable:
        rows.append(["Ryan-Joiner", _number(rj.rj, 4), str(rj.p_minitab), _p(rj.p_exact)])
    for test in (analysis.assumptions.anderson_darling, analysis.assumptions.shapiro_wilk):
        if test is not None and test.p is not None:
            rows.append([test.name, _number(test.statistic, 4), _p(test.p), ""])
    bartlett, levene = analysis.assumptions.bartlett, analysis.assumptions.levene
    if bartlett is not None and bartlett.applicable:
        line = [_number(bartlett.statistic, 4), _p(bartlett.p), _p(bartlett.p_monte_carlo)]
        rows.append(["Bartlett", *line])
    if levene is not None and levene.applicable:
        line = [_number(levene.statistic, 4), _p(levene.p), _p(levene.p_monte_carlo)]
        rows.append([f"Levene ({levene.center})", *line])
    tukey = analysis.assumptions.non_additivity
    if tukey is not None and tukey.p is not None:
        rows.append(["Tukey's non-additivity", _number(tukey.f, 4), _p(tukey.p), ""])
    for term, sphere in analysis.assumptions.sphericity.items():
        if sphere.p is not None:
            rows.append([f"Mauchly's sphericity, {term}", _number(sphere.w, 4), _p(sphere.p), ""])
    if len(rows) > 1:
        output.table(rows, "Assumptions")
    if analysis.variation.lenth is not None:
        lenth = analysis.variation.lenth
        print(
            f"Lenth: pseudo standard error {_number(lenth.pse, 4)}, margin of error "
            f"{_number(lenth.me, 4)}, simultaneous {_number(lenth.sme, 4)}; beyond it: "
            f"{', '.join(lenth.active) or 'none'}"
        )
    leant_on = analysis.assumptions.influence
    if leant_on is not None and leant_on.rows:
        listed = ", ".join(str(i) for i in leant_on.rows[:10])
        print(f"rows the fit leans on (Cook's distance > {leant_on.limit:.2g}): {listed}")


def _print_robustness(analysis: AnalysisResult) -> None:
    table = analysis.assumptions.robustness
    if table is None or not table.p:
        return
    methods = list(next(iter(table.p.values())))
    rows = [["Term", *methods, "below alpha in"]]
    for term, p in table.p.items():
        verdict = table.agreement[term].split(" in ", 1)[-1]
        rows.append([term, *(_p(p[m]) or "n/a" for m in methods), verdict])
    print()
    output.table(rows, "p in the defensible analyses")
    power = analysis.assumptions.box_cox
    if power is not None:
        low, high = power.ci95
        print(f"Box-Cox exponent {power.exponent:.2f} (95 % {low:.2f} to {high:.2f})")


def _print_bounds(analysis: AnalysisResult) -> None:
    if not analysis.data.bounds:
        return
    rows = [["Term", "lowest", "highest", "p from", "p to", "verdicts", "holds"]]
    for b in analysis.data.bounds:
        p = ("", "") if b.p is None else (_p(b.p[0]), _p(b.p[1]))
        holds = "yes" if b.holds else "no"
        verdicts = ", ".join(b.verdicts)
        rows.append([b.term, _number(b.low, 4), _number(b.high, 4), *p, verdicts, holds])
    print()
    output.table(rows, "Largest differences, whatever the missing responses are")


def _print_power(analysis: AnalysisResult) -> None:
    if not analysis.detection.power:
        return
    digits = ratio_digits if analysis.request.scale.is_log else lambda _: 3
    counts = [str(row.n) for row in next(iter(analysis.detection.power.values()))]
    unit = analysis.data.block or "replicates a cell"
    rows = [["Term", *counts]]
    rows += [
        [t, *(_number(r.detectable, digits(r.detectable)) for r in of_term)]
        for t, of_term in analysis.detection.power.items()
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
    lines = tuple(sentences(nested, alpha))
    for sentence in lines[:2]:
        print(f"{sentence}.")
    return lines


def reference_json(factor: str, compared: Comparisons) -> dict[str, object]:
    """Comparisons with a reference as ``--json`` shows them."""
    pairs = [asdict(pair) for pair in compared.pairs]
    return {
        "factor": factor, "method": compared.method, "alpha": compared.alpha,
        "scale": compared.effect,
        "pairs": pairs,
    }  # fmt: skip


def print_reference(factor: str, comparisons: Comparisons) -> None:
    """Print the differences from a reference level."""
    ends = f"{100 * (1 - comparisons.alpha):.4g} % interval"
    rows = [["Level", comparisons.effect, ends, "adjusted p"]]
    rows += [
        [pair.first, _number(pair.difference, 4), _interval((pair.lower, pair.upper)), _p(pair.p)]
        for pair in comparisons.pairs
    ]
    output.table(rows, f"{factor} against {comparisons.pairs[0].second} ({comparisons.method})")
    print()
