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

from study.arrays import Array

#: significance of the verdicts here
ALPHA = 0.05


@dataclass(frozen=True)
class Repeated:
    """Residuals of one averaged curve and the scatter of the repeats it averages.

    Parameters
    ----------
    residual : ndarray, shape (n,)
        Weighted residual of the mean.
    scatter : ndarray, shape (n,)
        Standard deviation of the repeats, times the same weights.
    repeats : int
        How many were averaged; at least two.
    """

    residual: Array
    scatter: Array
    repeats: int


@dataclass(frozen=True)
class LackOfFit:
    """Comparison of what the model misses with what repeats scatter.

    Parameters
    ----------
    statistic : float
        F: mean square of the misses over the mean square of pure error.
    df, df_error : int
        Degrees of freedom where every point is an independent error.
    p_independent, p_dependent : float
        p where every point is one, and where every curve is one.
    verdict : str
        ``lack-of-fit``, ``adequate``, or ``undecided`` where the two disagree.
    """

    statistic: float
    df: int
    df_error: int
    p_independent: float
    p_dependent: float
    verdict: Literal["lack-of-fit", "adequate", "undecided"]


@dataclass(frozen=True)
class Pattern:
    """Order in the residuals along the curves.

    Parameters
    ----------
    lag1 : float
        Correlation of neighboring residuals; near 0 where only noise is left.
    runs, expected_runs : float
        Runs of equal sign, and how many independent residuals would show.
    p : float
        Two-sided p of the runs test (Wald and Wolfowitz 1940), normal approximation.
    """

    lag1: float
    runs: int
    expected_runs: float
    p: float


def lack_of_fit(curves: Sequence[Repeated], parameters: int) -> LackOfFit | None:
    """F test of lack of fit against the pure error of repeats (Draper and Smith 1998, 2.1).

    Parameters
    ----------
    curves : sequence of Repeated
        The fitted curves that average repeats.
    parameters : int
        Constants fitted.

    Returns
    -------
    LackOfFit or None
        None where nothing was repeated, or there are no degrees of freedom.
    """
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


def pattern(residuals: Sequence[Array]) -> Pattern | None:
    """Pattern of the residuals along each curve; None below eight points.

    Parameters
    ----------
    residuals : sequence of ndarray
        One array a curve, in the order of the displacements.
    """
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
    return Pattern(lag1, runs, expected, p)


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

    Parameters
    ----------
    aicc : mapping of str to float
        By the name of the model. One that is not finite gets 0; all get NaN where none is finite.

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

    Parameters
    ----------
    pooled_rss, own_rss : float
        Sum of squares with common constants, and with own ones in each group, added up.
    n : float
        Points, or what correlated ones are worth.
    p, groups : int
        Constants of one group, and groups.
    """
    extra, left = p * (groups - 1), n - p * groups
    if extra <= 0 or left <= 0 or own_rss <= 0:
        return None
    from scipy.special import fdtrc

    return float(fdtrc(extra, left, max(pooled_rss - own_rss, 0.0) / extra / (own_rss / left)))
