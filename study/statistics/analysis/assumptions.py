"""Every test of what an analysis assumes: its field, what fills it, and its key in JSON."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from study.ground.arrays import Array, gathered
from study.ground.errors import Fault, InputError, settled
from study.statistics.analysis import error_ledger
from study.statistics.analysis.analysis_result import AnalysisResult, Assumptions
from study.statistics.analysis.anova_table import AnalysisSensitivity, BoxCoxResult
from study.statistics.analysis.data import Crossed
from study.statistics.analysis.equal_variance import (
    ResidualDesign,
    SpreadTest,
    bartlett,
    fligner,
    levene,
    welch_tests,
)
from study.statistics.analysis.gate import TREND, drift_over_rows, rows_in_line
from study.statistics.analysis.linear_model import (
    Factorization,
    Term,
    factorize,
    model_matrix,
    span,
    term_name,
)
from study.statistics.analysis.normality import (
    RyanJoinerResult,
    anderson_darling,
    block_share,
    helmert_contrasts,
    row_normality,
    ryan_joiner,
    shapiro_wilk,
)
from study.statistics.analysis.strata import OwnTests, own_tests
from study.statistics.analysis.sums_of_squares import (
    EXACT,
    Factored,
    FRatioTest,
    TwoWayFit,
    factor,
    fitted,
    influential,
    term_row,
    term_sums,
)
from study.statistics.analysis.unreplicated import non_additivity, ulp_floor


def assumptions_of(out: AnalysisResult) -> AnalysisResult:
    """Run the tests of what an analysis assumes; their notes come after its own."""
    robustness, power = _robustness(out)
    if power is not None and not np.isfinite(power.ci95).all():
        out = out.warn(
            "Box-Cox: the interval of the exponent is open: the response varies too little beside "
            "its mean to exclude even the largest exponents that a double can hold"
        )
    if out.crossed is not None and out.replicates != "noise":
        tests, notes = _by_contrast(out, out.crossed)
        out = out.warn(*notes)
    else:
        out, tests = _of_residuals(out)
    sphericity = out.assumptions.sphericity
    tests = replace(tests, sphericity=sphericity, robustness=robustness, box_cox=power)
    if out.fit is not None and out.fit.df_residual > 0:
        tests = replace(
            tests,
            non_additivity=non_additivity(out.fit),
            anderson_darling=anderson_darling(out.fit.residual),
            shapiro_wilk=shapiro_wilk(out.fit.residual),
            influence=influential(out.fit),
        )
        out = out.warn(*_order_of_rows(out, out.fit))
    return replace(out, assumptions=tests)


def _order_of_rows(out: AnalysisResult, fit: Factored | TwoWayFit) -> list[str]:
    """Say that rows in line are alike, and what of the differences a drift over them explains."""
    drift = drift_over_rows(out, fit)
    alike = rows_in_line(out, drift)
    notes = [alike.note] if alike is not None and alike.p < TREND else []
    if drift is None:
        return notes
    rows, slope, test = drift.rows, drift.slope, drift.test
    shares = []
    for effect in out.effects if not out.request.scale.is_log else ():
        if effect.is_main and effect.largest and effect.range:
            label = np.array(out.data.layout.labels(effect.term))
            first, last = (float(rows[label == level].mean()) for level in effect.largest)
            shares.append(f"{slope * (first - last):.3g} of {effect.range:.3g} ({effect.term})")
    what = f"; it would be {', '.join(shares)} of the largest differences" if shares else ""
    return [
        f"the response drifts over the rows of the table ({slope:.3g} a row, {test.words}), which "
        f"counts if they stand in the order of the runs{what}",
        *notes,
    ]


# -------------------------------------------------------------------------------------------------
# Checks of normality and equal spread: on the residuals, or contrast by contrast over blocks.
#
# Where every effect is tested against its own interaction with the blocks, no residual is pooled
# and none may be tested as if it were: the contrasts differ in spread, which looks like heavy
# tails. Each contrast is then a sample of its own over the blocks.

_MONTE_CARLO = 10_000
#: Residuals that normality is tested on at most: beyond, a random sample of as many.
MOST_TESTED = 5000
#: Numbers simulated at most for a spread test of many rows; 10,000 designs of 1,000 rows.
_MOST_NUMBERS = 1e7
#: A block that carries more than this share of the interaction, with this p, is named.
SHARE_P = 0.05
_OWN = "each effect is tested against its own interaction with the blocks, whose spreads may differ"


def _by_contrast(out: AnalysisResult, table: Crossed) -> tuple[Assumptions, tuple[str, ...]]:
    """Test each contrast over the blocks, and find the block that carries most of them."""
    none = SpreadTest(None, None, None, _OWN)
    unequal = Assumptions(bartlett=none, levene=none)
    warnings = _inapplicable(bartlett=none, levene=none)
    try:
        contrasts = helmert_contrasts(table.layout, out.terms, table.y)
    except InputError:
        why = "normality: not tested, because a combination of levels is missing"
        return unequal, (*warnings, why)
    tolerance = out.working_tolerance() / 10
    tested = row_normality(
        contrasts, tolerance=tolerance, alpha=out.request.alpha, seed=out.request.seed
    )
    if tested.p is None:
        return unequal, (*warnings, f"normality: not tested, because {tested.warning}")
    if tested.warning:
        warnings.append(f"Ryan-Joiner over blocks: {tested.warning}")
    share = block_share(contrasts, tolerance=tolerance, seed=out.request.seed)
    if share is not None and share.p < SHARE_P:
        warnings.append(
            f"{out.data.block} {table.blocks[share.block]} carries {100 * share.share:.0f} % of "
            "the interactions with the blocks: see what is special about it"
        )
    worst = min(tested.rows, key=lambda row: row.p)
    values = contrasts[worst.term][worst.contrast]
    of_worst = ryan_joiner(values, seed=out.request.seed, exact=False, alpha=out.request.alpha)
    decision = f"{'rejected' if tested.rejected else 'not rejected'} at {out.request.alpha:g}"
    summary = replace(
        of_worst,
        p_exact=tested.p,
        decision=f"normality {decision}: the smallest of {len(tested.rows)} "
        f"contrasts over {tested.blocks} blocks, {worst.term}, adjusted p {tested.p:.3g}",
    )
    return replace(unequal, normality=summary, normality_rows=tested.rows), tuple(warnings)


def _inapplicable(**tests: SpreadTest) -> list[str]:
    """One sentence for every reason for which tests are not applicable."""
    reasons = gathered((test.reason, name) for name, test in tests.items() if test.reason)
    return [f"{' and '.join(names)}: not applied, because {why}" for why, names in reasons.items()]


def _ryan_joiner(
    out: AnalysisResult, fit: Factored | TwoWayFit
) -> tuple[AnalysisResult, RyanJoinerResult]:
    """Ryan-Joiner of the residuals; of many a random sample, which is said."""
    request, values, matrix = out.request, fit.residual, fit.columns
    if (n := values.size) > MOST_TESTED:
        # among so many rows a few residuals are as independent as a plain sample
        chosen = np.random.default_rng(request.seed).choice(n, MOST_TESTED, replace=False)
        values, matrix = values[np.sort(chosen)], None
        out = out.warn(
            f"Ryan-Joiner tests a random {MOST_TESTED:,} of the {n:,} residuals: with more, "
            "departures from normality that change no conclusion are found as well"
        )
    seed, exact, alpha = request.seed, request.exact, request.alpha
    return out, ryan_joiner(values, model_matrix=matrix, seed=seed, exact=exact, alpha=alpha)


def _of_residuals(out: AnalysisResult) -> tuple[AnalysisResult, Assumptions]:
    """Ryan-Joiner on one representative of each computation, and the tests of equal spread."""
    rows = np.flatnonzero(out.is_representative)
    if out.fit is None or out.fit.df_residual == 0:
        return out, Assumptions()
    blocked = out.data.block is not None
    if blocked:
        # of more rows than are tested, nobody asks for the columns of the model
        fit_of = error_ledger.within_fit if rows.size > MOST_TESTED else error_ledger.additive_fit
        fit: Factored | TwoWayFit = fit_of(out.data, out.y, rows, plots=out.plots)
    elif rows.size == out.y.size:
        fit = out.fit
    else:
        extra: list[Term] = [(name,) for name in out.data.blocks]
        reduced = model_matrix(out.data.layout.take(rows), out.terms, extra=extra)
        fit = factor(reduced, out.y[rows])
    out, normality = _ryan_joiner(out, fit)
    if not normality.applicable:
        out = out.warn(f"normality: not tested, because {normality.reason}")
    if normality.warning:
        out = out.warn(normality.warning)
    values = fit.residual if blocked else out.y[rows]
    names = out.data.cell_names()
    present, index = np.unique(out.data.cell[rows], return_inverse=True)
    groups = {names[c]: values[index == i] for i, c in enumerate(present)}
    # residuals of a blocked fit are correlated: their own design is simulated; of more rows than
    # are tested, they are as good as independent
    design = None
    if blocked and isinstance(fit, Factored) and index.size <= MOST_TESTED:
        design = ResidualDesign(fit.q, index)
    count = int(min(_MONTE_CARLO, _MOST_NUMBERS / index.size)) if out.request.exact else 0
    seed = out.request.seed
    equal = bartlett(groups, approximate=blocked, simulations=count, seed=seed, design=design)
    spread = levene(
        groups,
        center="auto" if out.request.exact or design else "median",
        approximate=blocked,
        simulations=count if design else 0,
        seed=seed,
        design=design,
    )
    rank = None if blocked else fligner(groups)
    out = out.warn(*_inapplicable(bartlett=equal, levene=spread))
    return out, Assumptions(normality, bartlett=equal, levene=spread, fligner=rank)


# -------------------------------------------------------------------------------------------------
# When spreads differ or residuals are skewed: Box-Cox, HC3, Welch-James, side by side.


def hc3(fit: Factored) -> dict[str, FRatioTest | None]:
    """Wald tests with the HC3 covariance (MacKinnon and White 1985), sum-to-zero contrasts.

    None where a row has leverage one, a term is not estimable, or cells do not scatter.
    """
    from statsmodels.tools.sm_exceptions import ValueWarning

    covariance = None
    if fit.df_residual > 0 and float(fit.leverage.max()) <= EXACT:
        # by the leverage at hand: statsmodels sums over all pairs of columns row by row, a fifth of
        # the time of 1,000,000 rows
        away = fit.residual / (1 - fit.leverage)
        covariance = (fit.q.T * away**2) @ fit.q
    tests: dict[str, FRatioTest | None] = {}
    for s in term_sums(fit, "III"):
        tests[term_name(s.term)] = None
        if covariance is None or s.df < s.nominal_df:
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ValueWarning)
            test = fit.ols.f_test(s.basis.T, cov_p=covariance)
        # of a singular covariance statsmodels would test fewer constraints, another hypothesis
        if test.df_num == s.df:
            values = test.fvalue, s.df, fit.df_residual, test.pvalue
            tests[term_name(s.term)] = FRatioTest(*map(float, values))
    return tests


def box_cox(y: Array, matrix: Array) -> BoxCoxResult:
    """Profile likelihood of the Box-Cox exponent in a linear model (Box and Cox 1964).

    Shapes: y (n,); matrix (n, p).
    """
    from scipy.optimize import brentq, minimize_scalar

    if y.min() <= 0:
        raise InputError(Fault("Box-Cox", f"needs a positive response, got {y.min():g}"))
    length = np.linalg.norm(matrix, axis=0)
    basis = span(matrix[:, length > 0] / length[length > 0])  # a cell may be empty
    if basis.shape[1] >= y.size:
        raise InputError(Fault("Box-Cox", "the model leaves no residual degrees of freedom"))
    logs = np.log(y)
    logs = logs - logs.mean()

    def deviance(exponent: float) -> float:
        # with the response over its geometric mean the Jacobian of the power is one
        z = logs if abs(exponent) < 1e-9 else np.expm1(exponent * logs) / exponent
        rest = z - basis @ (basis.T @ z)
        return float(y.size * np.log(rest @ rest))

    # beyond this a power of the response would overflow
    widest = min(200.0, 300.0 / max(float(np.abs(logs).max()), 1e-300))
    best = minimize_scalar(
        deviance, bounds=(-widest, widest), method="bounded", options={"xatol": 1e-9}
    )
    settled(best, "exponent of Box and Cox")
    center, limit = float(best.x), float(best.fun) + 3.841458820694124

    def bound(step: float) -> float:
        edge = center
        while deviance(edge) < limit:
            if edge * step > 0 and abs(edge) >= widest:
                return math.copysign(math.inf, step)
            edge = min(max(edge + step, -widest), widest)
        root: float = brentq(lambda e: deviance(e) - limit, center, edge)
        return root

    return BoxCoxResult(center, (bound(-0.5), bound(0.5)))


def _of_rows(out: AnalysisResult, fit: Factored) -> AnalysisSensitivity:
    """P of every term in the defensible analyses of rows without blocks; ordinary F: Type III."""
    data = out.data
    p: dict[str, Mapping[str, float | None]] = {"ordinary F": _ordinary(fit)}
    robust = {
        "HC3 Wald": hc3(fit),
        "Welch-James": welch_tests(data, data.y, out.terms),
    }
    p |= {how: {k: None if w is None else w.p for k, w in tests.items()}
          for how, tests in robust.items()}  # fmt: skip
    if data.y.min() > 0:
        p["F of the log"] = _ordinary(fitted(fit, np.log(data.y)))
    return _side_by_side(out, p)


def _side_by_side(
    out: AnalysisResult, probabilities: Mapping[str, Mapping[str, float | None]]
) -> AnalysisSensitivity:
    """Table of p, terms against analyses, and in how many each is below alpha."""
    terms, alpha, agreement = map(term_name, out.terms), out.request.alpha, {}
    p = {term: {method: ps.get(term) for method, ps in probabilities.items()} for term in terms}
    for term, row in p.items():
        values = [value for value in row.values() if value is not None]
        below = sum(value < alpha for value in values)
        agreement[term] = f"p < {alpha:g} in {below} of {len(values)} analyses"
    return AnalysisSensitivity(p, agreement)


def _ordinary(fit: Factored) -> dict[str, float | None]:
    rows = [term_row(s, fit.df_residual, fit.rss, fit.tss) for s in term_sums(fit, "III")]
    return {row.term: row.p for row in rows}


# Welch-James inverts matrices of the number of cells; beyond this it is no small table
_MOST_CELLS = 600


def _robustness(out: AnalysisResult) -> tuple[AnalysisSensitivity | None, BoxCoxResult | None]:
    """Table of defensible analyses and Box and Cox's exponent, where there is an error."""
    if out.fit is None or out.plots is not None or len(out.data.blocks) > 1:
        return None, None
    if out.crossed is not None:
        return _blocked(out, out.crossed), None
    if out.data.block is not None or out.replicates != "runs" or out.error_term.source != "E0":
        return None, None
    many = np.unique(out.data.cell).size > _MOST_CELLS
    if many or out.fit.rss <= 0 or not isinstance(out.fit, Factored):
        return None, None
    fit = out.fit if not out.request.scale.is_log else fitted(out.fit, out.data.y)
    power = box_cox(out.data.y, out.fit.matrix.columns) if out.data.y.min() > 0 else None
    return _of_rows(out, fit), power


