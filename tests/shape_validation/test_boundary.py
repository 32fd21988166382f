"""Surfaces of meshes of every kind of cell: closed, outward, of the right volume."""

from __future__ import annotations

import numpy as np
import pytest

from study.ground.arrays import Array, Ints
from study.ground.errors import InputError
from study.laboratory.shape.boundary import DeformedMesh, surface_of, symmetry_of
from study.mechanics.surface.closed_surface import volume

#: Half a unit cube's nodes along an axis for the quadratic cell: corners, then middles.
CUBE = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]],
    dtype=float,
)


def box_mesh(n: int, low: Array, high: Array) -> tuple[Array, Ints]:
    """Hexahedra of a box."""
    grid = [np.linspace(a, b, n + 1) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange((n + 1) ** 3).reshape(n + 1, n + 1, n + 1)
    corner = CUBE.astype(int)
    cells = [
        [number[i + a, j + b, k + c] for a, b, c in corner]
        for i in range(n) for j in range(n) for k in range(n)
    ]  # fmt: skip
    return points, np.array(cells)


def six_tetrahedra(cells: Ints) -> Ints:
    """Split hexahedra along their diagonal 0-6."""
    ways = [(0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6)]
    return np.concatenate([cells[:, list(way)] for way in ways])


@pytest.mark.parametrize("kind", ["hexahedron", "tetra"])
def test_a_whole_box_has_its_volume(kind: str) -> None:
    points, cells = box_mesh(3, np.array([-2.0, -1, 0]), np.array([2.0, 1, 3]))
    cells = cells if kind == "hexahedron" else six_tetrahedra(cells)
    mesh = DeformedMesh(points, 0.1 * points, kind, cells)
    found = surface_of(mesh)
    assert str(symmetry_of(mesh)) == "whole body"
    assert volume(found.points, found.triangles) == pytest.approx(24)
    assert volume(found.points + found.displacement, found.triangles) == pytest.approx(24 * 1.1**3)


def test_a_quarter_of_an_upper_half_becomes_the_whole() -> None:
    points, cells = box_mesh(2, np.array([0.0, 0, 5]), np.array([2.0, 3, 10]))
    stretch = np.array([0.1, 0.1, -0.2])
    mesh = DeformedMesh(points, (points - [0, 0, 5]) * stretch, "hexahedron", cells)
    found = surface_of(mesh)
    assert symmetry_of(mesh).mirrored == (True, True, True)
    assert volume(found.points, found.triangles) == pytest.approx(4 * 6 * 10)
    assert found.displacement[found.points[:, 2] == 0.0, 2] == pytest.approx(1.0)


def test_a_section_becomes_a_ring_of_the_right_volume() -> None:
    points = np.array([[1.0, 0, 0], [3, 0, 0], [3, 2, 0], [1, 2, 0]])
    mesh = DeformedMesh(points, np.zeros_like(points), "quad", np.array([[0, 1, 2, 3]]))
    found = surface_of(mesh)
    # a polygon of 180 sides has sin(2 deg) / (2 deg) of its circle's area
    share = np.sin(np.radians(2)) / np.radians(2)
    assert volume(found.points, found.triangles) == pytest.approx(16 * np.pi * share)


def test_unknown_cells_are_refused() -> None:
    mesh = DeformedMesh(np.eye(3), np.zeros((3, 3)), "wedge", np.zeros((1, 6), dtype=np.int64))
    with pytest.raises(InputError, match="cells of type 'wedge'"):
        surface_of(mesh)
