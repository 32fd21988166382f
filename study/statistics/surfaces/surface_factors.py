"""Numeric factors, the runs at their settings, and distributions of those that are uncertain."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from study.ground.arrays import Array, Flags, Ints
from study.ground.canonical import Keyed
from study.ground.errors import Fault, InputError, nearest

#: part of the largest singular value of the settings below which factors change together
COLLINEAR = 1e-7
#: settings closer than this in coded units are one setting: far above rounding, far below a step
SAME_SETTING = 1e-9


@dataclass(frozen=True)
class NumericFactor(Keyed):
    """A factor whose settings are numbers."""

    KEYS = "low high scale"

    name: str
    #: Settings that are coded -1 and 1, in the factor's own unit.
    low: float
    high: float
    #: Whether settings are coded by their logarithm: equal shares of its range are equal ratios.
    log: bool = False
    #: Of the settings; empty for plain numbers, and where a table does not say it.
    unit: str = ""

    def __post_init__(self) -> None:
        if not self.low < self.high:
            rule = f"its range {self.low:g}..{self.high:g} is empty"
            mend = "a constant column is no factor: leave it out of --numeric"
            raise InputError(Fault(f"factor {self.name!r}", rule, mend))
        if self.log and self.low <= 0:
            rule = f"a logarithm needs positive settings, the lowest is {self.low:g}"
            raise InputError(Fault(f"factor {self.name!r}", rule, "leave ' log' out"))

    @property
    def scale(self) -> str:
        """Either ``log`` or ``linear``."""
        return "log" if self.log else "linear"

    def coded(self, settings: Array) -> Array:
        """Coded settings: -1 at ``low``, 1 at ``high``, without unit and of the same shape."""
        low, high = self._ends()
        values = np.log(settings) if self.log else np.asarray(settings)
        return np.asarray(2.0 * (values - 0.5 * (low + high)) / (high - low))

    def setting(self, coded: float) -> float:
        """Give the setting in the factor's own unit at a coded value."""
        low, high = self._ends()
        value = 0.5 * (low + high) + 0.5 * coded * (high - low)
        return float(np.exp(value)) if self.log else float(value)

    def at(self, share: float) -> float:
        """Give the setting at a share of the range, 0 its low and 1 its high end."""
        if self.log:
            return float(self.low * (self.high / self.low) ** share)
        return self.low + share * (self.high - self.low)

    def step(self, value: float) -> float:
        """Difference from a setting that is a ten-thousandth of the range."""
        return 1e-4 * (value * math.log(self.high / self.low) if self.log else self.high - self.low)

    def _ends(self) -> tuple[float, float]:
        if self.log:
            return float(np.log(self.low)), float(np.log(self.high))
        return self.low, self.high