def _blocked(out: AnalysisResult, table: Crossed) -> AnalysisSensitivity:
    """Own interactions (three corrections), interactions pooled, and the log of the response."""
    kind = out.anova.type
    model = factorize(model_matrix(table.layout, out.terms))
    tests = _tests(out, model, table, kind)
    p: dict[str, Mapping[str, float | None]] = {
        "own interaction, Greenhouse-Geisser": _p(tests, "gg"),
        "own interaction, Huynh-Feldt": _p(tests, "hf"),
        "interactions pooled": _additive(model, table.y, kind),
    }
    if not out.request.scale.is_log and table.y.min() > 0:
        logged = _tests(out, model, replace(table, y=np.log(table.y)), kind)
        p["own interaction of the log"] = _p(logged, "gg")
    return _side_by_side(out, p)


def _tests(out: AnalysisResult, model: Factorization, table: Crossed, kind: str) -> OwnTests:
    floor = max(out.working_tolerance(), ulp_floor(table.y))
    fit = fitted(model, table.y.mean(axis=1))
    return own_tests(table, fit, out.terms, kind, str(out.data.block), floor)


def _p(tests: OwnTests, how: str) -> dict[str, float | None]:
    from scipy.special import fdtrc

    p: dict[str, float | None] = {}
    for row in tests.rows.values():
        p[row.term] = row.p_gg
        sphere = tests.sphericity.get(row.term)
        if how == "hf" and row.f is not None and row.df_error is not None:
            epsilon = max(sphere.epsilon_hf, sphere.epsilon_gg) if sphere else 1.0
            p[row.term] = float(fdtrc(row.df * epsilon, row.df_error * epsilon, row.f))
    return p


def _additive(model: Factorization, y: Array, kind: str) -> dict[str, float | None]:
    """P of every term against all interactions with the blocks pooled."""
    cells, blocks = y.shape
    y = y - y[0, 0]
    fit = fitted(model, y.mean(axis=1))
    centered = y - y.mean(axis=1, keepdims=True) - y.mean(axis=0) + y.mean()
    df = (cells - 1) * (blocks - 1)
    sums = [replace(s, ss=blocks * s.ss) for s in term_sums(fit, kind)]
    rss = float(np.sum(centered**2))
    rows = [term_row(s, df, rss, blocks * fit.tss, partial=True) for s in sums]
    return {row.term: row.p for row in rows}
