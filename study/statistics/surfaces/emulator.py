"""An emulator of a response: prediction, its error, and what the factors do."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Literal

import numpy as np
import scipy

from study.ground.arrays import Array, Flags
from study.ground.canonical import Keyed
from study.ground.errors import Fault, RefusedError
from study.statistics.analysis.comparisons import t_quantile
from study.statistics.analysis.simple_effects import CANNOT_TELL, claim
from study.statistics.surfaces.gaussian_process import (
    FAMILIES,
    GaussianProcess,
    draw_paths,
    fit_process,
)
from study.statistics.surfaces.surface_factors import Runs, change_together, some_runs

# How far a factor moves the response, in the response's unit, and whether that matters.

#: settings of the other factors, and steps along the factor
SETTINGS = 256
STEPS = 11
#: part of the settings that the range is claimed for
SHARE = 0.95
#: coded distance within which two runs stand at one setting of a factor
SAME_PLACE = 1e-3
#: bound of a range: this many times the largest leave-one-out error
ERRORS = 2.0
#: added to a range before it is called small, as a part of the response's range: larger than
#: every miss of the bound on the borehole function
MISS = 0.02


@dataclass(frozen=True)
class EffectRange:
    """Range of the response along one factor."""

    #: Range, in the response's unit, that 95 % of the settings of the others stay below.
    value: float
    #: Half width around it: twice the largest leave-one-out error, and numerical uncertainty.
    bound: float
    #: {"matters", "no practical difference", "cannot tell"}: at 95 % of the settings.
    verdict: str
    #: shape (2, k); coded settings of the two predicted extremes: run both before the claim is
    #: made.
    confirm: Array
    #: Whether two runs that differ in this factor alone differ by more than what matters.
    confirmed: bool = False

    @property
    def claims(self) -> bool:
        """Whether the factor is said to matter, which two runs are yet to confirm."""
        return self.verdict == "matters" and not self.confirmed

    @property
    def words(self) -> str:
        """The verdict, and what it still waits for."""
        return f"{self.verdict}, if confirmed" if self.claims else self.verdict


def is_confirmed(runs: Runs, j: int, least: float) -> bool:
    """Whether two runs that differ in factor j alone differ by more than ``least``.

    Runs repeated at one setting count by their mean, over blocks their mean difference less its
    95 % interval. Settings of confirming runs are rounded to a ten-thousandth of their range.
    """
    import pandas as pd

    others = np.round(np.delete(runs.coded, j, axis=1) / SAME_PLACE)
    group = np.unique(others, axis=0, return_inverse=True)[1].ravel()
    block = runs.blocks or ("",) * runs.size
    rows = {"place": group, "at": runs.coded[:, j].round(3), "block": block, "y": runs.response}
    # one column a block, NaN where it has no run there
    means = pd.DataFrame(rows).pivot_table("y", ["place", "at"], "block")
    means = means[means.index.get_level_values(0).duplicated(keep=False)]
    n = means.shape[1]
    # two blocks have no interval
    t = t_quantile(0.025, n - 1) if n > 2 else math.nan
    for _, at_place in means.groupby(level=0):
        for a, b in combinations(at_place.to_numpy(), 2):
            change = a - b
            half = 0.0 if n == 1 else t * np.std(change, ddof=1) / math.sqrt(n)
            if abs(change.mean()) - half > least:  # false of a NaN
                return True
    return False


def effect_ranges(
    value: Callable[[Array], Array],
    runs: Runs,
    bounds: Sequence[float],
    practical: float | None,
    u: float,
) -> tuple[EffectRange, ...]:
    """Range along every factor of a surface over coded points, with its bound, judged."""
    from scipy.stats import qmc

    k, spread, ranges = len(bounds), float(np.ptp(runs.response)), []
    for j, bound in enumerate(bounds):
        others = 2.0 * qmc.Sobol(k, seed=j).random(SETTINGS) - 1.0
        points = np.repeat(others[:, None], STEPS, axis=1)
        points[:, :, j] = 2.0 * np.linspace(0.0, 1.0, STEPS) - 1.0
        values = value(points.reshape(-1, k)).reshape(SETTINGS, STEPS)
        sizes = np.ptp(values, axis=1)
        size = float(np.quantile(sizes, SHARE))
        at = int(np.abs(sizes - size).argmin())
        ends = points[at, [int(values[at].argmin()), int(values[at].argmax())]]
        verdict = verdict_of(size, bound, practical, spread)
        confirmed = practical is not None and is_confirmed(runs, j, practical + u)
        ranges.append(EffectRange(size, bound, verdict, ends, confirmed))
    return tuple(ranges)


def verdict_of(value: float, bound: float, practical: float | None, response_range: float) -> str:
    """Judge a range with its bound; what is too small to matter is told from the runs' range."""
    high = value + bound + MISS * response_range
    if practical is None:
        return CANNOT_TELL
    return claim(value - bound, high, practical) or CANNOT_TELL


