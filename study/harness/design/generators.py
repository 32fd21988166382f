"""Coded runs of designs other than the full factorial, from kept-up libraries.

Two-level designs are coded -1 and 1, response-surface designs -1 to 1 with the outermost runs at
the ends of the ranges, space-filling designs 0 to 1, all of shape (runs, factors). pyDOE3 is not
used: its fractional designs are wrong; those of pydoe are verified here.
"""

from __future__ import annotations

import itertools
import math
import string
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from study.ground.arrays import Array, Ints

#: letters that pydoe takes for factors
LETTERS = string.ascii_lowercase


def fractional(
    factors: Sequence[str], generators: Mapping[str, tuple[int, Sequence[str]]]
) -> Array:
    """Two-level fractional factorial with given generators."""
    from pydoe import fracfact

    basic = [name for name in factors if name not in generators]
    letter = dict(zip(basic, LETTERS, strict=False))
    words = []
    for factor in factors:
        sign, parts = generators.get(factor, (1, [factor]))
        words.append(("-" if sign < 0 else "") + "".join(sorted(letter[p] for p in parts)))
    return _ordered(np.asarray(fracfact(" ".join(words)), dtype=float))


def by_resolution(count: int, resolution: int) -> Array:
    """Smallest two-level fraction of a number of factors with at least a resolution."""
    from pydoe import fracfact_by_res

    return _ordered(np.asarray(fracfact_by_res(count, resolution), dtype=float))


def plackett_burman(count: int) -> Array:
    """Plackett-Burman screening design (Plackett and Burman 1946, Biometrika 33, 305)."""
    from pydoe import pbdesign

    return np.asarray(pbdesign(count), dtype=float)


def central_composite(count: int, star: str = "inscribed") -> Array:
    """Rotatable central composite design, or the face-centered one (Box and Wilson 1951)."""
    # The center stands once: a simulation repeated is the same simulation. The runs are scaled so
    # that none leaves -1 to 1, for the ends of a range are its true limits.
    from pydoe import ccdesign

    runs = ccdesign(count, center=(0, 1), alpha="rotatable", face=star)
    return np.asarray(runs, dtype=float)


#: blocks of factors that vary together (Box and Behnken 1960); the paper's design of nine
#: factors has three of its blocks twice, and a simulation repeated is the same simulation
_BLOCKS: Mapping[int, Sequence[tuple[int, ...]]] = {
    6: ((1, 2, 4), (2, 3, 5), (3, 4, 6), (1, 4, 5), (2, 5, 6), (1, 3, 6)),
    7: ((4, 5, 6), (1, 6, 7), (2, 5, 7), (1, 2, 4), (3, 4, 7), (1, 3, 5), (2, 3, 6)),
    9: (
        *((1, 4, 7), (2, 5, 8), (3, 6, 9), (1, 2, 3), (4, 5, 6), (7, 8, 9)),
        *((1, 5, 9), (3, 4, 8), (2, 6, 7), (1, 6, 8), (2, 4, 9), (3, 5, 7)),
    ),
    10: (
        *((2, 6, 7, 10), (1, 2, 5, 10), (2, 3, 7, 8), (2, 4, 6, 9), (1, 8, 9, 10)),
        *((3, 4, 5, 10), (1, 4, 7, 8), (3, 5, 7, 9), (1, 3, 6, 9), (4, 5, 6, 8)),
    ),
}


def box_behnken(count: int) -> Array:
    """Box-Behnken design with one center run (Box and Behnken 1960, Technometrics 2, 455).

    Within a block of an incomplete block design its factors take all combinations of -1 and 1,
    and all others are 0. Up to five factors, and for eight, which the paper leaves out, the
    blocks are all pairs.
    """
    pairs = tuple(itertools.combinations(range(1, count + 1), 2))
    runs = [
        [signs[block.index(k)] if k in block else 0.0 for k in range(1, count + 1)]
        for block in _BLOCKS.get(count, pairs)
        for signs in itertools.product((-1.0, 1.0), repeat=len(block))
    ]
    return np.array([*runs, [0.0] * count])


def latin_hypercube(count: int, runs: int, seed: int) -> Array:
    """Latin hypercube sample in 0 to 1: every factor has one run in each of ``runs`` slices."""
    from scipy.stats import qmc

    rng = np.random.default_rng(seed)
    return np.asarray(qmc.LatinHypercube(count, rng=rng).random(runs), dtype=float)


def sobol(count: int, runs: int, seed: int) -> Array:
    """Scrambled Sobol sequence in 0 to 1."""
    from scipy.stats import qmc

    rng = np.random.default_rng(seed)
    sampler = qmc.Sobol(count, scramble=True, rng=rng)
    return np.asarray(sampler.random_base2(int(runs).bit_length() - 1), dtype=float)


def trajectories(count: int, number: int, levels: int, seed: int) -> Array:
    """Paths that move each factor once, by half of its levels (Morris 1991), in 0 to 1.

    No run belongs to two of them; fewer are made where no more fit the grid.
    Shapes: returns (paths * (count + 1), count).
    """
    rng, jump = np.random.default_rng(seed), levels // 2
    runs: list[Ints] = []
    taken: set[tuple[int, ...]] = set()
    for _ in range(100 * number):
        path = [rng.integers(0, levels, count)]
        for j in rng.permutation(count):
            step = jump if path[-1][j] < jump else -jump
            path.append(path[-1] + step * (np.arange(count) == j))
        cells = {tuple(run.tolist()) for run in path}
        if taken.isdisjoint(cells) and len(runs) < number * (count + 1):
            runs += path
            taken |= cells
    return np.array(runs) / (levels - 1)


