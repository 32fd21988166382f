"""Minima where the gradient jumps: contact sets in on one side of a surface of constants.

A cost that is continuous but smooth on either side only has a gradient whose jump is normal
to that surface, so that two gradients close together on both sides tell its direction. The
search can then go on along the surface (the idea of Clarke's generalized gradient: at a
minimum zero lies between the two gradients).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: share of the full Gauss-Newton step, and scaled length relative to the parameters, within
#: which no smooth model turns its gradient
SHORT, SMALL = 0.01, 1e-3
#: shares of the step along the surface that are tried
SHARES = (1.0, 0.25, 0.06)


def turned(before: Array, after: Array, step: Array) -> bool:
    """Whether the cost falls at the beginning of a step and rises at its end.

    After a step too short for that there is a kink in between: a gradient that is merely
    wrong, or noisy, points the same way on both sides.

    Parameters
    ----------
    before, after : ndarray, shape (p,)
        Gradient of the cost at both ends.
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
    scale : ndarray, shape (p,)
        Scale of the parameters.
    held : ndarray of bool, shape (p,)
        Parameters that do not move.
    jump : ndarray, shape (p,)
        Difference of the gradients on both sides.
    """
    free, step = ~held, np.zeros(scale.size)
    if np.count_nonzero(free) < 2:
        return step
    normal = (jump / scale)[free]
    frame = np.linalg.qr(np.column_stack([normal, np.eye(normal.size)]))[0][:, 1:]
    own = (jacobian / scale)[:, free] @ frame
    step[free] = frame @ np.linalg.lstsq(own, -residual, rcond=1e-10)[0] / scale[free]
    return step
