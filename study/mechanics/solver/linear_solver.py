"""Sparse symmetric indefinite solves: PARDISO where it installs, SuperLU everywhere.

Both are given the fixed pattern once and then only new numbers. PARDISO is used with
matrix type -2 (real, symmetric, indefinite), which halves the time and memory of the
unsymmetric default.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.util
import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from study.ground.arrays import Array, Flags
from study.ground.compilation import threads_sleep_after_work
from study.mechanics.element.function_space import Pattern, symmetric_product

if TYPE_CHECKING:
    from scipy.sparse.linalg import SuperLU as Factors


class SingularMatrixError(ArithmeticError):
    """The matrix could not be factorized."""


def pardiso_available() -> bool:
    """Whether the fast solver is installed."""
    return importlib.util.find_spec("pypardiso") is not None


def make_solver(
    pattern: Pattern, name: str = "auto", *, plane: bool = False, corrected: bool = False
) -> LinearSolver:
    """Return a solver for a pattern."""
    if name == "superlu" or (name == "auto" and not pardiso_available()):
        return SuperLU(pattern)
    return Pardiso(pattern, plane=plane, corrected=corrected)


#: back-substitutions that a factorization of SuperLU costs, over the entries of a column
_PER_LENGTH = 0.1


class SuperLU:
    """SciPy's SuperLU in symmetric mode: always there, many times slower in 3D."""

    name = "superlu"
    #: Whether solutions have double precision; otherwise about five digits.
    exact = True

    def __init__(self, pattern: Pattern) -> None:
        n = pattern.free.size
        numbers = np.arange(1.0, pattern.indices.size + 1)
        upper = sp.csr_matrix((numbers, pattern.indices, pattern.indptr), shape=(n, n))
        full = (upper + sp.triu(upper, 1).T).tocsc()
        full.sort_indices()
        self._source = full.data.astype(np.int64) - 1
        self._matrix = full
        self._factors: Factors | None = None

    def sharpen(self) -> None:
        """No need: it has double precision from the start."""

    forget = sharpen

    def weigh(self, weights: Array | None) -> None:
        """No need: pivots are compared within their column, and none is perturbed."""

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

    def solve(self, right: Array, *, refined: bool = True) -> Array:  # noqa: ARG002
        """Back-substitution for one (n,) or several (n, k) right-hand sides, never refined."""
        if self._factors is None:
            raise RuntimeError("solve needs a matrix: factorize first")
        return np.asarray(self._factors.solve(np.asarray(right, dtype=np.float64)))

    def worth(self) -> float:
        """How many back-substitutions a factorization costs, by counts; 0 before the first.

        Columns of the factors are as long as their entries over their number.
        """
        if self._factors is None:
            return 0.0
        return _PER_LENGTH * float(self._factors.nnz) / float(self._matrix.shape[0])

    def negative_pivots(self) -> int | None:
        """Negative eigenvalues of the matrix that factors make (Sylvester); None if not known.

        They are the signs of the pivots where all of them were taken from the diagonal.
        """
        factors = self._factors
        if factors is None or not np.array_equal(factors.perm_r, factors.perm_c):
            return None
        return int(np.count_nonzero(factors.U.diagonal() < 0))

    def unperturbed(self) -> bool:
        """Whether every pivot was large enough: SuperLU perturbs none."""
        return True


#: PARDISO's number for real, symmetric, indefinite matrices
_SYMMETRIC = -2

#: MKL's settings by their numbers from 1; the others are zero
_IPARM = {
    1: 1,  # these settings, not MKL's own
    2: 2,  # nested dissection, and for small systems minimum degree (0)
    8: 0,  # refine only where pivots were perturbed: Newton corrects itself
    10: 8,  # perturb pivots below 1e-8 of the norm
    18: -1,  # count the entries of the factors
    19: -1,  # and the operations, in millions
    21: 1,  # Bunch-Kaufman pivoting for an indefinite matrix
    35: 1,  # rows and columns are counted from zero
}

#: unknowns of plane and of solid meshes up to which minimum degree orders in half the time of
#: nested dissection and no worse; up to which threads wait for each other more than they help;
#: and from which factors in single precision save more than their corrections cost
_ORDERED = {True: 40_000, False: 3_000}
_ALONE = {True: 10_000, False: 3_000}
_SINGLE = {True: 2_500, False: 3_000}

#: scaling and weighted matching: for matrices whose diagonal gives no good pivots
_MATCHING = {11: 1, 13: 1}

