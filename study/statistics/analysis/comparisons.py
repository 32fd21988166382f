"""Pairwise comparisons of means with simultaneous intervals, adjusted p, and letters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations
from string import ascii_letters
from typing import overload

import numpy as np
from numpy.typing import ArrayLike

from study.ground.arrays import Array, Ints, chunks
from study.ground.canonical import Keyed
from study.ground.errors import Fault, InputError, nearest
from study.statistics.analysis.anova_table import Comparison
from study.statistics.analysis.simple_effects import CANNOT_TELL, Confidence, Differences, claim


@dataclass(frozen=True)
class Comparisons:
    """All comparisons of one family; groups that share a letter are not told apart."""

    method: str
    alpha: float
    pairs: tuple[Comparison, ...]
    letters: dict[str, str]
    is_ratio: bool = False

    @property
    def effect(self) -> str:
        """What a pair is compared by: ``"difference"``, or ``"ratio"`` of a log response."""
        return "ratio" if self.is_ratio else "difference"

    def as_ratios(self) -> Comparisons:
        """Copy with differences of logarithms as ratios."""
        ends = ((pair, map(math.exp, (pair.difference, pair.lower, pair.upper)))
                for pair in self.pairs)  # fmt: skip
        pairs = (replace(pair, difference=d, lower=a, upper=b) for pair, (d, a, b) in ends)
        return replace(self, pairs=tuple(pairs), is_ratio=True)


@dataclass(frozen=True)
class GroupMoments:
    """Name, size, mean and variance of some groups."""

    names: tuple[str, ...]
    n: Array
    mean: Array
    variance: Array

    @property
    def pooled(self) -> tuple[float, float]:
        """Pooled variance and its degrees of freedom."""
        df = float((self.n - 1).sum())
        return float((self.n - 1) @ self.variance) / df, df

    def one_way(self, *, equal: bool) -> dict[str, float]:
        """F test of equal means: with one variance, or one for each group (Welch 1951)."""
        from statsmodels.stats.oneway import anova_generic

        variances = "equal" if equal else "unequal"
        test = anova_generic(self.mean, self.variance, self.n, variances)
        values = (test.statistic, test.df_num, test.df_denom, test.pvalue)
        return dict(zip(("f", "df", "df_error", "p"), map(float, values), strict=True))

    def pairs(self, alpha: float, *, equal: bool) -> Comparisons:
        """All pairs by the studentized range: Tukey and Kramer's, or Games and Howell's."""
        (ms, df), k, pairs = self.pooled, len(self.names), []
        share = (np.full(k, ms) if equal else self.variance) / self.n
        for i, j in combinations(range(k), 2):
            square = float(share[i] + share[j])
            if not equal:
                parts = share[[i, j]]
                df = square**2 / float(np.sum(parts**2 / (self.n[[i, j]] - 1)))
            error, d = math.sqrt(square / 2), float(self.mean[i] - self.mean[j])
            half = studentized_range_quantile(1 - alpha, k, df) * error
            p = 1 - studentized_range_cdf(abs(d) / error, k, df)
            names = self.names[i], self.names[j]
            pairs.append(Comparison(*names, d, d - half, d + half, p=p))
        method = "Tukey-Kramer" if equal else "Games-Howell"
        apart = (x for x in pairs if x.p is not None and x.p < alpha)
        different = {frozenset((x.first, x.second)) for x in apart}
        ordered = [self.names[i] for i in np.argsort(-self.mean, kind="stable")]
        return Comparisons(method, alpha, tuple(pairs), letters(ordered, different))


def holm(p: ArrayLike) -> Array:
    """Holm's adjusted p (m,) of a family (Holm 1979).

    Examples
    --------
    >>> holm([0.01, 0.04, 0.03]).tolist()
    [0.03, 0.06, 0.06]
    """
    # the same products as statsmodels.stats.multitest, which collects garbage at every call
    values = np.asarray(p, dtype=float)
    order = np.argsort(values)
    steps = np.maximum.accumulate(values[order] * np.arange(values.size, 0, -1))
    adjusted = np.empty_like(values)
    adjusted[order] = np.minimum(steps, 1.0)
    return adjusted


def letters(names: Sequence[str], different: set[frozenset[str]]) -> dict[str, str]:
    """Compact letter display by insert and absorb (Piepho 2004, JCGS 13, 456-466).

    Examples
    --------
    >>> letters(["a", "b", "c"], {frozenset(("a", "c"))})
    {'a': 'a', 'b': 'ab', 'c': 'b'}
    """
    columns = [set(names)]
    for pair in sorted(different, key=sorted):
        first, second = sorted(pair)
        split: list[set[str]] = []
        for column in columns:
            if first in column and second in column:
                split += [column - {first}, column - {second}]
            else:
                split.append(column)
        distinct = [c for i, c in enumerate(split) if c not in split[:i]]
        columns = [c for c in distinct if not any(c < other for other in distinct)]
    columns.sort(key=lambda c: [names.index(n) for n in names if n in c])
    tags = [ascii_letters[i] if i < 52 else f"({i})" for i in range(len(columns))]
    return {n: "".join(tag for tag, c in zip(tags, columns, strict=True) if n in c) for n in names}


_legendre = lru_cache(maxsize=4)(np.polynomial.legendre.leggauss)


#: degrees of freedom from which a sum over s is its value at 1 in every digit
_NORMAL = 1e14

#: half the degrees of freedom from which Stirling's series has every digit
_STIRLING = 25.0


@lru_cache(maxsize=256)
def scale_rule(df: float, end: float = math.inf) -> tuple[Array, Array]:
    """Nodes and weights of expectations over s = sqrt(chi2_df / df), up to infinite ``df``.

    Of functions that are zero from ``end`` on, where they have a kink, the rule ends there.
    """
    from scipy.special import gammainccinv, gammaincinv, gammaln

    if df > _NORMAL:
        return np.ones(1), np.ones(1) * (end > 1)
    a = df / 2
    low = math.sqrt(2 * float(gammaincinv(a, 1e-14)) / df)
    high = min(math.sqrt(2 * float(gammainccinv(a, 1e-14)) / df), max(end, low))
    nodes, weights = _legendre(128)
    s = low + (high - low) * (nodes + 1) / 2
    if a < _STIRLING:
        log_density = a * math.log(a) - float(gammaln(a)) + (df - 1) * np.log(s) - df * s**2 / 2
    else:
        # a ln a - ln Gamma(a) and df ln s are differences of numbers as large as df: taken together
        # with a, what is left of both is small (Abramowitz and Stegun 1964, 6.1.41)
        rest = 1 / (12 * a) - 1 / (360 * a**3) + 1 / (1260 * a**5) - 1 / (1680 * a**7)
        bent = np.log1p(s - 1) - (s - 1) - (s - 1) ** 2 / 2
        log_density = 0.5 * math.log(a / (2 * math.pi)) - rest + df * bent - np.log(s)
    return s, np.asarray(weights * (high - low) * np.exp(log_density))


def studentized_range_cdf(q: float, k: int, df: float) -> float:
    """P(studentized range of ``k`` means with ``df`` <= q) (Tukey 1953; Copenhaver 1988)."""
    from scipy.special import ndtr

    if q <= 0:
        return 0.0
    s, weights = scale_rule(float(df))
    # P(range of k standard normals <= w) = k int phi(z) (Phi(z) - Phi(z - w))^(k-1) dz
    nodes, node_weights = _legendre(96)
    z = 9.0 * nodes
    density = 9.0 * node_weights * np.exp(-0.5 * z**2) / math.sqrt(2 * math.pi)
    inner = ndtr(z) - ndtr(z - (q * s)[:, None])
    return min(1.0, float((k * (inner ** (k - 1)) @ density) @ weights))


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


# -------------------------------------------------------------------------------------------------
# Simultaneous intervals of many contrasts, each with its own variance over blocks.
#
# The multiplier is the quantile of the largest |t| of all contrasts, simulated from normal blocks
# that have the covariance of the observed ones (parametric bootstrap; Westfall and Young 1993,
# Resampling-Based Multiple Testing, chapter 2). Neither sphericity nor equal variances is needed.

#: Draws of the largest |t|; 2,000 give its .96 quantile to about 3 %.
DRAWS = 4000
#: Quantile taken for an error of .05: the plug-in covariance makes the .95 quantile slightly
#: liberal (coverage .914 to .970 simulated at .95, .949 to .960 at .96).
SHARPER = 0.8
#: With fewer blocks their covariance is too unsure to be simulated from: Bonferroni instead.
FEWEST_BLOCKS = 5
#: Blocks beyond which their covariance is factored first; below, that saves nothing.
MANY_BLOCKS = 9
#: From this number of blocks on, contrasts share nothing of their variances that would show.
ASYMPTOTIC_BLOCKS = 50
#: Values held at once by a simulation: 4 MB, which stay in the cache of one core.
_AT_ONCE = 500_000
#: Twice the numbers that are kept for the next table of as many blocks: 32 MB.
_KEPT_DRAWS = 8_000_000


@overload
def t_quantile(upper: float, df: float) -> float: ...
@overload
def t_quantile(upper: float, df: Array) -> Array: ...
def t_quantile(upper: float, df: float | Array) -> float | Array:
    """Upper quantile of Student's t: Bonferroni's multiplier of m intervals at alpha / (2 m)."""
    from scipy.special import stdtrit

    quantile = stdtrit(df, 1 - upper)
    return np.asarray(quantile) if np.ndim(quantile) else float(quantile)


def two_sided(t: float, df: float) -> float:
    """Two-sided p of Student's t."""
    from scipy.special import stdtr

    return 2 * float(stdtr(df, -abs(t)))


