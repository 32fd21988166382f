"""Upper tail of the noncentral F, at every noncentrality."""

from __future__ import annotations

import math

#: noncentrality from which the numerator varies by less than the root of a rounding
_FIXED = 1e9


def noncentral_f_sf(df1: float, df2: float, noncentrality: float, f: float) -> float:
    """Probability that a noncentral F is larger than ``f``.

    The upper tail of scipy 1.17 has a number where its distribution function has none (single
    noncentralities between 1,400 and 5,000); its series ends short of 1e12, where the denominator
    alone varies.
    """
    from scipy.special import gammainc
    from scipy.stats import ncf

    if f <= 0 or f == math.inf:
        return 1.0 if f <= 0 else 0.0
    if noncentrality > _FIXED:
        return float(gammainc(df2 / 2, df2 / 2 * (noncentrality / (df1 * f))))
    # what ncf.sf calls, without its checks of shapes, which take 100 times as long
    return float(ncf._sf(f, df1, df2, noncentrality))
