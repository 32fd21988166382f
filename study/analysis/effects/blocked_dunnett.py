"""Every level against a reference where all levels are measured in the same blocks.

Dunnett (1955), J. Amer. Statist. Assoc. 50, 1096-1121, with the largest |t| over differences
that depend on each other and may differ in variance; for independent groups of equal variance
see :func:`study.analysis.effects.comparisons.dunnett`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from study.analysis.effects.comparisons import Comparisons, Pair
from study.analysis.effects.simultaneous import block_multiplier
from study.arrays import Array
from study.errors import Fault, InputError, nearest

#: smallest p that is told apart: one of the 4,000 draws of the multiplier
_LEAST_P = 1 / 4000
#: halvings of the level, to a thousandth of it
_STEPS = 14


def blocked_dunnett(
    levels: Mapping[str, ArrayLike], reference: str, *, alpha: float = 0.05, seed: int = 2011
) -> Comparisons:
    """Compare every level with a reference over blocks.

    Parameters
    ----------
    levels : mapping of str to array_like, shape (b,)
        Mean of each level in each block, blocks in the same order.
    reference : str
        Level that the others are compared with.
    alpha : float
        One minus the simultaneous coverage.
    seed : int
        Seed of the simulated multiplier.

    Returns
    -------
    Comparisons
        Differences from the reference with simultaneous intervals; p is the level at which an
        interval touches zero, so both always agree.

    Raises
    ------
    InputError
        If ``reference`` is no level, or the levels do not share at least two blocks.
    """
    values = {str(name): np.asarray(v, dtype=float) for name, v in levels.items()}
    _check(values, reference)
    others = [name for name in values if name != reference]
    contrasts = np.array([values[name] - values[reference] for name in others])
    centre = contrasts.mean(axis=1)
    error = contrasts.std(axis=1, ddof=1) / math.sqrt(contrasts.shape[1])
    half = block_multiplier(contrasts, alpha, seed) * error
    pairs = tuple(
        Pair(name, reference, float(d), float(d - h), float(d + h), _p(contrasts, d, s, seed))
        for name, d, h, s in zip(others, centre, half, error, strict=True)
    )
    return Comparisons("Dunnett over blocks", alpha, pairs, {})


def _p(contrasts: Array, centre: float, error: float, seed: int) -> float:
    """Level at which the simultaneous interval of one difference touches zero."""
    low, high = math.log(_LEAST_P), 0.0
    if centre == 0:
        return 1.0
    for _ in range(_STEPS):
        level = (low + high) / 2
        beyond = abs(centre) > block_multiplier(contrasts, math.exp(level), seed) * error
        low, high = (low, level) if beyond else (level, high)
    return math.exp(high)


def _check(values: Mapping[str, Array], reference: str) -> None:
    faults = []
    if reference not in values:
        rule = f"{reference!r} is no level"
        faults.append(Fault("reference", rule, nearest(reference, values)))
    elif len(values) < 2:
        faults.append(Fault("levels", "at least two levels are needed"))
    shapes = {v.shape for v in values.values()}
    if len(shapes) != 1 or any(len(s) != 1 or s[0] < 2 for s in shapes):
        rule = "every level needs one value in each of the same blocks, two blocks at least"
        faults.append(Fault("blocks", rule, "leave incomplete blocks out"))
    elif not all(np.isfinite(v).all() for v in values.values()):
        faults.append(Fault("blocks", "a value is missing", "leave incomplete blocks out"))
    if faults:
        raise InputError(faults)
