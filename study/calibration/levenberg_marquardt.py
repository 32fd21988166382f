"""Levenberg-Marquardt for nonlinear least squares, after More (1978).

Two parts: :func:`damped_step` solves the damped linear problem inside the trust region, by
QR of the column-scaled Jacobian (never its normal equations), and :func:`updated_radius`
grows or shrinks the region by how well the linear model foretold the decrease. Columns are
scaled by the running maximum of their norms (More 1978, eq. 6.1), which makes every result
independent of the parameters' units. Convergence is judged by the full Gauss-Newton step
(Bates and Watts 1981), not by the damped one, which also gets small where nothing converges.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from study.calibration.damped import Linearization, bounded_step
from study.calibration.evaluation import Function, checked_bounds, evaluate
from study.calibration.status import Status

Array = NDArray[np.float64]

EPS = float(np.finfo(float).eps)
#: first trust-region radius as a multiple of the start's scaled length
FIRST_RADIUS = 1.0
#: cosine below which a point where no step helps is a minimum with a singular Jacobian
STATIONARY = 1e-6
#: scaled distance, relative to the parameters, at which a failed evaluation counts as next door
NEXT_DOOR = 0.01
#: accepted steps over which a search that creeps along failures is judged
CRAWL = 5
#: growth of a parameter over its start that counts as running to infinity
FAR = 1e8


@dataclass(frozen=True)
class Iteration:
    """One accepted point: what a progress line shows and what a resumed fit needs."""

    iteration: int
    evaluations: int
    x: Array
    cost: float
    radius: float
    damping: float
    offset: float
    scale: Array


Callback = Callable[[Iteration], bool | None]


@dataclass(frozen=True)
class LMResult:
    """Where the optimizer ended.

    Parameters
    ----------
    x : ndarray, shape (p,)
        Best point found, whatever the status.
    cost : float
        Half the sum of squared residuals.
    residual : ndarray, shape (n,)
        Residual at ``x``.
    jacobian : ndarray, shape (n, p)
        Its derivative at ``x``.
    status : Status
        How it ended; only a ``converged_*`` status is a success.
    evaluations, iterations : int
        Calls of the function; accepted steps.
    offset : float
        Share of the residual that the parameters could still explain (0 at a minimum).
    at_bound : ndarray of bool, shape (p,)
        Parameters held by a bound.
    history : tuple of Iteration
        The accepted points; the last one resumes the fit.
    """

    x: Array
    cost: float
    residual: Array
    jacobian: Array
    status: Status
    evaluations: int
    iterations: int
    offset: float
    at_bound: NDArray[np.bool_]
    history: tuple[Iteration, ...] = ()

    @property
    def converged(self) -> bool:
        """Whether a local minimum was reached."""
        return self.status.converged


@dataclass
class _State:
    """The search in progress."""

    x: Array
    residual: Array
    jacobian: Array
    scale: Array
    reach: Array
    peak: Array
    radius: float
    rank: int = 0
    damping: float = 0.0
    evaluations: int = 1
    history: list[Iteration] = field(default_factory=list)
    failed: list[Array] = field(default_factory=list)
    failures: list[int] = field(default_factory=list)

    @property
    def cost(self) -> float:
        return 0.5 * float(self.residual @ self.residual)


def levenberg_marquardt(
    function: Function,
    start: ArrayLike,
    *,
    bounds: Sequence[tuple[float, float]] | None = None,
    max_evaluations: int = 1000,
    ftol: float = 1e-12,
    xtol: float = 1e-12,
    gtol: float = 1e-10,
    edge: float = 0.0,
    callback: Callback | None = None,
    resume: Iteration | None = None,
) -> LMResult:
    """Minimize half the sum of squares of a residual.

    Parameters
    ----------
    function : callable
        ``x (p,) -> (residual (n,), jacobian (n, p))``; raises
        :class:`study.calibration.EvaluationFailed`, or returns numbers that are not finite,
        where the model has no answer: a rejected step.
    start : array_like, shape (p,)
        Start values, inside the bounds.
    bounds : sequence of (low, high), optional
        Bounds of every parameter; infinite where there is none.
    max_evaluations : int
        Calls of the function allowed.
    ftol : float
        Relative decrease that the full step may still promise when nothing lowers the cost.
    xtol : float
        Full Gauss-Newton step, relative to the parameters, at which the search ends.
    gtol : float
        Relative offset (Bates and Watts 1981): length of the residual's projection on the
        space of the Jacobian over the length of the residual.
    edge : float
        Relative decrease that five accepted steps beside failed ones must bring, or the search
        ends ``at_edge``; for models whose evaluations are dear.
    callback : callable, optional
        Gets every accepted :class:`Iteration`; returning True stops the search.
    resume : Iteration, optional
        Continue from an earlier search's last accepted point instead of ``start``.

    Returns
    -------
    LMResult

    Raises
    ------
    InputError
        If the start is not finite or lies outside the bounds.
    """
    first = np.array(start if resume is None else resume.x, dtype=float)
    low, high = checked_bounds(first, bounds)
    evaluated = evaluate(function, first)
    if evaluated is None:
        empty = np.zeros((0, first.size))
        none = np.zeros(first.size, bool)
        return LMResult(first, np.inf, empty[:, 0], empty, Status.start_failed, 1, 0, np.inf, none)
    state = _first_state(first, *evaluated, resume)
    status, offset, held = _search(
        function, state, low, high, max_evaluations, (ftol, xtol, gtol, edge), callback
    )
    return LMResult(
        state.x,
        state.cost,
        state.residual,
        state.jacobian,
        status,
        state.evaluations,
        len(state.history) - 1,
        offset,
        held,
        tuple(state.history),
    )


def updated_radius(radius: float, length: float, gain: float, damping: float) -> float:
    """Grow or shrink the trust region by the gain ratio (More 1978, sec. 4).

    Parameters
    ----------
    radius, length : float
        Radius of the region and scaled length of the step that was tried.
    gain : float
        Actual over foretold decrease of the cost; ``-inf`` where the evaluation failed.
    damping : float
        Damping of that step; zero for a full Gauss-Newton step.
    """
    if gain <= 0.25:
        # the parabola through both costs and the slope has its minimum at 1/(2 (2 - gain))
        shrink = 0.1 if not np.isfinite(gain) else min(max(0.5 / (2 - gain), 0.1), 0.5)
        return shrink * min(radius, 10 * length)
    if damping == 0 or gain >= 0.75:
        return 2 * length
    return radius


def _search(
    function: Function,
    state: _State,
    low: Array,
    high: Array,
    max_evaluations: int,
    tolerances: tuple[float, float, float, float],
    callback: Callback | None,
) -> tuple[Status, float, NDArray[np.bool_]]:
    ftol, xtol, gtol, edge = tolerances
    while True:
        held = _held(state, low, high)
        linear = Linearization.of(state.jacobian[:, ~held], state.residual, state.scale[~held])
        state.rank = max(state.rank, linear.rank + int(held.sum()))
        state.history.append(_snapshot(state, linear.offset))
        state.failures.append(len(state.failed))
        status = _converged(state, linear, held, xtol, gtol)
        if status is None and _crawling(state, edge):
            status = Status.at_edge
        if status is None and callback is not None and callback(state.history[-1]):
            status = Status.stopped
        if status is None:
            status = _advance(function, state, held, linear, low, high, max_evaluations, ftol)
        if status is not None:
            return _trusted(status, state, linear, held), linear.offset, held


def _advance(
    function: Function,
    state: _State,
    held: NDArray[np.bool_],
    linear: Linearization,
    low: Array,
    high: Array,
    max_evaluations: int,
    ftol: float,
) -> Status | None:
    """Try steps in a shrinking region until one lowers the cost; the reason if none does."""
    answered = False
    while state.evaluations < max_evaluations:
        step, damping = bounded_step(
            state.jacobian, state.residual, state.scale, state.radius, held, low - state.x,
            high - state.x, linear,
        )  # fmt: skip
        trial = np.clip(state.x + step, low, high)
        length = float(np.linalg.norm(state.scale * step))
        if np.all(np.abs(trial - state.x) <= 2 * EPS * np.abs(state.x)):
            return _no_step(state, linear, held, answered, ftol)
        evaluated = evaluate(function, trial)
        state.evaluations += 1
        answered = answered or evaluated is not None
        if evaluated is None:
            state.failed.append(trial)
        gain = _gain(state, step, evaluated)
        state.radius, state.damping = updated_radius(state.radius, length, gain, damping), damping
        if evaluated is not None and gain > 1e-4:
            _accept(state, trial, *evaluated)
            return None
        if linear.offset**2 <= ftol and answered and damping == 0:
            return Status.converged_cost
    return Status.max_evaluations


def _no_step(
    state: _State, linear: Linearization, held: NDArray[np.bool_], answered: bool, ftol: float
) -> Status:
    if not answered:
        return Status.too_many_failures
    # at a minimum rounding hides any decrease below about sqrt(eps) of the residual
    if linear.offset**2 <= ftol:
        return Status.converged_cost
    if _steepest(state, held) <= STATIONARY:
        return Status.converged_gradient
    if linear.full_length <= 1e-9 * _size(state, held):
        return Status.converged_step
    return Status.at_edge if _beside_failure(state) else Status.no_decrease


def _beside_failure(state: _State) -> bool:
    """Whether the model had no answer at constants next to the best ones."""
    size = float(np.linalg.norm(state.scale * state.x))
    distances = [float(np.linalg.norm(state.scale * (x - state.x))) for x in state.failed]
    return min(distances, default=np.inf) <= NEXT_DOOR * size


def _crawling(state: _State, edge: float) -> bool:
    """Whether the search creeps along constants at which the model has no answer."""
    if len(state.history) <= CRAWL:
        return False
    gained = state.history[-1 - CRAWL].cost - state.cost
    blocked = state.failures[-1] - state.failures[-1 - CRAWL]
    return gained < edge * state.cost and blocked >= 2 and _beside_failure(state)


def _steepest(state: _State, held: NDArray[np.bool_]) -> float:
    """Largest cosine between the residual and a column of the Jacobian."""
    norms = np.linalg.norm(state.jacobian, axis=0) * float(np.linalg.norm(state.residual))
    slopes = np.abs(state.jacobian.T @ state.residual)
    return float(np.max(np.where(held | (norms == 0), 0.0, slopes / norms), initial=0.0))


def _size(state: _State, held: NDArray[np.bool_]) -> float:
    return float(np.linalg.norm((state.scale * state.x)[~held]))


def _converged(
    state: _State, linear: Linearization, held: NDArray[np.bool_], xtol: float, gtol: float
) -> Status | None:
    length = float(np.linalg.norm(state.residual))
    influence = float(np.linalg.norm(state.jacobian, axis=0) @ np.abs(state.x))
    if length <= EPS * influence or length == 0:
        return Status.converged_zero
    if linear.offset <= gtol:
        return Status.converged_gradient
    if linear.full_length <= xtol * _size(state, held):
        return Status.converged_step
    return None


def _trusted(
    status: Status, state: _State, linear: Linearization, held: NDArray[np.bool_]
) -> Status:
    """No success where a parameter, or a combination, lost the influence it once had."""
    first = np.abs(state.history[0].x)
    if status is Status.no_decrease and np.any((np.abs(state.x) > FAR * first) & (first > 0)):
        return Status.running_away
    norms = np.linalg.norm(state.jacobian, axis=0)
    length = float(np.linalg.norm(state.residual))
    lost = (norms * state.reach <= 1e-8 * length) & (state.peak > norms) & ~held
    singular = linear.rank + int(held.sum()) < state.rank
    doubtful = status.converged and status is not Status.converged_zero
    return Status.no_influence if doubtful and (singular or np.any(lost)) else status


def _gain(state: _State, step: Array, evaluated: tuple[Array, Array] | None) -> float:
    """Actual over foretold decrease of the sum of squares."""
    if evaluated is None:
        return -np.inf
    change = state.jacobian @ step
    foretold = -float(change @ (2 * state.residual + change))
    new = evaluated[0]
    # (r - s)(r + s) keeps the digits that the difference of two sums of squares loses
    actual = float((state.residual - new) @ (state.residual + new))
    return actual / foretold if foretold > 0 else -np.inf


def _accept(state: _State, x: Array, residual: Array, jacobian: Array) -> None:
    state.x, state.residual, state.jacobian = x, residual, jacobian
    norms = np.linalg.norm(jacobian, axis=0)
    state.scale, state.peak = np.maximum(state.scale, norms), np.maximum(state.peak, norms)
    state.reach = np.maximum(state.reach, np.abs(x))


def _held(state: _State, low: Array, high: Array) -> NDArray[np.bool_]:
    """Parameters at a bound that the gradient pushes against."""
    gradient = state.jacobian.T @ state.residual
    at_low = (state.x <= low) & (gradient >= 0)
    return np.asarray(at_low | ((state.x >= high) & (gradient <= 0)))


def _first_state(x: Array, residual: Array, jacobian: Array, resume: Iteration | None) -> _State:
    norms = np.linalg.norm(jacobian, axis=0)
    if resume is not None:
        scale = np.maximum(resume.scale, norms)
        return _State(x, residual, jacobian, scale, np.abs(x), scale, resume.radius)
    scale = np.where(norms > 0, norms, 1.0)
    length = float(np.linalg.norm(scale * x))
    return _State(x, residual, jacobian, scale, np.abs(x), norms, FIRST_RADIUS * (length or 1.0))


def _snapshot(state: _State, offset: float) -> Iteration:
    return Iteration(
        len(state.history),
        state.evaluations,
        state.x.copy(),
        state.cost,
        state.radius,
        state.damping,
        offset,
        state.scale.copy(),
    )
