"""gmsh is given one body however it lies: position, orientation and order change no element."""

from dataclasses import replace

import numpy as np
import pytest

from study.mechanics.mesh.mesher import build_mesh
from study.mechanics.setup.geometry import Sphere, Surface
from study.mechanics.setup.setup import Model, Problem
from study.mechanics.setup.test_kind import Test
from tests.fem.problems import GEL
from tests.fem.surfaces import box, sphere, write

RNG = np.random.default_rng(2011)
PLACE = np.array([1.0, 0.7])


def scan():
    """Body without any symmetry."""
    points, triangles = sphere(8, 3)
    return points * (1.2 + 0.2 * np.sin(points[:, [1, 2, 0]] / 3)), triangles


def moved(shape, angle, shift):
    """Turned about the vertical, moved, and written down in another order."""
    points, triangles = shape
    c, s = np.cos(angle), np.sin(angle)
    turned = points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + shift
    order = RNG.permutation(len(points))
    cells = np.argsort(order)[triangles][RNG.permutation(len(triangles))]
    return turned[order], np.roll(cells, 1, axis=1)


def mesh(tmp_path, shape, angle, shift, **model):
    """Mesh of a moved body, pressed at the same of its places, in its first coordinates."""
    c, s = np.cos(angle), np.sin(angle)
    x, y = PLACE @ np.array([[c, s], [-s, c]]) + shift[:2]
    file = write(tmp_path / "body.obj", moved(shape, angle, shift))
    placed = Surface(file, press_x_mm=float(x), press_y_mm=float(y), clamp_below_mm=shift[2] + 1.0)
    test = Test("indentation", 0.4, "frictionless", "bonded", steps=1, indenter=Sphere(4))
    settings = replace(Model(space="3d", element_order="linear", mesh="coarse"), **model)
    made = build_mesh(Problem(placed, test, GEL, settings).setup)
    return replace(made, points=made.points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]))


@pytest.mark.parametrize("shape", [scan(), box(12, 10, 6)], ids=["scan", "box"])
def test_position_orientation_and_order_change_no_element(tmp_path, shape):
    first = mesh(tmp_path, shape, 0.0, np.zeros(3))
    for angle, shift in [
        (0.0, [0.1, -0.3, 0.7]),
        (np.pi / 2, [0.0, 0.0, 0.0]),
        (-2.1, [-312.4, 77.3, 1001.9]),
    ]:
        other = mesh(tmp_path, shape, angle, np.array(shift))
        assert np.array_equal(other.cells, first.cells)
        assert other.points == pytest.approx(first.points, abs=1e-9)


def test_a_seed_gives_another_mesh_of_the_same_body(tmp_path):
    first, *others = (
        mesh(tmp_path, scan(), 0.0, np.zeros(3), mesh_seed=seed) for seed in (None, 1, 2, 1)
    )
    assert len({len(one.points) for one in (first, *others[:2])}) == 3
    assert others[0].digest() == others[2].digest()
    for other in others:
        assert len(other.cells) == pytest.approx(len(first.cells), rel=0.1)
        assert other.size_mm == first.size_mm
        assert np.ptp(other.points, axis=0) == pytest.approx(np.ptp(first.points, axis=0), rel=0.02)
