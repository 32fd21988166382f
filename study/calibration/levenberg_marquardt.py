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
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from study.arrays import Array
from study.calibration.function import Function, checked_bounds, evaluate
from study.calibration.iteration import (
    EPS,
    SHARES,
    SHORT,
    SMALL,
    Iteration,
    State,
    Status,
    step_along,
    turned,
)
from study.calibration.trust_region_step import Linearization, bounded_step, length_of

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
        ends ``at_edge``; for models whose evaluations are dear, which also end ``at_kink`` as
        soon as the kink is seen.
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
    state = State.at_start(first, *evaluated, resume)
    with np.errstate(over="ignore"):  # a full step can be infinite: it is damped then
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
        # a full step that failed far inside the region must not be tried a second time
        reach = length if damping == 0 and gain <= ACCEPTED else 10 * length
        return shrink * min(radius, reach)
    if damping == 0 or gain >= 0.75:
        return 2 * length
    return radius


def _search(
    function: Function,
    state: State,
    low: Array,
    high: Array,
    max_evaluations: int,
    tolerances: tuple[float, float, float, float],
    callback: Callback | None,
) -> tuple[Status, float, NDArray[np.bool_]]:
    ftol, xtol, gtol, edge = tolerances
    while True:
        held = state.held_by_bounds(low, high)
        linear = Linearization.of(state.jacobian[:, ~held], state.residual, state.scale[~held])
        state.rank = max(state.rank, linear.rank + int(held.sum()))
        state.history.append(state.snapshot(linear.offset))
        state.failures.append(len(state.failed))
        status = state.converged(linear, held, xtol, gtol)
        if status is None and state.is_crawling(edge):
            status = Status.at_edge
        if status is None and callback is not None and callback(state.history[-1]):
            status = Status.stopped
        if status is None:
            limits = (low, high, max_evaluations)
            status = _advance(function, state, held, linear, limits, ftol, edge)
        if status is not None:
            return state.trusted(status, linear, held), linear.offset, held


def _advance(
    function: Function,
    state: State,
    held: NDArray[np.bool_],
    linear: Linearization,
    limits: tuple[Array, Array, int],
    ftol: float,
    edge: float,
) -> Status | None:
    """Try steps in a shrinking region until one lowers the cost; the reason if none does."""
    low, high, max_evaluations = limits
    answered = False
    while state.evaluations < max_evaluations:
        step, damping = bounded_step(
            state.jacobian, state.residual, state.scale, state.radius, held, low - state.x,
            high - state.x, linear,
        )  # fmt: skip
        trial = np.clip(state.x + step, low, high)
        length = length_of(state.scale * step)
        if state.is_negligible(trial - state.x):
            return _no_step(state, linear, held, answered, (ftol, edge))
        evaluated = evaluate(function, trial)
        state.evaluations += 1
        answered = answered or evaluated is not None
        if evaluated is None:
            state.failed.append(trial)
        gain = state.gain(step, evaluated)
        state.radius, state.damping = updated_radius(state.radius, length, gain, damping), damping
        if evaluated is not None and gain > ACCEPTED:
            state.accept(trial, *evaluated)
            return None
        if linear.offset**2 <= ftol and answered and damping == 0:
            return Status.converged_cost
        short = 0 < length <= min(SHORT * linear.full_length, SMALL * state.length(held))
        if short and evaluated is not None:
            before, after = state.jacobian.T @ state.residual, evaluated[1].T @ evaluated[0]
            state.kink = turned(before, after, step)
            if state.kink and _moved_along(function, state, held, after - before, limits, edge):
                return None
        if state.kink and edge > 0:
            return Status.converged_cost if _is_near_enough(linear, edge) else Status.at_kink
    return Status.max_evaluations


def _no_step(
    state: State,
    linear: Linearization,
    held: NDArray[np.bool_],
    answered: bool,
    tolerances: tuple[float, float],
) -> Status:
    ftol, edge = tolerances
    if not answered and state.is_beside_failure():
        return Status.too_many_failures
    # at a minimum rounding hides any decrease below about sqrt(eps) of the residual
    if linear.offset**2 <= HIDDEN * ftol or _is_near_enough(linear, edge):
        return Status.converged_cost
    if state.steepest(held) <= STATIONARY:
        return Status.converged_gradient
    if linear.full_length <= 1e-9 * state.length(held):
        return Status.converged_step
    if state.is_beside_failure():
        return Status.at_edge
    return Status.at_kink if state.kink else Status.no_decrease


def _is_near_enough(linear: Linearization, edge: float) -> bool:
    """Whether a model whose evaluations scatter is as near to its minimum as matters."""
    return edge > 0 and linear.offset <= NEGLIGIBLE_OFFSET


def _moved_along(
    function: Function,
    state: State,
    held: NDArray[np.bool_],
    jump: Array,
    limits: tuple[Array, Array, int],
    edge: float,
) -> bool:
    """Step along a kink; False if that lowers the cost by no more than ``edge`` of it."""
    low, high, _ = limits
    step = step_along(state.jacobian, state.residual, state.scale, held, jump)
    change = state.jacobian @ step
    if -float(change @ (2 * state.residual + change)) <= 2 * max(edge, EPS) * state.cost:
        return False
    for share in SHARES:
        trial = np.clip(state.x + share * step, low, high)
        evaluated = evaluate(function, trial)
        state.evaluations += 1
        if evaluated is not None and state.gain(share * step, evaluated) > ACCEPTED:
            state.radius = float(np.linalg.norm(state.scale * share * step))
            state.accept(trial, *evaluated)
            return True
    return False
