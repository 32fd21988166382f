"""A Gaussian process with a constant mean, fitted by restricted maximum likelihood.

scikit-learn's regressor has no mean by least squares, and its gradient is an array of n times n
times k + 2 numbers: 2.1 s a step with 1,000 runs of eight factors, which takes hundreds of steps.
Here one n times n array serves all length scales (`Kernel.with_slope`). The tests compare the
likelihood and the prediction with scikit-learn's.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg, optimize

from study.arrays import Array
from study.response_surface.emulator.kernels import Family, Kernel

#: length scales in the unit box: shorter is noise between runs, longer is a straight line
LENGTHS = (0.05, 50.0)

#: variance of the process beside that of the responses
VARIANCES = (1e-2, 1e4)

#: nugget beside the variance of the process: below, the matrix cannot be factorized
NUGGETS = (1e-10, 1.0)

#: where the first search begins; random ones begin at length scales between .1 and 5
FIRST_LENGTH = 0.5
FIRST_NUGGET = 1e-6
RESTART_LENGTHS = (0.1, 5.0)

#: searches beside the first one, and most steps of each
RESTARTS = 2
STEPS = 80

#: what an impossible matrix costs the search: any value above every likelihood
IMPOSSIBLE = 1e20


@dataclass(frozen=True)
class Hyperparameters:
    """What the likelihood decides.

    Parameters
    ----------
    kernel : Kernel
        Correlation with its length scales.
    variance : float
        Of the process, beside that of the responses.
    nugget : float
        Variance of the part that no neighbour shares, beside that of the process.
    """

    kernel: Kernel
    variance: float
    nugget: float


@dataclass(frozen=True)
class GaussianProcess:
    """A process conditioned on runs; responses have mean zero and variance one.

    Parameters
    ----------
    x : array, shape (n, k)
        Settings in the unit box.
    y : array, shape (n,)
        Standardized responses.
    noise : array, shape (n,)
        Known variance of each.
    found : Hyperparameters
        Length scales, variance and nugget.
    factor : array, shape (n, n)
        Lower Cholesky factor of the covariance K of the runs.
    projected : array, shape (n, n)
        K^-1 with the constant mean projected out.
    weights : array, shape (n,)
        The same times y.
    """

    x: Array
    y: Array
    noise: Array
    found: Hyperparameters
    factor: Array
    projected: Array
    weights: Array

    @property
    def loo_errors(self) -> Array:
        """Errors of predicting each run from all the others, shape (n,), in closed form."""
        return np.asarray(self.weights / np.diag(self.projected))

    @property
    def loo_deviations(self) -> Array:
        """Standard deviations of these predictions, shape (n,)."""
        return np.asarray(1.0 / np.sqrt(np.diag(self.projected)))

    def mean(self, x: Array) -> Array:
        """Posterior mean, shape (m,), at points of shape (m, k)."""
        level, weights = self._solved
        return np.asarray(level + self.covariance(x) @ weights)

    @cached_property
    def _solved(self) -> tuple[float, Array]:
        """Mean by generalized least squares, and weights of the runs, shape (n,)."""
        level, weights = self._weights(self.y[:, None])
        return float(level[0]), weights[:, 0]

    def _weights(self, responses: Array) -> tuple[Array, Array]:
        ones = linalg.cho_solve((self.factor, True), np.ones(self.y.size))
        level = ones @ responses / ones.sum()
        return level, linalg.cho_solve((self.factor, True), responses - level)

    def covariance(self, x: Array) -> Array:
        """Covariance, shape (m, n), of points of shape (m, k) with the runs."""
        return self.found.variance * self.found.kernel.correlation(x, self.x)

    def interpolated(self, responses: Array, covariance: Array) -> Array:
        """Means (m, p) that the process gives to data (n, p), with the mean of each by GLS."""
        level, weights = self._weights(responses)
        return np.asarray(level + covariance @ weights)

    def deviation(self, x: Array) -> Array:
        """Posterior standard deviation, shape (m,), without the nugget, at points (m, k)."""
        k = self.covariance(x)
        half = linalg.solve_triangular(self.factor, k.T, lower=True)
        ones = linalg.cho_solve((self.factor, True), np.ones(self.y.size))
        variance = self.found.variance - (half**2).sum(axis=0) + (1.0 - k @ ones) ** 2 / ones.sum()
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def fit_process(x: Array, y: Array, noise: Array, family: Family, seed: int = 0) -> GaussianProcess:
    """Fit length scales, variance and nugget.

    Parameters
    ----------
    x : array, shape (n, k)
        Settings in the unit box.
    y : array, shape (n,)
        Responses with mean zero and variance one.
    noise : array, shape (n,)
        Known variance of each response.
    family : {"Matern 5/2", "Gaussian"}
        Kernel.
    seed : int
        Of the random starts.
    """
    rng = np.random.default_rng(seed)
    k = x.shape[1]
    starts = [np.log([FIRST_LENGTH * np.sqrt(k)] * k + [1.0, FIRST_NUGGET])]
    for _ in range(RESTARTS):
        lengths = np.log(RESTART_LENGTHS[0]) + rng.random(k) * np.log(
            RESTART_LENGTHS[1] / RESTART_LENGTHS[0]
        )
        starts.append(np.array([*lengths, 0.0, np.log(FIRST_NUGGET)]))
    bounds = [tuple(np.log(LENGTHS))] * k + [tuple(np.log(VARIANCES)), tuple(np.log(NUGGETS))]

    def cost(theta: Array) -> tuple[float, Array]:
        value, slope = log_likelihood(theta, x, y, noise, family)
        return (-value, -slope) if np.isfinite(value) else (IMPOSSIBLE, np.zeros_like(theta))

    searches = [
        optimize.minimize(
            cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": STEPS}
        )
        for start in starts
    ]
    best = min(searches, key=lambda search: float(search.fun))
    return condition(x, y, noise, hyperparameters(np.asarray(best.x), family))


def hyperparameters(theta: Array, family: Family) -> Hyperparameters:
    """Read the logarithms of length scales, variance and nugget, shape (k + 2,)."""
    values = np.exp(theta)
    return Hyperparameters(Kernel(family, values[:-2]), float(values[-2]), float(values[-1]))


def condition(x: Array, y: Array, noise: Array, found: Hyperparameters) -> GaussianProcess:
    """Condition a process with known hyperparameters on runs; arguments as in `fit_process`."""
    matrix = found.variance * found.kernel.correlation(x, x)
    matrix[np.diag_indices_from(matrix)] += noise + found.variance * found.nugget
    factor = linalg.cholesky(matrix, lower=True)
    projected = _projected(factor)
    return GaussianProcess(x, y, noise, found, factor, projected, projected @ y)


def _projected(factor: Array) -> Array:
    """K^-1 with the constant mean projected out, shape (n, n)."""
    inverse, _ = linalg.lapack.dpotri(factor, lower=1)
    inverse = np.tril(inverse) + np.tril(inverse, -1).T
    ones = inverse.sum(axis=1)
    return np.asarray(inverse - np.outer(ones, ones) / ones.sum())


def log_likelihood(
    theta: Array, x: Array, y: Array, noise: Array, family: Family
) -> tuple[float, Array]:
    """Restricted log likelihood without its constant, and its gradient.

    Parameters
    ----------
    theta : array, shape (k + 2,)
        Logarithms of length scales, variance and nugget.
    x, y, noise, family
        As in `fit_process`.

    Returns
    -------
    float, array of shape (k + 2,)
        -inf where the matrix is not positive definite.
    """
    found = hyperparameters(theta, family)
    correlation, shared = found.kernel.with_slope(x)
    matrix = found.variance * correlation
    matrix[np.diag_indices_from(matrix)] += noise + found.variance * found.nugget
    try:
        factor = linalg.cholesky(matrix, lower=True, check_finite=False)
    except linalg.LinAlgError:
        return -np.inf, np.zeros_like(theta)
    half = linalg.solve_triangular(factor, np.ones(y.size), lower=True)
    projected = _projected(factor)
    weights = projected @ y
    value = -np.log(np.diag(factor)).sum() - 0.5 * np.log(half @ half) - 0.5 * float(y @ weights)
    # dL = 1/2 sum W dK with W = Pyy'P - P, P as in _projected
    outer = np.outer(weights, weights) - projected
    part = found.variance * outer * shared
    lengths = (
        part.sum(axis=1) @ x**2 - np.einsum("ij,ij->j", x, part @ x)
    ) / found.kernel.lengths**2
    trace = float(np.trace(outer))
    nugget = 0.5 * found.variance * found.nugget * trace
    variance = 0.5 * found.variance * float((outer * correlation).sum()) + nugget
    return float(value), np.array([*lengths, variance, nugget])
