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
from study.statistics.surfaces.surface_factors import BOUNDARY, CORNERS, Runs, box_points

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


def run_box(runs: Runs) -> tuple[Array, Array]:
    """Give the ends, shape (k,) each, of what was run inside of the coded box.

    Nothing is extrapolated beyond them.

    Shapes: runs (n, k).
    """
    low, high = runs.coded.min(axis=0), runs.coded.max(axis=0)
    return np.maximum(low, -1.0), np.minimum(high, 1.0)


def optimum(model: Model, goal: Goal, limits: Sequence[ResponseLimit], held: Array) -> Optimum:
    """Find the best predicted setting inside what was run.

    The limits are asked of the unfavourable ends of the intervals first. Where no setting keeps
    them so, they are asked of the predictions, and that is said.

    Shapes: held (k,).
    """
    space = _Space.of([model, *(one.model for one in limits)], held)
    sign = 1.0 if goal == "minimize" else -1.0
    shares = (1.0, 0.0) if limits else (0.0,)
    for share in shares:
        found = _searched(model, sign, limits, space, share)
        if found is not None:
            said: Assurance = "" if not limits else "surely" if share else "predicted"
            return _told(model, limits, space, found, said)
    raise RefusedError(str(_infeasible(model, limits, space)))


@dataclass(frozen=True)
class _Space:
    """Free factors and their bounds."""

    held: Array
    free: Ints
    low: Array
    high: Array

    @classmethod
    def of(cls, models: Sequence[Model], held: Array) -> _Space:
        boxes = [run_box(one.runs) for one in models]
        low = np.max([one for one, _ in boxes], axis=0)
        high = np.min([one for _, one in boxes], axis=0)
        free = np.flatnonzero(np.isnan(held))
        return cls(held, free, low[free], high[free])

    def whole(self, own: Array) -> Array:
        """Coded points (m, k) of free settings (m, f)."""
        points = np.repeat(self.held[None, :], len(own), axis=0)
        points[:, self.free] = own
        return points

    def sample(self) -> Array:
        """Free settings, shape (m, f), that fill the box, with its corners."""
        f = self.free.size
        if not f:
            return np.empty((1, 0))
        points = box_points(f, SAMPLE)
        if f <= CORNERS:
            points = np.vstack([points, np.array(list(product((-1.0, 1.0), repeat=f)))])
        return np.asarray(self.low + 0.5 * (points + 1.0) * (self.high - self.low))


def _searched(
    model: Model, sign: float, limits: Sequence[ResponseLimit], space: _Space, share: float
) -> Array | None:
    """Best free settings, shape (f,), that keep the limits; None where none do."""
    sample = space.sample()
    rooms = _rooms(limits, space.whole(sample), share)
    order = np.lexsort((sign * model.value(space.whole(sample)), -np.minimum(rooms, 0.0)))
    starts = sample[order[:STARTS]]
    if limits:  # a narrow set may lie between the points: begin from where it is nearest, too
        starts = np.vstack([starts, sample[np.argsort(-rooms)[:STARTS]]])
    scale = float(np.ptp(model.runs.response)) or 1.0
    searches = [_polished(model, sign / scale, limits, space, share, x) for x in starts]
    ends = [x for x, _ in searches]
    points = np.clip(np.vstack([starts, *ends]), space.low, space.high)
    kept: Flags = np.asarray(_rooms(limits, space.whole(points), share) >= -ROUNDING)
    if not kept.any():
        return None
    good = np.flatnonzero(kept)
    best = int(good[np.argmin(sign * model.value(space.whole(points[good])))])
    if best >= len(starts) and searches[best - len(starts)][1]:
        rule = f"the search for the best setting has not converged in {STEPS} steps"
        mend = "hold a factor, or move a limit that hardly any setting keeps"
        raise RefusedError(str(Fault("optimize", rule, mend)))
    return np.asarray(points[best])


def _polished(
    model: Model,
    sign: float,
    limits: Sequence[ResponseLimit],
    space: _Space,
    share: float,
    start: Array,
) -> tuple[Array, bool]:
    """Free settings, shape (f,), where sequential quadratic programming ends; whether by count."""
    if not start.size:
        return start, False

    def each(function: Callable[[Array], Array]) -> Callable[[Array], float]:
        return lambda x: float(function(space.whole(x[None, :]))[0])

    def rule(one: ResponseLimit) -> dict[str, object]:
        # kept by a hair more than is asked, so that rounding does not lose the limit
        return {"type": "ineq", "fun": each(lambda p: one.room(p, share) - 0.1 * ROUNDING)}

    found = scipy.optimize.minimize(
        each(lambda p: sign * model.value(p)), start, method="SLSQP",
        constraints=[rule(one) for one in limits],
        bounds=list(zip(space.low, space.high, strict=True)),
        options={"ftol": 1e-13, "maxiter": STEPS},
    )  # fmt: skip
    return np.asarray(found.x, dtype=np.float64), found.status == BY_COUNT


def _rooms(limits: Sequence[ResponseLimit], coded: Array, share: float) -> Array:
    """Smallest distance to a limit, shape (m,); zero without limits."""
    if not limits:
        return np.zeros(len(coded))
    return np.asarray(np.min([one.room(coded, share) for one in limits], axis=0))


def _told(
    model: Model, limits: Sequence[ResponseLimit], space: _Space, own: Array, said: Assurance
) -> Optimum:
    at = space.whole(own[None, :])
    value, half = model.predict(at)
    beside = [one.model.predict(at) for one in limits]
    limited = tuple((float(v[0]), float(h[0])) for v, h in beside)
    near = np.minimum(own - space.low, space.high - own) <= BOUNDARY
    ends = tuple(int(j) for j in space.free[near])
    return Optimum(at[0], float(value[0]), float(half[0]), limited, said, ends)


def _infeasible(model: Model, limits: Sequence[ResponseLimit], space: _Space) -> Fault:
    """Say how near to the limits the surfaces come."""
    points = space.whole(space.sample())
    at = points[int(np.argmax(_rooms(limits, points, 0.0)))]
    words = ", ".join(f"{name} = {x:.4g}" for name, x in model.runs.settings(at).items())
    reached = ", ".join(
        f"{one.model.runs.name} {one.model.predict(at[None, :])[0][0]:.4g} "
        f"(limit {'>=' if one.sign > 0 else '<='} {one.value:.4g})"
        for one in limits
    )
    rule = f"no setting inside of what was run is predicted to keep the limits; nearest: {reached}"
    return Fault("--subject-to", rule, f"there, {words}; move a limit, or run wider ranges")


@dataclass(frozen=True)
class ResponseSpread:
    """What the factors that nobody chooses do at a best setting."""

    #: Smallest and largest prediction over their ranges, in the response's unit.
    low: float
    high: float
    #: Share of their settings at which the limits hold for the prediction; 1 without limits.
    kept: float


def spread_over(
    model: Model, limits: Sequence[ResponseLimit], found: Optimum, others: Sequence[int]
) -> ResponseSpread | None:
    """Vary the factors that nobody chooses over what was run, the others at their best."""
    if not others:
        return None
    held = found.at.copy()
    held[list(others)] = np.nan
    space = _Space.of([model, *(one.model for one in limits)], held)
    points = space.whole(space.sample())
    value = model.value(points)
    kept = float((_rooms(limits, points, 0.0) >= -ROUNDING).mean())
    return ResponseSpread(float(value.min()), float(value.max()), kept)
