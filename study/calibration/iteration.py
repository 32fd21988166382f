"""State of a least-squares search, and what can be read from it: convergence, edges, limits."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from study.arrays import Array
from study.calibration.trust_region_step import Linearization, length_of

EPS = float(np.finfo(float).eps)

#: first trust-region radius as a multiple of the start's scaled length
FIRST_RADIUS = 1.0

#: scaled distance, relative to the parameters, at which a failed evaluation counts as next door
NEXT_DOOR = 0.01

#: accepted steps over which a search that creeps along failures is judged
CRAWL = 5

#: growth of a parameter over its start that counts as running to infinity
FAR = 1e8


@dataclass(frozen=True)
class Iteration:
    """One accepted point: what a progress line shows and what a resumed fit needs.

    ``scale`` is the largest norm of every column of the Jacobian so far, zero where there was
    no influence.
    """

    iteration: int
    evaluations: int
    x: Array
    cost: float
    radius: float
    damping: float
    offset: float
    scale: Array


@dataclass
class State:
    """The search in progress.

    Parameters
    ----------
    x : ndarray, shape (p,)
        Best parameters so far, each in its unit.
    residual, jacobian : ndarray, shapes (n,) and (n, p)
        There, weighted.
    reach : ndarray, shape (p,)
        Largest absolute value of each parameter so far.
    peak : ndarray, shape (p,)
        Largest norm of each column of the Jacobian so far; zero where there was no influence.
    radius : float
        Of the trust region, in the unit of the residual.
    rank : int
        Largest rank of the Jacobian so far.
    damping : float
        Levenberg's parameter of the last step.
    evaluations : int
        Calls of the model.
    kink : bool
        Whether the sum of squares was seen to have a kink here.
    history : list of Iteration
        Accepted points, the start first.
    failed : list of ndarray
        Parameters at which the model had no answer.
    failures : list of int
        How many there were at each accepted point.
    """

    x: Array
    residual: Array
    jacobian: Array
    reach: Array
    peak: Array
    radius: float
    rank: int = 0
    damping: float = 0.0
    evaluations: int = 1
    kink: bool = False
    history: list[Iteration] = field(default_factory=list)
    failed: list[Array] = field(default_factory=list)
    failures: list[int] = field(default_factory=list)

    @property
    def cost(self) -> float:
        """Half the sum of squares."""
        return 0.5 * float(self.residual @ self.residual)

    @property
    def scale(self) -> Array:
        """Scale of the parameters: the peak of their columns' norms, 1 before any influence."""
        return np.where(self.peak > 0, self.peak, 1.0)

    @classmethod
    def at_start(
        cls, x: Array, residual: Array, jacobian: Array, resume: Iteration | None
    ) -> State:
        """State at the start, or where an earlier search stopped."""
        norms = np.linalg.norm(jacobian, axis=0)
        if resume is not None:
            peak = np.maximum(resume.scale, norms)
            return cls(x, residual, jacobian, np.abs(x), peak, resume.radius)
        radius = FIRST_RADIUS * size(norms * x, residual)
        return cls(x, residual, jacobian, np.abs(x), norms, radius)

    def is_negligible(self, step: Array) -> bool:
        """Whether a step changes the residual by less than the parameters' own rounding does."""
        norms = np.linalg.norm(self.jacobian, axis=0)
        return length_of(norms * step) <= 2 * EPS * size(norms * self.x, self.residual)

    def snapshot(self, offset: float) -> Iteration:
        """Make the accepted point for the history."""
        return Iteration(
            len(self.history),
            self.evaluations,
            self.x.copy(),
            self.cost,
            self.radius,
            self.damping,
            offset,
            self.peak.copy(),
        )

    def accept(self, x: Array, residual: Array, jacobian: Array) -> None:
        """Move to a better point."""
        self.x, self.residual, self.jacobian = x, residual, jacobian
        self.peak = np.maximum(self.peak, np.linalg.norm(jacobian, axis=0))
        self.reach = np.maximum(self.reach, np.abs(x))

    def gain(self, step: Array, evaluated: tuple[Array, Array] | None) -> float:
        """Actual over foretold decrease of the sum of squares."""
        if evaluated is None:
            return -np.inf
        change = self.jacobian @ step
        foretold = -float(change @ (2 * self.residual + change))
        new = evaluated[0]
        # (r - s)(r + s) keeps the digits that the difference of two sums of squares loses
        actual = float((self.residual - new) @ (self.residual + new))
        return actual / foretold if foretold > 0 else -np.inf

    def held_by_bounds(self, low: Array, high: Array) -> NDArray[np.bool_]:
        """Parameters at a bound that the gradient pushes against."""
        gradient = self.jacobian.T @ self.residual
        at_low = (self.x <= low) & (gradient >= 0)
        return np.asarray(at_low | ((self.x >= high) & (gradient <= 0)))

    def length(self, held: NDArray[np.bool_]) -> float:
        """Scaled length of the parameters that may move, see :func:`size`."""
        return size((self.peak * self.x)[~held], self.residual)

    def steepest(self, held: NDArray[np.bool_]) -> float:
        """Largest cosine between the residual and a column of the Jacobian."""
        norms = np.linalg.norm(self.jacobian, axis=0) * float(np.linalg.norm(self.residual))
        slopes = np.abs(self.jacobian.T @ self.residual)
        return float(np.max(np.where(held | (norms == 0), 0.0, slopes / norms), initial=0.0))

    def is_beside_failure(self) -> bool:
        """Whether the model had no answer at constants next to the best ones."""
        reach = NEXT_DOOR * self.length(np.zeros(self.x.size, bool))
        return any(length_of(self.scale * (x - self.x)) <= reach for x in self.failed)

    def is_crawling(self, edge: float) -> bool:
        """Whether the search creeps along constants at which the model has no answer."""
        if len(self.history) <= CRAWL:
            return False
        gained = self.history[-1 - CRAWL].cost - self.cost
        blocked = self.failures[-1] - self.failures[-1 - CRAWL]
        return gained < edge * self.cost and blocked >= 2 and self.is_beside_failure()

    def converged(
        self, linear: Linearization, held: NDArray[np.bool_], xtol: float, gtol: float
    ) -> Status | None:
        """How a search has converged here; None where it has not."""
        length = float(np.linalg.norm(self.residual))
        influence = float(np.linalg.norm(self.jacobian, axis=0) @ np.abs(self.x))
        # a residual is a difference of a few terms, each with a rounding of its own
        if length <= 4 * EPS * influence or length == 0:
            return Status.converged_zero
        if linear.offset <= gtol:
            return Status.converged_gradient
        if linear.full_length <= xtol * self.length(held):
            return Status.converged_step
        return None

    def trusted(self, status: Status, linear: Linearization, held: NDArray[np.bool_]) -> Status:
        """No success where a parameter, or a combination, lost the influence it once had.

        Nor where none has any: the residual is then orthogonal to nothing.
        """
        first = np.abs(self.history[0].x)
        if status is Status.no_decrease and np.any((np.abs(self.x) > FAR * first) & (first > 0)):
            return Status.running_away
        norms = np.linalg.norm(self.jacobian, axis=0)
        length = float(np.linalg.norm(self.residual))
        lost = (norms * self.reach <= 1e-8 * length) & (self.peak > norms) & ~held
        singular = linear.rank + int(held.sum()) < self.rank or not (held | (norms > 0)).any()
        doubtful = status.converged and status is not Status.converged_zero
        return Status.no_influence if doubtful and (singular or np.any(lost)) else status


