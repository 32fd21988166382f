"""What a two-level design cannot tell apart, found by brute force over products of its columns."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from study.arrays import Array

Word = tuple[int, ...]
ROMAN = ("", "I", "II", "III", "IV", "V", "VI", "VII", "VIII", "IX", "X", "XI", "XII")


@dataclass(frozen=True)
class Alias:
    """Two terms of order 1 or 2 that a design correlates.

    Parameters
    ----------
    term, other : tuple of int
        Columns of the factors in each.
    r : float
        Correlation of their columns; 1 or -1 where nothing tells them apart.
    """

    term: Word
    other: Word
    r: float


def defining_words(runs: Array) -> tuple[Word, ...]:
    """Products of columns that are constant over all runs, shortest first.

    Parameters
    ----------
    runs : ndarray, shape (runs, factors)
        -1 and 1.
    """
    return tuple(word for word in _words(runs.shape[1]) if abs(_column(runs, word).mean()) == 1)


def resolution(runs: Array) -> int | None:
    """Length of the shortest constant product; None where there is none (a full factorial).

    Parameters
    ----------
    runs : ndarray, shape (runs, factors)
        -1 and 1.

    Examples
    --------
    >>> half = np.array([[-1, -1, 1], [-1, 1, -1], [1, -1, -1], [1, 1, 1]], dtype=float)
    >>> resolution(half)
    3
    """
    return next((len(w) for w in _words(runs.shape[1]) if abs(_column(runs, w).mean()) == 1), None)


def aliases(runs: Array) -> tuple[Alias, ...]:
    """Pairs of main effects and two-way interactions with correlated columns.

    Parameters
    ----------
    runs : ndarray, shape (runs, factors)
        -1 and 1.
    """
    terms = [w for w in _words(runs.shape[1], 2) if len(w) <= 2]
    columns = np.array([_column(runs, word) for word in terms])
    products = columns @ columns.T / len(runs)
    return tuple(
        Alias(terms[i], terms[j], float(products[i, j]))
        for i, j in itertools.combinations(range(len(terms)), 2)
        if abs(products[i, j]) > 1e-12
    )


def _words(count: int, longest: int | None = None) -> Iterator[Word]:
    for length in range(1, (longest or count) + 1):
        yield from itertools.combinations(range(count), length)


def _column(runs: Array, word: Word) -> Array:
    return np.asarray(runs[:, list(word)].prod(axis=1), dtype=float)


def term_name(word: Word, names: Sequence[str]) -> str:
    """Name of a term as an analysis writes it: ``"A"`` or ``"A:B"``.

    Parameters
    ----------
    word : tuple of int
        Columns of the factors in the term.
    names : sequence of str
        Of the factors, in the order of the columns.
    """
    return ":".join(names[i] for i in word)


def defining_relation(runs: Array, names: Sequence[str]) -> str:
    """Write the defining relation, such as ``"I = A:B:C"``; empty for a full factorial.

    Parameters
    ----------
    runs : ndarray, shape (runs, factors)
        -1 and 1.
    names : sequence of str
        Of the factors, in the order of the columns.
    """
    words = defining_words(runs)
    if not words:
        return ""
    signs = ["" if _column(runs, word)[0] > 0 else "-" for word in words]
    return "I = " + " = ".join(s + term_name(w, names) for s, w in zip(signs, words, strict=True))


def sentences(runs: Array, names: Sequence[str]) -> list[str]:
    """Alias table in words: what cannot be told from what, main effects first.

    Parameters
    ----------
    runs : ndarray, shape (runs, factors)
        -1 and 1.
    names : sequence of str
        Of the factors, in the order of the columns.

    Returns
    -------
    list of str
        Empty where the design tells all main effects and two-way interactions apart.
    """
    partners: dict[Word, list[Alias]] = {}
    for alias in aliases(runs):
        partners.setdefault(alias.term, []).append(alias)
    told: set[Word] = set()
    out = []
    for term, found in partners.items():
        whole = [a for a in found if abs(abs(a.r) - 1) < 1e-12]
        if whole and term not in told:
            told.update(a.other for a in whole)
            others = " or ".join(_words_of(a.other, names) for a in whole)
            out.append(f"{_words_of(term, names)} cannot be told from {others}")
        if len(term) == 1 and len(whole) < len(found):
            part = [a for a in found if a not in whole]
            largest = max(abs(a.r) for a in part)
            out.append(
                f"{_words_of(term, names)} is mixed with a part (up to {largest:.3g}) of "
                f"{len(part)} interactions of two other factors"
            )
    return out


def _words_of(word: Word, names: Sequence[str]) -> str:
    if len(word) == 1:
        return f"the effect of {names[word[0]]}"
    return "the interaction of " + " and ".join(names[i] for i in word)


def clear_order(found: int | None) -> int | None:
    """Highest order of terms that are free of one another at a resolution; None for all.

    Parameters
    ----------
    found : int or None
        Resolution as :func:`resolution` returns it; None where nothing is aliased.

    Examples
    --------
    >>> clear_order(3), clear_order(4), clear_order(5), clear_order(None)
    (1, 1, 2, None)
    """
    return None if found is None else max(1, (found - 1) // 2)
