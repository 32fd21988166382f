"""Pairwise comparisons of means with simultaneous intervals, adjusted p, and letters."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations
from string import ascii_letters
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from study.arrays import Array
from study.errors import Fault, InputError, nearest

if TYPE_CHECKING:
    from scipy.stats._common import ConfidenceInterval


@dataclass(frozen=True)
class Pair:
    """Difference ``first - second``, or ratio ``first / second``.

    With its simultaneous interval and adjusted p.
    """

    first: str
    second: str
    difference: float
    lower: float
    upper: float
    p: float


@dataclass(frozen=True)
class Comparisons:
    """All comparisons of one family; groups that share a letter are not told apart."""

    method: str
    alpha: float
    pairs: tuple[Pair, ...]
    letters: dict[str, str]
    is_ratio: bool = False

    @property
    def effect(self) -> str:
        """What a pair is compared by: ``"difference"``, or ``"ratio"`` of a log response."""
        return "ratio" if self.is_ratio else "difference"

    def as_ratios(self) -> Comparisons:
        """Copy with differences of logarithms as ratios."""
        pairs = tuple(
            replace(
                one,
                difference=math.exp(one.difference),
                lower=math.exp(one.lower),
                upper=math.exp(one.upper),
            )
            for one in self.pairs
        )
        return replace(self, pairs=pairs, is_ratio=True)


def _checked(groups: Mapping[str, ArrayLike]) -> dict[str, Array]:
    """Values of every group, two or more and finite."""
    values = {str(k): np.asarray(v, dtype=float) for k, v in groups.items()}
    faults = [
        Fault(f"group {k}", f"needs at least two finite values, got {v.tolist()[:5]}")
        for k, v in values.items()
        if v.size < 2 or not np.all(np.isfinite(v))
    ]
    if len(values) < 2:
        faults.append(Fault("groups", "at least two groups are needed"))
    if faults:
        raise InputError(faults)
    return values


def tukey_kramer(groups: Mapping[str, ArrayLike], *, alpha: float = 0.05) -> Comparisons:
    """All pairs, equal variances (Tukey 1953, Kramer 1956).

    Parameters
    ----------
    groups : mapping of str to array_like, shape (n_i,)
        Independent values of each group, two or more.
    alpha : float
        Error probability of all intervals together, and of the letters.
    """
    return _all_pairs("Tukey-Kramer", groups, alpha, equal_var=True)


def games_howell(groups: Mapping[str, ArrayLike], *, alpha: float = 0.05) -> Comparisons:
    """All pairs, unequal variances (Games and Howell 1976, J. Educ. Stat. 1, 113-125).

    Parameters
    ----------
    groups : mapping of str to array_like, shape (n_i,)
        Independent values of each group, two or more.
    alpha : float
        Error probability of all intervals together, and of the letters.
    """
    return _all_pairs("Games-Howell", groups, alpha, equal_var=False)


def _all_pairs(
    method: str, groups: Mapping[str, ArrayLike], alpha: float, *, equal_var: bool
) -> Comparisons:
    from scipy.stats import tukey_hsd

    values = _checked(groups)
    names = list(values)
    # differences from one value are exact where doubles are close
    shift = values[names[0]][0]
    shifted = [v - shift for v in values.values()]
    found = tukey_hsd(*shifted, equal_var=equal_var)
    ends = found.confidence_interval(1 - alpha)
    pairs = [
        Pair(
            names[i],
            names[j],
            float(found.statistic[i, j]),
            float(ends.low[i, j]),
            float(ends.high[i, j]),
            float(found.pvalue[i, j]),
        )
        for i, j in combinations(range(len(names)), 2)
    ]
    return _family(method, alpha, names, pairs, np.array([v.mean() for v in shifted]))


def dunnett(
    groups: Mapping[str, ArrayLike], control: str, *, alpha: float = 0.05, seed: int = 2011
) -> Comparisons:
    """Every group against a reference (Dunnett 1955), multivariate t by scipy, seeded.

    Parameters
    ----------
    groups : mapping of str to array_like, shape (n_i,)
        Independent values of each group, two or more.
    control : str
        Name of the reference group.
    alpha : float
        Error probability of all intervals together.
    seed : int
        Seed of the random numbers with which the multivariate t is integrated.

    Returns
    -------
    Comparisons
        Each other group minus the reference, without letters.

    Raises
    ------
    InputError
        If ``control`` is no group.
    """
    if control not in groups:
        raise InputError(
            Fault("control", f"{control!r} is no group", nearest(control, map(str, groups)))
        )
    _checked(groups)
    others = [str(k) for k in groups if k != control]
    p, interval = _dunnett(
        [np.asarray(groups[k], float) for k in others], np.asarray(groups[control], float), alpha,
        seed,
    )  # fmt: skip
    reference = float(np.mean(np.asarray(groups[control], float)))
    pairs = tuple(
        Pair(
            name,
            control,
            float(np.mean(np.asarray(groups[name], float))) - reference,
            float(interval.low[i]),
            float(interval.high[i]),
            float(p[i]),
        )
        for i, name in enumerate(others)
    )
    return Comparisons("Dunnett", alpha, pairs, {})


#: Seeds after which an interval of Dunnett's test is taken as it is found
_DUNNETT_SEEDS = 8


def _dunnett(
    samples: Sequence[Array], reference: Array, alpha: float, seed: int
) -> tuple[Array, ConfidenceInterval]:
    """P-values and intervals; where the noise of the integral hid the level, with other draws.

    scipy integrates the multivariate t with random numbers, and warns where the level that it
    reached is off by more than 1 % of alpha: in one of some thousand tables.
    """
    from scipy.stats import dunnett as scipy_dunnett

    for number in range(_DUNNETT_SEEDS):
        rng = np.random.default_rng(seed + number)
        found = scipy_dunnett(*samples, control=reference, random_state=rng)
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            interval = found.confidence_interval(1 - alpha)
        if not told:
            break
    return np.asarray(found.pvalue), interval


def holm(p: ArrayLike) -> Array:
    """Holm's adjusted p of a family (Holm 1979).

    Parameters
    ----------
    p : array_like, shape (m,)
        Raw p of all tests of the family; it may be empty.

    Examples
    --------
    >>> holm([0.01, 0.04, 0.03]).tolist()
    [0.03, 0.06, 0.06]
    """
    # the same products as statsmodels.stats.multitest, whose import takes .4 s of every analysis
    values = np.asarray(p, dtype=float)
    order = np.argsort(values)
    steps = np.maximum.accumulate(values[order] * np.arange(values.size, 0, -1))
    adjusted = np.empty_like(values)
    adjusted[order] = np.minimum(steps, 1.0)
    return adjusted


def _family(
    method: str, alpha: float, names: Sequence[str], pairs: Sequence[Pair], mean: Array
) -> Comparisons:
    different = {frozenset((x.first, x.second)) for x in pairs if x.p < alpha}
    ordered = [names[i] for i in np.argsort(-mean, kind="stable")]
    return Comparisons(method, alpha, tuple(pairs), letters(ordered, different))


def letters(names: Sequence[str], different: set[frozenset[str]]) -> dict[str, str]:
    """Compact letter display by insert and absorb (Piepho 2004, JCGS 13, 456-466).

    Parameters
    ----------
    names : sequence of str
        Levels, in the order in which letters are given: the largest mean first.
    different : set of frozenset of str
        Pairs of levels that are told apart.

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
        columns = [
            c
            for i, c in enumerate(split)
            if not any(c < other or (c == other and j < i) for j, other in enumerate(split))
        ]
    columns.sort(key=lambda c: [names.index(n) for n in names if n in c])
    tags = [ascii_letters[i] if i < 52 else f"({i})" for i in range(len(columns))]
    return {n: "".join(tag for tag, c in zip(tags, columns, strict=True) if n in c) for n in names}


