"""Tables of the page of one analysis, in the order and with the heads that Minitab gives them."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from itertools import repeat
from typing import TYPE_CHECKING

from study.ground.arrays import gathered
from study.ground.canonical import plain
from study.reporting.content import effect_words, surface_content, tables
from study.reporting.content.blocks import Block, Points, Table, Verbatim
from study.reporting.content.effect_words import bound
from study.reporting.content.report_facts import Facts
from study.reporting.content.report_facts import facts as read_facts
from study.reporting.content.text import (
    MISSING,
    clean,
    interval,
    level,
    listing,
    name_of,
    p_phrase,
    p_value,
    percent,
    plural_of,
    ratio_digits,
    sentence,
    significant,
    term_name,
)
from study.reporting.results.study_result import Check, ReportData
from study.statistics.analysis import repeats
from study.statistics.analysis.analysis_result import AnalysisResult
from study.statistics.analysis.anova_table import Comparison
from study.statistics.analysis.comparisons import Comparisons
from study.statistics.analysis.simple_effects import (
    MATTERS,
    NO_DIFFERENCE,
    NOT_RESOLVED,
    REFUSALS,
)
from study.statistics.surfaces.emulator import GIVEN, RANKED
from study.statistics.surfaces.surface_result import FittedSurface

if TYPE_CHECKING:
    import pandas as pd

    from study.statistics.analysis.anova_table import Contrast
    from study.statistics.analysis.mixed_model import MixedModel
    from study.statistics.analysis.post_hoc import Coefficient


#: Digits of sums of squares and statistics, as Minitab prints them.
DIGITS = 5


def factor_information(data: ReportData) -> Table:
    """Levels of every factor."""

    def values(levels: Sequence[str]) -> str:
        more = f", and {len(levels) - 20} more" if len(levels) > 20 else ""
        return ", ".join(clean(level, 30) for level in levels[:20]) + more

    return Table.of(
        "Factor Information",
        data.factors.items(),
        {
            "factor": lambda of: name_of(of[0], data.labels),
            "levels": lambda of: str(len(of[1])),
            "values": lambda of: values(of[1]),
        },
        tail=1,
    )


def model_summary(analysis: AnalysisResult) -> Table | None:
    """S, R-sq, adjusted and predicted; None where nothing was left over."""
    if (summary := analysis.summary) is None:
        return None
    return Table.of(
        "Model Summary",
        (summary,),
        {
            "S": lambda of: significant(of.s, DIGITS),
            "R-sq": lambda of: percent(of.r_sq, 4),
            "R-sq (adjusted)": lambda of: percent(of.r_sq_adj, 4),
            "R-sq (predicted)": lambda of: percent(of.r_sq_pred, 4),
        },
        note="R-sq (predicted) is 1 \N{MINUS SIGN} PRESS / total: each row is predicted from all "
        "others.",
        raw=plain,
    )


def coefficients(fitted: tuple[Coefficient, ...], facts: Facts) -> Table | None:
    """Coefficient, standard error, t, p and variance inflation factor of every column."""
    columns: dict[str, Callable[[Coefficient], str]] = {
        "term": lambda c: clean(c.term),
        "coefficient": lambda c: significant(c.estimate, 4),
        "standard error": lambda c: significant(c.standard_error),
        "t": lambda c: significant(c.t),
        "p": lambda c: p_value(c.p),
    }
    if any(c.vif is not None for c in fitted):
        columns["VIF"] = lambda c: "" if c.vif is None else significant(c.vif)
    scale = " of the log" if facts.ratio else ""
    note = (
        f"Sum-to-zero coding: a coefficient{scale} is the distance of a level from the mean of "
        "all; the last level of a factor is minus the sum of the others."
    )
    return Table.of("Coefficients", fitted, columns, note=note, raw=plain).first()


def means(facts: Facts, data: ReportData) -> Table:
    """Mean of every level of every factor and combination, with interval and letters."""
    every = [
        (effect.term, *of_level)
        for effect in facts.terms
        for ends, letters in [(effect.mean_ci95 or repeat(_NO_ENDS), effect.letters or repeat(""))]
        for of_level in zip(effect.levels, effect.mean, ends, letters, strict=False)
    ]
    return Table.of(
        "Means",
        every,
        {
            "term": lambda of: term_name(of[0], data.labels),
            "level": lambda of: clean(of[1], 60),
            "mean": lambda of: significant(of[2], 4),
            f"{level(data.alpha)} interval": lambda of: interval(*of[3], digits=4),
            "grouping": lambda of: of[4],
        },
        left=2,
        tail=1,
        note="Levels of a factor that share a letter are not told apart.",
        raw=lambda of: (
            {"term": of[0], "level": of[1], "mean": of[2]} | _raw_ends(of[3]) | {"letters": of[4]}
        ),
        grouped=True,
    ).first()


# Two levels or settings compared: a difference, or a ratio of a log response, and its intervals.

Ends = tuple[float | None, float | None]
_NO_ENDS: Ends = (None, None)


def _what(facts: Facts) -> str:
    return "ratio" if facts.ratio else "difference"


def _levels(first: str, second: str, facts: Facts) -> str:
    sign = "/" if facts.ratio else "\N{MINUS SIGN}"
    return f"{clean(first, 30)} {sign} {clean(second, 30)}"


def simple_effects(facts: Facts, data: ReportData) -> Table | None:
    """Differences of two levels at each setting of the other factors; None without interaction."""
    listed = [(e, simple) for e in facts.effects for simple in e.simple_effects if simple.at]
    if not listed:
        return None
    return Table.of(
        "Simple effects",
        listed,
        {
            "factor": lambda of: term_name(of[0].term, data.labels),
            "levels": lambda of: _levels(of[1].first, of[1].second, facts),
            "at": lambda of: ", ".join(
                f"{term_name(name, data.labels)} {clean(lev, 30)}" for name, lev in of[1].at
            ),
            _what(facts): lambda of: significant(of[1].difference),
            "its own interval": lambda of: interval(*(of[1].ci or _NO_ENDS)),
            "simultaneous interval": lambda of: interval(*(of[1].ci_simultaneous or _NO_ENDS)),
            "verdict": lambda of: MISSING if of[0].practical is None else of[1].verdict,
        },
        left=3,
        tail=1,
        note="A factor makes no practical difference where every own interval lies inside what "
        "matters; it matters where one simultaneous interval lies beyond.",
        raw=lambda of: {
            "factor": of[0].term,
            **{k: v for k, v in asdict(of[1]).items() if not isinstance(v, tuple)},
            "at": "; ".join(f"{name}={lev}" for name, lev in of[1].at),
            **_raw_ends(of[1].ci),
            **_raw_ends(of[1].ci_simultaneous, "_simultaneous"),
        },
    ).first()


def _raw_ends(ends: Ends | None, suffix: str = "") -> dict[str, object]:
    low, high = ends or _NO_ENDS
    return {f"low{suffix}": low, f"high{suffix}": high}


def open_effects(item: Facts, data: ReportData) -> Points | None:
    """Say of every factor that is left open why it is; None where each has its verdict."""
    lines = [
        effect_words.open_verdict(effect, item, data.labels)
        for effect in item.effects
        if effect.practical is not None and effect.verdict not in (MATTERS, NO_DIFFERENCE)
    ]
    return Points(lines) if lines else None


def contrasts(facts: Facts) -> Table | None:
    """Differences of two settings that were asked for by name; None without any."""
    if facts.result is None or not facts.result.contrasts:
        return None
    return contrast_table(facts.result.contrasts, facts, facts.alpha)


#: title of differences that were asked for by name
ASKED = "Differences that were asked for"


def contrast_table(requested: Sequence[Contrast], facts: Facts, alpha: float) -> Table:
    """Differences of two settings that were asked for by name."""
    several = len(requested) > 1
    columns: dict[str, Callable[[Contrast], str]] = {
        "asked for": lambda item: clean(item.name, 200),
        _what(facts): lambda item: significant(item.difference),
        f"{100 * (1 - alpha):.4g} % interval, all together": lambda item: interval(
            *(item.ci_simultaneous or item.ci or _NO_ENDS)
        ),
        "U": lambda item: significant(item.u, 2),
        "p": lambda item: p_value(item.p),
    }
    if several:
        columns["Holm's p"] = lambda item: p_value(item.p_holm)
    columns["verdict"] = lambda item: f"{item.verdict}: {item.why}" if item.why else item.verdict
    adjusted = ", and Holm's p is adjusted for all of them" if several else ""
    note = (
        "Each row is the mean over all cells of the first setting less (or over) that of the "
        "second; a factor that a setting leaves out is averaged over. The intervals hold for all "
        f"rows together{adjusted}. U, the bound of the numerical error, is in "
        f"{facts.unit or 'the response'}."
    )
    return Table.of(
        f"contrasts {facts.name}",
        requested,
        columns,
        note=note,
        raw=lambda item: {
            "contrast": item.name, "difference": item.difference, "U": item.u, "p": item.p,
            "p_holm": item.p_holm, **_raw_ends(item.ci_simultaneous), "verdict": item.verdict,
        },
    )  # fmt: skip


def pairwise(pairs: tuple[Comparison, ...], facts: Facts, data: ReportData) -> Table | None:
    """All pairs of levels with simultaneous interval and adjusted p."""
    if not pairs:
        return None
    columns: dict[str, Callable[[Comparison], str]] = {
        "factor": lambda pair: term_name(pair.factor, data.labels),
        "levels": lambda pair: _levels(pair.first, pair.second, facts),
        _what(facts): lambda pair: significant(pair.difference),
        f"simultaneous {level(data.alpha)} interval": lambda pair: interval(pair.lower, pair.upper),
    }
    is_tested = any(pair.p is not None for pair in pairs)
    if is_tested:
        columns |= {"adjusted p": lambda pair: p_value(pair.p), "method": lambda pair: pair.method}
    return Table.of(
        "pairwise comparisons",
        pairs,
        columns,
        left=2,
        tail=int(is_tested),
        note=f"{'Interval and p' if is_tested else 'Intervals'} hold for all pairs of a factor "
        "together.",
        grouped=True,
        raw=lambda pair: pair.to_json() | {"p": pair.p, "method": pair.method},
    ).first()


def against_reference(factor: str, comparisons: Comparisons, data: ReportData) -> Table:
    """Every level against a reference (Dunnett)."""
    return Table.of(
        f"{term_name(factor, data.labels)} against {clean(comparisons.pairs[0].second)}",
        comparisons.pairs,
        {
            "level": lambda pair: clean(pair.first),
            comparisons.effect: lambda pair: significant(pair.difference),
            f"simultaneous {level(comparisons.alpha)} interval": lambda pair: interval(
                pair.lower, pair.upper
            ),
            "adjusted p": lambda pair: p_value(pair.p),
        },
        note=f"{comparisons.method}.",
        raw=plain,
    )


def checks(
    analysis: AnalysisResult,
    name: str = "tests of assumptions",
    labels: Mapping[str, str] | None = None,
) -> Table | None:
    """Statistic and p of every test of an assumption that ran."""
    tests = analysis.assumptions
    rows: list[tuple[str, str, float | None, str, str]] = []
    if (rj := tests.normality) is not None and rj.applicable:
        several = len(tests.normality_rows)
        together = several > 1 and rj.p_exact is not None
        of = f"smallest of {several} contrasts, n = {rj.n}" if together else f"n = {rj.n}"
        # the tabled p of one contrast would contradict the p of all of them
        tabled = "" if together else str(rj.p_minitab).replace("0.", ".")
        rows.append(("normality", f"Ryan-Joiner ({of})", rj.rj, tabled, p_value(rj.p_exact)))
    for test in (tests.anderson_darling, tests.shapiro_wilk):
        if test is not None and test.p is not None:
            rows.append(("normality", test.name, test.statistic, p_value(test.p), ""))
    for key, spread in tests.spread.items():
        if spread.applicable:
            of = " (median)" * (key == "levene") + ", approximate" * spread.approximate
            p = p_value(spread.p), p_value(spread.p_monte_carlo)
            rows.append(("equal spread", f"{key.capitalize()}{of}", spread.statistic, *p))
    if (tukey := tests.non_additivity) is not None and tukey.p is not None:
        rows.append(("additivity", "Tukey, one df", tukey.f, p_value(tukey.p), ""))
    for term, sphere in tests.sphericity.items():
        if sphere.p is not None:
            mauchly = f"Mauchly, {term_name(term, labels)}"
            rows.append(("sphericity", mauchly, sphere.w, p_value(sphere.p), ""))
    if not rows:
        return None
    columns = ("assumption", "test", "statistic", "p", "p simulated")
    shown = tuple((*row[:2], significant(row[2], 4), *row[3:]) for row in rows)
    raw = tuple(dict(zip(columns, row, strict=True)) for row in rows)
    return Table(name, columns, shown, 2, raw=raw)


def unusual(unusual_rows: pd.DataFrame | None) -> Table | None:
    """Rows with a large residual, a high leverage or a large Cook's distance."""
    if unusual_rows is None or unusual_rows.empty:
        return None
    numbers = {
        "response": "response", "fit": "fitted", "residual": "residual",
        "standardized": "standardized", "leverage": "leverage", "Cook": "cook",
        "PRESS residual": "press",
    }  # fmt: skip
    columns: dict[str, Callable[[Mapping[Hashable, object]], str]] = {
        "row": lambda row: f"{row['row']}",
        **{
            head: lambda row, key=key: significant(float(str(row[key])))  # type: ignore[misc]
            for head, key in numbers.items()
        },
        "why": lambda row: str(row["why"]),
    }
    return Table.of(
        "Unusual observations",
        unusual_rows.to_dict("records"),
        columns,
        left=0,
        tail=1,
        raw=lambda row: {str(k): v for k, v in row.items()},
    ).first()


