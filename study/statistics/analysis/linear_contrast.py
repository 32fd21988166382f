"""Contrasts that the analyst names: one set of cells against another.

``"material=ogden-1, range=60 % - material=neo-hookean, range=60 %"`` is the mean over all cells
of the first kind less that of the second; a factor that a side leaves out is averaged over.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from study.ground.arrays import Array, Flags
from study.ground.contrast import Setting, sides_of
from study.ground.errors import Fault, InputError
from study.statistics.analysis.anova_table import Effect
from study.statistics.analysis.comparisons import block_multiplier, holm, t_quantile, two_sided
from study.statistics.analysis.effects import UNEQUAL, Scale, by_components, group_errors
from study.statistics.analysis.equal_variance import doubted_variances
from study.statistics.analysis.simple_effects import (
    CANNOT_TELL,
    CLAIMS,
    NOT_RESOLVED,
    ONE_SPECIMEN,
    UNBOUNDED,
    verdict_of,
)

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Contrast:
    """A named difference with its intervals and its verdict."""

    name: str
    #: In the unit of the response, or a ratio where its log was analyzed; as the intervals.
    difference: float
    #: Of this contrast alone, and of all that were asked for together; None without scatter.
    ci: tuple[float, float] | None
    ci_simultaneous: tuple[float, float] | None
    df: float | None
    #: Of no difference: alone, and adjusted for all that were asked for (Holm 1979).
    p: float | None
    #: Bound of the numerical error; None where it is not known.
    u: float | None
    #: Against the smallest difference that matters.
    verdict: str
    why: str = ""
    p_holm: float | None = None


HolmTest = TypeVar("HolmTest", Effect, Contrast)


def with_holm(tests: Sequence[HolmTest]) -> tuple[HolmTest, ...]:
    """Adjust the p of all that have one together (Holm 1979, Scand. J. Statist. 6, 65)."""
    adjusted = iter(holm([test.p for test in tests if test.p is not None]).tolist())
    return tuple(test if test.p is None else replace(test, p_holm=next(adjusted)) for test in tests)


@dataclass(frozen=True)
class _Estimate:
    """A difference on the scale of the analysis; ``by_block`` where it is made within blocks."""

    value: float
    error: float | None
    df: float | None
    by_block: Array | None = None
    welch: tuple[float, float] | None = None  # standard error and df with a variance a cell


@dataclass(frozen=True)
class Cells:
    """The rows of an analysis, as contrasts need them."""

    #: One row a run: ``cell``, ``y`` on the scale of the analysis, every factor, and ``block``
    #: where there are blocks.
    rows: pd.DataFrame
    levels: Mapping[str, tuple[str, ...]]
    #: What matters and what bounds the numerical error.
    scale: Scale
    #: One minus the level of the intervals.
    alpha: float
    seed: int
    #: Whether the repeats (or blocks) are refits to resampled noise of one curve: their scatter is
    #: the standard error of the fit itself, however many there are.
    resampled: bool = False
    #: Difference, standard error and degrees of freedom by a model of all rows.
    estimate: Callable[[Setting, Setting], tuple[float, float, float]] | None = None


def contrasts(cells: Cells, texts: Sequence[str]) -> tuple[Contrast, ...]:
    """Estimate differences of sets of cells."""
    estimated, faults = possible_contrasts(cells, texts)
    if faults:
        raise InputError(faults)
    return estimated


def possible_contrasts(
    cells: Cells, texts: Sequence[str]
) -> tuple[tuple[Contrast, ...], list[Fault]]:
    """Estimate those differences of sets of cells that can be, and say what keeps the others."""
    possible: list[tuple[str, tuple[Setting, Setting], _Estimate]] = []
    faults: list[Fault] = []
    for text in texts:
        try:
            sides = sides_of(text, cells.levels)
            if cells.estimate is None:
                estimate = _estimate(cells, *sides, text)
            else:
                estimate = _Estimate(*cells.estimate(*sides))
            possible.append((text, sides, estimate))
        except InputError as error:
            faults += error.faults
    wide = _multipliers([estimate for *_, estimate in possible], cells.alpha, cells.seed)
    together = ((multiplier, len(possible)) for multiplier in wide)
    judged = [_judged(*of, both, cells) for of, both in zip(possible, together, strict=True)]
    return with_holm(judged), faults


def _estimate(cells: Cells, first: Setting, second: Setting, text: str) -> _Estimate:
    rows = cells.rows
    sides = []
    for setting in (first, second):
        holds = np.ones(len(rows), dtype=bool)
        for name, level in setting.items():
            holds &= (rows[name].astype(str) == level).to_numpy()
        if not holds.any():
            setting_text = ", ".join(f"{name}={level}" for name, level in setting.items())
            raise InputError(Fault(f"contrast {text!r}", f"no row has {setting_text}"))
        sides.append(holds)
    if "block" not in rows:
        return _of_cells(rows, sides, resampled=cells.resampled)
    # every cell counts once, whatever its repeats
    by_cell = (rows[holds].groupby(["block", "cell"])["y"].mean() for holds in sides)
    means = [of_cells.groupby("block").mean() for of_cells in by_cell]
    both = means[0].index.intersection(means[1].index)
    differences = (means[0][both] - means[1][both]).to_numpy() if len(both) else None
    # within blocks, else by Welch between two sets of blocks
    sets = [mean.to_numpy() for mean in means] if differences is None else [differences]
    parts = np.concatenate([side / side.size for side in (sets[0], *(-s for s in sets[1:]))])
    value, least = float(parts.sum()), min(side.size for side in sets)
    if least < 2:
        return _Estimate(value, None, None, differences)
    groups = np.split(np.arange(parts.size), [side.size for side in sets[:-1]])
    error, df = (float(a[0]) for a in group_errors(parts[None], groups))
    if cells.resampled and differences is not None:
        error *= math.sqrt(least)
    return _Estimate(value, error, df if error or differences is not None else None, differences)


def _of_cells(rows: pd.DataFrame, sides: Sequence[Flags], *, resampled: bool) -> _Estimate:
    """Difference of means of cells, with the variance pooled within all cells.

    A cell that lies on both sides counts by the difference of its weights.
    """
    y, index = rows["y"].to_numpy(), np.unique(rows["cell"].to_numpy(), return_inverse=True)[1]
    counts = np.bincount(index)
    means = np.bincount(index, y - y[0]) / counts
    of_sides = [np.bincount(index, side) > 0 for side in sides]
    weight = np.subtract(*(cells / cells.sum() for cells in of_sides))
    value, df = float(weight @ means), float(y.size - counts.size)
    if df < 1:
        return _Estimate(value, None, None)
    squares = float(np.sum((y - y[0] - means[index]) ** 2))
    share, welch = weight**2 / (1 if resampled else counts), None
    variances = None if resampled else doubted_variances(y, index)
    if variances is not None:
        error, free = by_components(share[None], *variances, cautious=True)
        welch = float(error[0]), float(free[0])
    return _Estimate(value, math.sqrt(squares / df * float(share.sum())), df, welch=welch)


def _multipliers(estimates: Sequence[_Estimate], alpha: float, seed: int) -> list[float]:
    """Multipliers of the standard errors for intervals of all contrasts together."""
    blocks = [e.by_block for e in estimates if e.by_block is not None and e.error]
    if len(blocks) == len(estimates) > 1 and len({b.size for b in blocks}) == 1:
        m, b = len(blocks), blocks[0].size
        df = np.full(m, b - 1.0)
        return [*map(float, block_multiplier(np.array(blocks), alpha, seed, [np.arange(b)], df))]
    each = alpha / (2 * max(len(estimates), 1))
    return [0.0 if e.df is None else t_quantile(each, e.df) for e in estimates]


def _judged(
    text: str,
    sides: tuple[Setting, Setting],
    estimate: _Estimate,
    together: tuple[float, int],
    cells: Cells,
) -> Contrast:
    """Judge one of some contrasts, whose simultaneous multiplier and number are ``together``."""
    (multiplier, number), scale, alpha = together, cells.scale, cells.alpha
    value, error, df = estimate.value, estimate.error, estimate.df
    u = 0.0 if scale.bound is None else scale.bound.of(*map(dict, sides))
    shown = None if u is None or scale.bound is None else u / scale.unit
    why = "nothing scatters, so there is no interval"
    contrast = Contrast(text, scale.back(value), None, None, df, None, shown, CANNOT_TELL, why)
    if error is None or df is None:
        return contrast

    def around(half: float) -> tuple[float, float]:
        return value - half, value + half

    ci, wide = around(t_quantile(alpha / 2, df) * error), around(multiplier * error)
    verdict, why = _verdict(ci, wide, u, scale)
    if estimate.welch is not None and verdict in CLAIMS:
        of_cells, free = estimate.welch
        alone, every = (around(t_quantile(alpha / (2 * m), free) * of_cells) for m in (1, number))
        if _verdict(alone, every, u, scale)[0] != verdict:
            verdict, why = CANNOT_TELL, UNEQUAL
    p = two_sided(value / error, df) if error else None
    contrast = replace(contrast, ci=scale.ends(ci), ci_simultaneous=scale.ends(wide), p=p)
    return replace(contrast, verdict=verdict, why=why)


def _verdict(
    ci: tuple[float, float], wide: tuple[float, float], u: float | None, scale: Scale
) -> tuple[str, str]:
    """Verdict, and why it is none where the interval alone does not show that."""
    if scale.practical is None:
        return CANNOT_TELL, "no practical threshold was given"
    if scale.specimens == 1:
        return CANNOT_TELL, ONE_SPECIMEN
    verdict = verdict_of(ci, wide, u, scale.practical)
    if verdict == NOT_RESOLVED and u is None:
        return verdict, UNBOUNDED
    return verdict, "2 specimens" if scale.specimens == 2 and verdict in CLAIMS else ""