# Shares of the response's variance that factors explain, with all factors uniform on the box.

#: points of the sample: with 1,024 an exact emulator still erred by .017
SAMPLE = 4096
#: what the sample itself may err, added to every interval
SAMPLE_ERROR = 0.005


@dataclass(frozen=True)
class SobolIndex:
    """First-order and total index of a factor."""

    #: S: share of the variance by the factor alone; T: with all its interactions.
    first: float
    first_interval: tuple[float, float]
    total: float
    total_interval: tuple[float, float]

    @classmethod
    def of(
        cls, first: float, first_ends: Array, total: float, total_ends: Array, margin: float
    ) -> SobolIndex:
        """Make indices of which the intervals are wider by a margin at each end; all are shares."""

        def wide(ends: Array) -> tuple[float, float]:
            low, high = np.clip([ends[0] - margin, ends[1] + margin], 0.0, 1.0)
            return float(low), float(high)

        index = float(np.clip(first, 0.0, 1.0)), float(np.clip(total, 0.0, 1.0))
        return cls(index[0], wide(first_ends), index[1], wide(total_ends))


#: keys of the index of a factor, which are null without one
INDEX = (
    "S=index.first S_interval=index.first_interval T=index.total T_interval=index.total_interval"
)


def jansen(values: Callable[[Array], Array], k: int, seed: int) -> tuple[Array, Array]:
    """First-order and total indices by Jansen's estimators (Saltelli et al. 2010, table 2)."""
    # Shapes: values (m, p); returns (k, p).
    from scipy.stats import qmc

    sample = qmc.Sobol(2 * k, seed=seed).random(SAMPLE)
    a = sample[:, :k]
    b = sample[:, k:]
    at_a = values(a)
    at_b = values(b)
    variance = np.vstack([at_a, at_b]).var(axis=0)
    twice = np.where(variance > 0, 2.0 * variance, np.nan)
    first = np.empty((k, at_a.shape[1]))
    total = np.empty_like(first)
    for j in range(k):
        mixed = a.copy()
        mixed[:, j] = b[:, j]
        at_mixed = values(mixed)
        first[j] = 1.0 - ((at_b - at_mixed) ** 2).mean(axis=0) / twice
        total[j] = ((at_a - at_mixed) ** 2).mean(axis=0) / twice
    return first, total


def sobol_indices(
    values: Callable[[Array], Array], k: int, q2: float, seed: int
) -> tuple[SobolIndex, ...]:
    """Estimate indices of the posterior mean, with intervals from its paths."""
    # Shapes: values (m, 1 + paths).
    first, total = jansen(values, k, seed)
    margin = 1.0 - q2 + SAMPLE_ERROR
    shares = [0.025, 0.975]
    return tuple(
        SobolIndex.of(s[0], np.quantile(s[1:], shares), t[0], np.quantile(t[1:], shares), margin)
        for s, t in zip(first, total, strict=True)
    )