#: residual of a solution, over its right-hand side, above which the factorization is not
#: trusted; below it Newton corrects what perturbed pivots leave
_TRUSTED = 0.05

#: residual over matrix times solution: stays small where only the matrix is nearly singular
_BACKWARD = 1e-11

#: operations of a factorization in the time that a back-substitution takes for an entry, and
#: what a factorization does with an entry besides, in the same time
_PER_ENTRY = 38.0
_BESIDES = 5.0

#: parameters of PARDISO: the ordering, perturbed and negative pivots, entries, operations
_ORDERING = 2
_PERTURBED = 14
_NEGATIVE = 23
_ENTRIES = 18
_MILLIONS = 19

#: index of the parameter that asks for single precision
_PRECISION = 28

#: phases: analysis, factorization, solution, its three parts unrefined, release of all memory
_ANALYZE = 11
_FACTORIZE = 22
_SOLVE = 33
_PARTS = (331, 332, 333)
_RELEASE = -1

#: PARDISO's number for a lack of memory
_NO_MEMORY = -2


@functools.cache
def _mkl() -> ctypes.CDLL:
    """Load the library from where pip puts it: pypardiso searches the environment for 0.5 s."""
    files = sorted(Path(sys.prefix, "lib").glob("libmkl_rt.so*"))
    library: ctypes.CDLL
    if files:
        library = ctypes.CDLL(str(files[0]))
        library.pardiso.restype = None
    else:
        import pypardiso

        library = pypardiso.PyPardisoSolver(mtype=_SYMMETRIC).libmkl
    library.MKL_Get_Max_Threads()  # loads the library of its threads
    threads_sleep_after_work()
    return library


@contextmanager
def _one_thread(mkl: ctypes.CDLL) -> Iterator[None]:
    before = mkl.MKL_Set_Num_Threads_Local(1)
    try:
        yield
    finally:
        mkl.MKL_Set_Num_Threads_Local(before)


def _whole(value: int) -> object:
    return ctypes.byref(ctypes.c_int32(value))


def _integers(values: NDArray[np.int32]) -> object:
    return values.ctypes.data_as(ctypes.POINTER(ctypes.c_int32))


