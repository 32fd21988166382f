"""Settings that are searched for: best ones within limits, and those whose curve was measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Literal

import numpy as np
import scipy

from study.ground.arrays import Array, Flags, Ints
from study.ground.canonical import Keyed
from study.ground.errors import Fault, RefusedError, settled
from study.statistics.surfaces.emulator import GIVEN, BlockedEmulator, Emulator, fit_emulator
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


# An emulator of whole curves: a mean, and a few shapes whose sizes are emulated.

#: a shape is kept as long as it is this large beside the first one; at most so many
SMALLEST = 1e-4
MOST = 6


@dataclass(frozen=True)
class CurveEmulator:
    """Curves at settings that were not run."""

    #: Settings of the runs; the response is the mean of each curve.
    runs: Runs
    #: shape (m,); of the curves, in their unit.
    mean: Array
    #: shape (q, m); orthonormal.
    shapes: Array
    #: Of each shape, in the curves' unit.
    sizes: tuple[Emulator, ...]
    #: shape (n, m); errors of predicting the curve of each run from all the others, in that unit.
    loo_errors: Array
    #: Share of the curves' variance that is predicted so.
    q2: float

    @property
    def loo_rms(self) -> float:
        """Root mean square of the leave-one-out errors, in the curves' unit."""
        return float(np.sqrt(np.mean(self.loo_errors**2)))

    def value(self, coded: Array) -> Array:
        """Curves, shape (p, m), at coded points of shape (p, k)."""
        sizes = np.column_stack([size.value(coded) for size in self.sizes])
        return np.asarray(self.mean + sizes @ self.shapes)


def fit_curves(runs: Runs, curves: Array, seed: int = 0) -> CurveEmulator:
    """Emulate curves by their principal components (Higdon et al. 2008, JASA 103, 570)."""
    # Shapes: curves (n, m).
    settings, which = runs.distinct()
    averaged = np.zeros((len(settings), curves.shape[1]))
    np.add.at(averaged, which, curves)
    averaged /= np.bincount(which)[:, None]
    mean = averaged.mean(axis=0)
    _, size, shapes = np.linalg.svd(averaged - mean, full_matrices=False)
    if size[0] <= 1e-12 * float(np.abs(averaged).max()):
        rule = "every run has the same curve"
        raise RefusedError(str(Fault("invert", rule, "no input can be told from it")))
    retained = shapes[: max(1, min(MOST, int((size > SMALLEST * size[0]).sum())))]
    scores = (averaged - mean) @ retained.T
    sizes = tuple(
        fit_emulator(Runs(f"shape {j + 1}", runs.factors, settings, column), seed)
        for j, column in enumerate(scores.T)
    )
    # what the shapes leave out is an error, too
    rest = averaged - mean - scores @ retained
    errors = np.column_stack([emulator.loo_errors for emulator in sizes]) @ retained + rest
    q2 = 1.0 - float((errors**2).sum() / ((averaged - mean) ** 2).sum())
    if not q2 >= GIVEN:
        rule = f"the emulator of the curves has a Q2 of {q2:.2f}, below {GIVEN}"
        raise RefusedError(str(Fault("invert", rule, f"add runs: {2 * len(settings)} in all")))
    single = Runs("force", runs.factors, settings, averaged.mean(axis=1))
    return CurveEmulator(single, mean, retained, sizes, errors, q2)


# Settings whose curves are nearest to a measured one, and all that agree with it.

#: points at which the search looks around
CURVE_SAMPLE = 2048
#: coded distance between two starts
APART = 0.35
#: halvings between the best setting and an end of the range: 1e-4 of the range
HALVINGS = 14
#: curves that one search of the settings asks the emulator for, and searches after the first
EVALUATIONS = 60
SEARCHES = 20
#: root mean square over the largest force that a search may gain and have settled before
NEGLIGIBLE = 1e-7
#: a coded coordinate this near to an end of what was run stands there
NEAR_END = 1e-3
#: an input at an end of what was run limits another one where half of its range more would lower
#: the sum of squares by this part of what agreeing curves may miss, which moves the end of the
#: other one by a quarter of its distance from the best setting
LIMITS = 0.5
#: a power below this part of the largest one does not count
COUNTS = 0.05
#: step of the differences that give slopes, in coded units
STEP = 1e-4
#: a combination is determined where its interval is less than this part of what the ranges allow
NARROW = 0.5
#: probability of the region
LEVEL = 0.95


