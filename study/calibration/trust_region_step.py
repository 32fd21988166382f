"""The damped linear least-squares problem inside a trust region, with bounds."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from study.arrays import Array


@dataclass(frozen=True)
class Linearization:
    """Jacobian reduced by a column-scaled QR, its triangle by SVD: every step is cheap.

    Columns of unit length decide the rank and the full step, because the running maximum of
    the norms, which shapes the trust region, can exceed today's norms by many digits.

    Parameters
    ----------
    full_step : ndarray, shape (p,)
        Undamped (Gauss-Newton) step, of least length where the rank is deficient.
    full_length : float
        Its scaled length.
    offset : float
        Share of the residual that lies in the space of the Jacobian.
    rank : int
        Numerical rank.
    scale, singular, right, load : ndarray
        Column scale D, singular values and right vectors (rows) of J D^-1, and the residual
        in its left vectors.
    """

    full_step: Array
    full_length: float
    offset: float
    rank: int
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
        kept = singular > max(jacobian.shape) * np.finfo(float).eps * singular.max()
        unit = -(right[kept].T @ (load[kept] / singular[kept]))
        length = float(np.linalg.norm(residual))
        offset = float(np.linalg.norm(load[kept])) / length if length else 0.0
        left, singular, right = np.linalg.svd(triangle * (norms / scale), full_matrices=False)
        return cls(
            unit / norms,
            length_of(scale / norms * unit),
            offset,
            int(kept.sum()),
            scale,
            singular,
            right,
            left.T @ projected,
        )


def length_of(vector: Array) -> float:
    """Euclidean length without overflow or underflow of the squares.

    Parameters
    ----------
    vector : ndarray, shape (n,)
        Of any magnitude.
    """
    return math.hypot(*vector)


def damped_step(linear: Linearization, radius: float) -> tuple[Array, float]:
    """Levenberg-Marquardt step of scaled length at most 1.1 ``radius``, and its damping.

    The step p minimizes |J p + r|^2 + damping |D p|^2; damping solves |D p| = radius to 10 %
    by Hebden's iteration (More 1978, sec. 5), safeguarded by a bracket. The iteration sees
    lengths over the gradient's, so that no magnitude of the residual overflows in it.

    Parameters
    ----------
    linear : Linearization
        Of the parameters that may move.
    radius : float
        Of the trust region, in the scaled length ``|D p|``.

    Returns
    -------
    step : ndarray, shape (p,)
    damping : float
        0 for the full step.
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


def bounded_step(
    jacobian: Array,
    residual: Array,
    scale: Array,
    radius: float,
    held: NDArray[np.bool_],
    low: Array,
    high: Array,
    linear: Linearization,
) -> tuple[Array, float]:
    """Damped step in the free parameters; one that would cross its bound stops there.

    The others are then solved again with that part of the step given, at most p times.

    Parameters
    ----------
    jacobian, residual, scale : ndarray
        Linear model at the point, shapes (n, p), (n,), (p,).
    radius : float
        Scaled radius of the trust region.
    held : ndarray of bool, shape (p,)
        Parameters that stay where they are.
    low, high : ndarray, shape (p,)
        Bounds relative to the point.
    linear : Linearization
        Of the free columns.

    Returns
    -------
    step : ndarray, shape (p,)
    damping : float
    """
    step, free = np.zeros(scale.size), ~held
    while True:
        step[free], damping = damped_step(linear, radius)
        crossing = free & ((step < low) | (step > high))
        if not np.any(crossing):
            return step, damping
        step[crossing] = np.clip(step, low, high)[crossing]
        free = free & ~crossing
        if not np.any(free):
            return step, damping
        given = residual + jacobian[:, ~free] @ step[~free]
        linear = Linearization.of(jacobian[:, free], given, scale[free])
