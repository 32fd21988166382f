"""What a planned number of specimens or mesh seeds can detect, before anything is run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from study.errors import Fault, InputError


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

    Notes
    -----
    Two extreme means and the rest in the middle give the smallest noncentrality,
    lambda = n d^2 / (2 sd^2).
    """
    _check(sd, n, levels)
    from scipy.special import fdtri, ncfdtr

    df1, df2 = _df(n, levels, blocked)
    cut = float(fdtri(df1, df2, 1 - alpha))
    noncentrality = n * difference**2 / (2 * sd**2)
    if noncentrality == 0:
        return alpha
    return 1 - float(ncfdtr(df1, df2, noncentrality, cut))


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
    cost : float, optional
        Predicted cost of one block (seconds, say).

    Examples
    --------
    >>> [round(r.detectable, 3) for r in detectable(1.0, [3, 9])]
    [4.616, 1.509]
    """
    from scipy.optimize import brentq

    rows = []
    for n in counts:
        _check(sd, n, levels)

        def gap(d: float, n: int = n) -> float:
            got = power_of(d * sd, sd, n, levels=levels, blocked=blocked, alpha=alpha)
            return got - power

        high = 1.0
        while gap(high) < 0:
            high *= 2
        found: float = brentq(gap, 0.0, high)
        total = None if cost is None else n * cost
        rows.append(PowerRow(n, found * sd, _df(n, levels, blocked), total))
    return tuple(rows)
