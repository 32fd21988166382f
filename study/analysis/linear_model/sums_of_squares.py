"""Sums of squares of Types I, II and III from one orthogonal factorization.

The response is shifted by its first value (exact for close doubles, Sterbenz's lemma), the
model is factored once (:mod:`study.analysis.linear_model.factorization`). Certified against the
NIST StRD sets.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from typing import ParamSpec, TypeVar

import numpy as np

from study.analysis.anova_table import Row
from study.analysis.linear_model.design_matrix import ModelMatrix, Term, term_name
from study.analysis.linear_model.factorization import Factorization, factorize
from study.arrays import Array, Flags
from study.noncentral_f import noncentral_f_cdf


@dataclass(frozen=True)
class Factored:
    """A least-squares problem after the orthogonal factorization of its model.

    Parameters
    ----------
    model : Factorization
        The model.
    z : ndarray, shape (r,)
        ``q.T @ (y - shift)``.
    fitted, residual : ndarray, shape (n,)
        Fit and residual in the units of y.
    rss, tss : float
        Residual and corrected total sums of squares.
    """

    model: Factorization
    z: Array
    fitted: Array
    residual: Array
    rss: float
    tss: float
    shift: float

    @property
    def matrix(self) -> ModelMatrix:
        """Columns of the model, with the term that each belongs to."""
        return self.model.matrix

    @property
    def q(self) -> Array:
        """Orthonormal columns that span the model, shape (n, r)."""
        return self.model.q

    @property
    def r(self) -> Array:
        """``columns / scale = q @ r``, shape (r, p)."""
        return self.model.r

    @property
    def rank(self) -> int:
        """Rank of the model."""
        return self.model.rank

    @property
    def df_residual(self) -> int:
        """Residual degrees of freedom."""
        return int(self.q.shape[0] - self.rank)

    @property
    def leverage(self) -> Array:
        """Leverage of every row: the diagonal of the hat matrix, shape (n,)."""
        return self.model.leverage

    @property
    def columns(self) -> Array:
        """Columns of the model, shape (n, p)."""
        return self.matrix.columns

    def projected(self, y: Array) -> Array:
        """Part of other values that the model describes, shape (n,)."""
        return np.asarray(self.q @ (self.q.T @ y))

    def coefficients(self) -> Array:
        """Minimum-norm coefficients of the shifted response, shape (p,)."""
        return np.asarray(self.model.inverse @ self.z)

    def unscaled_covariance(self) -> Array:
        """(X'X)^+, shape (p, p)."""
        return self.model.unscaled_covariance

    def estimable(self, rows: Array) -> Flags:
        """Whether each linear combination of coefficients can be estimated, shape (m,)."""
        return self.model.estimable(rows)


@dataclass(frozen=True)
class TermSum:
    """Sum of squares of one term, the space it lives in, and what is lost to aliasing."""

    term: Term
    df: int
    ss: float
    basis: Array
    nominal_df: int
    aliases: tuple[str, ...] = ()


def factor(matrix: ModelMatrix, y: Array) -> Factored:
    """Factor the model and fit the response.

    Parameters
    ----------
    matrix : ModelMatrix
        Columns of the model, shape (n, p).
    y : ndarray, shape (n,)
        Response on the working scale.
    """
    return fitted(factorize(matrix), y)


def fitted(model: Factorization, y: Array) -> Factored:
    """Fit a response with a model that is factored already.

    Parameters
    ----------
    model : Factorization
        Of a model of n rows.
    y : ndarray, shape (n,)
        Response on the working scale.
    """
    q = model.q
    shift = float(y[0])
    shifted = y - shift
    z = q.T @ shifted
    # a second projection removes what rounding left of the model in the residual
    residual = shifted - q @ z
    correction = q.T @ residual
    residual = residual - q @ correction
    z = z + correction
    centered = shifted - shifted.mean()
    return Factored(
        model,
        z,
        y - residual,
        residual,
        float(residual @ residual),
        float(centered @ centered),
        shift,
    )


def term_sums(fit: Factored, kind: str, skip: Sequence[Term] = ()) -> list[TermSum]:
    """Sum of squares of every term but the intercept and ``skip``.

    Parameters
    ----------
    fit : Factored
        The factored model.
    kind : {"I", "II", "III"}
        Given the terms before it; given every term that does not contain it; given all others.
    skip : sequence of Term, optional
        Terms that get no sum, though others are adjusted for them.
    """
    terms = fit.matrix.terms
    return [_term_sum(fit, i, kind) for i in range(1, len(terms)) if terms[i] not in skip]


def _term_sum(fit: Factored, i: int, kind: str) -> TermSum:
    space = fit.model.space(i, kind)
    part = space.basis.T @ fit.z
    return TermSum(
        fit.matrix.terms[i],
        space.basis.shape[1],
        float(part @ part),
        space.basis,
        space.nominal_df,
        space.aliases,
    )


# a residual this small beside the total is rounding, no error term
_ROUNDING = 1e-28


def term_row(
    s: TermSum, df: int, rss: float, total: float, error: str = "residual", *, partial: bool = False
) -> Row:
    """One line: a term against an error of ``df`` degrees of freedom and sum ``rss``.

    Parameters
    ----------
    s : TermSum
        Sum of squares of the term, and its degrees of freedom.
    df : int
        Degrees of freedom of the error; 0 for no test.
    rss, total : float
        Sum of squares of the error, and the corrected total one, as squares of the response.
    error : str
        Name of the row that holds the error.
    partial : bool
        Whether what is left of a term is tested where a part of it is aliased (Type I).

    Returns
    -------
    Row
        Without F where there is no error, or where a part of the term is aliased.
    """
    from scipy.special import fdtrc

    name = term_name(s.term)
    if s.df == 0:
        return Row(name, 0, 0.0)
    ms = s.ss / s.df
    if df == 0 or rss <= _ROUNDING * max(total, s.ss):
        return Row(name, s.df, s.ss, ms)
    if s.df < s.nominal_df and not partial:
        return Row(name, s.df, s.ss, ms, error=error, df_error=df)
    mse = rss / df
    f = ms / mse
    return Row(
        name,
        s.df,
        s.ss,
        ms,
        f,
        float(fdtrc(s.df, df, f)),
        error,
        df,
        None,
        None,
        max(0.0, (s.ss - s.df * mse) / (total + mse)),
        s.ss / (s.ss + rss),
    )


def with_shares(rows: Sequence[Row], total: float) -> tuple[Row, ...]:
    """Rows with their share of the variation and the interval of partial eta squared.

    Parameters
    ----------
    rows : sequence of Row
        Terms and errors of one table.
    total : float
        Corrected total sum of squares; shares are fractions of it, and None where it is zero.
    """
    done = []
    for row in rows:
        share = row.ss / total if total > 0 else None
        done.append(replace(row, share=share, partial_eta_sq_ci95=eta_interval(row)))
    return tuple(done)


def alias_warnings(sums: Sequence[TermSum], *, partial: bool = False) -> list[str]:
    """One sentence for every term that lost degrees of freedom, with what it is aliased.

    Parameters
    ----------
    sums : sequence of TermSum
        Every term of one model.
    partial : bool
        Whether what is left of each is tested; one sentence then serves all.
    """
    if partial:
        lost = [
            f"{term_name(s.term)} {s.df} of {s.nominal_df}" for s in sums if s.df < s.nominal_df
        ]
        what = "degrees of freedom that empty cells leave"
        return [f"{what}: {', '.join(lost)}"] if lost else []
    out = []
    for s in sums:
        if s.df < s.nominal_df:
            partly = f" (aliased with {', '.join(s.aliases)})" if s.aliases else ""
            out.append(
                f"{term_name(s.term)}: {s.nominal_df - s.df} of {s.nominal_df} degrees of "
                f"freedom are not estimable{partly}: empty cells or a confounded design; no test"
            )
    return out


P = ParamSpec("P")
R = TypeVar("R")


def one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Run ``function`` with one linear-algebra thread.

    On a busy machine the threads of a small product wait for each other (15 s instead of
    0.5 s for 10,000 rows), and the last digits of a sum would depend on their number.

    Parameters
    ----------
    function : callable
        With any arguments; its signature and its result stay the same.
    """

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1):
            return function(*args, **kwargs)

    return limited


def eta_interval(row: Row, level: float = 0.95) -> tuple[float, float] | None:
    """Interval of partial eta squared from the noncentral F (Smithson 2001).

    At the level 0.95 the noncentrality bounds lambda solve F(f; df1, df2, lambda) = 0.975 and
    0.025; eta = lambda / (lambda + df1 + df2 + 1).

    Parameters
    ----------
    row : Row
        One term of a table, with F and the degrees of freedom df1 of the term and df2 of the error.
    level : float
        Coverage of the interval, a probability.

    Returns
    -------
    tuple of float or None
        Lower and upper end; None without F, for an F of 0 or of 1e5 and more, or if no bound is
        found.
    """
    if row.f is None or row.df_error is None or not 0 < row.f < 1e5:
        return None
    total = row.df + row.df_error + 1
    bounds = []
    for q in ((1 + level) / 2, (1 - level) / 2):
        value = _noncentrality(row.f, row.df, row.df_error, q)
        if value is None:
            return None
        bounds.append(value / (value + total))
    return bounds[0], bounds[1]


def _noncentrality(f: float, df1: float, df2: float, q: float) -> float | None:
    from scipy.optimize import brentq

    def gap(value: float) -> float:
        return noncentral_f_cdf(df1, df2, value, f) - q

    if gap(1e-9) <= 0:
        return 0.0
    high = 10.0 + 2 * f * df1
    while gap(high) > 0:
        high *= 2
        if high > 1e8:
            return None
    value = float(brentq(gap, 1e-9, high, xtol=1e-9))
    return value if np.isfinite(value) else None
