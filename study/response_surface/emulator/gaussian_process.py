"""A Gaussian process with constant means, fitted by restricted maximum likelihood.

scikit-learn's regressor has no mean by least squares, and its gradient is an array of n times n
times k + 2 numbers: 2.1 s a step with 1,000 runs of eight factors, which takes hundreds of steps.
Here one n times n array serves all length scales (`Kernel.with_slope`). The tests compare the
likelihood and the prediction with scikit-learn's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg, optimize

from study.arrays import Array
from study.response_surface.emulator.category_correlation import (
    DISTANCES,
    FIRST_DISTANCE,
    RESTART_DISTANCES,
    CategoryCorrelation,
    fitted,
)
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
        Settings in the unit box; with categories, their combination in a last column.
    y : array, shape (n,)
        Standardized responses.
    noise : array, shape (n,)
        Known variance of each.
    found : Hyperparameters
        Length scales, variance and nugget.
    factor : array, shape (n, n)
        Lower Cholesky factor of the covariance K of the runs.
    projected : array, shape (n, n)
        K^-1 with the constant means projected out.
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
        level, weights = self.solved
        return np.asarray(self.found.kernel.constants(x) @ level + self.covariance(x) @ weights)

    @cached_property
    def solved(self) -> tuple[Array, Array]:
        """Means of the p combinations by generalized least squares, and weights of the runs."""
        level, weights = self._weights(self.y[:, None])
        return level[:, 0], weights[:, 0]

    def _weights(self, responses: Array) -> tuple[Array, Array]:
        level = linalg.solve(self._information, self._constants.T @ responses, assume_a="pos")
        rest = responses - self.found.kernel.constants(self.x) @ level
        return level, linalg.cho_solve((self.factor, True), rest)

    @cached_property
    def _constants(self) -> Array:
        """K^-1 times the columns of the constant means, shape (n, p)."""
        return np.asarray(
            linalg.cho_solve((self.factor, True), self.found.kernel.constants(self.x))
        )

    @property
    def _information(self) -> Array:
        """What the runs say of these means, shape (p, p)."""
        return np.asarray(self.found.kernel.constants(self.x).T @ self._constants)

    def covariance(self, x: Array) -> Array:
        """Covariance, shape (m, n), of points of shape (m, k) with the runs."""
        return self.found.variance * self.found.kernel.correlation(x, self.x)

    def interpolated(self, responses: Array, x: Array) -> Array:
        """Predictions (m, q) at points (m, k) that the process makes of data (n, q)."""
        level, weights = self._weights(responses)
        return np.asarray(self.found.kernel.constants(x) @ level + self.covariance(x) @ weights)

    def deviation(self, x: Array) -> Array:
        """Posterior standard deviation, shape (m,), without the nugget, at points (m, k)."""
        k = self.covariance(x)
        half = linalg.solve_triangular(self.factor, k.T, lower=True)
        missed = self.found.kernel.constants(x) - k @ self._constants
        mean = (missed * linalg.solve(self._information, missed.T, assume_a="pos").T).sum(axis=1)
        variance = self.found.variance - (half**2).sum(axis=0) + mean
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def fit_process(
    x: Array, y: Array, noise: Array, family: Family, seed: int = 0, sizes: Sequence[int] = ()
) -> GaussianProcess:
    """Fit length scales, distances of categories, variance and nugget.

    Parameters
    ----------
    x : array, shape (n, k)
        Settings in the unit box; with categories, their combination in a last column.
    y : array, shape (n,)
        Responses with mean zero and variance one.
    noise : array, shape (n,)
        Known variance of each response.
    family : {"Matern 5/2", "Gaussian"}
        Kernel.
    seed : int
        Of the random starts.
    sizes : sequence of int
        Number of categories of each factor that is no number.
    """
    rng = np.random.default_rng(seed)
    k, p, tail = x.shape[1] - bool(sizes), fitted(sizes), [1.0, FIRST_NUGGET]
    starts = [np.log([FIRST_LENGTH * np.sqrt(k)] * k + [FIRST_DISTANCE] * p + tail)]
    for _ in range(RESTARTS):
        lengths, apart = _between(rng, RESTART_LENGTHS, k), _between(rng, RESTART_DISTANCES, p)
        starts.append(np.array([*lengths, *apart, *np.log(tail)]))
    ends = [LENGTHS] * k + [DISTANCES] * p + [VARIANCES, NUGGETS]
    bounds = [tuple(np.log(one)) for one in ends]

    def cost(theta: Array) -> tuple[float, Array]:
        value, slope = log_likelihood(theta, x, y, noise, family, sizes)
        return (-value, -slope) if np.isfinite(value) else (IMPOSSIBLE, np.zeros_like(theta))

    searches = [
        optimize.minimize(
            cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": STEPS}
        )
        for start in starts
    ]
    best = min(searches, key=lambda search: float(search.fun))
    return condition(x, y, noise, hyperparameters(np.asarray(best.x), family, sizes))


def _between(rng: np.random.Generator, ends: tuple[float, float], count: int) -> Array:
    """Logarithms drawn evenly between two ends."""
    low, high = np.log(ends)
    return np.asarray(low + rng.random(count) * (high - low))


def hyperparameters(theta: Array, family: Family, sizes: Sequence[int] = ()) -> Hyperparameters:
    """Read the logarithms of length scales, distances, variance and nugget, shape (k + p + 2,).

    Parameters
    ----------
    theta : array, shape (k + p + 2,)
        Of k numeric factors and p distances of categories, in this order.
    family : {"Matern 5/2", "Gaussian"}
        Kernel.
    sizes : sequence of int
        Number of categories of each factor that is no number; they give p.
    """
    values = np.exp(theta)
    k = values.size - 2 - fitted(sizes)
    categories = CategoryCorrelation.of(values[k:-2], sizes) if sizes else None
    kernel = Kernel(family, values[:k], categories)
    return Hyperparameters(kernel, float(values[-2]), float(values[-1]))


def condition(x: Array, y: Array, noise: Array, found: Hyperparameters) -> GaussianProcess:
    """Condition a process with known hyperparameters on runs.

    Parameters
    ----------
    x, y, noise
        As in `fit_process`.
    found : Hyperparameters
        Kernel, variance and nugget.
    """
    matrix = found.variance * found.kernel.correlation(x, x)
    matrix[np.diag_indices_from(matrix)] += noise + found.variance * found.nugget
    factor = linalg.cholesky(matrix, lower=True)
    projected = _projected(factor, found.kernel.constants(x))
    return GaussianProcess(x, y, noise, found, factor, projected, projected @ y)


def _projected(factor: Array, constants: Array) -> Array:
    """K^-1 with the columns of the constant means projected out, shape (n, n)."""
    inverse, _ = linalg.lapack.dpotri(factor, lower=1)
    inverse = np.tril(inverse) + np.tril(inverse, -1).T
    known = inverse @ constants
    return np.asarray(inverse - known @ linalg.solve(constants.T @ known, known.T, assume_a="pos"))


def log_likelihood(
    theta: Array, x: Array, y: Array, noise: Array, family: Family, sizes: Sequence[int] = ()
) -> tuple[float, Array]:
    """Restricted log likelihood without its constant, and its gradient.

    Parameters
    ----------
    theta : array, shape (k + p + 2,)
        Logarithms of length scales, distances of categories, variance and nugget.
    x, y, noise, family, sizes
        As in `fit_process`.

    Returns
    -------
    float, array of shape (k + p + 2,)
        -inf where the matrix is not positive definite.
    """
    found = hyperparameters(theta, family, sizes)
    correlation, shared = found.kernel.with_slope(x)
    matrix = found.variance * correlation
    matrix[np.diag_indices_from(matrix)] += noise + found.variance * found.nugget
    constants = found.kernel.constants(x)
    try:
        factor = linalg.cholesky(matrix, lower=True, check_finite=False)
        half = linalg.solve_triangular(factor, constants, lower=True)
        means = linalg.cholesky(half.T @ half, lower=True)
    except linalg.LinAlgError:
        return -np.inf, np.zeros_like(theta)
    projected = _projected(factor, constants)
    weights = projected @ y
    value = -np.log(np.diag(factor)).sum() - np.log(np.diag(means)).sum() - 0.5 * (y @ weights)
    # dL = 1/2 sum W dK with W = Pyy'P - P, P as in _projected
    outer = np.outer(weights, weights) - projected
    part = found.variance * outer * shared
    numbers = found.kernel.numbers(x)
    lengths = (
        part.sum(axis=1) @ numbers**2 - np.einsum("ij,ij->j", numbers, part @ numbers)
    ) / found.kernel.lengths**2
    share = found.variance * outer * correlation
    nugget = 0.5 * found.variance * found.nugget * float(np.trace(outer))
    variance = 0.5 * float(share.sum()) + nugget
    apart = []
    if found.kernel.categories is not None:
        by_combination = constants.T @ share @ constants
        apart = [0.5 * (by_combination * s).sum() for s in found.kernel.categories.slopes()]
    return float(value), np.array([*lengths, *apart, variance, nugget])
