"""What a fitted surface looks like: along each factor, over two of them, and at runs left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.response_surface.emulator.blocked import BlockedEmulator
from study.response_surface.quadratic.surface import QuadraticSurface
from study.response_surface.result import SurfaceAnalysis

#: points of a profile, and along each side of a contour
POINTS = 41
GRID = 31


@dataclass(frozen=True)
class Profile:
    """The response along one factor, the others in the middle of their ranges.

    Parameters
    ----------
    factor : str
        Its name.
    setting : ndarray, shape (m,)
        Settings that were run, from the lowest to the highest, in the factor's unit.
    value, low, high : ndarray, shape (m,)
        Predictions with their 95 % intervals, in the response's unit.
    """

    factor: str
    setting: Array
    value: Array
    low: Array
    high: Array

    @property
    def range(self) -> float:
        """Largest minus smallest prediction."""
        return float(np.ptp(self.value))


@dataclass(frozen=True)
class Contour:
    """The response over two factors, the others in the middle of their ranges.

    Parameters
    ----------
    factors : tuple of str
        Along x and along y.
    x, y : ndarray, shapes (m,) and (n,)
        Settings.
    value : ndarray, shape (n, m)
        Predictions in the response's unit.
    runs : ndarray, shape (r, 2)
        Settings of the runs, whatever the others were.
    """

    factors: tuple[str, str]
    x: Array
    y: Array
    value: Array
    runs: Array


@dataclass(frozen=True)
class LeftOut:
    """Every run, and what all the others predict of it; shape (n,) each."""

    observed: Array
    predicted: Array


def profiles(found: SurfaceAnalysis) -> tuple[Profile, ...]:
    """Profile of every factor, in the order of the factors.

    Parameters
    ----------
    found : SurfaceAnalysis
        With k factors.

    Returns
    -------
    tuple of Profile
        One a factor.
    """
    return tuple(_profile(found, j) for j in range(len(found.runs.factors)))


def strongest(found: SurfaceAnalysis) -> tuple[str, ...]:
    """Names of the factors, the one that moves the response most first.

    Parameters
    ----------
    found : SurfaceAnalysis
        Ranked by its sensitivities where it has some, else by the range of each profile.
    """
    if found.sensitivity:
        return tuple(i.factor for i in sorted(found.sensitivity, key=lambda i: i.rank))
    return tuple(p.factor for p in sorted(profiles(found), key=lambda p: -p.range))


def contour(found: SurfaceAnalysis, factors: Sequence[str]) -> Contour:
    """Surface over two factors.

    Parameters
    ----------
    found : SurfaceAnalysis
        With two factors or more.
    factors : sequence of str
        Two of the surface's factors: along x, along y.
    """
    runs = found.runs
    i, j = (runs.names.index(name) for name in factors)
    across, up = _coded(runs.coded[:, i], GRID), _coded(runs.coded[:, j], GRID)
    points = np.zeros((GRID, GRID, len(runs.factors)))
    points[..., i] = across[np.newaxis, :]
    points[..., j] = up[:, np.newaxis]
    value, _ = found.model.predict(points.reshape(GRID * GRID, -1))
    pair = (runs.factors[i], runs.factors[j])
    settings = [np.array([f.setting(float(x)) for x in runs.coded[:, k]])
                for f, k in zip(pair, (i, j), strict=True)]  # fmt: skip
    return Contour(
        (pair[0].name, pair[1].name),
        np.array([pair[0].setting(float(x)) for x in across]),
        np.array([pair[1].setting(float(x)) for x in up]),
        np.asarray(value).reshape(GRID, GRID),
        np.column_stack(settings),
    )


def left_out(found: SurfaceAnalysis) -> LeftOut | None:
    """Leave-one-out predictions; None where no run can be left out.

    Parameters
    ----------
    found : SurfaceAnalysis
        Its runs are told, but for those that a quadratic surface cannot leave out.
    """
    model = found.model
    if isinstance(model, QuadraticSurface):
        if model.loo is None:
            return None
        known = np.isfinite(model.loo.errors)
        observed = model.loo.observed[known]
        return LeftOut(observed, observed - model.loo.errors[known])
    each = model.each if isinstance(model, BlockedEmulator) else (model,)
    observed = np.concatenate([one.runs.response for one in each])
    return LeftOut(observed, observed - model.loo_errors)


def _profile(found: SurfaceAnalysis, j: int) -> Profile:
    runs = found.runs
    coded = np.zeros((POINTS, len(runs.factors)))
    coded[:, j] = _coded(runs.coded[:, j], POINTS)
    value, half = found.model.predict(coded)
    factor = runs.factors[j]
    setting = np.array([factor.setting(float(x)) for x in coded[:, j]])
    return Profile(factor.name, setting, value, value - half, value + half)


def _coded(column: Array, points: int) -> Array:
    return np.linspace(float(column.min()), float(column.max()), points)
