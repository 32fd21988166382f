"""Pairwise comparisons of means with simultaneous intervals, adjusted p, and letters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from string import ascii_letters

import numpy as np
from numpy.typing import ArrayLike

from study.arrays import Array
from study.errors import Fault, InputError, nearest


@dataclass(frozen=True)
class Pair:
    """Difference ``first - second`` with its simultaneous interval and adjusted p."""

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


@dataclass(frozen=True)
class _Groups:
    names: tuple[str, ...]
    n: Array
    mean: Array
    variance: Array

    @property
    def pooled(self) -> tuple[float, int]:
        df = self.n - 1
        return float((df * self.variance).sum() / df.sum()), int(df.sum())


def _summary(groups: Mapping[str, ArrayLike]) -> _Groups:
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
    return _Groups(
        tuple(values),
        np.array([float(v.size) for v in values.values()]),
        np.array([v[0] + np.mean(v - v[0]) for v in values.values()]),
        np.array([np.var(v - v[0], ddof=1) for v in values.values()]),
    )


def tukey_kramer(groups: Mapping[str, ArrayLike], *, alpha: float = 0.05) -> Comparisons:
    """All pairs, equal variances (Tukey 1953, Kramer 1956)."""
    g = _summary(groups)
    s2, df = g.pooled
    k = len(g.names)
    q = studentized_range_quantile(1 - alpha, k, df)
    pairs = []
    for i, j in combinations(range(k), 2):
        se = math.sqrt(s2 / 2 * (1 / g.n[i] + 1 / g.n[j]))
        pairs.append(_range_pair(g, i, j, se, q, k, df))
    return _family("Tukey-Kramer", alpha, g.names, pairs, g.mean)


def games_howell(groups: Mapping[str, ArrayLike], *, alpha: float = 0.05) -> Comparisons:
    """All pairs, unequal variances (Games and Howell 1976, J. Educ. Stat. 1, 113-125)."""
    g = _summary(groups)
    k = len(g.names)
    share = g.variance / g.n
    pairs = []
    for i, j in combinations(range(k), 2):
        both = share[i] + share[j]
        df = both**2 / (share[i] ** 2 / (g.n[i] - 1) + share[j] ** 2 / (g.n[j] - 1))
        q = studentized_range_quantile(1 - alpha, k, float(df))
        pairs.append(_range_pair(g, i, j, math.sqrt(both / 2), q, k, float(df)))
    return _family("Games-Howell", alpha, g.names, pairs, g.mean)


def _range_pair(g: _Groups, i: int, j: int, se: float, q: float, k: int, df: float) -> Pair:
    difference = float(g.mean[i] - g.mean[j])
    p = max(0.0, 1 - studentized_range_cdf(abs(difference) / se, k, df))
    return Pair(g.names[i], g.names[j], difference, difference - q * se, difference + q * se, p)


def dunnett(
    groups: Mapping[str, ArrayLike], control: str, *, alpha: float = 0.05, seed: int = 2011
) -> Comparisons:
    """Every group against a reference (Dunnett 1955), multivariate t by scipy, seeded.

    Raises
    ------
    InputError
        If ``control`` is no group.
    """
    if control not in groups:
        raise InputError(
            Fault("control", f"{control!r} is no group", nearest(control, map(str, groups)))
        )
    from scipy.stats import dunnett as scipy_dunnett

    _summary(groups)
    others = [str(k) for k in groups if k != control]
    found = scipy_dunnett(
        *(np.asarray(groups[k], float) for k in others),
        control=np.asarray(groups[control], float),
        random_state=np.random.default_rng(seed),
    )
    interval = found.confidence_interval(1 - alpha)
    reference = float(np.mean(np.asarray(groups[control], float)))
    pairs = tuple(
        Pair(
            name,
            control,
            float(np.mean(np.asarray(groups[name], float))) - reference,
            float(interval.low[i]),
            float(interval.high[i]),
            float(found.pvalue[i]),
        )
        for i, name in enumerate(others)
    )
    return Comparisons("Dunnett", alpha, pairs, {})


def holm(p: ArrayLike) -> Array:
    """Holm's adjusted p of a family (Holm 1979).

    Examples
    --------
    >>> holm([0.01, 0.04, 0.03]).tolist()
    [0.03, 0.06, 0.06]
    """
    from statsmodels.stats.multitest import multipletests

    return np.asarray(multipletests(np.asarray(p, dtype=float), method="holm")[1])


def _family(
    method: str, alpha: float, names: Sequence[str], pairs: Sequence[Pair], mean: Array
) -> Comparisons:
    different = {frozenset((x.first, x.second)) for x in pairs if x.p < alpha}
    ordered = [names[i] for i in np.argsort(-mean, kind="stable")]
    return Comparisons(method, alpha, tuple(pairs), letters(ordered, different))


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