#: Q2 at which indices and effects are given, and at which factors are at least ranked
GIVEN = 0.9
RANKED = 0.7
#: most runs: the work grows with the cube, 1,000 runs take about half a minute, 2,000 about five
LARGEST = 2000
#: seconds of a fit with 1,000 runs on one core, for the estimate that is said beforehand: 25 to
#: 30 of eight factors
SECONDS_1000 = 40.0
#: fewest runs a factor where a design does not fill the box
RUNS_A_FACTOR = 10
#: fewest different runs of each combination of categories
FEWEST_OWN = 5
#: fewest settings of a factor
FEWEST_SETTINGS = 4
#: designs with at most this many settings a factor are grids, not space-filling
GRID_LEVELS = 5

Gate = Literal["given", "ranking only", "refused"]


@dataclass(frozen=True)
class Emulator(Keyed):
    """A fitted emulator."""

    #: What it was fitted to, copies averaged.
    runs: Runs
    #: In the unit box, for standardized responses; where it was fitted to the runs of several
    #: combinations of categories, it has those of the others, too.
    process: GaussianProcess
    seed: int
    #: Number of the combination of categories at which it is asked.
    combination: int | None = None
    #: The same runs with the other kernel: where runs are far, the two part.
    rival: GaussianProcess | None = None

    @property
    def each(self) -> tuple[Emulator, ...]:
        """The emulator itself, as of blocks those of each."""
        return (self,)

    @cached_property
    def centre(self) -> float:
        """Mean of the responses, in their unit."""
        return float(self.runs.response.mean())

    @cached_property
    def scale(self) -> float:
        """Standard deviation of the responses, in their unit."""
        return float(self.runs.response.std())

    @property
    def kernel(self) -> dict[str, object]:
        """Kernel and Q2; with the runs of other combinations of levels their correlations."""
        kernel = self.process.hyperparameters.kernel
        lengths = dict(zip(self.runs.names, kernel.lengths, strict=True))
        keys: dict[str, object] = {"kernel": kernel.family, "lengths": lengths, "q2": self.q2}
        if kernel.categories is None:
            return keys
        return keys | {"category_correlation": kernel.categories.matrix[self.combination]}

    def keyed(self) -> dict[str, object]:
        """Give what stands under every key."""
        return self.kernel | left_out_errors(self)

    @cached_property
    def loo_errors(self) -> Array:
        """Leave-one-out errors of the own runs, shape (n,), in the response's unit."""
        return np.asarray(self.scale * self.process.loo_errors[self._own])

    @property
    def _own(self) -> Flags:
        which = self.process.hyperparameters.kernel.combination(self.process.x)
        return np.asarray(which == (self.combination or 0))

    def points(self, unit: Array) -> Array:
        """Points of the process at points (m, k) of the unit box."""
        return _among(unit, self.combination)

    def paths(self, seed: int) -> Callable[[Array], Array]:
        """Draw posterior paths: the mean and functions, shape (m, 1 + paths), of points (m, k)."""
        # Points lie in the unit box; values are those of standardized responses.
        drawn = draw_paths(self.process, seed)
        return lambda unit: drawn(self.points(unit))

    @property
    def loo_rms(self) -> float:
        """Root mean square leave-one-out error, in the response's unit."""
        return float(np.sqrt(np.mean(self.loo_errors**2)))

    @property
    def q2(self) -> float:
        """Share of the responses' variance that is predicted from the other runs."""
        left = float((self.loo_errors**2).sum())
        return 1.0 - left / float(((self.runs.response - self.runs.response.mean()) ** 2).sum())

    @property
    def gate(self) -> Gate:
        """What may be said: indices and effects, a ranking, or nothing."""
        if self.q2 >= GIVEN:
            return "given"
        return "ranking only" if self.q2 >= RANKED else "refused"

    @cached_property
    def widening(self) -> float:
        """Factor that makes the process' deviations as large as leave-one-out errors."""
        ratios = np.abs(self.process.loo_errors / self.process.loo_deviations)[self._own]
        rms = float(np.sqrt(np.mean(ratios**2)))
        return max(1.0, rms, float(np.quantile(ratios, 0.95)) / 1.96)

    def predict(self, coded: Array) -> tuple[Array, Array]:
        """Predictions and half widths of 95 % intervals, shape (m,) each, at coded points.

        What the other kernel predicts counts as well. In a corner of the box, where extremes lie
        and no run is near, deviations of one kernel covered 25 to 88 % of the largest and smallest
        values of five functions; with this they cover 75 to 100 %.
        """
        x = self.points(0.5 * (coded + 1.0))
        mean = self.process.mean(x)
        other = mean if self.rival is None else self.rival.mean(x)
        deviation = self.scale * self.widening * self.process.deviation(x)
        half = 1.96 * np.maximum(deviation, self.loo_rms) + self.scale * np.abs(mean - other)
        return self.centre + self.scale * mean, half

    def value(self, coded: Array) -> Array:
        """Predictions, shape (m,), at coded points of shape (m, k)."""
        return self.centre + self.scale * self.process.mean(self.points(0.5 * (coded + 1.0)))

    def indices(self) -> tuple[SobolIndex, ...]:
        """Sobol indices of every factor."""
        if self.gate == "refused":
            rule = f"Q2 is {self.q2:.2f}, below {RANKED}: no indices"
            mend = f"add runs: {2 * self.runs.response.size} in all"
            raise RefusedError(str(Fault("emulator", rule, mend)))
        return sobol_indices(self.paths(self.seed), len(self.runs.factors), self.q2, self.seed)

    def ranges(self, practical: float | None, u: float = 0.0) -> tuple[EffectRange, ...]:
        """Range of the response along every factor."""
        bound = ERRORS * float(np.abs(self.loo_errors).max()) + u
        return effect_ranges(self.value, self.runs, [bound] * len(self.runs.factors), practical, u)


