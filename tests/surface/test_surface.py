"""Closed surfaces: files, what is mended and what is refused; the brain-shaped one."""

from dataclasses import replace

import numpy as np
import pytest

from study.ground.errors import InputError
from study.mechanics.contact.collocation import touch_mm
from study.mechanics.contact.contact import pins, rigid_motions
from study.mechanics.setup.geometry import Brain, Cone, Sphere, Surface
from study.mechanics.surface.brain import brain_surface
from study.mechanics.surface.closed_surface import Triangles, body, first_intersection
from tests.fem.surfaces import box, cylinder, joined, sphere, write


def placed(shape, point, place):
    """Put a point somewhere else."""
    points = shape[0].copy()
    points[point] = place
    return points, shape[1]


@pytest.mark.parametrize(
    ("suffix", "text"), [(".stl", False), (".stl", True), (".ply", False), (".obj", False)]
)
def test_every_format_gives_the_same_body(tmp_path, suffix, text):
    path = tmp_path / f"box{suffix}"
    write(path, box(10, 8, 16))  # a file that changes is read again
    assert body(Surface(str(path))).height_mm == pytest.approx(16)
    found = body(Surface(write(path, box(10, 8, 6), text=text)))
    # single precision of a binary STL
    assert found.volume_mm3 == pytest.approx(480, rel=1e-6)
    assert found.height_mm == pytest.approx(6, rel=1e-6)
    assert (found.plate_area_mm2("top"), found.plate_area_mm2("base")) == pytest.approx((80, 80))
    assert found.half_width_mm == pytest.approx(4)
    assert found.notes == ()


@pytest.mark.parametrize(
    ("axis", "height"), [("z", 6), ("-z", 6), ("x", 10), ("-x", 10), ("y", 8), ("-y", 8)]
)
def test_any_axis_may_point_up(tmp_path, axis, height):
    file = write(tmp_path / "box.obj", box(10, 8, 6))
    found = body(Surface(file, axis=axis))
    assert found.height_mm == pytest.approx(height)
    assert found.volume_mm3 == pytest.approx(480)  # positive: a rotation, no mirror image
    assert found.touches("base")
    assert found.touches("top")


def test_an_axis_that_points_down_puts_the_top_below(tmp_path):
    points, triangles = box(10, 8, 6)
    points[4:, :2] *= 0.5  # a frustum, narrow above
    file = write(tmp_path / "frustum.obj", (points, triangles))
    assert body(Surface(file)).plate_area_mm2("top") == pytest.approx(20)
    assert body(Surface(file, axis="-z")).plate_area_mm2("base") == pytest.approx(20)


def test_unit_and_place_do_not_matter(tmp_path):
    points, triangles = box(10, 8, 6)
    file = write(tmp_path / "box.ply", (points / 25.4 + [3, -2, 5], triangles))
    found = body(Surface(file, unit="in"))
    assert found.points.min(axis=0) == pytest.approx([-5, -4, 0])
    assert found.points.max(axis=0) == pytest.approx([5, 4, 6])
    assert found.lowest_mm == pytest.approx(5 * 25.4)
    pressed = body(Surface(file, unit="in", press_x_mm=3 * 25.4 + 1, press_y_mm=-2 * 25.4))
    assert pressed.half_width_mm == pytest.approx(4)  # 4 to the right, 4 to the back
    assert pressed.points[:, 0].min() == pytest.approx(-6)


@pytest.mark.parametrize("far", [1e3, 1e7, -1e9])
def test_a_sound_body_far_from_the_origin_of_its_file_faces_outward(tmp_path, far):
    points, triangles = box(10, 8, 6)
    place = np.array([far, -far, 0.5 * far])
    found = body(Surface(write(tmp_path / "far.obj", (points + place, triangles))))
    assert found.notes == ()
    assert found.volume_mm3 == pytest.approx(480, rel=1e-6)  # coordinates hold 16 digits
    assert Triangles(points + place, triangles[:, ::-1]).volume_mm3 == pytest.approx(-480, rel=1e-6)
    assert found.area_mm2 == pytest.approx(2 * (80 + 60 + 48), rel=1e-6)


