"""Best setting that a surface predicts, where other surfaces may not pass a limit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np
import scipy

from study.ground.arrays import Array, Flags, Ints
from study.ground.errors import Fault, RefusedError
from study.statistics.surfaces.emulator import GIVEN, BlockedEmulator, Emulator
from study.statistics.surfaces.quadratic import CARRIED, QuadraticSurface
from study.statistics.surfaces.surface_factors import BOUNDARY, CORNERS, Extreme, Runs, box_points

Model = QuadraticSurface | Emulator | BlockedEmulator
Goal = Literal["minimize", "maximize"]
Assurance = Literal["", "surely", "predicted"]
#: points at which the search looks around, and the best of them from which it goes on
SAMPLE = 4096
STARTS = 8
#: steps of each search by sequential quadratic programming, and its status where they have ended
STEPS = 200
BY_COUNT = 9
#: a limit counts as kept this near to it, as a part of the response's range: rounding of the search
ROUNDING = 1e-7


@dataclass(frozen=True)
class ResponseLimit:
    """Another response that may not pass a limit."""

    #: Its surface, over the same factors.
    model: Model
    #: {1, -1}: 1 where it must be at least the limit, -1 where at most.
    sign: int
    #: The limit, in that response's unit.
    value: float

    @property
    def scale(self) -> float:
        """Range of its runs, in its unit."""
        return float(np.ptp(self.model.runs.response)) or 1.0

    def room(self, coded: Array, share: float) -> Array:
        """Distance to the limit, shape (m,), positive where it is kept. Shapes: coded (m, k)."""
        value, half = self.model.predict(coded)
        return np.asarray((self.sign * (value - self.value) - share * half) / self.scale)


@dataclass(frozen=True)
class Optimum:
    """Best predicted setting."""

    #: shape (k,); coded settings, with those that were held.
    at: Array
    #: Prediction and half of its 95 % interval, in the response's unit.
    value: float
    half_width: float
    #: Prediction and half width of every limited response there, in its unit.
    limited: tuple[tuple[float, float], ...]
    #: {"", "surely", "predicted"}: whether the limits hold with the unfavourable ends of the
    #: intervals, or for the prediction alone; empty without limits.
    assurance: Assurance
    #: Free factors that stand at an end of what was run.
    on_boundary: tuple[int, ...]


def check_carries(model: Model) -> None:
    """Refuse a surface that does not predict runs it has not seen."""
    quadratic = isinstance(model, QuadraticSurface)
    name, twice = model.runs.name, 2 * model.runs.response.size
    if isinstance(model, QuadraticSurface) and model.loo is None:
        rule = f"the surface of {name} has as many coefficients as runs: no error"
        raise RefusedError(str(Fault("optimize", rule, "add runs")))
    least = CARRIED if quadratic else GIVEN
    if not model.q2 >= least:
        rule = f"the surface of {name} has a Q2 of {model.q2:.2f}, below {least}"
        mend = f"add runs: {twice} in all" + (", or --surface emulator" if quadratic else "")
        raise RefusedError(str(Fault("optimize", rule, mend)))
    if isinstance(model, QuadraticSurface) and not model.carries:
        rule = f"the surface of {name} has one run more than coefficients: its Q2 may be chance"
        raise RefusedError(str(Fault("optimize", rule, f"add runs: {twice} in all")))


@dataclass(frozen=True)
class FreeSettings:
    """Factors that are not held, and what was run of them inside of the coded box."""

    #: shape (k,); coded settings, NaN where a factor is free.
    held: Array
    free: Ints
    #: shape (k,); ends beyond which nothing is extrapolated.
    low: Array
    high: Array

    @classmethod
    def of(cls, every: Sequence[Runs], held: Array) -> FreeSettings:
        """Give the ends that all runs reach."""
        low = np.max([runs.coded.min(axis=0) for runs in every], axis=0)
        high = np.min([runs.coded.max(axis=0) for runs in every], axis=0)
        free = np.flatnonzero(np.isnan(held))
        return cls(held, free, np.maximum(low, -1.0), np.minimum(high, 1.0))

    def whole(self, settings: Array) -> Array:
        """Coded points (m, k) of free settings (m, f)."""
        points = np.repeat(self.held[None, :], len(settings), axis=0)
        points[:, self.free] = settings
        return points

    def sample(self, count: int, *, corners: bool = False) -> Array:
        """Coded points, shape (m, k), that fill what was run evenly, with its corners if few."""
        f = self.free.size
        points = box_points(f, count) if f else np.empty((1, 0))
        if corners and 0 < f <= CORNERS:
            points = np.vstack([points, np.array(list(product((-1.0, 1.0), repeat=f)))])
        low, high = self.low[self.free], self.high[self.free]
        return self.whole(low + 0.5 * (points + 1.0) * (high - low))


@dataclass(frozen=True)
class _Question:
    """Response to optimize, and its limits; sign is 1 to minimize, -1 to maximize."""

    model: Model
    sign: float
    limits: Sequence[ResponseLimit]
    space: FreeSettings

    def best(self, share: float) -> Array | None:
        """Best coded setting, shape (k,), whose half widths leave room so far; None if none do."""
        free, sample = self.space.free, self.space.sample(SAMPLE, corners=True)
        rooms = self.rooms(sample, share)
        order = np.lexsort((self.sign * self.model.value(sample), -np.minimum(rooms, 0.0)))
        starts = sample[order[:STARTS]]
        if self.limits:  # a narrow set may lie between the points: begin from where it is nearest
            starts = np.vstack([starts, sample[np.argsort(-rooms)[:STARTS]]])
        searches = [self._polished(share, at[free]) for at in starts]
        points = np.vstack([starts, self.space.whole(np.array([x for x, _ in searches]))])
        points[:, free] = np.clip(points[:, free], self.space.low[free], self.space.high[free])
        holds = self.holds(points, share)
        if not holds.any():
            return None
        best = int(np.argmin(np.where(holds, self.sign * self.model.value(points), np.inf)))
        if best >= len(starts) and searches[best - len(starts)][1]:
            rule = f"the search for the best setting has not converged in {STEPS} steps"
            mend = "hold a factor, or move a limit that hardly any setting keeps"
            raise RefusedError(str(Fault("optimize", rule, mend)))
        return np.asarray(points[best])

    def _polished(self, share: float, start: Array) -> tuple[Array, bool]:
        """Free settings where sequential quadratic programming ends; whether by count."""
        if not start.size:
            return start, False
        scale = self.sign / (float(np.ptp(self.model.runs.response)) or 1.0)

        def each(function: Callable[[Array], Array]) -> Callable[[Array], float]:
            return lambda x: float(function(self.space.whole(x[None, :]))[0])

        def rule(limit: ResponseLimit) -> dict[str, object]:
            # kept by a hair more than is asked, so that rounding does not lose the limit
            return {"type": "ineq", "fun": each(lambda p: limit.room(p, share) - 0.1 * ROUNDING)}

        low, high = self.space.low[self.space.free], self.space.high[self.space.free]
        search = scipy.optimize.minimize(
            each(lambda p: scale * self.model.value(p)), start, method="SLSQP",
            constraints=[rule(limit) for limit in self.limits],
            bounds=list(zip(low, high, strict=True)),
            options={"ftol": 1e-13, "maxiter": STEPS},
        )  # fmt: skip
        return np.asarray(search.x, dtype=np.float64), search.status == BY_COUNT

    def rooms(self, coded: Array, share: float) -> Array:
        """Smallest distance to a limit, shape (m,); zero without limits."""
        rooms = [limit.room(coded, share) for limit in self.limits]
        return np.asarray(np.min(rooms, axis=0)) if rooms else np.zeros(len(coded))

    def holds(self, coded: Array, share: float) -> Flags:
        """Whether the limits are kept, shape (m,)."""
        return np.asarray(self.rooms(coded, share) >= -ROUNDING)

    def infeasible(self) -> Fault:
        """Say how near to the limits the surfaces come."""
        points = self.space.sample(SAMPLE, corners=True)
        at = points[int(np.argmax(self.rooms(points, 0.0)))]
        words = ", ".join(f"{name} = {x:.4g}" for name, x in self.model.runs.settings(at).items())
        reached = ", ".join(
            f"{limit.model.runs.name} {limit.model.predict(at[None, :])[0][0]:.4g} "
            f"(limit {'>=' if limit.sign > 0 else '<='} {limit.value:.4g})"
            for limit in self.limits
        )
        rule = "no setting inside of what was run is predicted to keep the limits; nearest: "
        mend = f"there, {words}; move a limit, or run wider ranges"
        return Fault("--subject-to", rule + reached, mend)


def _question(model: Model, goal: Goal, limits: Sequence[ResponseLimit], held: Array) -> _Question:
    every = [model.runs, *(limit.model.runs for limit in limits)]
    sign = 1.0 if goal == "minimize" else -1.0
    return _Question(model, sign, limits, FreeSettings.of(every, held))


def optimum(model: Model, goal: Goal, limits: Sequence[ResponseLimit], held: Array) -> Optimum:
    """Find the best predicted setting inside what was run.

    The limits are asked of the unfavourable ends of the intervals first. Where no setting keeps
    them so, they are asked of the predictions, and that is said.

    Shapes: held (k,).
    """
    question = _question(model, goal, limits, held)
    space = question.space
    for share in (1.0, 0.0) if limits else (0.0,):
        at = question.best(share)
        if at is None:
            continue
        (value,), (half,) = model.predict(at[None, :])
        of_limits = [limit.model.predict(at[None, :]) for limit in limits]
        near = np.minimum(at - space.low, space.high - at)[space.free] <= BOUNDARY
        assurance: Assurance = "" if not limits else "surely" if share else "predicted"
        return Optimum(
            at, float(value), float(half), tuple((float(v[0]), float(h[0])) for v, h in of_limits),
            assurance, tuple(space.free[near].tolist()),
        )  # fmt: skip
    raise RefusedError(str(question.infeasible()))


def extremes(model: Model) -> tuple[Extreme, Extreme]:
    """Find the smallest and the largest prediction in the ranges of the factors."""
    runs, k = model.runs, len(model.runs.factors)
    space = FreeSettings(np.full(k, np.nan), np.arange(k), np.full(k, -1.0), np.ones(k))
    low, high = (
        Extreme(at, runs.settings(at), *(float(part[0]) for part in model.predict(at[None, :])))
        for sign in (1.0, -1.0)
        if (at := _Question(model, sign, (), space).best(0.0)) is not None  # there is no limit
    )
    return low, high


@dataclass(frozen=True)
class ResponseSpread:
    """What the factors that nobody chooses do at a best setting."""

    #: Smallest and largest prediction over their ranges, in the response's unit.
    low: float
    high: float
    #: Share of their settings at which the limits hold for the prediction; 1 without limits.
    kept: float


def spread_over(
    model: Model, limits: Sequence[ResponseLimit], optimum: Optimum, others: Sequence[int]
) -> ResponseSpread | None:
    """Vary the factors that nobody chooses over what was run, the others at their best."""
    if not others:
        return None
    held = optimum.at.copy()
    held[list(others)] = np.nan
    question = _question(model, "minimize", limits, held)
    points = question.space.sample(SAMPLE, corners=True)
    value = model.value(points)
    share = float(question.holds(points, 0.0).mean())
    return ResponseSpread(float(value.min()), float(value.max()), share)