class Pardiso:
    """Symbolic analysis once, numerical factorization for each matrix.

    A solution that does not solve its system (pivots had to be perturbed, as with the zero
    diagonal of an incompressible body) makes the solver change over to weighted matching,
    which looks at the values and is analyzed anew for each matrix.

    Large systems are factorized in single precision where the caller corrects what that leaves:
    half the time and half the memory. Pivots that would have to be perturbed there bring back
    double precision.
    MKL is called without pypardiso's own call, which copies the pattern every time.
    """

    name = "pardiso"

    def __init__(self, pattern: Pattern, *, plane: bool = False, corrected: bool = False) -> None:
        self._mkl = _mkl()
        self._handle = np.zeros(64, dtype=np.int64)
        self._iparm = np.zeros(64, dtype=np.int32)
        for number, value in _IPARM.items():
            self._iparm[number - 1] = value
        self._size = pattern.free.size
        self._small = self._size <= _ALONE[plane]
        if self._size <= _ORDERED[plane]:
            self._iparm[_ORDERING - 1] = 0
        self._indptr, self._indices = pattern.indptr, pattern.indices
        self._phase, self._columns = ctypes.c_int32(0), ctypes.c_int32(0)
        self._failed = ctypes.c_int32(0)
        self._matching = self._trusted = False
        self._weights: Array | None = None
        self._usually_exact = not (corrected and self._size > _SINGLE[plane])
        self._set_precision(self._usually_exact)

    def _set_precision(self, exact: bool) -> None:
        self.exact = exact
        entries = np.zeros(self._indices.size, np.float64 if exact else np.float32)
        self._data: NDArray[Any] = entries
        self._iparm[_PRECISION - 1] = 0 if exact else 1
        self._handle[:] = 0
        self._matrix = self._arguments()
        self._analyzed = False

    def weigh(self, weights: Array | None) -> None:
        """Factorize D A D from the next matrix A on, D = diag(weights), powers of two (n,)."""
        # pivots are compared with the largest entry of the matrix, whatever its units
        self._weights = weights

    def sharpen(self) -> None:
        """Go over to double precision; the next factorization begins with an analysis."""
        if not self.exact:
            self.close()
            self._set_precision(exact=True)

    def forget(self) -> None:
        """Begin as at first: with the precision that is usual for this size."""
        if self.exact and not self._usually_exact:
            self.close()
            self._set_precision(exact=False)

    def factorize(self, data: Array) -> None:
        """Numerical factorization, after the analysis the first time."""
        if self._weights is not None:
            rows = np.repeat(self._weights, np.diff(self._indptr))
            data = rows * data * self._weights[self._indices]
        try:
            self._factorize(data)
        except SingularMatrixError:
            if self.exact:
                raise
        if not self.exact and not (self._analyzed and self.unperturbed()):
            self.sharpen()
            self._factorize(data)

    def _factorize(self, data: Array) -> None:
        np.copyto(self._data, data, casting="same_kind")  # the factors outlive the entries
        self._trusted = False
        empty = np.zeros(self._size, self._data.dtype)
        if not self._analyzed or self._matching:
            self._call(_ANALYZE, empty)
            self._analyzed = True
        self._call(_FACTORIZE, empty)

    def solve(self, right: Array, *, refined: bool = True) -> Array:
        """Back-substitution for one or several right-hand sides, exact or not.

        With perturbed pivots MKL refines it twice. What is not ``refined`` takes a third of the
        time: by factors as they are, once a solution has shown that they solve the system.
        """
        if self._weights is None:
            return self._solved_by_factors(right, refined=refined)
        solution = self._solved_by_factors((right.T * self._weights).T, refined=refined)
        return np.asarray((solution.T * self._weights).T)

    def _solved_by_factors(self, right: Array, *, refined: bool) -> Array:
        b = np.asfortranarray(right, dtype=self._data.dtype)
        if not (refined or self.unperturbed()) and (self._matching or self._trusted):
            for phase in _PARTS:
                b = np.asfortranarray(self._call(phase, b))
            return np.ascontiguousarray(b, dtype=np.float64)
        x = self._call(_SOLVE, b)
        if not self.exact:
            return x.astype(np.float64)
        if self._matching or self._trusted or self.unperturbed() or self._solved(x, b):
            self._trusted = True
            return x
        self._matching = True
        for number, value in _MATCHING.items():
            self._iparm[number - 1] = value
        self._factorize(self._data)
        return self._call(_SOLVE, b)

    def unperturbed(self) -> bool:
        """Whether every pivot was large enough."""
        return int(self._iparm[_PERTURBED - 1]) == 0

    def _solved(self, x: Array, b: Array) -> bool:
        """Whether ``x`` solves this system or one next to it (Higham 2002, sec. 7.1)."""
        product = np.empty_like(x)
        for column, into in zip(np.atleast_2d(x.T), np.atleast_2d(product.T), strict=True):
            into[:] = symmetric_product(
                self._indptr, self._indices, self._data, np.ascontiguousarray(column)
            )
        residual, size = float(np.linalg.norm(b - product)), float(np.linalg.norm(b))
        if residual <= _TRUSTED * size:
            return True
        largest = float(np.abs(self._data).max()) * float(np.linalg.norm(x))
        return residual <= _BACKWARD * (largest + size)

    def worth(self) -> float:
        """By counts: operations of a factorization, entries read in a back-substitution."""
        if self._matching or not self._analyzed:
            return 0.0
        entries, millions = (float(self._iparm[n - 1]) for n in (_ENTRIES, _MILLIONS))
        read = max(entries + float(self._data.size), 1.0)
        return _BESIDES + 1e6 * millions / (_PER_ENTRY * read)

    def negative_pivots(self) -> int | None:
        """Count of MKL, 2 x 2 pivots and perturbed ones included."""
        return int(self._iparm[_NEGATIVE - 1]) if self._analyzed else None

    def close(self) -> None:
        """Release the memory that MKL holds for this factorization."""
        if self._analyzed:
            self._call(_RELEASE, np.zeros(self._size, self._data.dtype))
            self._analyzed = False

    def _call(self, phase: int, b: Array) -> Array:
        """One phase, with a right-hand side (n,) or (n, k) in the order of columns."""
        x = np.zeros_like(b)
        self._phase.value, self._columns.value = phase, b.size // max(self._size, 1)
        pointers = (ctypes.c_void_p(b.ctypes.data), ctypes.c_void_p(x.ctypes.data))
        with _one_thread(self._mkl) if self._small else nullcontext():
            self._mkl.pardiso(*self._matrix, *pointers, ctypes.byref(self._failed))
        failed = self._failed.value
        if failed == _NO_MEMORY:
            raise MemoryError("the factorization does not fit into memory")
        if failed:
            raise SingularMatrixError(f"phase {phase}: PARDISO says {failed}")
        return np.ascontiguousarray(x)

    def _arguments(self) -> tuple[object, ...]:
        """All but the vectors: they point into this object, which only changes what is there."""
        return (
            self._handle.ctypes.data_as(ctypes.POINTER(ctypes.c_int64)),
            _whole(1),  # one factorization is kept,
            _whole(1),  # and it is that one
            _whole(_SYMMETRIC),
            ctypes.byref(self._phase),
            _whole(self._size),
            self._data.ctypes.data_as(ctypes.c_void_p),
            _integers(self._indptr),
            _integers(self._indices),
            _whole(0),  # no ordering of one's own
            ctypes.byref(self._columns),
            _integers(self._iparm),
            _whole(0),  # says nothing
        )

    def __del__(self) -> None:
        try:
            self.close()
        except Exception:  # noqa: BLE001 - interpreter shutdown: MKL may be gone already
            return


