"""Intervals of constants where the errors of neighboring rows are correlated.

A load cell drifts and a contact settles, so that the errors of a recording follow each other. They
are taken as an autoregression of second order, whose memory may fade more slowly than the
correlation of neighbors says. Estimates put in as if they were known give intervals that are too
narrow: at 60 rows and rho = 0.9 nominal 95 %
intervals cover 70 to 78 % by the lag-1 correlation of the residuals, and 84 to 87 % by restricted
maximum likelihood (600 simulated tests). Nor do 60 rows say which order they have. The intervals
here are therefore averaged over all pairs of partial autocorrelations, each weighed by its
restricted likelihood (Harville 1974, Biometrika 61, 383; free of the bias by fitted constants),
the reference prior (1 - rho^2)^(-1/2) of the first (Berger and Yang 1994, Econometric Theory 10,
461) and a uniform one of the second; white noise and first order are among them. What is said
of the correlation of neighbors, of effective rows and in AICc is that of first order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.calibration.covariance import half_widths

#: rows below which nothing is said about their correlation, and they count as independent
FEWEST_ROWS = 8

#: share of the error outside a two-sided interval at 95 %
_OUTSIDE = 0.05

#: Fisher's z = artanh(rho) of the first look: rho from -0.947 to 0.999
_FIRST_LOOK = np.linspace(-1.8, 3.8, 57)

#: the same of the second partial autocorrelation: from -0.89 to 0.89
_SECOND_LOOK = np.linspace(-1.4, 1.4, 21)

#: rows of the shortest recording below which errors are taken as of first order: a second
#: coefficient, known to 1 / sqrt(rows), would cost more power than it saves in coverage
_FEWEST_OF_SECOND_ORDER = 30

#: log weight below the largest from which values of rho no longer count
_NEGLIGIBLE = 15.0

#: values of rho among which the likeliest is looked for: 7 to a standard error
_VALUES = 81

#: values of each partial autocorrelation over which is averaged: 2 to a standard error
_VALUES_EACH = 25

#: autocovariances held at a time
_NUMBERS = 4_000_000

#: rounding of a sum of squares relative to its first term
_ROUNDING = 1e-13


@dataclass(frozen=True)
class Series:
    """Consecutive rows of one recording, in units of one common standard deviation.

    Parameters
    ----------
    residual : ndarray, shape (n,)
        Weighted residual.
    jacobian : ndarray, shape (n, p)
        Its derivative by the constants.
    influence : ndarray, shape (p, n)
        Change of the estimates by a change of the weighted error of every row.
    """

    residual: Array
    jacobian: Array
    influence: Array


@dataclass(frozen=True)
class Pseudo:
    """Observations of the constants themselves, which no recording correlates.

    Parameters
    ----------
    residual : ndarray, shape (k,)
        In units of the common standard deviation of the rows.
    jacobian : ndarray, shape (k, p)
        Its derivative by the constants.
    """

    residual: Array
    jacobian: Array

    @classmethod
    def none(cls, constants: int) -> Pseudo:
        """No observation."""
        return cls(np.zeros(0), np.zeros((0, constants)))

    def leverage(self, series: Sequence[Series]) -> float:
        """Parameters that these observations determine, and not the rows: from 0 to k.

        A prior that is as good as exact leaves its degree of freedom to the rows, a vague one
        takes it (the trace of the hat matrix, Hastie and Tibshirani 1990, sec. 3.5).
        """
        if not self.residual.size:
            return 0.0
        whole = np.concatenate([one.jacobian for one in series] + [self.jacobian])
        norms = np.linalg.norm(whole, axis=0)
        if not np.all(norms > 0):
            return 0.0
        basis, _ = np.linalg.qr(whole / norms)
        return float(np.sum(basis[-self.residual.size :] ** 2))


@dataclass(frozen=True)
class SerialCorrelation:
    """Correlation of the errors of neighboring rows, and what it leaves of them.

    Parameters
    ----------
    rows : int
        Recorded rows in the range of the fit.
    correlation : float
        Of neighboring rows, at the largest restricted likelihood; NaN below 8 rows, which
        count as independent.
    effective_rows : float
        Independent rows that would determine a mean as well, rows (1 - rho) / (1 + rho)
        (Bayley and Hammersley 1946, J. R. Stat. Soc. Suppl. 8, 184); at most the rows.
    inflation : ndarray, shape (p,)
        Width of every 95 % interval over the one of independent points.
    """

    rows: int
    correlation: float
    effective_rows: float
    inflation: Array


@dataclass(frozen=True)
class Intervals:
    """Errors of the estimates under serially correlated errors.

    Parameters
    ----------
    covariance : ndarray, shape (p, p)
        Averaged over rho.
    half_width : ndarray, shape (p,)
        Of the 95 % intervals.
    correlation : float
        rho at the largest restricted likelihood; NaN where it was not estimated.
    deviance : float
        -2 log likelihood at its maximum over constants, variance and rho, up to a constant.
    """

    covariance: Array
    half_width: Array
    correlation: float
    deviance: float


def intervals(
    series: Sequence[Series], pseudo: Pseudo | None = None, known: Array | None = None
) -> Intervals | None:
    """95 % intervals of least-squares estimates from serially correlated rows.

    Given rho, an estimate's error over its standard error has Student's t distribution with
    n - p degrees of freedom; the interval holds 95 % of the mixture over rho.

    Parameters
    ----------
    series : sequence of Series
        All recordings; they share rho and the variance, and are independent of each other.
    pseudo : Pseudo, optional
        Observations of the constants themselves, that were fitted besides.
    known : ndarray, shape (p, p), optional
        Covariance besides that of the rows, whose size the residuals do not tell. Degrees of
        freedom of the sum are those of Satterthwaite (1946, Biometrics Bull. 2, 110).

    Returns
    -------
    Intervals or None
        None without degrees of freedom, without residuals or with undetermined constants.
    """
    rows = sum(one.residual.size for one in series)
    beside = pseudo or Pseudo.none(series[0].jacobian.shape[1])
    freedom = rows - series[0].jacobian.shape[1] + beside.leverage(series)
    moments = _Moments.of(series, beside)
    if freedom <= 0 or moments is None:
        return None
    partial, weight = np.zeros((1, 2)), np.ones(1)
    rho = np.zeros((1, 2))
    if rows >= FEWEST_ROWS:
        partial, weight = _posterior(moments, freedom)
        rho = _of_first_order(moments, freedom)
    squares, _ = moments.generalized(partial)
    scaled = (squares / freedom)[:, None, None] * _propagated(series, partial)
    total = scaled if known is None else scaled + known
    variances = np.diagonal(total, axis1=1, axis2=2).T
    own = np.diagonal(scaled, axis1=1, axis2=2).T
    satterthwaite = freedom * ((variances / own) @ weight) ** 2
    half = half_widths(np.sqrt(variances), weight, satterthwaite, 1 - _OUTSIDE)
    squares, determinant = moments.generalized(rho)
    likely = -0.5 * freedom * np.log(squares) - determinant
    deviance = rows * np.log(squares / rows) - moments.series * np.log1p(-(rho[:, 0] ** 2))
    return Intervals(
        np.einsum("k,kij->ij", weight, total),
        half,
        float(rho[np.argmax(likely), 0]) if rows >= FEWEST_ROWS else math.nan,
        float(deviance.min()),
    )


def effective_rows(rows: int, correlation: float) -> float:
    """Independent rows worth as much as correlated ones for a mean.

    Examples
    --------
    >>> round(effective_rows(60, 0.5), 9)
    20.0
    >>> effective_rows(60, -0.2)
    60.0
    """
    rho = max(correlation, 0.0) if math.isfinite(correlation) else 0.0
    return rows * (1 - rho) / (1 + rho)


@dataclass(frozen=True)
class _Moments:
    """Sums of products of rows, from which the likelihood of any autoregression follows.

    Parameters
    ----------
    lagged : ndarray, shape (3, 3, p + 1, p + 1)
        Sums of products of row t + i and row t + j over t from 0 to n - 1 - i - j (Box, Jenkins
        and Reinsel 1994, Time Series Analysis, sec. A7.4), symmetric in i and j.
    pseudo : ndarray, shape (p + 1, p + 1)
        Sums over the pseudo-observations, which have the variance of a row.
    series, rows, shortest : int
        Number of recordings and of rows, and rows of the shortest recording.
    """

    lagged: Array
    pseudo: Array
    series: int
    rows: int
    shortest: int

    @classmethod
    def of(cls, series: Sequence[Series], pseudo: Pseudo) -> _Moments | None:
        """Moments of all series; None where the residual or a constant leaves nothing."""
        jacobian = np.concatenate([one.jacobian for one in series] + [pseudo.jacobian])
        residual = np.concatenate([one.residual for one in series] + [pseudo.residual])
        norms = np.linalg.norm(jacobian, axis=0)
        size = float(np.linalg.norm(residual))
        if not (np.all(norms > 0) and size > 0 and len(residual) >= len(norms)):
            return None
        # an orthonormal basis of the same columns: the likelihood sees no more of them
        basis, triangle = np.linalg.qr(jacobian / norms)
        if np.abs(np.diag(triangle)).min() < _ROUNDING:
            return None
        joined = np.column_stack([basis, residual])
        ends = np.cumsum([one.residual.size for one in series])
        *parts, beside = np.split(joined, ends)
        lagged = np.zeros((3, 3, len(norms) + 1, len(norms) + 1))
        for z in parts:
            for i, k in np.ndindex(3, 3):
                count = max(len(z) - i - k, 0)
                lagged[i, k] += z[i : i + count].T @ z[k : k + count]
        return cls(
            0.5 * (lagged + lagged.transpose(1, 0, 2, 3)), beside.T @ beside, len(parts),
            int(ends[-1]), min(len(z) for z in parts),
        )  # fmt: skip

    def generalized(self, partial: Array) -> tuple[Array, Array]:
        """Residual sum of squares by generalized least squares, and the log determinants.

        Parameters
        ----------
        partial : ndarray, shape (k, 2)
            Partial autocorrelations; the second is 0 for an autoregression of first order.

        Returns
        -------
        squares, determinant : ndarray, shape (k,)
            In units of the noise that enters at every row; half the log determinants of the
            errors' and of the estimates' inverse covariance, as the restricted likelihood
            subtracts them.
        """
        weight = np.column_stack([np.ones(len(partial)), -_coefficients(partial)])
        product = np.einsum("ki,kj,ijab->kab", weight, weight, self.lagged)
        product = 0.5 * (product + product.transpose(0, 2, 1))
        product = product + np.prod(1 - partial**2, axis=1)[:, None, None] * self.pseudo
        normal, right, own = product[:, :-1, :-1], product[:, :-1, -1:], product[:, -1, -1]
        explained = (right * np.linalg.solve(normal, right)).sum(axis=(1, 2))
        squares = np.maximum(own - explained, _ROUNDING * self.lagged[0, 0, -1, -1])
        log_normal = np.linalg.slogdet(normal)[1]
        log_errors = np.log1p(-(partial**2)) @ np.array([1.0, 2.0])
        return squares, 0.5 * (log_normal - self.series * log_errors)


def _coefficients(partial: Array) -> Array:
    """Coefficients phi of autoregressions of second order, shape (k, 2) (Durbin 1960)."""
    first, second = partial.T
    return np.column_stack([first * (1 - second), second])


def _of_first_order(moments: _Moments, freedom: float) -> Array:
    """Values of rho, even in Fisher's z, around the likeliest; shape (81, 2), the second 0."""
    z = np.column_stack([_FIRST_LOOK, np.zeros_like(_FIRST_LOOK)])
    low, high = _span(z[:, 0], _log_weight(moments, z, freedom))
    return np.tanh(np.column_stack([np.linspace(low, high, _VALUES), np.zeros(_VALUES)]))


