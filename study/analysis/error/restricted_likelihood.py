"""Restricted likelihood of a mixed model (Patterson and Thompson 1971, Biometrika 58, 545)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import qr
from scipy.optimize import minimize

from study.arrays import Array, Ints
from study.errors import RefusedError

# of the longest column: what an axis keeps below this share of it is rounding
_ROUNDING = 1e-12


@dataclass(frozen=True)
class _Blocks:
    """Response and effects of every block in the axes that see an effect, and what lies beside.

    Shapes: y (blocks, k), x (blocks, k, r), patterns (blocks, k, k), the covariances of random
    effects of unit variance. A block that sees fewer than k axes has zeros in the others;
    ``rows_left``, the rows beyond all axes, is less by as many.
    """

    y: Array
    x: Array
    patterns: tuple[Array, ...]
    rows_left: int
    squares_left: float

    def whiten(self, sd: Array) -> tuple[float, Array, Array]:
        """Return log det V, and W x and W y with W'W the inverse of the covariance V.

        Raises
        ------
        LinAlgError
            If V is not positive.
        """
        v = sd[-1] ** 2 * np.eye(self.y.shape[1]) + np.zeros_like(self.patterns[0])
        for one, pattern in zip(sd, self.patterns, strict=False):
            v += one**2 * pattern
        lower = np.linalg.cholesky(v)
        both = np.linalg.solve(lower, np.concatenate([self.x, self.y[:, :, None]], axis=2))
        log_det = 2 * float(np.log(np.diagonal(lower, axis1=1, axis2=2)).sum())
        rows = both.reshape(-1, both.shape[2])
        return log_det, rows[:, :-1], rows[:, -1]


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
        Indicators of the levels of every random effect: first the blocks, then what lies in
        blocks, so that rows of two blocks are independent.
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
        few = self._blocks
        try:
            log_det, x, y = few.whiten(sd)
        except np.linalg.LinAlgError:
            return float("inf")
        information = x.T @ x
        r = y - x @ np.linalg.solve(information, x.T @ y)
        found = log_det + r @ r
        if sd[-1] > 0:
            found += few.rows_left * np.log(sd[-1] ** 2) + few.squares_left / sd[-1] ** 2
        found += (self.y.size - restricted * self.x.shape[1]) * np.log(2 * np.pi)
        if restricted:
            found += np.linalg.slogdet(information)[1] - self._fixed_log_det
        return float(found)

    @cached_property
    def _fixed_log_det(self) -> float:
        return float(np.linalg.slogdet(self.x.T @ self.x)[1])

    @cached_property
    def _blocks(self) -> _Blocks:
        """The rows of every block in axes of which only the first few see an effect.

        Blocks are independent, and the likelihood does not change under a rotation. Beyond the
        space of its indicators and fixed columns every axis of a block holds scatter within
        alone, so their sum of squares is all that counts of them.
        """
        turned = [self._turned(np.flatnonzero(block)) for block in self.random[0].T if block.any()]
        k = max(y.size for y, *_ in turned)
        shape = len(turned), k
        y, x = np.zeros(shape), np.zeros((*shape, self.x.shape[1]))
        patterns = tuple(np.zeros((*shape, k)) for _ in self.random)
        for i, (own_y, own_x, own_z, _) in enumerate(turned):
            y[i, : own_y.size], x[i, : own_y.size] = own_y, own_x
            for pattern, z in zip(patterns, own_z, strict=True):
                pattern[i, : own_y.size, : own_y.size] = z @ z.T
        squares = sum(left for *_, left in turned)
        return _Blocks(y, x, patterns, self.y.size - y.size, squares)

    def _turned(self, rows: Ints) -> tuple[Array, Array, list[Array], float]:
        """Response, fixed columns and indicators of some rows in the axes that see an effect."""
        y, x, random = self.y[rows], self.x[rows], [z[rows] for z in self.random]
        q, r = qr(np.hstack([x, *random]), mode="economic", pivoting=True)[:2]
        seen = np.abs(np.diag(r)) > _ROUNDING * np.abs(r[0, 0])
        q = q[:, : seen.size][:, seen]
        left = y - q @ (q.T @ y)
        return q.T @ y, q.T @ x, [q.T @ z for z in random], float(left @ left)

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
            if found.success and (best is None or found.fun < best[0]):
                best = (float(found.fun), full(np.asarray(found.x)))
        if best is None:
            raise RefusedError(f"no variance components have the least deviance: {found.message}")
        return best[1], best[0]
