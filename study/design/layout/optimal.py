"""D-optimal designs: the cells that estimate given terms with the smallest joint variance.

Cells are chosen by coordinate exchange (Meyer and Nachtsheim 1995, Technometrics 37, 60-69): the
level of one factor of one cell changes wherever that makes det(X'X) larger, until no change does.
No cell is taken twice, for a simulation repeated is the same simulation.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from study.arrays import Array, Ints

#: searches from random designs; the best of them is taken
STARTS = 20
#: gain of the determinant below which an exchange is rounding
_GAIN = 1e-9
#: weight of the unit matrix that lets a search begin from a singular design
_RIDGE = 1e-8

#: factors of a term, by their number
Word = tuple[int, ...]
Row = tuple[int, ...]


def model_columns(rows: Ints, sizes: Sequence[int], words: Sequence[Word]) -> Array:
    """Columns of a model in orthonormal contrasts.

    Parameters
    ----------
    rows : ndarray of int, shape (n, factors)
        Index of the level of every factor.
    sizes : sequence of int
        Number of levels of every factor.
    words : sequence of tuple of int
        Factors of every term; an interaction is the product of their contrasts.

    Returns
    -------
    ndarray, shape (n, p)
        The mean first; of a full factorial X'X is n times the unit matrix.
    """
    own = [_contrasts(size)[rows[:, k]] for k, size in enumerate(sizes)]
    columns = [np.ones((len(rows), 1))]
    for word in words:
        product = np.ones((len(rows), 1))
        for k in word:
            product = np.einsum("ni,nj->nij", product, own[k]).reshape(len(rows), -1)
        columns.append(product)
    return np.hstack(columns)


def _contrasts(size: int) -> Array:
    """Helmert contrasts of some levels, each of mean square 1, shape (size, size - 1)."""
    found = np.zeros((size, size - 1))
    for k in range(1, size):
        found[:k, k - 1], found[k, k - 1] = -1.0, float(k)
        found[:, k - 1] *= math.sqrt(size / (k * (k + 1)))
    return found


def efficiency(rows: Sequence[Row], sizes: Sequence[int], words: Sequence[Word]) -> float:
    """D-efficiency: det(X'X)^(1/p) / n, 1 for an orthogonal design and 0 where terms are aliased.

    Parameters
    ----------
    rows : sequence of tuple of int
        Index of the level of every factor, one tuple a cell.
    sizes : sequence of int
        Number of levels of every factor.
    words : sequence of tuple of int
        Factors of every term, by number; the mean is added.

    Examples
    --------
    >>> half = [(0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 0)]
    >>> round(efficiency(half, (2, 2, 2), [(0,), (1,), (2,)]), 12)
    1.0
    """
    x = model_columns(np.array(rows), sizes, words)
    sign, log = np.linalg.slogdet(x.T @ x)
    aliased = sign <= 0 or np.linalg.matrix_rank(x) < x.shape[1]
    return 0.0 if aliased else float(np.exp(log / x.shape[1]) / len(rows))


def d_optimal(
    sizes: Sequence[int],
    words: Sequence[Word],
    runs: int,
    seed: int,
    given: Sequence[Row] = (),
) -> tuple[Row, ...]:
    """Choose cells for given terms.

    Parameters
    ----------
    sizes : sequence of int
        Number of levels of every factor.
    words : sequence of tuple of int
        Factors of every term.
    runs : int
        Cells to be chosen, beside those that are given.
    seed : int
        Of the random starts.
    given : sequence of tuple of int
        Cells that are run in any case.

    Returns
    -------
    tuple of tuple of int
        The chosen cells, in the order of the factors.
    """
    random = np.random.default_rng(seed)
    every = list(itertools.product(*(range(size) for size in sizes)))
    free = [row for row in every if row not in set(given)]
    best: tuple[float, tuple[Row, ...]] | None = None
    for _ in range(STARTS):
        drawn = random.choice(len(free), size=runs, replace=False)
        found = _exchanged([free[k] for k in drawn], list(given), sizes, words)
        value = efficiency([*given, *found], sizes, words)
        if best is None or value > best[0] * (1 + _GAIN):
            best = (value, tuple(sorted(found)))
        if best[0] > 1 - _GAIN:
            break
    if best is None:
        raise ValueError("no start")
    return best[1]


def _exchanged(
    rows: list[Row], given: list[Row], sizes: Sequence[int], words: Sequence[Word]
) -> list[Row]:
    """Exchange coordinates until none makes the determinant larger."""
    inverse = _inverse([*given, *rows], sizes, words)
    taken, moved = {*given, *rows}, True
    while moved:
        moved = False
        for i, k in itertools.product(range(len(rows)), range(len(sizes))):
            others = [
                (*rows[i][:k], level, *rows[i][k + 1 :])
                for level in range(sizes[k])
                if level != rows[i][k]
            ]
            others = [row for row in others if row not in taken]
            if not others:
                continue
            old = model_columns(np.array([rows[i]]), sizes, words).ravel()
            new = model_columns(np.array(others), sizes, words)
            gain = _ratio(inverse, old, new)
            j = int(gain.argmax())
            if gain[j] <= 1 + _GAIN:
                continue
            taken = (taken - {rows[i]}) | {others[j]}
            rows[i], moved = others[j], True
            inverse = _inverse([*given, *rows], sizes, words)
    return rows


def _inverse(rows: Sequence[Row], sizes: Sequence[int], words: Sequence[Word]) -> Array:
    """(X'X)^-1 of some cells."""
    x = model_columns(np.array(rows), sizes, words)
    return np.asarray(np.linalg.inv(x.T @ x + _RIDGE * np.eye(x.shape[1])), dtype=np.float64)


def _ratio(inverse: Array, old: Array, new: Array) -> Array:
    """Factor of det(X'X) where the row ``old`` becomes each of ``new`` (Fedorov 1972)."""
    at_old = float(old @ inverse @ old)
    at_new = np.einsum("ni,ij,nj->n", new, inverse, new)
    between = new @ inverse @ old
    return np.asarray((1 + at_new) * (1 - at_old) + between**2)