def left_out_errors(model: Emulator | BlockedEmulator) -> dict[str, object]:
    """Give the errors of predicting runs from the others, and what may be said with them."""
    largest = np.abs(model.loo_errors).max()
    return {"loo_rms": model.loo_rms, "loo_max": largest, "q2": model.q2, "indices": model.gate}


def expected_seconds(n: int) -> float:
    """Seconds that a fit of n runs takes on one core."""
    return SECONDS_1000 * (n / 1000.0) ** 3


def fit_emulator(runs: Runs, seed: int = 0) -> Emulator:
    """Fit both kernels and keep the one that predicts left-out runs better."""
    _check(runs)
    (model,) = _fitted([runs], (), seed)
    return model


def fit_together(runs: Sequence[Runs], sizes: Sequence[int]) -> tuple[Emulator, ...]:
    """Fit one process to the runs of all combinations of categories together."""
    for single in runs:
        n = len(single.distinct()[0])
        if n < FEWEST_OWN:
            rule = (
                f"{n} different runs at one combination of levels, at least {FEWEST_OWN} are needed"
            )
            raise RefusedError(str(Fault("emulator", rule, "add runs, or leave a level out")))
    first = runs[0]
    coded, response = (np.concatenate([getattr(r, n) for r in runs]) for n in ("coded", "response"))
    _check(Runs(first.name, first.factors, coded, response))
    return _fitted(runs, sizes)


