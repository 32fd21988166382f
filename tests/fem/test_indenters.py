"""Signed distance to indenters: exact, continuous, with the derivatives that Newton needs."""

import numpy as np
import pytest

from study.mechanics.contact.rigid_surface import Press, profile, signed_distance
from study.mechanics.setup.geometry import Cone, Flat, Sphere

INDENTERS = [Cone(30, 1), Cone(45, 0.5, 2), Flat(3, 0.3), Sphere(5)]
IDS = ["cone", "cone with shaft", "flat", "sphere"]


def press(indenter):
    return Press(profile(indenter, far_mm=1e4), height_mm=10.0)


def around(indenter, dim, n=400):
    """Points within a millimetre of the surface, away from the joints of its pieces."""
    rng = np.random.default_rng(2011)
    rho, z = rng.uniform(0.02, 4, 40 * n), rng.uniform(9, 14, 40 * n)
    near = np.abs(signed_distance(profile(indenter, far_mm=1e4), rho, z - 10.0)[0]) < 1.0
    rho, z = rho[near][:n], z[near][:n]
    if dim == 2:
        return np.column_stack([rho, z])
    angle = rng.uniform(0, np.pi / 2, rho.size)
    return np.column_stack([rho * np.cos(angle), rho * np.sin(angle), z])


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("indenter", INDENTERS, ids=IDS)
def test_normal_and_hessian_are_derivatives_of_the_gap(indenter, dim):
    surface, x = press(indenter), around(indenter, dim)
    _, normal, hessian = surface.gap(x, 0.0)
    h = 1e-6
    for axis in range(dim):
        step = h * np.eye(dim)[axis]
        up, down = surface.gap(x + step, 0.0), surface.gap(x - step, 0.0)
        # where a difference straddles two pieces the second derivative jumps
        smooth = np.abs(up[2] - down[2]).max(axis=(1, 2)) < 1e-3
        assert smooth.mean() > 0.97
        np.testing.assert_allclose(
            (up[0] - down[0])[smooth] / 2 / h, normal[smooth, axis], atol=1e-8
        )
        slope = (up[1] - down[1])[smooth] / 2 / h
        np.testing.assert_allclose(slope, hessian[smooth, :, axis], atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("indenter", INDENTERS, ids=IDS)
def test_normals_have_unit_length_and_the_gap_is_continuous(indenter):
    surface = press(indenter)
    normal = surface.gap(around(indenter, 3), 0.0)[1]
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=1e-12)
    line = np.column_stack([np.linspace(0, 4, 4001), np.full(4001, 10.3)])
    gap = surface.gap(line, 0.0)[0]
    assert np.abs(np.diff(gap)).max() <= 1.001e-3  # a distance changes no faster than its point


def test_distances_known_by_hand():
    flat = profile(Flat(3, 0.3), far_mm=1e4)
    gap = signed_distance(flat, np.array([1.0, 3.5, 3.0]), np.array([-0.2, 1.0, 0.0]))[0]
    corner = np.hypot(0.3, 0.3) - 0.3  # from the point below the shaft to the rounded edge
    np.testing.assert_allclose(gap, [0.2, 0.5, corner], atol=1e-12)
    cone = profile(Cone(30, 0), far_mm=1e4)
    on_flank = signed_distance(cone, np.array([np.tan(np.radians(30))]), np.array([1.0]))[0]
    np.testing.assert_allclose(on_flank, 0.0, atol=1e-12)


@pytest.mark.parametrize("indenter", [Cone(30, 1, 3), Flat(3, 0.3), Flat(3), Sphere(5)])
def test_a_point_thrown_across_the_axis_has_a_gap(indenter):
    """Seen in iterates that fail: an infinite gap made the forces of the next one NaN."""
    z = np.array([51.0, 49.9, 48.0, 40.0])
    across, on = (np.column_stack([np.full(4, r), z]) for r in (-0.1, 0.0))
    press = Press(profile(indenter, far_mm=1e5), 50.0)
    np.testing.assert_array_equal(press.gap(across, 1.0)[0], press.gap(on, 1.0)[0])
    assert np.isfinite(press.gap(across, 1.0)[0]).all()