LinearSolver = SuperLU | Pardiso

# -------------------------------------------------------------------------------------------------
# Solves with a tangent by the factorization of an earlier one, for as long as that pays.
#
# From one Newton iteration to the next a tangent changes little: the factors of an old one
# make a preconditioner with which GMRES needs a few back-substitutions, where a solid's new
# factorization costs twenty (Saad 2003, sec. 9.4: the flexible variant, which keeps the
# preconditioned directions, so that nothing is solved twice). When to factorize anew is
# decided by counts of operations, never by a clock: a result does not depend on the load
# of the machine.
#
# The same iteration corrects factors in single precision, down to what the Newton iteration asks
# of this solve (Carson and Higham 2018, SIAM J. Sci. Comput. 40, A817).

Operator = Callable[[Array], Array]

#: iterations worth less than this are no gain over factorizing: small systems never reuse
_WORTH = 6.0

#: factor on the expected slowing of the iteration, each time that the iteration is not tried
_FADES = 0.8

#: residual of a Newton step that tells as little of the next as a smaller one
_LEAST = 1e-3

#: corrections of a solution in single precision, of which each brings some four digits
_CORRECTIONS = 8

#: contact points that may have changed sides, each of them a direction more to search
_SWITCHED = 0.25


class KeptFactors:
    """A direct solver whose factors serve later matrices of the same pattern."""

    def __init__(self, solver: LinearSolver, pattern: Pattern) -> None:
        self.solver, self._pattern = solver, pattern
        self._spent: list[int] = []
        self._touching: Flags | None = None
        #: State of the tangent that was factorized; None where it is not known.
        self.state: object = None
        self._change = self._sensitivity = 0.0

    def renewed(self, touching: Flags, state: object = None) -> None:
        """Say that the solver has just factorized a state, with these contact points closed."""
        self._spent, self._touching, self._change = [], touching, 0.0
        self.state = state

    def forget(self) -> None:
        """Factorize first: what another run left behind must not change a digit of this one."""
        self._touching, self.state, self._sensitivity = None, None, 0.0
        self.solver.forget()

    def serves(self, touching: Flags) -> bool:
        """Whether the factors are of a tangent with these contact points closed."""
        return self._touching is not None and np.array_equal(touching, self._touching)

    def solve(
        self,
        data: Array,
        right: Array,
        scale: Array,
        tolerance: float,
        touching: Flags,
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
        solution, count, left = self._krylov(data, right, scale, tolerance, budget)
        self._spent.append(count)
        self._sensitivity = min(left ** (1 / count), 1.0) / self._change
        return solution

    def solve_afresh(self, data: Array, right: Array, scale: Array, tolerance: float) -> Array:
        """Solve with the factors of this very matrix, corrected where they are not exact.

        Where corrections do not do, it is factorized once more, in double precision.
        """
        if not self.solver.exact:
            solution, _, _ = self._krylov(data, right, scale, tolerance, _CORRECTIONS)
            if solution is not None:
                return solution
            self.solver.sharpen()
            self.solver.factorize(data)
        return self.solver.solve(right)

    def _expected(self, tolerance: float) -> float:
        """Foresee the iterations: each leaves a share that grows with the tangent's change."""
        share = self._sensitivity * self._change
        if share == 0:
            return 0.0
        return float(np.log(tolerance) / np.log(share)) if share < 1 else np.inf

    def _budget(self, touching: Flags) -> int:
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

    Shapes: b (n,).
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