def test_a_place_beside_a_surface_is_refused_with_the_range(tmp_path):
    points, triangles = box(10, 8, 6)
    file = write(tmp_path / "box.obj", (points + [100, 20, 0], triangles))
    with pytest.raises(InputError) as caught:
        body(Surface(file, press_x_mm=1e9, press_y_mm=15.0))
    said = str(caught.value)
    assert "press_x: 1e+09 mm is beside the specimen, which reaches from 95 to 105 mm" in said
    assert "press_y: 15 mm is beside the specimen, which reaches from 16 to 24 mm" in said
    # turned, x of the specimen is y of the file, and y is z
    with pytest.raises(InputError, match="press_x: 100 mm .* from 16 to 24 mm"):
        body(Surface(file, axis="x", press_x_mm=100.0, press_y_mm=3.0))
    assert body(Surface(file, axis="x", press_x_mm=20.0, press_y_mm=3.0)).notes == ()
    # upside down y changes its sign
    with pytest.raises(InputError, match="press_y: 20 mm .* from -24 to -16 mm"):
        body(Surface(file, axis="-z", press_y_mm=20.0))


def test_an_implausible_size_is_said(tmp_path):
    file = write(tmp_path / "box.obj", box(10, 8, 6))
    assert "is it really in m?" in body(Surface(file, unit="m")).notes[0]
    assert "1e+04 x 8000 x 6000 mm" in body(Surface(file, unit="m")).notes[0]


def test_turned_triangles_are_mended_and_said(tmp_path):
    points, triangles = box(10, 8, 6)
    one = triangles.copy()
    one[3] = one[3, ::-1]
    found = body(Surface(write(tmp_path / "one.obj", (points, one))))
    assert found.notes == ("specimen.file: 1 of 12 triangles faced inward and were turned",)
    assert found.volume_mm3 == pytest.approx(480)
    whole = body(Surface(write(tmp_path / "all.obj", (points, triangles[:, ::-1]))))
    assert "inside out" in whole.notes[0]
    assert whole.volume_mm3 == pytest.approx(480)


