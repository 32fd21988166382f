"""The brain-shaped surface: extents, closedness, symmetry and volume known another way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from study.ground.errors import InputError
from study.mechanics.setup.geometry import Brain
from study.mechanics.surface.brain import brain_surface
from study.mechanics.surface.closed_surface import body, volume

BRAIN = Brain(80, 60, 50, fissure_mm=4, clamp_below_mm=15)


def test_extents_are_those_asked_for() -> None:
    points, triangles = brain_surface(BRAIN)
    assert points.min(axis=0) == pytest.approx([-40, -30, 0], abs=1e-12)
    assert points.max(axis=0) == pytest.approx([40, 30, 50], abs=1e-12)
    edges = len({frozenset(p) for t in triangles for p in zip(t, np.roll(t, 1), strict=True)})
    assert len(points) - edges + len(triangles) == 2  # Euler: closed and without a hole


def test_without_a_groove_it_has_the_volume_of_two_half_ellipsoids() -> None:
    # the taper moves each section sideways of y = 0 alike in front and behind: to first order it
    # keeps the volume, and its squared slope does not enter an area; widths are scaled back
    points, triangles = brain_surface(replace(BRAIN, fissure_mm=0.0))
    x = np.linspace(-1, 1, 20001)
    widest = ((1 - 0.12 * x) * np.sqrt(1 - x**2)).max()
    expected = np.pi / 6 * 80 * 60 * 50 / widest
    assert volume(points, triangles) == pytest.approx(expected, rel=2e-3)


def test_the_groove_is_as_deep_as_said() -> None:
    floor = body(replace(BRAIN, press_x_mm=0.0, press_y_mm=0.0)).axis_height_mm
    assert body(BRAIN).height_mm - floor == pytest.approx(4, abs=1e-6)


def test_both_halves_are_mirror_images() -> None:
    points, _ = brain_surface(BRAIN)
    mirrored = np.round(points * [1, -1, 1], 9) + 0.0
    assert {tuple(p) for p in mirrored} == {tuple(p) for p in np.round(points, 9) + 0.0}


def test_a_groove_that_is_too_deep_is_refused() -> None:
    with pytest.raises(InputError, match=r"(?s)specimen\.fissure.*at most 7\.5 mm"):
        body(replace(BRAIN, fissure_mm=8.0))


def test_the_height_on_an_axis_is_that_of_an_ellipsoid() -> None:
    ball = Brain(20, 20, 20)
    # upper half: 0.65 of the height above the waist at 7 mm; at (3, 0) of a 10 mm half axis
    found = body(replace(ball, press_x_mm=3.0, press_y_mm=0.0)).axis_height_mm
    assert found == pytest.approx(7 + 13 * np.sqrt(1 - 0.09), abs=0.02)
    # a corner of the bounding box
    assert body(replace(ball, press_x_mm=9.5, press_y_mm=9.5)).axis_height_mm == 0.0


def test_a_place_beside_the_body_is_refused_with_the_range() -> None:
    said = r"(?s)press_x: 41 mm .*from -40 to 40 mm.*press_y: -30.5 mm .*from -30 to 30 mm"
    with pytest.raises(InputError, match=said):
        body(replace(BRAIN, press_x_mm=41.0, press_y_mm=-30.5))
    assert body(replace(BRAIN, press_x_mm=-40.0)).half_width_mm == 0.0  # on its edge