def robustness(analysis: AnalysisResult, data: ReportData) -> Table | None:
    """Give p of every term in each defensible analysis."""
    table = analysis.assumptions.robustness
    if table is None or not any(p is not None for of in table.p.values() for p in of.values()):
        return None
    methods = list(next(iter(table.p.values())))
    rows = tuple(
        (term_name(term, data.labels), *(p_value(p[m]) if p[m] is not None else MISSING
         for m in methods), table.agreement[term].split(" in ", 1)[-1])
        for term, p in table.p.items()
    )  # fmt: skip
    columns = ("term", *methods, f"below {analysis.request.alpha:g} in")
    raw = tuple({"term": term, **p} for term, p in table.p.items())
    return Table("p in the defensible analyses", columns, rows, 1, 1, raw=raw)


# An analysis as a terminal shows it: the tables of its page, and what a page draws instead.


def analysis_blocks(analysis: AnalysisResult, data: ReportData) -> Iterator[Block | None]:
    """Error term, table, effects, assumptions, and what an analysis by rows would have claimed."""
    (item,) = read_facts(data)
    term = analysis.error_term
    yield Verbatim(f"error term {term.source}: {term.question}")
    yield Verbatim(f"  because: {term.reason}\n")
    if analysis.anova.rows:
        yield factor_information(data)
        title = f"Analysis of Variance: {analysis.request.response}, type {analysis.anova.type}"
        yield tables.anova(item, data, title)
        yield model_summary(analysis)
        yield replace(tables.sizes(item, data), name="Sizes of the effects")
        yield from effect_blocks(item, data)
        yield checks(analysis, "Assumptions")
        # what a page draws: contrasts beyond Lenth's margins, rows that the fit leans on
        lenth, tests = analysis.lenth, analysis.assumptions
        if lenth is not None:
            yield Verbatim(
                f"Lenth: pseudo standard error {significant(lenth.pse, 4)}, margin of error "
                f"{significant(lenth.me, 4)}, simultaneous {significant(lenth.sme, 4)}; beyond it: "
                f"{', '.join(lenth.active) or 'none'}"
            )
        if tests.fligner is not None:
            statistic, p = tests.fligner
            yield Verbatim(f"Fligner-Killeen: {significant(statistic, 4)}, {p_phrase(p)}")
        if tests.influence is not None and tests.influence.rows:
            listed = ", ".join(str(i) for i in tests.influence.rows[:10])
            limit = tests.influence.limit
            yield Verbatim(f"rows the fit leans on (Cook's distance > {limit:.2g}): {listed}")
        if tests.box_cox is not None:
            low, high = tests.box_cox.ci95
            exponent = tests.box_cox.exponent
            yield Verbatim(f"Box-Cox exponent {exponent:.2f} (95 % {low:.2f} to {high:.2f})")
        yield robustness(analysis, data)
        yield _detectable(analysis)
    if analysis.nested is not None:
        yield Table.of(
            f"What {analysis.nested.rows} 'independent' rows would have claimed",
            analysis.nested.terms,
            {
                "Term": lambda t: t.term,
                f"F ({analysis.nested.unit} as the replicate)": lambda t: (
                    f"F({t.df[0]:g}, {t.df[1]:g}) = {t.f:.4g}"
                ),
                "p": lambda t: p_value(t.p),
                "F (every row)": lambda t: (
                    f"F({t.naive_df[0]:g}, {t.naive_df[1]:g}) = {t.naive_f:.4g}"
                ),
                "p (every row)": lambda t: p_value(t.naive_p),
            },
        )
        yield from (Verbatim(f"{text}.") for text in unit_sentences(analysis)[:2])
    if analysis.contrasts:
        yield replace(contrast_table(analysis.contrasts, item, analysis.request.alpha), name=ASKED)


