"""Wald test that fits to different data estimate the same constants, and its power.

Cochran's (1954, Biometrics 10, 101) weighted distances from a common estimate are chi-square
where the error variances are known. They are estimated, each from the residuals of its own fit,
so the statistic over its degrees of freedom is compared with F, whose denominator follows from
those of the fits (Fai and Cornelius 1996, J. Stat. Comput. Simul. 54, 363).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.calibration.fit import Fit
from study.errors import Fault, InputError, RefusedError

#: significance of the test
ALPHA = 0.05

#: power that a test should have against a difference that matters (Cohen 1988)
USUAL_POWER = 0.80

#: denominator from which F is a chi-square in every digit that is shown
_MANY = 1e5

#: noncentrality beyond which power is 1 (scipy's ncfdtr is NaN at some between 1400 and 2000)
_LARGE = 1e3


@dataclass(frozen=True)
class Agreement:
    """Test of the hypothesis that all fits estimate the same constants.

    Parameters
    ----------
    common : ndarray, shape (p,)
        Common estimate, weighted by the inverse covariances, MPa (exponents plain).
    covariance : ndarray, shape (p, p)
        Of the common estimate.
    statistic : float
        Sum of the weighted squared distances from it (Wald's statistic).
    df : int
        Degrees of freedom, p (k - 1).
    df_error : float
        Denominator degrees of freedom; infinite where the covariances are known.
    p : float
        Of F = statistic / df.
    p_chi_square : float
        Of the statistic as a chi-square: what is usual, and too small for few points.
    inverse_covariances : tuple of ndarray, shape (p, p)
        Weights of the fits.
    """

    common: Array
    covariance: Array
    statistic: float
    df: int
    df_error: float
    p: float
    p_chi_square: float
    inverse_covariances: tuple[Array, ...]

    def power(self, differences: Array) -> float:
        """Probability that the test rejects where the fits differ by this much.

        Parameters
        ----------
        differences : ndarray, shape (k, p)
            True constants of every fit less any common ones, MPa (exponents plain).
        """
        distances, _ = _distances(differences, self.inverse_covariances)
        return _power(_sum(distances, self.inverse_covariances), self.df, self.df_error)

    def detectable(self, differences: Array) -> float:
        """Multiple of these differences that is seen with a power of 80 %.

        Parameters
        ----------
        differences : ndarray, shape (k, p)
            As for :meth:`power`.

        Returns
        -------
        float
            Infinite where the differences change nothing, or the test has no such power.
        """
        from scipy.optimize import brentq

        distances, _ = _distances(differences, self.inverse_covariances)
        unit = _sum(distances, self.inverse_covariances)
        if unit <= 0 or _power(_LARGE, self.df, self.df_error) < USUAL_POWER:
            return float("inf")

        def short(noncentrality: float) -> float:
            return _power(noncentrality, self.df, self.df_error) - USUAL_POWER

        return float(np.sqrt(brentq(short, 0.0, _LARGE, xtol=1e-9) / unit))


def agreement(fits: Sequence[Fit], extra: Sequence[Array] = ()) -> Agreement:
    """Test whether fits to different data give the same constants.

    Parameters
    ----------
    fits : sequence of Fit
        Independent, converged, with the same constants.
    extra : sequence of ndarray, shape (p, p), optional
        Covariance that each fit has besides, for instance of the mesh's error; taken as known.

    Returns
    -------
    Agreement
        The test, and what gives its power.

    Raises
    ------
    InputError
        If there are no two fits of the same constants.
    RefusedError
        If a fit has no covariance, so that nothing can be compared.
    """
    from scipy.special import chdtrc

    _comparable(fits)
    own = [fit.covariance for fit in fits]
    total = [c + more for c, more in zip(own, extra, strict=True)] if len(extra) else own
    weights = tuple(_inverse(c) for c in total)
    distances, common = _distances(np.array([fit.values for fit in fits]), weights)
    statistic = _sum(distances, weights)
    df = len(fits[0].names) * (len(fits) - 1)
    df_error = _denominator(total, own, [fit.n - len(fit.names) for fit in fits])
    return Agreement(
        common=common,
        covariance=_inverse(np.sum(weights, axis=0)),
        statistic=statistic,
        df=df,
        df_error=df_error,
        p=_above(statistic / df, df, df_error),
        p_chi_square=float(chdtrc(df, statistic)),
        inverse_covariances=weights,
    )


def _comparable(fits: Sequence[Fit]) -> None:
    if len(fits) < 2 or any(fit.names != fits[0].names for fit in fits):
        mend = "give two or more tests of one material"
        raise InputError(Fault("agreement", "needs two or more fits of the same constants", mend))
    if not all(fit.converged and np.all(np.isfinite(fit.covariance)) for fit in fits):
        raise RefusedError(
            "a fit without a covariance cannot be compared with others: "
            "give more points, or an energy with fewer constants"
        )
    if not all(np.all(np.diag(fit.covariance) > 0) for fit in fits):
        raise RefusedError(
            "a constant that ended at a bound has no standard error to compare by: "
            "widen the bounds, or take an energy with fewer constants"
        )


def _inverse(matrix: Array) -> Array:
    """Inverse of a covariance, scaled: moduli and exponents differ by orders of magnitude."""
    scale = np.sqrt(np.diag(matrix))
    outer = np.outer(scale, scale)
    return np.asarray(np.linalg.inv(matrix / outer) / outer)


def _distances(values: Array, weights: Sequence[Array]) -> tuple[Array, Array]:
    """Distances of the rows of ``values`` from their weighted mean, and the mean."""
    total = np.sum(weights, axis=0)
    scale = 1 / np.sqrt(np.diag(total))
    right = sum(w @ v for w, v in zip(weights, values, strict=True)) * scale
    common = scale * np.linalg.solve(total * np.outer(scale, scale), right)
    return values - common, common


def _sum(distances: Array, weights: Sequence[Array]) -> float:
    return float(sum(d @ w @ d for d, w in zip(distances, weights, strict=True)))


def _denominator(total: Sequence[Array], own: Sequence[Array], df: Sequence[int]) -> float:
    """Degrees of freedom of F's denominator, of the contrasts to the last fit.

    The contrasts are turned so that they are uncorrelated; each has Satterthwaite's degrees of
    freedom nu, and F those with the same mean: E = sum nu / (nu - 2),
    2 E / (E - q), with E - q = sum 2 / (nu - 2).
    """
    k, p = len(total), total[0].shape[0]
    scale = np.sqrt(np.min([np.diag(c) for c in total], axis=0))
    contrast = np.kron(np.hstack([np.eye(k - 1), -np.ones((k - 1, 1))]), np.eye(p))
    parts = contrast.reshape(-1, k, p)

    def variance(i: int, matrix: Array) -> Array:
        return np.asarray(parts[:, i] @ (matrix / np.outer(scale, scale)) @ parts[:, i].T)

    d, turn = np.linalg.eigh(sum(variance(i, c) for i, c in enumerate(total)))
    spread = sum(
        np.diag(turn.T @ variance(i, c) @ turn) ** 2 / f
        for i, (c, f) in enumerate(zip(own, df, strict=True))
    )
    nu = d**2 / spread
    if np.any(nu <= 2):
        return float(nu.min())
    # E - q, without the difference of nearly equal numbers
    found = np.sum(nu / (nu - 2)) / np.sum(1 / (nu - 2))
    return float(min(found, _MANY))


def _above(f: float, df: int, df_error: float) -> float:
    from scipy.special import fdtrc

    return float(fdtrc(df, df_error, f))


def _power(noncentrality: float, df: int, df_error: float) -> float:
    from scipy.special import fdtri, ncfdtr

    if noncentrality <= 0:
        return ALPHA
    limit = float(fdtri(df, df_error, 1 - ALPHA))
    return 1 - float(ncfdtr(df, df_error, min(noncentrality, _LARGE), limit))