def all_contrasts(k: int, df: float, alpha: float, *, by_block: bool) -> float | None:
    """Multiplier for all contrasts of k dimensions: Scheffe's with a pooled variance.

    Hotelling's where each contrast has its own variance ``by_block``; None of too few blocks.
    """
    from scipy.special import fdtri

    free = df + 1 - k if by_block else df
    return math.sqrt(k * df / free * float(fdtri(k, free, 1 - alpha))) if free > 0 else None


def block_multiplier(
    contrasts: Array, groups: Sequence[Ints], df: Array, confidence: Confidence
) -> Array:
    """Multipliers (m,) of the standard errors for simultaneous intervals of contrasts (m, b)."""
    (m, b), (alpha, seed) = contrasts.shape, confidence
    safe = t_quantile(alpha / (2 * max(m, 1)), df)
    if seed is None or m <= 1 or min(len(part) for part in groups) < FEWEST_BLOCKS:
        return safe
    blocks = [contrasts[:, part] for part in groups]
    # roots of the covariance of each group: z z' is their covariance
    z = np.concatenate(
        [(v - v.mean(axis=1, keepdims=True)) / math.sqrt(v.shape[1] - 1) for v in blocks], axis=1
    )
    spread = np.sqrt(np.sum(z**2, axis=1))
    z = z[spread > 1e-12 * spread.max(initial=0.0)]
    if not len(z):
        return safe
    z = np.unique((z / np.sqrt(np.sum(z**2, axis=1))[:, None]).round(9), axis=0)
    ends = np.cumsum([len(part) for part in groups])[:-1]
    if len(groups) == 1 and b >= ASYMPTOTIC_BLOCKS:
        largest = _largest_of_many(z, b, seed)
    else:
        largest = _largest_t(np.split(z, ends, axis=1), [len(part) for part in groups], seed)
    return np.minimum(safe, np.quantile(largest, 1 - SHARPER * alpha))


