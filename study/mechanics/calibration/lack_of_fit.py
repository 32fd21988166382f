"""What the residuals say about the model: lack of fit, pattern, choice between energies.

The points of one test are not independent of each other: a load cell drifts, a contact
settles. Nothing in a single test tells how many independent errors it holds, so every
verdict is given for both ends: as many as points, and one a curve.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from study.ground.arrays import Array
from study.ground.errors import Fault, InputError, RefusedError
from study.ground.noncentral_f import noncentral_f_cdf
from study.mechanics.calibration.fit import Fit
from study.mechanics.calibration.serial_correlation import Mixture

ALPHA = 0.05


@dataclass(frozen=True)
class Repeated:
    """Residuals of one averaged curve and the scatter of the repeats it averages."""

    #: shape (n,); weighted residual of the mean.
    residual: Array
    #: shape (n,); standard deviation of the repeats, times the same weights.
    scatter: Array
    #: How many were averaged; at least two.
    repeats: int


@dataclass(frozen=True)
class LackOfFit:
    """Comparison of what the model misses with what repeats scatter."""

    #: F: mean square of the misses over the mean square of pure error.
    statistic: float
    #: Degrees of freedom where every point is an independent error.
    df: int
    df_error: int
    #: p where every point is one, and where every curve is one.
    p_independent: float
    p_dependent: float
    #: ``lack-of-fit``, ``adequate``, or ``undecided`` where the two disagree.
    verdict: Literal["lack-of-fit", "adequate", "undecided"]


@dataclass(frozen=True)
class ResidualPattern:
    """Order in the residuals along the curves."""

    #: Correlation of neighboring residuals; near 0 where only noise is left.
    lag1: float
    #: Runs of equal sign, and how many independent residuals would show.
    runs: int
    expected_runs: float
    #: Two-sided p of the runs test (Wald and Wolfowitz 1940), normal approximation.
    p: float


def lack_of_fit(curves: Sequence[Repeated], parameters: int) -> LackOfFit | None:
    """F test of lack of fit against the pure error of repeats (Draper and Smith 1998, 2.1)."""
    points = sum(c.residual.size for c in curves)
    df, df_error = points - parameters, sum(c.residual.size * (c.repeats - 1) for c in curves)
    missed = sum(c.repeats * float(c.residual @ c.residual) for c in curves)
    pure = sum((c.repeats - 1) * float(c.scatter @ c.scatter) for c in curves)
    if df <= 0 or df_error <= 0 or pure <= 0:
        return None
    from scipy.special import fdtrc

    statistic = (missed / df) / (pure / df_error)
    many = float(fdtrc(df, df_error, statistic))
    few = float(fdtrc(len(curves), sum(c.repeats - 1 for c in curves), statistic))
    clear: Literal["lack-of-fit", "adequate"] = "lack-of-fit" if many < ALPHA else "adequate"
    agree = (many < ALPHA) == (few < ALPHA)
    return LackOfFit(statistic, df, df_error, many, few, clear if agree else "undecided")


def pattern(residuals: Sequence[Array]) -> ResidualPattern | None:
    """Pattern of the residuals along each curve; None below eight points."""
    kept = [r for r in residuals if r.size > 1]
    n = sum(r.size for r in kept)
    power = sum(float(r @ r) for r in kept)
    if n < 8 or power == 0:
        return None
    lag1 = sum(float(r[1:] @ r[:-1]) for r in kept) / power
    above = [r > 0 for r in kept]
    runs = sum(int(np.count_nonzero(a[1:] != a[:-1])) + 1 for a in above)
    expected, variance = _runs_expected(above)
    from scipy.special import erfc

    p = float(erfc(abs(runs - expected) / math.sqrt(2 * variance))) if variance > 0 else math.nan
    return ResidualPattern(lag1, runs, expected, p)


def _runs_expected(above: Sequence[NDArray[np.bool_]]) -> tuple[float, float]:
    expected = variance = 0.0
    for signs in above:
        n, plus = signs.size, int(np.count_nonzero(signs))
        both = 2 * plus * (n - plus)
        expected += 1 + both / n
        variance += both * (both - n) / (n * n * (n - 1))
    return expected, max(variance, 0.0)


def akaike_weights(aicc: Mapping[str, float]) -> dict[str, float]:
    """Share of the evidence that each model has (Burnham and Anderson 2002, sec. 2.9).

    Examples
    --------
    >>> weights = akaike_weights({"one": 10.0, "two": 12.0})
    >>> {name: round(value, 4) for name, value in weights.items()}
    {'one': 0.7311, 'two': 0.2689}
    """
    finite = {name: value for name, value in aicc.items() if math.isfinite(value)}
    if not finite:
        return dict.fromkeys(aicc, math.nan)
    best = min(finite.values())
    share = {name: math.exp(-0.5 * (value - best)) for name, value in finite.items()}
    total = sum(share.values())
    return {name: share.get(name, 0.0) / total for name in aicc}


def same_constants(
    pooled_rss: float, own_rss: float, n: float, p: int, groups: int
) -> float | None:
    """P that groups share their constants, by the extra sum of squares.

    (Bates and Watts 1988, sec. 3.10.)
    """
    extra, left = p * (groups - 1), n - p * groups
    if extra <= 0 or left <= 0 or own_rss <= 0:
        return None
    from scipy.special import fdtrc

    return float(fdtrc(extra, left, max(pooled_rss - own_rss, 0.0) / extra / (own_rss / left)))


# Wald test that fits to different data estimate the same constants, and its power (Cochran 1954,
# Biometrics 10, 101; denominator by Fai and Cornelius 1996, J. Stat. Comput. Simul. 54, 363). p
# is averaged over the correlations of rows that each test allows.

WALD_ALPHA = 0.05
#: power that a test should have against a difference that matters (Cohen 1988)
USUAL_POWER = 0.80
#: correlations of its rows that are drawn for each fit
DRAWS = 4000
#: denominator from which F is a chi-square in every digit that is shown
_MANY = 1e5
#: noncentrality beyond which power is 1
_LARGE = 1e3


@dataclass(frozen=True)
class FitAgreement:
    """Test of the hypothesis that all fits estimate the same constants."""

    #: shape (p,); common estimate, weighted by the inverse covariances, MPa (exponents plain).
    common: Array
    #: shape (p, p); of the common estimate.
    covariance: Array
    #: Sum of the weighted squared distances from it (Wald's statistic), by the mean weights.
    statistic: float
    #: Degrees of freedom, p (k - 1).
    df: int
    #: Denominator degrees of freedom, the median over correlations; infinite where the covariances
    #: are known.
    df_error: float
    #: Of F = statistic / df, averaged over the correlations of rows that each fit allows.
    p: float
    #: The same of a chi-square: what is usual, and too small for few points.
    p_chi_square: float
    #: shape (p, p); weights of the fits.
    inverse_covariances: tuple[Array, ...]

    def power(self, differences: Array) -> float:
        """Probability that the test rejects where the fits differ by this much.

        Shapes: differences (k, p), MPa.
        """
        return _power(self._noncentrality(differences), self.df, self.df_error)

    def detectable(self, differences: Array) -> float:
        """Multiple of these differences that is seen with a power of 80 %; differences (k, p)."""
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


def agreement(fits: Sequence[Fit], extra: Sequence[Array] = ()) -> FitAgreement:
    """Test whether fits to different data give the same constants. Shapes: extra (p, p)."""
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
    return FitAgreement(
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
    """Distances of the rows of ``values`` from their weighted mean, and the mean."""
    # Shapes: values (k, p); weights (k, m, p, p); returns (k, m, p).
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

    Shapes: total, own (k, m, p, p).
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
        return WALD_ALPHA
    limit = float(fdtri(df, df_error, 1 - WALD_ALPHA))
    return 1 - noncentral_f_cdf(df, df_error, min(noncentrality, _LARGE), limit)