def _posterior(moments: _Moments, freedom: float) -> tuple[Array, Array]:
    """Partial autocorrelations on a grid even in Fisher's z, and the weight of each."""
    first = _FIRST_LOOK
    second = _SECOND_LOOK if moments.shortest >= _FEWEST_OF_SECOND_ORDER else np.zeros(1)
    for count in (_VALUES_EACH, _VALUES_EACH):
        z = np.stack(np.meshgrid(first, second, indexing="ij"), axis=-1).reshape(-1, 2)
        weight = _log_weight(moments, z, freedom).reshape(first.size, second.size)
        first = np.linspace(*_span(first, weight.max(axis=1)), count)
        if second.size > 1:
            second = np.linspace(*_span(second, weight.max(axis=0)), count)
    z = np.stack(np.meshgrid(first, second, indexing="ij"), axis=-1).reshape(-1, 2)
    log_weight = _log_weight(moments, z, freedom)
    counts = log_weight > log_weight.max() - _NEGLIGIBLE
    weight = np.exp(log_weight[counts] - log_weight.max())
    return np.tanh(z[counts]), weight / weight.sum()


def _span(z: Array, log_weight: Array) -> tuple[float, float]:
    """Find the ends of the values that count, with a neighbor on either side."""
    counts = np.flatnonzero(log_weight > log_weight.max() - _NEGLIGIBLE)
    return float(z[max(counts[0] - 1, 0)]), float(z[min(counts[-1] + 1, z.size - 1)])


