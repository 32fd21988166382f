"""Tables of the page of one analysis, in the order and with the heads that Minitab gives them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from study.ground.canonical import plain
from study.reporting.content import sentences, surface_content, tables, verdicts
from study.reporting.content.content_table import Table, bound
from study.reporting.content.numbers import (
    MISSING,
    f_value,
    interval,
    level,
    p_phrase,
    p_value,
    percent,
    significant,
)
from study.reporting.content.report_facts import Facts
from study.reporting.content.text import clean, listing, plural_of, term_name
from study.reporting.results.study_result import Check, ReportData
from study.statistics.analysis.anova_table import Row
from study.statistics.analysis.simple_effects import NOT_RESOLVED
from study.statistics.surfaces.emulator import GIVEN, RANKED
from study.statistics.surfaces.surface_profile import FittedSurface

if TYPE_CHECKING:
    from study.statistics.analysis.analysis_result import AnalysisResult
    from study.statistics.analysis.comparisons import Comparisons
    from study.statistics.analysis.equal_variance import SpreadTest
    from study.statistics.analysis.post_hoc import (
        CoefficientTable,
        PairwiseDifference,
        UnusualObservations,
    )


#: Rows that a page lists of a long table; the CSV beside it has all.
MOST_ROWS = 40
#: Digits of sums of squares and statistics, as Minitab prints them.
DIGITS = 5


def analysis_of_variance(analysis: AnalysisResult) -> Table:
    """Source, DF, SS, MS, F, P for every term, the error and the total."""
    rows = analysis.anova.rows
    corrected = any(row.p_gg is not None for row in rows)
    strata = len({row.error for row in rows if row.error}) > 1
    how = "Seq" if analysis.anova.type == "I" else "Adj"
    columns = ["source", "DF", f"{how} SS", f"{how} MS", "F", "p"]
    columns += ["GG epsilon", "p corrected"] if corrected else []
    columns += ["tested against"] if strata else []
    shown = [_anova_row(row, corrected, strata) for row in rows]
    if analysis.anova.ss_total is not None:
        total = (
            "total",
            f"{analysis.anova.df_total}",
            significant(analysis.anova.ss_total, DIGITS),
        )
        shown.append((*total, *[""] * (len(columns) - 3)))
    raw = tuple(plain(row) for row in rows)
    return Table("anova", tuple(columns), tuple(shown), 1, int(strata), raw=raw)


def _anova_row(row: Row, corrected: bool, strata: bool) -> tuple[str, ...]:
    name = "error" if row.term == "residual" else row.term.replace(":", " \N{MULTIPLICATION SIGN} ")
    sums = significant(row.ss, DIGITS), significant(row.ms, DIGITS) if row.ms is not None else ""
    tested = row.f is not None
    cells = [clean(name), f"{row.df:g}", *sums]
    cells += [f_value(row.f) if tested else "", p_value(row.p) if row.p is not None else ""]
    if corrected:
        cells += [
            "" if row.epsilon_gg is None else f"{row.epsilon_gg:.3f}",
            "" if row.p_gg is None else p_value(row.p_gg),
        ]
    if strata:
        cells.append(clean((row.error or "").replace(":", " \N{MULTIPLICATION SIGN} ")))
    return tuple(cells)


def model_summary(analysis: AnalysisResult) -> Table | None:
    """S, R-sq, adjusted and predicted; None where nothing was left over."""
    summary = analysis.variation.summary
    if summary is None:
        return None
    shares = (summary.r_sq, summary.r_sq_adj, summary.r_sq_pred)
    row = (significant(summary.s, DIGITS), *(percent(x, 4) for x in shares))
    columns = ("S", "R-sq", "R-sq (adjusted)", "R-sq (predicted)")
    note = (
        "R-sq (predicted) is 1 \N{MINUS SIGN} PRESS / total: each row is predicted from all others."
    )
    return Table("model summary", columns, (row,), 1, 0, note, (plain(summary),))


def coefficients(table: CoefficientTable, facts: Facts) -> Table | None:
    """Coefficient, standard error, t, p and variance inflation factor of every column."""
    if not table.coefficients:
        return None
    inflated = any(c.vif is not None for c in table.coefficients)
    rows = tuple(
        (
            clean(c.term),
            significant(c.estimate, 4),
            significant(c.standard_error),
            significant(c.t),
            p_value(c.p),
            *([significant(c.vif) if c.vif is not None else ""] if inflated else []),
        )
        for c in table.coefficients
    )
    columns = ("term", "coefficient", "standard error", "t", "p", *(["VIF"] if inflated else []))
    scale = " of the log" if facts.ratio else ""
    note = (
        f"Sum-to-zero coding: a coefficient{scale} is the distance of a level from the mean of "
        "all; the last level of a factor is minus the sum of the others."
    )
    raw = tuple(plain(c) for c in table.coefficients)
    return Table("coefficients", columns, rows[:MOST_ROWS], 1, 0, note + _cut(len(rows)), raw)


def means(facts: Facts, data: ReportData) -> Table:
    """Mean of every level of every factor and combination, with interval and letters."""
    rows: list[tuple[str, ...]] = []
    raw: list[dict[str, object]] = []
    for effect in facts.terms:
        for i, (name, mean) in enumerate(zip(effect.levels, effect.mean, strict=True)):
            low, high = (None, None) if effect.mean_ci95 is None else effect.mean_ci95[i]
            letters = effect.letters[i] if effect.letters else ""
            values = significant(mean, 4), interval(low, high, digits=4)
            rows.append((term_name(effect.term, data.labels), clean(name, 60), *values, letters))
            raw.append({"term": effect.term, "level": name, "mean": mean, "low": low, "high": high,
                        "letters": letters})  # fmt: skip
    columns = ("term", "level", "mean", f"{level(data.alpha)} interval", "grouping")
    note = "Levels of a factor that share a letter are not told apart." + _cut(len(rows))
    return Table(
        "means", columns, tuple(rows[:MOST_ROWS]), 2, 1, note, tuple(raw), grouped=True
    )  # fmt: skip


def simple_effects(facts: Facts, data: ReportData) -> Table | None:
    """Differences of two levels at each setting of the other factors; None without interaction."""
    listed = [(e, simple) for e in facts.effects for simple in e.simple_effects if simple.at]
    if not listed:
        return None
    sign = "/" if facts.ratio else "\N{MINUS SIGN}"
    rows = tuple(
        (
            term_name(effect.term, data.labels),
            f"{clean(simple.first, 30)} {sign} {clean(simple.second, 30)}",
            ", ".join(
                f"{term_name(name, data.labels)} {clean(lev, 30)}" for name, lev in simple.at
            ),
            significant(simple.difference),
            interval(*(simple.ci or (None, None))),
            interval(*(simple.ci_simultaneous or (None, None))),
            simple.verdict,
        )
        for effect, simple in listed
    )
    what = "ratio" if facts.ratio else "difference"
    ends = ("its own interval", "simultaneous interval")
    columns = ("factor", "levels", "at", what, *ends, "verdict")
    note = (
        "A factor makes no practical difference where every own interval lies inside what matters; "
        "it matters where one simultaneous interval lies beyond." + _cut(len(rows))
    )
    raw = tuple(
        {"factor": e.term, **{k: v for k, v in asdict(simple).items() if not isinstance(v, tuple)},
         "at": "; ".join(f"{name}={lev}" for name, lev in simple.at),
         "low": None if simple.ci is None else simple.ci[0],
         "high": None if simple.ci is None else simple.ci[1],
         "low_simultaneous": None if simple.ci_simultaneous is None else simple.ci_simultaneous[0],
         "high_simultaneous": None if simple.ci_simultaneous is None else simple.ci_simultaneous[1]}
        for e, simple in listed
    )  # fmt: skip
    return Table("simple effects", columns, rows[:MOST_ROWS], 3, 1, note, raw)


def contrasts(facts: Facts) -> Table | None:
    """Differences of two settings that were asked for by name; None without any."""
    result = facts.response.result
    if result is None or not result.contrasts:
        return None
    return contrast_table(result, facts.name, facts.unit)


def contrast_table(result: AnalysisResult, name: str, unit: str = "") -> Table:
    """Differences of two settings that were asked for by name."""
    what = "ratio" if result.request.scale.is_log else "difference"
    level = f"{100 * (1 - result.request.alpha):.4g} %"
    several = len(result.contrasts) > 1
    columns = ("asked for", what, f"{level} interval, all together", "U", "p",
               *(("Holm's p",) if several else ()), "verdict")  # fmt: skip
    rows = tuple(
        (
            clean(item.name, 200),
            significant(item.difference),
            interval(*(item.ci_simultaneous or (None, None))),
            significant(item.u, 2),
            p_value(item.p),
            *((p_value(item.p_holm),) if several else ()),
            f"{item.verdict}: {item.why}" if item.why else item.verdict,
        )
        for item in result.contrasts
    )
    adjusted = ", and Holm's p is adjusted for all of them" if several else ""
    note = (
        "Each row is the mean over all cells of the first setting less (or over) that of the "
        "second; a factor that a setting leaves out is averaged over. The intervals hold for all "
        f"rows together{adjusted}. U, the bound of the numerical error, is in "
        f"{unit or 'the response'}."
    )
    raw = tuple(
        {"contrast": item.name, "difference": item.difference, "U": item.u, "p": item.p,
         "p_holm": item.p_holm,
         "low": None if item.ci_simultaneous is None else item.ci_simultaneous[0],
         "high": None if item.ci_simultaneous is None else item.ci_simultaneous[1],
         "verdict": item.verdict}
        for item in result.contrasts
    )  # fmt: skip
    return Table(f"contrasts {name}", columns, rows, 1, 0, note, raw)


def pairwise(pairs: tuple[PairwiseDifference, ...], facts: Facts, data: ReportData) -> Table | None:
    """All pairs of levels with simultaneous interval and adjusted p."""
    if not pairs:
        return None
    sign = "/" if facts.ratio else "\N{MINUS SIGN}"
    rows = tuple(
        (
            term_name(pair.factor, data.labels),
            f"{clean(pair.first, 30)} {sign} {clean(pair.second, 30)}",
            significant(pair.difference),
            interval(pair.lower, pair.upper),
            p_value(pair.p),
            pair.method,
        )
        for pair in pairs
    )
    what = "ratio" if facts.ratio else "difference"
    ends = f"simultaneous {level(data.alpha)} interval"
    columns = ("factor", "levels", what, ends, "adjusted p", "method")
    note = "Interval and p hold for all pairs of a factor together." + _cut(len(rows))
    raw = tuple(plain(pair) for pair in pairs)
    return Table("pairwise comparisons", columns, rows[:MOST_ROWS], 2, 1, note, raw, grouped=True)


def against_reference(factor: str, comparisons: Comparisons, data: ReportData) -> Table:
    """Every level against a reference (Dunnett)."""
    reference = comparisons.pairs[0].second
    rows = tuple(
        (clean(pair.first), significant(pair.difference), interval(pair.lower, pair.upper),
         p_value(pair.p))
        for pair in comparisons.pairs
    )  # fmt: skip
    name = f"{term_name(factor, data.labels)} against {clean(reference)}"
    ends = f"simultaneous {level(comparisons.alpha)} interval"
    columns = ("level", comparisons.effect, ends, "adjusted p")
    raw = tuple(plain(pair) for pair in comparisons.pairs)
    return Table(name, columns, rows, 1, 0, f"{comparisons.method}.", raw)


def checks(analysis: AnalysisResult, name: str = "tests of assumptions") -> Table | None:
    """Statistic and p of every test of an assumption that ran."""
    tests = analysis.assumptions
    rows: list[tuple[str, str, float | None, str, str]] = []
    rj = tests.normality
    if rj is not None and rj.applicable:
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
            of = " (median)" if key == "levene" else ""
            of += ", approximate" if spread.approximate else ""
            p = p_value(spread.p), p_value(spread.p_monte_carlo)
            rows.append(("equal spread", f"{key.capitalize()}{of}", spread.statistic, *p))
    tukey = tests.non_additivity
    if tukey is not None and tukey.p is not None:
        rows.append(("additivity", "Tukey, one df", tukey.f, p_value(tukey.p), ""))
    for term, sphere in tests.sphericity.items():
        if sphere.p is not None:
            rows.append(("sphericity", f"Mauchly, {clean(term)}", sphere.w, p_value(sphere.p), ""))
    if not rows:
        return None
    columns = ("assumption", "test", "statistic", "p", "p simulated")
    shown = tuple((*row[:2], significant(row[2], 4), *row[3:]) for row in rows)
    raw = tuple(dict(zip(columns, row, strict=True)) for row in rows)
    return Table(name, columns, shown, 2, 0, "", raw)


def unusual(unusual_rows: UnusualObservations | None) -> Table | None:
    """Rows with a large residual, a high leverage or a large Cook's distance."""
    if unusual_rows is None or unusual_rows.rows.empty:
        return None
    columns = (
        "row",
        "response",
        "fit",
        "residual",
        "standardized",
        "leverage",
        "Cook",
        "PRESS residual",
        "why",
    )  # noqa: E501
    numbers = ("response", "fitted", "residual", "standardized", "leverage", "cook", "press")
    raw = tuple({str(k): v for k, v in row.items()} for row in unusual_rows.rows.to_dict("records"))
    rows = tuple(
        (f"{row['row']}", *(significant(float(str(row[key]))) for key in numbers), str(row["why"]))
        for row in raw[:MOST_ROWS]
    )
    return Table("unusual observations", columns, rows, 0, 1, _cut(len(raw)).strip(), raw)


