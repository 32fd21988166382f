"""Coordinates in which gmsh meshes a body, wherever and however it lies in its file.

gmsh decides by comparisons, which the last digit of a coordinate can turn: a sphere that was moved
by whole millimetres had other tetrahedra and a force 1.3 % away, and so it had on a processor that
adds in another order. Here the body is turned about its loading axis to an orientation that its
shape gives, its coordinates are rounded to a power of two, and its corners and triangles are put
into the order of these.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import numpy as np

from study.arrays import Array
from study.surface.surface import Body

#: binary digits of the rounded coordinates: 2e-7 of the extent, below the digits of a scan and far
#: above rounding; more where corners would fall together
_DIGITS = (22, 32, 42)

#: the extent is taken so much larger, lest one that is a power of two is at a border
_LARGER = 1.37

#: share of its sum of weights from which an angular moment gives the orientation, and the highest
_CLEAR = 0.01
_HIGHEST = 400

#: moments beyond it that tell equal parts of a turn apart
_FURTHER = 8

#: difference over the largest value below which two orientations count as equal
_EQUAL = 1e-7

#: equal orientations of a symmetric body that are told apart by their triangles
_COMPARED = 16


@dataclass(frozen=True)
class StandardFrame:
    """A body as gmsh is given it, and the way back.

    ``cosine`` and ``sine`` are those of the turn from the body to its standard orientation, and
    ``stretch`` is the rounded height over that of the body.
    """

    body: Body
    cosine: float
    sine: float
    stretch: float

    def back(self, points: Array) -> Array:
        """Points of the standard frame in the body's coordinates, shape (n, 3)."""
        x, y, z = points.T
        c, s = self.cosine, self.sine
        turned = np.column_stack([c * x - s * y, s * x + c * y]) / (c**2 + s**2)
        return np.column_stack([turned, z / self.stretch])


@functools.lru_cache(maxsize=8)
def standard_frame(body: Body, seed: int | None = None) -> StandardFrame:
    """Turn, round and sort a body; a seed turns it further by an angle drawn at random.

    The meshes of two seeds are equally good, and differ as those of two generators would.
    """
    further = 0.0 if seed is None else np.random.default_rng(seed).uniform(0.0, 2 * np.pi)
    frames = [_turned(body, angle + further) for angle in _orientations(body)[:_COMPARED]]
    return min(frames, key=lambda frame: frame.body.triangles.tolist())


def _turned(body: Body, angle: float) -> StandardFrame:
    """Frame of a body that is turned back by an angle (rad)."""
    # rounded, so that the angle has no last digits either
    c, s = (float(np.round(f(angle), 12)) for f in (np.cos, np.sin))
    x, y, z = body.points.T
    points = _rounded(np.column_stack([c * x + s * y, c * y - s * x, z]))
    order = np.lexsort(points.T[::-1])
    number = np.empty_like(order)
    number[order] = np.arange(order.size)
    triangles = number[body.triangles]
    first = triangles.argmin(axis=1)
    triangles = triangles[np.arange(len(first))[:, None], (first[:, None] + np.arange(3)) % 3]
    rows = np.lexsort(triangles.T[::-1])
    standard = replace(
        body, points=points[order], triangles=triangles[rows],
        top=body.top[rows], base=body.base[rows],
    )  # fmt: skip
    return StandardFrame(standard, c, s, standard.height_mm / body.height_mm)


def _rounded(points: Array) -> Array:
    """Coordinates that are multiples of a power of two, no two points at the same place."""
    exponent = np.ceil(np.log2(_LARGER * np.ptp(points, axis=0).max()))
    for digits in _DIGITS:
        step = 2.0 ** (exponent - digits)
        rounded = np.round(points / step) * step + 0.0  # no negative zeros
        if len(np.unique(rounded, axis=0)) == len(points):
            return np.asarray(rounded)
    return points


def _orientations(body: Body) -> Array:
    """Angles of the body about its loading axis (rad): several where its shape is symmetric.

    The first angular moment that is not small gives the angle up to a part of a turn. Which part,
    the place of the loading axis and the other moments tell.
    """
    middle = body.points[:, :2].mean(axis=0)
    away = (body.points[:, :2] - middle) @ np.array([1.0, 1.0j])
    size, weight = float(np.abs(away).max()), np.abs(away) * (1 + body.points[:, 2])
    unit = away / np.maximum(np.abs(away), 1e-300)
    powers, moments = weight.astype(complex), list[complex]()
    while len(moments) < _HIGHEST and (not moments or abs(moments[-1]) < _CLEAR):
        powers = powers * unit
        moments.append(complex(powers.sum()) / float(weight.sum()))
    fold = len(moments)
    if abs(moments[-1]) < _CLEAR:
        return np.zeros(1)
    # half a part further from three on, so that the sides of a square lie along the axes
    angles = (np.angle(moments[-1]) + np.pi * (fold > 2) + 2 * np.pi * np.arange(fold)) / fold
    for _ in range(_FURTHER):
        powers = powers * unit
        moments.append(complex(powers.sum()) / float(weight.sum()))
    for m, moment in [(1, complex(*-middle) / size), *enumerate(moments, 1)]:
        turned = moment * np.exp(-1j * m * angles)
        angles = angles[turned.real > turned.real.max() - _EQUAL]
        turned = moment * np.exp(-1j * m * angles)
        angles = angles[turned.imag > turned.imag.max() - _EQUAL]
    return np.asarray(angles)
