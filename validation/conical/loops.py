"""Statistics of a complete table of cells against blocks, the long way round.

Nothing here is shared with the program: means by loops, sums of squares from the components of
every combination of levels, epsilon by Box's covariance formula, p by a continued fraction.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Table:
    """A complete table: value of every cell (a tuple of levels) in every block."""

    factors: tuple[str, ...]
    levels: Mapping[str, tuple[str, ...]]
    blocks: tuple[str, ...]
    value: Mapping[tuple[tuple[str, ...], str], float]

    @property
    def cells(self) -> list[tuple[str, ...]]:
        """Cells in the order of the levels."""
        return list(itertools.product(*(self.levels[f] for f in self.factors)))


class Unfit(Exception):
    """The data do not allow a second computation; the message says why."""


def mean(table: Table, fixed: Mapping[str, str], block: str | None = None) -> float:
    """Mean over all cells with the given levels, in one block or in all."""
    found = [
        table.value[cell, b]
        for cell in table.cells
        for b in table.blocks
        if (block is None or b == block)
        and all(cell[table.factors.index(f)] == level for f, level in fixed.items())
    ]
    return math.fsum(found) / len(found)


def component(means: Mapping[Any, float], at: Mapping[str, str], block: str | None) -> float:
    """Pure effect of a combination of levels: means of all its parts with alternating sign."""
    total = 0.0
    names = list(at)
    for kept in range(len(names) + 1):
        for part in itertools.combinations(names, kept):
            sign = (-1) ** (len(names) - kept)
            total += sign * means[frozenset((f, at[f]) for f in part), block]
    return total


def all_means(table: Table, term: Sequence[str]) -> dict[Any, float]:
    """Mean of every part of a term, over all blocks (key None) and in each."""
    found = {}
    for kept in range(len(term) + 1):
        for part in itertools.combinations(term, kept):
            for levels in itertools.product(*(table.levels[f] for f in part)):
                at = dict(zip(part, levels, strict=True))
                for block in (None, *table.blocks):
                    found[frozenset(at.items()), block] = mean(table, at, block)
    return found


@dataclass(frozen=True)
class Tested:
    """One effect against its own interaction with the blocks."""

    df: int
    ss: float
    df_error: int
    ss_error: float
    epsilon: float

    @property
    def f(self) -> float:
        """Mean square of the effect over that of its interaction with the blocks."""
        return (self.ss / self.df) / (self.ss_error / self.df_error)


def tested(table: Table, term: Sequence[str]) -> Tested:
    """Sums of squares of a term and of its interaction with the blocks, by loops."""
    means = all_means(table, term)
    combinations = [
        dict(zip(term, levels, strict=True))
        for levels in itertools.product(*(table.levels[f] for f in term))
    ]
    runs = len(table.cells) / len(combinations)
    blocks = len(table.blocks)
    whole = [component(means, at, None) for at in combinations]
    single = [[component(means, at, b) for b in table.blocks] for at in combinations]
    df = math.prod(len(table.levels[f]) - 1 for f in term)
    return Tested(
        df,
        runs * blocks * math.fsum(w * w for w in whole),
        df * (blocks - 1),
        runs * math.fsum((s - w) ** 2 for w, each in zip(whole, single, strict=True) for s in each),
        greenhouse_geisser(single, df) if blocks > 1 else 1.0,
    )


def greenhouse_geisser(components: Sequence[Sequence[float]], df: int) -> float:
    """Epsilon by Box's covariance formula (1954; Winer 1971, 7.4).

    Parameters
    ----------
    components : sequence, one row a level (or combination of levels), one column a block
        For an interaction the pure components, which hold no lower-order effect.
    df : int
        Degrees of freedom of the term.
    """
    k, b = len(components), len(components[0])
    centers = [math.fsum(row) / b for row in components]
    s = [
        [
            math.fsum(
                (components[i][n] - centers[i]) * (components[j][n] - centers[j]) for n in range(b)
            )
            / (b - 1)
            for j in range(k)
        ]
        for i in range(k)
    ]
    rows_of = [math.fsum(row) / k for row in s]
    overall = math.fsum(rows_of) / k
    diagonal = math.fsum(s[i][i] for i in range(k)) / k
    squares = math.fsum(x * x for row in s for x in row)
    bottom = squares - 2 * k * math.fsum(r * r for r in rows_of) + k * k * overall**2
    if bottom == 0:
        return 1.0
    return min(1.0, k * k * (diagonal - overall) ** 2 / (df * bottom))


# Distributions


def upper_f(f: float, df1: float, df2: float) -> float:
    """P(F > f) by the incomplete beta function (Abramowitz and Stegun 26.6.2)."""
    return incomplete_beta(df2 / 2, df1 / 2, df2 / (df2 + df1 * f))


def incomplete_beta(a: float, b: float, x: float) -> float:
    """Regularized I_x(a, b) by its continued fraction (Abramowitz and Stegun 26.5.8)."""
    if x <= 0 or x >= 1:
        return float(x >= 1)
    front = a * math.log(x) + b * math.log1p(-x)
    front += math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b)
    if x < (a + 1) / (a + b + 2):
        return math.exp(front) * _fraction(a, b, x) / a
    return 1 - math.exp(front) * _fraction(b, a, 1 - x) / b


def _fraction(a: float, b: float, x: float) -> float:
    """Continued fraction of the incomplete beta function, by Lentz's method."""
    c, d = 1.0, 1 / (1 - (a + b) * x / (a + 1))
    h = d
    for m in range(1, 10_000):
        even = m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m))
        odd = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1))
        for step in (even, odd):
            d, c = 1 / (1 + step * d), 1 + step / c
            h *= c * d
        if abs(c * d - 1) < 1e-15:
            return h
    raise Unfit(f"the incomplete beta function of {a:g}, {b:g} did not converge at {x:g}")