def robustness(analysis: AnalysisResult, data: ReportData) -> Table | None:
    """Give p of every term in each defensible analysis."""
    table = analysis.assumptions.robustness
    if table is None or not table.p:
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


def _cut(n: int) -> str:
    return f" The first {MOST_ROWS} of {n:,} are shown; the CSV has all." if n > MOST_ROWS else ""


# Checks that follow from the analysis: outcome, finding, and what it means for the reader.

_ORDER = {"fail": 0, "caution": 1, "not applicable": 2, "pass": 3}


@dataclass(frozen=True)
class CheckGroup:
    """One check for all responses; its outcome is the worst of them."""

    name: str
    items: tuple[Check, ...]

    @property
    def outcome(self) -> str:
        """Worst outcome."""
        return min((check.outcome for check in self.items), key=_ORDER.__getitem__)

    @property
    def consequence(self) -> str:
        """What follows, where it is the same for two responses or more; else empty."""
        texts = [check.consequence for check in self.items if check.consequence]
        return texts[0] if len(texts) > 1 and len(set(texts)) == 1 else ""

    @property
    def agreed(self) -> bool:
        """Whether every response has the same outcome."""
        return len({check.outcome for check in self.items}) == 1


def grouped(made: Sequence[Check]) -> tuple[CheckGroup, ...]:
    """Gather checks of the same name into one, the worst first."""
    by_name: dict[str, list[Check]] = {}
    for check in made:
        by_name.setdefault(check.name, []).append(check)
    groups = [CheckGroup(name, tuple(items)) for name, items in by_name.items()]
    return tuple(sorted(groups, key=lambda group: _ORDER[group.outcome]))