def _fitted(runs: Sequence[Runs], sizes: Sequence[int], seed: int = 0) -> tuple[Emulator, ...]:
    averaged = [_emulator_averaged(response) for response in runs]
    numbers = range(len(runs)) if sizes else [None]
    parts = []
    for (response, u), number in zip(averaged, numbers, strict=True):
        centre, scale = response.response.mean(), response.response.std()
        if scale <= 1e-12 * abs(centre):
            rule = f"the response {response.name!r} is the same in every run"
            raise RefusedError(str(Fault("emulator", rule, "there is nothing to explain")))
        unit = _among(0.5 * (response.coded + 1.0), number)
        parts.append((unit, (response.response - centre) / scale, (u / scale) ** 2))
    x, y, noise = map(np.concatenate, zip(*parts, strict=True))
    fits = [fit_process(x, y, noise, family, seed, sizes) for family in FAMILIES]
    rival, best = sorted(fits, key=lambda p: 1.0 - float((p.loo_errors**2).sum() / (y**2).sum()))
    each = zip(averaged, numbers, strict=True)
    return tuple(Emulator(response, best, seed, number, rival) for (response, _), number in each)


def _among(unit: Array, combination: int | None) -> Array:
    """Points of the process: those of the unit box, and the number of the combination."""
    if combination is None:
        return unit
    return np.column_stack([unit, np.full(len(unit), float(combination))])


def _emulator_averaged(runs: Runs) -> tuple[Runs, Array]:
    """Average copies: a run is no test of its own copy."""
    settings, which = runs.distinct()
    counts = np.bincount(which)
    response = np.bincount(which, weights=runs.response) / counts
    u = np.zeros(counts.size)
    if runs.u_num is not None:
        u = np.sqrt(np.bincount(which, weights=runs.u_num**2) / counts)
    return Runs(runs.name, runs.factors, settings, response), u


def _check(runs: Runs) -> None:
    n, k, levels = len(runs.distinct()[0]), len(runs.factors), runs.levels()
    if runs.size > LARGEST:
        rule = f"{runs.size} runs, at most {LARGEST}: the work grows with their cube"
        mend = f"take every {-(-runs.size // LARGEST)}th row, or --surface quadratic"
        raise RefusedError(str(Fault("emulator", rule, mend)))
    for name, count in zip(runs.names, levels, strict=True):
        if count < FEWEST_SETTINGS:
            least = f"an emulator needs at least {FEWEST_SETTINGS}"
            rule = f"factor {name!r} has {count} settings, {least}"
            mend = "--surface quadratic, or run more settings"
            raise RefusedError(str(Fault("emulator", rule, mend)))
    needed = RUNS_A_FACTOR * k if max(levels) <= GRID_LEVELS else 3 * k
    if n < needed:
        rule = f"{n} different runs of {k} factors, at least {needed} are needed"
        raise RefusedError(str(Fault("emulator", rule, "add runs, or --surface quadratic")))
    together = change_together(runs)
    if together:
        rule = f"{', '.join(map(repr, together[:-1]))} and {together[-1]!r} change together"
        mend = "leave one of them out, or run settings that part them"
        raise RefusedError(str(Fault("emulator", f"{rule} in every run", mend)))


# One emulator a block: what factors do in each block, and how that differs between blocks.

#: fewest blocks whose mean has an interval worth the name
FEWEST = 3


