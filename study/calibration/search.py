"""State of a least-squares search, and what can be read from it: convergence, edges, limits."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from study.calibration.damped import Linearization, length_of
from study.calibration.status import Status

Array = NDArray[np.float64]

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
    """The search in progress."""

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


def first_state(x: Array, residual: Array, jacobian: Array, resume: Iteration | None) -> State:
    """State at the start, or where an earlier search stopped."""
    norms = np.linalg.norm(jacobian, axis=0)
    if resume is not None:
        peak = np.maximum(resume.scale, norms)
        return State(x, residual, jacobian, np.abs(x), peak, resume.radius)
    radius = FIRST_RADIUS * size(norms * x, residual)
    return State(x, residual, jacobian, np.abs(x), norms, radius)


def size(influence: Array, residual: Array) -> float:
    """Length of parameters in the unit of the residual: what steps and radii are relative to.

    Parameters without influence within the rounding of the residual are as good as zero. Their
    length is that of the residual, which the parameters have yet to explain: any other number,
    such as More's factor itself (1978, sec. 3), would have a unit.

    Parameters
    ----------
    influence : ndarray, shape (p,)
        Norm of each column of the Jacobian times the parameter.
    residual : ndarray, shape (n,)
        Residual.
    """
    length, left = length_of(influence), float(np.linalg.norm(residual))
    return length if length > EPS * left else left


def negligible(state: State, step: Array) -> bool:
    """Whether a step changes the residual by less than the parameters' own rounding does."""
    norms = np.linalg.norm(state.jacobian, axis=0)
    return length_of(norms * step) <= 2 * EPS * size(norms * state.x, state.residual)


def snapshot(state: State, offset: float) -> Iteration:
    """Make the accepted point for the history."""
    return Iteration(
        len(state.history),
        state.evaluations,
        state.x.copy(),
        state.cost,
        state.radius,
        state.damping,
        offset,
        state.peak.copy(),
    )


def accept(state: State, x: Array, residual: Array, jacobian: Array) -> None:
    """Move to a better point."""
    state.x, state.residual, state.jacobian = x, residual, jacobian
    state.peak = np.maximum(state.peak, np.linalg.norm(jacobian, axis=0))
    state.reach = np.maximum(state.reach, np.abs(x))


def gain_of(state: State, step: Array, evaluated: tuple[Array, Array] | None) -> float:
    """Actual over foretold decrease of the sum of squares."""
    if evaluated is None:
        return -np.inf
    change = state.jacobian @ step
    foretold = -float(change @ (2 * state.residual + change))
    new = evaluated[0]
    # (r - s)(r + s) keeps the digits that the difference of two sums of squares loses
    actual = float((state.residual - new) @ (state.residual + new))
    return actual / foretold if foretold > 0 else -np.inf


def held_by_bounds(state: State, low: Array, high: Array) -> NDArray[np.bool_]:
    """Parameters at a bound that the gradient pushes against."""
    gradient = state.jacobian.T @ state.residual
    at_low = (state.x <= low) & (gradient >= 0)
    return np.asarray(at_low | ((state.x >= high) & (gradient <= 0)))


def size_of(state: State, held: NDArray[np.bool_]) -> float:
    """Scaled length of the parameters that may move, see :func:`size`."""
    return size((state.peak * state.x)[~held], state.residual)


def steepest(state: State, held: NDArray[np.bool_]) -> float:
    """Largest cosine between the residual and a column of the Jacobian."""
    norms = np.linalg.norm(state.jacobian, axis=0) * float(np.linalg.norm(state.residual))
    slopes = np.abs(state.jacobian.T @ state.residual)
    return float(np.max(np.where(held | (norms == 0), 0.0, slopes / norms), initial=0.0))


def beside_failure(state: State) -> bool:
    """Whether the model had no answer at constants next to the best ones."""
    reach = NEXT_DOOR * size_of(state, np.zeros(state.x.size, bool))
    return any(length_of(state.scale * (x - state.x)) <= reach for x in state.failed)


def crawling(state: State, edge: float) -> bool:
    """Whether the search creeps along constants at which the model has no answer."""
    if len(state.history) <= CRAWL:
        return False
    gained = state.history[-1 - CRAWL].cost - state.cost
    blocked = state.failures[-1] - state.failures[-1 - CRAWL]
    return gained < edge * state.cost and blocked >= 2 and beside_failure(state)


def converged_at(
    state: State, linear: Linearization, held: NDArray[np.bool_], xtol: float, gtol: float
) -> Status | None:
    """How a search has converged here; None where it has not."""
    length = float(np.linalg.norm(state.residual))
    influence = float(np.linalg.norm(state.jacobian, axis=0) @ np.abs(state.x))
    # a residual is a difference of a few terms, each with a rounding of its own
    if length <= 4 * EPS * influence or length == 0:
        return Status.converged_zero
    if linear.offset <= gtol:
        return Status.converged_gradient
    if linear.full_length <= xtol * size_of(state, held):
        return Status.converged_step
    return None


def trusted(status: Status, state: State, linear: Linearization, held: NDArray[np.bool_]) -> Status:
    """No success where a parameter, or a combination, lost the influence it once had.

    Nor where none has any: the residual is then orthogonal to nothing.
    """
    first = np.abs(state.history[0].x)
    if status is Status.no_decrease and np.any((np.abs(state.x) > FAR * first) & (first > 0)):
        return Status.running_away
    norms = np.linalg.norm(state.jacobian, axis=0)
    length = float(np.linalg.norm(state.residual))
    lost = (norms * state.reach <= 1e-8 * length) & (state.peak > norms) & ~held
    singular = linear.rank + int(held.sum()) < state.rank or not (held | (norms > 0)).any()
    doubtful = status.converged and status is not Status.converged_zero
    return Status.no_influence if doubtful and (singular or np.any(lost)) else status