def all_checks(data: ReportData, all_facts: Sequence[Facts]) -> tuple[Check, ...]:
    """Gather the checks of the run, then the controls, then those of each analysis, worst first."""
    # controls that pass stand under numerical credibility alone
    bad = [check for check in data.controls if check.outcome in ("fail", "caution")]
    made = [*data.checks, *bad, *_of_cases(data)]
    for facts in all_facts:
        if facts.terms:
            made += [
                _normality(facts, data.alpha),
                _spread(facts, data.alpha),
                *_sphericity(facts, data),
                *_additivity(facts, data),
                *_resolution(facts, data),
                *_fragile(facts, data),
            ]
        elif not data.surfaces:
            why = facts.warnings[0] if facts.warnings else "no reason was recorded"
            made.append(
                Check("Analysis", "fail", why, "No verdict for this response.", facts.title)
            )
    made += [_surface(surface, data) for surface in data.surfaces]
    return tuple(sorted(made, key=lambda check: _ORDER[check.outcome]))


def _of_cases(data: ReportData) -> list[Check]:
    made = []
    if data.failures:
        finding = sentences.failures(data.failures, len(data.table))
        made.append(Check("Failed cases", "caution", finding, "See the failure map."))
    if data.retried:
        finding = tables.retried_sentence(data.retried)
        where = "They are listed among the failures."
        made.append(Check("Cases with other settings", "caution", finding, where))
    return made


