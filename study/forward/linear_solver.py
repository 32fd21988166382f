"""Sparse symmetric indefinite solves: PARDISO where it installs, SuperLU everywhere.

Both are given the fixed pattern once and then only new numbers. PARDISO is used with
matrix type -2 (real, symmetric, indefinite), which halves the time and memory of the
unsymmetric default.
"""

from __future__ import annotations

import copy
import functools
import importlib.util
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from study.forward.pattern import Pattern, symmetric_product
from study.forward.threads import threads_sleep_after_work

Array = NDArray[np.float64]


class SingularMatrixError(ArithmeticError):
    """The matrix could not be factorized."""


class LinearSolver(Protocol):
    """What Newton needs of a direct solver."""

    name: str

    def factorize(self, data: Array) -> None:
        """Factorize the matrix with these entries of the pattern."""

    def solve(self, right: Array) -> Array:
        """Solve for one (n,) or several (n, k) right-hand sides."""

    def negative_eigenvalues(self) -> int | None:
        """Count the negative eigenvalues of the last matrix; None where that is unknown."""

    def worth(self) -> float:
        """How many back-substitutions a factorization costs, by counts; 0 before the first."""

    def close(self) -> None:
        """Give the memory back."""


def pardiso_available() -> bool:
    """Whether the fast solver is installed."""
    return importlib.util.find_spec("pypardiso") is not None


def make_solver(pattern: Pattern, name: str = "auto", *, plane: bool = False) -> LinearSolver:
    """Return a solver for a pattern: ``auto``, ``pardiso`` or ``superlu``.

    ``plane`` says that it comes from a mesh in two dimensions: another ordering pays there.
    """
    if name == "superlu" or (name == "auto" and not pardiso_available()):
        return SuperLU(pattern)
    return Pardiso(pattern, plane=plane)


#: MKL's settings by their numbers from 1; the others are zero
_IPARM = {
    1: 1,  # these settings, not MKL's own
    2: 2,  # nested dissection, and for small systems minimum degree (0)
    8: 0,  # refine only where pivots were perturbed: Newton corrects itself
    10: 8,  # perturb pivots below 1e-8 of the norm
    18: -1,  # count the entries of the factors
    19: -1,  # and the operations, in millions
    21: 1,  # Bunch-Kaufman pivoting for an indefinite matrix
}

#: unknowns of plane and of solid meshes up to which minimum degree orders in half the time of
#: nested dissection and no worse, and threads wait for each other more than they help
_PLANE, _SOLID = 30_000, 3_000

#: scaling and weighted matching: for matrices whose diagonal gives no good pivots
_MATCHING = {11: 1, 13: 1}
#: residual of a solution, over its right-hand side, above which the factorization is not
#: trusted; below it Newton corrects what perturbed pivots leave
_TRUSTED = 0.05
#: residual over matrix times solution: stays small where only the matrix is nearly singular
_BACKWARD = 1e-11
#: operations of a factorization in the time that a back-substitution takes for an entry, and
#: what a factorization does with an entry besides, in the same time
_PER_ENTRY, _BESIDES = 38.0, 5.0
#: back-substitutions that a factorization of SuperLU costs, over the entries of a column
_PER_LENGTH = 0.1
#: parameters of PARDISO: the ordering, and the count of negative eigenvalues
_ORDERING, _NEGATIVE = 2, 23


@functools.cache
def _pardiso_template() -> Any:
    """Find the MKL library once: pypardiso searches the whole environment for each solver."""
    import pypardiso

    template = pypardiso.PyPardisoSolver(mtype=-2)
    template.libmkl.MKL_Get_Max_Threads()  # loads the library of its threads
    threads_sleep_after_work()
    return template


def _fresh_pardiso() -> Any:
    template = _pardiso_template()
    solver = copy.copy(template)
    solver.pt, solver.iparm = np.zeros_like(template.pt), np.zeros_like(template.iparm)
    for number, value in _IPARM.items():
        solver.iparm[number - 1] = value
    return solver