def effect_blocks(item: Facts, data: ReportData) -> Iterator[Block | None]:
    """Means, largest differences with their verdicts, and the telling simple effects."""
    yield replace(means(item, data), grouped=False)
    yield replace(tables.verdicts((item,), data), name="Effects", grouped=False)
    # without a threshold nothing can be told, which is said once for all
    explained = (e for e in item.effects if e.verdict in REFUSALS or e.condition)
    reasons = gathered((f"{e.verdict} ({e.why})", e.term) for e in explained if e.practical)
    yield from (Verbatim(f"{', '.join(terms)}: {why}") for why, terms in reasons.items())
    # of every factor that interacts the largest simple effect, and that which decides its verdict
    telling = [(e, dict.fromkeys((e.largest_simple, e.deciding_simple))) for e in item.terms]
    terms = tuple(replace(e, simple_effects=tuple(filter(None, few))) for e, few in telling)
    largest = simple_effects(replace(item, terms=terms), data)
    title = "Largest simple effects, and those that decide a verdict"
    yield largest and replace(largest, name=title)


def _detectable(analysis: AnalysisResult) -> Table | None:
    """Differences that would be seen with power 80 %, by the number of units."""
    power = analysis.power
    if not power:
        return None
    digits = ratio_digits if analysis.request.scale.is_log else lambda _: 3
    rows = tuple(
        (term, *(significant(row.detectable, digits(row.detectable)) for row in rows_of_term))
        for term, rows_of_term in power.items()
    )
    counts = (str(row.n) for row in next(iter(power.values())))
    unit = analysis.data.block or "replicates a cell"
    return Table(f"Detectable (power 80 %), by {unit}", ("Term", *counts), rows)


