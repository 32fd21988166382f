"""What single rows do to a fit: leverage, Cook distance, PRESS."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from study.analysis.anova_table import Influential, ModelSummary
from study.analysis.linear_model.sums_of_squares import Factored
from study.analysis.linear_model.two_way import TwoWayFit
from study.arrays import Array

if TYPE_CHECKING:
    from statsmodels.regression.linear_model import OLSResults


@dataclass(frozen=True)
class Influence:
    """Leverage, internally studentized residual, Cook's distance, PRESS residual of every row."""

    leverage: Array
    studentized: Array
    cook: Array
    press: Array


def influence(fit: Factored | TwoWayFit) -> Influence:
    """Leverage, studentized and PRESS residuals, and Cook's distance (Cook 1977) of a fit.

    Parameters
    ----------
    fit : Factored or TwoWayFit
        Fit of n rows.

    Returns
    -------
    Influence
        Arrays of shape (n,); infinite or NaN where a row has leverage 1 or no residual degree of
        freedom is left.
    """
    from statsmodels.stats.outliers_influence import OLSInfluence

    # a row of leverage one, or a saturated fit, has 0 / 0 here
    with np.errstate(divide="ignore", invalid="ignore"):
        if isinstance(fit, TwoWayFit):
            return _without_columns(fit)
        found = OLSInfluence(least_squares(fit))
        return Influence(
            found.hat_matrix_diag,
            found.resid_studentized_internal,
            found.cooks_distance[0],
            found.resid_press,
        )


def _without_columns(fit: TwoWayFit) -> Influence:
    """Influence from the leverage of every row: statsmodels asks for the columns themselves."""
    left = 1 - fit.leverage
    studentized = fit.residual / np.sqrt(fit.rss / np.float64(fit.df_residual) * left)
    cook = studentized**2 * fit.leverage / left / fit.rank
    return Influence(fit.leverage, studentized, cook, fit.residual / left)


def least_squares(fit: Factored, cov_type: str = "nonrobust") -> OLSResults:
    """Fit on its orthonormal columns, with the response less its reference value.

    The values of NIST's SmLs09 are 1e12 with a spread of 0.1: with the shift the largest Cook's
    distance has 14.9 digits, without it statsmodels leaves 0.5. The pseudo-inverse of
    orthonormal columns is their transpose, so nothing is factored again.

    Parameters
    ----------
    fit : Factored
        Fit with n rows and rank r.
    cov_type : str
        Covariance of the coefficients, as statsmodels names it: "nonrobust" or "HC3".

    Returns
    -------
    OLSResults
        Of statsmodels, with r coefficients: those of the orthonormal columns.
    """
    from statsmodels.regression.linear_model import OLS, OLSResults

    model = OLS(fit.q @ fit.z + fit.residual, fit.q, hasconst=False)
    model.pinv_wexog = fit.q.T
    model.df_model, model.df_resid = fit.rank, fit.df_residual
    return OLSResults(model, fit.z, np.eye(fit.rank), cov_type=cov_type, use_t=True)


def influential(fit: Factored | TwoWayFit) -> Influential | None:
    """Rows with a Cook's distance beyond the median of F(p, n - p) (Cook 1977, eq. 8).

    Parameters
    ----------
    fit : Factored or TwoWayFit
        Fit of rank p to n rows.

    Returns
    -------
    Influential or None
        None without residual degrees of freedom, or where the residuals are zero.
    """
    from scipy.special import fdtri

    if fit.df_residual < 1 or fit.rss <= 0:
        return None
    found = influence(fit)
    known = np.isfinite(found.cook) & (found.leverage < 1 - 1e-10)
    limit = float(fdtri(fit.rank, fit.df_residual, 0.5))
    rows = np.flatnonzero(known & (np.where(known, found.cook, 0.0) > limit))
    largest = float(found.cook[known].max()) if known.any() else None
    return Influential(float(found.leverage.max()), largest, limit, tuple(int(i) + 1 for i in rows))


def summary_of(fit: Factored) -> ModelSummary | None:
    """S, R-sq, R-sq(adj) and R-sq(pred) of a fit; None where nothing is left to judge by.

    R-sq(pred) is 1 - PRESS / total (Allen 1974); it needs every row to be predictable from
    the others.

    Parameters
    ----------
    fit : Factored
        On the working scale; S is in its unit, and R-sq are fractions.
    """
    df, n = fit.df_residual, fit.q.shape[0]
    if df == 0 or fit.tss <= 0:
        return None
    predictable = float(fit.leverage.max()) < 1 - 1e-10
    press = float(np.sum(influence(fit).press ** 2)) if predictable else None
    return ModelSummary(
        float(np.sqrt(fit.rss / df)),
        1 - fit.rss / fit.tss,
        1 - fit.rss / df / (fit.tss / (n - 1)),
        None if press is None else 1 - press / fit.tss,
    )
