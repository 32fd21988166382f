"""Accuracy against cost: which discretization reaches a wanted error with the least work."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class CostPoint:
    """One mesh of one discretization: relative error and seconds."""

    mesh_size: float
    error: float
    seconds: float


@dataclass(frozen=True)
class CostToAccuracy:
    """Seconds that a discretization (a cell of a study) needs for a wanted relative error."""

    cell: str
    #: None where its meshes are too few or do not get better.
    seconds: float | None
    mesh_size: float | None
    #: ``"between meshes"``, ``"coarsest mesh"`` (it is better than wanted), or ``"extrapolated"``
    #: (finer than any that was solved).
    how: str


def cost_to_accuracy(
    fronts: Mapping[str, Sequence[CostPoint]], accuracy: float
) -> list[CostToAccuracy]:
    """Rank discretizations by the seconds that an accuracy takes, cheapest first.

    Error against seconds is a straight line in logarithms, piece by piece.

    Examples
    --------
    >>> line = [CostPoint(1.0, 0.04, 1.0), CostPoint(0.5, 0.01, 4.0)]
    >>> found = cost_to_accuracy({"P2": line}, 0.02)[0]
    >>> round(found.seconds, 6), round(found.mesh_size, 6), found.how
    (2.0, 0.707107, 'between meshes')
    """
    costs = [_one(name, points, accuracy) for name, points in fronts.items()]
    return sorted(costs, key=lambda row: math.inf if row.seconds is None else row.seconds)


def _one(name: str, points: Sequence[CostPoint], accuracy: float) -> CostToAccuracy:
    ordered = sorted(points, key=lambda p: -p.mesh_size)
    good = [p for p in ordered if p.error > 0 and p.seconds > 0]
    if not good:
        return CostToAccuracy(name, None, None, "no mesh gave an answer")
    # from here on every finer mesh is at least as good
    first = len(good) - 1
    while first > 0 and good[first - 1].error <= accuracy:
        first -= 1
    if good[first].error <= accuracy:
        if first == 0:
            return CostToAccuracy(name, good[0].seconds, good[0].mesh_size, "coarsest mesh")
        return _between(name, good[first - 1], good[first], accuracy, "between meshes")
    if len(good) < 2 or good[-1].error >= good[-2].error:
        return CostToAccuracy(name, None, None, "its meshes do not get better")
    return _between(name, good[-2], good[-1], accuracy, "extrapolated")


def _between(
    name: str, coarse: CostPoint, fine: CostPoint, accuracy: float, how: str
) -> CostToAccuracy:
    share = math.log(accuracy / coarse.error) / math.log(fine.error / coarse.error)
    seconds = coarse.seconds * (fine.seconds / coarse.seconds) ** share
    size = coarse.mesh_size * (fine.mesh_size / coarse.mesh_size) ** share
    return CostToAccuracy(name, float(seconds), float(size), how)


def reference_value(
    candidates: Sequence[tuple[float | None, float | None]],
) -> tuple[float | None, float | None]:
    """Best limit of several series of one quantity: that with the smallest uncertainty."""
    bounded = [(u, limit) for limit, u in candidates if limit is not None and u is not None]
    if not bounded:
        return None, None
    u, limit = min(bounded)
    return float(limit), float(u)