def _surface(fitted: FittedSurface, data: ReportData) -> Check:
    """Whether a surface predicts runs that it has not seen."""
    name, of = "Surface predicts runs left out", surface_content.title(fitted, data)
    if fitted.found is None:
        return Check(name, "fail", clean(fitted.refused), "No verdict for this response.", of)
    q2 = fitted.found.model.q2
    if q2 >= GIVEN:
        use = "Between the runs its values may be used."
        return Check(name, "pass", surface_content.accuracy(fitted), use, of)
    outcome = "caution" if q2 >= RANKED else "fail"
    return Check(name, outcome, surface_content.accuracy(fitted), "Add runs.", of)


def _normality(facts: Facts, alpha: float) -> Check:
    normality, name = facts.assumptions.normality, "Residuals as from a normal distribution"
    if normality is None or normality.rj is None:
        reason = (normality and normality.reason) or "there are no residuals to test"
        return Check(name, "not applicable", f"Ryan-Joiner: {reason}", of=facts.title)
    rejected = verdicts.rejects_normality(facts, alpha)
    finding = f"{'rejected' if rejected else 'not rejected'} by Ryan-Joiner"
    if normality.p_exact is not None:
        finding += f" ({p_phrase(normality.p_exact)})"
    if not rejected:
        return Check(name, "pass", finding, "The p-values may be read as they are.", facts.title)
    return Check(
        name,
        "caution",
        finding,
        "Small p-values are approximate; the verdicts rest on the size of the effect "
        "against what matters."
        + ("" if facts.ratio else " The log of a positive response often helps."),
        facts.title,
    )


