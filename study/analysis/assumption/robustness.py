"""When spreads differ or residuals are skewed: Box-Cox, HC3, Welch-James, side by side."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from study.analysis.anova_table import BoxCoxResult, Sensitivity, WaldTest
from study.analysis.data import Crossed, Data, prepare
from study.analysis.error.blocked import OwnTerm, own_terms
from study.analysis.linear_model.design_matrix import (
    Model,
    Term,
    model_matrix,
    term_name,
    terms_of,
)
from study.analysis.linear_model.factorization import Factorization, factorize, span
from study.analysis.linear_model.influence import least_squares
from study.analysis.linear_model.sums_of_squares import Factored, TermSum, factor, fitted, term_sums
from study.analysis.outcome import Outcome
from study.analysis.pseudoreplication import ulp_floor
from study.arrays import Array
from study.errors import Fault, InputError

if TYPE_CHECKING:
    import pandas as pd
    from statsmodels.regression.linear_model import OLSResults


def hc3(fit: Factored) -> dict[str, WaldTest]:
    """Wald tests with the HC3 covariance (MacKinnon and White 1985), sum-to-zero contrasts.

    Parameters
    ----------
    fit : Factored
        Fit of the rows on the working scale.

    Returns
    -------
    dict of str to WaldTest
        By term; F with the degrees of freedom of the term and of the residual, or the reason why
        there is none.
    """
    if fit.df_residual < 1 or float(fit.leverage.max()) > 1 - 1e-10:
        return {
            term_name(t): WaldTest(term_name(t), None, None, None, "a row has leverage one")
            for t in fit.matrix.terms[1:]
        }
    robust = least_squares(fit, "HC3")
    return {term_name(s.term): _wald(robust, s, fit.df_residual) for s in term_sums(fit, "III")}


def _wald(robust: OLSResults, term: TermSum, df_residual: int) -> WaldTest:
    """F test that the coefficients of the fit are zero along the directions of one term."""
    from statsmodels.tools.sm_exceptions import ValueWarning

    name = term_name(term.term)
    if term.df < term.nominal_df:
        return WaldTest(name, None, None, None, "not estimable")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ValueWarning)
        test = robust.f_test(term.basis.T)
    if test.df_num < term.df:
        # statsmodels would go on with fewer constraints, which is the test of another hypothesis
        return WaldTest(name, None, None, None, "cells without spread: a singular covariance")
    df = (float(term.df), float(df_residual))
    return WaldTest(name, float(test.fvalue), df, float(test.pvalue))


def welch_james(cells: Sequence[Array], contrast: Array, name: str = "") -> WaldTest:
    """Welch-James test of a contrast of cell means (Johansen 1980, Biometrika 67, 85-92).

    Parameters
    ----------
    cells : sequence of ndarray
        Values of each cell, two or more.
    contrast : ndarray, shape (d, cells)
        Rows of the hypothesis.
    name : str
        Name of the term in the result.
    """
    return _johansen(_Moments.of(cells), contrast, name)


# Condition number beyond which the inverse of a covariance has no digit left (1 / 1e-16, less 2).
_WORST_CONDITION = 1e14


@dataclass(frozen=True)
class _Moments:
    """Size, mean (shifted) and variance of every cell."""

    n: Array
    mean: Array
    variance: Array

    @staticmethod
    def of(cells: Sequence[Array]) -> _Moments:
        shift = cells[0][0]
        return _Moments(
            np.array([c.size for c in cells], dtype=float),
            np.array([np.mean(c - shift) for c in cells]),
            np.array([np.var(c - c[0], ddof=1) if c.size > 1 else 0.0 for c in cells]),
        )


def _johansen(cells: _Moments, contrast: Array, name: str) -> WaldTest:
    from scipy.special import fdtrc

    n = cells.n
    if n.min() < 2 or cells.variance.min() <= 0:
        return WaldTest(name, None, None, None, "a cell has one value or zero variance")
    s = cells.variance / n
    covariance = (contrast * s) @ contrast.T
    if np.linalg.cond(covariance) > _WORST_CONDITION:
        return WaldTest(name, None, None, None, "the variances of the cells differ too much")
    inner = np.linalg.inv(covariance)
    effect = contrast @ cells.mean
    t = float(effect @ inner @ effect)
    weight = np.einsum("jk,jk->k", contrast, inner @ contrast) * s
    # tr(Q_j^2) = tr(Q_j)^2 because each cell enters with one variance
    a = float(np.sum(2 * weight**2 / (n - 1))) / 2
    d = contrast.shape[0]
    scale = d + 2 * a - 6 * a / (d + 2)
    df = (float(d), d * (d + 2) / (3 * a))
    f = t / scale
    return WaldTest(name, f, df, float(fdtrc(*df, f)))


def welch_factorial(
    table: pd.DataFrame, response: str, factors: Sequence[str], model: Model = "full"
) -> dict[str, WaldTest]:
    """Welch-James test of every term of a factorial with unequal cell variances.

    Parameters
    ----------
    table : DataFrame
        One row a run; every cell needs two rows or more.
    response : str
        Column of the response, which is not transformed.
    factors : sequence of str
        Columns of the factors.
    model : "full", int or sequence
        Terms; see :func:`study.analysis.linear_model.design_matrix.terms_of`.

    Returns
    -------
    dict of str to WaldTest
        By term; the reason where it has no test.
    """
    data = prepare(table, response, factors)
    return _welch(data, terms_of(data.factors, model))


def _welch(data: Data, terms: Sequence[Term]) -> dict[str, WaldTest]:
    present, index = np.unique(data.cell, return_inverse=True)
    moments = _Moments.of([data.y[index == i] for i in range(present.size)])
    first = np.array([int(np.flatnonzero(index == i)[0]) for i in range(present.size)])
    layout = data.layout.take(first)
    matrix = model_matrix(layout, terms)
    fit = factor(matrix, np.arange(float(present.size)))
    out = {}
    for s in term_sums(fit, "III"):
        name = term_name(s.term)
        if s.df < s.nominal_df:
            out[name] = WaldTest(name, None, None, None, "not estimable")
        else:
            out[name] = _johansen(moments, (fit.q @ s.basis).T, name)
    return out


def box_cox(y: Array, matrix: Array) -> BoxCoxResult:
    """Profile likelihood of the Box-Cox exponent in a linear model (Box and Cox 1964).

    Parameters
    ----------
    y : ndarray, shape (n,)
        Response before any transformation.
    matrix : ndarray, shape (n, p)
        Columns of the model, which may depend on each other.

    Raises
    ------
    InputError
        If the response is not positive or leaves no residual.
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
    center, limit = float(best.x), float(best.fun) + 3.841458820694124

    def bound(step: float) -> float:
        edge = min(max(center + step, -widest), widest)
        while deviance(edge) < limit and abs(edge + step) < widest:
            edge += step
        if deviance(edge) < limit:
            return edge
        root: float = brentq(lambda e: deviance(e) - limit, center, edge)
        return root

    return BoxCoxResult(center, (bound(-0.5), bound(0.5)))