def _ordered(runs: Array) -> Array:
    """Sort the runs as a table: the last basic factor varies fastest."""
    return runs[np.lexsort(runs.T[::-1])]


# D-optimal designs by coordinate exchange (Meyer and Nachtsheim 1995, Technometrics 37, 60-69).
# No cell is taken twice: a simulation repeated is the same simulation.

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
    """Columns of a model in orthonormal contrasts. Shapes: rows (n, factors); returns (n, p)."""
    contrasts = [_contrasts(size)[rows[:, k]] for k, size in enumerate(sizes)]
    columns = [np.ones((len(rows), 1))]
    for word in words:
        product = np.ones((len(rows), 1))
        for k in word:
            product = np.einsum("ni,nj->nij", product, contrasts[k]).reshape(len(rows), -1)
        columns.append(product)
    return np.hstack(columns)


def _contrasts(size: int) -> Array:
    """Helmert contrasts of some levels, each of mean square 1, shape (size, size - 1)."""
    contrasts = np.zeros((size, size - 1))
    for k in range(1, size):
        contrasts[:k, k - 1], contrasts[k, k - 1] = -1.0, float(k)
        contrasts[:, k - 1] *= math.sqrt(size / (k * (k + 1)))
    return contrasts


def efficiency(rows: Sequence[Row], sizes: Sequence[int], words: Sequence[Word]) -> float:
    """D-efficiency: det(X'X)^(1/p) / n, 1 for an orthogonal design, 0 where terms are aliased."""
    x = model_columns(np.array(rows), sizes, words)
    sign, log = np.linalg.slogdet(x.T @ x)
    aliased = sign <= 0 or np.linalg.matrix_rank(x) < x.shape[1]
    return 0.0 if aliased else float(np.exp(log / x.shape[1]) / len(rows))


def d_optimal(
    sizes: Sequence[int], words: Sequence[Word], runs: int, seed: int, given: Sequence[Row] = ()
) -> tuple[Row, ...]:
    """Choose cells for given terms."""
    random = np.random.default_rng(seed)
    every = list(itertools.product(*(range(size) for size in sizes)))
    free = [row for row in every if row not in set(given)]
    best: tuple[float, tuple[Row, ...]] = (-1.0, ())
    for _ in range(STARTS):
        drawn = random.choice(len(free), size=runs, replace=False)
        rows = _exchanged([free[k] for k in drawn], list(given), sizes, words)
        value = efficiency([*given, *rows], sizes, words)
        if value > best[0] * (1 + _GAIN):
            best = (value, tuple(sorted(rows)))
        if best[0] > 1 - _GAIN:
            break
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


# What a two-level design cannot tell apart, found by brute force over products of its columns.

ROMAN = ("", "I", "II", "III", "IV", "V", "VI", "VII", "VIII", "IX", "X", "XI", "XII")


def defining_words(runs: Array) -> Iterator[Word]:
    """Products of columns that are constant over all runs, shortest first; runs (runs, factors)."""
    return (word for word in _words(runs.shape[1]) if abs(_column(runs, word).mean()) == 1)


def resolution(runs: Array) -> int | None:
    """Length of the shortest constant product; None where there is none (a full factorial)."""
    return next(map(len, defining_words(runs)), None)


def _words(count: int) -> Iterator[Word]:
    for length in range(1, count + 1):
        yield from itertools.combinations(range(count), length)


def _column(runs: Array, word: Word) -> Array:
    return np.asarray(runs[:, list(word)].prod(axis=1), dtype=float)


def term_name(word: Word, names: Sequence[str]) -> str:
    """Name of a term as an analysis writes it: ``"A"`` or ``"A:B"``."""
    return ":".join(names[i] for i in word)


def defining_relation(runs: Array, names: Sequence[str]) -> str:
    """Write the defining relation, such as ``"I = A:B:C"``; empty for a full factorial."""
    signed = [
        ("" if _column(runs, word)[0] > 0 else "-") + term_name(word, names)
        for word in defining_words(runs)
    ]
    return " = ".join(["I", *signed]) if signed else ""


def sentences(runs: Array, names: Sequence[str]) -> list[str]:
    """Alias table in words: what cannot be told from what, main effects first."""
    terms = [word for word in _words(runs.shape[1]) if len(word) <= 2]
    columns = np.array([_column(runs, word) for word in terms])
    correlation = np.abs(columns @ columns.T / len(runs))
    named: set[Word] = set()
    out = []
    for i, (term, row) in enumerate(zip(terms, correlation, strict=True)):
        correlated = [j for j in range(i + 1, len(terms)) if row[j] > 1e-12]
        whole = [terms[j] for j in correlated if abs(row[j] - 1) < 1e-12]
        if whole and term not in named:
            named.update(whole)
            others = " or ".join(_words_of(other, names) for other in whole)
            out.append(f"{_words_of(term, names)} cannot be told from {others}")
        part = [row[j] for j in correlated if terms[j] not in whole]
        if len(term) == 1 and part:
            out.append(
                f"{_words_of(term, names)} is mixed with a part (up to {max(part):.3g}) of "
                f"{len(part)} interactions of two other factors"
            )
    return out


def _words_of(word: Word, names: Sequence[str]) -> str:
    if len(word) == 1:
        return f"the effect of {names[word[0]]}"
    return "the interaction of " + " and ".join(names[i] for i in word)