def size(influence: Array, residual: Array) -> float:
    """Length of parameters in the unit of the residual: what steps and radii are relative to.

    Parameters without influence within the rounding of the residual are as good as zero. Their
    length is that of the residual, which the parameters have yet to explain: any other number,
    such as More's factor itself (1978, sec. 3), would have a unit.

    Parameters
    ----------
    influence, residual : ndarray, shapes (p,) and (n,)
        Norm of each column of the Jacobian times the parameter; residual.
    """
    length, left = length_of(influence), float(np.linalg.norm(residual))
    return length if length > EPS * left else left


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


#: share of the full Gauss-Newton step, and scaled length relative to the parameters, within
#: which no smooth model turns its gradient
SHORT = 0.01
SMALL = 1e-3

#: shares of the step along the surface that are tried
SHARES = (1.0, 0.25, 0.06)


def turned(before: Array, after: Array, step: Array) -> bool:
    """Whether the cost falls at the beginning of a step and rises at its end.

    After a step too short for that there is a kink in between: a gradient that is merely
    wrong, or noisy, points the same way on both sides.

    Parameters
    ----------
    before, after, step : ndarray, shape (p,)
        Gradient of the cost at both ends, and the way between them.
    """
    return float(before @ step) < 0 < float(after @ step)


def step_along(
    jacobian: Array, residual: Array, scale: Array, held: NDArray[np.bool_], jump: Array
) -> Array:
    """Gauss-Newton step that stays on the surface, shape (p,).

    Parameters
    ----------
    jacobian, residual : ndarray, shapes (n, p) and (n,)
        On either side.
    scale, jump : ndarray, shape (p,)
        Scale of the parameters, and difference of the gradients on both sides.
    held : ndarray of bool, shape (p,)
        Parameters that do not move.
    """
    free, step = ~held, np.zeros(scale.size)
    if np.count_nonzero(free) < 2:
        return step
    normal = (jump / scale)[free]
    frame = np.linalg.qr(np.column_stack([normal, np.eye(normal.size)]))[0][:, 1:]
    own = (jacobian / scale)[:, free] @ frame
    step[free] = frame @ np.linalg.lstsq(own, -residual, rcond=1e-10)[0] / scale[free]
    return step
