"""Solves with a tangent by the factorization of an earlier one, for as long as that pays.

From one Newton iteration to the next a tangent changes little: the factors of an old one
make a preconditioner with which GMRES needs a few back-substitutions, where a solid's new
factorization costs twenty (Saad 2003, sec. 9.4: the flexible variant, which keeps the
preconditioned directions, so that nothing is solved twice). When to factorize anew is
decided by counts of operations, never by a clock: a result does not depend on the load
of the machine.

The same iteration corrects factors in single precision, down to what the Newton iteration asks
of this solve (Carson and Higham 2018, SIAM J. Sci. Comput. 40, A817).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from study.arrays import Array
from study.fem.element.sparsity import Pattern, symmetric_product
from study.fem.solver.linear_solver import LinearSolver

Operator = Callable[[Array], Array]

#: iterations worth less than this are no gain over factorizing: small systems never reuse
_WORTH = 6.0

#: of what slowed the last solve down, the part that is believed after one that was not tried
_FADES = 0.8

#: residual of a Newton step that tells as little of the next as a smaller one
_LEAST = 1e-3

#: corrections of a solution in single precision, of which each brings some four digits
_CORRECTIONS = 8

#: contact points that may have changed sides, each of them a direction more to search
_SWITCHED = 0.25


class KeptFactors:
    """A direct solver whose factors serve later matrices of the same pattern.

    Parameters
    ----------
    solver : LinearSolver
        Factorizes, and solves with its last factorization.
    pattern : Pattern
        Upper triangle of the matrices.
    """

    def __init__(self, solver: LinearSolver, pattern: Pattern) -> None:
        self.solver, self._pattern = solver, pattern
        self._spent: list[int] = []
        self._touching: NDArray[np.bool_] | None = None
        self._change = self._sensitivity = 0.0

    def renewed(self, touching: NDArray[np.bool_]) -> None:
        """Say that the solver has just factorized, with these contact points closed."""
        self._spent, self._touching, self._change = [], touching, 0.0

    def forget(self) -> None:
        """Factorize first: what another run left behind must not change a digit of this one."""
        self._touching, self._sensitivity = None, 0.0
        self.solver.forget()

    def serves(self, touching: NDArray[np.bool_]) -> bool:
        """Whether the factors are of a tangent with these contact points closed."""
        return self._touching is not None and np.array_equal(touching, self._touching)

    def solve(
        self,
        data: Array,
        right: Array,
        scale: Array,
        tolerance: float,
        touching: NDArray[np.bool_],
        change: float,
    ) -> Array | None:
        """Solve to a relative residual of ``tolerance``, rows weighted by ``scale``.

        None where a new factorization is cheaper. ``change`` is the size of Newton's next step,
        by its residual.
        """
        self._change += max(change, _LEAST)
        budget = self._budget(touching)
        if budget < 1:
            return None
        if self._expected(tolerance) > budget:
            self._sensitivity *= _FADES
            return None
        found, count, left = self._krylov(data, right, scale, tolerance, budget)
        self._spent.append(count)
        self._sensitivity = min(left ** (1 / count), 1.0) / self._change
        return found

    def solve_afresh(self, data: Array, right: Array, scale: Array, tolerance: float) -> Array:
        """Solve with the factors of this very matrix, corrected where they are not exact.

        Where corrections do not do, it is factorized once more, in double precision.
        """
        if not self.solver.exact:
            found, _, _ = self._krylov(data, right, scale, tolerance, _CORRECTIONS)
            if found is not None:
                return found
            self.solver.sharpen()
            self.solver.factorize(data)
        return self.solver.solve(right)

    def _expected(self, tolerance: float) -> float:
        """Foresee the iterations: each leaves a share that grows with the tangent's change."""
        share = self._sensitivity * self._change
        if share == 0:
            return 0.0
        return float(np.log(tolerance) / np.log(share)) if share < 1 else np.inf

    def _budget(self, touching: NDArray[np.bool_]) -> int:
        """Back-substitutions that may be spent on the next solve.

        A factorization is shared by the solves that it serves: it is kept while the next
        one is expected to cost less than the average so far.
        """
        worth = self.solver.worth()
        if self._touching is None or worth < _WORTH:
            return 0
        if np.count_nonzero(touching != self._touching) > _SWITCHED * worth:
            return 0
        average = (worth + sum(self._spent)) / (len(self._spent) + 1)
        if self._spent and self._spent[-1] > average:
            return 0
        return int(average)

    def _krylov(
        self, data: Array, right: Array, scale: Array, tolerance: float, most: int
    ) -> tuple[Array | None, int, float]:
        indptr, indices = self._pattern.indptr, self._pattern.indices

        def product(v: Array) -> Array:
            return scale * symmetric_product(indptr, indices, data, v)

        def precondition(v: Array) -> Array:
            return self.solver.solve(v / scale)

        return fgmres(product, precondition, scale * right, tolerance, most)


