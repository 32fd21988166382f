"""Normality of residuals: Ryan-Joiner as Minitab prints it, and exact for the design."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from study.analysis.linear_model.factorization import span
from study.analysis.linear_model.sums_of_squares import one_thread
from study.arrays import Array

SCORES = "Phi^-1((r - 3/8)/(n + 1/4)), tied values share the average rank"
_ALPHAS = (0.10, 0.05, 0.01)
_CRITICAL = (
    (1.0071, -0.1371, -0.3682, 0.7780),
    (1.0063, -0.1288, -0.6118, 1.3505),
    (0.9963, -0.0211, -1.4106, 3.1791),
)
_MAX_SIMULATIONS = 100_000
_MAX_NUMBERS = 3e7
_MAX_NUMBERS_OF_MANY = 5e6
_MANY_VALUES = 1000


@dataclass(frozen=True)
class RyanJoinerResult:
    """Ryan-Joiner test.

    Parameters
    ----------
    rj : float or None
        Correlation of the sorted data with normal scores; None where not applicable.
    n : int
        Number of values.
    p_minitab : str or None
        p from the published critical values, printed as Minitab does.
    p_exact : float or None
        p by simulation of this very design; it decides.
    """

    rj: float | None
    n: int
    p_minitab: str | None
    p_exact: float | None
    simulations: int
    seed: int
    applicable: bool
    reason: str
    decision: str
    warning: str = ""
    scores: str = SCORES

    def to_json(self) -> dict[str, object] | None:
        """JSON document; None where the test does not apply."""
        if not self.applicable:
            return None
        return {
            "rj": self.rj,
            "n": self.n,
            "p_minitab": self.p_minitab,
            "p_exact": self.p_exact,
            "simulations": self.simulations,
            "seed": self.seed,
            "decision": self.decision,
        }


@dataclass(frozen=True)
class NormalityResult:
    """A test of normality by name (Anderson-Darling or Shapiro-Wilk)."""

    name: str
    statistic: float | None
    p: float | None
    reason: str = ""


def critical_values(n: int) -> tuple[float, float, float]:
    """Critical values of RJ at 10, 5 and 1 % (Ryan and Joiner 1976).

    Parameters
    ----------
    n : int
        Number of values, at least 4.

    Examples
    --------
    >>> round(critical_values(10)[1], 10)
    0.9178948637
    """
    powers = (1.0, 1 / math.sqrt(n), 1 / n, 1 / n**2)
    values = [sum(c * x for c, x in zip(row, powers, strict=True)) for row in _CRITICAL]
    return values[0], values[1], values[2]


def minitab_p(rj: float, n: int) -> str:
    """P by linear interpolation between the critical values, as Minitab prints it.

    Parameters
    ----------
    rj : float
        Observed statistic, at most 1.
    n : int
        Number of values.

    Returns
    -------
    str
        ``"> 0.100"``, ``"< 0.010"``, or three decimals between them.
    """
    c10, c05, c01 = critical_values(n)
    if rj > c10:
        return "> 0.100"
    if rj < c01:
        return "< 0.010"
    return f"{float(np.interp(rj, (c01, c05, c10), _ALPHAS[::-1])):.3f}"


def statistic(values: ArrayLike) -> float:
    """RJ of ``values``: Pearson correlation with the normal scores of their average ranks.

    Parameters
    ----------
    values : array_like, shape (n,)
        Data or residuals, finite and not all equal.

    Examples
    --------
    >>> weights = [148, 154, 158, 160, 161, 162, 166, 170, 182, 195, 236]
    >>> round(statistic(weights), 10)
    0.8782835189
    """
    from scipy.stats import rankdata

    x = np.asarray(values, dtype=float)
    return _correlation(x - x[0], _scores(rankdata(x), x.size))


def _scores(ranks: ArrayLike, n: int) -> Array:
    from scipy.special import ndtri

    return np.asarray(ndtri((np.asarray(ranks, float) - 0.375) / (n + 0.25)))


def _correlation(x: Array, b: Array) -> float:
    x, b = x - x.mean(), b - b.mean()
    return min(1.0, float(x @ b) / math.sqrt(float(x @ x) * float(b @ b)))


@one_thread
def ryan_joiner(
    values: ArrayLike,
    *,
    model_matrix: Array | None = None,
    seed: int = 2011,
    exact: bool = True,
    alpha: float = 0.05,
    simulations: int | None = None,
) -> RyanJoinerResult:
    """Ryan-Joiner test of data, or of the residuals of a linear model.

    Parameters
    ----------
    values : array_like, shape (n,)
        Data or residuals.
    model_matrix : ndarray, shape (n, p), optional
        Model whose residuals ``values`` are; without it the values are a plain sample.
    seed : int
        Seed of the simulation.
    exact : bool
        Whether to simulate ``p_exact``.
    alpha : float
        Size of the test, to which the simulated p is made exact.
    simulations : int, optional
        Number of simulated samples; as many as ``alpha`` needs by default.

    Returns
    -------
    RyanJoinerResult
        Statistic, Minitab's p, exact p.

    Notes
    -----
    RJ is free of location and scale, so its null distribution for residuals is that of
    (I - H) z with z standard normal; p = (1 + #{r <= r_obs}) / (N + 1).
    """
    x = np.asarray(values, dtype=float)
    reason = _not_applicable(x, model_matrix)
    if reason:
        return RyanJoinerResult(
            None, int(x.size), None, None, 0, seed, False, reason, f"not applicable: {reason}"
        )
    n = int(x.size)
    basis = span(np.ones((n, 1)) / math.sqrt(n) if model_matrix is None else _unit(model_matrix))
    rj = statistic(x)
    count = simulations or default_simulations(n)
    p_exact = exact_p(rj, basis, count, seed) if exact else None
    p_text = minitab_p(rj, n)
    df = n - basis.shape[1]
    warning = f"Ryan-Joiner on {df} residual degrees of freedom has little power" if df < 8 else ""
    return RyanJoinerResult(
        rj,
        n,
        p_text,
        p_exact,
        count if exact else 0,
        seed,
        True,
        "",
        _decision(p_text, p_exact, alpha),
        warning,
    )


def default_simulations(n: int) -> int:
    """Give the number of simulated designs of the exact p.

    min(100,000, 3e7 / n) up to 1,000 values; 5e6 / n beyond, 1,000 of 5,000 values, in 0.3 s:
    a p of 0.05 then has a standard error of 0.007.

    Parameters
    ----------
    n : int
        Number of values in a design.
    """
    numbers = _MAX_NUMBERS if n <= _MANY_VALUES else _MAX_NUMBERS_OF_MANY
    return int(min(_MAX_SIMULATIONS, numbers / n))


def _unit(matrix: Array) -> Array:
    length = np.linalg.norm(matrix, axis=0)
    return np.asarray(matrix / np.where(length == 0, 1.0, length))


def _not_applicable(x: Array, matrix: Array | None) -> str:
    if not np.all(np.isfinite(x)):
        return "a value is missing"
    if x.size < 4:
        return f"the Ryan-Joiner test needs n >= 4, got n = {x.size}"
    spread = float(x.max() - x.min())
    if spread <= 64 * float(np.spacing(float(np.abs(x).max()))):
        return "the values are all equal"
    if matrix is not None and span(_unit(matrix)).shape[1] >= x.size:
        return "no residual degrees of freedom"
    return ""


def _decision(p_text: str, p_exact: float | None, alpha: float) -> str:
    if p_exact is not None:
        rejected = p_exact < alpha
        how = f"exact p = {p_exact:.3g}"
    else:
        rejected = p_text.startswith("<") or (not p_text.startswith(">") and float(p_text) < alpha)
        how = f"p {p_text}"
    return f"normality {'rejected' if rejected else 'not rejected'} at {alpha:g} ({how})"


def exact_p(rj: float, basis: Array, simulations: int, seed: int) -> float:
    """Exact p of ``rj`` among residuals of standard normal data.

    Parameters
    ----------
    rj : float
        Observed statistic.
    basis : ndarray, shape (n, p)
        Orthonormal basis of the model.
    simulations : int
        Number of simulated designs.
    seed : int
        Seed of the simulation.
    """
    below = sum(int(np.count_nonzero(chunk <= rj)) for chunk in null_rj(basis, simulations, seed))
    return (1 + below) / (simulations + 1)


def null_rj(basis: Array, simulations: int, seed: int) -> Iterator[Array]:
    """RJ of the residuals of standard normal data, in pieces that fit the memory.

    Parameters
    ----------
    basis : ndarray, shape (n, p)
        Orthonormal basis of the model.
    simulations : int
        Number of simulated samples of n values.
    seed : int
        Seed of the simulation.

    Yields
    ------
    ndarray, shape (m,)
        RJ of m samples; the pieces hold ``simulations`` values together.
    """
    n = basis.shape[0]
    rng = np.random.default_rng(seed)
    chunk = max(1, int(2e6 // n))
    for start in range(0, simulations, chunk):
        yield simulated_rj(rng.standard_normal((min(chunk, simulations - start), n)), basis)


def simulated_rj(z: Array, basis: Array) -> Array:
    """RJ of the residuals of each row of ``z``, shape (m,).

    Parameters
    ----------
    z : ndarray, shape (m, n)
        One sample of n values a row.
    basis : ndarray, shape (n, p)
        Orthonormal basis of the model.
    """
    n = z.shape[1]
    scores = _scores(np.arange(1, n + 1), n)
    residual = z - (z @ basis) @ basis.T
    residual -= residual.mean(axis=1, keepdims=True)
    residual.sort(axis=1)
    length = np.sqrt(np.einsum("ij,ij->i", residual, residual) * (scores @ scores))
    return np.asarray(residual @ scores / length)


def anderson_darling(values: ArrayLike) -> NormalityResult:
    """Anderson-Darling test, mean and variance estimated (D'Agostino and Stephens 1986, 4.9).

    Parameters
    ----------
    values : array_like, shape (n,)
        Data or residuals, n >= 8.

    Returns
    -------
    NormalityResult
        A squared, with the p of its value corrected for n; or the reason why there is none.
    """
    from scipy.special import log_ndtr

    x = np.sort(np.asarray(values, dtype=float))
    n = x.size
    if n < 8:
        return NormalityResult("Anderson-Darling", None, None, f"needs n >= 8, got n = {n}")
    reason = _not_applicable(x, None)
    if reason:
        return NormalityResult("Anderson-Darling", None, None, reason)
    centered = x - x[0]
    z = (centered - centered.mean()) / centered.std(ddof=1)
    i = np.arange(1, n + 1)
    # statsmodels' normal_ad takes the log of 1 - cdf, which is no number beyond 8.3 deviations
    a2 = float(-n - np.mean((2 * i - 1) * (log_ndtr(z) + log_ndtr(-z[::-1]))))
    a = a2 * (1 + 0.75 / n + 2.25 / n**2)
    return NormalityResult("Anderson-Darling", a2, _anderson_p(a))


def _anderson_p(a: float) -> float:
    # far out the quadratic in the exponent would turn upward
    if a >= 10:
        return 0.0
    if a >= 0.6:
        return math.exp(1.2937 - 5.709 * a + 0.0186 * a * a)
    if a > 0.34:
        return math.exp(0.9177 - 4.279 * a - 1.38 * a * a)
    if a > 0.2:
        return 1 - math.exp(-8.318 + 42.796 * a - 59.938 * a * a)
    return 1 - math.exp(-13.436 + 101.14 * a - 223.73 * a * a)


def shapiro_wilk(values: ArrayLike) -> NormalityResult:
    """Shapiro-Wilk test, guarded: scipy calls constant data perfectly normal.

    Parameters
    ----------
    values : array_like, shape (n,)
        Data or residuals, 3 <= n <= 5000.

    Returns
    -------
    NormalityResult
        W and p; or the reason why there is none.
    """
    x = np.asarray(values, dtype=float)
    reason = "needs n >= 3" if x.size < 3 else _not_applicable(np.r_[x, x], None)
    if reason:
        return NormalityResult("Shapiro-Wilk", None, None, reason)
    if x.size > 5000:
        return NormalityResult("Shapiro-Wilk", None, None, "p is not accurate beyond n = 5000")
    from scipy.stats import shapiro

    # scipy takes a range below 1e-19 for none, whatever the unit
    result = shapiro((x - x[0]) / np.ptp(x))
    return NormalityResult("Shapiro-Wilk", float(result.statistic), float(result.pvalue))
