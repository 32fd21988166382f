"""One emulator a block: what factors do in each block, and how that differs between blocks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.errors import Fault, RefusedError
from study.response_surface.emulator.effect_ranges import EffectRange, Small
from study.response_surface.emulator.emulator import (
    Emulator,
    Gate,
    fit_emulator,
    fit_together,
)
from study.response_surface.emulator.sobol_indices import SAMPLE_ERROR, SobolIndex
from study.response_surface.factors import Runs

#: fewest blocks whose mean has an interval worth the name
FEWEST = 3


@dataclass(frozen=True)
class BlockedEmulator:
    """Emulators of the blocks; every number is formed in each block, then compared over them.

    Parameters
    ----------
    runs : Runs
        Of all blocks.
    emulators : dict of str to Emulator
        By block, at least three.
    """

    runs: Runs
    emulators: dict[str, Emulator]

    @property
    def each(self) -> tuple[Emulator, ...]:
        """The emulators in the order of the blocks."""
        return tuple(self.emulators.values())

    @property
    def q2(self) -> float:
        """Smallest leave-one-out Q2 of all blocks."""
        return min(found.q2 for found in self.each)

    @property
    def gate(self) -> Gate:
        """What the worst block allows to be said."""
        return min(self.each, key=lambda found: found.q2).gate

    @property
    def loo_rms(self) -> float:
        """Root mean square leave-one-out error over all blocks, in the response's unit."""
        return float(np.sqrt(np.mean([found.loo_rms**2 for found in self.each])))

    @property
    def loo_errors(self) -> Array:
        """Leave-one-out errors of all blocks, in the response's unit."""
        return np.concatenate([found.loo_errors for found in self.each])

    def value(self, coded: Array) -> Array:
        """Mean over the blocks, shape (m,), at coded points of shape (m, k)."""
        return np.asarray(np.mean([found.value(coded) for found in self.each], axis=0))

    def predict(self, coded: Array) -> tuple[Array, Array]:
        """Means over blocks and half widths: scatter of the blocks, and the emulators' error."""
        told = [found.predict(coded) for found in self.each]
        values = np.array([value for value, _ in told])
        errors = np.mean([half for _, half in told], axis=0)
        return values.mean(axis=0), self._scatter(values) + errors

    def indices(self) -> tuple[SobolIndex, ...]:
        """Sobol indices, averaged over blocks, with t intervals widened by 1 - Q2."""
        told = [found.indices() for found in self.each]
        margin = 1.0 - self.q2 + SAMPLE_ERROR
        return tuple(_averaged(own, self._scatter, margin) for own in zip(*told, strict=True))

    def ranges(self, practical: float | None, u: float = 0.0) -> tuple[EffectRange, ...]:
        """Range along every factor, averaged over blocks; arguments as for one emulator."""
        told = [found.ranges(practical, u) for found in self.each]
        small = Small(practical, float(np.ptp(self.runs.response)))
        return tuple(self._range(own, small) for own in zip(*told, strict=True))

    def _range(self, own: tuple[EffectRange, ...], small: Small) -> EffectRange:
        values = np.array([effect.value for effect in own])
        bound = float(self._scatter(values) + np.mean([effect.bound for effect in own]))
        value = float(values.mean())
        # where the block nearest to the mean has its extremes
        nearest = own[int(np.abs(values - value).argmin())]
        return EffectRange(value, bound, small.verdict(value, bound), nearest.confirm)

    def _scatter(self, values: Array) -> Array:
        """Half width of the 95 % interval of a mean over blocks, the first axis of the values."""
        from scipy import stats

        b = len(self.each)
        t = float(stats.t.ppf(0.975, b - 1))
        return np.asarray(t * values.std(axis=0, ddof=1) / np.sqrt(b))


def _averaged(
    own: tuple[SobolIndex, ...], scatter: Callable[[Array], Array], margin: float
) -> SobolIndex:
    first = np.array([index.first for index in own])
    total = np.array([index.total for index in own])
    return SobolIndex(
        float(first.mean()),
        _interval(first, float(scatter(first)) + margin),
        float(total.mean()),
        _interval(total, float(scatter(total)) + margin),
    )


def _interval(values: Array, half: float) -> tuple[float, float]:
    low, high = np.clip([values.mean() - half, values.mean() + half], 0.0, 1.0)
    return float(low), float(high)


def fit_blocks(runs: Runs, seed: int = 0) -> BlockedEmulator:
    """Fit an emulator to the runs of each block.

    Parameters
    ----------
    runs : Runs
        Of at least three blocks.
    seed : int
        Of everything random, the same in every block.

    Raises
    ------
    RefusedError
        If there are fewer blocks, or a block cannot carry an emulator.
    """
    found = {name: fit_emulator(_of_block(runs, name), seed) for name in _blocks(runs)}
    return BlockedEmulator(runs, found)


def fit_blocks_together(
    runs: Sequence[Runs], sizes: Sequence[int], seed: int = 0
) -> tuple[BlockedEmulator, ...]:
    """Fit one process a block to its runs of all combinations of categories.

    Parameters
    ----------
    runs, sizes, seed
        As for `fit_together`; every combination has runs of the same blocks.

    Raises
    ------
    RefusedError
        As for `fit_blocks` and `fit_together`.
    """
    every = [_blocks(one) for one in runs]
    if any(set(one) != set(every[0]) for one in every):
        rule = "the combinations of levels have runs of other blocks"
        raise RefusedError(str(Fault("emulator", rule, "run every block at each of them")))
    found = {
        name: fit_together([_of_block(one, name) for one in runs], sizes, seed) for name in every[0]
    }
    return tuple(
        BlockedEmulator(one, {name: own[place] for name, own in found.items()})
        for place, one in enumerate(runs)
    )


def _blocks(runs: Runs) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(runs.blocks))
    if len(names) < FEWEST:
        rule = f"{len(names)} blocks have no interval, at least {FEWEST} are needed"
        mend = "analyze the rows of one block at a time, without --block"
        raise RefusedError(str(Fault("--block", rule, mend)))
    return names


def _of_block(runs: Runs, name: str) -> Runs:
    rows = np.array(runs.blocks) == name
    return Runs(runs.name, runs.factors, runs.coded[rows], runs.response[rows])