class Pardiso:
    """MKL PARDISO: symbolic analysis once, numerical factorization for each matrix.

    A solution that does not solve its system (pivots had to be perturbed, as with the zero
    diagonal of an incompressible body) makes the solver change over to weighted matching,
    which looks at the values and is analyzed anew for each matrix.
    """

    name = "pardiso"

    def __init__(self, pattern: Pattern, *, plane: bool = False) -> None:
        import pypardiso

        self._error: type[Exception] = pypardiso.pardiso_wrapper.PyPardisoError
        self._solver = _fresh_pardiso()
        n = pattern.free.size
        self._small = n <= (_PLANE if plane else _SOLID)
        if self._small:
            self._solver.iparm[_ORDERING - 1] = 0
        self._matrix = sp.csr_matrix(
            (np.zeros(pattern.indices.size), pattern.indices, pattern.indptr), shape=(n, n)
        )
        self._analyzed = self._matching = self._trusted = False

    def factorize(self, data: Array) -> None:
        """Numerical factorization (phase 22), after the analysis (11) the first time."""
        np.copyto(self._matrix.data, data)  # the factors outlive the entries they came from
        self._trusted = False
        empty = np.zeros(self._matrix.shape[0])
        if not self._analyzed or self._matching:
            self._call(11, empty)
            self._analyzed = True
        self._call(22, empty)

    def solve(self, right: Array) -> Array:
        """Back-substitution (phase 33) for one or several right-hand sides."""
        b = np.asfortranarray(right, dtype=np.float64)
        x = np.ascontiguousarray(self._call(33, b))
        if self._matching or self._trusted or self._solved(x, b):
            self._trusted = True
            return x
        self._matching = True
        for number, value in _MATCHING.items():
            self._solver.iparm[number - 1] = value
        self.factorize(self._matrix.data)
        return np.ascontiguousarray(self._call(33, b))

    def _solved(self, x: Array, b: Array) -> bool:
        """Whether ``x`` solves this system or one next to it (Higham 2002, sec. 7.1)."""
        upper = self._matrix
        product = np.empty_like(x)
        for column, into in zip(np.atleast_2d(x.T), np.atleast_2d(product.T), strict=True):
            into[:] = symmetric_product(
                upper.indptr, upper.indices, upper.data, np.ascontiguousarray(column)
            )
        residual, size = float(np.linalg.norm(b - product)), float(np.linalg.norm(b))
        if residual <= _TRUSTED * size:
            return True
        largest = float(np.abs(upper.data).max()) * float(np.linalg.norm(x))
        return residual <= _BACKWARD * (largest + size)

    def negative_eigenvalues(self) -> int | None:
        """Count the negative eigenvalues of the last factorized matrix."""
        return int(self._solver.iparm[_NEGATIVE - 1])

    def worth(self) -> float:
        """By counts: operations of a factorization, entries read in a back-substitution."""
        if self._matching or not self._analyzed:
            return 0.0
        entries, millions = (float(self._solver.iparm[n - 1]) for n in (18, 19))
        read = max(entries + float(self._matrix.data.size), 1.0)
        return _BESIDES + 1e6 * millions / (_PER_ENTRY * read)

    def close(self) -> None:
        """Release the memory that MKL holds for this factorization."""
        if self._analyzed:
            self._call(-1, np.zeros(self._matrix.shape[0]))
            self._analyzed = False

    def _call(self, phase: int, b: Array) -> Array:
        self._solver.set_phase(phase)
        mkl = self._solver.libmkl
        threads = mkl.MKL_Set_Num_Threads_Local(1) if self._small else 0
        try:
            return np.asarray(self._solver._call_pardiso(self._matrix, b))
        except self._error as error:
            if error.args and error.args[0] == -2:
                raise MemoryError("the factorization does not fit into memory") from error
            raise SingularMatrixError(f"phase {phase}: {error}") from error
        finally:
            if self._small:
                mkl.MKL_Set_Num_Threads_Local(threads)

    def __del__(self) -> None:
        try:
            self.close()
        except Exception:  # noqa: BLE001 - interpreter shutdown: MKL may be gone already
            return


class SuperLU:
    """SciPy's SuperLU in symmetric mode: always there, many times slower in 3D."""

    name = "superlu"

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

    def negative_eigenvalues(self) -> int | None:
        """Unknown: row exchanges hide the signs of the pivots."""
        return None

    def worth(self) -> float:
        """By counts: columns of the factors are as long as their entries over their number."""
        if self._factors is None:
            return 0.0
        return _PER_LENGTH * float(self._factors.nnz) / float(self._matrix.shape[0])

    def close(self) -> None:
        """Drop the factors."""
        self._factors = None
