"""An emulator of a response: prediction, its error, and what the factors do."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from study.arrays import Array, Flags
from study.errors import Fault, RefusedError
from study.response_surface.emulator.effect_ranges import (
    ERRORS,
    EffectRange,
    Small,
    effect_range,
)
from study.response_surface.emulator.gaussian_process import GaussianProcess, fit_process
from study.response_surface.emulator.kernels import FAMILIES
from study.response_surface.emulator.posterior_paths import draw_paths
from study.response_surface.emulator.sobol_indices import SobolIndex, sobol_indices
from study.response_surface.factors import Runs, change_together

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

#: fewest runs of one combination of categories beside those of the others
FEWEST_OWN = 5

#: fewest settings of a factor
FEWEST_SETTINGS = 4

#: designs with at most this many settings a factor are grids, not space-filling
GRID_LEVELS = 5

Gate = Literal["given", "ranking only", "refused"]


@dataclass(frozen=True)
class Emulator:
    """A fitted emulator.

    Parameters
    ----------
    runs : Runs
        What it was fitted to, copies averaged.
    process : GaussianProcess
        In the unit box, for standardized responses; where it was fitted to the runs of several
        combinations of categories, it has those of the others, too.
    centre, scale : float
        Mean and standard deviation of the responses, in their unit.
    seed : int
        Of everything random.
    combination : int, optional
        Number of the combination of categories at which it is asked.
    rival : GaussianProcess, optional
        The same runs with the other kernel: where runs are far, the two part.
    """

    runs: Runs
    process: GaussianProcess
    centre: float
    scale: float
    seed: int
    combination: int | None = None
    rival: GaussianProcess | None = None

    @cached_property
    def loo_errors(self) -> Array:
        """Leave-one-out errors of the own runs, shape (n,), in the response's unit."""
        return np.asarray(self.scale * self.process.loo_errors[self._own])

    @property
    def _own(self) -> Flags:
        which = self.process.found.kernel.combination(self.process.x)
        return np.asarray(which == (self.combination or 0))

    def points(self, unit: Array) -> Array:
        """Points of the process at points (m, k) of the unit box."""
        return _among(unit, self.combination)

    def paths(self, seed: int) -> Callable[[Array], Array]:
        """Draw posterior paths: the mean and functions, shape (m, 1 + paths), of points (m, k).

        Points lie in the unit box; values are those of standardized responses.
        """
        drawn = draw_paths(self.process, seed)
        return lambda unit: drawn.values(self.points(unit))

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
        own = self.process.mean(x)
        other = own if self.rival is None else self.rival.mean(x)
        deviation = self.scale * self.widening * self.process.deviation(x)
        half = 1.96 * np.maximum(deviation, self.loo_rms) + self.scale * np.abs(own - other)
        return self.centre + self.scale * own, half

    def value(self, coded: Array) -> Array:
        """Predictions, shape (m,), at coded points of shape (m, k)."""
        return self.centre + self.scale * self.process.mean(self.points(0.5 * (coded + 1.0)))

    def indices(self) -> tuple[SobolIndex, ...]:
        """Sobol indices of every factor.

        Raises
        ------
        RefusedError
            If Q2 is below .7: the emulator does not know the function well enough.
        """
        if self.gate == "refused":
            rule = f"Q2 is {self.q2:.2f}, below {RANKED}: no indices"
            mend = f"add runs: {2 * self.runs.response.size} in all"
            raise RefusedError(str(Fault("emulator", rule, mend)))
        return sobol_indices(self.paths(self.seed), len(self.runs.factors), self.q2, self.seed)

    def ranges(self, practical: float | None, u: float = 0.0) -> tuple[EffectRange, ...]:
        """Range of the response along every factor.

        Parameters
        ----------
        practical : float or None
            Smallest difference that matters, in the response's unit.
        u : float
            Numerical uncertainty of a difference, in the same unit, common to all runs.
        """
        bound = ERRORS * float(np.abs(self.loo_errors).max()) + u
        small = Small(practical, float(np.ptp(self.runs.response)))
        k = len(self.runs.factors)
        return tuple(
            effect_range(lambda x: self.value(2.0 * x - 1.0), k, j, bound, small) for j in range(k)
        )


def expected_seconds(n: int) -> float:
    """Seconds that a fit of n runs takes on one core.

    Parameters
    ----------
    n : int
        Number of runs; the time grows with the third power.
    """
    return SECONDS_1000 * (n / 1000.0) ** 3