def unit_sentences(analysis: AnalysisResult) -> tuple[str, ...]:
    """Say what the analysis by units claims, and what one by rows would have; empty without."""
    nested = analysis.nested
    return () if nested is None else tuple(repeats.sentences(nested, analysis.request.alpha))


def mixed_blocks(model: MixedModel, response: str, alpha: float) -> Iterator[Block | None]:
    """Variance components, tests, slopes, means, effects and contrasts."""
    import pandas as pd

    ends = f"{100 * (1 - alpha):.4g} % interval"
    yield Table.of(
        f"Scatter by source (REML, {model.rows} rows)",
        model.components,
        {
            "Source": lambda c: c.source,
            "standard deviation": lambda c: significant(c.sd, 4),
            ends: lambda c: (
                f"{significant(c.low, 4)} to "
                + ("unknown" if math.isinf(c.high) else significant(c.high, 4))
            ),
            "share of the variance": lambda c: f"{100 * c.share:.0f} %",
        },
    )
    yield Table.of(
        "Tests of the fixed terms (Kenward and Roger)",
        model.terms,
        {
            "Term": lambda term: term.term,
            "DF": lambda term: str(term.df),
            "F": lambda term: f"{term.f:.2f}",
            "DF of error": lambda term: f"{term.df_error:.1f}",
            "p": lambda term: p_value(term.p),
        },
    )
    yield Table.of(
        "Slopes",
        model.slopes,
        {
            "Covariate": lambda slope: slope.covariate,
            "change for each unit": lambda slope: significant(slope.value, 4),
            ends: lambda slope: interval(slope.low, slope.high),
        },
    )
    item = Facts(response, "", title=response, terms=model.effects)
    if model.effects:
        yield from effect_blocks(item, ReportData("table", "", {}, pd.DataFrame(), alpha=alpha))
    if model.contrasts:
        yield replace(contrast_table(model.contrasts, item, alpha), name=ASKED)


