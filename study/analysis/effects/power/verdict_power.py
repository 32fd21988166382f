"""Before a study is run: how probable each verdict is with so many specimens and mesh seeds.

The verdict of a contrast rests on its interval d +- t s / sqrt(b) widened by U. Given the
standard deviation over blocks, d is normal and s^2 a multiple of chi-squared, so that every
probability is one integral over s: the noncentral t for *matters*, Owen's Q (Owen 1965,
Biometrika 52, 437-446) for *no practical difference*.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from study.analysis.effects.comparisons import scale_rule
from study.errors import Fault, InputError

#: numbers of blocks beyond this are not looked for
MOST_BLOCKS = 200


@dataclass(frozen=True)
class VerdictProbabilities:
    """Probability of each verdict; they add to one."""

    matters: float
    no_practical_difference: float
    not_resolved: float
    cannot_tell: float


@dataclass(frozen=True)
class PlannedVerdicts:
    """What a number of blocks and seeds would tell, and what it costs.

    Parameters
    ----------
    blocks, seeds : int
        Specimens, and mesh seeds for each.
    equal : VerdictProbabilities
        If the true difference is zero.
    double : VerdictProbabilities
        If it is twice the practical difference.
    cases : int
        Solves that the study needs.
    seconds : float or None
        Their cost.
    """

    blocks: int
    seeds: int
    equal: VerdictProbabilities
    double: VerdictProbabilities
    cases: int
    seconds: float | None

    @property
    def right(self) -> float:
        """Smaller probability of the right claim, over both truths."""
        return min(self.equal.no_practical_difference, self.double.matters)


def contrast_sd(sd: float, seeds: int = 1, sd_seed: float = 0.0) -> float:
    """Give the standard deviation over blocks of a contrast whose seeds are averaged in each block.

    Parameters
    ----------
    sd : float
        Standard deviation of the contrast over blocks, without the seeds.
    seeds : int
        Mesh seeds in each block.
    sd_seed : float
        Standard deviation of the contrast over seeds within a block.

    Returns
    -------
    float
        sqrt(sd^2 + sd_seed^2 / seeds).

    Examples
    --------
    >>> contrast_sd(3.0, 4, 8.0)
    5.0
    """
    return math.hypot(sd, sd_seed / math.sqrt(seeds))


def verdict_probabilities(
    blocks: int, sd: float, practical: float, truth: float, *, u: float = 0.0, alpha: float = 0.05
) -> VerdictProbabilities:
    """Probability of each verdict of a contrast.

    Parameters
    ----------
    blocks : int
        Number of blocks; one allows no claim.
    sd : float
        Standard deviation of the contrast over blocks, see :func:`contrast_sd`.
    practical : float
        Smallest difference that matters, in the unit of the response.
    truth : float
        True difference.
    u : float
        Numerical uncertainty expected; its error is taken to be zero.
    alpha : float
        One minus the coverage of the interval.

    Returns
    -------
    VerdictProbabilities
        Of the four verdicts.

    Raises
    ------
    InputError
        For a standard deviation, practical difference or uncertainty that is no such number.

    Examples
    --------
    >>> round(verdict_probabilities(3, 0.3, 1.0, 0.0).no_practical_difference, 2)
    0.73
    """
    _check(blocks, sd, practical, u)
    if blocks == 1:
        return VerdictProbabilities(0.0, 0.0, 0.0, 1.0)
    matters, none = _claimed(blocks, sd, practical, truth, u, alpha)
    able = _claimed(blocks, sd, practical, truth, 0.0, alpha)
    unresolved = max(0.0, sum(able) - matters - none)
    return VerdictProbabilities(matters, none, unresolved, max(0.0, 1 - sum(able)))


def _claimed(
    blocks: int, sd: float, practical: float, truth: float, u: float, alpha: float
) -> tuple[float, float]:
    """Probability of *matters* and of *no practical difference*."""
    from scipy.special import ndtr, stdtrit

    error = sd / math.sqrt(blocks)
    s, weights = scale_rule(blocks - 1)
    half = float(stdtrit(blocks - 1, 1 - alpha / 2)) * error * s
    outer, inner = practical + u + half, practical - u - half
    above = ndtr((truth - outer) / error) + ndtr((-outer - truth) / error)
    within = ndtr((inner - truth) / error) - ndtr((-inner - truth) / error)
    return float(weights @ above), float(weights @ np.maximum(within, 0.0))


def planned_verdicts(
    counts: Sequence[int],
    sd: float,
    practical: float,
    *,
    seeds: int = 1,
    sd_seed: float = 0.0,
    u: float = 0.0,
    cells: int = 2,
    seconds: float | None = None,
) -> tuple[PlannedVerdicts, ...]:
    """Tell what each number of blocks would find, with its cost.

    Parameters
    ----------
    counts : sequence of int
        Numbers of blocks to compare.
    sd, practical, seeds, sd_seed, u
        As in :func:`verdict_probabilities` and :func:`contrast_sd`.
    cells : int
        Cells of the design.
    seconds : float, optional
        Cost of one solve, in s.

    Returns
    -------
    tuple of PlannedVerdicts
        One for each number of blocks.
    """
    spread = contrast_sd(sd, seeds, sd_seed)
    rows = []
    for blocks in counts:
        equal, double = (
            verdict_probabilities(blocks, spread, practical, truth, u=u)
            for truth in (0.0, 2 * practical)
        )
        cases = cells * blocks * seeds
        cost = None if seconds is None else cases * seconds
        rows.append(PlannedVerdicts(blocks, seeds, equal, double, cases, cost))
    return tuple(rows)


def fewest_blocks(
    sd: float, practical: float, *, u: float = 0.0, wanted: Sequence[float] = (0.8, 0.9)
) -> tuple[int | None, ...]:
    """Smallest numbers of blocks whose right claim reaches each wanted probability.

    Parameters
    ----------
    sd, practical, u
        As in :func:`verdict_probabilities`.
    wanted : sequence of float
        Probabilities of *no practical difference* at a truth of 0 and of *matters* at twice
        the practical difference; both must reach them.

    Returns
    -------
    tuple of (int or None)
        None where 200 blocks do not suffice, as when U reaches the practical difference.

    Examples
    --------
    >>> fewest_blocks(0.3, 1.0)
    (4, 4)
    """
    found: list[int | None] = []
    for level in wanted:
        rows = (planned_verdicts([b], sd, practical, u=u)[0] for b in range(2, MOST_BLOCKS + 1))
        found.append(next((row.blocks for row in rows if row.right >= level), None))
    return tuple(found)


def _check(blocks: int, sd: float, practical: float, u: float) -> None:
    faults = []
    if blocks < 1:
        faults.append(Fault("blocks", f"at least one is needed, got {blocks}"))
    for name, value in (("sd", sd), ("practical", practical)):
        if not (math.isfinite(value) and value > 0):
            faults.append(Fault(name, f"must be a positive number, got {value!r}"))
    if not (math.isfinite(u) and u >= 0):
        rule = f"must be zero or a positive number, got {u!r}"
        faults.append(Fault("numerical uncertainty", rule))
    if faults:
        raise InputError(faults)
