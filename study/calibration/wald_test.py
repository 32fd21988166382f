"""Wald test that fits to different data estimate the same constants, and its power.

Cochran's (1954, Biometrics 10, 101) weighted distances from a common estimate are chi-square
where the error variances are known. They are estimated, each from the residuals of its own fit,
so the statistic over its degrees of freedom is compared with F, whose denominator follows from
those of the fits (Fai and Cornelius 1996, J. Stat. Comput. Simul. 54, 363). How strongly the rows
of a test are correlated is not known either: p is averaged over what each test allows. One
covariance that is an average of its own gave p above .5 for three tests of 15 points whose rows
were independent, 600 times in 600.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.calibration.fit import Fit
from study.calibration.serial_correlation import Mixture
from study.errors import Fault, InputError, RefusedError
from study.noncentral_f import noncentral_f_cdf

#: significance of the test
ALPHA = 0.05

#: power that a test should have against a difference that matters (Cohen 1988)
USUAL_POWER = 0.80

#: correlations of its rows that are drawn for each fit
DRAWS = 4000

#: denominator from which F is a chi-square in every digit that is shown
_MANY = 1e5

#: noncentrality beyond which power is 1
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
        Sum of the weighted squared distances from it (Wald's statistic), by the mean weights.
    df : int
        Degrees of freedom, p (k - 1).
    df_error : float
        Denominator degrees of freedom, the median over correlations; infinite where the covariances
        are known.
    p : float
        Of F = statistic / df, averaged over the correlations of rows that each fit allows.
    p_chi_square : float
        The same of a chi-square: what is usual, and too small for few points.
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
        return _power(self._noncentrality(differences), self.df, self.df_error)

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

        unit = self._noncentrality(differences)
        if unit <= 0 or _power(_LARGE, self.df, self.df_error) < USUAL_POWER:
            return float("inf")

        def short(noncentrality: float) -> float:
            return _power(noncentrality, self.df, self.df_error) - USUAL_POWER

        return float(np.sqrt(brentq(short, 0.0, _LARGE, xtol=1e-9) / unit))

    def _noncentrality(self, differences: Array) -> float:
        weights = np.array(self.inverse_covariances)[:, None]
        return float(_sum(_distances(differences, weights)[0], weights)[0])


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
    from scipy.special import chdtrc, fdtrc

    _comparable(fits)
    values = np.array([fit.values for fit in fits])
    total, own = _drawn(fits, extra)
    inverses = _inverse(total)
    statistics = _sum(_distances(values, inverses)[0], inverses)
    df = len(fits[0].names) * (len(fits) - 1)
    freedom = [fit.n - len(fit.names) for fit in fits]
    weights = inverses.mean(axis=1)
    distances, common = _distances(values, weights[:, None])
    df_error = _denominator(total, own, freedom)
    return Agreement(
        common=common[0],
        covariance=_inverse(weights.sum(axis=0)),
        statistic=float(_sum(distances, weights[:, None])[0]),
        df=df,
        df_error=float(np.median(df_error)),
        p=float(fdtrc(df, df_error, statistics / df).mean()),
        p_chi_square=float(chdtrc(df, statistics).mean()),
        inverse_covariances=tuple(weights),
    )


def _drawn(fits: Sequence[Fit], extra: Sequence[Array]) -> tuple[Array, Array]:
    """Covariances of every fit at drawn correlations of its rows, shape (k, m, p, p), and its own.

    How strongly neighboring rows are correlated is not known, and not the same in every test.
    Each fit's correlations are as often here as they are likely, in an order of their own.
    """
    mixtures = [None if fit.serial is None else fit.serial.mixture for fit in fits]
    lengths = [1 if one is None else one.weight.size for one in mixtures]
    count, random = 1 if max(lengths) == 1 else DRAWS, np.random.default_rng(2011)
    places = (np.arange(count) + 0.5) / count
    total, own = [], []
    for i, (fit, mixture) in enumerate(zip(fits, mixtures, strict=True)):
        more = extra[i] if len(extra) else np.zeros_like(fit.covariance)
        known = mixture or Mixture(np.ones(1), fit.covariance[None], fit.covariance[None])
        drawn = random.permutation(np.searchsorted(np.cumsum(known.weight), places))
        drawn = np.minimum(drawn, known.weight.size - 1)
        total.append(known.covariance[drawn] + more)
        own.append(known.from_rows[drawn])
    return np.array(total), np.array(own)


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
    """Inverse of covariances, scaled: moduli and exponents differ by orders of magnitude."""
    scale = np.sqrt(np.diagonal(matrix, axis1=-2, axis2=-1))
    outer = scale[..., :, None] * scale[..., None, :]
    return np.asarray(np.linalg.inv(matrix / outer) / outer)


def _distances(values: Array, weights: Array) -> tuple[Array, Array]:
    """Distances of the rows of ``values`` from their weighted mean, and the mean.

    Parameters
    ----------
    values : ndarray, shape (k, p)
    weights : ndarray, shape (k, m, p, p)

    Returns
    -------
    distances, common : ndarray, shapes (k, m, p), (m, p)
    """
    total = weights.sum(axis=0)
    scale = 1 / np.sqrt(np.diagonal(total, axis1=-2, axis2=-1))
    right = np.einsum("kmij,kj->mi", weights, values) * scale
    scaled = total * scale[..., :, None] * scale[..., None, :]
    common = scale * np.linalg.solve(scaled, right[..., None])[..., 0]
    return values[:, None] - common, common


def _sum(distances: Array, weights: Array) -> Array:
    return np.asarray(np.einsum("kmi,kmij,kmj->m", distances, weights, distances))


def _denominator(total: Array, own: Array, df: Sequence[int]) -> Array:
    """Degrees of freedom of F's denominator, of the contrasts to the last fit, shape (m,).

    The contrasts are turned so that they are uncorrelated; each has Satterthwaite's degrees of
    freedom nu, and F those with the same mean: E = sum nu / (nu - 2),
    2 E / (E - q), with E - q = sum 2 / (nu - 2).

    Parameters
    ----------
    total, own : ndarray, shape (k, m, p, p)
        Covariances, and the part of each that its residuals tell.
    """
    k, p = total.shape[0], total.shape[-1]
    scale = np.sqrt(np.diagonal(total, axis1=-2, axis2=-1).min(axis=0))
    outer = scale[..., :, None] * scale[..., None, :]
    contrast = np.kron(np.hstack([np.eye(k - 1), -np.ones((k - 1, 1))]), np.eye(p))
    parts = contrast.reshape(-1, k, p)

    def variances(matrices: Array) -> Array:
        return np.asarray(np.einsum("akp,kmpq,bkq->kmab", parts, matrices / outer, parts))

    d, turn = np.linalg.eigh(variances(total).sum(axis=0))
    turned = np.einsum("mac,kmab,mbc->kmc", turn, variances(own), turn)
    nu = d**2 / (turned**2 / np.array(df)[:, None, None]).sum(axis=0)
    few = (nu <= 2).any(axis=-1)
    # E - q, without the difference of nearly equal numbers
    safe = np.where(few[:, None], 4.0, nu)
    found = (safe / (safe - 2)).sum(axis=-1) / (1 / (safe - 2)).sum(axis=-1)
    return np.asarray(np.where(few, nu.min(axis=-1), np.minimum(found, _MANY)))


def _power(noncentrality: float, df: int, df_error: float) -> float:
    from scipy.special import fdtri

    if noncentrality <= 0:
        return ALPHA
    limit = float(fdtri(df, df_error, 1 - ALPHA))
    return 1 - noncentral_f_cdf(df, df_error, min(noncentrality, _LARGE), limit)
