"""Sparse symmetric indefinite solves: PARDISO where it installs, SuperLU everywhere.

Both are given the fixed pattern once and then only new numbers. PARDISO is used with
matrix type -2 (real, symmetric, indefinite), which halves the time and memory of the
unsymmetric default.
"""

from __future__ import annotations

import importlib.util
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from study.forward.pattern import Pattern

Array = NDArray[np.float64]


class SingularMatrixError(ArithmeticError):
    """The matrix could not be factorized."""


class LinearSolver(Protocol):
    """What Newton needs of a direct solver."""

    name: str

    @property
    def exact(self) -> bool:
        """Whether solutions have double precision; otherwise about five digits."""

    def sharpen(self) -> None:
        """Have double precision from the next factorization on."""

    def forget(self) -> None:
        """Go back to the precision it began with."""

    def factorize(self, data: Array) -> None:
        """Factorize the matrix with these entries of the pattern."""

    def solve(self, right: Array) -> Array:
        """Solve for one (n,) or several (n, k) right-hand sides."""

    def worth(self) -> float:
        """How many back-substitutions a factorization costs, by counts; 0 before the first."""

    def close(self) -> None:
        """Give the memory back."""


def pardiso_available() -> bool:
    """Whether the fast solver is installed."""
    return importlib.util.find_spec("pypardiso") is not None


def make_solver(
    pattern: Pattern, name: str = "auto", *, plane: bool = False, corrected: bool = False
) -> LinearSolver:
    """Return a solver for a pattern: ``auto``, ``pardiso`` or ``superlu``.

    ``plane`` says that it comes from a mesh in two dimensions: another ordering pays there.
    ``corrected`` says that solutions need not be exact: see :class:`LinearSolver`.
    """
    if name == "superlu" or (name == "auto" and not pardiso_available()):
        return SuperLU(pattern)
    from study.forward.pardiso import Pardiso

    return Pardiso(pattern, plane=plane, corrected=corrected)


#: back-substitutions that a factorization of SuperLU costs, over the entries of a column
_PER_LENGTH = 0.1


class SuperLU:
    """SciPy's SuperLU in symmetric mode: always there, many times slower in 3D."""

    name = "superlu"
    exact = True

    def __init__(self, pattern: Pattern) -> None:
        n = pattern.free.size
        upper = sp.csr_matrix(
            (np.arange(1.0, pattern.indices.size + 1), pattern.indices, pattern.indptr),
            shape=(n, n),
        )
        full = (upper + sp.triu(upper, 1).T).tocsc()
        full.sort_indices()
        self._source = full.data.astype(np.int64) - 1
        self._matrix = full
        self._factors: Any = None

    def factorize(self, data: Array) -> None:
        """Factorize with minimum degree on A + A' and a small pivot threshold."""
        from scipy.sparse.linalg import splu

        self._matrix.data = data[self._source]
        try:
            self._factors = splu(
                self._matrix,
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=1e-3,
                options={"SymmetricMode": True},
            )
        except RuntimeError as error:
            raise SingularMatrixError(str(error)) from error

    def solve(self, right: Array) -> Array:
        """Back-substitution for one or several right-hand sides."""
        return np.asarray(self._factors.solve(np.asarray(right, dtype=np.float64)))

    def sharpen(self) -> None:
        """Do nothing: there is only double precision."""

    def forget(self) -> None:
        """Do nothing: there is only double precision."""

    def worth(self) -> float:
        """By counts: columns of the factors are as long as their entries over their number."""
        if self._factors is None:
            return 0.0
        return _PER_LENGTH * float(self._factors.nnz) / float(self._matrix.shape[0])

    def close(self) -> None:
        """Drop the factors."""
        self._factors = None