@dataclass(frozen=True)
class FactorCombination(Keyed):
    """A product of powers of the inputs that a curve determines, where inputs alone are not."""

    KEYS = "exponents value ratio words"

    #: Powers of the inputs that count, by name; the first one is 1.
    exponents: Mapping[str, float]
    #: Of the product, in the inputs' units.
    value: float
    #: Factor by which the product may be larger or smaller.
    ratio: float

    @property
    def words(self) -> str:
        """The product as it is written."""
        return " * ".join(n if e == 1.0 else f"{n}^{e:g}" for n, e in self.exponents.items())


@dataclass(frozen=True)
class InversionAgreement:
    """Settings whose curves agree with a measured one."""

    #: shape (k,); coded settings of the best curve.
    at: Array
    #: Root mean square residual of the best curve, in the curve's unit.
    rms: float
    #: Root mean square residual from which a curve no longer agrees.
    limit: float
    #: shape (k,); ends of every setting inside of the set, coded.
    low: Array
    high: Array
    #: shape (k,); whether the set reaches the end of the run range, of this input or of one that
    #: compensates it, and maybe goes on beyond.
    open_low: Flags
    open_high: Flags
    #: shape (p, k); members of the set, coded: the best setting for values of each input.
    points: Array
    #: shape (2, k); members where the least determined input is smallest and largest.
    ends: Array
    #: What is determined where an input by itself is not; empty where all inputs are.
    combinations: tuple[FactorCombination, ...]


def agreeing(
    nearest: NearestCurves, *, rows_worth: float | None = None, largest: float | None = None
) -> InversionAgreement:
    """Find the set of settings whose curves agree with a measured one.

    A curve agrees where its sum of squares lies in the joint 95 % region of least squares (Bates
    and Watts 1988, eq. 2.12: S <= S_min + s^2 p F), widened by the emulator's own error; or where
    it misses no more than ``largest``. The ends of an input are those of its profile: the other
    inputs are always at their best, so that a narrow, bent set is followed to its ends.
    """
    model, space, at = nearest.model, nearest.space, nearest.minima[0]
    rms, p, m = nearest.rms(at), space.free.size, nearest.measured.size
    if largest is None:
        worth = min(max(rows_worth or float(m), p + 1.0), float(m))
        f = float(scipy.special.fdtri(p, max(m - p, 1), LEVEL))
        share = p * f / max(m - p, 1) * m / worth
        largest = float(np.sqrt(rms**2 * (1.0 + share) + (1.96 * model.loo_rms) ** 2))
    is_open = np.zeros((2, at.size), dtype=bool)
    branches = [at, *(point for point in nearest.minima[1:] if nearest.rms(point) <= largest)]
    members = list(branches)
    for j in space.free:
        for side, end in enumerate((float(space.low[j]), float(space.high[j]))):
            reached = float("nan")
            for branch in branches:
                path = nearest.profile_end(int(j), end, branch, largest, reached)
                is_open[side, j] |= nearest.ends_with_the_runs(int(j), path[-1], rms, largest)
                members += path[1:]
                reached = min((float(point[j]) for point in members), key=lambda x: abs(end - x))
                if abs(end - reached) < NEAR_END:
                    is_open[side, j] = True
                    break
    points = np.array(members)
    low, high = points.min(axis=0), points.max(axis=0)
    width = (high - low)[space.free] / (space.high - space.low)[space.free]
    loose = int(space.free[int(np.argmax(width))])
    whole = points[[int(np.argmin(points[:, loose])), int(np.argmax(points[:, loose]))]]
    alone = ~(is_open[0] | is_open[1])
    loose_ones = np.array([j for j in space.free if not alone[j]], dtype=np.int64)
    # a product of one input is that input
    near_best = nearest.combinations(at, rms, largest, loose_ones) if loose_ones.size > 1 else ()
    # a profile follows the best settings; others agree as well, and a rule is for all of them
    around = space.sample(CURVE_SAMPLE)
    agree = np.vstack([points, around[nearest.each_rms(around) <= largest]])
    rules = tuple(
        widened for rule in near_best if (widened := nearest.holding(rule, agree)) is not None
    )
    return InversionAgreement(
        at, rms, largest, low, high, is_open[0], is_open[1], points, whole, rules
    )


