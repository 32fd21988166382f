"""Distribution function of the noncentral F, at every noncentrality."""

from __future__ import annotations

import math

import numpy as np

#: noncentrality up to which the series of scipy is used; beyond, it takes seconds
_SERIES = 1e6
#: standard deviations of the Poisson weights that are summed, to either side of their mean
_SPREAD = 12.0
#: weights at most: the terms are smooth over a standard deviation, so that fewer would do
_TERMS = 4001


def noncentral_f_cdf(df1: float, df2: float, noncentrality: float, f: float) -> float:
    """Probability that a noncentral F is at most ``f``.

    scipy 1.17 gives NaN at single noncentralities between 1,400 and 5,000, of any degrees of
    freedom. There, and beyond its range, the Poisson mixture of incomplete beta functions is
    summed (Johnson, Kotz and Balakrishnan 1995, equation 30.10), with Loader's form of the
    weights (Loader 2000), which subtracts no large logarithms.
    """
    from scipy.special import betainc, betaincc, ncfdtr

    if noncentrality <= _SERIES:
        value = float(ncfdtr(df1, df2, noncentrality, f))
        if math.isfinite(value):
            return value
    mean = noncentrality / 2
    half = _SPREAD * math.sqrt(mean) + _SPREAD
    low, high = max(float(np.ceil(mean - half)), 1.0), float(np.floor(mean + half))
    j = np.linspace(low, high, int(min(high - low + 1, _TERMS)))
    away = (j - mean) / mean
    logarithms = -mean * ((1 + away) * np.log1p(away) - away) - np.log(j) / 2 - 1 / (12 * j)
    weights = np.exp(logarithms - logarithms.max())
    if df1 * f < df2:  # the argument that rounding leaves its digits
        terms = betainc(df1 / 2 + j, df2 / 2, df1 * f / (df1 * f + df2))
    else:
        terms = betaincc(df2 / 2, df1 / 2 + j, df2 / (df1 * f + df2))
    return float(weights @ terms / weights.sum())