@lru_cache(maxsize=4)
def _legendre(n: int) -> tuple[Array, Array]:
    nodes, weights = np.polynomial.legendre.leggauss(n)
    return nodes, weights


def range_cdf(w: Array, k: int) -> Array:
    """P(range of ``k`` standard normals <= w): k int phi(z) (Phi(z) - Phi(z - w))^(k-1) dz.

    Parameters
    ----------
    w : ndarray
        Ranges in standard deviations, of any shape, which the result has too.
    k : int
        Number of independent normals, at least 2.
    """
    from scipy.special import ndtr

    nodes, weights = _legendre(96)
    z = 9.0 * nodes
    density = 9.0 * weights * np.exp(-0.5 * z**2) / math.sqrt(2 * math.pi)
    inner = ndtr(z) - ndtr(z - np.asarray(w)[..., None])
    return np.asarray(k * (inner ** (k - 1)) @ density)


#: degrees of freedom from which a sum over s is its value at 1 in every digit
_NORMAL = 1e14

#: half the degrees of freedom from which Stirling's series has every digit
_STIRLING = 25.0


@lru_cache(maxsize=256)
def scale_rule(df: float) -> tuple[Array, Array]:
    """Nodes and weights of expectations over s = sqrt(chi2_df / df), up to infinite ``df``."""
    from scipy.special import gammainccinv, gammaincinv, gammaln

    if df > _NORMAL:
        return np.ones(1), np.ones(1)
    a = df / 2
    low = math.sqrt(2 * float(gammaincinv(a, 1e-14)) / df)
    high = math.sqrt(2 * float(gammainccinv(a, 1e-14)) / df)
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
    """P(studentized range of ``k`` means with ``df`` <= q) (Tukey 1953; Copenhaver 1988).

    Parameters
    ----------
    q : float
        Range of the means over the standard error of one mean.
    k : int
        Number of means.
    df : float
        Degrees of freedom of that standard error.
    """
    if q <= 0:
        return 0.0
    s, weights = scale_rule(float(df))
    return min(1.0, float(range_cdf(q * s, k) @ weights))


@lru_cache(maxsize=1024)
def studentized_range_quantile(p: float, k: int, df: float) -> float:
    """Quantile of the studentized range.

    Parameters
    ----------
    p : float
        Probability that the range stays below the quantile, 1 - alpha.
    k : int
        Number of means.
    df : float
        Degrees of freedom of the standard error of a mean.

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