@dataclass(frozen=True)
class BlockedEmulator(Keyed):
    """Emulators of the blocks; every number is formed in each block, then compared over them."""

    runs: Runs
    emulators: dict[str, Emulator]

    @property
    def each(self) -> tuple[Emulator, ...]:
        """The emulators in the order of the blocks."""
        return tuple(self.emulators.values())

    def keyed(self) -> dict[str, object]:
        """Give what stands under every key."""
        blocks = {name: emulator.kernel for name, emulator in self.emulators.items()}
        return {"blocks": blocks} | left_out_errors(self)

    @property
    def q2(self) -> float:
        """Smallest leave-one-out Q2 of all blocks."""
        return min(emulator.q2 for emulator in self.each)

    @property
    def gate(self) -> Gate:
        """What the worst block allows to be said."""
        return min(self.each, key=lambda emulator: emulator.q2).gate

    @property
    def loo_rms(self) -> float:
        """Root mean square leave-one-out error over all blocks, in the response's unit."""
        return float(np.sqrt(np.mean([emulator.loo_rms**2 for emulator in self.each])))

    @property
    def loo_errors(self) -> Array:
        """Leave-one-out errors of all blocks, in the response's unit."""
        return np.concatenate([emulator.loo_errors for emulator in self.each])

    def value(self, coded: Array) -> Array:
        """Mean over the blocks, shape (m,), at coded points of shape (m, k)."""
        return np.asarray(np.mean([emulator.value(coded) for emulator in self.each], axis=0))

    def predict(self, coded: Array) -> tuple[Array, Array]:
        """Means over blocks and half widths: scatter of the blocks, and the emulators' error."""
        predictions = [emulator.predict(coded) for emulator in self.each]
        values = np.array([value for value, _ in predictions])
        errors = np.mean([half for _, half in predictions], axis=0)
        return values.mean(axis=0), self.scatter(values) + errors

    def indices(self) -> tuple[SobolIndex, ...]:
        """Sobol indices, averaged over blocks, with t intervals widened by 1 - Q2."""
        by_block = [emulator.indices() for emulator in self.each]
        margin = 1.0 - self.q2 + SAMPLE_ERROR
        return tuple(self._averaged(of_factor, margin) for of_factor in zip(*by_block, strict=True))

    def _averaged(self, indices: tuple[SobolIndex, ...], margin: float) -> SobolIndex:
        """Mean of the blocks' indices of a factor, with its t interval."""
        parts = [np.array([i.first for i in indices]), np.array([i.total for i in indices])]
        sides = np.array([-1.0, 1.0])
        first, total = (float(part.mean()) for part in parts)
        ends = [part.mean() + self.scatter(part) * sides for part in parts]
        return SobolIndex.of(first, ends[0], total, ends[1], margin)

    def ranges(self, practical: float | None, u: float = 0.0) -> tuple[EffectRange, ...]:
        """Range along every factor, averaged over blocks; arguments as for one emulator."""
        by_block = [emulator.ranges(practical, u) for emulator in self.each]
        each = enumerate(zip(*by_block, strict=True))
        return tuple(self._range(j, of_factor, practical, u) for j, of_factor in each)

    def _range(
        self, j: int, ranges: tuple[EffectRange, ...], practical: float | None, u: float
    ) -> EffectRange:
        values = np.array([effect.value for effect in ranges])
        bound = float(self.scatter(values) + np.mean([effect.bound for effect in ranges]))
        value = float(values.mean())
        # where the block nearest to the mean has its extremes
        nearest = ranges[int(np.abs(values - value).argmin())]
        sure = practical is not None and is_confirmed(self.runs, j, practical + u)
        verdict = verdict_of(value, bound, practical, float(np.ptp(self.runs.response)))
        return EffectRange(value, bound, verdict, nearest.confirm, sure)

    def scatter(self, values: Array) -> Array:
        """Half width of the 95 % interval of a mean over blocks, the first axis of the values."""
        b = len(self.each)
        return np.asarray(t_quantile(0.025, b - 1) * values.std(axis=0, ddof=1) / np.sqrt(b))


def fit_own(runs: Runs) -> Emulator | BlockedEmulator:
    """Fit an emulator to runs, one for each block where there are several."""
    if len(set(runs.blocks)) < 2:
        return fit_emulator(runs)
    return BlockedEmulator(runs, {b: fit_emulator(_of_block(runs, b)) for b in _blocks(runs)})


