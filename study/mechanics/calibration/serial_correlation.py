"""Errors of neighboring rows: their size, and the intervals of constants where they are correlated.

A load cell drifts and a contact settles, so that the errors of a recording follow each other. They
are taken as an autoregression of first order, e_t = rho e_(t-1) + noise. An estimate of rho put
in as if it were known gives intervals that are too narrow: at 60 rows and rho = 0.9 nominal 95 %
intervals cover 70 to 78 % by the lag-1 correlation of the residuals, and 84 to 87 % by restricted
maximum likelihood (600 simulated tests). The intervals here are
therefore averaged over all rho, each weighed by its restricted likelihood (Harville 1974,
Biometrika 61, 383; free of the bias by fitted constants) and the reference prior
(1 - rho^2)^(-1/2) (Berger and Yang 1994, Econometric Theory 10, 461).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from study.ground.arrays import Array

#: rows below which nothing is said about their correlation, and they count as independent
FEWEST_ROWS = 8
#: share of the error outside a two-sided interval at 95 %
_OUTSIDE = 0.05
#: Fisher's z = artanh(rho) of the first look: rho from -0.947 to 0.999
_FIRST_LOOK = np.linspace(-1.8, 3.8, 57)
#: log weight below the largest from which values of rho no longer count
_NEGLIGIBLE = 15.0
#: values of rho over which is averaged: 7 to a standard error
_VALUES = 81
#: rounding of a sum of squares relative to its first term
_ROUNDING = 1e-13

# Noise of single rows, from their distances to the line through their neighbors: what changes
# slowly, a drift of the load cell or a model that is wrong, is no part of it.

#: neighbors of a row through which the line goes (Theil 1950, Sen 1968: medians of slopes, so that
#: one of the neighbors may be an outlier)
_NEIGHBORS = 6
_PAIRS = np.array(list(combinations(range(_NEIGHBORS), 2)))
#: standard deviation of such a distance over that of a row: at the three rows of an end, and inside
#: (200,000 simulated rows of white noise)
_DISTANCE = np.array([1.425, 1.229, 1.126, 1.104])
#: standard deviation of a normal variable over the median of its size
_BY_MEDIAN = 1.4826
#: share of the largest force that counts as the size of smaller ones: a load cell has a floor
_FLOOR = 0.02
#: powers of the force with which noise may grow
_LARGEST_POWER = 1.5
#: standard errors by which the power must differ from zero
_GROWS = 2.5
#: sd(log |z|) of a normal variable z
_LOG_SCATTER = math.pi / math.sqrt(8)
#: neighbors share rows: how much more the slope of the distances scatters
_SHARED = 1.2


@dataclass(frozen=True)
class RowNoise:
    """Noise of the rows of one recording."""

    #: shape (n,); standard deviation of every row.
    deviation: Array
    #: shape (n,); distance of every row from the line through its neighbors, over the standard
    #: deviation that such a distance has.
    distance: Array
    #: Power of the force with which the deviation grows; 0 where the rows show no growth.
    power: float

    @property
    def relative(self) -> Array:
        """Deviation of every row over their root mean square, shape (n,); 1 without growth."""
        size = math.sqrt(float(np.mean(self.deviation**2)))
        return np.ones_like(self.deviation) if self.power == 0 else self.deviation / size

    @classmethod
    def of(cls, distance: Array, force: Array, power: float | None, grows: float) -> RowNoise:
        """Noise of rows by their distances from their neighbors' lines, in units of one row's."""
        size = np.maximum(np.abs(force), _FLOOR * np.abs(force).max())
        if power is None:
            power = _power_of(distance, size, grows)
        shape = (size / size.max()) ** power
        deviation = _BY_MEDIAN * float(_median(np.abs(distance) / shape)) * shape
        return cls(deviation, distance / deviation, power)

    def grown(self, force: Array) -> RowNoise:
        """Noise of the same rows where growth with the force need not be significant."""
        return RowNoise.of(self.distance * self.deviation, force, None, 0.0)


def row_noise(
    values: Array, places: Array, force: Array, power: float | None = None, grows: float = _GROWS
) -> RowNoise | None:
    """Noise of rows (residuals or forces); None below 8 rows, or where they hold none.

    The power is estimated by the regression of log distances on log forces (Carroll and Ruppert
    1988, Transformation and Weighting in Regression, sec. 3.3) unless it is given; below ``grows``
    standard errors it is zero.

    Shapes: values, places, force (n,).
    """
    n = values.size
    if n < FEWEST_ROWS or np.any(np.diff(places) <= 0):
        return None
    first = np.clip(np.arange(n) - _NEIGHBORS // 2, 0, n - 1 - _NEIGHBORS)
    index = first[:, None] + np.arange(_NEIGHBORS)
    index = index + (index >= np.arange(n)[:, None])
    x, y = places[index], values[index]
    before, after = _PAIRS.T
    slope = _median((y[:, after] - y[:, before]) / (x[:, after] - x[:, before]))
    line = slope * places + _median(y - slope[:, None] * x)
    factor = np.full(n, _DISTANCE[-1])
    factor[:3], factor[-3:] = _DISTANCE[:3], _DISTANCE[2::-1]
    distance = (values - line) / factor
    if not (_median(np.abs(distance)) > _ROUNDING * np.abs(values).max() and force.any()):
        return None
    return RowNoise.of(distance, force, power, grows)


def _median(values: Array) -> Array:
    """Median along the last axis, in a fifth of the time of ``np.median`` for few numbers."""
    middle, ordered = values.shape[-1] // 2, np.sort(values, axis=-1)
    if values.shape[-1] % 2:
        return np.asarray(ordered[..., middle])
    return np.asarray(0.5 * (ordered[..., middle - 1] + ordered[..., middle]))


def _power_of(distance: Array, size: Array, grows: float) -> float:
    """Power of the force with which distances grow; 0 where growth is not significant."""
    x = np.log(size)
    spread = float(x.std())
    y = np.log(np.maximum(np.abs(distance), 1e-3 * _median(np.abs(distance))))
    if spread < _ROUNDING:
        return 0.0
    slope = float((x - x.mean()) @ (y - y.mean())) / (x.size * spread**2)
    error = _SHARED * _LOG_SCATTER / (math.sqrt(x.size) * spread)
    return min(slope, _LARGEST_POWER) if slope > grows * error else 0.0


@dataclass(frozen=True)
class Series:
    """Consecutive rows of one recording, in units of one common standard deviation."""

    #: shape (n,); weighted residual.
    residual: Array
    #: shape (n, p); its derivative by the constants.
    jacobian: Array
    #: shape (p, n); change of the estimates by a change of the weighted error of every row.
    influence: Array

    def at(self, rows: NDArray[np.intp]) -> Series:
        """Return some of its rows, given by their places."""
        return Series(self.residual[rows], self.jacobian[rows], self.influence[:, rows])


@dataclass(frozen=True)
class Pseudo:
    """Observations of the constants themselves, which no recording correlates."""

    #: shape (k,); in units of the common standard deviation of the rows.
    residual: Array
    #: shape (k, p); its derivative by the constants.
    jacobian: Array

    def leverage(self, series: Sequence[Series]) -> float:
        """Parameters that these observations determine, and not the rows: from 0 to k.

        A prior that is as good as exact leaves its degree of freedom to the rows, a vague one
        takes it (the trace of the hat matrix, Hastie and Tibshirani 1990, sec. 3.5).
        """
        whole = np.concatenate([part.jacobian for part in series] + [self.jacobian])
        norms = np.linalg.norm(whole, axis=0)
        if not np.all(norms > 0):
            return 0.0
        basis, _ = np.linalg.qr(whole / norms)
        return float(np.sum(basis[-self.residual.size :] ** 2))


@dataclass(frozen=True)
class SerialCorrelation:
    """Correlation of the errors of neighboring rows, and what it leaves of them."""

    #: Recorded rows in the range of the fit.
    rows: int
    #: Of neighboring rows, at the largest restricted likelihood; NaN below 8 rows, which count as
    #: independent.
    correlation: float
    #: Independent rows that would determine a mean as well, rows (1 - rho) / (1 + rho) (Bayley and
    #: Hammersley 1946, J. R. Stat. Soc. Suppl. 8, 184); at most the rows.
    effective_rows: float
    #: shape (p,); width of every 95 % interval over the one of independent points.
    inflation: Array
    #: Errors of the estimates at every correlation that the rows allow.
    mixture: Mixture | None = None


@dataclass(frozen=True)
class Mixture:
    """Covariances of the estimates at several correlations of the rows, and how likely each is."""

    #: shape (k,); posterior weight of each correlation; they sum to 1.
    weight: Array
    #: shape (k, p, p); in all.
    covariance: Array
    #: shape (k, p, p); the part whose size the residuals tell.
    from_rows: Array

    def of(self, parameters: Array) -> Mixture:
        """Return that of some of the estimates."""
        some = np.ix_(np.arange(len(self.weight)), parameters, parameters)
        return Mixture(self.weight, self.covariance[some], self.from_rows[some])


@dataclass(frozen=True)
class Intervals:
    """Errors of the estimates under serially correlated errors."""

    #: shape (p, p); averaged over rho.
    covariance: Array
    #: shape (p,); of the 95 % intervals.
    half_width: Array
    #: rho at the largest restricted likelihood; NaN where it was not estimated.
    correlation: float
    #: -2 log likelihood at its maximum over constants, variance and rho, up to a constant.
    deviance: float
    mixture: Mixture


def intervals(
    series: Sequence[Series], pseudo: Pseudo | None = None, other_covariance: Array | None = None
) -> Intervals | None:
    """95 % intervals of least-squares estimates from serially correlated rows.

    Given rho, an estimate's error over its standard error has Student's t distribution with
    n - p degrees of freedom; the interval holds 95 % of the mixture over rho.

    ``other_covariance``, shape (p, p), is added to that of the rows: the residuals do not tell its
    size. Degrees of freedom of the sum are those of Satterthwaite (1946, Biometrics Bull. 2, 110).
    """
    rows = sum(part.residual.size for part in series)
    freedom: float = rows - series[0].jacobian.shape[1]
    if pseudo is not None and pseudo.residual.size:
        freedom += pseudo.leverage(series)
    moments = _LagMoments.of(series, pseudo)
    if freedom <= 0 or moments is None:
        return None
    rho, weight = np.zeros(1), np.ones(1)
    if rows >= FEWEST_ROWS:
        rho, weight = _posterior(moments, freedom)
    squares, determinant = moments.generalized(rho)
    scaled = (squares / freedom)[:, None, None] * _propagated(series, rho)
    total = scaled if other_covariance is None else scaled + other_covariance
    variances = np.diagonal(total, axis1=1, axis2=2).T
    diagonal = np.diagonal(scaled, axis1=1, axis2=2).T
    with np.errstate(over="ignore"):  # infinitely many are those of a normal error
        satterthwaite = freedom * ((variances / diagonal) @ weight) ** 2
    half = _half_widths(np.sqrt(variances), weight, satterthwaite)
    likely = -0.5 * freedom * np.log(squares) - determinant
    deviance = rows * np.log(squares / rows) - moments.series * np.log1p(-(rho**2))
    return Intervals(
        np.einsum("k,kij->ij", weight, total),
        half,
        float(rho[np.argmax(likely)]) if rows >= FEWEST_ROWS else math.nan,
        float(deviance.min()),
        Mixture(weight, total, scaled),
    )


#: columns of a trend that constants explain but for this share say nothing of a misfit
_EXPLAINED = 0.1


def trend(
    series: Sequence[Series], columns: Sequence[Array], explained: float = _EXPLAINED
) -> tuple[float, Array]:
    """P that the residuals hold no trend beyond a drift, and the trend, shape (n,).

    F test of further columns, given an autoregression of the rows, averaged over the correlations
    that the rows allow beside the trend. Where the model is right, a p below .002 comes in at most
    1 % of tests (AR(1) up to 0.98, 10 to 500 rows, 400 draws each).

    Shapes: columns (n_k, m) of every series.
    """
    from scipy.special import fdtrc

    constants = series[0].jacobian.shape[1]
    jacobian, residual = (
        np.concatenate([getattr(part, key) for part in series]) for key in ("jacobian", "residual")
    )
    added = np.concatenate(columns)
    basis, _ = np.linalg.qr(jacobian / np.linalg.norm(jacobian, axis=0))
    added = added / np.linalg.norm(added, axis=0)
    left, size, _ = np.linalg.svd(added - basis @ (basis.T @ added), full_matrices=False)
    left = left[:, size > explained]
    count, nothing = left.shape[1], np.zeros_like(residual)
    ends = np.cumsum([part.residual.size for part in series])[:-1]
    wider = [
        replace(part, jacobian=np.hstack([part.jacobian, column]))
        for part, column in zip(series, np.split(left, ends), strict=True)
    ]
    null, wide = _LagMoments.of(series), _LagMoments.of(wider)
    freedom = residual.size - constants - count
    if null is None or wide is None or freedom < 2 or count == 0:
        return 1.0, nothing
    rho, weight = _posterior(wide, freedom)
    without, extended = null.generalized(rho)[0], wide.generalized(rho)[0]
    statistic = np.maximum(without - extended, 0) / count / (extended / freedom)
    p = float(weight @ fdtrc(count, freedom, statistic))
    return p, np.asarray(left @ (left.T @ residual))


def effective_rows(rows: int, correlation: float) -> float:
    """Independent rows worth as much as correlated ones for a mean."""
    rho = max(correlation, 0.0) if math.isfinite(correlation) else 0.0
    return rows * (1 - rho) / (1 + rho)


@dataclass(frozen=True)
class _LagMoments:
    """Sums of products of rows, lag 0 and 1, from which any rho's likelihood follows."""

    #: shape (p + 1, p + 1); sums over rows, over pairs of neighbors (both ways), and over rows that
    #: are no ends.
    all_rows: Array
    neighbors: Array
    interior: Array
    #: shape (p + 1, p + 1); sums over the pseudo-observations, which have the variance of a row.
    pseudo: Array
    #: Number of recordings and of rows.
    series: int
    rows: int

    @classmethod
    def of(cls, series: Sequence[Series], pseudo: Pseudo | None = None) -> _LagMoments | None:
        """Moments of all series; None where the residual or a constant leaves nothing."""
        parts: list[Series | Pseudo] = [*series, *([] if pseudo is None else [pseudo])]
        jacobian = np.concatenate([part.jacobian for part in parts])
        residual = np.concatenate([part.residual for part in parts])
        norms = np.linalg.norm(jacobian, axis=0)
        size = float(np.linalg.norm(residual))
        if not (np.all(norms > 0) and size > 0 and len(residual) >= len(norms)):
            return None
        # an orthonormal basis of the same columns: the likelihood sees no more of them
        basis, triangle = np.linalg.qr(jacobian / norms)
        if np.abs(np.diag(triangle)).min() < _ROUNDING:
            return None
        joined = np.column_stack([basis, residual])
        ends = np.cumsum([part.residual.size for part in series])
        *recordings, prior = np.split(joined, ends)
        rows = joined[: ends[-1]]
        cross = sum((z[1:].T @ z[:-1] for z in recordings), np.zeros((len(norms) + 1,) * 2))
        inner = sum((z[1:-1].T @ z[1:-1] for z in recordings), np.zeros_like(cross))
        return cls(
            rows.T @ rows, cross + cross.T, inner, prior.T @ prior, len(recordings), len(rows)
        )

    def generalized(self, rho: Array) -> tuple[Array, Array]:
        """Residual sum of squares by generalized least squares, and the log determinants."""
        # Shapes: rho (k,); returns (k,).
        r = rho[:, None, None]
        product = self.all_rows - r * self.neighbors + r**2 * self.interior
        product = product + (1 - r**2) * self.pseudo
        normal, right, square = product[:, :-1, :-1], product[:, :-1, -1:], product[:, -1, -1]
        explained = (right * np.linalg.solve(normal, right)).sum(axis=(1, 2))
        squares = np.maximum(square - explained, _ROUNDING * self.all_rows[-1, -1])
        log_normal = np.linalg.slogdet(normal)[1]
        return squares, 0.5 * (log_normal - self.series * np.log1p(-(rho**2)))


