"""Whether independent fits agree on their constants: one test over all of them at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from study.calibration.fit import Fit
from study.errors import Fault, InputError, RefusedError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Agreement:
    """Test of the hypothesis that all fits estimate the same constants.

    Parameters
    ----------
    common : ndarray, shape (p,)
        Common estimate, weighted by the inverse covariances.
    covariance : ndarray, shape (p, p)
        Of the common estimate.
    statistic, p : float
        Chi-square of the weighted distances from it, and its p; the joint 95 % regions of the
        fits meet where p is above 0.05.
    df : int
        Degrees of freedom, p (k - 1).
    """

    common: Array
    covariance: Array
    statistic: float
    df: int
    p: float


def agreement(fits: Sequence[Fit], extra: Sequence[Array] = ()) -> Agreement:
    """Test whether fits to different data give the same constants (Cochran 1954, Biometrics 10).

    Parameters
    ----------
    fits : sequence of Fit
        Independent, converged, with the same constants.
    extra : sequence of ndarray, shape (p, p), optional
        Covariance that each fit has besides, for instance of the mesh's error.

    Raises
    ------
    RefusedError
        If a fit has no covariance, so that nothing can be compared.
    """
    names = fits[0].names
    if len(fits) < 2 or any(fit.names != names for fit in fits):
        raise InputError(Fault("agreement", "needs two or more fits of the same constants"))
    if not all(fit.converged and np.all(np.isfinite(fit.covariance)) for fit in fits):
        raise RefusedError("a fit without a covariance cannot be compared with others")
    added = list(extra) or [np.zeros((len(names), len(names)))] * len(fits)
    covariances = [fit.covariance + more for fit, more in zip(fits, added, strict=True)]
    # scaled by the standard errors: moduli and exponents differ by orders of magnitude
    scale = np.sqrt(np.min([np.diag(c) for c in covariances], axis=0))
    weights = [np.linalg.inv(c / np.outer(scale, scale)) for c in covariances]
    values = [fit.values / scale for fit in fits]
    total = np.sum(weights, axis=0)
    common = np.linalg.solve(total, sum(w @ v for w, v in zip(weights, values, strict=True)))
    distances = [v - common for v in values]
    statistic = float(sum(d @ w @ d for w, d in zip(weights, distances, strict=True)))
    df = len(names) * (len(fits) - 1)
    from scipy.special import chdtrc

    covariance = np.linalg.inv(total) * np.outer(scale, scale)
    return Agreement(common * scale, covariance, statistic, df, float(chdtrc(df, statistic)))
