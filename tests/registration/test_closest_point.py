"""Distances to surfaces: closed forms, and every triangle looked at."""

from __future__ import annotations

import numpy as np
import pytest

from study.laboratory.registration.iterative_closest_point import TriangleSurface, point_triangle
from tests.registration.bodies import ball, box, egg


def test_the_signed_distance_to_a_box_is_that_of_its_formula() -> None:
    sides = np.array([30.0, 20.0, 10.0])
    surface = box(*sides)
    points = np.random.default_rng(1).uniform(-15, 45, (2000, 3))
    q = np.abs(points - sides / 2) - sides / 2
    outside = np.linalg.norm(np.maximum(q, 0), axis=1)
    expected = outside + np.minimum(q.max(axis=1), 0)
    assert np.abs(surface.closest(points).distance - expected).max() < 1e-12


def test_the_sign_is_right_off_edges_and_vertices() -> None:
    """Straight off a vertex the normals of its faces disagree: only pseudo-normals are safe."""
    surface = box(10.0, 10.0, 10.0)
    off = np.array([[-1.0, -1, -1], [11, 11, 11], [-1, -1, 5], [11, 5, -1], [5, 5, 5]])
    assert (np.sign(surface.closest(off).distance) == [1, 1, 1, 1, -1]).all()


def test_no_triangle_is_nearer_than_the_one_found() -> None:
    surface = egg(300)
    # one triangle a hundred times larger than the rest, in which candidates could be missed
    far = np.array([[300.0, -400, -300], [300, 400, -300], [300, 0, 500]])
    points = np.vstack([surface.points, far])
    large = np.vstack([surface.triangles, np.array([[0, 1, 2]]) + len(surface.points)])
    both = TriangleSurface(points, large)
    asked = np.random.default_rng(2).uniform(-300, 300, (200, 3))
    every, _ = point_triangle(asked[:, None], both.corners[None])
    assert np.abs(np.abs(both.closest(asked).distance) - every.min(axis=1)).max() < 1e-9


def test_the_distance_to_a_faceted_sphere_converges_with_the_square_of_the_side() -> None:
    asked = np.random.default_rng(3).uniform(-20, 20, (500, 3))
    exact = np.linalg.norm(asked, axis=1) - 10.0
    errors = [np.abs(ball(10.0, n).closest(asked).distance - exact).max() for n in (500, 2000)]
    # four times the triangles have half the side
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.3)