# Assumptions


def helmert_rows(table: Table, term: Sequence[str]) -> list[list[float]]:
    """Contrasts of a term in every block: each level against the mean of those before it."""
    codes = []
    for factor in table.factors:
        k = len(table.levels[factor])
        if factor not in term:
            codes.append([[1.0] * k])
            continue
        codes.append([[1.0] * j + [-float(j)] + [0.0] * (k - 1 - j) for j in range(1, k)])
    rows = []
    for chosen in itertools.product(*codes):
        weight = {
            cell: math.prod(
                code[table.levels[f].index(level)]
                for f, code, level in zip(table.factors, chosen, cell, strict=True)
            )
            for cell in table.cells
        }
        rows.append([math.fsum(w * table.value[c, b] for c, w in weight.items())
                     for b in table.blocks])  # fmt: skip
    return rows


def residuals(table: Table, cells: Sequence[tuple[str, ...]]) -> dict[tuple[str, ...], list[float]]:
    """Take from a few cells their own means and those of the blocks."""
    y = {(c, b): table.value[c, b] for c in cells for b in table.blocks}
    total = math.fsum(y.values()) / len(y)
    by_cell = {c: math.fsum(y[c, b] for b in table.blocks) / len(table.blocks) for c in cells}
    by_block = {b: math.fsum(y[c, b] for c in cells) / len(cells) for b in table.blocks}
    return {c: [y[c, b] - by_cell[c] - by_block[b] + total for b in table.blocks] for c in cells}


def ryan_joiner(values: Sequence[float]) -> float:
    """Correlation of sorted values with normal scores (Ryan and Joiner 1976), ties averaged."""
    n, ordered = len(values), sorted(values)
    scores = []
    for value in ordered:
        first, last = ordered.index(value), n - 1 - ordered[::-1].index(value)
        rank = (first + last) / 2 + 1
        scores.append(NormalDist().inv_cdf((rank - 0.375) / (n + 0.25)))
    return float(np.corrcoef(ordered, scores)[0, 1])


def bartlett(groups: Iterable[Sequence[float]]) -> tuple[float, int]:
    """Bartlett's statistic (Snedecor and Cochran 1989) and its degrees of freedom."""
    known = [list(map(float, group)) for group in groups]
    sizes = [len(g) - 1 for g in known]
    variances = []
    for group, df in zip(known, sizes, strict=True):
        center = math.fsum(group) / len(group)
        variances.append(math.fsum((x - center) ** 2 for x in group) / df)
    total = sum(sizes)
    pooled = math.fsum(v * df for v, df in zip(variances, sizes, strict=True)) / total
    top = total * math.log(pooled)
    top -= math.fsum(df * math.log(v) for v, df in zip(variances, sizes, strict=True))
    k = len(known)
    return top / (1 + (math.fsum(1 / df for df in sizes) - 1 / total) / (3 * (k - 1))), k - 1