# Checks that follow from the analysis: outcome, finding, and what it means for the reader.


def all_checks(data: ReportData, all_facts: Sequence[Facts]) -> list[Check]:
    """Gather the checks of the run, then the controls, then those of each analysis, worst first."""
    # controls that pass stand under numerical credibility alone
    bad = (check for check in data.controls if check.outcome in ("fail", "caution"))
    every = [*data.checks, *bad]
    if data.retried:
        finding = tables.retried_sentence(data.retried)
        where = "They are listed among the failures."
        every.append(Check("Cases with other settings", "caution", finding, where))
    for facts in all_facts:
        if facts.terms:
            every += [replace(check, of=facts.title) for check in _of_response(facts, data)]
        elif not data.surfaces:
            why = next(iter(facts.warnings), "no reason was recorded")
            every.append(Check("Analysis", "fail", why, _NO_VERDICT, facts.title))
    return [*every, *(_surface(surface, data) for surface in data.surfaces)]


_NO_VERDICT = "No verdict for this response."
_OUTCOMES = ("fail", "caution", "not applicable", "pass")


def by_name(every: Iterable[Check]) -> list[list[Check]]:
    """Gather checks of the same name, the worst outcome first, in and among the groups."""
    ranked = sorted(every, key=lambda check: _OUTCOMES.index(check.outcome))
    return list(gathered((check.name, check) for check in ranked).values())