def _posterior(moments: _LagMoments, freedom: float) -> tuple[Array, Array]:
    """Values of rho, even in Fisher's z, and the weight of each; shapes (81,)."""
    look = _log_weight(moments, _FIRST_LOOK, freedom)
    counts = np.flatnonzero(look > look.max() - _NEGLIGIBLE)
    low, high = max(counts[0] - 1, 0), min(counts[-1] + 1, look.size - 1)
    z = np.linspace(_FIRST_LOOK[low], _FIRST_LOOK[high], _VALUES)
    weight = _log_weight(moments, z, freedom)
    weight = np.exp(weight - weight.max())
    return np.tanh(z), weight / weight.sum()


def _log_weight(moments: _LagMoments, z: Array, freedom: float) -> Array:
    """Log of restricted likelihood x reference prior x d rho / d z."""
    rho = np.tanh(z)
    squares, determinant = moments.generalized(rho)
    prior_and_step = (1 - 0.5) * np.log1p(-(rho**2))
    return np.asarray(-0.5 * freedom * np.log(squares) - determinant + prior_and_step)


def _propagated(series: Sequence[Series], rho: Array) -> Array:
    """Covariance of the estimates for unit noise, shape (k, p, p): influence R influence'."""
    # R has the elements rho^|i - j| / (1 - rho^2), so that lagged products are all it takes.
    p, rows = series[0].influence.shape[0], max(part.residual.size for part in series)
    # the lags of all recordings are added up before rho weighs them; twice the rows, so that
    # the ends of a recording do not meet
    size = 1 << (2 * rows - 1).bit_length()
    spectra = [np.fft.rfft(part.influence, size, axis=1) for part in series]
    power_spectrum = sum(s[:, None] * s[None].conj() for s in spectra)
    products = np.fft.irfft(power_spectrum, size, axis=2)[..., :rows]
    weight = np.ones((rho.size, rows))
    weight[:, 1:] = rho[:, None]
    np.cumprod(weight, axis=1, out=weight)
    weight[:, 0] = 0.5
    half = (weight @ products.reshape(p * p, rows).T).reshape(rho.size, p, p)
    return np.asarray((half + half.transpose(0, 2, 1)) / (1 - rho**2)[:, None, None])