def sensitivity(
    table: pd.DataFrame,
    response: str,
    factors: Sequence[str],
    *,
    model: Model = "full",
    alpha: float = 0.05,
) -> Sensitivity:
    """P of every term in the defensible analyses of a replicated factorial.

    Ordinary F (Type III), HC3 Wald, Welch-James, and the F of the log response where it is
    positive.

    Parameters
    ----------
    table : DataFrame
        One row a run, without blocks.
    response : str
        Column of the response.
    factors : sequence of str
        Columns of the factors.
    model : "full", int or sequence
        Terms; see :func:`study.analysis.linear_model.design_matrix.terms_of`.
    alpha : float
        Size of the tests, a probability.
    """
    data = prepare(table, response, factors)
    terms = terms_of(data.factors, model)
    return sensitivity_of(data, terms, factor(model_matrix(data.layout, terms), data.y), alpha)


def sensitivity_of(data: Data, terms: Sequence[Term], fit: Factored, alpha: float) -> Sensitivity:
    """As :func:`sensitivity`, of checked data without blocks and the fit of their response.

    Parameters
    ----------
    data : Data
        Checked rows, n of them; several in a cell.
    terms : sequence of Term
        Terms of the model, without the intercept.
    fit : Factored
        Fit of the terms to the response before any transformation.
    alpha : float
        Size of the tests, a probability.
    """
    found: dict[str, Mapping[str, float | None]] = {
        "ordinary F": _ordinary(fit),
        "HC3 Wald": {k: w.p for k, w in hc3(fit).items()},
        "Welch-James": {k: w.p for k, w in _welch(data, terms).items()},
    }
    if data.y.min() > 0:
        found["F of the log"] = _ordinary(fitted(fit.model, np.log(data.y)))
    return side_by_side([term_name(t) for t in terms], found, alpha)


def side_by_side(
    terms: Sequence[str], found: Mapping[str, Mapping[str, float | None]], alpha: float
) -> Sensitivity:
    """Table of p, terms against analyses, and in how many each is below alpha.

    Parameters
    ----------
    terms : sequence of str
        Names of the terms.
    found : mapping of str to mapping
        By analysis, the p of each term; None where there is none, which does not count.
    alpha : float
        Size of the tests, a probability.
    """
    p = {term: {method: ps.get(term) for method, ps in found.items()} for term in terms}
    return Sensitivity(p, {term: _agreement(row, alpha) for term, row in p.items()})


