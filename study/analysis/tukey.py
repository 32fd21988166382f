"""Quantiles of the studentized range, fast enough for every effect of a table."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from study.analysis.matrix import Array


@lru_cache(maxsize=4)
def _legendre(n: int) -> tuple[Array, Array]:
    nodes, weights = np.polynomial.legendre.leggauss(n)
    return nodes, weights


def range_cdf(w: Array, k: int) -> Array:
    """P(range of ``k`` standard normals <= w): k int phi(z) (Phi(z) - Phi(z - w))^(k-1) dz."""
    from scipy.special import ndtr

    nodes, weights = _legendre(96)
    z = 9.0 * nodes
    density = 9.0 * weights * np.exp(-0.5 * z**2) / math.sqrt(2 * math.pi)
    inner = ndtr(z) - ndtr(z - np.asarray(w)[..., None])
    return np.asarray(k * (inner ** (k - 1)) @ density)


@lru_cache(maxsize=256)
def _scale_rule(df: float) -> tuple[Array, Array]:
    """Nodes and weights for s = sqrt(chi2_df / df)."""
    from scipy.special import gammainccinv, gammaincinv, gammaln

    low = math.sqrt(2 * float(gammaincinv(df / 2, 1e-14)) / df)
    high = math.sqrt(2 * float(gammainccinv(df / 2, 1e-14)) / df)
    nodes, weights = _legendre(128)
    s = low + (high - low) * (nodes + 1) / 2
    log_density = (
        math.log(2)
        + df / 2 * math.log(df / 2)
        - float(gammaln(df / 2))
        + (df - 1) * np.log(s)
        - df * s**2 / 2
    )
    return s, np.asarray(weights * (high - low) / 2 * np.exp(log_density))


def studentized_range_cdf(q: float, k: int, df: float) -> float:
    """P(studentized range of ``k`` means with ``df`` <= q) (Tukey 1953; Copenhaver 1988)."""
    if q <= 0:
        return 0.0
    s, weights = _scale_rule(float(df))
    return min(1.0, float(range_cdf(q * s, k) @ weights))


@lru_cache(maxsize=1024)
def studentized_range_quantile(p: float, k: int, df: float) -> float:
    """Quantile of the studentized range.

    Examples
    --------
    >>> round(studentized_range_quantile(0.95, 3, 10), 4)
    3.8768
    """
    from scipy.optimize import brentq

    high = 8.0
    while studentized_range_cdf(high, k, df) < p:
        high *= 2
    root: float = brentq(lambda q: studentized_range_cdf(q, k, df) - p, 1e-6, high, xtol=1e-9)
    return root
