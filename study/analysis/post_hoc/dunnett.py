"""Levels of a factor against a reference with the error of the fitted model (Dunnett 1955)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from study.analysis.anova_table import Effect, PairDifference
from study.analysis.effects.comparisons import Comparisons, Pair
from study.analysis.effects.estimates import pooled_critical
from study.arrays import Array

#: Samples of the multivariate t: its quantile then repeats to about 0.1 %.
SAMPLES = 200_000
#: Samples drawn at a time: 20 levels of them take 8 MB.
CHUNK = 50_000


def dunnett_of_model(
    effect: Effect, reference: str, df: float, alpha: float, seed: int
) -> Comparisons:
    """Compare the level means of a factor with one of them.

    The differences are those of the model, so other factors and blocks are taken out of the
    error; their correlations follow from the standard errors of all pairs. The distribution of
    the largest absolute t is simulated.

    Parameters
    ----------
    effect : Effect
        Of one factor, with its pairs, tested against one residual.
    reference : str
        One of its levels.
    df : float
        Degrees of freedom of the residual.
    alpha : float
        One minus the level of the intervals together.
    seed : int
        Of the simulation.

    Returns
    -------
    Comparisons
        Differences from the reference (ratios for a log response).
    """
    others = [level for level in effect.levels if level != reference]
    known = {frozenset((p.first, p.second)): p for p in effect.pairs}
    critical = pooled_critical(len(effect.levels), len(effect.levels) - 1, df, True, alpha)
    error = {key: _half(pair, effect.is_ratio) / critical for key, pair in known.items()}
    means = np.array([_difference(known, name, reference, effect.is_ratio) for name in others])
    own = np.array([error[frozenset((name, reference))] for name in others])
    largest = _largest_t(_correlation(others, own, error), df, seed)
    half = float(np.quantile(largest, 1 - alpha)) * own
    p = [(1 + int(np.sum(largest >= abs(t)))) / (largest.size + 1) for t in means / own]
    ends = zip(means, means - half, means + half, strict=True)
    pairs = tuple(
        Pair(name, reference, float(d), float(low), float(high), float(one))
        for name, (d, low, high), one in zip(others, ends, p, strict=True)
    )
    compared = Comparisons("Dunnett", alpha, pairs, {})
    return compared.as_ratios() if effect.is_ratio else compared


def _half(pair: PairDifference, is_ratio: bool) -> float:
    if is_ratio:
        return math.log(pair.upper / pair.lower) / 2
    return (pair.upper - pair.lower) / 2


def _difference(
    known: dict[frozenset[str], PairDifference], name: str, reference: str, is_ratio: bool
) -> float:
    pair = known[frozenset((name, reference))]
    size = math.log(pair.difference) if is_ratio else pair.difference
    return size if pair.first == name else -size


def _correlation(others: Sequence[str], own: Array, error: dict[frozenset[str], float]) -> Array:
    """Correlations of the differences from the reference: 2 cov = var + var - var of the pair."""
    k = len(others)
    found = np.eye(k)
    for i in range(k):
        for j in range(i):
            between = error[frozenset((others[i], others[j]))]
            found[i, j] = (own[i] ** 2 + own[j] ** 2 - between**2) / (2 * own[i] * own[j])
            found[j, i] = found[i, j]
    return found


def _largest_t(correlation: Array, df: float, seed: int) -> Array:
    """Largest absolute value of correlated t, simulated, shape (SAMPLES,)."""
    values, vectors = np.linalg.eigh(correlation)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(seed)
    parts = []
    for _ in range(SAMPLES // CHUNK):
        z = np.abs(rng.standard_normal((CHUNK, len(values))) @ root.T).max(axis=1)
        parts.append(z / np.sqrt(rng.chisquare(df, CHUNK) / df))
    return np.concatenate(parts)
