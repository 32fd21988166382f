"""Levenberg-Marquardt for nonlinear least squares, after More (1978).

Two parts: :func:`damped_step` solves the damped linear problem inside the trust region, by
QR of the column-scaled Jacobian (never its normal equations), and :func:`updated_radius`
grows or shrinks the region by how well the linear model foretold the decrease. Columns are
scaled by the running maximum of their norms (More 1978, eq. 6.1), which makes every result
independent of the parameters' units. Convergence is judged by the full Gauss-Newton step
(Bates and Watts 1981), not by the damped one, which also gets small where nothing converges.
Where each evaluation is a simulation, the curvature of the residual is learned from accepted
steps and added to the linear model (Dennis, Gay and Welsch 1981).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike

from study.ground.arrays import Array, Flags
from study.mechanics.calibration.residual_function import Bounds, Function, checked_bounds, evaluate

# The damped linear least-squares problem inside a trust region.


@dataclass(frozen=True)
class Linearization:
    """Jacobian reduced by a column-scaled QR, its triangle by SVD: every step is cheap.

    Columns of unit length decide the rank and the full step, because the running maximum of
    the norms, which shapes the trust region, can exceed today's norms by many digits.
    """

    #: shape (p,); undamped (Gauss-Newton) step, of least length where the rank is deficient.
    full_step: Array
    full_length: float
    #: Share of the residual that lies in the space of the Jacobian.
    offset: float
    rank: int
    #: Column scale D, singular values and right vectors (rows) of J D^-1, and the residual in its
    #: left vectors.
    scale: Array
    singular: Array
    right: Array
    load: Array

    @classmethod
    def of(cls, jacobian: Array, residual: Array, scale: Array) -> Linearization:
        """Factorize a Jacobian (n, p) with its residual (n,) and column scale (p,)."""
        if jacobian.shape[1] == 0:
            none = np.zeros(0)
            return cls(none, 0.0, 0.0, 0, none, none, np.zeros((0, 0)), none)
        norms = np.linalg.norm(jacobian, axis=0)
        norms = np.where(norms > 0, norms, 1.0)
        q, triangle = np.linalg.qr(jacobian / norms)
        projected = q.T @ residual
        left, singular, right = np.linalg.svd(triangle, full_matrices=False)
        load = left.T @ projected
        significant = singular > max(jacobian.shape) * np.finfo(float).eps * singular.max()
        unit = -(right[significant].T @ (load[significant] / singular[significant]))
        length = float(np.linalg.norm(residual))
        offset = float(np.linalg.norm(load[significant])) / length if length else 0.0
        left, singular, right = np.linalg.svd(triangle * (norms / scale), full_matrices=False)
        return cls(
            unit / norms,
            length_of(scale / norms * unit),
            offset,
            int(significant.sum()),
            scale,
            singular,
            right,
            left.T @ projected,
        )


def length_of(vector: Array) -> float:
    """Euclidean length without overflow or underflow of the squares. Shapes: vector (n,)."""
    return math.hypot(*vector)


def damped_step(linear: Linearization, radius: float) -> tuple[Array, float]:
    """Levenberg-Marquardt step of scaled length at most 1.1 ``radius``, and its damping.

    The step p minimizes |J p + r|^2 + damping |D p|^2; damping solves |D p| = radius to 10 %
    by Hebden's iteration (More 1978, sec. 5), safeguarded by a bracket. The iteration sees
    lengths over the gradient's, so that no magnitude of the residual overflows in it.

    Shapes: returns (p,).
    """
    if linear.full_length <= 1.1 * radius:
        return linear.full_step, 0.0
    gradient = linear.singular * linear.load
    steepness = length_of(gradient)
    if steepness == 0:  # the gradient is too small for a number: there is no direction to go
        return np.zeros_like(linear.scale), 0.0
    s2, unit, target = linear.singular**2, gradient / steepness, radius / steepness
    low, high = 0.0, 1 / target
    damping = 1e-3 * high
    # a step of another length within the bracket lowers the cost, too, and is judged by that
    for _ in range(60):
        terms = unit / (s2 + damping)
        length = length_of(terms)
        if abs(length - target) <= 0.1 * target:
            break
        low, high = (damping, high) if length > target else (low, damping)
        slope = float((terms / length) ** 2 @ (1 / (s2 + damping)))
        damping += (length / target - 1) / slope
        if not low < damping < high:
            damping = max(1e-3 * high, math.sqrt(low) * math.sqrt(high))
    scaled = -linear.right.T @ (unit / (s2 + damping))
    return steepness * scaled / linear.scale, damping


def newton_step(tangent: Array, slope: Array, radius: float) -> tuple[Array, float]:
    """Step of length at most 1.1 ``radius`` to the least value of a quadratic, and its damping.

    Shapes: tangent (p, p), symmetric; slope (p,); returns (p,).
    """
    values, axes = np.linalg.eigh(tangent)
    along = axes.T @ slope
    low = max(0.0, -float(values[0])) * (1 + 1e-9)
    high = low + length_of(along) / radius
    damping = 0.0
    if values[0] <= 0 or length_of(along / values) > 1.1 * radius:
        for _ in range(60):
            damping = 0.5 * (low + high)
            length = length_of(along / (values + damping))
            if abs(length - radius) <= 0.1 * radius:
                break
            low, high = (damping, high) if length > radius else (low, damping)
    return -axes @ (along / (values + damping)), damping


# A least-squares search, and what can be read from it: convergence, edges, limits.

EPS = float(np.finfo(float).eps)
#: first trust-region radius as a multiple of the start's scaled length
FIRST_RADIUS = 1.0
#: scaled distance, relative to the parameters, at which a failed evaluation counts as next door
NEXT_DOOR = 0.01
#: accepted steps over which a search that creeps along failures is judged
CRAWL = 3
#: share of the residual that parameters explain, above which its curvature does not matter yet
EXPLAINED = 0.5
#: growth of a parameter over its start that counts as running to infinity
FAR = 1e8
#: share of the full Gauss-Newton step, and scaled length relative to the parameters, within
#: which no smooth model turns its gradient
SHORT = 0.01
SMALL = 1e-3
#: shares of the step along a kink that are tried
SHARES = (1.0, 0.25, 0.06)
#: gain from which a step is taken
ACCEPTED = 1e-4
#: cosine below which a point where no step helps is a minimum with a singular Jacobian
STATIONARY = 1e-6
#: Foretold decrease of the cost, in ``ftol``, that the precision of the function may hide where
#: no step lowers the cost. A simulation started from another state differs by 3e-9 N; the cost
#: of a flat indentation fitted to 1.3 % noise then scatters by 1e-9 of itself, which is the
#: ``ftol`` of fits by simulation, and one specimen in six ended there with 1.5e-9 foretold.
HIDDEN = 10.0
#: Relative offset below which the rest of the way is a thousandth of the radius of a 95 % region,
#: which a model that scatters by itself need not go (Bates and Watts 1981, Technometrics 23, 179)
NEGLIGIBLE_OFFSET = 1e-3


class Status(Enum):
    """How the optimizer ended; the value is a sentence."""

    converged_gradient = "a minimum: no small change of the constants lowers the sum of squares"
    converged_step = "the next full step would not change the parameters"
    converged_cost = "the sum of squares can fall no further within rounding"
    converged_zero = "the model meets the data within rounding"
    max_evaluations = "the evaluations allowed were used up before a minimum was reached"
    no_decrease = "no step lowers the sum of squares although its gradient is not zero"
    at_edge = "the sum of squares falls on towards constants at which the model has no answer"
    at_kink = (
        "the sum of squares has a kink at its lowest point: contact sets in on one side of it, "
        "so that a standard error would mean nothing"
    )
    no_influence = "a parameter lost all influence on the model: this is no minimum to trust"
    running_away = "a parameter runs to infinity: no minimum lies within reach"
    start_failed = "the model has no answer at the start values"
    too_many_failures = "the model had no answer in the whole neighborhood of the best point"
    stopped = "stopped by the caller"

    @property
    def converged(self) -> bool:
        """Whether a local minimum was reached."""
        return self.name.startswith("converged")

    @property
    def usable(self) -> bool:
        """Whether the constants describe the data as well as the model can."""
        return self.converged or self in (Status.at_edge, Status.at_kink)

    @property
    def sentence(self) -> str:
        """The end in words."""
        return str(self.value)


@dataclass(frozen=True)
class Iteration:
    """One accepted point: what a progress line shows and what a resumed fit needs.

    ``scale`` is the largest norm of every column of the Jacobian so far, zero where there was
    no influence. ``offset`` is the share of the residual that the parameters could still explain.
    """

    iteration: int
    evaluations: int
    x: Array
    cost: float
    radius: float
    damping: float
    offset: float
    scale: Array


Callback = Callable[[Iteration], bool | None]


class LeastSquaresSearch:
    """A search for the least sum of squares, and where it ended."""

    def __init__(
        self,
        function: Function,
        start: Array,
        bounds: Bounds,
        max_evaluations: int,
        tolerances: tuple[float, float, float, float],
    ) -> None:
        self.function, self.max_evaluations = function, max_evaluations
        self.ftol, self.xtol, self.gtol, self.edge = tolerances
        self.low, self.high = checked_bounds(start, bounds)
        #: Best parameters so far, shape (p,), each in its unit; there the weighted residual (n,)
        #: and its derivative (n, p), and the parameters that a bound holds, shape (p,).
        self.x = start
        self.residual, self.jacobian = np.zeros(0), np.zeros((0, start.size))
        self.at_bound = np.zeros(start.size, bool)
        #: Largest absolute value of each parameter so far, and largest norm of each column of the
        #: Jacobian, zero where there was no influence; both of shape (p,).
        self.reach, self.peak = np.abs(start), np.zeros(start.size)
        #: Residuals times their second derivatives, summed, shape (p, p), as steps show them, and
        #: whether they would have foretold the last decrease better than the linear model alone.
        self.curvature, self.bends = np.zeros((start.size, start.size)), False
        #: Of the trust region, in the unit of the residual; Levenberg's parameter of the last step.
        self.radius = self.damping = 0.0
        #: Largest rank of the Jacobian so far, calls of the function.
        self.rank, self.evaluations = 0, 0
        #: Whether the sum of squares was seen to have a kink here.
        self.kink = False
        self.history: list[Iteration] = []
        #: Parameters at which the model had no answer, and how many at each accepted point.
        self.failed: list[Array] = []
        self.failures: list[int] = []
        #: How it ended; only a ``converged_*`` status is a success.
        self.status = Status.start_failed

    @property
    def converged(self) -> bool:
        """Whether a local minimum was reached."""
        return self.status.converged

    @property
    def cost(self) -> float:
        """Half the sum of squares; infinite where the start has no answer."""
        return 0.5 * float(self.residual @ self.residual) if self.residual.size else np.inf

    @property
    def scale(self) -> Array:
        """Scale of the parameters: the peak of their columns' norms, 1 before any influence."""
        return np.where(self.peak > 0, self.peak, 1.0)

    def run(self, callback: Callback | None, resume: Iteration | None) -> Status:
        """Search from the start, or from where an earlier search stopped."""
        evaluated = self._evaluated(self.x)
        if evaluated is None:
            return Status.start_failed
        self._accept(self.x, *evaluated)
        self.radius = FIRST_RADIUS * size(self.peak * self.x, self.residual)
        if resume is not None:
            self.peak, self.radius = np.maximum(resume.scale, self.peak), resume.radius
        while True:
            gradient = self.jacobian.T @ self.residual
            at_low = (self.x <= self.low) & (gradient >= 0)
            self.at_bound = at_low | ((self.x >= self.high) & (gradient <= 0))
            free = ~self.at_bound
            linear = Linearization.of(self.jacobian[:, free], self.residual, self.scale[free])
            self.rank = max(self.rank, linear.rank + int(self.at_bound.sum()))
            self.history.append(
                Iteration(
                    len(self.history), self.evaluations, self.x.copy(), self.cost, self.radius,
                    self.damping, linear.offset, self.peak.copy(),
                )
            )  # fmt: skip
            self.failures.append(len(self.failed))
            status = self._converged_at(linear)
            if status is None and self._is_crawling() and not self._is_near_enough(linear):
                status = Status.at_edge
            if status is None and callback is not None and callback(self.history[-1]):
                status = Status.stopped
            if status is None:
                status = self._advance(linear)
            if status is not None:
                return self._trusted(status, linear)

    def _evaluated(self, x: Array) -> tuple[Array, Array] | None:
        self.evaluations += 1
        return evaluate(self.function, x)

    def _accept(self, x: Array, residual: Array, jacobian: Array) -> None:
        """Move to a better point."""
        if self.edge > 0 and self.residual.size:
            self._bend(x - self.x, residual, jacobian)
        self.x, self.residual, self.jacobian = x, residual, jacobian
        self.peak = np.maximum(self.peak, np.linalg.norm(jacobian, axis=0))
        self.reach = np.maximum(self.reach, np.abs(x))

    def _bend(self, step: Array, residual: Array, jacobian: Array) -> None:
        """Correct the curvature of the residual by what an accepted step shows of it.

        The update of least change, sized by what remains of the curvature (Dennis, Gay and Welsch
        1981, ACM Trans. Math. Softw. 7, 348).
        """
        actual, straight = self._decrease(residual), self._foretold(step)
        before = float(step @ self.curvature @ step)
        self.bends = abs(straight - before - actual) < abs(straight - actual)
        gradient = jacobian.T @ residual - self.jacobian.T @ self.residual
        bent, along = (jacobian - self.jacobian).T @ residual, float(gradient @ step)
        self.curvature *= min(1.0, abs(float(step @ bent) / before)) if before else 1.0
        if along > 0:
            missed = bent - self.curvature @ step
            self.curvature += (np.outer(missed, gradient) + np.outer(gradient, missed)) / along
            self.curvature -= float(missed @ step) / along**2 * np.outer(gradient, gradient)

    def _newton_step(self, radius: float) -> tuple[Array, float, float] | None:
        """Newton's step within a radius, its damping, and the decrease that it foretells.

        None while the linear model foretells as well, or at a bound.
        """
        if not self.bends or self.at_bound.any():
            return None
        slope = self.jacobian.T @ self.residual / self.scale
        tangent = self.jacobian.T @ self.jacobian + self.curvature
        tangent = tangent / np.outer(self.scale, self.scale)
        scaled, damping = newton_step(tangent, slope, radius)
        return scaled / self.scale, damping, -float((2 * slope + tangent @ scaled) @ scaled)

    def _proposed(self, linear: Linearization) -> tuple[Array, float, float]:
        """Step within the region, its damping, and the decrease that it foretells.

        It is Newton's once steps have shown how the residual bends: where what is left of it is
        large, the steps of Gauss and Newton shrink by a constant factor.
        """
        newton = self._newton_step(self.radius) if linear.offset < EXPLAINED else None
        if newton is not None:
            there = self.x + newton[0]
            if np.all((self.low <= there) & (there <= self.high)):
                return newton
        step, damping = self._bounded_step(linear)
        return step, damping, self._foretold(step)

    def _gain(self, foretold: float, evaluated: tuple[Array, Array] | None) -> float:
        """Actual over foretold decrease of the sum of squares."""
        if evaluated is None:
            return -np.inf
        return self._decrease(evaluated[0]) / foretold if foretold > 0 else -np.inf

    def _decrease(self, residual: Array) -> float:
        """Decrease of the sum of squares to that of another residual (n,)."""
        # (r - s)(r + s) keeps the digits that the difference of two sums of squares loses
        return float((self.residual - residual) @ (self.residual + residual))

    def _foretold(self, step: Array) -> float:
        """Decrease of the sum of squares in the linear model."""
        change = self.jacobian @ step
        return -float(change @ (2 * self.residual + change))

    def _length(self, held: Flags) -> float:
        """Scaled length of the parameters that may move, see :func:`size`."""
        return size((self.peak * self.x)[~held], self.residual)

    def _is_beside_failure(self) -> bool:
        """Whether the model had no answer at constants next to the best ones."""
        reach = NEXT_DOOR * self._length(np.zeros(self.x.size, bool))
        return any(length_of(self.scale * (x - self.x)) <= reach for x in self.failed)

    def _is_crawling(self) -> bool:
        """Whether the search creeps along constants at which the model has no answer."""
        if len(self.history) <= CRAWL:
            return False
        gained = self.history[-1 - CRAWL].cost - self.cost
        blocked = self.failures[-1] - self.failures[-1 - CRAWL]
        return gained < self.edge * self.cost and blocked >= 2 and self._is_beside_failure()

    def _is_near_enough(self, linear: Linearization) -> bool:
        """Whether a model whose evaluations scatter is as near to its minimum as matters."""
        return self.edge > 0 and linear.offset <= NEGLIGIBLE_OFFSET

    def _converged_at(self, linear: Linearization) -> Status | None:
        """How a search has converged here; None where it has not."""
        length = float(np.linalg.norm(self.residual))
        influence = float(np.linalg.norm(self.jacobian, axis=0) @ np.abs(self.x))
        # a residual is a difference of a few terms, each with a rounding of its own
        if length <= 4 * EPS * influence or length == 0:
            return Status.converged_zero
        if linear.offset <= self.gtol and self._is_flat(length):
            return Status.converged_gradient
        if linear.full_length <= self.xtol * self._length(self.at_bound):
            return Status.converged_step
        return None

    def _is_flat(self, length: float) -> bool:
        """Whether Newton's step lowers the sum of squares by no more than the offset allows."""
        newton = self._newton_step(length)
        return newton is None or newton[1] > 0 or newton[2] <= (self.gtol * length) ** 2

    def _trusted(self, status: Status, linear: Linearization) -> Status:
        """No success where a parameter, or a combination, lost the influence it once had."""
        # Nor where none has any: the residual is then orthogonal to nothing.
        first, held = np.abs(self.history[0].x), self.at_bound
        if status is Status.no_decrease and np.any((np.abs(self.x) > FAR * first) & (first > 0)):
            return Status.running_away
        norms = np.linalg.norm(self.jacobian, axis=0)
        length = float(np.linalg.norm(self.residual))
        lost = (norms * self.reach <= 1e-8 * length) & (self.peak > norms) & ~held
        singular = linear.rank + int(held.sum()) < self.rank or not (held | (norms > 0)).any()
        doubtful = status.converged and status is not Status.converged_zero
        return Status.no_influence if doubtful and (singular or np.any(lost)) else status

    def _advance(self, linear: Linearization) -> Status | None:
        """Try steps in a shrinking region until one lowers the cost; the reason if none does."""
        answered = False
        while self.evaluations < self.max_evaluations:
            step, damping, foretold = self._proposed(linear)
            trial = np.clip(self.x + step, self.low, self.high)
            length = length_of(self.scale * step)
            norms = np.linalg.norm(self.jacobian, axis=0)
            # a change of the residual below that of the parameters' own rounding
            if length_of(norms * (trial - self.x)) <= 2 * EPS * size(norms * self.x, self.residual):
                return self._without_step(linear, answered)
            evaluated = self._evaluated(trial)
            answered = answered or evaluated is not None
            if evaluated is None:
                self.failed.append(trial)
            gain = self._gain(foretold, evaluated)
            self.radius = updated_radius(self.radius, length, gain, damping)
            self.damping = damping
            if evaluated is not None and gain > ACCEPTED:
                self._accept(trial, *evaluated)
                return None
            if linear.offset**2 <= self.ftol and answered and damping == 0:
                return Status.converged_cost
            reach = min(SHORT * linear.full_length, SMALL * self._length(self.at_bound))
            if 0 < length <= reach and evaluated is not None:
                before, after = self.jacobian.T @ self.residual, evaluated[1].T @ evaluated[0]
                # A cost that falls at the beginning of a step and rises at its end, which is too
                # short for that, has a kink in between: a gradient that is merely wrong, or noisy,
                # points the same way on both sides.
                self.kink = float(before @ step) < 0 < float(after @ step)
                if self.kink and self._moved_along(after - before):
                    return None
            if self.kink and self.edge > 0:
                near = self._is_near_enough(linear)
                return Status.converged_cost if near else Status.at_kink
        return Status.max_evaluations

    def _bounded_step(self, linear: Linearization) -> tuple[Array, float]:
        """Damped step in the free parameters; one that would cross its bound stops there.

        The others are then solved again with that part of the step given, at most p times.
        """
        low, high = self.low - self.x, self.high - self.x
        step, free = np.zeros(self.x.size), ~self.at_bound
        while True:
            step[free], damping = damped_step(linear, self.radius)
            crossing = free & ((step < low) | (step > high))
            step[crossing] = np.clip(step, low, high)[crossing]
            free = free & ~crossing
            if not (np.any(crossing) and np.any(free)):
                return step, damping
            given = self.residual + self.jacobian[:, ~free] @ step[~free]
            linear = Linearization.of(self.jacobian[:, free], given, self.scale[free])

    def _without_step(self, linear: Linearization, answered: bool) -> Status:
        """Status where no step is left that changes anything."""
        if not answered and self._is_beside_failure():
            return Status.too_many_failures
        # at a minimum rounding hides any decrease below about sqrt(eps) of the residual
        if linear.offset**2 <= HIDDEN * self.ftol or self._is_near_enough(linear):
            return Status.converged_cost
        norms = np.linalg.norm(self.jacobian, axis=0) * float(np.linalg.norm(self.residual))
        slopes = np.abs(self.jacobian.T @ self.residual)
        cosines = np.where(self.at_bound | (norms == 0), 0.0, slopes / norms)
        if float(np.max(cosines, initial=0.0)) <= STATIONARY:
            return Status.converged_gradient
        if linear.full_length <= 1e-9 * self._length(self.at_bound):
            return Status.converged_step
        if self._is_beside_failure():
            return Status.at_edge
        return Status.at_kink if self.kink else Status.no_decrease

    def _moved_along(self, jump: Array) -> bool:
        """Step along a kink; False if that lowers the cost by no more than ``edge`` of it."""
        free, step = ~self.at_bound, np.zeros(self.x.size)
        if np.count_nonzero(free) >= 2:  # a Gauss-Newton step that stays on the surface
            scale, normal = self.scale, (jump / self.scale)[free]
            frame = np.linalg.qr(np.column_stack([normal, np.eye(normal.size)]))[0][:, 1:]
            reduced = (self.jacobian / scale)[:, free] @ frame
            least = np.linalg.lstsq(reduced, -self.residual, rcond=1e-10)[0]
            step[free] = frame @ least / scale[free]
        if self._foretold(step) <= 2 * max(self.edge, EPS) * self.cost:
            return False
        for share in SHARES:
            trial = np.clip(self.x + share * step, self.low, self.high)
            evaluated = self._evaluated(trial)
            gain = self._gain(self._foretold(share * step), evaluated)
            if evaluated is not None and gain > ACCEPTED:
                self.radius = float(np.linalg.norm(self.scale * share * step))
                self._accept(trial, *evaluated)
                return True
        return False


