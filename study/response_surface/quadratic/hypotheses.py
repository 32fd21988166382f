"""Tests of terms and of lack of fit: against blocks, or against measured replicates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.arrays import Array, Ints
from study.response_surface.quadratic.least_squares import ModelColumns

#: part of the response's size below which a spread between blocks is rounding
ROUNDING = 1e-12


@dataclass(frozen=True)
class FTest:
    """An F test.

    Parameters
    ----------
    f : float
        Ratio of the mean squares.
    df, df_error : float
        Degrees of freedom; with blocks after Greenhouse and Geisser's correction.
    p : float
        Probability of a larger ratio where there is nothing to be found.
    """

    f: float
    df: float
    df_error: float
    p: float


def against_blocks(columns: Array, response: Array) -> FTest | None:
    """Test columns against their own interaction with the blocks (Greenhouse and Geisser 1959).

    Parameters
    ----------
    columns : array, shape (n, k)
        Orthonormal columns over the settings.
    response : array, shape (n, b)
        One column a block.

    Returns
    -------
    FTest or None
        None without columns, or where the blocks agree to the last digit.
    """
    from scipy import stats

    parts = response.T @ columns  # (b, k): what every block says of each column
    blocks, k = parts.shape
    if k == 0 or blocks < 2:
        return None
    mean = parts.mean(axis=0)
    covariance = np.atleast_2d(np.cov(parts, rowvar=False))
    trace = float(np.trace(covariance))
    if trace <= (ROUNDING * float(np.abs(response).max())) ** 2:
        return None
    epsilon = trace**2 / (k * float((covariance**2).sum()))
    f = blocks * float(mean @ mean) / trace
    df = epsilon * k
    return FTest(f, df, df * (blocks - 1), float(stats.f.sf(f, df, df * (blocks - 1))))


def lack_of_fit(columns: ModelColumns, response: Array, which: Ints) -> FTest | None:
    """Classical test of the model against pure error (Montgomery 2017, section 11.2).

    Parameters
    ----------
    columns : ModelColumns
        The model at every run.
    response : array, shape (n,)
        One value a run.
    which : array of int, shape (n,)
        Setting of each run; runs of one setting are replicates.

    Returns
    -------
    FTest or None
        None without replicates, or where no setting is left to judge the model by.
    """
    from scipy import stats

    counts = np.bincount(which)
    means = np.bincount(which, weights=response) / counts
    pure = float(((response - means[which]) ** 2).sum())
    df_pure = int(response.size - counts.size)
    df = int(counts.size - len(columns.terms))
    if df_pure < 1 or df < 1 or pure <= 0:
        return None
    residual = float((columns.residuals(response) ** 2).sum())
    f = max(residual - pure, 0.0) / df / (pure / df_pure)
    return FTest(f, float(df), float(df_pure), float(stats.f.sf(f, df, df_pure)))