def check_table(every: Iterable[Check], name: str) -> Table:
    """List every check, named in the first of its rows: outcome, finding, what follows."""
    rows = [
        ("" if k else sentence(check.name).rstrip("."), check.outcome, clean(check.of),
         sentence(clean(check.finding)), sentence(clean(check.consequence)))
        for group in by_name(every)
        for k, check in enumerate(group)
    ]  # fmt: skip
    columns = ("check", "outcome", "response", "finding", "what follows")
    return Table(name, columns, tuple(rows), len(columns))


def _surface(fitted: FittedSurface, data: ReportData) -> Check:
    name, of = "Surface predicts runs left out", surface_content.title(fitted, data)
    if fitted.surface is None:
        outcome = "not applicable" if fitted.screened else "fail"
        return Check(name, outcome, clean(fitted.refused), _NO_VERDICT, of)
    q2 = fitted.surface.model.q2
    outcome = "pass" if q2 >= GIVEN else "caution" if q2 >= RANKED else "fail"
    use = "Between the runs its values may be used." if outcome == "pass" else "Add runs."
    return Check(name, outcome, surface_content.accuracy(fitted), use, of)


def _of_response(facts: Facts, data: ReportData) -> Iterator[Check]:
    """Make the checks of one analysis; the last asks whether claims hang on a single block."""
    yield _normality(facts, data.alpha)
    yield _spread(facts, data.alpha)
    yield from _missing(facts, data)
    if (least := effect_words.least_sphericity(facts)) is not None:
        finding = f"smallest epsilon {least[1]:.2f}, of {term_name(least[0], data.labels)}"
        changed = [
            term_name(row.term, data.labels)
            for row in facts.rows
            if row.p is not None and row.p_gg is not None and row.p < data.alpha <= row.p_gg
        ]
        decides = f"The correction decides for {listing(changed)}: read the corrected p."
        mend = decides if changed else "The correction changes no decision."
        yield Check("Sphericity", "caution" if changed else "pass", finding, mend)
    tukey, unit = facts.assumptions.non_additivity, clean(data.block) or "block"
    if tukey is not None and tukey.p is not None and math.isfinite(tukey.p):
        name = f"No interaction between cell and {unit}"
        finding = f"rejected by Tukey's one-degree test ({p_phrase(tukey.p)})"
        if tukey.p >= data.alpha:
            holds = f"Nothing speaks against equal effects in all {plural_of(unit)}."
            yield Check(name, "pass", f"not {finding}", holds)
        else:
            mend = f"Effects scale with the level of the {unit}: consider the log."
            yield Check(name, "caution", finding, mend)
    bounded = [effect for effect in facts.effects if effect.u_num is not None]
    if bounded or not data.is_table:  # a table has no mesh
        yield _resolution(facts, data, len(bounded))
    judged = [effect for effect in facts.effects if effect.lost_without is not None]
    lost = [
        f"the claim on {term_name(effect.term, data.labels)} fails if "
        f"{effect_words.blocks_needed(effect, facts)} is left out"
        for effect in judged
        if effect.lost_without
    ]
    name, claims = f"Claims hold with any one {facts.block} left out", len(judged)
    if lost:
        those = "it" if len(lost) == 1 else "them"
        more = f"Measure more {plural_of(facts.block)} before relying on {those}."
        yield Check(name, "caution", listing(lost), more)
    elif judged:
        finding = {1: "the claim does", 2: "both claims do"}.get(claims, f"all {claims} claims do")
        yield Check(name, "pass", finding, f"No claim hangs on a single {facts.block}.")


