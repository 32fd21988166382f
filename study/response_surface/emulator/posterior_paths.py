"""Functions drawn from the posterior: Matheron's rule with random features."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.response_surface.emulator.gaussian_process import GaussianProcess

#: random features of a prior path (Rahimi and Recht 2007) and paths that are drawn
FEATURES = 1000
PATHS = 40


@dataclass(frozen=True)
class PosteriorPaths:
    """The posterior mean and functions drawn from the posterior (Wilson et al. 2021).

    A path is a function of the prior, plus what the process makes of the difference between
    the data and that function at the runs.

    Parameters
    ----------
    process : GaussianProcess
        What is drawn from.
    frequencies : array, shape (features, k)
        Of the cosines.
    phases : array, shape (features,)
        In radians.
    amplitudes : array, shape (p, features, paths)
        Of each path, for every combination of categories; p is 1 without them.
    differences : array, shape (n, 1 + paths)
        The data, and the data without each path.
    """

    process: GaussianProcess
    frequencies: Array
    phases: Array
    amplitudes: Array
    differences: Array

    def values(self, x: Array) -> Array:
        """Values, shape (m, 1 + paths), at points (m, k) of the unit box; the mean comes first."""
        found = self.process.interpolated(self.differences, x)
        found[:, 1:] += _prior(self.process, x, self.frequencies, self.phases, self.amplitudes)
        return found


def draw_paths(process: GaussianProcess, seed: int, paths: int = PATHS) -> PosteriorPaths:
    """Draw functions from the posterior.

    Parameters
    ----------
    process : GaussianProcess
        What is drawn from.
    seed : int
        Of the generator.
    paths : int
        Number of functions.
    """
    rng = np.random.default_rng(seed)
    found = process.found
    frequencies = found.kernel.frequencies(rng, FEATURES)
    phases = rng.uniform(0.0, 2.0 * np.pi, FEATURES)
    size = np.sqrt(2.0 * found.variance / FEATURES)
    categories = found.kernel.categories
    parts = np.ones((1, 1)) if categories is None else categories.parts
    independent = size * rng.standard_normal((len(parts), FEATURES, paths))
    amplitudes = np.tensordot(parts, independent, axes=1)
    prior = _prior(process, process.x, frequencies, phases, amplitudes)
    deviation = np.sqrt(process.noise + found.variance * found.nugget)
    noise = deviation[:, None] * rng.standard_normal((process.y.size, paths))
    differences = np.column_stack([process.y, process.y[:, None] - prior - noise])
    return PosteriorPaths(process, frequencies, phases, amplitudes, differences)


def _prior(
    process: GaussianProcess, x: Array, frequencies: Array, phases: Array, amplitudes: Array
) -> Array:
    """Paths of the prior, shape (m, paths), at points of the unit box."""
    kernel = process.found.kernel
    which = kernel.combination(x)
    found = np.empty((len(x), amplitudes.shape[2]))
    for one in np.unique(which):
        own = which == one
        # half the digits: a path of 1,000 cosines is a few percent off that of the process anyway
        angles = (kernel.numbers(x[own]) @ frequencies.T + phases).astype(np.float32)
        found[own] = np.cos(angles) @ amplitudes[one].astype(np.float32)
    return found