def fit_blocks_together(runs: Sequence[Runs], sizes: Sequence[int]) -> tuple[BlockedEmulator, ...]:
    """Fit one process a block to its runs of all combinations of categories."""
    every = [_blocks(response) for response in runs]
    if any(set(response) != set(every[0]) for response in every):
        rule = "the combinations of levels have runs of other blocks"
        raise RefusedError(str(Fault("emulator", rule, "run every block at each of them")))
    emulators = {
        name: fit_together([_of_block(response, name) for response in runs], sizes)
        for name in every[0]
    }
    return tuple(
        BlockedEmulator(
            response, {name: by_response[index] for name, by_response in emulators.items()}
        )
        for index, response in enumerate(runs)
    )


def _blocks(runs: Runs) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(runs.blocks))
    if len(names) < FEWEST:
        rule = f"{len(names)} blocks have no interval, at least {FEWEST} are needed"
        mend = "analyze the rows of one block at a time, without --block"
        raise RefusedError(str(Fault("--block", rule, mend)))
    return names


def _of_block(runs: Runs, name: str) -> Runs:
    return replace(some_runs(runs, np.array(runs.blocks) == name), blocks=())


# Where further runs make an emulator surest (Cohn, Ghahramani and Jordan 1996; Gramacy 2020).

#: candidates for the next run, and points at which the gain is summed, as powers of two
CANDIDATES = 10
REFERENCES = 9
#: how far candidates reach beyond the box before they are cut: so the faces have some, too
STRETCH = 1.1
#: weight of the mean misfit where no run is near, in runs
PRIOR_RUNS = 1.0


def candidates(k: int, seed: int) -> Array:
    """Points of the unit box from which runs are chosen, shape (1024, k), some on its faces."""
    from scipy.stats import qmc

    inside = qmc.Sobol(k, seed=seed).random_base2(CANDIDATES)
    return np.asarray(np.round(np.clip(0.5 + STRETCH * (inside - 0.5), 0.0, 1.0), 4))


@dataclass(frozen=True)
class Unsure:
    """What one emulator says of the box."""

    #: Fitted to standardized responses at points of the unit box.
    process: GaussianProcess
    #: 1 to lower the mean squared error, more to go where left-out runs were missed most.
    power: float = 1.0

    def gains(self, x: Array, at: Array, run_points: Array) -> Array:
        """Drop of the summed variance that a run at each candidate would bring, shape (m,)."""
        # Shapes: x (m, k); at (r, k); run_points (n, k).
        fitted = self.process.hyperparameters
        kernel, nugget = fitted.kernel, fitted.nugget
        matrix = kernel.correlation(run_points, run_points)
        matrix[np.diag_indices_from(matrix)] += max(nugget, 1e-10)
        factor = scipy.linalg.cholesky(matrix, lower=True)
        half_x, half_at = (
            scipy.linalg.solve_triangular(factor, kernel.correlation(run_points, p), lower=True)
            for p in (x, at)
        )
        shared = kernel.correlation(x, at) - half_x.T @ half_at
        variance = np.maximum(1.0 - (half_x**2).sum(axis=0), 0.0) + max(nugget, 1e-10)
        # squared leave-one-out error of the runs near each point, over the variance of the process
        ratios = (self.process.loo_errors / self.process.loo_deviations) ** 2
        near = kernel.correlation(at, self.process.x)
        local = near @ ratios + PRIOR_RUNS * float(ratios.mean())
        local /= near.sum(axis=1) + PRIOR_RUNS
        gains = (shared**2) @ local**self.power / variance
        return np.asarray(fitted.variance * gains / at.shape[0])


def next_run(unsure: Sequence[Unsure], x: Array, at: Array, run_points: Array) -> tuple[int, float]:
    """Candidate with the largest gain over all emulators, and that gain."""
    if not unsure:
        apart = np.min(np.abs(x[:, None, :] - run_points[None, :, :]).sum(axis=2), axis=1)
        best = int(apart.argmax())
        return best, float(apart[best])
    gains = np.sum([model.gains(x, at, run_points) for model in unsure], axis=0)
    best = int(gains.argmax())
    return best, float(gains[best])