def _missing(facts: Facts, data: ReportData) -> Iterator[Check]:
    """Make the check whether the missing responses decide a verdict."""
    if facts.result is None or not facts.has_size or not facts.result.failure_bounds:
        return
    name, filled = "Missing responses", "between the worst and the best observed value they change"
    if hanging := sorted(facts.hang_on_missing):
        finding = f"{filled} the verdict on {listing([term_name(t, data.labels) for t in hanging])}"
        yield Check(name, "caution", finding, "It stands only if they are like the others.")
    else:
        yield Check(name, "pass", f"{filled} no claim", "No claim hangs on them.")


def _normality(facts: Facts, alpha: float) -> Check:
    normality, name = facts.assumptions.normality, "Residuals as from a normal distribution"
    if normality is None or normality.rj is None:
        reason = (normality and normality.reason) or "there are no residuals to test"
        return Check(name, "not applicable", f"Ryan-Joiner: {reason}")
    p = "" if normality.p_exact is None else f" ({p_phrase(normality.p_exact)})"
    finding = f"rejected by Ryan-Joiner{p}"
    if not effect_words.rejects_normality(facts, alpha):
        return Check(name, "pass", f"not {finding}", "The p-values may be read as they are.")
    mend = "; the log of the response may help" * (not facts.ratio)
    return Check(name, "caution", finding, f"Small p-values are approximate{mend}.")


def _spread(facts: Facts, alpha: float) -> Check:
    name, tests = "Equal spread of the cells", facts.assumptions.spread
    ps = {
        key.capitalize(): effect_words.p_of(test)
        for key, test in tests.items()
        if test.statistic is not None
    }
    if not ps:
        reasons = list(dict.fromkeys(test.reason for test in tests.values() if test.reason))
        why = listing(reasons) or "there are no residuals to test"
        untested = f"neither Bartlett's nor Levene's test applies: {why}"
        return Check(name, "not applicable", untested)
    against = [test for test, p in ps.items() if p is not None and p < alpha]
    p_values = listing([f"{test} {p_phrase(p)}" for test, p in ps.items()])
    if not against:
        finding = f"not rejected ({p_values})"
        return Check(name, "pass", finding, "One error serves for all cells.")
    unequal = "Intervals are too short for the cells that scatter most and too long for the others."
    return Check(name, "caution", f"rejected by {listing(against)} ({p_values})", unequal)


def _resolution(facts: Facts, data: ReportData, bounded: int) -> Check:
    """Whether the error of what was refined leaves a verdict open, where it is known."""
    refined = data.refinement.name
    name = f"Effects resolved by the {refined}"
    if not bounded:
        finding = "No numerical uncertainty is known."
        mend = f"Every claim holds at this {refined}: the discretization was not examined."
        return Check(name, "not applicable", finding, mend)
    names = {effect.term: term_name(effect.term, data.labels) for effect in facts.effects}
    open_ones = [effect for effect in facts.effects if effect.verdict == NOT_RESOLVED]
    if not open_ones:
        finding = f"{refined} error, added to the interval, changes no verdict (of {bounded})"
        unbounded = [names[effect.term] for effect in facts.effects if effect.u_num is None]
        if unbounded:
            finding += f"; no bound is known for {listing(unbounded)}"
            holds = "These verdicts hold" if len(unbounded) > 1 else "That verdict holds"
            return Check(name, "caution", finding, f"{holds} at this {refined}; refine further.")
        return Check(name, "pass", finding, f"A finer {refined} would change no verdict.")
    needed = [
        f"below {bound(effect.u_needed, effect, facts)} for {names[effect.term]}"
        for effect in open_ones
        if effect.u_needed is not None
    ]
    unclear = listing([names[e.term] for e in open_ones])
    finding = f"{refined} error is too large to judge {unclear}"
    finding += "; the measurements alone would suffice" * data.is_measured
    below = f"Refine until the {refined} error is {listing(needed)}."
    return Check(name, "caution", finding, below if needed else f"Refine the {refined}.")
