"""State of a least-squares search, and what can be read from it: convergence, edges, limits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from study.arrays import Array
from study.calibration.trust_region_step import Linearization, length_of
from study.errors import Fault, InputError

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
    influence, residual : ndarray, shapes (p,) and (n,)
        Norm of each column of the Jacobian times the parameter; residual.
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


Function = Callable[[Array], tuple[Array, Array]]


def evaluate(function: Function, x: Array) -> tuple[Array, Array] | None:
    """Call a function for its residual and Jacobian; None where there is no finite answer.

    Parameters
    ----------
    function, x
        As :func:`study.calibration.levenberg_marquardt` takes them; ``x`` of shape (p,).
    """
    if not np.all(np.isfinite(x)):
        return None
    try:
        with np.errstate(all="ignore"):  # a far trial point may overflow: that is a rejection
            residual, jacobian = function(x.copy())
    except (EvaluationFailed, OverflowError, ZeroDivisionError):
        return None
    residual = np.asarray(residual, float).ravel()
    jacobian = np.asarray(jacobian, float).reshape(residual.size, x.size)
    if not (np.all(np.isfinite(residual)) and np.all(np.isfinite(jacobian))):
        return None
    # beyond 1e150 the squares overflow, also those of a parameter's influence on the residual
    with np.errstate(over="ignore"):
        sizes = [np.abs(part).max(initial=0) for part in (residual, jacobian, jacobian * x)]
    return (residual, jacobian) if max(sizes) <= 1e150 else None


def checked_bounds(
    start: Array, bounds: Sequence[tuple[float, float]] | None
) -> tuple[Array, Array]:
    """Check a start against its bounds and return them as two arrays.

    Parameters
    ----------
    start, bounds
        Values (p,), and a pair (low, high) for each; None where there are no bounds.

    Raises
    ------
    InputError
        Naming every start value that is not finite or lies outside its bounds.
    """
    if start.ndim != 1 or start.size == 0 or not np.all(np.isfinite(start)):
        raise InputError(Fault("start", f"must be finite numbers in a row, got {start}"))
    pairs = np.array([(-np.inf, np.inf)] * start.size if bounds is None else bounds, float)
    if pairs.shape != (start.size, 2) or np.any(pairs[:, 0] >= pairs[:, 1]):
        raise InputError(Fault("bounds", f"need low < high for {start.size} parameters"))
    outside = np.flatnonzero((start < pairs[:, 0]) | (start > pairs[:, 1]))
    if outside.size:
        raise InputError(
            [
                Fault(
                    f"start[{i}]",
                    f"{start[i]:g} lies outside its bounds {pairs[i, 0]:g} to {pairs[i, 1]:g}",
                    "start inside them or widen them",
                )
                for i in outside
            ]
        )
    return pairs[:, 0].copy(), pairs[:, 1].copy()


def finite_difference(
    function: Callable[[Array], Array],
    x: ArrayLike,
    *,
    scheme: str = "central",
    relative_step: float | None = None,
    base: Array | None = None,
) -> Array:
    """Jacobian of a function that has no gradient, by differences, shape (n, p).

    Parameters
    ----------
    function : callable
        ``x (p,) -> values (n,)``.
    x : array_like, shape (p,)
        Where.
    scheme : str
        ``central`` (2p calls) or ``forward`` (p calls and ``base``).
    relative_step : float, optional
        Step over max(|x|, 1e-8 of the largest |x|); by default eps^(1/3) or eps^(1/2), which
        balance truncation with rounding of a function exact to eps.
    base : ndarray, shape (n,), optional
        ``function(x)`` if it is known already (forward differences).
    """
    point = np.asarray(x, dtype=float)
    eps = float(np.finfo(float).eps)
    power = 1 / 3 if scheme == "central" else 1 / 2
    relative = eps**power if relative_step is None else relative_step
    size = np.maximum(np.abs(point), 1e-8 * (np.abs(point).max(initial=0.0) or 1.0))
    columns = []
    forward = scheme == "forward"
    origin = (function(point) if base is None else base) if forward else np.zeros(0)
    for i, step in enumerate(relative * size):
        ahead, behind = point.copy(), point.copy()
        ahead[i] += step
        behind[i] -= step
        if forward:
            columns.append((function(ahead) - origin) / (ahead[i] - point[i]))
        else:
            columns.append((function(ahead) - function(behind)) / (ahead[i] - behind[i]))
    return np.array(columns).T


class EvaluationFailed(Exception):
    """The model has no answer at these constants; the optimizer rejects the step."""


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
