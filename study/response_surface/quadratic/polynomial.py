"""A polynomial of second order in coded factors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from study.arrays import Array


@dataclass(frozen=True)
class Term:
    """One column of the model: a product of at most two factors, given by their positions."""

    factors: tuple[int, ...]

    def column(self, coded: Array) -> Array:
        """Values of the term, shape (n,), at coded points of shape (n, k)."""
        return np.asarray(np.prod(coded[:, list(self.factors)], axis=1), dtype=np.float64)

    def label(self, names: Sequence[str]) -> str:
        """Name as it is printed: ``1``, ``time``, ``time^2`` or ``time:temp``."""
        if not self.factors:
            return "1"
        if len(self.factors) == 2 and self.factors[0] == self.factors[1]:
            return f"{names[self.factors[0]]}^2"
        return ":".join(names[j] for j in self.factors)


def second_order(levels: Sequence[int]) -> tuple[Term, ...]:
    """Terms 1, x_j, x_j x_k and x_j^2; no square of a factor with two levels, which cannot tell it.

    Parameters
    ----------
    levels : sequence of int
        Number of different settings of each factor.
    """
    k = range(len(levels))
    linear = [Term((j,)) for j in k]
    products = [Term(pair) for pair in combinations(k, 2)]
    return (Term(()), *linear, *products, *(Term((j, j)) for j in k if levels[j] > 2))


def model_matrix(terms: Sequence[Term], coded: Array) -> Array:
    """Columns of the terms, shape (n, terms), at coded points of shape (n, k).

    Parameters
    ----------
    terms : sequence of Term
        One column each; at least one.
    coded : array, shape (n, k)
        Coded settings, from -1 to 1 inside the box.
    """
    return np.column_stack([term.column(coded) for term in terms])


@dataclass(frozen=True)
class Polynomial:
    """Terms with their coefficients.

    Parameters
    ----------
    terms : tuple of Term
        The columns.
    coefficients : array, shape (terms,)
        In the response's unit, for coded factors.
    k : int
        Number of factors.
    """

    terms: tuple[Term, ...]
    coefficients: Array
    k: int

    def value(self, coded: Array) -> Array:
        """Values, shape (n,), at coded points of shape (n, k)."""
        return np.asarray(model_matrix(self.terms, coded) @ self.coefficients)

    def linear(self) -> Array:
        """Coefficients b of the linear terms, shape (k,)."""
        b = np.zeros(self.k)
        for term, c in zip(self.terms, self.coefficients, strict=True):
            if len(term.factors) == 1:
                b[term.factors[0]] = c
        return b

    def quadratic(self) -> Array:
        """Symmetric matrix B, shape (k, k), of the second-order terms x'Bx."""
        matrix = np.zeros((self.k, self.k))
        for term, c in zip(self.terms, self.coefficients, strict=True):
            if len(term.factors) == 2:
                i, j = term.factors
                matrix[i, j] += 0.5 * c
                matrix[j, i] += 0.5 * c
        return matrix

    def gradient(self, coded: Array) -> Array:
        """Slopes b + 2Bx, shape (n, k), at coded points of shape (n, k)."""
        return np.asarray(self.linear() + 2.0 * coded @ self.quadratic())