def size(influence: Array, residual: Array) -> float:
    """Length of parameters in the unit of the residual: what steps and radii are relative to.

    Parameters without influence within the rounding of the residual are as good as zero. Their
    length is that of the residual, which the parameters have yet to explain: any other number,
    such as More's factor itself (1978, sec. 3), would have a unit.

    Shapes: influence, residual (p,).
    """
    length, left = length_of(influence), float(np.linalg.norm(residual))
    return length if length > EPS * left else left


def updated_radius(radius: float, length: float, gain: float, damping: float) -> float:
    """Grow or shrink the trust region by the gain ratio (More 1978, sec. 4)."""
    if gain <= 0.25:
        # the parabola through both costs and the slope has its minimum at 1/(2 (2 - gain))
        shrink = 0.1 if not np.isfinite(gain) else min(max(0.5 / (2 - gain), 0.1), 0.5)
        # a full step that failed far inside the region must not be tried a second time
        reach = length if damping == 0 and gain <= ACCEPTED else 10 * length
        return shrink * min(radius, reach)
    if damping == 0 or gain >= 0.75:
        return 2 * length
    return radius


def levenberg_marquardt(
    function: Function,
    start: ArrayLike,
    *,
    bounds: Bounds = None,
    max_evaluations: int = 1000,
    ftol: float = 1e-12,
    xtol: float = 1e-12,
    gtol: float = 1e-10,
    edge: float = 0.0,
    callback: Callback | None = None,
    resume: Iteration | None = None,
) -> LeastSquaresSearch:
    """Minimize half the sum of squares of a residual.

    Shapes: start (p,); gtol Relative offset (Bates and Watts 1981): length of the residual's
    projection on the space of the Jacobian over the length of the residual.
    """
    first = np.array(start if resume is None else resume.x, dtype=float)
    tolerances = (ftol, xtol, gtol, edge)
    search = LeastSquaresSearch(function, first, bounds, max_evaluations, tolerances)
    with np.errstate(over="ignore"):  # a full step can be infinite: it is damped then
        search.status = search.run(callback, resume)
    return search
