"""Normality of residuals: Ryan-Joiner as Minitab prints it, and exact for the design."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import ArrayLike

from study.ground.arrays import Array, chunks, one_thread
from study.ground.errors import Fault, InputError
from study.ground.units import p_phrase
from study.statistics.analysis.comparisons import holm
from study.statistics.analysis.linear_model import (
    CellLayout,
    Term,
    balanced,
    products,
    span,
    term_name,
)

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
#: decimals of the range to which values that agree are ties
_TIED = 10


@dataclass(frozen=True)
class RyanJoinerResult:
    """Ryan-Joiner test."""

    #: Correlation of the sorted data with normal scores; None where not applicable.
    rj: float | None
    n: int
    #: p from the published critical values, printed as Minitab does.
    p_minitab: str | None
    #: p by simulation of this very design; it decides.
    p_exact: float | None
    simulations: int
    seed: int
    reason: str
    decision: str
    warning: str = ""

    @property
    def applicable(self) -> bool:
        """Whether there is no reason against the test."""
        return not self.reason

    def to_json(self) -> dict[str, object] | None:
        """JSON document; None where the test does not apply."""
        if not self.applicable:
            return None
        keys = ("rj", "n", "p_minitab", "p_exact", "simulations", "seed", "decision")
        return {key: getattr(self, key) for key in keys}


@dataclass(frozen=True)
class NormalityResult:
    """A test of normality by name (Anderson-Darling or Shapiro-Wilk)."""

    name: str
    statistic: float | None
    p: float | None
    reason: str = ""


def critical_values(n: int) -> tuple[float, float, float]:
    """Critical values of RJ at 10, 5 and 1 % (Ryan and Joiner 1976).

    Examples
    --------
    >>> round(critical_values(10)[1], 10)
    0.9178948637
    """
    powers = (1.0, 1 / math.sqrt(n), 1 / n, 1 / n**2)
    values = [sum(c * x for c, x in zip(row, powers, strict=True)) for row in _CRITICAL]
    return values[0], values[1], values[2]


def minitab_p(rj: float, n: int) -> str:
    """P by linear interpolation between the critical values, as Minitab prints it."""
    c10, c05, c01 = critical_values(n)
    if rj > c10:
        return "> 0.100"
    if rj < c01:
        return "< 0.010"
    return f"{float(np.interp(rj, (c01, c05, c10), _ALPHAS[::-1])):.3f}"


def statistic(values: ArrayLike) -> float:
    """RJ of ``values``: Pearson correlation with the normal scores of their average ranks.

    Shapes: values (n,).

    Examples
    --------
    >>> weights = [148, 154, 158, 160, 161, 162, 166, 170, 182, 195, 236]
    >>> round(statistic(weights), 10)
    0.8782835189
    """
    from scipy.stats import rankdata

    x = np.asarray(values, dtype=float)
    x = x - x[0]
    # residuals of rounded readings are equal but for the rounding of the fit, and are ties
    scores = _scores(rankdata(np.round(x / np.ptp(x), _TIED)), x.size)
    scores, x = scores - scores.mean(), x - x.mean()
    return min(1.0, float(x @ scores) / math.sqrt(float(x @ x) * float(scores @ scores)))


def _scores(ranks: ArrayLike, n: int) -> Array:
    from scipy.special import ndtri

    return np.asarray(ndtri((np.asarray(ranks, float) - 0.375) / (n + 0.25)))


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
        decision = f"not applicable: {reason}"
        return RyanJoinerResult(None, int(x.size), None, None, 0, seed, reason, decision)
    n = int(x.size)
    basis = span(np.ones((n, 1)) / math.sqrt(n) if model_matrix is None else _unit(model_matrix))
    rj = statistic(x)
    count = simulations or default_simulations(n)
    p_exact = None
    if exact:
        p_exact = (1 + int(np.count_nonzero(null_rj(basis, count, seed) <= rj))) / (count + 1)
    p_text = minitab_p(rj, n)
    df = n - basis.shape[1]
    warning = f"Ryan-Joiner on {df} residual degrees of freedom has little power" if df < 8 else ""
    decision = _decision(p_text, p_exact, alpha)
    return RyanJoinerResult(
        rj, n, p_text, p_exact, count if exact else 0, seed, "", decision, warning
    )


def default_simulations(n: int) -> int:
    """Give the number of simulated designs of the exact p.

    min(100,000, 3e7 / n) up to 1,000 values; 5e6 / n beyond, 1,000 of 5,000 values, in 0.3 s:
    a p of 0.05 then has a standard error of 0.007.
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
        how = f"exact {p_phrase(p_exact)}"
    else:
        rejected = p_text.startswith("<") or (not p_text.startswith(">") and float(p_text) < alpha)
        how = f"p {p_text}"
    return f"normality {'rejected' if rejected else 'not rejected'} at {alpha:g} ({how})"