@dataclass(frozen=True)
class Runs:
    """Responses at settings of numeric factors."""

    name: str
    factors: tuple[NumericFactor, ...]
    #: shape (n, k); coded settings.
    coded: Array
    #: shape (n,); one value a run, in the response's unit.
    response: Array
    #: Block of each run; empty without blocks.
    blocks: tuple[str, ...] = ()
    #: shape (n,); numerical standard uncertainty of each run, in the response's unit.
    u_num: Array | None = None

    def __post_init__(self) -> None:
        if not self.response.size:
            rule = "none has an answer, so no surface is fitted"
            raise InputError(Fault("runs", rule, "study status says what failed"))
        mend = "leave it out of --numeric, or run other settings"
        constant = [
            Fault(f"factor {name!r}", "has one setting in every run", mend)
            for name, extent in zip(self.names, np.ptp(self.coded, axis=0), strict=True)
            if extent <= SAME_SETTING
        ]
        if constant:
            raise InputError(constant)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the factors."""
        return tuple(factor.name for factor in self.factors)

    @property
    def ranges(self) -> dict[str, NumericFactor]:
        """The factors by name."""
        return {factor.name: factor for factor in self.factors}

    @property
    def size(self) -> int:
        """Number of runs."""
        return int(self.response.size)

    def levels(self) -> tuple[int, ...]:
        """Count the different settings of each factor."""
        return tuple(len(np.unique(np.round(c / SAME_SETTING))) for c in self.coded.T)

    def settings(self, coded: Array) -> dict[str, float]:
        """Give settings by name, in their own units, of one coded point of shape (k,)."""
        return {f.name: f.setting(float(x)) for f, x in zip(self.factors, coded, strict=True)}

    def points(self, at: Mapping[str, ArrayLike]) -> Array:
        """Coded points, shape (m, k), of settings given by name, one or m of each."""
        faults = [
            Fault(n, "no such factor", nearest(n, self.names)) for n in at if n not in self.names
        ]
        faults += [
            Fault(n, "has no setting", "give every factor one") for n in self.names if n not in at
        ]
        if faults:
            raise InputError(faults)
        settings = [np.atleast_1d(np.asarray(at[n], dtype=np.float64)) for n in self.names]
        columns = [f.coded(s) for f, s in zip(self.factors, settings, strict=True)]
        outside = [
            self._outside(j, s, c) for j, (s, c) in enumerate(zip(settings, columns, strict=True))
        ]
        if any(outside):
            raise InputError([fault for fault in outside if fault is not None])
        return np.column_stack(np.broadcast_arrays(*columns))

    def coded_inside(self, name: str, setting: float) -> float:
        """Coded setting of one factor."""
        j = self.names.index(name)
        settings = np.array([setting])
        coded = self.factors[j].coded(settings)
        fault = self._outside(j, settings, coded)
        if fault is not None:
            raise InputError(fault)
        return float(coded[0])

    def distinct(self) -> tuple[Array, Ints]:
        """Different settings, shape (m, k), and which of them each run has, shape (n,)."""
        rounded = np.round(self.coded / SAME_SETTING)
        _, first, which = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
        order = np.argsort(first)  # in the order of the runs
        rank = np.empty_like(order)
        rank[order] = np.arange(order.size)
        return self.coded[first[order]], rank[np.ravel(which)]

    def _outside(self, j: int, settings: Array, coded: Array) -> Fault | None:
        """Fault of the first setting that would have to be extrapolated."""
        factor, run = self.factors[j], self.coded[:, j]
        inside = (coded >= run.min() - SAME_SETTING) & (coded <= run.max() + SAME_SETTING)
        if inside.all():  # a NaN is never inside
            return None
        low, high = (factor.setting(float(x)) for x in (run.min(), run.max()))
        first = settings[~inside][0]
        rule = f"{first:g} lies outside the settings that were run, {low:g} to {high:g}"
        return Fault(factor.name, rule, "ask inside this range, or run settings beyond it")


def some_runs(runs: Runs, here: Flags) -> Runs:
    """Keep some of the runs, in the ranges of all; refuses a factor that never changes in them."""
    blocks = tuple(name for name, chosen in zip(runs.blocks, here, strict=False) if chosen)
    u_num = None if runs.u_num is None else runs.u_num[here]
    return replace(
        runs, coded=runs.coded[here], response=runs.response[here], blocks=blocks, u_num=u_num
    )


def change_together(runs: Runs) -> tuple[str, ...]:
    """Name the factors of which one follows from the others in every run; empty if none does."""
    # Shapes: runs (n, k).
    centred = runs.coded - runs.coded.mean(axis=0)
    _, sizes, directions = np.linalg.svd(centred, full_matrices=len(centred) < centred.shape[1])
    if len(runs.factors) < 2 or (sizes.size == len(directions)
                                 and sizes[-1] > COLLINEAR * sizes[0]):  # fmt: skip
        return ()
    last = np.abs(directions[-1])
    return tuple(n for n, c in zip(runs.names, last, strict=True) if c > 1e-3 * last.max())


#: coded setting of two factors from which a quarter of their ranges counts as run
QUARTER = 0.1


def never_run(runs: Runs, at: Array | None = None) -> list[str]:
    """Name the quarters of the ranges of two factors in which no run lies.

    Where coded points are given, shape (m, k), only the quarters that hold one of them.
    """
    regions = []
    every = [runs.coded, *([] if at is None else [at])]
    for i, j in combinations(range(len(runs.factors)), 2):
        for side in product((1.0, -1.0), repeat=2):
            inside = [(p[:, [i, j]] * side > QUARTER).all(axis=1).any() for p in every]
            if not inside[0] and all(inside[1:]):
                ends = zip((runs.factors[i], runs.factors[j]), side, strict=True)
                regions.append(" with ".join(
                    f"{factor.name} {'above' if end > 0 else 'below'} {factor.setting(0.0):.4g}"
                    for factor, end in ends
                ))  # fmt: skip
    if not regions:
        return []
    more = f" and {len(regions) - 4} more" if len(regions) > 4 else ""
    return [f"never run: {'; '.join(regions[:4])}{more}: what is predicted there is extrapolated"]


# Largest and smallest prediction in the box of coded factors.

#: most factors whose corners are all asked: 2^10 = 1,024
CORNERS = 10
#: a coordinate this near to 1 in size lies on the boundary
BOUNDARY = 1e-6


@dataclass(frozen=True)
class Extreme(Keyed):
    """A largest or smallest prediction."""

    KEYS = "at=settings value half_width on_boundary"

    #: shape (k,); coded settings, and those in the factors' own units.
    at: Array
    settings: Mapping[str, float]
    value: float
    #: Half of the interval around it, in the same unit.
    half_width: float

    @property
    def on_boundary(self) -> bool:
        """Whether a factor stands at an end of its range."""
        return bool(np.abs(self.at).max() >= 1.0 - BOUNDARY)


def box_points(k: int, n: int) -> Array:
    """Points that fill the box [-1, 1]^k evenly, shape (n, k); n is a power of two."""
    from scipy.stats import qmc

    return np.asarray(2.0 * qmc.Sobol(k, seed=0).random(n) - 1.0)


# Distribution of an uncertain input, cut off at the ends of the range that is run.

#: what each kind of distribution is told by, in the order of its numbers
PARAMETERS: Mapping[str, tuple[str, ...]] = {
    "normal": ("mean", "sd"),
    "uniform": ("low", "high"),
    "triangular": ("low", "mode", "high"),
    "lognormal": ("median", "factor"),
}
DISTRIBUTION_KEYS = (
    "distribution",
    *dict.fromkeys(k for names in PARAMETERS.values() for k in names),
)


@dataclass(frozen=True)
class InputDistribution:
    """Distribution of an uncertain input, cut off at the ends of the range that is run."""

    #: The family.
    kind: str
    #: Its numbers in the order of `PARAMETERS`, in the unit of the range; the factor of a lognormal
    #: distribution is exp(sd of the logarithm).
    numbers: tuple[float, ...]
    low: float
    high: float

    def _frozen(self) -> Any:
        """Distribution of scipy with these numbers."""
        from scipy import stats

        if self.kind == "normal":
            return stats.norm(*self.numbers)
        if self.kind == "lognormal":
            median, factor = self.numbers
            return stats.lognorm(math.log(factor), scale=median)
        width = self.numbers[-1] - self.numbers[0]
        if self.kind == "uniform":
            return stats.uniform(self.numbers[0], width)
        low, mode, _ = self.numbers
        return stats.triang((mode - low) / width, low, width)

    @property
    def outside(self) -> float:
        """Probability that is cut off."""
        distribution = self._frozen()
        return float(distribution.cdf(self.low) + distribution.sf(self.high))

    def quantile(self, shares: Array) -> Array:
        """Values, in the unit of the range, below which such shares of the distribution lie."""
        distribution = self._frozen()
        first, last = distribution.cdf([self.low, self.high])
        quantiles = distribution.ppf(first + shares * (last - first))
        return np.asarray(np.clip(quantiles, self.low, self.high))

    def halved(self) -> InputDistribution:
        """Give the distribution with half the spread, about the same middle."""
        a, b = self.numbers[0], self.numbers[1]
        if self.kind == "normal":
            numbers: tuple[float, ...] = (a, 0.5 * b)
        elif self.kind == "lognormal":
            numbers = (a, math.sqrt(b))
        else:
            middle = sum(self.numbers) / len(self.numbers)
            numbers = tuple(0.5 * (value + middle) for value in self.numbers)
        return InputDistribution(self.kind, numbers, self.low, self.high)

    def words(self, unit: str) -> str:
        """Say what it is, such as ``normal, mean 7 kPa, sd 0.5 kPa``."""
        named = zip(PARAMETERS[self.kind], self.numbers, strict=True)
        parts = [f"{name} {v:.4g}" + ("" if name == "factor" or not unit else f" {unit}")
                for name, v in named]  # fmt: skip
        return ", ".join([self.kind, *parts])