@dataclass(frozen=True)
class NearestCurves:
    """An emulator of curves, and the settings whose curves are nearest to a measured one."""

    model: CurveEmulator
    #: shape (m,); the measured curve, in the curves' unit.
    measured: Array
    space: FreeSettings

    @classmethod
    def of(cls, model: CurveEmulator, measured: Array, held: Array) -> NearestCurves:
        """Search all that is not held: coded settings of shape (k,), NaN where free."""
        return cls(model, measured, FreeSettings.of([model.runs], held))

    @cached_property
    def minima(self) -> list[Array]:
        """Settings (k,) at which the sum of squares is least about them, the best one first."""
        points = self.space.sample(CURVE_SAMPLE)
        rest = points[np.argsort(self.each_rms(points))]
        settings: list[Array] = []
        for _ in range(STARTS):
            if not len(rest):
                break
            settings.append(self.fitted(rest[0], self.space.free))
            # the next one starts away from those that have been followed
            starts = np.array([rest[0], *settings])
            near = np.abs(rest[:, None] - starts[None]).max(axis=2).min(axis=1) < APART
            rest = rest[~near]
        settings.sort(key=self.rms)
        return [
            minimum
            for i, minimum in enumerate(settings)
            if all(np.abs(minimum - other).max() > NEAR_END for other in settings[:i])
        ]

    @property
    def residual(self) -> Array:
        """What the nearest curve misses, shape (m,)."""
        return np.asarray(self.measured - self.model.value(self.minima[0][None, :])[0])

    def rms(self, at: Array) -> float:
        """Root mean square of what the curve at a point misses."""
        return float(self.each_rms(at[None, :])[0])

    def each_rms(self, points: Array) -> Array:
        """Give the same, shape (n,), for points of shape (n, k)."""
        return np.asarray(np.sqrt(((self.model.value(points) - self.measured) ** 2).mean(axis=1)))

    def fitted(self, start: Array, free: Ints) -> Array:
        """Least squares over some coordinates from a start; shape (k,)."""
        if not free.size:
            return start
        scale = float(np.abs(self.measured).max()) or 1.0
        low, high = self.space.low[free], self.space.high[free]
        inside = np.clip(start[free], low + 1e-9, high - 1e-9)

        def whole(x: Array) -> Array:
            at = start.copy()
            at[free] = x
            return at

        def searched(x: Array) -> scipy.optimize.OptimizeResult:
            return scipy.optimize.least_squares(
                lambda x: (self.model.value(whole(x)[None, :])[0] - self.measured) / scale,
                x,
                jac=lambda x: self.slope(whole(x), free) / scale,
                bounds=(low, high), xtol=1e-10, ftol=1e-12, gtol=1e-12, max_nfev=EVALUATIONS,
            )  # fmt: skip

        # Where only a product of settings is determined, steps along it never end, and change
        # nothing: a search has settled as well where as many steps again do not matter.
        search = searched(inside)
        for _ in range(SEARCHES):
            if search.success:
                break
            before, search = search, searched(np.asarray(search.x))
            gain = np.sqrt(before.cost) - np.sqrt(search.cost)
            if gain <= NEGLIGIBLE * np.sqrt(self.measured.size / 2):
                search = before
                break
        else:
            settled(search, "setting whose curve is nearest to the measured one")
        return whole(np.asarray(search.x, dtype=np.float64))

    def slope(self, at: Array, free: Ints) -> Array:
        """Differentiate the curve by coded coordinates, shape (m, f)."""
        steps = np.zeros((free.size, at.size))
        steps[np.arange(free.size), free] = STEP
        values = self.model.value(np.vstack([at + steps, at - steps]))
        return np.asarray((values[: free.size] - values[free.size :]).T / (2.0 * STEP))

    def profile_end(
        self, j: int, end: float, best: Array, largest: float, reached: float
    ) -> list[Array]:
        """Members of the set on the way from a minimum to an end of an input.

        The minima of one set mostly end at one place: an end beside the value of the input that
        other members have ``reached`` is not searched again.
        """
        others = self.space.free[self.space.free != j]

        def at(value: float, near: Array) -> Array:
            starts = (near.copy(), best.copy())
            for start in starts:
                start[j] = value
            return min((self.fitted(start, others) for start in starts), key=self.rms)

        path = [best]
        # on the way, so that a bent set is followed
        for share in (0.25, 0.5, 0.75, 1.0):
            point = at(best[j] + share * (end - best[j]), path[-1])
            if self.rms(point) > largest:
                break
            path.append(point)
        else:
            return path
        inner, outer = float(path[-1][j]), float(point[j])
        guesses = (reached - NEAR_END, reached + NEAR_END)
        for _ in range(HALVINGS):
            if max(abs(inner - reached), abs(outer - reached)) < 1.01 * NEAR_END:
                break
            between = (point for point in guesses if min(inner, outer) < point < max(inner, outer))
            middle = at(next(between, 0.5 * (inner + outer)), path[-1])
            if self.rms(middle) <= largest:
                inner = float(middle[j])
                path.append(middle)
            else:
                outer = float(middle[j])
        return path

    def ends_with_the_runs(self, j: int, at: Array, rms: float, largest: float) -> bool:
        """Whether runs further out might move an end of an input: runs of it, or of another one.

        Another input that stands at an end of what was run limits this one only if the sum of
        squares would still fall beyond; where a third makes up for it, it stands there by chance.
        """
        below, above = at - self.space.low < NEAR_END, self.space.high - at < NEAR_END
        if below[j] or above[j]:
            return True
        missed = self.model.value(at[None, :])[0] - self.measured
        free = self.space.free
        rise = 2.0 * self.slope(at, free).T @ missed
        gain = np.where(below[free], rise, 0.0) - np.where(above[free], rise, 0.0)
        return bool(gain.max() > LIMITS * self.measured.size * (largest**2 - rms**2))

    def combinations(
        self, at: Array, rms: float, largest: float, loose: Ints
    ) -> tuple[FactorCombination, ...]:
        """Products of powers of the inputs that by themselves are not determined."""
        # In logarithms the curve is nearly linear about the best setting; along the directions in
        # which it changes much, the set is narrow.
        factors = [self.model.runs.factors[j] for j in loose]
        if not factors or any(factor.low <= 0 for factor in factors):
            return ()
        settings = np.array([factor.setting(float(at[j]))
                             for factor, j in zip(factors, loose, strict=True)])  # fmt: skip
        extent = np.log([factor.high / factor.low for factor in factors])
        by_log = np.array([2.0 / np.log(factor.high / factor.low) if factor.log
                           else 2.0 * x / (factor.high - factor.low)
                           for factor, x in zip(factors, settings, strict=True)])  # fmt: skip
        _, strength, directions = np.linalg.svd(self.slope(at, loose) * by_log, full_matrices=False)
        room = np.sqrt(self.measured.size * max(largest**2 - rms**2, 0.0))
        half = room / np.maximum(strength, 1e-12 * strength[0])
        narrow = half < NARROW * 0.5 * (np.abs(directions) @ extent)
        return tuple(
            self._combination(direction, float(half_width), settings, loose)
            for direction, half_width, is_narrow in zip(directions, half, narrow, strict=True)
            if is_narrow
        )

    def holding(self, rule: FactorCombination, members: Array) -> FactorCombination | None:
        """Widen a rule until every member of the set keeps it; None where it says little then."""
        names, powers = self.model.runs.names, np.array([*rule.exponents.values()])
        used = [names.index(name) for name in rule.exponents]
        factors = [self.model.runs.factors[j] for j in used]
        logs = np.log([[f.setting(float(x)) for f, x in zip(factors, member[used], strict=True)]
                       for member in members])  # fmt: skip
        worst = float(np.abs(logs @ powers - np.log(rule.value)).max())
        half = max(worst, float(np.log(rule.ratio)))
        room = np.log([f.high / f.low for f in factors])
        if half >= NARROW * 0.5 * float(np.abs(powers) @ room):
            return None
        return replace(rule, ratio=float(np.exp(half)))

    def _combination(
        self, direction: Array, half: float, settings: Array, loose: Ints
    ) -> FactorCombination:
        counts = np.abs(direction) >= COUNTS * float(np.abs(direction).max())
        unit = direction[int(np.flatnonzero(counts)[0])]
        # as they are written, three digits: 3.50 of C R^2 would be 3.47 of C R^1.997
        powers = np.array([float(f"{e:.3g}") for e in np.where(counts, direction / unit, 0.0)])
        powers[np.abs(powers - 1.0) < 0.005], powers[np.abs(powers) < 0.01] = 1.0, 0.0
        value = float(np.prod(settings**powers))
        names = (self.model.runs.names[j] for j in loose)
        exponents = {n: float(e) for n, e in zip(names, powers, strict=True) if e}
        return FactorCombination(exponents, value, float(np.exp(half / abs(unit))))
