"""Restricted likelihood of a mixed model (Patterson and Thompson 1971, Biometrika 58, 545)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from study.arrays import Array


@dataclass(frozen=True)
class Likelihood:
    """Restricted or full likelihood as a function of standard deviations (blocks ..., within).

    Parameters
    ----------
    y : ndarray, shape (n,)
        Response.
    x : ndarray, shape (n, r)
        Columns of the fixed effects.
    random : tuple of ndarray, shape (n, levels)
        Indicators of the levels of every random effect.
    """

    y: Array
    x: Array
    random: tuple[Array, ...]

    def covariance(self, sd: Array) -> Array:
        """Covariance of the response, shape (n, n)."""
        v: Array = sd[-1] ** 2 * np.eye(self.y.size)
        for one, z in zip(sd, self.random, strict=False):
            v += one**2 * (z @ z.T)
        return v

    def deviance(self, sd: Array, restricted: bool) -> float:
        """-2 log likelihood."""
        try:
            root = cho_factor(self.covariance(sd), lower=True)
        except np.linalg.LinAlgError:
            return float("inf")
        vx = cho_solve(root, self.x)
        information = self.x.T @ vx
        beta = np.linalg.solve(information, vx.T @ self.y)
        r = self.y - self.x @ beta
        n = self.y.size - (self.x.shape[1] if restricted else 0)
        found = 2 * np.log(np.diag(root[0])).sum() + r @ cho_solve(root, r) + n * np.log(2 * np.pi)
        if restricted:
            found += np.linalg.slogdet(information)[1] - np.linalg.slogdet(self.x.T @ self.x)[1]
        return float(found)

    @cached_property
    def scale(self) -> float:
        """Standard deviation of all rows about the fixed effects."""
        residual = self.y - self.x @ np.linalg.lstsq(self.x, self.y)[0]
        return float(np.sqrt(residual @ residual / max(self.y.size - self.x.shape[1], 1)))

    def fit(self, restricted: bool, held: tuple[int, float] | None = None) -> tuple[Array, float]:
        """Find the standard deviations of least deviance; one of them may be held."""
        k = len(self.random) + 1
        free = [i for i in range(k) if held is None or i != held[0]]

        def full(values: Array) -> Array:
            sd = np.zeros(k)
            sd[free] = np.abs(values) * self.scale
            if held is not None:
                sd[held[0]] = held[1]
            return sd

        best: tuple[float, Array] | None = None
        for share in (0.3, 1.0):
            start = np.where(np.array(free) == k - 1, 1.0, share)
            found = minimize(
                lambda v: self.deviance(full(v), restricted), start, method="Nelder-Mead",
                options={"xatol": 1e-9, "fatol": 1e-10, "maxiter": 4000},
            )  # fmt: skip
            if best is None or found.fun < best[0]:
                best = (float(found.fun), full(np.asarray(found.x)))
        if best is None:
            raise ValueError("no start")
        return best[1], best[0]