def _largest_t(roots: Sequence[Array], blocks: Sequence[int], seed: int) -> Array:
    """Largest |t| of all contrasts in each draw of blocks from N(0, z z') of each group.

    Of draws N of the blocks a contrast has the mean z'N and the variance z'NN'z, so that sums
    over the blocks need not be made contrast by contrast.
    """
    short = [_short(z) for z in roots]
    # products of all pairs of columns, each once: z'Sz of a symmetric S is linear in them
    upper = [np.triu_indices(z.shape[1]) for z in short]
    squares = [z[:, i] * z[:, j] * np.where(i == j, 1.0, 2.0)
               for z, (i, j) in zip(short, upper, strict=True)]  # fmt: skip
    # what is drawn at once is part of the stream of numbers where there are several groups
    most = max(len(z) * (b if len(short) > 1 else 1) for z, b in zip(short, blocks, strict=True))
    sizes = tuple((z.shape[1], b) for z, b in zip(short, blocks, strict=True))
    is_small = DRAWS * sum(columns * (columns + 3) for columns, _ in sizes) <= _KEPT_DRAWS
    drawn = _block_draws if is_small else _block_draws.__wrapped__
    largest = []
    for groups in drawn(seed, sizes, _AT_ONCE // most):
        n = len(groups[0][0])
        total, variance = np.zeros((len(roots[0]), n)), np.zeros((len(roots[0]), n))
        for z, pairs, (sums, products), b in zip(short, squares, groups, blocks, strict=True):
            total += z @ sums.T
            variance += pairs @ products.T * (b / (b - 1))
        np.multiply(total, total, out=total)
        total /= np.maximum(variance, 1e-300, out=variance)
        largest.append(np.sqrt(total.max(axis=0)))
    return np.concatenate(largest)


@lru_cache(maxsize=4)
def _block_draws(
    seed: int, sizes: tuple[tuple[int, int], ...], at_once: int
) -> list[list[tuple[Array, Array]]]:
    """Draw normal columns in blocks: their sums over blocks, and products of pairs of columns.

    They are the same for every block that is left out, and take two thirds of the time.
    """
    random = np.random.default_rng(seed)

    def group(n: int, columns: int, b: int) -> tuple[Array, Array]:
        first, second = np.triu_indices(columns)
        normal = random.standard_normal((n, columns, b))
        sums = normal.sum(axis=2)
        normal -= normal.mean(axis=2, keepdims=True)
        return sums, (normal @ normal.transpose(0, 2, 1))[:, first, second]

    return [[group(n, *size) for size in sizes] for n in chunks(DRAWS, at_once)]


def _largest_of_many(z: Array, blocks: int, seed: int) -> Array:
    """Largest |t| for many blocks: normal contrasts with Student's margins.

    Of 200 contrasts in 50 blocks the .96 quantile then covers .956 to .960 (20,000 draws of the
    blocks themselves, contrasts alike or apart), in 100 blocks .958 to .960.
    """
    from scipy.special import ndtr, stdtrit

    random, short, largest = np.random.default_rng(seed), _short(z), []
    for n in chunks(DRAWS, _AT_ONCE // len(short)):
        normal = short @ random.standard_normal((n, short.shape[1])).T
        largest.append(np.abs(normal).max(axis=0))
    return np.asarray(-stdtrit(blocks - 1, ndtr(-np.concatenate(largest))))


def _short(z: Array) -> Array:
    """Root of z z' with no more columns than rows where blocks are many (400 resamples)."""
    if z.shape[1] <= MANY_BLOCKS or z.shape[1] <= z.shape[0]:
        return z
    upper = np.asarray(np.linalg.qr(z.T, mode="r"))
    return np.asarray(upper.T)


def pooled_multiplier(
    differences: Differences, length: Array, df: float, confidence: Confidence
) -> float:
    """Multiplier where one error variance serves all contrasts of some length (m,).

    Simulated quantile of the largest |t| of a multivariate t (Hothorn, Bretz and Westfall 2008);
    never above Bonferroni's.
    """
    estimated, (alpha, seed) = np.flatnonzero(length > 1e-12 * length.max(initial=0.0)), confidence
    safe = t_quantile(alpha / (2 * max(len(estimated), 1)), df)
    if len(estimated) <= 1 or seed is None:
        return safe
    # first of every set that is one but for its unit: what is equal has the same product with any
    # numbers, and two of nine digits tell others apart
    drawn = np.random.default_rng(0).standard_normal((differences.settings.shape[1], 2))
    product = differences.of(differences.settings @ drawn)[estimated] / length[estimated, None]
    estimated = estimated[np.unique(product.round(9), axis=0, return_index=True)[1]]
    few, random, largest = differences.take(estimated), np.random.default_rng(seed), []
    for n in chunks(DRAWS, _AT_ONCE // len(estimated)):
        values = differences.settings @ random.standard_normal((differences.settings.shape[1], n))
        normal = (np.abs(few.of(values)) / length[estimated, None]).max(axis=0)
        largest.append(normal / np.sqrt(random.chisquare(df, n) / df))
    return min(safe, float(np.quantile(np.concatenate(largest), 1 - alpha)))


# -------------------------------------------------------------------------------------------------
# Several tests at once: Holm's p beside the raw one, within a response or over a study.
#
# Holm controls the chance of any false rejection whatever the dependence (Holm 1979, Scand. J.
# Statist. 6, 65-70) and is never less powerful than Bonferroni. The false discovery rate is no
# alternative here: a study has 7 to 30 dependent tests and each is read alone.

#: more primary terms than this are no choice before the run
MOST_PRIMARY = 3


@dataclass(frozen=True)
class FamilyTest:
    """One test of a family."""

    response: str
    term: str
    #: Raw p; None where there is no test.
    p: float | None
    #: Adjusted p; None outside the family.
    p_holm: float | None
    #: Number of tests in the family.
    family: int


def holm_family(
    p: Mapping[str, Mapping[str, float | None]], primary: Sequence[str] = ()
) -> tuple[FamilyTest, ...]:
    """Adjust the p of all terms of one or several responses together, or of the primary ones.

    Examples
    --------
    >>> [t.p_holm for t in holm_family({"f": {"A": 0.01, "B": 0.04, "A:B": None}})]
    [0.02, 0.04, None]
    """
    tests = [(name, term, value) for name, terms in p.items() for term, value in terms.items()]
    faults = [
        Fault(f"{name}: {term}", f"p must lie in [0, 1], got {value!r}")
        for name, term, value in tests
        if value is not None and not (math.isfinite(value) and 0 <= value <= 1)
    ]
    terms = [term for _, term, _ in tests]
    if len(primary) > MOST_PRIMARY:
        rule = f"at most {MOST_PRIMARY} may be declared, got {len(primary)}"
        faults.append(Fault("primary terms", rule, "name only those decided before the run"))
    for term in primary:
        if term not in terms:
            rule = f"{term!r} is no term of the model"
            faults.append(Fault("primary terms", rule, nearest(term, terms)))
    if faults:
        raise InputError(faults)
    inside = {
        i: value
        for i, (_, term, value) in enumerate(tests)
        if value is not None and (not primary or term in primary)
    }
    adjusted = dict(zip(inside, holm(list(inside.values())).tolist(), strict=True))
    return tuple(
        FamilyTest(name, term, value, adjusted.get(i), len(inside))
        for i, (name, term, value) in enumerate(tests)
    )


@dataclass(frozen=True)
class SummaryAnalysis(Keyed):
    """Groups of which mean, standard deviation and number of rows are known, compared."""

    KEYS = (
        "groups anova welch tukey_kramer=tukey.pairs games_howell=games_howell.pairs practical "
        "verdicts"
    )

    groups: GroupMoments
    #: Keys f, df, df_error and p: with one variance, and with one for each group (Welch).
    anova: Mapping[str, float]
    welch: Mapping[str, float]
    tukey: Comparisons
    games_howell: Comparisons
    practical: float | None = None

    @property
    def verdicts(self) -> list[str | None]:
        """Verdict of each pair: a claim where both intervals make it."""
        if self.practical is None:
            return [None] * len(self.tukey.pairs)
        verdicts: list[str | None] = []
        for both in zip(self.tukey.pairs, self.games_howell.pairs, strict=True):
            claims = {claim(pair.lower, pair.upper, self.practical) for pair in both}
            verdicts.append((len(claims) == 1 and claims.pop()) or CANNOT_TELL)
        return verdicts
