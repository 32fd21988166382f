"""Sphericity of blocked comparisons: Mauchly's test and the epsilons that correct p."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from study.arrays import Array


@dataclass(frozen=True)
class SphericityResult:
    """Mauchly's test and the epsilons of one blocked term."""

    w: float | None
    chi2: float | None
    df: int | None
    p: float | None
    epsilon_gg: float
    epsilon_hf: float
    reason: str = ""


def epsilon_gg(covariance: Array) -> float:
    """Greenhouse-Geisser epsilon of the covariance of orthonormal contrasts, shape (d, d).

    Greenhouse and Geisser (1959), Psychometrika 24, 95-112: tr(S)^2 / (d tr(S^2)).

    Parameters
    ----------
    covariance : ndarray, shape (d, d)
        Covariance of the d contrasts over the blocks.

    Returns
    -------
    float
        From 1/d to 1; 1 where the contrasts are spherical.
    """
    d = covariance.shape[0]
    square = float(np.sum(covariance * covariance))
    if square == 0:
        return 1.0
    return float(min(1.0, max(1.0 / d, np.trace(covariance) ** 2 / (d * square))))


def sphericity(contrasts: Array) -> SphericityResult:
    """Mauchly's test of the orthonormal contrasts of a term.

    Parameters
    ----------
    contrasts : ndarray, shape (d, b)
        One column a block.

    Notes
    -----
    Mauchly (1940); Anderson (2003), 10.7.4; Huynh and Feldt (1976). With d = 1 sphericity
    holds by construction.
    """
    d, b = contrasts.shape
    s = np.atleast_2d(np.cov(contrasts))
    gg = epsilon_gg(s)
    if d == 1:
        return SphericityResult(1.0, 0.0, 0, None, 1.0, 1.0, "one degree of freedom")
    bottom = d * (b - 1 - d * gg)
    hf = 1.0 if bottom <= 0 else min(1.0, (b * d * gg - 2) / bottom)
    if b - 1 < d:
        return SphericityResult(
            None, None, None, None, gg, hf, f"needs more than {d} blocks, got {b}"
        )
    sign, logdet = np.linalg.slogdet(s)
    if sign <= 0:
        return SphericityResult(None, None, None, None, gg, hf, "the contrasts are singular")
    log_w = float(logdet - d * math.log(np.trace(s) / d))
    factor = 1 - (2 * d * d + d + 2) / (6 * d * (b - 1))
    chi2, df = -(b - 1) * factor * log_w, d * (d + 1) // 2 - 1
    p = _mauchly_p(max(chi2, 0.0), d, b - 1, factor)
    return SphericityResult(math.exp(log_w), chi2, df, p, gg, hf)


def _mauchly_p(chi2: float, d: int, n: int, rho: float) -> float:
    """P with the second term of the expansion (Anderson 2003, section 10.7.4)."""
    from scipy.special import chdtrc

    df = d * (d + 1) // 2 - 1
    top = (d + 2) * (d - 1) * (d - 2) * (2 * d**3 + 6 * d**2 + 3 * d + 2)
    second = top / (288 * (n * d * rho) ** 2)
    first = float(chdtrc(df, chi2))
    return min(1.0, max(0.0, first + second * (float(chdtrc(df + 4, chi2)) - first)))
