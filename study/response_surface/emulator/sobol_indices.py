"""Shares of the response's variance that factors explain, with all factors uniform on the box."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from study.arrays import Array

#: points of the sample: with 1,024 an exact emulator still erred by .017
SAMPLE = 4096

#: what the sample itself may err, added to every interval
SAMPLE_ERROR = 0.005


@dataclass(frozen=True)
class SobolIndex:
    """First-order and total index of a factor.

    Parameters
    ----------
    first, total : float
        S: share of the variance by the factor alone; T: with all its interactions.
    first_interval, total_interval : tuple of float
        About 95 %.
    """

    first: float
    first_interval: tuple[float, float]
    total: float
    total_interval: tuple[float, float]


def jansen(values: Callable[[Array], Array], k: int, seed: int) -> tuple[Array, Array]:
    """First-order and total indices by Jansen's estimators (Saltelli et al. 2010, table 2).

    Parameters
    ----------
    values : callable
        Functions, shape (m, p), at points of shape (m, k) of the unit box.
    k : int
        Number of factors.
    seed : int
        Of the scrambled Sobol sample.

    Returns
    -------
    array, array
        S and T, shape (k, p) each; NaN for a function that never changes.
    """
    from scipy.stats import qmc

    sample = qmc.Sobol(2 * k, seed=seed).random(SAMPLE)
    a = sample[:, :k]
    b = sample[:, k:]
    at_a = values(a)
    at_b = values(b)
    variance = np.vstack([at_a, at_b]).var(axis=0)
    twice = np.where(variance > 0, 2.0 * variance, np.nan)
    first = np.empty((k, at_a.shape[1]))
    total = np.empty_like(first)
    for j in range(k):
        mixed = a.copy()
        mixed[:, j] = b[:, j]
        at_mixed = values(mixed)
        first[j] = 1.0 - ((at_b - at_mixed) ** 2).mean(axis=0) / twice
        total[j] = ((at_a - at_mixed) ** 2).mean(axis=0) / twice
    return first, total


def sobol_indices(
    values: Callable[[Array], Array], k: int, q2: float, seed: int
) -> tuple[SobolIndex, ...]:
    """Estimate indices of the posterior mean, with intervals from its paths.

    Parameters
    ----------
    values : callable
        Posterior mean (first column) and paths, shape (m, 1 + paths), at points of shape (m, k).
    k : int
        Number of factors.
    q2 : float
        Leave-one-out Q2: what the emulator leaves unexplained widens every interval, because
        paths alone scatter too little where there are few runs.
    seed : int
        Of the sample.
    """
    first, total = jansen(values, k, seed)
    margin = 1.0 - q2 + SAMPLE_ERROR
    return tuple(
        SobolIndex(_cut(s[0]), _interval(s[1:], margin), _cut(t[0]), _interval(t[1:], margin))
        for s, t in zip(first, total, strict=True)
    )


def _interval(paths: Array, margin: float) -> tuple[float, float]:
    low, high = np.quantile(paths, [0.025, 0.975])
    return _cut(low - margin), _cut(high + margin)


def _cut(value: float) -> float:
    return float(np.clip(value, 0.0, 1.0))
