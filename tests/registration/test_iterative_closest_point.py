"""Registered clouds and distances to surfaces: known motions come back, bounds hold."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import binom, t

from study.laboratory.registration.iterative_closest_point import (
    PATCHES,
    TriangleSurface,
    point_triangle,
    register,
)
from study.laboratory.registration.rigid import isolated, turned_about
from tests.fem.problems import long_verification
from tests.registration.bodies import ball, box, egg, scan


def random_motion(rng):
    return turned_about(np.zeros(3), 0.4 * rng.standard_normal(3), 30 * rng.standard_normal(3))


@pytest.mark.parametrize("outliers", [0.0, 0.3])
def test_a_clean_scan_comes_back_to_a_millionth(outliers):
    rng = np.random.default_rng(1)
    surface = egg()
    cloud = scan(surface, 1500, rng)
    foreign = int(outliers * len(cloud))
    cloud[:foreign] = rng.uniform(-60, 60, (foreign, 3))
    truth = random_motion(rng)
    found = register(surface, truth(cloud))
    error = found.motion.after(truth)
    assert found.converged
    assert np.abs(error(surface.points) - surface.points).max() < 1e-6
    assert found.sliding == ()


def test_a_body_that_is_larger_all_around_lies_in_the_middle():
    """Nearly all points 0.3 mm outside, a few foreign: not pushed until half of them touch."""
    rng = np.random.default_rng(11)
    axes = np.array([30.0, 24.0, 18.0])
    sphere = ball(1.0, 4000)
    surface = TriangleSurface(sphere.points * axes, sphere.triangles)
    d = scan(sphere, 1500, rng)
    d /= np.linalg.norm(d, axis=1)[:, None]
    normal = (d / axes) / np.linalg.norm(d / axes, axis=1)[:, None]
    cloud = d * axes + 0.3 * normal + rng.normal(0, 0.05, d.shape)
    cloud[:15] *= 1.2
    seen = turned_about(np.zeros(3), np.array([0.1, 0.05, 0.2]), axes)(cloud)
    found = register(surface, seen)
    assert found.converged
    away = surface.closest(found.motion(seen[15:])).distance
    assert away.mean() == pytest.approx(0.3, abs=0.02)
    assert away.std() < 0.08


def coverage(scans, seed):
    """How often each of six parameters lies in its 95 % interval: noise, 30 % outliers."""
    rng = np.random.default_rng(seed)
    surface = egg()
    inside = np.zeros(6)
    for _ in range(scans):
        cloud = scan(surface, 1000, rng, noise=0.2)
        cloud[:300] = rng.uniform(-60, 60, (300, 3))
        truth = random_motion(rng)
        seen = truth(cloud)
        found = register(surface, seen[~isolated(seen)])
        error = found.motion.after(truth)
        shift = error(found.center[None])[0] - found.center
        wrong = np.append(Rotation.from_matrix(error.rotation).as_rotvec(), shift)
        inside += np.abs(wrong) < t.ppf(0.975, PATCHES - 6) * np.sqrt(np.diag(found.covariance))
    return inside


def test_noisy_clouds_with_outliers_stay_in_the_stated_uncertainty():
    inside = coverage(4, 7)
    # of 24 intervals 23 should hold; by chance fewer than 18 do in 1 of 2000 such tests
    assert inside.sum() >= binom.ppf(5e-4, 24, 0.95)


@long_verification
def test_the_stated_uncertainty_holds_in_95_of_100_clouds():
    inside = coverage(200, 8)
    low, high = binom.ppf([2.5e-4, 1 - 2.5e-4], 200, 0.95)
    assert (inside >= low).all(), inside
    assert (inside <= high).all(), inside


def test_far_starts_end_at_the_truth():
    rng = np.random.default_rng(9)
    surface = egg()
    truth = turned_about(np.zeros(3), np.array([0.0, 2.8, 0.6]), np.array([500.0, -300, 80]))
    found = register(surface, truth(scan(surface, 1500, rng, noise=0.05)))
    error = found.motion.after(truth)
    assert np.abs(error(surface.points) - surface.points).max() < 0.05


def test_a_sphere_can_turn_and_that_is_said():
    rng = np.random.default_rng(10)
    surface = ball(20.0)
    found = register(surface, scan(surface, 1500, rng, noise=0.02) + [0.5, 0, 0])
    assert [str(one).split()[0] for one in found.sliding] == ["rotation"] * 3
    assert np.abs(found.motion(np.array([[0.5, 0, 0]]))).max() < 0.01


def test_one_face_of_a_box_slides_three_ways():
    rng = np.random.default_rng(11)
    whole = box(60.0, 60.0, 5.0)
    top = TriangleSurface(
        whole.points, whole.triangles[(whole.corners[:, :, 2] == 5.0).all(axis=1)]
    )
    cloud = scan(top, 400, rng, noise=0.01) * [0.5, 0.5, 1.0] + [15.0, 15.0, 0.3]
    found = register(top, cloud)
    names = sorted(str(one) for one in found.sliding)
    assert len(names) == 3
    assert "rotation about (0.00, 0.00, 1.00)" in names
    assert found.motion(cloud)[:, 2].mean() == pytest.approx(5.0, abs=0.01)


def test_points_alone_in_space_are_outliers_and_a_grid_has_none():
    rng = np.random.default_rng(12)
    cloud = scan(egg(), 2000, rng)
    strewn = rng.uniform(-200, 200, (100, 3))
    flagged = isolated(np.vstack([cloud, strewn]))
    assert flagged[:2000].sum() <= 2
    assert flagged[2000:].mean() > 0.9
    grid = np.stack(np.meshgrid(*[np.arange(20.0)] * 2, [0.0]), axis=-1).reshape(-1, 3)
    assert not isolated(grid).any()


# Distances to surfaces: closed forms, and every triangle looked at.


def test_the_signed_distance_to_a_box_is_that_of_its_formula():
    sides = np.array([30.0, 20.0, 10.0])
    surface = box(*sides)
    points = np.random.default_rng(1).uniform(-15, 45, (2000, 3))
    q = np.abs(points - sides / 2) - sides / 2
    outside = np.linalg.norm(np.maximum(q, 0), axis=1)
    expected = outside + np.minimum(q.max(axis=1), 0)
    assert np.abs(surface.closest(points).distance - expected).max() < 1e-12


def test_the_sign_is_right_off_edges_and_vertices():
    """Straight off a vertex the normals of its faces disagree: only pseudo-normals are safe."""
    surface = box(10.0, 10.0, 10.0)
    off = np.array([[-1.0, -1, -1], [11, 11, 11], [-1, -1, 5], [11, 5, -1], [5, 5, 5]])
    assert (np.sign(surface.closest(off).distance) == [1, 1, 1, 1, -1]).all()


def test_no_triangle_is_nearer_than_the_one_found():
    surface = egg(300)
    # one triangle a hundred times larger than the rest, in which candidates could be missed
    far = np.array([[300.0, -400, -300], [300, 400, -300], [300, 0, 500]])
    points = np.vstack([surface.points, far])
    large = np.vstack([surface.triangles, np.array([[0, 1, 2]]) + len(surface.points)])
    both = TriangleSurface(points, large)
    asked = np.random.default_rng(2).uniform(-300, 300, (200, 3))
    every, _ = point_triangle(asked[:, None], both.corners[None])
    assert np.abs(np.abs(both.closest(asked).distance) - every.min(axis=1)).max() < 1e-9


def test_the_distance_to_a_faceted_sphere_converges_with_the_square_of_the_side():
    asked = np.random.default_rng(3).uniform(-20, 20, (500, 3))
    exact = np.linalg.norm(asked, axis=1) - 10.0
    errors = [np.abs(ball(10.0, n).closest(asked).distance - exact).max() for n in (500, 2000)]
    # four times the triangles have half the side
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.3)