def _log_weight(moments: _Moments, z: Array, freedom: float) -> Array:
    """Log of restricted likelihood x prior x steps of z.

    The prior of the first partial autocorrelation is the reference prior, that of the second
    is uniform; the derivative of each by its z is 1 less its square.
    """
    partial = np.tanh(z)
    squares, determinant = moments.generalized(partial)
    prior_and_step = np.log1p(-(partial**2)) @ np.array([1 - 0.5, 1.0])
    return np.asarray(-0.5 * freedom * np.log(squares) - determinant + prior_and_step)


def _propagated(series: Sequence[Series], partial: Array) -> Array:
    """Covariance of the estimates for unit noise, shape (k, p, p): influence R influence'.

    R has the autocovariances of the lag as elements, so that lagged products are all it takes.
    """
    p, rows = series[0].influence.shape[0], max(one.residual.size for one in series)
    # the lags of all recordings are added up before R weighs them; twice the rows, so that
    # the ends of a recording do not meet
    size = 1 << (2 * rows - 1).bit_length()
    spectra = [np.fft.rfft(one.influence, size, axis=1) for one in series]
    power_spectrum = sum(s[:, None] * s[None].conj() for s in spectra)
    products = np.fft.irfft(power_spectrum, size, axis=2)[..., :rows].reshape(p * p, rows).T
    half = np.empty((len(partial), p * p))
    block = max(1, _NUMBERS // rows)
    for begin in range(0, len(partial), block):
        own = _autocovariances(partial[begin : begin + block], rows)
        own[:, 0] *= 0.5
        half[begin : begin + block] = own @ products
    halves = half.reshape(-1, p, p)
    return np.asarray(halves + halves.transpose(0, 2, 1))


def _autocovariances(partial: Array, n: int) -> Array:
    """Autocovariances of lag 0 to n - 1 for unit noise (Yule and Walker), shape (k, n)."""
    first, second = _coefficients(partial).T
    out = np.empty((n, len(partial)))
    out[0] = 1 / np.prod(1 - partial**2, axis=1)
    if n > 1:
        out[1] = partial[:, 0] * out[0]
    for lag in range(2, n):
        out[lag] = first * out[lag - 1] + second * out[lag - 2]
    return out.T