def _untested(tests: Mapping[str, SpreadTest]) -> str:
    """Why neither test of the spread applies."""
    reasons = [reason for reason in dict.fromkeys(test.reason for test in tests.values()) if reason]
    why = listing(reasons) if reasons else "they were not run"
    return f"neither Bartlett's nor Levene's test applies: {why}"


def _spread(facts: Facts, alpha: float) -> Check:
    name = "Equal spread of the cells"
    tests = facts.assumptions.spread
    applicable = {k: t for k, t in tests.items() if t.statistic is not None}
    if not applicable:
        return Check(name, "not applicable", _untested(tests), of=facts.title)
    against = [k.capitalize() for k, t in applicable.items() if verdicts.rejects(t, alpha)]
    p_values = listing(
        [f"{k.capitalize()} {p_phrase(verdicts.p_of(t))}" for k, t in applicable.items()]
    )
    if not against:
        finding = f"not rejected ({p_values})"
        return Check(name, "pass", finding, "One error serves for all cells.", facts.title)
    return Check(
        name,
        "caution",
        f"rejected by {listing(against)} ({p_values})",
        "Intervals are too short for the cells that scatter most and too long for the others.",
        facts.title,
    )


def _sphericity(facts: Facts, data: ReportData) -> list[Check]:
    least = verdicts.least_sphericity(facts)
    if least is None:
        return []
    term, epsilon = least
    name = "Sphericity"
    finding = f"smallest epsilon {epsilon:.2f}, of {term_name(term, data.labels)}"
    changed = [
        term_name(row.term, data.labels)
        for row in facts.rows
        if row.p is not None and row.p_gg is not None and row.p < data.alpha <= row.p_gg
    ]
    if changed:
        return [
            Check(
                name,
                "caution",
                finding,
                f"The correction decides for {listing(changed)}: read the corrected p.",
                facts.title,
            )
        ]
    return [Check(name, "pass", finding, "The correction changes no decision.", facts.title)]


