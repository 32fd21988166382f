"""Pictures of meshes: the boundary is found, nothing but vectors is drawn."""

import numpy as np
import pytest

from study.reporting.figures.mesh_figures import boundary_faces, picture

# a unit cube of six tetrahedra around its diagonal (Kuhn's triangulation)
CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
TETRAHEDRA = np.array(
    [[0, 4, 6, 7], [0, 4, 5, 7], [0, 2, 6, 7], [0, 2, 3, 7], [0, 1, 5, 7], [0, 1, 3, 7]]
)


def area(points, faces):
    a, b, c = (points[faces[:, i]] for i in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def test_boundary_of_a_cube_of_tetrahedra_is_its_surface():
    faces = boundary_faces(TETRAHEDRA)
    assert len(faces) == 12
    assert area(CORNERS, faces) == pytest.approx(6.0)


def test_two_hexahedra_share_one_face():
    # scikit-fem numbers the corners of its cube from (1, 1, 1) to (0, 0, 0)
    order = [[1, 1, 1], [1, 1, 0], [1, 0, 1], [0, 1, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]]
    both = np.unique(np.concatenate([np.array(order), np.array(order) + [1, 0, 0]]), axis=0)
    cells = np.array(
        [[int(np.flatnonzero((both == np.array(v) + [shift, 0, 0]).all(1))[0]) for v in order]
         for shift in (0, 1)]
    )  # fmt: skip
    faces = boundary_faces(cells)
    assert len(faces) == 10
    for face in faces:
        corners = both[face]
        # a face lies in a plane, and its corners go round it
        assert (np.ptp(corners, axis=0) == 0).sum() == 1
        assert [np.abs(corners[i] - corners[i - 1]).sum() for i in range(4)] == [1, 1, 1, 1]


def test_a_solid_and_a_section_are_drawn_as_vectors():
    shift = 0.1 * CORNERS
    svg, caption = picture(CORNERS, TETRAHEDRA, shift, name="cube")
    assert caption.startswith("6 cells")
    assert "0.173" in caption  # 0.1 sqrt(3)
    flat = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    section, _ = picture(flat, np.array([[0, 1, 2, 3]]), 0.1 * flat, name="plane")
    for drawing in (svg, section):
        assert "<image" not in drawing
        assert 'role="img"' in drawing


def test_a_mesh_too_large_to_draw_is_refused():
    many = np.tile([[0, 1, 2]], (20_001, 1))
    with pytest.raises(ValueError, match="20,001 faces are too many"):
        picture(np.zeros((3, 2)), many, np.zeros((3, 2)))