def fit_emulator(runs: Runs, seed: int = 0) -> Emulator:
    """Fit both kernels and keep the one that predicts left-out runs better.

    Parameters
    ----------
    runs : Runs
        Responses of one block.
    seed : int
        Of the random starts, paths and samples.

    Raises
    ------
    RefusedError
        If there are too many or too few runs, too few settings of a factor, or factors that
        change together; the message says what to do.
    """
    _check(runs)
    (found,) = _fitted([runs], (), seed)
    return found


def fit_together(runs: Sequence[Runs], sizes: Sequence[int], seed: int = 0) -> tuple[Emulator, ...]:
    """Fit one process to the runs of all combinations of categories, which learn from each other.

    Parameters
    ----------
    runs : sequence of Runs
        Of every combination, over the same factors; the last factor without numbers changes
        fastest.
    sizes : sequence of int
        Number of categories of each of these factors.
    seed : int
        As for `fit_emulator`.

    Returns
    -------
    tuple of Emulator
        One a combination: its own runs, deviations and errors, of the common process.

    Raises
    ------
    RefusedError
        As for `fit_emulator`; or where a combination has too few runs of its own.
    """
    for one in runs:
        _check_own(one)
    first = runs[0]
    coded, response = (np.concatenate([getattr(r, n) for r in runs]) for n in ("coded", "response"))
    _check(Runs(first.name, first.factors, coded, response))
    return _fitted(runs, sizes, seed)


def _fitted(runs: Sequence[Runs], sizes: Sequence[int], seed: int) -> tuple[Emulator, ...]:
    singles = [_averaged(one) for one in runs]
    centres = [float(one.response.mean()) for one, _ in singles]
    scales = [float(one.response.std()) for one, _ in singles]
    for (one, _), centre, scale in zip(singles, centres, scales, strict=True):
        if scale <= 1e-12 * abs(centre):
            rule = f"the response {one.name!r} is the same in every run"
            raise RefusedError(str(Fault("emulator", rule, "there is nothing to explain")))
    numbers = range(len(runs)) if sizes else [None]
    x, y, noise = (np.concatenate(parts) for parts in zip(*(
        (_among(0.5 * (one.coded + 1.0), number), (one.response - centre) / scale, (u / scale) ** 2)
        for (one, u), centre, scale, number in zip(singles, centres, scales, numbers, strict=True)
    ), strict=True))  # fmt: skip
    fits = [fit_process(x, y, noise, family, seed, sizes) for family in FAMILIES]
    rival, best = sorted(fits, key=_q2)
    return tuple(
        Emulator(one, best, centre, scale, seed, number, rival)
        for (one, _), centre, scale, number in zip(singles, centres, scales, numbers, strict=True)
    )


def _among(unit: Array, combination: int | None) -> Array:
    """Points of the process: those of the unit box, and the number of the combination."""
    if combination is None:
        return unit
    return np.column_stack([unit, np.full(len(unit), float(combination))])


def _q2(process: GaussianProcess) -> float:
    return 1.0 - float((process.loo_errors**2).sum() / (process.y**2).sum())


def _averaged(runs: Runs) -> tuple[Runs, Array]:
    """Average copies: a run is no test of its own copy."""
    settings, which = runs.distinct()
    counts = np.bincount(which)
    response = np.bincount(which, weights=runs.response) / counts
    u = np.zeros(counts.size)
    if runs.u_num is not None:
        u = np.sqrt(np.bincount(which, weights=runs.u_num**2) / counts)
    return Runs(runs.name, runs.factors, settings, response), u


def _check_own(runs: Runs) -> None:
    n = len(runs.distinct()[0])
    if n < FEWEST_OWN:
        rule = f"{n} different runs at one combination of levels, at least {FEWEST_OWN} are needed"
        raise RefusedError(str(Fault("emulator", rule, "add runs, or leave a level out")))


def _check(runs: Runs) -> None:
    n = len(runs.distinct()[0])
    k = len(runs.factors)
    levels = runs.levels()
    if runs.response.size > LARGEST:
        rule = f"{runs.response.size} runs, at most {LARGEST}: the work grows with their cube"
        mend = f"take every {-(-runs.response.size // LARGEST)}th row, or --surface quadratic"
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