def _additivity(facts: Facts, data: ReportData) -> list[Check]:
    non_additivity = facts.assumptions.non_additivity
    if non_additivity is None or non_additivity.p is None or not math.isfinite(non_additivity.p):
        return []
    p = non_additivity.p
    name = f"No interaction between cell and {clean(data.block) or 'block'}"
    if p >= data.alpha:
        finding = f"not rejected by Tukey's one-degree test ({p_phrase(p)})"
        units = plural_of(clean(data.block) or "block")
        return [Check(name, "pass", finding, f"Effects hold in all {units} alike.", facts.title)]
    return [
        Check(
            name,
            "caution",
            f"rejected by Tukey's one-degree test ({p_phrase(p)})",
            f"Effects grow or shrink with the level of the {clean(data.block) or 'block'}: "
            "consider the log.",
            facts.title,
        )
    ]


def _resolution(facts: Facts, data: ReportData) -> list[Check]:
    """Whether mesh error leaves a verdict open; nothing for a table, which has no mesh."""
    name = "Effects resolved by the mesh"
    bounded = [effect for effect in facts.effects if effect.u_num is not None]
    if not bounded:
        finding = "No numerical uncertainty is known."
        mend = "Every claim holds at this mesh: the discretization was not examined."
        none = Check(name, "not applicable", finding, mend, facts.title)
        return [] if data.is_table else [none]
    open_ones = [effect for effect in facts.effects if effect.verdict == NOT_RESOLVED]
    if not open_ones:
        finding = f"mesh error, added to the interval, changes no verdict (of {len(bounded)})"
        unbounded = [term_name(e.term, data.labels) for e in facts.effects if e.u_num is None]
        if unbounded:
            finding += f"; no bound is known for {listing(unbounded)}"
            holds = "These verdicts hold" if len(unbounded) > 1 else "That verdict holds"
            mend = f"{holds} at this mesh; refine further."
            return [Check(name, "caution", finding, mend, facts.title)]
        sure = "Finer meshes would change no verdict."
        return [Check(name, "pass", finding, sure, facts.title)]
    needed = [
        f"below {bound(effect.u_needed, effect, facts)} for {term_name(effect.term, data.labels)}"
        for effect in open_ones
        if effect.u_needed is not None
    ]
    named = listing([term_name(effect.term, data.labels) for effect in open_ones])
    finding = f"mesh error is too large to judge {named}; the measurements alone would suffice"
    mend = (
        f"Refine: mesh error would have to be {listing(needed)}." if needed else "Refine the mesh."
    )
    return [Check(name, "caution", finding, mend, facts.title)]


def _fragile(facts: Facts, data: ReportData) -> list[Check]:
    """Say which claims fall with one block."""
    judged = [effect for effect in facts.effects if effect.lost_without is not None]
    if not judged:
        return []
    name = f"Claims hold with any one {facts.block} left out"
    lost = [
        f"the claim on {term_name(effect.term, data.labels)} fails if "
        f"{verdicts.blocks_needed(effect, facts)} is left out"
        for effect in judged
        if effect.lost_without
    ]
    if not lost:
        many = {1: "the claim does", 2: "both claims do"}
        finding = many.get(len(judged), f"all {len(judged)} claims do")
        sure = f"No claim hangs on a single {facts.block}."
        return [Check(name, "pass", finding, sure, facts.title)]
    claims = "it" if len(lost) == 1 else "them"
    more = f"Measure more {plural_of(facts.block)} before relying on {claims}."
    return [Check(name, "caution", listing(lost), more, facts.title)]