def _half_widths(errors: Array, weight: Array, freedom: Array) -> Array:
    """Half widths that hold 95 % of mixtures of Student's t of several scales, shape (p,).

    ``errors`` has the scales of each mixture, shape (p, k), ``weight`` those of the scales, and
    ``freedom`` the degrees of freedom, shape (p,), up to infinity. Brent's method needs the
    distribution function alone, which is exact for every freedom; in a density, the ratio of two
    gamma functions of 1e19 degrees of freedom is a difference of logarithms near 1e20.
    """
    from scipy.optimize import brentq
    from scipy.special import stdtr, stdtrit

    inside = 1 - _OUTSIDE / 2

    def half_width(scales: Array, nu: float) -> float:
        mean = float(np.sqrt(scales**2 @ weight))
        if not 0 < mean < math.inf:
            return math.nan
        # in units of the mean scale's quantile, which the narrowest's and the widest's enclose;
        # twice as far, so that a single scale lies between them too
        unit, ends = float(stdtrit(nu, inside)) * mean, (scales.min() / mean, scales.max() / mean)
        root: float = brentq(
            lambda half: stdtr(nu, half * unit / scales) @ weight - inside,
            0.5 * ends[0], 2 * ends[1], xtol=1e-15,
        )  # fmt: skip
        return root * unit

    return np.array([half_width(*row) for row in zip(errors, freedom, strict=True)])
