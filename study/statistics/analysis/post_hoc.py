"""What is asked of a finished analysis: coefficients, comparisons of levels, named contrasts, rows.

The table of regression coefficients has the standard error that the error term gives. Factors have
sum-to-zero contrasts (Minitab's ``-1, 0, +1``): the coefficient of a level is how far its mean
lies from the mean of all, and the last level is minus the sum of the others.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress, product
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from study.ground.arrays import Array, Ints
from study.ground.contrast import Setting, sides_of
from study.ground.errors import Fault, InputError, nearest
from study.statistics.analysis.anova_table import Comparison, Contrast, Effect, Row
from study.statistics.analysis.comparisons import (
    Comparisons,
    block_multiplier,
    holm,
    studentized_range_cdf,
    t_quantile,
    two_sided,
)
from study.statistics.analysis.data import Crossed, Data
from study.statistics.analysis.effects import Gate, Scale, critical, group_errors, term_rows
from study.statistics.analysis.gate import cell_fit
from study.statistics.analysis.linear_model import (
    CellLayout,
    ModelMatrix,
    Term,
    nested_in,
    setting_rows,
    terms_of,
)
from study.statistics.analysis.simple_effects import (
    CANNOT_TELL,
    CLAIMS,
    NOT_RESOLVED,
    ONE_SPECIMEN,
    UNBOUNDED,
    Confidence,
    Differences,
    Estimates,
    verdict_of,
)
from study.statistics.analysis.sums_of_squares import EXACT, Factored

if TYPE_CHECKING:
    import pandas as pd

    from study.statistics.analysis.analysis_result import AnalysisResult


#: Columns beyond which a table of coefficients is not read; the QR of 200 columns takes 0.1 s.
MOST_COEFFICIENTS = 200


@dataclass(frozen=True)
class Coefficient:
    """One coefficient on the scale of the analysis."""

    #: ``Constant``, or the term with its level: ``material[2]``, ``A:B[a1 b2]``.
    term: str
    #: None where it cannot be given.
    estimate: float
    standard_error: float | None
    t: float | None
    p: float | None
    df: float
    #: Variance inflation factor; 1 where the columns are orthogonal.
    vif: float | None


def coefficient_table(analysis: AnalysisResult) -> tuple[Coefficient, ...] | str:
    """Give the coefficients of the model that an analysis fitted, or why there are none.

    With a pooled error they are those of least squares. Where effects are tested against their
    own interactions with the blocks, the model is fitted to each block alone, and a standard
    error is that of the mean of the blocks' coefficients: no sphericity is assumed.
    """
    tested = {row.error for row in analysis.anova.rows if row.f is not None}
    terms = terms_of(analysis.request.factors, analysis.request.model)
    if not tested:
        return "there is no error term to judge a coefficient by"
    if nested_in(terms):
        return "the levels of a nested factor have no contrasts of their own"
    levels = {effect.term: effect.levels for effect in analysis.effects}
    if any(len(levels.get(name, ())) < 2 for name in analysis.request.factors):
        return "a level of a factor has no row"
    names: tuple[str, ...] = ("Constant",)
    for term in terms:  # every level but the last ones
        every = product(*(levels[name][:-1] for name in term))
        names += tuple(f"{':'.join(term)}[{' '.join(combination)}]" for combination in every)
    if len(names) > MOST_COEFFICIENTS:
        return f"{len(names)} coefficients are more than anyone reads"
    block = analysis.data.block
    model = analysis.model
    one_error = analysis.summary is not None and all(":" not in str(e) for e in tested)
    if model is not None and one_error:
        return _pooled(model, analysis.anova.row("residual"), names)
    crossed = analysis.crossed
    if crossed is not None and all(str(error).startswith(f"{block}:") for error in tested):
        return _own(crossed, terms, names)
    return "the strata of the table have different errors"


def _pooled(fit: Factored, residual: Row, names: tuple[str, ...]) -> tuple[Coefficient, ...] | str:
    if not residual.ms:
        return "nothing is left over to estimate an error from"
    if not fit.is_full:
        return "some terms are aliased with others"
    beta, columns = fit.coefficients(), fit.columns
    beta[0] += fit.shift
    spread = np.diag(fit.unscaled_covariance)
    # blocks stand between the constant and the factors, and are no coefficients of interest
    of_factors = np.r_[0, columns.shape[1] - len(names) + 1 : columns.shape[1]]
    error = np.sqrt(spread * residual.ms)
    # variance over that without the other columns (Marquardt 1970)
    inflation = spread * np.sum((columns - columns.mean(axis=0)) ** 2, axis=0)
    return _table(names, beta[of_factors], error[of_factors], residual.df, inflation[of_factors])


def _own(
    table: Crossed, terms: tuple[Term, ...], names: tuple[str, ...]
) -> tuple[Coefficient, ...] | str:
    """Mean of the blocks' own coefficients, and its standard error."""
    fit = cell_fit(table, terms)
    if not fit.is_full:
        return "some terms are aliased with others"
    beta, blocks = fit.inverse @ (fit.q.T @ (table.y - fit.shift)), table.y.shape[1]
    beta[0] += fit.shift
    error = beta.std(axis=1, ddof=1) / np.sqrt(blocks)
    return _table(names, beta.mean(axis=1), error, blocks - 1.0, None)


