"""Numeric factors and the runs that were made at their settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from study.arrays import Array, Ints
from study.errors import Fault, InputError, nearest

#: part of the largest singular value of the settings below which factors change together
COLLINEAR = 1e-7

#: settings closer than this in coded units are one setting: far above rounding, far below a step
SAME_SETTING = 1e-9


@dataclass(frozen=True)
class NumericFactor:
    """A factor whose settings are numbers.

    Parameters
    ----------
    name : str
        Column of the factor.
    low, high : float
        Settings that are coded -1 and 1, in the factor's own unit.
    log : bool
        Whether settings are coded by their logarithm.

    Raises
    ------
    InputError
        If the range is empty or, for a logarithm, not positive.
    """

    name: str
    low: float
    high: float
    log: bool = False

    def __post_init__(self) -> None:
        if not self.low < self.high:
            rule = f"its range {self.low:g}..{self.high:g} is empty"
            mend = "a constant column is no factor: leave it out of --numeric"
            raise InputError(Fault(f"factor {self.name!r}", rule, mend))
        if self.log and self.low <= 0:
            rule = f"a logarithm needs positive settings, the lowest is {self.low:g}"
            raise InputError(Fault(f"factor {self.name!r}", rule, "leave ' log' out"))

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

    def _ends(self) -> tuple[float, float]:
        if self.log:
            return float(np.log(self.low)), float(np.log(self.high))
        return self.low, self.high


@dataclass(frozen=True)
class Runs:
    """Responses at settings of numeric factors.

    Parameters
    ----------
    name : str
        Name of the response.
    factors : tuple of NumericFactor
        The k factors.
    coded : array, shape (n, k)
        Coded settings.
    response : array, shape (n,)
        One value a run, in the response's unit.
    blocks : tuple of str
        Block of each run; empty without blocks.
    u_num : array, shape (n,), optional
        Numerical standard uncertainty of each run, in the response's unit.

    Raises
    ------
    InputError
        If there are no runs, or a factor never changes.
    """

    name: str
    factors: tuple[NumericFactor, ...]
    coded: Array
    response: Array
    blocks: tuple[str, ...] = ()
    u_num: Array | None = None

    def __post_init__(self) -> None:
        if not self.response.size:
            rule = "none has an answer, so no surface is fitted"
            raise InputError(Fault("runs", rule, "study status says what failed"))
        constant = [
            f for f, column in zip(self.factors, self.coded.T, strict=True) if _same(column)
        ]
        if constant:
            mend = "leave it out of --numeric, or run other settings"
            raise InputError(
                [
                    Fault(f"factor {f.name!r}", "has one setting in every run", mend)
                    for f in constant
                ]
            )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the factors."""
        return tuple(factor.name for factor in self.factors)

    def levels(self) -> tuple[int, ...]:
        """Count the different settings of each factor."""
        return tuple(len(np.unique(np.round(c / SAME_SETTING))) for c in self.coded.T)

    def settings(self, coded: Array) -> dict[str, float]:
        """Give settings by name, in their own units, of one coded point of shape (k,)."""
        return {f.name: f.setting(float(x)) for f, x in zip(self.factors, coded, strict=True)}

    def points(self, at: Mapping[str, ArrayLike]) -> Array:
        """Coded points, shape (m, k), of settings given by name, one or m of each.

        Raises
        ------
        InputError
            If a factor is missing or unknown, a setting is no number, or a point lies
            outside the settings that were run.
        """
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
        """Coded setting of one factor.

        Raises
        ------
        InputError
            If it lies outside the settings that were run.
        """
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


def _same(column: Array) -> bool:
    return bool(np.ptp(column) <= SAME_SETTING)


def change_together(runs: Runs) -> tuple[str, ...]:
    """Name the factors of which one follows from the others in every run; empty if none does.

    Parameters
    ----------
    runs : Runs
        Their coded settings count, shape (n, k).
    """
    centred = runs.coded - runs.coded.mean(axis=0)
    _, sizes, directions = np.linalg.svd(centred, full_matrices=len(centred) < centred.shape[1])
    if len(runs.factors) < 2 or (sizes.size == len(directions)
                                 and sizes[-1] > COLLINEAR * sizes[0]):  # fmt: skip
        return ()
    last = np.abs(directions[-1])
    return tuple(n for n, c in zip(runs.names, last, strict=True) if c > 1e-3 * last.max())
