"""Pins: the fewest held unknowns that keep a whole specimen from moving as a rigid body.

Between frictionless plates nothing says where the specimen stands. As many unknowns are
held as there are rigid motions left: such a support is statically determinate, so that it
carries nothing and adds no stiffness as long as the loads balance by themselves.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: motion, over that of the largest, below which a rigid motion counts as held
_HELD = 1e-6


def rigid_motions(places: Array) -> Array:
    """List translations and rotations about the middle of some points, shape (3 n, 6)."""
    middle = (places.min(axis=0) + places.max(axis=0)) / 2
    x, y, z = (places - middle).T / float(np.ptp(places, axis=0).max())
    zero = np.zeros(len(places))
    motions = np.zeros((len(places), 3, 6))
    motions[:, :, :3] = np.eye(3)
    motions[:, :, 3] = np.column_stack([zero, -z, y])
    motions[:, :, 4] = np.column_stack([z, zero, -x])
    motions[:, :, 5] = np.column_stack([-y, x, zero])
    return motions.reshape(-1, 6)


def pins(places: Array, n_free: int, held: Mapping[int, float]) -> Ints:
    """Unknowns that have to be held besides those that are.

    Parameters
    ----------
    places : ndarray, shape (n_nodes, 3)
        Nodes.
    n_free : int
        Only the first so many nodes may be pinned (vertices; a bubble moves nothing).
    held : mapping of int to float
        Unknowns that are prescribed already.

    Returns
    -------
    ndarray of int
        At most six unknowns, chosen where they move most in the motions that are left.
    """
    motions = rigid_motions(places)
    rows = motions[sorted(held)]
    values, directions = np.linalg.eigh(rows.T @ rows) if held else (np.zeros(6), np.eye(6))
    free = directions[:, values < _HELD**2 * max(float(values.max(initial=0.0)), 1.0)]
    chosen: list[int] = []
    while free.shape[1]:
        left = motions[: 3 * n_free] @ free
        # rounded, so that equal places do not change with the last digit
        dof = int(np.round(np.linalg.norm(left, axis=1), 9).argmax())
        chosen.append(dof)
        # the motions left are those that do not move this unknown
        free = free @ np.linalg.svd(left[dof : dof + 1])[2][1:].T
    return np.array(sorted(chosen), dtype=np.int64)
