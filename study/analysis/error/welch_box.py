"""Groups of blocks with covariances of their own: Welch's idea with Box's degrees of freedom.

Blocks (specimens) belong to groups (mixes, batches). Every block gives the contrasts B' y of a
term; their covariance may differ between groups, so nothing is pooled over groups.

References: Box (1954), Ann. Math. Statist. 25, 290-302 (a quadratic form as a multiple of
chi-squared); Welch (1938), Biometrika 29, 350-362, and Satterthwaite (1946), Biometrics Bull.
2, 110-114 (degrees of freedom of a sum of variances); Greenhouse and Geisser (1959),
Psychometrika 24, 95-112, which is the case of one group.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.errors import Fault, InputError

#: a covariance of two blocks has one degree of freedom: smaller groups are pooled
LEAST_OWN = 3


@dataclass(frozen=True)
class WelchBox:
    """Test that a vector of contrasts is zero.

    Parameters
    ----------
    f : float or None
        theta' theta / tr V; None where nothing varies.
    df1, df2 : float or None
        Degrees of freedom of the approximation.
    p : float or None
        Upper tail of F.
    pooled : bool
        Whether a group has two blocks only, so that one covariance is used for all groups.
    """

    f: float | None
    df1: float | None
    df2: float | None
    p: float | None
    pooled: bool = False


@dataclass(frozen=True)
class WelchInterval:
    """Interval of one contrast over groups of blocks."""

    estimate: float
    standard_error: float
    df: float
    low: float
    high: float
    pooled: bool = False


def welch_box(groups: Sequence[Array], weights: Array | None = None) -> WelchBox:
    """Test weighted sums over groups of a term's mean contrasts.

    Parameters
    ----------
    groups : sequence of ndarray, shape (d, n_g)
        Orthonormal contrasts of the term in each block of each group, n_g >= 2.
    weights : ndarray, shape (G,) or (m, G), optional
        Weights of the groups; 1/G by default (the average effect). (1, -1) compares two groups;
        m orthonormal rows compare several at once.

    Returns
    -------
    WelchBox
        F, its degrees of freedom and p.

    Raises
    ------
    InputError
        For groups of fewer than two blocks, unequal numbers of contrasts, or missing values.

    Notes
    -----
    With S_g the covariance in group g, theta_i = sum_g w_ig mean_g and M the covariance of all
    theta: F = theta' theta / tr M, df1 = (tr M)^2 / tr M^2, df2 = df1 (tr M)^2 /
    sum_g [(sum_i w_ig^2)^2 (tr S_g)^2 / n_g^2 / (n_g - 1)]. One group is Greenhouse-Geisser.

    Examples
    --------
    >>> one = np.array([[1.0, 2.0, 4.0, 3.0]])
    >>> found = welch_box([one])
    >>> round(found.f, 4), round(found.df1, 4), round(found.df2, 4)
    (15.0, 1.0, 3.0)
    """
    _check(groups)
    w = np.full(len(groups), 1 / len(groups)) if weights is None else np.asarray(weights, float)
    w = np.atleast_2d(w)
    n = np.array([float(g.shape[1]) for g in groups])
    covariance, pooled = _covariances(groups)
    means = np.array([g.mean(axis=1) for g in groups])
    theta = w @ means
    # blocks of M are sum_g w_ig w_jg S_g / n_g; a Kronecker product for each group
    m = sum(np.kron(np.outer(w[:, g], w[:, g]), covariance[g] / n[g]) for g in range(len(groups)))
    trace = float(np.trace(m))
    if not trace > 0:
        return WelchBox(None, None, None, None, pooled)
    traces = np.array([float(np.trace(s)) for s in covariance])
    df1 = trace**2 / float(np.sum(m * m))
    share = (w**2).sum(axis=0) * traces / n
    if pooled:  # one covariance with the degrees of freedom of all groups
        below = float(share.sum()) ** 2 / float((n - 1).sum())
    else:
        below = float(np.sum(share**2 / (n - 1)))
    df2 = df1 * trace**2 / below
    f = float(np.sum(theta**2)) / trace
    return WelchBox(f, df1, df2, _tail(df1, df2, f), pooled)


def welch_interval(
    groups: Sequence[Array], weights: Array | None = None, *, alpha: float = 0.05
) -> WelchInterval:
    """Interval of one contrast with its own variance in each group.

    Parameters
    ----------
    groups : sequence of ndarray, shape (n_g,)
        The contrast in each block of each group.
    weights : ndarray, shape (G,), optional
        Weights of the groups; 1/G by default.
    alpha : float
        One minus the coverage.

    Returns
    -------
    WelchInterval
        Estimate, standard error, Welch's degrees of freedom and interval.

    Raises
    ------
    InputError
        As :func:`welch_box`.
    """
    from scipy.special import stdtrit

    rows = [np.atleast_2d(np.asarray(g, float)) for g in groups]
    found = welch_box(rows, weights)
    w = np.full(len(rows), 1 / len(rows)) if weights is None else np.asarray(weights, float)
    centre = float(sum(wg * g.mean() for wg, g in zip(w, rows, strict=True)))
    if found.df2 is None:
        return WelchInterval(centre, 0.0, float("inf"), centre, centre, found.pooled)
    covariance, pooled = _covariances(rows)
    variance = sum(
        wg**2 * float(s[0, 0]) / g.shape[1] for wg, s, g in zip(w, covariance, rows, strict=True)
    )
    error = float(np.sqrt(variance))
    half = float(stdtrit(found.df2, 1 - alpha / 2)) * error
    return WelchInterval(centre, error, found.df2, centre - half, centre + half, pooled)


def _covariances(groups: Sequence[Array]) -> tuple[list[Array], bool]:
    """Covariance of every group; one pooled covariance where a group has two blocks only."""
    own = [np.atleast_2d(np.cov(g)) for g in groups]
    if len(groups) == 1 or min(g.shape[1] for g in groups) >= LEAST_OWN:
        return own, False
    df = np.array([g.shape[1] - 1.0 for g in groups])
    pooled = np.tensordot(df, np.array(own), axes=1) / df.sum()
    return [pooled] * len(groups), True


def _tail(df1: float, df2: float, f: float) -> float:
    from scipy.special import fdtrc

    return float(fdtrc(df1, df2, f))


def _check(groups: Sequence[Array]) -> None:
    faults = []
    if not groups:
        faults.append(Fault("groups", "no group of blocks given"))
    for i, g in enumerate(groups):
        if g.ndim != 2 or g.shape[1] < 2:
            rule = f"needs at least two blocks, got shape {g.shape}"
            faults.append(Fault(f"group {i + 1}", rule, "run more blocks or merge groups"))
        elif not np.isfinite(g).all():
            faults.append(Fault(f"group {i + 1}", "a value is missing", "leave its block out"))
    if not faults and len({g.shape[0] for g in groups}) > 1:
        faults.append(Fault("groups", "all groups need the same contrasts"))
    if faults:
        raise InputError(faults)