def _ordinary(fit: Factored) -> dict[str, float | None]:
    from scipy.special import fdtrc

    df = fit.df_residual
    out: dict[str, float | None] = {}
    for s in term_sums(fit, "III"):
        usable = df > 0 and s.df == s.nominal_df and fit.rss > 0
        f = s.ss / s.df / (fit.rss / df) if usable else 0.0
        out[term_name(s.term)] = float(fdtrc(s.df, df, f)) if usable else None
    return out


def _agreement(found: Mapping[str, float | None], alpha: float) -> str:
    known = [p for p in found.values() if p is not None]
    return f"p < {alpha:g} in {sum(p < alpha for p in known)} of {len(known)} analyses"


# Welch-James inverts matrices of the number of cells; beyond this it is no small table
_MOST_CELLS = 600


def add_robustness(out: Outcome) -> Outcome:
    """Outcome with Box-Cox and the table of defensible analyses, where there is an error.

    Parameters
    ----------
    out : Outcome
        With its fit; returned as it is for split plots, crossing blocks, errors other than E0 or
        own interactions, and more than 600 cells without blocks.
    """
    if out.fit is None or out.plots is not None or out.data.also:
        return out
    if out.crossed is not None:
        return replace(out, robustness=_blocked(out, out.crossed))
    if out.data.block is not None or out.replicates != "runs" or out.error.source != "E0":
        return out
    if np.unique(out.data.cell).size > _MOST_CELLS or out.fit.rss <= 0:
        return out
    if not isinstance(out.fit, Factored):
        return out
    fit = out.fit if not out.request.scale.is_log else fitted(out.fit.model, out.data.y)
    table = sensitivity_of(out.data, out.terms, fit, out.request.alpha)
    if out.data.y.min() <= 0:
        return replace(out, robustness=table)
    return replace(out, robustness=table, box_cox=box_cox(out.data.y, out.fit.matrix.columns))


def _blocked(out: Outcome, table: Crossed) -> Sensitivity:
    """Own interactions (three corrections), interactions pooled, and the log of the response."""
    kind = out.anova.type
    model = out.cell_model or factorize(model_matrix(table.layout, out.terms))
    tests = _tests(out, model, table, kind)
    found: dict[str, Mapping[str, float | None]] = {
        "own interaction, Greenhouse-Geisser": _p(tests, "gg"),
        "own interaction, Huynh-Feldt": _p(tests, "hf"),
        "interactions pooled": _additive(model, table.y, kind),
    }
    if not out.request.scale.is_log and table.y.min() > 0:
        logged = _tests(out, model, replace(table, y=np.log(table.y)), kind)
        found["own interaction of the log"] = _p(logged, "gg")
    return side_by_side([term_name(t) for t in out.terms], found, out.request.alpha)


def _tests(out: Outcome, model: Factorization, table: Crossed, kind: str) -> list[OwnTerm]:
    y = table.y
    floor = max(out.working_tolerance(), ulp_floor(y))
    total = float(np.sum((y - y[0, 0] - (y - y[0, 0]).mean()) ** 2))
    fit = fitted(model, y.mean(axis=1))
    return own_terms(table, fit, kind, str(out.data.block), floor, total)


def _p(tests: Sequence[OwnTerm], how: str) -> dict[str, float | None]:
    from scipy.special import fdtrc

    found: dict[str, float | None] = {}
    for test in tests:
        row = test.row
        found[row.term] = row.p_gg
        if how == "hf" and row.f is not None and row.df_error is not None:
            epsilon = max(test.sphericity.epsilon_hf, test.sphericity.epsilon_gg)
            found[row.term] = float(fdtrc(row.df * epsilon, row.df_error * epsilon, row.f))
    return found


def _additive(model: Factorization, y: Array, kind: str) -> dict[str, float | None]:
    """P of every term against all interactions with the blocks pooled."""
    from scipy.special import fdtrc

    cells, blocks = y.shape
    y = y - y[0, 0]
    fit = fitted(model, y.mean(axis=1))
    centered = y - y.mean(axis=1, keepdims=True) - y.mean(axis=0) + y.mean()
    df = (cells - 1) * (blocks - 1)
    mse = float(np.sum(centered**2)) / df
    found: dict[str, float | None] = {}
    for s in term_sums(fit, kind):
        usable = s.df > 0 and mse > 0
        f = blocks * s.ss / s.df / mse if usable else 0.0
        found[term_name(s.term)] = float(fdtrc(s.df, df, f)) if usable else None
    return found
