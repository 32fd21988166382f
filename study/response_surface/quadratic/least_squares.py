"""Least squares by QR, with the terms that the runs cannot tell apart, and leave-one-out errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import linalg

from study.arrays import Array
from study.response_surface.quadratic.polynomial import Term, model_matrix

#: a column that keeps less than this part of its length beside those before it is their alias:
#: rounding leaves about 1e-15, and a design that is nearly aliased keeps a few hundredths
ALIASED = 1e-8

#: a run with a leverage above this decides its own prediction and cannot be left out
SATURATED = 1.0 - 1e-9


@dataclass(frozen=True)
class ModelColumns:
    """Columns of a model that the settings can tell, factorized once for every response.

    Parameters
    ----------
    terms : tuple of Term
        The p terms kept.
    aliases : tuple of (Term, tuple of (Term, float))
        Each term left out, and the sum of kept terms that it equals at these settings.
    matrix : array, shape (n, p)
        The columns.
    q : array, shape (n, p)
        Orthonormal columns.
    r : array, shape (p, p)
        Upper triangle.
    """

    terms: tuple[Term, ...]
    aliases: tuple[tuple[Term, tuple[tuple[Term, float], ...]], ...]
    matrix: Array
    q: Array
    r: Array

    @property
    def leverage(self) -> Array:
        """Diagonal of the hat matrix, shape (n,)."""
        return np.asarray((self.q**2).sum(axis=1))

    def coefficients(self, response: Array) -> Array:
        """Coefficients, shape (p,) or (p, m), of responses of shape (n,) or (n, m)."""
        return np.asarray(linalg.solve_triangular(self.r, self.q.T @ response))

    def residuals(self, response: Array) -> Array:
        """Responses without what the model says of them, in the same shape."""
        return np.asarray(response - self.q @ (self.q.T @ response))

    def inverse(self) -> Array:
        """(X'X)^-1, shape (p, p)."""
        half = linalg.solve_triangular(self.r, np.eye(len(self.terms)))
        return np.asarray(half @ half.T)

    def complement(self) -> Array:
        """Orthonormal columns, shape (n, n - p), of all that the model leaves open."""
        full, _ = linalg.qr(self.matrix)
        return np.asarray(full[:, len(self.terms) :])

    def alone(self, which: Sequence[int]) -> Array:
        """Orthonormal columns, shape (n, len(which)), of terms beside all the other terms."""
        others = [j for j in range(len(self.terms)) if j not in set(which)]
        ordered = self.matrix[:, [*others, *which]]
        q, _ = linalg.qr(ordered, mode="economic")
        return np.asarray(q[:, len(others) :])


def factorize(terms: Sequence[Term], coded: Array) -> ModelColumns:
    """Keep, in their order, the terms that the settings can tell.

    Parameters
    ----------
    terms : sequence of Term
        Terms that are wanted, the simplest first.
    coded : array, shape (n, k)
        Coded settings.
    """
    kept: list[Term] = []
    basis = np.empty((len(coded), 0))
    left_out: list[Term] = []
    for term in terms:
        column = term.column(coded)
        rest = column - basis @ (basis.T @ column)
        rest -= basis @ (basis.T @ rest)  # twice is enough (Kahan, Parlett)
        length = float(np.linalg.norm(rest))
        if length <= ALIASED * max(float(np.linalg.norm(column)), 1.0):
            left_out.append(term)
            continue
        kept.append(term)
        basis = np.column_stack([basis, rest / length])
    matrix = model_matrix(kept, coded)
    q, r = linalg.qr(matrix, mode="economic")
    aliases = tuple((term, _equals(term, kept, q, r, coded)) for term in left_out)
    return ModelColumns(tuple(kept), aliases, matrix, np.asarray(q), np.asarray(r))


def _equals(
    term: Term, kept: Sequence[Term], q: Array, r: Array, coded: Array
) -> tuple[tuple[Term, float], ...]:
    weights = linalg.solve_triangular(r, q.T @ term.column(coded))
    return tuple((t, float(w)) for t, w in zip(kept, weights, strict=True) if abs(w) > ALIASED)


@dataclass(frozen=True)
class LeaveOneOut:
    """Errors of predicting each run from all the others.

    Parameters
    ----------
    rms, largest : float
        Root mean square and largest absolute error, in the response's unit.
    q2 : float
        1 - PRESS/SS about the mean: 1 is perfect, 0 no better than the mean.
    saturated : int
        Runs that cannot be predicted without themselves, and are not counted.
    observed, errors : ndarray, shape (n,)
        Responses, and responses minus predictions; NaN where a run is saturated.
    """

    rms: float
    largest: float
    q2: float
    saturated: int
    observed: Array = field(compare=False, repr=False)
    errors: Array = field(compare=False, repr=False)


def leave_one_out(columns: ModelColumns, response: Array) -> LeaveOneOut | None:
    """Leave-one-out errors e/(1 - h) of a response of shape (n,); None if none can be told.

    Parameters
    ----------
    columns : ModelColumns
        Columns of the model at the settings of the n runs.
    response : array, shape (n,)
        In its unit, which the errors have too.
    """
    free = columns.leverage < SATURATED
    if not free.any():
        return None
    every = np.full(response.shape, np.nan)
    every[free] = columns.residuals(response)[free] / (1.0 - columns.leverage[free])
    errors = every[free]
    spread = float(((response[free] - response.mean()) ** 2).sum())
    q2 = 1.0 - float((errors**2).sum()) / spread if spread > 0 else float("nan")
    rms = float(np.sqrt(np.mean(errors**2)))
    largest = float(np.abs(errors).max())
    return LeaveOneOut(rms, largest, q2, int((~free).sum()), response, every)
