"""An indenter at a chosen place of a round body: where it meets the surface, and what it feels."""

from dataclasses import replace

import numpy as np
import pytest

from study.mechanics.mesh.mesher import build_mesh
from study.mechanics.setup.geometry import Brain, Flat, Gravity, Sphere, Surface
from study.mechanics.surface.closed_surface import body
from tests.fem.problems import GEL, LONG, indentation, long_verification, reached
from tests.fem.surfaces import box, sphere, write

BRAIN = Brain(80, 60, 50, 4, clamp_below_mm=15, press_x_mm=10, press_y_mm=-14)


def pressed(specimen, depth, **model):
    settings = {"space": "3d", "element_order": "linear", "mesh": "coarse", **model}
    return indentation(Sphere(8), depth, material=GEL, specimen=specimen, steps=1, **settings)


def force(problem):
    found = reached(problem)
    return float(found.curve.force_N[-1]), float(found.base_reaction_N[-1])


def test_elements_are_small_where_the_indenter_comes_down():
    problem = pressed(BRAIN, 1.0)
    mesh, height = build_mesh(problem.setup), body(BRAIN).axis_height_mm
    assert height < 48  # below the highest point of the body, at whose height they once were small
    centers = mesh.points[mesh.cells].mean(axis=1)
    corners = mesh.points[mesh.cells]
    size = np.linalg.norm(corners[:, :, None] - corners[:, None, :], axis=-1).max(axis=(1, 2))
    smallest = centers[size < np.quantile(size, 0.1)]
    far = np.linalg.norm(smallest - [0, 0, height], axis=1)
    assert np.quantile(far, 0.9) < 6


@pytest.mark.parametrize("order", ["linear", pytest.param("quadratic", marks=LONG)])
def test_a_clamp_carries_what_the_indenter_presses(order):
    # on a slope, in both orders: held bubbles of linear elements once took 6 % of it
    top, below = force(pressed(BRAIN, 0.5, element_order=order))
    assert below == pytest.approx(top, rel=1e-6)


def test_weight_is_carried_by_the_clamp_too():
    problem = pressed(BRAIN, 0.5)
    heavy = replace(problem.test, gravity=Gravity(980.0))
    top, below = force(replace(problem, test=heavy))
    weight = 9.80665 * 980e-9 * body(BRAIN).volume_mm3
    assert below - top == pytest.approx(weight, rel=1e-6)
    assert top < force(problem)[0]  # the surface has sagged away from the indenter


@long_verification
def test_a_sphere_on_a_ball_is_hertz_contact(tmp_path):
    """Two spheres that touch, 1/R = 1/R1 + 1/R2 (Hertz 1882), one of them rigid."""
    ball = Surface(write(tmp_path / "ball.stl", sphere(40, 5)), clamp_below_mm=-15.0)
    problem = pressed(ball, 0.4, element_order="quadratic")
    found, _ = force(problem)
    radius = 1 / (1 / 8 + 1 / 40)
    hertz = 4 / 3 * (2 * GEL.mu0 / 0.5) * np.sqrt(radius) * 0.4**1.5
    # measured: 4.5 % less on this mesh; the contact radius is 0.23 of the indenter's
    assert found == pytest.approx(hertz, rel=0.08)


@long_verification
def test_a_place_on_a_box_away_from_its_middle(tmp_path):
    """A wide box feels the same a little beside its middle: the block's own model knows it."""
    lump = Surface(write(tmp_path / "box.ply", box(24, 24, 12)), press_x_mm=2.0, press_y_mm=-1.0)
    problem = pressed(lump, 0.4, element_order="quadratic")
    problem = replace(problem, test=replace(problem.test, indenter=Flat(3, 1)))
    beside, _ = force(problem)
    middle, _ = force(replace(problem, specimen=replace(lump, press_x_mm=0.0, press_y_mm=0.0)))
    # measured: 1.0 %
    assert beside == pytest.approx(middle, rel=0.02)


def test_a_rough_scan_is_meshed(data_dir):
    """Of a brain from images, on which some edges are as bent as those between faces."""
    file = data_dir / "brain_surface" / "mni152_outer_coarse.stl"
    scan = Surface(str(file), clamp_below_mm=-20.0, press_x_mm=20.0, press_y_mm=-20.0)
    mesh = build_mesh(pressed(scan, 3.0).setup)
    edges = mesh.points[mesh.cells[:, 1:]] - mesh.points[mesh.cells[:, :1]]
    enclosed = np.linalg.det(edges).sum() / 6
    assert enclosed == pytest.approx(body(scan).volume_mm3, rel=1e-6)
