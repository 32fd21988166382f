"""Normality of the contrasts that a blocked analysis tests, one row of values a contrast.

Residuals pooled over terms are no sample: their variances differ between terms, which looks
like heavy tails (simulated: a size of .74 to .99 on non-spherical normal data). One contrast
over the blocks is independent and identically distributed whatever the covariances, so its
Ryan-Joiner p is exact. The contrasts are those of a fixed Helmert basis: principal components
would be chosen by the data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from study.analysis.assumption.normality import default_simulations, null_rj, simulated_rj
from study.analysis.effects.comparisons import holm
from study.analysis.linear_model.design_matrix import Layout, Term, balanced, term_name
from study.arrays import Array, Ints
from study.errors import Fault, InputError

#: simulated samples of the exact p
SIMULATIONS = 100_000
#: below this many blocks a test that does not reject says little
FEW_BLOCKS = 9
#: residual degrees of freedom that the Ryan-Joiner test needs (4 values about their mean)
_LEAST_DF = 3
#: two contrasts of this correlation are one
_DUPLICATE = 1 - 1e-9
#: contrasts whose correlations with all others are held at once
_AT_ONCE = 1000
#: numbers simulated at once for the share of a block: 4 MB
_NUMBERS_AT_ONCE = 500_000
#: numbers simulated at most: 2,000 studies of 25,000 numbers, fewer of larger ones
_MOST_NUMBERS = 50_000_000
#: normals drawn at most with the rows themselves as root, blocks by blocks a study: 224 blocks
_MOST_NORMALS = 100_000_000
#: studies simulated at least: a p of .05 then has a standard error of .01
_FEWEST_DRAWS = 500


@dataclass(frozen=True)
class RowTest:
    """Ryan-Joiner test of one contrast over the blocks."""

    term: str
    contrast: int
    rj: float
    p: float
    p_holm: float


@dataclass(frozen=True)
class RowNormality:
    """Tests of all contrasts; the smallest p times their number decides.

    Parameters
    ----------
    rows : tuple of RowTest
        One for each contrast that varies.
    blocks : int
        Values in a row.
    p : float or None
        Bonferroni's p of all rows together; None where there is no test.
    rejected : bool
        Whether normality is rejected; the rows of small ``p_holm`` are those to look at.
    warning : str
        What non-rejection is worth, or why there is no test.
    """

    rows: tuple[RowTest, ...]
    blocks: int
    p: float | None
    rejected: bool
    warning: str = ""


@dataclass(frozen=True)
class BlockShare:
    """The block that carries the most of the interaction.

    Parameters
    ----------
    block : int
        Index of the block.
    share : float
        Its part of the squares, averaged over the standardized contrasts.
    p : float
        Part of simulated normal studies whose largest share is as large; a caution, no test
        that decides.
    """

    block: int
    share: float
    p: float


def helmert(k: int) -> Array:
    """Orthonormal Helmert contrasts of ``k`` levels, shape (k, k - 1).

    Parameters
    ----------
    k : int
        Number of levels, at least 2.

    Examples
    --------
    >>> helmert(3).round(3).tolist()
    [[0.707, 0.408], [-0.707, 0.408], [0.0, -0.816]]
    """
    j = np.arange(1, k)
    raw = np.triu(np.ones((k, k - 1))) - np.diag(j.astype(float), -1)[:, : k - 1]
    return np.asarray(raw / np.sqrt(j * (j + 1.0)))


def helmert_contrasts(layout: Layout, terms: Sequence[Term], y: Array) -> dict[str, Array]:
    """Contrasts of every term in every block.

    Parameters
    ----------
    layout : Layout
        Factor levels of each cell of a complete factorial.
    terms : sequence of Term
        Terms of the model.
    y : ndarray, shape (cells, blocks)
        Response of every cell in every block.

    Returns
    -------
    dict of str to ndarray, shape (df, blocks)
        Orthonormal contrasts of each term.

    Raises
    ------
    InputError
        If a combination of levels is missing or repeated.
    """
    factors = tuple(layout.levels)
    if not balanced(layout, factors) or layout.n != y.shape[0]:
        rule = "every combination of levels is needed once"
        raise InputError(Fault("cells", rule, "average repeats, leave out incomplete levels"))
    found = {}
    for term in terms:
        columns = np.ones((layout.n, 1))
        for name in factors:
            k = len(layout.levels[name])
            code = helmert(k) if name in term else np.full((k, 1), k**-0.5)
            part = code[layout.codes[name]]
            columns = (columns[:, :, None] * part[:, None, :]).reshape(layout.n, -1)
        found[term_name(term)] = columns.T @ (y - y[0, 0])
    return found


def row_normality(
    contrasts: Mapping[str, Array],
    *,
    groups: Ints | None = None,
    tolerance: float = 0.0,
    alpha: float = 0.05,
    seed: int = 2011,
) -> RowNormality:
    """Test the normality of every contrast over the blocks.

    Parameters
    ----------
    contrasts : mapping of str to ndarray, shape (df, b)
        Contrasts of each term in each block.
    groups : ndarray, shape (b,), optional
        Group of each block; rows are then taken about the means of their groups.
    tolerance : float
        Solver tolerance: rows shorter than ten of it are left out.
    alpha : float
        Size of the test of all rows together.
    seed : int
        Seed of the simulated null distribution.

    Returns
    -------
    RowNormality
        Every row with its exact p, and the decision by Bonferroni.

    Examples
    --------
    >>> rows = np.random.default_rng(1).standard_normal((3, 9))
    >>> row_normality({"A": rows[:1], "A:B": rows[1:]}).rejected
    False
    """
    names, rows = _rows(contrasts, groups, tolerance)
    blocks = next(iter(contrasts.values())).shape[1] if contrasts else 0
    code = _codes(groups, blocks)
    if blocks - len(set(code)) < _LEAST_DF:
        why = f"the Ryan-Joiner test needs more blocks, got {blocks}"
        return RowNormality((), blocks, None, False, why)
    if not names:
        return RowNormality((), blocks, None, False, "no contrast varies over the blocks")
    rj = simulated_rj(rows, _group_basis(code))
    null = _null(code, seed)
    p = (1 + np.searchsorted(null, rj, side="right")) / (null.size + 1)
    adjusted = holm(p)
    together = min(1.0, float(p.min()) * p.size)
    tests = tuple(
        RowTest(term, index, float(r), float(raw), float(both))
        for (term, index), r, raw, both in zip(names, rj, p, adjusted, strict=True)
    )
    few = f"b = {blocks}: power is small, non-rejection says little"
    warning = few if blocks < FEW_BLOCKS else ""
    return RowNormality(tests, blocks, together, together < alpha, warning)


def block_share(
    contrasts: Mapping[str, Array],
    *,
    groups: Ints | None = None,
    tolerance: float = 0.0,
    draws: int = 2000,
    seed: int = 2011,
) -> BlockShare | None:
    """Find the block that carries the most of the interaction with the blocks.

    Parameters
    ----------
    contrasts, groups, tolerance, seed
        As in :func:`row_normality`.
    draws : int
        Simulated normal studies with the covariance of the rows, fewer of very large ones.

    Returns
    -------
    BlockShare or None
        None where no contrast varies.
    """
    _, rows = _rows(contrasts, groups, tolerance)
    if rows.shape[0] == 0:
        return None
    blocks = rows.shape[1]
    basis = _group_basis(_codes(groups, blocks))
    share = _shares(rows)
    root = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    fewer = max(_MOST_NUMBERS // rows.size, _FEWEST_DRAWS)
    if fewer < draws or draws * blocks**2 > _MOST_NORMALS:
        draws = min(draws, fewer)
        # the smallest root of the same covariance: its normals take the longest
        root = np.asarray(np.linalg.qr(root.T, mode="r")).T
    top, above = float(share.max()), 0
    rng = np.random.default_rng(seed)
    step = max(1, _NUMBERS_AT_ONCE // (blocks * max(rows.shape[0], root.shape[1])))
    for start in range(0, draws, step):
        normal = rng.standard_normal((min(step, draws - start), root.shape[1], blocks))
        drawn = root @ normal
        largest = _shares(drawn - (drawn @ basis) @ basis.T).max(axis=-1)
        above += int(np.count_nonzero(largest >= top))
    return BlockShare(int(share.argmax()), top, (1 + above) / (draws + 1))


def _shares(rows: Array) -> Array:
    """Part of each block in the squares, averaged over rows, shape (..., b)."""
    squares = rows**2
    return np.asarray((squares / squares.sum(axis=-1, keepdims=True)).mean(axis=-2))


def _rows(
    contrasts: Mapping[str, Array], groups: Ints | None, tolerance: float
) -> tuple[list[tuple[str, int]], Array]:
    """Rows about their means that vary, each once, with their term and number."""
    names: list[tuple[str, int]] = []
    kept: list[Array] = []
    for term, values in contrasts.items():
        basis = _group_basis(_codes(groups, values.shape[1]))
        floor = max(10 * tolerance, 1e-12 * float(np.abs(values).max(initial=0.0)))
        rows = values - (values @ basis) @ basis.T
        for index in np.flatnonzero(np.linalg.norm(rows, axis=1) > floor):
            names.append((term, int(index)))
            kept.append(rows[index])
    if not kept:
        return names, np.zeros((0, 0))
    rows = np.array(kept)
    once = _once(rows / np.linalg.norm(rows, axis=1, keepdims=True))
    return [names[i] for i in once], rows[once]


def _once(units: Array) -> list[int]:
    """Rows that are no copy of an earlier one that is kept."""
    alike: dict[int, list[int]] = {}
    for start in range(0, len(units), _AT_ONCE):
        same = np.abs(units[start : start + _AT_ONCE] @ units.T) > _DUPLICATE
        for i, j in np.argwhere(np.tril(same, start - 1)):
            alike.setdefault(start + int(i), []).append(int(j))
    dropped: set[int] = set()
    for row in sorted(alike):
        if not dropped.issuperset(alike[row]):
            dropped.add(row)
    return [i for i in range(len(units)) if i not in dropped]


def _codes(groups: Ints | None, blocks: int) -> tuple[int, ...]:
    if groups is None:
        return (0,) * blocks
    return tuple(np.unique(groups, return_inverse=True)[1].tolist())


def _group_basis(code: tuple[int, ...]) -> Array:
    """Orthonormal indicators of the groups, shape (b, G)."""
    member = np.eye(max(code) + 1)[list(code)]
    return np.asarray(member / np.sqrt(member.sum(axis=0)))


@lru_cache(maxsize=16)
def _null(code: tuple[int, ...], seed: int) -> Array:
    """RJ of residuals of normal samples about the means of their groups, sorted."""
    count = min(SIMULATIONS, default_simulations(len(code)))
    return np.sort(np.concatenate(list(null_rj(_group_basis(code), count, seed))))
