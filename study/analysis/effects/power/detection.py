"""What a planned number of specimens or mesh seeds can detect, before anything is run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from study.analysis.anova_table import Row
from study.errors import Fault, InputError
from study.noncentral_f import noncentral_f_cdf


@dataclass(frozen=True)
class PowerRow:
    """Detectable difference of two level means with ``n`` blocks or replicates."""

    n: int
    detectable: float
    df: tuple[int, int]
    cost: float | None = None


def power_of(
    difference: float,
    sd: float,
    n: int,
    *,
    levels: int = 2,
    blocked: bool = True,
    alpha: float = 0.05,
) -> float:
    """Power of the F test for the least favorable pattern with a given largest difference.

    Parameters
    ----------
    difference : float
        Largest difference of level means.
    sd : float
        Standard deviation of one value: of the interaction with the blocks, or within a cell.
    n : int
        Blocks, or replicates per level.
    levels : int
        Levels k of the factor, at least 2.
    blocked : bool
        Whether the error has (k - 1)(n - 1) degrees of freedom, of the interaction with the
        blocks; else k (n - 1).
    alpha : float
        Size of the test, a probability.

    Notes
    -----
    Two extreme means and the rest in the middle give the smallest noncentrality,
    lambda = n d^2 / (2 sd^2).
    """
    _check(sd, n, levels)
    return _power(n * difference**2 / (2 * sd**2), _df(n, levels, blocked), alpha)


def planned(
    terms: Mapping[str, tuple[Row, int]],
    n: int,
    cells: int,
    *,
    blocked: bool,
    alpha: float,
    ratio: bool = False,
) -> dict[str, tuple[PowerRow, ...]]:
    """Tell what other numbers of blocks, or of replicates in a cell, would find.

    Parameters
    ----------
    terms : mapping of str to (Row, int)
        Row of each factor and the number of its levels.
    n : int
        Blocks, or replicates in a cell, of this study.
    cells : int
        Cells of the design.
    blocked : bool
        Whether each factor is tested against its own interaction with the blocks.
    alpha : float
        Size of the tests, a probability; the wanted power is 0.8.
    ratio : bool
        Whether the response is a logarithm, so that a difference is reported as a ratio.

    Returns
    -------
    dict of str to tuple of PowerRow
        For n / 2 (rounded up, 2 at least), n, 2 n and 4 n blocks or replicates; without factors
        that have no F.

    Notes
    -----
    Each level is a mean over ``cells / levels`` cells, so its error variance in one block is
    the error mean square over that number.
    """
    counts = sorted({max(2, math.ceil(n / 2)), n, 2 * n, 4 * n} - {1})
    found = {}
    for name, (row, levels) in terms.items():
        if row.f is None or not row.f > 0 or row.ms is None:
            continue
        each = cells / levels
        sd = math.sqrt(row.ms / row.f / each)
        rows = []
        for count in counts:
            df2 = (levels - 1) * (count - 1) if blocked else cells * (count - 1)
            size = _detectable(sd, count, (levels - 1, df2), alpha, 0.8)
            value = math.exp(size) if ratio else size
            rows.append(PowerRow(count, value, (levels - 1, df2)))
        found[name] = tuple(rows)
    return found


#: differences over the scatter that no number of runs has to find: beyond, powers overflow
_LARGEST = 1e100


def _detectable(sd: float, n: int, df: tuple[int, int], alpha: float, power: float) -> float:
    """Smallest largest difference that is found with the wanted power."""
    from scipy.optimize import brentq

    def gap(d: float) -> float:
        return _power(n * d**2 / 2, df, alpha) - power

    # statsmodels 0.15 would end here, without a warning, at a power of 0.05 for 3 or 5 blocks:
    # its solve_power takes a root of f^2 between -1 and 1
    high = 1.0
    while gap(high) < 0:
        high *= 2
        if high > _LARGEST:
            return math.inf
    found: float = brentq(gap, 0.0, high)
    return found * sd


def _power(noncentrality: float, df: tuple[int, int], alpha: float) -> float:
    from scipy.special import fdtri

    if noncentrality == 0:
        return alpha
    return 1 - noncentral_f_cdf(*df, noncentrality, float(fdtri(*df, 1 - alpha)))


def _df(n: int, levels: int, blocked: bool) -> tuple[int, int]:
    return levels - 1, (levels - 1) * (n - 1) if blocked else levels * (n - 1)


def _check(sd: float, n: int, levels: int) -> None:
    if not sd > 0 or n < 2 or levels < 2:
        raise InputError(
            Fault("power", f"needs sd > 0, n >= 2 and levels >= 2, got {sd}, {n}, {levels}")
        )


def detectable(
    sd: float,
    counts: Sequence[int],
    *,
    levels: int = 2,
    blocked: bool = True,
    alpha: float = 0.05,
    power: float = 0.8,
    cost: float | None = None,
) -> tuple[PowerRow, ...]:
    """Smallest difference found with the wanted power, for each number of blocks.

    Parameters
    ----------
    sd : float
        See :func:`power_of`.
    counts : sequence of int
        Numbers of specimens or seeds to compare.
    levels, blocked, alpha
        As for :func:`power_of`.
    power : float
        Wanted probability to find the difference.
    cost : float, optional
        Predicted cost of one block (seconds, say).

    Examples
    --------
    >>> [round(r.detectable, 3) for r in detectable(1.0, [3, 9])]
    [4.616, 1.509]
    """
    rows = []
    for n in counts:
        _check(sd, n, levels)
        df = _df(n, levels, blocked)
        total = None if cost is None else n * cost
        rows.append(PowerRow(n, _detectable(sd, n, df, alpha, power), df, total))
    return tuple(rows)
