"""The function that is fitted: its calls, its bounds, and its derivatives by differences."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from study.arrays import Array
from study.errors import Fault, InputError

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