def _table(
    names: tuple[str, ...], beta: Array, error: Array, df: float, inflation: Array | None
) -> tuple[Coefficient, ...]:
    rows = []
    for i, name in enumerate(names):
        se = float(error[i])
        has_error = np.isfinite(se) and se > 0
        t = float(beta[i]) / se if has_error else None
        p = None if t is None else two_sided(t, df)
        vif = None if inflation is None or i == 0 else float(inflation[i])
        rows.append(Coefficient(name, float(beta[i]), se if has_error else None, t, p, df, vif))
    return tuple(rows)


# -------------------------------------------------------------------------------------------------
# Levels of a factor against a reference with the error of the fitted model (Dunnett 1955).

#: Samples of the multivariate t: its quantile then repeats to about 0.1 %.
SAMPLES = 200_000
#: Samples drawn at a time: 20 levels of them take 8 MB.
CHUNK = 50_000


def _of_model(
    fit: Factored, ms: float, df: float, analysis: AnalysisResult, factor: str, reference: str
) -> Comparisons:
    """Compare the level means of a factor with one of them, by the error of the fitted model.

    Other factors and blocks are taken out of the error; the distribution of the largest absolute t
    is simulated.
    """
    request = analysis.request
    names, rows, *_ = term_rows(fit, (factor,))
    at = names.index(reference)
    differences = np.delete(rows, at, axis=0) - rows[at]
    if not fit.estimable(differences).all():
        rule = "compares levels that stand in the same cells, and some cells are empty"
        raise InputError(Fault("--reference", rule, "analyze the complete part of the table"))
    along = differences @ fit.inverse
    length = np.linalg.norm(along, axis=1)
    means, error = along @ fit.z, length * math.sqrt(ms)
    values, vectors = np.linalg.eigh(along @ along.T / np.outer(length, length))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(request.seed)
    parts = []
    for _ in range(SAMPLES // CHUNK):
        z = np.abs(rng.standard_normal((CHUNK, len(values))) @ root.T).max(axis=1)
        parts.append(z / np.sqrt(rng.chisquare(df, CHUNK) / df))
    largest = np.concatenate(parts)
    half = float(np.quantile(largest, 1 - request.alpha)) * error
    p = [(1 + int(np.sum(largest >= abs(t)))) / (largest.size + 1) for t in means / error]
    others = [name for name in names if name != reference]
    return _against(reference, others, means, half, p, "Dunnett", request.alpha)


def _against(
    reference: str,
    others: Sequence[str],
    means: Array,
    half: Array,
    p: Sequence[float],
    method: str,
    alpha: float,
) -> Comparisons:
    ends = zip(means.tolist(), (means - half).tolist(), (means + half).tolist(), strict=True)
    each = zip(others, ends, p, strict=True)
    pairs = tuple(Comparison(name, reference, *end, p=p_of) for name, end, p_of in each)
    return Comparisons(method, alpha, pairs, {})


#: smallest p that is told apart: one of the 4,000 draws of the multiplier
_LEAST_P = 1 / 4000
#: halvings of the level, to a thousandth of it
_STEPS = 14


def dunnett_over_groups(
    values: Mapping[str, Array],
    reference: str,
    groups: Sequence[Ints],
    method: str,
    confidence: Confidence,
) -> Comparisons:
    """Compare levels with one of them, each difference with an error of its own.

    A level's values (b,) add up to its mean over blocks, or over the rows of its cells; the scatter
    of each group of them (all blocks, or the rows of a cell) is its own. The differences depend
    on each other, which the simulated multiplier of the largest |t| counts.
    """
    names = [name for name in values if name != reference]
    parts = np.array([values[name] - values[reference] for name in names])
    error, df = group_errors(parts, groups)
    centre = parts.sum(axis=1)

    def half(level: float) -> Array:
        return block_multiplier(parts, groups, df, confidence._replace(alpha=level)) * error

    def p(i: int) -> float:
        """Level at which the simultaneous interval of one difference touches zero."""
        low, high = math.log(_LEAST_P), 0.0
        for _ in range(_STEPS if centre[i] else 0):
            middle = (low + high) / 2
            beyond = abs(centre[i]) > half(math.exp(middle))[i]
            low, high = (low, middle) if beyond else (middle, high)
        return math.exp(high)

    p_of_all = [p(i) for i in range(len(names))]
    alpha = confidence.alpha
    return _against(reference, names, centre, half(alpha), p_of_all, method, alpha)


# -------------------------------------------------------------------------------------------------
# All pairs of levels of every factor: difference, simultaneous interval, adjusted p.

TUKEY = "Tukey"
BONFERRONI = "Bonferroni"
HOTELLING = "Hotelling"
TWO_LEVELS = "t"


def pairwise(analysis: AnalysisResult) -> tuple[Comparison, ...]:
    """Give all pairwise comparisons of an analysis, factor after factor.

    With one pooled error they are Tukey's (Kramer's where unbalanced). Where effects are tested
    against their own interactions with the blocks, each difference has its own variance, and
    Bonferroni's or Hotelling's multiplier serves, whichever is smaller.
    """
    rows = {row.term: row for row in analysis.anova.rows}
    compared = []
    for effect, pair in ((e, pair) for e in analysis.effects if e.is_main for pair in e.pairs):
        method, p = _adjusted(effect, pair, rows.get(effect.term), analysis)
        compared.append(replace(pair, factor=effect.term, p=p, method=method, different=None))
    return tuple(compared)


def _adjusted(
    effect: Effect, pair: Comparison, row: Row | None, analysis: AnalysisResult
) -> tuple[str, float | None]:
    if row is None or row.error is None or row.df_error is None or row.df_error <= 0:
        return "", None
    from scipy.special import fdtrc

    k, alpha, df = len(effect.levels), analysis.request.alpha, row.df_error
    pairs = k * (k - 1) / 2
    if row.error == "residual":
        multiplier = critical(k, k - 1, df, alpha, main=True)
        method = TUKEY
    elif row.error == f"{analysis.data.block}:{effect.term}" and row.df:
        df = float(round(df / row.df))
        # its own variance over blocks: the multiplier that made the interval
        multiplier = critical(k, k - 1, df, alpha, by_block=True)
        method = BONFERRONI if multiplier >= t_quantile(alpha / (2 * pairs), df) else HOTELLING
    else:
        return "", None
    method = TWO_LEVELS if k == 2 else method
    size, half = pair.difference, (pair.upper - pair.lower) / 2
    if effect.is_ratio:  # on the scale of the analysis
        size, half = math.log(pair.difference), math.log(pair.upper / pair.lower) / 2
    if not (math.isfinite(half) and half > 0):
        return method, None
    t = abs(size) / half * multiplier
    if method == TUKEY:
        return method, max(0.0, 1 - studentized_range_cdf(t * math.sqrt(2), k, df))
    if method == HOTELLING:
        rest = df + 2 - k
        return method, float(fdtrc(k - 1, rest, t * t * rest / ((k - 1) * df)))
    return method, min(1.0, pairs * two_sided(t, df))


# -------------------------------------------------------------------------------------------------
# Rows that a fit describes badly or leans on: residuals, leverage, Cook's distance, PRESS.

#: Standardized residuals beyond this are listed, as in Minitab's "Fits and Diagnostics".
LARGE_RESIDUAL = 2.0
#: Leverage above this many times the average is listed, as in Minitab.
LARGE_LEVERAGE = 3.0


def diagnosed_rows(analysis: AnalysisResult) -> pd.DataFrame | None:
    """Every row with its standardized and PRESS residual; None where nothing was left over."""
    rows, fit = analysis.residuals, analysis.fit
    if fit is None or fit.df_residual < 1 or fit.rss <= 0:
        return None
    # a row that is fitted exactly leaves 0 / 0: it has no residual to judge
    left = np.where(fit.leverage < EXACT, 1 - fit.leverage, np.nan)
    standardized = fit.residual / math.sqrt(fit.rss / fit.df_residual) / np.sqrt(left)
    return rows.assign(row=rows["row"] + 1, standardized=standardized, press=fit.residual / left)


def unusual_observations(analysis: AnalysisResult) -> pd.DataFrame | None:
    """List the rows with a large residual, leverage or Cook's distance, the largest residual first.

    ``press`` is the residual of a row predicted from all others; ``why`` says what is large.
    """
    rows = diagnosed_rows(analysis)
    if rows is None:
        return None
    influence = analysis.assumptions.influence
    limit = None if influence is None else influence.limit
    largest_leverage = min(LARGE_LEVERAGE * float(rows["leverage"].mean()), 0.99)
    reasons = {
        "large residual": rows["standardized"].abs() > LARGE_RESIDUAL,
        "high leverage": rows["leverage"] > largest_leverage,
        "moves the fit": rows["cook"] > (math.inf if limit is None else limit),
    }
    why = [", ".join(compress(reasons, flags)) for flags in zip(*reasons.values(), strict=True)]
    columns = ("row", "response", "fitted", "residual", "standardized", "leverage", "cook", "press")
    listed = rows[list(columns)].assign(why=why)[np.array(list(map(bool, why)))]
    order = listed["standardized"].abs().sort_values(ascending=False, kind="stable").index
    return listed.loc[order].reset_index(drop=True)


# Levels of a factor compared with one of them, and differences that an analyst names.


def against_reference(analysis: AnalysisResult, level: str) -> tuple[str, Comparisons]:
    """Compare all levels of a factor with one of them (Dunnett 1955)."""
    named, _, level_name = level.rpartition("=")
    levels = {e.term: e.levels for e in analysis.effects if e.term in analysis.request.factors}
    holding = [f for f in levels if level_name in levels[f] and named in ("", f)]
    if len(holding) != 1:
        every = [name for its_levels in levels.values() for name in its_levels]
        rule = "is a level of several factors" if holding else "is no level of a factor"
        mend = f"write {holding[0]}={level_name}" if holding else nearest(level_name, every)
        raise InputError(Fault("--reference", f"{level_name!r} {rule}", mend))
    factor = holding[0]
    row = analysis.anova.row(factor)
    model = analysis.model
    if row.error == "residual" and model is not None:
        error = analysis.anova.row("residual")
        compared = _of_model(model, error.ms or 0.0, error.df, analysis, factor, level_name)
    else:
        compared = _of_rows(analysis, factor, level_name)
    return factor, compared.as_ratios() if analysis.request.scale.is_log else compared


def _of_rows(analysis: AnalysisResult, factor: str, reference: str) -> Comparisons:
    """Compare levels by their rows, or by their means in each block, on the analyzed scale."""
    confidence = Confidence(analysis.request.alpha, analysis.request.seed)
    rows = analysis.residuals
    if analysis.request.scale.is_log:
        rows = rows.assign(response=np.log(rows["response"]))
    if analysis.data.block is not None:
        means = rows.pivot_table("response", "block", factor, sort=False).dropna()
        if len(means) < 2:
            rule = "two blocks at least need a value at every level"
            raise InputError(Fault("blocks", rule, "leave incomplete levels out"))
        values = {str(name): means[name].to_numpy() / len(means) for name in means.columns}
        blocks = [np.arange(len(means))]
        return dunnett_over_groups(values, reference, blocks, "Dunnett over blocks", confidence)
    if analysis.request.error != "welch":
        model = analysis.model
        if model is not None and model.df_residual:  # of the means of a nested factor's levels
            ms = float(model.ols.mse_resid)
            return _of_model(model, ms, model.df_residual, analysis, factor, reference)
        rule = "needs two rows or more in some cell: nothing scatters"
        raise InputError(Fault("--reference", rule, "add rows, or leave it out"))
    cells = [np.asarray(at) for at in rows.groupby("cell", sort=False).indices.values()]
    level, y = rows[factor].astype(str).to_numpy(), rows["response"].to_numpy()
    share = np.zeros(len(rows))
    for cell in cells:  # a level is the mean of the means of its cells
        share[cell] = 1 / cell.size / sum(level[other[0]] == level[cell[0]] for other in cells)
    values = {name: (y - y[0]) * share * (level == name) for name in dict.fromkeys(level)}
    return dunnett_over_groups(values, reference, cells, "Dunnett by Welch", confidence)


# -------------------------------------------------------------------------------------------------
# Contrasts that the analyst names: one set of cells against another.
#
# "material=ogden-1, range=60 % - material=neo-hookean, range=60 %" is the mean over all cells of
# the first kind less that of the second; a factor that a side leaves out is averaged over.


HolmTest = TypeVar("HolmTest", Effect, Contrast)


def with_holm(tests: Sequence[HolmTest]) -> tuple[HolmTest, ...]:
    """Adjust the p of all that have one together (Holm 1979, Scand. J. Statist. 6, 65)."""
    adjusted = iter(holm([test.p for test in tests if test.p is not None]).tolist())
    return tuple(test if test.p is None else replace(test, p_holm=next(adjusted)) for test in tests)


def cells_with_rows(gate: Gate, data: Data) -> CellLayout:
    """Levels of the cells that hold rows, without levels that the analysis left out."""
    first = np.unique(data.cell, return_index=True)[1]
    levels = {name: gate.matrix.layout.levels[name] for name in data.factors}
    codes = {}
    for name, its_levels in levels.items():
        index = [its_levels.index(a) if a in its_levels else -1 for a in data.layout.levels[name]]
        codes[name] = np.array(index)[data.layout.codes[name][first]]
    cells = CellLayout(levels, codes)
    return cells.take(np.flatnonzero(np.all([code >= 0 for code in codes.values()], axis=0)))


def possible_contrasts(
    gate: Gate, data: Data, texts: Sequence[str]
) -> tuple[tuple[Contrast, ...], list[Fault]]:
    """Estimate those differences of sets of cells that can be, and say what keeps the others."""
    possible: list[_Sides] = []
    cells = cells_with_rows(gate, data)
    faults: list[Fault] = []
    for text in texts:
        try:
            possible.append(_sides(text, cells))
        except InputError as error:
            faults += error.faults
    if not possible:
        return (), faults
    estimates = gate.sample(_differences(gate.matrix, possible))
    lost = np.isnan(estimates.value)
    if lost.any():
        rule = "needs cells without rows"
        faults += [Fault(f"contrast {s.text!r}", rule) for s in compress(possible, lost)]
        if lost.all():
            return (), faults
        possible = list(compress(possible, ~lost))
        estimates = gate.sample(_differences(gate.matrix, possible))
    judged = _withdrawn(gate, possible, _judged(gate, possible, estimates))
    return with_holm(judged), faults


@dataclass(frozen=True)
class _Sides:
    """The cells of both sides of a contrast."""

    text: str
    settings: tuple[Setting, Setting]
    cells: tuple[CellLayout, CellLayout]
    #: Over which settings a factor is averaged where cells are empty.
    averaged: str
    #: Whether both sides name every factor.
    is_of_cells: bool

    def bound(self, scale: Scale) -> float | None:
        """Bound of the numerical error of the contrast, on the scale of the analysis."""
        return 0.0 if scale.bound is None else scale.bound.of(*map(dict, self.settings))


def _sides(text: str, cells: CellLayout) -> _Sides:
    """Find the cells of a contrast, each side averaged over settings that both of them have."""
    settings = sides_of(text, cells.levels)
    holds = [
        np.all([cells.codes[n] == cells.levels[n].index(a) for n, a in setting.items()], axis=0)
        for setting in settings
    ]
    for setting, side in zip(settings, holds, strict=True):
        if not side.any():
            named = ", ".join(f"{name}={level}" for name, level in setting.items())
            raise InputError(Fault(f"contrast {text!r}", f"no row has {named}"))
    others = [name for name in cells.levels if name not in settings[0]]
    averaged = ""
    if set(settings[0]) == set(settings[1]) and others:
        at = cells.cell(others)
        both = np.intersect1d(at[holds[0]], at[holds[1]])
        every = np.union1d(at[holds[0]], at[holds[1]]).size
        if not both.size:
            rule = f"its sides have no setting of {', '.join(others)} in common"
            raise InputError(Fault(f"contrast {text!r}", rule))
        if both.size < every:
            averaged = f"over the {both.size} of {every} settings of {', '.join(others)} with both"
            holds = [side & np.isin(at, both) for side in holds]
    first, second = (cells.take(np.flatnonzero(side)) for side in holds)
    is_of_cells = all(len(setting) == len(cells.levels) for setting in settings)
    return _Sides(text, settings, (first, second), averaged, is_of_cells)


def _differences(matrix: ModelMatrix, contrasted: Sequence[_Sides]) -> Differences:
    """Combine the coefficients of a model to the two means of each contrast."""
    settings = np.zeros((2 * len(contrasted), matrix.columns.shape[1]))
    for i, cells in enumerate(side for sides in contrasted for side in sides.cells):
        terms = [term for term in matrix.terms if set(term) <= cells.levels.keys()]
        settings[i] = setting_rows(matrix, cells.codes, terms).mean(axis=0)
    first = np.arange(0, len(settings), 2)
    return Differences(settings, first, first + 1)


def _judged(gate: Gate, contrasted: Sequence[_Sides], estimates: Estimates) -> list[Contrast]:
    """Judge contrasts by the printed analysis alone."""
    scale, listed = gate.scale, []
    verdicts = _verdicts(scale, contrasted, estimates)
    each = zip(contrasted, verdicts, estimates.intervals(), strict=True)
    for i, (sides, (verdict, why), (value, ci, wide)) in enumerate(each):
        u = sides.bound(scale)
        shown = None if u is None or scale.bound is None else u / scale.unit
        contrast = Contrast(
            sides.text, scale.back(value), None, None, None, None, shown, verdict, why
        )
        if estimates.error is not None:
            error, df = float(estimates.error[i]), None
            if estimates.df is not None:
                df = float(np.broadcast_to(estimates.df, estimates.value.shape)[i])
            contrast = replace(
                contrast,
                ci=scale.ends(ci),
                ci_simultaneous=scale.ends(wide),
                df=df,
                p=two_sided(value / error, df) if error and df is not None else None,
                why="; ".join(filter(None, (why, sides.averaged))),
            )
        listed.append(contrast)
    return listed


def _withdrawn(gate: Gate, contrasted: Sequence[_Sides], printed: list[Contrast]) -> list[Contrast]:
    """Withdraw claims that an analysis as defensible as the printed one does not make."""
    contrasts = [
        replace(c, verdict=CANNOT_TELL, why=gate.undecided)
        if gate.undecided and c.verdict in CLAIMS and not sides.is_of_cells
        else c
        for c, sides in zip(printed, contrasted, strict=True)
    ]
    for rival in gate.rivals:
        if not {c.verdict for c in contrasts} & set(CLAIMS) & set(rival.claims):
            continue
        scale = replace(gate.scale, practical=rival.practical or gate.scale.practical)
        estimates = rival.sample(_differences(rival.matrix or gate.matrix, contrasted))
        for i, (verdict, _) in enumerate(_verdicts(scale, contrasted, estimates)):
            if contrasts[i].verdict in rival.claims and contrasts[i].verdict != verdict:
                contrasts[i] = replace(contrasts[i], verdict=CANNOT_TELL, why=rival.why)
    if gate.condition:
        for i, c in enumerate(contrasts):
            if c.verdict in CLAIMS:
                why = "; ".join(filter(None, (c.why, gate.condition)))
                contrasts[i] = replace(c, why=why)
    return contrasts


def _verdicts(
    scale: Scale, contrasted: Sequence[_Sides], estimates: Estimates
) -> list[tuple[str, str]]:
    """Verdict of each contrast, and why it is none where the interval alone does not show that."""
    reasons = {
        "nothing scatters, so there is no interval": estimates.error is None,
        "no practical threshold was given": scale.practical is None,
        ONE_SPECIMEN: scale.specimens == 1,
    }
    if why := next(compress(reasons, reasons.values()), ""):
        return [(CANNOT_TELL, why)] * len(contrasted)
    verdicts = []
    for sides, (_, ci, wide) in zip(contrasted, estimates.intervals(), strict=True):
        u = sides.bound(scale)
        verdict, why = verdict_of(ci, wide, u, scale.practical), ""
        if verdict == NOT_RESOLVED and u is None:
            why = UNBOUNDED
        elif verdict in CLAIMS and scale.specimens == 2:
            why = "2 specimens"
        verdicts.append((verdict, why))
    return verdicts


def named_contrasts(
    analysis: AnalysisResult, texts: Sequence[str]
) -> tuple[tuple[Contrast, ...], list[Fault]]:
    """Differences that an analyst names, and what keeps others from being estimated."""
    if analysis.gate is None:
        rule = f"{analysis.request.response} is constant: there is nothing to compare"
        return (), [Fault(f"contrast {text!r}", rule) for text in texts]
    return possible_contrasts(analysis.gate, analysis.data, texts)


def with_contrasts(analysis: AnalysisResult, texts: Sequence[str]) -> AnalysisResult:
    """Give a result the differences that its design declares."""
    if not texts:
        return analysis
    together, faults = named_contrasts(analysis, texts)
    notes = [f"{fault.where}: {fault.rule}" for fault in faults]
    return replace(analysis, contrasts=together).warn(*notes)
