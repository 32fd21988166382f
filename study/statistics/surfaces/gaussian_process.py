"""A Gaussian process with constant means, fitted by restricted maximum likelihood.

scikit-learn's regressor has no mean by least squares, and its gradient is an array of n times n
times k + 2 numbers: 2.1 s a step with 1,000 runs of eight factors, which takes hundreds of steps.
Here one n times n array serves all length scales (`Kernel.with_slope`). The tests compare the
likelihood and the prediction with scikit-learn's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Literal

import numpy as np
import scipy

from study.ground.arrays import Array, Ints, one_thread
from study.ground.errors import settled

# Correlation of the functions that belong to categories: what they share, and what each has.

#: distances of a category from the shared part: below, it is the shared part; beyond, alone
DISTANCES = (1e-5, 3.0)
#: where the first search begins: two categories correlate by .82
FIRST_DISTANCE = 0.1
RESTART_DISTANCES = (0.01, 1.0)


@dataclass(frozen=True)
class CategoryCorrelation:
    """Correlation exp(-(d_r + d_s)) of categories r and s, multiplied over the factors.

    McMillan, Sacks, Welch and Gao (1999, J. Biopharm. Stat. 9, 417), in the family of Qian, Wu
    and Wu (2008, Technometrics 50, 383). The function of category r is exp(-d_r) times one that
    all share, and the rest its own. With equal distances it is the exchangeable correlation; one
    distance is fitted to two categories, for only the sum of theirs counts.
    """

    #: shape (c,); of every category of each factor, from the shared part; positive.
    distances: tuple[Array, ...]

    @classmethod
    def of(cls, values: Array, sizes: Sequence[int]) -> CategoryCorrelation:
        """Read what is fitted, shape (`fitted(sizes)`,)."""
        parts = np.split(values, np.cumsum([_own(c) for c in sizes])[:-1])
        return cls(tuple(np.broadcast_to(p, c) for p, c in zip(parts, sizes, strict=True)))

    @cached_property
    def matrix(self) -> Array:
        """Correlations, shape (p, p), of all combinations; the last factor changes fastest."""
        return reduce(np.kron, [np.exp(m) for m in self._logarithms])

    @cached_property
    def parts(self) -> Array:
        """Weights, shape (p, p), of independent functions: a root of the matrix."""
        return np.asarray(np.linalg.cholesky(self.matrix + 1e-12 * np.eye(len(self.matrix))))

    def slopes(self) -> list[Array]:
        """List the derivatives of ln(matrix) by the logarithm of each distance that is fitted."""
        derivatives = []
        for q, distance in enumerate(self.distances):
            c = distance.size
            for r in range(_own(c)):
                slope = np.zeros((c, c))
                slope[r, :] -= distance[r]
                slope[:, r] -= distance[r]
                if c == 2:  # both are the same number
                    slope[:] = -2.0 * distance[0]
                np.fill_diagonal(slope, 0.0)
                # logarithms of the factors of a Kronecker product add
                ones = [np.ones_like(m) for m in self._logarithms]
                ones[q] = slope
                derivatives.append(reduce(lambda a, b: np.asarray(np.kron(a, b)), ones))
        return derivatives

    @cached_property
    def _logarithms(self) -> list[Array]:
        logarithms = [-(distance[:, None] + distance) for distance in self.distances]
        for logarithm in logarithms:
            np.fill_diagonal(logarithm, 0.0)
        return logarithms


def fitted(sizes: Sequence[int]) -> int:
    """Count the distances that are fitted to factors with so many categories."""
    return sum(_own(c) for c in sizes)


def _own(c: int) -> int:
    return 1 if c == 2 else c


# Correlation of two points by their distance, with one length scale a factor.

Family = Literal["Matern 5/2", "Gaussian"]
FAMILIES: tuple[Family, ...] = ("Matern 5/2", "Gaussian")
#: degrees of freedom of the t distribution that is the spectrum of Matern 5/2
SPECTRAL_DF = 5


@dataclass(frozen=True)
class Kernel:
    """A stationary correlation (Rasmussen and Williams 2006, section 4.2)."""

    #: {"Matern 5/2", "Gaussian"}: twice differentiable, or without end.
    family: Family
    #: shape (k,); length scales, in the unit box.
    lengths: Array
    #: Where the runs belong to combinations of categories: points have the number of theirs in a
    #: last column, and correlations are multiplied by those of the combinations.
    categories: CategoryCorrelation | None = None

    def correlation(self, x: Array, other: Array) -> Array:
        """Correlations, shape (n, m), of points of shape (n, k) and (m, k)."""
        if self.family == "Gaussian":
            values = np.asarray(np.exp(-0.5 * self._squared(x, other)))
        else:
            a = np.sqrt(5.0 * self._squared(x, other))
            values = np.asarray((1.0 + a + a * a / 3.0) * np.exp(-a))
        return self._among(values, x, other)

    def with_slope(self, x: Array) -> tuple[Array, Array]:
        """Correlations R of points of shape (n, k), and H: dR/d ln l_j = H (x_ij - x_kj)^2/l_j^2.

        All slopes share H, so that no array of n times n times k numbers is ever made.
        """
        squared = self._squared(x, x)
        if self.family == "Gaussian":
            r = self._among(np.exp(-0.5 * squared), x, x)
            return r, r
        a = np.sqrt(5.0 * squared)
        decay = self._among(np.exp(-a), x, x)
        return (1.0 + a + a * a / 3.0) * decay, 5.0 / 3.0 * (1.0 + a) * decay

    def numbers(self, x: Array) -> Array:
        """Columns (n, k) of the points that are no categories."""
        return x[:, : self.lengths.size]

    def combination(self, x: Array) -> Ints:
        """Give the combination of categories of each point, shape (n,); 0 where there are none."""
        if self.categories is None:
            return np.zeros(len(x), dtype=np.int64)
        return np.asarray(x[:, -1], dtype=np.int64)

    def constants(self, x: Array) -> Array:
        """Columns (n, p) of the constant mean of every combination of categories."""
        p = 1 if self.categories is None else len(self.categories.matrix)
        return np.asarray(np.eye(p)[self.combination(x)])

    def _among(self, correlation: Array, x: Array, other: Array) -> Array:
        if self.categories is None:
            return correlation
        rows, columns = self.combination(x), self.combination(other)
        return np.asarray(correlation * self.categories.matrix[np.ix_(rows, columns)])

    def frequencies(self, rng: np.random.Generator, n: int) -> Array:
        """Draw frequencies, shape (n, k), from the spectrum of the correlation (Bochner)."""
        normal = rng.standard_normal((n, self.lengths.size))
        if self.family == "Matern 5/2":
            normal /= np.sqrt(rng.chisquare(SPECTRAL_DF, (n, 1)) / SPECTRAL_DF)
        return np.asarray(normal / self.lengths)

    def _squared(self, x: Array, other: Array) -> Array:
        scaled = (self.numbers(points) / self.lengths for points in (x, other))
        return np.asarray(scipy.spatial.distance.cdist(*scaled, "sqeuclidean"))


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
#: searches beside the first one
RESTARTS = 2
#: steps of each search, and of the best one where those were too few
STEPS = 80
MOST_STEPS = 2000
#: status of a search by L-BFGS-B that ended by its number of steps
BY_COUNT = 1
#: what an impossible matrix costs the search: any value above every likelihood
IMPOSSIBLE = 1e20


@dataclass(frozen=True)
class Hyperparameters:
    """What the likelihood decides."""

    kernel: Kernel
    #: Of the process, beside that of the responses.
    variance: float
    #: Variance of the part that no neighbour shares, beside that of the process.
    nugget: float


@dataclass(frozen=True)
class GaussianProcess:
    """A process conditioned on runs; responses have mean zero and variance one."""

    #: shape (n, k); settings in the unit box; with categories, their combination in a last column.
    x: Array
    #: shape (n,); standardized responses.
    y: Array
    #: shape (n,); known variance of each.
    noise: Array
    hyperparameters: Hyperparameters
    #: shape (n, n); lower Cholesky factor of the covariance K of the runs.
    factor: Array
    #: shape (n, n); K^-1 with the constant means projected out.
    projected: Array
    #: shape (n,); the same times y.
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
        return np.asarray(
            self.hyperparameters.kernel.constants(x) @ level + self.covariance(x) @ weights
        )

    @cached_property
    def solved(self) -> tuple[Array, Array]:
        """Means of the p combinations by generalized least squares, and weights of the runs."""
        level, weights = self._weights(self.y[:, None])
        return level[:, 0], weights[:, 0]

    def _weights(self, responses: Array) -> tuple[Array, Array]:
        level = scipy.linalg.solve(self._information, self._constants.T @ responses, assume_a="pos")
        rest = responses - self.hyperparameters.kernel.constants(self.x) @ level
        return level, scipy.linalg.cho_solve((self.factor, True), rest)

    @cached_property
    def _constants(self) -> Array:
        """K^-1 times the columns of the constant means, shape (n, p)."""
        return np.asarray(
            scipy.linalg.cho_solve(
                (self.factor, True), self.hyperparameters.kernel.constants(self.x)
            )
        )

    @property
    def _information(self) -> Array:
        """What the runs say of these means, shape (p, p)."""
        return np.asarray(self.hyperparameters.kernel.constants(self.x).T @ self._constants)

    def covariance(self, x: Array) -> Array:
        """Covariance, shape (m, n), of points of shape (m, k) with the runs."""
        return self.hyperparameters.variance * self.hyperparameters.kernel.correlation(x, self.x)

    def interpolated(self, responses: Array, x: Array) -> Array:
        """Predictions (m, q) at points (m, k) that the process makes of data (n, q)."""
        level, weights = self._weights(responses)
        return np.asarray(
            self.hyperparameters.kernel.constants(x) @ level + self.covariance(x) @ weights
        )

    def deviation(self, x: Array) -> Array:
        """Posterior standard deviation, shape (m,), without the nugget, at points (m, k)."""
        k = self.covariance(x)
        half = scipy.linalg.solve_triangular(self.factor, k.T, lower=True)
        missed = self.hyperparameters.kernel.constants(x) - k @ self._constants
        solved = scipy.linalg.solve(self._information, missed.T, assume_a="pos")
        mean = (missed * solved.T).sum(axis=1)
        variance = self.hyperparameters.variance - (half**2).sum(axis=0) + mean
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


@one_thread
def fit_process(
    x: Array, y: Array, noise: Array, family: Family, seed: int = 0, sizes: Sequence[int] = ()
) -> GaussianProcess:
    """Fit length scales, distances of categories, variance and nugget."""
    # Shapes: x (n, k); y (n,); noise (n,).
    rng = np.random.default_rng(seed)
    k, p, tail = x.shape[1] - bool(sizes), fitted(sizes), [1.0, FIRST_NUGGET]
    starts = [np.log([FIRST_LENGTH * np.sqrt(k)] * k + [FIRST_DISTANCE] * p + tail)]
    for _ in range(RESTARTS):
        lengths, apart = _between(rng, RESTART_LENGTHS, k), _between(rng, RESTART_DISTANCES, p)
        starts.append(np.array([*lengths, *apart, *np.log(tail)]))
    ends = [LENGTHS] * k + [DISTANCES] * p + [VARIANCES, NUGGETS]
    bounds = [tuple(np.log(search)) for search in ends]

    def cost(theta: Array) -> tuple[float, Array]:
        value, slope = log_likelihood(theta, x, y, noise, family, sizes)
        return (-value, -slope) if np.isfinite(value) else (IMPOSSIBLE, np.zeros_like(theta))

    def searched(start: Array, steps: int) -> scipy.optimize.OptimizeResult:
        return scipy.optimize.minimize(
            cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": steps}
        )

    best = min((searched(start, STEPS) for start in starts), key=lambda search: float(search.fun))
    if best.status == BY_COUNT:
        best = searched(np.asarray(best.x), MOST_STEPS)
    settled(best, "length scales of the emulator", by_lines=True)
    return condition(x, y, noise, hyperparameters(np.asarray(best.x), family, sizes))


def _between(rng: np.random.Generator, ends: tuple[float, float], count: int) -> Array:
    """Logarithms drawn evenly between two ends."""
    low, high = np.log(ends)
    return np.asarray(low + rng.random(count) * (high - low))


def hyperparameters(theta: Array, family: Family, sizes: Sequence[int] = ()) -> Hyperparameters:
    """Read the logarithms of length scales, distances, variance and nugget, shape (k + p + 2,)."""
    values = np.exp(theta)
    k = values.size - 2 - fitted(sizes)
    categories = CategoryCorrelation.of(values[k:-2], sizes) if sizes else None
    kernel = Kernel(family, values[:k], categories)
    return Hyperparameters(kernel, float(values[-2]), float(values[-1]))


def condition(x: Array, y: Array, noise: Array, fitted: Hyperparameters) -> GaussianProcess:
    """Condition a process with known hyperparameters on runs."""
    matrix = fitted.variance * fitted.kernel.correlation(x, x)
    matrix[np.diag_indices_from(matrix)] += noise + fitted.variance * fitted.nugget
    factor = scipy.linalg.cholesky(matrix, lower=True)
    projected = _projected(factor, fitted.kernel.constants(x))
    return GaussianProcess(x, y, noise, fitted, factor, projected, projected @ y)


def _projected(factor: Array, constants: Array) -> Array:
    """K^-1 with the columns of the constant means projected out, shape (n, n)."""
    lower, _ = scipy.linalg.lapack.dpotri(factor, lower=1)
    inverse = lower + lower.T  # the factor has zeros above its diagonal, and so has the inverse
    inverse[np.diag_indices_from(inverse)] = np.diag(lower)
    solved = inverse @ constants
    return np.asarray(
        inverse - solved @ scipy.linalg.solve(constants.T @ solved, solved.T, assume_a="pos")
    )


def log_likelihood(
    theta: Array, x: Array, y: Array, noise: Array, family: Family, sizes: Sequence[int] = ()
) -> tuple[float, Array]:
    """Restricted log likelihood without its constant, and its gradient."""
    # Shapes: theta (k + p + 2,); returns (k + p + 2,).
    at = hyperparameters(theta, family, sizes)
    correlation, shared = at.kernel.with_slope(x)
    matrix = at.variance * correlation
    matrix[np.diag_indices_from(matrix)] += noise + at.variance * at.nugget
    constants = at.kernel.constants(x)
    try:
        factor = scipy.linalg.cholesky(matrix, lower=True, check_finite=False)
        half = scipy.linalg.solve_triangular(factor, constants, lower=True)
        means = scipy.linalg.cholesky(half.T @ half, lower=True)
    except scipy.linalg.LinAlgError:
        return -np.inf, np.zeros_like(theta)
    projected = _projected(factor, constants)
    weights = projected @ y
    value = -np.log(np.diag(factor)).sum() - np.log(np.diag(means)).sum() - 0.5 * (y @ weights)
    # dL = 1/2 sum W dK with W = Pyy'P - P, P as in _projected
    outer = np.outer(weights, weights) - projected
    part = at.variance * outer * shared
    numbers = at.kernel.numbers(x)
    lengths = (
        part.sum(axis=1) @ numbers**2 - np.einsum("ij,ij->j", numbers, part @ numbers)
    ) / at.kernel.lengths**2
    share = at.variance * outer * correlation
    nugget = 0.5 * at.variance * at.nugget * float(np.trace(outer))
    variance = 0.5 * float(share.sum()) + nugget
    apart = []
    if at.kernel.categories is not None:
        by_combination = constants.T @ share @ constants
        apart = [0.5 * (by_combination * s).sum() for s in at.kernel.categories.slopes()]
    return float(value), np.array([*lengths, *apart, variance, nugget])


# Functions drawn from the posterior: Matheron's rule with random features.

#: random features of a prior path (Rahimi and Recht 2007) and paths that are drawn
FEATURES = 1000
PATHS = 40


def draw_paths(process: GaussianProcess, seed: int, paths: int = PATHS) -> Callable[[Array], Array]:
    """Draw functions from the posterior (Wilson et al. 2021).

    A path is a function of the prior, plus what the process makes of the difference between the
    data and that function at the runs. Values have the shape (m, 1 + paths), the posterior mean
    first, at points of the unit box of shape (m, k).
    """
    rng = np.random.default_rng(seed)
    fitted = process.hyperparameters
    kernel = fitted.kernel
    frequencies = kernel.frequencies(rng, FEATURES)
    phases = rng.uniform(0.0, 2.0 * np.pi, FEATURES)
    size = np.sqrt(2.0 * fitted.variance / FEATURES)
    parts = np.ones((1, 1)) if kernel.categories is None else kernel.categories.parts
    independent = size * rng.standard_normal((len(parts), FEATURES, paths))
    # of each path (features, paths), for every combination of categories
    amplitudes = np.tensordot(parts, independent, axes=1)

    def prior(x: Array) -> Array:
        which = kernel.combination(x)
        values = np.empty((len(x), paths))
        for combination in np.unique(which):
            here = which == combination
            # half the digits: a path of 1,000 cosines is a few percent off the process anyway
            angles = (kernel.numbers(x[here]) @ frequencies.T + phases).astype(np.float32)
            values[here] = np.cos(angles) @ amplitudes[combination].astype(np.float32)
        return values

    deviation = np.sqrt(process.noise + fitted.variance * fitted.nugget)
    noise = deviation[:, None] * rng.standard_normal((process.y.size, paths))
    # the data, and the data without each path
    rest = np.column_stack([process.y, process.y[:, None] - prior(process.x) - noise])

    def values(x: Array) -> Array:
        paths_at = process.interpolated(rest, x)
        paths_at[:, 1:] += prior(x)
        return paths_at

    return values