def fgmres(
    product: Operator, precondition: Operator, b: Array, tolerance: float, most: int
) -> tuple[Array | None, int, float]:
    """Solve ``product(x) = b`` in at most ``most`` iterations; None where they do not suffice.

    Saad (1993), SIAM J. Sci. Comput. 14, 461, algorithm 2.2, without restarts.

    Parameters
    ----------
    product, precondition : callable
        Matrix times a vector, and an approximate solve with it, (n,) to (n,).
    b : ndarray, shape (n,)
        Right-hand side.
    tolerance : float
        On the norm of the residual over that of ``b``.
    most : int
        Iterations, each of one product and one approximate solve.

    Returns
    -------
    x : ndarray or None
    iterations : int
    left : float
        Residual over that of zero.
    """
    size = float(np.linalg.norm(b))
    if size == 0:
        return np.zeros_like(b), 1, 0.0
    basis, directions = [b / size], list[Array]()
    triangle, right = np.zeros((most, most)), [size]
    rotations = list[tuple[float, float]]()
    for j in range(most):
        directions.append(precondition(basis[j]))
        w = product(directions[j])
        column = _orthogonalized(w, basis)
        norm = column[-1]
        triangle[: j + 1, j] = _rotated(column, right, rotations)
        left = abs(right[-1])
        if left <= tolerance * size:
            y = np.linalg.solve(triangle[: j + 1, : j + 1], right[:-1])
            return np.asarray(np.column_stack(directions) @ y), j + 1, left / size
        if not np.isfinite(norm) or norm <= 1e-14 * size:
            return None, j + 1, left / size
        # too slow at the rate so far: the rest of the budget would be lost as well
        if j >= 1 and np.log(tolerance) * (j + 1) < np.log(left / size) * most:
            return None, j + 1, left / size
        basis.append(w / norm)
    return None, most, left / size


def _orthogonalized(w: Array, basis: list[Array]) -> list[float]:
    """Take the parts along ``basis`` away from ``w``; return them, and the norm of the rest."""
    column = [0.0] * len(basis)
    for _ in range(2):  # Gram-Schmidt twice is enough
        for i, v in enumerate(basis):
            h = float(np.einsum("i,i->", v, w))  # no threads for so little
            column[i] += h
            w -= h * v
    return [*column, math.sqrt(np.einsum("i,i->", w, w))]


def _rotated(
    column: list[float], right: list[float], rotations: list[tuple[float, float]]
) -> list[float]:
    """Next column of the triangle: plane rotations take away what is below the diagonal.

    The rotation of this column joins ``rotations`` and turns the end of ``right``, which then
    holds the residual (Saad 2003, sec. 6.5.3).
    """
    for i, (c, s) in enumerate(rotations):
        upper, lower = column[i], column[i + 1]
        column[i], column[i + 1] = c * upper + s * lower, c * lower - s * upper
    *above, last, below = column
    size = math.hypot(last, below)
    c, s = (last / size, below / size) if size > 0 else (0.0, 1.0)
    rotations.append((c, s))
    right[-1:] = [c * right[-1], -s * right[-1]]
    return [*above, size]