BOX, BALL = box(10, 8, 6), sphere(5, 2)
#: surfaces that enclose no body, and what is said of each
REFUSED = {
    # triangle (1, 7, 5): corners (5, -4, 0), (5, 4, 6), (5, -4, 6)
    "hole": ((BOX[0], BOX[1][:-1]),
             "3 open edges around 1 hole, the largest near (5, -1.3333, 4) mm"),
    "fin": ((np.vstack([BOX[0], [[0, 0, 20]]]), np.vstack([BOX[1], [[4, 5, 8]]])),
            "1 edges belong to more than two triangles (first near (0, -4, 6) mm)"),
    "two bodies": (joined(BOX, (BOX[0] + 20, BOX[1])),
                   "holds 2 separate surfaces, with 12, 12 triangles"),
    "cavity": (joined(BOX, (BOX[0] * 0.5 + [0, 0, 1], BOX[1][:, ::-1])), "without cavities"),
    # joined by a point alone is not joined
    "corner": (joined(BOX, (BOX[0] + [10, 8, 6], BOX[1])), "separate surfaces"),
    # the upper pole of a sphere is pushed down onto the lower one
    "pinched": (placed(BALL, 2, BALL[0][5]), "touches itself at 1 points (first at (0, 0, -5) mm)"),
    # and out of it: where the spike leaves the sphere
    "spike": (placed(BALL, 2, [0, 0, -7]), "passes through itself: triangles"),
    "nan": (placed(BOX, 3, [np.nan, 0, 0]), "coordinates that are no numbers (first: 1)"),
    "infinite": (placed(BOX, 3, [np.inf, 0, 0]), "no numbers"),
    "flat": ((BOX[0], np.vstack([BOX[1], [[4, 4, 5]]])),
             "1 triangles have no area (first: triangle 13"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_a_surface_that_encloses_no_body_is_refused(tmp_path, name):
    shape, said = REFUSED[name]
    with pytest.raises(InputError) as caught:
        body(Surface(write(tmp_path / "surface.obj", shape)))
    assert said in str(caught.value)


def test_one_pair_of_crossing_triangles_is_named():
    points = np.array(
        [[0, 0, 0], [4, 0, 0], [0, 4, 0], [1, 1, -1], [1, 1, 1], [9, 9, 0], [7, 7, 7], [8, 7, 7]]
        + [[7, 8, 7]],
        dtype=float,
    )
    found = first_intersection(points, np.array([[6, 7, 8], [3, 4, 5], [0, 1, 2]]))
    first, second, place, count = found
    assert (first, second, count) == (1, 2, 1)
    assert place[2] == pytest.approx(0)
    above = points + np.where(np.arange(9) < 3, 5.0, 0.0)[:, None] * [0, 0, 1]
    assert first_intersection(above, np.array([[6, 7, 8], [3, 4, 5], [0, 1, 2]])) is None


def test_overlapping_triangles_in_one_plane():
    points = np.array([[0, 0, 0], [4, 0, 0], [0, 4, 0], [4, 4, 0], [1, 1, 0]], dtype=float)
    neighbors = np.array([[0, 1, 2], [1, 3, 2]])
    assert first_intersection(points, neighbors) is None  # they share an edge
    assert first_intersection(points, np.array([[0, 1, 2], [1, 3, 4]])) is not None


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("empty.stl", b"", "is empty"),
        ("text.stl", b"this is no surface\nat all\n", "is malformed"),
        ("noise.stl", bytes(range(256)) * 8, "is malformed"),
        (
            "short.stl",
            b"\0" * 80 + b"\x05\0\0\0" + b"\0" * 60,
            "promises 5 triangles, it has room for 1.2",
        ),
        ("cut.stl", b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0", "is malformed"),
        ("endless.ply", b"ply\nformat ascii 1.0\nelement vertex 3\n", "its header has no end"),
        (
            "bomb.ply",
            b"ply\nformat ascii 1.0\nelement vertex 999999999999\nend_header\n",
            "promises more",
        ),
        (
            "lists.ply",
            b"ply\nformat ascii 1.0\nelement face 1\nproperty list uchar\nend_header\n",
            "is malformed: it breaks the rules of its format",
        ),
        ("range.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "a point that is not there"),
        ("quads.obj", b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n", "no triangles"),
        ("points.obj", b"v 0 0 0\nv 1 0 0\n", "no triangles"),
        ("box.step", b"ISO-10303-21;", "must end in .stl, .ply, .obj"),
    ],
)
def test_files_that_are_no_surfaces(tmp_path, name, content, said):
    path = tmp_path / name
    with pytest.raises(InputError, match="cannot be read"):
        body(Surface(str(path)))
    path.write_bytes(content)
    with pytest.raises(InputError, match=said):
        body(Surface(str(path)))


def test_a_file_cut_or_changed_anywhere_ends_in_words(tmp_path):
    rng, refusals = np.random.default_rng(7), 0
    for k in range(150):
        path = tmp_path / f"shape{('.stl', '.ply', '.obj')[k % 3]}"
        write(path, cylinder(10, 12, 8), text=bool(k % 2))
        raw = bytearray(path.read_bytes())
        for place in rng.integers(len(raw), size=3):
            raw[place : place + int(rng.integers(3))] = rng.bytes(int(rng.integers(4)))
        path.write_bytes(raw[: int(rng.integers(1, 2 * len(raw)))])
        try:
            assert body(Surface(str(path))).volume_mm3 > 0
        except InputError:  # anything else is a bug
            refusals += 1
    assert refusals > 100


def test_thirty_thousand_triangles(tmp_path):
    file = write(tmp_path / "sphere.stl", sphere(5, 6))
    found = body(Surface(file))
    assert len(found.triangles) == 32768
    assert found.volume_mm3 == pytest.approx(4 / 3 * np.pi * 125, rel=1e-3)
    assert not found.touches("top")


def test_faces_nearly_in_a_plate_are_put_into_it(tmp_path):
    points, triangles = box(10, 8, 6)
    points[4:, 2] += [0, 2e-4, -1e-4, 3e-4]  # 5e-5 of the height: a scanned face
    found = body(Surface(write(tmp_path / "rough.obj", (points, triangles))))
    assert found.plate_area_mm2("top") == pytest.approx(80)
    assert np.ptp(found.points[np.unique(found.triangles[found.top]), 2]) == 0
    points[4:, 2] += [0, 2e-2, -1e-2, 3e-2]
    file = write(tmp_path / "rougher.obj", (points, triangles))
    assert not body(Surface(file)).touches("top")
    assert body(Surface(file, plate_tolerance_mm=0.1)).touches("top")


def test_where_an_indenter_first_touches_a_slope():
    # a sphere of radius R on a plane with slope t about the axis: R / cos t - R above it
    far, slope = 20.0, np.radians(20)
    corners = np.array([[-far, -far], [far, -far], [0, 2 * far]])
    triangle = np.column_stack([corners, 5 + np.tan(slope) * corners[:, 0]])[None]
    touch = touch_mm(Sphere(3), triangle, 10)
    # 14 halvings of the triangle's sides; the difference is quadratic in the place
    assert touch == pytest.approx(5 + 3 / np.cos(slope) - 3, abs=1e-5)
    # a sharp cone of 45 deg touches a slope below its own with its tip
    assert touch_mm(Cone(45), triangle, 10) == pytest.approx(5, abs=1e-2)
    with pytest.raises(InputError, match="misses the specimen"):
        touch_mm(Sphere(3), triangle + [30, 0, 0], 10)


def test_pins_hold_what_is_left_and_no_more():
    places = np.random.default_rng(1).uniform(-1, 1, (40, 3))
    assert len(pins(places, 40, {})) == 6
    lying = places.copy()
    lying[:10, 2] = -1
    plate = {3 * n + 2: 0.0 for n in range(10)}
    found = pins(lying, 30, plate)
    assert len(found) == 3  # along the plate, and about its normal
    assert (found < 90).all()
    rows = rigid_motions(lying).reshape(-1, 6)[sorted({*plate, *found.tolist()})]
    assert np.linalg.matrix_rank(rows) == 6
    clamp = {3 * n + i: 0.0 for n in range(10) for i in range(3)}
    assert pins(lying, 30, clamp).size == 0


# The brain-shaped surface: extents, closedness, symmetry and volume known another way.

BRAIN = Brain(80, 60, 50, fissure_mm=4, clamp_below_mm=15)


def test_extents_are_those_asked_for():
    points, triangles = brain_surface(BRAIN)
    assert points.min(axis=0) == pytest.approx([-40, -30, 0], abs=1e-12)
    assert points.max(axis=0) == pytest.approx([40, 30, 50], abs=1e-12)
    edges = len({frozenset(p) for t in triangles for p in zip(t, np.roll(t, 1), strict=True)})
    assert len(points) - edges + len(triangles) == 2  # Euler: closed and without a hole


def test_without_a_groove_it_has_the_volume_of_two_half_ellipsoids():
    # the taper moves each section sideways of y = 0 alike in front and behind: to first order it
    # keeps the volume, and its squared slope does not enter an area; widths are scaled back
    points, triangles = brain_surface(replace(BRAIN, fissure_mm=0.0))
    x = np.linspace(-1, 1, 20001)
    widest = ((1 - 0.12 * x) * np.sqrt(1 - x**2)).max()
    expected = np.pi / 6 * 80 * 60 * 50 / widest
    assert Triangles(points, triangles).volume_mm3 == pytest.approx(expected, rel=2e-3)


def test_the_groove_is_as_deep_as_said():
    floor = body(replace(BRAIN, press_x_mm=0.0, press_y_mm=0.0)).axis_height_mm
    assert body(BRAIN).height_mm - floor == pytest.approx(4, abs=1e-6)


def test_both_halves_are_mirror_images():
    points, _ = brain_surface(BRAIN)
    mirrored = np.round(points * [1, -1, 1], 9) + 0.0
    assert {tuple(p) for p in mirrored} == {tuple(p) for p in np.round(points, 9) + 0.0}


def test_a_groove_that_is_too_deep_is_refused():
    with pytest.raises(InputError, match=r"(?s)specimen\.fissure.*at most 7\.5 mm"):
        body(replace(BRAIN, fissure_mm=8.0))


def test_the_height_on_an_axis_is_that_of_an_ellipsoid():
    ball = Brain(20, 20, 20)
    # upper half: 0.65 of the height above the waist at 7 mm; at (3, 0) of a 10 mm half axis
    found = body(replace(ball, press_x_mm=3.0, press_y_mm=0.0)).axis_height_mm
    assert found == pytest.approx(7 + 13 * np.sqrt(1 - 0.09), abs=0.02)
    # a corner of the bounding box
    assert body(replace(ball, press_x_mm=9.5, press_y_mm=9.5)).axis_height_mm == 0.0


def test_a_place_beside_the_body_is_refused_with_the_range():
    said = r"(?s)press_x: 41 mm .*from -40 to 40 mm.*press_y: -30.5 mm .*from -30 to 30 mm"
    with pytest.raises(InputError, match=said):
        body(replace(BRAIN, press_x_mm=41.0, press_y_mm=-30.5))
    assert body(replace(BRAIN, press_x_mm=-40.0)).half_width_mm == 0.0  # on its edge
