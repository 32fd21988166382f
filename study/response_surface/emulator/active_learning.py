"""Where further runs make an emulator surest (Cohn, Ghahramani and Jordan 1996; Gramacy 2020)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from study.arrays import Array
from study.response_surface.emulator.gaussian_process import GaussianProcess
from study.response_surface.emulator.kernels import Kernel

#: candidates for the next run, and points at which the gain is summed, as powers of two
CANDIDATES = 10
REFERENCES = 9

#: how far candidates reach beyond the box before they are cut: so the faces have some, too
STRETCH = 1.1

#: weight of the mean misfit where no run is near, in runs
PRIOR_RUNS = 1.0


def candidates(k: int, seed: int) -> Array:
    """Points of the unit box from which runs are chosen, shape (1024, k), some on its faces.

    Parameters
    ----------
    k : int
        Number of factors.
    seed : int
        Of the scrambled Sobol sequence.
    """
    from scipy.stats import qmc

    inside = qmc.Sobol(k, seed=seed).random_base2(CANDIDATES)
    return np.asarray(np.round(np.clip(0.5 + STRETCH * (inside - 0.5), 0.0, 1.0), 4))


@dataclass(frozen=True)
class Unsure:
    """What one emulator says of the box.

    Parameters
    ----------
    process : GaussianProcess
        Fitted to standardized responses at points of the unit box.
    power : float
        1 to lower the mean squared error, more to go where left-out runs were missed most.
    """

    process: GaussianProcess
    power: float = 1.0

    def gains(self, x: Array, at: Array, made: Array) -> Array:
        """Drop of the summed variance that a run at each candidate would bring, shape (m,).

        Parameters
        ----------
        x : array, shape (m, k)
            Candidates in the unit box.
        at : array, shape (r, k)
            Points over which the variance is summed.
        made : array, shape (n, k)
            Runs that are made or chosen, those without an answer too: a second run there would
            tell no more.
        """
        found = self.process.found
        kernel, nugget = found.kernel, found.nugget
        matrix = kernel.correlation(made, made)
        matrix[np.diag_indices_from(matrix)] += max(nugget, 1e-10)
        factor = linalg.cholesky(matrix, lower=True)
        half_x = linalg.solve_triangular(factor, kernel.correlation(made, x), lower=True)
        half_at = linalg.solve_triangular(factor, kernel.correlation(made, at), lower=True)
        shared = kernel.correlation(x, at) - half_x.T @ half_at
        own = np.maximum(1.0 - (half_x**2).sum(axis=0), 0.0) + max(nugget, 1e-10)
        gains = (shared**2) @ self._weights(at, kernel) / own
        return np.asarray(found.variance * gains / at.shape[0])

    def _weights(self, at: Array, kernel: Kernel) -> Array:
        """Square of the misfit of the runs near each point, over that which the process expects."""
        ratios = (self.process.loo_errors / self.process.loo_deviations) ** 2
        near = kernel.correlation(at, self.process.x)
        mean = float(ratios.mean())
        local = (near @ ratios + PRIOR_RUNS * mean) / (near.sum(axis=1) + PRIOR_RUNS)
        return np.asarray(local**self.power)


def next_run(unsure: Sequence[Unsure], x: Array, at: Array, made: Array) -> tuple[int, float]:
    """Candidate with the largest gain over all emulators, and that gain.

    Parameters
    ----------
    unsure : sequence of Unsure
        One a response; none where no emulator could be fitted: the candidate farthest from all
        runs is taken then.
    x, at, made : array
        As in `Unsure.gains`.
    """
    if not unsure:
        apart = np.min(np.abs(x[:, None, :] - made[None, :, :]).sum(axis=2), axis=1)
        best = int(apart.argmax())
        return best, float(apart[best])
    gains = np.sum([one.gains(x, at, made) for one in unsure], axis=0)
    best = int(gains.argmax())
    return best, float(gains[best])