def null_rj(basis: Array, simulations: int, seed: int) -> Array:
    """RJ of the residuals of standard normal data, in pieces that fit the memory.

    Shapes: basis (n, p); returns (simulations,).
    """
    n = basis.shape[0]
    rng = np.random.default_rng(seed)
    sizes = chunks(simulations, 2e6 // n)
    return np.concatenate([simulated_rj(rng.standard_normal((m, n)), basis) for m in sizes])


def simulated_rj(z: Array, basis: Array) -> Array:
    """RJ of the residuals of each row of ``z``, shape (m,).

    Shapes: z (m, n); basis (n, p).
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

    Shapes: values (n,).
    """
    from scipy.stats import anderson

    x = np.asarray(values, dtype=float)
    n = x.size
    reason = f"needs n >= 8, got n = {n}" if n < 8 else _not_applicable(x, None)
    if reason:
        return NormalityResult("Anderson-Darling", None, None, reason)
    # statsmodels' normal_ad takes the log of 1 - cdf, which is no number beyond 8.3 deviations
    a2 = float(anderson((x - x[0]) / np.ptp(x), "norm", method="interpolate").statistic)
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

    Shapes: values (n,).
    """
    x = np.asarray(values, dtype=float)
    reason = "needs n >= 3" if x.size < 3 else _not_applicable(np.r_[x, x], None)
    if x.size > 5000:
        reason = reason or "p is not accurate beyond n = 5000"
    if reason:
        return NormalityResult("Shapiro-Wilk", None, None, reason)
    from scipy.stats import shapiro

    # scipy takes a range below 1e-19 for none, whatever the unit
    result = shapiro((x - x[0]) / np.ptp(x))
    return NormalityResult("Shapiro-Wilk", float(result.statistic), float(result.pvalue))


# -------------------------------------------------------------------------------------------------
# Normality of the contrasts that a blocked analysis tests, one row of values a contrast.
#
# Residuals pooled over terms are no sample: their variances differ between terms, which looks
# like heavy tails (simulated: a size of .74 to .99 on non-spherical normal data). One contrast
# over the blocks is independent and identically distributed whatever the covariances, so its
# Ryan-Joiner p is exact. The contrasts are those of a fixed Helmert basis: principal components
# would be chosen by the data.

#: below this many blocks a test that does not reject says little
FEW_BLOCKS = 9
#: residual degrees of freedom that the Ryan-Joiner test needs (4 values about their mean)
_LEAST_DF = 3
#: two contrasts of this correlation are one
_DUPLICATE = 1 - 1e-9
#: numbers simulated at once for the share of a block: 4 MB
_NUMBERS_AT_ONCE = 500_000
#: numbers simulated at most: 2,000 studies of 25,000 numbers, fewer of larger ones
_MOST_NUMBERS = 50_000_000
#: normals drawn at most with the rows themselves as root, blocks by blocks a study: 224 blocks
_MOST_NORMALS = 100_000_000
#: studies simulated at most, and at least: a p of .05 then has a standard error of .01
_MOST_DRAWS = 2000
_FEWEST_DRAWS = 500


@dataclass(frozen=True)
class RowTest:
    """Ryan-Joiner test of one contrast over the blocks."""

    term: str
    contrast: int
    rj: float
    p: float
    p_holm: float


@dataclass(frozen=True)
class RowNormality:
    """Tests of all contrasts; the smallest p decides, adjusted for their number."""

    #: One for each contrast that varies.
    rows: tuple[RowTest, ...]
    blocks: int
    #: Probability of a p as small as the smallest among so many independent ones (Sidak 1967, J.
    #: Am. Stat. Assoc. 62, 626); None where there is no test.
    p: float | None
    #: Whether normality is rejected; the rows of small ``p_holm`` are those to look at.
    rejected: bool
    #: What non-rejection is worth, or why there is no test.
    warning: str = ""


@dataclass(frozen=True)
class BlockShare:
    """The block that carries the most of the interaction."""

    block: int
    #: Its part of the squares, averaged over the standardized contrasts.
    share: float
    #: Part of simulated normal studies whose largest share is as large; a caution, no test that
    #: decides.
    p: float


def helmert_contrasts(layout: CellLayout, terms: Sequence[Term], y: Array) -> dict[str, Array]:
    """Contrasts of every term in every block.

    Shapes: y (cells, blocks); returns (df, blocks).
    """
    factors = tuple(layout.levels)
    if not balanced(layout, factors) or layout.n != y.shape[0]:
        rule = "every combination of levels is needed once"
        raise InputError(Fault("cells", rule, "average repeats, leave out incomplete levels"))
    contrasts = {}
    for term in terms:
        coded = {f: scipy.linalg.helmert(k).T if f in term else np.full((k, 1), k**-0.5)
                 for f, k in ((f, len(layout.levels[f])) for f in factors)}  # fmt: skip
        contrasts[term_name(term)] = products(layout, coded).T @ (y - y[0, 0])
    return contrasts


def row_normality(
    contrasts: Mapping[str, Array], *, tolerance: float = 0.0, alpha: float = 0.05, seed: int = 2011
) -> RowNormality:
    """Test the normality of every contrast over the blocks.

    Shapes: contrasts (df, b).

    Examples
    --------
    >>> rows = np.random.default_rng(1).standard_normal((3, 9))
    >>> row_normality({"A": rows[:1], "A:B": rows[1:]}).rejected
    False
    """
    names, rows = _rows(contrasts, tolerance)
    blocks = next(iter(contrasts.values())).shape[1] if contrasts else 0
    if blocks - 1 < _LEAST_DF:
        why = f"the Ryan-Joiner test needs more blocks, got {blocks}"
        return RowNormality((), blocks, None, False, why)
    if not names:
        return RowNormality((), blocks, None, False, "no contrast varies over the blocks")
    rj = simulated_rj(rows, _mean_basis(blocks))
    null = _null(blocks, seed)
    p = (1 + np.searchsorted(null, rj, side="right")) / (null.size + 1)
    adjusted = holm(p)
    together = -math.expm1(p.size * math.log1p(-float(p.min()))) if p.min() < 1 else 1.0
    tests = tuple(
        RowTest(term, index, float(r), float(raw), float(both))
        for (term, index), r, raw, both in zip(names, rj, p, adjusted, strict=True)
    )
    few = f"only {blocks} blocks: the power is small, and a non-rejection says little"
    warning = few if blocks < FEW_BLOCKS else ""
    return RowNormality(tests, blocks, together, together < alpha, warning)


def block_share(
    contrasts: Mapping[str, Array], *, tolerance: float = 0.0, seed: int = 2011
) -> BlockShare | None:
    """Find the block that carries the most of the interaction with the blocks."""
    _, rows = _rows(contrasts, tolerance)
    if rows.shape[0] == 0:
        return None
    blocks = rows.shape[1]
    basis = _mean_basis(blocks)
    share = _shares(rows)
    root = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    draws = min(_MOST_DRAWS, max(_MOST_NUMBERS // rows.size, _FEWEST_DRAWS))
    if draws < _MOST_DRAWS or _MOST_DRAWS * blocks**2 > _MOST_NORMALS:
        # the smallest root of the same covariance: its normals take the longest
        root = np.asarray(np.linalg.qr(root.T, mode="r")).T
    top, above = float(share.max()), 0
    rng = np.random.default_rng(seed)
    for m in chunks(draws, _NUMBERS_AT_ONCE // (blocks * max(rows.shape[0], root.shape[1]))):
        normal = rng.standard_normal((m, root.shape[1], blocks))
        drawn = root @ normal
        largest = _shares(drawn - (drawn @ basis) @ basis.T).max(axis=-1)
        above += int(np.count_nonzero(largest >= top))
    return BlockShare(int(share.argmax()), top, (1 + above) / (draws + 1))


def _shares(rows: Array) -> Array:
    """Part of each block in the squares, averaged over rows, shape (..., b)."""
    squares = rows**2
    return np.asarray((squares / squares.sum(axis=-1, keepdims=True)).mean(axis=-2))


def _rows(contrasts: Mapping[str, Array], tolerance: float) -> tuple[list[tuple[str, int]], Array]:
    """Rows about their means that vary, each once, with their term and number."""
    names: list[tuple[str, int]] = []
    varying: list[Array] = []
    for term, values in contrasts.items():
        basis = _mean_basis(values.shape[1])
        floor = max(10 * tolerance, 1e-12 * float(np.abs(values).max(initial=0.0)))
        rows = values - (values @ basis) @ basis.T
        for index in np.flatnonzero(np.linalg.norm(rows, axis=1) > floor):
            names.append((term, int(index)))
            varying.append(rows[index])
    if not varying:
        return names, np.zeros((0, 0))
    rows = np.array(varying)
    heads, once = np.empty_like(rows), list[int]()
    for i, unit in enumerate(rows / np.linalg.norm(rows, axis=1, keepdims=True)):
        if not (np.abs(heads[: len(once)] @ unit) > _DUPLICATE).any():
            heads[len(once)] = unit
            once.append(i)
    return [names[i] for i in once], rows[once]


def _mean_basis(blocks: int) -> Array:
    """Direction of the mean over blocks, shape (b, 1)."""
    return np.full((blocks, 1), 1 / math.sqrt(blocks))


@lru_cache(maxsize=16)
def _null(blocks: int, seed: int) -> Array:
    """RJ of residuals of normal samples about their means, sorted."""
    return np.sort(null_rj(_mean_basis(blocks), default_simulations(blocks), seed))
